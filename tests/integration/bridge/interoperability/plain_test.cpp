// SPDX-License-Identifier: Apache-2.0
//
// Goal: the bridge's endpoints, in DDS and here, have the QoS of those that they stand for, as
// participants of Cyclone DDS announce and see it. Method: plain_peer; peer_test.cpp checks that
// messages follow these QoS.

#include <tests/integration/bridge/interoperability/peer_side.hpp>

#include <agnocast/graph.hpp>
#include <bridge/plan/routes.hpp>

#include <gmock/gmock.h>

namespace agnocast::test {
namespace {

using namespace std::chrono_literals;

struct Offer {
  const char* words;  // as plain_peer writes them
  QoS qos;
};
const std::vector<Offer>& offers() {
  static const std::vector<Offer> list = {
      {"best 5", QoS(5).best_effort()},
      {"best transient 2", QoS(2).best_effort().transient_local()},
      {"reliable 7", QoS(7)},
      {"reliable transient 3", QoS(3).transient_local()},
      {"reliable 1000", QoS(1000)},
      {"reliable all", QoS(1).keep_all(100)}};
  return list;
}

TEST_F(Peer, SeesWritersWithTheQosOfThePublishersAndNothingMore) {
  make("reader r " + dds_topic() + " String best 1");
  for (const Offer& offer : offers()) {
    SCOPED_TRACE(offer.words);
    const auto publisher = create_publisher<String>(PlainNode(), topic(), offer.qos);
    const std::string wanted = "writer " + string_type + " " + offer.words;
    EXPECT_TRUE(answers("others " + dds_topic(), wanted)) << peer_.ask("others " + dds_topic());
  }
  EXPECT_TRUE(answers("others " + dds_topic(), ""));
}

TEST_F(Peer, SeesReadersWithTheQosOfTheSubscriptions) {
  const auto sees_only = [&](const std::string& wanted) {
    std::string said;
    EXPECT_TRUE(other_.eventually([&] {
      said = peer_.ask("others " + dds_topic());
      return said.starts_with("reader " + string_type + " " + wanted) &&
             said.find(',') == said.npos && said.find("said") == said.npos;
    })) << said;
  };
  make("writer w " + dds_topic() + " String reliable transient 1");
  for (const Offer& offer : offers()) {
    SCOPED_TRACE(offer.words);
    const std::string words = offer.words;
    const auto subscription = create_subscription<String>(PlainNode(), topic(), offer.qos);
    sees_only(words.substr(0, words.rfind(' ')) + " ");
  }
  EXPECT_TRUE(answers("others " + dds_topic(), ""));
}

TEST_F(Peer, HasAPublisherHereWithTheQosOfItsWriter) {
  const auto subscription = create_subscription<String>(PlainNode(), topic(), QoS(4).best_effort());
  Graph graph;
  for (const Offer& offer : offers()) {
    if (offer.qos.is_keep_all()) continue;  // has no depth in DDS
    SCOPED_TRACE(offer.words);
    make("writer w " + dds_topic() + " String " + offer.words);
    std::vector<QoS> seen;
    EXPECT_TRUE(other_.eventually([&] {
      const auto now = graph.wait(100ms);
      if (!now || !*now) return false;
      seen.clear();
      for (const EndpointInfo& endpoint : (*now)->endpoints) {
        if (bridge::is_bridge(endpoint) && endpoint.topic == topic()) seen.push_back(endpoint.qos);
      }
      return seen.size() == 1 && seen[0].is_reliable() == offer.qos.is_reliable() &&
             seen[0].is_transient_local() == offer.qos.is_transient_local() &&
             seen[0].depth() == offer.qos.depth();
    }));
    EXPECT_EQ(peer_.ask("delete w"), "gone");
  }
}

// Not so with Fast DDS: its readers accept history that Cyclone DDS's writers repeat for others,
// also without a bridge.
TEST_F(Peer, ReceivesNoHistoryThatItDoesNotRequest) {
  const auto publisher = create_publisher<String>(PlainNode(), topic(), QoS(3).transient_local());
  make("reader early " + dds_topic() + " String transient 10");
  ASSERT_TRUE(answers("matched early", "1"));
  for (std::uint64_t i = 0; i < 5; ++i) {
    const std::string published = publish<StringKind>(publisher, i);
    EXPECT_EQ(take("early"), published);
  }
  make("reader fresh " + dds_topic() + " String 10");
  ASSERT_TRUE(answers("matched fresh", "1"));
  const std::string newest = publish<StringKind>(publisher, 5);
  EXPECT_EQ(take("fresh"), newest);
}

TEST_F(Peer, LosesNoMessageToASlowKeepAllSubscriptionHere) {
  // The most that may wait in the bridge, docs/bridge.md.
  constexpr std::uint64_t count = 1'000;
  make("writer w " + dds_topic() + " String all");
  const auto subscription = create_subscription<String>(PlainNode(), topic(), QoS(1).keep_all(5));
  meet<StringKind>(subscription);
  for (std::uint64_t number = 0; number < count; ++number)
    ASSERT_EQ(peer_.ask("write w " + std::to_string(number)), "Success");
  for (std::uint64_t number = 0; number < count; ++number) {
    const auto got = hear(subscription);
    ASSERT_TRUE(got) << number;
    ASSERT_EQ(text_of<SeeString>(*got), text_of_number<StringKind>(number));
  }
}

}  // namespace
}  // namespace agnocast::test
