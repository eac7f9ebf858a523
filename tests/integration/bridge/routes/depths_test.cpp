// SPDX-License-Identifier: Apache-2.0
//
// Goal: a publisher's history, and whether it blocks, are the same beside publishers that keep
// less or more, and readers that become deeper lose nothing. Method: the bridge is stopped while
// publishers publish.

#include <tests/integration/bridge/routes/bridge_side.hpp>
#include <tests/support/processes/plain_node.hpp>

#include <agnocast/agnocast.hpp>

#include <std_msgs/msg/string.hpp>

#include <signal.h>

#include <set>
#include <string>
#include <thread>
#include <utility>
#include <vector>

namespace agnocast::test {
namespace {

using namespace std::chrono_literals;
using std_msgs::msg::String;

constexpr int count = 500;

class Depths : public BridgeTest {
 protected:
  static PublishResult publish(Publisher<String>& publisher, const std::string& data) {
    auto loan = publisher.borrow_loaned_message();
    loan->data = data;
    return publisher.publish(std::move(loan));
  }
  static DdsQos keep_last(std::int32_t depth) {
    DdsQos qos;
    qos.depth = depth;
    return qos;
  }
  void stop() const { ASSERT_EQ(::kill(bridge_->pid(), SIGSTOP), 0); }
  void go_on() const { ASSERT_EQ(::kill(bridge_->pid(), SIGCONT), 0); }
  /// Waits until both publishers have all local readers of the bridge, and the reader receives
  /// both; a keep-all publisher may block meanwhile. The bridge sends messages of a publisher whose
  /// own local reader is still to come too, so hearing them is not enough.
  bool hears(DdsReader& reader, Publisher<String>& one, Publisher<String>& other,
             std::size_t local_readers) {
    if (!other_.eventually([&] {
          return one.get_linked_subscription_count() == local_readers &&
                 other.get_linked_subscription_count() == local_readers;
        }))
      return false;
    bool from_one = false, from_other = false;
    return other_.eventually([&] {
      for (auto& [publisher, data] : {std::pair(&one, "one"), std::pair(&other, "other")}) {
        const PublishResult result = publish(*publisher, data);
        EXPECT_TRUE(result || result.code == Errc::would_block);
      }
      while (const auto sample = reader.take()) {
        if (sample->state != DdsSample::State::valid) continue;
        const auto& data = static_cast<String*>(sample->object.get())->data;
        (data == "one" ? from_one : from_other) = true;
      }
      return from_one && from_other;
    });
  }
  /// Expects 0 … numbers - 1 next, in this order.
  void take_numbers(DdsReader& reader, int numbers) {
    for (int i = 0; i < numbers; ++i) {
      const auto got = other_.take<String>(reader);
      ASSERT_NE(got, nullptr) << "nothing more arrives after " << i;
      ASSERT_EQ(got->data, std::to_string(i));
    }
  }
};

TEST_F(Depths, AreThoseOfEachPublisherAlsoOfALaterOne) {
  DdsReader& reader = other_.reads<String>(dds_topic(), keep_last(5000));
  auto shallow = create_publisher<String>(PlainNode(), topic(), 1);
  ASSERT_TRUE(other_.eventually([&] { return is_out(reader, *shallow); }));
  auto deep = create_publisher<String>(PlainNode(), topic(), 1000);
  ASSERT_TRUE(hears(reader, *shallow, *deep, 2));
  stop();
  for (int i = 0; i < count; ++i) ASSERT_TRUE(publish(*deep, std::to_string(i)));
  go_on();
  int expected = 0;
  while (expected < count) {
    const auto got = other_.take<String>(reader);
    ASSERT_NE(got, nullptr) << "nothing more arrives; messages lost before " << expected;
    if (got->data == "one" || got->data == "other") continue;
    ASSERT_EQ(got->data, std::to_string(expected));
    ++expected;
  }
}

// As on /tf_static: many publishers, each with one message that counts.
TEST_F(Depths, OfOneMessageEachLeaveALateReaderAllHistories) {
  std::vector<Publisher<String>::SharedPtr> publishers;
  std::set<std::string> expected;
  for (int i = 0; i < 40; ++i) {
    publishers.push_back(create_publisher<String>(PlainNode(), topic(), QoS(1).transient_local()));
    ASSERT_TRUE(publish(*publishers.back(), std::to_string(i)));
    expected.insert(std::to_string(i));
  }
  DdsQos late = keep_last(100);
  late.transient_local = true;
  DdsReader& reader = other_.reads<String>(dds_topic(), late);
  std::set<std::string> got;
  while (got.size() < expected.size()) {
    const auto message = other_.take<String>(reader);
    ASSERT_NE(message, nullptr) << "nothing more arrives after " << got.size();
    EXPECT_TRUE(got.insert(message->data).second) << message->data << " came twice";
  }
  EXPECT_EQ(got, expected);
}

TEST_F(Depths, OfOneMessageEachAreKeptWhileTheBridgeLags) {
  DdsReader& reader = other_.reads<String>(dds_topic(), keep_last(5000));
  auto one = create_publisher<String>(PlainNode(), topic(), 1);
  auto other = create_publisher<String>(PlainNode(), topic(), 1);
  ASSERT_TRUE(hears(reader, *one, *other, 1));
  stop();
  ASSERT_TRUE(publish(*one, "last of one"));
  for (int i = 0; i < count; ++i) ASSERT_TRUE(publish(*other, std::to_string(i)));
  go_on();
  for (bool has_one = false, has_other = false; !has_one || !has_other;) {
    const auto got = other_.take<String>(reader);
    ASSERT_NE(got, nullptr) << "nothing more arrives; of one publisher: " << has_one;
    has_one |= got->data == "last of one";
    has_other |= got->data == std::to_string(count - 1);
  }
}

// The bridge makes its local reader for it, after it has seen another publisher.
TEST_F(Depths, OfANewPublisherLoseNoneOfItsFirstMessages) {
  DdsReader& reader = other_.reads<String>(dds_topic(), keep_last(5000));
  auto first = create_publisher<String>(PlainNode(), topic(), 10);
  ASSERT_TRUE(other_.eventually([&] { return is_out(reader, *first); }));
  for (int round = 0; round < 20; ++round) {
    auto next =
        create_publisher<String>(PlainNode(), topic(), static_cast<std::size_t>(11 + round));
    ASSERT_TRUE(other_.eventually([&] { return next->get_linked_subscription_count() > 0; }));
    for (int i = 0; i < 5; ++i) ASSERT_TRUE(publish(*next, std::to_string(i)));
    SCOPED_TRACE(round);
    ASSERT_NO_FATAL_FAILURE(take_numbers(reader, 5));
  }
}

// A local reader of another depth has only its last message, and may be first.
TEST_F(Depths, OfANewPublisherAreNotThoseOfAShallowerLocalReader) {
  DdsReader& reader = other_.reads<String>(dds_topic(), keep_last(5000));
  std::vector<Publisher<String>::SharedPtr> all = {
      create_publisher<String>(PlainNode(), topic(), 1)};
  ASSERT_TRUE(other_.eventually([&] { return is_out(reader, *all.front()); }));
  for (std::size_t round = 0; round < 20; ++round) {
    // The first one of a depth makes a local reader, the second one finds it.
    all.push_back(create_publisher<String>(PlainNode(), topic(), 10 + round / 2));
    const Publisher<String>& next = *all.back();
    ASSERT_TRUE(
        other_.eventually([&] { return next.get_linked_subscription_count() == 2 + round / 2; }));
    stop();
    for (int i = 0; i < 5; ++i) ASSERT_TRUE(publish(*all.back(), std::to_string(i)));
    go_on();
    SCOPED_TRACE(round);
    ASSERT_NO_FATAL_FAILURE(take_numbers(reader, 5));
  }
}

TEST_F(Depths, OfANewKeepAllPublisherBlockItAndLoseNothing) {
  DdsReader& reader = other_.reads<String>(dds_topic(), keep_last(5000));
  auto first = create_publisher<String>(PlainNode(), topic(), QoS(1).keep_all(10));
  ASSERT_TRUE(other_.eventually([&] { return is_out(reader, *first); }));
  for (int round = 0; round < 20; ++round) {
    auto next = create_publisher<String>(PlainNode(), topic(), QoS(1).keep_all(10));
    ASSERT_TRUE(other_.eventually([&] { return next->get_linked_subscription_count() == 1; }));
    for (int i = 0; i < 40; ++i) {
      const auto deadline = std::chrono::steady_clock::now() + patience;
      while (!publish(*next, std::to_string(i)))
        ASSERT_LT(std::chrono::steady_clock::now(), deadline) << "blocked for ever";
    }
    SCOPED_TRACE(round);
    ASSERT_NO_FATAL_FAILURE(take_numbers(reader, 40));
  }
}

TEST_F(Depths, OfKeepAllBlockTheirPublisherAndNoOther) {
  DdsReader& reader = other_.reads<String>(dds_topic(), keep_last(5000));
  auto last = create_publisher<String>(PlainNode(), topic(), 5);
  ASSERT_TRUE(other_.eventually([&] { return is_out(reader, *last); }));
  auto all = create_publisher<String>(PlainNode(), topic(), QoS(1).keep_all(5));
  ASSERT_TRUE(hears(reader, *last, *all, 2));
  stop();
  PublishResult held;
  for (int i = 0; i < count && held.code != Errc::would_block; ++i)
    held = publish(*all, std::to_string(i));
  EXPECT_EQ(held.code, Errc::would_block)
      << "the bridge has not read, and the publish does not wait for it";
  for (int i = 0; i < count; ++i) EXPECT_TRUE(publish(*last, "last"));
  go_on();
  EXPECT_TRUE(hears(reader, *last, *all, 2));
}

TEST_F(Depths, OfDdsReadersGrowWithoutALossForExistingReaders) {
  auto early = create_subscription<String>(PlainNode(), topic(), 100);
  std::vector<Subscription<String>::SharedPtr> late;
  DdsWriter& writer = other_.writes(dds_topic(), dds_type_name<String>(), keep_last(100));
  ASSERT_TRUE(other_.eventually([&] { return writer.matched() >= 1; }));
  int written = 0, got = 0;
  const auto has_come_but = [&](int rest) {
    return other_.eventually([&] {
      while (const auto message = early->take()) {
        if (message->data == "hello") continue;
        EXPECT_EQ(message->data, std::to_string(got));
        ++got;
      }
      return got >= written - rest || HasFailure();
    });
  };
  // The writer matches before the bridge's participant knows it, so the first messages may be lost.
  // Later messages have later times, by which the bridge knows what both of its DDS readers got.
  constexpr std::int64_t hello_time_ns = 1;
  ASSERT_TRUE(other_.eventually([&] {
    String hello;
    hello.data = "hello";
    EXPECT_TRUE(Other::write(writer, hello, hello_time_ns));
    return early->take() != nullptr;
  }));
  const auto reader_depths = [&] {
    std::set<std::int32_t> depths;
    for (const auto& [guid, remote] : other_.participant().remotes()) {
      if (remote.topic == dds_topic()) depths.insert(remote.qos.depth);
    }
    return depths;
  };
  // Each makes the bridge read with another DDS reader, while messages flow.
  for (const std::int32_t depth : {150, 300, 1000}) {
    late.push_back(
        create_subscription<String>(PlainNode(), topic(), QoS(static_cast<std::size_t>(depth))));
    const auto is_read_anew = [&] {
      const std::set<std::int32_t> depths = reader_depths();
      return depths.size() == 1 && *depths.begin() >= depth;
    };
    do {
      String message;
      message.data = std::to_string(written);
      ++written;
      ASSERT_TRUE(Other::write(writer, message, hello_time_ns + written));
      ASSERT_TRUE(has_come_but(20)) << "lost, twice or out of order";
      ASSERT_FALSE(HasFailure());
      other_.look(1ms);
    } while (!is_read_anew());
  }
  EXPECT_TRUE(has_come_but(0));
}

// It is held up for longer than a former DDS reader stays, while both readers receive.
TEST_F(Depths, OfDdsReadersGrowWithoutALossWhileTheBridgeWaitsForAgnocastd) {
  auto early = create_subscription<String>(PlainNode(), topic(), 100);
  auto other = create_subscription<String>(PlainNode(), topic() + "_other", 1);
  const auto has_reader = [&](const std::string& name, std::int32_t depth) {
    return other_.eventually([&] {
      for (const auto& [guid, remote] : other_.participant().remotes()) {
        if (remote.topic == name && remote.kind == Remote::Kind::reader &&
            remote.qos.depth >= depth)
          return true;
      }
      return false;
    });
  };
  ASSERT_TRUE(has_reader(dds_topic() + "_other", 1));
  DdsWriter& writer = other_.writes(dds_topic(), dds_type_name<String>(), keep_last(100));
  std::int64_t time_ns = 0;
  const auto write = [&](const std::string& data) {
    String message;
    message.data = data;
    EXPECT_TRUE(Other::write(writer, message, ++time_ns));
  };
  ASSERT_TRUE(other_.eventually([&] {
    write("hello");
    return early->take() != nullptr;
  }));
  auto late = create_subscription<String>(PlainNode(), topic(), 150);
  ASSERT_TRUE(has_reader(dds_topic(), 150));
  // The plan for this writer waits.
  const pid_t waits_for = daemon->kill_worker(SIGSTOP);
  other_.writes(dds_topic() + "_other", dds_type_name<String>(), {});
  for (int i = 0; i < 20; ++i) {
    write(std::to_string(i));
    other_.look(10ms);
  }
  std::this_thread::sleep_for(1200ms);
  ASSERT_EQ(::kill(waits_for, SIGCONT), 0);
  std::vector<std::string> got, expected;
  for (int i = 0; i < 20; ++i) expected.push_back(std::to_string(i));
  (void)other_.eventually([&] {
    while (const auto message = early->take())
      if (message->data != "hello") got.push_back(message->data);
    return got.size() >= expected.size();
  });
  other_.look(200ms);
  while (const auto message = early->take()) got.push_back(message->data);
  EXPECT_EQ(got, expected) << "lost, twice or out of order";
}

}  // namespace
}  // namespace agnocast::test
