// SPDX-License-Identifier: Apache-2.0
//
// The cost of agnocast-ctl in a large system: 500 topics of 200 processes that publish, the CPU
// time of `top -b` at 2 Hz and of the daemon meanwhile, and the duration of each command, beside
// a program that does nothing.
//   ctl_bench [--topics=N] [--processes=N] [--seconds=N] [--json]

#include <agnocast/agnocast.hpp>
#include <tests/support/processes/daemon_process.hpp>

#include <nlohmann/json.hpp>

#include <fcntl.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <csignal>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <iterator>
#include <memory>
#include <sstream>
#include <string>
#include <thread>
#include <utility>
#include <vector>

namespace agnocast::bench {

struct Frame {
  std::uint64_t number = 0;
  std::vector<std::uint8_t> bytes;
};

}  // namespace agnocast::bench

template <>
struct agnocast::MessageTraits<agnocast::bench::Frame> {
  static constexpr const char* name = "bench/Frame";
  static void for_each_pointer(const agnocast::bench::Frame& frame,
                               PointerVisitor& visit) noexcept {
    visit("bytes", frame.bytes);
  }
};

namespace agnocast::bench {
namespace {

using Clock = std::chrono::steady_clock;

struct Size {
  unsigned topics = 500, processes = 200, seconds = 20;
};

std::string topic_of(unsigned index) { return "/bench/topic_" + std::to_string(index); }

/// Publishes on its share of the topics twice a second, and subscribes to its neighbour's.
[[noreturn]] void be_node(unsigned index, const Size& size) {
  ::prctl(PR_SET_PDEATHSIG, SIGKILL);
  Node node("node_" + std::to_string(index));
  std::vector<Publisher<Frame>::SharedPtr> publishers;
  std::vector<PollingSubscriber<Frame>::SharedPtr> subscriptions;
  for (unsigned topic = index; topic < size.topics; topic += size.processes)
    publishers.push_back(create_publisher<Frame>(node, topic_of(topic), QoS(5)));
  for (unsigned topic = (index + 1) % size.processes; topic < size.topics; topic += size.processes)
    subscriptions.push_back(create_subscription<Frame>(node, topic_of(topic), QoS(5)));
  std::puts("ready");
  std::fflush(stdout);
  for (std::uint64_t number = 1;; ++number) {
    for (const auto& publisher : publishers) {
      auto message = publisher->borrow_loaned_message();
      message->number = number;
      message->bytes.resize(1000);
      static_cast<void>(publisher->publish(std::move(message)));
    }
    for (const auto& subscription : subscriptions) {
      while (subscription->take()) {
      }
    }
    std::this_thread::sleep_for(std::chrono::milliseconds(500));
  }
}

struct Spent {
  double wall_s = 0, cpu_s = 0;
  bool ok = false;
};

/// Runs a command and discards its output.
Spent run(const std::vector<std::string>& words) {
  std::vector<char*> arguments;
  for (const std::string& word : words) arguments.push_back(const_cast<char*>(word.c_str()));
  arguments.push_back(nullptr);
  const auto begin = Clock::now();
  const pid_t pid = ::vfork();
  if (pid == 0) {
    const int nowhere = ::open("/dev/null", O_WRONLY | O_CLOEXEC);
    ::dup2(nowhere, STDOUT_FILENO);
    ::execvp(arguments[0], arguments.data());
    ::_exit(99);
  }
  int status = 0;
  rusage used{};
  ::wait4(pid, &status, 0, &used);
  const auto seconds = [](const timeval& time) {
    return static_cast<double>(time.tv_sec) + static_cast<double>(time.tv_usec) / 1e6;
  };
  return {std::chrono::duration<double>(Clock::now() - begin).count(),
          seconds(used.ru_utime) + seconds(used.ru_stime), status == 0};
}

/// Returns user and system time of a process so far.
double cpu_of(pid_t pid) {
  std::ifstream file("/proc/" + std::to_string(pid) + "/stat");
  std::string text((std::istreambuf_iterator<char>(file)), {});
  std::istringstream fields(text.substr(text.rfind(')') + 2));
  std::string skipped;
  for (int i = 0; i < 11; ++i) fields >> skipped;
  double user = 0, system = 0;
  fields >> user >> system;
  return (user + system) / static_cast<double>(::sysconf(_SC_CLK_TCK));
}

nlohmann::ordered_json times_of(const std::vector<std::string>& words) {
  constexpr std::size_t rounds = 21;
  std::vector<double> wall_ms;
  for (std::size_t i = 0; i < rounds; ++i) {
    const Spent spent = run(words);
    if (!spent.ok) {
      std::fprintf(stderr, "ctl_bench: %s failed\n", words[1].c_str());
      std::exit(1);
    }
    wall_ms.push_back(spent.wall_s * 1000);
  }
  std::sort(wall_ms.begin(), wall_ms.end());
  return {{"median_ms", wall_ms[rounds / 2]}, {"slowest_ms", wall_ms.back()}};
}

/// Long because it sets up, measures and prints one system of a size, in that order.
int measure(const Size& size, bool is_json, const char* self) {
  test::DaemonProcess daemon;
  ::setenv("AGNOCAST_SOCKET", daemon.socket_path().c_str(), 1);
  const std::string ctl = AGNOCAST_BENCH_CTL;
  for (unsigned i = 0; i < size.processes; ++i) {
    int ends[2];
    if (::pipe2(ends, O_CLOEXEC) != 0) return 1;
    const std::string node = "--node=" + std::to_string(i);
    const std::string topics = "--topics=" + std::to_string(size.topics);
    const std::string processes = "--processes=" + std::to_string(size.processes);
    if (::fork() == 0) {
      ::dup2(ends[1], STDOUT_FILENO);
      ::execl(self, self, node.c_str(), topics.c_str(), processes.c_str(), nullptr);
      ::_exit(99);
    }
    ::close(ends[1]);
    char answer = 0;
    if (::read(ends[0], &answer, 1) != 1) {
      std::fprintf(stderr, "ctl_bench: node %u did not begin\n", i);
      return 1;
    }
    ::close(ends[0]);
  }
  nlohmann::ordered_json all{{"topics", size.topics}, {"processes", size.processes}};
  const double daemon_before = cpu_of(daemon.pid());
  const Spent top = run({ctl, "top", "-b", "-d", "0.5", "-n", std::to_string(2 * size.seconds)});
  all["top"] = {{"cpu_percent", 100 * top.cpu_s / top.wall_s},
                {"daemon_cpu_percent", 100 * (cpu_of(daemon.pid()) - daemon_before) / top.wall_s},
                {"seconds", top.wall_s}};
  all["nothing"] = times_of({"/bin/true", ""});
  for (const char* const command : {"status",
                                    "topic list",
                                    "topic list -t",
                                    "topic info -v /bench/topic_1",
                                    "topic find nobody_msgs/msg/Nothing",
                                    "topic type /bench/topic_1",
                                    "node list",
                                    "node info /node_1",
                                    "process list",
                                    "heap list",
                                    "message list",
                                    "message list /bench/topic_1",
                                    "top -b -n 1",
                                    "dump",
                                    "graph",
                                    "graph --format mermaid",
                                    "journal",
                                    "explain no_slot",
                                    "log-level",
                                    "access /bench/topic_1",
                                    "metrics"}) {
    std::vector<std::string> words{ctl};
    std::istringstream stream(command);
    for (std::string word; stream >> word;) words.push_back(word);
    all["commands"][command] = times_of(words);
  }
  if (is_json) {
    std::puts(all.dump(2).c_str());
    return 0;
  }
  std::printf("%u topics, %u processes\n", size.topics, size.processes);
  std::printf("top -b at 2 Hz, %.0f s: %.2f %% of a core; the daemon meanwhile %.2f %%\n",
              top.wall_s, all["top"]["cpu_percent"].get<double>(),
              all["top"]["daemon_cpu_percent"].get<double>());
  const double nothing = all["nothing"]["median_ms"];
  std::printf("\n%-36s %10s %10s %s\n%-36s %7.1f ms\n", "command", "median", "slowest",
              "to nothing", "/bin/true", nothing);
  for (const auto& [command, times] : all["commands"].items())
    std::printf("%-36s %7.1f ms %7.1f ms %7.1f\n", command.c_str(),
                times["median_ms"].get<double>(), times["slowest_ms"].get<double>(),
                times["median_ms"].get<double>() / nothing);
  return 0;
}

}  // namespace
}  // namespace agnocast::bench

int main(int argc, char** argv) {
  using namespace agnocast::bench;
  Size size;
  bool is_json = false;
  long node = -1;
  for (int i = 1; i < argc; ++i) {
    const std::string word = argv[i];
    const auto number = [&] {
      return std::strtoul(word.substr(word.find('=') + 1).c_str(), nullptr, 10);
    };
    if (word.starts_with("--topics=")) {
      size.topics = static_cast<unsigned>(number());
    } else if (word.starts_with("--processes=")) {
      size.processes = static_cast<unsigned>(number());
    } else if (word.starts_with("--seconds=")) {
      size.seconds = static_cast<unsigned>(number());
    } else if (word == "--json") {
      is_json = true;
    } else if (word.starts_with("--node=")) {
      node = static_cast<long>(number());
    } else {
      std::fputs("ctl_bench [--topics=N] [--processes=N] [--seconds=N] [--json]\n", stderr);
      return word == "--help" ? 0 : 2;
    }
  }
  if (size.topics == 0 || size.processes == 0 || size.seconds == 0) return 2;
  if (node >= 0) be_node(static_cast<unsigned>(node), size);
  return measure(size, is_json, "/proc/self/exe");
}
