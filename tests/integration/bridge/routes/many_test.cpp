// SPDX-License-Identifier: Apache-2.0
//
// Goal: with one to eight publishers and as many receivers on both sides of one topic, of any QoS,
// each receiver gets from each publisher what both QoS promise: all messages once and in order if
// both are reliable, some once and in order if one is not, nothing if they do not match. Method:
// random rounds (AGNOCAST_TEST_SEED); the real bridge, and in DDS one participant that writes and
// one that reads, since none receives its own messages.

#include <tests/integration/bridge/routes/bridge_side.hpp>
#include <tests/support/processes/plain_node.hpp>

#include <agnocast/agnocast.hpp>

#include <std_msgs/msg/string.hpp>

#include <gmock/gmock.h>

#include <algorithm>
#include <cstdlib>
#include <functional>
#include <map>
#include <random>
#include <set>
#include <thread>

namespace agnocast::test {
namespace {

using namespace std::chrono_literals;
using std_msgs::msg::String;

constexpr int rounds = 6;
constexpr std::uint64_t message_count = 40;
// Deep enough that nothing is overwritten unread.
constexpr std::int32_t depth = 1'000;

struct Class {
  bool is_reliable = true, is_transient = false;
};
bool serves(const Class& offered, const Class& requested) {
  return (offered.is_reliable || !requested.is_reliable) &&
         (offered.is_transient || !requested.is_transient);
}

struct Sender {
  Class qos;
  std::function<bool(const std::string&)> send;
};
struct Receiver {
  Class qos;
  std::function<std::optional<std::string>()> take;
  bool is_local = false;
  std::set<std::size_t> met = {};                                  // by their probes
  std::map<std::size_t, std::vector<std::uint64_t>> counted = {};  // by sender
};

class Many : public BridgeTest {
 protected:
  static QoS local_qos(const Class& of) {
    QoS qos(depth);
    if (!of.is_reliable) qos.best_effort();
    if (of.is_transient) qos.transient_local();
    return qos;
  }
  static DdsQos dds_qos(const Class& of) {
    DdsQos qos;
    qos.depth = depth;
    qos.reliable = of.is_reliable;
    qos.transient_local = of.is_transient;
    return qos;
  }

  void add_publisher(const std::string& topic, const Class& of) {
    auto publisher = create_publisher<String>(PlainNode(), topic, local_qos(of));
    senders_.push_back({of, [publisher](const std::string& data) {
                          auto loan = publisher->borrow_loaned_message();
                          loan->data = data;
                          return static_cast<bool>(publisher->publish(std::move(loan)));
                        }});
  }
  void add_writer(const std::string& topic, const Class& of) {
    DdsWriter& writer = other_.writes("rt" + topic, dds_type_name<String>(), dds_qos(of));
    senders_.push_back({of, [&writer, time = std::int64_t{0}](const std::string& data) mutable {
                          String message;
                          message.data = data;
                          return Other::write(writer, message, ++time);
                        }});
  }
  void add_subscription(const std::string& topic, const Class& of) {
    auto subscription = create_subscription<String>(PlainNode(), topic, local_qos(of));
    receivers_.push_back({of,
                          [subscription]() -> std::optional<std::string> {
                            const auto message = subscription->take();
                            if (!message) return std::nullopt;
                            return message->data;
                          },
                          true});
  }
  void add_reader(const std::string& topic, const Class& of) {
    DdsReader& reader = readers_.reads<String>("rt" + topic, dds_qos(of));
    receivers_.push_back({of, [&reader]() -> std::optional<std::string> {
                            while (const auto sample = reader.take()) {
                              if (sample->state == DdsSample::State::valid)
                                return static_cast<String*>(sample->object.get())->data;
                            }
                            return std::nullopt;
                          }});
  }

  void take_all() {
    for (Receiver& receiver : receivers_) {
      while (const auto data = receiver.take()) {
        const std::size_t colon = data->find(':');
        ASSERT_NE(colon, data->npos) << *data;
        const std::size_t sender = std::stoul(*data);
        const std::string text = data->substr(colon + 1);
        if (!text.starts_with("probe")) {
          receiver.counted[sender].push_back(std::stoul(text));
        } else if (text == probe_) {
          receiver.met.insert(sender);
        }
      }
    }
  }
  void look() {
    other_.look(5ms);
    readers_.look(5ms);
  }
  /// Sends until all receivers hear the senders that match.
  bool meet(const std::string& probe) {
    probe_ = probe;
    for (Receiver& receiver : receivers_) receiver.met.clear();
    return eventually([&] {
      for (std::size_t i = 0; i < senders_.size(); ++i)
        EXPECT_TRUE(senders_[i].send(std::to_string(i) + ':' + probe));
      take_all();
      return have_all_met() || HasFailure();
    });
  }
  /// Returns whether the bridge reads the topic reliably, if a subscription requests that.
  bool is_read_reliably(const std::string& topic) {
    const auto& remotes = other_.participant().remotes();
    return std::none_of(receivers_.begin(), receivers_.end(),
                        [](const Receiver& receiver) {
                          return receiver.is_local && receiver.qos.is_reliable;
                        }) ||
           std::any_of(remotes.begin(), remotes.end(), [&](const auto& entry) {
             const Remote& remote = entry.second;
             return remote.topic == "rt" + topic && remote.kind == Remote::Kind::reader &&
                    remote.qos.reliable && remote.participant != readers_.participant().guid();
           });
  }
  bool have_all_met() const {
    return std::all_of(receivers_.begin(), receivers_.end(), [&](const Receiver& receiver) {
      for (std::size_t i = 0; i < senders_.size(); ++i) {
        if (serves(senders_[i].qos, receiver.qos) && !receiver.met.contains(i)) return false;
      }
      return true;
    });
  }
  /// Returns whether every message that may not be lost has arrived.
  bool is_complete() const {
    return std::all_of(receivers_.begin(), receivers_.end(), [&](const Receiver& receiver) {
      for (std::size_t i = 0; i < senders_.size(); ++i) {
        if (!is_sure(i, receiver)) continue;
        const auto got = receiver.counted.find(i);
        if (got == receiver.counted.end() || got->second.size() < message_count) return false;
      }
      return true;
    });
  }
  bool is_sure(std::size_t sender, const Receiver& receiver) const {
    return serves(senders_[sender].qos, receiver.qos) && receiver.qos.is_reliable;
  }
  bool eventually(const std::function<bool()>& condition) {
    const auto end = std::chrono::steady_clock::now() + patience;
    while (!condition()) {
      if (std::chrono::steady_clock::now() > end) return false;
      look();
    }
    return true;
  }

  Other readers_{domain->id()};
  std::vector<Sender> senders_;
  std::vector<Receiver> receivers_;
  std::string probe_;  // the present one; earlier ones may still come
};

TEST_F(Many, ReceiveExactlyWhatTheirQosPromise) {
  const char* const said = std::getenv("AGNOCAST_TEST_SEED");
  const unsigned seed = said != nullptr ? static_cast<unsigned>(std::stoul(said)) : 1;
  std::mt19937 random(seed);
  const auto flip = [&] { return random() % 2 == 0; };
  for (int round = 0; round < rounds; ++round) {
    SCOPED_TRACE("AGNOCAST_TEST_SEED=" + std::to_string(seed) + ", round " + std::to_string(round));
    const std::string name = topic() + "_" + std::to_string(round);
    const auto some = [&](const auto& add) {
      for (auto count = 1 + random() % 8; count > 0; --count) add(Class{flip(), flip()});
    };
    senders_.clear();
    receivers_.clear();
    some([&](const Class& of) { add_publisher(name, of); });
    some([&](const Class& of) { add_writer(name, of); });
    some([&](const Class& of) { add_subscription(name, of); });
    some([&](const Class& of) { add_reader(name, of); });
    ASSERT_TRUE(meet("probe")) << "a receiver does not hear a matching sender";
    // The bridge may have read a writer for best-effort subscriptions alone. It reads it reliably
    // from the first message that comes after the bridge has a reliable reader.
    ASSERT_TRUE(eventually([&] { return is_read_reliably(name); }));
    ASSERT_TRUE(meet("probe again")) << "a receiver does not hear a matching sender again";
    for (std::uint64_t number = 0; number < message_count; ++number) {
      for (std::size_t i = 0; i < senders_.size(); ++i)
        ASSERT_TRUE(senders_[i].send(std::to_string(i) + ":" + std::to_string(number)));
      take_all();
    }
    EXPECT_TRUE(eventually([&] {
      take_all();
      return is_complete();
    })) << "a receiver has not got everything";
    for (int i = 0; i < 20; ++i) look();  // for messages that should not arrive
    take_all();
    for (std::size_t r = 0; r < receivers_.size(); ++r) {
      const Receiver& receiver = receivers_[r];
      for (const auto& [sender, numbers] : receiver.counted) {
        SCOPED_TRACE("receiver " + std::to_string(r) + ", sender " + std::to_string(sender));
        EXPECT_TRUE(serves(senders_[sender].qos, receiver.qos)) << "they do not match";
        EXPECT_EQ(std::adjacent_find(numbers.begin(), numbers.end(), std::greater_equal<>()),
                  numbers.end())
            << "twice, or in another order";
        if (is_sure(sender, receiver)) {
          EXPECT_EQ(numbers.size(), message_count) << testing::PrintToString(numbers);
        }
      }
    }
    if (HasFailure()) return;
    other_.forget();
    readers_.forget();
  }
}

}  // namespace
}  // namespace agnocast::test
