// SPDX-License-Identifier: Apache-2.0
//
// The peer of the dying process in the case death: it subscribes to the dying publisher and
// publishes to the dying subscriber; a process of its own because it publishes. It prints its
// measurements line by line:
//
//   series NAME        and on the next line nanoseconds, one for each death or gap
//   number NAME        and on the next line a figure
//   step WHAT          its next step
//   failed WHY         an event took more than ten seconds, or a message was lost; then it ends
//   done
//
// All durations begin before kill(); death.cpp defines them. It records told and back at the
// event itself; it polls for ended and free (a line of the daemon's log) every 100 µs.

#include <bench/cases/death_client.hpp>
#include <bench/cases/looking.hpp>
#include <bench/process.hpp>
#include <bench/services.hpp>

#include <agnocast/agnocast.hpp>
#include <base/descriptors/unique_fd.hpp>

#include <fcntl.h>
#include <poll.h>
#include <sys/prctl.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <csignal>
#include <cstdio>
#include <cstdlib>
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

void say(const std::string& what, const std::string& name) {
  std::printf("%s %s\n", what.c_str(), name.c_str());
  std::fflush(stdout);
}
[[noreturn]] void give_up(const std::string& why) {
  say("failed", why);
  ::_exit(1);  // destructors would wait for the missing event
}

/// Durations of one kind.
struct Series {
  std::string what;
  std::vector<std::int64_t> ns;
};

template <class Condition>
void wait_until(Condition holds, const std::string& what) {
  for (const std::int64_t end = now_ns() + patience_ns; !holds();) {
    if (now_ns() > end) give_up(what + " did not happen within 10 s");
    std::this_thread::sleep_for(look_every);
  }
}

/// The daemon's log lines since begin().
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

/// Matched events of the peer, with their times.
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

class Peer {
 public:
  explicit Peer(Daemon& daemon) : daemon_(daemon), log_(daemon.log_path()) {
    executor_.add_node(node_);
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
    say("step", who + std::to_string(rounds) + " times");
    Series ended{who + "ended", {}}, notified{who + "its subscription is notified", {}},
        free{who + "everything free", {}}, meanwhile{who + "longest creation meanwhile", {}};
    for (const std::int64_t end = budget(seconds); rounds > 0 && now_ns() < end; --rounds) {
      const std::uint64_t heard = heard_;
      const auto victim = start("publisher", {std::to_string(bytes)});
      wait_until([&] { return heard_ != heard; }, "a new publisher's message");
      kill(*victim, at_subscription_,
           {ended, notified, free, bytes > small_bytes ? &meanwhile : nullptr}, nullptr);
    }
    for (const Series* series : {&ended, &notified, &free, &meanwhile}) add(*series);
  }

  void subscriber_deaths(std::size_t rounds, std::size_t bytes, const std::string& how,
                         double seconds) {
    const std::string who = "subscriber dies, " + how + ": ";
    say("step", who + std::to_string(rounds) + " times");
    Series ended{who + "ended", {}}, notified{who + "its publisher is notified", {}},
        back{who + "the message it held is free", {}}, free{who + "everything free", {}},
        meanwhile{who + "longest creation meanwhile", {}};
    for (const std::int64_t end = budget(seconds); rounds > 0 && now_ns() < end; --rounds) {
      const auto victim = process("subscriber", {});
      wait_until([&] { return at_publisher_.count == 1; }, "the match of a new subscriber");
      auto message = publisher_->borrow_loaned_message();
      message->bytes.resize(bytes, 1);
      Sample::destroyed_ns = 0;
      if (!publisher_->publish(std::move(message))) give_up("a message was not published");
      await(*victim);
      if (Sample::destroyed_ns != 0) give_up("a message was destroyed while it was held");
      kill(*victim, at_publisher_,
           {ended, notified, free, bytes > small_bytes ? &meanwhile : nullptr}, &back);
    }
    for (const Series* series : {&ended, &notified, &back, &free, &meanwhile}) add(*series);
  }

  void daemon_deaths(std::size_t rounds, const std::string& how, double seconds) {
    say("step", "daemon dies, " + how + ": " + std::to_string(rounds) + " times");
    Series without{"no death, " + how + ": creation answered", {}},
        answered{"daemon dies, " + how + ": creation answered", {}},
        all_back{"daemon dies, " + how + ": all clients back", {}};
    Stream stream;
    Node node("listener");
    BackgroundExecutor executor;
    executor.add_node(node);
    auto subscription = create_subscription<Sample>(
        node, topic_of_stream, QoS(stream_depth),
        [&](const ipc_shared_ptr<const Sample>& sample) { stream.receive(*sample); });
    auto source = start("stream", {});
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
    // Receives the messages in transit before it counts losses.
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
    subscription.reset();
    source.reset();
    for (const Series* series : {&without, &answered, &all_back}) add(*series);
    Series gaps[2]{
        {"1 kHz stream, " + how + ", no death: gap", stream.gaps(Stream::quiet)},
        {"1 kHz stream, " + how + ", a death each 200 ms: gap", stream.gaps(Stream::deadly)}};
    const auto longest = [](const Series& series) {
      return static_cast<double>(*std::max_element(series.ns.begin(), series.ns.end()));
    };
    for (Series& series : gaps) {
      if (series.ns.empty()) give_up("the stream has stood still");
      add(series);
    }
    add("1 kHz stream, " + how + ": longest gap with deaths / without",
        longest(gaps[1]) / longest(gaps[0]));
    add("1 kHz stream, " + how + ": messages lost", static_cast<double>(stream.lost()));
    // A listener that is starved for as long as its queue lasts loses messages without a death.
    const double queue_ns = static_cast<double>(stream_depth) * 1e6;
    if (stream.lost() != 0 && longest(gaps[0]) < queue_ns && longest(gaps[1]) < queue_ns)
      give_up("the stream lost messages");
  }

  void start_idle(std::size_t count) {
    say("step", "starting " + std::to_string(count) + " idle processes");
    for (std::size_t i = 0; i < count; ++i)
      idle_.push_back(start("idle", {"/death/idle" + std::to_string(i)}));
  }

 private:
  static void add(const Series& series) {
    if (series.ns.empty()) return;
    say("series", series.what);
    std::string line;
    for (const std::int64_t ns : series.ns) line += std::to_string(ns) + ' ';
    say("", line);
  }
  static void add(const std::string& what, double value) {
    say("number", what);
    say("", std::to_string(value));
  }
  static std::int64_t budget(double seconds) {
    return now_ns() + static_cast<std::int64_t>(seconds * 1e9);
  }
  std::unique_ptr<Process> process(const std::string& role,
                                   std::vector<std::string> arguments) const {
    return std::make_unique<Process>(
        Process::Options{.command = as_role("death-" + role, std::move(arguments)),
                         .environment = variables_of(daemon_),
                         .has_pipes = true});
  }
  static void await(Process& process) {
    if (process.line(std::chrono::seconds(10)) != "ready") give_up("a new process is not ready");
  }
  std::unique_ptr<Process> start(const std::string& role,
                                 std::vector<std::string> arguments) const {
    auto started = process(role, std::move(arguments));
    await(*started);
    return started;
  }

  struct DeathFigures {
    Series &ended, &notified, &free;
    Series* meanwhile;  // null: no creations meanwhile
  };
  void kill(Process& victim, Matched& peer, const DeathFigures& figures, Series* back) {
    const UniqueFd pidfd(static_cast<int>(::syscall(SYS_pidfd_open, victim.pid(), 0)));
    if (pidfd.get() < 0) give_up("a living process has no pidfd");
    std::this_thread::sleep_for(std::chrono::milliseconds(3));  // lets the effects of its start end
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
      pollfd end{pidfd.get(), POLLIN, 0};
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
    figures.notified.ns.push_back(peer.gone_ns - killed);
    figures.free.ns.push_back(free_ns - killed);
    if (figures.meanwhile != nullptr) figures.meanwhile->ns.push_back(longest_ns);
    if (back != nullptr) back->ns.push_back(Sample::destroyed_ns - killed);
  }

  std::int64_t time_of_creation() {
    const std::int64_t begin = now_ns();
    const auto made = try_create_subscription<Sample>(node_, "/death/late", QoS(1));
    if (!made) give_up("a creation was refused: " + text_of(made.error()));
    return now_ns() - begin;
  }
  void kill_daemon(Series& answered, Series& all_back) {
    const pid_t worker = worker_of(daemon_);
    log_.begin();
    const std::int64_t killed = now_ns();
    ::kill(worker, SIGKILL);
    time_of_creation();
    answered.ns.push_back(now_ns() - killed);
    const std::size_t clients = idle_.size() + 2;  // this process and the stream's
    wait_until([&] { return log_.count(" client is back ") >= clients; },
               "the return of all clients after a death of the daemon");
    all_back.ns.push_back(now_ns() - killed);
    if (worker_of(daemon_) == worker) give_up("the daemon outlived its SIGKILL");
  }
  template <class Action>
  static void paced(Action action) {
    const auto next = std::chrono::steady_clock::now() + between_restarts;
    action();
    std::this_thread::sleep_until(next);
  }

  Daemon& daemon_;
  LogTail log_;
  Node node_{"peer"};
  BackgroundExecutor executor_;
  Matched at_subscription_, at_publisher_;
  std::atomic<std::uint64_t> heard_{0};
  Subscription<Sample>::SharedPtr subscription_;
  Publisher<Sample>::SharedPtr publisher_;
  std::vector<std::unique_ptr<Process>> idle_;
};

/// ROUNDS LARGE_BYTES IDLE
int be_peer(const std::vector<std::string>& arguments) {
  ::prctl(PR_SET_TIMERSLACK, 1UL);
  // It has the hook already; the daemon must run without it, as usual.
  ::unsetenv("LD_PRELOAD");
  const std::size_t rounds = std::stoul(arguments.at(0));
  const std::size_t large = std::stoul(arguments.at(1));
  const std::size_t idle = std::stoul(arguments.at(2));
  const auto part = [rounds](std::size_t of) { return std::max<std::size_t>(rounds / of, 1); };
  // The seconds allow a loaded machine 200 rounds; beyond that there are fewer samples.
  const double unit = std::max(1.0, static_cast<double>(rounds) / 200);
  try {
    Daemon daemon(
        "[daemon]\nsocket_mode = \"0666\"\nlog_level = \"debug\"\n"
        "[heap]\nwindow_bytes = \"4GiB\"\n");
    ::setenv("AGNOCAST_SOCKET", daemon.socket().c_str(), 1);
    Peer peer(daemon);
    peer.publisher_deaths(rounds, small_bytes, "small heap", 12 * unit);
    peer.subscriber_deaths(rounds, small_bytes, "small heap", 12 * unit);
    const std::string size = std::to_string(large >> 20) + " MiB";
    peer.publisher_deaths(part(2), large, size, 150 * unit);
    peer.subscriber_deaths(part(2), large, size, 150 * unit);
    peer.daemon_deaths(part(4), "few clients", 25 * unit);
    peer.start_idle(idle);
    const std::string crowd = std::to_string(idle) + " idle clients";
    peer.publisher_deaths(part(4), small_bytes, crowd, 6 * unit);
    peer.subscriber_deaths(part(4), small_bytes, crowd, 6 * unit);
    peer.daemon_deaths(part(8), crowd, 15 * unit);
    say("done", "");
  } catch (const std::exception& error) {
    give_up(error.what());
  }
  return 0;
}

const RegisterRole role("death-peer", be_peer);

}  // namespace
}  // namespace agnocast::bench
