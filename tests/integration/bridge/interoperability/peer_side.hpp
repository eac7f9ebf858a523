// SPDX-License-Identifier: Apache-2.0
//
// Fixture for tests with a DDS participant that has none of our code: plain_peer or fast_peer,
// which take the same commands, and messages that both sides derive from a number and print as
// text.
#pragma once

#include <tests/integration/bridge/programs/values.hpp>
#include <tests/integration/bridge/routes/bridge_side.hpp>
#include <tests/support/processes/plain_node.hpp>

#include <agnocast/agnocast.hpp>

#include <sensor_msgs/msg/point_cloud2.hpp>
#include <std_msgs/msg/string.hpp>
#include <visualization_msgs/msg/marker_array.hpp>

namespace agnocast::test {

using std_msgs::msg::String;

inline const std::string string_type = "std_msgs::msg::dds_::String_";

template <class Message, class SeeType>
struct Kind {
  using M = Message;
  using See = SeeType;
};
using StringKind = Kind<String, SeeString>;
using CloudKind = Kind<sensor_msgs::msg::PointCloud2, SeeCloud>;
using MarkersKind = Kind<visualization_msgs::msg::MarkerArray, SeeMarkers>;

template <class K>
inline constexpr const char* peer_name = "String";
template <>
inline constexpr const char* peer_name<CloudKind> = "Cloud";
template <>
inline constexpr const char* peer_name<MarkersKind> = "Markers";

/// AGNOCAST_TEST_PEER is the program.
class Peer : public BridgeTest {
 protected:
  void TearDown() override {
    // Ends by itself: Fast DDS leaves its shared memory behind when killed.
    EXPECT_EQ(peer_.finish(), 0);
    BridgeTest::TearDown();
  }
  void make(const std::string& line) { ASSERT_EQ(peer_.ask(line), "made") << line; }
  bool answers(const std::string& line, const std::string& wanted) {
    return other_.eventually([&] { return peer_.ask(line) == wanted; });
  }
  std::string take(const std::string& reader) {
    std::string text = "none";
    (void)other_.eventually([&] { return (text = peer_.ask("take " + reader)) != "none"; });
    return text;
  }
  /// Fast DDS repeats lost messages after 3 s.
  template <class Subscription>
  auto hear(const Subscription& subscription) {
    auto message = subscription->take();
    (void)other_.eventually([&] { return message || (message = subscription->take()); });
    return message;
  }
  /// Waits until writes of "w" arrive, such as `probe`: its side knowing the reader does not mean
  /// that the reader's side knows it.
  template <class K, class Subscription>
  void meet(const Subscription& subscription, const std::string& probe = "write w 1000000") {
    constexpr std::uint64_t last = 1'000'001;
    ASSERT_TRUE(answers("matched w", "1"));
    ASSERT_TRUE(other_.eventually([&] {
      EXPECT_EQ(peer_.ask(probe), "Success");
      return bool(subscription->take());
    }));
    EXPECT_EQ(peer_.ask("write w " + std::to_string(last)), "Success");
    for (;;) {
      const auto got = hear(subscription);
      ASSERT_TRUE(got);
      if (text_of<typename K::See>(*got) == text_of_number<K>(last)) return;
    }
  }
  template <class K, class Publisher>
  static std::string publish(const Publisher& publisher, std::uint64_t number) {
    auto loan = publisher->borrow_loaned_message();
    set_values<typename K::See>(number, *loan);
    const std::string text = text_of<typename K::See>(*loan);
    EXPECT_TRUE(publisher->publish(std::move(loan)));
    return text;
  }
  template <class K>
  static std::string text_of_number(std::uint64_t number) {
    typename K::M message;
    set_values<typename K::See>(number, message);
    return text_of<typename K::See>(message);
  }

  SteeredProcess peer_{{AGNOCAST_TEST_PEER, std::to_string(domain->id())}, {}};
};

}  // namespace agnocast::test
