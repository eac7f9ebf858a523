// SPDX-License-Identifier: Apache-2.0
//
// Goal: executors run the callbacks of their nodes, all of them once, in a fair order and in the
// thread that spins, while nodes move between executors; nothing runs without one.
// Method: executor_fixture.hpp. tests/threads/executor_threads_test.cpp covers the moves under
// ThreadSanitizer; callback_group_test.cpp has the groups and the executors with several threads.

#include <tests/integration/client/executors/executor_fixture.hpp>
#include <tests/support/processes/child.hpp>

#include <poll.h>
#include <signal.h>

#include <gmock/gmock.h>

#include <atomic>
#include <chrono>
#include <cstdint>
#include <future>
#include <memory>
#include <stdexcept>
#include <string>
#include <thread>
#include <type_traits>
#include <utility>
#include <vector>

namespace agnocast {
namespace {

using test::SecondProcess;

static_assert(std::has_virtual_destructor_v<Executor>, "may be held by pointers to the base");

class Executors : public ExecutorFixture {};

std::vector<std::uint64_t> up_to(std::uint64_t last) {
  std::vector<std::uint64_t> values;
  for (std::uint64_t value = 1; value <= last; ++value) values.push_back(value);
  return values;
}

TEST_F(Executors, NothingRunsUntilAnExecutorThatHasTheNodeSpins) {
  Node node(own("node"));
  Seen seen;
  std::atomic<int> events{0};
  auto subscription = node.create_subscription<Number>(
      own("topic"), 10, [&](const Message& number) { seen.add(number->value); },
      SubscriptionOptions().matched_callback([&](MatchedInfo&) { ++events; }));
  auto publisher = node.create_publisher<Number>(own("topic"), 10);
  ASSERT_TRUE(eventually([&] { return subscription->get_linked_publisher_count() == 1; }));
  for (std::uint64_t value = 1; value <= 3; ++value) publish(*publisher, value);
  BackgroundExecutor other;
  SingleThreadedExecutor executor;
  std::this_thread::sleep_for(50ms);
  executor.add_node(node);
  std::this_thread::sleep_for(50ms);
  EXPECT_EQ(seen.count(), 0u);
  EXPECT_EQ(events, 0);
  executor.spin_all(0s);
  EXPECT_EQ(seen.values, up_to(3)) << "unread messages wait";
  EXPECT_EQ(events, 1);
  EXPECT_THAT(seen.threads, testing::Each(std::this_thread::get_id()));
  executor.remove_node(node);
  publish(*publisher, 4);
  executor.spin_all(0s);
  std::this_thread::sleep_for(50ms);
  EXPECT_EQ(seen.count(), 3u);
  other.add_node(node);
  EXPECT_TRUE(eventually([&] { return seen.count() == 4; }));
}

TEST_F(Executors, SpinRunsCallbacksInItsThreadUntilCancelled) {
  Node node(own("node"));
  Seen seen;
  auto subscription =
      node.create_subscription<Number>(own("topic"), test::qos_of("100rva"),
                                       [&](const Message& number) { seen.add(number->value); });
  SingleThreadedExecutor executor;
  executor.add_node(node);
  std::thread spinner([&] { executor.spin(); });
  const std::thread::id id = spinner.get_id();
  SecondProcess publisher({"publish", own("topic"), "100rva", "300"});
  EXPECT_TRUE(eventually([&] { return seen.count() == 300; })) << seen.count();
  EXPECT_TRUE(executor.is_spinning());
  executor.cancel();
  spinner.join();
  EXPECT_FALSE(executor.is_spinning());
  EXPECT_EQ(seen.values, up_to(300));
  EXPECT_THAT(seen.threads, testing::Each(id));
}

TEST_F(Executors, ACancelBeforeSpinEndsIt) {
  SingleThreadedExecutor executor;
  executor.cancel();
  executor.spin();
  SpinningExecutor spinning(SpinningExecutor::forever);
  spinning.cancel();
  spinning.spin();
}

// A caller of cancel() wants an end: a function that ends at that moment anyway must not swallow
// it.
TEST_F(Executors, ACancelDuringTheLastCallbackAppliesToTheNextSpin) {
  Node node(own("node"));
  Seen seen;
  SingleThreadedExecutor executor;
  executor.add_node(node);
  auto subscription =
      node.create_subscription<Number>(own("topic"), 10, [&](const Message& number) {
        seen.add(number->value);
        executor.cancel();
      });
  auto publisher = node.create_publisher<Number>(own("topic"), 10);
  ASSERT_TRUE(eventually([&] { return subscription->get_linked_publisher_count() == 1; }));
  for (std::uint64_t value = 1; value <= 4; ++value) publish(*publisher, value);
  executor.spin_once();
  executor.spin();
  EXPECT_EQ(seen.values, up_to(1));
  EXPECT_EQ(executor.dispatch(), 1u);
  EXPECT_EQ(executor.dispatch(), 0u);
  EXPECT_EQ(seen.values, up_to(2));
  executor.spin_all(0s);
  executor.spin();
  EXPECT_EQ(seen.values, up_to(4)) << "these were ended, and the cancel is used up";
}

SingleThreadedExecutor* signalled = nullptr;

TEST_F(Executors, ASignalHandlerMayCancel) {
  SingleThreadedExecutor executor;
  signalled = &executor;
  struct sigaction action = {}, before = {};
  action.sa_handler = [](int) { signalled->cancel(); };
  ASSERT_EQ(::sigaction(SIGUSR1, &action, &before), 0);
  std::thread other([&] {
    EXPECT_TRUE(eventually([&] { return executor.is_spinning(); }));
    ::kill(::getpid(), SIGUSR1);
  });
  executor.spin();
  other.join();
  ::sigaction(SIGUSR1, &before, nullptr);
}

// The node moves between three spinning executors, one of them a background executor, and a fourth
// one that is made and destroyed, while a publisher in another process sends at full speed.
// keep-all: every message must arrive.
TEST_F(Executors, NothingIsLostOrDoubledOrOvertakenWhileANodeMoves) {
  constexpr std::uint64_t count = 30000;
  Node node(own("node")), other(own("other"));
  Seen seen;
  std::atomic<int> inside{0}, overlaps{0};
  auto subscription = node.create_subscription<Number>(own("topic"), test::qos_of("100rva"),
                                                       [&](const Message& number) {
                                                         if (inside.fetch_add(1) != 0) ++overlaps;
                                                         seen.add(number->value);
                                                         --inside;
                                                       });
  auto second = other.create_subscription<Number>(own("nothing"), 1, [](const Message&) {});
  SingleThreadedExecutor sleeping;
  BackgroundExecutor background;
  SpinningExecutor spinning(100us);
  Executor* const executors[] = {&sleeping, &background, &spinning};
  sleeping.add_node(other);
  std::thread one([&] { sleeping.spin(); }), two([&] { spinning.spin(); });
  SecondProcess publisher({"publish", own("topic"), "100rva", std::to_string(count)});
  std::uint64_t moves = 0;
  EXPECT_TRUE(eventually([&] {
    for (int i = 0; i < 10; ++i) {
      for (int stay = 0; stay < 3; ++stay) {
        executors[stay]->add_node(node);
        if (i % 3 == stay) std::this_thread::sleep_for(300us);
        executors[stay]->remove_node(node);
      }
      {
        SingleThreadedExecutor passing;
        passing.add_node(node);
        passing.spin_some();
      }
      ++moves;
    }
    return seen.count() >= count;
  })) << seen.count()
      << " after " << moves << " rounds";
  sleeping.cancel();
  spinning.cancel();
  one.join();
  two.join();
  subscription.reset();
  EXPECT_EQ(overlaps, 0);
  EXPECT_EQ(seen.values.size(), count);
  EXPECT_TRUE(seen.values == up_to(count));
  EXPECT_GT(moves, 10u);
}

// Both sleep when the node moves: the last message before and the first one after a move must wake
// the right executor.
TEST_F(Executors, ANewExecutorIsWokenByMessagesAfterTheMove) {
  Node node(own("node"));
  Seen seen;
  auto subscription = node.create_subscription<Number>(
      own("topic"), 10, [&](const Message& number) { seen.add(number->value); });
  auto publisher = node.create_publisher<Number>(own("topic"), 10);
  BackgroundExecutor background;
  SingleThreadedExecutor executor;
  Executor *from = &background, *to = &executor;
  from->add_node(node);
  std::thread spinner([&] { executor.spin(); });
  for (std::uint64_t value = 1; value <= 40; ++value) {
    publish(*publisher, value);
    ASSERT_TRUE(eventually([&] { return seen.count() == value; })) << value;
    from->remove_node(node);
    to->add_node(node);
    std::swap(from, to);
  }
  const std::thread::id id = spinner.get_id();
  executor.cancel();
  spinner.join();
  for (std::size_t i = 0; i < 40; ++i) EXPECT_EQ(seen.threads[i] == id, i % 2 == 1) << i;
}

TEST_F(Executors, EachSubscriptionRunsInEachCycle) {
  Node fast(own("fast")), slow(own("slow"));
  std::string order;
  SingleThreadedExecutor executor;
  executor.add_node(fast);
  executor.add_node(slow);
  auto a = fast.create_subscription<Number>(own("a"), 10, [&](const Message&) { order += 'a'; });
  auto b = fast.create_subscription<Number>(own("b"), 10, [&](const Message&) { order += 'b'; });
  auto c = slow.create_subscription<Number>(own("c"), 10, [&](const Message&) { order += 'c'; });
  auto to_a = fast.create_publisher<Number>(own("a"), 10);
  auto to_b = fast.create_publisher<Number>(own("b"), 10);
  auto to_c = fast.create_publisher<Number>(own("c"), 10);
  for (auto* publisher : {&to_a, &to_b, &to_c})
    ASSERT_TRUE(eventually([&] { return (*publisher)->get_linked_subscription_count() == 1; }));
  for (auto* subscription : {&a, &b, &c})
    ASSERT_TRUE(eventually([&] { return (*subscription)->get_linked_publisher_count() == 1; }));
  for (std::uint64_t value = 1; value <= 4; ++value) publish(*to_a, value);
  for (std::uint64_t value = 1; value <= 2; ++value) publish(*to_b, value);
  for (std::uint64_t value = 1; value <= 3; ++value) publish(*to_c, value);
  EXPECT_EQ(order, "") << "nothing runs until the executor spins";
  executor.spin_once();
  executor.spin_once();
  EXPECT_EQ(order, "ab") << "one callback each";
  executor.spin_some();
  EXPECT_EQ(order, "abc") << "the rest of the cycle";
  executor.spin_some();
  EXPECT_EQ(order, "abcabc");
  executor.spin_all(0s);
  EXPECT_EQ(order, "abcabcaca");
  executor.spin_some();
  executor.spin_once(1ms);
  EXPECT_EQ(order.size(), 9u);
}

TEST_F(Executors, AnExceptionLeavesSpinAndTheExecutorGoesOn) {
  Node node(own("node"));
  Seen seen;
  auto subscription =
      node.create_subscription<Number>(own("topic"), 10, [&](const Message& number) {
        seen.add(number->value);
        if (number->value % 2 == 1) throw std::runtime_error(std::to_string(number->value));
      });
  auto publisher = node.create_publisher<Number>(own("topic"), 10);
  SingleThreadedExecutor executor;
  executor.add_node(node);
  for (std::uint64_t value = 1; value <= 4; ++value) publish(*publisher, value);
  for (const char* number : {"1", "3"}) {
    try {
      executor.spin();
      ADD_FAILURE() << "spin returned";
    } catch (const std::runtime_error& error) {
      EXPECT_STREQ(error.what(), number);
    }
    EXPECT_FALSE(executor.is_spinning());
  }
  executor.spin_once();
  EXPECT_EQ(seen.values, up_to(4));
  EXPECT_EQ(subscription->get_callback_exception_count(), 0u) << "the caller got them";

  executor.remove_node(node);
  BackgroundExecutor background;
  background.add_node(node);
  for (std::uint64_t value = 5; value <= 8; ++value) publish(*publisher, value);
  EXPECT_TRUE(eventually([&] { return seen.count() == 8; }))
      << "the library's thread survives them";
  EXPECT_TRUE(eventually([&] { return subscription->get_callback_exception_count() == 2; }));
}

TEST_F(Executors, AUsersOwnLoopPollsAndDispatches) {
  Node node(own("node"));
  Seen seen;
  auto subscription = node.create_subscription<Number>(
      own("topic"), test::qos_of("20rva"), [&](const Message& number) { seen.add(number->value); });
  SingleThreadedExecutor executor;
  executor.add_node(node);
  SecondProcess publisher({"publish", own("topic"), "20rva", "500"});
  ASSERT_TRUE(eventually([&] {
    for (int i = 0; i < 100 && seen.count() < 500; ++i) {
      if (executor.prepare() == Executor::Readiness::armed) {
        pollfd readable{executor.fd(), POLLIN, 0};
        ::poll(&readable, 1, -1);
      }
      executor.dispatch();
    }
    return seen.count() == 500;
  })) << seen.count();
  EXPECT_EQ(seen.values, up_to(500));

  // No message arrives: the descriptor must not stay readable (that would be a busy loop).
  std::uint64_t silent = 0;
  for (int i = 0; i < 10; ++i) {
    ASSERT_EQ(executor.prepare(), Executor::Readiness::armed);
    pollfd readable{executor.fd(), POLLIN, 0};
    silent += ::poll(&readable, 1, 20) == 0;
    EXPECT_EQ(executor.dispatch(), 0u);
  }
  EXPECT_GE(silent, 5u);
  // Nor may a wait last for ever when nobody rings: not the first, and not a later one.
  for (int i = 0; i < 3; ++i) {
    ASSERT_EQ(executor.prepare(), Executor::Readiness::armed);
    pollfd ticking{executor.fd(), POLLIN, 0};
    EXPECT_EQ(::poll(&ticking, 1, 10000), 1) << i;
    EXPECT_EQ(executor.dispatch(), 0u);
  }
  executor.spin_once(1500ms);  // so it has an end
  executor.cancel();
  pollfd readable{executor.fd(), POLLIN, 0};
  EXPECT_EQ(::poll(&readable, 1, 10000), 1) << "cancel ends the poll";
  EXPECT_EQ(executor.dispatch(), 0u);
}

TEST_F(Executors, ASpinningExecutorGetsEveryMessageWithAnyBudget) {
  for (const std::chrono::nanoseconds budget :
       {std::chrono::nanoseconds(50us), SpinningExecutor::forever}) {
    Node node(own("node"));
    const std::string topic =
        own("topic") + (budget == SpinningExecutor::forever ? "_forever" : "");
    Seen seen;
    auto subscription = node.create_subscription<Number>(
        topic, test::qos_of("20rva"), [&](const Message& number) { seen.add(number->value); });
    SpinningExecutor executor(budget);
    executor.add_node(node);
    std::thread spinner([&] { executor.spin(); });
    SecondProcess publisher({"publish", topic, "20rva", "500"});
    EXPECT_TRUE(eventually([&] { return seen.count() == 500; })) << seen.count();
    executor.cancel();
    spinner.join();
    EXPECT_EQ(seen.values, up_to(500));
  }
}

TEST_F(Executors, SpinUntilFutureCompleteEndsWithTheFuture) {
  Node node(own("node"));
  std::promise<std::uint64_t> first;
  auto subscription = node.create_subscription<Number>(
      own("topic"), 10, [&](const Message& number) { first.set_value(number->value); });
  auto publisher = node.create_publisher<Number>(own("topic"), 10);
  SingleThreadedExecutor executor;
  executor.add_node(node);
  auto future = first.get_future();
  EXPECT_EQ(executor.spin_until_future_complete(future, 1ms), FutureReturnCode::TIMEOUT);
  executor.cancel();
  EXPECT_EQ(executor.spin_until_future_complete(future), FutureReturnCode::INTERRUPTED);
  publish(*publisher, 42);
  EXPECT_EQ(executor.spin_until_future_complete(future), FutureReturnCode::SUCCESS);
  EXPECT_EQ(future.get(), 42u);
  std::promise<void> elsewhere;
  auto shared = elsewhere.get_future().share();
  std::thread other([&] { elsewhere.set_value(); });
  EXPECT_EQ(executor.spin_until_future_complete(shared), FutureReturnCode::SUCCESS);
  other.join();
}

/// A node of another library, and a part of one: all that add_node needs.
struct BaseInterface {
  std::string name;
  const char* get_fully_qualified_name() const { return name.c_str(); }
};
struct OtherNode {
  std::string name = "like";
  const char* get_name() const { return name.c_str(); }
  const char* get_namespace() const { return "/ns"; }
  std::string get_fully_qualified_name() const { return "/ns/" + name; }
};

TEST_F(Executors, NodesOfOtherTypesAreKnownByTheirName) {
  auto node = std::make_shared<OtherNode>();
  auto base = std::make_shared<BaseInterface>(BaseInterface{node->get_fully_qualified_name()});
  Seen seen;
  auto publisher = create_publisher<Number>(node, own("topic"), 10);
  SingleThreadedExecutor executor;
  executor.add_node(node);  // before its first subscription
  auto subscription = create_subscription<Number>(
      node.get(), own("topic"), 10, [&](const Message& number) { seen.add(number->value); });
  ASSERT_TRUE(eventually([&] { return subscription->get_linked_publisher_count() == 1; }));
  publish(*publisher, 1);
  executor.spin_once();
  EXPECT_EQ(seen.values, up_to(1));
  EXPECT_THAT(seen.threads, testing::ElementsAre(std::this_thread::get_id()));
  executor.remove_node(base);
  publish(*publisher, 2);
  executor.spin_some();
  EXPECT_EQ(seen.count(), 1u) << "it is in no executor";
  executor.add_node(base);
  executor.spin_once();
  EXPECT_EQ(seen.values, up_to(2));
}

TEST_F(Executors, ACallbackMayMoveItsNodeAndEndItsSubscription) {
  Node node(own("node"));
  Seen seen;
  SingleThreadedExecutor executor, other;
  Subscription<Number>::SharedPtr subscription;
  subscription = node.create_subscription<Number>(own("topic"), 10, [&](const Message& number) {
    seen.add(number->value);
    if (number->value == 1) {
      executor.remove_node(node);
      other.add_node(node);
    }
    if (number->value == 2) subscription.reset();
  });
  auto publisher = node.create_publisher<Number>(own("topic"), 10);
  executor.add_node(node);
  ASSERT_TRUE(eventually([&] { return subscription->get_linked_publisher_count() == 1; }));
  for (std::uint64_t value = 1; value <= 3; ++value) publish(*publisher, value);
  executor.spin_all(0s);
  EXPECT_EQ(seen.values, up_to(1));
  other.spin_all(0s);
  EXPECT_EQ(seen.values, up_to(2));
}

TEST_F(Executors, MisuseIsReported) {
  Node node(own("node"));
  SingleThreadedExecutor executor, other;
  executor.add_node(node);
  EXPECT_THAT(error_of([&] { executor.add_node(node); }), testing::HasSubstr("already"));
  EXPECT_THAT(error_of([&] { other.add_node(node); }), testing::HasSubstr("already"));
  EXPECT_THAT(error_of([&] { other.remove_node(node); }),
              testing::HasSubstr("not in this executor"));
  std::string within;
  auto subscription = node.create_subscription<Number>(
      own("topic"), 1, [&](const Message&) { within = error_of([&] { executor.spin_some(); }); });
  auto publisher = node.create_publisher<Number>(own("topic"), 1);
  publish(*publisher, 1);
  executor.spin_once();
  EXPECT_THAT(within, testing::HasSubstr("spinning already"));
}

TEST_F(Executors, AForkedChildCanDoNoHarm) {
  Node node(own("node"));
  Seen seen;
  auto subscription = node.create_subscription<Number>(
      own("topic"), 100, [&](const Message& number) { seen.add(number->value); });
  auto executor = std::make_unique<SpinningExecutor>(SpinningExecutor::forever);
  executor->add_node(node);
  std::thread spinner([&] { executor->spin(); });
  ASSERT_TRUE(eventually([&] { return executor->is_spinning(); }));
  for (int i = 0; i < 20; ++i) {
    // The spinning thread has the locks now and then, and no thread releases them in the child.
    test::Child child([&]() noexcept {
      const std::string forked = "was forked";
      executor->cancel();
      bool right = executor->prepare() == Executor::Readiness::armed;
      right = right && error_of([&] { executor->spin(); }).find(forked) != std::string::npos;
      right = right && error_of([&] { executor->dispatch(); }).find(forked) != std::string::npos;
      right =
          right && error_of([&] { executor->remove_node(node); }).find(forked) != std::string::npos;
      right = right &&
              error_of([&] { SingleThreadedExecutor another; }).find(forked) != std::string::npos;
      right =
          right && error_of([&] { BackgroundExecutor another; }).find(forked) != std::string::npos;
      right = right && subscription->get_matched_status().total_count == 0;
      subscription.reset();
      executor.reset();
      return right ? 0 : 1;
    });
    ASSERT_EQ(child.wait(), 0);
  }
  EXPECT_TRUE(executor->is_spinning()) << "the parent's was not cancelled";
  auto publisher = node.create_publisher<Number>(own("topic"), 1);
  publish(*publisher, 1);
  EXPECT_TRUE(eventually([&] { return seen.count() == 1; }));
  executor->cancel();
  spinner.join();
}

TEST_F(Executors, AChildForkedInACallbackThatReturnsGetsAnError) {
  Node node(own("node"));
  Seen seen;
  SingleThreadedExecutor executor;
  executor.add_node(node);
  bool is_child = false;
  int status = -1;
  auto subscription =
      node.create_subscription<Number>(own("topic"), 10, [&](const Message& number) {
        const pid_t pid = ::fork();
        if (pid == 0) {
          is_child = true;
          return;
        }
        ::waitpid(pid, &status, 0);
        seen.add(number->value);
      });
  auto publisher = node.create_publisher<Number>(own("topic"), 10);
  publish(*publisher, 1);
  std::string refused;
  std::thread spinner([&] {
    refused = error_of([&] { executor.spin(); });
    if (is_child) ::_exit(refused.find("was forked") != std::string::npos ? 0 : 1);
  });
  EXPECT_TRUE(eventually([&] { return seen.count() == 1; }));
  executor.cancel();
  spinner.join();
  EXPECT_EQ(status, 0);
  EXPECT_EQ(refused, "(no error)");

  executor.remove_node(node);
  status = -1;
  BackgroundExecutor background;
  background.add_node(node);
  publish(*publisher, 2);
  EXPECT_TRUE(eventually([&] { return seen.count() == 2; }));
  EXPECT_EQ(status, 0) << "in the library's thread: the thread ends, and with it the child";
}

TEST_F(Executors, ABackgroundExecutorRunsCallbacksInItsThreadWhileItLives) {
  Node node(own("node"));
  Seen seen;
  auto group = node.create_callback_group(CallbackGroupType::MutuallyExclusive);
  auto subscription = node.create_subscription<Number>(
      own("topic"), 10,
      [&](const Message& number) {
        seen.add(number->value);
        if (number->value == 2) throw std::runtime_error("counted");
      },
      SubscriptionOptions().callback_group(group));
  auto publisher = node.create_publisher<Number>(own("topic"), 10);
  ASSERT_TRUE(eventually([&] { return subscription->get_linked_publisher_count() == 1; }));
  {
    BackgroundExecutor executor;
    EXPECT_TRUE(executor.is_spinning());
    EXPECT_THAT(error_of([&] { executor.spin(); }), testing::HasSubstr("spinning already"));
    executor.add_node(node);
    for (std::uint64_t value = 1; value <= 3; ++value) publish(*publisher, value);
    EXPECT_TRUE(eventually([&] { return seen.count() == 3; }));
    EXPECT_EQ(subscription->get_callback_exception_count(), 1u);
  }
  publish(*publisher, 4);
  std::this_thread::sleep_for(20ms);
  EXPECT_EQ(seen.count(), 3u);
  {
    BackgroundExecutor executor;
    executor.add_node(node);
    EXPECT_TRUE(eventually([&] { return seen.count() == 4; }));
    executor.cancel();
    EXPECT_TRUE(eventually([&] { return !executor.is_spinning(); }));
    publish(*publisher, 5);
    std::this_thread::sleep_for(20ms);
    EXPECT_EQ(seen.count(), 4u);
  }
}

}  // namespace
}  // namespace agnocast
