// SPDX-License-Identifier: Apache-2.0
//
// Goal: a subscription that requests more than the earlier ones of its topic gets all that a writer
// in DDS retains and sends on, although the bridge's DDS reader for the earlier ones may have lost
// some. Method: it is created while a writer writes.

#include <tests/integration/bridge/routes/bridge_side.hpp>
#include <tests/support/processes/plain_node.hpp>

#include <agnocast/agnocast.hpp>

#include <std_msgs/msg/string.hpp>

#include <algorithm>
#include <numeric>
#include <string>
#include <vector>

namespace agnocast::test {
namespace {

using namespace std::chrono_literals;
using std_msgs::msg::String;

constexpr std::int32_t retained = 1'000;

class Handover : public BridgeTest {};

// Cyclone withholds the samples of a reliable writer from a best-effort reader between the creation
// of the first reliable reader and the writer's next heartbeat.
TEST_F(Handover, FromBestEffortLosesNothingThatTheWriterRetains) {
  constexpr int rounds = 10;
  for (int round = 0; round < rounds; ++round) {
    SCOPED_TRACE(round);
    const std::string name = topic() + "_" + std::to_string(round);
    auto early = create_subscription<String>(PlainNode(), name, QoS(retained).best_effort());
    DdsQos qos;
    qos.depth = retained;
    qos.transient_local = true;
    DdsWriter& writer = other_.writes("rt" + name, dds_type_name<String>(), qos);
    int written = 0;
    const auto write = [&] {
      String message;
      message.data = std::to_string(written);
      EXPECT_TRUE(Other::write(writer, message, ++written));
      other_.look(1ms);
    };
    ipc_shared_ptr<const String> first;
    ASSERT_TRUE(other_.eventually([&] {
      write();
      return static_cast<bool>(first = early->take());
    }));
    auto late = create_subscription<String>(PlainNode(), name, QoS(retained).transient_local());
    ASSERT_TRUE(other_.eventually([&] {
      write();
      const auto& remotes = other_.participant().remotes();
      return std::any_of(remotes.begin(), remotes.end(), [&](const auto& entry) {
        const Remote& remote = entry.second;
        return remote.topic == "rt" + name && remote.kind == Remote::Kind::reader &&
               remote.qos.reliable;
      });
    }));
    for (int i = 0; i < 20; ++i) write();
    std::vector<int> got;
    ASSERT_TRUE(other_.eventually([&] {
      while (const auto message = late->take()) {
        const int number = std::stoi(message->data);
        got.push_back(number);
      }
      return !got.empty() && got.back() == written - 1;
    }));
    std::vector<int> expected(got.size());
    std::iota(expected.begin(), expected.end(), got.front());
    EXPECT_EQ(got, expected);
    EXPECT_LE(got.front(), std::stoi(first->data)) << "the first messages are missing";
  }
}

}  // namespace
}  // namespace agnocast::test
