// SPDX-License-Identifier: Apache-2.0
//
// Goal: nothing grows: after 1,000,000 messages, 100,000 endpoints and 10,000 processes, daemon
// and clients use as many resources as after a warm-up.
// Method: a sample after each tenth; of the daemon and of two processes that stay: open
// descriptors, mappings, resident memory; of the publisher's shared heap: mapped and live bytes;
// of the daemon: the place and the address of the next process. The first and the last sample have
// to be equal, except for resident memory and live bytes, which an allocator's caches and
// high-water marks move: their tolerance stands beside them.
//   AGNOCAST_ENDURANCE=short   a tenth of these numbers.
//   AGNOCAST_ROTATION=I/N      an N-th of the processes and three fifths of the endpoints.
//   AGNOCAST_RESTARTS=100000   the restarts of a publisher beside a subscriber that lives.

#include <tests/support/processes/daemon_process.hpp>
#include <tests/support/processes/steered_process.hpp>
#include <tests/support/rotation.hpp>
#include <tests/system/random.hpp>

#include <gtest/gtest.h>

#include <dirent.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <deque>
#include <fstream>
#include <memory>
#include <sstream>
#include <string>
#include <vector>

namespace agnocast::test {
namespace {

constexpr int patience_s = 1200;

// Private memory: a leak grows in every tenth of a run, noise (an allocator's free lists) does
// not. So the median of the nine growths may be ten bytes for each step, or this:
constexpr std::int64_t private_growth_least = 32 << 10;
// Tables and regions keep the pages of the busiest moment so far: how far the control thread of a
// client lagged behind, which depends on the machine. A page leaked by each endpoint would be 360
// MiB.
constexpr std::int64_t shared_growth_max = 64 << 20;
// Blocks in the caches of the publisher's threads count as live: 0 to 122 KiB of them were
// measured. A block leaked by each message would be 16 MB, in the short form 1.6 MB.
constexpr std::int64_t live_tolerance = 256 << 10;
// Extents and topics that were open once stay mapped, adjacent or with a gap: how many at once
// depends on the same lag. A mapping leaked by each step would be 200 at least.
constexpr std::size_t mapping_tolerance = 32;

std::uint64_t count_of(std::uint64_t whole) {
  const char* const wanted = std::getenv("AGNOCAST_ENDURANCE");
  return wanted != nullptr && std::string(wanted) == "short" ? whole / 10 : whole;
}

std::uint64_t process_count(std::uint64_t whole) {
  return std::max<std::uint64_t>(count_of(whole) / Rotation().parts(), 200);
}

// A page leaked by each publisher, a third of them, is still more than shared_growth_max.
std::uint64_t endpoint_count(std::uint64_t whole) {
  return count_of(whole) * (Rotation().parts() > 1 ? 3 : 5) / 5;
}

std::uint64_t restart_count() {
  const char* const wanted = std::getenv("AGNOCAST_RESTARTS");
  return wanted != nullptr ? std::strtoull(wanted, nullptr, 10) : process_count(2'000);
}

struct ProcessSample {
  std::size_t descriptors = 0, mappings = 0;
  std::int64_t private_bytes = 0, shared_bytes = 0;  // resident

  static ProcessSample of(pid_t pid) {
    ProcessSample sample;
    const std::string proc = "/proc/" + std::to_string(pid);
    if (DIR* const fds = ::opendir((proc + "/fd").c_str())) {
      while (::readdir(fds) != nullptr) ++sample.descriptors;
      ::closedir(fds);
    }
    sample.mappings = count_mappings(proc + "/maps");
    std::ifstream status(proc + "/status");
    for (std::string name; status >> name;) {
      std::int64_t kibibytes = 0;
      if (name == "RssAnon:" && status >> kibibytes) sample.private_bytes = kibibytes << 10;
      if (name == "RssShmem:" && status >> kibibytes) sample.shared_bytes = kibibytes << 10;
    }
    return sample;
  }

 private:
  // The kernel splits a mapping where parts of it are locked in memory: neighbours of the same
  // file count as one.
  static std::size_t count_mappings(const std::string& path) {
    std::size_t count = 0;
    std::string end_before, file_before;
    std::ifstream maps(path);
    for (std::string line; std::getline(maps, line);) {
      std::istringstream words(line);
      std::string range, rights, offset, device, inode;
      words >> range >> rights >> offset >> device >> inode;
      const std::size_t dash = range.find('-');
      if (inode == "0" || file_before != inode + rights || end_before != range.substr(0, dash))
        ++count;
      end_before = range.substr(dash + 1);
      file_before = inode + rights;
    }
    return count;
  }
};

struct Heap {
  std::int64_t used = 0, frontier = 0, live = 0;
};

/// The daemon and the two processes that stay.
class Endurance : public testing::Test {
 protected:
  Endurance() {
    publisher_ = client(true);
    subscriber_ = client(false);
    EXPECT_EQ(publisher_->ask("pub /stays"), "ok");
    EXPECT_EQ(subscriber_->ask("sub /stays"), "ok");
    EXPECT_TRUE(publisher_->eventually("links", "1"));
    EXPECT_TRUE(subscriber_->eventually("links", "1"));
  }
  std::unique_ptr<SteeredProcess> client(bool may_publish) {
    std::vector<std::string> variables{"AGNOCAST_SOCKET=" + daemon_.socket_path()};
    if (may_publish) variables.push_back("LD_PRELOAD=" AGNOCAST_HOOK);
    return std::make_unique<SteeredProcess>(std::vector<std::string>{AGNOCAST_ENDURANCE_CLIENT},
                                            variables);
  }

  struct Sample {
    ProcessSample daemon, publisher, subscriber;
    Heap heap;
  };
  Sample sample() {
    Sample all{ProcessSample::of(daemon_.pid()),
               ProcessSample::of(publisher_->pid()),
               ProcessSample::of(subscriber_->pid()),
               {}};
    std::istringstream(publisher_->ask("heap")) >> all.heap.used >> all.heap.frontier >>
        all.heap.live;
    return all;
  }
  /// Samples when the daemon has announced the last departures.
  Sample sample_at_rest() {
    Sample last = sample();
    unsigned same = 0;
    EXPECT_TRUE(eventually([&] {
      const Sample now = sample();
      const bool is_same = counts_of(now) == counts_of(last) && now.heap.live == last.heap.live;
      same = is_same ? same + 1 : 0;
      last = now;
      return same >= 120;  // longer than the timer of a control thread
    }));
    return last;
  }
  static std::vector<std::int64_t> counts_of(const Sample& sample) {
    std::vector<std::int64_t> all{sample.heap.frontier};
    for (const ProcessSample& process : {sample.daemon, sample.publisher, sample.subscriber}) {
      all.push_back(static_cast<std::int64_t>(process.descriptors));
      all.push_back(static_cast<std::int64_t>(process.mappings));
    }
    return all;
  }

  void expect_flat(const Sample& before, const Sample& after, const std::string& what) {
    print("warm  ", before);
    print("end   ", after);
    EXPECT_EQ(before.heap.frontier, after.heap.frontier) << what << ": mapped bytes of the heap";
    const auto one = [&](const char* who, const ProcessSample& earlier, const ProcessSample& now) {
      EXPECT_EQ(earlier.descriptors, now.descriptors) << what << ": descriptors of " << who;
      EXPECT_LE(now.mappings, earlier.mappings + mapping_tolerance)
          << what << ": mappings of " << who;
    };
    one("the daemon", before.daemon, after.daemon);
    one("the publisher", before.publisher, after.publisher);
    one("the subscriber", before.subscriber, after.subscriber);
    EXPECT_LE(after.heap.live - before.heap.live, live_tolerance) << what;
  }
  static void print(const char* when, const Sample& sample) {
    std::printf("  %s", when);
    const auto one = [](const char* who, const ProcessSample& process) {
      std::printf("  %s %zu fds %zu maps %lld+%lld KiB", who, process.descriptors, process.mappings,
                  static_cast<long long>(process.private_bytes >> 10),
                  static_cast<long long>(process.shared_bytes >> 10));
    };
    one("daemon", sample.daemon);
    one("pub", sample.publisher);
    one("sub", sample.subscriber);
    std::printf(
        "  heap %lld used %lld mapped %lld live\n", static_cast<long long>(sample.heap.used),
        static_cast<long long>(sample.heap.frontier), static_cast<long long>(sample.heap.live));
    std::fflush(stdout);
  }

  static void expect_no_leak(const std::vector<Sample>& samples, ProcessSample Sample::*who,
                             std::uint64_t steps, const std::string& what) {
    std::vector<std::int64_t> growth;
    for (std::size_t i = 1; i < samples.size(); ++i)
      growth.push_back((samples[i].*who).private_bytes - (samples[i - 1].*who).private_bytes);
    std::nth_element(growth.begin(), growth.begin() + 4, growth.end());
    EXPECT_LE(growth[4], std::max(private_growth_least, static_cast<std::int64_t>(steps) * 10))
        << what;
    EXPECT_LE((samples.back().*who).shared_bytes - (samples.front().*who).shared_bytes,
              shared_growth_max)
        << what;
  }

  /// Calls `steps(part)` for each tenth of `count`; prints the time of a step in each.
  template <class Steps>
  void endure(const std::string& what, std::uint64_t count, Steps steps) {
    std::vector<Sample> samples;
    std::printf("%s, us each:", what.c_str());
    for (int tenth = 0; tenth < 10; ++tenth) {
      const auto begin = std::chrono::steady_clock::now();
      steps(count / 10);
      const std::chrono::duration<double> took = std::chrono::steady_clock::now() - begin;
      std::printf(" %.1f", took.count() * 1e7 / static_cast<double>(count));
      std::fflush(stdout);
      samples.push_back(tenth == 0 || tenth == 9 ? sample_at_rest() : sample());
    }
    std::printf("\n");
    expect_flat(samples.front(), samples.back(), what);
    expect_no_leak(samples, &Sample::daemon, count / 10, what + ": resident memory of the daemon");
    expect_no_leak(samples, &Sample::publisher, count / 10,
                   what + ": resident memory of the publisher");
    expect_no_leak(samples, &Sample::subscriber, count / 10,
                   what + ": resident memory of the subscriber");
  }

  DaemonProcess daemon_{{.arguments = {"--log-level", "debug"}}};
  std::unique_ptr<SteeredProcess> publisher_, subscriber_;
};

TEST_F(Endurance, MessagesLeaveNothingBehind) {
  endure("messages", count_of(1'000'000), [&](std::uint64_t count) {
    subscriber_->tell("receive " + std::to_string(count));
    ASSERT_EQ(publisher_->ask("publish " + std::to_string(count), patience_s), "ok");
    ASSERT_EQ(subscriber_->answer(patience_s), "ok");
    // The subscriber releases every message before the heap is sampled.
    ASSERT_EQ(publisher_->ask("publish 1"), "ok");
    ASSERT_EQ(subscriber_->ask("receive 1"), "ok");
  });
}

TEST_F(Endurance, EndpointsLeaveNothingBehind) {
  // A third each: publishers and subscriptions, both always on new topics; and subscriptions on
  // the topic of a publisher that stays, which maps and unmaps them all.
  endure("endpoints", endpoint_count(100'000), [&](std::uint64_t count) {
    const std::string third = std::to_string(count / 3);
    publisher_->tell("cycle pub /publishers " + third);
    ASSERT_EQ(subscriber_->ask("cycle sub /subscriptions " + third, patience_s), "ok");
    ASSERT_EQ(publisher_->answer(patience_s), "ok");
    ASSERT_EQ(subscriber_->ask("rejoin /stays " + third, patience_s), "ok");
  });
}

class EnduranceOfProcesses : public Endurance {
 protected:
  /// Starts a process that joins and ends, or is killed some time on its way.
  pid_t spawn(bool publishes, int steps) {
    std::vector<std::string> arguments{AGNOCAST_ENDURANCE_CLIENT,
                                       publishes ? "once-pub" : "once-sub", "/busy",
                                       std::to_string(steps)};
    std::vector<std::string> variables{"AGNOCAST_SOCKET=" + daemon_.socket_path()};
    if (publishes) variables.push_back("LD_PRELOAD=" AGNOCAST_HOOK);
    std::vector<char*> argv, environment;
    for (std::string& argument : arguments) argv.push_back(argument.data());
    for (std::string& variable : variables) environment.push_back(variable.data());
    argv.push_back(nullptr);
    environment.push_back(nullptr);
    pid_t pid = -1;
    EXPECT_EQ(::posix_spawn(&pid, argv[0], nullptr, nullptr, argv.data(), environment.data()), 0);
    return pid;
  }
  void end(pid_t pid, bool kill) {
    if (kill) ::kill(pid, SIGKILL);
    int status = 0;
    ::waitpid(pid, &status, 0);
    if (!kill) {
      EXPECT_TRUE(WIFEXITED(status) && WEXITSTATUS(status) == 0) << status;
    }
  }

  /// Returns where the daemon puts the next process: its place in the table, and the base of its
  /// window.
  std::string next_place() {
    const auto next = client(true);
    EXPECT_EQ(next->ask("pub /next"), "ok");
    const std::string pid = " pid=" + std::to_string(next->pid()) + " ";
    std::istringstream log(daemon_.log());
    std::string place;
    for (std::string line; std::getline(log, line);) {
      if (line.find(pid) == std::string::npos) continue;
      // An earlier process had the same pid: tens of thousands of processes use all pids.
      if (line.find("client registered") != std::string::npos) place.clear();
      for (const char* field : {"client registered client=", "base="}) {
        if (const std::size_t at = line.find(field); at != std::string::npos)
          place += line.substr(at, line.find(' ', at + std::string(field).size()) - at) + " ";
      }
    }
    return place;
  }
};

TEST_F(EnduranceOfProcesses, LeaveNothingBehind) {
  // A subscription that nobody reads keeps its newest five messages, also of dead publishers, and
  // no more.
  ASSERT_EQ(publisher_->ask("also pub /busy"), "ok");
  ASSERT_EQ(subscriber_->ask("also sub /busy"), "ok");
  Random random(7);
  std::uint64_t killed = 0;
  std::vector<std::string> places;
  endure("processes", process_count(10'000), [&](std::uint64_t count) {
    std::deque<pid_t> alive;
    for (std::uint64_t i = 0; i < count; ++i) {
      alive.push_back(spawn(random.chance(50), static_cast<int>(random.below(3))));
      if (alive.size() < 4) continue;
      const bool kill = random.chance(30);
      killed += kill ? 1 : 0;
      end(alive.front(), kill);
      alive.pop_front();
    }
    for (const pid_t pid : alive) end(pid, false);
    ASSERT_EQ(subscriber_->ask("drain"), "ok");
    (void)sample_at_rest();
    places.push_back(next_place());
  });
  std::printf("  %llu were killed; the next process gets %s\n",
              static_cast<unsigned long long>(killed), places.back().c_str());
  EXPECT_FALSE(places.front().empty());
  EXPECT_EQ(places.front(), places.back()) << "place and address after a tenth, and in the end";
}

TEST_F(EnduranceOfProcesses, RestartsOfAPublisherLeaveNothingBehind) {
  // Each publishes one message and ends without leaving or leaves properly; the subscriber takes
  // every message, and so maps and unmaps region and window of each.
  ASSERT_EQ(subscriber_->ask("also sub /busy"), "ok");
  std::vector<std::string> places;
  std::uint64_t life = 0;
  endure("restarts of a publisher", restart_count(), [&](std::uint64_t count) {
    std::deque<pid_t> alive;  // fewer than the depth of the subscription, so nothing is lost
    for (std::uint64_t i = 0; i < count; ++i) {
      alive.push_back(spawn(true, life++ % 2 == 0 ? 1 : 2));
      if (alive.size() < 4 && i + 1 < count) continue;
      for (; alive.size() >= 4 || (i + 1 == count && !alive.empty()); alive.pop_front()) {
        ASSERT_EQ(subscriber_->ask("one"), "ok");
        end(alive.front(), false);
      }
    }
    (void)sample_at_rest();
    places.push_back(next_place());
  });
  EXPECT_EQ(places.front(), places.back()) << "place and address after a tenth, and in the end";
}

}  // namespace
}  // namespace agnocast::test
