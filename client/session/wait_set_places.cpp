// SPDX-License-Identifier: Apache-2.0

#include <client/process/forked_child.hpp>
#include <client/session/wait_set_places.hpp>

#include <agnocast/abi/limits.hpp>

#include <utility>

namespace agnocast {

std::shared_ptr<WaitSet::Place> WaitSetPlaces::lend(std::unique_ptr<WaitSet::Place> place) {
  return {place.release(), [this](WaitSet::Place* returned) noexcept {
            if (is_forked_child()) return;
            const std::lock_guard lock(mutex_);
            unused_.emplace_back(returned);  // within its capacity
            --lent_;
          }};
}

Result<WaitSetPlaces::Next> WaitSetPlaces::next() {
  const std::lock_guard lock(mutex_);
  unused_.reserve(abi::wait_set_count_max);
  failed_.reserve(abi::wait_set_count_max);
  Next next;
  if (!unused_.empty()) {
    next.place = std::move(unused_.back());
    unused_.pop_back();
    ++lent_;
  } else if (!failed_.empty()) {
    next.wait_set = failed_.back();
    failed_.pop_back();
    next.again = true;
  } else if (next_number_ == abi::wait_set_count_max) {
    static_assert(abi::wait_set_count_max == 56);
    return fail(
        Errc::limit_reached,
        "all 56 wait sets of this process are in use, or have messages that are still held");
  } else {
    next.wait_set = next_number_++;
  }
  return next;
}

Result<void> WaitSetPlaces::give(WaitSet& wait_set, WaitSet::Session session, const Permit& permit,
                                 const Open& open) {
  const std::lock_guard giving(giving_);
  if (wait_set.index_in(session)) return {};
  if (Result<void> permitted = permit(); !permitted) return permitted;
  Result<Next> found = next();
  if (!found) return tl::unexpected<Failure>(found.error());
  if (found->place != nullptr) return wait_set.add(session, lend(std::move(found->place)));
  Result<std::unique_ptr<WaitSet::Place>> opened = open(found->wait_set, found->again);
  {
    const std::lock_guard lock(mutex_);
    if (opened) {
      ++lent_;
    } else {
      // If the doorbells come late, they are closed. The next user of this number asks for new
      // ones.
      failed_.push_back(found->wait_set);  // within its capacity
    }
  }
  if (!opened) return tl::unexpected<Failure>(opened.error());
  return wait_set.add(session, lend(std::move(*opened)));
}

void WaitSetPlaces::renew(std::uint64_t wait_set, DoorbellReceiver& doorbells) noexcept {
  const std::lock_guard lock(mutex_);
  for (const auto& place : unused_) {
    if (place->index == wait_set) return std::swap(place->doorbells, doorbells);
  }
}

bool WaitSetPlaces::end() noexcept {
  const std::lock_guard lock(mutex_);
  if (lent_ != 0) return false;
  unused_.clear();
  return true;
}

}  // namespace agnocast
