// SPDX-License-Identifier: Apache-2.0

#include <client/sleeper.hpp>

#include <unistd.h>

#include <algorithm>

namespace agnocast {

Sleeper::~Sleeper() {
  disarm();  // the next user of a place begins awake
  for (const auto& [membership, place] : places_) {
    for (const Set& set : sets_) place->bells.remove_from(set.epoll);
  }
}

Result<void> Sleeper::add(Membership membership, std::shared_ptr<Place> place) {
  const std::lock_guard lock(mutex_);
  places_.reserve(places_.size() + 1);
  for (const Set& set : sets_) {
    Result<void> added = place->bells.add_to(set.epoll, set.eventfd_tag, set.datagram_tag);
    if (added) continue;
    for (const Set& before : sets_) place->bells.remove_from(before.epoll);
    return added;
  }
  places_.emplace_back(membership, std::move(place));
  wake_locked();  // who sleeps has not armed this one
  return {};
}

void Sleeper::remove(Membership membership) noexcept {
  std::shared_ptr<Place> gone;  // its end takes locks
  const std::lock_guard lock(mutex_);
  const auto found = std::find_if(places_.begin(), places_.end(),
                                  [&](const auto& entry) { return entry.first == membership; });
  if (found == places_.end()) return;
  gone = std::move(found->second);
  places_.erase(found);
  for (const Set& set : sets_) gone->bells.remove_from(set.epoll);
  wake_locked();  // a ring that nobody has noticed yet goes with the bell
}

std::optional<std::uint64_t> Sleeper::index_in(Membership membership) const noexcept {
  const std::lock_guard lock(mutex_);
  for (const auto& [where, place] : places_) {
    if (where == membership) return place->index;
  }
  return std::nullopt;
}

Result<void> Sleeper::add_to(int epoll, std::uint64_t eventfd_tag, std::uint64_t datagram_tag) {
  const std::lock_guard lock(mutex_);
  sets_.reserve(sets_.size() + 1);
  for (const auto& [membership, place] : places_) {
    Result<void> added = place->bells.add_to(epoll, eventfd_tag, datagram_tag);
    if (added) continue;
    for (const auto& [other, before] : places_) before->bells.remove_from(epoll);
    return added;
  }
  sets_.push_back({epoll, eventfd_tag, datagram_tag});
  return {};
}

void Sleeper::remove_from(int epoll) noexcept {
  const std::lock_guard lock(mutex_);
  std::erase_if(sets_, [&](const Set& set) { return set.epoll == epoll; });
  for (const auto& [membership, place] : places_) place->bells.remove_from(epoll);
}

void Sleeper::drain() noexcept {
  const std::lock_guard lock(mutex_);
  for (const auto& [membership, place] : places_) place->bells.drain();
}

void Sleeper::wake_locked() const noexcept {
  if (places_.empty()) return;
  const std::uint64_t one = 1;
  [[maybe_unused]] const ssize_t written =
      ::write(places_.front().second->bells.eventfd(), &one, sizeof one);
}

void Sleeper::wake() const noexcept {
  const std::lock_guard lock(mutex_);
  wake_locked();
}

void Sleeper::arm() noexcept {
  const std::lock_guard lock(mutex_);
  for (const auto& [membership, place] : places_) {
    place->core.arm();
    place->is_armed = true;
  }
}

void Sleeper::disarm() noexcept {
  const std::lock_guard lock(mutex_);
  for (const auto& [membership, place] : places_) {
    if (std::exchange(place->is_armed, false)) place->core.disarm();
  }
}

}  // namespace agnocast
