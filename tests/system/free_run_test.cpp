// SPDX-License-Identifier: Apache-2.0
//
// Goal: at full speed, only permitted things happen, whichever processes join, lag, leave or die.
// Method: real publishers and subscribers in their own processes, at full speed; each subscription
// judges its messages (free_run.hpp), and in the end every one that stayed must have the last
// message that each publisher committed, also of publishers killed while they published. Seeds as
// in stepped_test.cpp; a free run's interleaving is the machine's, its contents and pauses are the
// seed's. AGNOCAST_FREE_RUNS: the number of runs (10 if not set).

#include <tests/support/processes/daemon_process.hpp>
#include <tests/system/actor_process.hpp>
#include <tests/system/free_run.hpp>
#include <tests/system/specimen.hpp>

#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <memory>
#include <sstream>
#include <string>
#include <thread>
#include <vector>

namespace agnocast::test {
namespace {

constexpr int patience_s = 120;

struct Reader {
  std::unique_ptr<ActorProcess> actor;
  std::uint64_t depth;
  bool stays;
};
struct Writer {
  std::unique_ptr<ActorProcess> actor;
  bool dies;
};

class FreeRun {
 public:
  explicit FreeRun(std::uint64_t seed)
      : random_(seed),
        seed_(seed),
        daemon_({.config = "[heap]\nwindow_bytes = \"256MiB\"\n"}),
        progress_path_(daemon_.directory() + "/progress"),
        progress_(Progress::at(progress_path_)),
        keep_all_(random_.chance(25)) {}

  void run() {
    const std::uint64_t reader_count = 1 + random_.below(random_.chance(30) ? 16 : 5);
    const std::uint64_t writer_count = 1 + random_.below(3);
    for (std::uint64_t i = 0; i < reader_count; ++i)
      add_reader(i == 0 || random_.chance(60), writer_count);
    for (std::uint64_t i = 0; i < writer_count; ++i) add_writer(!keep_all_ && random_.chance(30));
    const std::uint64_t count = keep_all_ ? 300 : 1000 + random_.below(2000);
    for (std::size_t i = 0; i < writers_.size(); ++i) {
      writers_[i].actor->tell("run_pub " + std::to_string(i) + " " + std::to_string(count) + " " +
                              std::to_string(random_.next()) + " " + progress_path_);
    }
    while (std::any_of(writers_.begin(), writers_.end(),
                       [&](const Writer& writer) { return is_at_work(writer, count); })) {
      one_disturbance(count);
      std::this_thread::sleep_for(std::chrono::milliseconds(1 + random_.below(20)));
    }
    for (Writer& writer : writers_) {
      if (writer.actor != nullptr) {
        EXPECT_EQ(writer.actor->answer(patience_s), std::to_string(count));
      }
    }
    progress_.stop.store(1);
    for (Reader& reader : readers_) judge(reader);
  }

 private:
  std::string qos(std::uint64_t depth) const {
    return std::to_string(depth) + (keep_all_ ? "a" : "");
  }
  bool is_at_work(const Writer& writer, std::uint64_t count) const {
    const auto index = static_cast<std::size_t>(&writer - writers_.data());
    return writer.actor != nullptr && progress_.publisher[index].committed.load() < count &&
           std::chrono::steady_clock::now() < give_up_;
  }

  void start_reading(Reader& reader, std::uint64_t publishers) {
    EXPECT_EQ(reader.actor->ask("sub 1 /free " + qos(reader.depth) + " 16"), "ok");
    EXPECT_EQ(reader.actor->ask("sync"), "ok");
    reader.actor->tell("run_sub 1 " + std::to_string(reader.depth) + " " +
                       std::to_string(publishers) + " " + std::to_string(random_.next()) + " " +
                       progress_path_);
  }
  void add_reader(bool stays, std::uint64_t publishers) {
    constexpr std::uint64_t depths[] = {1, 2, 5, 10, 100, 1000};
    Reader reader{std::make_unique<ActorProcess>(daemon_.socket_path(), false),
                  depths[random_.below(std::size(depths))], stays};
    EXPECT_EQ(reader.actor->ask("seed " + std::to_string(seed_)), "ok");
    start_reading(reader, publishers);
    readers_.push_back(std::move(reader));
  }
  void add_writer(bool dies) {
    Writer writer{std::make_unique<ActorProcess>(daemon_.socket_path(), true), dies};
    EXPECT_EQ(writer.actor->ask("seed " + std::to_string(seed_)), "ok");
    EXPECT_EQ(writer.actor->ask("pub " + std::to_string(writers_.size()) + " /free " + qos(10)),
              "ok");
    writers_.push_back(std::move(writer));
  }

  /// A reader that does not stay is killed and restarted; a writer that dies does so half way.
  void one_disturbance(std::uint64_t count) {
    for (std::size_t i = 0; i < writers_.size(); ++i) {
      if (writers_[i].dies && writers_[i].actor != nullptr &&
          progress_.publisher[i].committed.load() > count / 3)
        writers_[i].actor.reset();
    }
    Reader& reader = readers_[random_.below(readers_.size())];
    if (reader.stays || keep_all_) return;
    reader.actor = std::make_unique<ActorProcess>(daemon_.socket_path(), false);
    EXPECT_EQ(reader.actor->ask("seed " + std::to_string(seed_)), "ok");
    start_reading(reader, 0);
  }

  void judge(Reader& reader) {
    std::istringstream verdict(reader.actor->answer(patience_s));
    std::string word;
    std::uint64_t taken = 0, lost = 0;
    verdict >> word >> taken >> lost;
    ASSERT_EQ(word, "ok") << verdict.str() << "; seed " << seed_;
    if (keep_all_) {
      EXPECT_EQ(lost, 0u);
    }
    std::vector<std::uint64_t> last(writers_.size());
    for (std::string entry; verdict >> entry;) {
      const std::size_t colon = entry.find(':');
      last.at(std::stoull(entry)) = std::stoull(entry.substr(colon + 1));
    }
    if (!reader.stays) return;
    std::uint64_t committed = 0, attempted = 0;
    for (std::size_t i = 0; i < writers_.size(); ++i) {
      const auto& progress = progress_.publisher[i];
      committed += progress.committed.load();
      attempted += progress.attempted.load();
      EXPECT_LE(last[i], progress.attempted.load());
      // With several publishers, the newest message of one may lie outside the depth.
      if (writers_.size() == 1 || keep_all_) {
        EXPECT_GE(last[i], progress.committed.load()) << "the newest message; seed " << seed_;
      }
    }
    // Equal, except where a publisher was killed between commit and record.
    EXPECT_GE(taken + lost, committed) << "neither taken nor counted; seed " << seed_;
    EXPECT_LE(taken + lost, attempted) << "never published; seed " << seed_;
  }

  Random random_;
  std::uint64_t seed_;
  DaemonProcess daemon_;
  std::string progress_path_;
  Progress& progress_;
  bool keep_all_;
  std::chrono::steady_clock::time_point give_up_ =
      std::chrono::steady_clock::now() + std::chrono::seconds(patience_s);
  std::vector<Reader> readers_;
  std::vector<Writer> writers_;
};

TEST(FreeRun, OnlyPermittedThingsHappen) {
  const std::uint64_t only = seed_given();
  const std::uint64_t runs = only != 0 ? 1 : number_from_environment("AGNOCAST_FREE_RUNS", 10);
  const auto now = std::chrono::system_clock::now().time_since_epoch().count();
  for (std::uint64_t i = 0; i < runs && !testing::Test::HasFailure(); ++i) {
    const std::uint64_t seed =
        only != 0 ? only : static_cast<std::uint64_t>(now) / 1000 % 1'000'000'000 * 1000 + i;
    std::printf("free run of seed %llu\n", static_cast<unsigned long long>(seed));
    std::fflush(stdout);
    FreeRun(seed).run();
  }
}

/// The judge detects each violation.
TEST(FreeRunJudge, ComplainsAboutEachViolation) {
  const auto verdict_of = [](auto happen) {
    FreeRunJudge judge(2, 1);
    happen(judge);
    return judge.verdict().substr(0, 3);
  };
  EXPECT_EQ(verdict_of([](FreeRunJudge& judge) {
              judge.took(1, 1, 0, true);
              judge.took(1, 4, 2, true);
              judge.took(1, 5, 2, true);
              judge.found_nothing();
            }),
            "ok ");
  EXPECT_EQ(verdict_of([](FreeRunJudge& judge) { judge.took(1, 1, 0, false); }), "bad")
      << "content";
  EXPECT_EQ(verdict_of([](FreeRunJudge& judge) { judge.took(1, 2, 0, true); }), "bad")
      << "uncounted";
  EXPECT_EQ(verdict_of([](FreeRunJudge& judge) { judge.took(1, 1, 1, true); }), "bad")
      << "counted and not missing";
  EXPECT_EQ(verdict_of([](FreeRunJudge& judge) {
              judge.took(1, 1, 0, true);
              judge.took(1, 1, 0, true);
            }),
            "bad")
      << "twice";
  EXPECT_EQ(verdict_of([](FreeRunJudge& judge) {
              judge.took(1, 3, 2, true);
              judge.found_nothing();
            }),
            "bad")
      << "lost without a newer one beyond its depth";
}

}  // namespace
}  // namespace agnocast::test
