// SPDX-License-Identifier: Apache-2.0
//
// Goal: a rule about a topic also holds for the memory behind it: a user that may not subscribe to
// one topic of a process gets no memory of that process. Method: rules as values and a registry;
// each request is checked as a process would send it.

#include <daemon/admission/access_control.hpp>
#include <tests/support/registry_scene.hpp>
#include <tests/unit/daemon/admission/users.hpp>

#include <gtest/gtest.h>

#include <optional>
#include <string>
#include <vector>

namespace agnocast::daemon {
namespace {

Principals only(uid_t uid) { return {false, {uid}, {}, {}}; }

class AccessControlTest : public testing::Test {
 protected:
  static PeerIdentity identity(uid_t uid) {
    PeerIdentity who;
    who.uid = uid;
    who.gid = uid;
    return who;
  }
  Result<void> check(uid_t uid, ClientIndex client, Kind kind, const std::string& topic,
                     std::optional<std::uint64_t> domain = {}) {
    CreateRequest request;
    request.domain = domain;
    request.kind = kind;
    request.topic = topic;
    return access.check_endpoint(identity(uid), client, request);
  }
  void publish(ClientIndex client, const std::string& topic) {
    scene.publisher(client, topic);
    scene.registry.set_readers(client, readers_of(rules, 0, topic));
  }

  test::RegistryScene scene;
  // Only alice may read /secret, and /fenced of one domain; bob may publish nothing.
  std::vector<AccessRule> rules{{"/secret", {}, {}, only(alice), 3},
                                {"/fenced", 57, {}, only(alice), 5},
                                {"/**", {}, only(alice), {}, 7}};
  std::string lines;
  Log log{{"agnocastd"},
          LogLevel::debug,
          Log::Format::people,
          [this](std::string_view line) { return lines.append(line), true; },
          [] { return std::uint64_t{0}; }};
  AccessControl access{rules, scene.registry, log};
};

TEST_F(AccessControlTest, NamesTheRuleThatForbids) {
  const ClientIndex client = scene.process(bob);
  EXPECT_TRUE(check(bob, client, Kind::subscription, "/open"));
  const auto reads = check(bob, client, Kind::subscription, "/secret");
  ASSERT_FALSE(reads);
  EXPECT_EQ(reads.error().code, Errc::access_denied);
  EXPECT_NE(std::string(detail_of(reads.error())).find("rule in line 3"), std::string::npos);
  const auto publishes = check(bob, client, Kind::publisher, "/open");
  ASSERT_FALSE(publishes);
  EXPECT_NE(std::string(detail_of(publishes.error())).find("rule in line 7"), std::string::npos);
}

TEST_F(AccessControlTest, ARuleOfADomainHoldsForEndpointsOfThatDomain) {
  const ClientIndex client = scene.process(bob);
  EXPECT_TRUE(check(bob, client, Kind::subscription, "/fenced"));
  EXPECT_TRUE(check(bob, client, Kind::subscription, "/fenced", 0));
  const auto reads = check(bob, client, Kind::subscription, "/fenced", 57);
  ASSERT_FALSE(reads);
  EXPECT_NE(std::string(detail_of(reads.error())).find("rule in line 5"), std::string::npos);
  const ClientIndex other = scene.process(alice);
  publish(other, "/secret");  // with the readers of /fenced in domain 57
  EXPECT_TRUE(check(alice, other, Kind::publisher, "/fenced", 57));
  EXPECT_FALSE(check(alice, other, Kind::publisher, "/fenced"));
}

TEST_F(AccessControlTest, OneHeapHasOneSetOfReaders) {
  const ClientIndex client = scene.process(alice);
  EXPECT_TRUE(check(alice, client, Kind::publisher, "/secret"));
  publish(client, "/secret");
  const auto other = check(alice, client, Kind::publisher, "/open");
  ASSERT_FALSE(other);
  EXPECT_EQ(other.error().code, Errc::readers_differ);
  EXPECT_TRUE(check(alice, client, Kind::publisher, "/secret")) << "the same readers";
}

TEST_F(AccessControlTest, NoUserReadsAProcessThatAlsoPublishesATopicForbiddenToIt) {
  // Only a change of the rules leads to this.
  const ClientIndex client = scene.process(alice);
  publish(client, "/secret");
  publish(client, "/open");
  const ClientIndex reader = scene.process(bob);
  const auto denied = check(bob, reader, Kind::subscription, "/open");
  ASSERT_FALSE(denied);
  EXPECT_EQ(denied.error().code, Errc::access_denied);
  EXPECT_TRUE(check(alice, reader, Kind::subscription, "/open"));
}

TEST_F(AccessControlTest, FindsEndpointsThatTheCurrentRulesForbid) {
  const ClientIndex client = scene.process(bob);
  scene.subscription(client, "/open");
  EXPECT_EQ(access.forbidden_endpoint(client, identity(bob)), "");
  const EndpointRef secret = scene.subscription(client, "/secret");
  EXPECT_NE(access.forbidden_endpoint(client, identity(bob)).find("/secret any more"),
            std::string::npos);
  scene.registry.change_subscription(secret.topic, secret.index, EndpointState::leaving);
  EXPECT_EQ(access.forbidden_endpoint(client, identity(bob)), "") << "it leaves already";
}

TEST_F(AccessControlTest, WarnsWhenTheAllowedReadersDifferFromThoseWithTheMemory) {
  const ClientIndex client = scene.process(alice);
  scene.publisher(client, "/secret");
  scene.registry.set_readers(client, everybody_reads);
  access.warn_of_other_readers(client);
  EXPECT_NE(lines.find("readers have changed"), std::string::npos);
  lines.clear();
  scene.registry.set_readers(client, readers_of(rules, 0, "/secret"));
  access.warn_of_other_readers(client);
  EXPECT_EQ(lines, "");
}

}  // namespace
}  // namespace agnocast::daemon
