// SPDX-License-Identifier: Apache-2.0
//
// Cost of the heap hook's allocations beside libc's, in one process and one run.
//
//   libc      libc's own functions, past the hook
//   outside   malloc and free as a program calls them, out of scope: libc plus what the hook adds
//   shared    the same calls in a loan scope: the shared arena
//
// Rounds of the three are interleaved, so that frequency changes and neighbours hit all alike; printed is the median round.
//   allocator_bench [ROUNDS]      default 7

#include <agnocast/abi/heaphook.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <string>
#include <thread>
#include <vector>

#include <dlfcn.h>
#include <fcntl.h>
#include <sys/mman.h>
#include <unistd.h>

namespace {

struct Heap {
  const char* name;
  void* (*allocate)(std::size_t);
  void (*release)(void*);
  bool in_scope;
};

using Clock = std::chrono::steady_clock;

double nanoseconds_each(Clock::time_point start, std::size_t count) {
  return std::chrono::duration<double, std::nano>(Clock::now() - start).count() / static_cast<double>(count);
}

double pairs(const Heap& heap, std::size_t size, std::size_t count) {
  const auto start = Clock::now();
  for (std::size_t i = 0; i < count; ++i) {
    void* block = heap.allocate(size);
    asm volatile("" : "+r"(block) : : "memory");
    heap.release(block);
  }
  return nanoseconds_each(start, count);
}

// A live set of 1000 blocks of 16 bytes to 64 KiB, small ones far more often, replaced at random.
double mixed(const Heap& heap, std::size_t count) {
  std::vector<void*> live(1000, nullptr);
  std::uint64_t random = 88172645463325252u;
  const auto start = Clock::now();
  for (std::size_t i = 0; i < count; ++i) {
    random ^= random << 13;
    random ^= random >> 7;
    random ^= random << 17;
    void*& slot = live[random % live.size()];
    heap.release(slot);
    slot = heap.allocate(std::size_t{16} << ((random >> 32) % 64 == 0 ? (random >> 40) % 13 : (random >> 40) % 6));
  }
  const double each = nanoseconds_each(start, count);
  for (void* block : live) heap.release(block);
  return each;
}

// One thread allocates, another frees, as a publisher's thread and a control thread do.
double handed_over(const Heap& heap, const agnocast_heaphook_table& hook, std::size_t size, std::size_t count) {
  std::vector<std::atomic<void*>> ring(256);
  std::thread consumer([&] {
    for (std::size_t i = 0; i < count; ++i) {
      std::atomic<void*>& slot = ring[i % ring.size()];
      void* block = nullptr;
      while ((block = slot.exchange(nullptr, std::memory_order_acquire)) == nullptr) std::this_thread::yield();
      heap.release(block);
    }
  });
  const auto start = Clock::now();
  if (heap.in_scope) hook.enter();
  for (std::size_t i = 0; i < count; ++i) {
    std::atomic<void*>& slot = ring[i % ring.size()];
    while (slot.load(std::memory_order_relaxed) != nullptr) std::this_thread::yield();
    slot.store(heap.allocate(size), std::memory_order_release);
  }
  if (heap.in_scope) hook.leave();
  consumer.join();
  return nanoseconds_each(start, count);
}

}  // namespace

int main(int argc, char** argv) {
  const int rounds = argc > 1 ? std::atoi(argv[1]) : 7;
  using Find = const agnocast_heaphook_table* (*)();
  const auto find = reinterpret_cast<Find>(dlsym(RTLD_DEFAULT, "agnocast_heaphook"));
  void* const libc = dlopen("libc.so.6", RTLD_LAZY | RTLD_NOLOAD);
  if (find == nullptr || libc == nullptr || rounds < 1) return 2;
  const agnocast_heaphook_table& hook = *find();

  agnocast_heaphook_window window{};
  window.base = reinterpret_cast<void*>(std::uintptr_t{1} << 38);
  window.length = std::size_t{4} << 30;
  window.write_fd = memfd_create("allocator_bench", MFD_CLOEXEC);
  if (ftruncate(window.write_fd, static_cast<off_t>(window.length)) != 0) return 1;
  window.read_fd = open(("/proc/self/fd/" + std::to_string(window.write_fd)).c_str(), O_RDONLY | O_CLOEXEC);
  agnocast_heaphook_options options{};
  options.grown = [](void*, std::uint32_t, std::uint64_t) {};
  const auto before_attach = Clock::now();
  if (hook.attach(&window, &options) != AGNOCAST_HEAPHOOK_OK) return 1;
  std::printf("attach: %.0f us\n", nanoseconds_each(before_attach, 1000));

  const Heap heaps[] = {
      {"libc", reinterpret_cast<void* (*)(std::size_t)>(dlsym(libc, "malloc")),
       reinterpret_cast<void (*)(void*)>(dlsym(libc, "free")), false},
      {"outside", malloc, free, false},
      {"shared", malloc, free, true},
  };
  struct Case {
    const char* name;
    double (*measure)(const Heap&, const agnocast_heaphook_table&);
  };
  const auto scoped = [](const Heap& heap, const agnocast_heaphook_table& table, auto body) {
    if (heap.in_scope) table.enter();
    const double each = body();
    if (heap.in_scope) table.leave();
    return each;
  };
  static const auto in = scoped;
  const Case cases[] = {
      {"pair of 64 B", [](const Heap& h, const agnocast_heaphook_table& t) { return in(h, t, [&] { return pairs(h, 64, 2000000); }); }},
      {"pair of 4 KiB", [](const Heap& h, const agnocast_heaphook_table& t) { return in(h, t, [&] { return pairs(h, 4096, 1000000); }); }},
      {"pair of 64 KiB", [](const Heap& h, const agnocast_heaphook_table& t) { return in(h, t, [&] { return pairs(h, 65536, 200000); }); }},
      {"pair of 1 MiB", [](const Heap& h, const agnocast_heaphook_table& t) { return in(h, t, [&] { return pairs(h, 1 << 20, 100000); }); }},
      {"pair of 8 MiB", [](const Heap& h, const agnocast_heaphook_table& t) { return in(h, t, [&] { return pairs(h, 8 << 20, 100000); }); }},
      {"mixed live set", [](const Heap& h, const agnocast_heaphook_table& t) { return in(h, t, [&] { return mixed(h, 1000000); }); }},
      {"freed elsewhere, 64 B", [](const Heap& h, const agnocast_heaphook_table& t) { return handed_over(h, t, 64, 300000); }},
      {"freed elsewhere, 1 MiB", [](const Heap& h, const agnocast_heaphook_table& t) { return handed_over(h, t, 1 << 20, 50000); }},
  };
  std::printf("%-24s %10s %10s %10s   ns each, median of %d rounds\n", "", "libc", "outside", "shared", rounds);
  for (const Case& one : cases) {
    std::vector<double> samples[3];
    for (int round = 0; round < rounds; ++round) {
      for (std::size_t i = 0; i < 3; ++i) samples[i].push_back(one.measure(heaps[i], hook));
    }
    for (auto& values : samples) std::sort(values.begin(), values.end());
    const std::size_t middle = static_cast<std::size_t>(rounds) / 2;
    std::printf("%-24s %10.1f %10.1f %10.1f\n", one.name, samples[0][middle], samples[1][middle], samples[2][middle]);
  }
}
