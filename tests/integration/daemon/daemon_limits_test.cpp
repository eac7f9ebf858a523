// SPDX-License-Identifier: Apache-2.0
//
// Goal: limits bound a user's resources, rules its actions; each refusal has its code and names
// the limit or rule, and other users notice nothing. Method: small limits in the configuration,
// raw clients up to them and one further; clients of another user as children (needs root).

#include <agnocast/abi/client_region.hpp>
#include <tests/integration/daemon/raw_node.hpp>
#include <tests/support/processes/lowered_limit.hpp>

#include <gtest/gtest.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <functional>
#include <memory>
#include <utility>
#include <vector>

namespace agnocast::test {
namespace {

using abi::Qos;
using wire::Opcode;

const char* const small_heap =
    "[daemon]\nsocket_mode = \"0666\"\n[heap]\nwindow_bytes = \"64MiB\"\narena_bytes = \"1GiB\"\n";

std::unique_ptr<WireClient> greeted(const DaemonProcess& daemon) {
  auto client = std::make_unique<WireClient>(daemon.socket_path());
  EXPECT_EQ(client->hello().opcode(), Opcode::welcome);
  return client;
}

void expect_quota(const Incoming& answer, const char* name) {
  EXPECT_EQ(answer.refused_code(), Errc::quota_exceeded) << answer.refused_text();
  EXPECT_NE(answer.refused_text().find(name), std::string::npos) << answer.refused_text();
}

TEST(DaemonLimits, CountsEndpointsExecutorsAndHeldMessagesOfAUser) {
  DaemonProcess daemon({.config = std::string(small_heap) +
                                  "[quota]\npublishers = 3\nsubscriptions = 2\nwait_sets = 2\n"
                                  "held_messages = 9\nheap_bytes = \"128MiB\"\n"});
  const auto a = greeted(daemon), b = greeted(daemon);
  EXPECT_EQ(a->create_publisher("/a").opcode(), Opcode::endpoint_created);
  EXPECT_EQ(b->create_publisher("/a").opcode(), Opcode::endpoint_created);
  EXPECT_EQ(b->create_publisher("/b").opcode(), Opcode::endpoint_created);
  expect_quota(a->create_publisher("/c"), "[quota] publishers is 3");

  EXPECT_EQ(a->open_wait_set(0).opcode(), Opcode::wait_set_opened);
  EXPECT_EQ(b->open_wait_set(0).opcode(), Opcode::wait_set_opened);
  expect_quota(b->open_wait_set(1), "[quota] wait_sets is 2");

  auto greedy = WireClient::endpoint("/x", Qos{});
  greedy.quota = 10;
  expect_quota(a->ask(Opcode::create_subscription, greedy), "[quota] held_messages is 9");
  EXPECT_EQ(a->create_subscription("/x").opcode(), Opcode::endpoint_created);
  greedy.quota = 6;
  expect_quota(a->ask(Opcode::create_subscription, greedy), "[quota] held_messages is 9");
  EXPECT_EQ(b->create_subscription("/x").opcode(), Opcode::endpoint_created);
  expect_quota(b->create_subscription("/x"), "[quota] subscriptions is 2");

  EXPECT_EQ(a->open_window(0).opcode(), Opcode::window_opened);
  EXPECT_EQ(b->open_window(0).opcode(), Opcode::window_opened);
  expect_quota(a->open_window(1), "[quota] heap_bytes is 134217728");

  EXPECT_TRUE(daemon.wait_for_log("code=quota_exceeded"));
  if (::geteuid() != 0) GTEST_SKIP() << "the rest needs root and another user";
  EXPECT_EQ(in_other_user([&] {
              const auto c = greeted(daemon);
              return c->create_publisher("/c").opcode() == Opcode::endpoint_created ? 0 : 1;
            }),
            0)
      << "another user has limits of its own";
}

// The memory of an endpoint stays with its process after the endpoint has ended.
TEST(DaemonLimits, CountsMemoryThatAUsersProcessesKeepForEndedEndpoints) {
  DaemonProcess daemon(
      {.config = std::string(small_heap) +
                 "[limits]\nwide_topics = []\n[quota]\npublishers = 3\nsubscriptions = 1\n"});
  std::vector<std::unique_ptr<WireClient>> processes;
  Incoming refused;
  while (processes.size() < 20 && refused.bytes.empty()) {
    processes.push_back(greeted(daemon));
    for (int again = 0; again < 5; ++again) {  // within one process they share the same memory
      Incoming made = processes.back()->create_publisher("/a");
      if (made.opcode() != Opcode::endpoint_created) {
        refused = std::move(made);
        break;
      }
      const auto publisher = made.as<wire::EndpointCreated>();
      for (const Opcode end : {Opcode::leave, Opcode::drained})
        EXPECT_EQ(processes.back()
                      ->reference(end, wire::Kind::publisher, publisher.topic, publisher.index,
                                  publisher.generation)
                      .opcode(),
                  Opcode::done);
    }
  }
  ASSERT_FALSE(refused.bytes.empty()) << "the daemon does not count them";
  expect_quota(refused, "for present and past endpoints");
  EXPECT_GT(processes.size(), 4u)
      << "endpoints that may exist at once have room, in whatever processes";
  processes.erase(processes.begin(), processes.begin() + 2);
  EXPECT_TRUE(eventually([&] {
    return processes.back()->create_publisher("/a").opcode() == Opcode::endpoint_created;
  })) << "a process that has ended is not counted";
}

TEST(DaemonLimits, CountsThePlacesOfAUserInEachTopic) {
  DaemonProcess daemon(
      {.config = std::string(small_heap) +
                 "[quota]\npublishers_per_topic = 2\nsubscriptions_per_topic = 1\n"});
  const auto a = greeted(daemon), b = greeted(daemon);
  EXPECT_EQ(a->create_publisher("/a").opcode(), Opcode::endpoint_created);
  EXPECT_EQ(b->create_publisher("/a").opcode(), Opcode::endpoint_created);
  EXPECT_EQ(a->create_publisher("/a").refused_text(),
            "[quota] publishers_per_topic is 2, this user has 2 and asks for 1 more");
  EXPECT_EQ(a->create_publisher("/b").opcode(), Opcode::endpoint_created);
  EXPECT_EQ(a->open_wait_set().opcode(), Opcode::wait_set_opened);
  EXPECT_EQ(b->open_wait_set().opcode(), Opcode::wait_set_opened);
  EXPECT_EQ(a->create_subscription("/a").opcode(), Opcode::endpoint_created);
  expect_quota(b->create_subscription("/a"), "[quota] subscriptions_per_topic is 1");
  EXPECT_EQ(b->create_subscription("/b").opcode(), Opcode::endpoint_created);
  if (::geteuid() != 0) GTEST_SKIP() << "the rest needs root and another user";
  EXPECT_EQ(in_other_user([&] {
              const auto c = greeted(daemon);
              return c->create_publisher("/a").opcode() == Opcode::endpoint_created ? 0 : 1;
            }),
            0)
      << "another user has places of its own";
}

TEST(DaemonLimits, GivesAHoldQuotaOrNamesThePossibleOne) {
  if (::geteuid() != 0) GTEST_SKIP() << "needs root and another user";
  // The pool has 245 messages.
  DaemonProcess daemon(
      {.more_config = "[limits]\nslots_per_publisher = 2048\nsubscriptions_per_topic = 768\n"});
  const auto a = greeted(daemon);
  EXPECT_EQ(a->create_publisher("/t").opcode(), Opcode::endpoint_created);
  EXPECT_EQ(a->open_wait_set().opcode(), Opcode::wait_set_opened);
  auto wanted = WireClient::endpoint("/t", Qos{});
  wanted.quota = 2048;
  for (int i = 0; i < 5; ++i) {
    EXPECT_EQ(a->ask(Opcode::create_subscription, wanted).opcode(), Opcode::endpoint_created);
    EXPECT_EQ(a->expect<wire::Announcement>(Opcode::announce).quota, 2048u)
        << "for the user's own publisher";
    // The daemon announces the subscription to the publisher as well.
    EXPECT_EQ(a->expect<wire::Announcement>(Opcode::announce).quota, 2048u);
  }
  EXPECT_EQ(in_other_user([&] {
              const auto other = greeted(daemon);
              EXPECT_EQ(other->open_wait_set().opcode(), Opcode::wait_set_opened);
              const auto ask = [&](std::uint64_t quota) {
                wanted.quota = quota;
                return other->ask(Opcode::create_subscription, wanted);
              };
              const Incoming refused = ask(2048);
              EXPECT_EQ(refused.refused_code(), Errc::quota_exceeded);
              EXPECT_EQ(
                  refused.refused_text(),
                  "the publishers of /t belong to other users and have 62 messages left for one "
                  "more subscription of user 65534: ask for a hold_quota of at most that, not "
                  "2048");
              const auto quota_given = [&] {
                return other->expect<wire::Announcement>(Opcode::announce).quota;
              };
              EXPECT_EQ(ask(64 | wire::quota_or_less).opcode(), Opcode::endpoint_created);
              EXPECT_EQ(quota_given(), 9u) << "an eighth of 61, and one";
              EXPECT_EQ(ask(55).refused_code(), Errc::quota_exceeded);
              EXPECT_EQ(ask(53).opcode(), Opcode::endpoint_created);
              EXPECT_EQ(quota_given(), 53u);
              EXPECT_EQ(ask(64 | wire::quota_or_less).opcode(), Opcode::endpoint_created);
              EXPECT_EQ(quota_given(), 2u);
              EXPECT_EQ(ask(64 | wire::quota_or_less).opcode(), Opcode::endpoint_created);
              EXPECT_EQ(quota_given(), 1u) << "every user may read";
              return 0;
            }),
            0);
  EXPECT_TRUE(daemon.wait_for_log("limit=hold_quota value=62"));
}

/// Takes windows for this user, in processes of its own, until the daemon refuses.
struct Taker {
  explicit Taker(const DaemonProcess& daemon) {
    do {
      if (got % abi::window_count_max == 0) clients.push_back(greeted(daemon));
      answer = clients.back()->open_window(got % abi::window_count_max);
    } while (answer.opcode() == Opcode::window_opened && ++got < 1000);
  }
  std::vector<std::unique_ptr<WireClient>> clients;
  unsigned got = 0;
  Incoming answer;
};

TEST(DaemonLimits, KeepsAQuarterOfTheArenaFromAnyOneUser) {
  const DaemonProcess daemon({.config = small_heap});
  const Taker taker(daemon);
  EXPECT_EQ(taker.got, 12u) << "of 16";
  expect_quota(taker.answer, "[quota] heap_bytes is 805306368");
}

TEST(DaemonLimits, GivesTheOnlyWindowOfAnArena) {
  const DaemonProcess daemon(
      {.config = "[heap]\nwindow_bytes = \"64MiB\"\narena_bytes = \"64MiB\"\n"});
  EXPECT_EQ(Taker(daemon).got, 1u);
}

// Each process costs the keeper two descriptors, each window and each executor one.
TEST(DaemonLimits, KeepsAQuarterOfTheStoreFromAnyOneUser) {
  if (::geteuid() != 0) GTEST_SKIP() << "needs root and another user";
  // In a process of its own: the supervisor's room depends on the limit of open files.
  const pid_t pid = ::fork();
  if (pid == 0) {
    const rlimit small{512, 512};
    EXPECT_EQ(::setrlimit(RLIMIT_NOFILE, &small), 0);
    const DaemonProcess daemon(
        {.config = "[daemon]\nsocket_mode = \"0666\"\n[heap]\nwindow_bytes = \"64MiB\"\n"
                   "arena_bytes = \"16GiB\"\n[quota]\nheap_bytes = \"unlimited\"\n"});
    // The supervisor keeps 224: half of the rest of the limit. 16 processes of 8 windows, and one
    // of 6.
    const Taker taker(daemon);
    EXPECT_EQ(taker.got, 16u * 8 + 6);
    expect_quota(taker.answer, "three quarters of FileDescriptorStoreMax is 168");
    EXPECT_EQ(in_other_user([&] {
                const auto other = greeted(daemon);
                EXPECT_EQ(other->open_wait_set().opcode(), Opcode::wait_set_opened);
                EXPECT_EQ(other->open_window(0).opcode(), Opcode::window_opened);
                return 0;
              }),
              0);
    std::fflush(nullptr);
    ::_exit(testing::Test::HasFailure() ? 98 : 0);
  }
  int status = 0;
  ::waitpid(pid, &status, 0);
  EXPECT_TRUE(WIFEXITED(status) && WEXITSTATUS(status) == 0) << status;
}

TEST(DaemonLimits, GivesBackTheResourcesOfADeadProcess) {
  DaemonProcess daemon({.config = std::string(small_heap) + "[quota]\npublishers = 1\n"});
  for (int life = 0; life < 3; ++life) {
    const auto client = greeted(daemon);
    EXPECT_EQ(client->create_publisher("/a").opcode(), Opcode::endpoint_created) << life;
    expect_quota(client->create_publisher("/b"), "[quota] publishers is 1");
    client->socket().close();
    ASSERT_TRUE(eventually([&] {
      std::size_t gone = 0;
      const std::string log = daemon.log();
      for (std::size_t at = 0; (at = log.find("client gone", at)) != std::string::npos; ++at)
        ++gone;
      return gone == static_cast<std::size_t>(life) + 1;
    }));
  }
}

TEST(DaemonLimits, CountsConnectionsThatNeverSpeak) {
  DaemonProcess daemon({.config = "[quota]\nclients = 5\n"});
  std::vector<std::unique_ptr<WireClient>> silent;
  for (int i = 0; i < 4; ++i) silent.push_back(std::make_unique<WireClient>(daemon.socket_path()));
  const auto honest = greeted(daemon);
  // The next connections may observe, and no more.
  for (std::uint32_t i = 0; i < abi::observer_count_max; ++i) {
    silent.push_back(std::make_unique<WireClient>(daemon.socket_path()));
    EXPECT_EQ(silent.back()->hello().refused_text(), "[quota] clients is 5, this user has as many");
  }
  WireClient one_more(daemon.socket_path());
  const Incoming refused = one_more.next();
  EXPECT_EQ(refused.refused_code(), Errc::quota_exceeded);
  EXPECT_EQ(refused.refused_text(), "[quota] clients is 5, this user has as many");
  EXPECT_TRUE(one_more.is_hung_up());
  EXPECT_EQ(honest->create_publisher("/a").opcode(), Opcode::endpoint_created);
  silent.clear();
  EXPECT_TRUE(eventually([&] {
    const auto socket = PacketSocket::connect(daemon.socket_path());
    WireClient again(daemon.socket_path());
    wire::Hello hello{};
    hello.header = {Opcode::hello, sizeof hello, 1};
    hello.fingerprint = abi::fingerprint();
    again.send_bytes(std::as_bytes(std::span(&hello, 1)));
    return again.next().opcode() == Opcode::welcome;
  }));
}

void live_and_die(const DaemonProcess& daemon, std::string_view topic) {
  const pid_t pid = ::fork();
  if (pid == 0) {
    { RawNode(daemon).publisher(topic); }
    ::_exit(testing::Test::HasFailure() ? 1 : 0);
  }
  ::waitpid(pid, nullptr, 0);
}

/// Writes lines that claim to hold a message of every publisher of a topic that is not wide.
void hold_something_of_everybody(RawNode& node, const wire::EndpointCreated& subscription) {
  for (std::uint64_t p = 0; p < abi::link_block_count; ++p)
    SharedMemory::word(node.region.base(),
                       subscription.extent + abi::link_offset(p) + offsetof(abi::LinkLine, hold))
        .store(1);
}

TEST(DaemonLimits, CountsDeadProcessesWhileAPeerHoldsTheirMemory) {
  DaemonProcess daemon({.config = "[quota]\nclients = 4\n"});
  RawNode holder(daemon);
  hold_something_of_everybody(holder, holder.subscription("/t"));
  for (int life = 0; life < 3; ++life) live_and_die(daemon, "/t");
  const auto four_are_counted = [&] {
    return WireClient(daemon.socket_path()).hello().refused_text() ==
           "[quota] clients is 4, this user has as many";
  };
  EXPECT_TRUE(four_are_counted());
  EXPECT_TRUE(daemon.is_running());
}

// So many dead of one user, kept by that user, that the daemon makes room: that user's.
TEST(DaemonLimits, DeadPublishersOfAnotherUserCostNobodyUnreadMessages) {
  if (::geteuid() != 0) GTEST_SKIP() << "needs root and a second uid";
  DaemonProcess daemon({.config = "[daemon]\nsocket_mode = \"0666\"\n[limits]\nclients = 16\n",
                        .arguments = {"--log-level", "debug"}});
  RawNode honest(daemon);
  honest.subscription("/h");
  live_and_die(daemon, "/h");  // the oldest of all dead publishers
  ASSERT_TRUE(eventually([&] { return daemon.log().find("client gone") != std::string::npos; }));
  const auto final_heads = [&] {
    std::vector<std::uint64_t> heads;
    for (const auto& packet : honest.wire.drain()) {
      if (packet.opcode() == Opcode::orphaned)
        heads.push_back(packet.as<wire::Orphaned>().final_head);
    }
    return heads;
  };
  const auto first = final_heads();
  ASSERT_EQ(first.size(), 1u);
  EXPECT_NE(first[0], 0u);
  EXPECT_EQ(
      in_other_user([&] {
        RawNode holder(daemon);
        hold_something_of_everybody(holder, holder.subscription("/t"));
        for (int life = 0; life < 12; ++life) live_and_die(daemon, "/t");
        std::size_t given_up = 0;
        for (const auto& packet : holder.wire.drain()) {
          if (packet.opcode() == Opcode::orphaned && packet.as<wire::Orphaned>().final_head == 0)
            ++given_up;
        }
        return given_up > 0 && !testing::Test::HasFailure() ? 0 : 1;
      }),
      0);
  EXPECT_TRUE(final_heads().empty()) << "the daemon gave it up";
}

TEST(DaemonLimits, BoundsTheTablesOfTheDaemon) {
  DaemonProcess daemon({.config = std::string(small_heap) +
                                  "windows_per_process = 2\n"
                                  "[limits]\ntopics = 2\npublishers_per_topic = 2\n"
                                  "subscriptions_per_topic = 1\ndepth_max = 20\nclients = 2\n"});
  const auto a = greeted(daemon), b = greeted(daemon);
  WireClient third(daemon.socket_path());
  EXPECT_EQ(third.hello().refused_code(), Errc::limit_reached);
  EXPECT_EQ(a->create_publisher("/a").opcode(), Opcode::endpoint_created);
  EXPECT_EQ(a->create_publisher("/a").opcode(), Opcode::endpoint_created);
  EXPECT_EQ(b->create_publisher("/a").refused_code(), Errc::limit_reached);
  EXPECT_EQ(a->create_publisher("/b").opcode(), Opcode::endpoint_created);
  EXPECT_EQ(b->create_publisher("/c").refused_code(), Errc::limit_reached);
  EXPECT_EQ(b->open_wait_set().opcode(), Opcode::wait_set_opened);
  EXPECT_EQ(b->create_subscription("/a").opcode(), Opcode::endpoint_created);
  EXPECT_EQ(b->create_subscription("/a").refused_code(), Errc::limit_reached);
  const Incoming deep = b->create_publisher("/b", {21, false, true, false, false});
  EXPECT_EQ(deep.refused_code(), Errc::depth_refused);
  EXPECT_EQ(deep.refused_text(), "[limits] depth_max is 20, depth 21 is asked for");
  for (const auto& client : {a.get(), b.get()}) {
    EXPECT_EQ(client->open_window(0).opcode(), Opcode::window_opened);
    EXPECT_EQ(client->open_window(1).opcode(), Opcode::window_opened);
    EXPECT_EQ(client->open_window(2).refused_code(), Errc::window_exhausted);
  }
}

TEST(DaemonLimits, BoundsTheTopicsOfAUser) {
  DaemonProcess daemon({.config = std::string(small_heap) + "[quota]\ntopics = 2\n"});
  const auto a = greeted(daemon), b = greeted(daemon);
  EXPECT_EQ(a->create_publisher("/a").opcode(), Opcode::endpoint_created);
  const Incoming second = a->create_publisher("/b");
  ASSERT_EQ(second.opcode(), Opcode::endpoint_created);
  const Incoming third = b->create_publisher("/c");
  EXPECT_EQ(third.refused_code(), Errc::quota_exceeded);
  EXPECT_EQ(third.refused_text(), "[quota] topics is 2, this user has 2 and asks for 1 more");
  EXPECT_EQ(b->create_publisher("/a").opcode(), Opcode::endpoint_created)
      << "it already has that topic";
}

TEST(DaemonLimits, ReportsAnArenaThatAnUnlimitedUserHasUsedUp) {
  DaemonProcess daemon({.config = "[heap]\nwindow_bytes = \"64MiB\"\narena_bytes = \"128MiB\"\n"
                                  "[quota]\nheap_bytes = \"unlimited\"\n"});
  const auto a = greeted(daemon);
  EXPECT_EQ(a->open_window(0).opcode(), Opcode::window_opened);
  EXPECT_EQ(a->open_window(1).opcode(), Opcode::window_opened);
  const Incoming refused = a->open_window(2);
  EXPECT_EQ(refused.refused_code(), Errc::limit_reached);
  EXPECT_EQ(refused.refused_text(),
            "[heap] arena_bytes has room for 2 windows of 67108864 bytes, all are in use");
}

TEST(DaemonLimits, FollowsTheRulesOfAccess) {
  if (::geteuid() != 0) GTEST_SKIP() << "needs root and another user";
  DaemonProcess daemon({.config = "[daemon]\nsocket_mode = \"0666\"\n"
                                  "[[access]]\ntopic = \"/secret/**\"\npublish = [\"uid:0\"]\n"
                                  "subscribe = [\"uid:0\"]\n"
                                  "[[access]]\ntopic = \"/cmd\"\npublish = [\"uid:0\"]\n"});
  const auto secretive = greeted(daemon), root = greeted(daemon);
  EXPECT_EQ(secretive->create_publisher("/secret/a").opcode(), Opcode::endpoint_created);
  EXPECT_EQ(secretive->create_publisher("/cmd").refused_code(), Errc::readers_differ)
      << "readers of that topic would get the memory of both";
  EXPECT_EQ(root->create_publisher("/cmd").opcode(), Opcode::endpoint_created);
  EXPECT_EQ(in_other_user([&] {
              const auto other = greeted(daemon);
              EXPECT_EQ(other->open_wait_set().opcode(), Opcode::wait_set_opened);
              const Incoming refused = other->create_subscription("/secret/a");
              EXPECT_EQ(refused.refused_code(), Errc::access_denied);
              EXPECT_EQ(refused.refused_text(),
                        "user 65534 may not subscribe to /secret/a (rule in line 3)");
              EXPECT_EQ(other->create_publisher("/secret/b").refused_code(), Errc::access_denied);
              EXPECT_EQ(other->create_publisher("/cmd").refused_code(), Errc::access_denied);
              EXPECT_EQ(other->create_subscription("/cmd").opcode(), Opcode::endpoint_created);
              EXPECT_EQ(other->create_publisher("/open").opcode(), Opcode::endpoint_created);
              return 0;
            }),
            0);
  EXPECT_TRUE(daemon.wait_for_log("code=access_denied"));
  // Refusals reach nobody else: the daemon announces only the subscription to /cmd, and its end,
  // to root.
  for (const Incoming& packet : root->drain()) {
    if (packet.opcode() == Opcode::announce) {
      const auto about = packet.as<wire::Announcement>();
      EXPECT_EQ(about.kind, wire::Kind::subscription);
      EXPECT_EQ(about.topic, 1u);
    } else {
      EXPECT_TRUE(packet.opcode() == Opcode::forget || packet.opcode() == Opcode::kick);
    }
  }
}

TEST(DaemonLimits, GivesTheSocketToTheConfiguredUsers) {
  if (::geteuid() != 0) GTEST_SKIP() << "needs root and another user";
  DaemonProcess daemon({.config = "[daemon]\nsocket_mode = \"0600\"\n"});
  EXPECT_EQ(in_other_user([&] {
              const auto socket = PacketSocket::connect(daemon.socket_path());
              return !socket && socket.error().code == Errc::permission_denied ? 0 : 1;
            }),
            0);
}

TEST(DaemonLimits, SurvivesHavingNoDescriptorLeft) {
  rlimit before{};
  ASSERT_EQ(::getrlimit(RLIMIT_NOFILE, &before), 0);
  const rlimit small{64, 64};
  std::unique_ptr<DaemonProcess> daemon;
  {
    daemon = std::make_unique<DaemonProcess>();
    ASSERT_EQ(::prlimit(daemon->pid(), RLIMIT_NOFILE, &small, nullptr), 0);
  }
  std::vector<std::unique_ptr<WireClient>> clients;
  const auto first = greeted(*daemon);
  unsigned turned_away = 0;
  for (int i = 0; i < 60 && turned_away == 0; ++i) {
    clients.push_back(std::make_unique<WireClient>(daemon->socket_path()));
    wire::Hello hello{};
    hello.header = {Opcode::hello, sizeof hello, 1};
    hello.fingerprint = abi::fingerprint();
    clients.back()->send_bytes(std::as_bytes(std::span(&hello, 1)));
    const Incoming answer = clients.back()->next();
    if (answer.opcode() == Opcode::welcome) continue;
    ASSERT_EQ(answer.opcode(), Opcode::refused);
    EXPECT_TRUE(answer.refused_code() == Errc::limit_reached ||
                answer.refused_code() == Errc::os_failure)
        << answer.refused_text();
    ++turned_away;
  }
  EXPECT_EQ(turned_away, 1u);
  EXPECT_EQ(first->create_publisher("/a").opcode(), Opcode::endpoint_created);
  clients.clear();
  EXPECT_TRUE(eventually([&] {
    WireClient again(daemon->socket_path());
    wire::Hello hello{};
    hello.header = {Opcode::hello, sizeof hello, 1};
    hello.fingerprint = abi::fingerprint();
    again.send_bytes(std::as_bytes(std::span(&hello, 1)));
    return again.next().opcode() == Opcode::welcome;
  }));
}

TEST(DaemonLimits, RepeatsAnAnnouncementThatItHadNoDescriptorFor) {
  DaemonProcess daemon;
  const auto publisher = greeted(daemon), subscriber = greeted(daemon);
  ASSERT_EQ(publisher->create_publisher("/topic").opcode(), Opcode::endpoint_created);
  const Incoming doorbells = subscriber->open_wait_set();
  ASSERT_EQ(doorbells.opcode(), Opcode::wait_set_opened);
  LoweredLimit limit(daemon.pid(), RLIMIT_NOFILE, 3);
  ASSERT_EQ(subscriber->create_subscription("/topic").opcode(), Opcode::endpoint_created);
  const auto first = publisher->expect<wire::Announcement>(Opcode::announce);
  EXPECT_EQ(first.doorbell_count, 0u);
  ASSERT_TRUE(daemon.wait_for_log("announcement waits"));
  publisher->unlinked(first.kind, first.topic, first.index, first.generation);

  limit.lift();
  std::vector<UniqueFd> fds;
  const auto again = publisher->expect<wire::Announcement>(Opcode::announce, &fds);
  EXPECT_EQ(again.generation, first.generation);
  EXPECT_EQ(again.doorbell_count, 2u);
  EXPECT_EQ(fds.size(), 3u);
  EXPECT_EQ(publisher->drain().size(), 0u) << "announced once";
}

TEST(DaemonLimits, AnnouncementsThatNobodyReadsCostNoDescriptorEach) {
  DaemonProcess daemon({.more_config = "[quota]\nsubscriptions_per_topic = \"unlimited\"\n"});
  const auto deaf = greeted(daemon), subscriber = greeted(daemon);
  ASSERT_EQ(deaf->create_publisher("/topic").opcode(), Opcode::endpoint_created);
  const Incoming doorbells = subscriber->open_wait_set();
  ASSERT_EQ(doorbells.opcode(), Opcode::wait_set_opened);
  const std::size_t before = daemon.descriptor_count();
  constexpr int count = 700;  // more than a socket holds
  for (int i = 0; i < count; ++i)
    ASSERT_EQ(subscriber->create_subscription("/topic").opcode(), Opcode::endpoint_created);
  EXPECT_LE(daemon.descriptor_count(), before + 8);
  for (int i = 0; i < count; ++i) {
    std::vector<UniqueFd> fds;
    ASSERT_EQ(deaf->expect<wire::Announcement>(Opcode::announce, &fds).doorbell_count, 2u);
    ASSERT_EQ(fds.size(), 3u) << "its doorbells come all the same";
  }
}

}  // namespace
}  // namespace agnocast::test
