// SPDX-License-Identifier: Apache-2.0
//
// Packed 8-byte words of the shared regions. A word is the unit of commitment: one aligned store
// is never torn, so a reader sees either the old or the new state.
#pragma once

#include <cstdint>

namespace agnocast::abi {

// --- commit word and order ring: sequence number in the upper 48 bits, slot index in the lower 16
//
//   63                                    16 15        0
//   +---------------------------------------+-----------+
//   |               sequence                |   slot    |
//   +---------------------------------------+-----------+
constexpr std::uint64_t pack_entry(std::uint64_t sequence, std::uint64_t slot) noexcept {
  return sequence << 16 | slot;
}
constexpr std::uint64_t sequence_of(std::uint64_t entry) noexcept { return entry >> 16; }
constexpr std::uint32_t slot_of(std::uint64_t entry) noexcept {
  return static_cast<std::uint32_t>(entry & 0xffff);
}

// --- slot id: 0 free, sequence live, retired_mark | sequence retired
inline constexpr std::uint64_t retired_mark = std::uint64_t{1} << 63;

// First sequence number of a publisher generation: 2^32 apart, so that the spaces of successive
// publishers in one index do not overlap unless one publishes more than 2^32 messages (five days
// at 10 kHz; then only this second line of defence is gone). The highest is 2^47, so 48 bits
// leave room for 2^47 messages. The +1 keeps sequence 0 for "nothing yet".
constexpr std::uint64_t first_sequence_of(std::uint64_t generation) noexcept {
  return (generation % 0x7fff + 1) << 32;
}

// --- state word of an endpoint: generation (never reused) in the upper 48 bits, flags, state
//
//   63                                    16 15     8 7      0
//   +---------------------------------------+--------+--------+
//   |              generation               | flags  | state  |
//   +---------------------------------------+--------+--------+
enum class BoardState : std::uint8_t {
  free = 0,
  active = 1,
  leaving = 2,  // a subscription that takes no more; its holds still count
  orphan = 3,   // a publisher that publishes no more; its committed messages are still delivered
  revoked = 4,  // reserved: never stored
  dead = 5,     // its process is dead
};
constexpr std::uint64_t pack_board_word(std::uint64_t generation, BoardState state) noexcept {
  return generation << 16 | static_cast<std::uint64_t>(state);
}
constexpr std::uint64_t generation_of(std::uint64_t board_word) noexcept {
  return board_word >> 16;
}
constexpr BoardState state_of(std::uint64_t board_word) noexcept {
  return static_cast<BoardState>(board_word & 0xff);
}
/// Returns whether the holds of the subscription with this board word count.
constexpr bool takes_part(std::uint64_t board_word) noexcept {
  const BoardState state = state_of(board_word);
  return state == BoardState::active || state == BoardState::leaving;
}

// --- quality of service, evaluated by both sides of a match
struct Qos {
  std::uint32_t depth = 1;
  bool transient_local = false;
  bool reliable = true;
  bool keep_all = false;
  bool ignore_local = false;       // matches no publisher of its own process
  bool manual_liveliness = false;  // asserted for each topic; otherwise the process is alive
  // Nanoseconds; 0: none.
  std::uint64_t deadline_ns = 0;  // between two messages
  std::uint64_t lifespan_ns = 0;  // of messages, so of publishers
  std::uint64_t lease_ns = 0;     // of liveliness
};
// The longest time: a signed number of nanoseconds, 292 years.
inline constexpr std::uint64_t qos_time_max_ns = INT64_MAX;
//   bits 0-15 depth · bit 16 transient_local · bit 17 reliable · bit 18 keep_all ·
//   bit 19 ignore_local, of subscriptions · bit 20 manual_liveliness
constexpr std::uint64_t pack_policies(const Qos& qos) noexcept {
  return (qos.depth & 0xffff) | std::uint64_t{qos.transient_local} << 16 |
         std::uint64_t{qos.reliable} << 17 | std::uint64_t{qos.keep_all} << 18 |
         std::uint64_t{qos.ignore_local} << 19 | std::uint64_t{qos.manual_liveliness} << 20;
}
inline constexpr std::uint64_t policy_bits = 0x1fffff;
// As it travels, and as the daemon stores it.
struct QosWords {
  std::uint64_t policies;
  std::uint64_t deadline_ns;
  std::uint64_t lifespan_ns;
  std::uint64_t lease_ns;
};
constexpr QosWords pack_qos(const Qos& qos) noexcept {
  return {pack_policies(qos), qos.deadline_ns, qos.lifespan_ns, qos.lease_ns};
}
constexpr Qos unpack_qos(const QosWords& words) noexcept {
  const auto bit = [&](int number) { return (words.policies >> number & 1) != 0; };
  return {static_cast<std::uint32_t>(words.policies & 0xffff),
          bit(16),
          bit(17),
          bit(18),
          bit(19),
          bit(20),
          words.deadline_ns,
          words.lifespan_ns,
          words.lease_ns};
}
// The policy that prevents a match, numbered as in rmw_qos_policy_kind_t.
enum class QosPolicy : std::uint32_t {
  none = 0,
  durability = 1 << 1,
  deadline = 1 << 2,
  liveliness = 1 << 3,
  reliability = 1 << 4,
  liveliness_lease = 1 << 8,
};
// Returns whether a time is longer; none is the longest.
constexpr bool is_longer(std::uint64_t time_ns, std::uint64_t than_ns) noexcept {
  return time_ns - 1 > than_ns - 1;  // 0 becomes the largest number
}
// Returns the first policy where the request exceeds the offer (DDS 1.4, 2.2.3); as in DDS, later
// policies are not evaluated.
constexpr QosPolicy qos_mismatch(const Qos& offered, const Qos& requested) noexcept {
  if (requested.reliable && !offered.reliable) return QosPolicy::reliability;
  if (requested.transient_local && !offered.transient_local) return QosPolicy::durability;
  if (is_longer(offered.deadline_ns, requested.deadline_ns)) return QosPolicy::deadline;
  if (requested.manual_liveliness && !offered.manual_liveliness) return QosPolicy::liveliness;
  if (is_longer(offered.lease_ns, requested.lease_ns)) return QosPolicy::liveliness_lease;
  return QosPolicy::none;
}
constexpr bool qos_match(const Qos& offered, const Qos& requested) noexcept {
  return qos_mismatch(offered, requested) == QosPolicy::none;
}
// Whether two endpoints match, each with the index of its process.
struct QosOf {
  Qos qos;
  std::uint64_t client;
};
constexpr bool endpoints_match(const QosOf& offered, const QosOf& requested) noexcept {
  return qos_match(offered.qos, requested.qos) &&
         !(requested.qos.ignore_local && offered.client == requested.client);
}
// Returns how many of the newest messages a subscription can still take. A keep-all one has one
// more than its bound: while it joins, the publisher may commit one message before it learns
// about the subscription that it must wait for.
constexpr std::uint32_t reach_of(const Qos& requested) noexcept {
  return requested.depth + (requested.keep_all ? 1 : 0);
}

// --- withdrawal: why a publisher stopped serving a subscription, two bits for each subscription
//
//   bits 2i and 2i+1 of word w: the subscription with board index 32×w + i
enum class Withdrawal : std::uint8_t {
  none = 0,
  over_quota = 1,    // it holds more messages than allowed
  over_share = 2,    // its user holds more than its share of bytes, while the heap is full
  not_attached = 3,  // the publisher's process could not map it
};
inline constexpr std::uint64_t withdrawals_per_word = 32;
constexpr std::uint64_t pack_withdrawal(std::uint64_t subscription, Withdrawal why) noexcept {
  return static_cast<std::uint64_t>(why) << subscription % withdrawals_per_word * 2;
}
constexpr Withdrawal withdrawal_of(std::uint64_t word, std::uint64_t subscription) noexcept {
  return static_cast<Withdrawal>(word >> subscription % withdrawals_per_word * 2 & 3);
}

// --- intent.op: the operation of a publisher that a death interrupts
inline constexpr std::uint64_t intent_idle = 0;
inline constexpr std::uint64_t intent_publish = 1;
// After the loss of the daemon's store: this queue gets no more messages, its publisher has moved
// to another one. Only readers of the previous session read it; no daemon does, because the one
// that made the region is gone.
inline constexpr std::uint64_t intent_moved = 2;
// Cursor of a link whose subscription closed while there was no daemon to tell: publishers do not
// wait for it. Sequence numbers have 48 bits, so this is beyond all of them.
inline constexpr std::uint64_t cursor_aside = std::uint64_t{1} << 62;

}  // namespace agnocast::abi
