// SPDX-License-Identifier: Apache-2.0
//
// Goal: ROS 2 nodes on Fast DDS, the other vendor, and nodes of this host receive and see each
// other, whichever process is killed. Method: fast_peer; peer_test.cpp covers the messages common
// to both vendors.

#include <tests/integration/bridge/interoperability/peer_side.hpp>
#include <tests/support/processes/ctl.hpp>

#include <std_msgs/msg/bool.hpp>

#include <gmock/gmock.h>

#include <set>

namespace agnocast::test {
namespace {

using namespace std::chrono_literals;
using std_msgs::msg::Bool;

TEST_F(Peer, HasRoomForTheBridgesMessagesOfAFixedSize) {
  make("reader r " + dds_topic() + " Bool 10");
  make("writer w " + dds_topic() + "_in Bool 10");
  const auto publisher = create_publisher<Bool>(PlainNode(), topic(), 10);
  const auto subscription = create_subscription<Bool>(PlainNode(), topic() + "_in", 10);
  ASSERT_TRUE(answers("matched r", "1"));
  meet<Kind<Bool, SeeString>>(subscription);
  ASSERT_TRUE(other_.eventually([&] { return publisher->get_linked_subscription_count() == 1; }));
  for (const bool data : {true, false, true}) {
    auto loan = publisher->borrow_loaned_message();
    loan->data = data;
    ASSERT_TRUE(publisher->publish(std::move(loan)));
    EXPECT_EQ(take("r"), data ? "1 " : "0 ");
  }
  std::string said, wanted;
  for (std::uint64_t number = 0; number < 10; ++number) {
    Bool message;
    set_values<SeeString>(number, message);
    wanted += text_of<SeeString>(message);
    ASSERT_EQ(peer_.ask("write w " + std::to_string(number)), "Success");
    const auto got = hear(subscription);
    ASSERT_TRUE(got);
    said += text_of<SeeString>(*got);
  }
  EXPECT_EQ(said, wanted);
  EXPECT_THAT(said, testing::AllOf(testing::HasSubstr("0"), testing::HasSubstr("1")));
}

TEST_F(Peer, ExchangesMessagesOfAMegabyteUnchanged) {
  constexpr std::size_t letters = 1'000'000;
  make("reader r " + dds_topic() + " String 10");
  make("writer w " + dds_topic() + "_in String 10");
  const auto publisher = create_publisher<String>(PlainNode(), topic(), 10);
  const auto subscription = create_subscription<String>(PlainNode(), topic() + "_in", 10);
  ASSERT_TRUE(answers("matched r", "1"));
  // Cyclone DDS treats a message that is in transit, in fragments, at the first heartbeat as
  // history.
  meet<StringKind>(subscription, "letters w 0 " + std::to_string(letters));
  ASSERT_TRUE(other_.eventually([&] { return publisher->get_linked_subscription_count() == 1; }));
  for (std::uint64_t number = 0; number < 5; ++number) {
    const std::string data = letters_of(number, letters);
    auto loan = publisher->borrow_loaned_message();
    loan->data = data;
    ASSERT_TRUE(publisher->publish(std::move(loan)));
    EXPECT_TRUE(take("r") == '"' + data + "\" ") << number;
    ASSERT_EQ(peer_.ask("letters w " + std::to_string(number) + ' ' + std::to_string(letters)),
              "Success");
    const auto got = hear(subscription);
    ASSERT_TRUE(got);
    EXPECT_TRUE(got->data == data) << number;
  }
}

TEST_F(Peer, SeesTheNodesOfThisHostWithTheirEndpoints) {
  make("reader r " + dds_topic() + "_out String 10");
  make("writer w " + dds_topic() + "_in String 10");
  const auto has_node = [&](const std::string& wanted) {
    std::string said;
    EXPECT_TRUE(other_.eventually([&] {
      said = peer_.ask("nodes");
      return (", " + said + ",").find(", " + wanted + ",") != said.npos;
    })) << wanted
        << " is not in " << said;
  };
  {
    const auto publisher = create_publisher<String>(PlainNode(), topic() + "_out", 10);
    const auto subscription = create_subscription<String>(PlainNode(), topic() + "_in", 10);
    has_node("/ns/node <" + dds_topic() + "_in >" + dds_topic() + "_out");
    EXPECT_TRUE(answers("others " + dds_topic() + "_out", "writer " + string_type + " reliable"));
    EXPECT_TRUE(answers("others " + dds_topic() + "_in", "reader " + string_type + " reliable"));
  }
  EXPECT_TRUE(other_.eventually([&] {
    return peer_.ask("nodes").find("/ns/node") == std::string::npos;
  })) << peer_.ask("nodes");
}

TEST_F(Peer, IsShownWithItsNodeByAgnocastCtl) {
  make("writer w " + dds_topic() + " String 10");
  const auto subscription = create_subscription<String>(PlainNode(), topic(), 10);
  ASSERT_TRUE(answers("matched w", "1"));
  const auto ctl = [&] {
    return run_ctl(daemon->socket_path(), {"bridge", "info", topic(), "--json"});
  };
  EXPECT_TRUE(other_.eventually([&] {
    const CtlResult said = ctl();
    if (said.status != 0) return false;
    const auto about = said.json();
    for (const auto& endpoint : about["bridges"][0]["endpoints"])
      if (endpoint["direction"] == "in" && endpoint["node"] == "/fast_peer") return true;
    return false;
  })) << ctl().out
      << ctl().err;
}

/// Messages both ways between this process and a peer, without a loss once matched.
class KilledPeer : public Peer {
 protected:
  void SetUp() override {
    Peer::SetUp();
    start_peer();
  }
  void start_peer() {
    killed_ = std::make_unique<SteeredProcess>(
        std::vector<std::string>{AGNOCAST_TEST_PEER, std::to_string(domain->id()), "no-shm"},
        std::vector<std::string>{});
    EXPECT_EQ(killed_->ask("reader r " + dds_topic() + "_out String 100"), "made");
    EXPECT_EQ(killed_->ask("writer w " + dds_topic() + "_in String 100"), "made");
  }
  /// Waits until messages sent after this call arrive, on both sides.
  void expect_flow(const std::string& after) {
    SCOPED_TRACE(after);
    const std::uint64_t since = number_;
    std::set<std::string> sent;
    bool out = false, in = false;
    EXPECT_TRUE(other_.eventually([&] {
      sent.insert(publish<StringKind>(publisher_, ++number_));
      EXPECT_EQ(killed_->ask("write w " + std::to_string(number_)), "Success");
      for (std::string got; (got = killed_->ask("take r")) != "none";) {
        EXPECT_TRUE(got.starts_with('"')) << got;
        if (got.starts_with('"'))
          out |= sent.contains(got);
        else
          return true;
      }
      while (const auto got = subscription_->take()) in |= sent.contains(text_of<SeeString>(*got));
      return out && in;
    })) << (out ? "" : "nothing goes out; ")
        << (in ? "" : "nothing comes in; ") << "no message goes out; " << since;
  }

  std::unique_ptr<SteeredProcess> killed_;
  Publisher<String>::SharedPtr publisher_ =
      create_publisher<String>(PlainNode(), topic() + "_out", 100);
  Subscription<String>::SharedPtr subscription_ =
      create_subscription<String>(PlainNode(), topic() + "_in", 100);
  std::uint64_t number_ = 0;
};

TEST_F(KilledPeer, ReceivesAndIsReceivedAgainAfterEitherSideWasKilled) {
  expect_flow("the start");
  for (int round = 0; round < 2; ++round) {
    bridge_->kill();
    start_bridge();
    expect_flow("SIGKILL of the bridge");
    killed_->kill();
    start_peer();
    expect_flow("SIGKILL of the peer");
  }
  // Endpoints of dead peers go when their leases end; only those of living ones are left.
  EXPECT_TRUE(other_.eventually([&] {
    return killed_->ask("matched r") == "1" && killed_->ask("matched w") == "1" &&
           publisher_->get_linked_subscription_count() == 1 &&
           subscription_->get_linked_publisher_count() == 1;
  })) << killed_->ask("matched r")
      << " no message comes in; " << killed_->ask("matched w") << " readers";
}

}  // namespace
}  // namespace agnocast::test
