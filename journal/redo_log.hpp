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
//      0  magic · fingerprint · incarnation · shape: sizes and places in a record
//     64  committed lsn            128  applied lsn            (lsn 1 is the first record)
//   4096  record[record_count]     at lsn mod record_count
#pragma once

#include <agnocast/abi/client_region.hpp>
#include <agnocast/abi/limits.hpp>
#include <base/memory_policy.hpp>
#include <journal/record.hpp>

#include <cstddef>
#include <cstdint>
#include <optional>

namespace agnocast::journal {

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
  /// What a region that an earlier life left holds: docs/recovery.md, rows @L.
  enum class State : std::uint8_t {
    valid,         // a log of this very layout
    other_layout,  // a log, but nothing behind its fingerprint can be read
    damaged,       // damage() says what
  };
  State state(std::uint64_t fingerprint) const noexcept;
  /// In plain words, static text; nullptr when it is a whole log.
  const char* damage() const noexcept;
  std::uint64_t fingerprint() const noexcept;
  /// Sizes and places in a record: another build's records are not ours, even where all that clients
  /// see is the same.
  std::uint64_t shape() const noexcept;
  static constexpr std::uint64_t own_shape = record_count | sizeof(Record) << 32 |
                                             offsetof(Record, stamp_ns) << 48 |
                                             offsetof(Record, argument) << 56;
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
  std::uint64_t applied_lsn() const noexcept;
  /// Of the oldest record that has not been overwritten; 0: there is none.
  std::uint64_t oldest_lsn() const noexcept;

 private:
  using M = SharedMemory;
  abi::SharedWord& word(std::uint64_t offset) const noexcept { return M::word(region_, offset); }

  std::byte* region_;
};

}  // namespace agnocast::journal
