// SPDX-License-Identifier: Apache-2.0
//
// Goal: a program may fork, exec and spawn while loans are open, messages are held and callbacks
// run: the child gets errors for forbidden calls and can do no harm, the parent goes on
// undisturbed.
// Method: real processes with the real daemon and hook; one process per case, which forks. A child
// that hangs or crashes fails its case.

#include <agnocast/agnocast.hpp>
#include <tests/support/processes/daemon_process.hpp>
#include <tests/support/processes/own_process.hpp>
#include <tests/support/processes/plain_node.hpp>
#include <tests/support/processes/spun.hpp>

#include <sensor_msgs/msg/point_cloud2.hpp>

#include <gmock/gmock.h>

#include <spawn.h>
#include <sys/syscall.h>

#include <atomic>
#include <cstdlib>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <utility>
#include <vector>

namespace agnocast {
namespace {

using Cloud = sensor_msgs::msg::PointCloud2;
using test::Child;
using test::in_own_process;
using test::PlainNode;
using test::take_soon;

Cloud cloud_of(std::uint32_t number) {
  Cloud cloud;
  cloud.width = number;
  cloud.header.frame_id = "a frame whose name does not fit into a string object";
  cloud.data.assign(50000, static_cast<std::uint8_t>(number));
  return cloud;
}

/// A process with a loan, a held message and a callback.
struct Busy {
  Subscription<Cloud>::SharedPtr subscription =
      create_subscription<Cloud>(PlainNode(), "points", QoS(10));
  PollingSubscriber<Cloud>::SharedPtr newest =
      create_subscription<Cloud>(PlainNode(), "points", QoS(10));
  std::atomic<std::uint32_t> called{0};
  test::Spun<PlainNode> node;
  Subscription<Cloud>::SharedPtr with_callback = create_subscription<Cloud>(
      node, "points", QoS(10),
      [this](const ipc_shared_ptr<const Cloud>& cloud) { called = cloud->width; });
  Publisher<Cloud>::SharedPtr publisher = create_publisher<Cloud>(PlainNode(), "points", 10);
  ipc_shared_ptr<const Cloud> held;
  ipc_shared_ptr<Cloud> loan;

  Busy() {
    EXPECT_TRUE(publisher->publish(std::make_unique<Cloud>(cloud_of(1))));
    held = take_soon(subscription);
    EXPECT_TRUE(held);
    EXPECT_TRUE(test::eventually([this] { return static_cast<bool>(newest->take_data()); }));
    loan = publisher->borrow_loaned_message();
    *loan = cloud_of(2);
  }
  Busy(const Busy&) = delete;
  Busy& operator=(const Busy&) = delete;

  /// The parent's checks after its children.
  void expect_unharmed() {
    EXPECT_EQ(*held, cloud_of(1));
    EXPECT_EQ(*loan, cloud_of(2));
    const PublishResult result = publisher->publish(std::move(loan));
    EXPECT_TRUE(result) << sentence_of(result.code);
    EXPECT_EQ(result.adopted_bytes, 0u);
    held = take_soon(subscription);
    ASSERT_TRUE(held);
    EXPECT_EQ(*held, cloud_of(2));
    EXPECT_TRUE(test::eventually([&] { return called == 2; })) << "the callback thread goes on";
  }
};

/// Forks a child whose failed expectations fail the test.
template <class Body>
Child child_of(Body body) {
  return Child([&]() noexcept {
    body();
    std::fflush(nullptr);
    return testing::Test::HasFailure() ? 1 : 0;
  });
}

class Fork : public testing::Test {
 protected:
  void SetUp() override { ::setenv("AGNOCAST_SOCKET", daemon_.socket_path().c_str(), 1); }
  void TearDown() override { EXPECT_TRUE(daemon_.is_running()); }
  test::DaemonProcess daemon_;
};

TEST_F(Fork, AChildReadsMessagesAndItsWritesStayItsOwn) {
  EXPECT_TRUE(in_own_process([] {
    Busy busy;
    Child child = child_of([&] {
      EXPECT_EQ(*busy.held, cloud_of(1));
      EXPECT_EQ(*busy.loan, cloud_of(2));
      busy.loan->data[0] = 99;
      busy.loan->data.resize(200000, 5);
      busy.loan->header.frame_id = "another text that does not fit into a string object either";
      EXPECT_EQ(busy.loan->data[0], 99);
      EXPECT_EQ(busy.loan->data[49999], 2);
      busy.loan.reset();
      busy.held.reset();
    });
    EXPECT_EQ(child.wait(), 0);
    busy.expect_unharmed();
  }));
}

void expect_detached(Busy& busy) {
  const auto publisher = try_create_publisher<Cloud>(PlainNode(), "points", QoS(1));
  ASSERT_FALSE(publisher);
  EXPECT_EQ(publisher.error().code, Errc::shut_down);
  EXPECT_THAT(publisher.error().what, testing::HasSubstr("forked"));
  const auto asked = try_create_subscription<Cloud>(PlainNode(), "points", QoS(1));
  ASSERT_FALSE(asked);
  EXPECT_THAT(asked.error().what, testing::HasSubstr("forked"));
  try {
    create_subscription<Cloud>(PlainNode(), "points", QoS(1),
                               [](const ipc_shared_ptr<const Cloud>&) {});
    ADD_FAILURE() << "a subscription with a callback was created";
  } catch (const Error& error) {
    EXPECT_EQ(error.code(), Errc::shut_down);
    EXPECT_THAT(error.what(), testing::HasSubstr("forked"));
  }
  EXPECT_EQ(busy.publisher->publish(std::move(busy.loan)).code, Errc::shut_down);
  EXPECT_TRUE(busy.loan) << "the caller still has it";
  auto message = std::make_unique<Cloud>();
  EXPECT_EQ(busy.publisher->publish(std::move(message)).code, Errc::shut_down);
  EXPECT_FALSE(busy.publisher->wait_for_all_acked());
  EXPECT_NE(message, nullptr);
  EXPECT_FALSE(busy.subscription->take());
  ipc_shared_ptr<const Cloud> batch[2] = {busy.held};
  EXPECT_EQ(busy.subscription->take_batch(batch, 2), 0u);
  EXPECT_EQ(busy.publisher->get_subscription_count(), 0u);
  EXPECT_EQ(set_heap_scope(HeapScope::all).error().code, Errc::shut_down);
}

TEST_F(Fork, InAChildCreationAndPublishReturnShutDownAndTakeFindsNothing) {
  EXPECT_TRUE(in_own_process([] {
    Busy busy;
    EXPECT_TRUE(busy.publisher->publish(std::make_unique<Cloud>(cloud_of(7)))) << "one to take";
    Child child = child_of([&] {
      expect_detached(busy);
      auto fresh = busy.publisher->borrow_loaned_message();
      *fresh = cloud_of(3);
      EXPECT_EQ(busy.publisher->publish(std::move(fresh)).code, Errc::shut_down);
      Child grandchild = child_of([&] { expect_detached(busy); });
      EXPECT_EQ(grandchild.wait(), 0);
    });
    EXPECT_EQ(child.wait(), 0);
    EXPECT_EQ(take_soon(busy.subscription)->width, 7u);
    busy.expect_unharmed();
  }));
}

TEST_F(Fork, AChildThatRanNoForkHandlersIsDetectedToo) {
  EXPECT_TRUE(in_own_process([] {
    Busy busy;
    const auto pid = static_cast<pid_t>(::syscall(SYS_clone, SIGCHLD, 0, 0, 0, 0));
    if (pid == 0) {
      // Its windows are not mapped: the library may not touch the message.
      const bool publish_says =
          busy.publisher->publish(std::move(busy.loan)).code == Errc::shut_down;
      const bool take_says = !busy.subscription->take();
      ::_exit(publish_says && take_says ? 0 : 1);
    }
    int status = -1;
    ASSERT_EQ(::waitpid(pid, &status, 0), pid);
    EXPECT_EQ(status, 0);
    busy.expect_unharmed();
  }));
}

TEST_F(Fork, AChildThatDestroysEverythingAndExitsHarmsNobody) {
  EXPECT_TRUE(in_own_process([] {
    static std::optional<Busy> busy;
    busy.emplace();
    std::fflush(nullptr);
    Child destroys = child_of([&] { busy.reset(); });
    EXPECT_EQ(destroys.wait(), 0);
    Child exits([]() noexcept -> int { std::exit(0); });  // destroys it with its static objects
    EXPECT_EQ(exits.wait(), 0);
    busy->expect_unharmed();
    busy.reset();
  }));
  EXPECT_THAT(daemon_.log(), testing::Not(testing::HasSubstr("warning")));
}

TEST_F(Fork, ProgramsStartedMeanwhileInheritNoDescriptors) {
  EXPECT_TRUE(in_own_process([] {
    Busy busy;
    char shell[] = "/bin/sh", option[] = "-c";
    char command[] = "! ls -l /proc/self/fd /proc/$$/fd | grep -E 'memfd|socket|anon_inode'";
    char* const arguments[] = {shell, option, command, nullptr};
    int status = -1;

    Child forked([&]() noexcept {
      ::execv(shell, arguments);
      return 127;
    });
    EXPECT_EQ(forked.wait(), 0) << "fork and exec";
    pid_t pid = -1;
    ASSERT_EQ(::posix_spawn(&pid, shell, nullptr, nullptr, arguments, environ), 0);
    ASSERT_EQ(::waitpid(pid, &status, 0), pid);
    EXPECT_EQ(status, 0) << "posix_spawn";
    pid = ::vfork();
    if (pid == 0) {
      ::execv(shell, arguments);
      ::_exit(127);
    }
    ASSERT_EQ(::waitpid(pid, &status, 0), pid);
    EXPECT_EQ(status, 0) << "vfork";
    EXPECT_EQ(std::system(command), 0);
    busy.expect_unharmed();
  }));
}

struct OtherNode : PlainNode {
  const char* get_fully_qualified_name() const { return "/ns/other"; }
};

TEST_F(Fork, AnExecutorThatSpinsStaysWithTheParent) {
  EXPECT_TRUE(in_own_process([] {
    auto executor = std::make_unique<SingleThreadedExecutor>();
    executor->add_node(OtherNode());
    std::atomic<std::uint32_t> called{0};
    auto subscription = create_subscription<Cloud>(
        OtherNode(), "points", QoS(10),
        [&](const ipc_shared_ptr<const Cloud>& cloud) { called = cloud->width; });
    std::thread spinner([&] { executor->spin(); });
    Busy busy;
    EXPECT_TRUE(test::eventually([&] { return called == 1; }));
    Child child = child_of([&] {
      subscription.reset();
      executor->cancel();
      executor.reset();
    });
    EXPECT_EQ(child.wait(), 0);
    busy.expect_unharmed();
    EXPECT_TRUE(test::eventually([&] { return called == 2; }));
    executor->cancel();
    spinner.join();
  }));
}

TEST_F(Fork, ForkingWhileThreadsPublishAndTakeDisturbsNobody) {
  EXPECT_TRUE(in_own_process([] {
    Busy busy;
    std::atomic<bool> stop{false};
    std::vector<std::thread> threads;
    for (int i = 0; i < 2; ++i) {
      threads.emplace_back([&] {
        const std::string topic = "storm";
        auto subscription = create_subscription<Cloud>(PlainNode(), topic, QoS(1));
        auto publisher = create_publisher<Cloud>(PlainNode(), topic, 1);
        for (std::uint32_t n = 0; !stop; ++n) {
          auto loan = publisher->borrow_loaned_message();
          *loan = cloud_of(n);
          const PublishResult result = publisher->publish(std::move(loan));
          EXPECT_TRUE(result) << sentence_of(result.code);
          if (const auto message = subscription->take()) {
            EXPECT_EQ(*message, cloud_of(message->width));
          }
        }
      });
    }
    for (int i = 0; i < 40; ++i) {
      Child child = child_of([&] {
        expect_detached(busy);
        busy.subscription.reset();
        busy.with_callback.reset();
        busy.publisher.reset();
        busy.loan.reset();
      });
      EXPECT_EQ(child.wait(), 0) << "child " << i;
    }
    stop = true;
    for (std::thread& thread : threads) thread.join();
    busy.expect_unharmed();
  }));
}

TEST_F(Fork, AskingForTheNewestMessageInAChildWaitsForNoThreadOfTheParent) {
  EXPECT_TRUE(in_own_process([] {
    Busy busy;
    std::atomic<bool> stop{false};
    std::thread asking([&] {
      while (!stop) EXPECT_TRUE(busy.newest->take_data());
    });
    for (int i = 0; i < 100 && !testing::Test::HasFailure(); ++i) {
      Child child = child_of([&] {
        ::alarm(20);
        EXPECT_FALSE(busy.newest->take_data());
      });
      EXPECT_EQ(child.wait(), 0) << "child " << i;
    }
    stop = true;
    asking.join();
  }));
}

}  // namespace
}  // namespace agnocast
