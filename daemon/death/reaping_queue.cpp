// SPDX-License-Identifier: Apache-2.0
//
// ReapingQueue: see the header.

#include <daemon/death/reaping_queue.hpp>

#include <base/clock.hpp>

#include <algorithm>
#include <iterator>
#include <utility>

namespace agnocast::daemon {

using journal::DeathReason;

void ReapingQueue::begin(ClientIndex client, DeathReason reason, AfterReaping then,
                         std::uint64_t budget_ns) {
  Reaping reaping(client, reason, registry_, regions_, doorbells_, endpoint_manager_);
  const std::uint64_t now = monotonic_ns();
  const bool done = reaping.go_on(budget_ns > UINT64_MAX - now ? UINT64_MAX : now + budget_ns);
  if (done) return then(reaping.reaped());
  endings_.push_back({std::move(reaping), std::move(then)});
}

void ReapingQueue::go_on() {
  if (endings_.empty()) return;
  // Each end has its time slice: a large one must not delay the notifications of another.
  endings_.splice(endings_.end(), endings_, endings_.begin());
  const auto ending = std::prev(endings_.end());
  if (!ending->reaping.go_on(monotonic_ns() + budget_ns_of_slice)) return;
  const Ending done = std::move(*ending);
  endings_.erase(ending);
  done.then(done.reaping.reaped());
}

bool ReapingQueue::append(ClientIndex client, AfterReaping then) {
  const auto ending = std::find_if(endings_.begin(), endings_.end(), [&](const Ending& one) {
    return one.reaping.client() == client;
  });
  if (ending == endings_.end()) return false;
  ending->then = [before = std::move(ending->then), then = std::move(then)](const Reaped& reaped) {
    before(reaped);
    then(reaped);
  };
  return true;
}

}  // namespace agnocast::daemon
