// SPDX-License-Identifier: Apache-2.0
//
// SubscriptionEndpoint: an untyped subscription, its links to publishers, and its messages.
//
// Takes happen in user threads under one private mutex. The control thread adds links
// (announcements), marks them orphaned, and collects those that are over. A held message keeps its
// Link, and so the mapping it lies in: it outlives the subscription, its node and the publisher's
// process.
//
//   announced → linked → (publisher gone) orphaned → drained → (nothing held) unlinked → reported
//                      → (subscription closed, and the daemon knows) → (nothing held) unlinked
//
// After a reconnect the daemon announces everything once more. An entry per publisher index
// remembers what was linked and unlinked last: linking a generation again would deliver its
// messages twice.
#pragma once

#include <agnocast/events.hpp>
#include <agnocast/ipc_shared_ptr.hpp>
#include <agnocast/result.hpp>
#include <base/clock.hpp>
#include <client/endpoint/departure.hpp>
#include <client/endpoint/endpoint_events.hpp>
#include <client/endpoint/endpoint_owner.hpp>
#include <client/endpoint/peer.hpp>
#include <client/process/forked_child.hpp>
#include <client/process/steps.hpp>
#include <client/process/wait_set.hpp>
#include <dataplane/subscription_core.hpp>
#include <journal/announce_set.hpp>

#include <algorithm>
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

/// One subscription's end of a queue. The subscription and each message it holds share it.
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
    if (identity.offered.manual_liveliness) lease_.begin(identity.offered.lease_ns, monotonic_ns());
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
  /// Returns 0 while the publisher has not announced it yet.
  std::uint64_t persistent_id() const noexcept {
    return identity_.publisher.persistent_id().load(std::memory_order_relaxed);
  }
  Peer& peer() const noexcept { return *peer_; }
  /// Returns how many messages of this publisher may be held at once.
  std::uint64_t quota() const noexcept { return quota_; }

  /// The last copy of a taken message is gone. Any thread; one locked instruction, no system call.
  /// Returns true when the link is closing and this was its last message: the caller must wake the
  /// control thread.
  bool release(std::uint64_t slot) noexcept {
    core_.release(slot);
    const std::uint64_t before = held_.fetch_sub(1, std::memory_order_acq_rel);
    if (before == quota_) end_wait();
    return before == 1 && closing_.load(std::memory_order_acquire);
  }
  /// For callers of release() that got true. Any thread.
  void wake_control() const noexcept {
    if (wake_control_) wake_control_();
  }
  /// Returns a ReceivedBlock that was kept, or null. Call under the subscription's mutex: no other
  /// thread takes one out.
  detail::Block* spare() noexcept {
    if (spares_ == nullptr) {
      // The newest one stays. Only this thread writes behind it, so no locked instruction is
      // needed.
      detail::Block* const newest = kept_.load(std::memory_order_acquire);
      if (newest != nullptr) spares_ = std::exchange(newest->next, nullptr);
    }
    if (spares_ == nullptr) return nullptr;
    return std::exchange(spares_, std::exchange(spares_->next, nullptr));
  }
  /// Keeps the block of a released message for the next one. As many are kept as were ever held at
  /// once, plus one: a user that holds no more than before allocates none. Any thread.
  void keep(detail::Block* block) noexcept {
    block->next = kept_.load(std::memory_order_relaxed);
    while (!kept_.compare_exchange_weak(block->next, block, std::memory_order_release,
                                        std::memory_order_relaxed)) {
    }
  }
  bool keeps_history() const noexcept { return identity_.offered.transient_local; }
  std::uint64_t held_count() const noexcept { return held_.load(std::memory_order_acquire); }
  /// Returns 0 if its messages do not expire.
  std::uint64_t lifespan_ns() const noexcept { return identity_.offered.lifespan_ns; }

 private:
  friend class SubscriptionEndpoint;
  /// Returns 1 if no look has counted this message, and counts it.
  std::uint64_t count_taken(std::uint64_t sequence) noexcept {
    if (sequence < counted_) return 0;
    counted_ = sequence + 1;
    return 1;
  }
  /// It may take again: unread messages ring no doorbell.
  void end_wait() noexcept {
    is_quota_reported_.store(false, std::memory_order_relaxed);
    wait_set_->wake();
  }
  /// One publisher's queues in several sessions have one persistent endpoint id, and one heap,
  /// which the publisher brings along and no other process has.
  struct Origin {
    std::uint64_t persistent_id;
    std::uint64_t heap;  // address
    friend bool operator==(const Origin&, const Origin&) = default;
  };
  Origin origin() const noexcept { return {persistent_id(), peer_->heap().first_address()}; }
  std::uint64_t shown_alive_ns() const noexcept {
    return std::max(core_.newest_stamp(),
                    identity_.publisher.asserted_ns().load(std::memory_order_relaxed));
  }
  /// Returns whether its publisher adds no more here, because it publishes in a newer session.
  bool has_moved() const noexcept {
    // acquire; pairs with the store after the last commit in PublisherEndpoint::move_to.
    return identity_.publisher.intent_op().load(std::memory_order_acquire) == abi::intent_moved;
  }

  Core core_;
  Core::Identity identity_;
  std::shared_ptr<Peer> peer_;
  std::shared_ptr<WaitSet> wait_set_;
  std::uint64_t quota_;
  std::function<void()> wake_control_;
  std::uint64_t windows_seen_ = 0;  // at the last take()
  std::uint64_t lost_noted_ = 0, malformed_noted_ = 0, unreachable_noted_ = 0;
  std::atomic<std::uint64_t> held_{0};
  std::atomic<bool> closing_{false};
  // State of the current look.
  std::uint64_t head_ = 0;
  HeapLook windows_{peer_->heap(), Unannounced::awaited, head_};
  std::optional<std::uint64_t> next_stamp_;  // of the next message to take
  std::atomic<detail::Block*> kept_{nullptr};
  detail::Block* spares_ = nullptr;
  std::atomic<bool> is_quota_reported_{false};  // and nothing was released since
  std::uint64_t counted_ = 0;                   // by count_arrivals()
  bool is_refused_ = false;                     // a take may have been in vain
  bool ceased_ = false;                         // the publisher adds no more
  LeaseWatch lease_;
  bool continues_ = false;  // it had an earlier queue of the same publisher
  // Set by the daemon's packet, after it has announced every window that the publisher had by then.
  bool is_orphaned_ = false;
};

/// A message held by this process. Its last user calls release() exactly once. It has all it needs:
/// the link keeps the message's memory mapped, and wakes the control thread of its own session.
struct Received {
  dataplane::Taken taken;
  std::shared_ptr<Link> link;

  /// The last copy is gone. Any thread. No system call unless it was the last message of a closing
  /// link.
  void release() const noexcept {
    if (is_forked_child()) return;  // the hold is the parent's
    if (!link->release(taken.slot)) return;
    AGNOCAST_CRASH_POINT(C_release_last);
    link->wake_control();
  }
};

/// A received message in the form that its users share.
struct ReceivedBlock : detail::Block {
  Received received;
};

/// The destination of a take.
class Receiver {
 public:
  /// Called when there is something to take, before it is taken. If it turns out to be lost, the
  /// placed object stays without a link. Return null without memory: the message stays unread.
  /// Called under the subscription's mutex: must not call the subscription.
  virtual Received* place(Link& link) noexcept = 0;
  std::size_t wanted() const noexcept { return wanted_; }
  /// The object placed last has its message.
  void took() noexcept { --wanted_; }

 protected:
  explicit Receiver(std::size_t wanted = 1) noexcept : wanted_(wanted) {}
  ~Receiver() = default;

 private:
  std::size_t wanted_;  // messages
};

class SubscriptionEndpoint {
 public:
  struct Identity {
    region::TopicWords<SharedMemory> topic;
    std::uint32_t topic_index;
    std::uint64_t index;
    std::uint64_t generation;
    std::byte* region;     // this process's client region
    std::uint64_t extent;  // in the region
    abi::Qos qos;
    std::uint64_t quota;  // messages held at once, per publisher, at most
    bool depth_per_publisher = false;
    std::uint64_t message_bytes = 0;  // sizeof the message object; 0 = any
    std::uint64_t message_alignment = 1;
    std::function<void()> wake_control = {};      // of the session; any thread
    std::shared_ptr<EndpointEvents> events = {};  // of the endpoint that this one continues
    EndpointOwner* owner = nullptr;
    std::uint64_t persistent_id = 0;
  };
  struct Publisher {
    std::uint64_t index;
    std::uint64_t generation;
    std::uint64_t extent;
    std::uint64_t first_sequence;
    abi::Qos qos;
    bool from_start;
    std::uint64_t quota;  // of its messages that may be held at once
  };

  SubscriptionEndpoint(const Identity& identity, std::shared_ptr<WaitSet> wait_set);
  SubscriptionEndpoint(const SubscriptionEndpoint&) = delete;
  SubscriptionEndpoint& operator=(const SubscriptionEndpoint&) = delete;

  const Identity& identity() const noexcept { return self_; }
  const WaitSet& wait_set() const noexcept { return *wait_set_; }
  const std::shared_ptr<WaitSet>& shared_wait_set() const noexcept { return wait_set_; }
  EndpointOwner* owner() const noexcept { return self_.owner; }

  // --- control thread

  /// Links an announced publisher. A repeated announcement can only bring new windows. Returns
  /// false when the publisher is not linked: it was before, this subscription is closed, or it is
  /// not on the board.
  [[nodiscard]] bool add_publisher(const Publisher& publisher, std::shared_ptr<Peer> peer);
  /// The daemon reports that this publisher is gone. Its committed messages are still delivered,
  /// unless `give_up`: unread ones are lost then.
  void orphan(std::uint64_t publisher, std::uint64_t generation, bool give_up) noexcept;
  /// The session of the process was revoked: ends all matches.
  void revoke() noexcept;
  /// Unlinks the links that are over and hold nothing, and returns them; the caller tells the
  /// daemon.
  std::vector<std::shared_ptr<Link>> collect_unlinked();
  bool is_linked_to(std::uint64_t publisher, std::uint64_t generation) const noexcept;
  /// Returns whether it has left and has no link.
  bool is_empty() const noexcept;

  // --- user threads

  /// Takes the oldest unread messages of all publishers (in order per publisher; by stamp between
  /// publishers), as many as `receiver` wants. Usually looks at the publishers only once: messages
  /// that arrive meanwhile may be left for the next call. Messages beyond the subscription's depth
  /// count as lost. No system call, except after a publisher's heap has grown. Returns whether
  /// `receiver` has at least one.
  bool take(Receiver& receiver) noexcept;
  /// The subscription takes no more.
  void close() noexcept;
  /// Returns whether there is anything to take. For the check between arming and sleeping.
  bool has_news() const noexcept;
  /// See SubscriptionBase::get_arrivals(). Looks at each link.
  Arrivals arrivals() noexcept;
  /// Counts missed deadlines up to now, and publishers that are alive.
  void look_at_times() noexcept {
    if (is_forked_child()) return;
    if (events_->has_deadline()) events_->look_at_deadline(newest_stamp());
    if (events_->has_lease()) events_->look_at_leases([this] { return look_at_leases(); });
  }
  std::uint64_t lost() const noexcept;
  std::uint64_t malformed() const noexcept;
  std::uint64_t unreachable() const noexcept;
  /// Returns the number of publishers that match and are not gone. One counts as soon as its
  /// creation is answered; `linked`: as soon as it is mapped here, and linked.
  std::size_t publisher_count(bool linked = false) const noexcept;
  /// Also counts publishers that are gone and still have something here.
  std::size_t link_count() const noexcept;
  /// Calls `see(persistent_id, is_gone)` for publishers that are not gone, and for gone ones with
  /// unread messages.
  void for_each_writer(const std::function<void(std::uint64_t, bool)>& see) const;
  const std::shared_ptr<EndpointEvents>& shared_events() const noexcept { return events_; }
  EndpointEvents& events() noexcept { return *events_; }
  Departure& departure() noexcept { return departure_; }

  // --- after the daemon's store was lost: docs/decisions/0006. The user's endpoint stays, and
  // takes from its successors in newer sessions what is not in its own links.

  /// The session's daemon will not come back.
  void be_alone() noexcept;
  /// Reserves room for one more, so that a created successor is not lost. Throws bad_alloc.
  void expect_successor();
  /// Adds a successor of a newer session. What a publisher publishes there comes after what it left
  /// here. Returns false when this subscription is closed.
  bool add_successor(const std::shared_ptr<SubscriptionEndpoint>& successor);
  /// Returns the endpoint of that session: this one, or a successor; null if there is none.
  std::shared_ptr<SubscriptionEndpoint> in_session(
      const EndpointOwner* owner, const std::shared_ptr<SubscriptionEndpoint>& self) const;
  std::size_t successor_count() const noexcept;
  /// Returns the successor of the given number, oldest first; null if there are fewer.
  std::shared_ptr<SubscriptionEndpoint> successor(std::size_t number) const noexcept;
  /// Replaces collect_unlinked() without a daemon: forgets links whose publishers add no more, when
  /// all is read and released.
  void collect_alone();
  /// Returns whether it is closed or succeeded, and has no link.
  bool is_finished() const noexcept;
  /// From now on it does not access its session.
  void finish() noexcept;
  /// Called on a successor, before add_successor().
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
  // Separate, so that a take that finds nothing saves no registers for it.
  [[gnu::noinline]] bool take_oldest(Receiver& receiver) noexcept;
  template <bool only_next>
  [[gnu::noinline, gnu::flatten]] Attempt take_from(const std::shared_ptr<Link>& link,
                                                    Receiver& receiver, std::size_t most) noexcept;
  [[gnu::noinline]] void pass_over_expired() noexcept;
  bool cease(Link& link) noexcept;
  std::uint64_t newest_stamp() const noexcept;
  std::uint64_t look_at_leases() noexcept;
  void look_at_empty() const noexcept;
  [[gnu::noinline]] bool take_in_order(Receiver& receiver) noexcept;
  bool may_take() const noexcept;
  bool can_take(Link& link) const noexcept;
  void look_at(Link& link) const noexcept;
  void see_next(Link& link) const noexcept;
  bool has_news_here() const noexcept;
  bool has_news_in_order() const noexcept;
  // Sessions by age: 0 is this one; its successors follow.
  template <class Do>
  auto with_successors_locked(Do work, std::size_t locked = 0) const -> decltype(work());
  SubscriptionEndpoint& in_age(std::size_t age) noexcept {
    return age == 0 ? *this : *successors_[age - 1];
  }
  const SubscriptionEndpoint& in_age(std::size_t age) const noexcept {
    return age == 0 ? *this : *successors_[age - 1];
  }
  Candidate oldest_in_order() noexcept;
  bool is_held_back(Link& link, std::size_t age) const noexcept;
  void absorb(SubscriptionEndpoint& successor) noexcept;
  bool has_former(const Link& link, std::size_t age) const noexcept;
  bool has_next(const Link& link, std::size_t age) const noexcept;
  std::size_t matched_count() const noexcept;  // on its own board
  bool takes_part() const noexcept;
  using Announcement = journal::AnnouncementState<SharedMemory>;
  void drop_beyond_depth() noexcept;
  void note_losses(Link& link) noexcept;
  const std::shared_ptr<Link>* oldest() const noexcept;

  Identity self_;
  std::shared_ptr<WaitSet> wait_set_;
  mutable std::mutex mutex_;
  std::vector<std::shared_ptr<Link>> links_;
  std::vector<Announcement> announcements_;  // by publisher index, as far as one was announced
  bool counts_ = false;                      // somebody wants to know arrivals()
  std::uint64_t arrived_ = 0;
  std::uint64_t lost_before_ = 0;       // of links that are over
  bool may_expire_ = false;             // messages of some publisher
  std::uint64_t newest_before_ns_ = 0;  // stamp of their newest message
  std::uint64_t malformed_before_ = 0;
  std::uint64_t unreachable_before_ = 0;
  bool closed_ = false;
  bool is_alone_ = false;
  bool has_finished_ = false;
  std::atomic<bool> is_succeeded_{false};
  std::vector<std::shared_ptr<SubscriptionEndpoint>> successors_;  // oldest first
  std::weak_ptr<SubscriptionEndpoint> first_;                      // of a successor
  std::vector<Link::Origin> followed_;  // collected queues whose publishers have moved on
  const std::shared_ptr<EndpointEvents> events_;
  Departure departure_;
};

}  // namespace agnocast
