// SPDX-License-Identifier: Apache-2.0
//
// SubscriptionEndpoint: an untyped subscription, its links to publishers, and what it has taken.
//
// Takes happen in user threads under one private mutex. The control thread adds links
// (announcements), marks them orphaned, and collects those that are over. A held message keeps its
// Link, and with it the mapping it lies in, so it outlives the subscription, its node and the
// publisher's process.
//
//   announced → linked → (publisher gone) orphaned → drained → (nothing held) unlinked → UNLINKED
//   to the daemon
//                      → (subscription closed, and the daemon knows) → (nothing held) unlinked
//
// After a new connection everything is announced once more. A book per publisher index remembers
// what was linked and unlinked last: to link a generation again would deliver its messages twice.
#pragma once

#include <agnocast/ipc_shared_ptr.hpp>
#include <agnocast/result.hpp>
#include <client/endpoint/departure.hpp>
#include <client/endpoint/endpoint_events.hpp>
#include <client/endpoint/peer.hpp>
#include <client/process/forked_child.hpp>
#include <client/process/steps.hpp>
#include <client/process/wait_set.hpp>
#include <dataplane/subscription_core.hpp>
#include <journal/announce_set.hpp>

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <utility>
#include <vector>

namespace agnocast {

/// One subscription towards one publisher. Shared by the subscription and by every message it
/// holds.
class Link {
 public:
  using Core = dataplane::LinkCore<SharedMemory>;
  Link(const Core::Identity& identity, std::shared_ptr<Peer> peer,
       std::shared_ptr<WaitSet> wait_set, std::uint64_t quota, std::function<void()> wake_control)
      : core_(identity),
        identity_(identity),
        peer_(std::move(peer)),
        wait_set_(std::move(wait_set)),
        quota_(quota),
        wake_control_(std::move(wake_control)) {
    if (keeps_history())
      core_.want_history(identity.requested.transient_local
                             ? std::min(identity.offered.depth, identity.requested.depth)
                             : 0);
  }
  Link(const Link&) = delete;
  Link& operator=(const Link&) = delete;
  ~Link();

  std::uint64_t publisher() const noexcept { return identity_.index; }
  std::uint64_t generation() const noexcept { return identity_.generation; }
  std::uint64_t first_sequence() const noexcept { return identity_.first_sequence; }
  /// 0: the publisher has not said it yet.
  std::uint64_t persistent_id() const noexcept {
    return identity_.publisher.persistent_id().load(std::memory_order_relaxed);
  }
  Peer& peer() const noexcept { return *peer_; }
  /// Messages of this publisher that may be held at once.
  std::uint64_t quota() const noexcept { return quota_; }

  /// The last copy of a taken message is gone. Any thread; one locked instruction, no system call.
  /// True when the link is closing and this was its last message: then the control thread has
  /// something to do.
  bool release(std::uint64_t slot) noexcept {
    core_.release(slot);
    const std::uint64_t before = held_.fetch_sub(1, std::memory_order_acq_rel);
    if (before == quota_) wait_set_->wake();  // it may take again: what is unread rings nobody
    return before == 1 && closing_.load(std::memory_order_acquire);
  }
  /// For whoever releases and is told so. Any thread.
  void wake_control() const noexcept {
    if (wake_control_) wake_control_();
  }
  /// A ReceivedBlock that was kept, or null. Under the subscription's mutex: nobody else takes any
  /// out.
  detail::Block* spare() noexcept {
    if (spares_ == nullptr) {
      // The newest stays. Behind it nobody writes but who takes out, which so needs no locked
      // instruction.
      detail::Block* const newest = kept_.load(std::memory_order_acquire);
      if (newest != nullptr) spares_ = std::exchange(newest->next, nullptr);
    }
    if (spares_ == nullptr) return nullptr;
    return std::exchange(spares_, std::exchange(spares_->next, nullptr));
  }
  /// Of a message that was released, for the next one. As many are kept as were held at once, and
  /// one: whoever holds no more than before allocates none. Any thread.
  void keep(detail::Block* block) noexcept {
    block->next = kept_.load(std::memory_order_relaxed);
    while (!kept_.compare_exchange_weak(block->next, block, std::memory_order_release,
                                        std::memory_order_relaxed)) {
    }
  }
  bool keeps_history() const noexcept { return identity_.offered.transient_local; }
  std::uint64_t held_count() const noexcept { return held_.load(std::memory_order_acquire); }

 private:
  friend class SubscriptionEndpoint;
  /// The queues by which one publisher is in several sessions have one persistent endpoint id, and
  /// one heap, which it brings along and nobody else has.
  struct Origin {
    std::uint64_t persistent_id;
    std::uint64_t heap;  // address
    friend bool operator==(const Origin&, const Origin&) = default;
  };
  Origin origin() const noexcept { return {persistent_id(), peer_->heap().first_address()}; }
  /// Its publisher adds nothing here any more, because it does in a newer session.
  bool has_moved() const noexcept {
    // acquire; pairs with the store behind the last commit of PublisherEndpoint::move_to.
    return identity_.publisher.intent_op().load(std::memory_order_acquire) == abi::intent_moved;
  }

  Core core_;
  Core::Identity identity_;
  std::shared_ptr<Peer> peer_;
  std::shared_ptr<WaitSet> wait_set_;
  std::uint64_t quota_;
  std::function<void()> wake_control_;
  std::uint64_t windows_seen_ = 0;  // when take() was tried last
  std::uint64_t lost_noted_ = 0, malformed_noted_ = 0, unreachable_noted_ = 0;
  std::atomic<std::uint64_t> held_{0};
  std::atomic<bool> closing_{false};
  // Of the look by which is being taken.
  std::uint64_t head_ = 0;
  HeapLook windows_{peer_->heap(), Unannounced::awaited, head_};
  std::optional<std::uint64_t> next_stamp_;  // of what would be taken next
  std::atomic<detail::Block*> kept_{nullptr};
  detail::Block* spares_ = nullptr;
  bool ceased_ = false;     // the publisher adds nothing any more
  bool continues_ = false;  // it had a queue of the same publisher before
  // The daemon has said so, and before that it announced each window that the publisher had by
  // then.
  bool is_orphaned_ = false;
};

/// A message in the hands of this process. Whoever drops it calls release() exactly once. All that
/// this needs it has: the link keeps what the message lies in, and wakes the control thread of its
/// own session.
struct Received {
  dataplane::Taken taken;
  std::shared_ptr<Link> link;

  /// The last copy of it is gone. Any thread. No system call unless a closing link ends with it.
  void release() const noexcept {
    if (is_forked_child()) return;  // the hold is the parent's
    if (!link->release(taken.slot)) return;
    AGNOCAST_CRASH_POINT(C_release_last);
    link->wake_control();
  }
};

/// A received message as its users have it.
struct ReceivedBlock : detail::Block {
  Received received;
};

/// Where a take puts what it takes.
class Receiver {
 public:
  /// Called once there is something to take, and before it is. If it turns out to be lost, what was
  /// placed stays without a link. Null: there is no memory, and it stays unread. Under the
  /// subscription's mutex: it must not come back to it.
  virtual Received* place(Link& link) noexcept = 0;
  std::size_t wanted() const noexcept { return wanted_; }
  /// What was placed last is taken.
  void took() noexcept { --wanted_; }

 protected:
  explicit Receiver(std::size_t wanted = 1) noexcept : wanted_(wanted) {}
  ~Receiver() = default;

 private:
  std::size_t wanted_;  // messages
};

class Context;

class SubscriptionEndpoint {
 public:
  struct Identity {
    region::TopicWords<SharedMemory> topic;
    std::uint32_t topic_index;
    std::uint64_t index;
    std::uint64_t generation;
    std::byte* region;     // this process's client region
    std::uint64_t extent;  // in it
    abi::Qos qos;
    std::uint64_t quota;  // messages held at once, per publisher, at most
    bool depth_per_publisher = false;
    std::uint64_t message_bytes = 0;  // sizeof the message object; 0 = any
    std::uint64_t message_alignment = 1;
    std::function<void()> wake_control = {};      // of the session; any thread
    std::shared_ptr<EndpointEvents> events = {};  // of the endpoint that this one continues
    Context* context = nullptr;                   // its session
    std::uint64_t persistent_id = 0;
  };
  struct Publisher {
    std::uint64_t index;
    std::uint64_t generation;
    std::uint64_t extent;
    std::uint64_t first_sequence;
    abi::Qos qos;
    bool from_start;
    std::uint64_t quota;  // messages of it that may be held at once
  };

  SubscriptionEndpoint(const Identity& identity, std::shared_ptr<WaitSet> wait_set);
  SubscriptionEndpoint(const SubscriptionEndpoint&) = delete;
  SubscriptionEndpoint& operator=(const SubscriptionEndpoint&) = delete;

  const Identity& identity() const noexcept { return self_; }
  const WaitSet& wait_set() const noexcept { return *wait_set_; }
  const std::shared_ptr<WaitSet>& shared_wait_set() const noexcept { return wait_set_; }
  Context* context() const noexcept { return self_.context; }

  // --- control thread
  // ------------------------------------------------------------------------------------------------------------

  /// An announced publisher; announced again, it only may have new windows. False when it is not
  /// linked: it was before, this subscription is closed, or it is not on the board.
  [[nodiscard]] bool add_publisher(const Publisher& publisher, std::shared_ptr<Peer> peer);
  /// The daemon says that this publisher is gone: what it committed is still delivered, unless it
  /// is to be given up. Then what is unread is lost.
  void orphan(std::uint64_t publisher, std::uint64_t generation, bool give_up) noexcept;
  /// The session of the process was revoked: nobody is matched any more.
  void revoke() noexcept;
  /// Links that are over and of which nothing is held: unlinked here; the caller tells the daemon.
  std::vector<std::shared_ptr<Link>> collect_unlinked();
  bool is_linked_to(std::uint64_t publisher, std::uint64_t generation) const noexcept;
  /// True when it has left and no link is left.
  bool is_empty() const noexcept;

  // --- user threads
  // --------------------------------------------------------------------------------------------------------------

  /// The oldest unread messages over all publishers (per publisher in order; between publishers by
  /// stamp), as many as `receiver` wants. By one look at the publishers, as a rule: what comes
  /// meanwhile may be left to the next call. Counts what falls out of the subscription's depth as
  /// lost. No system call except after a publisher's heap has grown. True: `receiver` has at least
  /// one.
  bool take(Receiver& receiver) noexcept;
  /// The subscription takes no more.
  void close() noexcept;
  /// Is there anything to take? For the look between arming and sleeping.
  bool has_news() const noexcept;
  std::uint64_t lost() const noexcept;
  std::uint64_t malformed() const noexcept;
  std::uint64_t unreachable() const noexcept;
  /// Publishers that are mapped and not gone.
  std::size_t publisher_count() const noexcept;
  /// Those that are gone and still have something here count as well.
  std::size_t link_count() const noexcept;
  /// `see(persistent_id, is_gone)` for those that are not gone, and those that are and have
  /// something unread.
  void for_each_writer(const std::function<void(std::uint64_t, bool)>& see) const;
  const std::shared_ptr<EndpointEvents>& shared_events() const noexcept { return events_; }
  EndpointEvents& events() noexcept { return *events_; }
  Departure& departure() noexcept { return departure_; }

  // --- after the daemon's store was lost: docs/decisions/0006. The endpoint that the user has
  // stays, and takes from its successors in newer sessions what it does not find here any more.

  /// There is no daemon that could say more of this session.
  void be_alone() noexcept;
  /// Room for one more, so that none is lost that was created. Throws bad_alloc.
  void expect_successor();
  /// One of a newer session. What a publisher has moved there comes after what it left here. False
  /// when this is closed.
  bool add_successor(const std::shared_ptr<SubscriptionEndpoint>& successor);
  /// The endpoint of that session: this one, or a successor; null: there is none.
  std::shared_ptr<SubscriptionEndpoint> in_session(
      const Context* context, const std::shared_ptr<SubscriptionEndpoint>& self) const;
  std::size_t successor_count() const noexcept;
  /// The one of the given number, oldest first; null: there are not so many.
  std::shared_ptr<SubscriptionEndpoint> successor(std::size_t number) const noexcept;
  /// In place of collect_unlinked(), when alone: forgets links whose publishers add nothing any
  /// more, and that are read and released.
  void collect_alone();
  /// It is closed or succeeded, and has no link any more.
  bool is_finished() const noexcept;
  /// Touches nothing of its session any more.
  void finish() noexcept;
  /// Said of a successor, before add_successor().
  void continues(const std::shared_ptr<SubscriptionEndpoint>& first) noexcept { first_ = first; }
  bool is_closed() const noexcept {
    const std::lock_guard lock(mutex_);
    return closed_;
  }
  void be_succeeded() noexcept { is_succeeded_.store(true, std::memory_order_release); }

 private:
  struct Candidate {
    SubscriptionEndpoint* of = nullptr;
    const std::shared_ptr<Link>* link = nullptr;
    std::uint64_t stamp = 0;
  };
  enum class Attempt : std::uint8_t { taken, lost, no_room };
  bool take_here(Receiver& receiver) noexcept;
  // Apart, so that a take that finds nothing saves no registers for them.
  [[gnu::noinline]] bool take_oldest(Receiver& receiver) noexcept;
  template <bool only_next>
  [[gnu::noinline, gnu::flatten]] Attempt take_from(const std::shared_ptr<Link>& link,
                                                    Receiver& receiver, std::size_t most) noexcept;
  void look_at_empty() const noexcept;
  [[gnu::noinline]] bool take_in_order(Receiver& receiver) noexcept;
  bool may_take() const noexcept;
  bool can_take(const Link& link) const noexcept;
  void look_at(Link& link) const noexcept;
  void see_next(Link& link) const noexcept;
  bool has_news_here() const noexcept;
  bool has_news_in_order() const noexcept;
  // Sessions by age: 0 is this one, its successors follow.
  template <class Do>
  auto with_successors_locked(Do work, std::size_t locked = 0) const -> decltype(work());
  SubscriptionEndpoint& in_age(std::size_t age) noexcept {
    return age == 0 ? *this : *successors_[age - 1];
  }
  const SubscriptionEndpoint& in_age(std::size_t age) const noexcept {
    return age == 0 ? *this : *successors_[age - 1];
  }
  Candidate oldest_in_order() noexcept;
  bool is_held_back(const Link& link, std::size_t age) const noexcept;
  void absorb(SubscriptionEndpoint& successor) noexcept;
  bool has_former(const Link& link, std::size_t age) const noexcept;
  bool has_next(const Link& link, std::size_t age) const noexcept;
  bool takes_part() const noexcept;
  using Book = journal::AnnouncementBook<SharedMemory>;
  void drop_beyond_depth() noexcept;
  void note_losses(Link& link) noexcept;
  const std::shared_ptr<Link>* oldest() const noexcept;

  Identity self_;
  std::shared_ptr<WaitSet> wait_set_;
  mutable std::mutex mutex_;
  std::vector<std::shared_ptr<Link>> links_;
  std::vector<Book> books_;        // by publisher index, as far as any was announced
  std::uint64_t lost_before_ = 0;  // of links that are over
  std::uint64_t malformed_before_ = 0;
  std::uint64_t unreachable_before_ = 0;
  bool closed_ = false;
  bool is_alone_ = false;
  bool has_finished_ = false;
  std::atomic<bool> is_succeeded_{false};
  std::vector<std::shared_ptr<SubscriptionEndpoint>> successors_;  // oldest first
  std::weak_ptr<SubscriptionEndpoint> first_;                      // of a successor
  std::vector<Link::Origin> followed_;  // of queues that are over and have been moved from
  const std::shared_ptr<EndpointEvents> events_;
  Departure departure_;
};

}  // namespace agnocast
