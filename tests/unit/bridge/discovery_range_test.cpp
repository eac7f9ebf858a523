// SPDX-License-Identifier: Apache-2.0
//
// Goal: the bridge looks for others as far as ROS 2's variables say. Method: the configuration for
// each value, and whether Cyclone DDS accepts it.

#include <bridge/dds/discovery_range.hpp>
#include <bridge/dds/participant.hpp>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdlib>
#include <map>
#include <string>

namespace agnocast::bridge {
namespace {

using testing::HasSubstr;
using testing::Not;
using Variables = std::map<std::string, std::string>;

auto range_of(const Variables& set) {
  return discovery_range([&](const char* name) {
    const auto found = set.find(name);
    return found != set.end() ? found->second : std::string();
  });
}

void expect_accepted(const std::string& configuration) {
  ::setenv("CYCLONEDDS_URI", configuration.c_str(), 1);
  EXPECT_EQ(fault_in_dds_configuration(97), "") << configuration;
  ::unsetenv("CYCLONEDDS_URI");
}

TEST(DiscoveryRange, ChangesNothingUnlessAskedTo) {
  for (const Variables& set : {Variables{}, Variables{{"ROS_LOCALHOST_ONLY", "0"}},
                               Variables{{"ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET"}},
                               Variables{{"ROS_AUTOMATIC_DISCOVERY_RANGE", "SYSTEM_DEFAULT"}},
                               Variables{{"ROS_AUTOMATIC_DISCOVERY_RANGE", "SYSTEM_DEFAULT"},
                                         {"ROS_STATIC_PEERS", "a"}}}) {
    const auto range = range_of(set);
    ASSERT_TRUE(range);
    EXPECT_EQ(range->configuration, "");
    EXPECT_EQ(range->reason, "");
  }
}

TEST(DiscoveryRange, UsesTheLoopbackDeviceAloneForHumblesVariable) {
  for (const char* const distribution : {"", "foxy", "galactic", "humble"}) {
    const auto range = range_of({{"ROS_LOCALHOST_ONLY", "1"}, {"ROS_DISTRO", distribution}});
    ASSERT_TRUE(range);
    EXPECT_THAT(range->configuration, HasSubstr("<NetworkInterface address=\"127.0.0.1\"/>"));
    EXPECT_EQ(range->reason, "ROS_LOCALHOST_ONLY=1");
    expect_accepted(range->configuration);
  }
}

TEST(DiscoveryRange, SearchesThisHostForNewerDistributions) {
  for (const Variables& set : {Variables{{"ROS_LOCALHOST_ONLY", "1"}, {"ROS_DISTRO", "jazzy"}},
                               Variables{{"ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST"}},
                               // The older variable wins.
                               Variables{{"ROS_LOCALHOST_ONLY", "1"},
                                         {"ROS_DISTRO", "kilted"},
                                         {"ROS_STATIC_PEERS", "10.0.0.9"},
                                         {"ROS_AUTOMATIC_DISCOVERY_RANGE", "OFF"}}}) {
    const auto range = range_of(set);
    ASSERT_TRUE(range);
    EXPECT_THAT(range->configuration, HasSubstr("<AllowMulticast>false</AllowMulticast>"));
    EXPECT_THAT(range->configuration, HasSubstr("<Peers><Peer address=\"localhost\"/></Peers>"));
    EXPECT_NE(range->reason, "");
    expect_accepted(range->configuration);
  }
}

TEST(DiscoveryRange, NamesPeersOfOtherSubnets) {
  const auto range = range_of({{"ROS_STATIC_PEERS", "192.168.7.1;;robot-2.local;fe80::1"}});
  ASSERT_TRUE(range);
  EXPECT_THAT(range->configuration,
              HasSubstr("<Peers><Peer address=\"192.168.7.1\"/><Peer address=\"robot-2.local\"/>"
                        "<Peer address=\"fe80::1\"/></Peers>"));
  EXPECT_THAT(range->configuration, Not(HasSubstr("AllowMulticast")));
  EXPECT_EQ(range->reason, "");  // nothing is limited
}

TEST(DiscoveryRange, IsFoundByNobodyWhenOff) {
  const auto range =
      range_of({{"ROS_AUTOMATIC_DISCOVERY_RANGE", "OFF"}, {"ROS_STATIC_PEERS", "192.168.7.1"}});
  ASSERT_TRUE(range);
  EXPECT_THAT(range->configuration, HasSubstr("<Tag>"));
  EXPECT_THAT(range->configuration, Not(HasSubstr("Peer")));
  expect_accepted(range->configuration);
}

TEST(DiscoveryRange, RefusesWhatItDoesNotKnow) {
  const auto range = range_of({{"ROS_AUTOMATIC_DISCOVERY_RANGE", "localhost"}});
  ASSERT_FALSE(range);
  EXPECT_EQ(range.error().variable, "ROS_AUTOMATIC_DISCOVERY_RANGE");
  for (const char* const peer : {"a\"/><Peer address=\"b", "a b", "<", "a&b"}) {
    const auto peers = range_of({{"ROS_STATIC_PEERS", peer}});
    ASSERT_FALSE(peers) << peer;
    EXPECT_EQ(peers.error().variable, "ROS_STATIC_PEERS");
  }
}

}  // namespace
}  // namespace agnocast::bridge
