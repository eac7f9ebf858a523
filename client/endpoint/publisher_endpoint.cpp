// SPDX-License-Identifier: Apache-2.0

#include <base/clock.hpp>
#include <client/endpoint/publisher_endpoint.hpp>
#include <client/endpoint/twice_owned.hpp>
#include <client/process/forked_child.hpp>
#include <client/process/steps.hpp>
#include <client/process/user_code.hpp>

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

/// What one turn with the queue leaves to do outside the mutex.
struct PublisherEndpoint::Work {
  Work(PublisherEndpoint& of, bool destroys) noexcept : endpoint(of), may_destroy(destroys) {}

  PublisherEndpoint& endpoint;
  const bool may_destroy;                          // otherwise messages die with the process
  std::array<void*, destroy_at_once_max> destroy;  // the first destroy_count
  std::size_t destroy_count = 0;
  std::uint64_t rung = 0;
  bool wake_control = false;
  bool destroys_later = false;

  /// Into the line that the commit goes into next: stored behind that, it would take the line a second
  /// time from those who look at it. Only written under the mutex. A death between the two leaves it one
  /// message ahead, which is nothing to those it is for: people.
  void commits(const dataplane::Entry& entry) noexcept {
    auto& total =
        endpoint.identity_.core.words.counter(offsetof(abi::PublisherEndpoint, published_bytes));
    total.store(total.load(std::memory_order_relaxed) + entry.bytes, std::memory_order_relaxed);
  }
  void ring(std::uint64_t executor, std::uint64_t armed) noexcept {
    Executor& sleeper = endpoint.executors_[executor];
    if (!sleeper.bell.doorbell) return;
    if (rung++ < ring_at_once_max) {
      sleeper.bell.doorbell.ring();
    } else {
      sleeper.owed = armed;
      wake_control = true;
    }
  }
  /// The control thread does, as it is woken anyway; but it destroys nothing any more once exit has begun.
  bool passes_soon() const noexcept { return wake_control && !exit_has_begun(); }
  void freed(std::uint64_t, std::uint64_t address) noexcept {
    if (!may_destroy) return;
    void* const message = reinterpret_cast<void*>(address);
    if (!destroys_later && destroy_count < destroy.size()) {
      destroy[destroy_count++] = message;
    } else if (endpoint.doomed_.size() == endpoint.doomed_.capacity()) {
      // The control thread is far behind: rather here, under the mutex, than allocate.
      const UserSignals as_creator(endpoint.identity_.signals);
      endpoint.destroy(message);
    } else {
      endpoint.doomed_.push_back(message);  // within its capacity: no allocation
      endpoint.has_doomed_.store(true, std::memory_order_relaxed);
    }
  }
  /// What an earlier turn had no room for.
  void destroy_doomed() noexcept {
    if (!may_destroy) return;
    auto& doomed = endpoint.doomed_;
    for (; !doomed.empty() && destroy_count < destroy.size(); doomed.pop_back())
      destroy[destroy_count++] = doomed.back();
    if (doomed.empty() && !endpoint.lacked_room_.load(std::memory_order_relaxed))
      endpoint.has_doomed_.store(false, std::memory_order_relaxed);
  }
};

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

template <class Do>
inline void PublisherEndpoint::turn(Do work, Work& left) noexcept {
  {
    const std::lock_guard lock(mutex_);
    work(left);
  }
  if (left.wake_control) identity_.wake_control();  // first: sleepers do not wait for destructors
}

inline void PublisherEndpoint::destroy_all(const Work& left) noexcept {
  for (std::size_t i = 0; i < left.destroy_count; ++i) {
    AGNOCAST_CRASH_POINT(C_destroy);
    destroy(left.destroy[i]);
  }
}

template <class Do>
void PublisherEndpoint::with_queue(Do work) noexcept {
  Work left(*this, true);
  turn(work, left);
  destroy_all(left);
}

template <class Do>
void PublisherEndpoint::in_control_thread(Do work) noexcept {
  const UserCode code;
  Work left(*this, code.may_run());
  turn(work, left);
  if (left.destroy_count == 0) return;
  const UserSignals as_creator(identity_.signals);
  destroy_all(left);
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

void PublisherEndpoint::list_foreign_readers(std::vector<Reader>& readers) const {
  readers.clear();
  readers.reserve(SharedMemory::subscription_capacity);  // not below the mutex
  const std::lock_guard lock(mutex_);
  for (const Attached& attached : attached_) {
    if (!attached.owner.is_own)
      readers.push_back({{attached.index, attached.generation}, attached.owner.uid});
  }
}

std::uint64_t PublisherEndpoint::kept_bytes(
    std::span<const Core::MemberId> readers) const noexcept {
  const std::lock_guard lock(mutex_);
  return core_ != nullptr ? core_->kept_bytes(readers) : 0;
}

void PublisherEndpoint::withdraw(const Core::MemberId& reader) noexcept {
  in_control_thread([&](Work& work) {
    if (core_ == nullptr) return;
    if (core_->withdraw(reader.index, reader.generation, abi::Withdrawal::over_share))
      core_->pass(work);
  });
}

void PublisherEndpoint::note_unmapped(const Member& member, PeerOwner owner, bool is_out,
                                      ReaderShares::Clock::time_point now) {
  if (is_attached(member.index, member.generation)) return;
  Watched& watched = watched_[member.index];
  if (watched.generation != member.generation) watched = {member.generation, now};
  watched.owner = owner;
  in_control_thread([&](Work& work) {
    if (core_ == nullptr || moved_) return;
    core_->pass(work);  // from here on it counts
    if (is_out && core_->withdraw(member.index, member.generation, abi::Withdrawal::not_attached))
      core_->pass(work);
  });
}

void PublisherEndpoint::look_at_readers(ReaderShares::Clock::time_point now,
                                        const ReaderShares& shares, UnmappedUsers& unmapped_users,
                                        std::vector<Withdrawn>& news) {
  const auto may_be_served_again = [&](abi::Withdrawal why, PeerOwner owner) {
    return why == abi::Withdrawal::not_attached ||
           (why == abi::Withdrawal::over_share && !shares.is_out(owner, now));
  };
  std::map<std::uint64_t, Watched> watched;
  // What was seen at an earlier look goes on from there.
  const auto watch = [&](std::uint64_t index, std::uint64_t generation) -> Watched& {
    const auto before = watched_.find(index);
    const bool is_known = before != watched_.end() && before->second.generation == generation;
    return watched.emplace(index, is_known ? before->second : Watched{generation, now})
        .first->second;
  };
  struct Mapped {
    Member id;
    PeerOwner owner;
  };
  std::vector<Member> unmapped;
  std::vector<Mapped> attached;
  unmapped.reserve(SharedMemory::subscription_capacity);  // not below the mutex
  attached.reserve(SharedMemory::subscription_capacity);
  {
    const std::lock_guard lock(mutex_);
    if (core_ == nullptr || moved_) return;
    core_->for_each_unmapped([&](std::uint64_t index, std::uint64_t generation) {
      unmapped.push_back({index, generation});
    });
    for (const Attached& one : attached_) {
      const abi::Withdrawal why = core_->withdrawal(one.index, one.generation);
      const auto known = watched_.find(one.index);
      const bool is_told = known != watched_.end() && known->second.generation == one.generation &&
                           known->second.why == abi::Withdrawal::over_quota;
      if (why != abi::Withdrawal::none && !is_told)
        attached.push_back({{one.index, one.generation}, one.owner});
    }
  }
  const std::size_t unmapped_count = unmapped.size();
  for (const Mapped& one : attached) {
    unmapped.push_back(one.id);
    watch(one.id.index, one.id.generation).owner = one.owner;
  }
  for (std::size_t i = 0; i < unmapped.size(); ++i) {
    const std::uint64_t index = unmapped[i].index, generation = unmapped[i].generation;
    Watched& member = watch(index, generation);
    const bool is_out = member.owner && unmapped_users.is_out(*member.owner, now);
    bool is_news = false, was_waited_for = false;
    std::uint64_t bytes = 0;
    in_control_thread([&](Work& work) {
      abi::Withdrawal why = core_->withdrawal(index, generation);
      if (why == abi::Withdrawal::none) {
        if (i >= unmapped_count) return;
        if (!is_out && now - member.since < ReaderShares::patience_to_attach) return;
        if (!core_->withdraw(index, generation, abi::Withdrawal::not_attached)) return;  // it ended
        why = abi::Withdrawal::not_attached;
        was_waited_for = !is_out;
      } else if (i >= unmapped_count && may_be_served_again(why, *member.owner) &&
                 core_->serve_again(index, generation, work)) {
        why = abi::Withdrawal::none;
      } else if (!core_->is_disregarded(index) && now - member.since >= ReaderShares::patience) {
        core_->disregard(index, generation);
      }
      core_->pass(work);
      if (why == member.why) return;
      is_news = true;
      bytes = core_->kept_bytes(std::array{Core::MemberId{index, generation}});
      member.why = why;
      member.since = now;
    });
    if (was_waited_for && member.owner) unmapped_users.ban(*member.owner, now);
    if (i < unmapped_count && member.why == abi::Withdrawal::none && member.owner)
      unmapped_users.note(*member.owner);
    if (is_news) news.push_back({index, generation, member.why, bytes});
  }
  // For good, and nothing is left to look at.
  for (const auto& [index, before] : watched_) {
    if (before.why == abi::Withdrawal::over_quota) watched.emplace(index, before);
  }
  watched_.swap(watched);
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
