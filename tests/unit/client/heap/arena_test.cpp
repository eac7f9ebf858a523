// SPDX-License-Identifier: Apache-2.0
//
// Goal: a process gets the free part of its arena, and knows which part is blocked and by what.
// Method: pages of this test in a range that was free a moment before.

#include <client/heap/arena.hpp>

#include <gtest/gtest.h>

#include <sys/mman.h>

#include <cstdint>
#include <string>
#include <utility>
#include <vector>

namespace agnocast {
namespace {

constexpr std::uint64_t granule = abi::window_granule_bytes;
constexpr std::uint64_t arena_bytes = 64 * granule;

/// Returns a granule-aligned base with room for the arena.
std::uint64_t free_base() {
  const Mapping room = Mapping::reserve(0, arena_bytes + granule).value();
  return (reinterpret_cast<std::uint64_t>(room.base()) + granule - 1) / granule * granule;
}

class Page {
 public:
  explicit Page(std::uint64_t address)
      : at_(::mmap(reinterpret_cast<void*>(address), 4096, PROT_READ,
                   MAP_PRIVATE | MAP_ANONYMOUS | MAP_FIXED_NOREPLACE, -1, 0)) {
    EXPECT_EQ(reinterpret_cast<std::uint64_t>(at_), address);
  }
  Page(Page&& other) noexcept : at_(std::exchange(other.at_, MAP_FAILED)) {}
  Page(const Page&) = delete;
  Page& operator=(const Page&) = delete;
  ~Page() {
    if (at_ != MAP_FAILED) ::munmap(at_, 4096);
  }

 private:
  void* at_;
};

TEST(Arena, IsReservedWholeWhereAllIsFree) {
  const std::uint64_t base = free_base();
  const auto arena = Arena::reserve(base, arena_bytes);
  ASSERT_TRUE(arena);
  EXPECT_TRUE(arena->blocked().empty());
  EXPECT_TRUE(arena->has(base, arena_bytes));
  EXPECT_TRUE(arena->contains(base, arena_bytes));
  EXPECT_FALSE(arena->has(base, arena_bytes + 1));
  EXPECT_FALSE(arena->has(base - 1, 2));
  EXPECT_FALSE(arena->contains(base + 1, arena_bytes));
  EXPECT_FALSE(arena->contains(base, ~std::uint64_t{0}));
  void* const taken = ::mmap(reinterpret_cast<void*>(base), 4096, PROT_READ,
                             MAP_PRIVATE | MAP_ANONYMOUS | MAP_FIXED_NOREPLACE, -1, 0);
  EXPECT_EQ(taken, MAP_FAILED) << "no other mapping gets these addresses by chance";
}

TEST(Arena, AvoidsForeignMappingsAndNamesThem) {
  const std::uint64_t base = free_base();
  const Page first(base), second(base + 5 * granule + 4096), third(base + 6 * granule),
      last(base + arena_bytes - 4096);
  const auto arena = Arena::reserve(base, arena_bytes);
  ASSERT_TRUE(arena);
  ASSERT_EQ(arena->blocked().size(), 3u);
  EXPECT_EQ(arena->blocked()[0].base, base);
  EXPECT_EQ(arena->blocked()[0].bytes, granule);
  EXPECT_EQ(arena->blocked()[1].base, base + 5 * granule);
  EXPECT_EQ(arena->blocked()[1].bytes, 2 * granule) << "two adjacent ones are merged";
  EXPECT_EQ(arena->blocked()[2].base, base + arena_bytes - granule);
  EXPECT_NE(arena->blocked()[1].what.find("r--p 00000000 00:00 0"), std::string::npos);
  EXPECT_FALSE(arena->has(base, granule));
  EXPECT_TRUE(arena->has(base + granule, 4 * granule));
  EXPECT_FALSE(arena->has(base + granule, 5 * granule));
  EXPECT_TRUE(arena->contains(base, 5 * granule));
  EXPECT_TRUE(arena->has(base + 7 * granule, arena_bytes - 8 * granule));
}

TEST(Arena, BlockedRangesBeyondTheMaximumAreMergedUpToTheEnd) {
  const std::uint64_t base = free_base();
  std::vector<Page> pages;
  for (std::uint64_t i = 0; i < abi::blocked_count_max + 2; ++i)
    pages.emplace_back(base + (1 + 2 * i) * granule);
  const auto arena = Arena::reserve(base, arena_bytes);
  ASSERT_TRUE(arena);
  ASSERT_EQ(arena->blocked().size(), abi::blocked_count_max);
  const Arena::Blocked& last = arena->blocked().back();
  EXPECT_EQ(last.base, base + (1 + 2 * (abi::blocked_count_max - 1)) * granule);
  EXPECT_EQ(last.base + last.bytes, base + arena_bytes);
  EXPECT_TRUE(arena->has(base, granule));
  EXPECT_FALSE(arena->has(base + arena_bytes - granule, granule));
}

TEST(Arena, IsRefusedWhereNothingIsFree) {
  const std::uint64_t base = free_base();
  const Page page(base + 4096);
  const auto arena = Arena::reserve(base, granule);
  ASSERT_FALSE(arena);
  EXPECT_EQ(arena.error().code, Errc::arena_occupied);
  EXPECT_NE(text_of(arena.error()).find("r--p"), std::string::npos);
}

}  // namespace
}  // namespace agnocast
