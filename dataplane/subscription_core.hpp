// SPDX-License-Identifier: Apache-2.0
//
// Subscription core: link, take, release, unlink, sleep. docs/protocol.md, "Take",
// "Sleep and wake" and "Join, leave, death", uses the same numbers.
//
// A link is the state of one subscription towards one publisher. A take publishes a hold bit and
// only then checks that the entry is still the wanted one (the reader's half of the handshake
// whose writer's half is P6…P10). The caller holds the subscription's private mutex. All words of
// the publisher are input: loaded once and checked, and every loop is bounded by 2 × ring
// entries.
#pragma once

#include <dataplane/steps.hpp>
#include <region/views.hpp>
#include <region/windows.hpp>

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <optional>

namespace agnocast::dataplane {

/// A message that is held now: release it with the same slot.
struct Taken {
  std::uint64_t sequence = 0;
  std::uint64_t slot = 0;
  std::uint64_t address = 0;
  std::uint64_t size = 0;
  std::uint64_t stamp_ns = 0;
};

template <class M>
class LinkCore {
 public:
  struct Identity {
    region::TopicWords<M> topic;
    region::PublisherWords<M> publisher;  // in the publisher's client region, read-only here
    region::LinkWords<M> line;            // in this process's client region
    std::uint64_t index;                  // of the publisher in the topic
    std::uint64_t generation;             // of the publisher
    std::uint64_t first_sequence;
    abi::Qos offered;
    abi::Qos requested;
    std::uint64_t
        message_bytes;  // sizeof the message object; 0 = any (for tools that do not know the type)
    std::uint64_t message_alignment = 1;  // a power of two
    std::uint64_t subscription = 0;       // own index in the topic
  };

  explicit LinkCore(const Identity& identity) noexcept
      : self_(identity), cursor_(identity.first_sequence + 1) {}

  /// J6. `from_start`: the publisher joined after the subscription, which therefore wants
  /// everything it committed. Otherwise it wants what was committed since it joined (J4), as far
  /// as its depth reaches. Returns false, and links nothing, if the board no longer shows the
  /// announced publisher. Rule RU excludes that: a peer has broken an invariant.
  bool link(bool from_start) noexcept {
    std::uint64_t start = 0, head = abi::pack_entry(self_.first_sequence, 0);
    // Written by the daemon before it answered (J4); 0: it has set no start.
    AGNOCAST_STEP(J6_start) start = self_.line.cursor().load(std::memory_order_acquire);
    // [sync:join] seq_cst; behind J3 in the single total order, so a publisher that missed J3
    // saw an earlier head.
    AGNOCAST_STEP(J6_head) head = self_.publisher.head().load(std::memory_order_seq_cst);
    const bool history = M::holds(steps::J6_history,
                                  self_.offered.transient_local && self_.requested.transient_local);
    const std::uint64_t back = history ? std::min(self_.offered.depth, self_.requested.depth) : 0;
    const std::uint64_t end = abi::sequence_of(head) + 1;
    if (start == 0 || start > end) start = end;
    cursor_ = from_start ? self_.first_sequence + 1
                         : std::max(region::minus_at_least(start, back, self_.first_sequence + 1),
                                    region::minus_at_least(end, abi::reach_of(self_.requested), 0));
    AGNOCAST_STEP(J6_cursor) self_.line.cursor().store(cursor_, std::memory_order_relaxed);
    // [sync:link] seq_cst; pairs with the acquire at P9.
    AGNOCAST_STEP(J6_generation)
    self_.line.publisher_generation().store(self_.generation, std::memory_order_seq_cst);
    const std::uint64_t word = publisher_word();
    const bool announced = abi::generation_of(word) == self_.generation &&
                           (abi::state_of(word) == abi::BoardState::active ||
                            abi::state_of(word) == abi::BoardState::orphan);
    if (M::holds(steps::J6_check, announced)) return true;
    unlink();
    return false;
  }

  /// Unlinks; no message of this link may be held. Then the caller may send UNLINKED to the
  /// daemon.
  void unlink() noexcept {
    AGNOCAST_STEP(U1_generation)
    self_.line.publisher_generation().store(0, std::memory_order_release);
    AGNOCAST_STEP(U2_cursor) self_.line.cursor().store(0, std::memory_order_release);
  }

  /// Takes and holds the next message, or returns nothing. `windows` is the publisher's heap:
  /// open() makes it accessible up to the stored frontiers, place_of(address, size) returns
  /// whether a message there is readable.
  template <class Windows>
  std::optional<Taken> take(Windows& windows) noexcept {
    std::uint64_t head = look();
    return take(windows, head);
  }

  /// Loads the publisher's head, by which several messages can be taken.
  std::uint64_t look() noexcept {
    const std::uint64_t head = newest();
    pass_over_history(abi::sequence_of(head));
    return head;
  }
  /// Takes a message by an earlier look(): like a take() that was slow between T1 and T2. If the
  /// publisher was faster, it looks again and updates `head`. With `only_next` it does not: it
  /// returns the message that next_stamp(head) described, or counts a loss. Not split: the steps T1
  /// to T6 of docs/protocol.md stand in their order, and the hot path stays one function.
  template <bool only_next = false, class Windows>
  std::optional<Taken> take(Windows& windows, std::uint64_t& head) noexcept {
    const std::uint64_t stored_cursor = cursor_;
    awaiting_ = 0;
    for (std::uint64_t round = 0; round < (only_next ? 1 : 2 * M::ring_count()); ++round) {
      if (round != 0) head = look();
      const std::uint64_t newest_sequence = abi::sequence_of(head);
      if (newest_sequence < cursor_) break;
      std::uint64_t wanted = cursor_;
      AGNOCAST_STEP(T1_reach)
      wanted = std::max(
          cursor_, region::minus_at_least(newest_sequence + 1, abi::reach_of(self_.requested), 0));
      lose(wanted - cursor_);
      // [sync:publish] acquire; pairs with P4.
      const std::uint64_t entry =
          wanted == newest_sequence ? head
                                    : self_.publisher.order(wanted).load(std::memory_order_acquire);
      const std::uint64_t slot = abi::slot_of(entry);
      if (!M::holds(steps::T2_order, abi::sequence_of(entry) == wanted) ||
          slot >= M::slot_capacity) {
        if (abi::sequence_of(entry) < wanted || slot >= M::slot_capacity) ++malformed_;
        lose(1);
        continue;
      }
      // [sync:publish] acquire; pairs with P3. Only avoids a hold on a message that is already
      // gone.
      if (!M::holds(steps::T3_live,
                    self_.publisher.slot_id(slot).load(std::memory_order_acquire) == wanted)) {
        lose(1);
        continue;
      }
      const std::uint64_t bit = std::uint64_t{1} << slot % 64;
      std::uint64_t before = 0;
      // [sync:hold] seq_cst, then a seq_cst load: pairs with mark, fence (P6), scan (P9) of the
      // publisher.
      AGNOCAST_STEP(T4_hold)
      before = self_.line.hold(slot / 64).fetch_or(bit, std::memory_order_seq_cst);
      const auto undo = [&] {
        if ((before & bit) != 0) return;
        AGNOCAST_STEP(T5_undo)
        self_.line.hold(slot / 64).fetch_and(~bit, std::memory_order_release);
      };
      // [sync:hold] seq_cst, behind T4; pairs with E1 and the fence of a later scan: either this
      // load sees the withdrawal, or that scan sees the hold. Before the check of the slot:
      // messages freed before the publisher resumed serving are gone there.
      if (M::holds(steps::T5_withdrawn, is_withdrawn())) {
        undo();
        unusual_ |= is_withdrawn_here;
        break;
      }
      if (!M::holds(steps::T5_valid,
                    self_.publisher.slot_id(slot).load(std::memory_order_seq_cst) == wanted)) {
        undo();
        lose(1);
        continue;
      }
      Taken taken{wanted, slot, self_.publisher.slot_address(slot).load(std::memory_order_relaxed),
                  self_.publisher.slot_size(slot).load(std::memory_order_relaxed),
                  self_.publisher.slot_stamp(slot).load(std::memory_order_relaxed)};
      AGNOCAST_STEP(T6_frontier) windows.open();
      const region::Place place = has_right_shape(taken)
                                      ? windows.place_of(taken.address, taken.size)
                                      : region::Place::outside;
      if (!M::holds(steps::T6_inside, place == region::Place::readable)) {
        release(slot);
        if (place == region::Place::awaited) {  // it stays unread until the announcement is here
          awaiting_ = 1;
          break;
        }
        ++(place == region::Place::unreachable ? unreachable_ : malformed_);
        lose(1);
        continue;
      }
      cursor_ = wanted + 1;
      store_cursor();
      return taken;
    }
    if (cursor_ != stored_cursor) store_cursor();
    return std::nullopt;
  }

  /// Returns the number of unread messages within reach: those that take() can still deliver.
  std::uint64_t unread() noexcept {
    const std::uint64_t end = abi::sequence_of(newest()) + 1;
    pass_over_history(end - 1);
    const std::uint64_t from =
        std::max(cursor_, region::minus_at_least(end, abi::reach_of(self_.requested), 0));
    return end > from ? end - from : 0;
  }
  /// Returns how many messages came since the last call and were not taken, also those beyond the
  /// reach that are lost, at most as many as a queue holds. `counted` is what the last call left
  /// there, 0 at first: the sequence of the next one to count.
  std::uint64_t count_arrivals(std::uint64_t& counted) noexcept {
    const std::uint64_t end = abi::sequence_of(newest()) + 1;
    pass_over_history(end - 1);
    const std::uint64_t from = std::max(std::min(counted, end), cursor_);
    counted = end;
    return end > from ? std::min<std::uint64_t>(end - from, M::ring_count()) : 0;
  }
  /// Returns the stamp of the message that take() would try next, if there is one. Orders the
  /// links of a subscription; a hint, unvalidated.
  std::optional<std::uint64_t> next_stamp() const noexcept { return next_stamp(newest()); }
  /// The same by an earlier look().
  std::optional<std::uint64_t> next_stamp(std::uint64_t head) const noexcept {
    const std::uint64_t newest_sequence = abi::sequence_of(head);
    if (newest_sequence < cursor_) return std::nullopt;
    const std::uint64_t wanted = std::max(
        cursor_, region::minus_at_least(newest_sequence + 1, abi::reach_of(self_.requested), 0));
    const std::uint64_t entry = wanted == newest_sequence
                                    ? head
                                    : self_.publisher.order(wanted).load(std::memory_order_acquire);
    const std::uint64_t slot = abi::slot_of(entry);
    if (abi::sequence_of(entry) != wanted || slot >= M::slot_capacity)
      return 0;  // gone: try this link first
    return self_.publisher.slot_stamp(slot).load(std::memory_order_relaxed);
  }
  /// Skips the next message of an earlier look(), which is not lost, if its stamp is before
  /// `limit_ns`. Returns whether it did. Stamps are hints, but the sequence is the one looked at.
  bool pass_over_older(std::uint64_t head, std::uint64_t limit_ns) noexcept {
    const std::uint64_t stamp = next_stamp(head).value_or(0);
    if (stamp == 0 || stamp >= limit_ns) return false;
    const std::uint64_t next = std::max(
        cursor_,
        region::minus_at_least(abi::sequence_of(head) + 1, abi::reach_of(self_.requested), 0));
    lose(next - cursor_);
    ++cursor_;
    store_cursor();
    return true;
  }
  /// Returns the stamp of the newest message, 0 if there was none, or it is not known. A hint.
  std::uint64_t newest_stamp() const noexcept {
    const std::uint64_t head = newest();
    const std::uint64_t slot = abi::slot_of(head);
    if (abi::sequence_of(head) <= self_.first_sequence || slot >= M::slot_capacity ||
        (unusual_ & is_withdrawn_here) != 0)
      return 0;
    return self_.publisher.slot_stamp(slot).load(std::memory_order_relaxed);
  }
  /// Skips the next unread message and counts it as lost. Keeps a subscription's depth over
  /// several publishers.
  void skip() noexcept {
    const std::uint64_t end = abi::sequence_of(newest()) + 1;
    pass_over_history(end - 1);
    const std::uint64_t from =
        std::max(cursor_, region::minus_at_least(end, abi::reach_of(self_.requested), 0));
    if (from >= end) return;
    lose(from + 1 - cursor_);
    store_cursor();
  }

  /// L1. Commit and effect are one instruction. For any thread of the process with the
  /// subscription's mutex or the last reference.
  void release(std::uint64_t slot) noexcept {
    // [sync:hold] release; pairs with the acquire at P9: everything read from the message was read
    // before this.
    AGNOCAST_STEP(L1_release)
    self_.line.hold(slot / 64).fetch_and(~(std::uint64_t{1} << slot % 64),
                                         std::memory_order_release);
  }

  /// Stops taking while there is no daemon to report it to: publishers then wait for nothing but
  /// its held messages.
  void stand_aside() noexcept {
    cursor_ = abi::cursor_aside;
    self_.line.cursor().store(cursor_, std::memory_order_release);
  }
  /// Limits history: of the messages published in a previous session, this subscription gets only
  /// the newest `count`. The others are skipped, and do not count as lost.
  void want_history(std::uint64_t count) noexcept { history_wanted_ = count; }

  /// S3: returns whether there is a message to take. Call it between S2 and the sleep.
  bool has_news() const noexcept { return has_news(newest()); }
  /// The same by an earlier look().
  bool has_news(std::uint64_t head) const noexcept { return abi::sequence_of(head) >= cursor_; }

  /// Returns whether the publisher has ever committed a message.
  bool has_begun() const noexcept { return abi::sequence_of(newest()) > self_.first_sequence; }

  /// Checks whether the publisher has ended. If so, only messages up to the head recorded by the
  /// daemon are taken from now on.
  void observe_publisher() noexcept {
    if ((unusual_ & is_orphaned) != 0) return;
    const std::uint64_t word = publisher_word();
    if (abi::generation_of(word) == self_.generation &&
        abi::state_of(word) == abi::BoardState::active)
      return;
    final_head_ = self_.topic.publisher(self_.index, offsetof(abi::PublisherEntry, final_head))
                      .load(std::memory_order_relaxed);
    unusual_ |= is_orphaned;
  }
  /// Returns whether the publisher has ended and all its committed messages were taken or lost.
  bool drained() const noexcept {
    return (unusual_ & is_orphaned) != 0 && abi::sequence_of(newest()) < cursor_;
  }
  /// Returns whether a take found that the publisher stopped serving this subscription. It may
  /// resume.
  bool withdrawn() const noexcept { return (unusual_ & is_withdrawn_here) != 0 && is_withdrawn(); }

  /// Returns whether the last take(), which found nothing, left a message that a later one may get.
  bool was_refused() const noexcept {
    return awaiting_ != 0 || (unusual_ & is_withdrawn_here) != 0;
  }
  /// Returns whether the last take() left a message because its window was not announced yet.
  bool is_awaiting_window() const noexcept { return awaiting_ != 0; }
  std::uint64_t cursor() const noexcept { return cursor_; }
  std::uint64_t lost() const noexcept { return lost_; }
  std::uint64_t malformed() const noexcept { return malformed_; }
  std::uint64_t unreachable() const noexcept { return unreachable_; }

 private:
  std::uint64_t newest() const noexcept {
    if (unusual_ != 0) [[unlikely]] {
      if (withdrawn()) return abi::pack_entry(cursor_ - 1, 0);
      if ((unusual_ & is_orphaned) != 0) return final_head_;
    }
    std::uint64_t head = 0;
    // [sync:publish] acquire; pairs with P5.
    AGNOCAST_STEP(T1_head) head = self_.publisher.head().load(std::memory_order_acquire);
    return head;
  }
  /// Called behind each look at head, up to that head: history may still be arriving, and
  /// messages committed after a load of `inherited` would count as news.
  void pass_over_history(std::uint64_t newest_sequence) noexcept {
    if (history_wanted_ == all_history) return;
    // [sync:publish] relaxed, behind the acquire of T1; pairs with the store before each commit
    // of history.
    const std::uint64_t last = self_.publisher.inherited().load(std::memory_order_relaxed);
    if (last < cursor_ + history_wanted_) return;
    const std::uint64_t next = std::min(last - history_wanted_, newest_sequence) + 1;
    if (next <= cursor_) return;
    cursor_ = next;
    store_cursor();
  }
  bool is_withdrawn() const noexcept {
    const std::uint64_t word =
        self_.publisher.withdrawn(self_.subscription).load(std::memory_order_seq_cst);
    return abi::withdrawal_of(word, self_.subscription) != abi::Withdrawal::none;
  }
  bool has_right_shape(const Taken& taken) const noexcept {
    return taken.size != 0 && (self_.message_bytes == 0 || taken.size == self_.message_bytes) &&
           (taken.address & (self_.message_alignment - 1)) == 0;
  }
  std::uint64_t publisher_word() const noexcept {
    return self_.topic.publisher(self_.index, offsetof(abi::PublisherEntry, word))
        .load(std::memory_order_acquire);
  }
  void lose(std::uint64_t count) noexcept {
    lost_ += count;
    cursor_ += count;
  }
  void store_cursor() noexcept {
    // [sync:direct-free] release, behind the hold; pairs with the acquire at P9.
    AGNOCAST_STEP(T7_cursor) self_.line.cursor().store(cursor_, std::memory_order_release);
  }

  static constexpr std::uint64_t is_orphaned = 1;
  static constexpr std::uint64_t is_withdrawn_here = 2;  // seen once; check again
  static constexpr std::uint64_t all_history = ~std::uint64_t{0};

  Identity self_;
  std::uint64_t cursor_;
  std::uint64_t history_wanted_ = all_history;
  std::uint64_t lost_ = 0;
  std::uint64_t malformed_ = 0;
  std::uint64_t unreachable_ = 0;
  std::uint64_t unusual_ = 0;  // is_orphaned, is_withdrawn_here
  std::uint64_t awaiting_ = 0;
  std::uint64_t final_head_ = 0;
};

/// The sleep word of a wait set. To sleep: arm() → check every link → block on the doorbell →
/// disarm(). If several threads sleep, each arms, and the last one disarms: a publisher rings once
/// for each value of the word, so each sleep needs a value of its own.
template <class M>
class SleepCore {
 public:
  SleepCore(typename M::Region region, std::uint64_t offset) noexcept
      : region_(region), offset_(offset) {}

  /// S1, S2. From here on a publisher rings; the check that follows sees what was committed
  /// before.
  void arm() noexcept {
    // [sync:sleep] relaxed, then a fence; pairs with P6, P8. The generation is 64 bits wide: a
    // narrow one loses a wake by wrapping.
    generation_ += 1 + generation_ % 2;
    AGNOCAST_STEP(S1_arm) M::word(region_, offset_).store(generation_, std::memory_order_relaxed);
    AGNOCAST_STEP(S2_fence) M::fence();
  }
  void disarm() noexcept {
    ++generation_;
    AGNOCAST_STEP(S5_disarm)
    M::word(region_, offset_).store(generation_, std::memory_order_relaxed);
  }

 private:
  typename M::Region region_;
  std::uint64_t offset_;
  std::uint64_t generation_ = 0;  // even: all are awake
};

}  // namespace agnocast::dataplane
