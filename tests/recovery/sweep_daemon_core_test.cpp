// SPDX-License-Identifier: Apache-2.0
//
// Goal: the daemon may be killed before any store into its redo log, its tables, the board and the
// client regions, before and after any packet, repeatedly; the next daemon continues unaffected.
// Method: the daemon's core (registry, endpoint manager, reaper) runs a script in a child process
// on memory that outlives it, and is killed at its 1st, 2nd, … n-th crash point. Then
//   - open() restores exactly the state after the last committed record;
//   - a daemon that resumes and gets the interrupted request again reaches the state that the
//     operation had without a death, and from there completes the rest of the script;
//   - pairs: the same when the resuming daemon is first killed at its m-th crash point.
// AGNOCAST_SWEEP=all: all pairs; single: none; otherwise all in which the second daemon dies while
// it opens its tables, and about every 15th of the others. AGNOCAST_ROTATION: pairs of a part of
// the first deaths (tests/support/rotation.hpp).

#include <tests/recovery/sweep_daemon_core.hpp>
#include <tests/support/crash/step_names.hpp>
#include <tests/support/machine/temporary_directory.hpp>
#include <tests/support/rotation.hpp>

#include <gtest/gtest.h>

#include <sys/mman.h>
#include <sys/wait.h>
#include <unistd.h>

#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <functional>
#include <set>
#include <utility>

namespace agnocast::sweep {
namespace {

struct Operation {
  std::string name;
  std::function<void(Core&, bool again)> run;
  std::set<std::uint32_t> ended;  // processes that are dead when it begins
};

Operation hello(std::uint32_t c) {
  return {"hello", [=](Core& core, bool again) { core.hello(c, again); }, {}};
}
Operation window(std::uint32_t c, std::uint64_t w) {
  return {"window", [=](Core& core, bool again) { core.open_window(c, w, again); }, {}};
}
Operation executor(std::uint32_t c) {
  return {"executor", [=](Core& core, bool) { core.open_wait_set(c); }, {}};
}
Operation publisher(std::uint32_t c, const char* topic, std::uint64_t request) {
  return {
      "create a publisher",
      [=](Core& core, bool again) { core.create(c, Kind::publisher, topic, request, 5, again); },
      {}};
}
Operation subscription(std::uint32_t c, const char* topic, std::uint64_t request,
                       std::uint32_t depth = 5) {
  return {"create a subscription",
          [=](Core& core, bool again) {
            core.create(c, Kind::subscription, topic, request, depth, again);
          },
          {}};
}
Operation leave(std::uint32_t c, std::uint64_t request) {
  return {"leave", [=](Core& core, bool again) { core.leave(c, request, again); }, {}};
}
Operation drained(std::uint32_t c, std::uint64_t request) {
  return {"drained", [=](Core& core, bool again) { core.drained(c, request, again); }, {}};
}
Operation unlinked(std::uint32_t by, std::uint64_t request) {
  return {"unlinked", [=](Core& core, bool) { core.unlinked(by, request); }, {}};
}
Operation unlinked_region(std::uint32_t by, std::uint32_t c) {
  return {"unlinked a region", [=](Core& core, bool) { core.unlinked_region(by, c); }, {}};
}
Operation stop_in_publish(std::uint32_t c, std::uint64_t request, bool committed) {
  return {"a publisher stops in a publish",
          [=](Core& core, bool) { core.stop_in_publish(c, request, committed); },
          {}};
}
Operation reap(std::uint32_t c) {
  return {"reap", [=](Core& core, bool) { core.reap(c); }, {c}};
}
Operation revoke(std::uint32_t c) {
  return {"revoke", [=](Core& core, bool) { core.revoke(c); }, {}};
}
Operation end_of_revoked(std::uint32_t c) {
  return {"the end of a revoked process", [=](Core& core, bool) { core.end(c); }, {c}};
}
Operation reap_both(std::uint32_t first, std::uint32_t second) {
  return {"two deaths",
          [=](Core& core, bool) {
            core.reap(first);
            core.reap(second);
          },
          {first, second}};
}

// Processes 0 … 4. A publisher's depth, slots that must grow, reused indexes, both orders of
// leaving, deaths of processes with both kinds of endpoints, two of them in the middle of a
// publish, a revoked process that ends later, and no process at the end.
const std::vector<Operation> script = {
    hello(0), window(0, 0), publisher(0, "/a", 1), hello(1), executor(1), subscription(1, "/a", 2),
    hello(2), executor(2), window(2, 0), subscription(2, "/a", 3, 500), publisher(2, "/b", 4),
    subscription(1, "/b", 5), window(0, 1), subscription(2, "/b", 6), publisher(1, "/a", 7),
    // a subscription leaves; its index is used again
    leave(1, 2), drained(1, 2), unlinked(0, 2), unlinked(1, 2), subscription(1, "/a", 8),
    // a publisher leaves
    leave(0, 1), unlinked(1, 1), unlinked(2, 1), drained(0, 1), unlinked_region(2, 0),
    publisher(0, "/a", 9),
    // processes die
    hello(3), publisher(3, "/a", 10), executor(3), subscription(3, "/c", 11), hello(4),
    window(4, 0), publisher(4, "/a", 12), executor(4), subscription(4, "/b", 13), revoke(4),
    unlinked(1, 12), unlinked(2, 12), unlinked(2, 13), unlinked_region(1, 4), unlinked_region(2, 4),
    end_of_revoked(4), stop_in_publish(3, 10, false), reap(3), unlinked(1, 10), unlinked(2, 10),
    unlinked_region(1, 3), unlinked_region(2, 3), stop_in_publish(2, 4, true), reap(2),
    unlinked(1, 4), unlinked(1, 3), unlinked(0, 3), unlinked_region(1, 2), unlinked_region(0, 2),
    leave(1, 5), drained(1, 5), leave(1, 7), unlinked(1, 7), drained(1, 7), reap_both(1, 0)};

class CoreSweep : public testing::Test {
 protected:
  CoreSweep() {
    void* const page =
        ::mmap(nullptr, abi::page_bytes, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
    control_ = static_cast<crash_points::Control*>(page);
    progress_ = reinterpret_cast<std::atomic<std::uint64_t>*>(static_cast<std::byte*>(page) + 2048);
    crash_points::use(*control_);
  }

  const std::string& doorbells() {
    for (const auto& entry : std::filesystem::directory_iterator(directory_.path()))
      std::filesystem::remove(entry);
    return directory_.path();
  }

  /// Runs without a death: records what the processes know, and the state after each operation.
  void rehearse() {
    crash_points::arm(0);
    KeptMemory memory;
    Core core(memory, doorbells(), references_);
    core.registry().create(1);
    for (const Operation& operation : script) {
      operation.run(core, false);
      after_.push_back(core.state(Core::Generations::order));
    }
  }

  struct Death {
    bool died = false;
    Step step = no_step;
    std::uint64_t progress = 0;  // completed operations
  };
  struct First {
    std::uint64_t n = 0;  // the crash point
    std::size_t at = 0;   // the operation
    Step step = no_step;
  };
  /// Runs `body` in a child that dies at its n-th crash point.
  template <class Body>
  Death dies(std::uint64_t n, Body body) {
    control_->last.store(0);
    progress_->store(0);
    const pid_t pid = ::fork();
    if (pid == 0) {
      crash_points::arm(n);
      try {
        body();
      } catch (const std::exception& error) {
        std::fprintf(stderr, "%s\n", error.what());
        ::_exit(1);
      }
      ::_exit(0);
    }
    int status = 0;
    ::waitpid(pid, &status, 0);
    Death death;
    death.died = WIFSIGNALED(status) && WTERMSIG(status) == SIGKILL && control_->last.load() != 0;
    EXPECT_TRUE(death.died || (WIFEXITED(status) && WEXITSTATUS(status) == 0))
        << "the child ended in another way, status " << status;
    if (death.died) death.step = static_cast<Step>(control_->last.load() - 1);
    death.progress = progress_->load();
    crash_points::arm(0);
    return death;
  }
  Death first_life(KeptMemory& memory, std::uint64_t n) {
    const std::string& directory = doorbells();
    return dies(n, [&] {
      Core core(memory, directory, references_);
      core.registry().create(1);
      for (const Operation& operation : script) {
        operation.run(core, false);
        progress_->fetch_add(1);
      }
    });
  }
  /// Resumes and repeats the operation; the progress is 1 when the tables are open.
  void repeat(Core& core, std::size_t at) {
    if (const auto opened = core.registry().open(); !opened)
      throw std::runtime_error("no tables of ours");
    progress_->store(1);
    core.resume(script[at].ended);
    script[at].run(core, true);
  }

  test::TemporaryDirectory directory_;
  crash_points::Control* control_ = nullptr;
  std::atomic<std::uint64_t>* progress_ = nullptr;
  References references_;
  std::vector<std::string> after_;
};

// Long because one loop dies, restarts, compares and counts, and each uses what the former found.
TEST_F(CoreSweep, AfterADeathAtAnyStoreTheNextDaemonContinues) {
  const char* const extent = std::getenv("AGNOCAST_SWEEP");
  const std::uint64_t stride = extent != nullptr && std::string(extent) == "all" ? 1 : 29;
  const bool with_pairs = extent == nullptr || std::string(extent) != "single";
  const test::Rotation rotation;
  rehearse();
  std::map<std::uint64_t, std::pair<std::string, std::string>> by_lsn;  // state, and its origin
  std::map<std::string, std::uint64_t> by_name, second_by_name;
  std::set<std::uint64_t> untouched;  // states without a repair
  std::uint64_t pairs = 0, opening = 0, violations = 0;
  const auto where = [](const First& first) {
    return "death at point " + std::to_string(first.n) + " (" + name_of(first.step) +
           ") in operation " + std::to_string(first.at + 1) + ", " + script[first.at].name;
  };
  const auto expect_equal = [&](const First& first, const std::string& got,
                                const std::string& wanted, const std::string& what) {
    if (got == wanted) return true;
    ++violations;
    ADD_FAILURE() << where(first) << ": " << what << "\n--- got\n"
                  << got << "--- wanted\n"
                  << wanted;
    return false;
  };
  const auto complete = [&](const First& first, KeptMemory& left, bool to_the_end) {
    try {
      Core core(left, doorbells(), references_);
      repeat(core, first.at);
      if (!expect_equal(first, core.state(Core::Generations::order), after_[first.at],
                        "the operation asked for again"))
        return;
      for (std::size_t i = first.at + 1; to_the_end && i < script.size(); ++i) {
        script[i].run(core, false);
        if (!expect_equal(first, core.state(Core::Generations::order), after_[i],
                          "operation " + std::to_string(i + 1)))
          return;
      }
    } catch (const std::exception& error) {
      ++violations;
      ADD_FAILURE() << where(first) << ": " << error.what();
    }
  };
  // The repair of a queue takes a few points among many, which a sample of second deaths may miss:
  // for every fourth first death of these operations all points are tried.
  std::set<std::size_t> repairing;
  std::vector<First> firsts;
  for (std::uint64_t n = 1; violations < 5; ++n) {
    KeptMemory memory;
    const Death death = first_life(memory, n);
    if (!death.died) break;
    const First first{n, death.progress, death.step};
    firsts.push_back(first);
    ++by_name[name_of(first.step)];
    if (first.step == steps::D3_slot) repairing.insert(first.at);
    {
      Core core(memory, doorbells(), references_);
      ASSERT_TRUE(core.registry().open().has_value()) << where(first);
      const std::uint64_t lsn = core.registry().log().committed_lsn();
      const auto [known, is_new] =
          by_lsn.try_emplace(lsn, core.state(Core::Generations::exact), where(first));
      if (!is_new)
        expect_equal(first, core.state(Core::Generations::exact), known->second.first,
                     "record " + std::to_string(lsn) + " and " + known->second.second);
      if (first.step == steps::W1_record) untouched.insert(lsn);
    }
    complete(first, memory, true);
  }
  std::uint64_t repairs = 0;
  for (const First& first : firsts) {
    const bool whole = repairing.count(first.at) != 0 && repairs++ % 4 == 0;
    if (!with_pairs || !rotation.takes(first.n, firsts.size())) continue;
    KeptMemory left;
    ASSERT_TRUE(first_life(left, first.n).died) << where(first);
    for (std::uint64_t m = 1; violations < 5;) {
      KeptMemory again;
      again.copy(left);
      const std::string& directory = doorbells();
      const Death second = dies(m, [&] {
        Core core(again, directory, references_);
        repeat(core, first.at);
      });
      if (!second.died) break;
      ++pairs;
      ++second_by_name[name_of(second.step)];
      opening += second.progress == 0;
      complete(first, again, false);
      m += whole || second.progress == 0 ? 1 : 1 + (first.n + m) % stride;
    }
  }
  std::printf("daemon core: %ju points, %zu records, %zu of their states seen without a repair\n",
              std::uintmax_t{firsts.size()}, by_lsn.size(), untouched.size());
  std::printf(
      "daemon core: %ju pairs, in %ju of them the second died while it opened its tables%s\n",
      std::uintmax_t{pairs}, std::uintmax_t{opening},
      stride == 1 ? "; all pairs" : "; of the others a sample");
  std::printf("daemon core: %ju violations; rotation: %s\n", std::uintmax_t{violations},
              rotation.text().c_str());
  for (const auto& [name, count] : by_name)
    std::printf("  %-20s %5ju, in pairs %6ju\n", name.c_str(), std::uintmax_t{count},
                std::uintmax_t{second_by_name[name]});
  EXPECT_EQ(violations, 0u);
  EXPECT_GT(firsts.size(), 500u);
  for (const char* name : {"D3_slot", "D3_order", "D3_intent", "D3_final_head", "R3_died"}) {
    EXPECT_GT(by_name[name], 0u) << name;
    // A part has few of the first deaths that such a second one can follow.
    if (with_pairs && rotation.parts() == 1) {
      EXPECT_GT(second_by_name[name], 0u) << name;
    }
  }
  EXPECT_EQ(after_.back().find("state 1"), std::string::npos) << after_.back();
}

}  // namespace
}  // namespace agnocast::sweep
