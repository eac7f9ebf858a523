// SPDX-License-Identifier: Apache-2.0
//
// Redo log: the decisions of the daemon, stored before it carries them out.
//
//   write the record → committed = lsn → change tables and board (may be repeated) → applied = lsn
//
// A daemon that died in between finds committed != applied at its next start and repeats the
// change; every change is idempotent. The log is in a memfd that outlives the daemon's process.
// Process death loses no executed stores, so nothing is flushed: this is a redo log without a
// disk. One change is in progress at a time. Old records stay until the ring wraps: the flight
// recorder.
//
//      0  magic · fingerprint · incarnation · shape: sizes and places in a record
//     64  committed lsn            128  applied lsn            (lsn 1 is the first record)
//   4096  record[record_count]     at lsn mod record_count
#pragma once

#include <agnocast/abi/client_region.hpp>
#include <agnocast/abi/limits.hpp>
#include <base/memory/memory_policy.hpp>
#include <journal/record.hpp>

#include <cstddef>
#include <cstdint>
#include <optional>

namespace agnocast::journal {

/// CRC-32C (Castagnoli, RFC 3720 appendix B.4) of `bytes` at `data`.
std::uint32_t crc32c(const void* data, std::size_t bytes) noexcept;

class RedoLog {
 public:
  // 4096 records × 128 B = 512 KiB: the last few seconds of a busy start of 1000 nodes, otherwise
  // hours.
  static constexpr std::uint64_t record_count = 4096;
  static constexpr std::uint64_t bytes = abi::page_bytes + record_count * sizeof(Record);

  /// `region`: at least `bytes`, writable by the daemon alone. The constructor does not access
  /// it.
  explicit RedoLog(std::byte* region) noexcept : region_(region) {}

  /// Makes a fresh log in a zeroed region.
  void create(std::uint64_t fingerprint, std::uint64_t incarnation) noexcept;
  /// State of a region left by a previous incarnation: docs/recovery.md, rows @L.
  enum class State : std::uint8_t {
    valid,         // a log of this layout
    other_layout,  // a log, but unreadable behind its fingerprint
    damaged,       // see damage()
  };
  State state(std::uint64_t fingerprint) const noexcept;
  /// Returns the damage as a sentence, static text; nullptr for a whole log.
  const char* damage() const noexcept;
  std::uint64_t fingerprint() const noexcept;
  /// Returns sizes and offsets of a record: another build's records differ, even if everything
  /// that clients see is the same.
  std::uint64_t shape() const noexcept;
  static constexpr std::uint64_t own_shape = record_count | sizeof(Record) << 32 |
                                             offsetof(Record, stamp_ns) << 48 |
                                             offsetof(Record, argument) << 56;
  std::uint64_t incarnation() const noexcept;

  /// Writes and commits a record; from here on the change will happen. Only if nothing is
  /// pending. Returns its lsn.
  std::uint64_t commit(RecordType type, const std::uint64_t* arguments, std::size_t count) noexcept;
  /// Marks the change as done.
  void applied() noexcept;
  /// Returns the committed record whose change may be incomplete, if there is one.
  std::optional<Record> pending() const noexcept;
  /// Returns an old record, if it is still there and whole. Accepts any number.
  std::optional<Record> read(std::uint64_t lsn) const noexcept;
  std::uint64_t committed_lsn() const noexcept;
  std::uint64_t applied_lsn() const noexcept;
  /// Returns the lsn of the oldest record that is not overwritten; 0: there is none.
  std::uint64_t oldest_lsn() const noexcept;

 private:
  using M = SharedMemory;
  abi::SharedWord& word(std::uint64_t offset) const noexcept { return M::word(region_, offset); }

  std::byte* region_;
};

}  // namespace agnocast::journal
