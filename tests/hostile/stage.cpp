// SPDX-License-Identifier: Apache-2.0

#include <tests/hostile/stage.hpp>

#include <fcntl.h>
#include <grp.h>
#include <poll.h>
#include <sys/mman.h>
#include <sys/prctl.h>

#include <cstdio>
#include <cstdlib>
#include <sstream>
#include <utility>

namespace agnocast::test {
namespace {

std::string configuration(const StageOptions& options) {
  return "[daemon]\nsocket_mode = \"0666\"\n" + options.daemon_keys +
         "[heap]\nwindow_bytes = \"64MiB\"\narena_bytes = \"4GiB\"\n" AGNOCAST_TEST_ARENA_BASE +
         options.heap + "[quota]\n" + options.quota + options.more + "[[access]]\ntopic = \"" +
         stream_topic + "\"\npublish = [\"uid:" + std::to_string(honest_uid) + "\"]\n";
}

std::unique_ptr<SteeredProcess> honest_process(const DaemonProcess& daemon,
                                               uid_t uid = honest_uid) {
  return std::make_unique<SteeredProcess>(
      std::vector<std::string>{AGNOCAST_HONEST_NODE, std::to_string(uid)},
      std::vector<std::string>{"AGNOCAST_SOCKET=" + daemon.socket_path()});
}

/// Reports failures in an attacker to the test, since the attacker may be killed before it ends.
class Failures : public testing::EmptyTestEventListener {
 public:
  explicit Failures(Attack::Word& count) : count_(count) {}
  void OnTestPartResult(const testing::TestPartResult& result) override {
    if (result.failed()) ++count_;
  }

 private:
  Attack::Word& count_;
};

}  // namespace

Stage::Stage(const StageOptions& options)
    : daemon_({.config = configuration(options),
               .uid = options.daemon,
               .without_passrights = options.without_passrights}),
      subscriber_(honest_process(daemon_)),
      publisher_(honest_process(daemon_)) {
  EXPECT_EQ(subscriber_->ask(std::string("watch ") + open_topic), "ok");
  EXPECT_EQ(subscriber_->ask(std::string("subscribe ") + stream_topic), "ok");
  EXPECT_EQ(publisher_->ask(std::string("publish ") + stream_topic), "ok");
  EXPECT_TRUE(subscriber_->eventually("matched", "1"));
  honest_goes_on();
  // creates the one-time objects now: windows and wait sets of the honest process
  honest_is_served();
  EXPECT_EQ(subscriber_->ask("forget-gap"), "ok");
  row_ = std::make_unique<AttackRow>(daemon_.pid());
}

Stage::~Stage() {
  if (!judged_) honest_lost_nothing();
}

std::unique_ptr<SteeredProcess> Stage::another_honest_process(uid_t uid) const {
  return honest_process(daemon_, uid);
}

Stage::State Stage::state() {
  State state;
  std::uint64_t ignored = 0;
  std::istringstream publisher(publisher_->ask("state")), subscriber(subscriber_->ask("state"));
  publisher >> state.published >> state.refused;
  for (int i = 0; i < 8; ++i) publisher >> ignored;
  std::getline(publisher, state.refusal);
  EXPECT_FALSE(publisher.fail()) << "the honest publisher does not answer: " << publisher.str();
  subscriber >> ignored >> ignored >> state.received >> state.wrong >> state.lost >>
      state.watched >> state.low >> state.high >> state.watch_lost >> state.largest_gap_ns;
  EXPECT_FALSE(subscriber.fail()) << "the honest subscriber does not answer: " << subscriber.str();
  return state;
}

wire::DaemonCounters Stage::counters() {
  WireClient observer(socket_path());
  wire::Observe observe{};
  observe.fingerprint = abi::fingerprint();
  EXPECT_EQ(observer.ask(wire::Opcode::observe, observe).opcode(), wire::Opcode::observed);
  observer.send(wire::Opcode::dump, wire::Dump{});
  wire::DaemonCounters counters{};
  for (;;) {
    const Incoming packet = observer.next();
    if (packet.opcode() == wire::Opcode::dump_daemon)
      counters = packet.as<wire::DumpDaemon>().counters;
    if (packet.bytes.empty() || packet.opcode() == wire::Opcode::dump_end) return counters;
  }
}

void Stage::honest_goes_on() {
  const State before = state();
  State now;
  EXPECT_TRUE(eventually([&] {
    now = state();
    return testing::Test::HasFailure() ||
           (now.published >= before.published + 100 && now.received >= before.published + 100);
  })) << "published "
      << before.published << " then " << now.published << ", received " << before.received
      << " then " << now.received;
  EXPECT_EQ(now.refused, 0u) << "publish reported:" << now.refusal;
  EXPECT_EQ(now.wrong, 0u);
  EXPECT_EQ(now.lost, 0u);
}

void Stage::honest_is_served() {
  EXPECT_EQ(subscriber_->ask("create /served" + std::to_string(++served_)), "ok");
}

void Stage::honest_lost_nothing() {
  judged_ = true;
  EXPECT_TRUE(daemon_.is_running()) << daemon_.log();
  EXPECT_EQ(publisher_->ask("stop"), "ok");
  EXPECT_TRUE(eventually([&] {
    const State now = state();
    return now.received >= now.published;
  }));
  const State end = state();
  EXPECT_EQ(end.received, end.published);
  EXPECT_EQ(end.refused, 0u) << "publish reported:" << end.refusal;
  EXPECT_EQ(end.wrong, 0u);
  EXPECT_EQ(end.lost, 0u);
  const double gap_ms = static_cast<double>(end.largest_gap_ns) / 1e6;
  std::printf("honest: %llu messages, %llu lost, %llu refused, largest gap %.1f ms\n",
              static_cast<unsigned long long>(end.received),
              static_cast<unsigned long long>(end.lost),
              static_cast<unsigned long long>(end.refused), gap_ms);
  row_->write(daemon_.pid(),
              victim_.value_or(AttackRow::Victim{end.received, end.lost, end.refused, gap_ms}));
}

void Stage::victim_was(SteeredProcess& publisher) {
  std::istringstream state(publisher.ask("state"));
  std::uint64_t published = 0, refused = 0, ignored = 0, gap_ns = 0;
  state >> published >> refused;
  for (int i = 0; i < 7; ++i) state >> ignored;
  state >> gap_ns;
  EXPECT_FALSE(state.fail()) << "the victim does not answer: " << state.str();
  victim_ = AttackRow::Victim{published, 0, refused, static_cast<double>(gap_ns) / 1e6};
}

void Attack::ready() { EXPECT_EQ(::write(ready_, "", 1), 1); }

bool Attack::goes_on() const {
  pollfd stop{stop_, POLLIN, 0};
  return ::poll(&stop, 1, 0) == 0;
}

Attacker::Attacker(std::function<void(Attack&)> body, uid_t uid) {
  void* const shared = ::mmap(nullptr, sizeof(Attack::Word) * (word_count + 1),
                              PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
  if (shared == MAP_FAILED) std::abort();
  words_ = static_cast<Attack::Word*>(shared);
  int stop[2], ready[2];
  if (::pipe2(stop, O_CLOEXEC) != 0 || ::pipe2(ready, O_CLOEXEC) != 0) std::abort();
  std::fflush(nullptr);
  child_ = std::make_unique<Child>([&] {
    ::close(stop[1]);
    ::close(ready[0]);
    // The attacker ends with its test.
    ::prctl(PR_SET_PDEATHSIG, SIGKILL);
    if (::setgroups(0, nullptr) != 0 || ::setgid(uid) != 0 || ::setuid(uid) != 0) return 99;
    // Dumpable as any process that was this user's from the beginning, so its /proc entries belong
    // to it.
    ::prctl(PR_SET_DUMPABLE, 1);
    testing::UnitTest::GetInstance()->listeners().Append(new Failures(words_[word_count]));
    Attack attack(words_, stop[0], ready[1]);
    body(attack);
    std::fflush(nullptr);
    return testing::Test::HasFailure() ? 98 : 0;
  });
  stop_.reset(stop[1]);
  ready_.reset(ready[0]);
  ::close(stop[0]);
  ::close(ready[1]);
}

Attacker::~Attacker() {
  child_.reset();
  ::munmap(words_, sizeof(Attack::Word) * (word_count + 1));
}

bool Attacker::wait_until_ready() {
  char byte = 0;
  const bool ready = ::read(ready_.get(), &byte, 1) == 1;
  EXPECT_TRUE(ready) << "the attacker ended before it had begun";
  return ready;
}

void Attacker::end() {
  stop_.reset();
  EXPECT_EQ(child_->wait(), 0) << "98: an expectation of the attacker failed, see above";
}

void Attacker::kill() {
  child_->kill();
  EXPECT_EQ(child_->wait(), -SIGKILL);
  EXPECT_EQ(words_[word_count].load(), 0u) << "an expectation of the attacker failed, see above";
}

Chance::Chance(std::uint64_t seed) {
  if (const char* const wanted = std::getenv("AGNOCAST_SEED"); wanted != nullptr)
    seed = std::strtoull(wanted, nullptr, 0);
  std::printf("seed %llu (AGNOCAST_SEED=)\n", static_cast<unsigned long long>(seed));
  engine_.seed(seed);
}

std::uint64_t Chance::nasty() {
  switch (engine_() % 6) {
    case 0:
      return 0;
    case 1:
      return ~std::uint64_t{0} - engine_() % 3;
    case 2:
      return std::uint64_t{1} << engine_() % 64;
    case 3:
      return (std::uint64_t{1} << engine_() % 64) - 1;
    case 4:
      return engine_() % 4096;
    default:
      return engine_();
  }
}

std::chrono::milliseconds attack_time() {
  const char* const seconds = std::getenv("AGNOCAST_ATTACK_SECONDS");
  return std::chrono::seconds(seconds != nullptr ? std::atol(seconds) : 2);
}

}  // namespace agnocast::test
