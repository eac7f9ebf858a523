// SPDX-License-Identifier: Apache-2.0

#include <base/clock.hpp>
#include <client/endpoint/publisher_work.hpp>
#include <client/endpoint/twice_owned.hpp>
#include <client/process/forked_child.hpp>
#include <dataplane/board_look.hpp>

#include <algorithm>
#include <utility>

namespace agnocast {
namespace {

template <class Entry>
void reserve_one_more(std::vector<Entry>& entries) {
  if (entries.size() == entries.capacity()) entries.reserve(2 * entries.size() + 1);
}

constexpr std::uint64_t armed_offset(std::uint64_t wait_set) noexcept {
  return offsetof(abi::ClientRegionHeader, wait_set) + wait_set * sizeof(abi::WaitSetLine);
}

}  // namespace

PublisherEndpoint::PublisherEndpoint(const Identity& identity)
    : identity_(identity),
      core_(std::make_unique<Core>(identity.core)),
      events_(identity.events != nullptr ? identity.events : std::make_shared<EndpointEvents>()) {
  doomed_.reserve(abi::slot_count_max);
  const std::uint64_t now_ns = monotonic_ns();
  identity_.core.words.asserted_ns().store(now_ns, std::memory_order_relaxed);
  const abi::Qos& qos = identity_.core.qos;
  if (identity.events == nullptr) events_->begin_deadline(qos.deadline_ns);
  if (qos.manual_liveliness) lease_.begin(qos.lease_ns, now_ns);
  events_->look_at_leases_at(lease_.next_ns());
  // Stored first: a process that sees a message or link of this publisher also sees its id.
  if (!identity_.announces_persistent_id_later)
    identity_.core.words.persistent_id().store(identity_.persistent_id, std::memory_order_relaxed);
}

void PublisherEndpoint::announce_persistent_id() noexcept {
  const std::lock_guard lock(mutex_);
  if (!moved_)
    identity_.core.words.persistent_id().store(identity_.persistent_id, std::memory_order_relaxed);
}

dataplane::PublishOutcome PublisherEndpoint::publish(void* message, std::uint64_t object_bytes,
                                                     std::uint64_t message_bytes) noexcept {
  dataplane::PublishOutcome outcome = dataplane::PublishOutcome::no_slot;
  std::shared_ptr<PublisherEndpoint> successor;
  with_queue([&](Work& work) {
    if (moved_) [[unlikely]] {
      successor = successor_;
      return;
    }
    // Destroy the messages that no borrow has destroyed since. When a reader that lagged has caught
    // up, there are many at once: the rest waits for the next borrows and publishes, or for the
    // control thread's timer. Waking that thread would be a system call.
    work.destroy_doomed();
    work.destroys_later = message_bytes <= Core::kept_back_max;
    // The stamp is taken under the mutex, so that it grows with the sequence.
    outcome = core_->publish(
        {reinterpret_cast<std::uint64_t>(message), object_bytes, monotonic_ns(), message_bytes},
        work);
  });
  if (successor != nullptr) [[unlikely]]
    return successor->publish(message, object_bytes, message_bytes);
  if (outcome == dataplane::PublishOutcome::no_slot)
    count(offsetof(abi::PublisherEndpoint, refused_no_slot), 1);
  if (outcome == dataplane::PublishOutcome::would_block)
    count(offsetof(abi::PublisherEndpoint, refused_would_block), 1);
  return outcome;
}

void PublisherEndpoint::make_room() noexcept {
  if (!has_doomed_.load(std::memory_order_relaxed)) return;
  if (lacked_room_.exchange(false, std::memory_order_relaxed)) identity_.make_room_everywhere();
  with_queue([](Work& work) { work.destroy_doomed(); });
}

void PublisherEndpoint::lacked_room() noexcept {
  lacked_room_.store(true, std::memory_order_relaxed);
  has_doomed_.store(true, std::memory_order_relaxed);
}

bool PublisherEndpoint::has_more_room() noexcept {
  bool some = false;
  // Messages that other threads add meanwhile are theirs to destroy.
  constexpr std::size_t attempts_max = abi::slot_count_max / destroy_at_once_max + 1;
  bool is_done = false;
  for (std::size_t attempt = 0; attempt < attempts_max && !is_done; ++attempt) {
    with_queue([&](Work& work) {
      if (attempt == 0 && core_ != nullptr) {
        core_->scan(work);
        core_->scan(work);
      }
      work.destroy_doomed();
      some = some || work.destroy_count != 0;
      is_done = doomed_.empty();
    });
  }
  return some;
}

std::uint64_t PublisherEndpoint::head_sequence() const noexcept {
  const std::lock_guard lock(mutex_);
  return core_ != nullptr ? core_->head_sequence() : 0;
}

std::uint64_t PublisherEndpoint::newest_stamp() const noexcept {
  std::shared_ptr<PublisherEndpoint> successor;
  std::uint64_t here_ns = 0;
  {
    const std::lock_guard lock(mutex_);
    here_ns = newest_stamp_here();
    successor = successor_;
  }
  return successor != nullptr ? std::max(here_ns, successor->newest_stamp()) : here_ns;
}

/// Under the mutex.
std::uint64_t PublisherEndpoint::newest_stamp_here() const noexcept {
  if (core_ == nullptr || core_->head_sequence() <= identity_.core.first_sequence) return 0;
  const auto& words = identity_.core.words;
  const std::uint64_t head = words.head().load(std::memory_order_relaxed);
  return words.slot_stamp(abi::slot_of(head)).load(std::memory_order_relaxed);
}

bool PublisherEndpoint::assert_liveliness() noexcept {
  if (is_forked_child()) return false;
  std::shared_ptr<PublisherEndpoint> successor;
  {
    const std::lock_guard lock(mutex_);
    if (!moved_) {
      if (core_ == nullptr) return false;
      identity_.core.words.asserted_ns().store(monotonic_ns(), std::memory_order_relaxed);
      return true;
    }
    successor = successor_;
  }
  return successor != nullptr && successor->assert_liveliness();
}

void PublisherEndpoint::look_at_times() noexcept {
  if (is_forked_child()) return;
  if (events_->has_deadline()) events_->look_at_deadline(newest_stamp());
  if (!events_->has_lease()) return;
  std::shared_ptr<PublisherEndpoint> successor;
  {
    const std::lock_guard lock(mutex_);
    successor = successor_;
    if (!moved_ && core_ != nullptr) {
      const std::uint64_t shown_ns = std::max(
          newest_stamp_here(), identity_.core.words.asserted_ns().load(std::memory_order_relaxed));
      if (lease_.look(monotonic_ns(), shown_ns) && !lease_.is_alive()) events_->liveliness_lost();
      events_->look_at_leases_at(lease_.next_ns());
    }
  }
  if (successor != nullptr) successor->look_at_times();
}

bool PublisherEndpoint::is_taken(std::uint64_t sequence) noexcept {
  bool taken = true;
  with_queue([&](Work& work) {
    if (core_ == nullptr) return;
    core_->scan(work);
    taken = core_->is_taken(sequence);
  });
  return taken;
}

void PublisherEndpoint::count(std::size_t counter, std::uint64_t more) noexcept {
  std::shared_ptr<PublisherEndpoint> successor;
  {
    const std::lock_guard lock(mutex_);
    if (!moved_) identity_.core.words.counter(counter).fetch_add(more, std::memory_order_relaxed);
    successor = successor_;
  }
  if (successor != nullptr) successor->count(counter, more);
}
void PublisherEndpoint::count_adopted(std::uint64_t bytes) noexcept {
  count(offsetof(abi::PublisherEndpoint, adopted_messages), 1);
  count(offsetof(abi::PublisherEndpoint, adopted_bytes), bytes);
}
void PublisherEndpoint::count_heap_exhausted() noexcept {
  count(offsetof(abi::PublisherEndpoint, refused_heap_exhausted), 1);
}

std::size_t PublisherEndpoint::number_of(const Peer& peer, std::uint64_t wait_set,
                                         PeerDoorbell doorbell) {
  std::size_t free_place = wait_sets_.size();
  for (std::size_t i = 0; i < wait_sets_.size(); ++i) {
    PeerWaitSet& known = wait_sets_[i];
    if (known.users == 0) {
      free_place = std::min(free_place, i);
    } else if (known.client == peer.client() && known.client_generation == peer.generation() &&
               known.wait_set == wait_set) {
      ++known.users;
      if (doorbell.sender) std::swap(known.doorbell, doorbell);
      return i;
    }
  }
  if (free_place == wait_sets_.size()) wait_sets_.emplace_back();
  wait_sets_[free_place] = {peer.client(), peer.generation(), wait_set, 1, std::move(doorbell), 0,
                            peer.region()};
  return free_place;
}

bool PublisherEndpoint::attach(const Subscription& subscription, std::shared_ptr<Peer> peer,
                               PeerDoorbell doorbell) {
  if (is_attached(subscription.index, subscription.generation)) {
    replace_doorbell(subscription, std::move(doorbell));
    return false;
  }
  {
    const std::lock_guard lock(mutex_);
    reserve_one_more(attached_);
    reserve_one_more(wait_sets_);
  }
  in_control_thread([&](Work& work) {
    AGNOCAST_CRASH_POINT(C_attach);
    const std::size_t wait_set = number_of(*peer, subscription.wait_set, std::move(doorbell));
    core_->attach(subscription.index, subscription.generation, peer->region(), subscription.extent,
                  armed_offset(subscription.wait_set), wait_set, work);
    core_->limit_holds(subscription.index, subscription.quota);
    attached_.push_back({subscription.index, subscription.generation, subscription.extent, wait_set,
                         std::move(peer), subscription.owner});
    core_->scan(work);
  });
  note_links();
  return true;
}

// The previous doorbell may be mute, or its receiver may be gone.
void PublisherEndpoint::replace_doorbell(const Subscription& subscription,
                                         PeerDoorbell doorbell) noexcept {
  if (!doorbell.sender) return;
  const std::lock_guard lock(mutex_);
  for (const Attached& attached : attached_) {
    if (attached.index != subscription.index || attached.generation != subscription.generation)
      continue;
    std::swap(wait_sets_[attached.wait_set].doorbell, doorbell);
    // A publish since the subscription fell asleep has rung the previous doorbell.
    wait_sets_[attached.wait_set].doorbell.sender.ring();
    return;
  }
}

bool PublisherEndpoint::is_attached(std::uint64_t index, std::uint64_t generation) const noexcept {
  const std::lock_guard lock(mutex_);
  return std::any_of(attached_.begin(), attached_.end(), [&](const Attached& attached) {
    return attached.index == index && attached.generation == generation;
  });
}

bool PublisherEndpoint::is_linked(const Attached& attached) const noexcept {
  // [sync:link] acquire; pairs with the seq_cst store at J6.
  return region::LinkWords<SharedMemory>{attached.peer->region(), attached.extent,
                                         identity_.core.index}
             .publisher_generation()
             .load(std::memory_order_acquire) == identity_.core.generation;
}

// Reports a match when the subscription has linked: then each process has mapped the other.
void PublisherEndpoint::note_links() noexcept {
  if (!is_served()) return;
  std::size_t linked = 0;
  {
    const std::lock_guard lock(mutex_);
    if (moved_) return;
    for (Attached& attached : attached_) {
      if (attached.match != Match::awaited || !is_linked(attached)) continue;
      attached.match = Match::counted;
      ++linked;
    }
  }
  for (; linked > 0; --linked) events_->gained();
}

void PublisherEndpoint::detach(std::uint64_t index, std::uint64_t generation) noexcept {
  std::shared_ptr<Peer> ended_uses;
  Match match = Match::ended;
  in_control_thread([&](Work& work) {
    const auto found =
        std::find_if(attached_.begin(), attached_.end(), [&](const Attached& attached) {
          return attached.index == index && attached.generation == generation;
        });
    if (found == attached_.end()) return;
    core_->scan(work);  // sees that the endpoint is over while its line can still be read
    AGNOCAST_CRASH_POINT(C_detach);
    core_->detach(index, generation);
    if (--wait_sets_[found->wait_set].users == 0) wait_sets_[found->wait_set] = {};
    ended_uses = std::move(found->peer);
    match = found->match;
    if (moved_ && match == Match::awaited) match = Match::ended;
    attached_.erase(found);
  });
  if (match == Match::ended) return;
  if (match == Match::awaited) events_->gained();  // it came and went between two looks
  events_->ceased();
}

// Attachments stay: the publisher waits for its readers as before, as far as the board shows them.
void PublisherEndpoint::revoke() noexcept {
  std::ptrdiff_t matched = 0;
  {
    const std::lock_guard lock(mutex_);
    for (Attached& attached : attached_)
      matched += std::exchange(attached.match, Match::ended) == Match::counted;
  }
  for (; matched > 0; --matched) events_->ceased();
}

std::vector<PublisherEndpoint::EndpointId> PublisherEndpoint::detach_all() {
  std::vector<Attached> ended_uses;
  std::vector<EndpointId> endpoints;
  const std::lock_guard lock(mutex_);
  endpoints.reserve(attached_.size());
  for (const Attached& attached : attached_) {
    core_->detach(attached.index, attached.generation);
    endpoints.push_back({attached.index, attached.generation});
  }
  ended_uses.swap(attached_);
  wait_sets_.clear();
  return endpoints;
}

void PublisherEndpoint::run_upkeep() noexcept {
  note_links();
  in_control_thread([&](Work& work) {
    for (PeerWaitSet& wait_set : wait_sets_) {
      if (!std::exchange(wait_set.is_owed_ring, false) || wait_set.users == 0) continue;
      AGNOCAST_CRASH_POINT(C_errand_ring);
      // Awake: it has looked by itself, or will. Another value does not say that: one of several
      // threads that sleep there may have armed it anew.
      const std::uint64_t armed =
          SharedMemory::word(wait_set.region, armed_offset(wait_set.wait_set))
              .load(std::memory_order_relaxed);
      if (armed % 2 == 0) continue;
      wait_set.doorbell.sender.ring();
    }
    core_->scan(work);
    work.destroy_doomed();
    // The rest comes next time: destructors may be slow, and other work waits.
    work.wake_control = work.may_destroy && !doomed_.empty();
  });
}

bool PublisherEndpoint::has_reclaimable() const noexcept {
  const std::lock_guard lock(mutex_);
  return core_->has_reclaimable() || !doomed_.empty();
}
bool PublisherEndpoint::is_over() const noexcept {
  const std::lock_guard lock(mutex_);
  return core_->is_over() && core_->allocated_count() == 0 && doomed_.empty();
}
std::uint64_t PublisherEndpoint::allocated_count() const noexcept {
  const std::lock_guard lock(mutex_);
  return (core_ != nullptr ? core_->allocated_count() : 0) +
         (successor_ != nullptr ? successor_->allocated_count() : 0);
}
std::size_t PublisherEndpoint::subscription_count(Readers readers) const noexcept {
  if (!is_served()) return 0;
  std::shared_ptr<PublisherEndpoint> successor;
  {
    const std::lock_guard lock(mutex_);
    // Nobody writes the board of a session whose daemon's store is lost.
    if (!moved_)
      return readers == Readers::linked || readers == Readers::local_linked || is_alone_
                 ? linked_count(readers)
                 : matched_count(readers);
    successor = successor_;
  }
  return successor != nullptr ? successor->subscription_count(readers) : 0;
}
std::vector<std::uint64_t> PublisherEndpoint::reader_persistent_ids() const {
  if (!is_served()) return {};
  std::shared_ptr<PublisherEndpoint> successor;
  {
    const std::lock_guard lock(mutex_);
    successor = successor_;
    if (moved_ && successor == nullptr) return {};
  }
  return successor != nullptr ? successor->reader_persistent_ids() : linked_persistent_ids(false);
}
std::size_t PublisherEndpoint::matched_count(Readers readers) const noexcept {
  const Core::Identity& own = identity_.core;
  return dataplane::matching_subscriptions(
      own.topic, {own.qos, own.client},
      [&](std::uint64_t index, const dataplane::BoardEndpoint& reader) {
        return (readers != Readers::local || reader.of.client == own.client) &&
               core_->withdrawal(index, reader.generation) == abi::Withdrawal::none;
      });
}
std::size_t PublisherEndpoint::linked_count(Readers readers) const noexcept {
  const auto counts = [&](const Attached& attached) {
    if (!is_linked(attached)) return false;
    if (readers == Readers::all || readers == Readers::linked) return true;
    const auto reader = dataplane::active_subscription(identity_.core.topic, attached.index);
    return reader && reader->of.client == identity_.core.client &&
           core_->withdrawal(attached.index, attached.generation) == abi::Withdrawal::none;
  };
  return static_cast<std::size_t>(std::count_if(attached_.begin(), attached_.end(), counts));
}
bool PublisherEndpoint::awaits_link() const noexcept {
  const std::lock_guard lock(mutex_);
  return std::any_of(attached_.begin(), attached_.end(),
                     [](const Attached& attached) { return attached.match == Match::awaited; });
}

void PublisherEndpoint::destroy(void* message) noexcept {
  if (!TwiceOwned::instance().release(message)) identity_.end_message(message);
}

// --- after the daemon's store was lost

bool PublisherEndpoint::move_to(const std::shared_ptr<PublisherEndpoint>& successor) noexcept {
  bool moves = false;
  in_control_thread([&](Work& work) {
    if (moved_) return;
    moves = true;
    const auto& words = identity_.core.words;
    // Stored after the last commit here and before the first one of the successor. A reader that
    // sees the mark sees the whole queue, and a reader that sees a message of the successor sees
    // the mark.
    words.intent_op().store(abi::intent_moved, std::memory_order_release);
    AGNOCAST_CRASH_POINT(C_move);
    const std::uint64_t head = core_->head_sequence();
    const std::uint64_t kept = identity_.core.qos.transient_local ? identity_.core.qos.depth : 0;
    const std::uint64_t begin =
        std::max(identity_.core.first_sequence, head - std::min(head, kept)) + 1;
    for (std::uint64_t sequence = begin; sequence <= head; ++sequence) {
      const std::uint64_t slot =
          abi::slot_of(words.order(sequence).load(std::memory_order_relaxed));
      if (slot >= abi::slot_count_max ||
          words.slot_id(slot).load(std::memory_order_relaxed) != sequence)
        continue;
      AGNOCAST_CRASH_POINT(C_inherit);
      successor->inherit({words.slot_address(slot).load(std::memory_order_relaxed),
                          words.slot_size(slot).load(std::memory_order_relaxed),
                          words.slot_stamp(slot).load(std::memory_order_relaxed)});
    }
    AGNOCAST_CRASH_POINT(C_move);
    moved_ = true;
    successor_ = successor;
    AGNOCAST_CRASH_POINT(C_move);
    core_->keep_no_history();
    AGNOCAST_CRASH_POINT(C_moved);
    core_->scan(work);
  });
  if (moves) {
    revoke();  // its subscriptions belong to the successor now
    events_->moved();
  }
  return moves;
}

void PublisherEndpoint::inherit(const dataplane::Entry& entry) noexcept {
  void* const message = reinterpret_cast<void*>(entry.address);
  try {
    TwiceOwned::instance().share(message);
  } catch (const std::bad_alloc&) {
    return;  // late joiners miss this message
  }
  dataplane::PublishOutcome outcome = dataplane::PublishOutcome::no_slot;
  AGNOCAST_CRASH_POINT(C_inherit);
  with_queue([&](Work& work) {
    work.destroys_later = true;  // the caller holds the mutex of the previous endpoint
    const std::uint64_t before = core_->head_sequence();
    auto&& inherited = identity_.core.words.inherited();
    // [sync:publish] relaxed, before the commit; pairs with the load after T1.
    inherited.store(before + 1, std::memory_order_relaxed);
    outcome = core_->publish(entry, work, true);
    if (outcome == dataplane::PublishOutcome::published) return;
    inherited.store(before, std::memory_order_relaxed);
  });
  if (outcome != dataplane::PublishOutcome::published) TwiceOwned::instance().release(message);
}

void PublisherEndpoint::redirect_to(const std::shared_ptr<PublisherEndpoint>& successor) noexcept {
  const std::lock_guard lock(mutex_);
  AGNOCAST_CRASH_POINT(C_redirect);
  if (moved_ && successor.get() != this) successor_ = successor;
}

std::shared_ptr<PublisherEndpoint> PublisherEndpoint::present(
    const std::shared_ptr<PublisherEndpoint>& self) const {
  std::shared_ptr<PublisherEndpoint> successor;
  {
    const std::lock_guard lock(mutex_);
    successor = successor_;
  }
  return successor != nullptr ? successor->present(successor) : self;
}

void PublisherEndpoint::abandon() noexcept {
  const std::lock_guard lock(mutex_);
  if (!moved_) identity_.core.words.intent_op().store(abi::intent_moved, std::memory_order_release);
  moved_ = true;
}

std::vector<std::uint64_t> PublisherEndpoint::linked_persistent_ids(bool living) const {
  std::vector<std::uint64_t> all;
  const std::lock_guard lock(mutex_);
  for (const Attached& attached : attached_) {
    if (!is_linked(attached)) continue;
    if (living) {
      const region::LinkWords<SharedMemory> link{attached.peer->region(), attached.extent,
                                                 identity_.core.index};
      if (link.cursor().load(std::memory_order_relaxed) == abi::cursor_aside ||
          !attached.peer->is_alive())
        continue;
    }
    all.push_back(region::SubscriptionWords<SharedMemory>{attached.peer->region(), attached.extent}
                      .persistent_id()
                      .load(std::memory_order_relaxed));
  }
  std::sort(all.begin(), all.end());
  return all;
}

bool PublisherEndpoint::is_succeeded_by(const PublisherEndpoint& successor) const {
  const std::vector<std::uint64_t> here = linked_persistent_ids(true),
                                   there = successor.linked_persistent_ids(false);
  return std::includes(there.begin(), there.end(), here.begin(), here.end());
}

void PublisherEndpoint::remove_dead_subscriptions() {
  std::vector<EndpointId> dead;
  {
    const std::lock_guard lock(mutex_);
    is_alone_ = true;
    for (const Attached& attached : attached_) {
      if (!attached.peer->is_alive()) dead.push_back({attached.index, attached.generation});
    }
  }
  for (const EndpointId& endpoint : dead) {
    {
      const std::lock_guard lock(mutex_);
      core_->remove_dead_subscription(endpoint.index, endpoint.generation);
    }
    detach(endpoint.index, endpoint.generation);
  }
}

bool PublisherEndpoint::is_finished() noexcept {
  const std::lock_guard lock(mutex_);
  if (!moved_ && departure_.is_wanted()) {
    moved_ = true;
    core_->keep_no_history();
    identity_.core.words.intent_op().store(abi::intent_moved, std::memory_order_release);
  }
  if (!moved_) return false;
  return core_->allocated_count() == 0 && doomed_.empty();
}

void PublisherEndpoint::finish() noexcept {
  std::vector<Attached> ended_uses;  // after the lock
  const std::lock_guard lock(mutex_);
  ended_uses.swap(attached_);
  wait_sets_.clear();
  moved_ = true;
  core_.reset();
}

}  // namespace agnocast
