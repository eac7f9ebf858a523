// SPDX-License-Identifier: Apache-2.0
//
// Every bound of the system, each with its reason. A limit exists here and nowhere else.
#pragma once

#include <cstdint>

namespace agnocast::abi {

// 64 bytes: the cache line of every x86-64 and of the AArch64 cores of interest; 128-byte
// prefetch pairs only cost speed.
inline constexpr std::uint64_t cache_line_bytes = 64;
// The daemon assigns extents in pages, so that one fallocate covers exactly one owner's metadata.
inline constexpr std::uint64_t page_bytes = 4096;

// Deepest keep-last or keep-all history of either side. rclcpp's deepest default is 1000
// (/parameter_events).
inline constexpr std::uint32_t depth_max = 1000;
// Order ring of a publisher: a power of two above the widest reach (depth_max, and one more for
// keep-all), so that the entry it overwrites is out of every reach.
inline constexpr std::uint32_t ring_count = 1024;
static_assert(ring_count > depth_max + 1 && (ring_count & (ring_count - 1)) == 0);

// Slots of one publisher: the deepest history, one message in the hands of each subscription, and
// some hundred for those that hold more (daemon/state/hold_pool.hpp). 32 B each; a publisher gets
// as many as its subscriptions may need.
inline constexpr std::uint32_t slot_count_max = 4096;
static_assert(slot_count_max <= 0x10000, "a slot index is 16 bits of the commit word");
// Consecutive publishes that may skip the reclamation scan (docs/protocol.md, deferred scan): each
// needs one slot that the scan would have freed.
inline constexpr std::uint32_t deferred_scan_count_max = 32;
// Slots whose hold bits share the link line; 6 words are left in one line beside generation and
// cursor.
inline constexpr std::uint32_t near_slot_count = 384;

// Publishers and subscriptions of one topic: as many as processes, because each node of ROS 2
// publishes /rosout, and subscribes to /parameter_events as well.
inline constexpr std::uint32_t publisher_count_max = 2048;
inline constexpr std::uint32_t subscription_count_max = 2048;
// Publishers for which a subscription has lines in one block. A subscription of most topics has one
// block; of topics that the daemon's configuration calls wide, all: processes of other users can
// read, and so allocate, what lies in a region, used or not.
inline constexpr std::uint32_t link_block_count = 256;
inline constexpr std::uint32_t link_block_max = publisher_count_max / link_block_count;
static_assert(publisher_count_max % link_block_count == 0);
// Dead publishers of one topic with unread messages. Each keeps its memory, and a place for a
// process; the daemon abandons the oldest beyond that, so that a subscription that does not read
// cannot keep publishers from joining. Where [limits] allows fewer publishers, half of those.
inline constexpr std::uint32_t orphan_count_max = 126;
// 4096 topics × 260 KiB = 1 GiB of addresses, touched only for existing endpoints.
inline constexpr std::uint32_t topic_count_max = 4096;

// Processes registered at once. A thousand are required; the daemon keeps one bit per process for
// everything it announces.
inline constexpr std::uint32_t client_count_max = 2048;

// Addresses of one client region. Room for 7,000 endpoints; for 200 nodes of rclcpp, whose
// subscriptions to /parameter_events are wide, two thirds. The memory grows with the extents.
inline constexpr std::uint64_t client_region_bytes = std::uint64_t{1} << 30;

// Heap windows of one process: the first and its growth (each the configured length, 16 GiB by
// default).
inline constexpr std::uint32_t window_count_max = 8;
// How often the daemon asks one process to allocate elsewhere because a reader cannot map its
// addresses: each time takes a window, and as many again stay to grow in.
inline constexpr std::uint32_t heap_move_max = 3;
// Ranges of the arena that one process can report as occupied; it widens the last one as needed.
inline constexpr std::uint32_t blocked_count_max = 16;
// Alignment of windows' base and length: whole huge pages, so that the kernel can use them.
inline constexpr std::uint64_t window_granule_bytes = 2 << 20;
// Observers of one user. The daemon may have to store one dump for each.
inline constexpr std::uint32_t observer_count_max = 8;

// Endpoints in the graph table: four times those of 1,000 nodes of rclcpp, which have about 14
// each. 72 MiB when it is full.
inline constexpr std::uint32_t graph_entry_max = 65536;

// Wait sets of one process: one line each in the rest of the client region's first page beside the
// windows. Callback groups share them when there are more.
inline constexpr std::uint32_t wait_set_count_max = 56;

// What the daemon knows of the threads that run callbacks, for each process: five times the
// required 200 executor threads, and twice the required 2,000 callback groups. In rclcpp each group
// is an executor of ours, which every thread of rclcpp's executor may spin: 16 threads of 2,000.
inline constexpr std::uint32_t callback_thread_count_max = 1024;
inline constexpr std::uint32_t callback_group_count_max = 4096;
inline constexpr std::uint32_t callback_spin_count_max = 32768;
// Processors that a thread setting can name: glibc's cpu_set_t (CPU_SETSIZE).
inline constexpr std::uint32_t cpu_count_max = 1024;

}  // namespace agnocast::abi
