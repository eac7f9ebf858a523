// SPDX-License-Identifier: Apache-2.0
//
// Goal: whatever publishers and subscriptions do in any order, every take gives exactly the
// message that quality of service determines, intact to the last nested string, and every loss is
// counted.
// Method: a schedule made from a seed steers real processes against the real daemon one step at a
// time: join, leave, publish, take, hold, release, SIGKILL. Each answer is compared with the
// reference (reference.hpp). A join is over when every process concerned has handled the daemon's
// announcements before it answers another request ("sync"); a death, when the daemon's log shows
// it. Then nothing is left to chance, and a schedule repeats exactly:
//   --seed=N or AGNOCAST_SEED=N runs that one schedule. AGNOCAST_STEPPED_SECONDS: how long to
//   go on (60 if not set).

#include <agnocast/error.hpp>
#include <tests/support/processes/daemon_process.hpp>
#include <tests/system/actor_process.hpp>
#include <tests/system/reference.hpp>
#include <tests/system/specimen.hpp>

#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <deque>
#include <map>
#include <memory>
#include <sstream>
#include <string>
#include <vector>

namespace agnocast::test {
namespace {

constexpr std::size_t publishing_actors = 3;
constexpr std::size_t actor_count = 7;
constexpr std::size_t subscription_count_max = 16;
constexpr std::size_t publisher_count_max = 4;

/// Daemon and processes, used by many schedules: remains of one would disturb the next.
class Stage {
 public:
  Stage()
      : daemon_({.config = "[heap]\nwindow_bytes = \"256MiB\"\n",
                 .arguments = {"--log-level", "debug"}}) {
    actors_.resize(actor_count);
    is_known_.resize(actor_count);
  }
  ActorProcess& actor(std::size_t place) {
    auto& actor = actors_[place];
    if (actor == nullptr)
      actor = std::make_unique<ActorProcess>(daemon_.socket_path(), place < publishing_actors);
    return *actor;
  }
  /// The process has made an endpoint, so the daemon knows it.
  void note_endpoint(std::size_t place) { is_known_[place] = true; }
  /// Sends SIGKILL; returns when the daemon has handled the death.
  [[nodiscard]] bool kill(std::size_t place) {
    const std::string pid = " pid=" + std::to_string(actor(place).pid()) + " ";
    actors_[place].reset();
    if (!is_known_[place]) return true;
    is_known_[place] = false;
    const auto is_gone = [&] {
      std::istringstream log(daemon_.log());
      for (std::string line; std::getline(log, line);) {
        if (line.find("client gone") != std::string::npos && line.find(pid) != std::string::npos)
          return true;
      }
      return false;
    };
    return eventually(is_gone);
  }
  bool is_daemon_running() { return daemon_.is_running(); }

 private:
  DaemonProcess daemon_;
  std::vector<std::unique_ptr<ActorProcess>> actors_;
  std::vector<bool> is_known_;
};

class Schedule {
 public:
  Schedule(Stage& stage, std::uint64_t seed)
      : stage_(stage),
        seed_(seed),
        random_(seed),
        topic_("/stepped/s" + std::to_string(seed)),
        flavour_(random_.below(4)) {}

  void run() {
    for (std::size_t place = 0; place < actor_count; ++place)
      expect(stage_.actor(place).ask("seed " + std::to_string(seed_)), "ok", "seed");
    const std::uint64_t steps = 60 + random_.below(140);
    for (std::uint64_t step = 0; step < steps && !failed_; ++step) one_step();
    for (auto& [id, where] : subscriptions_) drain(id);
    while (!failed_ && !subscriptions_.empty()) leave_subscription();
    while (!failed_ && !publishers_.empty()) leave_publisher();
    for (std::size_t place = 0; place < actor_count && !failed_; ++place)
      expect(stage_.actor(place).ask("release_ended"), "ok", "held beyond the subscription");
  }

  bool failed() const { return failed_; }
  std::uint64_t takes() const { return takes_; }
  std::uint64_t deaths() const { return deaths_; }

 private:
  struct Subscription {
    std::size_t place;
    std::deque<std::uint64_t> held;  // their publishers
  };

  void expect(const std::string& got, const std::string& wanted, const std::string& what) {
    if (got == wanted || failed_) return;
    failed_ = true;
    std::string log;
    for (const std::string& line : log_) log += "    " + line + "\n";
    ADD_FAILURE() << "seed " << seed_ << ": " << what << ": got '" << got
                  << "', the reference has '" << wanted << "'\n  last steps:\n"
                  << log << "  repeat: --seed=" << seed_;
  }
  std::string ask(std::size_t place, const std::string& line) {
    log_.push_back("process " + std::to_string(place) + ": " + line);
    if (log_.size() > 40) log_.pop_front();
    const std::string answer = stage_.actor(place).ask(line);
    log_.back() += " -> " + answer;
    return answer;
  }
  void sync(std::size_t place) { expect(ask(place, "sync"), "ok", "sync"); }
  template <class Map>
  std::uint64_t any_of(const Map& map) {
    auto at = map.begin();
    std::advance(at, static_cast<std::ptrdiff_t>(random_.below(map.size())));
    return at->first;
  }

  void one_step() {
    const std::uint64_t kind = random_.below(100);
    if (publishers_.empty() || kind < 3) return join_publisher();
    if (subscriptions_.empty() || kind < 12) return join_subscription();
    if (kind < 14) return leave_publisher();
    if (kind < 18) return leave_subscription();
    if (kind < 19 && random_.chance(50)) return kill();
    if (kind < 48) return publish();
    if (kind < 84) return take(any_of(subscriptions_));
    if (kind < 98) return release();
    drain(any_of(subscriptions_));
  }

  ReferenceQos some_qos(bool of_publisher) {
    constexpr std::uint64_t depths[] = {1, 1, 2, 3, 5, 10, 30, 100, 1000};
    ReferenceQos qos;
    qos.depth = depths[random_.below(std::size(depths))];
    // Flavours: mostly matching volatile · transient local · keep-all · everything.
    qos.transient_local = flavour_ == 1 ? random_.chance(90) : flavour_ == 3 && random_.chance(50);
    qos.best_effort = random_.chance(of_publisher ? 10 : 30);
    qos.keep_all = flavour_ == 2 ? random_.chance(80) : flavour_ == 3 && random_.chance(30);
    return qos;
  }

  void join_publisher() {
    if (publishers_.size() == publisher_count_max) return;
    const std::uint64_t id = next_id_++;
    const std::size_t place = random_.below(publishing_actors);
    const ReferenceQos qos = some_qos(true);
    stage_.note_endpoint(place);
    expect(ask(place, "pub " + std::to_string(id) + " " + topic_ + " " + qos.text()), "ok", "pub");
    reference_.join_publisher(id, qos);
    publishers_[id] = place;
    sync_everybody();
    check_matched();
  }
  void join_subscription() {
    if (subscriptions_.size() == subscription_count_max) return;
    const std::uint64_t id = next_id_++;
    const std::size_t place = random_.below(actor_count);
    const ReferenceQos qos = some_qos(false);
    const std::uint64_t quota = random_.chance(20) ? 1 + random_.below(3) : 64;
    stage_.note_endpoint(place);
    expect(ask(place, "sub " + std::to_string(id) + " " + topic_ + " " + qos.text() + " " +
                          std::to_string(quota)),
           "ok", "sub");
    reference_.join_subscription(id, qos, quota);
    subscriptions_[id] = {place, {}};
    sync_everybody();
    check_matched();
  }
  void leave_publisher() {
    const std::uint64_t id = any_of(publishers_);
    expect(ask(publishers_[id], "unpub " + std::to_string(id)), "ok", "unpub");
    reference_.leave_publisher(id);
    publishers_.erase(id);
    sync_everybody();
  }
  void leave_subscription() {
    const std::uint64_t id = any_of(subscriptions_);
    const std::size_t place = subscriptions_[id].place;
    expect(ask(place, "unsub " + std::to_string(id)), "ok", "unsub");
    if (random_.chance(70))
      expect(ask(place, "release_ended"), "ok", "held beyond the subscription");
    reference_.leave_subscription(id);
    subscriptions_.erase(id);
    sync_everybody();
  }
  void kill() {
    const std::size_t place = random_.below(actor_count);
    log_.push_back("process " + std::to_string(place) + " is killed");
    if (!stage_.kill(place)) expect("nothing in the log", "client gone", "a death");
    ++deaths_;
    std::erase_if(publishers_, [&](const auto& entry) {
      if (entry.second == place) reference_.leave_publisher(entry.first);
      return entry.second == place;
    });
    std::erase_if(subscriptions_, [&](const auto& entry) {
      if (entry.second.place == place) reference_.leave_subscription(entry.first);
      return entry.second.place == place;
    });
    expect(stage_.actor(place).ask("seed " + std::to_string(seed_)), "ok", "seed");
    sync_everybody();
    check_matched();
  }
  void sync_everybody() {
    std::vector<bool> concerned(actor_count);
    for (const auto& [_, place] : publishers_) concerned[place] = true;
    for (const auto& [_, where] : subscriptions_) concerned[where.place] = true;
    for (std::size_t place = 0; place < actor_count; ++place) {
      if (concerned[place]) sync(place);
    }
  }
  // Detaching waits for the daemon's report that the subscription is drained, so: at most.
  void check_matched() {
    for (const auto& [id, place] : publishers_) {
      const std::string answer = ask(place, "matched " + std::to_string(id));
      if (std::stoull(answer) < reference_.matched(id))
        expect(answer, std::to_string(reference_.matched(id)), "matched subscriptions");
    }
  }

  void publish() {
    const std::uint64_t id = any_of(publishers_);
    const std::uint64_t count = random_.chance(90) ? 1 + random_.below(3) : random_.below(40);
    const std::uint64_t bytes = random_.chance(98) ? 0 : random_.below(1u << 20);
    std::uint64_t committed = 0;
    while (committed < count && reference_.publish(id)) ++committed;
    expect(ask(publishers_[id], "publish " + std::to_string(id) + " " + std::to_string(count) +
                                    " " + std::to_string(bytes)),
           std::to_string(committed) +
               (committed < count ? std::string(" ") + sentence_of(Errc::would_block) : ""),
           "publish");
  }

  /// Returns true if there was one.
  bool take_one(std::uint64_t id) {
    Subscription& subscription = subscriptions_.at(id);
    const Reference::Take wanted = reference_.take(id);
    std::string got = ask(subscription.place, "take " + std::to_string(id));
    ++takes_;
    const std::size_t last = got.rfind(' ');
    std::string lost = std::to_string(wanted.lost);
    if (!wanted.lost_is_exact && last != std::string::npos &&
        std::strtoull(got.c_str() + last, nullptr, 10) <= wanted.lost)
      lost = got.substr(last + 1);
    if (!wanted.taken) {
      expect(got, "none " + lost, "take");
      return false;
    }
    const std::string number = std::to_string(wanted.taken->number);
    expect(got, std::to_string(wanted.taken->publisher) + " " + number + " " + number + " " + lost,
           "take");
    subscription.held.push_back(wanted.taken->publisher);
    return true;
  }
  void take(std::uint64_t id) { (void)take_one(id); }
  void release_of(std::uint64_t id, std::size_t position) {
    Subscription& subscription = subscriptions_.at(id);
    expect(
        ask(subscription.place, "release " + std::to_string(id) + " " + std::to_string(position)),
        "ok", "a held message");
    reference_.release(id, subscription.held[position]);
    subscription.held.erase(subscription.held.begin() + static_cast<std::ptrdiff_t>(position));
  }
  void release() {
    const std::uint64_t id = any_of(subscriptions_);
    const std::size_t held = subscriptions_.at(id).held.size();
    if (held != 0) release_of(id, random_.below(held));
  }
  void drain(std::uint64_t id) {
    do {
      while (!failed_ && !subscriptions_.at(id).held.empty()) release_of(id, 0);
    } while (!failed_ && take_one(id));
  }

  Stage& stage_;
  std::uint64_t seed_;
  Random random_;
  std::string topic_;
  std::uint64_t flavour_;
  Reference reference_;
  std::map<std::uint64_t, std::size_t> publishers_;  // by id: in which process
  std::map<std::uint64_t, Subscription> subscriptions_;
  std::uint64_t next_id_ = 1, takes_ = 0, deaths_ = 0;
  std::deque<std::string> log_;
  bool failed_ = false;
};

TEST(Stepped, EveryTakeEqualsTheReference) {
  const std::uint64_t only = seed_given();
  const std::uint64_t base =
      only != 0
          ? only
          : static_cast<std::uint64_t>(std::chrono::system_clock::now().time_since_epoch().count());
  const auto end = std::chrono::steady_clock::now() +
                   std::chrono::seconds(number_from_environment("AGNOCAST_STEPPED_SECONDS", 60));
  std::uint64_t schedules = 0, takes = 0, deaths = 0;
  std::unique_ptr<Stage> stage;
  do {
    if (schedules % 25 == 0) stage = std::make_unique<Stage>();  // its log is read again and again
    const std::uint64_t seed = only != 0 ? only : base / 1000 % 1'000'000'000 * 1000 + schedules;
    if (schedules % 25 == 0 || only != 0) {
      std::printf("schedules from seed %llu\n", static_cast<unsigned long long>(seed));
      std::fflush(stdout);
    }
    Schedule schedule(*stage, seed);
    schedule.run();
    ASSERT_FALSE(schedule.failed());
    ASSERT_TRUE(stage->is_daemon_running());
    ++schedules;
    takes += schedule.takes();
    deaths += schedule.deaths();
  } while (only == 0 && std::chrono::steady_clock::now() < end);
  std::printf("%llu schedules, %llu takes, %llu deaths\n",
              static_cast<unsigned long long>(schedules), static_cast<unsigned long long>(takes),
              static_cast<unsigned long long>(deaths));
}

TEST(Stepped, MessagesOfAHundredMegabytesArriveWhole) {
  DaemonProcess daemon({.config = "[heap]\nwindow_bytes = \"1GiB\"\n"});
  ActorProcess publisher(daemon.socket_path(), true);
  ActorProcess first(daemon.socket_path(), false), second(daemon.socket_path(), false);
  ASSERT_EQ(first.ask("sub 2 /large 2 64"), "ok");
  ASSERT_EQ(second.ask("sub 3 /large 1 64"), "ok");
  ASSERT_EQ(publisher.ask("pub 1 /large 1"), "ok");
  for (ActorProcess* actor : {&publisher, &first, &second}) ASSERT_EQ(actor->ask("sync"), "ok");
  ASSERT_EQ(publisher.ask("publish 1 2 100000000", 100), "2");
  EXPECT_EQ(first.ask("take 2", 100), "1 1 1 0");
  EXPECT_EQ(second.ask("take 3", 100), "1 2 2 1");
  ASSERT_EQ(publisher.ask("publish 1 1 100000000", 100), "1");
  EXPECT_EQ(first.ask("release 2 0", 100), "ok") << "held while a newer one was written";
  publisher.kill();
  EXPECT_EQ(first.ask("take 2", 100), "1 2 2 0");
  EXPECT_EQ(first.ask("take 2", 100), "1 3 3 0") << "committed before its publisher was killed";
  EXPECT_EQ(second.ask("release 3 0", 100), "ok") << "held when its publisher was killed";
  EXPECT_EQ(first.ask("release 2 1", 100), "ok");
  EXPECT_EQ(first.ask("release 2 0", 100), "ok");
}

/// The premise of the comparisons above: a single different leaf is detected.
TEST(Specimen, OneDifferentLeafIsADifferentMessage) {
  const SpecimenName name{1, 7, 64};
  Specimen message;
  SpecimenMaker::fill(message, 5, name);
  ASSERT_TRUE(SpecimenMaker::is_intact(message, 5, name));
  EXPECT_EQ(SpecimenMaker::name_of(message), name);
  const auto differs_when = [&](auto change) {
    Specimen other = message;
    change(other);
    return !SpecimenMaker::is_intact(other, 5, name);
  };
  EXPECT_TRUE(differs_when([](Specimen& m) { m.flags.push_back(true); }));
  EXPECT_TRUE(differs_when([](Specimen& m) { m.fixed_flags[3] = !m.fixed_flags[3]; }));
  EXPECT_TRUE(differs_when([](Specimen& m) { m.texts.emplace_back(); }));
  EXPECT_TRUE(differs_when([](Specimen& m) { m.inner.blob[63] ^= 1; }));
  EXPECT_TRUE(differs_when([](Specimen& m) { m.fixed_inners[1].label += "x"; }));
  EXPECT_TRUE(differs_when([](Specimen& m) { m.fixed_inners[1].notes.emplace_back("y"); }));
  EXPECT_TRUE(differs_when([](Specimen& m) { m.inners.emplace_back(); }));
  EXPECT_TRUE(differs_when([](Specimen& m) { m.fixed_flats[1].tag[2] ^= 1; }));
  Specimen next;
  SpecimenMaker::fill(next, 5, {1, 8, 64});
  EXPECT_FALSE(message == next);
}

}  // namespace
}  // namespace agnocast::test
