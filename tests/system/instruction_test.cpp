// SPDX-License-Identifier: Apache-2.0
//
// Goal: borrow, publish, take and release do not become slower unnoticed.
// Method: callgrind counts the instructions of the calling thread (instruction_subject.cpp), which
// a busy machine does not change. Each count may exceed its record in instruction_counts.txt by 5
// % (or ten). An observer (agnocast-ctl top, as fast as it can) changes none of them. Records
// belong to an architecture, a compiler and a build type; for another one the test is skipped. To
// record the current counts after a change that is worth it:
//
//   AGNOCAST_RECORD=1 ctest … -R system_instructions

#include <tests/support/processes/child.hpp>
#include <tests/support/processes/daemon_process.hpp>
#include <tests/support/processes/steered_process.hpp>

#include <gtest/gtest.h>

#include <sys/utsname.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <map>
#include <optional>
#include <sstream>
#include <string>
#include <vector>

namespace agnocast::test {
namespace {

constexpr double margin = 0.05;
constexpr std::uint64_t least_margin = 10;     // 5 % of the smallest would be one branch
constexpr std::uint64_t counted_turns = 1024;  // as in instruction_subject.cpp
constexpr const char* remedy =
    "; if this is meant, record it: AGNOCAST_RECORD=1 ctest -R system_instructions, and commit "
    "tests/system/instruction_counts.txt";

using Counts = std::map<std::string, std::uint64_t>;

std::string key_of_this_build() {
  utsname name{};
  ::uname(&name);
  return std::string(name.machine) + "/" AGNOCAST_COMPILER "/" AGNOCAST_BUILD_TYPE;
}

/// key → name → instructions. Lines: KEY NAME COUNT; # begins a comment.
std::map<std::string, Counts> read_records() {
  std::map<std::string, Counts> records;
  std::ifstream file(AGNOCAST_RECORDS);
  for (std::string line; std::getline(file, line);) {
    std::istringstream words(line);
    std::string key, name;
    std::uint64_t count = 0;
    if (line.rfind('#', 0) != 0 && words >> key >> name >> count) records[key][name] = count;
  }
  return records;
}

void write_records(const std::map<std::string, Counts>& records) {
  std::ofstream file(AGNOCAST_RECORDS);
  file << "# Instructions per call, by callgrind: architecture/compiler/build, call, count. "
          "Written by\n"
          "# AGNOCAST_RECORD=1 ctest -R system_instructions; gated at 5 % by "
          "instruction_test.cpp.\n";
  for (const auto& [key, counts] : records) {
    for (const auto& [name, count] : counts) file << key << " " << name << " " << count << "\n";
  }
}

/// One dump of callgrind: its name and its total.
void read_dump(const std::filesystem::path& path, Counts& counts) {
  std::ifstream file(path);
  const std::string trigger = "desc: Trigger: Client Request: ";
  std::string name;
  for (std::string line; std::getline(file, line);) {
    if (line.rfind(trigger, 0) == 0) name = line.substr(trigger.size());
    if (line.rfind("summary: ", 0) == 0 && !name.empty())
      counts[name] = std::strtoull(line.c_str() + 9, nullptr, 10) / counted_turns;
  }
}

/// Runs agnocast-ctl top, twenty times a second, until the end.
class Watcher {
 public:
  explicit Watcher(const std::string& socket)
      : child_([&] {
          if (std::freopen("/dev/null", "w", stdout) == nullptr) return 98;
          ::execl(AGNOCAST_TEST_CTL, AGNOCAST_TEST_CTL, "top", "-b", "-d", "0.05", "--socket",
                  socket.c_str(), nullptr);
          return 99;
        }) {}
  bool goes_on() const { return ::waitpid(child_.pid(), nullptr, WNOHANG) == 0; }

 private:
  Child child_;
};

enum class Looks : std::uint8_t { nobody, somebody };

Counts measure(Looks who) {
  DaemonProcess daemon;
  std::optional<Watcher> watcher;
  if (who == Looks::somebody) watcher.emplace(daemon.socket_path());
  const std::string out = daemon.directory() + "/counts";
  std::filesystem::create_directory(out);
  SteeredProcess counted({AGNOCAST_VALGRIND, "--tool=callgrind", "-q", "--collect-atstart=no",
                          "--callgrind-out-file=" + out + "/dump", AGNOCAST_COUNTED},
                         {"AGNOCAST_SOCKET=" + daemon.socket_path(), "LD_PRELOAD=" AGNOCAST_HOOK});
  EXPECT_EQ(counted.finish(), 0);
  EXPECT_TRUE(!watcher || watcher->goes_on()) << "no observer was running";
  Counts counts;
  for (const auto& entry : std::filesystem::directory_iterator(out))
    read_dump(entry.path(), counts);
  return counts;
}

TEST(Instructions, AreNoMoreThanRecorded) {
  const std::string key = key_of_this_build();
  auto records = read_records();
  const bool record = std::getenv("AGNOCAST_RECORD") != nullptr;
  if (!record && records.count(key) == 0) {
    GTEST_SKIP() << "no instruction counts are recorded for " << key << remedy;
  }
  const Counts counts = measure(Looks::nobody);
  ASSERT_EQ(counts.size(), 8u);
  for (const auto& [name, count] : counts) {
    const std::uint64_t recorded = records[key][name];
    std::printf("%-14s %6llu instructions, recorded %llu\n", name.c_str(),
                static_cast<unsigned long long>(count), static_cast<unsigned long long>(recorded));
    EXPECT_GT(count, 10u) << name << ": nothing was counted";
    if (record) continue;
    const auto allowed = static_cast<std::uint64_t>(static_cast<double>(recorded) * margin);
    EXPECT_LE(count, recorded + std::max(allowed, least_margin))
        << name << " became slower" << remedy;
    if (count + std::max(allowed, least_margin) < recorded)
      std::printf("  faster than recorded%s\n", remedy);
  }
  if (!record || HasFailure()) return;
  records[key] = counts;
  write_records(records);
}

// The subject's rounds are the same each time; the variation (a reclamation scan that the control
// thread has made before) is far below one more load from a shared word.
TEST(Instructions, AreTheSameBesideAnObserver) {
  const Counts alone = measure(Looks::nobody), watched = measure(Looks::somebody);
  ASSERT_EQ(alone.size(), 8u);
  for (const auto& [name, count] : alone) {
    ASSERT_EQ(watched.count(name), 1u);
    const std::uint64_t allowed = std::max(count / 100, least_margin);
    EXPECT_LE(watched.at(name), count + allowed) << name;
    EXPECT_GE(watched.at(name) + allowed, count) << name;
  }
}

}  // namespace
}  // namespace agnocast::test
