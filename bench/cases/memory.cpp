// SPDX-License-Identifier: Apache-2.0
//
// memory: the cost of pages, and whether memory is returned. A publisher's process with the heap
// hook (the owner) and a subscriber's (the reader), 8 MiB buffers:
//
//   touch     a byte of each page of a buffer that was never used, of one that was, of private
//             memory, and after the pages were populated ahead; beside it a copy of as much
//   read      the reader's access to each page of a message, for the first time and again
//   steady    messages made, read and freed for longer than idle memory is kept: no page may be
//             returned and faulted again
//   spike     1 GiB of messages made and freed: how much of it the system gets back, and when,
//             with the process quiet and with small messages continuing
//
// Idle memory is kept for AGNOCAST_HEAP_IDLE_SECONDS of the owner: ten here, the default. Each
// spike is made three times, and the worst of them is judged.

#include <bench/case.hpp>
#include <bench/cases/looking.hpp>
#include <bench/comparison.hpp>
#include <bench/figures.hpp>
#include <bench/process.hpp>
#include <bench/services.hpp>

#include <agnocast/abi/heaphook.h>
#include <agnocast/agnocast.hpp>

#include <dlfcn.h>
#include <sys/mman.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <unistd.h>

#include <chrono>
#include <cstring>
#include <filesystem>
#include <iostream>
#include <map>
#include <memory>
#include <mutex>
#include <set>
#include <sstream>
#include <string>
#include <thread>
#include <utility>
#include <vector>

namespace agnocast::bench {

struct Buffer {
  std::uint64_t number = 0;
  std::vector<std::uint8_t> bytes;
};

}  // namespace agnocast::bench

template <>
struct agnocast::MessageTraits<agnocast::bench::Buffer> {
  static constexpr const char* name = "bench/Buffer";
  static void for_each_pointer(const agnocast::bench::Buffer& buffer,
                               PointerVisitor& visit) noexcept {
    visit("bytes", buffer.bytes);
  }
};

namespace agnocast::bench {
namespace {

using Clock = std::chrono::steady_clock;
using std::chrono::milliseconds;
using std::chrono::seconds;

constexpr std::size_t page_bytes = 4096;
constexpr std::size_t buffer_bytes = std::size_t{8} << 20;
constexpr const char* topic = "/memory/buffer";
constexpr const char* small_topic = "/memory/small";

template <class Action>
double ns_of(Action action) {
  const auto began = Clock::now();
  action();
  return std::chrono::duration<double, std::nano>(Clock::now() - began).count();
}

void write_pages(void* buffer, std::size_t bytes) {
  auto* const at = static_cast<volatile char*>(buffer);
  for (std::size_t i = 0; i < bytes; i += page_bytes) at[i] = 1;
}
void read_pages(const void* buffer, std::size_t bytes) {
  const auto* const at = static_cast<const volatile char*>(buffer);
  for (std::size_t i = 0; i < bytes; i += page_bytes) (void)at[i];
}

const agnocast_heaphook_table& hook() {
  using Find = const agnocast_heaphook_table* (*)();
  const auto find = reinterpret_cast<Find>(::dlsym(RTLD_DEFAULT, "agnocast_heaphook"));
  if (find == nullptr) throw std::runtime_error("the heap hook was not preloaded");
  return *find();
}

// --- the owner: a command on each line, "ok" and figures as the answer

class Owner {
 public:
  std::vector<double> obey(const std::string& line) {
    std::istringstream words(line);
    std::string command;
    std::size_t a = 0, b = 0;
    words >> command >> a >> b;
    if (command == "fresh") return fresh(a);
    if (command == "ahead") return ahead(a);
    if (command == "warm") return warm(a);
    if (command == "private") return in_private_memory(a);
    if (command == "copy") return copy(a);
    if (command == "publish") return publish(*publisher_, buffer_bytes), std::vector<double>{};
    if (command == "steady") return steady(milliseconds(a), milliseconds(b));
    if (command == "spike") return spike(a);
    if (command == "murmur") return murmur(milliseconds(a)), std::vector<double>{};
    if (command == "matched")
      return {static_cast<double>(publisher_->get_linked_subscription_count())};
    throw std::runtime_error("unknown command " + command);
  }

 private:
  // A thread with a loan allocates from the shared heap.
  std::vector<std::unique_ptr<char[]>> shared_buffers(std::size_t count) {
    const auto loan = publisher_->borrow_loaned_message();
    std::vector<std::unique_ptr<char[]>> buffers;
    for (std::size_t i = 0; i < count; ++i)
      buffers.push_back(std::unique_ptr<char[]>(new char[buffer_bytes]));
    if (hook().owns(buffers.at(0).get()) == 0) throw std::runtime_error("the shared heap is full");
    return buffers;
  }
  static std::vector<double> touched(const std::vector<std::unique_ptr<char[]>>& buffers) {
    std::vector<double> times;
    for (const auto& buffer : buffers)
      times.push_back(ns_of([&] { write_pages(buffer.get(), buffer_bytes); }));
    return times;
  }

  // Allocates all at once, so that none reuses another; keeps them, so that the next call gets
  // others.
  std::vector<double> fresh(std::size_t count) {
    kept_.push_back(shared_buffers(count));
    return touched(kept_.back());
  }
  // MADV_POPULATE_WRITE, which a program can call in advance; alternating results: the call, and
  // the touch after it.
  std::vector<double> ahead(std::size_t count) {
    constexpr int populate_write = 23;  // Linux 5.14; headers may be older
    kept_.push_back(shared_buffers(count));
    std::vector<double> times;
    for (const auto& buffer : kept_.back()) {
      bool done = false;
      times.push_back(ns_of([&] {
        const auto begin = reinterpret_cast<std::uintptr_t>(buffer.get()) & ~(page_bytes - 1);
        done = ::madvise(reinterpret_cast<void*>(begin), buffer_bytes, populate_write) == 0;
      }));
      if (!done) return {};
      times.push_back(ns_of([&] { write_pages(buffer.get(), buffer_bytes); }));
    }
    return times;
  }
  std::vector<double> warm(std::size_t count) {
    kept_.clear();
    std::vector<double> times;
    for (std::size_t i = 0; i <= count; ++i) {
      const auto buffers = shared_buffers(1);
      const double ns = touched(buffers)[0];
      if (i != 0) times.push_back(ns);
    }
    return times;
  }
  static std::vector<double> in_private_memory(std::size_t count) {
    std::vector<double> times;
    for (std::size_t i = 0; i < count; ++i) {
      void* const memory =
          ::mmap(nullptr, buffer_bytes, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
      if (memory == MAP_FAILED) throw std::runtime_error("no private memory for 8 MiB");
      times.push_back(ns_of([&] { write_pages(memory, buffer_bytes); }));
      ::munmap(memory, buffer_bytes);
    }
    return times;
  }
  static std::vector<double> copy(std::size_t count) {
    const std::vector<char> from(buffer_bytes, 1);
    std::vector<char> to(buffer_bytes, 2);
    std::vector<double> times;
    for (std::size_t i = 0; i < count; ++i)
      times.push_back(ns_of([&] {
        std::memcpy(to.data(), from.data(), buffer_bytes);
        asm volatile("" : : "r"(to.data()) : "memory");
      }));
    return times;
  }

  static void publish(Publisher<Buffer>& publisher, std::size_t bytes) {
    auto message = publisher.borrow_loaned_message();
    message->bytes.resize(bytes);
    if (const PublishResult result = publisher.publish(std::move(message)); !result)
      throw std::runtime_error(std::string("publishing: ") + sentence_of(result.code));
  }

  // Returns messages, page faults meanwhile, and bytes returned meanwhile.
  std::vector<double> steady(milliseconds length, milliseconds period) {
    rusage before{}, after{};
    ::getrusage(RUSAGE_SELF, &before);
    const double given_back = punched();
    double count = 0;
    for (const auto end = Clock::now() + length; Clock::now() < end; ++count) {
      publish(*publisher_, buffer_bytes);
      std::this_thread::sleep_for(period);
    }
    ::getrusage(RUSAGE_SELF, &after);
    return {count, static_cast<double>(after.ru_minflt - before.ru_minflt), punched() - given_back};
  }
  static double punched() {
    agnocast_heaphook_usage usage{};
    hook().usage(&usage);
    return static_cast<double>(usage.punched_bytes);
  }

  std::vector<double> spike(std::size_t count) {
    std::vector<std::unique_ptr<Buffer>> messages;
    {
      const auto loan = publisher_->borrow_loaned_message();
      for (std::size_t i = 0; i < count; ++i) {
        messages.push_back(std::make_unique<Buffer>());
        messages.back()->bytes.resize(buffer_bytes, 1);
      }
    }
    if (hook().owns(messages.back()->bytes.data()) == 0)
      throw std::runtime_error("the shared heap is full");
    return {};
  }
  void murmur(milliseconds length) {
    for (const auto end = Clock::now() + length; Clock::now() < end;) {
      publish(*small_publisher_, 1000);
      std::this_thread::sleep_for(milliseconds(10));
    }
  }

  Node node_{"owner"};
  Publisher<Buffer>::SharedPtr publisher_ = create_publisher<Buffer>(node_, topic, QoS(1));
  Publisher<Buffer>::SharedPtr small_publisher_ =
      create_publisher<Buffer>(node_, small_topic, QoS(1));
  std::vector<std::vector<std::unique_ptr<char[]>>> kept_;
};

int be_owner(const std::vector<std::string>&) {
  Owner owner;
  for (std::string line; std::getline(std::cin, line);) {
    std::string answer = "ok";
    try {
      for (const double figure : owner.obey(line)) answer += ' ' + std::to_string(figure);
    } catch (const std::exception& error) {
      answer = error.what();
    }
    std::cout << answer << std::endl;
  }
  return 0;
}

/// Reads each message as it arrives; prints the times so far for each input line.
int be_reader(const std::vector<std::string>&) {
  std::mutex mutex;
  std::string times;
  Node node("reader");
  BackgroundExecutor executor;
  executor.add_node(node);
  const auto subscription = create_subscription<Buffer>(
      node, topic, QoS(1), [&](const ipc_shared_ptr<const Buffer>& message) {
        const double ns = ns_of([&] { read_pages(message->bytes.data(), message->bytes.size()); });
        const std::lock_guard lock(mutex);
        times += ' ' + std::to_string(ns);
      });
  for (std::string line; std::getline(std::cin, line);) {
    const std::lock_guard lock(mutex);
    std::cout << "ok" << times << std::endl;
    times.clear();
  }
  std::_Exit(0);  // callbacks may still run
}

const RegisterRole owner_role("memory-owner", be_owner);
const RegisterRole reader_role("memory-reader", be_reader);

// --- the conductor

/// Returns the pages of all memfds that the process has open, each file once.
double heap_bytes_of(pid_t pid) {
  std::set<ino_t> seen;
  double bytes = 0;
  std::error_code ignored;
  const std::string directory = "/proc/" + std::to_string(pid) + "/fd";
  for (const auto& entry : std::filesystem::directory_iterator(directory, ignored)) {
    const std::string name = std::filesystem::read_symlink(entry.path(), ignored).string();
    struct stat file {};
    if (!name.starts_with("/memfd:") || ::stat(entry.path().c_str(), &file) != 0) continue;
    if (seen.insert(file.st_ino).second) bytes += static_cast<double>(file.st_blocks) * 512;
  }
  return bytes;
}

class Memory {
 public:
  Memory(const Run& run, Report& report)
      : report_(report),
        aims_(run),
        rounds_(run.rounds.value_or(run.is_small ? 3 : 20)),
        is_small_(run.is_small),
        idle_(run.is_small ? 1 : 10),
        daemon_("[daemon]\nsocket_mode = \"0666\"\n[heap]\nwindow_bytes = \"4GiB\"\n"),
        owner_({.command = as_role("memory-owner"), .environment = variables(), .has_pipes = true}),
        reader_({.command = as_role("memory-reader"),
                 .environment = {daemon_.variable()},
                 .has_pipes = true}) {
    for (const auto end = Clock::now() + seconds(10); ask(owner_, "matched").at(0) < 1;) {
      if (Clock::now() > end)
        throw std::runtime_error("publisher and subscription have not matched within 10 s");
      std::this_thread::sleep_for(milliseconds(1));
    }
    idle_bytes_ = heap_bytes_of(owner_.pid());
  }

  void run() {
    report_.progress(0, 5, "pages");
    pages();
    report_.progress(1, 5, "reading");
    reading();
    report_.progress(2, 5, "steady traffic");
    steady();
    spikes(3, "quiet afterwards", false);
    spikes(4, "small messages going on", true);
    report_.progress(5, 5, "");
    aims_.tell(report_);
    report_.add(std::move(touches_));
    report_.add(std::move(course_));
  }

 private:
  std::vector<std::string> variables() const {
    auto all = variables_of(daemon_);
    all.push_back("AGNOCAST_HEAP_IDLE_SECONDS=" + std::to_string(idle_.count()));
    return all;
  }
  std::vector<double> ask(Process& who, const std::string& what) {
    if (!who.send(what)) throw std::runtime_error("a process has ended");
    std::istringstream answer(who.line());
    std::string word;
    answer >> word;
    if (word != "ok") throw std::runtime_error(answer.str());
    std::vector<double> figures;
    for (double figure = 0; answer >> figure;) figures.push_back(figure);
    return figures;
  }
  std::vector<double> ask(const std::string& what, std::size_t count) {
    return ask(owner_, what + ' ' + std::to_string(count));
  }

  void row(const std::string& what, const std::vector<double>& times, const char* system) {
    if (times.empty()) return;
    const bool has_p99 = times.size() >= p99_samples_min;
    const std::string p99 = has_p99 ? text("%.0f", quantile(times, 0.99) / 1e3) : "-";
    report_.say(text("%-58s %10.0f %10s %10.0f %6.3f %8.3f", what.c_str(), median(times) / 1e3,
                     p99.c_str(), quantile(times, 1) / 1e3, variation(times),
                     median(times) / 1e3 / (static_cast<double>(buffer_bytes) / page_bytes)));
    nlohmann::json result{{"system", system},
                          {"part", what},
                          {"size_bytes", buffer_bytes},
                          {"samples", times.size()},
                          {"min_ns", quantile(times, 0)},
                          {"p50_ns", median(times)},
                          {"max_ns", quantile(times, 1)},
                          {"variation", variation(times)}};
    if (has_p99) result["p99_ns"] = quantile(times, 0.99);
    report_.add(std::move(result));
    touches_.groups.push_back(what);
    touches_.series.at(0)["y"].push_back(median(times) / 1e3);
  }

  void pages() {
    std::string huge = "unknown";
    std::ifstream state("/sys/kernel/mm/transparent_hugepage/shmem_enabled");
    std::getline(state, huge);
    report_.say("huge pages in shared memory (shmem_enabled): " + huge);
    report_.say(text("%-58s %10s %10s %10s %6s %8s", "microseconds for 8 MiB", "p50", "p99", "max",
                     "CV", "a page"));
    row("shared, never used: first touch", ask("fresh", rounds_), "agnocast-executor");
    const std::vector<double> both = ask("ahead", rounds_);
    std::vector<double> asking, touching;
    for (std::size_t i = 0; i + 1 < both.size(); i += 2)
      asking.push_back(both[i]), touching.push_back(both[i + 1]);
    row("shared, never used: MADV_POPULATE_WRITE", asking, "agnocast-executor");
    row("shared, asked for ahead like that: touch", touching, "agnocast-executor");
    row("shared, used before: touch", ask("warm", rounds_), "agnocast-executor");
    row("private, never used: first touch", ask("private", rounds_), "floor-private");
    row("copy from and to warm private memory", ask("copy", rounds_), "floor-memcpy");
    if (asking.empty())
      report_.say("pages cannot be asked for ahead: the kernel is older than 5.14");
  }

  // Alternates two messages, because the first is freed when the second was published.
  void reading() {
    std::vector<double> first, again;
    for (std::size_t round = 0; round < rounds_; ++round) {
      if (round == 0) collect(first, 1);
      collect(round < 2 ? first : again, 1);
    }
    row("shared, in the reader: first read of a message", first, "agnocast-executor");
    row("shared, in the reader: read of pages that it knows", again, "agnocast-executor");
  }
  void collect(std::vector<double>& times, std::size_t count) {
    (void)ask(owner_, "publish");
    for (const auto end = Clock::now() + seconds(10); count > 0;) {
      for (const double ns : ask(reader_, "times")) times.push_back(ns), --count;
      if (Clock::now() > end) throw std::runtime_error("a message has not come within 10 s");
      std::this_thread::sleep_for(milliseconds(1));
    }
  }

  void steady() {
    // Memory freed before is returned while the same traffic runs for the first time; not
    // measured.
    const milliseconds settling = idle_ + seconds(4), length = idle_ + seconds(is_small_ ? 1 : 5);
    const auto traffic = [this](milliseconds time) {
      return ask(owner_, text("steady %lld 10", static_cast<long long>(time.count())));
    };
    (void)traffic(settling);
    const auto figures = traffic(length);
    const double count = figures.at(0);
    report_.say(
        text("steady traffic, %.0f messages of 8 MiB in %.0f s: %.2f page faults a message, "
             "%.0f bytes given back a message",
             count, static_cast<double>(length.count()) / 1e3, figures.at(1) / count,
             figures.at(2) / count));
    report_.add(nlohmann::json{{"system", "agnocast-executor"},
                               {"part", "steady traffic"},
                               {"size_bytes", buffer_bytes},
                               {"samples", static_cast<std::size_t>(count)},
                               {"faults_per_message", figures.at(1) / count},
                               {"returned_bytes_per_message", figures.at(2) / count}});
  }

  /// The returned part of a spike, and when most of it was back; longer than observed: never.
  struct Return {
    double share = 0, after_s = 0;
  };

  void spikes(std::size_t step, const std::string& how, bool is_murmuring) {
    Return worst{1, 0};
    for (std::size_t i = 0; i < (is_small_ ? 1 : 3); ++i) {
      report_.progress(step, 5, "spike, " + how);
      const Return one = spike(how, is_murmuring, i == 0);
      worst = {std::min(worst.share, one.share), std::max(worst.after_s, one.after_s)};
    }
    const Basis basis{.is_of_rounds = false};
    aims_.add("share of the pages of a spike that comes back, worst of three, " + how, worst.share,
              Aims::Sense::at_least, aim, {}, basis);
    aims_.add(text("seconds until %.0f %% of them are back, ", 100 * aim) + how, worst.after_s,
              Aims::Sense::at_most, static_cast<double>((idle_ + late).count()), {}, basis);
  }

  Return spike(const std::string& how, bool is_murmuring, bool is_drawn) {
    const std::size_t messages = is_small_ ? 16 : 128;
    (void)ask("spike", messages);
    const auto began = Clock::now();
    const double peak = heap_bytes_of(owner_.pid());
    if (peak < static_cast<double>(messages * buffer_bytes))
      throw std::runtime_error("the spike had less memory than its messages need");
    const seconds watched = idle_ + late + seconds(is_small_ ? 0 : 2);
    if (is_murmuring)
      owner_.send(text("murmur %lld", static_cast<long long>(watched.count() * 1000)));
    nlohmann::json x = nlohmann::json::array(), y = nlohmann::json::array();
    double share = 0, when = -1;
    while (Clock::now() < began + watched) {
      const double now = heap_bytes_of(owner_.pid());
      const double at = std::chrono::duration<double>(Clock::now() - began).count();
      x.push_back(at), y.push_back(now / (1 << 20));
      share = peak > idle_bytes_ ? (peak - now) / (peak - idle_bytes_) : 0;
      if (share >= aim && when < 0) when = at;
      std::this_thread::sleep_for(milliseconds(100));
    }
    if (is_murmuring && owner_.line() != "ok") throw std::runtime_error("small messages failed");
    report_.say(text("spike of %zu MiB, %s: %.0f MiB of pages, %.1f %% came back within %lld s%s",
                     messages * buffer_bytes >> 20, how.c_str(), peak / (1 << 20), 100 * share,
                     static_cast<long long>(watched.count()),
                     when < 0 ? "" : text(", %.0f %% after %.1f s", 100 * aim, when).c_str()));
    nlohmann::json result{{"system", "agnocast-executor"},
                          {"part", "spike, " + how},
                          {"size_bytes", messages * buffer_bytes},
                          {"samples", 1},
                          {"before_bytes", idle_bytes_},
                          {"peak_bytes", peak},
                          {"returned_share", share}};
    if (when >= 0) result["returned_after_s"] = when;
    report_.add(std::move(result));
    if (is_drawn) course_.series.push_back({{"label", how}, {"x", x}, {"y", y}});
    return {share, when < 0 ? static_cast<double>(watched.count()) : when};
  }

  static constexpr double aim = 0.95;
  static constexpr seconds late{4};  // "within a few seconds more" (docs/heaphook.md)

  Report& report_;
  Aims aims_;
  const std::size_t rounds_;
  const bool is_small_;
  const seconds idle_;
  Daemon daemon_;
  Process owner_, reader_;
  double idle_bytes_ = 0;  // of the owner before the first message
  Plot touches_{.name = "memory-pages",
                .kind = "bars",
                .title = "Pages of 8 MiB",
                .x_label = "",
                .y_label = "µs, median",
                .log_y = true,
                .series = {{{"label", "8 MiB"}, {"y", nlohmann::json::array()}}}};
  Plot course_{.name = "memory-spike",
               .kind = "lines",
               .title = "Pages of a heap after a spike",
               .x_label = "seconds since the last message was freed",
               .y_label = "MiB"};
};

}  // namespace

void run_memory(const Run& run, Report& report) { Memory(run, report).run(); }

}  // namespace agnocast::bench
