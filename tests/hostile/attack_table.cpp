// SPDX-License-Identifier: Apache-2.0

#include <tests/hostile/attack_table.hpp>

#include <base/clock.hpp>

#include <fcntl.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <nlohmann/json.hpp>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <sstream>
#include <string>
#include <utility>

namespace agnocast::test {
namespace {

nlohmann::json json_of(const ProcessUse& use) {
  return {{"descriptors", use.descriptors},
          {"mappings", use.mappings},
          {"resident_bytes", use.resident_bytes}};
}

std::string name_of(const testing::TestInfo& test) {
  return std::string(test.test_suite_name()) + "." + test.name();
}

const char* table_path() { return std::getenv("AGNOCAST_ATTACK_TABLE"); }

// One write per line: tests that run side by side append to the same file.
void append(const nlohmann::json& row) {
  const std::string line = row.dump() + "\n";
  const int file = ::open(table_path(), O_WRONLY | O_APPEND | O_CREAT | O_CLOEXEC, 0644);
  EXPECT_EQ(::write(file, line.data(), line.size()), static_cast<ssize_t>(line.size()))
      << table_path();
  ::close(file);
}

bool has_row = false;  // of the running test

class RowsWithoutFigures : public testing::EmptyTestEventListener {
  void OnTestStart(const testing::TestInfo&) override { has_row = false; }
  void OnTestEnd(const testing::TestInfo& test) override {
    if (table_path() == nullptr || has_row) return;
    const testing::TestResult& result = *test.result();
    nlohmann::json row{{"test", name_of(test)},
                       {"survived", result.Passed()},
                       {"seconds", static_cast<double>(result.elapsed_time()) / 1e3}};
    if (result.Skipped())
      row["skipped"] = result.GetTestPartResult(result.total_part_count() - 1).message();
    append(row);
  }
};

[[maybe_unused]] const bool listens = [] {
  testing::UnitTest::GetInstance()->listeners().Append(new RowsWithoutFigures);
  return true;
}();

}  // namespace

ProcessUse use_of(pid_t pid) {
  ProcessUse use;
  const std::filesystem::path process = "/proc/" + std::to_string(pid);
  std::error_code gone;
  const std::filesystem::directory_iterator descriptors(process / "fd", gone);
  if (gone) return use;
  use.descriptors = static_cast<std::uint64_t>(
      std::distance(begin(descriptors), std::filesystem::directory_iterator()));
  std::ifstream maps(process / "maps");
  for (std::string line; std::getline(maps, line);) ++use.mappings;
  std::uint64_t pages = 0;
  std::ifstream(process / "statm") >> pages >> pages;
  use.resident_bytes = pages * static_cast<std::uint64_t>(::sysconf(_SC_PAGESIZE));
  // proc_pid_stat(5): the name in parentheses is field 2, utime and stime are fields 14 and 15.
  std::ifstream stat(process / "stat");
  std::string text((std::istreambuf_iterator<char>(stat)), {});
  std::istringstream fields(text.substr(text.rfind(')') + 1));
  std::string skipped;
  for (int field = 3; field < 14; ++field) fields >> skipped;
  std::uint64_t user = 0, system = 0;
  fields >> user >> system;
  use.cpu_ns = (user + system) * 1'000'000'000 / static_cast<std::uint64_t>(::sysconf(_SC_CLK_TCK));
  return use;
}

AttackRow::AttackRow(pid_t daemon)
    : before_pid_(daemon),
      before_(use_of(daemon)),
      begin_ns_(static_cast<std::int64_t>(monotonic_ns())) {}

void AttackRow::write(pid_t daemon, const Victim& victim) {
  const auto* const test = testing::UnitTest::GetInstance()->current_test_info();
  if (table_path() == nullptr || test == nullptr || std::exchange(written_, true)) return;
  const ProcessUse after = use_of(daemon);
  const std::uint64_t cpu_before = daemon == before_pid_ ? before_.cpu_ns : 0;
  const nlohmann::json row{
      {"test", name_of(*test)},
      {"survived", !testing::Test::HasFailure()},
      {"seconds",
       static_cast<double>(monotonic_ns() - static_cast<std::uint64_t>(begin_ns_)) / 1e9},
      {"victim",
       {{"messages", victim.messages},
        {"lost", victim.lost},
        {"refused", victim.refused},
        {"largest_gap_ms", victim.largest_gap_ms}}},
      {"daemon",
       {{"before", json_of(before_)},
        {"after", json_of(after)},
        {"cpu_seconds", static_cast<double>(after.cpu_ns - cpu_before) / 1e9}}}};
  append(row);
  has_row = true;
}

}  // namespace agnocast::test
