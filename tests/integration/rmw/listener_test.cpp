// SPDX-License-Identifier: Apache-2.0
//
// Goal: a listener's callbacks run for each arrival once, whichever thread takes meanwhile, and
// none runs after it was replaced. Method: endpoints of this process and the real daemon; counts
// that must be reached, and threads that replace callbacks while others publish.

#include <ros2/rmw_agnocast_cpp/core/listener.hpp>
#include <ros2/rmw_agnocast_cpp/core/services.hpp>
#include <ros2/rmw_agnocast_cpp/core/topics.hpp>

#include <tests/integration/rmw/messages.hpp>
#include <tests/support/processes/daemon_process.hpp>
#include <tests/support/processes/suite_daemon.hpp>

#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <atomic>
#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <thread>
#include <vector>

namespace agnocast::rmw {
namespace {

using namespace std::chrono_literals;
using test::eventually;

/// A callback that counts.
struct Heard {
  std::atomic<std::uint64_t> count{0}, calls{0};

  static void hear(const void* self, std::size_t count) {
    auto& heard = *static_cast<Heard*>(const_cast<void*>(self));
    ++heard.calls;
    heard.count += count;
  }
};

/// A callback that does anything.
struct Reaction {
  std::function<void(std::size_t)> react;

  static void run(const void* self, std::size_t count) {
    static_cast<const Reaction*>(self)->react(count);
  }
};

class RmwListener : public test::SuiteDaemon {
 protected:
  std::unique_ptr<TopicPublisher> publisher(const QoS& qos) {
    return valued(TopicPublisher::create(node, topic, cpp_support<Everything>(), qos));
  }
  std::unique_ptr<TopicSubscription> subscription(const QoS& qos) {
    return valued(TopicSubscription::create(node, topic, cpp_support<Everything>(), qos, false));
  }
  static void expect_match(const TopicSubscription& reader) {
    ASSERT_TRUE(eventually([&] { return reader.endpoint().get_linked_publisher_count() == 1; }));
  }
  static void publish(TopicPublisher& writer, int count = 1) {
    const Everything message{};
    for (int i = 0; i < count; ++i) ASSERT_TRUE(writer.publish(&message));
  }
  /// Waits for keep-all subscriptions.
  static void publish_all(TopicPublisher& writer, std::uint64_t count) {
    const Everything message{};
    for (std::uint64_t i = 0; i < count; ++i) {
      while (!writer.publish(&message)) std::this_thread::yield();
    }
  }
  static bool take(TopicSubscription& reader) {
    Everything message;
    MessageInfo info;
    return reader.take(&message, info);
  }
  /// Takes once for each message that is reported.
  static Reaction taking_what_it_hears_of(TopicSubscription& reader,
                                          std::atomic<std::uint64_t>& taken) {
    return {[&](std::size_t come) {
      for (; come > 0; --come) taken += take(reader);
    }};
  }
  void hear(Listenable& from, Heard& heard) {
    ASSERT_TRUE(listener.listen(from, &Heard::hear, &heard));
  }
  static void expect(const Heard& heard, std::uint64_t count) {
    EXPECT_TRUE(eventually([&] { return heard.count >= count; })) << heard.count;
    EXPECT_EQ(heard.count, count);
  }

  const NodeName node{"node", "/" + own("space")};
  const std::string topic = "/" + own("topic");
  WaitPool pool;
  Listener listener{pool};
};

TEST_F(RmwListener, EachMessageIsReportedOnce) {
  const auto writer = publisher(QoS(10));
  const auto reader = subscription(QoS(10));
  expect_match(*reader);
  Heard first, second, third;
  hear(*reader, first);
  publish(*writer);
  expect(first, 1);
  hear(*reader, second);
  publish(*writer);
  expect(second, 1);
  ASSERT_TRUE(listener.listen(*reader, nullptr, nullptr));
  publish(*writer, 3);
  hear(*reader, third);
  expect(third, 3);
  EXPECT_EQ(third.calls, 1u);
  while (take(*reader)) {
  }
  publish(*writer);
  expect(third, 4);
  EXPECT_EQ(first.count, 1u);
  EXPECT_EQ(second.count, 1u);
  listener.forget(*reader);
}

TEST_F(RmwListener, WhatCannotBeTakenAnyMoreIsNotReported) {
  const auto writer = publisher(QoS(3));
  const auto reader = subscription(QoS(3));
  expect_match(*reader);
  publish(*writer, 5);  // the oldest two are beyond the depth
  EXPECT_TRUE(take(*reader));
  Heard heard;
  hear(*reader, heard);
  expect(heard, 2);
  listener.forget(*reader);
}

TEST_F(RmwListener, WhatTheHoldQuotaRefusedIsReportedAgainWhenItCanBeTaken) {
  const auto writer = publisher(QoS(100));
  const auto reader = subscription(QoS(100));
  expect_match(*reader);
  Heard heard;
  hear(*reader, heard);
  publish(*writer, 70);
  expect(heard, 70);
  std::vector<const void*> held;
  MessageInfo info;
  while (const void* const one = reader->take_loaned(info)) held.push_back(one);
  const std::size_t left = 70 - held.size();
  ASSERT_GT(left, 0u) << "there is a quota";
  for (const void* const one : held) EXPECT_TRUE(reader->give_back(one));
  EXPECT_TRUE(eventually([&] { return heard.count >= 70 + left; })) << heard.count;
  for (std::size_t i = 0; i < left; ++i) EXPECT_TRUE(take(*reader));
  listener.forget(*reader);
}

TEST_F(RmwListener, WhatHasExpiredKeepsNothingFromBeingReported) {
  const auto writer = publisher(QoS(10).lifespan(20ms));
  const auto reader = subscription(QoS(10));
  expect_match(*reader);
  Heard heard;
  hear(*reader, heard);
  publish(*writer, 5);
  expect(heard, 5);
  std::this_thread::sleep_for(30ms);
  EXPECT_FALSE(take(*reader));
  publish(*writer, 3);
  expect(heard, 8);
  listener.forget(*reader);
}

TEST_F(RmwListener, ATakerThatOnlyTakesWhatItHearsOfGetsAll) {
  constexpr std::uint64_t count = 20'000;
  const auto writer = publisher(QoS(1000).keep_all());
  const auto reader = subscription(QoS(1000).keep_all());
  expect_match(*reader);
  std::atomic<std::uint64_t> taken{0};
  const Reaction reaction = taking_what_it_hears_of(*reader, taken);
  ASSERT_TRUE(listener.listen(*reader, &Reaction::run, &reaction));
  publish_all(*writer, count);
  EXPECT_TRUE(eventually([&] { return taken == count; })) << taken;
  listener.forget(*reader);
}

TEST_F(RmwListener, OfSeveralPublishersAsWell) {
  constexpr std::uint64_t count = 5'000;
  constexpr std::size_t threads = 3;
  const auto reader = subscription(QoS(1000).keep_all());
  std::vector<std::unique_ptr<TopicPublisher>> writers(threads);
  for (auto& writer : writers) writer = publisher(QoS(1000).keep_all());
  ASSERT_TRUE(
      eventually([&] { return reader->endpoint().get_linked_publisher_count() == threads; }));
  std::atomic<std::uint64_t> taken{0};
  const Reaction reaction = taking_what_it_hears_of(*reader, taken);
  ASSERT_TRUE(listener.listen(*reader, &Reaction::run, &reaction));
  std::vector<std::thread> publishing;
  for (auto& writer : writers) publishing.emplace_back([&] { publish_all(*writer, count); });
  for (std::thread& thread : publishing) thread.join();
  EXPECT_TRUE(eventually([&] { return taken == threads * count; })) << taken;
  listener.forget(*reader);
}

TEST_F(RmwListener, AnotherTakerLosesNoArrival) {
  constexpr std::uint64_t count = 20'000;
  const auto writer = publisher(QoS(1000).keep_all());
  const auto reader = subscription(QoS(1000).keep_all());
  expect_match(*reader);
  std::atomic<std::uint64_t> taken{0};
  const Reaction reaction = taking_what_it_hears_of(*reader, taken);
  ASSERT_TRUE(listener.listen(*reader, &Reaction::run, &reaction));
  std::atomic<bool> is_over{false};
  std::thread other([&] {
    while (!is_over) taken += take(*reader);
  });
  publish_all(*writer, count);
  is_over = true;
  other.join();
  EXPECT_TRUE(eventually([&] { return taken == count; })) << taken;
  listener.forget(*reader);
}

TEST_F(RmwListener, NoCallbackRunsAfterItWasReplaced) {
  const auto writer = publisher(QoS(10));
  const auto reader = subscription(QoS(10));
  expect_match(*reader);
  std::atomic<bool> is_over{false};
  std::thread publishing([&] {
    while (!is_over) publish(*writer);
  });
  std::atomic<int> called{0};
  struct Watched {
    std::atomic<bool> is_replaced{false};
    Reaction reaction;
  };
  std::unique_ptr<Watched> current;
  for (int round = 0; round < 300; ++round) {
    auto next = std::make_unique<Watched>();
    next->reaction.react = [&called, one = next.get()](std::size_t) {
      EXPECT_FALSE(one->is_replaced);
      std::this_thread::yield();
      EXPECT_FALSE(one->is_replaced);
      ++called;
    };
    const int before = called;
    ASSERT_TRUE(listener.listen(*reader, &Reaction::run, &next->reaction));
    if (current != nullptr) current->is_replaced = true;
    current = std::move(next);
    if (round % 2 == 0) {
      EXPECT_TRUE(eventually([&] { return called != before; }));
    }
    if (round % 3 == 0) continue;
    if (round % 3 == 1) {
      listener.forget(*reader);
    } else {
      ASSERT_TRUE(listener.listen(*reader, nullptr, nullptr));
    }
    current.reset();
  }
  listener.forget(*reader);
  is_over = true;
  publishing.join();
}

TEST_F(RmwListener, ACallbackMayReplaceItself) {
  const auto writer = publisher(QoS(10));
  const auto reader = subscription(QoS(10));
  expect_match(*reader);
  Heard heard;
  std::atomic<int> called{0};
  const Reaction reaction{[&](std::size_t) {
    ++called;
    EXPECT_TRUE(take(*reader));
    hear(*reader, heard);
  }};
  ASSERT_TRUE(listener.listen(*reader, &Reaction::run, &reaction));
  publish(*writer);
  EXPECT_TRUE(eventually([&] { return called == 1; }));
  publish(*writer, 2);
  expect(heard, 2);
  EXPECT_EQ(called, 1);
  listener.forget(*reader);
}

TEST_F(RmwListener, RequestsAndResponsesAreReported) {
  const ServiceSupport support{cpp_support<Everything>(), cpp_support<Everything>()};
  const std::string name = "/" + own("service");
  const auto server = valued(ServiceServer::create(node, name, support, ServicesQoS()));
  const auto client = valued(ServiceClient::create(node, name, support, ServicesQoS()));
  ASSERT_TRUE(eventually([&] { return client->server_count() == 1; }));
  Heard requests, responses;
  hear(*server, requests);
  hear(*client, responses);
  const Everything message{};
  for (std::uint64_t i = 1; i <= 5; ++i) {
    ASSERT_TRUE(client->send(&message));
    expect(requests, i);
    Everything got;
    RequestId id;
    ASSERT_TRUE(server->take(&got, id));
    ASSERT_TRUE(server->send(id, &message));
    expect(responses, i);
    std::int64_t number = 0;
    if (i % 2 == 0) {
      ASSERT_TRUE(client->take(&got, number));
    }
  }
  Heard later;
  hear(*client, later);
  ASSERT_TRUE(client->send(&message));
  expect(requests, 6);
  Everything got;
  RequestId id;
  ASSERT_TRUE(server->take(&got, id));
  ASSERT_TRUE(server->send(id, &message));
  expect(later, 1);
  listener.forget(*server);
  listener.forget(*client);
}

TEST_F(RmwListener, AResponseThatNobodyWantsHidesNone) {
  const ServiceSupport support{cpp_support<Everything>(), cpp_support<Everything>()};
  const std::string name = "/" + own("service");
  const auto client = valued(ServiceClient::create(node, name, support, ServicesQoS()));
  const auto stays = valued(ServiceServer::create(node, name, support, ServicesQoS()));
  auto goes = valued(ServiceServer::create(node, name, support, ServicesQoS()));
  Heard stays_heard, goes_heard, responses;
  hear(*stays, stays_heard);
  hear(*goes, goes_heard);
  hear(*client, responses);
  const Everything message{};
  Everything got;
  std::int64_t number = 0;
  const auto answer = [&](ServiceServer& server, const Heard& heard, std::uint64_t requests) {
    EXPECT_TRUE(eventually([&] { return heard.count >= requests; }));
    RequestId id;
    ASSERT_TRUE(server.take(&got, id));
    ASSERT_TRUE(server.send(id, &message));
  };
  ASSERT_TRUE(eventually([&] { return client->server_count() == 2; }));
  for (std::uint64_t i = 1; i <= 5; ++i) {
    const std::uint64_t before = responses.count;
    ASSERT_TRUE(client->send(&message));
    answer(*stays, stays_heard, i);
    answer(*goes, goes_heard, i);
    EXPECT_TRUE(eventually([&] { return responses.count >= before + 2; })) << responses.count;
    EXPECT_TRUE(client->take(&got, number));
    EXPECT_FALSE(client->take(&got, number)) << "of the other server, for a request that is over";
  }
  listener.forget(*goes);
  goes.reset();
  const std::uint64_t before = responses.count;
  ASSERT_TRUE(client->send(&message));
  answer(*stays, stays_heard, 6);
  EXPECT_TRUE(eventually([&] { return responses.count > before; }));
  EXPECT_TRUE(client->take(&got, number));
  listener.forget(*stays);
  listener.forget(*client);
}

TEST_F(RmwListener, EventsAreReported) {
  const auto reader = subscription(QoS(1).reliable().deadline(50ms));
  Heard refused, alive, missed;
  hear(reader->events().incompatible_qos, refused);
  hear(reader->events().liveliness_changed, alive);
  hear(reader->events().deadline_missed, missed);
  const auto other = publisher(QoS(1).best_effort());
  expect(refused, 1);
  auto writer = publisher(QoS(1).deadline(50ms));
  expect(alive, 1);
  EXPECT_EQ(reader->events().liveliness_changed.take().alive_count, 1);
  expect_match(*reader);
  publish(*writer);
  EXPECT_TRUE(eventually([&] { return missed.count >= 2; }));
  Heard lost;
  hear(reader->events().message_lost, lost);
  publish(*writer, 3);  // the depth is 1
  EXPECT_TRUE(take(*reader));
  EXPECT_TRUE(eventually([&] { return lost.count >= 2; }));
  writer.reset();
  expect(alive, 2);
  for (Listenable* const one : reader->listenables()) listener.forget(*one);
}

TEST_F(RmwListener, AServerIsReportedWhenItIsMatched) {
  const ServiceSupport support{cpp_support<Everything>(), cpp_support<Everything>()};
  const auto client = valued(ServiceClient::create(node, topic, support, QoS(1)));
  for (std::uint64_t come = 1; come <= 3; ++come) {
    Heard heard;
    hear(client->server_arrival(), heard);
    EXPECT_EQ(heard.count, 0u);
    auto server = valued(ServiceServer::create(node, topic, support, QoS(1)));
    expect(heard, 1);
    EXPECT_EQ(client->server_count(), 1u);
    listener.forget(client->server_arrival());  // nothing is left to listen to, until the next turn
    server.reset();
    EXPECT_TRUE(eventually([&] { return client->server_count() == 0; }));
  }
}

TEST_F(RmwListener, MayEndBeforeWhatItListensTo) {
  const auto writer = publisher(QoS(10));
  const auto reader = subscription(QoS(10));
  expect_match(*reader);
  Heard heard;
  {
    Listener short_lived(pool);
    ASSERT_TRUE(short_lived.listen(*reader, &Heard::hear, &heard));
    publish(*writer);
    expect(heard, 1);
  }
  publish(*writer);
  EXPECT_TRUE(take(*reader));
  EXPECT_EQ(heard.count, 1u);
}

#if !defined(AGNOCAST_TEST_THREADS_SANITIZED)
TEST_F(RmwListener, AForkedChildHasNoCallbacks) {
  const auto reader = subscription(QoS(10));
  Heard heard;
  hear(*reader, heard);
  const pid_t child = ::fork();
  ASSERT_GE(child, 0);
  if (child == 0) {
    const auto listened = listener.listen(*reader, &Heard::hear, &heard);
    listener.forget(*reader);
    ::_exit(listened || listened.error().code != Errc::shut_down ? 1 : 0);
  }
  int status = -1;
  ASSERT_EQ(::waitpid(child, &status, 0), child);
  EXPECT_EQ(status, 0);
  listener.forget(*reader);
}
#endif

}  // namespace
}  // namespace agnocast::rmw
