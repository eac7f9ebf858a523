// SPDX-License-Identifier: Apache-2.0
//
// Limits: what other participants in DDS may make the bridge keep. Nobody in a DDS domain is
// trusted, so each number bounds what one participant takes from the others, or what all take from
// this host. A refusal costs only its own endpoint or message, and is counted by its reason: see
// the status, and the table in docs/bridge.md.
//
// Memory that Cyclone DDS keeps itself is not bounded here: see "Limits" in docs/bridge.md.
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
  history_bytes_of_remote_publisher,
  history_bytes,
  requests,
  request_bytes_of_service,
  discovery_info_bytes,
  count
};

struct LimitRow {
  Limit limit;
  const char* name;  ///< its name in the status
  std::size_t most;
};

inline constexpr std::size_t mebibyte = std::size_t{1} << 20;

inline constexpr LimitRow limit_table[] = {
    // ROS 2 has one for each process, and DDS has ports for 120 on a host: eight full hosts.
    {Limit::participants, "participants", 1'024},
    // A plan reads all of them: some 50 ms.
    {Limit::endpoints, "endpoints", 32'768},
    // 200 nodes in one process, with 20 endpoints each.
    {Limit::endpoints_of_participant, "endpoints_of_participant", 4'096},
    // ROS names have at most 255 bytes, and its USER_DATA is an enclave's name or a client's id.
    {Limit::text_bytes, "text_bytes", 1'024},
    // Four frames of 8K video, uncompressed; two seconds of a gigabit link.
    {Limit::message_bytes, "message_bytes", 256 * mebibyte},
    // As CDR, received and not yet taken. One message is always accepted.
    {Limit::unread_bytes_of_reader, "unread_bytes_of_reader", 256 * mebibyte},
    // All readers together: two flooded readers leave one message to each of the others.
    {Limit::unread_bytes, "unread_bytes", 512 * mebibyte},
    // For writers that the next plan will know: the size of ROS's /rosout history.
    {Limit::unplaced_messages, "unplaced_messages", 1'000},
    // As CDR, the history of a transient-local writer that its publisher here keeps: ten point
    // clouds of 6 MB.
    {Limit::history_bytes_of_remote_publisher, "history_bytes_of_remote_publisher", 64 * mebibyte},
    // All histories together.
    {Limit::history_bytes, "history_bytes", 512 * mebibyte},
    // Pending at one service: a hundred times the depth of a ROS 2 client. Beyond it, the client
    // with most loses one.
    {Limit::requests, "requests", 1'000},
    // A quarter of the bytes that the requests of all services may take.
    {Limit::request_bytes_of_service, "request_bytes_of_service", 64 * mebibyte},
    // The nodes of all participants, in memory: 3,000 nodes with 100 endpoints each.
    {Limit::discovery_info_bytes, "discovery_info_bytes", 8 * mebibyte},
};
static_assert(sizeof limit_table / sizeof *limit_table == static_cast<std::size_t>(Limit::count));

constexpr std::size_t most_of(Limit limit) noexcept {
  return limit_table[static_cast<std::size_t>(limit)].most;
}

/// Counts the refusals of each limit. Any thread.
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
