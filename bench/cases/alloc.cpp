// SPDX-License-Identifier: Apache-2.0
//
// alloc: the cost of malloc and free in the shared heap, beside the same in private memory. One
// process for each heap; only the measured one runs at a time; rounds of all heaps alternate, and
// ratios are per round, with their median over all:
//
//   shared     with the heap hook, in a loan's scope
//   private    the same allocator, with the same calls, on private memory: once the shared heap
//              has grown, private memory is mapped over its window; the allocator's metadata are
//              outside, so it notices nothing
//   outside    with the heap hook, out of scope: libc's malloc behind it
//   jemalloc   Debian's libjemalloc instead of libc's malloc, with its own settings, if installed
//   libc       libc's malloc
//
// All memory is warm: every heap has touched each measured page before. The aim covers the rows
// that write to their blocks: with the same allocator and calls the others can hardly differ
// between shared and private memory, and are printed beside it.

#include <bench/case.hpp>
#include <bench/cases/looking.hpp>
#include <bench/comparison.hpp>
#include <bench/figures.hpp>
#include <bench/process.hpp>
#include <bench/services.hpp>

#include <agnocast/abi/heaphook.h>

#include <dlfcn.h>
#include <fcntl.h>
#include <sys/mman.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <barrier>
#include <chrono>
#include <cmath>
#include <cstdlib>
#include <iostream>
#include <map>
#include <memory>
#include <sstream>
#include <string>
#include <thread>
#include <utility>
#include <vector>

namespace agnocast::bench {
namespace {

using Clock = std::chrono::steady_clock;

// --- a heap's process

// Called through volatile pointers, so that the compiler keeps allocations without a use.
void* (*volatile allocate)(std::size_t) = std::malloc;
void (*volatile release)(void*) = std::free;

/// Threads that open it allocate from the shared heap; for other heaps it does nothing.
class Scope {
 public:
  explicit Scope(const agnocast_heaphook_table* hook) : hook_(hook) {
    if (hook_ != nullptr) hook_->enter();
  }
  ~Scope() {
    if (hook_ != nullptr) hook_->leave();
  }
  Scope(const Scope&) = delete;
  Scope& operator=(const Scope&) = delete;

 private:
  const agnocast_heaphook_table* hook_;
};

void touch(void* block, std::size_t bytes) {
  for (std::size_t i = 0; i < bytes; i += 4096) static_cast<volatile char*>(block)[i] = 1;
}

// Room for eight threads' live sets, and blocks passed between them.
constexpr std::size_t warm_bytes = std::size_t{512} << 20;
std::atomic<std::uint64_t> frontier{0};
double attach_ns = 0;

const agnocast_heaphook_table* open_shared_heap(bool is_private) {
  using Find = const agnocast_heaphook_table* (*)();
  const auto find = reinterpret_cast<Find>(::dlsym(RTLD_DEFAULT, "agnocast_heaphook"));
  if (find == nullptr) throw std::runtime_error("the heap hook was not preloaded");
  const agnocast_heaphook_table* const hook = find();
  agnocast_heaphook_window window{};
  window.base = reinterpret_cast<void*>(std::uintptr_t{1} << 38);
  window.length = std::size_t{4} << 30;
  window.write_fd = ::memfd_create("agnocast-bench heap", MFD_CLOEXEC);
  if (::ftruncate(window.write_fd, static_cast<off_t>(window.length)) != 0)
    throw std::runtime_error("there is no memfd of 4 GiB");
  const std::string path = "/proc/self/fd/" + std::to_string(window.write_fd);
  window.read_fd = ::open(path.c_str(), O_RDONLY | O_CLOEXEC);
  agnocast_heaphook_options options{};
  options.grown = [](void*, std::uint32_t, std::uint64_t bytes) { frontier = bytes; };
  const auto began = Clock::now();
  if (hook->attach(&window, &options) != AGNOCAST_HEAPHOOK_OK)
    throw std::runtime_error("the heap hook cannot open its heap");
  attach_ns = std::chrono::duration<double, std::nano>(Clock::now() - began).count();
  {
    const Scope scope(hook);
    void* const whole = allocate(warm_bytes);
    if (hook->owns(whole) == 0) throw std::runtime_error("the shared heap has no room");
    if (!is_private) touch(whole, warm_bytes);
    release(whole);
  }
  if (is_private) {
    const std::size_t bytes = frontier;
    if (::mmap(window.base, bytes, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS | MAP_FIXED,
               -1, 0) == MAP_FAILED)
      throw std::runtime_error("there is no private memory for the window");
    touch(window.base, bytes);
  }
  return hook;
}

class Random {
 public:
  explicit Random(std::uint64_t seed) : state_(88172645463325252u + seed * 2654435761u) {}
  std::uint64_t next() {
    state_ ^= state_ << 13;
    state_ ^= state_ >> 7;
    return state_ ^= state_ << 17;
  }

 private:
  std::uint64_t state_;
};

void pairs(std::size_t bytes, std::size_t count) {
  for (std::size_t i = 0; i < count; ++i) release(allocate(bytes));
}
void written(std::size_t bytes, std::size_t count) {
  for (std::size_t i = 0; i < count; ++i) {
    void* const block = allocate(bytes);
    touch(block, bytes);
    release(block);
  }
}
/// A live set of a thousand blocks, replaced at random.
template <class Size>
void live_set(std::size_t count, std::uint64_t seed, Size size) {
  std::vector<void*> live(1000, nullptr);
  Random random(seed);
  for (std::size_t i = 0; i < count; ++i) {
    const std::uint64_t word = random.next();
    void*& place = live[word % live.size()];
    release(place);
    place = allocate(size(word >> 32));
    *static_cast<volatile char*>(place) = 1;
  }
  for (void* const block : live) release(block);
}
constexpr std::size_t small_max = 1024;
std::size_t small_size(std::uint64_t word) { return 16 + word % (small_max - 15); }
// Returns 16 bytes to 64 KiB, small sizes far more often.
std::size_t mixed_size(std::uint64_t word) {
  return std::size_t{16} << (word % 64 == 0 ? (word >> 8) % 13 : (word >> 8) % 6);
}

/// One thread allocates, the other frees.
class Belt {
 public:
  void put(std::size_t bytes, std::size_t count) {
    for (std::size_t i = 0; i < count; ++i) {
      std::atomic<void*>& place = places_[i % places_.size()];
      while (place.load(std::memory_order_relaxed) != nullptr) std::this_thread::yield();
      place.store(allocate(bytes), std::memory_order_release);
    }
  }
  void take(std::size_t count) {
    for (std::size_t i = 0; i < count; ++i) {
      std::atomic<void*>& place = places_[i % places_.size()];
      void* block = nullptr;
      while ((block = place.exchange(nullptr, std::memory_order_acquire)) == nullptr)
        std::this_thread::yield();
      release(block);
    }
  }

 private:
  std::array<std::atomic<void*>, 64> places_{};
};

/// The work of one thread, `count` times.
void work(const std::string& what, std::size_t bytes, std::size_t thread, std::size_t count,
          std::vector<Belt>& belts) {
  if (what == "pairs") return pairs(bytes, count);
  if (what == "written") return written(bytes, count);
  if (what == "live" && bytes == small_max) return live_set(count, thread, small_size);
  if (what == "live") return live_set(count, thread, mixed_size);
  Belt& belt = belts[thread / 2];
  thread % 2 == 0 ? belt.put(bytes, count) : belt.take(count);
}

/// Measures from the start of the first thread until the last one is done, per call of all
/// threads.
double ns_each(const std::string& what, std::size_t bytes, std::size_t threads, std::size_t count,
               const agnocast_heaphook_table* hook) {
  std::vector<Belt> belts((threads + 1) / 2);
  std::barrier start(static_cast<std::ptrdiff_t>(threads));
  std::vector<Clock::time_point> began(threads), ended(threads);
  std::vector<std::thread> all;
  for (std::size_t i = 0; i < threads; ++i)
    all.emplace_back([&, i] {
      start.arrive_and_wait();
      const Scope scope(hook);
      began[i] = Clock::now();
      work(what, bytes, i, count, belts);
      ended[i] = Clock::now();
    });
  for (std::thread& thread : all) thread.join();
  const auto whole =
      *std::max_element(ended.begin(), ended.end()) - *std::min_element(began.begin(), began.end());
  return std::chrono::duration<double, std::nano>(whole).count() /
         static_cast<double>(count * threads);
}

int be_heap(const std::vector<std::string>& arguments) {
  const std::string& kind = arguments.at(0);
  const agnocast_heaphook_table* const hook =
      kind == "shared" || kind == "private" ? open_shared_heap(kind == "private") : nullptr;
  for (std::string line; std::getline(std::cin, line);) {
    std::istringstream words(line);
    std::string what;
    std::size_t bytes = 1, threads = 1, count = 1;
    words >> what >> bytes >> threads >> count;
    std::cout << (what == "attach" ? attach_ns : ns_each(what, bytes, threads, count, hook))
              << std::endl;
  }
  return 0;
}

const RegisterRole role("alloc-heap", be_heap);

// --- the conductor

struct Work {
  const char* what;  // name of the work in the heap's process
  std::size_t bytes;
  const char* title;
  std::size_t count;  // calls per measurement, all threads together
  std::vector<std::size_t> threads;
  std::string name() const { return what + ("-" + std::to_string(bytes)); }
  bool writes() const {
    return what == std::string_view("live") || what == std::string_view("written");
  }
};
const std::vector<Work> works{
    {"pairs", 64, "64 B, allocated and freed", 1'000'000, {1, 2, 4, 8}},
    {"live", small_max, "16 B - 1 KiB, 1000 live", 500'000, {1, 2, 4, 8}},
    {"live", 64 * kib, "16 B - 64 KiB, 1000 live", 500'000, {1, 2, 4, 8}},
    {"pairs", 4 * kib, "4 KiB, allocated and freed", 500'000, {1}},
    {"pairs", 64 * kib, "64 KiB, allocated and freed", 100'000, {1}},
    {"pairs", mib, "1 MiB, allocated and freed", 100'000, {1, 2, 4, 8}},
    {"pairs", 8 * mib, "8 MiB, allocated and freed", 100'000, {1}},
    {"written", mib, "1 MiB, its pages written", 20'000, {1, 2, 4, 8}},
    {"handed", 64, "64 B, freed by another thread", 200'000, {2, 4, 8}},
    {"handed", mib, "1 MiB, freed by another thread", 40'000, {2, 4, 8}},
};

struct Heap {
  std::string name;
  std::unique_ptr<Process> process;

  double ask(const std::string& line) {
    if (!process->send(line)) throw std::runtime_error("the heap " + name + " has ended");
    return std::stod(process->line());
  }
  double ns_each(const Work& work, std::size_t threads, std::size_t count) {
    std::ostringstream line;
    line << work.what << ' ' << work.bytes << ' ' << threads << ' '
         << std::max<std::size_t>(count / threads, 1);
    return ask(line.str());
  }
};

std::vector<Heap> make_heaps(Report& report) {
  const std::string jemalloc = "/libjemalloc.so.2";
  std::string installed;
  for (const char* const directory :
       {"/usr/lib/x86_64-linux-gnu", "/usr/lib/aarch64-linux-gnu", "/usr/lib64", "/usr/lib"}) {
    if (installed.empty() && ::access((directory + jemalloc).c_str(), R_OK) == 0)
      installed = directory + jemalloc;
  }
  const std::string hook = path_of("libagnocast_heaphook.so");
  std::vector<Heap> heaps;
  const auto add = [&heaps](const char* name, const std::string& preload) {
    Process::Options options{.command = as_role("alloc-heap", {name}), .has_pipes = true};
    if (!preload.empty()) options.environment = {"LD_PRELOAD=" + preload};
    heaps.push_back({name, std::make_unique<Process>(std::move(options))});
  };
  add("shared", hook);
  add("private", hook);
  add("outside", hook);
  if (!installed.empty()) add("jemalloc", installed);
  if (installed.empty()) report.say("libjemalloc.so.2 is not installed: left out");
  add("libc", "");
  return heaps;
}

using HeapTimes = std::map<std::string, std::vector<double>>;  // of each round

// Ratios of the first to the second; pairs with a missing heap are left out.
constexpr std::pair<const char*, const char*> compared_heaps[] = {
    {"shared", "private"}, {"shared", "jemalloc"}, {"shared", "libc"}, {"outside", "libc"}};

class Rows {
 public:
  Rows(const std::vector<Heap>& heaps, Report& report, std::size_t rounds)
      : heaps_(heaps), report_(report), rounds_(rounds) {
    std::string head = text("\n%-31s %7s", "ns each", "threads");
    for (const Heap& heap : heaps_) head += text(" %9s %5s", heap.name.c_str(), "CV");
    for (const auto& [one, other] : compared_heaps) {
      if (has(other)) head += text(" %16s", (std::string(one) + "/" + other).c_str());
    }
    report_.say(head);
  }

  void add(const Work& work, std::size_t threads, const HeapTimes& times) {
    std::string row = text("%-31s %7zu", work.title, threads);
    std::map<std::string, nlohmann::json> results;
    for (const Heap& heap : heaps_) {
      const std::vector<double>& ns = times.at(heap.name);
      row += text(" %9.1f %5.2f", median(ns), variation(ns));
      results[heap.name] = {{"system", "heap-" + heap.name},
                            {"part", work.name()},
                            {"size_bytes", work.bytes},
                            {"threads", threads},
                            {"rounds", rounds_},
                            {"samples", rounds_},
                            {"p50_ns", median(ns)},
                            {"variation", variation(ns)}};
    }
    for (const auto& [one, other] : compared_heaps) {
      if (!has(other)) continue;
      std::vector<double> ratios;
      for (std::size_t i = 0; i < rounds_; ++i)
        ratios.push_back(times.at(one)[i] / times.at(other)[i]);
      const double ratio = median(ratios);
      row += text(" %16.2f", ratio);
      results[one][std::string("ratio_to_") + other] = ratio;
      rows_[{one, other}].push_back(
          {std::move(ratios), text("%s, %zu threads", work.title, threads), work.writes()});
    }
    report_.say(row);
    for (auto& [name, result] : results) report_.add(std::move(result));
  }

  void finish(const Run& run) {
    Aims aims(run);
    for (const auto& [of, rows] : rows_) {
      const std::vector<double> written = geometric_means(rows, true);
      const std::string pair = of.first + " / " + of.second;
      const Row& worst = *std::max_element(
          rows.begin(), rows.end(),
          [](const Row& a, const Row& b) { return median(a.ratios) < median(b.ratios); });
      report_.say(text(
          "%s: geometric mean of the rows that write to their blocks %.2f, of the others %.2f; "
          "worst of all %.2f (%s)",
          pair.c_str(), median(written), median(geometric_means(rows, false)), median(worst.ratios),
          worst.text.c_str()));
      if (of != Pair{"shared", "private"}) continue;
      aims.add_median("heap " + pair + ", blocks that are written to, geometric mean", written,
                      Aims::Sense::at_most, aim);
      aims.add_information("heap " + pair + ", worst row: " + worst.text, worst.ratios);
    }
    aims.tell(report_);
  }

 private:
  using Pair = std::pair<std::string, std::string>;
  struct Row {
    std::vector<double> ratios;  // per round
    std::string text;
    bool writes;
  };
  static constexpr double aim = 1.2;
  bool has(const std::string& name) const {
    return std::any_of(heaps_.begin(), heaps_.end(),
                       [&](const Heap& heap) { return heap.name == name; });
  }
  /// Returns one mean per round.
  std::vector<double> geometric_means(const std::vector<Row>& rows, bool writes) const {
    std::vector<double> means;
    for (std::size_t round = 0; round < rounds_; ++round) {
      std::vector<double> logarithms;
      for (const Row& row : rows) {
        if (row.writes == writes) logarithms.push_back(std::log(row.ratios[round]));
      }
      means.push_back(std::exp(mean(logarithms)));
    }
    return means;
  }

  const std::vector<Heap>& heaps_;
  Report& report_;
  std::size_t rounds_;
  std::map<Pair, std::vector<Row>> rows_;
};

}  // namespace

void run_alloc(const Run& run, Report& report) {
  const std::size_t rounds = run.rounds.value_or(run.is_small ? 2 : 9);
  const std::size_t shorter = run.is_small ? 50 : 1;
  std::vector<Heap> heaps = make_heaps(report);
  report.say(text("opening the shared heap: %.0f µs", heaps.front().ask("attach") / 1e3));
  Rows rows(heaps, report, rounds);
  Plot plot{.name = "alloc",
            .kind = "bars",
            .title = "Allocations of one thread (of two where another one frees)",
            .x_label = "",
            .y_label = "ns each, median",
            .log_y = true};
  for (const Heap& heap : heaps)
    plot.series.push_back({{"label", heap.name}, {"y", nlohmann::json::array()}});
  std::size_t step = 0;
  for (const Work& work : works) {
    report.progress(step++, works.size(), work.title);
    for (const std::size_t threads : work.threads) {
      const std::size_t count = work.count / shorter;
      HeapTimes times;
      for (Heap& heap : heaps) (void)heap.ns_each(work, threads, count);
      for (std::size_t round = 0; round < rounds; ++round) {
        for (std::size_t i = 0; i < heaps.size(); ++i) {
          Heap& heap = heaps[(round + i) % heaps.size()];
          times[heap.name].push_back(heap.ns_each(work, threads, count));
        }
      }
      rows.add(work, threads, times);
      if (threads != work.threads.front()) continue;
      plot.groups.push_back(work.title);
      for (std::size_t i = 0; i < heaps.size(); ++i)
        plot.series[i]["y"].push_back(median(times[heaps[i].name]));
    }
  }
  report.progress(step, works.size(), "");
  rows.finish(run);
  report.add(std::move(plot));
}

}  // namespace agnocast::bench
