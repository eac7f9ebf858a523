// SPDX-License-Identifier: Apache-2.0
//
// Goal: neither many endpoints, nor one that does not answer, nor a lack of memory keep the bridge
// from its task.
// Method: more writers than places, a stopped reader in DDS, an allocation that fails.

#include <tests/integration/bridge/routes/bridge_side.hpp>
#include <tests/support/processes/plain_node.hpp>

#include <agnocast/agnocast.hpp>
#include <bridge/plan/routes.hpp>

#include <std_msgs/msg/string.hpp>

#include <signal.h>

#include <set>

namespace agnocast::test {
namespace {

using bridge::remote_publishers_per_topic_max;
using std_msgs::msg::String;

class Bounds : public BridgeTest {
 protected:
  void SetUp() override { start_bridge({"--status-socket", status_path()}); }
  static std::string status_path() { return daemon->directory() + "/bounds.sock"; }
  static std::string status() { return status_at(status_path()); }
  /// Returns whether run() answers. It waits a second each time: less than the lease of a stopped
  /// reader in all, and as long as a busy machine may need.
  static bool answers() {
    for (int i = 0; i < 20; ++i) {
      if (!status().empty()) return true;
    }
    return false;
  }
  static DdsQos keep_last(std::int32_t depth) {
    DdsQos qos;
    qos.depth = depth;
    return qos;
  }
  static PublishResult publish(Publisher<String>& publisher, const std::string& data) {
    auto loan = publisher.borrow_loaned_message();
    loan->data = data;
    return publisher.publish(std::move(loan));
  }
  std::size_t count_of(const std::string& text, const std::string& what) const {
    std::size_t count = 0;
    for (std::size_t at = text.find(what); at != text.npos; at = text.find(what, at + 1)) ++count;
    return count;
  }
};

TEST_F(Bounds, LeaveHalfOfATopicsPlacesToThePublishersOfThisHost) {
  auto subscription = create_subscription<String>(PlainNode(), topic(), 1000);
  std::vector<DdsWriter*> writers;
  for (std::size_t i = 0; i < remote_publishers_per_topic_max + 20; ++i)
    writers.push_back(&other_.writes(dds_topic(), dds_type_name<String>(), keep_last(1)));
  const auto source_count = [&] {
    const std::string now = status();
    const std::size_t begin = now.find("\"remote_publishers\":["),
                      end = now.find("\"local_readers\":[");
    return begin == now.npos ? 0 : count_of(now.substr(begin, end - begin), "\"topic\"");
  };
  ASSERT_TRUE(other_.eventually([&] {
    return source_count() == remote_publishers_per_topic_max &&
           status().find("\"why\":\"too_many\"") != std::string::npos;
  }));
  EXPECT_TRUE(other_.eventually([&] { return said("not bridged what=\"writers of ") == 1; }));
  std::vector<Publisher<String>::SharedPtr> publishers;
  // They belong to the bridge's own user, who may have three quarters of the places.
  for (int i = 0; i < 60; ++i) {
    auto made = try_create_publisher<String>(PlainNode(), topic(), QoS(1));
    ASSERT_TRUE(made) << i << ": " << made.error().what;
    publishers.push_back(std::move(*made));
  }
  // The bridge reads those that have a place, and they keep it.
  std::set<std::string> first, later;
  const auto hear = [&](std::set<std::string>& heard) {
    return other_.eventually([&] {
      static std::int64_t time = 0;
      ++time;
      for (std::size_t i = 0; i < writers.size(); ++i) {
        String message;
        message.data = std::to_string(i);
        EXPECT_TRUE(Other::write(*writers[i], message, time));
      }
      other_.look(std::chrono::milliseconds(5));
      while (const auto message = subscription->take()) heard.insert(message->data);
      return heard.size() >= remote_publishers_per_topic_max;
    });
  };
  EXPECT_TRUE(hear(first));
  EXPECT_TRUE(hear(later));
  EXPECT_EQ(first.size(), remote_publishers_per_topic_max);
  EXPECT_EQ(first, later);
}

TEST_F(Bounds, OfAReaderThatDoesNotAcknowledgeAffectItsWritersAlone) {
  const auto peer = domain->peer("60 s");
  ASSERT_EQ(peer->ask("reader " + dds_topic() + " " + dds_type_name<String>() + " reliable all"),
            "made");
  auto first = create_publisher<String>(PlainNode(), topic(), QoS(1));
  ASSERT_TRUE(other_.eventually([&] { return first->get_linked_subscription_count() == 1; }));
  ASSERT_TRUE(publish(*first, "met"));
  ASSERT_NE(peer->ask("take " + dds_topic()), "(nothing)");
  ASSERT_EQ(::kill(peer->pid(), SIGSTOP), 0);
  // Each with a history that a DDS writer cannot get rid of, for a local reader that does not
  // exist yet.
  constexpr std::size_t count = 20, history = 5;
  std::vector<Publisher<String>::SharedPtr> publishers;
  for (std::size_t i = 0; i < count; ++i) {
    publishers.push_back(
        create_publisher<String>(PlainNode(), topic(), QoS(1).keep_all(10 + i).transient_local()));
    for (std::size_t j = 0; j < history; ++j)
      (void)publish(*publishers.back(), std::string(100'000, 'x'));
  }
  ASSERT_TRUE(other_.eventually([&] { return said("keep-all blocks a publisher") > 0; }));
  // Neither the status nor another topic waits for it.
  DdsReader& beside = other_.reads<String>(dds_topic() + "_beside", keep_last(100));
  auto free = create_publisher<String>(PlainNode(), topic() + "_beside", QoS(10));
  ASSERT_TRUE(other_.eventually([&] { return is_out(beside, *free); }));
  for (int i = 0; i < 20; ++i) {
    EXPECT_TRUE(answers()) << "the thread that plans waits for a reader in DDS";
    ASSERT_TRUE(publish(*free, std::to_string(i)));
    const auto got = other_.take<String>(beside);
    ASSERT_NE(got, nullptr) << i;
    EXPECT_EQ(got->data, std::to_string(i));
  }
  ASSERT_EQ(::kill(peer->pid(), SIGCONT), 0);
  for (std::size_t i = 0; i < count * history; ++i) {
    ASSERT_TRUE(other_.eventually([&] { return peer->ask("take " + dds_topic()) != "(nothing)"; }))
        << "nothing more arrives after " << i;
  }
}

TEST_F(Bounds, OfTimeApplyToWaitingMessagesOfADeadWriter) {
  const auto never_reads = create_subscription<String>(PlainNode(), topic(), QoS(1).keep_all(5));
  DdsQos keep_all;
  keep_all.keep_all = true;
  auto writer =
      other_.participant().create_writer(dds_topic(), dds_type_name<String>(), keep_all).value();
  ASSERT_TRUE(other_.eventually([&] { return writer->matched() == 1; }));
  for (int i = 1; i <= 50; ++i) ASSERT_TRUE(Other::write(*writer, String(), i));
  const auto has_remote_publisher = [] {
    return status().find("\"remote_publishers\":[]") == std::string::npos;
  };
  ASSERT_TRUE(other_.eventually(has_remote_publisher));
  writer.reset();
  EXPECT_TRUE(other_.eventually([&] { return !has_remote_publisher(); }));
  EXPECT_EQ(said("message not published"), 1u) << "the log reports the dropped message";
}

// Each allocation in turn: the bridge goes on, or ends with a status after which its unit restarts
// it.
TEST_F(Bounds, OfMemoryEndTheBridgeInOrder) {
  constexpr int allocations = 120;  // planning and applying a first route are about that many
  int ended = 0;
  for (int number = 0; number < allocations; ++number) {
    bridge_.reset();
    const std::size_t said_before = said("no memory here");
    start_bridge(
        {"--status-socket", status_path()},
        {"LD_PRELOAD=" AGNOCAST_NO_MEMORY, "AGNOCAST_NO_MEMORY=" + std::to_string(number)});
    ASSERT_TRUE(other_.eventually([&] { return !status().empty(); })) << number;
    ASSERT_EQ(::kill(bridge_->pid(), SIGUSR1), 0);
    ASSERT_TRUE(other_.eventually([&] {
      const auto publisher = create_publisher<String>(PlainNode(), topic(), QoS(1));
      return said("no memory here") > said_before;
    })) << number;
    ::kill(bridge_->pid(), SIGTERM);
    const int status = bridge_->finish();
    EXPECT_TRUE(status == 0 || status == 1) << status << " at allocation " << number;
    ended += status;
  }
  EXPECT_GT(ended, 0) << "no allocation of the planning failed";
}

}  // namespace
}  // namespace agnocast::test
