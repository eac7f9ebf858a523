// SPDX-License-Identifier: Apache-2.0
//
// Goal: a daemon may be killed at any store of its redo log, also while it redoes; exactly the
// committed changes are made. Method: a child makes changes to a table through the log and is
// killed at its n-th crash point; a second child redoes and is killed at its m-th; then the parent
// redoes and compares with the changes that the log shows as committed.

#include <base/memory/mapping.hpp>
#include <base/memory/memfd.hpp>
#include <journal/redo_log.hpp>
#include <tests/support/crash/crash_point.hpp>

#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <csignal>
#include <cstdio>
#include <string>

namespace agnocast::journal {
namespace {

constexpr std::uint64_t fingerprint = 42;
constexpr std::uint64_t cell_count = 8;
constexpr std::uint64_t change_count = 12;

/// The table that the log protects; it follows the log in memory.
abi::SharedWord& cell(std::byte* region, std::uint64_t index) {
  return SharedMemory::word(region, RedoLog::bytes + index * 8);
}

/// Two stores, so that a death can fall between them; making them again changes nothing.
void apply(std::byte* region, const Record& record) {
  crash_point(no_step);
  cell(region, record.argument[0]).store(record.argument[1], std::memory_order_release);
  crash_point(no_step);
  cell(region, (record.argument[0] + 1) % cell_count)
      .store(~record.argument[1], std::memory_order_release);
  crash_point(no_step);
}

Record change(std::uint64_t number) {
  Record record;
  record.argument[0] = number * 3 % cell_count;
  record.argument[1] = number * 0x1000001;
  return record;
}

void make_changes(std::byte* region) {
  RedoLog log(region);
  for (std::uint64_t i = 1; i <= change_count; ++i) {
    const Record record = change(i);
    log.commit(RecordType::add_publisher, record.argument, 2);
    apply(region, record);
    log.applied();
  }
}

void redo(std::byte* region) {
  RedoLog log(region);
  if (const auto record = log.pending()) {
    apply(region, *record);
    log.applied();
  }
}

/// Returns whether the child died at its crash point.
template <class Body>
bool dies(std::uint64_t n, Body body) {
  const pid_t pid = ::fork();
  if (pid == 0) {
    crash_points::arm(n);
    body();
    ::_exit(0);
  }
  int status = 0;
  ::waitpid(pid, &status, 0);
  if (WIFSIGNALED(status)) {
    EXPECT_EQ(WTERMSIG(status), SIGKILL);
  }
  return WIFSIGNALED(status);
}

TEST(RedoLogSweep, ExactlyTheCommittedChangesAreMadeWhateverDies) {
  unsigned deaths = 0, pairs = 0;
  bool first_survived = false;
  for (std::uint64_t n = 1; !first_survived; ++n) {
    bool second_survived = false;
    for (std::uint64_t m = 1; !second_survived; ++m) {
      SCOPED_TRACE("death at " + std::to_string(n) + ", then while redoing at " +
                   std::to_string(m));
      const std::uint64_t bytes = RedoLog::bytes + abi::page_bytes;
      const UniqueFd fd = make_memfd("journal", bytes).value();
      const Mapping mapping = Mapping::map(fd.get(), bytes, Mapping::Access::read_write).value();
      std::byte* const region = mapping.base();
      RedoLog(region).create(fingerprint, 1);
      first_survived = !dies(n, [&] { make_changes(region); });
      second_survived = !dies(m, [&] { redo(region); });
      ASSERT_EQ(RedoLog(region).state(fingerprint), RedoLog::State::valid);
      redo(region);
      EXPECT_FALSE(RedoLog(region).pending().has_value());
      deaths += !first_survived;
      pairs += !first_survived && !second_survived;

      std::uint64_t expected[cell_count] = {};
      const std::uint64_t committed = RedoLog(region).committed_lsn();
      for (std::uint64_t i = 1; i <= committed; ++i) {
        const Record record = change(i);
        expected[record.argument[0]] = record.argument[1];
        expected[(record.argument[0] + 1) % cell_count] = ~record.argument[1];
      }
      for (std::uint64_t i = 0; i < cell_count; ++i)
        ASSERT_EQ(cell(region, i).load(), expected[i]) << "cell " << i;
      EXPECT_LE(committed, change_count);
      if (first_survived) {
        EXPECT_EQ(committed, change_count);
      }
    }
  }
  std::printf("redo log: %u deaths, of which %u followed by a second one while redoing\n", deaths,
              pairs);
  EXPECT_GT(pairs, change_count);
}

TEST(RedoLog, RecognisesOnlyItsOwnLayout) {
  const UniqueFd fd = make_memfd("journal", RedoLog::bytes).value();
  const Mapping mapping =
      Mapping::map(fd.get(), RedoLog::bytes, Mapping::Access::read_write).value();
  RedoLog log(mapping.base());
  EXPECT_EQ(log.state(fingerprint), RedoLog::State::damaged) << "a zeroed region is not a log";
  log.create(fingerprint, 7);
  EXPECT_EQ(log.state(fingerprint), RedoLog::State::valid);
  EXPECT_EQ(log.state(fingerprint + 1), RedoLog::State::other_layout);
  EXPECT_EQ(log.incarnation(), 7u);
}

TEST(RedoLog, KeepsTheNewestRecordsAndRefusesDamagedOnes) {
  const UniqueFd fd = make_memfd("journal", RedoLog::bytes).value();
  const Mapping mapping =
      Mapping::map(fd.get(), RedoLog::bytes, Mapping::Access::read_write).value();
  RedoLog log(mapping.base());
  log.create(fingerprint, 1);
  for (std::uint64_t i = 1; i <= RedoLog::record_count + 5; ++i) {
    EXPECT_EQ(log.commit(RecordType::announced, &i, 1), i);
    log.applied();
  }
  EXPECT_FALSE(log.read(5).has_value()) << "overwritten";
  ASSERT_TRUE(log.read(6).has_value());
  EXPECT_EQ(log.read(6)->argument[0], 6u);
  EXPECT_FALSE(log.read(0).has_value());
  EXPECT_FALSE(log.read(RedoLog::record_count + 6).has_value()) << "not written yet";
  mapping.base()[abi::page_bytes + 6 * sizeof(Record) + 20] ^= std::byte{1};
  EXPECT_FALSE(log.read(6).has_value()) << "a flipped bit";
}

TEST(RedoLog, ChecksumIsCrc32c) {
  // RFC 3720, appendix B.4: 32 bytes of zeros, of ones, and counting up.
  unsigned char zeros[32] = {}, ones[32], counting[32];
  for (unsigned char i = 0; i < 32; ++i) {
    ones[i] = 0xff;
    counting[i] = i;
  }
  EXPECT_EQ(crc32c(zeros, 32), 0x8a9136aau);
  EXPECT_EQ(crc32c(ones, 32), 0x62a8ab43u);
  EXPECT_EQ(crc32c(counting, 32), 0x46dd794eu);
}

}  // namespace
}  // namespace agnocast::journal
