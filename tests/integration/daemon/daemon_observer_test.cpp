// SPDX-License-Identifier: Apache-2.0
//
// Goal: an observer's connection gets the whole state of one moment, costs nobody a place, can
// disturb nobody, and may send nothing else. Method: raw observers and raw clients against the
// real daemon; the daemon's descriptors and log show the cost.

#include <agnocast/abi/client_region.hpp>
#include <agnocast/abi/observe.hpp>
#include <agnocast/version.hpp>
#include <base/memory/memory_policy.hpp>
#include <tests/support/processes/daemon_process.hpp>
#include <tests/support/wire/wire_client.hpp>

#include <fcntl.h>
#include <grp.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <map>
#include <memory>
#include <vector>

namespace agnocast::test {
namespace {

using wire::Kind;
using wire::Opcode;

struct Dumped {
  wire::DumpDaemon daemon{};
  std::vector<wire::DumpProcess> processes;
  std::map<std::uint64_t, UniqueFd> regions;  // by client
  std::vector<wire::DumpTopic> topics;
  std::vector<wire::DumpEndpoint> endpoints;
  std::vector<wire::DumpUser> users;
  std::vector<wire::DumpRefusal> refusals;
  wire::DumpEnd end{};
};

struct Observer {
  explicit Observer(const DaemonProcess& daemon) : wire(daemon.socket_path()) {}

  Incoming observe(std::uint64_t fingerprint = abi::fingerprint()) {
    wire::Observe body{};
    body.fingerprint = fingerprint;
    return wire.ask(Opcode::observe, body);
  }
  Dumped dump() {
    Dumped all;
    const std::uint64_t id = wire.send(Opcode::dump, wire::Dump{});
    for (;;) {
      Incoming packet = wire.next();
      EXPECT_EQ(packet.header().request, id);
      switch (packet.opcode()) {
        case Opcode::dump_daemon:
          all.daemon = packet.as<wire::DumpDaemon>();
          break;
        case Opcode::dump_process:
          all.processes.push_back(packet.as<wire::DumpProcess>());
          EXPECT_EQ(packet.fds.size(), all.processes.back().region_count);
          if (!packet.fds.empty())
            all.regions[all.processes.back().client] = std::move(packet.fds[0]);
          break;
        case Opcode::dump_topic:
          all.topics.push_back(packet.as<wire::DumpTopic>());
          break;
        case Opcode::dump_endpoint:
          all.endpoints.push_back(packet.as<wire::DumpEndpoint>());
          break;
        case Opcode::dump_user:
          all.users.push_back(packet.as<wire::DumpUser>());
          break;
        case Opcode::dump_refusal:
          all.refusals.push_back(packet.as<wire::DumpRefusal>());
          break;
        case Opcode::dump_end:
          all.end = packet.as<wire::DumpEnd>();
          return all;
        default:
          ADD_FAILURE() << "opcode " << static_cast<unsigned>(packet.opcode())
                        << packet.refused_text();
          return all;
      }
    }
  }
  WireClient wire;
};

std::unique_ptr<Observer> observing(const DaemonProcess& daemon) {
  auto observer = std::make_unique<Observer>(daemon);
  const Incoming answer = observer->observe();
  EXPECT_EQ(answer.opcode(), Opcode::observed) << answer.refused_text();
  EXPECT_EQ(answer.fds.size(), 1u);
  return observer;
}
std::unique_ptr<WireClient> greeted_client(const DaemonProcess& daemon) {
  auto client = std::make_unique<WireClient>(daemon.socket_path());
  EXPECT_EQ(client->hello().opcode(), Opcode::welcome);
  return client;
}
bool is_read_only(int fd) { return (::fcntl(fd, F_GETFL) & O_ACCMODE) == O_RDONLY; }

TEST(DaemonObserver, GetsTheWholeStateOfOneMoment) {
  DaemonProcess daemon;
  const auto a = greeted_client(daemon), b = greeted_client(daemon);
  const auto window = a->open_window(0).as<wire::WindowOpened>();
  const auto p = a->create_publisher("/topic").as<wire::EndpointCreated>();
  b->open_wait_set(3);
  auto wanted = WireClient::endpoint("/topic", {7, false, true, false, false});
  wanted.wait_set = 3;
  const auto s = b->ask(Opcode::create_subscription, wanted).as<wire::EndpointCreated>();

  const auto observer = observing(daemon);
  const Dumped all = observer->dump();
  EXPECT_EQ(all.daemon.version_minor, static_cast<unsigned>(AGNOCAST_VERSION_MINOR));
  EXPECT_EQ(all.daemon.pid, static_cast<unsigned>(daemon.pid()));
  EXPECT_EQ(all.daemon.windows_used, 1u);
  EXPECT_EQ(all.daemon.connections, 2u);
  EXPECT_EQ(all.daemon.observers, 1u);
  EXPECT_EQ(all.daemon.counters.clients_registered, 2u);
  EXPECT_EQ(all.daemon.limits.depth_max, abi::depth_max);
  EXPECT_GT(all.daemon.uptime_ns, 0u);

  ASSERT_EQ(all.processes.size(), 2u) << "an observer is no process";
  EXPECT_EQ(all.processes[0].pid, static_cast<unsigned>(::getpid()));
  EXPECT_EQ(all.processes[0].uid, ::geteuid());
  EXPECT_EQ(all.processes[0].state, wire::ProcessState::connected);
  EXPECT_STREQ(all.processes[0].name.text, "wire_client");
  ASSERT_EQ(all.processes[0].window_count, 1u);
  EXPECT_EQ(all.processes[0].window[0].base, window.base);
  EXPECT_EQ(all.processes[0].window[0].bytes, window.bytes);
  EXPECT_EQ(all.processes[1].wait_sets, std::uint64_t{1} << 3);
  ASSERT_EQ(all.topics.size(), 1u);
  EXPECT_STREQ(all.topics[0].name.text, "/topic");
  EXPECT_STREQ(all.topics[0].type.text, "test/msg/Type");
  EXPECT_EQ(all.topics[0].layout_hash, 1u);
  ASSERT_EQ(all.endpoints.size(), 2u);
  EXPECT_EQ(all.endpoints[0].kind, Kind::publisher);
  EXPECT_EQ(all.endpoints[0].board_word,
            abi::pack_board_word(p.generation, abi::BoardState::active));
  EXPECT_EQ(all.endpoints[0].extent, p.extent);
  EXPECT_EQ(all.endpoints[0].first_sequence, p.first_sequence);
  EXPECT_STREQ(all.endpoints[0].node.text, "node");
  EXPECT_EQ(all.endpoints[1].kind, Kind::subscription);
  EXPECT_EQ(all.endpoints[1].generation, s.generation);
  EXPECT_EQ(all.endpoints[1].wait_set, 3u);
  EXPECT_EQ(abi::unpack_qos(all.endpoints[1].qos).depth, 7u);
  ASSERT_EQ(all.users.size(), 1u);
  EXPECT_EQ(all.users[0].use.publishers, 1u);
  EXPECT_EQ(all.users[0].use.heap_bytes, window.bytes);
  EXPECT_EQ(all.users[0].observers, 1u);
  EXPECT_EQ(all.end.process_count, 2u);
  EXPECT_EQ(all.end.topic_count, 1u);
  EXPECT_EQ(all.end.endpoint_count, 2u);
  EXPECT_EQ(all.end.user_count, 1u);

  ASSERT_EQ(all.regions.size(), 2u);
  for (const auto& [client, fd] : all.regions) EXPECT_TRUE(is_read_only(fd.get()));
  const Mapping region = std::move(
      Mapping::map(all.regions.at(0).get(), abi::page_bytes, Mapping::Access::read).value());
  EXPECT_EQ(SharedMemory::word(region.base(), 0).load(), abi::client_region_magic);
  EXPECT_EQ(SharedMemory::word(region.base(), 16).load(), all.processes[0].generation);
}

TEST(DaemonObserver, GetsRecentRefusals) {
  DaemonProcess daemon({.config = "[limits]\ndepth_max = 5\n"});
  const auto observer = observing(daemon);
  EXPECT_TRUE(observer->dump().refusals.empty());
  const auto client = greeted_client(daemon);
  for (int i = 0; i < 3; ++i)
    EXPECT_EQ(
        client->ask(Opcode::create_publisher, WireClient::endpoint("/deep", {6})).refused_code(),
        Errc::depth_refused);
  EXPECT_EQ(
      client->ask(Opcode::create_subscription, WireClient::endpoint("/deep", {6})).refused_code(),
      Errc::depth_refused);
  const Dumped all = observer->dump();
  ASSERT_EQ(all.refusals.size(), 2u) << "a repeated refusal is counted";
  EXPECT_EQ(all.end.refusal_count, 2u);
  const wire::DumpRefusal& refusal = all.refusals[0];
  EXPECT_EQ(refusal.code, static_cast<std::uint32_t>(Errc::depth_refused));
  EXPECT_EQ(refusal.kind, Kind::publisher);
  EXPECT_EQ(refusal.uid, ::geteuid());
  EXPECT_EQ(refusal.pid, static_cast<unsigned>(::getpid()));
  EXPECT_EQ(refusal.times, 3u);
  EXPECT_STREQ(refusal.topic.text, "/deep");
  EXPECT_STREQ(refusal.process_name.text, "wire_client");
  EXPECT_STREQ(refusal.why.text, "[limits] depth_max is 5, depth 6 is asked for");
  EXPECT_EQ(all.refusals[1].kind, Kind::subscription);
}

TEST(DaemonObserver, ReadsTheLogLevelAndSetsItIfItMay) {
  DaemonProcess daemon({.config = "[daemon]\nsocket_mode = \"0666\"\nlog_level = \"warning\"\n"});
  const auto observer = observing(daemon);
  const auto ask = [](WireClient& wire, std::uint64_t level) {
    wire::SetLogLevel request{};
    request.level = level;
    return wire.ask(Opcode::set_log_level, request);
  };
  EXPECT_EQ(ask(observer->wire, 0).as<wire::LogLevelIs>().level, 4u);
  EXPECT_EQ(ask(observer->wire, 7).as<wire::LogLevelIs>().level, 7u);
  EXPECT_EQ(observer->dump().daemon.log_level, 7u);
  const auto client = greeted_client(daemon);
  EXPECT_TRUE(daemon.wait_for_log("client registered")) << "the level applies at once";
  EXPECT_EQ(ask(observer->wire, 8).refused_code(), Errc::invalid_argument);
  EXPECT_EQ(ask(observer->wire, 2).refused_code(), Errc::invalid_argument);
  EXPECT_EQ(ask(observer->wire, 0).as<wire::LogLevelIs>().level, 7u);
}

TEST(DaemonObserver, GetsTheUsersThatMayPublishAndSubscribe) {
  DaemonProcess daemon({.config = R"(
[[access]]
topic = "/lidar/**"
publish = ["uid:4711", "gid:42"]

[[access]]
topic = "/lidar/top"
subscribe = []
)"});
  const auto observer = observing(daemon);
  const auto ask = [&](const char* topic) {
    wire::AskAccess request{};
    std::strcpy(request.topic.text, topic);
    const Incoming publish = observer->wire.ask(Opcode::ask_access, request);
    EXPECT_EQ(publish.opcode(), Opcode::access_is) << publish.refused_text();
    return std::pair(publish.as<wire::AccessIs>(), observer->wire.next().as<wire::AccessIs>());
  };
  const auto [publish, subscribe] = ask("/lidar/top");
  EXPECT_EQ(publish.kind, Kind::publisher);
  EXPECT_EQ(publish.line, 2u);
  EXPECT_EQ(publish.everybody, 0u);
  EXPECT_EQ(publish.rule_count, 2u);
  EXPECT_STREQ(publish.pattern.text, "/lidar/**");
  EXPECT_STREQ(publish.principals, "uid:4711, gid:42");
  EXPECT_EQ(subscribe.kind, Kind::subscription);
  EXPECT_EQ(subscribe.line, 6u);
  EXPECT_EQ(subscribe.everybody, 0u);
  EXPECT_STREQ(subscribe.principals, "");
  const auto [other, _] = ask("/other");
  EXPECT_EQ(other.line, 0u);
  EXPECT_EQ(other.everybody, 1u);
  wire::AskAccess wrong{};
  std::strcpy(wrong.topic.text, "no slash");
  EXPECT_EQ(observer->wire.ask(Opcode::ask_access, wrong).refused_code(), Errc::invalid_name);
}

TEST(DaemonObserver, GetsTheBoardForReading) {
  DaemonProcess daemon;
  Observer observer(daemon);
  const Incoming answer = observer.observe();
  ASSERT_EQ(answer.opcode(), Opcode::observed);
  ASSERT_EQ(answer.fds.size(), 1u);
  EXPECT_TRUE(is_read_only(answer.fds[0].get()));
  EXPECT_EQ(answer.as<wire::Observed>().fingerprint, abi::fingerprint());
}

TEST(DaemonObserver, IsNeverAnnouncedAndTakesNoPlace) {
  DaemonProcess daemon({.config = "[limits]\nclients = 2\n"});
  const auto observer = observing(daemon);
  const auto a = greeted_client(daemon), b = greeted_client(daemon);
  a->create_publisher("/topic");
  b->open_wait_set();
  b->create_subscription("/topic");
  EXPECT_EQ(a->expect<wire::Announcement>(Opcode::announce).kind, Kind::subscription);
  EXPECT_EQ(observer->dump().endpoints.size(), 2u);
  EXPECT_FALSE(observer->wire.poll().has_value()) << "it got a packet without a request";
  EXPECT_TRUE(a->drain().empty());
}

TEST(DaemonObserver, MaySendNothingElse) {
  DaemonProcess daemon;
  Observer early(daemon);
  EXPECT_EQ(early.wire.ask(Opcode::dump, wire::Dump{}).refused_text(),
            "the first request must be hello");
  EXPECT_EQ(early.observe(1).refused_code(), Errc::layout_mismatch);
  EXPECT_EQ(early.observe().opcode(), Opcode::observed) << "it may try again";
  EXPECT_EQ(early.observe().refused_code(), Errc::protocol_violation);
  EXPECT_EQ(early.wire.hello().refused_text(), "an observer may not take part");
  EXPECT_EQ(early.wire.open_window(0).refused_code(), Errc::protocol_violation);
  EXPECT_EQ(early.wire.create_publisher("/x").refused_code(), Errc::protocol_violation);
  EXPECT_EQ(early.wire.ask(Opcode::dump, wire::Revoke{}).refused_code(), Errc::protocol_violation)
      << "of another length";
  EXPECT_EQ(early.dump().processes.size(), 0u) << "the daemon still serves";
  const auto client = greeted_client(daemon);
  EXPECT_EQ(client->ask(Opcode::observe, wire::Observe{}).refused_code(), Errc::protocol_violation);
  EXPECT_EQ(client->ask(Opcode::dump, wire::Dump{}).refused_code(), Errc::protocol_violation);
}

TEST(DaemonObserver, HasALimitOfItsOwn) {
  DaemonProcess daemon({.config = "[quota]\nclients = 1\n"});
  const auto client = greeted_client(daemon);
  std::vector<std::unique_ptr<Observer>> observers;
  for (std::uint32_t i = 0; i < abi::observer_count_max; ++i)
    observers.push_back(observing(daemon));
  EXPECT_EQ(observers.back()->dump().users.at(0).observers, abi::observer_count_max);
  Observer one_more(daemon);
  EXPECT_EQ(one_more.wire.next().refused_code(), Errc::quota_exceeded);
  EXPECT_TRUE(one_more.wire.is_hung_up());
  observers.pop_back();
  EXPECT_TRUE(eventually(
      [&] { return observers.front()->dump().users.at(0).observers < abi::observer_count_max; }));
  Observer next(daemon);
  EXPECT_EQ(next.observe().opcode(), Opcode::observed);
}

TEST(DaemonObserver, IsRefusedBeyondItsLimitWhileThereAreClientsLeft) {
  DaemonProcess daemon;
  std::vector<std::unique_ptr<Observer>> observers;
  for (std::uint32_t i = 0; i < abi::observer_count_max; ++i)
    observers.push_back(observing(daemon));
  Observer one_more(daemon);
  const Incoming refused = one_more.observe();
  EXPECT_EQ(refused.refused_code(), Errc::quota_exceeded);
  EXPECT_EQ(refused.refused_text(), "this user may have 8 observers");
  EXPECT_EQ(one_more.wire.hello().opcode(), Opcode::welcome) << "it may still become a client";
}

// Makes a client large enough that no socket takes its dump whole.
std::unique_ptr<WireClient> crowd(const DaemonProcess& daemon) {
  auto client = greeted_client(daemon);
  for (int i = 0; i < 600; ++i)
    EXPECT_EQ(client->create_publisher("/crowd" + std::to_string(i)).opcode(),
              Opcode::endpoint_created);
  return client;
}

TEST(DaemonObserver, IsDisconnectedWhenItDoesNotReadAndDelaysNobody) {
  DaemonProcess daemon({.arguments = {"--log-level", "debug"}});
  const auto client = crowd(daemon);
  const auto slow = observing(daemon), quick = observing(daemon);
  slow->wire.send(Opcode::dump, wire::Dump{});
  EXPECT_EQ(client->create_publisher("/another").opcode(), Opcode::endpoint_created);
  EXPECT_EQ(quick->dump().endpoints.size(), 601u);
  EXPECT_TRUE(daemon.wait_for_log("an observer does not read"));
  EXPECT_TRUE(slow->wire.is_hung_up());
  EXPECT_EQ(quick->dump().endpoints.size(), 601u) << "the observer that reads stays";
}

TEST(DaemonObserver, IsDisconnectedWhenItAsksBeforeItHasRead) {
  DaemonProcess daemon({.arguments = {"--log-level", "debug"}});
  const auto client = crowd(daemon);
  const auto hasty = observing(daemon);
  for (int i = 0; i < 100; ++i) {
    auto body = wire::Dump{};
    body.header = {Opcode::dump, sizeof body, 99};
    if (!hasty->wire.send_bytes(std::as_bytes(std::span(&body, 1)))) break;
  }
  EXPECT_TRUE(daemon.wait_for_log("an observer sent a request before it had read the answer"));
  EXPECT_TRUE(hasty->wire.is_hung_up());
  EXPECT_EQ(client->create_publisher("/another").opcode(), Opcode::endpoint_created);
}

TEST(DaemonObserver, LeavesNothingBehind) {
  DaemonProcess daemon;
  const auto client = crowd(daemon);
  const std::size_t before = daemon.descriptor_count();
  for (int life = 0; life < 20; ++life) {
    const pid_t pid = ::fork();
    if (pid == 0) {
      const auto observer = observing(daemon);
      observer->wire.send(Opcode::dump, wire::Dump{});
      if (life % 2 == 0) static_cast<void>(observer->wire.next());
      ::raise(SIGKILL);
    }
    int status = 0;
    ::waitpid(pid, &status, 0);
    EXPECT_TRUE(WIFSIGNALED(status));
  }
  EXPECT_TRUE(eventually([&] { return daemon.descriptor_count() <= before; }));
  const auto observer = observing(daemon);
  const Dumped all = observer->dump();
  EXPECT_EQ(all.processes.size(), 1u);
  EXPECT_EQ(all.daemon.observers, 1u);
}

TEST(DaemonObserver, SeesTheRegionOfADeadProcessUntilItsPlaceIsFree) {
  DaemonProcess daemon;
  const auto subscriber = greeted_client(daemon);
  subscriber->open_wait_set();
  subscriber->create_subscription("/topic");
  const auto observer = observing(daemon);
  const pid_t pid = ::fork();
  if (pid == 0) {
    WireClient publisher(daemon.socket_path());
    publisher.hello();
    publisher.create_publisher("/topic");
    ::raise(SIGKILL);
  }
  ::waitpid(pid, nullptr, 0);
  const auto about = subscriber->expect<wire::Announcement>(Opcode::announce);
  subscriber->expect<wire::Orphaned>(Opcode::orphaned);
  const Dumped dead = observer->dump();
  ASSERT_EQ(dead.processes.size(), 2u);
  EXPECT_EQ(dead.processes[1].state, wire::ProcessState::dead);
  EXPECT_EQ(dead.regions.count(1), 1u);
  EXPECT_EQ(dead.daemon.counters.clients_died, 1u);
  ASSERT_EQ(dead.endpoints.size(), 2u);
  EXPECT_EQ(abi::state_of(dead.endpoints[0].board_word), abi::BoardState::orphan);
  subscriber->unlinked(Kind::publisher, about.topic, about.index, about.generation);
  subscriber->unlinked(Kind::region, 0, about.client, about.client_generation);
  subscriber->drain();
  const Dumped over = observer->dump();
  EXPECT_EQ(over.processes.size(), 1u);
  EXPECT_EQ(over.regions.size(), 1u);
}

TEST(DaemonObserver, OfAnotherUserSeesTheSame) {
  if (::geteuid() != 0) GTEST_SKIP() << "needs root";
  DaemonProcess daemon({.config = "[daemon]\nsocket_mode = \"0666\"\n"});
  const auto client = greeted_client(daemon);
  client->create_publisher("/topic");
  const pid_t pid = ::fork();
  if (pid == 0) {
    if (::setgroups(0, nullptr) != 0 || ::setgid(65534) != 0 || ::setuid(65534) != 0) ::_exit(99);
    const auto observer = observing(daemon);
    const Dumped all = observer->dump();
    const bool same = all.topics.size() == 1 && all.regions.size() == 1 && all.users.size() == 2;
    const std::string path = "/proc/self/fd/" + std::to_string(all.regions.at(0).get());
    const bool writable = ::open(path.c_str(), O_RDWR | O_CLOEXEC) >= 0;
    ::_exit(same && !writable && !testing::Test::HasFailure() ? 0 : 1);
  }
  int status = 0;
  ::waitpid(pid, &status, 0);
  EXPECT_EQ(WEXITSTATUS(status), 0);
}

}  // namespace
}  // namespace agnocast::test
