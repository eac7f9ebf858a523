// SPDX-License-Identifier: Apache-2.0
//
// Goal: no unusual state of a process keeps it from moving to a daemon without a store: several of
// its endpoints on one topic, children of fork, readers that hold all they may, an endpoint that
// the new daemon refuses, a store that is lost again before everything has moved.
// Method: the public interface in this process and client_tool in others; real daemons that are
// killed with their supervisors and restarted without a store at the same socket.

#include <tests/integration/client/session/reregistration_in_process.hpp>
#include <tests/support/processes/child.hpp>
#include <tests/support/processes/client_tool.hpp>
#include <tests/support/processes/spun.hpp>
#include <tests/support/wire/wire_dump.hpp>

#include <time.h>

#include <array>
#include <atomic>
#include <csignal>
#include <cstdint>
#include <deque>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

/// A Block that does not reveal where its words lie.
struct OpaqueBlock : agnocast::test::Block {};
template <>
struct agnocast::MessageTraits<OpaqueBlock> {
  static constexpr const char* name = "tests/Block";
};

namespace agnocast {
namespace {

using test::are_connected;
using test::Child;
using test::ClientTool;

class ReregistrationCases : public ReregistrationInProcess {
 protected:
  /// v: volatile, t: transient local.
  static void two_publishers_and_two_subscriptions(char durability);
};

std::string numbers(int first, int last) {
  std::string text;
  for (int number = first; number <= last; ++number) text += std::to_string(number) + " ";
  return text;
}

using Values = std::map<std::uint64_t, std::vector<std::uint64_t>>;  // by publisher
constexpr std::uint64_t of_publisher = 1'000'000;

template <class SubscriptionPointer>
void drain(const SubscriptionPointer& subscription, Values& values) {
  while (const auto number = subscription->take())
    values[number->value / of_publisher].push_back(number->value % of_publisher);
}
TEST_F(ReregistrationCases, PublishersAndSubscriptionsOfAProcessOnOneTopicKeepTheirOrder) {
  two_publishers_and_two_subscriptions('v');
}
TEST_F(ReregistrationCases, PublishersOfAProcessOnOneTopicKeepSeparateHistories) {
  two_publishers_and_two_subscriptions('t');
}

void ReregistrationCases::two_publishers_and_two_subscriptions(char durability) {
  const std::string name = std::string("/several_") + durability;
  Node node("several");
  const auto publisher_qos = test::qos_of(std::string("5r") + durability);
  const auto reader_qos = test::qos_of(std::string("100r") + durability);
  std::vector<Publisher<Number>::SharedPtr> publishers;
  std::vector<Subscription<Number>::SharedPtr> readers;
  for (int i = 0; i < 2; ++i) {
    readers.push_back(node.create_subscription<Number>(name, reader_qos));
    publishers.push_back(node.create_publisher<Number>(name, publisher_qos));
  }
  const auto matched = [&](std::size_t count) {
    return eventually([&] {
      return publishers[0]->get_linked_subscription_count() == count &&
             publishers[1]->get_linked_subscription_count() == count;
    });
  };
  ASSERT_TRUE(matched(2));
  std::array<Values, 2> got;
  std::uint64_t last = 0;
  const auto each_publishes = [&] {
    ++last;
    for (std::uint64_t p = 0; p < 2; ++p) publish(*publishers[p], (p + 1) * of_publisher + last);
  };
  for (int round = 0; round < 3; ++round) {
    each_publishes();
    each_publishes();
    drain(readers[0], got[0]);  // the other one reads later
    end();
    each_publishes();
    begin();
    each_publishes();
    await_connection();
    each_publishes();
    // Both have moved when a subscription without a previous session receives them.
    ASSERT_TRUE(matched(2));
    const auto late = node.create_subscription<Number>(name, reader_qos);
    ASSERT_TRUE(matched(3));
    each_publishes();
    for (std::size_t r = 0; r < 2; ++r) drain(readers[r], got[r]);
    Values heard;
    EXPECT_TRUE(eventually([&] {
      drain(late, heard);
      return !heard[1].empty() && !heard[2].empty() && heard[1].back() == last &&
             heard[2].back() == last;
    }));
    EXPECT_EQ(heard[1], heard[2]);
    EXPECT_EQ(heard[1], range(heard[1].front(), last)) << "history once, then the new messages";
  }
  for (std::size_t r = 0; r < 2; ++r) {
    EXPECT_EQ(got[r][1], range(1, last)) << r;
    EXPECT_EQ(got[r][2], range(1, last)) << r;
    EXPECT_EQ(readers[r]->get_lost_count(), 0u);
    EXPECT_EQ(readers[r]->get_linked_publisher_count(), 2u);
  }
}

TEST_F(ReregistrationCases, ChildrenOfForkDisturbNothingAndGetErrors) {
  Node node("parent");
  const auto reader = node.create_subscription<Number>("/forks", 1000);
  const auto publisher = node.create_publisher<Number>("/forks", 1000);
  ClientTool other(socket());
  ASSERT_EQ(other.ask("connect"), "ok");
  ASSERT_TRUE(eventually([&] { return publisher->get_linked_subscription_count() == 1; }));
  std::uint64_t published = 0;
  publish(*publisher, ++published);
  const auto held = reader->take();
  ASSERT_TRUE(held);

  const auto is_told = [&] {
    auto message = std::make_unique<Number>();
    return publisher->publish(std::move(message)).code == Errc::shut_down && !reader->take() &&
           held->value == 1 && connection_state() == ConnectionState::unconnected;
  };
  char shell[] = "/bin/sh", option[] = "-c";
  char command[] = "! ls -l /proc/self/fd /proc/$$/fd | grep -E 'memfd|anon_inode'";
  char* const arguments[] = {shell, option, command, nullptr};
  // One that was forked before and lives over all steps; it has the parent's locks as well.
  int go[2];
  ASSERT_EQ(::pipe(go), 0);
  const auto long_lived = [&]() noexcept {
    ::close(go[1]);
    char nothing = 0;
    while (::read(go[0], &nothing, 1) > 0) {
    }
    return is_told() ? 0 : 1;
  };
  Child before(long_lived);
  std::vector<std::unique_ptr<Child>> during;
  std::uint64_t made = 0;
  for (int round = 0; round < 3; ++round) {
    end();
    begin();
    // During the move, at any of its steps.
    do {
      Child asks([&]() noexcept { return is_told() ? 0 : 1; });
      Child executes([&]() noexcept {
        ::execv(shell, arguments);
        return 127;
      });
      if (during.size() < 10) during.push_back(std::make_unique<Child>(long_lived));
      publish(*publisher, ++published);
      EXPECT_EQ(asks.wait(), 0) << "the child gets an error";
      EXPECT_EQ(executes.wait(), 0) << "a program inherits nothing";
      made += 2;
    } while (connection_state() != ConnectionState::connected ||
             publisher->get_linked_subscription_count() != 1);
  }
  std::printf("%llu children\n", static_cast<unsigned long long>(made));
  EXPECT_EQ(other.ask("sub /x 1"), "ok");
  publish(*publisher, ++published);
  for (std::uint64_t value = 2; value <= published; ++value) {
    const auto number = reader->take();
    ASSERT_TRUE(number) << value;
    EXPECT_EQ(number->value, value);
  }
  EXPECT_FALSE(reader->take());
  ::close(go[1]);
  EXPECT_EQ(before.wait(), 0);
  for (const auto& child : during) EXPECT_EQ(child->wait(), 0);
  ::close(go[0]);
  EXPECT_EQ(held->value, 1u);
}

TEST_F(ReregistrationCases, ARefusedEndpointKeepsNoOtherFromMoving) {
  Node node("refused");
  const auto first = node.create_publisher<Number>("/first", 10);
  const auto deep = node.create_publisher<Number>("/deep", 50);  // refused by the second daemon
  const auto last = node.create_publisher<Number>("/last", 10);
  const auto deep_reader =
      node.create_subscription<Number>("/last", 50);  // likewise: receives nothing
  const auto reader_of_deep = node.create_subscription<Number>("/deep", 10);
  const auto reader_of_first = node.create_subscription<Number>("/first", 10);
  const auto both = [&] {
    return first->get_linked_subscription_count() == 1 &&
           deep->get_linked_subscription_count() == 1 && last->get_linked_subscription_count() == 1;
  };
  ASSERT_TRUE(eventually(both));
  const auto each = [&](std::uint64_t value) {
    for (const auto& publisher : {first, deep, last}) publish(*publisher, value);
    for (const auto& reader : {reader_of_first, reader_of_deep}) {
      const auto number = reader->take();
      ASSERT_TRUE(number) << value;
      EXPECT_EQ(number->value, value);
    }
  };
  each(1);
  lose("[limits]\ndepth_max = 20\n");
  each(2);
  // New subscriptions hear moved publishers; refused ones go on among their old peers.
  const auto newcomer = node.create_subscription<Number>("/first", 10);
  const auto of_refused = node.create_subscription<Number>("/deep", 10);
  const auto other = node.create_subscription<Number>("/last", 10);
  EXPECT_TRUE(eventually([&] { return first->get_linked_subscription_count() == 2; }));
  each(3);
  const auto number = newcomer->take();
  EXPECT_TRUE(number && number->value == 3);
  EXPECT_FALSE(of_refused->take());
  // A daemon that allows it: everything moves.
  lose();
  EXPECT_TRUE(eventually([&] {
    return first->get_linked_subscription_count() == 2 &&
           deep->get_linked_subscription_count() == 2 && last->get_linked_subscription_count() == 2;
  }));
  each(4);
  const auto heard = of_refused->take();
  EXPECT_TRUE(heard && heard->value == 4);
  Values all;
  drain(deep_reader, all);
  EXPECT_EQ(all[0].back(), 4u) << "it receives again";
}

// Its readers have no windows of it but those of the previous session, and are not told of others.
TEST_F(ReregistrationCases, MessagesOfARefusedPublisherInANewWindowReachNobody) {
  using test::Block;
  Node node("refused");
  const auto refused = node.create_publisher<Block>("/refused", test::qos_of("50rt"));
  const auto welcome = node.create_publisher<Block>("/welcome", test::qos_of("10rt"));
  const auto opaque = node.create_publisher<OpaqueBlock>("/opaque", test::qos_of("50rt"));
  test::SecondProcess reader({"blocks", "/refused", "50rv"}),
      of_opaque({"blocks", "/opaque", "50rv"});
  ASSERT_TRUE(eventually([&] {
    return refused->get_linked_subscription_count() == 1 &&
           opaque->get_linked_subscription_count() == 1;
  }));
  const auto publish_block = [](auto& publisher, std::uint64_t value) {
    auto block = publisher->borrow_loaned_message();
    block->fill(value, (std::size_t{12} << 20) / sizeof(std::uint64_t));
    return publisher->publish(std::move(block)).code;
  };
  ASSERT_EQ(publish_block(refused, 1), Errc::ok);
  lose("[limits]\ndepth_max = 20\n");
  ASSERT_EQ(publish_block(refused, 2), Errc::ok)
      << "there is room in the windows that its readers map";
  // A window of 64 MiB has room for five of them: those of the other publisher lie in further
  // ones.
  std::uint64_t published = 0;
  EXPECT_TRUE(eventually([&] {
    published += publish_block(welcome, published + 1) == Errc::ok;
    return published == 10;
  }));
  Errc code = Errc::ok;
  for (std::uint64_t value = 3; value < 10 && code == Errc::ok; ++value)
    code = publish_block(refused, value);
  EXPECT_EQ(code, Errc::heap_exhausted);
  for (std::uint64_t value = 1; value < 10; ++value)
    EXPECT_EQ(publish_block(opaque, value), Errc::heap_exhausted) << "it may lie anywhere";
  EXPECT_EQ(reader.end(), 0) << "a reader got a message that it cannot read";
  EXPECT_EQ(of_opaque.end(), 0) << "a reader got a message that it cannot read";
  // A daemon that allows it learns of all windows.
  lose();
  const auto newcomer = node.create_subscription<Block>("/refused", 50);
  ASSERT_TRUE(eventually([&] { return refused->get_linked_subscription_count() == 1; }));
  EXPECT_TRUE(eventually([&] { return publish_block(refused, 100) == Errc::ok; }));
  EXPECT_TRUE(eventually([&] {
    const auto block = newcomer->take();
    return block && block->value == 100 && block->is_intact();
  }));
}

TEST_F(ReregistrationCases, ASubscriptionThatHoldsAllItMayOfAPreviousPublisherSleeps) {
  ClientTool publisher(socket()), subscriber(socket());
  ASSERT_TRUE(meet(subscriber, "sub /t 100", publisher, "pub /t 100"));
  ASSERT_EQ(publisher.ask("publish 20 10"), "ok");
  for (int number = 1; number <= 16; ++number)  // its quota
    ASSERT_EQ(subscriber.ask("take"), std::to_string(number));
  ASSERT_EQ(subscriber.ask("take"), "none");
  end();
  begin();
  ASSERT_TRUE(are_connected({&publisher, &subscriber}));
  // It has moved when a new subscription receives from it.
  ClientTool newcomer(socket());
  ASSERT_EQ(newcomer.ask("sub /t 100"), "ok");
  ASSERT_TRUE(publisher.eventually("matched", "2"));
  ASSERT_EQ(publisher.ask("publish 5 10"), "ok");
  EXPECT_EQ(take_all(newcomer), numbers(21, 25));
  // A message that cannot be taken is no news: a sleeping thread goes on sleeping. Rings that were
  // under way arrive first.
  EXPECT_TRUE(eventually([&] { return subscriber.ask("wait 100") == "timeout"; }));
  for (int i = 0; i < 5; ++i) {
    EXPECT_EQ(subscriber.ask("take"), "none");
    EXPECT_EQ(subscriber.ask("wait 50"), "timeout");
  }
  for (int number = 1; number <= 16; ++number) ASSERT_EQ(subscriber.ask("release"), "ok");
  EXPECT_EQ(subscriber.ask("wait 10000"), "news");
  EXPECT_EQ(take_all(subscriber), numbers(17, 25));
  EXPECT_EQ(subscriber.ask("lost"), "0");
  EXPECT_TRUE(publisher.eventually("allocated", "0"));
}

TEST_F(ReregistrationCases, ACallbackThreadThatHoldsAllItMayUsesNoProcessor) {
  test::Spun<Node> node("keeper");
  Node talker("talker");
  struct {
    std::mutex mutex;
    std::vector<std::uint64_t> values;
    std::deque<ipc_shared_ptr<const Number>> held;
    clockid_t clock = 0;
  } kept;
  SubscriptionOptions options;
  options.hold_quota(2);
  const auto subscription = node.create_subscription<Number>(
      "/kept", 10,
      [&](ipc_shared_ptr<const Number> number) {
        const std::lock_guard lock(kept.mutex);
        ::pthread_getcpuclockid(::pthread_self(), &kept.clock);
        kept.values.push_back(number->value);
        kept.held.push_back(std::move(number));
      },
      options);
  const auto publisher = talker.create_publisher<Number>("/kept", 10);
  ASSERT_TRUE(eventually([&] { return publisher->get_linked_subscription_count() == 1; }));
  const auto count = [&] {
    const std::lock_guard lock(kept.mutex);
    return kept.values.size();
  };
  for (std::uint64_t value = 1; value <= 5; ++value) publish(*publisher, value);
  ASSERT_TRUE(eventually([&] { return count() == 2; }));
  lose();
  const auto newcomer = talker.create_subscription<Number>("/kept", 10);
  ASSERT_TRUE(eventually([&] { return publisher->get_linked_subscription_count() == 2; }));
  EXPECT_FALSE(publisher->wait_for_all_acked(std::chrono::seconds(0)))
      << "three messages are unread in the queue from before";
  for (std::uint64_t value = 6; value <= 8; ++value) publish(*publisher, value);
  const auto used_ms = [&] {
    timespec used{};
    ::clock_gettime(kept.clock, &used);
    return used.tv_sec * 1000 + used.tv_nsec / 1'000'000;
  };
  // CPU time of the thread, not the clock: a busy loop would use all it can get.
  const auto before = used_ms();
  std::this_thread::sleep_for(std::chrono::seconds(2));
  EXPECT_LT(used_ms() - before, 100);
  EXPECT_EQ(count(), 2u);
  for (std::size_t done = 2; done < 8; ++done) {
    {
      const std::lock_guard lock(kept.mutex);
      kept.held.pop_front();
    }
    EXPECT_TRUE(eventually([&] { return count() > done; })) << done;
  }
  EXPECT_FALSE(publisher->wait_for_all_acked(std::chrono::seconds(0)));
  for (int i = 0; i < 3; ++i) EXPECT_TRUE(newcomer->take());
  EXPECT_TRUE(publisher->wait_for_all_acked());
  const std::lock_guard lock(kept.mutex);
  EXPECT_EQ(kept.values, range(1, 8));
  kept.held.clear();
}

TEST_F(ReregistrationCases, AStoreLostWhileAPublisherWaitsToMoveCostsNothing) {
  ClientTool publisher(socket()), subscriber(socket()), stopped(socket());
  for (ClientTool* const tool : {&subscriber, &stopped}) ASSERT_EQ(tool->ask("sub /t 100"), "ok");
  ASSERT_EQ(publisher.ask("pub /t 100 tl"), "ok");
  ASSERT_TRUE(publisher.eventually("matched", "2"));
  ASSERT_EQ(publisher.ask("publish 2 10"), "ok");
  ::kill(stopped.pid(), SIGSTOP);
  int last = 2;
  // Its migration successor exists and gets nothing, because one of two readers is missing.
  for (int round = 0; round < 3; ++round) {
    end();
    begin();
    ASSERT_TRUE(are_connected({&publisher, &subscriber}));
    ASSERT_EQ(publisher.ask("publish 2 10"), "ok");
    last += 2;
  }
  EXPECT_EQ(take_all(subscriber), numbers(1, last));
  ::kill(stopped.pid(), SIGCONT);
  ASSERT_TRUE(stopped.eventually("state", "connected"));
  ASSERT_TRUE(publisher.eventually("matched", "2"));
  EXPECT_TRUE(subscriber.eventually("links", "1"));
  EXPECT_TRUE(stopped.eventually("take", "1"));
  EXPECT_EQ(stopped.ask("release"), "ok");
  std::string heard = take_all(stopped);
  ASSERT_EQ(publisher.ask("publish 2 10"), "ok");
  EXPECT_EQ(take_all(subscriber), numbers(last + 1, last + 2));
  heard += take_all(stopped);
  // A machine under load may take longer than publishers wait; then it misses some, in one piece.
  EXPECT_EQ(heard.substr(0, 2), "2 ");
  const std::string ends = numbers(last + 1, last + 2);
  EXPECT_EQ(heard.substr(heard.size() - ends.size()), ends) << heard;
  EXPECT_TRUE(stopped.eventually("links", "1"));
}

TEST_F(ReregistrationCases, APublisherThatEndsWhileItWaitsToMoveLeavesNothing) {
  ClientTool publisher(socket()), stopped(socket());
  ASSERT_TRUE(meet(stopped, "sub /t 100", publisher, "pub /t 100"));
  ::kill(stopped.pid(), SIGSTOP);
  end();
  begin();
  ASSERT_TRUE(publisher.eventually("state", "connected"));
  ASSERT_EQ(publisher.ask("publish 2 10"), "ok");
  ASSERT_EQ(publisher.ask("unpub"), "ok");
  const auto known = [](std::size_t count) {
    return eventually([&] { return test::wire_dump(socket()).endpoints.size() == count; });
  };
  EXPECT_TRUE(known(0)) << "its migration successor has left";
  ::kill(stopped.pid(), SIGCONT);
  ASSERT_TRUE(stopped.eventually("state", "connected"));
  EXPECT_EQ(take_all(stopped), numbers(1, 2));
  EXPECT_TRUE(known(1));
  EXPECT_TRUE(stopped.eventually("links", "0"));
}

TEST_F(ReregistrationCases, LossesInQuickSuccessionCostNothing) {
  ClientTool publisher(socket()), subscriber(socket());
  ASSERT_TRUE(meet(subscriber, "sub /t 100", publisher, "pub /t 100"));
  int last = 0;
  std::string heard;
  for (int round = 0; round < 20; ++round) {
    ASSERT_EQ(publisher.ask("publish 1 10"), "ok");
    ++last;
    end();
    begin();
    // At another step each time: hello, windows, endpoints, the move.
    std::this_thread::sleep_for(std::chrono::microseconds(500 * round));
    if (round % 5 == 0) heard += take_all(subscriber);
  }
  ASSERT_TRUE(are_connected({&publisher, &subscriber}));
  ASSERT_TRUE(publisher.eventually("matched", "1"));
  ASSERT_EQ(publisher.ask("publish 2 10"), "ok");
  last += 2;
  EXPECT_TRUE(eventually([&] {
    heard += take_all(subscriber);
    return heard.size() >= numbers(1, last).size();
  }));
  EXPECT_EQ(heard, numbers(1, last));
  EXPECT_EQ(subscriber.ask("lost"), "0");
  EXPECT_TRUE(subscriber.eventually("links", "1"));
  EXPECT_TRUE(publisher.eventually("allocated", "0"));
}

}  // namespace
}  // namespace agnocast
