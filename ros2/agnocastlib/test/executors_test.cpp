// SPDX-License-Identifier: Apache-2.0
//
// Goal: every executor of the package runs the callbacks of both kinds, and the callback-isolated
// one has a thread for each group, whenever that is created, added or removed.

#include "common.hpp"

#include <algorithm>
#include <atomic>
#include <functional>
#include <future>
#include <set>
#include <stdexcept>

namespace agnocastlib {
namespace {

/// A subscription of each kind and a timer, and what they have heard.
class Both {
 public:
  explicit Both(rclcpp::Node& node, const std::string& name = "both",
                const rclcpp::CallbackGroup::SharedPtr& group = nullptr) {
    agnocast::SubscriptionOptions options;
    options.callback_group = group;
    ours_ = agnocast::create_subscription<String>(
        &node, name + "/ours", 10, [this](const Message&) { ++ours; }, options);
    rclcpp::SubscriptionOptions ros_options;
    ros_options.callback_group = group;
    theirs_ = node.rclcpp::Node::create_subscription<String>(
        name + "/theirs", 10, [this](const String&) { ++theirs; }, ros_options);
    to_ours_ = agnocast::create_publisher<String>(&node, name + "/ours", 10);
    to_theirs_ = node.rclcpp::Node::create_publisher<String>(name + "/theirs", 10);
    EXPECT_TRUE(eventually([&] {
      return to_ours_->get_linked_subscription_count() == 1 &&
             to_theirs_->get_subscription_count() == 1;
    }));
  }
  /// Publishes on both until both have heard something new.
  [[nodiscard]] bool hears() {
    const int ours_before = ours, theirs_before = theirs;
    return eventually([&] {
      publish(*to_ours_, "text");
      to_theirs_->publish(String());
      std::this_thread::sleep_for(5ms);
      return ours > ours_before && theirs > theirs_before;
    });
  }

  std::atomic<int> ours{0}, theirs{0};

 private:
  agnocast::Publisher<String>::SharedPtr to_ours_;
  rclcpp::Publisher<String>::SharedPtr to_theirs_;
  agnocast::Subscription<String>::SharedPtr ours_;
  rclcpp::Subscription<String>::SharedPtr theirs_;
};

template <class Executor>
class Executors : public AgnocastTest {};
using Kinds = testing::Types<
    agnocast::SingleThreadedAgnocastExecutor, agnocast::MultiThreadedAgnocastExecutor,
    agnocast::CallbackIsolatedAgnocastExecutor, agnocast::AgnocastOnlySingleThreadedExecutor,
    agnocast::AgnocastOnlyMultiThreadedExecutor, agnocast::AgnocastOnlyCallbackIsolatedExecutor>;
TYPED_TEST_SUITE(Executors, Kinds);

TYPED_TEST(Executors, RunCallbacksOfBothKinds) {
  const auto node = std::make_shared<agnocast::Node>("node");
  TypeParam executor;
  executor.add_node(node->get_node_base_interface());
  Both both(*node);
  const Spinning spinning(executor);
  EXPECT_TRUE(both.hears());
}

TYPED_TEST(Executors, FindGroupsThatAreCreatedWhileTheySpin) {
  const auto node = std::make_shared<agnocast::Node>("node");
  TypeParam executor;
  executor.add_node(node);
  const Spinning spinning(executor);
  Both first(*node);
  EXPECT_TRUE(first.hears());
  const auto group = node->create_callback_group(rclcpp::CallbackGroupType::MutuallyExclusive);
  Both second(*node, "second", group);
  EXPECT_TRUE(second.hears());
  Both third(*node, "third", group);  // a later subscription of a group that is served
  EXPECT_TRUE(third.hears());
}

TYPED_TEST(Executors, EndAtShutdown) {
  const auto node = std::make_shared<agnocast::Node>("node");
  TypeParam executor;
  executor.add_node(node);
  std::thread spinning([&] { executor.spin(); });
  Both both(*node);
  EXPECT_TRUE(both.hears());
  agnocast::shutdown();
  spinning.join();
}

TYPED_TEST(Executors, AreCancelledInsideACallback) {
  const auto node = std::make_shared<agnocast::Node>("node");
  TypeParam executor;
  executor.add_node(node);
  const auto timer = node->create_wall_timer(1ms, [&] { executor.cancel(); });
  executor.spin();
}

TYPED_TEST(Executors, RemoveNodes) {
  const auto node = std::make_shared<agnocast::Node>("node");
  auto executor = std::make_unique<TypeParam>();
  executor->add_node(node);
  Both both(*node);
  {
    const Spinning spinning(*executor);
    EXPECT_TRUE(both.hears());
    executor->remove_node(node);
  }
  EXPECT_TRUE(executor->get_all_callback_groups().empty());
  // Jazzy's executors drop the entities of a removed node when they wait again, or end; until
  // then another one throws: "subscription already associated with a wait set".
  executor.reset();
  TypeParam other;
  other.add_node(node);
  const Spinning spinning(other);
  EXPECT_TRUE(both.hears());
}

TYPED_TEST(Executors, NodesWithSeveralGroupsMayEndAfterTheyWereRemoved) {
  const auto other = std::make_shared<agnocast::Node>("other");
  TypeParam executor;
  executor.add_node(other);
  Both both(*other);
  const Spinning spinning(executor);
  for (int i = 0; i < 5; ++i) {
    auto node = std::make_shared<agnocast::Node>("node");
    auto group = node->create_callback_group(rclcpp::CallbackGroupType::MutuallyExclusive);
    auto theirs = node->create_callback_group(rclcpp::CallbackGroupType::MutuallyExclusive);
    auto in_group = std::make_unique<Both>(*node, "in_group", group);
    auto in_default = std::make_unique<Both>(*node, "in_default");
    executor.add_node(node);
    EXPECT_TRUE(in_group->hears());
    EXPECT_TRUE(in_default->hears());
    executor.remove_node(node);
    in_group.reset();
    in_default.reset();
    group.reset();
    theirs.reset();
    node.reset();
    EXPECT_TRUE(both.hears());
  }
}

using CallbackIsolated = AgnocastTest;

TEST_F(CallbackIsolated, ABlockedGroupBlocksNoOther) {
  const auto node = std::make_shared<rclcpp::Node>("node");
  const auto blocked = node->create_callback_group(rclcpp::CallbackGroupType::MutuallyExclusive);
  std::promise<void> may_end;
  auto end = may_end.get_future().share();
  std::atomic<bool> is_blocked{false};
  const auto timer = node->create_wall_timer(
      1ms,
      [&] {
        is_blocked = true;
        end.wait();
      },
      blocked);
  agnocast::CallbackIsolatedAgnocastExecutor executor;
  executor.add_node(node);
  Both both(*node);
  {
    const Spinning spinning(executor);
    EXPECT_TRUE(eventually([&] { return is_blocked.load(); }));
    EXPECT_TRUE(both.hears());
    may_end.set_value();
  }
}

TEST_F(CallbackIsolated, EachGroupHasOneThread) {
  const auto node = std::make_shared<rclcpp::Node>("node");
  std::mutex mutex;
  std::vector<std::set<std::thread::id>> threads(4);
  std::atomic<int> calls{0};
  std::vector<rclcpp::CallbackGroup::SharedPtr> groups;
  std::vector<rclcpp::TimerBase::SharedPtr> timers;
  for (auto& of_group : threads) {
    groups.push_back(node->create_callback_group(rclcpp::CallbackGroupType::Reentrant));
    for (int i = 0; i < 2; ++i)
      timers.push_back(node->create_wall_timer(
          1ms,
          [&] {
            const std::lock_guard lock(mutex);
            of_group.insert(std::this_thread::get_id());
            ++calls;
          },
          groups.back()));
  }
  agnocast::CallbackIsolatedAgnocastExecutor executor;
  executor.add_node(node);
  {
    const Spinning spinning(executor);
    EXPECT_TRUE(eventually([&] {
      const std::lock_guard lock(mutex);
      return calls > 400 && std::none_of(threads.begin(), threads.end(),
                                         [](const auto& ids) { return ids.empty(); });
    }));
  }
  std::set<std::thread::id> all;
  for (const auto& of_group : threads) {
    EXPECT_EQ(of_group.size(), 1u);
    all.insert(of_group.begin(), of_group.end());
  }
  EXPECT_EQ(all.size(), threads.size());
}

TEST_F(CallbackIsolated, AnExceptionLeavesTheSpin) {
  const auto node = std::make_shared<rclcpp::Node>("node");
  std::atomic<int> calls{0};
  const auto timer = node->create_wall_timer(1ms, [&] {
    if (++calls == 1) throw std::runtime_error("from a callback");
  });
  agnocast::CallbackIsolatedAgnocastExecutor executor;
  executor.add_node(node);
  EXPECT_THROW(executor.spin(), std::runtime_error);
  EXPECT_EQ(calls, 1);
  const Spinning again(executor);
  EXPECT_TRUE(eventually([&] { return calls > 1; }));
}

TEST_F(CallbackIsolated, GroupsAreAddedAndRemovedByThemselves) {
  const auto node = std::make_shared<rclcpp::Node>("node");
  const auto group =
      node->create_callback_group(rclcpp::CallbackGroupType::MutuallyExclusive, false);
  Both alone(*node, "alone", group);
  Both rest(*node, "rest");
  agnocast::CallbackIsolatedAgnocastExecutor executor;
  executor.add_node(node);
  const Spinning spinning(executor);
  EXPECT_TRUE(rest.hears());
  EXPECT_EQ(alone.ours, 0) << "it is in no executor";
  executor.add_callback_group(group, node->get_node_base_interface());
  EXPECT_TRUE(alone.hears());
  EXPECT_EQ(executor.get_manually_added_callback_groups().size(), 1u);
  executor.remove_callback_group(group);
  const int heard = alone.ours;
  EXPECT_TRUE(rest.hears());
  EXPECT_EQ(alone.ours, heard);
  EXPECT_THROW(executor.remove_callback_group(group), std::runtime_error);
}

TEST_F(CallbackIsolated, NodesAreAddedAndRemovedInsideCallbacks) {
  const auto manager = std::make_shared<rclcpp::Node>("manager");
  const auto node = std::make_shared<rclcpp::Node>("node");
  Both both(*node);
  agnocast::CallbackIsolatedAgnocastExecutor executor;
  std::atomic<int> rounds{0};
  const auto timer = manager->create_wall_timer(1ms, [&] {
    if (rounds == 20) return;
    executor.add_node(node);
    executor.remove_node(node);
    ++rounds;
  });
  executor.add_node(manager);
  const Spinning spinning(executor);
  EXPECT_TRUE(eventually([&] { return rounds == 20; }));
  executor.add_node(node);
  EXPECT_THROW(executor.add_node(node), std::runtime_error);
  EXPECT_TRUE(both.hears());
}

// The thread that ends the others must not wait for the manager's, which waits for the node's.
TEST_F(CallbackIsolated, ACallbackOfARemovedNodeMayRemoveAnother) {
  const auto manager = std::make_shared<rclcpp::Node>("manager");
  const auto node = std::make_shared<rclcpp::Node>("node");
  agnocast::CallbackIsolatedAgnocastExecutor executor;
  std::atomic<bool> is_removed{false};
  rclcpp::TimerBase::SharedPtr timer = manager->create_wall_timer(1ms, [&] {
    timer->cancel();
    executor.remove_node(manager);
    std::this_thread::sleep_for(50ms);  // for the executor to notice
    executor.remove_node(node);
    is_removed = true;
  });
  executor.add_node(manager);
  executor.add_node(node);
  const Spinning spinning(executor);
  EXPECT_TRUE(eventually([&] { return is_removed.load(); }));
}

TEST_F(CallbackIsolated, ANodeIsRemovedWhileTheSpinEnds) {
  const auto manager = std::make_shared<rclcpp::Node>("manager");
  const auto node = std::make_shared<rclcpp::Node>("node");
  agnocast::CallbackIsolatedAgnocastExecutor executor;
  rclcpp::TimerBase::SharedPtr timer = manager->create_wall_timer(1ms, [&] {
    timer->cancel();
    executor.cancel();
    std::this_thread::sleep_for(50ms);
    executor.remove_node(node);
  });
  executor.add_node(manager);
  executor.add_node(node);
  executor.spin();
  EXPECT_THROW(executor.remove_node(node), std::runtime_error) << "it was removed";
}

/// As rclcpp::on_shutdown(), until the end of the scope.
class OnShutdown {
 public:
  explicit OnShutdown(std::function<void()> callback)
      : handle_(context_->add_on_shutdown_callback(std::move(callback))) {}
  ~OnShutdown() { context_->remove_on_shutdown_callback(handle_); }

 private:
  const rclcpp::Context::SharedPtr context_ = rclcpp::contexts::get_global_default_context();
  const rclcpp::OnShutdownCallbackHandle handle_;
};

// rclcpp::shutdown() holds a lock while it calls the function, which ~Executor needs. The function
// gives the executor the time to end its threads before it calls cancel().
TEST_F(CallbackIsolated, IsCancelledWhenTheContextIsShutDown) {
  const auto node = std::make_shared<rclcpp::Node>("node");
  agnocast::CallbackIsolatedAgnocastExecutor executor(rclcpp::ExecutorOptions(), 50, 1);
  std::atomic<int> calls{0};
  const auto timer = node->create_wall_timer(1ms, [&] { ++calls; });
  const OnShutdown cancelling([&] {
    std::this_thread::sleep_for(300ms);
    executor.cancel();
  });
  executor.add_node(node);
  std::thread spinning([&] { EXPECT_NO_THROW(executor.spin()); });
  EXPECT_TRUE(eventually([&] { return calls > 0; }));
  rclcpp::shutdown();
  spinning.join();
}

// rclcpp holds a mutex meanwhile that the destructor of an executor wants.
TEST_F(CallbackIsolated, ShutdownMayWaitForTheSpin) {
  const auto node = std::make_shared<rclcpp::Node>("node");
  agnocast::CallbackIsolatedAgnocastExecutor executor(rclcpp::ExecutorOptions(), 50, 1);
  std::atomic<int> calls{0};
  const auto timer = node->create_wall_timer(1ms, [&] { ++calls; });
  executor.add_node(node);
  std::thread spinning([&] { EXPECT_NO_THROW(executor.spin()); });
  const OnShutdown waiting([&] {
    executor.cancel();
    spinning.join();
  });
  EXPECT_TRUE(eventually([&] { return calls > 0; }));
  rclcpp::shutdown();
}

// The executor makes and ends threads all the time.
TEST_F(CallbackIsolated, ShutdownWhileNodesComeAndGoLeavesNoException) {
  const auto node = std::make_shared<rclcpp::Node>("node");
  agnocast::CallbackIsolatedAgnocastExecutor executor(rclcpp::ExecutorOptions(), 50, 1);
  const OnShutdown cancelling([&] { executor.cancel(); });
  std::thread spinning([&] { EXPECT_NO_THROW(executor.spin()); });
  std::atomic<bool> is_over{false};
  std::atomic<int> rounds{0};
  std::thread changing([&] {
    for (; !is_over; ++rounds) {
      executor.add_node(node);
      std::this_thread::sleep_for(2ms);
      executor.remove_node(node);
    }
  });
  EXPECT_TRUE(eventually([&] { return rounds > 20; }));
  rclcpp::shutdown();
  spinning.join();
  is_over = true;
  changing.join();
}

TEST_F(CallbackIsolated, RefusesToRunSingleCallbacks) {
  agnocast::CallbackIsolatedAgnocastExecutor executor;
  EXPECT_THROW(executor.spin_once(0ms), std::logic_error);
  EXPECT_THROW(executor.spin_some(), std::logic_error);
  EXPECT_THROW(executor.spin_all(1ms), std::logic_error);
  std::promise<void> never;
  EXPECT_THROW(executor.spin_until_future_complete(never.get_future(), 10ms), std::logic_error);
}

TEST_F(AgnocastTest, TheThreadsOfTheMultiThreadedExecutorAddUp) {
  agnocast::MultiThreadedAgnocastExecutor executor(rclcpp::ExecutorOptions(), 1, 2);
  EXPECT_EQ(executor.get_number_of_threads(), 3u);
}

}  // namespace
}  // namespace agnocastlib
