// SPDX-License-Identifier: Apache-2.0
//
// Every bound of the system, each with its reason. A limit exists here and nowhere else.
#pragma once

#include <cstdint>

namespace agnocast::abi {

// 64 bytes: the cache line of every x86-64 and of the AArch64 cores of interest; 128-byte prefetch
// pairs only cost speed.
inline constexpr std::uint64_t cache_line_bytes = 64;
// Extents are handed out in pages, so that one fallocate covers exactly one owner's metadata.
inline constexpr std::uint64_t page_bytes = 4096;

// Deepest keep-last or keep-all history of either side. rclcpp's own deepest default is 1000
// (/parameter_events).
inline constexpr std::uint32_t depth_max = 1000;
// Order ring of a publisher: a power of two above the widest window (depth_max, and one more for
// keep-all), so that the entry it overwrites is outside every window.
inline constexpr std::uint32_t ring_count = 1024;
static_assert(ring_count > depth_max + 1 && (ring_count & (ring_count - 1)) == 0);

// Slots of one publisher: the deepest history plus as many messages again that subscriptions may
// hold. 32 B each = 64 KiB.
inline constexpr std::uint32_t slot_count_max = 2048;
static_assert(slot_count_max <= 0x10000, "a slot index is 16 bits of the commit word");
// Publishes in a row that may leave out the look at what may be freed (docs/protocol.md, lazy pass): what
// they would have freed needs a slot each.
inline constexpr std::uint32_t lazy_pass_count_max = 32;
// Slots whose hold bits share the link line; 6 words are what one line has left beside generation
// and cursor.
inline constexpr std::uint32_t near_slot_count = 384;

// One topic's board entry is 64 KiB = 2 lines + (254 + 768) lines: wide topics (128 endpoints of
// each kind are asked for) with room.
inline constexpr std::uint32_t publisher_count_max = 254;
inline constexpr std::uint32_t subscription_count_max = 768;
// Publishers of one topic that are gone and not read to their end: what the 128 that are asked for
// leave of the indexes. Of more, the oldest are given up, so that nobody keeps others from joining by
// not reading. Where [limits] allows fewer publishers, half of those.
inline constexpr std::uint32_t orphan_count_max = publisher_count_max - 128;
// 4096 topics × 64 KiB = 256 MiB of addresses, touched only where topics exist.
inline constexpr std::uint32_t topic_count_max = 4096;

// Processes registered at once. A thousand are asked for; the daemon keeps one bit per process for
// everything it announces.
inline constexpr std::uint32_t client_count_max = 2048;

// Heap windows of one process: the first and its growth (each the configured length, 16 GiB by
// default).
inline constexpr std::uint32_t window_count_max = 8;
// How often one process is asked to allocate elsewhere because a reader cannot map where it does: each
// takes a window, and as many again stay to grow in.
inline constexpr std::uint32_t heap_move_max = 3;
// Ranges of the arena that one process can say it has not got; it makes the last as wide as it needs.
inline constexpr std::uint32_t blocked_count_max = 16;
// Where windows begin and how long they are: whole huge pages, so that the kernel can use them.
inline constexpr std::uint64_t window_granule_bytes = 2 << 20;
// Connections of one user that only look. Each may let the daemon keep one dump for it.
inline constexpr std::uint32_t observer_count_max = 8;

// Executors of one process, one for each of its nodes with callbacks: one line each in what the
// first page of the client region has left beside the windows. Containers of more nodes exist, but
// are rare.
inline constexpr std::uint32_t executor_count_max = 56;

}  // namespace agnocast::abi
