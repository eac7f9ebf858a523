// SPDX-License-Identifier: Apache-2.0
//
// Goal: one user gets what its quotas allow and no more, a refusal names the quota and its value,
// and no user's quota depends on the use by another one. Method: the daemon's core with small
// quotas; each request is checked before it is carried out.

#include <daemon/admission/admission.hpp>
#include <tests/support/processes/daemon_core.hpp>
#include <tests/unit/daemon/admission/users.hpp>

#include <gtest/gtest.h>

#include <string>

namespace agnocast::daemon {
namespace {

class AdmissionTest : public testing::Test {
 protected:
  AdmissionTest() {
    config.quota.clients = 2;
    config.quota.publishers = 2;
    config.quota.topics = 2;
    config.quota.wait_sets = 2;
    config.quota.publishers_per_topic = 1;
    config.limits.depth_max = 10;
    config.heap.windows_per_process = 1;
  }
  Result<void> endpoint(ClientIndex client, Kind kind, const std::string& topic,
                        std::uint32_t depth = 1) {
    PeerIdentity who;
    who.uid = core.registry.client(client).uid;
    CreateRequest request;
    request.kind = kind;
    request.topic = topic;
    request.qos.depth = depth;
    request.quota = 1;
    return admission.admit_endpoint(who, client, request);
  }

  test::DaemonCore core;
  Config config;
  Arena arena{std::uint64_t{1} << 45, 16 << 20, 2 << 20};
  AddressPlan plan{arena};
  Log log{{"agnocastd"},
          LogLevel::error,
          Log::Format::people,
          [](std::string_view) { return true; },
          [] { return std::uint64_t{0}; }};
  AccessControl access{config.access, core.registry, log};
  Admission admission{config,     arena, plan, core.registry, core.endpoint_manager,
                      core.store, access};
};

TEST_F(AdmissionTest, CountsTheProcessesOfEachUserSeparately) {
  EXPECT_TRUE(admission.admit_client(alice, false));
  core.process(alice);
  core.process(alice);
  const auto refused = admission.admit_client(alice, false);
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, Errc::quota_exceeded);
  EXPECT_EQ(admission.exceeded().limit, "[quota] clients");
  EXPECT_EQ(admission.exceeded().used, 2u);
  admission.begin_request();
  EXPECT_TRUE(admission.admit_client(bob, false));
  EXPECT_EQ(admission.exceeded().limit, "") << "the result of the previous request is cleared";
  EXPECT_FALSE(admission.admit_client(bob, true)) << "its connection was accepted only to observe";
}

TEST_F(AdmissionTest, NamesTheQuotaThatARequestExceeds) {
  const ClientIndex client = core.process(alice);
  core.create(client, Kind::publisher, "/a");
  const auto same_topic = endpoint(client, Kind::publisher, "/a");
  ASSERT_FALSE(same_topic);
  EXPECT_EQ(admission.exceeded().limit, "[quota] publishers_per_topic");
  core.create(client, Kind::publisher, "/b");
  EXPECT_FALSE(endpoint(client, Kind::subscription, "/c"));
  EXPECT_EQ(admission.exceeded().limit, "[quota] topics");
  EXPECT_TRUE(endpoint(client, Kind::subscription, "/b"));
  EXPECT_FALSE(endpoint(client, Kind::publisher, "/b"));
  EXPECT_EQ(admission.exceeded().limit, "[quota] publishers");
  EXPECT_TRUE(endpoint(core.process(bob), Kind::publisher, "/b")) << "another user's quota";
}

TEST_F(AdmissionTest, RefusesADepthThatNoPublisherMayHave) {
  const ClientIndex client = core.process(alice);
  EXPECT_TRUE(endpoint(client, Kind::publisher, "/a", 10));
  const auto refused = endpoint(client, Kind::publisher, "/a", 11);
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, Errc::depth_refused);
}

TEST_F(AdmissionTest, CountsGonePublishersOfAUserUntilTheyAreRead) {
  const ClientIndex owner = core.process(alice), reader = core.process(bob);
  core.create(reader, Kind::subscription, "/a");
  core.create(owner, Kind::publisher, "/a");
  core.end(owner);
  const auto refused = endpoint(core.process(alice), Kind::publisher, "/a");
  ASSERT_FALSE(refused);
  EXPECT_NE(std::string(detail_of(refused.error())).find("has not unmapped 1"), std::string::npos)
      << "the process that keeps it is named: " << detail_of(refused.error());
}

TEST_F(AdmissionTest, BoundsTheWindowsOfAProcessAndTheAddressesOfAUser) {
  const ClientIndex first = core.process(alice);
  EXPECT_TRUE(admission.admit_window(core.registry.client(first)));
  core.registry.open_window(first, {arena.base, arena.window_bytes, 0});
  const auto refused = admission.admit_window(core.registry.client(first));
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, Errc::window_exhausted);
  config.quota.heap_bytes = arena.window_bytes;
  const auto over = admission.admit_window(core.registry.client(core.process(alice)));
  ASSERT_FALSE(over);
  EXPECT_EQ(over.error().code, Errc::quota_exceeded);
  EXPECT_EQ(admission.exceeded().limit, "[quota] heap_bytes");
  EXPECT_TRUE(admission.admit_window(core.registry.client(core.process(bob))));
}

TEST_F(AdmissionTest, LeavesAQuarterToOtherUsersWithoutAConfiguredQuota) {
  config.quota.publishers_per_topic = 0;
  config.limits.publishers_per_topic = 100;
  EXPECT_EQ(admission.places_quota(Kind::publisher), 75u);
  config.limits.publishers_per_topic = 1;
  EXPECT_EQ(admission.places_quota(Kind::publisher), unlimited) << "too little to be divided";
  EXPECT_EQ(admission.heap_quota(), 6 * arena.window_bytes);
}

}  // namespace
}  // namespace agnocast::daemon
