// SPDX-License-Identifier: Apache-2.0
//
// Goal: upstream's synchronizers give the same sets whether an input is rclcpp's or ours. Method:
// sequences of stamps, also those of upstream's own test_approximate_time_policy.cpp and
// test_exact_time_policy.cpp with what they expect; each message is published on both, and there is
// a synchronizer for every choice of which inputs are ours. A message is published when every input
// has the one before, so the order is the sequence's.

#include "test_node.hpp"

#include <message_filters/subscriber.h>
#include <message_filters/sync_policies/approximate_time.h>
#include <message_filters/sync_policies/exact_time.h>
#include <message_filters/synchronizer.h>
#include <agnocast_rclcpp/message_filters.hpp>
#include <sensor_msgs/msg/temperature.hpp>

#include <algorithm>
#include <array>
#include <functional>
#include <initializer_list>
#include <memory>
#include <random>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

namespace agnocast_rclcpp {
namespace {

using Temperature = sensor_msgs::msg::Temperature;
using Message = Temperature::ConstSharedPtr;
using Filter = message_filters::SimpleFilter<Temperature>;
using Theirs = message_filters::Subscriber<Temperature>;
using Ours = agnocast::message_filters::Subscriber<Temperature>;

constexpr std::size_t depth = 50;

/// What is published, and the sets of one message of each topic that come of it.
struct Sequence {
  const char* name;
  std::size_t topics;  // 2 to 4
  std::uint32_t queue_size;
  double lower_bound;     // in seconds between messages of the first topic; 0: none
  std::string published;  // topic and stamp in seconds, as "A0 B1"
  std::string sets;       // as "0/1 3/4"
};

const Sequence upstream[] = {
    {"exact", 2, 10, 0, "A0 B0 A3 B3 A6 B6", "0/0 3/3 6/6"},
    {"perfect", 2, 10, 0, "A0 B1 A3 B4 A6 B7", "0/1 3/4"},
    {"imperfect", 2, 10, 0, "A0 B1 A2 A3 B5 A6 B7", "0/1 6/5"},
    {"acceleration", 2, 10, 0, "A0 B7 A12 B15 A17 B18", "12/7 17/18"},
    {"queue_of_1", 2, 1, 0, "A0 B1 B3 A4 B7 A8 A10 B11 A13 B14", "4/3 10/11"},
    {"queue_of_2", 2, 2, 0, "A0 B1 B3 A4 B7 A8 A10 B11 A13 B14", "0/1 4/3 8/7 10/11"},
    {"long_queue", 2, 5, 0, "A0 A1 A2 A3 A4 A5 A6 A7 A8 B3 A9 A10 A11 A12 B10 A13", "10/10"},
    {"two_sets_at_once", 2, 10, 0, "A0 B1 B3 A3", "0/1 3/3"},
    {"four_topics", 4, 10, 0, "A0 B1 C2 D3 A5 D5 B6 C6 A8 B9 C10 D11 A10 A13 B14",
     "0/1/2/3 5/6/6/5 10/9/10/11"},
    {"early", 4, 10, 0, "A0 B1 C2 D3 A7", "0/1/2/3"},
    {"bound_below_the_rate", 2, 10, 1.5, "A0 B1 A3 B4 A6 B7", "0/1 3/4"},
    {"bound_near_the_rate", 2, 10, 2, "A0 B1 A3 B4 A6 B7", "0/1 3/4 6/7"},
};

const Sequence upstream_exact[] = {
    {"multiple_times", 3, 2, 0, "A0 B1 A1 C1", "1/1/1"},
    {"queue_size", 3, 1, 0, "A0 B0 B1 B0 C0", ""},
    {"all_three", 3, 1, 0, "A0 B0 C0 C1 B1 A1", "0/0/0 1/1/1"},
};

/// A topic of both kinds.
class Topic {
 public:
  Topic(rclcpp::Node::SharedPtr node, rclcpp::Executor& executor, const std::string& name)
      : executor_(executor),
        dds_(node->create_publisher<Temperature>("dds/" + name, depth)),
        shared_(agnocast::create_publisher<Temperature>(node, "shared/" + name, depth)),
        theirs_(node, "dds/" + name, rclcpp::QoS(depth).get_rmw_qos_profile()),
        ours_(node, "shared/" + name, rclcpp::QoS(depth)) {}
  Filter& input(bool is_ours) {
    return is_ours ? static_cast<Filter&>(ours_) : static_cast<Filter&>(theirs_);
  }
  /// After all synchronizers are connected: counts what they have been given.
  void begin() {
    count(theirs_, 0);
    count(ours_, 1);
    ASSERT_TRUE(spin_until([&] {
      return dds_->get_subscription_count() == 1 && shared_->get_subscription_count() == 1;
    }));
  }
  void publish(int seconds) {
    Temperature message;
    message.header.stamp.sec = seconds;
    dds_->publish(message);
    ASSERT_EQ(shared_->publish(message).code, agnocast::Errc::ok);
    ++published_;
    ASSERT_TRUE(spin_until([&] { return heard_[0] == published_ && heard_[1] == published_; }));
  }

 private:
  void count(Filter& filter, std::size_t kind) {
    filter.registerCallback(
        std::function<void(const Message&)>([this, kind](const Message&) { ++heard_[kind]; }));
  }
  template <class Condition>
  bool spin_until(Condition condition) {
    for (int i = 0; i < 6000 && !condition(); ++i)
      executor_.spin_once(std::chrono::milliseconds(5));
    return condition();
  }

  rclcpp::Executor& executor_;
  rclcpp::Publisher<Temperature>::SharedPtr dds_;
  agnocast::Publisher<Temperature>::SharedPtr shared_;
  Theirs theirs_;
  Ours ours_;
  int published_ = 0;
  std::array<int, 2> heard_{};
};

/// A synchronizer, and the sets that it gave.
template <template <class...> class PolicyOf, class... Each>
class Collected {
 public:
  using Policy = PolicyOf<Each...>;
  Collected(const Sequence& sequence, const std::vector<Filter*>& inputs)
      : synchronizer_(Policy(sequence.queue_size)) {
    connect(inputs, std::index_sequence_for<Each...>());
    if constexpr (sizeof...(Each) == 2) {
      synchronizer_.registerCallback(&Collected::note_two, this);
    } else if constexpr (sizeof...(Each) == 3) {
      synchronizer_.registerCallback(&Collected::note_three, this);
    } else {
      synchronizer_.registerCallback(&Collected::note_four, this);
    }
  }
  message_filters::Synchronizer<Policy>& synchronizer() { return synchronizer_; }
  const std::string& sets() const { return sets_; }

 private:
  template <std::size_t... I>
  void connect(const std::vector<Filter*>& inputs, std::index_sequence<I...>) {
    synchronizer_.connectInput(*inputs[I]...);
  }
  void note_two(const Message& a, const Message& b) { note({a, b}); }
  void note_three(const Message& a, const Message& b, const Message& c) { note({a, b, c}); }
  void note_four(const Message& a, const Message& b, const Message& c, const Message& d) {
    note({a, b, c, d});
  }
  void note(std::initializer_list<Message> set) {
    std::string words;
    for (const Message& message : set) {
      words += words.empty() ? "" : "/";
      words += std::to_string(message->header.stamp.sec);
    }
    sets_ += (sets_.empty() ? "" : " ") + words;
  }

  message_filters::Synchronizer<Policy> synchronizer_;
  std::string sets_;
};

/// Only the approximate policy has a bound.
template <class Synchronizer>
auto bound(Synchronizer& synchronizer, const rclcpp::Duration& time, int)
    -> decltype(synchronizer.setInterMessageLowerBound(0, time)) {
  synchronizer.setInterMessageLowerBound(0, time);
}
template <class Synchronizer>
void bound(Synchronizer&, const rclcpp::Duration&, long) {}

/// Returns the sets by choice of the inputs that are ours, a bit for each topic.
template <template <class...> class PolicyOf, class... Each>
std::vector<std::string> sets_of_each(const Sequence& sequence) {
  const auto node = std::make_shared<rclcpp::Node>("node");
  rclcpp::executors::SingleThreadedExecutor executor;
  executor.add_node(node);
  std::vector<std::unique_ptr<Topic>> topics;
  for (std::size_t i = 0; i < sequence.topics; ++i)
    topics.push_back(std::make_unique<Topic>(node, executor, std::string(1, "abcd"[i])));
  std::vector<std::unique_ptr<Collected<PolicyOf, Each...>>> collected;
  for (std::size_t ours = 0; ours < std::size_t{1} << sequence.topics; ++ours) {
    std::vector<Filter*> inputs;
    for (std::size_t i = 0; i < sequence.topics; ++i)
      inputs.push_back(&topics[i]->input((ours >> i & 1) != 0));
    collected.push_back(std::make_unique<Collected<PolicyOf, Each...>>(sequence, inputs));
    if (sequence.lower_bound > 0)
      bound(collected.back()->synchronizer(), rclcpp::Duration::from_seconds(sequence.lower_bound),
            0);
  }
  for (const auto& topic : topics) topic->begin();
  std::istringstream published(sequence.published);
  for (std::string one; published >> one && !testing::Test::HasFatalFailure();)
    topics[static_cast<std::size_t>(one[0] - 'A')]->publish(std::stoi(one.substr(1)));
  std::vector<std::string> sets;
  for (const auto& one : collected) sets.push_back(one->sets());
  return sets;
}
template <template <class...> class PolicyOf>
std::vector<std::string> sets_of(const Sequence& sequence) {
  using T = Temperature;
  switch (sequence.topics) {
    case 2:
      return sets_of_each<PolicyOf, T, T>(sequence);
    case 3:
      return sets_of_each<PolicyOf, T, T, T>(sequence);
    default:
      return sets_of_each<PolicyOf, T, T, T, T>(sequence);
  }
}

class UpstreamsSequences : public RclcppTest, public testing::WithParamInterface<Sequence> {
 protected:
  template <template <class...> class PolicyOf>
  static void expect_its_sets() {
    const auto sets = sets_of<PolicyOf>(GetParam());
    ASSERT_EQ(sets.size(), std::size_t{1} << GetParam().topics);
    for (std::size_t ours = 0; ours < sets.size(); ++ours)
      EXPECT_EQ(sets[ours], GetParam().sets) << "inputs that are ours: bits of " << ours;
  }
};

TEST_P(UpstreamsSequences, GiveItsSetsFromAnyMixtureOfInputs) {
  expect_its_sets<message_filters::sync_policies::ApproximateTime>();
}

class UpstreamsExactSequences : public UpstreamsSequences {};

TEST_P(UpstreamsExactSequences, GiveItsSetsFromAnyMixtureOfInputs) {
  expect_its_sets<message_filters::sync_policies::ExactTime>();
}

INSTANTIATE_TEST_SUITE_P(ExactTime, UpstreamsExactSequences, testing::ValuesIn(upstream_exact),
                         [](const auto& info) { return std::string(info.param.name); });
INSTANTIATE_TEST_SUITE_P(ApproximateTime, UpstreamsSequences, testing::ValuesIn(upstream),
                         [](const auto& info) { return std::string(info.param.name); });

class RandomSequences : public RclcppTest, public testing::WithParamInterface<unsigned> {
 protected:
  /// Each topic in turn with stamps that jitter, and leaves some out.
  static std::string random_of(unsigned seed, std::size_t topics, int jitter) {
    std::minstd_rand random(seed);
    std::string words;
    for (int time = 10; time < 400; time += 10) {
      for (std::size_t topic = 0; topic < topics; ++topic) {
        if (random() % 5 == 0) continue;
        const int stamp = time + static_cast<int>(random() % static_cast<unsigned>(jitter));
        words += std::string(1, "ABCD"[topic]) + std::to_string(stamp) + ' ';
      }
    }
    return words;
  }
  template <template <class...> class PolicyOf>
  static void expect_equal_sets(std::size_t topics, int jitter) {
    const std::string published = random_of(GetParam(), topics, jitter);
    const auto sets = sets_of<PolicyOf>({"random", topics, depth, 0, published, ""});
    ASSERT_EQ(sets.size(), std::size_t{1} << topics);
    EXPECT_GT(std::count(sets[0].begin(), sets[0].end(), ' '), 5) << published;
    for (std::size_t ours = 1; ours < sets.size(); ++ours)
      EXPECT_EQ(sets[ours], sets[0]) << "inputs that are ours: bits of " << ours;
  }
};

TEST_P(RandomSequences, GiveTheSetsOfInputsOfRclcpp) {
  using namespace message_filters::sync_policies;
  expect_equal_sets<ExactTime>(2, 1);
  expect_equal_sets<ApproximateTime>(2, 8);
  expect_equal_sets<ApproximateTime>(4, 8);
}

INSTANTIATE_TEST_SUITE_P(Seeds, RandomSequences, testing::Range(1u, 7u));

using FilterSource = RclcppTest;

TEST_F(FilterSource, MayEndAndBeginAgain) {
  const auto node = std::make_shared<rclcpp::Node>("node");
  Ours ours;
  ours.subscribe();
  EXPECT_EQ(ours.getTopic(), "");
  ours.subscribe(node, "topic", rclcpp::SensorDataQoS());
  EXPECT_EQ(ours.getTopic(), "topic");
  std::vector<double> heard;
  ours.registerCallback(std::function<void(const Temperature::ConstSharedPtr&)>(
      [&](const Temperature::ConstSharedPtr& message) { heard.push_back(message->temperature); }));
  const auto publisher = agnocast::create_publisher<Temperature>(node, "topic", 10);
  rclcpp::executors::SingleThreadedExecutor executor;
  executor.add_node(node);
  for (const double value : {1.0, 2.0, 3.0}) {
    const std::size_t before = heard.size();
    if (value == 2.0) {
      ours.unsubscribe();
      EXPECT_TRUE(eventually([&] { return publisher->get_subscription_count() == 0; }));
    } else {
      ours.subscribe();
      ASSERT_TRUE(eventually([&] { return publisher->get_subscription_count() == 1; }));
    }
    Temperature message;
    message.temperature = value;
    ASSERT_EQ(publisher->publish(message).code, agnocast::Errc::ok);
    for (int i = 0; i < (value == 2.0 ? 20 : 3000) && heard.size() == before; ++i)
      executor.spin_once(std::chrono::milliseconds(10));
  }
  EXPECT_EQ(heard, (std::vector<double>{1.0, 3.0}));
}

}  // namespace
}  // namespace agnocast_rclcpp
