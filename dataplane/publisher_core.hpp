// SPDX-License-Identifier: Apache-2.0
//
// Publisher core: publish, retain, retire, free. docs/protocol.md, "Publish" and
// "Retain, retire, free", uses the same numbers.
//
// A publish is one commit (P5) between an intent and a scan. A scan looks once at every
// subscription of the topic and decides what to free. It loads from peers and stores to its own
// memory only, never waits, and takes no lock that another process could hold. The caller holds the
// publisher's private mutex; this object is private memory of the process.
//
// Three numbers decide everything (h = newest sequence, H = history kept for late joiners, D = a
// subscription's reach):
//   need     no subscription may ask for an entry below it
//            min(h-H+1, min over active s of max(low_s, h-D_s+1))
//   past     no subscription will ever take an entry below it again
//            min over active and leaving s of low_s
//   unknown  an unmapped endpoint may have started at it, or later
//            min over unmapped s of since_s
// A withdrawn endpoint takes no more: it counts in none of them. What it holds counts until it has
// once held nothing, or is disregarded.
//
//            past            need                          h
//   ---------|---------------|-----------------------------|--->  sequence
//   free now   retire, free in a later scan    keep
#pragma once

#include <dataplane/publisher_slots.hpp>
#include <dataplane/steps.hpp>
#include <region/views.hpp>

#include <algorithm>
#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <span>
#include <utility>

namespace agnocast::dataplane {

enum class PublishOutcome : std::uint8_t { published, no_slot, would_block };

/// A message as it enters the queue: the object in the shared heap, and its commit time.
struct Entry {
  std::uint64_t address = 0;
  std::uint64_t size = 0;
  std::uint64_t stamp_ns = 0;
  std::uint64_t bytes = 0;  // with all that it owns: what a deferred scan may keep back
};

template <class M>
class PublisherCore {
 public:
  /// Bytes that publishes without a look at links may keep back together: so few that they stay in
  /// the first-level cache beside the data that the process works with.
  static constexpr std::uint64_t kept_back_max = 16 * 1024;

  struct Identity {
    region::TopicWords<M> topic;
    region::PublisherWords<M> words;
    std::uint64_t index;  // of this publisher in the topic
    std::uint64_t generation;
    std::uint64_t first_sequence;  // the queue is empty while head has this value
    abi::Qos qos;
    std::uint64_t slot_count;
    std::uint64_t deferred_limit;  // consecutive publishes that may omit the look; 0 = none
    std::uint64_t client = 0;      // index of its process
  };

  explicit PublisherCore(const Identity& identity)
      : self_(identity),
        head_sequence_(identity.first_sequence),
        seen_(identity.first_sequence),
        history_(identity.qos.transient_local ? identity.qos.depth : 0),
        slots_(std::min<std::uint64_t>(identity.slot_count, M::slot_capacity)) {}

  /// Commits one message. Calls ring(wait_set, armed) of `environment` for each wait set to ring,
  /// and freed(slot, address) for each message to destroy. If it has commits(entry), that is called
  /// directly before the commit, when nothing can refuse the message any more. If it has
  /// scans_soon(), that is called after the rings and returns whether another thread is about to
  /// make a full scan. On an error the caller keeps the message. A message that `was_published`
  /// before, in another queue, does not wait for keep-all readers.
  template <class Environment>
  PublishOutcome publish(const Entry& entry, Environment& environment,
                         bool was_published = false) noexcept {
    if (self_.qos.keep_all && !was_published && !room_for_one_more()) {
      scan(environment, false);
      if (!room_for_one_more()) return PublishOutcome::would_block;
    }
    std::uint64_t slot = slots_.lowest_free();
    // After deferred scans nothing has been retired yet: the first scan then only retires.
    for (int looks = self_.deferred_limit != 0 ? 2 : 1; slot == Slots::none && looks > 0; --looks) {
      scan(environment, false);
      slot = slots_.lowest_free();
    }
    if (slot == Slots::none) return PublishOutcome::no_slot;
    const std::uint64_t sequence = head_sequence_ + 1;
    const auto& words = self_.words;
    AGNOCAST_STEP(P1_sequence) words.intent_sequence().store(sequence, std::memory_order_relaxed);
    AGNOCAST_STEP(P1_slot) words.intent_slot().store(slot, std::memory_order_relaxed);
    AGNOCAST_STEP(P1_op) words.intent_op().store(abi::intent_publish, std::memory_order_release);
    AGNOCAST_STEP(P2_address)
    words.slot_address(slot).store(entry.address, std::memory_order_relaxed);
    AGNOCAST_STEP(P2_stamp) words.slot_stamp(slot).store(entry.stamp_ns, std::memory_order_relaxed);
    AGNOCAST_STEP(P2_size) words.slot_size(slot).store(entry.size, std::memory_order_relaxed);
    // [sync:publish] release, in this order; pairs with the acquires of T1, T2 and T3, so entries
    // at or below head are complete.
    AGNOCAST_STEP(P3_id) words.slot_id(slot).store(sequence, std::memory_order_release);
    AGNOCAST_STEP(P4_order)
    words.order(sequence).store(abi::pack_entry(sequence, slot), std::memory_order_release);
    if constexpr (requires { environment.commits(entry); }) environment.commits(entry);
    AGNOCAST_STEP(P5_head)
    words.head().store(abi::pack_entry(sequence, slot), std::memory_order_release);
    head_sequence_ = sequence;
    slots_.enter(slot, sequence, entry.address, entry.bytes);
    kept_back_ += entry.bytes;
    scan(environment, true);
    AGNOCAST_STEP(P11_idle) words.intent_op().store(abi::intent_idle, std::memory_order_release);
    return PublishOutcome::published;
  }

  /// Looks at every endpoint once and frees messages. The publisher calls it in publish; the
  /// control thread when an endpoint died, left or was mapped, and from its timer while anything
  /// outside the history is allocated.
  template <class Environment>
  void scan(Environment& environment) noexcept {
    scan(environment, false);
  }

  /// The control thread has mapped the client region of the subscription with this index and
  /// generation. `wait_set` numbers the wait sets of this publisher (below subscription_capacity);
  /// subscriptions that share a wait set share the number. Rings once: a commit between the
  /// endpoint's join and now could not ring it. The caller scans afterwards.
  template <class Environment>
  void attach(std::uint64_t index, std::uint64_t generation, typename M::Region region,
              std::uint64_t extent, std::uint64_t armed_offset, std::uint64_t wait_set,
              Environment& environment) noexcept {
    Endpoint& endpoint = at(index);
    endpoint.wait_set = wait_set;
    if (abi::generation_of(endpoint.word) != generation)
      end_withdrawal(index);  // of the previous generation
    // The number may have belonged to another wait set.
    AGNOCAST_STEP(J7_rung) places_->rung[wait_set] = 0;
    AGNOCAST_STEP(J7_member) {
      endpoint.attached_generation = generation;
      endpoint.region = region;
      endpoint.line = extent + abi::link_offset(self_.index);
      endpoint.armed_offset = armed_offset;
    }
    endpoint.limit = 0;
    if (index >= endpoint_high_) endpoint_high_ = index + 1;
    AGNOCAST_STEP(J7_ring) environment.ring(wait_set, 0);
  }
  /// Call after attach(): limits what the endpoint may hold of this publisher, whatever the board
  /// allows it to hold of others.
  void limit_holds(std::uint64_t index, std::uint64_t quota) noexcept {
    at(index).limit = quota + 1;
  }
  /// Call before the control thread unmaps it.
  void detach(std::uint64_t index, std::uint64_t generation) noexcept {
    if (at(index).attached_generation == generation) at(index).attached_generation = 0;
  }

  /// E1. Withdraws an endpoint: it takes no more, and only messages that it holds, or may hold
  /// while it is not mapped, are kept for it, until it has released everything or disregard() is
  /// called. The caller scans afterwards. Returns false if it is no endpoint of this generation.
  bool withdraw(std::uint64_t index, std::uint64_t generation, abi::Withdrawal why) noexcept {
    Endpoint& endpoint = at(index);
    if (abi::generation_of(endpoint.word) != generation || !abi::takes_part(endpoint.word))
      return false;
    endpoint.word = abi::pack_board_word(generation, abi::BoardState::leaving);
    if (endpoint.withdrawn_at == 0) endpoint.withdrawn_at = head_sequence_;
    say_withdrawal(index, why);
    return true;
  }
  /// Ignores the holds of a withdrawn endpoint: messages that it does hold may be overwritten.
  void disregard(std::uint64_t index, std::uint64_t generation) noexcept {
    Endpoint& endpoint = at(index);
    if (abi::generation_of(endpoint.word) == generation && endpoint.withdrawn_at != 0)
      endpoint.word = abi::pack_board_word(generation, abi::BoardState::free);
  }
  /// Serves a mapped endpoint again. A disregarded one must hold nothing: the slots that it still
  /// holds may have other messages by now.
  template <class Environment>
  bool serve_again(std::uint64_t index, std::uint64_t generation,
                   Environment& environment) noexcept {
    Endpoint& endpoint = at(index);
    if (abi::generation_of(endpoint.word) != generation || endpoint.withdrawn_at == 0 ||
        endpoint.attached_generation != generation)
      return false;
    const std::uint64_t word =
        self_.topic.subscription(index, offsetof(abi::SubscriptionEntry, word))
            .load(std::memory_order_acquire);
    if (abi::generation_of(word) != generation || !abi::takes_part(word)) return false;
    const region::LinkWords<M> link{endpoint.region, endpoint.line};
    std::uint64_t held = 0;
    for (std::size_t i = 0; i < slots_.words_in_use(); ++i)
      held |= link.hold(i).load(std::memory_order_acquire);
    if (held != 0 && !abi::takes_part(endpoint.word)) return false;
    end_withdrawal(index);
    endpoint.word = word;
    M::fence();  // so that the rung wait set sees the change
    AGNOCAST_STEP(J7_ring) environment.ring(endpoint.wait_set, 0);
    return true;
  }
  abi::Withdrawal withdrawal(std::uint64_t index, std::uint64_t generation) const noexcept {
    const Endpoint& endpoint = at(index);
    if (abi::generation_of(endpoint.word) != generation || endpoint.withdrawn_at == 0)
      return abi::Withdrawal::none;
    return abi::withdrawal_of(self_.words.withdrawn(index).load(std::memory_order_relaxed), index);
  }
  bool is_disregarded(std::uint64_t index) const noexcept {
    return at(index).withdrawn_at != 0 && !abi::takes_part(at(index).word);
  }
  /// Calls function(index, generation) for each endpoint that takes part and is not mapped.
  template <class Function>
  void for_each_unmapped(Function function) const noexcept {
    for (std::uint64_t i = 0; i < endpoint_high_; ++i) {
      const std::uint64_t generation = abi::generation_of(at(i).word);
      if (abi::takes_part(at(i).word) && at(i).attached_generation != generation)
        function(i, generation);
    }
  }
  /// Returns the bytes of the messages, with all that they own, that these mapped endpoints keep:
  /// messages that one of them holds, or has not read and may still ask for. A message that several
  /// keep counts once. A message of the history for late joiners does not count: it would stay
  /// without them.
  struct EndpointId {
    std::uint64_t index, generation;
  };
  std::uint64_t kept_bytes(std::span<const EndpointId> ids) const noexcept {
    typename Slots::Mask kept{};
    std::uint64_t unread_from = infinite;
    for (const auto& [index, generation] : ids) {
      const Endpoint& endpoint = at(index);
      if (endpoint.attached_generation != generation || is_disregarded(index)) continue;
      const region::LinkWords<M> link{endpoint.region, endpoint.line};
      for (std::size_t word = 0; word < slots_.words_in_use(); ++word)
        kept[word] |= link.hold(word).load(std::memory_order_relaxed) & slots_.allocated(word);
      if (abi::state_of(endpoint.word) == abi::BoardState::active)
        unread_from = std::min(
            unread_from,
            std::max(endpoint.low, region::minus_at_least(head_sequence_ + 1, endpoint.reach, 0)));
    }
    const std::uint64_t history_from = region::minus_at_least(head_sequence_ + 1, history_, 0);
    std::uint64_t sum = 0;
    slots_.for_each([&](std::uint64_t slot) {
      const std::uint64_t sequence = slots_.sequence(slot);
      if (sequence < history_from && (Slots::test(kept, slot) || sequence >= unread_from))
        sum += slots_.bytes(slot);
    });
    return sum;
  }

  /// Returns whether no reliable subscription can take one up to `sequence`, as of the last scan.
  bool is_taken(std::uint64_t sequence) const noexcept {
    if (over_ != 0) return true;
    for (const Endpoint& endpoint : endpoints()) {
      if (abi::state_of(endpoint.word) != abi::BoardState::active || !endpoint.reliable) continue;
      const std::uint64_t oldest = region::minus_at_least(head_sequence_ + 1, endpoint.reach, 0);
      if (std::max(endpoint.low, oldest) <= sequence) return false;
    }
    return true;
  }

  /// From now on nothing is kept for late joiners. The caller scans afterwards.
  void keep_no_history() noexcept { history_ = 0; }
  /// The process of an endpoint is gone, without a daemon to report it: its holds and its unread
  /// messages count no more. The caller scans afterwards.
  void remove_dead_subscription(std::uint64_t index, std::uint64_t generation) noexcept {
    Endpoint& endpoint = at(index);
    if (abi::generation_of(endpoint.word) == generation)
      endpoint.word = abi::pack_board_word(generation, abi::BoardState::free);
    detach(index, generation);
  }

  /// Returns whether a message outside the history is allocated: a timer scan may free it.
  bool has_reclaimable() const noexcept {
    return slots_.has_before(region::minus_at_least(head_sequence_ + 1, history_, 0));
  }
  /// Returns whether the daemon has freed the index: no process reads anything of it any more.
  bool is_over() const noexcept { return over_ != 0; }
  std::uint64_t head_sequence() const noexcept { return head_sequence_; }
  std::uint64_t allocated_count() const noexcept { return slots_.count(); }

 private:
  using Slots = PublisherSlots<M>;
  static constexpr std::uint64_t infinite = ~std::uint64_t{0};

  struct Endpoint {
    // As last read from the board; `leaving` for a withdrawn one, `free` for a disregarded one.
    std::uint64_t word = 0;
    std::uint64_t since = 0;  // lower bound of its start while it is not linked
    std::uint64_t reach = 0;  // newest messages that it can still ask for
    std::uint64_t bound = 0;  // unread ones beyond which a keep-all publisher waits; 0 = none
    std::uint64_t attached_generation = 0;  // 0 = not mapped
    std::uint64_t line = 0;                 // offset of its link line for this publisher
    std::uint64_t armed_offset = 0;
    std::uint64_t wait_set = 0;
    std::uint64_t low = 0;           // of the last scan, for room_for_one_more
    std::uint64_t quota = 0;         // messages that it may hold at once
    std::uint64_t limit = 0;         // likewise, of this publisher, plus one; 0 = no other limit
    std::uint64_t withdrawn_at = 0;  // head when it was withdrawn; 0 = it is not
    bool reliable = false;
    typename M::Region region{};
  };

  Endpoint& at(std::uint64_t index) noexcept { return places_->endpoints[index]; }
  const Endpoint& at(std::uint64_t index) const noexcept { return places_->endpoints[index]; }
  std::span<Endpoint> endpoints() noexcept { return {places_->endpoints.data(), endpoint_high_}; }
  std::span<const Endpoint> endpoints() const noexcept {
    return {places_->endpoints.data(), endpoint_high_};
  }

  /// keep-all: returns whether one more message leaves no reliable keep-all endpoint with more
  /// unread ones than both sides agreed to.
  bool room_for_one_more() const noexcept {
    bool room = true;
    for (const Endpoint& endpoint : endpoints()) {
      if (abi::state_of(endpoint.word) != abi::BoardState::active || endpoint.bound == 0) continue;
      const std::uint64_t bound = std::min<std::uint64_t>(self_.qos.depth, endpoint.bound);
      if (M::holds(steps::K0_room, head_sequence_ + 2 > endpoint.low + bound)) room = false;
    }
    return room;
  }

  /// P7: reads the endpoints from the board. An endpoint seen for the first time may have started
  /// as early as the head of the previous look: that look missed its J3, so its J4 and J6 read
  /// a head at or after it.
  void refresh_endpoints() noexcept {
    std::uint64_t epoch = epoch_seen_;
    // [sync:join] acquire; pairs with the daemon's seq_cst store at J3, behind the fence of P6.
    AGNOCAST_STEP(P7_epoch) epoch = self_.topic.epoch().load(std::memory_order_acquire);
    if (M::holds(steps::P7_changed, epoch != epoch_seen_)) {
      epoch_seen_ = epoch;
      // The own word is read before the endpoints' words: once it says orphan, no history is kept
      // for late joiners, and this scan must see every endpoint that joined before that.
      // [sync:join] acquire; pairs with D3_word, which the daemon stores after every earlier J3.
      std::uint64_t self_word = abi::pack_board_word(self_.generation, abi::BoardState::active);
      AGNOCAST_STEP(P7_self)
      self_word = self_.topic.publisher(self_.index, offsetof(abi::PublisherEntry, word))
                      .load(std::memory_order_acquire);
      std::uint64_t high = self_.topic.subscription_high().load(std::memory_order_acquire);
      high = std::min<std::uint64_t>(high, M::subscription_capacity);
      endpoint_high_ = std::max(endpoint_high_, high);
      for (std::uint64_t i = 0; i < high; ++i) refresh_endpoint(i);
      // A publish looks at each of them, however many there once were.
      while (endpoint_high_ != 0 && at(endpoint_high_ - 1).withdrawn_at == 0 &&
             !abi::takes_part(at(endpoint_high_ - 1).word))
        --endpoint_high_;
      refresh_self(self_word);
    }
    AGNOCAST_STEP(P7_seen) seen_ = head_sequence_;
  }

  /// Called after the endpoints: one seen for the first time still counts with its promised
  /// history.
  void refresh_self(std::uint64_t word) noexcept {
    // Free again, or reused: every notified process has unlinked or is dead (rule RU), so none
    // holds anything.
    if (abi::generation_of(word) != self_.generation ||
        abi::state_of(word) == abi::BoardState::free) {
      over_ = 1;
    } else {
      const std::uint64_t slots =
          self_.topic.publisher(self_.index, offsetof(abi::PublisherEntry, slot_count))
              .load(std::memory_order_relaxed);
      AGNOCAST_STEP(P7_slots)
      slots_.grow(slots);
    }
    if (over_ != 0 || abi::state_of(word) != abi::BoardState::active) history_ = 0;
  }

  void refresh_endpoint(std::uint64_t index) noexcept {
    Endpoint& endpoint = at(index);
    std::uint64_t word = endpoint.word;
    AGNOCAST_STEP(P7_word)
    word = self_.topic.subscription(index, offsetof(abi::SubscriptionEntry, word))
               .load(std::memory_order_acquire);
    if (abi::generation_of(word) != abi::generation_of(endpoint.word)) {
      using Fields = abi::SubscriptionEntry;
      const auto field = [&](std::size_t offset) {
        return self_.topic.subscription(index, offset).load(std::memory_order_relaxed);
      };
      const abi::Qos qos =
          abi::unpack_qos({field(offsetof(Fields, policies)), field(offsetof(Fields, deadline_ns)),
                           0, field(offsetof(Fields, lease_ns))});
      if (!M::holds(steps::P7_match, abi::endpoints_match({self_.qos, self_.client},
                                                          {qos, field(offsetof(Fields, client))})))
        word = abi::pack_board_word(abi::generation_of(word), abi::BoardState::free);
      AGNOCAST_STEP(P7_reach) endpoint.reach = abi::reach_of(qos);
      endpoint.bound = qos.keep_all && qos.reliable ? qos.depth : 0;
      endpoint.reliable = qos.reliable;
      endpoint.quota = field(offsetof(Fields, quota));
      end_withdrawal(index);
      endpoint.since = head_sequence_ + 1;
      AGNOCAST_STEP(P7_since)
      endpoint.since = region::minus_at_least(seen_ + 1, history_, self_.first_sequence + 1);
      endpoint.low = endpoint.since;
    } else if (endpoint.word != word && !abi::takes_part(endpoint.word)) {
      word = abi::pack_board_word(abi::generation_of(word),
                                  abi::BoardState::free);  // refused or over: it stays so
    } else if (endpoint.withdrawn_at != 0 && abi::takes_part(word)) {
      word = endpoint.word;
    }
    endpoint.word = word;
  }

  void say_withdrawal(std::uint64_t index, abi::Withdrawal why) noexcept {
    auto&& word = self_.words.withdrawn(index);
    const std::uint64_t others = word.load(std::memory_order_relaxed) &
                                 ~abi::pack_withdrawal(index, static_cast<abi::Withdrawal>(3));
    // [sync:hold] release, before the fence of a later scan; pairs with the seq_cst load at T5.
    AGNOCAST_STEP(E1_withdraw)
    word.store(others | abi::pack_withdrawal(index, why), std::memory_order_release);
  }

  void end_withdrawal(std::uint64_t index) noexcept {
    Endpoint& endpoint = at(index);
    if (endpoint.withdrawn_at == 0) return;
    endpoint.withdrawn_at = 0;
    say_withdrawal(index, abi::Withdrawal::none);
  }

  /// P8: rings once per wait set and sleep.
  template <class Environment>
  void ring_wait_sets(Environment& environment) noexcept {
    for (const Endpoint& endpoint : endpoints()) {
      if (abi::state_of(endpoint.word) != abi::BoardState::active) continue;
      if (endpoint.attached_generation != abi::generation_of(endpoint.word))
        continue;  // J7 rings it once it is mapped
      std::uint64_t armed = 0;
      // [sync:sleep] relaxed behind the fence of P6; pairs with S1, S2: either this sees the
      // wait set or its re-check sees the commit.
      AGNOCAST_STEP(P8_armed)
      armed = M::word(endpoint.region, endpoint.armed_offset).load(std::memory_order_relaxed);
      std::uint64_t& rung = places_->rung[endpoint.wait_set];
      if (!M::holds(steps::P8_asleep, (armed & 1) != 0 && armed != rung)) continue;
      AGNOCAST_STEP(P8_rung) rung = armed;
      AGNOCAST_STEP(P8_ring) environment.ring(endpoint.wait_set, armed);
    }
  }

  template <class Environment>
  bool may_defer_scan(const Environment& environment) noexcept {
    if (deferred_scans_ >= self_.deferred_limit) return false;
    if (kept_back_ <= kept_back_max) return true;
    // Only once: if no other thread makes that scan, the next publish does.
    if constexpr (requires { environment.scans_soon(); })
      return std::exchange(left_, 1) == 0 && environment.scans_soon();
    return false;
  }

  struct Unknown {
    std::uint64_t from, to;
  };
  template <class Environment>
  void scan(Environment& environment, bool after_commit) noexcept {
    // [sync:hold] seq_cst; pairs with T4 and T5: either this scan sees a take that validated an
    // entry, or that take sees the mark made before this fence.
    AGNOCAST_STEP(P6_fence) M::fence();
    refresh_endpoints();
    if (after_commit) {
      ring_wait_sets(environment);
      if (may_defer_scan(environment)) {
        ++deferred_scans_;
        return;
      }
    }
    deferred_scans_ = 0;
    kept_back_ = 0;
    left_ = 0;

    std::uint64_t need = region::minus_at_least(head_sequence_ + 1, history_, 0);
    std::uint64_t past = infinite;
    Unknown unknown{infinite, 0};
    typename Slots::Mask held;  // as far as words_in_use()
    std::fill_n(held.begin(), slots_.words_in_use(), 0);
    for (Endpoint& endpoint : endpoints()) {
      if (over_ != 0 || !abi::takes_part(endpoint.word)) continue;
      const bool leaving = abi::state_of(endpoint.word) == abi::BoardState::leaving;
      const bool mapped = endpoint.attached_generation == abi::generation_of(endpoint.word);
      std::uint64_t low = endpoint.since;
      if (mapped) {
        const region::LinkWords<M> link{endpoint.region, endpoint.line};
        // [sync:link] acquire; pairs with the seq_cst store at J6: the cursor read next is at least
        // the one it was linked with.
        const bool linked = M::holds(
            steps::P9_linked,
            link.publisher_generation().load(std::memory_order_acquire) == self_.generation);
        if (linked) {
          // [sync:direct-free] acquire, before the holds; pairs with T7: behind a passed cursor a
          // clear bit means released.
          AGNOCAST_STEP(P9_cursor) low = link.cursor().load(std::memory_order_acquire);
          AGNOCAST_STEP(P9_hold) collect_holds(link, endpoint, held);
        }
      } else {
        AGNOCAST_STEP(P9_unknown) unknown.from = std::min(unknown.from, endpoint.since);
        unknown.to =
            std::max(unknown.to, endpoint.withdrawn_at != 0 ? endpoint.withdrawn_at : infinite);
      }
      if (leaving) low = infinite;
      endpoint.low = low;
      past = std::min(past, low);
      if (!leaving)
        need = std::min(
            need, std::max(low, region::minus_at_least(head_sequence_ + 1, endpoint.reach, 0)));
    }
    retire_and_free(environment, need, past, unknown, held);
  }

  /// An honest subscription takes nothing while it holds its quota. One that holds more could take
  /// all slots of this publisher; from now on its holds are ignored, and its messages may be
  /// overwritten.
  void collect_holds(const region::LinkWords<M>& link, Endpoint& endpoint,
                     typename Slots::Mask& held) noexcept {
    if (endpoint.withdrawn_at != 0) [[unlikely]]
      return collect_last_holds(link, endpoint, held);
    const std::size_t words = slots_.words_in_use();
    std::uint64_t count = 0;
    for (std::size_t word = 0; word < words; ++word) {
      if (slots_.allocated(word) == 0) continue;
      // [sync:hold] acquire; pairs with the release of L1: what the holder read, it read before
      // this message is destroyed.
      const std::uint64_t bits = link.hold(word).load(std::memory_order_acquire);
      held[word] |= bits;
      if (bits != 0)
        count += static_cast<std::uint64_t>(std::popcount(bits & slots_.allocated(word)));
    }
    const std::uint64_t quota = std::min(endpoint.quota, endpoint.limit - 1);
    if (count > quota && slots_.holds_too_many(link, quota)) {
      endpoint.withdrawn_at = head_sequence_;
      endpoint.word =
          abi::pack_board_word(abi::generation_of(endpoint.word), abi::BoardState::free);
      say_withdrawal(static_cast<std::uint64_t>(&endpoint - endpoints().data()),
                     abi::Withdrawal::over_quota);
    }
  }

  /// Collects the holds of a withdrawn endpoint. It was notified before the fence of this scan, so
  /// it takes nothing that this look has not seen.
  void collect_last_holds(const region::LinkWords<M>& link, Endpoint& endpoint,
                          typename Slots::Mask& held) const noexcept {
    std::uint64_t any = 0;
    for (std::size_t word = 0; word < slots_.words_in_use(); ++word) {
      if (slots_.allocated(word) == 0) continue;
      const std::uint64_t bits = slots_.published_before(
          endpoint.withdrawn_at, word, link.hold(word).load(std::memory_order_acquire));
      held[word] |= bits;
      any |= bits;
    }
    if (M::holds(steps::E2_clear, any == 0))
      endpoint.word =
          abi::pack_board_word(abi::generation_of(endpoint.word), abi::BoardState::free);
  }

  template <class Environment>
  void retire_and_free(Environment& environment, std::uint64_t need, std::uint64_t past,
                       Unknown unknown, const typename Slots::Mask& held) noexcept {
    slots_.for_each([&](std::uint64_t slot) {
      const std::uint64_t sequence = slots_.sequence(slot);
      // Retired by an earlier scan: this one marks a slot below, after its decision. So the mark is
      // older than the fence at P6.
      const bool retired = slots_.is_retired(slot);
      if (!M::holds(steps::P10_needed, sequence < need) && !retired) return;
      const bool untouchable =
          M::holds(steps::P10_past, sequence < past) || M::holds(steps::P10_marked, retired);
      if (untouchable && !M::holds(steps::P10_held, Slots::test(held, slot)) &&
          (sequence < unknown.from || sequence > unknown.to)) {
        AGNOCAST_STEP(P10_free) self_.words.slot_id(slot).store(0, std::memory_order_release);
        slots_.free(slot);
        environment.freed(slot, slots_.address(slot));
      } else if (!retired) {
        // [sync:hold] release, before the fence of a later scan; pairs with the seq_cst load of T5.
        AGNOCAST_STEP(P10_retire)
        self_.words.slot_id(slot).store(abi::retired_mark | sequence, std::memory_order_release);
        slots_.retire(slot);
      }
    });
  }

  Identity self_;
  std::uint64_t head_sequence_;
  std::uint64_t seen_;  // head at the last epoch check
  std::uint64_t epoch_seen_ = 0;
  std::uint64_t history_;   // H
  std::uint64_t over_ = 0;  // 1: the daemon has freed this publisher's index
  std::uint64_t deferred_scans_ = 0;
  std::uint64_t kept_back_ = 0;  // bytes published since the last look at links
  std::uint64_t left_ = 0;       // 1: the scan after a large message was left to another thread
  std::uint64_t endpoint_high_ = 0;
  Slots slots_;
  struct Places {
    std::array<Endpoint, M::subscription_capacity> endpoints;
    std::array<std::uint64_t, M::subscription_capacity> rung;  // per wait set: the last rung sleep
  };
  typename M::template Zeroed<Places> places_;
};

}  // namespace agnocast::dataplane
