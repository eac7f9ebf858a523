// SPDX-License-Identifier: Apache-2.0
//
// Goal: the public interface does what its comments say, with a real message type, the real daemon
// and the real heap hook.
// Method: publisher and subscriptions in this process (the hook is linked); the daemon in a
// private directory. client_test.cpp and the tests of the examples cover several processes.

#include <agnocast/agnocast.hpp>
#include <tests/support/messages/error_of.hpp>
#include <tests/support/processes/daemon_process.hpp>
#include <tests/support/processes/plain_node.hpp>
#include <tests/support/processes/spun.hpp>
#include <tests/support/processes/suite_daemon.hpp>

#include <sensor_msgs/msg/point_cloud2.hpp>

#include <gmock/gmock.h>

#include <chrono>
#include <condition_variable>
#include <cstdlib>
#include <ctime>
#include <map>
#include <memory>
#include <mutex>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

namespace agnocast {
namespace {

using test::error_of;
using test::PlainNode;
using Cloud = sensor_msgs::msg::PointCloud2;

/// A look-alike of rclcpp::Node: names resolve through an interface of its own, remappings
/// included.
struct LookAlikeNode : PlainNode {
  struct Topics {
    std::string resolve_topic_name(const std::string& name) const {
      return name == "points" ? "/remapped/points" : "/ns/" + name;
    }
  };
  std::shared_ptr<Topics> get_node_topics_interface() const { return std::make_shared<Topics>(); }
};
/// A look-alike of rclcpp::QoS with rmw's numbers.
struct LookAlikeQos {
  enum class History { SystemDefault = 0, KeepLast = 1, KeepAll = 2 };
  enum class Reliability { Reliable = 1, BestEffort = 2, BestAvailable = 4 };
  enum class Durability { TransientLocal = 1, Volatile = 2, BestAvailable = 4 };
  std::size_t kept = 7;
  History how = History::KeepLast;
  Reliability how_reliable = Reliability::BestEffort;
  Durability how_durable = Durability::TransientLocal;
  std::size_t depth() const { return kept; }
  History history() const { return how; }
  Reliability reliability() const { return how_reliable; }
  Durability durability() const { return how_durable; }
};

/// The calls of an rclcpp::QoS.
struct ToldQos {
  explicit ToldQos(std::size_t told) : depth(told) {}
  ToldQos& keep_all() { return all = true, *this; }
  ToldQos& best_effort() { return reliable = false, *this; }
  ToldQos& transient_local() { return kept = true, *this; }
  std::size_t depth;
  bool all = false, reliable = true, kept = false;
};

/// What an rclcpp::QoS of today has: times, which it takes as an rclcpp::Duration.
class TimedQos {
 public:
  struct Duration {
    template <class Rep, class Period>
    Duration(const std::chrono::duration<Rep, Period>& time)
        : count(std::chrono::nanoseconds(time).count()) {}
    std::int64_t nanoseconds() const { return count; }
    std::int64_t count;
  };
  enum class Liveliness { Automatic = 1, ManualByTopic = 3 };

  explicit TimedQos(std::size_t depth) : depth_(depth) {}
  TimedQos& keep_all() { return *this; }
  TimedQos& best_effort() { return *this; }
  TimedQos& transient_local() { return *this; }
  TimedQos& deadline(const Duration& time) { return deadline_ = time, *this; }
  TimedQos& lifespan(const Duration& time) { return lifespan_ = time, *this; }
  TimedQos& liveliness(Liveliness kind) { return liveliness_ = kind, *this; }
  TimedQos& liveliness_lease_duration(const Duration& time) { return lease_ = time, *this; }
  std::size_t depth() const { return depth_; }
  LookAlikeQos::History history() const { return LookAlikeQos::History::KeepLast; }
  LookAlikeQos::Reliability reliability() const { return LookAlikeQos::Reliability::Reliable; }
  LookAlikeQos::Durability durability() const { return LookAlikeQos::Durability::Volatile; }
  Duration deadline() const { return deadline_; }
  Duration lifespan() const { return lifespan_; }
  Liveliness liveliness() const { return liveliness_; }
  Duration liveliness_lease_duration() const { return lease_; }

 private:
  std::size_t depth_;
  Duration deadline_{std::chrono::nanoseconds::max()}, lifespan_{std::chrono::nanoseconds(0)},
      lease_{std::chrono::nanoseconds::max()};
  Liveliness liveliness_ = Liveliness::Automatic;
};

/// A look-alike of rmw_qos_profile_t with its times.
struct TimedProfile {
  struct Time {
    std::uint64_t sec, nsec;
  };
  LookAlikeQos::History history = LookAlikeQos::History::KeepLast;
  std::size_t depth = 5;
  LookAlikeQos::Reliability reliability = LookAlikeQos::Reliability::Reliable;
  LookAlikeQos::Durability durability = LookAlikeQos::Durability::Volatile;
  Time deadline{0, 0}, lifespan{0, 0};
  TimedQos::Liveliness liveliness = TimedQos::Liveliness::Automatic;
  Time liveliness_lease_duration{0, 0};
};

/// A look-alike of rmw_qos_profile_t.
struct LookAlikeProfile {
  LookAlikeQos::History history;
  std::size_t depth;
  LookAlikeQos::Reliability reliability;
  LookAlikeQos::Durability durability;
  bool avoid_ros_namespace_conventions = false;
};

class Api : public test::SuiteDaemon {
 protected:
  PlainNode node;

  template <class T>
  static ipc_shared_ptr<const T> take_soon(Subscription<T>& subscription) {
    const auto end = std::chrono::steady_clock::now() + std::chrono::minutes(5);
    while (std::chrono::steady_clock::now() < end) {
      if (auto message = subscription.take()) return message;
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }
    return {};
  }
};

void fill(Cloud& cloud, std::uint32_t points) {
  cloud.header.frame_id = "a frame whose name does not fit into a string object";
  cloud.fields.resize(3);
  for (std::size_t i = 0; i < 3; ++i)
    cloud.fields[i].name =
        std::string("field ") + "xyz"[i] + " with a long name that is stored elsewhere";
  cloud.width = points;
  for (std::uint32_t i = 0; i < points * 4; ++i)
    cloud.data.push_back(static_cast<std::uint8_t>(i * 7));
}

TEST_F(Api, ALoanIsTheMessageThatArrives) {
  auto subscription = create_subscription<Cloud>(node, "points", QoS(5));
  auto publisher = create_publisher<Cloud>(&node, "points", 1);
  EXPECT_STREQ(publisher->get_topic_name(), "/ns/points");
  auto loan = publisher->borrow_loaned_message();
  fill(*loan, 5000);
  const void* const address = loan.get();
  const void* const payload = loan->data.data();
  const Cloud copy = *loan;
  auto second_handle = loan;
  const PublishResult result = publisher->publish(std::move(loan));
  ASSERT_TRUE(result) << sentence_of(result.code);
  EXPECT_EQ(result.adopted_bytes, 0u);
  EXPECT_FALSE(second_handle) << "every copy of the handle is empty";
  auto received = take_soon(*subscription);
  ASSERT_TRUE(received);
  EXPECT_EQ(received.get(), address) << "no byte moved";
  EXPECT_EQ(received->data.data(), payload);
  EXPECT_EQ(*received, copy);
  EXPECT_EQ(received.info().sequence, 1u);
  const auto now = std::chrono::duration_cast<std::chrono::nanoseconds>(
                       std::chrono::system_clock::now().time_since_epoch())
                       .count();
  EXPECT_NEAR(static_cast<double>(received.info().source_timestamp()), static_cast<double>(now),
              60e9);
}

TEST_F(Api, ForeignMemoryIsAdoptedAndReported) {
  auto subscription = create_subscription<Cloud>(node, "moved", QoS(5));
  auto publisher = create_publisher<Cloud>(node, "moved", 1);
  std::vector<std::uint8_t> elsewhere(10000, 42);
  auto loan = publisher->borrow_loaned_message();
  // Allocated in the loan's scope it would already be shared.
  std::vector<std::uint8_t> foreign;
  std::thread([&] { foreign.assign(20000, 7); }).join();
  loan->data = std::move(foreign);
  const PublishResult result = publisher->publish(std::move(loan));
  ASSERT_TRUE(result);
  EXPECT_EQ(result.adopted_bytes, 20000u);
  auto received = take_soon(*subscription);
  ASSERT_TRUE(received);
  EXPECT_THAT(received->data, testing::Each(7));
  EXPECT_EQ(received->data.size(), 20000u);

  auto message = std::make_unique<Cloud>();
  message->data = elsewhere;
  const PublishResult adopted = publisher->publish(std::move(message));
  ASSERT_TRUE(adopted);
  EXPECT_EQ(message, nullptr);
  EXPECT_EQ(adopted.adopted_bytes, sizeof(Cloud) + 10000);
  received = take_soon(*subscription);
  ASSERT_TRUE(received);
  EXPECT_EQ(received->data, elsewhere);
}

TEST_F(Api, CallbacksWaitForAnExecutorAndTakeEitherPointer) {
  std::mutex mutex;
  std::condition_variable changed;
  std::vector<std::uint32_t> by_const, by_mutable;
  const auto note = [&](std::vector<std::uint32_t>& list, std::uint32_t width) {
    const std::lock_guard lock(mutex);
    list.push_back(width);
    changed.notify_all();
  };
  auto first = create_subscription<Cloud>(
      node, "called", QoS(10),
      [&](const ipc_shared_ptr<const Cloud>& cloud) { note(by_const, cloud->width); });
  auto second = create_subscription<Cloud>(
      node, "called", QoS(10),
      [&](ipc_shared_ptr<Cloud>&& cloud) { note(by_mutable, cloud->width); });
  auto publisher = create_publisher<Cloud>(node, "called", 1);
  for (std::uint32_t width : {1u, 2u, 3u}) {
    auto loan = publisher->borrow_loaned_message();
    loan->width = width;
    ASSERT_TRUE(publisher->publish(std::move(loan)));
  }
  std::this_thread::sleep_for(std::chrono::milliseconds(50));
  {
    const std::lock_guard lock(mutex);
    EXPECT_TRUE(by_const.empty() && by_mutable.empty());
  }
  BackgroundExecutor executor;
  executor.add_node(node);
  std::unique_lock lock(mutex);
  EXPECT_TRUE(changed.wait_for(lock, std::chrono::minutes(5),
                               [&] { return by_const.size() == 3 && by_mutable.size() == 3; }));
  EXPECT_THAT(by_const, testing::ElementsAre(1, 2, 3));
  EXPECT_THAT(by_mutable, testing::ElementsAre(1, 2, 3));
}

TEST_F(Api, NodesWithCallbacksComeAndGoWithoutLimit) {
  struct NumberedNode : PlainNode {
    explicit NumberedNode(int number) : name("/ns/node" + std::to_string(number)) {}
    std::string name;
    std::string get_fully_qualified_name() const { return name; }
  };
  for (int i = 0; i < 100; ++i) {
    test::Spun<NumberedNode> numbered(i);
    ASSERT_NO_THROW(create_subscription<Cloud>(numbered, "many", QoS(1),
                                               [](const ipc_shared_ptr<const Cloud>&) {}))
        << i;
  }
}

TEST_F(Api, AtTheHoldQuotaACallbackThreadSleepsUntilARelease) {
  std::mutex mutex;
  std::condition_variable changed;
  std::vector<ipc_shared_ptr<const Cloud>> held;
  int reached = 0;
  BackgroundExecutor executor;
  executor.add_node(node);
  auto subscription = create_subscription<Cloud>(
      node, "quota", QoS(10),
      [&](const ipc_shared_ptr<const Cloud>& cloud) {
        const std::lock_guard lock(mutex);
        held.push_back(cloud);
        changed.notify_all();
      },
      SubscriptionOptions().hold_quota(2).hold_quota_callback([&](HoldQuotaInfo& info) {
        const std::lock_guard lock(mutex);
        reached = info.total_count;
        changed.notify_all();
      }));
  auto publisher = create_publisher<Cloud>(node, "quota", 1);
  const auto publish = [&](std::uint32_t width) {
    auto loan = publisher->borrow_loaned_message();
    loan->width = width;
    EXPECT_TRUE(publisher->publish(std::move(loan)));
  };
  for (std::uint32_t width : {1u, 2u, 3u}) publish(width);
  std::unique_lock lock(mutex);
  ASSERT_TRUE(changed.wait_for(lock, std::chrono::minutes(5),
                               [&] { return held.size() == 2 && reached == 1; }));
  // It sleeps instead of polling: the process uses next to no processor time.
  const std::clock_t before = std::clock();
  EXPECT_FALSE(
      changed.wait_for(lock, std::chrono::milliseconds(500), [&] { return held.size() == 3; }));
  EXPECT_LT(std::clock() - before, CLOCKS_PER_SEC / 5);
  ipc_shared_ptr<const Cloud> first = std::move(held.front());
  held.erase(held.begin());
  lock.unlock();
  first.reset();
  lock.lock();
  EXPECT_TRUE(changed.wait_for(lock, std::chrono::minutes(5), [&] { return held.size() == 2; }));
  EXPECT_EQ(held.back()->width, 3u);
  EXPECT_EQ(reached, 1) << "nothing waits";
  publish(4);
  EXPECT_TRUE(changed.wait_for(lock, std::chrono::minutes(5), [&] { return reached == 2; }));
  EXPECT_EQ(subscription->get_hold_quota_status().total_count_change, 2);
  EXPECT_EQ(subscription->get_hold_quota_status().total_count_change, 0);
}

TEST_F(Api, DepthCountsOverAllPublishersOrForEachOne) {
  const QoS qos = QoS(2).transient_local();
  std::vector<Publisher<Cloud>::SharedPtr> publishers;
  const auto publish = [&](std::size_t index, std::uint32_t width) {
    auto loan = publishers[index]->borrow_loaned_message();
    loan->height = static_cast<std::uint32_t>(index);
    loan->width = width;
    ASSERT_TRUE(publishers[index]->publish(std::move(loan)));
  };
  // Returns each publisher's widths, in the order in which they are taken.
  const auto drain = [](Subscription<Cloud>& subscription) {
    std::map<std::uint32_t, std::vector<std::uint32_t>> widths;
    while (const auto cloud = subscription.take()) widths[cloud->height].push_back(cloud->width);
    return widths;
  };
  for (std::size_t i = 0; i < 5; ++i) {
    publishers.push_back(create_publisher<Cloud>(node, "depths", qos));
    for (const std::uint32_t width : {1u, 2u, 3u}) publish(i, width);
  }
  auto together = create_subscription<Cloud>(node, "depths", qos);
  auto each =
      create_subscription<Cloud>(node, "depths", qos, SubscriptionOptions().depth_per_publisher());
  for (const auto& publisher : publishers)
    ASSERT_TRUE(test::eventually([&] { return publisher->get_linked_subscription_count() == 2; }));
  using testing::ElementsAre;
  using testing::Pair;
  EXPECT_THAT(drain(*together), ElementsAre(Pair(4, ElementsAre(2, 3))));
  const auto both = ElementsAre(2, 3);
  EXPECT_THAT(drain(*each), ElementsAre(Pair(0, both), Pair(1, both), Pair(2, both), Pair(3, both),
                                        Pair(4, both)));
  // Later messages of one publisher push out only its own.
  publish(0, 4);
  for (const std::uint32_t width : {5u, 6u, 7u}) publish(1, width);
  EXPECT_THAT(drain(*together), ElementsAre(Pair(1, ElementsAre(6, 7))));
  EXPECT_THAT(drain(*each), ElementsAre(Pair(0, ElementsAre(4)), Pair(1, ElementsAre(6, 7))));
  EXPECT_EQ(each->get_lost_count(), 1u);
}

TEST_F(Api, AHeldMessageOutlivesItsSubscriptionAndItsPublisher) {
  auto subscription = create_subscription<Cloud>(node, "kept", QoS(5));
  auto publisher = create_publisher<Cloud>(node, "kept", 1);
  auto loan = publisher->borrow_loaned_message();
  fill(*loan, 100);
  const Cloud copy = *loan;
  ASSERT_TRUE(publisher->publish(std::move(loan)));
  auto held = take_soon(*subscription);
  ASSERT_TRUE(held);
  subscription.reset();
  publisher.reset();
  std::this_thread::sleep_for(std::chrono::milliseconds(50));
  EXPECT_EQ(*held, copy);
}

TEST_F(Api, LookAlikesOfRclcppFit) {
  LookAlikeNode like;
  auto publisher = create_publisher<Cloud>(like, "points", LookAlikeQos());
  EXPECT_STREQ(publisher->get_topic_name(), "/remapped/points");
  const QoS qos = LookAlikeQos();
  EXPECT_EQ(qos.depth(), 7u);
  EXPECT_FALSE(qos.is_reliable());
  EXPECT_TRUE(qos.is_transient_local());
  EXPECT_FALSE(qos.is_keep_all());
  auto shared = std::make_shared<LookAlikeNode>();
  EXPECT_STREQ(create_publisher<Cloud>(shared, "other", 3)->get_topic_name(), "/ns/other");
}

TEST_F(Api, EndpointsReportTheirQos) {
  const auto publisher =
      create_publisher<Cloud>(node, "reported", QoS(7).best_effort().transient_local());
  const ToldQos told = publisher->get_actual_qos();
  EXPECT_EQ(told.depth, 7u);
  EXPECT_FALSE(told.all);
  EXPECT_FALSE(told.reliable);
  EXPECT_TRUE(told.kept);
  const auto all = create_subscription<Cloud>(node, "reported", QoS(1).keep_all(9).best_effort());
  EXPECT_TRUE(ToldQos(all->get_actual_qos()).all);
  EXPECT_EQ(all->get_actual_qos().depth(), 9u);
  const LookAlikeQos best{7, LookAlikeQos::History::KeepLast,
                          LookAlikeQos::Reliability::BestAvailable};
  EXPECT_TRUE(create_publisher<Cloud>(node, "best", best)->get_actual_qos().is_reliable());
  EXPECT_FALSE(create_subscription<Cloud>(node, "best", best)->get_actual_qos().is_reliable());
}

TEST_F(Api, BestAvailableMatchesAllQos) {
  const LookAlikeQos best{7, LookAlikeQos::History::KeepLast,
                          LookAlikeQos::Reliability::BestAvailable,
                          LookAlikeQos::Durability::BestAvailable};
  EXPECT_FALSE(QoS(best).is_transient_local());
  auto undemanding = create_subscription<Cloud>(node, "best", QoS(best));
  auto publisher = create_publisher<Cloud>(node, "best", QoS(1).best_effort());
  EXPECT_TRUE(test::eventually([&] { return undemanding->get_linked_publisher_count() == 1; }));
  auto demanding = create_subscription<Cloud>(node, "best_too", QoS(1).reliable());
  auto offering = create_publisher<Cloud>(node, "best_too", QoS(best));
  EXPECT_TRUE(test::eventually([&] { return demanding->get_linked_publisher_count() == 1; }));
  auto strict = create_subscription<Cloud>(node, "best", QoS(best).reliable());
  EXPECT_TRUE(test::eventually([&] {
    return strict->get_incompatible_qos_status().total_count == 1;
  })) << "reported afterwards";
}

// rclcpp::KeepAll has depth 0, and so has rclcpp::SystemDefaultsQoS, which Humble makes keep-last.
TEST_F(Api, ARclcppHistoryWithoutADepthHasDepthOne) {
  const LookAlikeQos all{0, LookAlikeQos::History::KeepAll};
  EXPECT_TRUE(QoS(all).is_keep_all());
  EXPECT_EQ(QoS(all).depth(), QoS(1).keep_all().depth());
  EXPECT_EQ(QoS(LookAlikeQos{10, LookAlikeQos::History::KeepAll}).depth(), QoS(all).depth())
      << "keep-all does not use the depth";
  EXPECT_TRUE(try_create_subscription<Cloud>(node, "keep_all", all));
  for (const auto history :
       {LookAlikeQos::History::SystemDefault, LookAlikeQos::History::KeepLast}) {
    const LookAlikeQos defaults{0, history};
    EXPECT_FALSE(QoS(defaults).is_keep_all());
    EXPECT_EQ(QoS(defaults).depth(), 1u);
    EXPECT_TRUE(try_create_subscription<Cloud>(node, "defaults", defaults));
  }
  const auto refused = try_create_subscription<Cloud>(node, "keep_last", QoS(0));
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, Errc::depth_refused);
}

TEST_F(Api, ProfilesOfRmwConvert) {
  const LookAlikeProfile sensor{LookAlikeQos::History::KeepLast, 5,
                                LookAlikeQos::Reliability::BestEffort,
                                LookAlikeQos::Durability::TransientLocal};
  const QoS qos = sensor;
  EXPECT_EQ(qos.depth(), 5u);
  EXPECT_FALSE(qos.is_keep_all());
  EXPECT_FALSE(qos.is_reliable());
  EXPECT_TRUE(qos.is_transient_local());
  const LookAlikeProfile all{LookAlikeQos::History::KeepAll, 0, LookAlikeQos::Reliability::Reliable,
                             LookAlikeQos::Durability::Volatile};
  EXPECT_TRUE(QoS(all).is_keep_all());
  EXPECT_TRUE(QoS(all).is_reliable());
  EXPECT_FALSE(QoS(all).is_transient_local());
  EXPECT_TRUE(try_create_publisher<Cloud>(node, "profile", sensor));
}

TEST_F(Api, TimesOfAQosConvertBothWays) {
  using namespace std::chrono_literals;
  const QoS none = TimedQos(1);
  EXPECT_EQ(none.deadline(), 0ns) << "infinite";
  EXPECT_EQ(none.lifespan(), 0ns);
  EXPECT_EQ(none.liveliness_lease_duration(), 0ns);
  EXPECT_EQ(none.liveliness(), Liveliness::automatic);
  const QoS all = TimedQos(1)
                      .deadline(1ms)
                      .lifespan(2s)
                      .liveliness(TimedQos::Liveliness::ManualByTopic)
                      .liveliness_lease_duration(3h);
  EXPECT_EQ(all.deadline(), 1ms);
  EXPECT_EQ(all.lifespan(), 2s);
  EXPECT_EQ(all.liveliness_lease_duration(), 3h);
  EXPECT_EQ(all.liveliness(), Liveliness::manual_by_topic);
  const TimedQos back = create_publisher<Cloud>(node, "timed", all)->get_actual_qos();
  EXPECT_EQ(back.deadline().nanoseconds(), 1'000'000);
  EXPECT_EQ(back.lifespan().nanoseconds(), 2'000'000'000);
  EXPECT_EQ(back.liveliness_lease_duration().nanoseconds(), 10'800'000'000'000);
  EXPECT_EQ(back.liveliness(), TimedQos::Liveliness::ManualByTopic);
  // RMW_DURATION_INFINITE, and what rmw calls best available.
  for (const std::int64_t unlimited : {INT64_MAX, INT64_MAX - 1}) {
    const std::chrono::nanoseconds time(unlimited);
    const QoS qos = TimedQos(1).deadline(time).lifespan(time).liveliness_lease_duration(time);
    EXPECT_EQ(qos.deadline(), 0ns);
    EXPECT_EQ(qos.lifespan(), 0ns);
    EXPECT_EQ(qos.liveliness_lease_duration(), 0ns);
  }
  const TimedQos infinite = none;
  EXPECT_EQ(infinite.deadline().nanoseconds(), INT64_MAX);
}

TEST_F(Api, TimesOfAProfileConvert) {
  using namespace std::chrono_literals;
  TimedProfile profile;
  profile.deadline = {1, 5};
  profile.lifespan = {9223372036, 854775807};  // RMW_DURATION_INFINITE
  EXPECT_EQ(QoS(profile).deadline(), 1s + 5ns);
  EXPECT_EQ(QoS(profile).lifespan(), 0ns);
  for (const TimedProfile::Time& unlimited :
       {TimedProfile::Time{~std::uint64_t{0}, 0}, TimedProfile::Time{0, ~std::uint64_t{0}},
        TimedProfile::Time{9223372035, INT64_MAX}, TimedProfile::Time{9223372036, 854775806}}) {
    profile.deadline = unlimited;
    EXPECT_EQ(QoS(profile).deadline(), 0ns) << unlimited.sec << " s " << unlimited.nsec;
  }
  profile.deadline = {0, 1'500'000'000};
  EXPECT_EQ(QoS(profile).deadline(), 1500ms);
  profile.liveliness = TimedQos::Liveliness::ManualByTopic;
  EXPECT_EQ(QoS(profile).liveliness(), Liveliness::manual_by_topic);
}

/// Throws as rclcpp does for a wrong name, in both forms.
struct RefusingTopics {
  std::string resolve_topic_name(const std::string& name) const {
    throw std::runtime_error("Invalid topic name: " + name);
  }
};
struct RefusingInterface : PlainNode {
  std::shared_ptr<RefusingTopics> get_node_topics_interface() const {
    return std::make_shared<RefusingTopics>();
  }
};
struct RefusingNode : PlainNode, RefusingTopics {};

TEST_F(Api, AnExceptionOfANodeAboutANameIsAnOrdinaryFailure) {
  const auto by_interface = try_create_publisher<Cloud>(RefusingInterface(), "a b", QoS(1));
  ASSERT_FALSE(by_interface);
  EXPECT_EQ(by_interface.error().code, Errc::invalid_name);
  EXPECT_THAT(text_of(by_interface.error()), testing::HasSubstr("Invalid topic name: a b"));
  const auto by_node = try_create_subscription<Cloud>(RefusingNode(), "a b", QoS(1));
  ASSERT_FALSE(by_node);
  EXPECT_THAT(text_of(by_node.error()), testing::HasSubstr("Invalid topic name: a b"));
}

TEST_F(Api, AnEndedPublisherIsNotCountedAlthoughItsMessagesRemain) {
  auto subscription = create_subscription<Cloud>(node, "gone", QoS(5));
  auto publisher = create_publisher<Cloud>(node, "gone", 1);
  ASSERT_TRUE(publisher->publish(publisher->borrow_loaned_message()));
  ASSERT_TRUE(test::eventually([&] { return subscription->get_linked_publisher_count() == 1; }));
  publisher.reset();
  EXPECT_TRUE(test::eventually([&] { return subscription->get_linked_publisher_count() == 0; }));
  EXPECT_TRUE(take_soon(*subscription));
}

TEST_F(Api, MisuseIsReported) {
  EXPECT_THAT(error_of([&] {
                create_subscription<Cloud>(node, "none", QoS(1),
                                           SubscriptionOptions().hold_quota(0));
              }),
              testing::HasSubstr("hold quota of 0"));
  EXPECT_THAT(error_of([&] { create_publisher<Cloud>(node, "/a//b", 1); }),
              testing::HasSubstr(sentence_of(Errc::invalid_name)));
  auto publisher = create_publisher<Cloud>(node, "/typed", 1);
  EXPECT_THAT(
      error_of([&] { create_subscription<sensor_msgs::msg::PointField>(node, "/typed", QoS(1)); }),
      testing::AllOf(testing::HasSubstr(sentence_of(Errc::type_mismatch)),
                     testing::HasSubstr("sensor_msgs/msg/PointField (layout 0x"),
                     testing::HasSubstr("sensor_msgs/msg/PointCloud2 (layout 0x")));
  auto other = create_publisher<Cloud>(node, "/other", 1);
  auto loan = other->borrow_loaned_message();
  EXPECT_EQ(publisher->publish(std::move(loan)).code, Errc::loan_invalid)
      << "a loan of another publisher";
  EXPECT_TRUE(loan) << "the caller still has it";
  EXPECT_TRUE(other->publish(std::move(loan)));
  EXPECT_EQ(other->publish(std::move(loan)).code, Errc::loan_invalid) << "it is already published";
  EXPECT_EQ(other->publish(std::unique_ptr<Cloud>()).code, Errc::loan_invalid);
}

}  // namespace
}  // namespace agnocast
