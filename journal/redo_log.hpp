// SPDX-License-Identifier: Apache-2.0
//
// Redo log: what the daemon has decided, before it does it.
//
//   write the record → committed = lsn → change tables and board (may be repeated) → applied = lsn
//
// A daemon that dies in between finds committed != applied when it starts again and does the change
// once more; every change is idempotent. The log lies in a memfd that outlives the daemon's
// process. Process death does not lose executed stores, so nothing is flushed: this is a redo log
// without a disk. One change is under way at a time. Old records stay until the ring comes round:
// the flight recorder.
//
//      0  magic · fingerprint · incarnation · record_count
//     64  committed lsn            128  applied lsn            (lsn 1 is the first record)
//   4096  record[record_count]     at lsn mod record_count
#pragma once

#include <agnocast/abi/client_region.hpp>
#include <agnocast/abi/limits.hpp>
#include <base/memory_policy.hpp>

#include <cstddef>
#include <cstdint>
#include <optional>
#include <type_traits>

namespace agnocast::journal {

enum class RecordType : std::uint32_t {
  none = 0,
  register_client = 1,
  add_publisher = 2,
  add_subscription = 3,
  announced = 4,
  unlinked = 5,
  leave_publisher = 6,
  leave_subscription = 7,
  free_publisher = 8,
  free_subscription = 9,
  client_dead = 10,
  client_end = 11,
  open_window = 12,
  free_window = 13,
  revoke_subscription = 14,
  add_topic = 15,
  open_executor = 16,
  free_topic = 17,
  raise_slots = 18,
  client_forgotten = 19,
};

//    0 lsn u64 · 8 type u32 · 12 crc32c u32 (of everything else) · 16 argument[14] u64, meaning by
//    type
struct Record {
  std::uint64_t lsn = 0;
  RecordType type = RecordType::none;
  std::uint32_t crc = 0;
  std::uint64_t argument[14] = {};
};
static_assert(sizeof(Record) == 128 && offsetof(Record, argument) == 16 &&
              std::is_trivially_copyable_v<Record>);
static_assert(std::has_unique_object_representations_v<Record>);

/// CRC-32C (Castagnoli, RFC 3720 appendix B.4) of `bytes` at `data`.
std::uint32_t crc32c(const void* data, std::size_t bytes) noexcept;

class RedoLog {
 public:
  // 4096 records × 128 B = 512 KiB: at a busy start of 1000 nodes the last few seconds, otherwise
  // hours.
  static constexpr std::uint64_t record_count = 4096;
  static constexpr std::uint64_t bytes = abi::page_bytes + record_count * sizeof(Record);

  /// `region`: at least `bytes`, writable by the daemon alone. Does not touch it.
  explicit RedoLog(std::byte* region) noexcept : region_(region) {}

  /// Makes a fresh log of a zeroed region.
  void create(std::uint64_t fingerprint, std::uint64_t incarnation) noexcept;
  /// True when the region holds a log of this very layout.
  bool is_valid(std::uint64_t fingerprint) const noexcept;
  std::uint64_t incarnation() const noexcept;

  /// Writes and commits; from here on the change will happen. Only when nothing is pending. Returns
  /// its lsn.
  std::uint64_t commit(RecordType type, const std::uint64_t* arguments, std::size_t count) noexcept;
  /// The change is done.
  void applied() noexcept;
  /// The committed record whose change may not be complete, if there is one.
  std::optional<Record> pending() const noexcept;
  /// An old record, if it is still there and whole. Any number.
  std::optional<Record> read(std::uint64_t lsn) const noexcept;
  std::uint64_t committed_lsn() const noexcept;

 private:
  using M = SharedMemory;
  abi::SharedWord& word(std::uint64_t offset) const noexcept { return M::word(region_, offset); }

  std::byte* region_;
};

}  // namespace agnocast::journal
