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
// A second script has a topic of two link blocks; its deaths are tried by turns, without pairs.
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
Operation publisher(std::uint32_t c, const char* topic, std::uint64_t request,
                    std::uint32_t depth = 5) {
  return {"create a publisher",
          [=](Core& core, bool again) {
            core.create(c, Kind::publisher, topic, request, depth, again);
          },
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

using Script = std::vector<Operation>;

// Processes 0 … 4. A publisher's depth, slots that must grow, reused indexes, both orders of
// leaving, deaths of processes with both kinds of endpoints, two of them in the middle of a
// publish, a revoked process that ends later, and no process at the end.
const Script everything = {
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

// A topic whose first link block is full, and what follows in the second: it is backed in the
// subscriptions that are there, for deeper queues as well, and in new ones; its publishers leave
// and die, and so do subscriptions that have it.
Script full_link_block() {
  Script script{hello(0), hello(1), executor(1), subscription(1, "/wide", 1)};
  for (std::uint64_t i = 0; i < abi::link_block_count; ++i)
    script.push_back(publisher(0, "/wide", 100 + i));
  return script;
}
const Script second_link_block = {
    hello(2), publisher(2, "/wide", 2), hello(3), executor(3), subscription(3, "/wide", 3),
    publisher(0, "/wide", 4, 500),
    // one of the first block leaves; its place is used again
    leave(0, 100), unlinked(1, 100), unlinked(3, 100), drained(0, 100), publisher(2, "/wide", 5),
    // of the second one leaves, one dies in a publish
    leave(0, 4), unlinked(1, 4), unlinked(3, 4), drained(0, 4), stop_in_publish(2, 2, false),
    reap(2), unlinked(1, 2), unlinked(3, 2), unlinked(1, 5), unlinked(3, 5), unlinked_region(1, 2),
    unlinked_region(3, 2), subscription(1, "/wide", 6), reap(3), unlinked(0, 3),
    unlinked_region(0, 3), leave(1, 1), drained(1, 1), unlinked(0, 1)};

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
    KeptMemory memory;
    crash_points::arm(0);
    Core core(memory, doorbells(), references_);
    core.registry().create(1);
    if (!before_.empty()) {
      for (const Operation& operation : before_) operation.run(core, false);
      crash_points::arm(0);
    }
    for (const Operation& operation : script_) {
      operation.run(core, false);
      after_.push_back(core.state(Core::Generations::order));
    }
    points_ = crash_points::reached();
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
      if (!before_.empty()) {
        crash_points::arm(0);
        for (const Operation& operation : before_) operation.run(core, false);
        crash_points::arm(n);
      }
      for (const Operation& operation : script_) {
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
    core.resume(script_[at].ended);
    script_[at].run(core, true);
  }

  Script before_;  // runs without deaths
  Script script_ = everything;
  /// Which deaths are tried: of the first daemon at a part of the points or at all, or, with pairs,
  /// of the second one as well.
  enum class Extent { part, single, pairs };
  void sweep(Extent extent);

  test::TemporaryDirectory directory_;
  crash_points::Control* control_ = nullptr;
  std::atomic<std::uint64_t>* progress_ = nullptr;
  References references_;
  std::vector<std::string> after_;
  std::uint64_t points_ = 0;                                       // of the script
  std::vector<First> firsts_;                                      // deaths that were tried
  std::map<std::string, std::uint64_t> by_name_, second_by_name_;  // by the name of the step
};

// Long because one loop dies, restarts, compares and counts, and each uses what the former found.
void CoreSweep::sweep(Extent extent) {
  const char* const wanted = std::getenv("AGNOCAST_SWEEP");
  const std::uint64_t stride = wanted != nullptr && std::string(wanted) == "all" ? 1 : 29;
  const test::Rotation rotation;
  rehearse();
  std::map<std::uint64_t, std::pair<std::string, std::string>> by_lsn;  // state, and its origin
  std::set<std::uint64_t> untouched;                                    // states without a repair
  std::uint64_t pairs = 0, opening = 0, violations = 0;
  const auto where = [this](const First& first) {
    return "death at point " + std::to_string(first.n) + " (" + name_of(first.step) +
           ") in operation " + std::to_string(first.at + 1) + ", " + script_[first.at].name;
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
      for (std::size_t i = first.at + 1; to_the_end && i < script_.size(); ++i) {
        script_[i].run(core, false);
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
  for (std::uint64_t n = 1; n <= points_ && violations < 5; ++n) {
    if (extent == Extent::part && !rotation.takes(n, points_)) continue;
    KeptMemory memory;
    const Death death = first_life(memory, n);
    ASSERT_TRUE(death.died) << "point " << n;
    const First first{n, death.progress, death.step};
    firsts_.push_back(first);
    ++by_name_[name_of(first.step)];
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
  for (const First& first : firsts_) {
    const bool whole = repairing.count(first.at) != 0 && repairs++ % 4 == 0;
    if (extent != Extent::pairs || !rotation.takes(first.n, firsts_.size())) continue;
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
      ++second_by_name_[name_of(second.step)];
      opening += second.progress == 0;
      complete(first, again, false);
      m += whole || second.progress == 0 ? 1 : 1 + (first.n + m) % stride;
    }
  }
  std::printf(
      "daemon core: %zu of %ju points, %zu records, %zu of their states seen without a repair\n",
      firsts_.size(), std::uintmax_t{points_}, by_lsn.size(), untouched.size());
  std::printf(
      "daemon core: %ju pairs, in %ju of them the second died while it opened its tables%s\n",
      std::uintmax_t{pairs}, std::uintmax_t{opening},
      stride == 1 ? "; all pairs" : "; of the others a sample");
  std::printf("daemon core: %ju violations; rotation: %s\n", std::uintmax_t{violations},
              rotation.text().c_str());
  for (const auto& [name, count] : by_name_)
    std::printf("  %-20s %5ju, in pairs %6ju\n", name.c_str(), std::uintmax_t{count},
                std::uintmax_t{second_by_name_[name]});
  EXPECT_EQ(violations, 0u);
}

TEST_F(CoreSweep, AfterADeathAtAnyStoreTheNextDaemonContinues) {
  const char* const wanted = std::getenv("AGNOCAST_SWEEP");
  const bool with_pairs = wanted == nullptr || std::string(wanted) != "single";
  sweep(with_pairs ? Extent::pairs : Extent::single);
  EXPECT_GT(firsts_.size(), 500u);
  for (const char* name : {"D3_slot", "D3_order", "D3_intent", "D3_final_head", "R3_died"}) {
    EXPECT_GT(by_name_[name], 0u) << name;
    // A part has few of the first deaths that such a second one can follow.
    if (with_pairs && test::Rotation().parts() == 1) {
      EXPECT_GT(second_by_name_[name], 0u) << name;
    }
  }
  EXPECT_EQ(after_.back().find("state 1"), std::string::npos) << after_.back();
}

TEST_F(CoreSweep, AlsoWhereATopicHasMoreThanOneLinkBlock) {
  before_ = full_link_block();
  script_ = second_link_block;
  sweep(Extent::part);
  EXPECT_GT(points_, 500u);
  EXPECT_GE(firsts_.size(), points_ / test::Rotation().parts());
  if (test::Rotation().parts() == 1) {
    for (const char* name : {"B_board_field", "D2_word", "D3_intent", "R3_died", "W2_committed"})
      EXPECT_GT(by_name_[name], 0u) << name;
  }
  for (const std::uint64_t request : {2u, 4u})
    EXPECT_GE(references_.at(request).index, std::uint64_t{abi::link_block_count});
}

}  // namespace
}  // namespace agnocast::sweep
