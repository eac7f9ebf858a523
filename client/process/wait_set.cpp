// SPDX-License-Identifier: Apache-2.0

#include <base/descriptors/kept_fd.hpp>
#include <client/process/forked_child.hpp>
#include <client/process/wait_set.hpp>

#include <sys/epoll.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>

namespace agnocast {

Result<std::shared_ptr<WaitSet>> WaitSet::make() {
  UniqueFd eventfd = keep(UniqueFd(::eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK)));
  if (!eventfd) return fail(Errc::os_failure, "making an eventfd", errno);
  return std::make_shared<WaitSet>(std::move(eventfd));
}

WaitSet::~WaitSet() {
  // Sleep words and epoll sets belong to the parent, and the mutex may be held for ever.
  if (is_forked_child()) return;
  disarm_places();  // the next user of each begins awake
  for (const Set& set : sets_) leave(set.epoll);
}

void WaitSet::leave(int epoll) const noexcept {
  if (has_lost_kept()) return;  // these numbers may belong to other files now
  ::epoll_ctl(epoll, EPOLL_CTL_DEL, eventfd_.get(), nullptr);
  for (const auto& [session, place] : places_) place->doorbells.remove_from(epoll);
}

Result<void> WaitSet::add(Session session, std::shared_ptr<Place> place) {
  const std::lock_guard lock(mutex_);
  places_.reserve(places_.size() + 1);
  for (const Set& set : sets_) {
    Result<void> added = place->doorbells.add_to(set.epoll, set.eventfd_tag, set.datagram_tag);
    if (added) continue;
    for (const Set& before : sets_) place->doorbells.remove_from(before.epoll);
    return added;
  }
  places_.emplace_back(session, std::move(place));
  wake();  // a sleeping thread has not armed this place
  return {};
}

void WaitSet::remove(Session session) noexcept {
  std::shared_ptr<Place> gone;  // its destructor takes locks
  const std::lock_guard lock(mutex_);
  const auto found = std::find_if(places_.begin(), places_.end(),
                                  [&](const auto& entry) { return entry.first == session; });
  if (found == places_.end()) return;
  gone = std::move(found->second);
  places_.erase(found);
  for (const Set& set : sets_) gone->doorbells.remove_from(set.epoll);
  wake();  // an unnoticed ring is lost with the doorbell
}

bool WaitSet::renew(Session session, DoorbellReceiver& doorbells) noexcept {
  const std::lock_guard lock(mutex_);
  const auto found = std::find_if(places_.begin(), places_.end(),
                                  [&](const auto& entry) { return entry.first == session; });
  if (found == places_.end()) return false;
  for (const Set& set : sets_) {
    if (doorbells.add_to(set.epoll, set.eventfd_tag, set.datagram_tag)) continue;
    for (const Set& before : sets_) doorbells.remove_from(before.epoll);
    return false;
  }
  for (const Set& set : sets_) found->second->doorbells.remove_from(set.epoll);
  std::swap(found->second->doorbells, doorbells);
  wake();  // nothing has rung the new doorbells for earlier messages
  return true;
}

std::optional<std::uint64_t> WaitSet::index_in(Session session) const noexcept {
  const std::lock_guard lock(mutex_);
  for (const auto& [where, place] : places_) {
    if (where == session) return place->index;
  }
  return std::nullopt;
}

Result<void> WaitSet::add_to(int epoll, std::uint64_t eventfd_tag, std::uint64_t datagram_tag) {
  const std::lock_guard lock(mutex_);
  sets_.reserve(sets_.size() + 1);
  epoll_event event{};
  event.events = EPOLLIN | EPOLLET;
  event.data.u64 = eventfd_tag;
  if (::epoll_ctl(epoll, EPOLL_CTL_ADD, eventfd_.get(), &event) != 0)
    return fail(Errc::os_failure, "adding an eventfd to an epoll set", errno);
  for (const auto& [session, place] : places_) {
    Result<void> added = place->doorbells.add_to(epoll, eventfd_tag, datagram_tag);
    if (added) continue;
    leave(epoll);
    return added;
  }
  sets_.push_back({epoll, eventfd_tag, datagram_tag});
  return {};
}

void WaitSet::remove_from(int epoll) noexcept {
  const std::lock_guard lock(mutex_);
  std::erase_if(sets_, [&](const Set& set) { return set.epoll == epoll; });
  leave(epoll);
}

void WaitSet::drain() noexcept {
  const std::lock_guard lock(mutex_);
  for (const auto& [session, place] : places_) {
    if (place->doorbells.drain()) continue;
    // A publisher that rings only by datagram is noticed at the next periodic check.
    for (const Set& set : sets_) place->doorbells.mute(set.epoll);
  }
  if (sets_.size() > 1) wake();
}

void WaitSet::wake() const noexcept {
  if (!may_use(eventfd_.get())) return;
  const std::uint64_t one = 1;
  [[maybe_unused]] const ssize_t written = ::write(eventfd_.get(), &one, sizeof one);
}

void WaitSet::arm() noexcept {
  const std::lock_guard lock(mutex_);
  ++asleep_;
  for (const auto& [session, place] : places_) {
    place->core.arm();
    place->is_armed = true;
  }
}

void WaitSet::disarm() noexcept {
  const std::lock_guard lock(mutex_);
  if (--asleep_ != 0) return;
  disarm_places();
}

void WaitSet::disarm_places() noexcept {
  for (const auto& [session, place] : places_) {
    if (std::exchange(place->is_armed, false)) place->core.disarm();
  }
}

}  // namespace agnocast
