// SPDX-License-Identifier: Apache-2.0
//
// Goal: another configuration, by SIGHUP, loses no history and delivers none twice. Method: rules
// that change the durability of endpoints in DDS while both sides live.

#include <tests/integration/bridge/routes/bridge_side.hpp>
#include <tests/support/processes/plain_node.hpp>

#include <agnocast/agnocast.hpp>

#include <std_msgs/msg/string.hpp>

#include <signal.h>

#include <algorithm>
#include <fstream>
#include <string>

namespace agnocast::test {
namespace {

using std_msgs::msg::String;

class Reload : public BridgeTest {
 protected:
  void SetUp() override {}
  static std::string file() { return daemon->directory() + "/reload.toml"; }
  void configure(const std::string& qos) const {
    std::ofstream(file()) << "[[topic]]\nname = \"" + topic() + "\"\n" + qos + '\n';
  }
  void configure_again(const std::string& qos) const {
    configure(qos);
    ASSERT_EQ(::kill(bridge_->pid(), SIGHUP), 0);
  }
  static DdsQos history() {
    DdsQos qos;
    qos.depth = 10;
    qos.transient_local = true;
    return qos;
  }
  /// Returns whether the bridge's endpoint offers or requests a history, and is the only one.
  bool is_latched(Remote::Kind kind) {
    std::size_t count = 0, latched = 0;
    for (const auto& [guid, remote] : other_.participant().remotes()) {
      if (remote.topic != dds_topic() || remote.kind != kind) continue;
      ++count;
      latched += remote.qos.transient_local;
    }
    return count == 1 && latched == 1;
  }
};

TEST_F(Reload, HandsTheHistoryToARecreatedWriter) {
  configure("to_dds = { durability = \"volatile\" }");
  start_bridge({"--config", file()});
  DdsReader& early = other_.reads<String>(dds_topic(), {});
  auto publisher = create_publisher<String>(PlainNode(), topic(), QoS(3).transient_local());
  ASSERT_TRUE(other_.eventually([&] { return is_out(early, *publisher); }));
  for (const char* const data : {"1", "2", "3"}) {
    auto loan = publisher->borrow_loaned_message();
    loan->data = data;
    ASSERT_TRUE(publisher->publish(std::move(loan)));
    const auto got = other_.take<String>(early);
    ASSERT_NE(got, nullptr);
    EXPECT_EQ(got->data, data);
  }
  configure_again("");
  ASSERT_TRUE(other_.eventually([&] { return is_latched(Remote::Kind::writer); }));
  DdsReader& late = other_.reads<String>(dds_topic(), history());
  for (const char* const data : {"1", "2", "3"}) {
    const auto got = other_.take<String>(late);
    ASSERT_NE(got, nullptr) << data << " is lost";
    EXPECT_EQ(got->data, data);
  }
}

TEST_F(Reload, DeliversAHistoryOnceAlthoughAReaderIsRecreated) {
  configure("from_dds = { durability = \"volatile\" }");
  start_bridge({"--config", file()});
  auto subscription = create_subscription<String>(PlainNode(), topic(), QoS(10).transient_local());
  DdsWriter& writer = other_.writes(dds_topic(), dds_type_name<String>(), history());
  ASSERT_TRUE(other_.eventually([&] { return writer.matched() == 1; }));
  const auto write = [&](int i) {
    String message;
    message.data = std::to_string(i);
    ASSERT_TRUE(Other::write(writer, message, i));
  };
  for (int i = 1; i <= 3; ++i) {
    write(i);
    const auto got = take_soon(subscription);
    ASSERT_TRUE(got) << i;
    EXPECT_EQ(got->data, std::to_string(i));
  }
  configure_again("");
  ASSERT_TRUE(other_.eventually([&] { return is_latched(Remote::Kind::reader); }));
  write(4);
  const auto got = take_soon(subscription);
  ASSERT_TRUE(got);
  EXPECT_EQ(got->data, "4");
}

}  // namespace
}  // namespace agnocast::test
