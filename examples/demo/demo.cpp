// SPDX-License-Identifier: Apache-2.0
//
// The demo: starts a daemon, a publisher and two subscribers of its own, gives them work, and
// checks their reports. It does not use agnocast itself: its results come from the reports of the
// other processes and from /proc.
//
//   [1] every message arrives intact     seals checked by both subscribers, none missing, in order
//   [2] no byte moved                    the same addresses in all three, the publisher's memfd at
//                                        them, read-only in the subscribers, nothing adopted
//   [3] moved-in memory                  adopted_bytes of msg->data = std::move(v) in each scope
//   [4] latency by size                  beside Cyclone DDS, alternating in the same processes
//
// The other processes die with this one in any case, and the directory TMPDIR/agnocast-demo-PID-…
// is removed. The demo ends when its own parent dies.

#include <examples/demo/ack.hpp>
#include <examples/demo/maps.hpp>
#include <examples/demo/options.hpp>
#include <examples/demo/process.hpp>
#include <examples/demo/report.hpp>

#include <fcntl.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <csignal>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <memory>
#include <sstream>

namespace demo {
namespace {

using Environment = std::map<std::string, std::string>;

constexpr std::array<std::uint64_t, 5> sizes = {1 << 10, 10 << 10, 100 << 10, 1 << 20, 8 << 20};
constexpr std::uint64_t moved_bytes = 1 << 20;
constexpr std::size_t faults_shown = 20;  // one fault often occurs in every message

/// One sent message, as the publisher reports it.
struct Sent {
  std::uint64_t number = 0;
  std::uint64_t bytes = 0;
  std::uint64_t adopted_bytes = 0;
  std::string places;
};

class Directory {
 public:
  Directory() {
    const std::string name = format("agnocast-demo-%d-XXXXXX", ::getpid());
    std::string path = (std::filesystem::temp_directory_path() / name).string();
    if (::mkdtemp(path.data()) == nullptr) throw Failure(path + ": " + std::strerror(errno));
    path_ = path;
  }
  ~Directory() {
    std::error_code ignored;
    std::filesystem::remove_all(path_, ignored);
  }
  Directory(const Directory&) = delete;
  Directory& operator=(const Directory&) = delete;
  std::string file(const char* name) const { return path_ + "/" + name; }

 private:
  std::string path_;
};

// All on the loopback interface, without multicast, and separate from every other DDS on this host
// but for its ports: the default number of participants would not start where ten others run.
constexpr const char* dds_configuration = R"(<CycloneDDS><Domain id="any">
  <General>
    <Interfaces><NetworkInterface name="lo" multicast="false"/></Interfaces>
    <AllowMulticast>false</AllowMulticast>
    <MaxMessageSize>65500B</MaxMessageSize><FragmentSize>65000B</FragmentSize>
  </General>
  <Discovery>
    <ParticipantIndex>auto</ParticipantIndex>
    <MaxAutoParticipantIndex>99</MaxAutoParticipantIndex><Tag>TAG</Tag>
    <Peers><Peer address="127.0.0.1"/></Peers>
  </Discovery>
  <Internal>
    <SocketReceiveBufferSize max="16MiB"/>
    <Watermarks><WhcHigh>16MiB</WhcHigh></Watermarks>
  </Internal>
</Domain></CycloneDDS>
)";

class Demo {
 public:
  explicit Demo(Options options) : options_(std::move(options)) {
    programs_ = std::filesystem::read_symlink("/proc/self/exe").parent_path().string();
    environment_["AGNOCAST"] = "on";
    environment_["AGNOCAST_SOCKET"] = directory_.file("agnocastd.sock");
    const std::string dds = directory_.file("cyclonedds.xml");
    std::string text = dds_configuration;
    text.replace(text.find("TAG"), 3, "agnocast-demo-" + std::to_string(::getpid()));
    std::ofstream(dds) << text;
    environment_["CYCLONEDDS_URI"] = "file://" + dds;
  }

  bool run() {
    report_.line("agnocast demo: PointCloud2 from one process to two, 1 KB to 8 MB");
    start();
    send_everything();
    show_that_no_byte_moved();
    move_in();
    end_second_subscriber();
    measure();
    end();
    report_.line();
    report_.line(faults_ == 0 ? "PASSED: every message arrived intact"
                              : "FAILED: " + std::to_string(faults_) +
                                    (faults_ == 1 ? " fault" : " faults") +
                                    ", the first of them named above");
    return faults_ == 0;
  }

 private:
  void fault(const std::string& what) {
    if (++faults_ <= faults_shown) report_.line("    WRONG: " + what);
  }

  std::unique_ptr<Process> publisher(const char* name, bool scope_all, int answers) {
    std::vector<std::string> command;
    Environment environment = environment_;
    if (options_.hook.empty()) {
      command = {"agnocast-run", "--scope", scope_all ? "all" : "loan"};
    } else {
      environment["LD_PRELOAD"] = options_.hook;
      environment["AGNOCAST_SCOPE"] = scope_all ? "all" : "loan";
    }
    command.insert(command.end(), {programs_ + "/demo_publisher", name});
    if (options_.with_dds && !scope_all) command.push_back("dds");
    return std::make_unique<Process>(Process::Options{name, command, environment, answers, {}});
  }

  void await_ready(Process& process) {
    for (std::string line; line != "ready";) {
      line = process.line();
      if (line.rfind("no_dds ", 0) == 0) no_dds_ = line.substr(7);
      if (line.rfind("failed ", 0) == 0) throw Failure(process.name() + ": " + line.substr(7));
    }
  }

  void start_daemon() {
    daemon_ = std::make_unique<Process>(
        Process::Options{"agnocastd",
                         {options_.daemon, "--socket", environment_["AGNOCAST_SOCKET"]},
                         {},
                         -1,
                         directory_.file("agnocastd.log")});
    sockaddr_un address{};
    address.sun_family = AF_UNIX;
    std::strncpy(address.sun_path, environment_["AGNOCAST_SOCKET"].c_str(),
                 sizeof address.sun_path - 1);
    for (int attempt = 0; attempt < 1000; ++attempt) {
      const int probe = ::socket(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0);
      const int status =
          ::connect(probe, reinterpret_cast<const sockaddr*>(&address), sizeof address);
      ::close(probe);
      if (status == 0) return;
      check_signals();
      if (daemon_->has_ended()) break;
      ::usleep(20000);
    }
    std::ifstream log(directory_.file("agnocastd.log"));
    std::stringstream text;
    text << log.rdbuf();
    throw Failure("agnocastd does not serve\n" + text.str());
  }

  void start() {
    start_daemon();
    int answers[2];
    if (::pipe2(answers, O_CLOEXEC) != 0) throw Failure("no pipe");
    const std::string program = programs_ + "/demo_subscriber";
    std::vector<std::string> first = {program, "subscriber_1", "latency"};
    if (options_.with_dds) first.push_back("dds");
    subscribers_[0] = std::make_unique<Process>(
        Process::Options{"subscriber 1", first, environment_, answers[1], {}});
    subscribers_[1] = std::make_unique<Process>(
        Process::Options{"subscriber 2", {program, "subscriber_2"}, environment_, -1, {}});
    publisher_ = publisher("publisher", false, answers[0]);
    ::close(answers[0]);
    ::close(answers[1]);
    for (auto& subscriber : subscribers_) await_ready(*subscriber);
    await_ready(*publisher_);
    report_.line(format("    agnocastd      pid %d, private, uid %u", daemon_->pid(), ::geteuid()));
    report_.line(format("    publisher      pid %d, heap hook preloaded", publisher_->pid()));
    report_.line(
        format("    subscribers    pid %d, %d", subscribers_[0]->pid(), subscribers_[1]->pid()));
  }

  /// Sends an order and calls `each` with the words of each line of the answer.
  template <class Each>
  static void order(Process& process, const std::string& order, Each each) {
    process.send(order);
    for (;;) {
      const std::string text = process.line();
      if (text == "end") return;
      std::istringstream line(text);
      std::string verb;
      line >> verb;
      if (verb == "failed") throw Failure(process.name() + ": " + text.substr(7));
      each(verb, line);
    }
  }

  /// Sends messages, then checks the lines of both subscribers about each message, in order.
  std::vector<Sent> exchange(Process& publisher, const std::string& text, std::uint64_t bytes) {
    std::vector<Sent> sent;
    order(publisher, text, [&](const std::string&, std::istringstream& line) {
      Sent one;
      line >> one.number >> one.adopted_bytes >> one.places;
      one.bytes = bytes;
      sent.push_back(one);
    });
    for (auto& subscriber : subscribers_) {
      for (const Sent& one : sent) {
        std::istringstream line(subscriber->line());
        std::string verb, verdict, places;
        std::uint64_t number = 0;
        line >> verb >> number >> verdict >> places;
        const std::string what = "message " + std::to_string(one.number) + " of " +
                                 size_text(bytes) + " at " + subscriber->name();
        if (verb != "received" || number != one.number) {
          throw Failure(what + " did not arrive: " + line.str());
        } else if (verdict != "intact") {
          fault(what + " is not what was sent: its checksum differs");
        } else if (one.adopted_bytes == 0 && places != one.places) {
          fault(what + " lies elsewhere: " + places + " instead of " + one.places);
        }
      }
    }
    return sent;
  }

  void send_everything() {
    report_.heading(1, "every message arrives intact: checksum over every member");
    report_.line(
        "    built with push_back, resize, insert, assign, reserve, shrink_to_fit, erase,");
    report_.line("    move; the kind, order and amount of each operation drawn at random");
    order(*publisher_, "wait cloud 2", [](auto&&...) {});
    for (const std::uint64_t bytes : sizes) {
      const std::size_t faults_before = faults_;
      if (options_.corrupt_one && bytes == sizes[2])
        order(*publisher_, "corrupt", [](auto&&...) {});
      // In small batches, to show progress.
      for (unsigned done = 0; done < options_.clouds_per_size; done += 5) {
        report_.progress(static_cast<double>(done) / options_.clouds_per_size, size_text(bytes));
        const std::string text =
            "clouds " + std::to_string(next_number_) + " 5 " + std::to_string(bytes);
        for (Sent& one : exchange(*publisher_, text, bytes)) sent_.push_back(std::move(one));
        next_number_ += 5;
      }
      report_.line(format("    %-6s  %3u messages  %s", size_text(bytes).c_str(),
                          options_.clouds_per_size,
                          faults_ == faults_before ? "intact at both" : "NOT ALL INTACT"));
    }
  }

  /// Returns the address of a message's bytes: the second of its places.
  static std::uint64_t data_address(const Sent& sent) {
    return std::stoull(sent.places.substr(sent.places.find(',') + 1), nullptr, 16);
  }

  void show_that_no_byte_moved() {
    report_.heading(2, "no byte moved: data() of the last message, and /proc/PID/maps there");
    std::uint64_t adopted = 0;
    for (const Sent& one : sent_) {
      adopted += one.adopted_bytes;
      check_places(one);
    }
    const std::uint64_t address = data_address(sent_.back());
    const auto show = [&](const Process& process) {
      const auto place = place_in(process.pid(), address).value_or(MappedPlace{});
      // The name is shown without the window's address and owner behind it.
      report_.line(format("    %-13s %#llx  %s  inode %llu  %s", process.name().c_str(),
                          static_cast<unsigned long long>(address), place.permissions.c_str(),
                          static_cast<unsigned long long>(place.inode),
                          place.name.substr(0, place.name.find("-0x")).c_str()));
    };
    show(*publisher_);
    for (const auto& subscriber : subscribers_) show(*subscriber);
    if (adopted != 0) fault(std::to_string(adopted) + " bytes were adopted: copied");
    report_.line("    checked for all " + std::to_string(sent_.size()) +
                 " messages: object, data, fields and frame_id at one");
    report_.line("    address, inode and offset in all three, read-only in the subscribers;");
    report_.line("    " + std::to_string(adopted) + " bytes adopted");
  }

  /// Checks each piece of memory of a message: the publisher's memfd in all three, read-only in
  /// two.
  void check_places(const Sent& sent) {
    std::istringstream places(sent.places);
    for (std::string text; std::getline(places, text, ',');) {
      const std::uint64_t address = std::stoull(text, nullptr, 16);
      const auto home = place_in(publisher_->pid(), address);
      const std::string where = text + " of message " + std::to_string(sent.number);
      if (!home || home->permissions != "rw-s" || home->name.rfind("/memfd:", 0) != 0) {
        fault(where + " is not in a memfd of the publisher");
        continue;
      }
      for (const auto& subscriber : subscribers_) {
        const auto there = place_in(subscriber->pid(), address);
        if (!there || !there->is_same_byte_as(*home)) {
          fault(where + " is other memory at " + subscriber->name());
        } else if (there->permissions != "r--s") {
          fault(where + " is " + there->permissions + " at " + subscriber->name());
        }
      }
    }
  }

  void move_in() {
    report_.heading(3, "moved-in memory: v built before the loan, msg->data = std::move(v)");
    const auto once = [&](Process& process, const char* scope, std::uint64_t expected,
                          const char* meaning) {
      const std::string text =
          "move_in " + std::to_string(next_number_++) + " " + std::to_string(moved_bytes);
      const Sent sent = exchange(process, text, moved_bytes).at(0);
      report_.line(format("    scope %-5s adopted_bytes %7llu   %s", scope,
                          static_cast<unsigned long long>(sent.adopted_bytes), meaning));
      if (sent.adopted_bytes != expected) fault("adopted_bytes is not " + std::to_string(expected));
    };
    once(*publisher_, "loan", moved_bytes, "v lies in libc's heap: copied in once");
    const auto all = publisher("publisher_all", true, -1);
    await_ready(*all);
    order(*all, "wait cloud 2", [](auto&&...) {});
    once(*all, "all", 0, "v was built in the shared heap");
    all->close_input();
    if (all->wait() != 0) fault("the publisher with scope all failed");
  }

  void end_second_subscriber() {
    end_subscriber(*subscribers_[1]);
    order(*publisher_, "wait cloud 1", [](auto&&...) {});
  }

  void measure() {
    report_.heading(4, "latency by size");
    order(*publisher_, "wait latency 1", [](auto&&...) {});
    if (options_.with_dds && no_dds_.empty())
      order(*publisher_, "wait dds 1", [&](const std::string& verb, std::istringstream& line) {
        if (verb == "no_dds") std::getline(line >> std::ws, no_dds_);
      });
    const bool with_dds = options_.with_dds && no_dds_.empty();
    if (!options_.with_dds) no_dds_ = "switched off by --no-dds";
    if (!no_dds_.empty()) report_.line("    without Cyclone DDS: " + no_dds_);
    std::vector<Latency> rows;
    for (const std::uint64_t bytes : sizes)
      rows.push_back(measure_size(bytes, with_dds, rows.size()));
    report_.table(rows);
    report_.line();
    report_.plot(rows);
    explain(with_dds);
  }

  Latency measure_size(std::uint64_t bytes, bool with_dds, std::size_t place) {
    // Large messages take longer; the two largest get two thirds of the time.
    static constexpr std::array<double, sizes.size()> shares = {0.08, 0.1, 0.12, 0.25, 0.45};
    std::vector<double> p50[2], p99[2], ratios;
    Latency row;
    row.bytes = bytes;
    for (int round = 0; round < options_.rounds; ++round) {
      report_.progress((static_cast<double>(place) + static_cast<double>(round) / options_.rounds) /
                           static_cast<double>(sizes.size()),
                       size_text(bytes) + ", round " + std::to_string(round + 1));
      std::ostringstream text;
      text << "latency " << bytes << " 1000 " << options_.seconds * shares[place] / options_.rounds
           << (with_dds ? " dds" : " alone");
      order(*publisher_, text.str(), [&](const std::string&, std::istringstream& line) {
        std::string road;
        std::uint64_t count = 0, wrong = 0, lost = 0;
        double median = 0, high = 0;
        line >> road >> count >> median >> high >> wrong >> lost;
        const bool ours = road == "agnocast";
        (ours ? row.agnocast_count : row.dds_count) += count;
        p50[ours ? 0 : 1].push_back(median);
        p99[ours ? 0 : 1].push_back(high);
        if (wrong != 0) fault(std::to_string(wrong) + " wrong messages through " + road);
        if (lost != 0 && ours) fault(std::to_string(lost) + " messages did not arrive");
        if (lost != 0 && !ours)
          report_.line("    note: " + std::to_string(lost) +
                       " messages through Cyclone DDS did not arrive");
      });
      if (with_dds) ratios.push_back(p50[1].back() / p50[0].back());
    }
    row.agnocast_p50_ns = median(p50[0]);
    row.agnocast_p99_ns = median(p99[0]);
    row.dds_p50_ns = median(p50[1]);
    row.dds_p99_ns = median(p99[1]);
    row.ratio = median(ratios);
    return row;
  }

  static double median(std::vector<double> values) {
    if (values.empty()) return 0;
    std::sort(values.begin(), values.end());
    return values[values.size() / 2];
  }

  void explain(bool with_dds) {
    const std::string rounds = std::to_string(options_.rounds);
    report_.line();
    report_.line("Measured: from the call of publish to the first line of the callback, one");
    report_.line("subscriber process; the next message follows when this one was checked. Medians");
    report_.line("over " + rounds + (options_.rounds == 1 ? " round" : " rounds") +
                 ". Filling the message is not included.");
    report_.line(
        with_dds ? "Both alike: sender and receiver on cores of their own, one receiver, 1 ms rest"
                 : "Sender and receiver are on cores of their own, with 1 ms rest");
    report_.line("before each message, alternating: the times include waking an idle core.");
    if (!with_dds) return;
    report_.line("Cyclone DDS: from the call of dds_write (which serializes) to the return of");
    report_.line("dds_take (which deserializes) in its listener; reliable, keep-last 1, loopback");
    report_.line("UDP, 64 KB fragments, socket buffers as large as the kernel permits; the same");
    report_.line("content and processes, alternating. Not its shared-memory mode.");
  }

  void end_subscriber(Process& subscriber) {
    subscriber.close_input();
    std::string line = subscriber.line();
    std::istringstream words(line);
    std::string verb;
    std::uint64_t received = 0, wrong = 0, lost = 0;
    words >> verb >> received >> wrong >> lost;
    if (verb != "done") fault(subscriber.name() + " received more than was sent: " + line);
    if (wrong != 0 || lost != 0)
      fault(subscriber.name() + ": " + std::to_string(wrong) + " wrong, " + std::to_string(lost) +
            " lost");
    if (subscriber.wait() != (wrong == 0 ? 0 : 1)) fault(subscriber.name() + " failed");
  }

  void end() {
    end_subscriber(*subscribers_[0]);
    publisher_->close_input();
    if (publisher_->wait() != 0) fault("the publisher failed");
    ::kill(daemon_->pid(), SIGTERM);
    if (daemon_->wait() != 0) fault("agnocastd failed");
  }

  Options options_;
  Report report_;
  Directory directory_;  // before the processes: removed after they are dead
  std::string programs_;
  Environment environment_;
  std::unique_ptr<Process> daemon_;
  std::unique_ptr<Process> publisher_;
  std::array<std::unique_ptr<Process>, 2> subscribers_;
  std::vector<Sent> sent_;
  std::uint64_t next_number_ = 1;
  std::string no_dds_;
  std::size_t faults_ = 0;
};

}  // namespace
}  // namespace demo

int main(int argc, char** argv) try {
  demo::Options options = demo::parse(argc, argv);
  demo::catch_signals();
  ::prctl(PR_SET_PDEATHSIG, SIGTERM);
  return demo::Demo(std::move(options)).run() ? 0 : 1;
} catch (const demo::Interrupted& interrupted) {
  std::fprintf(stderr, "\ndemo: ended by signal %d\n", interrupted.signal);
  return 128 + interrupted.signal;
} catch (const std::exception& error) {
  std::fprintf(stderr, "\ndemo: %s\n", error.what());
  return 1;
}
