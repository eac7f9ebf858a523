// SPDX-License-Identifier: Apache-2.0

#include <journal/redo_log.hpp>

#include <base/clock.hpp>
#include <journal/steps.hpp>

#include <array>
#include <cstring>

namespace agnocast::journal {
namespace {

constexpr std::uint64_t magic_value = 0x676f6c2e6f676761;  // "aggo.log" in memory order
constexpr std::uint64_t magic_offset = 0, fingerprint_offset = 8, incarnation_offset = 16,
                        shape_offset = 24;
constexpr std::uint64_t committed_offset = abi::cache_line_bytes,
                        applied_offset = 2 * abi::cache_line_bytes;

constexpr std::array<std::uint32_t, 256> make_table() noexcept {
  std::array<std::uint32_t, 256> table{};
  for (std::uint32_t i = 0; i < 256; ++i) {
    std::uint32_t value = i;
    for (int bit = 0; bit < 8; ++bit)
      value = value >> 1 ^ (0x82f63b78 & (0 - (value & 1)));  // the polynomial, reflected
    table[i] = value;
  }
  return table;
}

std::uint32_t checksum(Record record) noexcept {
  record.crc = 0;
  return crc32c(&record, sizeof record);
}

constexpr std::uint64_t record_offset(std::uint64_t lsn) noexcept {
  return abi::page_bytes + lsn % RedoLog::record_count * sizeof(Record);
}

}  // namespace

std::uint32_t crc32c(const void* data, std::size_t bytes) noexcept {
  static constexpr std::array<std::uint32_t, 256> table = make_table();
  std::uint32_t value = ~std::uint32_t{0};
  const auto* at = static_cast<const unsigned char*>(data);
  for (std::size_t i = 0; i < bytes; ++i) value = value >> 8 ^ table[(value ^ at[i]) & 0xff];
  return ~value;
}

void RedoLog::create(std::uint64_t fingerprint, std::uint64_t incarnation) noexcept {
  word(fingerprint_offset).store(fingerprint, std::memory_order_relaxed);
  word(incarnation_offset).store(incarnation, std::memory_order_relaxed);
  word(shape_offset).store(own_shape, std::memory_order_relaxed);
  word(magic_offset)
      .store(magic_value, std::memory_order_release);  // last, so that an incomplete log has none
}

RedoLog::State RedoLog::state(std::uint64_t fingerprint) const noexcept {
  if (word(magic_offset).load(std::memory_order_acquire) != magic_value) return State::damaged;
  if (this->fingerprint() != fingerprint || shape() != own_shape) return State::other_layout;
  return damage() == nullptr ? State::valid : State::damaged;
}

const char* RedoLog::damage() const noexcept {
  if (word(magic_offset).load(std::memory_order_acquire) != magic_value)
    return "the redo log has no valid header";
  const std::uint64_t committed = committed_lsn();
  const std::uint64_t done = applied_lsn();
  if (committed != done && committed != done + 1)
    return "committed and applied numbers of the redo log contradict each other";
  if (committed != done && !read(committed)) return "the last record of the redo log is not whole";
  return nullptr;
}

std::uint64_t RedoLog::shape() const noexcept {
  return word(shape_offset).load(std::memory_order_relaxed);
}
std::uint64_t RedoLog::fingerprint() const noexcept {
  return word(fingerprint_offset).load(std::memory_order_relaxed);
}
std::uint64_t RedoLog::incarnation() const noexcept {
  return word(incarnation_offset).load(std::memory_order_relaxed);
}
std::uint64_t RedoLog::committed_lsn() const noexcept {
  return word(committed_offset).load(std::memory_order_acquire);
}

std::uint64_t RedoLog::applied_lsn() const noexcept {
  return word(applied_offset).load(std::memory_order_acquire);
}
std::uint64_t RedoLog::oldest_lsn() const noexcept {
  const std::uint64_t newest = committed_lsn();
  return newest <= record_count ? (newest == 0 ? 0 : 1) : newest - record_count + 1;
}

std::uint64_t RedoLog::commit(RecordType type, const std::uint64_t* arguments,
                              std::size_t count) noexcept {
  Record record;
  record.lsn = committed_lsn() + 1;
  record.type = type;
  record.stamp_ns = monotonic_ns();
  for (std::size_t i = 0; i < count && i < std::size(record.argument); ++i)
    record.argument[i] = arguments[i];
  record.crc = checksum(record);
  AGNOCAST_STEP(W1_record) std::memcpy(region_ + record_offset(record.lsn), &record, sizeof record);
  AGNOCAST_STEP(W2_committed) word(committed_offset).store(record.lsn, std::memory_order_release);
  return record.lsn;
}

void RedoLog::applied() noexcept {
  AGNOCAST_STEP(W3_applied) word(applied_offset).store(committed_lsn(), std::memory_order_release);
}

std::optional<Record> RedoLog::pending() const noexcept {
  const std::uint64_t committed = committed_lsn();
  if (committed == applied_lsn()) return std::nullopt;
  return read(committed);
}

std::optional<Record> RedoLog::read(std::uint64_t lsn) const noexcept {
  if (lsn == 0 || lsn > committed_lsn()) return std::nullopt;
  Record record;
  std::memcpy(&record, region_ + record_offset(lsn), sizeof record);
  if (record.lsn != lsn || record.crc != checksum(record)) return std::nullopt;
  return record;
}

}  // namespace agnocast::journal
