// SPDX-License-Identifier: Apache-2.0
//
// Goal: peers of other users cause no more descriptors than their share, however often they come
// and go; no peer gets the last few descriptor numbers. Method: the share of this process, under
// limits that the test sets.

#include <base/descriptors/unique_fd.hpp>
#include <base/memory/map_count.hpp>
#include <base/memory/memfd.hpp>
#include <client/endpoint/peer.hpp>
#include <client/shares/descriptor_share.hpp>

#include <fcntl.h>
#include <gtest/gtest.h>
#include <sys/resource.h>
#include <unistd.h>

#include <memory>
#include <utility>
#include <vector>

namespace agnocast {
namespace {

using Owner = DescriptorShare::Owner;
using Part = DescriptorShare::Part;

class Share : public testing::Test {
 protected:
  void SetUp() override {
    ASSERT_EQ(::getrlimit(RLIMIT_NOFILE, &before_), 0);
    limit_to(limit);
  }
  void TearDown() override { ::setrlimit(RLIMIT_NOFILE, &before_); }
  void limit_to(rlim_t count) {
    const rlimit wanted{count, before_.rlim_max};
    ASSERT_EQ(::setrlimit(RLIMIT_NOFILE, &wanted), 0);
  }
  std::size_t take_all(Owner owner, std::vector<Part>& parts) {
    const std::size_t before = parts.size();
    for (Part part = share_.take(owner, 1); part && parts.size() < 2 * limit;
         part = share_.take(owner, 1)) {
      parts.push_back(std::move(part));
    }
    return parts.size() - before;
  }

  static constexpr std::size_t limit = 256;
  rlimit before_{};
  DescriptorShare share_;
};

TEST_F(Share, IsAQuarterForOneUserAndHalfForAll) {
  std::vector<Part> parts;
  EXPECT_EQ(take_all({1, false}, parts), limit / 4);
  EXPECT_FALSE(share_.take({1, false}, 1));
  EXPECT_EQ(take_all({2, false}, parts), limit / 4);
  EXPECT_EQ(take_all({3, false}, parts), 0u) << "half of all is taken";
  // Descriptors for peers of the same user are not counted.
  EXPECT_TRUE(share_.take({4, true}, 2));
  EXPECT_EQ(take_all({4, true}, parts), 2 * limit - limit / 2);
}

TEST_F(Share, AlsoLimitsMappings) {
  const std::uint64_t quarter = read_map_count_max() / 4, region_bytes = 16 * abi::page_bytes;
  MappingShare& mappings = MappingShare::instance();
  const UniqueFd region = make_memfd("region", region_bytes).value();
  const auto peer_of = [&](Owner owner) {
    UniqueFd fd(::fcntl(region.get(), F_DUPFD_CLOEXEC, 0));
    return std::make_unique<Peer>(
        1, 1, owner,
        SparseRegion::make(std::move(fd), region_bytes, Mapping::Access::read).value());
  };
  const auto can_open_one = [&](Owner owner) {
    UniqueFd none;
    return peer_of(owner)->open(abi::page_bytes, abi::page_bytes, none).has_value();
  };
  Part most = mappings.take({1, false}, quarter - 2);
  ASSERT_TRUE(most);
  const auto peer = peer_of({1, false});
  UniqueFd none;
  ASSERT_TRUE(peer->open(abi::page_bytes, abi::page_bytes, none));
  EXPECT_TRUE(peer->open(abi::page_bytes, abi::page_bytes, none))
      << "the same part needs no second mapping";
  EXPECT_FALSE(peer->open(3 * abi::page_bytes, abi::page_bytes, none));
  EXPECT_FALSE(can_open_one({1, false}));
  EXPECT_TRUE(can_open_one({1, true})) << "the same user with this uid has no limit";
  const Part other = mappings.take({2, false}, quarter);
  EXPECT_FALSE(can_open_one({3, false})) << "half of all is taken";
  EXPECT_TRUE(can_open_one({3, true}));
  most = {};
  EXPECT_TRUE(can_open_one({1, false})) << "unmapping returns the share";
}

TEST_F(Share, IsTakenWholeOrNotAtAll) {
  const Part most = share_.take({1, false}, limit / 4 - 1);
  ASSERT_TRUE(most);
  EXPECT_FALSE(share_.take({1, false}, 2));
  EXPECT_TRUE(share_.take({1, false}, 1));
}

TEST_F(Share, ReturnsWhenItsUserCloses) {
  std::vector<Part> parts;
  ASSERT_EQ(take_all({1, false}, parts), limit / 4);
  EXPECT_FALSE(share_.has_more()) << "no peer has closed";
  parts.pop_back();
  EXPECT_FALSE(share_.has_more()) << "one descriptor is too few to report";
  parts.resize(parts.size() / 2);
  EXPECT_TRUE(share_.has_more());
  EXPECT_FALSE(share_.has_more()) << "it is reported once";
  take_all({1, false}, parts);
  EXPECT_EQ(parts.size(), limit / 4);
}

TEST_F(Share, KeepsTheLastDescriptorNumbersFree) {
  std::vector<UniqueFd> taken;
  for (UniqueFd fd(::dup(0)); fd; fd.reset(::dup(0))) taken.push_back(std::move(fd));
  ASSERT_FALSE(can_open(1));
  EXPECT_FALSE(share_.take({1, true}, 1));
  taken.resize(taken.size() - DescriptorShare::left_free + 1);
  EXPECT_FALSE(share_.take({1, true}, 1));
  EXPECT_FALSE(share_.has_more());
  taken.pop_back();
  EXPECT_TRUE(share_.take({1, true}, 1));
  EXPECT_FALSE(share_.has_more()) << "too few for the next peer";
  taken.resize(taken.size() - DescriptorShare::left_free);
  EXPECT_TRUE(share_.has_more());
}

}  // namespace
}  // namespace agnocast
