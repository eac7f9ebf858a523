// SPDX-License-Identifier: Apache-2.0
//
// Goal: a server on another host answers a client as if there were no bridges between, never twice
// and never in a loop; and whatever dies or is unplugged, each request ends, and later ones are
// answered. Method: that of hosts_test.cpp.

#include <tests/integration/bridge/hosts/hosts.hpp>

#include <gmock/gmock.h>

namespace agnocast::test {
namespace {

using namespace std::chrono_literals;

/// Returns local_peer's sums, and "failed" for requests that ended without one.
std::vector<std::string> ended(SteeredProcess& process, const std::string& client) {
  std::vector<std::string> list;
  std::istringstream words(process.ask("ended " + client));
  for (std::string word; words >> word;) list.push_back(word);
  return list;
}
bool is_ready(SteeredProcess& process, const std::string& client) {
  return eventually_s([&] { return process.ask("ready " + client) == "yes"; });
}
/// Sends one request after the other.
void expect_answers(SteeredProcess& process, const std::string& client, int count, int add) {
  for (int i = 0; i < count; ++i) {
    ASSERT_EQ(process.ask("call " + client + ' ' + std::to_string(i) + " 10"), "sent");
    std::vector<std::string> got;
    ASSERT_TRUE(eventually_s([&] {
      got = ended(process, client);
      return !got.empty();
    })) << "request "
        << i;
    EXPECT_THAT(got, testing::ElementsAre(std::to_string(i + 10 + add)));
  }
}

TEST_F(Hosts, AnswerClientsOfTheOtherHostOnceEach) {
  TwoHosts hosts;
  hosts.left.start_bridge();
  hosts.right.start_bridge();
  const auto left = hosts.left.process(), right = hosts.right.process();
  ASSERT_EQ(left->ask("serve s /of_left 1000"), "made");
  ASSERT_EQ(right->ask("serve s /of_right 2000"), "made");
  ASSERT_EQ(left->ask("client c /of_right"), "made");
  ASSERT_EQ(right->ask("client c /of_left"), "made");
  ASSERT_TRUE(is_ready(*left, "c") && is_ready(*right, "c"));
  expect_answers(*left, "c", 30, 2000);
  expect_answers(*right, "c", 30, 1000);
  EXPECT_EQ(left->ask("served s"), "30");
  EXPECT_EQ(right->ask("served s"), "30");
  // Many under way at once.
  for (int i = 0; i < 8; ++i) ASSERT_EQ(left->ask("call c " + std::to_string(i) + " 0"), "sent");
  std::vector<std::string> got;
  ASSERT_TRUE(eventually_s([&] {
    const auto more = ended(*left, "c");
    got.insert(got.end(), more.begin(), more.end());
    return got.size() == 8;
  }));
  EXPECT_THAT(got, testing::UnorderedElementsAre("2000", "2001", "2002", "2003", "2004", "2005",
                                                 "2006", "2007"));
  expect_sound(hosts.left);
  expect_sound(hosts.right);
}

TEST_F(Hosts, LeaveRequestsToTheLocalServerWhereBothHaveOne) {
  TwoHosts hosts;
  hosts.left.start_bridge();
  hosts.right.start_bridge();
  const auto left = hosts.left.process(), right = hosts.right.process();
  ASSERT_EQ(left->ask("serve s /both 1000"), "made");
  ASSERT_EQ(right->ask("serve s /both 2000"), "made");
  // Shows that the bridges have met.
  ASSERT_EQ(right->ask("serve met /met 0"), "made");
  ASSERT_EQ(left->ask("client met /met"), "made");
  ASSERT_EQ(left->ask("client c /both"), "made");
  ASSERT_EQ(right->ask("client c /both"), "made");
  ASSERT_TRUE(is_ready(*left, "met") && is_ready(*left, "c") && is_ready(*right, "c"));
  expect_answers(*left, "c", 30, 1000);
  expect_answers(*right, "c", 30, 2000);
  // Looping requests would still be arriving while these are answered.
  expect_answers(*left, "met", 30, 0);
  EXPECT_EQ(left->ask("served s"), "30");
  EXPECT_EQ(right->ask("served s"), "30");
}

/// A client on the left, a server on the right.
struct Asked {
  Asked() {
    hosts.left.start_bridge();
    hosts.right.start_bridge();
    client = hosts.left.process();
    server = hosts.right.process();
    EXPECT_EQ(server->ask("serve s /asked 0"), "made");
    EXPECT_EQ(client->ask("client c /asked"), "made");
    EXPECT_TRUE(is_ready(*client, "c"));
    expect_answers(*client, "c", 5, 0);
  }
  /// Sends some of them; others find no server.
  void ask_some() {
    for (int i = 0; i < 5; ++i) (void)client->ask("call c 1 2");
  }
  void expect_that_all_have_ended() {
    EXPECT_TRUE(eventually_s([&] {
      for (const std::string& sum : ended(*client, "c"))
        EXPECT_THAT(sum, testing::AnyOf("3", "failed"));
      return client->ask("pending c") == "0";
    })) << client->ask("pending c")
        << " requests have not ended";
  }

  TwoHosts hosts{"1 s"};
  std::unique_ptr<SteeredProcess> client, server;
};

TEST_F(Hosts, EndEachRequestWhenTheBridgeOfTheServerIsKilledAndAnswerLaterOnes) {
  Asked asked;
  for (int round = 0; round < 2; ++round) {
    SCOPED_TRACE(round);
    asked.ask_some();
    asked.hosts.right.bridge().kill();
    asked.ask_some();
    asked.expect_that_all_have_ended();
    asked.hosts.right.start_bridge();
    ASSERT_TRUE(is_ready(*asked.client, "c"));
    expect_answers(*asked.client, "c", 5, 0);
  }
}

TEST_F(Hosts, EndEachRequestWhenTheBridgeOfTheServerIsReplacedAtOnce) {
  Asked asked;
  asked.ask_some();
  asked.hosts.right.bridge().kill();
  asked.ask_some();
  asked.hosts.right.start_bridge();
  asked.expect_that_all_have_ended();
  ASSERT_TRUE(is_ready(*asked.client, "c"));
  expect_answers(*asked.client, "c", 5, 0);
}

TEST_F(Hosts, EndEachRequestWhenTheBridgeOfTheClientIsKilledAndAnswerLaterOnes) {
  Asked asked;
  for (int round = 0; round < 2; ++round) {
    SCOPED_TRACE(round);
    asked.ask_some();
    asked.hosts.left.bridge().kill();
    asked.ask_some();
    asked.expect_that_all_have_ended();
    asked.hosts.left.start_bridge();
    ASSERT_TRUE(is_ready(*asked.client, "c"));
    expect_answers(*asked.client, "c", 5, 0);
  }
}

TEST_F(Hosts, EndEachRequestWhenTheNetworkIsGoneAndAnswerLaterOnes) {
  Asked asked;
  for (int round = 0; round < 2; ++round) {
    SCOPED_TRACE(round);
    asked.hosts.unplug();
    asked.ask_some();
    asked.expect_that_all_have_ended();
    asked.hosts.plug();
    ASSERT_TRUE(is_ready(*asked.client, "c"));
    expect_answers(*asked.client, "c", 5, 0);
  }
}

}  // namespace
}  // namespace agnocast::test
