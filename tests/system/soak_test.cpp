// SPDX-License-Identifier: Apache-2.0
//
// Goal: no death of any process at any moment ever makes a message wrong, lost or late for ever,
// or leaves anything behind.
// Method: processes with the real library, hook and daemon come and go as fast as the machine
// allows. They are killed at random moments and at random crash points, delayed at others, stopped
// and continued. Freed payload is poisoned; every message is compared at take and at release. Two
// residents live through all of it and account for every committed message (soak_client.cpp). In
// the end all processes leave, and the test counts the remains.
//
//   system_soak [--minutes=N] [--seed=N] [--processes=N] [--daemons=N]
//                          one minute, a seed of its own, 12, 10 deaths of the daemon a minute at
//                          random moments, and about as many at crash points
//   AGNOCAST_SOAK_MINUTES, AGNOCAST_SEED                    the same, for ctest
//
// A seed repeats what the processes intend, not the machine's interleaving.

#include <base/descriptors/unique_fd.hpp>
#include <tests/support/crash/step_names.hpp>
#include <tests/support/processes/ctl.hpp>
#include <tests/support/processes/daemon_process.hpp>
#include <tests/system/random.hpp>
#include <tests/system/soak_client.hpp>

#include <gtest/gtest.h>

#include <fcntl.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <bitset>
#include <csignal>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

namespace agnocast::test {
namespace {

constexpr std::size_t resident_count = 2;
// Without any progress for this long the system hangs; the machine may be busy.
constexpr std::uint64_t watchdog_ns = 30 * second;

/// Returns --NAME=VALUE, else the variable, else `otherwise`.
double option(std::string_view name, const char* variable, double otherwise) {
  std::ifstream arguments("/proc/self/cmdline");
  for (std::string argument; std::getline(arguments, argument, '\0');) {
    if (argument.rfind("--" + std::string(name) + "=", 0) == 0)
      return std::strtod(argument.c_str() + name.size() + 3, nullptr);
  }
  const char* const text = variable != nullptr ? std::getenv(variable) : nullptr;
  return text != nullptr ? std::strtod(text, nullptr) : otherwise;
}

struct Deaths {
  std::uint64_t all = 0, publishers = 0, subscribers = 0, unjoined = 0, at_points = 0;
  std::uint64_t stops = 0, left = 0;
  std::bitset<step_bound> steps;
};

/// Keeps the places filled with processes, and kills them.
class Herd {
 public:
  Herd(SoakBoard& board, std::uint64_t seed, std::size_t count)
      : board_(board), random_(seed), flies_(resident_count + count) {}
  ~Herd() {
    for (std::size_t i = 0; i < flies_.size(); ++i) end(i);
  }

  void start_residents() {
    for (std::size_t i = 0; i < resident_count; ++i) start(i);
  }
  /// One round: kills the processes that are due, replaces those that have ended.
  void tend() {
    const std::uint64_t now = now_ns();
    for (std::size_t i = 0; i < flies_.size(); ++i) {
      Fly& fly = flies_[i];
      if (fly.pid > 0) {
        if (fly.continue_ns != 0 && fly.continue_ns <= now) {
          ::kill(fly.pid, SIGCONT);
          fly.continue_ns = 0;
        }
        if (fly.kill_ns == 0 && board_.place[i].joined != 0) fly.kill_ns = now + life_ns();
        if (fly.kill_ns != 0 && fly.kill_ns <= now) ::kill(fly.pid, SIGKILL);
        reap(i, WNOHANG);
      }
      if (fly.pid <= 0 && i >= resident_count) start(i);
    }
    if (random_.below(1000) < 10) stop_somebody(now);
  }
  void kill_mayflies() {
    for (std::size_t i = resident_count; i < flies_.size(); ++i) end(i);
  }
  /// Starts `phase` when all residents wait for it; false if one does not get there.
  [[nodiscard]] bool lead_to(SoakBoard::Phase phase) {
    const std::uint64_t end = now_ns() + 4 * watchdog_ns;
    for (std::size_t i = 0; i < resident_count; ++i) {
      if (flies_[i].pid > 0) ::kill(flies_[i].pid, SIGCONT);
      while (board_.place[i].waits_for != phase) {
        reap(i, WNOHANG);
        if (flies_[i].pid <= 0 || now_ns() > end || board_.complaint_count != 0) return false;
        ::usleep(1000);
      }
    }
    board_.phase = phase;
    return true;
  }
  void wait_for_residents() {
    for (std::size_t i = 0; i < resident_count; ++i) reap(i, 0);
  }
  const Deaths& deaths() const noexcept { return deaths_; }

 private:
  struct Fly {
    pid_t pid = -1;
    std::uint64_t kill_ns = 0;      // 0: not decided until it has joined
    std::uint64_t continue_ns = 0;  // 0: not stopped
  };

  void start(std::size_t i) {
    SoakPlace& place = board_.place[i];
    const bool is_resident = i < resident_count;
    for (Word* word :
         {&place.control.reached, &place.control.deadly, &place.control.last, &place.joined,
          &place.publishers, &place.subscriptions, &place.reading_token, &place.waits_for})
      *word = 0;
    place.control.seed = random_.next() | 1;
    place.control.sleeps = random_.chance(50) ? 200 : 2000;
    place.control.deaths = is_resident ? 0 : random_.chance(50) ? 0 : 300;
    const std::uint64_t seed = random_.next();
    const pid_t parent = ::getpid();
    const pid_t pid = ::fork();
    if (pid == 0) {
      ::prctl(PR_SET_PDEATHSIG, SIGKILL);
      if (::getppid() != parent) ::_exit(0);
      if (is_resident) run_resident(board_, place, seed);
      run_mayfly(board_, place, seed);
    }
    flies_[i] = {pid, 0, 0};
    if (is_resident) flies_[i].kill_ns = ~std::uint64_t{0};
    // Some die while they join, the others some time after it.
    if (!is_resident && random_.chance(20))
      flies_[i].kill_ns = now_ns() + random_.below(10 * millisecond);
  }
  std::uint64_t life_ns() { return random_.below(random_.chance(95) ? 30 * millisecond : second); }
  void stop_somebody(std::uint64_t now) {
    Fly& fly = flies_[random_.below(flies_.size())];
    if (fly.pid <= 0 || fly.continue_ns != 0) return;
    ::kill(fly.pid, SIGSTOP);
    fly.continue_ns =
        now + random_.below(random_.chance(90) ? 20 * millisecond : 300 * millisecond);
    ++deaths_.stops;
  }
  void end(std::size_t i) {
    if (flies_[i].pid <= 0) return;
    ::kill(flies_[i].pid, SIGKILL);
    reap(i, 0);
  }

  void reap(std::size_t i, int options) {
    Fly& fly = flies_[i];
    int status = 0;
    if (fly.pid <= 0 || ::waitpid(fly.pid, &status, options) != fly.pid) return;
    fly.pid = -1;
    const SoakPlace& place = board_.place[i];
    if (WIFEXITED(status) && WEXITSTATUS(status) == 0) {
      ++deaths_.left;
    } else if (WIFSIGNALED(status) && WTERMSIG(status) == SIGKILL) {
      ++deaths_.all;
      if (place.joined == 0) ++deaths_.unjoined;
      if (place.publishers != 0) ++deaths_.publishers;
      if (place.subscriptions != 0) ++deaths_.subscribers;
      if (const std::uint64_t step = place.control.last; step != 0) {
        ++deaths_.at_points;
        deaths_.steps.set(step - 1);
      }
    } else {
      board_.complain("place %zu ended with %s %d, reading number %llu of token %#llx", i,
                      WIFSIGNALED(status) ? "signal" : "status",
                      WIFSIGNALED(status) ? WTERMSIG(status) : WEXITSTATUS(status),
                      static_cast<unsigned long long>(place.reading_number.load()),
                      static_cast<unsigned long long>(place.reading_token.load()));
    }
  }

  SoakBoard& board_;
  Random random_;
  std::vector<Fly> flies_;
  Deaths deaths_;
};

/// The daemon's crash points: each daemon in turn uses the same control.
class DaemonControl {
 public:
  DaemonControl() : file_(::memfd_create("soak", MFD_CLOEXEC)) {
    if (!file_ || ::ftruncate(file_.get(), sizeof(crash_points::Control)) != 0) std::abort();
    void* const at = ::mmap(nullptr, sizeof(crash_points::Control), PROT_READ | PROT_WRITE,
                            MAP_SHARED, file_.get(), 0);
    if (at == MAP_FAILED) std::abort();
    control_ = static_cast<crash_points::Control*>(at);
  }
  ~DaemonControl() { ::munmap(control_, sizeof *control_); }
  DaemonControl(const DaemonControl&) = delete;
  DaemonControl& operator=(const DaemonControl&) = delete;

  crash_points::Control& operator*() const noexcept { return *control_; }
  crash_points::Control* operator->() const noexcept { return control_; }
  std::string variable() const {
    return "AGNOCAST_CRASH_CONTROL=/proc/" + std::to_string(::getpid()) + "/fd/" +
           std::to_string(file_.get());
  }

 private:
  UniqueFd file_;
  crash_points::Control* control_ = nullptr;
};

/// Kills the daemon, at random moments and at its crash points. Another one takes over.
class DaemonKiller {
 public:
  DaemonKiller(DaemonProcess& daemon, crash_points::Control& control, double a_minute,
               std::uint64_t seed)
      : daemon_(daemon), control_(control), random_(seed), is_idle_(a_minute <= 0) {
    control_.sleeps = 200;
    control_.seed = random_.next() | 1;
    if (is_idle_) return;
    life_ns_ = static_cast<std::uint64_t>(60e9 / a_minute);
    control_.deaths = static_cast<std::uint64_t>(a_minute / points_a_minute * 1e6);
    due_ns_ = now_ns() + random_.below(2 * life_ns_);
  }
  void tend() {
    if (is_idle_ || now_ns() < due_ns_) return;
    if (const pid_t worker = daemon_.pid(); worker > 0) last_ = daemon_.kill_worker();
    due_ns_ = now_ns() + random_.below(2 * life_ns_);
  }
  bool is_idle() const noexcept { return is_idle_; }
  /// Stops the deaths; returns false when no daemon serves.
  [[nodiscard]] bool rest() {
    control_.seed = 0;
    return daemon_.wait_for_next(last_);
  }
  std::uint64_t deaths() const {
    const std::string log = daemon_.log();
    std::uint64_t count = 0;
    for (std::size_t at = 0; (at = log.find(" worker died ", at)) != std::string::npos; ++at)
      ++count;
    return count;
  }

 private:
  static constexpr double points_a_minute = 4e6;  // the rate at a busy daemon

  DaemonProcess& daemon_;
  crash_points::Control& control_;
  Random random_;
  const bool is_idle_;
  std::uint64_t life_ns_ = 0, due_ns_ = 0;
  pid_t last_ = -1;
};

class Soak : public testing::Test {
 protected:
  Soak() {
    ::setenv("AGNOCAST_SOCKET", daemon_.socket_path().c_str(), 1);
    ::unsetenv("ROS_DOMAIN_ID");
  }

  /// Returns false when something is wrong; the end of the test prints it.
  bool is_well() { return board_.complaint_count == 0 && daemon_.is_running(); }
  /// Complains when `now` has not grown since the last time.
  void expect_progress(const char* what, std::uint64_t now, std::uint64_t& before) {
    if (now == before)
      board_.complain("no progress: still %llu %s", static_cast<unsigned long long>(now), what);
    before = now;
  }

  /// All processes go on meanwhile; a thread that got no processor for seconds can look broken,
  /// and a daemon that dies cannot answer. So several looks.
  bool verify_alive() {
    CtlResult last;
    for (int look = 0; look < 5; ++look) {
      last = run_ctl(daemon_.socket_path(), {"verify"});
      if (last.status == 0) return true;
    }
    ADD_FAILURE() << "agnocast-ctl verify: status " << last.status << "\n" << last.out << last.err;
    return false;
  }
  /// Returns the count without connections. The daemon and ctl close theirs shortly after their
  /// answers.
  std::size_t settled_descriptors() const {
    std::size_t count = 0;
    EXPECT_TRUE(eventually([&] {
      const std::size_t before = std::exchange(count, daemon_.descriptor_count());
      ::usleep(50'000);
      return count == before;
    }));
    return count;
  }
  nlohmann::json status() { return run_ctl(daemon_.socket_path(), {"status", "--json"}).json(); }

  void print(const Deaths& deaths, std::uint64_t of_daemon, double minutes) const {
    const auto number = [](std::uint64_t value) { return static_cast<unsigned long long>(value); };
    std::printf(
        "soak: %llu deaths in %.1f minutes, %.0f a minute\n"
        "  of publishers %llu, of subscribers %llu, before they had joined %llu, of the daemon "
        "%llu\n"
        "  at crash points %llu, at %zu different ones; %llu left properly; %llu stops\n"
        "  %llu published, %llu taken and verified, %llu verified again at release, %llu lost\n"
        "  %llu bytes verified, %llu messages wrong\n",
        number(deaths.all), minutes, static_cast<double>(deaths.all) / minutes,
        number(deaths.publishers), number(deaths.subscribers), number(deaths.unjoined),
        number(of_daemon), number(deaths.at_points), deaths.steps.count(), number(deaths.left),
        number(deaths.stops), number(board_.published), number(board_.taken),
        number(board_.released), number(board_.lost), number(board_.verified_bytes),
        number(board_.wrong));
    for (std::size_t code = 0; code < SoakBoard::code_count_max; ++code) {
      if (board_.refused[code] != 0)
        std::printf("  refused %llu times: %s\n", number(board_.refused[code]),
                    sentence_of(static_cast<Errc>(code)));
    }
    std::fflush(stdout);
  }
  void report_complaints(std::uint64_t seed) const {
    const std::uint64_t count = board_.complaint_count;
    for (std::uint64_t i = 0; i < std::min<std::uint64_t>(count, SoakBoard::complaint_count_max);
         ++i)
      ADD_FAILURE() << board_.complaint[i];
    if (count != 0) ADD_FAILURE() << count << " complaints with --seed=" << seed;
  }

  SoakBoard& board_ = SoakBoard::make();
  DaemonControl control_;
  DaemonProcess daemon_{{.config = "[daemon]\nlog_level = \"notice\"\n"
                                   "[heap]\nwindow_bytes = \"64MiB\"\narena_bytes = \"256GiB\"\n",
                         .program = AGNOCAST_CRASH_DAEMON,
                         .environment = {control_.variable()}}};
};

// Long because it is one run: start, kill for minutes, end, and the sums of all of it.
TEST_F(Soak, ADeathNeverAffectsRemainingProcesses) {
  const double minutes = option("minutes", "AGNOCAST_SOAK_MINUTES", 1);
  auto seed = static_cast<std::uint64_t>(option("seed", "AGNOCAST_SEED", 0));
  if (seed == 0) seed = now_ns() % 1'000'000'007;
  std::printf("soak: --seed=%llu --minutes=%g\n", static_cast<unsigned long long>(seed), minutes);
  std::fflush(stdout);

  ASSERT_TRUE(verify_alive());
  const std::size_t descriptors = settled_descriptors();

  Herd herd(board_, seed, static_cast<std::size_t>(option("processes", nullptr, 12)));
  herd.start_residents();
  bool well = herd.lead_to(SoakBoard::run);
  while (well &&
         board_.publisher_count < resident_count * static_cast<std::uint64_t>(SoakTopic::count))
    ::usleep(1000);

  const std::uint64_t begin = now_ns();
  const auto end = begin + static_cast<std::uint64_t>(minutes * 60 * static_cast<double>(second));
  DaemonKiller killer(daemon_, *control_, option("daemons", "AGNOCAST_SOAK_DAEMONS", 10), ~seed);
  std::uint64_t look = begin + 10 * second, watch = begin + watchdog_ns, taken = 0, deaths = 0;
  std::array<std::uint64_t, resident_count> looks{};
  while (well && now_ns() < end) {
    herd.tend();
    ::usleep(300);
    well = is_well();
    killer.tend();
    if (now_ns() >= look) {
      well = well && verify_alive();
      look = now_ns() + 10 * second;
    }
    if (now_ns() >= watch) {
      expect_progress("deaths", herd.deaths().all, deaths);
      expect_progress("messages taken", board_.taken, taken);
      for (std::size_t i = 0; i < resident_count; ++i)
        expect_progress("looks of a resident", board_.place[i].looks, looks[i]);
      watch = now_ns() + watchdog_ns;
      if (minutes > 1)
        print(herd.deaths(), killer.deaths(), static_cast<double>(now_ns() - begin) / 6e10);
    }
  }
  const double took_minutes = static_cast<double>(now_ns() - begin) / 6e10;

  if (well) {
    EXPECT_TRUE(killer.rest());
    well = herd.lead_to(SoakBoard::silence);
    herd.kill_mayflies();
    well = well && herd.lead_to(SoakBoard::drain);
    // A living process keeps no place of a dead publisher once it has read its messages.
    EXPECT_TRUE(!well || eventually([&] {
      return status()["in_use"]["processes"] == resident_count;
    })) << status().dump(2);
    for (const auto phase : {SoakBoard::unsubscribe, SoakBoard::unpublish})
      well = well && herd.lead_to(phase);
    well = well && verify_alive() && herd.lead_to(SoakBoard::end);
    if (well) herd.wait_for_residents();
  }
  print(herd.deaths(), killer.deaths(), took_minutes);
  report_complaints(seed);
  if (minutes >= 1) {
    EXPECT_GT(herd.deaths().at_points, 0u)
        << "no process died at a crash point, so the test proves nothing";
    EXPECT_TRUE(killer.is_idle() || killer.deaths() > 0)
        << "the daemon never died, so the test proves nothing";
  }
  ASSERT_TRUE(well) << "--seed=" << seed;

  EXPECT_TRUE(eventually([&] {
    const auto use = status()["in_use"];
    return use["processes"] == 0 && use["topics"] == 0 && use["windows"] == 0;
  })) << status().dump(2);
  EXPECT_TRUE(verify_alive());
  EXPECT_TRUE(eventually([&] { return daemon_.descriptor_count() <= descriptors; }))
      << daemon_.descriptor_count() << " descriptors instead of " << descriptors;
  for (const char* what : {"client lost", "damaged"})
    EXPECT_EQ(daemon_.log().find(what), std::string::npos) << daemon_.log();
  const auto counters = status()["counters"];
  EXPECT_EQ(counters["intents_corrupt"], 0);
  EXPECT_EQ(counters["requests_refused"], 0) << daemon_.log();
  std::printf("  the daemon: %s, %llu crash points\n", counters.dump().c_str(),
              static_cast<unsigned long long>(control_->reached.load()));
}

}  // namespace
}  // namespace agnocast::test
