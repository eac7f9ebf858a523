// SPDX-License-Identifier: Apache-2.0
//
// Goal: regions and the kernel's limits. What is handed out of them, and to whom, is in the
// integration tests; here is what those cannot bring about.

#include <daemon/lifecycle/regions.hpp>

#include <gtest/gtest.h>

namespace agnocast::daemon {
namespace {

TEST(Regions, LeaveTheDaemonMappingsOfItsOwn) {
  EXPECT_GE(Regions::regions_max(65'530), std::uint64_t{abi::client_count_max});
  EXPECT_EQ(Regions::regions_max(0), 0u);
  EXPECT_EQ(Regions::regions_max(2048), 0u);
  EXPECT_EQ(Regions::regions_max(2049), 1u);
}

}  // namespace
}  // namespace agnocast::daemon
