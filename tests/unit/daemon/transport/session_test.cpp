// SPDX-License-Identifier: Apache-2.0
//
// Goal: a session's record of what its process was notified of is right and bounded. Method: the
// record alone, without a socket, and with the endpoint manager that asks it.

#include <daemon/transport/session.hpp>
#include <tests/support/processes/daemon_core.hpp>

#include <gtest/gtest.h>

#include <algorithm>

#include <memory>
#include <string>
#include <vector>

namespace agnocast::daemon {
namespace {

using abi::wire::Kind;

constexpr Announced publisher{Kind::publisher, 1, 2};
constexpr Announced subscription(std::uint64_t index) { return {Kind::subscription, 1, index}; }

TEST(CollisionsNotified, IsNewsOncePerPairAndAfterEachChange) {
  CollisionsNotified notified(std::make_shared<KeptForUser>());
  const CollisionsNotified::Collision what{10, 20, 0, true};
  EXPECT_TRUE(notified.report(publisher, subscription(0), what));
  EXPECT_FALSE(notified.report(publisher, subscription(0), what));
  EXPECT_TRUE(notified.report(publisher, subscription(1), what));
  EXPECT_FALSE(notified.report(publisher, subscription(0), what));
  for (const CollisionsNotified::Collision& other :
       {CollisionsNotified::Collision{11, 20, 0, true},
        CollisionsNotified::Collision{11, 21, 0, true},
        CollisionsNotified::Collision{11, 21, 1, true},
        CollisionsNotified::Collision{11, 21, 1, false}}) {
    EXPECT_TRUE(notified.report(publisher, subscription(0), other));
    EXPECT_FALSE(notified.report(publisher, subscription(0), other));
  }
}

TEST(CollisionsNotified, IsBoundedHoweverManyPairsCollide) {
  CollisionsNotified notified(std::make_shared<KeptForUser>());
  const CollisionsNotified::Collision what{10, 20, 0, true};
  constexpr std::uint64_t pairs = 3 * CollisionsNotified::count_max;
  std::uint64_t reported = 0, repeated = 0;
  std::size_t most = 0;
  for (std::uint64_t i = 0; i < pairs; ++i) {
    if (notified.report(publisher, subscription(i), what)) ++reported;
    if (notified.report(publisher, subscription(i), what)) ++repeated;
    most = std::max(most, notified.size());
  }
  EXPECT_EQ(reported, pairs);
  EXPECT_EQ(repeated, 0u) << "this pair was just reported";
  EXPECT_LE(most, CollisionsNotified::count_max);
}

TEST(CollisionsNotified, IsBoundedPerUser) {
  const auto user = std::make_shared<KeptForUser>(), other = std::make_shared<KeptForUser>();
  const CollisionsNotified::Collision what{10, 20, 0, true};
  // Used by its other processes: four of the sessions find room.
  constexpr std::uint64_t used =
      NotedBytes::of_user_max - 4 * CollisionsNotified::count_max * CollisionsNotified::entry_bytes;
  user->noted_bytes = used;
  std::vector<CollisionsNotified> sessions;
  for (std::uint64_t s = 0; s < 10; ++s) {
    CollisionsNotified& notified = sessions.emplace_back(user);
    std::uint64_t reported = 0;
    for (std::uint64_t i = 0; i < CollisionsNotified::count_max; ++i)
      if (notified.report(publisher, subscription(i), what)) ++reported;
    EXPECT_EQ(reported, CollisionsNotified::count_max);
    ASSERT_LE(user->noted_bytes, NotedBytes::of_user_max + (s + 1) * NotedBytes::own_max);
  }
  CollisionsNotified of_another(other);
  EXPECT_TRUE(of_another.report(publisher, subscription(0), what));
  std::uint64_t reported = 1;
  for (std::uint64_t i = 1; i < CollisionsNotified::count_max; ++i)
    if (of_another.report(publisher, subscription(i), what)) ++reported;
  EXPECT_EQ(reported, CollisionsNotified::count_max);
  EXPECT_FALSE(of_another.report(publisher, subscription(0), what))
      << "another user has its own room";
  EXPECT_GT(user->noted_bytes, NotedBytes::of_user_max) << "the later ones found no room";
  sessions.clear();
  EXPECT_EQ(user->noted_bytes, used);
}

TEST(AnnouncementNumbers, AreExactWhileThereIsRoom) {
  AnnouncementNumbers numbers(std::make_shared<KeptForUser>());
  numbers.announced(subscription(0), 10);
  numbers.announced(publisher, 12);
  EXPECT_TRUE(numbers.is_void(subscription(0), 9));
  EXPECT_FALSE(numbers.is_void(subscription(0), 10));
  numbers.announced(subscription(0), 20);
  EXPECT_TRUE(numbers.is_void(subscription(0), 19));
  EXPECT_FALSE(numbers.is_void(publisher, 12));
  numbers.forget(subscription(0));
  EXPECT_FALSE(numbers.is_void(subscription(0), 0));
  EXPECT_FALSE(numbers.may_be_void(subscription(0), 0)) << "the process itself has acknowledged it";
  EXPECT_EQ(numbers.size(), 1u);
}

TEST(AnnouncementNumbers, AreBoundedPerUserAndReportWhatTheyCannotJudge) {
  const auto user = std::make_shared<KeptForUser>();
  constexpr std::uint64_t own_count = NotedBytes::own_max / AnnouncementNumbers::entry_bytes;
  AnnouncementNumbers first(user), second(user);
  std::uint64_t packet = 0;
  const auto subject = [](std::uint64_t i) {
    return Announced{Kind::subscription, static_cast<std::uint32_t>(i >> 9), i & 511};
  };
  for (std::uint64_t i = 0;
       user->noted_bytes + AnnouncementNumbers::entry_bytes <= NotedBytes::of_user_max; ++i)
    first.announced(subject(i), ++packet);
  for (std::uint64_t i = 0; i < own_count; ++i) second.announced(subject(i), i + 1);
  EXPECT_EQ(second.size(), own_count) << "its own minimum";
  EXPECT_TRUE(second.is_void(subject(0), 0));

  second.announced(subject(own_count), own_count + 1);
  EXPECT_LE(user->noted_bytes, NotedBytes::of_user_max + NotedBytes::own_max);
  EXPECT_LT(second.size(), own_count);
  EXPECT_TRUE(second.may_be_void(subject(0), 0));
  EXPECT_FALSE(second.may_be_void(subject(0), own_count))
      << "its process has read all forgotten packets";
  EXPECT_FALSE(second.may_be_void(subject(own_count), 0));
  EXPECT_TRUE(second.is_void(subject(own_count), 0)) << "the newer half is exact";
  EXPECT_TRUE(second.is_void(subject(own_count - 1), own_count - 1));
  EXPECT_EQ(first.size(), packet) << "entries of another session are kept";
}

// An acknowledged place must not stay taken because the daemon cannot judge the statement.
TEST(AnnouncementNumbers, MakeAProcessReconnectIfTheyCannotJudgeItsStatement) {
  test::DaemonCore core;
  const auto user = std::make_shared<KeptForUser>();
  user->noted_bytes = NotedBytes::of_user_max;  // used by its other processes
  const ClientIndex reader = core.process(1), writer = core.process(2);
  const auto connect = [&] {
    core.channel.sessions.try_emplace(reader, PacketSocket(), PeerIdentity(), user);
  };
  connect();
  std::vector<EndpointRef> publishers;
  for (std::uint64_t i = 0; i <= NotedBytes::own_max / AnnouncementNumbers::entry_bytes; ++i) {
    const std::string topic = "/topic" + std::to_string(i / 200);
    if (i % 200 == 0) core.create(reader, Kind::subscription, topic);
    publishers.push_back(core.create(writer, Kind::publisher, topic));
  }
  const auto says_unlinked = [&](const EndpointRef& ref, std::uint64_t seen) {
    wire::Unlinked statement{};
    statement.kind = ref.kind;
    statement.topic = number(ref.topic);
    statement.index = ref.index;
    statement.generation = core.registry.generation_of(ref);
    statement.seen = seen;
    EXPECT_TRUE(core.endpoint_manager.unlinked(reader, statement));
    return !core.registry.notified_of(ref).contains(number(reader));
  };
  const auto has_read = [&] { return core.channel.session_of(reader)->packet_count(); };
  EXPECT_TRUE(says_unlinked(publishers[0], has_read()))
      << "the process has read all forgotten packets";
  ASSERT_NE(core.channel.session_of(reader), nullptr);
  EXPECT_FALSE(says_unlinked(publishers[1], 5));
  ASSERT_EQ(core.channel.session_of(reader), nullptr) << "the process must reconnect";
  connect();
  EXPECT_TRUE(says_unlinked(publishers[1], has_read()));
}

}  // namespace
}  // namespace agnocast::daemon
