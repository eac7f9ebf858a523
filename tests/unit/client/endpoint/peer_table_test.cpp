// SPDX-License-Identifier: Apache-2.0
//
// Goal: a process is mapped with its first announced endpoint, stays mapped as long as it is used,
// and is unmapped before that is reported to the daemon. Whatever the daemon announces, nothing is
// mapped outside the arena. Method: this test is the daemon, with memfds as regions and windows.

#include <client/endpoint/peer_table.hpp>

#include <agnocast/abi/client_region.hpp>
#include <base/memory/memfd.hpp>

#include <gtest/gtest.h>
#include <poll.h>

#include <cstdint>
#include <memory>
#include <utility>
#include <vector>

namespace agnocast {
namespace {

constexpr std::uint64_t peer_arena_bytes = std::uint64_t{64} << 20,
                        peer_window_bytes = std::uint64_t{4} << 20;
constexpr std::uint64_t peer_region_bytes = std::uint64_t{1} << 30, extent = std::uint64_t{1} << 20;

struct PeerTableTest : testing::Test {
  static constexpr PeerTable::Key self{1, 10}, other{2, 20};

  PeerTableTest() { table.begin({self, &region, &arena, wake}); }

  static UniqueFd file(std::uint64_t bytes) { return make_memfd("test", bytes).value(); }
  /// The lower end of a gap: the kernel puts further mappings at the upper end.
  static std::uint64_t free_addresses() {
    return reinterpret_cast<std::uint64_t>(
        Mapping::reserve(0, peer_arena_bytes + (1 << 30)).value().base());
  }
  abi::wire::Announcement announcement(const PeerTable::Key& process,
                                       std::uint32_t windows = 0) const {
    abi::wire::Announcement body{};
    body.kind = abi::wire::Kind::publisher;
    body.client = process.first;
    body.client_generation = process.second;
    body.extent = extent;
    body.uid = 4711;
    body.window_count = windows;
    for (std::uint32_t i = 0; i < windows; ++i)
      body.window[i] = {arena.base() + i * peer_window_bytes, peer_window_bytes, 0};
    return body;
  }
  std::shared_ptr<Peer> use(const abi::wire::Announcement& body) {
    std::vector<UniqueFd> fds;
    fds.push_back(file(peer_region_bytes));
    for (std::uint32_t i = 0; i < body.window_count; ++i) fds.push_back(file(peer_window_bytes));
    std::size_t used = 0;
    auto peer = table.use(body, fds, used);
    EXPECT_EQ(used, 1 + body.window_count);
    return peer;
  }
  std::vector<PeerTable::Key> collect() {
    std::vector<PeerTable::Key> all;
    table.collect([&](const PeerTable::Key& process) {
      EXPECT_FALSE(table.has(process)) << "reported before it was unmapped";
      all.push_back(process);
    });
    return all;
  }
  bool was_woken() const {
    pollfd readable{wake->fd(), POLLIN, 0};
    return ::poll(&readable, 1, 0) == 1;
  }

  Arena arena = Arena::reserve(free_addresses(), peer_arena_bytes).value();
  SparseRegion region =
      SparseRegion::make(file(peer_region_bytes), peer_region_bytes, Mapping::Access::read_write)
          .value();
  std::shared_ptr<const ControlWake> wake = ControlWake::make().value();
  EndpointTable endpoints;
  PeerTable table{endpoints};
};

TEST_F(PeerTableTest, KeepsAProcessAsLongAsItIsUsed) {
  auto first = use(announcement(other));
  ASSERT_NE(first, nullptr);
  auto second = use(announcement(other));
  ASSERT_NE(second, nullptr);
  EXPECT_EQ(first.get(), second.get());
  EXPECT_TRUE(table.has(other));
  first.reset();
  EXPECT_FALSE(was_woken());
  EXPECT_TRUE(collect().empty());
  second.reset();
  EXPECT_TRUE(was_woken());
  EXPECT_EQ(collect(), std::vector<PeerTable::Key>{other});
  EXPECT_TRUE(table.is_empty());
}

TEST_F(PeerTableTest, KnowsOtherGenerationsAsOtherProcesses) {
  const auto one = use(announcement(other)), next = use(announcement({other.first, 21}));
  ASSERT_NE(one, nullptr);
  ASSERT_NE(next, nullptr);
  EXPECT_NE(one.get(), next.get());
  // A previous process at the place of this one is another process, too.
  const auto previous = use(announcement({self.first, 9}));
  ASSERT_NE(previous, nullptr);
  EXPECT_NE(previous->region(), region.base());
}

TEST_F(PeerTableTest, UnmapsOnlyUnusedProcessesWithoutADaemonToo) {
  const auto used = use(announcement(other));
  use(announcement({3, 30}));
  table.collect_alone();
  EXPECT_TRUE(table.has(other));
  EXPECT_FALSE(table.has({3, 30}));
}

TEST_F(PeerTableTest, HasItsOwnProcessAsAPeerAndDoesNotReportItsEnd) {
  auto here = use(announcement(self));
  ASSERT_NE(here, nullptr);
  EXPECT_EQ(here->region(), region.base());
  EXPECT_TRUE(table.owner_of(announcement(self)).is_own);
  EXPECT_FALSE(table.owner_of(announcement(other)).is_own);
  auto of_this_user = announcement(other);
  of_this_user.same_user = 1;
  EXPECT_TRUE(table.owner_of(of_this_user).is_own);
  here.reset();
  EXPECT_TRUE(collect().empty());
  EXPECT_TRUE(table.is_empty());
}

TEST_F(PeerTableTest, HasTheAnnouncedWindows) {
  const auto peer = use(announcement(other, 2));
  ASSERT_NE(peer, nullptr);
  EXPECT_EQ(peer->heap().window_count(), 2u);
  table.add_window(other, {2, arena.base() + 2 * peer_window_bytes, peer_window_bytes, 0},
                   file(peer_window_bytes));
  EXPECT_EQ(peer->heap().window_count(), 3u);
  table.add_window({3, 30}, {0, arena.base(), peer_window_bytes, 0}, file(peer_window_bytes));
  EXPECT_FALSE(table.has({3, 30})) << "a window does not make its process known";
}

TEST_F(PeerTableTest, MapsNothingOutsideTheArena) {
  auto body = announcement(other, 1);
  body.window[0].base = arena.base() + peer_arena_bytes - peer_window_bytes / 2;
  EXPECT_EQ(use(body), nullptr);
  const auto peer = use(announcement(other));
  ASSERT_NE(peer, nullptr);
  table.add_window(other, {0, arena.base() - peer_window_bytes, peer_window_bytes, 0},
                   file(peer_window_bytes));
  EXPECT_EQ(peer->heap().window_count(), 0u);
}

TEST_F(PeerTableTest, UsesNoProcessWithMissingDescriptors) {
  std::size_t used = 0;
  EXPECT_EQ(table.use(announcement(other), {}, used), nullptr);
  EXPECT_FALSE(table.has(other));
  auto body = announcement(other, 1);
  std::vector<UniqueFd> region_alone;
  region_alone.push_back(file(peer_region_bytes));
  EXPECT_EQ(table.use(body, region_alone, used), nullptr);
  body.window_count = abi::window_count_max + 1;
  std::vector<UniqueFd> fds;
  for (std::uint64_t i = 0; i < abi::window_count_max + 2; ++i)
    fds.push_back(file(peer_window_bytes));
  EXPECT_EQ(table.use(body, fds, used), nullptr);
  EXPECT_TRUE(table.is_empty());
}

}  // namespace
}  // namespace agnocast
