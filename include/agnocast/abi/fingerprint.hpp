// SPDX-License-Identifier: Apache-2.0
//
// Fingerprint of everything that two processes must agree on: every size and offset of the shared
// regions and of the wire, every limit, every number that stands for something, and how words are
// packed. Compared exactly when a client says hello: two builds that differ never touch each other's
// memory. A field that is added to a struct is added here; tests/layout holds the value, so a change
// of it is a change somebody meant.
#pragma once

#include <agnocast/abi/board.hpp>
#include <agnocast/abi/client_region.hpp>
#include <agnocast/abi/limits.hpp>
#include <agnocast/abi/wire.hpp>
#include <agnocast/abi/words.hpp>

#include <cstddef>
#include <cstdint>

namespace agnocast::abi {

// Raised by hand when the meaning of a word changes while its place does not.
inline constexpr std::uint64_t layout_version = 1;

// FNV-1a over numbers, each as eight bytes: two different lists collide with probability 2^-64.
class Fingerprint {
 public:
  template <class... Numbers>
  constexpr Fingerprint& add(Numbers... numbers) noexcept {
    (add_one(static_cast<std::uint64_t>(numbers)), ...);
    return *this;
  }
  constexpr std::uint64_t value() const noexcept { return hash_; }

 private:
  constexpr void add_one(std::uint64_t number) noexcept {
    for (int byte = 0; byte < 8; ++byte)
      hash_ = (hash_ ^ (number >> 8 * byte & 0xff)) * 0x100000001b3;
  }
  std::uint64_t hash_ = 0xcbf29ce484222325;
};

constexpr std::uint64_t fingerprint() noexcept {
  Fingerprint sum;
  sum.add(layout_version, cache_line_bytes, page_bytes, depth_max, ring_count, slot_count_max,
          near_slot_count, publisher_count_max, subscription_count_max, topic_count_max,
          client_count_max, window_count_max, executor_count_max);
  // How words are packed, by what comes out for probes.
  sum.add(pack_entry(0x123456789abc, 0xdef0), sequence_of(0xfedcba9876543210),
          slot_of(0xfedcba9876543210), retired_mark, first_sequence_of(0x12345),
          pack_member(0x123456789abc, MemberState::leaving), generation_of(0xfedcba9876543210),
          pack_qos({0x1234, true, false, false, false}), pack_qos({0, false, true, false, false}),
          pack_qos({0, false, false, true, false}), window_of({7, false, true, true, false}),
          intent_idle, intent_publish);
  sum.add(QosPolicy::none, QosPolicy::durability, QosPolicy::reliability);
  sum.add(MemberState::free, MemberState::active, MemberState::leaving, MemberState::orphan,
          MemberState::revoked, MemberState::dead);
  sum.add(order_offset(3), slot_offset(ring_count, 3), link_offset(3), far_hold_offset(5, 3, 1),
          publisher_entry_offset(3), subscription_entry_offset(5, 3), topic_offset(3), topic_bytes);
  sum.add(sizeof(QueueSlot), offsetof(QueueSlot, id), offsetof(QueueSlot, address),
          offsetof(QueueSlot, stamp_ns), offsetof(QueueSlot, size));
  sum.add(sizeof(PublisherEndpoint), offsetof(PublisherEndpoint, head),
          offsetof(PublisherEndpoint, intent_op), offsetof(PublisherEndpoint, intent_sequence),
          offsetof(PublisherEndpoint, intent_slot));
  sum.add(sizeof(LinkLine), offsetof(LinkLine, publisher_generation), offsetof(LinkLine, cursor),
          offsetof(LinkLine, hold));
  sum.add(sizeof(ExecutorLine), offsetof(ExecutorLine, armed));
  sum.add(sizeof(WindowEntry), offsetof(WindowEntry, base), offsetof(WindowEntry, length),
          offsetof(WindowEntry, frontier), offsetof(WindowEntry, reserved));
  sum.add(sizeof(ClientRegionHeader), offsetof(ClientRegionHeader, magic),
          offsetof(ClientRegionHeader, fingerprint), offsetof(ClientRegionHeader, generation),
          offsetof(ClientRegionHeader, window), offsetof(ClientRegionHeader, reserved),
          offsetof(ClientRegionHeader, executor));
  sum.add(sizeof(BoardHeader), offsetof(BoardHeader, magic), offsetof(BoardHeader, fingerprint),
          offsetof(BoardHeader, incarnation));
  sum.add(sizeof(TopicHeader), offsetof(TopicHeader, epoch), offsetof(TopicHeader, word),
          offsetof(TopicHeader, publisher_high), offsetof(TopicHeader, subscription_high));
  sum.add(sizeof(PublisherEntry), offsetof(PublisherEntry, word), offsetof(PublisherEntry, qos),
          offsetof(PublisherEntry, client), offsetof(PublisherEntry, extent),
          offsetof(PublisherEntry, slot_count), offsetof(PublisherEntry, first_sequence),
          offsetof(PublisherEntry, final_head));
  sum.add(sizeof(SubscriptionEntry), offsetof(SubscriptionEntry, word),
          offsetof(SubscriptionEntry, qos), offsetof(SubscriptionEntry, client),
          offsetof(SubscriptionEntry, extent), offsetof(SubscriptionEntry, quota),
          offsetof(SubscriptionEntry, executor));
  sum.add(sizeof(wire::Header), offsetof(wire::Header, opcode), offsetof(wire::Header, bytes),
          offsetof(wire::Header, request));
  sum.add(sizeof(wire::Hello), offsetof(wire::Hello, header), offsetof(wire::Hello, fingerprint),
          offsetof(wire::Hello, domain), offsetof(wire::Hello, process_name));
  sum.add(sizeof(wire::Welcome), offsetof(wire::Welcome, header),
          offsetof(wire::Welcome, fingerprint), offsetof(wire::Welcome, incarnation),
          offsetof(wire::Welcome, client), offsetof(wire::Welcome, client_generation),
          offsetof(wire::Welcome, arena_base), offsetof(wire::Welcome, arena_bytes),
          offsetof(wire::Welcome, client_region_bytes));
  sum.add(sizeof(wire::Reference), offsetof(wire::Reference, header),
          offsetof(wire::Reference, kind), offsetof(wire::Reference, topic),
          offsetof(wire::Reference, index), offsetof(wire::Reference, generation));
  sum.add(sizeof(wire::Unlinked), offsetof(wire::Unlinked, header), offsetof(wire::Unlinked, kind),
          offsetof(wire::Unlinked, topic), offsetof(wire::Unlinked, index),
          offsetof(wire::Unlinked, generation), offsetof(wire::Unlinked, seen));
  sum.add(sizeof(wire::WindowRequest), offsetof(wire::WindowRequest, header),
          offsetof(wire::WindowRequest, window));
  sum.add(sizeof(wire::WindowOpened), offsetof(wire::WindowOpened, header),
          offsetof(wire::WindowOpened, window), offsetof(wire::WindowOpened, base),
          offsetof(wire::WindowOpened, bytes));
  sum.add(sizeof(wire::WindowAnnounced), offsetof(wire::WindowAnnounced, header),
          offsetof(wire::WindowAnnounced, client),
          offsetof(wire::WindowAnnounced, client_generation),
          offsetof(wire::WindowAnnounced, window), offsetof(wire::WindowAnnounced, base),
          offsetof(wire::WindowAnnounced, bytes));
  sum.add(sizeof(wire::ExecutorRequest), offsetof(wire::ExecutorRequest, header),
          offsetof(wire::ExecutorRequest, executor));
  sum.add(sizeof(wire::CreateEndpoint), offsetof(wire::CreateEndpoint, header),
          offsetof(wire::CreateEndpoint, qos), offsetof(wire::CreateEndpoint, layout_hash),
          offsetof(wire::CreateEndpoint, executor), offsetof(wire::CreateEndpoint, quota),
          offsetof(wire::CreateEndpoint, topic), offsetof(wire::CreateEndpoint, type),
          offsetof(wire::CreateEndpoint, node));
  sum.add(sizeof(wire::EndpointCreated), offsetof(wire::EndpointCreated, header),
          offsetof(wire::EndpointCreated, topic), offsetof(wire::EndpointCreated, reserved),
          offsetof(wire::EndpointCreated, index), offsetof(wire::EndpointCreated, generation),
          offsetof(wire::EndpointCreated, extent), offsetof(wire::EndpointCreated, slot_count),
          offsetof(wire::EndpointCreated, first_sequence));
  sum.add(sizeof(wire::Announcement), offsetof(wire::Announcement, header),
          offsetof(wire::Announcement, kind), offsetof(wire::Announcement, topic),
          offsetof(wire::Announcement, own_index), offsetof(wire::Announcement, own_generation),
          offsetof(wire::Announcement, index), offsetof(wire::Announcement, generation),
          offsetof(wire::Announcement, client), offsetof(wire::Announcement, client_generation),
          offsetof(wire::Announcement, extent), offsetof(wire::Announcement, qos),
          offsetof(wire::Announcement, first_sequence), offsetof(wire::Announcement, executor),
          offsetof(wire::Announcement, from_start), offsetof(wire::Announcement, window_count),
          offsetof(wire::Announcement, doorbell_count), offsetof(wire::Announcement, reserved),
          offsetof(wire::Announcement, window));
  sum.add(sizeof(wire::Orphaned), offsetof(wire::Orphaned, header), offsetof(wire::Orphaned, topic),
          offsetof(wire::Orphaned, reserved), offsetof(wire::Orphaned, index),
          offsetof(wire::Orphaned, generation), offsetof(wire::Orphaned, final_head));
  sum.add(sizeof(wire::Refused), offsetof(wire::Refused, header), offsetof(wire::Refused, code),
          offsetof(wire::Refused, os_errno), offsetof(wire::Refused, text));
  sum.add(sizeof(wire::Notice), offsetof(wire::Notice, header), offsetof(wire::Notice, code),
          offsetof(wire::Notice, kind), offsetof(wire::Notice, topic),
          offsetof(wire::Notice, policy), offsetof(wire::Notice, index),
          offsetof(wire::Notice, generation), offsetof(wire::Notice, text));
  sum.add(sizeof(wire::Done), offsetof(wire::Done, header));
  sum.add(wire::version, wire::name_bytes, wire::packet_bytes_max, wire::descriptor_count_max,
          sizeof(wire::Announcement::Window));
  using wire::Opcode;
  sum.add(Opcode::hello, Opcode::open_window, Opcode::open_executor, Opcode::create_publisher,
          Opcode::create_subscription, Opcode::leave, Opcode::drained, Opcode::unlinked,
          Opcode::welcome, Opcode::window_opened, Opcode::executor_opened, Opcode::endpoint_created,
          Opcode::done, Opcode::refused, Opcode::announce, Opcode::window_announced, Opcode::forget,
          Opcode::orphaned, Opcode::kick, Opcode::notice);
  sum.add(wire::Kind::publisher, wire::Kind::subscription, wire::Kind::region);
  return sum.value();
}

}  // namespace agnocast::abi
