// SPDX-License-Identifier: Apache-2.0
//
// Limits: what others in DDS may make the bridge keep. Nobody in a DDS domain is known, so each number bounds what one of
// them takes from the others, or what all of them together take from this host. A refusal costs its own endpoint or
// message only, and is counted by its reason: the status says it, docs/bridge.md has the table.
//
// What Cyclone DDS keeps by itself is not bounded here: see "Limits" in docs/bridge.md.
#pragma once

#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>

namespace agnocast::bridge {

enum class Limit : std::uint8_t {
  participants,
  endpoints,
  endpoints_of_participant,
  text_bytes,
  message_bytes,
  unread_bytes_of_reader,
  unread_bytes,
  unplaced_messages,
  history_bytes_of_source,
  history_bytes,
  requests,
  request_bytes_of_service,
  discovery_info_bytes,
  count
};

struct LimitRow {
  Limit limit;
  const char* name;  ///< in the status
  std::size_t most;
};

inline constexpr std::size_t mebibyte = std::size_t{1} << 20;

inline constexpr LimitRow limit_table[] = {
    // ROS 2 has one for each process, and DDS has ports for 120 of a host: eight full hosts.
    {Limit::participants, "participants", 1'024},
    // A plan looks at all of them: some 50 ms.
    {Limit::endpoints, "endpoints", 32'768},
    // 200 nodes in one process, with 20 each.
    {Limit::endpoints_of_participant, "endpoints_of_participant", 4'096},
    // Names of ROS have at most 255 bytes, and its USER_DATA is an enclave's name or a client's id.
    {Limit::text_bytes, "text_bytes", 1'024},
    // Four frames of 8K video, uncompressed; two seconds of a gigabit link.
    {Limit::message_bytes, "message_bytes", 256 * mebibyte},
    // As CDR, received and not yet taken. One message is always taken.
    {Limit::unread_bytes_of_reader, "unread_bytes_of_reader", 256 * mebibyte},
    // Of all readers: two that are flooded leave one message to each of the others.
    {Limit::unread_bytes, "unread_bytes", 512 * mebibyte},
    // Of writers that the next plan will know: a history of ROS's /rosout.
    {Limit::unplaced_messages, "unplaced_messages", 1'000},
    // As CDR, the history of a transient-local writer that its publisher here retains: ten point clouds of 6 MB.
    {Limit::history_bytes_of_source, "history_bytes_of_source", 64 * mebibyte},
    // Of all of them.
    {Limit::history_bytes, "history_bytes", 512 * mebibyte},
    // Waiting for one service: a hundred times a client's depth in ROS 2. Beyond it who has most gives way to who has less.
    {Limit::requests, "requests", 1'000},
    // A quarter of what requests of all services may take.
    {Limit::request_bytes_of_service, "request_bytes_of_service", 64 * mebibyte},
    // What all participants say of their nodes, in memory: 3,000 nodes with 100 endpoints each.
    {Limit::discovery_info_bytes, "discovery_info_bytes", 8 * mebibyte},
};
static_assert(sizeof limit_table / sizeof *limit_table == static_cast<std::size_t>(Limit::count));

constexpr std::size_t most_of(Limit limit) noexcept {
  return limit_table[static_cast<std::size_t>(limit)].most;
}

/// How often each has refused something. Any thread.
class Limits {
 public:
  void refuse(Limit limit, std::uint64_t count = 1) noexcept {
    refused_[static_cast<std::size_t>(limit)].fetch_add(count, std::memory_order_relaxed);
  }
  std::uint64_t refused(Limit limit) const noexcept {
    return refused_[static_cast<std::size_t>(limit)].load(std::memory_order_relaxed);
  }

 private:
  std::array<std::atomic<std::uint64_t>, static_cast<std::size_t>(Limit::count)> refused_{};
};

}  // namespace agnocast::bridge
