// SPDX-License-Identifier: Apache-2.0
//
// Goal: a claimed region shows that its process lives, exactly as long as it does, and no other
// process can show that. Method: memfds as the daemon makes them, real processes, real SIGKILL.

#include <client/heap/sparse_region.hpp>

#include <base/descriptors/kept_fd.hpp>
#include <base/memory/memfd.hpp>
#include <client/process/forked_child.hpp>
#include <tests/support/processes/child.hpp>

#include <fcntl.h>
#include <gtest/gtest.h>
#include <sys/mman.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <csignal>
#include <new>
#include <string>
#include <utility>
#include <vector>

namespace agnocast {
namespace {

constexpr std::uint64_t small_region_bytes = std::uint64_t{1} << 20;

/// One process may write it, others read it.
struct Region {
  UniqueFd writer = make_memfd("region", small_region_bytes).value();

  SparseRegion owned() const {
    UniqueFd fd(::fcntl(writer.get(), F_DUPFD_CLOEXEC, 0));
    return SparseRegion::make(std::move(fd), small_region_bytes, Mapping::Access::read_write)
        .value();
  }
  SparseRegion read() const {
    return SparseRegion::make(reopen_read_only(writer.get()).value(), small_region_bytes,
                              Mapping::Access::read)
        .value();
  }
};

class SparseRegionClaim : public testing::Test {
 protected:
  static void SetUpTestSuite() { ASSERT_TRUE(recognise_forked_children()); }
};

/// What a child reports to its parent.
struct Word {
  std::atomic<int> word{0};
  static Word& make() {
    void* const page =
        ::mmap(nullptr, 4096, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
    return *new (page) Word;
  }
  int wait() const {
    while (word.load() == 0) ::usleep(1000);
    return word.load();
  }
};

TEST_F(SparseRegionClaim, IsSeenByReadersUntilTheRegionIsUnmapped) {
  const Region region;
  const SparseRegion reader = region.read();
  EXPECT_FALSE(reader.is_claimed());
  SparseRegion owned = region.owned();
  ASSERT_TRUE(owned.open(0, abi::page_bytes));
  ASSERT_TRUE(owned.claim());
  EXPECT_TRUE(reader.is_claimed());
  SparseRegion moved = std::move(owned);
  owned = {};
  EXPECT_TRUE(reader.is_claimed());
  moved = {};
  EXPECT_FALSE(reader.is_claimed()) << "although the daemon still has its descriptor";
}

// A program may close descriptors that it did not open, and reuse the number for its own.
TEST(SparseRegionParts, OfAFileThatTookTheRegionsDescriptorNumberAreNotMapped) {
  UniqueFd file = keep(make_memfd("region", small_region_bytes).value());
  const int number = file.get();
  SparseRegion region =
      SparseRegion::make(std::move(file), small_region_bytes, Mapping::Access::read_write).value();
  ASSERT_TRUE(region.open(0, abi::page_bytes));
  const UniqueFd strange = make_memfd("strange", small_region_bytes).value();
  ASSERT_EQ(::dup2(strange.get(), number), number);
  const auto refused = region.open(abi::page_bytes, abi::page_bytes);
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().os_errno, EBADF);
}

// Other threads use them at that time.
TEST(SparseRegionParts, ThatAreOpenAreNotMappedAgain) {
  const Region file;
  SparseRegion region = file.owned();
  constexpr std::uint64_t page = abi::page_bytes;
  for (const auto& [first, count] :
       {std::pair<std::uint64_t, std::uint64_t>{1, 2}, {5, 2}, {3, 2}, {8, 1}, {2, 4}})
    ASSERT_TRUE(region.open(first * page, count * page));
  const auto close_all = [&] { ASSERT_EQ(::mprotect(region.base(), 10 * page, PROT_NONE), 0); };
  const auto accessible = [&] {
    int ends[2];
    EXPECT_EQ(::pipe(ends), 0);
    std::string pages;
    for (std::uint64_t i = 0; i < 10; ++i)
      pages += ::write(ends[1], region.base() + i * page, 1) == 1 ? '1' : '0';
    ::close(ends[0]);
    ::close(ends[1]);
    return pages;
  };
  EXPECT_EQ(accessible(), "0111111010");
  close_all();
  ASSERT_TRUE(region.open(page, 6 * page));
  ASSERT_TRUE(region.open(8 * page, 1));
  EXPECT_EQ(accessible(), "0000000000");
  ASSERT_TRUE(region.open(0, 2 * page));
  ASSERT_TRUE(region.open(6 * page, 3 * page));
  EXPECT_EQ(accessible(), "1100001110");
  close_all();
  ASSERT_TRUE(region.open(0, 9 * page));
  EXPECT_EQ(accessible(), "0000000000") << "all are one range now";
  ASSERT_TRUE(region.open(0, 10 * page));
  EXPECT_EQ(accessible(), "1111111111");
}

TEST_F(SparseRegionClaim, EndsWithItsProcessEvenIfAChildOfItLives) {
  Region region;
  const SparseRegion reader = region.read();
  Word& grandchild = Word::make();
  {
    const test::Child owner([&] {
      SparseRegion owned(SparseRegion::make(std::move(region.writer), small_region_bytes,
                                            Mapping::Access::read_write)
                             .value());
      if (!owned.open(0, abi::page_bytes) || !owned.claim()) return 1;
      // The grandchild reports it: when fork has returned there, it has closed the lock.
      if (::fork() == 0) grandchild.word.store(::getpid());
      return test::sleep_for_ever();
    });
    region.writer.reset();  // a daemon whose store is lost has no descriptor
    grandchild.wait();
    EXPECT_TRUE(reader.is_claimed());
  }
  // The owner has ended when its parent can reap it; the grandchild lives.
  EXPECT_FALSE(reader.is_claimed());
  EXPECT_EQ(::kill(grandchild.word.load(), 0), 0)
      << "the grandchild is gone: this test shows nothing";
  ::kill(grandchild.word.load(), SIGKILL);
}

TEST_F(SparseRegionClaim, CannotBeForgedByAReader) {
  const Region region;
  const SparseRegion reader = region.read();
  const UniqueFd liar = reopen_read_only(region.writer.get()).value();
  struct flock lock {};
  lock.l_type = F_RDLCK;
  ASSERT_EQ(::fcntl(liar.get(), F_OFD_SETLK, &lock), 0);
  EXPECT_FALSE(reader.is_claimed());
  lock.l_type = F_WRLCK;
  EXPECT_NE(::fcntl(liar.get(), F_OFD_SETLK, &lock), 0);
}

TEST_F(SparseRegionClaim, IsRefusedWhereItCannotBeShown) {
  const Region region;
  const UniqueFd other = reopen_read_only(region.writer.get()).value();
  struct flock lock {};
  lock.l_type = F_RDLCK;
  ASSERT_EQ(::fcntl(other.get(), F_OFD_SETLK, &lock), 0);
  SparseRegion owned = region.owned();
  const Result<void> refused = owned.claim();
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, Errc::os_failure);
  EXPECT_EQ(refused.error().os_errno, EAGAIN);
}

TEST_F(SparseRegionClaim, LeavesADescriptorOfTheSameNumberToLaterChildren) {
  {
    const Region region;
    SparseRegion owned = region.owned();
    ASSERT_TRUE(owned.claim());
  }
  std::vector<UniqueFd> all;  // one of them gets the number
  for (int i = 0; i < 16; ++i) all.emplace_back(::open("/dev/null", O_RDONLY | O_CLOEXEC));
  test::Child child([&] {
    for (const UniqueFd& fd : all) {
      if (::fcntl(fd.get(), F_GETFD) < 0) return 1;
    }
    return 0;
  });
  EXPECT_EQ(child.wait(), 0);
}

TEST_F(SparseRegionClaim, OfMoreThanSixtyFourRegionsAtOnceIsRefused) {
  std::vector<Region> regions(65);
  std::vector<SparseRegion> owned;
  for (const Region& region : regions) owned.push_back(region.owned());
  for (std::size_t i = 0; i < 64; ++i) ASSERT_TRUE(owned[i].claim()) << i;
  const Result<void> refused = owned[64].claim();
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, Errc::limit_reached);
  owned[10] = {};
  EXPECT_TRUE(owned[64].claim());
}

}  // namespace
}  // namespace agnocast
