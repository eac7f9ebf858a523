// SPDX-License-Identifier: Apache-2.0
//
// recovery_bench: what a death costs those who live. Real processes, the real daemon and its
// supervisor, SIGKILL. It asserts no time; what does not happen within ten seconds ends it with a
// sentence. Without options it is over within two minutes, and what the large heap takes.
//
// This process is the peer of whoever dies: it subscribes to the dying publisher and publishes to the
// dying subscriber. All durations begin before kill():
//   ended    its pidfd is readable: the kernel has taken its memory down. What comes before is not ours
//   told     the peer's event callback runs: nobody is matched any more
//   back     the publisher's message that the dead subscriber held is destroyed, its memory free again
//   free     the daemon has given back everything: place, addresses, descriptors; the peer has unmapped
//   creation meanwhile   with a large heap: the longest of the creations that this process asks for all
//            the time until then
// told and back are taken where they happen; ended and free (a line of the daemon's log) are looked for every 100 µs.
//
//   answered   a creation that was asked for just after the daemon's death is answered
//   all back   every client has rejoined
// Beside it a stream of 1 kHz: in turn a second with a death of the daemon and a creation every 200 ms, and a
// second with the creations alone.

#include <bench/recovery_client.hpp>
#include <bench/recovery_figures.hpp>
#include <tests/support/daemon_process.hpp>
#include <tests/support/steered_process.hpp>

#include <agnocast/agnocast.hpp>
#include <base/pidfd.hpp>

#include <fcntl.h>
#include <getopt.h>
#include <gtest/gtest.h>
#include <poll.h>
#include <sys/prctl.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <memory>
#include <string>
#include <thread>
#include <vector>

namespace agnocast::bench {
namespace {

constexpr std::int64_t second = 1'000'000'000;
constexpr std::int64_t patience_ns = 10 * second;
constexpr std::chrono::microseconds look_every{100};
constexpr std::chrono::milliseconds between_restarts{200};
constexpr std::size_t restarts_in_a_row = 5;
constexpr std::size_t small_bytes = 1000;

[[noreturn]] void give_up(const std::string& what) {
  std::fprintf(stderr, "recovery_bench: %s\n", what.c_str());
  std::fflush(stdout);
  ::_exit(1);  // destructors would wait for what does not happen
}

template <class Condition>
void wait_until(Condition holds, const std::string& what) {
  for (const std::int64_t end = now_ns() + patience_ns; !holds();) {
    if (now_ns() > end) give_up(what + " did not happen within 10 s");
    std::this_thread::sleep_for(look_every);
  }
}

/// What the daemon has written since begin().
class LogTail {
 public:
  explicit LogTail(const std::string& path) : file_(::open(path.c_str(), O_RDONLY | O_CLOEXEC)) {}
  void begin() {
    at_ = ::lseek(file_.get(), 0, SEEK_END);
    text_.clear();
  }
  std::size_t count(const char* event) {
    char part[8192];
    for (ssize_t got; (got = ::pread(file_.get(), part, sizeof part, at_)) > 0; at_ += got)
      text_.append(part, static_cast<std::size_t>(got));
    std::size_t found = 0;
    for (std::size_t i = 0; (i = text_.find(event, i)) != std::string::npos; ++i) ++found;
    return found;
  }

 private:
  UniqueFd file_;
  off_t at_ = 0;
  std::string text_;
};

/// What the peer is told about who matches it, and when.
struct Matched {
  std::atomic<std::int64_t> gone_ns{0};
  std::atomic<std::size_t> count{0};
  auto callback() {
    return [this](MatchedInfo& info) {
      count = info.current_count;
      if (info.current_count == 0) gone_ns = now_ns();
    };
  }
};

/// Receives the stream; runs in a thread of the library.
class Stream {
 public:
  void receive(const Sample& sample) {
    const std::int64_t now = now_ns();
    if (last_number_ != 0) {
      lost_ += sample.number - last_number_ - 1;
      gaps_[phase].push_back(now - last_ns_);
    }
    last_number_ = sample.number;
    last_ns_ = now;
    ++count;
  }
  enum Phase { warming_up, quiet, deadly, phase_count };
  const std::vector<std::int64_t>& gaps(Phase of) const { return gaps_[of]; }
  std::uint64_t lost() const { return lost_; }
  std::atomic<Phase> phase{warming_up};
  std::atomic<std::uint64_t> count{0};

 private:
  std::uint64_t last_number_ = 0, lost_ = 0;
  std::int64_t last_ns_ = 0;
  std::vector<std::int64_t> gaps_[phase_count];
};

class Bench {
 public:
  explicit Bench(test::DaemonProcess& daemon) : daemon_(daemon), log_(daemon.directory() + "/log") {
    SubscriptionOptions listening;
    listening.matched_callback(at_subscription_.callback());
    subscription_ = create_subscription<Sample>(
        node_, topic_of_dying_publisher, QoS(1).transient_local(),
        [this](const ipc_shared_ptr<const Sample>& sample) {
          touch(*sample);
          ++heard_;
        },
        listening);
    PublisherOptions speaking;
    speaking.matched_callback(at_publisher_.callback());
    publisher_ = create_publisher<Sample>(node_, topic_of_dying_subscriber, QoS(1), speaking);
  }

  void publisher_deaths(std::size_t rounds, std::size_t bytes, const std::string& how,
                        double seconds) {
    const std::string who = "publisher dies, " + how + ": ";
    std::fprintf(stderr, "… %s%zu times\n", who.c_str(), rounds);
    Series ended{who + "ended", {}}, told{who + "its subscription is told", {}},
        free{who + "everything free", {}}, meanwhile{who + "longest creation meanwhile", {}};
    for (const std::int64_t end = budget(seconds); rounds > 0 && now_ns() < end; --rounds) {
      const std::uint64_t heard = heard_;
      const auto victim = start("publisher", std::to_string(bytes));
      wait_until([&] { return heard_ != heard; }, "a new publisher's message");
      kill(*victim, at_subscription_,
           {ended, told, free, bytes > small_bytes ? &meanwhile : nullptr}, nullptr);
    }
    for (Series* series : {&ended, &told, &free, &meanwhile}) add(std::move(*series));
  }

  void subscriber_deaths(std::size_t rounds, std::size_t bytes, const std::string& how,
                         double seconds) {
    const std::string who = "subscriber dies, " + how + ": ";
    std::fprintf(stderr, "… %s%zu times\n", who.c_str(), rounds);
    Series ended{who + "ended", {}}, told{who + "its publisher is told", {}},
        back{who + "the message it held is free", {}}, free{who + "everything free", {}},
        meanwhile{who + "longest creation meanwhile", {}};
    for (const std::int64_t end = budget(seconds); rounds > 0 && now_ns() < end; --rounds) {
      const auto victim = process("subscriber", "");
      wait_until([&] { return at_publisher_.count == 1; }, "the match of a new subscriber");
      auto message = publisher_->borrow_loaned_message();
      message->bytes.resize(bytes, 1);
      Sample::destroyed_ns = 0;
      if (!publisher_->publish(std::move(message))) give_up("a message was not published");
      await(*victim, "subscriber");
      if (Sample::destroyed_ns != 0) give_up("a message was destroyed while it was held");
      kill(*victim, at_publisher_, {ended, told, free, bytes > small_bytes ? &meanwhile : nullptr},
           &back);
    }
    for (Series* series : {&ended, &told, &back, &free, &meanwhile}) add(std::move(*series));
  }

  void daemon_deaths(std::size_t rounds, const std::string& how, double seconds) {
    std::fprintf(stderr, "… daemon dies, %s: %zu times\n", how.c_str(), rounds);
    Series without{"no death, " + how + ": creation answered", {}},
        answered{"daemon dies, " + how + ": creation answered", {}},
        all_back{"daemon dies, " + how + ": all clients back", {}};
    Stream stream;
    Node node("listener");
    auto subscription = create_subscription<Sample>(
        node, topic_of_stream, QoS(stream_depth),
        [&](const ipc_shared_ptr<const Sample>& sample) { stream.receive(*sample); });
    auto source = start("stream", "");
    wait_until([&] { return stream.count > 100; }, "the hundredth message of a stream");
    const std::int64_t end = budget(seconds);
    for (std::size_t done = 0; done < rounds && now_ns() < end; done += restarts_in_a_row) {
      stream.phase = Stream::quiet;
      for (std::size_t i = 0; i < restarts_in_a_row; ++i)
        paced([&] { without.ns.push_back(time_of_creation()); });
      stream.phase = Stream::deadly;
      for (std::size_t i = 0; i < restarts_in_a_row; ++i)
        paced([&] { kill_daemon(answered, all_back); });
    }
    // What is under way is received before it is said that nothing was lost.
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
    subscription.reset();
    source.reset();
    for (Series* series : {&without, &answered, &all_back}) add(std::move(*series));
    Series gaps[2]{
        {"1 kHz stream, " + how + ", no death: gap", stream.gaps(Stream::quiet)},
        {"1 kHz stream, " + how + ", a death each 200 ms: gap", stream.gaps(Stream::deadly)}};
    const double ratio = static_cast<double>(gaps[1].at(1)) / static_cast<double>(gaps[0].at(1));
    for (Series& series : gaps) figures_.add(std::move(series));
    figures_.add_number("1 kHz stream, " + how + ": longest gap with deaths / without", ratio);
    figures_.add_number("1 kHz stream, " + how + ": messages lost",
                        static_cast<double>(stream.lost()));
    if (stream.lost() != 0) give_up("the stream lost messages");
  }

  void start_idle(std::size_t count) {
    std::fprintf(stderr, "… starting %zu idle processes\n", count);
    for (std::size_t i = 0; i < count; ++i)
      idle_.push_back(start("idle", "/recovery/idle" + std::to_string(i)));
  }

  const Figures& figures() const { return figures_; }

 private:
  void add(Series series) {
    if (!series.ns.empty()) figures_.add(std::move(series));
  }
  static std::int64_t budget(double seconds) {
    return now_ns() + static_cast<std::int64_t>(seconds * 1e9);
  }
  std::unique_ptr<test::SteeredProcess> process(const std::string& role,
                                                const std::string& argument) const {
    return std::make_unique<test::SteeredProcess>(
        std::vector<std::string>{"/proc/self/exe", "--be", role, argument},
        std::vector<std::string>{"AGNOCAST_SOCKET=" + daemon_.socket_path()});
  }
  static void await(test::SteeredProcess& process, const std::string& role) {
    const std::string answer = process.answer(10);
    if (answer != "ready") give_up("a new process, " + role + ", is not ready: " + answer);
  }
  std::unique_ptr<test::SteeredProcess> start(const std::string& role,
                                              const std::string& argument) const {
    auto started = process(role, argument);
    await(*started, role);
    return started;
  }

  struct DeathFigures {
    Series &ended, &told, &free;
    Series* meanwhile;  // null: nothing is created meanwhile
  };
  void kill(test::SteeredProcess& victim, Matched& peer, const DeathFigures& figures,
            Series* back) {
    const auto pidfd = Pidfd::open(victim.pid());
    if (!pidfd) give_up("a living process has no pidfd");
    std::this_thread::sleep_for(std::chrono::milliseconds(3));  // what its start caused is over
    log_.begin();
    peer.gone_ns = 0;
    std::int64_t ended_ns = 0, free_ns = 0, longest_ns = 0;
    std::atomic<bool> over{false};
    std::thread creator([&] {
      while (!over && figures.meanwhile != nullptr)
        longest_ns = std::max(longest_ns, time_of_creation());
    });
    const std::int64_t killed = now_ns();
    ::kill(victim.pid(), SIGKILL);
    const auto is_over = [&] {
      pollfd end{pidfd->fd(), POLLIN, 0};
      if (ended_ns == 0 && ::poll(&end, 1, 0) == 1) ended_ns = now_ns();
      if (free_ns == 0 && log_.count(" client place free ") != 0) free_ns = now_ns();
      return ended_ns != 0 && free_ns != 0 && peer.gone_ns != 0 &&
             (back == nullptr || Sample::destroyed_ns != 0);
    };
    for (const std::int64_t until = killed + patience_ns; !is_over();) {
      if (now_ns() > until)
        give_up(std::string("10 s after a death of a client: ") +
                (ended_ns == 0       ? "it has not ended"
                 : peer.gone_ns == 0 ? "its peer does not know"
                 : free_ns == 0      ? "the daemon has not given everything back"
                                     : "the message that it held is not free"));
      std::this_thread::sleep_for(look_every);
    }
    over = true;
    creator.join();
    figures.ended.ns.push_back(ended_ns - killed);
    figures.told.ns.push_back(peer.gone_ns - killed);
    figures.free.ns.push_back(free_ns - killed);
    if (figures.meanwhile != nullptr) figures.meanwhile->ns.push_back(longest_ns);
    if (back != nullptr) back->ns.push_back(Sample::destroyed_ns - killed);
  }

  std::int64_t time_of_creation() {
    const std::int64_t begin = now_ns();
    const auto made = try_create_subscription<Sample>(node_, "/recovery/late", QoS(1));
    if (!made) give_up("a creation was refused: " + text_of(made.error()));
    return now_ns() - begin;
  }
  void kill_daemon(Series& answered, Series& all_back) {
    const pid_t worker = daemon_.pid();
    log_.begin();
    const std::int64_t killed = now_ns();
    ::kill(worker, SIGKILL);
    time_of_creation();
    answered.ns.push_back(now_ns() - killed);
    const std::size_t clients = idle_.size() + 2;  // this process and the stream's
    wait_until([&] { return log_.count(" client is back ") >= clients; },
               "the return of all clients after a death of the daemon");
    all_back.ns.push_back(now_ns() - killed);
    if (daemon_.pid() == worker) give_up("the daemon outlived its SIGKILL");
  }
  template <class Action>
  static void paced(Action action) {
    const auto next = Clock::now() + between_restarts;
    action();
    std::this_thread::sleep_until(next);
  }

  test::DaemonProcess& daemon_;
  LogTail log_;
  Node node_{"peer"};
  Matched at_subscription_, at_publisher_;
  std::atomic<std::uint64_t> heard_{0};
  Subscription<Sample>::SharedPtr subscription_;
  Publisher<Sample>::SharedPtr publisher_;
  std::vector<std::unique_ptr<test::SteeredProcess>> idle_;
  Figures figures_;
};

constexpr const char* usage =
    "usage: recovery_bench [OPTION]...\n"
    "Measures what a death of a client or of agnocastd costs those who live.\n\n"
    "  --rounds=200         deaths of each kind of client; half as many with the large heap, a "
    "quarter\n"
    "                       with idle neighbours, and a quarter of the daemon\n"
    "  --large-mib=1024     what the large heap has mapped and touched, MiB\n"
    "  --large-seconds=300  at most this long for the deaths of each kind of client with it: one "
    "takes\n"
    "                       most of a second, and a 99th percentile needs a hundred\n"
    "  --idle=100           processes that are connected and do nothing, in the last part\n"
    "  --json=FILE          writes the figures there as well\n"
    "  --help               this text\n\n"
    "Exit status: 0 measured, 1 something did not happen in time, 2 the command line is wrong.\n";

struct Options {
  std::size_t rounds = 200, large_mib = 1024, large_seconds = 300, idle = 100;
  std::string json;
};

[[noreturn]] void refuse(const std::string& what) {
  std::fprintf(stderr, "%shint: recovery_bench --help\n", what.c_str());
  std::exit(2);
}

Options parse(int argc, char** argv) {
  // Above the greatest, nothing can be multiplied beyond its type; no machine gets there.
  constexpr unsigned long number_max = 1'000'000;
  static constexpr ::option known[] = {{"rounds", required_argument, nullptr, 'r'},
                                       {"large-mib", required_argument, nullptr, 'm'},
                                       {"large-seconds", required_argument, nullptr, 's'},
                                       {"idle", required_argument, nullptr, 'i'},
                                       {"json", required_argument, nullptr, 'j'},
                                       {"help", no_argument, nullptr, 'h'},
                                       {nullptr, 0, nullptr, 0}};
  Options options;
  int index = 0;
  for (int found; (found = ::getopt_long(argc, argv, "", known, &index)) != -1;) {
    if (found == '?') refuse("");  // getopt_long has said what is wrong
    if (found == 'h') {
      std::fputs(usage, stdout);
      std::exit(0);
    }
    if (found == 'j') {
      options.json = optarg;
      continue;
    }
    char* end = nullptr;
    const unsigned long number = std::strtoul(optarg, &end, 10);
    // A crowd may be none; everything else is needed.
    if (optarg[0] < '0' || optarg[0] > '9' || *end != '\0' || number > number_max ||
        (number == 0 && found != 'i'))
      refuse(std::string("recovery_bench: --") + known[index].name + "=" + optarg +
             ": expected a whole number from " + (found == 'i' ? "0" : "1") + " to " +
             std::to_string(number_max) + "\n");
    (found == 'r'   ? options.rounds
     : found == 'm' ? options.large_mib
     : found == 's' ? options.large_seconds
                    : options.idle) = number;
  }
  if (optind < argc)
    refuse(std::string("recovery_bench: unexpected argument '") + argv[optind] + "'\n");
  return options;
}

int run(const Options& options) {
  const auto& [rounds, large_mib, large_seconds, idle, json] = options;
  const auto part = [rounds = rounds](std::size_t of) {
    return std::max<std::size_t>(rounds / of, 1);
  };
  ::prctl(PR_SET_TIMERSLACK, 1UL);
  test::DaemonProcess daemon({.config = "[daemon]\nlog_level = \"debug\"\n"
                                        "[heap]\nwindow_bytes = \"4GiB\"\n"});
  ::setenv("AGNOCAST_SOCKET", daemon.socket_path().c_str(), 1);
  double load = 0;
  std::ifstream("/proc/loadavg") >> load;
  std::printf("%u cores, load %.1f, resources looked at every %lld µs\n",
              std::thread::hardware_concurrency(), load,
              static_cast<long long>(look_every.count()));
  Figures::print_head();
  // The seconds are what a loaded machine may take for 200 rounds; then there are fewer samples.
  const double unit = std::max(1.0, static_cast<double>(rounds) / 200);
  Bench bench(daemon);
  bench.publisher_deaths(rounds, small_bytes, "small heap", 12 * unit);
  bench.subscriber_deaths(rounds, small_bytes, "small heap", 12 * unit);
  const std::string large = std::to_string(large_mib) + " MiB";
  const auto large_budget = static_cast<double>(large_seconds);
  bench.publisher_deaths(part(2), large_mib << 20, large, large_budget);
  bench.subscriber_deaths(part(2), large_mib << 20, large, large_budget);
  bench.daemon_deaths(part(4), "few clients", 25 * unit);
  bench.start_idle(idle);
  const std::string crowd = std::to_string(idle) + " idle clients";
  bench.publisher_deaths(part(4), small_bytes, crowd, 6 * unit);
  bench.subscriber_deaths(part(4), small_bytes, crowd, 6 * unit);
  bench.daemon_deaths(part(8), crowd, 15 * unit);
  if (!json.empty() && !bench.figures().write(json)) give_up("cannot write " + json);
  return testing::Test::HasFailure() ? 1 : 0;
}

}  // namespace
}  // namespace agnocast::bench

int main(int argc, char** argv) {
  try {
    if (argc == 4 && std::strcmp(argv[1], "--be") == 0) agnocast::bench::be(argv[2], argv[3]);
    return agnocast::bench::run(agnocast::bench::parse(argc, argv));
  } catch (const std::exception& error) {
    agnocast::bench::give_up(error.what());
  }
}
