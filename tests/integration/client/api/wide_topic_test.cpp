// SPDX-License-Identifier: Apache-2.0
//
// Goal: a topic that the configuration names serves publishers of every link block, whether its
// subscriptions were there before them or came later, in this process and in another, also behind a
// new daemon; any other topic refuses the first publisher beyond one block, and says what to do.
// Method: hundreds of publishers in this process, with the real daemon and the real heap hook.

#include <agnocast/abi/limits.hpp>
#include <agnocast/agnocast.hpp>
#include <tests/integration/client/programs/second_process.hpp>
#include <tests/support/processes/ctl.hpp>
#include <tests/support/processes/daemon_process.hpp>
#include <tests/support/processes/plain_node.hpp>
#include <tests/support/processes/suite_daemon.hpp>

#include <gmock/gmock.h>

#include <cstdint>
#include <numeric>
#include <string>
#include <utility>
#include <vector>

namespace agnocast {
namespace {

using test::eventually;
using test::Number;
using test::PlainNode;

// Three link blocks, the last of them not full.
constexpr std::uint64_t publisher_count = 2 * abi::link_block_count + 90;

class WideTopic : public test::SuiteDaemon {
 protected:
  static void SetUpTestSuite() {
    start({.more_config = "[limits]\nwide_topics = [\"/wide\"]\n[quota]\npublishers_per_topic = "
                          "\"unlimited\"\n"});
  }

  static Publisher<Number>::SharedPtr publisher(const std::string& topic) {
    return create_publisher<Number>(PlainNode{}, topic, QoS(1));
  }
  /// Lets each publisher publish its number.
  void publish() {
    for (std::size_t i = 0; i < publishers.size(); ++i) {
      auto loan = publishers[i]->borrow_loaned_message();
      loan->value = i;
      EXPECT_TRUE(publishers[i]->publish(std::move(loan)));
    }
  }
  /// Takes as many messages as there are publishers, and returns them sorted.
  std::vector<std::uint64_t> taken(Subscription<Number>& subscription) {
    std::vector<std::uint64_t> values;
    EXPECT_TRUE(eventually([&] {
      while (const auto message = subscription.take()) values.push_back(message->value);
      return values.size() >= publishers.size();
    }));
    std::sort(values.begin(), values.end());
    return values;
  }
  /// Returns how many publishers the topic may have, as agnocast-ctl says.
  static std::uint64_t room_of(const std::string& topic) {
    const auto info = test::run_ctl(daemon->socket_path(), {"topic", "info", topic, "-j"});
    return info.json().value("publisher_count_max", std::uint64_t{0});
  }
  void expect_intact() const {
    const test::CtlResult verify = test::run_ctl(daemon->socket_path(), {"verify"});
    EXPECT_EQ(verify.status, 0) << verify.out << verify.err;
  }

  std::vector<Publisher<Number>::SharedPtr> publishers;
};

TEST_F(WideTopic, ServesPublishersOfEveryLinkBlock) {
  const auto earlier = create_subscription<Number>(PlainNode{}, "/wide", QoS(1000));
  test::SecondProcess elsewhere({"subscribe", "/wide", "1000rv"});
  while (publishers.size() < publisher_count) publishers.push_back(publisher("/wide"));
  const auto later = create_subscription<Number>(PlainNode{}, "/wide", QoS(1000));
  std::vector<std::uint64_t> all(publisher_count);
  std::iota(all.begin(), all.end(), 0);
  EXPECT_EQ(earlier->get_publisher_count(), publisher_count);
  EXPECT_EQ(room_of("/wide"), std::uint64_t{abi::publisher_count_max});
  publish();
  EXPECT_TRUE(eventually([&] { return earlier->get_arrivals().count == publisher_count; }));
  EXPECT_EQ(taken(*earlier), all);
  EXPECT_EQ(earlier->get_arrivals().unread, 0u);
  EXPECT_EQ(taken(*later), all);
  for (const auto& one : publishers)
    ASSERT_TRUE(eventually([&] { return one->get_linked_subscription_count() == 3; }));
  expect_intact();

  const pid_t before = daemon->kill_worker();
  ASSERT_TRUE(daemon->wait_for_next(before));
  publishers.push_back(publisher("/wide"));
  all.push_back(publisher_count);
  publish();
  EXPECT_EQ(taken(*earlier), all);
  EXPECT_EQ(taken(*later), all);
  expect_intact();

  elsewhere.kill();
  for (const auto& one : publishers)
    ASSERT_TRUE(eventually([&] { return one->get_subscription_count() == 2; }));
  publishers.erase(publishers.begin(), publishers.begin() + abi::link_block_count);
  EXPECT_TRUE(eventually([&] { return later->get_publisher_count() == publishers.size(); }));
  expect_intact();
}

TEST_F(WideTopic, AnotherTopicRefusesTheFirstPublisherBeyondOneBlock) {
  while (publishers.size() < abi::link_block_count) publishers.push_back(publisher("/narrow"));
  EXPECT_EQ(room_of("/narrow"), std::uint64_t{abi::link_block_count});
  const auto refused = try_create_publisher<Number>(PlainNode{}, "/narrow", QoS(1));
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, Errc::limit_reached);
  EXPECT_THAT(detail_of(refused.error()),
              testing::HasSubstr("256 publishers, as many as one that began without"));
}

}  // namespace
}  // namespace agnocast
