// SPDX-License-Identifier: Apache-2.0
//
// Board steps: the daemon's changes to the endpoints of one topic. docs/protocol.md,
// "Join, leave, death".
//
// Descriptor, then word (release), then epoch (seq_cst), always in this order: a process that
// sees the epoch sees the word, and one that sees the word sees the descriptor. Every function
// may be repeated after a crash of the daemon: an extra epoch is harmless.
#pragma once

#include <journal/steps.hpp>
#include <region/views.hpp>

#include <algorithm>
#include <cstddef>
#include <cstdint>

namespace agnocast::journal {

struct SubscriptionDescriptor {
  abi::Qos qos;
  std::uint64_t client = 0;
  std::uint64_t extent = 0;
  std::uint64_t quota = 0;
  std::uint64_t wait_set = 0;
};

struct PublisherDescriptor {
  abi::Qos qos;
  std::uint64_t client = 0;
  std::uint64_t extent = 0;
  std::uint64_t slot_count = 0;
};

template <class M>
class BoardSteps {
 public:
  explicit BoardSteps(region::TopicWords<M> topic) noexcept : topic_(topic) {}

  void add_subscription(std::uint64_t index, std::uint64_t generation,
                        const SubscriptionDescriptor& descriptor) noexcept {
    using Entry = abi::SubscriptionEntry;
    AGNOCAST_STEP(J3_descriptor) {
      topic_.subscription(index, offsetof(Entry, policies))
          .store(abi::pack_policies(descriptor.qos), std::memory_order_relaxed);
      AGNOCAST_CRASH_POINT(B_board_field);
      topic_.subscription(index, offsetof(Entry, client))
          .store(descriptor.client, std::memory_order_relaxed);
      AGNOCAST_CRASH_POINT(B_board_field);
      topic_.subscription(index, offsetof(Entry, extent))
          .store(descriptor.extent, std::memory_order_relaxed);
      AGNOCAST_CRASH_POINT(B_board_field);
      topic_.subscription(index, offsetof(Entry, quota))
          .store(descriptor.quota, std::memory_order_relaxed);
      AGNOCAST_CRASH_POINT(B_board_field);
      topic_.subscription(index, offsetof(Entry, wait_set))
          .store(descriptor.wait_set, std::memory_order_relaxed);
      AGNOCAST_CRASH_POINT(B_board_field);
      topic_.subscription(index, offsetof(Entry, deadline_ns))
          .store(descriptor.qos.deadline_ns, std::memory_order_relaxed);
      AGNOCAST_CRASH_POINT(B_board_field);
      topic_.subscription(index, offsetof(Entry, lease_ns))
          .store(descriptor.qos.lease_ns, std::memory_order_relaxed);
    }
    raise(topic_.subscription_high(), index + 1);
    AGNOCAST_STEP(J3_word)
    topic_.subscription(index, offsetof(Entry, word))
        .store(abi::pack_board_word(generation, abi::BoardState::active),
               std::memory_order_release);
    AGNOCAST_STEP(J3_epoch) bump_epoch();
  }

  void add_publisher(std::uint64_t index, std::uint64_t generation,
                     const PublisherDescriptor& descriptor) noexcept {
    using Entry = abi::PublisherEntry;
    AGNOCAST_STEP(J3_descriptor) {
      topic_.publisher(index, offsetof(Entry, policies))
          .store(abi::pack_policies(descriptor.qos), std::memory_order_relaxed);
      AGNOCAST_CRASH_POINT(B_board_field);
      topic_.publisher(index, offsetof(Entry, client))
          .store(descriptor.client, std::memory_order_relaxed);
      AGNOCAST_CRASH_POINT(B_board_field);
      topic_.publisher(index, offsetof(Entry, extent))
          .store(descriptor.extent, std::memory_order_relaxed);
      AGNOCAST_CRASH_POINT(B_board_field);
      topic_.publisher(index, offsetof(Entry, slot_count))
          .store(descriptor.slot_count, std::memory_order_relaxed);
      AGNOCAST_CRASH_POINT(B_board_field);
      topic_.publisher(index, offsetof(Entry, deadline_ns))
          .store(descriptor.qos.deadline_ns, std::memory_order_relaxed);
      AGNOCAST_CRASH_POINT(B_board_field);
      topic_.publisher(index, offsetof(Entry, lease_ns))
          .store(descriptor.qos.lease_ns, std::memory_order_relaxed);
      AGNOCAST_CRASH_POINT(B_board_field);
      topic_.publisher(index, offsetof(Entry, final_head)).store(0, std::memory_order_relaxed);
    }
    raise(topic_.publisher_high(), index + 1);
    AGNOCAST_STEP(J3_word)
    topic_.publisher(index, offsetof(Entry, word))
        .store(abi::pack_board_word(generation, abi::BoardState::active),
               std::memory_order_release);
    AGNOCAST_STEP(J3_epoch) bump_epoch();
  }

  /// Sets a subscription to leaving, dead or free; changes only the word.
  void set_subscription(std::uint64_t index, std::uint64_t generation,
                        abi::BoardState state) noexcept {
    AGNOCAST_STEP(D2_word)
    topic_.subscription(index, offsetof(abi::SubscriptionEntry, word))
        .store(abi::pack_board_word(generation, state), std::memory_order_release);
    AGNOCAST_STEP(D2_epoch) bump_epoch();
  }

  /// Ends a publisher that publishes no more (it died or left); its messages up to `final_head`
  /// are still delivered.
  void orphan_publisher(std::uint64_t index, std::uint64_t generation,
                        std::uint64_t final_head) noexcept {
    using Entry = abi::PublisherEntry;
    AGNOCAST_STEP(D3_final_head)
    topic_.publisher(index, offsetof(Entry, final_head))
        .store(final_head, std::memory_order_relaxed);
    set_publisher(index, generation, abi::BoardState::orphan);
  }
  void free_publisher(std::uint64_t index, std::uint64_t generation) noexcept {
    set_publisher(index, generation, abi::BoardState::free);
  }

  /// Makes all processes check the topic again.
  void renew() noexcept { AGNOCAST_STEP(J3_epoch) bump_epoch(); }

 private:
  void set_publisher(std::uint64_t index, std::uint64_t generation,
                     abi::BoardState state) noexcept {
    AGNOCAST_STEP(D3_word)
    topic_.publisher(index, offsetof(abi::PublisherEntry, word))
        .store(abi::pack_board_word(generation, state), std::memory_order_release);
    AGNOCAST_STEP(D3_epoch) bump_epoch();
  }
  void bump_epoch() noexcept {
    // [sync:join] seq_cst; pairs with the acquire at P7 behind the fence of P6. Only the daemon
    // writes it, so load and store suffice.
    topic_.epoch().store(topic_.epoch().load(std::memory_order_relaxed) + 1,
                         std::memory_order_seq_cst);
  }
  template <class Word>
  static void raise(Word&& word, std::uint64_t value) noexcept {
    if (word.load(std::memory_order_relaxed) >= value) return;
    AGNOCAST_CRASH_POINT(B_board_field);
    word.store(value, std::memory_order_release);
  }

  region::TopicWords<M> topic_;
};

}  // namespace agnocast::journal
