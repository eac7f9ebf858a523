// SPDX-License-Identifier: Apache-2.0
//
// Goal: the frontier of a growing heap is stored in every client region that follows it and in
// none that has left, and an allocating thread waits for no other thread. Method: a hook of this
// test, which intervenes at the worst moments.

#include <client/heap/heap.hpp>

#include <agnocast/abi/client_region.hpp>
#include <base/memory/mapping.hpp>
#include <tests/support/soon.hpp>

#include <gtest/gtest.h>
#include <sys/mman.h>
#include <unistd.h>

#include <atomic>
#include <csignal>
#include <cstdlib>
#include <functional>
#include <memory>
#include <thread>
#include <vector>

namespace agnocast {
namespace {

using test::soon;

constexpr std::uint64_t base = 0x100000000, length = std::uint64_t{1} << 30;

// --- the hook

std::atomic<std::uint64_t> hook_frontier{0};
agnocast_heaphook_options hook_options;
std::function<void()> while_follow_looks;

int attach(const agnocast_heaphook_window*, const agnocast_heaphook_options* options) {
  hook_options = *options;
  return AGNOCAST_HEAPHOOK_OK;
}
void nothing() {}
int owns(const void*) { return 1; }
std::uint64_t frontier(std::uint32_t) {
  const std::uint64_t now = hook_frontier.load(std::memory_order_acquire);
  if (while_follow_looks) while_follow_looks();
  return now;
}
void grow_to(std::uint64_t bytes) {
  hook_frontier.store(bytes, std::memory_order_release);
  hook_options.grown(hook_options.context, 0, bytes);
}

// --- client regions: the first page

struct Region {
  Region()
      : page(static_cast<std::byte*>(::mmap(nullptr, abi::page_bytes, PROT_READ | PROT_WRITE,
                                            MAP_PRIVATE | MAP_ANONYMOUS, -1, 0))) {}
  ~Region() { ::munmap(page, abi::page_bytes); }
  Region(const Region&) = delete;
  Region& operator=(const Region&) = delete;
  std::uint64_t frontier() const {
    return reinterpret_cast<abi::ClientRegionHeader*>(page)->window[0].frontier.load();
  }
  std::byte* const page;
};

// The next store into a closed page waits here.
std::atomic<bool> is_stopped{false}, may_go_on{false};
void wait_at_closed_page(int, siginfo_t* info, void*) {
  is_stopped = true;
  while (!may_go_on) {
  }
  const auto address = reinterpret_cast<std::uintptr_t>(info->si_addr);
  ::mprotect(reinterpret_cast<void*>(address / abi::page_bytes * abi::page_bytes), abi::page_bytes,
             PROT_READ | PROT_WRITE);
}

class HeapRegions : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    static Region* const first = new Region;  // region of the first session, always followed
    auto heap = Heap::find();
    ASSERT_TRUE(heap) << heap.error().what;
    ASSERT_TRUE(
        heap->attach(first->page, base, length, UniqueFd(::dup(0)), 0, HeapScope::loan, nullptr));
    ASSERT_EQ(Heap::window_count(), 1u);
  }
};

TEST_F(HeapRegions, ARegionHasTheFrontierAsSoonAsItFollows) {
  grow_to(100);
  const Region region;
  ASSERT_TRUE(Heap::follow(region.page));
  EXPECT_EQ(region.frontier(), 100u);
  grow_to(200);
  EXPECT_EQ(region.frontier(), 200u);
  Heap::leave_region(region.page);
  grow_to(300);
  EXPECT_EQ(region.frontier(), 200u);
}

TEST_F(HeapRegions, AnAllocationDoesNotWaitForFollow) {
  grow_to(1000);
  const Region region;
  std::atomic<bool> grown{false};
  std::thread allocates;
  while_follow_looks = [&] {
    // As if the allocating thread preempted follow() here for ever.
    allocates = std::thread([&] {
      grow_to(2000);
      grown = true;
    });
    EXPECT_TRUE(soon([&] { return grown.load(); }))
        << "the allocation waits for a thread that cannot run";
  };
  const bool followed = Heap::follow(region.page);
  while_follow_looks = nullptr;
  allocates.join();
  ASSERT_TRUE(followed);
  EXPECT_EQ(region.frontier(), 2000u) << "an older frontier overwrote a newer one";
  Heap::leave_region(region.page);
}

TEST_F(HeapRegions, LeaveRegionWaitsForAGrowthUnderWay) {
#if defined(AGNOCAST_UNDER_THREAD_SANITIZER)
  GTEST_SKIP() << "ThreadSanitizer runs a signal's handler later";
#endif
  const Region region;
  ASSERT_TRUE(Heap::follow(region.page));
  struct sigaction action {
  }, before{};
  action.sa_sigaction = wait_at_closed_page;
  action.sa_flags = SA_SIGINFO;
  ASSERT_EQ(::sigaction(SIGSEGV, &action, &before), 0);
  ASSERT_EQ(::mprotect(region.page, abi::page_bytes, PROT_NONE), 0);
  std::thread allocates([] { grow_to(5000); });
  ASSERT_TRUE(soon([] { return is_stopped.load(); }));
  std::atomic<bool> left{false};
  std::thread leaves([&] {
    Heap::leave_region(region.page);
    left = true;
  });
  ::usleep(100'000);  // long enough for a leave that does not wait
  EXPECT_FALSE(left);
  may_go_on = true;
  allocates.join();
  leaves.join();
  ASSERT_EQ(::sigaction(SIGSEGV, &before, nullptr), 0);
  EXPECT_EQ(region.frontier(), 5000u) << "the growth did not write: this test shows nothing";
}

TEST_F(HeapRegions, RegionsThatComeAndGoMissNoFrontier) {
  std::atomic<bool> stop{false};
  std::thread allocates([&] {
    for (std::uint64_t bytes = 10'000; !stop; ++bytes) grow_to(bytes);
  });
  for (int i = 0; i < 20'000; ++i) {
    const Region region;
    const std::uint64_t before = hook_frontier.load(std::memory_order_acquire);
    ASSERT_TRUE(Heap::follow(region.page));
    const std::uint64_t first = region.frontier();
    ASSERT_GE(first, before);
    ASSERT_GE(region.frontier(), first);
    Heap::leave_region(region.page);
  }
  stop = true;
  allocates.join();
}

TEST_F(HeapRegions, MoreThanEightAreRefused) {
  std::vector<std::unique_ptr<Region>> regions;
  for (int i = 0; i < 8; ++i) regions.push_back(std::make_unique<Region>());
  for (int i = 0; i < 7; ++i) ASSERT_TRUE(Heap::follow(regions[static_cast<std::size_t>(i)]->page));
  EXPECT_FALSE(Heap::follow(regions[7]->page));
  for (const auto& region : regions) Heap::leave_region(region->page);
  EXPECT_TRUE(Heap::follow(regions[7]->page));
  Heap::leave_region(regions[7]->page);
}

}  // namespace
}  // namespace agnocast

extern "C" __attribute__((visibility("default"))) const agnocast_heaphook_table*
agnocast_heaphook() {
  static const agnocast_heaphook_table table = [] {
    agnocast_heaphook_table hook{};
    hook.abi_version = AGNOCAST_HEAPHOOK_ABI_VERSION;
    hook.size_bytes = sizeof hook;
    hook.attach = agnocast::attach;
    hook.enter = hook.leave = agnocast::nothing;
    hook.owns = agnocast::owns;
    hook.frontier = agnocast::frontier;
    return hook;
  }();
  return &table;
}
