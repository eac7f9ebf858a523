// SPDX-License-Identifier: Apache-2.0

#include <client/process/steps.hpp>
#include <client/upkeep/departures.hpp>

#include <algorithm>
#include <cstddef>

namespace agnocast {

namespace wire = abi::wire;
using wire::Opcode;

namespace {

/// Returns whether the board says that every other process has released this publisher.
bool is_freed(SparseRegion& board, const Departures::Key& key, std::uint64_t generation) {
  if (key.first >= abi::topic_count_max || key.second >= abi::publisher_count_max) return false;
  const std::uint64_t topic = abi::topic_offset(key.first);
  if (!board.open(topic, abi::topic_bytes)) return false;
  const std::uint64_t word = region::TopicWords<SharedMemory>{board.base(), topic}
                                 .publisher(key.second, offsetof(abi::PublisherEntry, word))
                                 .load(std::memory_order_acquire);
  return abi::generation_of(word) != generation || abi::state_of(word) == abi::BoardState::free;
}

}  // namespace

void Departures::wait_for(const Departure& departure, const Connection& connection,
                          Clock::time_point end) noexcept {
  std::unique_lock lock(mutex_);
  known_.wait_until(lock, std::min(end, Clock::now() + Connection::answer_timeout),
                    [&] { return departure.is_known() || !connection.is_open(); });
}

void Departures::notify() noexcept {
  const std::lock_guard lock(mutex_);
  known_.notify_all();
}

void Departures::say_one(Connection& connection, const std::shared_ptr<const ControlWake>& wake,
                         Departure& departure, const wire::Reference& who,
                         std::shared_ptr<void> keeps) {
  if (!departure.is_due()) return;
  // A refusal also means that there is nothing to leave.
  const auto on_answer = [this, wake, &departure,
                          keeps = std::move(keeps)](const Result<Incoming*>&) {
    AGNOCAST_CRASH_POINT(C_left);
    departure.known();
    (*wake)();
    notify();
  };
  connection.request_later(Opcode::leave, who, on_answer);
  departure.reported();  // only after the call: it may throw for lack of memory
}

void Departures::say(Connection& connection, const std::shared_ptr<const ControlWake>& wake) {
  for (const auto& publisher : endpoints_.publishers()) {
    const auto& identity = publisher->identity();
    say_one(
        connection, wake, publisher->departure(),
        reference(Kind::publisher, publisher->topic_index(), identity.index, identity.generation),
        publisher);
  }
  endpoints_.for_each_subscription([&](const Key& key, const auto& subscription) {
    say_one(
        connection, wake, subscription->departure(),
        reference(Kind::subscription, key.first, key.second, subscription->identity().generation),
        subscription);
  });
}

void Departures::adopt_unclaimed(Kind kind, const Key& key, std::uint64_t generation,
                                 bool has_left) {
  const auto found = unclaimed_.find({kind, key});
  std::shared_ptr<UnclaimedEndpoint> unclaimed =
      found != unclaimed_.end() ? found->second : nullptr;
  if (unclaimed == nullptr || unclaimed->generation != generation) {
    unclaimed = std::make_shared<UnclaimedEndpoint>(generation);
    unclaimed_.insert_or_assign({kind, key}, unclaimed);
  }
  unclaimed->departure.want();
  if (has_left) unclaimed->departure.known();
}

void Departures::end_unclaimed(Connection& connection,
                               const std::shared_ptr<const ControlWake>& wake,
                               SparseRegion& board) {
  if (!connection.is_open()) return;
  for (auto at = unclaimed_.begin(); at != unclaimed_.end();) {
    const auto& [kind, key] = at->first;
    const std::shared_ptr<UnclaimedEndpoint>& unclaimed = at->second;
    const wire::Reference who = reference(kind, key.first, key.second, unclaimed->generation);
    say_one(connection, wake, unclaimed->departure, who, unclaimed);
    if (!unclaimed->departure.is_known() ||
        (kind == Kind::publisher && !is_freed(board, key, unclaimed->generation))) {
      ++at;
      continue;
    }
    connection.post(Opcode::drained, who, true);
    at = unclaimed_.erase(at);
  }
}

}  // namespace agnocast
