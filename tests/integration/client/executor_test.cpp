// SPDX-License-Identifier: Apache-2.0
//
// Goal: executors run the callbacks of their nodes, all of them once, in a fair order and in the
// thread that spins, while nodes move between executors and the library's thread.
// Method: the public interface, the real daemon, publishers in this process and (where messages
// flow meanwhile) in a second one. tests/threads/executor_threads_test.cpp covers the moves under
// ThreadSanitizer.

#include <agnocast/agnocast.hpp>
#include <tests/integration/client/second_process.hpp>
#include <tests/support/messages/error_of.hpp>
#include <tests/support/processes/child.hpp>
#include <tests/support/processes/daemon_process.hpp>
#include <tests/support/processes/suite_daemon.hpp>

#include <poll.h>
#include <signal.h>

#include <gmock/gmock.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstdlib>
#include <functional>
#include <future>
#include <memory>
#include <mutex>
#include <stdexcept>
#include <string>
#include <thread>
#include <type_traits>
#include <vector>

namespace agnocast {
namespace {

using namespace std::chrono_literals;
using test::error_of;
using test::eventually;
using test::Number;
using test::SecondProcess;
using Message = ipc_shared_ptr<const Number>;

static_assert(std::has_virtual_destructor_v<Executor>, "may be held by pointers to the base");

class Executors : public test::SuiteDaemon {
 protected:
  static void publish(Publisher<Number>& publisher, std::uint64_t value) {
    auto number = publisher.borrow_loaned_message();
    number->value = value;
    ASSERT_TRUE(publisher.publish(std::move(number)));
  }
};

/// The values that callbacks got, from any thread.
struct Seen {
  std::mutex mutex;
  std::vector<std::uint64_t> values;
  std::vector<std::thread::id> threads;
  void add(std::uint64_t value) {
    const std::lock_guard lock(mutex);
    values.push_back(value);
    threads.push_back(std::this_thread::get_id());
  }
  std::size_t count() {
    const std::lock_guard lock(mutex);
    return values.size();
  }
};

std::vector<std::uint64_t> up_to(std::uint64_t last) {
  std::vector<std::uint64_t> values;
  for (std::uint64_t value = 1; value <= last; ++value) values.push_back(value);
  return values;
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
  ASSERT_TRUE(eventually([&] { return subscription->get_publisher_count() == 1; }));
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

// The node moves between two spinning executors, a third one that is made and destroyed, and the
// library's thread, while a publisher in another process sends at full speed. keep-all: every
// message must arrive.
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
  SpinningExecutor spinning(100us);
  sleeping.add_node(other);
  std::thread one([&] { sleeping.spin(); }), two([&] { spinning.spin(); });
  SecondProcess publisher({"publish", own("topic"), "100rva", std::to_string(count)});
  std::uint64_t moves = 0;
  EXPECT_TRUE(eventually([&] {
    for (int i = 0; i < 10; ++i) {
      sleeping.add_node(node);
      if (i % 3 == 0) std::this_thread::sleep_for(300us);
      sleeping.remove_node(node);
      if (i % 3 == 1) std::this_thread::sleep_for(300us);
      spinning.add_node(node);
      if (i % 3 == 2) std::this_thread::sleep_for(300us);
      spinning.remove_node(node);
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

// It sleeps when the node is taken and when it is given back: the last message before and the
// first one after a move must wake the right executor.
TEST_F(Executors, ANewExecutorIsWokenByMessagesAfterTheMove) {
  Node node(own("node"));
  Seen seen;
  auto subscription = node.create_subscription<Number>(
      own("topic"), 10, [&](const Message& number) { seen.add(number->value); });
  auto publisher = node.create_publisher<Number>(own("topic"), 10);
  SingleThreadedExecutor executor;
  std::thread spinner([&] { executor.spin(); });
  for (std::uint64_t value = 1; value <= 40; ++value) {
    publish(*publisher, value);
    ASSERT_TRUE(eventually([&] { return seen.count() == value; })) << value;
    if (value % 2 == 1) {
      executor.add_node(node);
    } else {
      executor.remove_node(node);
    }
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
    ASSERT_TRUE(eventually([&] { return (*publisher)->get_subscription_count() == 1; }));
  for (auto* subscription : {&a, &b, &c})
    ASSERT_TRUE(eventually([&] { return (*subscription)->get_publisher_count() == 1; }));
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

/// Look-alikes of rclcpp's node and of its base interface: all that add_node needs.
struct BaseInterface {
  std::string name;
  const char* get_fully_qualified_name() const { return name.c_str(); }
};
struct LookAlikeNode {
  std::string name = "like";
  const char* get_name() const { return name.c_str(); }
  const char* get_namespace() const { return "/ns"; }
  std::string get_fully_qualified_name() const { return "/ns/" + name; }
  std::shared_ptr<BaseInterface> get_node_base_interface() const {
    return std::make_shared<BaseInterface>(BaseInterface{get_fully_qualified_name()});
  }
};

TEST_F(Executors, NodesOfOtherTypesAreKnownByTheirName) {
  auto node = std::make_shared<LookAlikeNode>();
  Seen seen;
  auto publisher = create_publisher<Number>(node, own("topic"), 10);
  SingleThreadedExecutor executor;
  executor.add_node(node);  // before its first subscription
  auto subscription = create_subscription<Number>(
      node.get(), own("topic"), 10, [&](const Message& number) { seen.add(number->value); });
  ASSERT_TRUE(eventually([&] { return subscription->get_publisher_count() == 1; }));
  publish(*publisher, 1);
  executor.spin_once();
  EXPECT_EQ(seen.values, up_to(1));
  EXPECT_THAT(seen.threads, testing::ElementsAre(std::this_thread::get_id()));
  executor.remove_node(node->get_node_base_interface());
  publish(*publisher, 2);
  EXPECT_TRUE(eventually([&] { return seen.count() == 2; })) << "the library's thread again";
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
  ASSERT_TRUE(eventually([&] { return subscription->get_publisher_count() == 1; }));
  for (std::uint64_t value = 1; value <= 3; ++value) publish(*publisher, value);
  executor.spin_all(0s);
  EXPECT_EQ(seen.values, up_to(1));
  other.spin_all(0s);
  EXPECT_EQ(seen.values, up_to(2));
}

// The last subscription of the node goes, and the next one comes, while the callback still runs.
TEST_F(Executors, ACallbackThatReplacesItsSubscriptionNeverRunsConcurrently) {
  Node node(own("node"));
  std::atomic<int> inside{0}, overlaps{0}, first{0}, second{0};
  const auto enter = [&] {
    if (inside.fetch_add(1) != 0) ++overlaps;
  };
  auto publisher = node.create_publisher<Number>(own("topic"), QoS(1).transient_local());
  publish(*publisher, 1);
  Subscription<Number>::SharedPtr subscription;
  std::promise<void> ready;
  subscription =
      node.create_subscription<Number>(own("topic"), QoS(1).transient_local(), [&](const Message&) {
        ready.get_future().wait();
        enter();
        subscription.reset();
        subscription = node.create_subscription<Number>(own("topic"), QoS(1).transient_local(),
                                                        [&](const Message&) {
                                                          enter();
                                                          ++second;
                                                          --inside;
                                                        });
        // Time for a concurrent callback, if there were one.
        for (int i = 0; i < 300 && overlaps == 0; ++i) std::this_thread::sleep_for(1ms);
        --inside;
        ++first;
      });
  ready.set_value();
  EXPECT_TRUE(eventually([&] { return first == 1 && second == 1; })) << first << second;
  EXPECT_EQ(overlaps, 0);
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
  publish(*publisher, 2);
  EXPECT_TRUE(eventually([&] { return seen.count() == 2; }));
  EXPECT_EQ(status, 0) << "in the library's thread: the thread ends, and with it the child";
}

// More groups than wait sets: they share, and each is woken all the same.
TEST_F(Executors, NodesBeyondTheWaitSetsOfAProcessShareThem) {
  constexpr std::size_t count = 200;
  std::vector<std::unique_ptr<Node>> nodes;
  std::vector<Subscription<Number>::SharedPtr> subscriptions;
  std::vector<std::atomic<int>> got(count);
  SingleThreadedExecutor executor, other;
  for (std::size_t i = 0; i < count; ++i) {
    nodes.push_back(std::make_unique<Node>(own("node") + std::to_string(i)));
    (i % 2 == 0 ? executor : other).add_node(*nodes.back());
    subscriptions.push_back(nodes.back()->create_subscription<Number>(
        own("topic"), 1, [&got, i](const Message&) { ++got[i]; }));
  }
  std::thread one([&] { executor.spin(); }), two([&] { other.spin(); });
  auto publisher = nodes.front()->create_publisher<Number>(own("topic"), 1);
  EXPECT_TRUE(eventually([&] { return publisher->get_subscription_count() == count; }));
  for (int value = 1; value <= 5; ++value) {
    publish(*publisher, static_cast<std::uint64_t>(value));
    EXPECT_TRUE(eventually([&] {
      return std::all_of(got.begin(), got.end(), [&](const auto& of) { return of == value; });
    })) << value;
  }
  executor.cancel();
  other.cancel();
  one.join();
  two.join();
}

// --- groups and executors with several threads

/// Two groups of one node, each with a subscription to a topic of its own.
struct TwoGroups {
  explicit TwoGroups(const std::string& name, CallbackGroupType type) : node(name) {
    for (auto& group : groups) group = node.create_callback_group(type);
  }
  Subscription<Number>::SharedPtr subscribe(std::size_t group, const std::string& topic,
                                            std::function<void(const Message&)> callback) {
    return node.create_subscription<Number>(topic, 1000, std::move(callback),
                                            SubscriptionOptions().callback_group(groups[group]));
  }
  Node node;
  CallbackGroup::SharedPtr groups[2];
};

/// Runs `spin` in a thread until the end of the scope.
class Spun {
 public:
  explicit Spun(Executor& executor)
      : executor_(executor), thread_([&executor] { executor.spin(); }) {}
  ~Spun() {
    executor_.cancel();
    thread_.join();
  }

 private:
  Executor& executor_;
  std::thread thread_;
};

TEST_F(Executors, AGroupThatIsInNoExecutorRunsNothing) {
  TwoGroups two(own("node"), CallbackGroupType::MutuallyExclusive);
  std::atomic<int> got{0};
  auto subscription = two.subscribe(0, own("topic"), [&](const Message&) { ++got; });
  auto publisher = two.node.create_publisher<Number>(own("topic"), 1000);
  ASSERT_TRUE(eventually([&] { return subscription->get_publisher_count() == 1; }));
  publish(*publisher, 1);
  std::this_thread::sleep_for(50ms);
  EXPECT_EQ(got, 0);
  SingleThreadedExecutor executor;
  executor.add_callback_group(two.groups[0]);
  executor.spin_some();
  EXPECT_EQ(got, 1);
  executor.remove_callback_group(two.groups[0]);
  publish(*publisher, 2);
  executor.spin_some();
  EXPECT_EQ(got, 1);
}

TEST_F(Executors, AGroupStaysWhereItWasAddedAlone) {
  Node node(own("node"));
  auto apart = node.create_callback_group(CallbackGroupType::MutuallyExclusive, false);
  auto with = node.create_callback_group(CallbackGroupType::MutuallyExclusive);
  EXPECT_FALSE(apart->automatically_add_to_executor_with_node());
  EXPECT_EQ(apart->type(), CallbackGroupType::MutuallyExclusive);
  SingleThreadedExecutor executor, other;
  other.add_callback_group(with);
  executor.add_node(node);
  EXPECT_THAT(error_of([&] { executor.add_callback_group(with); }), testing::HasSubstr("already"));
  EXPECT_THAT(error_of([&] { executor.remove_callback_group(with); }),
              testing::HasSubstr("not in this executor"));
  executor.add_callback_group(apart);
  executor.remove_node(node);
  EXPECT_THAT(error_of([&] { other.add_callback_group(apart); }), testing::HasSubstr("already"));
  executor.remove_callback_group(apart);
  other.add_callback_group(apart);
  Node another(own("another"));
  EXPECT_THAT(error_of([&] {
                auto refused = another.create_subscription<Number>(
                    own("topic"), 1, [](const Message&) {},
                    SubscriptionOptions().callback_group(with));
              }),
              testing::HasSubstr("the callback group belongs to another node"));
}

TEST_F(Executors, SeveralThreadsRunDifferentGroupsAtOnceAndOneGroupNever) {
  TwoGroups two(own("node"), CallbackGroupType::MutuallyExclusive);
  std::atomic<int> inside[2]{}, overlaps{0}, together{0};
  std::uint64_t unguarded[2]{};
  std::vector<Subscription<Number>::SharedPtr> subscriptions;
  for (std::size_t i = 0; i < 4; ++i) {
    const std::size_t group = i / 2;
    subscriptions.push_back(two.subscribe(group, own("topic"), [&, group](const Message&) {
      if (inside[group].fetch_add(1) != 0) ++overlaps;
      if (inside[1 - group] != 0) ++together;
      ++unguarded[group];
      std::this_thread::sleep_for(100us);
      --inside[group];
    }));
  }
  auto publisher = two.node.create_publisher<Number>(own("topic"), 1000);
  MultiThreadedExecutor executor(4);
  EXPECT_EQ(executor.get_number_of_threads(), 4u);
  executor.add_node(two.node);
  {
    const Spun spun(executor);
    ASSERT_TRUE(eventually([&] { return publisher->get_subscription_count() == 4; }));
    for (std::uint64_t value = 1; value <= 200; ++value) {
      publish(*publisher, value);
      std::this_thread::sleep_for(std::chrono::microseconds(value * 7 % 300));
    }
  }
  executor.spin_all(0s);  // what was published just before the end
  EXPECT_EQ(overlaps, 0);
  EXPECT_GT(together, 0);
  EXPECT_EQ(unguarded[0], 400u);
  EXPECT_EQ(unguarded[1], 400u);
}

TEST_F(Executors, AReentrantGroupRunsOneSubscriptionInSeveralThreads) {
  TwoGroups two(own("node"), CallbackGroupType::Reentrant);
  std::atomic<int> inside{0}, met{0};
  auto subscription = two.subscribe(0, own("topic"), [&](const Message&) {
    ++inside;
    if (eventually([&] { return inside >= 2; })) ++met;
  });
  auto publisher = two.node.create_publisher<Number>(own("topic"), 1000);
  ASSERT_TRUE(eventually([&] { return subscription->get_publisher_count() == 1; }));
  MultiThreadedExecutor executor(2);
  executor.add_node(two.node);
  const Spun spun(executor);
  publish(*publisher, 1);
  publish(*publisher, 2);
  EXPECT_TRUE(eventually([&] { return met == 2; }));
}

TEST_F(Executors, ACallbackIsolatedExecutorGivesEachGroupItsThread) {
  TwoGroups two(own("node"), CallbackGroupType::MutuallyExclusive);
  Seen seen[3];
  std::promise<void> may_end;
  auto blocked = may_end.get_future().share();
  auto first = two.subscribe(0, own("first"), [&](const Message& number) {
    blocked.wait();
    seen[0].add(number->value);
  });
  auto second =
      two.subscribe(1, own("second"), [&](const Message& number) { seen[1].add(number->value); });
  auto to_first = two.node.create_publisher<Number>(own("first"), 10);
  auto to_second = two.node.create_publisher<Number>(own("second"), 10);
  ASSERT_TRUE(eventually(
      [&] { return first->get_publisher_count() == 1 && second->get_publisher_count() == 1; }));
  CallbackIsolatedExecutor executor;
  executor.add_node(two.node);
  {
    const Spun spun(executor);
    publish(*to_first, 1);
    publish(*to_second, 1);
    EXPECT_TRUE(eventually([&] { return seen[1].count() == 1; })) << "the first is blocked";
    // A group that comes while it spins, and goes.
    auto third_group = two.node.create_callback_group(CallbackGroupType::MutuallyExclusive);
    auto third = two.node.create_subscription<Number>(
        own("second"), 10, [&](const Message& number) { seen[2].add(number->value); },
        SubscriptionOptions().callback_group(third_group));
    ASSERT_TRUE(eventually([&] { return third->get_publisher_count() == 1; }));
    publish(*to_second, 2);
    EXPECT_TRUE(eventually([&] { return seen[1].count() == 2 && seen[2].count() == 1; }));
    third.reset();
    third_group.reset();
    publish(*to_second, 3);
    EXPECT_TRUE(eventually([&] { return seen[1].count() == 3; }));
    EXPECT_EQ(seen[0].count(), 0u);
    may_end.set_value();
    EXPECT_TRUE(eventually([&] { return seen[0].count() == 1; }));
  }
  EXPECT_NE(seen[0].threads[0], seen[1].threads[0]);
  EXPECT_NE(seen[1].threads[0], seen[2].threads[0]);
  EXPECT_THAT(seen[1].threads, testing::Each(seen[1].threads[0]));
  publish(*to_second, 4);
  executor.spin_some();
  EXPECT_EQ(seen[1].threads[3], std::this_thread::get_id()) << "other spin functions go on";
}

template <class Made>
void leaves_spin(const std::string& name, const std::string& topic) {
  Node node(name);
  std::atomic<int> got{0};
  auto subscription = node.create_subscription<Number>(topic, 10, [&](const Message&) {
    if (++got == 1) throw std::runtime_error("the first");
  });
  auto publisher = node.create_publisher<Number>(topic, 10);
  Made executor;
  executor.add_node(node);
  ASSERT_TRUE(eventually([&] { return subscription->get_publisher_count() == 1; }));
  auto number = publisher->borrow_loaned_message();
  ASSERT_TRUE(publisher->publish(std::move(number)));
  EXPECT_THROW(executor.spin(), std::runtime_error);
  EXPECT_FALSE(executor.is_spinning());
  number = publisher->borrow_loaned_message();
  ASSERT_TRUE(publisher->publish(std::move(number)));
  const Spun spun(executor);
  EXPECT_TRUE(eventually([&] { return got == 2; }));
}

TEST_F(Executors, AnExceptionLeavesTheSpinOfSeveralThreads) {
  leaves_spin<MultiThreadedExecutor>(own("node"), own("topic"));
  leaves_spin<CallbackIsolatedExecutor>(own("isolated"), own("other"));
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
  ASSERT_TRUE(eventually([&] { return subscription->get_publisher_count() == 1; }));
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
