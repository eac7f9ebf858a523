// SPDX-License-Identifier: Apache-2.0
//
// Goal: regions within the kernel's limits. The integration tests cover which regions are handed
// out and to which processes; these are the cases that they cannot produce.

#include <daemon/lifecycle/regions.hpp>

#include <gtest/gtest.h>

namespace agnocast::daemon {
namespace {

TEST(Regions, LeaveMappingsForTheDaemonItself) {
  EXPECT_GE(Regions::regions_max(65'530), std::uint64_t{abi::client_count_max});
  EXPECT_EQ(Regions::regions_max(0), 0u);
  EXPECT_EQ(Regions::regions_max(2048), 0u);
  EXPECT_EQ(Regions::regions_max(2049), 1u);
}

}  // namespace
}  // namespace agnocast::daemon
