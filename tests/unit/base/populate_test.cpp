// SPDX-License-Identifier: Apache-2.0
//
// Goal: pages become present for writing with their content, and an impossible range is a failure,
// not a signal. Method: a memfd with a hole, a used page and an end; both ways of the kernel.

#include <base/memory/mapping.hpp>
#include <base/memory/memfd.hpp>
#include <base/memory/populate.hpp>

#include <gtest/gtest.h>
#include <sys/stat.h>

#include <cstring>

namespace agnocast {
namespace {

constexpr std::uint64_t page = 4096, pages = 16;

class Populate
    : public testing::TestWithParam<Result<void> (*)(std::byte*, std::uint64_t) noexcept> {
 protected:
  UniqueFd file_ = std::move(make_memfd("agnocast-test", pages* page, Length::may_grow).value());
  Mapping mapping_ =
      std::move(Mapping::map(file_.get(), 2 * pages * page, Mapping::Access::read_write).value());

  std::uint64_t bytes_of_memory() const {
    struct stat file {};
    EXPECT_EQ(::fstat(file_.get(), &file), 0);
    return static_cast<std::uint64_t>(file.st_blocks) * 512;
  }
};

TEST_P(Populate, MakesPagesPresentAndKeepsTheirContent) {
  std::memset(mapping_.base() + 3 * page, 0x5a, page);
  ASSERT_EQ(bytes_of_memory(), page);
  ASSERT_TRUE(GetParam()(mapping_.base() + page, 8 * page));
  EXPECT_EQ(bytes_of_memory(), 8 * page);
  for (std::uint64_t i = 0; i < pages * page; ++i)
    ASSERT_EQ(std::to_integer<int>(mapping_.base()[i]), i / page == 3 ? 0x5a : 0);
}

TEST_P(Populate, FailsWhereTheFileIsShorter) {
  const auto populated = GetParam()(mapping_.base(), (pages + 1) * page);
  ASSERT_FALSE(populated);
  EXPECT_EQ(populated.error().code, Errc::os_failure);
  EXPECT_EQ(populated.error().os_errno, EFAULT);
}

INSTANTIATE_TEST_SUITE_P(Ways, Populate, testing::Values(&populate, &populate_page_by_page));

}  // namespace
}  // namespace agnocast
