// SPDX-License-Identifier: Apache-2.0

#include <base/clock.hpp>
#include <client/endpoint/publisher_work.hpp>
#include <client/endpoint/twice_owned.hpp>
#include <client/process/forked_child.hpp>

#include <algorithm>
#include <utility>

namespace agnocast {
namespace {

template <class Entry>
void reserve_one_more(std::vector<Entry>& entries) {
  if (entries.size() == entries.capacity()) entries.reserve(2 * entries.size() + 1);
}

constexpr std::uint64_t armed_offset(std::uint64_t executor) noexcept {
  return offsetof(abi::ClientRegionHeader, executor) + executor * sizeof(abi::ExecutorLine);
}

}  // namespace

PublisherEndpoint::PublisherEndpoint(const Identity& identity)
    : identity_(identity),
      core_(std::make_unique<Core>(identity.core)),
      events_(identity.events != nullptr ? identity.events : std::make_shared<EndpointEvents>()) {
  doomed_.reserve(abi::slot_count_max);
  // Ahead of everything: who sees a message or a link of it sees this.
  if (!identity_.says_lineage_later)
    identity_.core.words.lineage().store(identity_.lineage, std::memory_order_relaxed);
}

void PublisherEndpoint::say_lineage() noexcept {
  const std::lock_guard lock(mutex_);
  if (!moved_) identity_.core.words.lineage().store(identity_.lineage, std::memory_order_relaxed);
}

dataplane::PublishOutcome PublisherEndpoint::publish(void* message, std::uint64_t object_bytes,
                                                     std::uint64_t message_bytes) noexcept {
  dataplane::PublishOutcome outcome = dataplane::PublishOutcome::no_slot;
  std::shared_ptr<PublisherEndpoint> heir;
  with_queue([&](Work& work) {
    if (moved_) [[unlikely]] {
      heir = heir_;
      return;
    }
    // What no borrow has destroyed since. Many at once, when a reader that lagged has caught up: the rest
    // waits for the next borrows and publishes, or for the control thread's timer. Waking it would be a
    // system call.
    work.destroy_doomed();
    work.destroys_later = message_bytes <= Core::kept_back_max;
    // The stamp is taken under the mutex, so that it grows with the sequence.
    outcome = core_->publish(
        {reinterpret_cast<std::uint64_t>(message), object_bytes, monotonic_ns(), message_bytes},
        work);
  });
  if (heir != nullptr) [[unlikely]]
    return heir->publish(message, object_bytes, message_bytes);
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
  // What others add to it meanwhile is theirs to destroy.
  constexpr std::size_t turns_max = abi::slot_count_max / destroy_at_once_max + 1;
  bool is_done = false;
  for (std::size_t turn = 0; turn < turns_max && !is_done; ++turn) {
    with_queue([&](Work& work) {
      if (turn == 0 && core_ != nullptr) {
        core_->pass(work);
        core_->pass(work);
      }
      work.destroy_doomed();
      some = some || work.destroy_count != 0;
      is_done = doomed_.empty();
    });
  }
  return some;
}

void PublisherEndpoint::count(std::size_t counter, std::uint64_t more) noexcept {
  std::shared_ptr<PublisherEndpoint> heir;
  {
    const std::lock_guard lock(mutex_);
    if (!moved_) identity_.core.words.counter(counter).fetch_add(more, std::memory_order_relaxed);
    heir = heir_;
  }
  if (heir != nullptr) heir->count(counter, more);
}
void PublisherEndpoint::count_adopted(std::uint64_t bytes) noexcept {
  count(offsetof(abi::PublisherEndpoint, adopted_messages), 1);
  count(offsetof(abi::PublisherEndpoint, adopted_bytes), bytes);
}
void PublisherEndpoint::count_heap_exhausted() noexcept {
  count(offsetof(abi::PublisherEndpoint, refused_heap_exhausted), 1);
}

std::size_t PublisherEndpoint::executor_of(const Peer& peer, std::uint64_t executor, Bell bell) {
  std::size_t free_place = executors_.size();
  for (std::size_t i = 0; i < executors_.size(); ++i) {
    Executor& known = executors_[i];
    if (known.users == 0) {
      free_place = std::min(free_place, i);
    } else if (known.client == peer.client() && known.client_generation == peer.generation() &&
               known.executor == executor) {
      ++known.users;
      if (bell.doorbell) std::swap(known.bell, bell);
      return i;
    }
  }
  if (free_place == executors_.size()) executors_.emplace_back();
  executors_[free_place] = {peer.client(), peer.generation(), executor, 1, std::move(bell), 0,
                            peer.region()};
  return free_place;
}

bool PublisherEndpoint::attach(const Subscription& subscription, std::shared_ptr<Peer> peer,
                               Bell bell) {
  if (is_attached(subscription.index, subscription.generation)) {
    replace_bell(subscription, std::move(bell));
    return false;
  }
  {
    const std::lock_guard lock(mutex_);
    reserve_one_more(attached_);
    reserve_one_more(executors_);
  }
  in_control_thread([&](Work& work) {
    AGNOCAST_CRASH_POINT(C_attach);
    const std::size_t executor = executor_of(*peer, subscription.executor, std::move(bell));
    core_->attach(subscription.index, subscription.generation, peer->region(), subscription.extent,
                  armed_offset(subscription.executor), executor, work);
    core_->limit_holds(subscription.index, subscription.quota);
    attached_.push_back({subscription.index, subscription.generation, subscription.extent, executor,
                         std::move(peer), subscription.owner});
    core_->pass(work);
  });
  note_links();
  return true;
}

// The one that was here may be mute, or lead to a receiver that is no more.
void PublisherEndpoint::replace_bell(const Subscription& subscription, Bell bell) noexcept {
  if (!bell.doorbell) return;
  const std::lock_guard lock(mutex_);
  for (const Attached& attached : attached_) {
    if (attached.index != subscription.index || attached.generation != subscription.generation)
      continue;
    std::swap(executors_[attached.executor].bell, bell);
    // What was published since it fell asleep has rung the former one.
    executors_[attached.executor].bell.doorbell.ring();
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

// A match is reported when the subscription has linked: before, it may still miss what is published.
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
  std::shared_ptr<Peer> let_go;
  Match match = Match::ended;
  in_control_thread([&](Work& work) {
    const auto found =
        std::find_if(attached_.begin(), attached_.end(), [&](const Attached& attached) {
          return attached.index == index && attached.generation == generation;
        });
    if (found == attached_.end()) return;
    core_->pass(work);  // learns that it is over while its line can still be read
    AGNOCAST_CRASH_POINT(C_detach);
    core_->detach(index, generation);
    if (--executors_[found->executor].users == 0) executors_[found->executor] = {};
    let_go = std::move(found->peer);
    match = found->match;
    if (moved_ && match == Match::awaited) match = Match::ended;
    attached_.erase(found);
  });
  if (match == Match::ended) return;
  if (match == Match::awaited) events_->gained();  // it came and went between two looks
  events_->ceased();
}

// What is attached stays: its readers are waited for as before, as far as the board tells of them.
void PublisherEndpoint::revoke() noexcept {
  std::ptrdiff_t matched = 0;
  {
    const std::lock_guard lock(mutex_);
    for (Attached& attached : attached_)
      matched += std::exchange(attached.match, Match::ended) == Match::counted;
  }
  for (; matched > 0; --matched) events_->ceased();
}

std::vector<PublisherEndpoint::Member> PublisherEndpoint::detach_all() {
  std::vector<Attached> let_go;
  std::vector<Member> members;
  const std::lock_guard lock(mutex_);
  members.reserve(attached_.size());
  for (const Attached& attached : attached_) {
    core_->detach(attached.index, attached.generation);
    members.push_back({attached.index, attached.generation});
  }
  let_go.swap(attached_);
  executors_.clear();
  return members;
}

void PublisherEndpoint::run_errands() noexcept {
  note_links();
  in_control_thread([&](Work& work) {
    for (Executor& sleeper : executors_) {
      const std::uint64_t owed = std::exchange(sleeper.owed, 0);
      if (owed == 0 || sleeper.users == 0) continue;
      AGNOCAST_CRASH_POINT(C_errand_ring);
      // Another generation: it was awake meanwhile and has looked for itself.
      if (SharedMemory::word(sleeper.region, armed_offset(sleeper.executor))
              .load(std::memory_order_relaxed) == owed)
        sleeper.bell.doorbell.ring();
    }
    core_->pass(work);
    work.destroy_doomed();
    // More next time: destructors may be slow, others wait.
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
         (heir_ != nullptr ? heir_->allocated_count() : 0);
}
std::size_t PublisherEndpoint::subscription_count() const noexcept {
  if (!is_served()) return 0;
  std::shared_ptr<PublisherEndpoint> heir;
  {
    const std::lock_guard lock(mutex_);
    if (!moved_) return linked_count();
    heir = heir_;
  }
  return heir != nullptr ? heir->subscription_count() : 0;
}
std::vector<std::uint64_t> PublisherEndpoint::reader_lineages() const {
  if (!is_served()) return {};
  std::shared_ptr<PublisherEndpoint> heir;
  {
    const std::lock_guard lock(mutex_);
    heir = heir_;
    if (moved_ && heir == nullptr) return {};
  }
  return heir != nullptr ? heir->reader_lineages() : linked_lineages(false);
}
std::size_t PublisherEndpoint::linked_count() const noexcept {
  return static_cast<std::size_t>(
      std::count_if(attached_.begin(), attached_.end(),
                    [this](const Attached& attached) { return is_linked(attached); }));
}
bool PublisherEndpoint::awaits_link() const noexcept {
  const std::lock_guard lock(mutex_);
  return std::any_of(attached_.begin(), attached_.end(),
                     [](const Attached& attached) { return attached.match == Match::awaited; });
}

void PublisherEndpoint::destroy(void* message) noexcept {
  if (!TwiceOwned::instance().let_go(message)) identity_.end_message(message);
}

// --- after the daemon's store was lost

bool PublisherEndpoint::move_to(const std::shared_ptr<PublisherEndpoint>& heir) noexcept {
  bool moves = false;
  in_control_thread([&](Work& work) {
    if (moved_) return;
    moves = true;
    const auto& words = identity_.core.words;
    // Behind the last commit, ahead of the first one of the heir: who sees it sees the whole queue, and
    // who sees anything of the heir sees it.
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
      heir->inherit({words.slot_address(slot).load(std::memory_order_relaxed),
                     words.slot_size(slot).load(std::memory_order_relaxed),
                     words.slot_stamp(slot).load(std::memory_order_relaxed)});
    }
    AGNOCAST_CRASH_POINT(C_move);
    moved_ = true;
    heir_ = heir;
    AGNOCAST_CRASH_POINT(C_move);
    core_->keep_no_history();
    AGNOCAST_CRASH_POINT(C_moved);
    core_->pass(work);
  });
  if (moves) {
    revoke();  // its subscriptions are the heir's now
    events_->moved();
  }
  return moves;
}

void PublisherEndpoint::inherit(const dataplane::Entry& entry) noexcept {
  void* const message = reinterpret_cast<void*>(entry.address);
  try {
    TwiceOwned::instance().share(message);
  } catch (const std::bad_alloc&) {
    return;  // late joiners miss it
  }
  dataplane::PublishOutcome outcome = dataplane::PublishOutcome::no_slot;
  AGNOCAST_CRASH_POINT(C_inherit);
  with_queue([&](Work& work) {
    work.destroys_later = true;  // the caller has the former one's mutex
    const std::uint64_t before = core_->head_sequence();
    auto&& inherited = identity_.core.words.inherited();
    // [sync:publish] relaxed, ahead of the commit; pairs with the look at it behind T1.
    inherited.store(before + 1, std::memory_order_relaxed);
    outcome = core_->publish(entry, work, true);
    if (outcome == dataplane::PublishOutcome::published) return;
    inherited.store(before, std::memory_order_relaxed);
  });
  if (outcome != dataplane::PublishOutcome::published) TwiceOwned::instance().let_go(message);
}

void PublisherEndpoint::redirect_to(const std::shared_ptr<PublisherEndpoint>& heir) noexcept {
  const std::lock_guard lock(mutex_);
  AGNOCAST_CRASH_POINT(C_redirect);
  if (moved_ && heir.get() != this) heir_ = heir;
}

std::shared_ptr<PublisherEndpoint> PublisherEndpoint::present(
    const std::shared_ptr<PublisherEndpoint>& self) const {
  std::shared_ptr<PublisherEndpoint> heir;
  {
    const std::lock_guard lock(mutex_);
    heir = heir_;
  }
  return heir != nullptr ? heir->present(heir) : self;
}

void PublisherEndpoint::abandon() noexcept {
  const std::lock_guard lock(mutex_);
  if (!moved_) identity_.core.words.intent_op().store(abi::intent_moved, std::memory_order_release);
  moved_ = true;
}

std::vector<std::uint64_t> PublisherEndpoint::linked_lineages(bool living) const {
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
    all.push_back(
        region::SubscriptionWords<SharedMemory>{attached.peer->region(), attached.extent}
            .lineage()
            .load(std::memory_order_relaxed));
  }
  std::sort(all.begin(), all.end());
  return all;
}

bool PublisherEndpoint::is_succeeded_by(const PublisherEndpoint& heir) const {
  const std::vector<std::uint64_t> here = linked_lineages(true),
                                   there = heir.linked_lineages(false);
  return std::includes(there.begin(), there.end(), here.begin(), here.end());
}

void PublisherEndpoint::bury_dead() {
  std::vector<Member> dead;
  {
    const std::lock_guard lock(mutex_);
    for (const Attached& attached : attached_) {
      if (!attached.peer->is_alive()) dead.push_back({attached.index, attached.generation});
    }
  }
  for (const Member& member : dead) {
    {
      const std::lock_guard lock(mutex_);
      core_->bury(member.index, member.generation);
    }
    detach(member.index, member.generation);
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
  std::vector<Attached> let_go;  // after the lock
  const std::lock_guard lock(mutex_);
  let_go.swap(attached_);
  executors_.clear();
  moved_ = true;
  core_.reset();
}

}  // namespace agnocast
