// SPDX-License-Identifier: Apache-2.0
//
// Goal: agnocast-ctl shows what exists, in ros2's formats and as JSON, with the promised exit
// statuses and two-line errors (journal and verify have their own files). Method: the real daemon,
// raw clients whose regions this test writes like an honest process and then breaks, and
// agnocast-ctl as a program of its own.

#include <agnocast/version.hpp>
#include <base/sockets/unix_address.hpp>
#include <tests/integration/ctl/ctl_node.hpp>
#include <tests/support/processes/ctl.hpp>
#include <tests/support/processes/daemon_process.hpp>

#include <gmock/gmock.h>
#include <signal.h>
#include <sys/stat.h>

#include <cinttypes>
#include <cstdio>
#include <cstdlib>
#include <memory>
#include <string>
#include <vector>

namespace agnocast::test {
namespace {

using abi::Qos;
using testing::HasSubstr;
using testing::MatchesRegex;
using testing::StartsWith;
using wire::Opcode;
using M = SharedMemory;
using Node = CtlNode;

// --- output

// A GID is sixteen bytes and never the same.
std::string without_gids(std::string text) {
  constexpr std::size_t length = 16 * 3 - 1;
  for (std::size_t at = 0; (at = text.find("GID: ", at)) != std::string::npos; at += 5) {
    if (text.find('\n', at) == at + 5 + length) text.replace(at + 5, length, "X");
  }
  return text;
}

TEST(Ctl, ListsTopicsInTheFormatOfRos2) {
  DaemonProcess daemon;
  Node a(daemon.socket_path()), elsewhere(daemon.socket_path(), 7);
  a.publisher("/chatter", {7}, "/talker", "std_msgs/msg/String");
  a.publisher("/chatter", {7}, "/talker", "std_msgs/msg/String");
  a.subscription("/points", {5}, "/listener", "sensor_msgs/msg/PointCloud2");
  a.publisher("/_private/x");
  elsewhere.publisher("/far");
  const auto ctl = [&](std::vector<std::string> words, std::vector<std::string> environment = {}) {
    const CtlResult result = run_ctl(daemon.socket_path(), std::move(words), environment);
    EXPECT_EQ(result.status, 0) << result.err;
    EXPECT_EQ(result.err, "");
    return result.out;
  };
  EXPECT_EQ(ctl({"topic", "list"}), "/chatter\n/points\n");
  EXPECT_EQ(ctl({"topics"}), "/chatter\n/points\n") << "the plural is short for list";
  EXPECT_EQ(ctl({"topic", "list", "-t"}),
            "/chatter [std_msgs/msg/String]\n/points [sensor_msgs/msg/PointCloud2]\n");
  EXPECT_EQ(ctl({"topic", "list", "-c"}), "2\n");
  EXPECT_EQ(ctl({"topic", "list", "--count-topics", "--include-hidden-topics"}), "3\n");
  EXPECT_EQ(ctl({"topic", "list", "-v"}),
            "Published topics:\n * /chatter [std_msgs/msg/String] 2 publishers\n\n"
            "Subscribed topics:\n * /points [sensor_msgs/msg/PointCloud2] 1 subscriber\n");
  EXPECT_EQ(ctl({"topic", "list"}, {"ROS_DOMAIN_ID=7"}), "/far\n");
  EXPECT_EQ(ctl({"topic", "list", "--domain", "7"}), "/far\n");
  EXPECT_EQ(ctl({"topic", "list", "--all-domains"}),
            "/chatter (domain 0)\n/far (domain 7)\n/points (domain 0)\n");
  EXPECT_EQ(ctl({"--socket", daemon.socket_path(), "topic", "list"}, {"AGNOCAST_SOCKET=/x"}),
            "/chatter\n/points\n")
      << "--socket overrides AGNOCAST_SOCKET, and options may stand first";
}

TEST(Ctl, ListsServicesInTheFormatOfRos2) {
  DaemonProcess daemon;
  Node server(daemon.socket_path()), client(daemon.socket_path()),
      elsewhere(daemon.socket_path(), 7);
  const std::string requests = "/_service/request/ns/add", type = "pkg/srv/Add_Request";
  server.subscription(requests, {5}, "/ns/server", type);
  client.publisher(requests, {5}, "/asker", type);
  client.subscription("/_service/reply/c0123456789abcdef/ns/add", {5}, "/asker",
                      "pkg/srv/Add_Response");
  client.publisher("/_service/request/mine/_hidden", {5}, "/asker", "tests/Other");
  elsewhere.subscription("/_service/request/far", {5}, "/far", type);
  client.publisher("/add", {5}, "/asker", "pkg/msg/Add");
  const auto ctl = [&](std::vector<std::string> words) {
    const CtlResult result = run_ctl(daemon.socket_path(), std::move(words));
    EXPECT_EQ(result.status, 0) << result.err;
    return result.out;
  };
  EXPECT_EQ(ctl({"service", "list"}), "/ns/add\n");
  EXPECT_EQ(ctl({"services", "-t"}), "/ns/add [pkg/srv/Add]\n");
  EXPECT_EQ(ctl({"service", "list", "--include-hidden-services"}), "/mine/_hidden\n/ns/add\n");
  EXPECT_EQ(ctl({"service", "list", "-c"}), "1\n");
  EXPECT_EQ(ctl({"service", "list", "-a"}), "/far (domain 7)\n/ns/add (domain 0)\n");
  EXPECT_EQ(ctl({"service", "type", "ns/add"}), "pkg/srv/Add\n");
  EXPECT_EQ(ctl({"service", "type", "/mine/_hidden"}), "tests/Other\n");
  EXPECT_EQ(ctl({"service", "find", "pkg/srv/Add"}), "/ns/add\n");
  EXPECT_EQ(ctl({"service", "find", "pkg/srv/Add", "-c"}), "1\n");
  EXPECT_EQ(ctl({"service", "find", "pkg/srv/None"}), "");
  EXPECT_EQ(ctl({"service", "info", "/ns/add"}),
            "Type: pkg/srv/Add\nClients count: 1\nServices count: 1\n");
  const std::string process = ", wire_client (pid " + std::to_string(::getpid()) + ", uid " +
                              std::to_string(::geteuid()) + ")\n";
  EXPECT_EQ(ctl({"service", "info", "-v", "/ns/add"}),
            "Type: pkg/srv/Add\nClients count: 1\n  /asker" + process +
                "Services count: 1\n  /ns/server" + process);
  const auto info = run_ctl(daemon.socket_path(), {"service", "info", "/ns/add", "-j"}).json();
  EXPECT_EQ(info["servers"][0]["node_name"], "server");
  EXPECT_EQ(info["clients"][0]["pid"], ::getpid());
  EXPECT_EQ(ctl({"topic", "list"}), "/add\n") << "topics of services are hidden";
  const CtlResult none = run_ctl(daemon.socket_path(), {"service", "type", "/ns/ad"});
  EXPECT_NE(none.status, 0);
  EXPECT_THAT(none.err, HasSubstr("did you mean /ns/add?"));
  EXPECT_THAT(none.err, HasSubstr("hint: agnocast-ctl service type /ns/add\n"));
}

// Long because one system is set up, and each form of the answer is read of it.
TEST(Ctl, ShowsATopicAsRos2DoesAndItsCost) {
  DaemonProcess daemon;
  Node a(daemon.socket_path()), b(daemon.socket_path());
  a.open_window();
  const auto p = a.publisher("/points", {7, true, true, false, false});
  const auto s = b.subscription("/points", {5, false, false, true, false});
  a.commit(p, 6);
  b.link(s, p, 4, 2);
  auto& endpoint = *reinterpret_cast<abi::PublisherEndpoint*>(a.region.base() + p.extent);
  const auto pid = std::to_string(::getpid());
  EXPECT_EQ(run_ctl(daemon.socket_path(), {"topic", "info", "/points"}).out,
            "Type: test/msg/Type\nPublisher count: 1\nSubscription count: 1\n");
  CtlResult info = run_ctl(daemon.socket_path(), {"topic", "info", "-v", "points"});
  EXPECT_EQ(info.status, 0) << info.err;
  EXPECT_THAT(info.out, HasSubstr("Zero-copy: yes\n"));
  endpoint.adopted_messages.store(2);
  endpoint.adopted_bytes.store(12345);
  endpoint.refused_no_slot.store(3);
  const region::SubscriptionWords<M> counters{b.region.base(), s.extent};
  counters.counter(offsetof(abi::SubscriptionCounters, lost)).store(9);
  counters.counter(offsetof(abi::SubscriptionCounters, malformed)).store(1);
  info = run_ctl(daemon.socket_path(), {"topic", "info", "points", "--verbose"});
  const std::string gid = without_gids(info.out);
  EXPECT_EQ(gid,
            "Type: test/msg/Type\nRoom: 256 publishers, 2048 subscriptions\n\n"
            "Publisher count: 1\n\n"
            "Node name: talker\nNode namespace: /ns\nTopic type: test/msg/Type\n"
            "Endpoint type: PUBLISHER\nGID: X\nQoS profile:\n  Reliability: RELIABLE\n"
            "  History (Depth): KEEP_LAST (7)\n  Durability: TRANSIENT_LOCAL\n"
            "  Lifespan: Infinite\n  Deadline: Infinite\n  Liveliness: AUTOMATIC\n"
            "  Liveliness lease duration: Infinite\n"
            "Process: wire_client (pid " +
                pid + ", uid " + std::to_string(::geteuid()) +
                ")\nZero-copy: no, 12345 bytes adopted (2 messages)\nPublished: 6 messages, 0 B\n"
                "Allocated: 6 messages of 384, 2 held by subscriptions\n"
                "Refused: 3 no_slot, 0 would_block, 0 heap_exhausted\n\n"
                "Subscription count: 1\n\n"
                "Node name: listener\nNode namespace: /\nTopic type: test/msg/Type\n"
                "Endpoint type: SUBSCRIPTION\nGID: X\nQoS profile:\n"
                "  Reliability: BEST_EFFORT\n  History (Depth): KEEP_ALL (5)\n"
                "  Durability: VOLATILE\n  Lifespan: Infinite\n  Deadline: Infinite\n"
                "  Liveliness: AUTOMATIC\n  Liveliness lease duration: Infinite\n"
                "Process: wire_client (pid " +
                pid + ", uid " + std::to_string(::geteuid()) +
                ")\nLinked: 1 publisher\nHeld: 2 messages, at most 4 of each publisher\n"
                "Unread: 2 messages\nLost: 9 messages, 1 malformed\n\n"
                "Is it zero-copy?\n  /ns/talker of wire_client (pid " +
                pid + ", uid " + std::to_string(::geteuid()) +
                ") -> /listener of wire_client (pid " + pid + ", uid " +
                std::to_string(::geteuid()) +
                "): no, adopted: 2 of 6 messages were "
                "built outside the "
                "shared heap, 12.1 KiB of them copied into it by publish\n");
  const auto json = run_ctl(daemon.socket_path(), {"topic", "info", "/points", "-j"}).json();
  EXPECT_EQ(json["schema"], "agnocast.topic-info/1");
  EXPECT_EQ(json["name"], "/points");
  const auto& publisher = json["publishers"][0];
  EXPECT_EQ(publisher["node_name"], "talker");
  EXPECT_EQ(publisher["node_namespace"], "/ns");
  EXPECT_EQ(publisher["generation"], p.generation);
  EXPECT_EQ(publisher["qos"]["durability"], "transient_local");
  EXPECT_EQ(publisher["is_zero_copy"], false);
  EXPECT_EQ(publisher["adopted_bytes"], 12345);
  EXPECT_EQ(publisher["published_messages"], 6);
  EXPECT_EQ(publisher["held_messages"], 2);
  const auto& subscription = json["subscriptions"][0];
  EXPECT_EQ(subscription["lost_messages"], 9);
  EXPECT_EQ(subscription["unread_messages"], 2);
  EXPECT_EQ(subscription["held_messages_max_per_publisher"], 4);
  EXPECT_EQ(subscription["pid"], ::getpid());
}

TEST(Ctl, ShowsTheTimesOfAQosAndExpiredMessages) {
  const DaemonProcess daemon;
  Node a(daemon.socket_path());
  const Qos timed{7, false, true, false, false, true, 1'000'000, 2'000'000, 3'000'000};
  a.publisher("/points", timed);
  Qos requested = timed;
  requested.lifespan_ns = 0;
  const auto s = a.subscription("/points", requested);
  const region::SubscriptionWords<M> counters{a.region.base(), s.extent};
  counters.counter(offsetof(abi::SubscriptionCounters, expired)).store(4);
  const std::string times =
      "  Deadline: 1000000 nanoseconds\n  Liveliness: MANUAL_BY_TOPIC\n"
      "  Liveliness lease duration: 3000000 nanoseconds\n";
  const CtlResult info = run_ctl(daemon.socket_path(), {"topic", "info", "-v", "/points"});
  EXPECT_THAT(info.out, HasSubstr("  Lifespan: 2000000 nanoseconds\n" + times));
  EXPECT_THAT(info.out, HasSubstr("  Lifespan: Infinite\n" + times));
  EXPECT_THAT(info.out, HasSubstr("Lost: 0 messages\nExpired: 4 messages\n"));
  const auto json = run_ctl(daemon.socket_path(), {"topic", "info", "/points", "-j"}).json();
  const auto& qos = json["publishers"][0]["qos"];
  EXPECT_EQ(qos["deadline_ns"], 1'000'000);
  EXPECT_EQ(qos["lifespan_ns"], 2'000'000);
  EXPECT_EQ(qos["liveliness_lease_ns"], 3'000'000);
  EXPECT_EQ(qos["liveliness"], "manual_by_topic");
  const auto& subscription = json["subscriptions"][0];
  EXPECT_EQ(subscription["qos"]["lifespan_ns"], nullptr);
  EXPECT_EQ(subscription["expired_messages"], 4);
  EXPECT_THAT(run_ctl(daemon.socket_path(), {"metrics"}).out,
              testing::ContainsRegex("agnocast_expired_messages_total\\{[^}]*\\} 4\n"));
}

TEST(Ctl, ListsProcessesAliveOrphanedAndDead) {
  DaemonProcess daemon;
  Node watcher(daemon.socket_path()), orphan(daemon.socket_path());
  watcher.subscription("/topic");
  orphan.publisher("/other");
  const pid_t pid = ::fork();
  if (pid == 0) {
    Node dying(daemon.socket_path());
    dying.open_window();
    dying.publisher("/topic");
    ::raise(SIGKILL);
  }
  ::waitpid(pid, nullptr, 0);
  watcher.wire.expect<wire::Announcement>(Opcode::announce);
  watcher.wire.expect<wire::Orphaned>(Opcode::orphaned);
  orphan.wire.socket().close();  // alive, and its region is mapped
  nlohmann::json list;
  ASSERT_TRUE(eventually([&] {
    list = run_ctl(daemon.socket_path(), {"process", "list", "--json"}).json();
    return list["processes"][1]["state"] == "orphaned";
  }));
  EXPECT_EQ(list["schema"], "agnocast.process-list/1");
  EXPECT_EQ(list["process_count"], 3);
  EXPECT_EQ(list["processes"][0]["state"], "alive");
  EXPECT_EQ(list["processes"][0]["subscription_count"], 1);
  EXPECT_EQ(list["processes"][2]["state"], "dead");
  EXPECT_EQ(list["processes"][2]["pid"], pid);
  EXPECT_EQ(list["processes"][2]["window_count"], 1);
  const CtlResult text = run_ctl(daemon.socket_path(), {"processes"});
  EXPECT_THAT(text.out, StartsWith("PID"));
  EXPECT_THAT(text.out, HasSubstr("  orphaned  "));
  EXPECT_THAT(text.out, HasSubstr("  dead  "));
  EXPECT_THAT(run_ctl(daemon.socket_path(), {"topic", "info", "-v", "/topic"}).out,
              HasSubstr("Publisher count: 0 (and 1 that left or died)"));
  EXPECT_THAT(run_ctl(daemon.socket_path(), {"topic", "info", "-v", "/topic"}).out,
              HasSubstr("State: orphan: has ended, its last messages are still being read"));
  const CtlResult verdict = run_ctl(daemon.socket_path(), {"verify"});
  EXPECT_EQ(verdict.status, 0) << verdict.out << verdict.err;
}

TEST(Ctl, ListsHeapsWithTheMemoryInUse) {
  DaemonProcess daemon;
  Node a(daemon.socket_path());
  a.open_window();
  a.commit(a.publisher("/points"), 3);
  const auto list = run_ctl(daemon.socket_path(), {"heap", "list", "-j"}).json();
  EXPECT_EQ(list["schema"], "agnocast.heap-list/1");
  ASSERT_EQ(list["windows"].size(), 1u);
  EXPECT_EQ(list["windows"][0]["length_bytes"], a.window.bytes);
  EXPECT_EQ(list["windows"][0]["used_bytes"], 1 << 20);
  EXPECT_EQ(list["windows"][0]["messages"], 3);
  char base[32];
  std::snprintf(base, sizeof base, "0x%016" PRIx64, a.window.base);
  EXPECT_EQ(list["windows"][0]["base_address"], base);
  EXPECT_THAT(run_ctl(daemon.socket_path(), {"heaps"}).out, HasSubstr("1.0 MiB  3\n"));
}

TEST(Ctl, ShowsTheStatusOfTheDaemon) {
  DaemonProcess daemon({.config =
                            "[heap]\nwindow_bytes = \"64MiB\"\narena_bytes = \"1GiB\"\n[quota]\n"
                            "clients = 5\nheld_messages = \"unlimited\"\n[limits]\n"
                            "topics = 9\n"});
  Node a(daemon.socket_path());
  a.publisher("/points");
  a.wire.create_publisher("bad name");
  const auto status = run_ctl(daemon.socket_path(), {"status", "--json=pretty"}).json();
  EXPECT_EQ(status["schema"], "agnocast.status/1");
  EXPECT_EQ(status["daemon"]["pid"], daemon.pid());
  EXPECT_EQ(status["daemon"]["socket"], daemon.socket_path());
  EXPECT_GT(status["daemon"]["uptime_ns"], 0);
  EXPECT_EQ(status["in_use"]["processes"], 1);
  EXPECT_EQ(status["in_use"]["publishers"], 1);
  EXPECT_EQ(status["counters"]["processes_registered"], 1);
  EXPECT_EQ(status["counters"]["requests_refused"], 1);
  EXPECT_EQ(status["limits"]["topics"], 9);
  EXPECT_EQ(status["quota_per_user"]["processes"], 5);
  EXPECT_EQ(status["quota_per_user"]["heap_bytes"], std::uint64_t{768} << 20) << "of the arena";
  EXPECT_TRUE(status["quota_per_user"]["held_messages"].is_null()) << "unlimited is no number";
  EXPECT_EQ(status["users"][0]["uid"], ::geteuid());
  EXPECT_EQ(status["users"][0]["in_use"]["publishers"], 1);
  const CtlResult text = run_ctl(daemon.socket_path(), {"status"});
  EXPECT_EQ(text.status, 0);
  EXPECT_THAT(text.out, HasSubstr("processes      1 of 2048\n"));
  EXPECT_THAT(text.out, HasSubstr("topics         1 of 9\n"));
  EXPECT_EQ(text.out.find('\x1b'), std::string::npos) << "no colour without a terminal";
}

// Returns its output on a terminal.
std::string on_a_terminal(const std::string& socket, const char* no_colour) {
  const UniqueFd master(::posix_openpt(O_RDWR | O_NOCTTY | O_CLOEXEC));
  char name[64];
  if (!master || ::grantpt(master.get()) != 0 || ::unlockpt(master.get()) != 0 ||
      ::ptsname_r(master.get(), name, sizeof name) != 0)
    return "(no terminal)";
  const UniqueFd terminal(::open(name, O_RDWR | O_NOCTTY | O_CLOEXEC));
  const pid_t pid = ::fork();
  if (pid == 0) {
    ::dup2(terminal.get(), STDOUT_FILENO);
    ::setenv("AGNOCAST_SOCKET", socket.c_str(), 1);
    ::setenv("NO_COLOR", no_colour, 1);
    ::execl(AGNOCAST_TEST_CTL, AGNOCAST_TEST_CTL, "status", nullptr);
    ::_exit(98);
  }
  ::waitpid(pid, nullptr, 0);
  char text[8192];
  const ssize_t count = ::read(master.get(), text, sizeof text);
  return count > 0 ? std::string(text, static_cast<std::size_t>(count)) : "(nothing)";
}

TEST(Ctl, IsColouredOnATerminalUnlessSwitchedOff) {
  if (::access("/dev/pts/ptmx", F_OK) != 0)
    GTEST_SKIP() << "no terminals here: /dev/pts is missing";
  DaemonProcess daemon;
  EXPECT_THAT(on_a_terminal(daemon.socket_path(), ""), HasSubstr("\x1b[1magnocastd"));
  const std::string plain = on_a_terminal(daemon.socket_path(), "1");
  EXPECT_THAT(plain, StartsWith("agnocastd "));
  EXPECT_EQ(plain.find('\x1b'), std::string::npos);
}

void expect_keys(const nlohmann::json& value) {
  for (const auto& [key, inner] : value.items()) {
    if (value.is_object()) {
      EXPECT_THAT(key, MatchesRegex("[a-z][a-z0-9_]*"));
    }
    if (inner.is_structured()) expect_keys(inner);
  }
}

TEST(Ctl, JsonIsOneObjectWithASchema) {
  DaemonProcess daemon;
  Node a(daemon.socket_path());
  a.open_window();
  a.commit(a.publisher("/points"), 1);
  a.subscription("/points");
  const std::vector<std::pair<std::vector<std::string>, std::string>> cases = {
      {{"status"}, "agnocast.status/1"},
      {{"topic", "list"}, "agnocast.topic-list/1"},
      {{"topic", "info", "/points"}, "agnocast.topic-info/1"},
      {{"process", "list"}, "agnocast.process-list/1"},
      {{"thread", "list"}, "agnocast.thread-list/1"},
      {{"heap", "list"}, "agnocast.heap-list/1"},
      {{"journal"}, "agnocast.journal/1"},
      {{"verify"}, "agnocast.verify/1"}};
  for (const auto& [words, schema] : cases) {
    for (const char* form : {"-j", "--json", "--json=short", "--json=pretty"}) {
      auto with_form = words;
      with_form.insert(with_form.begin(), form);
      const CtlResult result = run_ctl(daemon.socket_path(), with_form);
      EXPECT_EQ(result.status, 0) << schema << result.err;
      EXPECT_EQ(result.json().begin().value().is_null(), false);
      EXPECT_EQ(result.json()["schema"], schema);
      EXPECT_THAT(result.out, StartsWith(form == std::string("--json=pretty") ? "{\n  \"schema\""
                                                                              : "{\"schema\":\""));
      expect_keys(result.json());
    }
  }
}

TEST(Ctl, PrintsNoControlCharactersOfOthers) {
  DaemonProcess daemon;
  Node a(daemon.socket_path(), 0, "no\x1b]0;de\n");
  a.publisher("/points");
  for (const std::vector<std::string>& words :
       {std::vector<std::string>{"topic", "info", "-v", "/points"},
        {"process", "list"},
        {"heap", "list"},
        {"journal"}}) {
    const CtlResult result = run_ctl(daemon.socket_path(), words);
    EXPECT_EQ(result.status, 0) << result.err;
    EXPECT_EQ(result.out.find('\x1b'), std::string::npos) << result.out;
    EXPECT_EQ(result.out.find("no\\x1b]0;de\\n") == std::string::npos, words[0] == "heap")
        << result.out;
  }
}

// --- errors

// Long because it is the table of errors.
TEST(Ctl, ReportsErrorsInTwoLines) {
  DaemonProcess daemon;
  Node a(daemon.socket_path()), far(daemon.socket_path(), 3);
  a.publisher("/points");
  far.publisher("/far");
  struct Case {
    std::vector<std::string> words;
    int status;
    std::string err;
    std::vector<std::string> environment = {};
  };
  const Case cases[] = {
      {{"topic", "info", "/pionts"},
       4,
       "agnocast-ctl: /pionts: there is no such topic in domain 0; did you mean /points?\n"
       "hint: agnocast-ctl topic info /points\n"},
      {{"topic", "info", "zebra"},
       4,
       "agnocast-ctl: /zebra: there is no such topic in domain 0\nhint: agnocast-ctl topic list\n"},
      {{"topic", "info", "/far"},
       4,
       "agnocast-ctl: /far: there is no such topic in domain 0\n"
       "hint: agnocast-ctl topic info /far --domain 3\n"},
      {{"topic", "info"},
       2,
       "agnocast-ctl: NAME: is missing\nhint: agnocast-ctl topic info -v /points\n"},
      {{"topic", "lst"},
       2,
       "agnocast-ctl: topic lst: unknown command\nhint: agnocast-ctl topic list\n"},
      {{"topics", "x"},
       2,
       "agnocast-ctl: x: agnocast-ctl topic list takes no such argument\n"
       "hint: agnocast-ctl topic list --help\n"},
      {{"statsu"}, 2, "agnocast-ctl: statsu: unknown command\nhint: agnocast-ctl status\n"},
      {{"help"}, 2, "agnocast-ctl: help: unknown command\nhint: agnocast-ctl --help\n"},
      {{"processs"}, 2, "agnocast-ctl: processs: unknown command\nhint: agnocast-ctl processes\n"},
      {{"tpic"}, 2, "agnocast-ctl: tpic: unknown command\nhint: agnocast-ctl topic --help\n"},
      {{"frobnicate"}, 2, "agnocast-ctl: frobnicate: unknown command\nhint: agnocast-ctl --help\n"},
      {{"topic"}, 2, "agnocast-ctl: topic: a verb is missing\nhint: agnocast-ctl topic --help\n"},
      {{}, 2, "agnocast-ctl: command line: a command is missing\nhint: agnocast-ctl --help\n"},
      {{"--frob"}, 2, "agnocast-ctl: --frob: unknown option\nhint: agnocast-ctl --help\n"},
      {{"topic", "list", "--show-typs"},
       2,
       "agnocast-ctl: --show-typs: unknown option\nhint: agnocast-ctl topic list --show-types\n"},
      {{"status", "-t"}, 2, "agnocast-ctl: -t: unknown option\nhint: agnocast-ctl status --help\n"},
      {{"status", "--json=xml"},
       2,
       "agnocast-ctl: --json: \"xml\" is unknown; use one of short, pretty\n"
       "hint: agnocast-ctl status --help\n"},
      {{"topics"},
       2,
       "agnocast-ctl: ROS_DOMAIN_ID: \"seven\" is not a domain; use a number from 0 to 232\n"
       "hint: ROS_DOMAIN_ID=0 agnocast-ctl topic list\n",
       {"ROS_DOMAIN_ID=seven"}},
      {{"topics", "--domain", "233"},
       2,
       "agnocast-ctl: --domain: \"233\" is not a domain; use a number from 0 to 232\n"
       "hint: ROS_DOMAIN_ID=0 agnocast-ctl topic list\n"},
      {{"status", "--socket", "/nonexistent/socket"},
       3,
       "agnocast-ctl: /nonexistent/socket: agnocastd does not answer: No such file or directory\n"
       "hint: start it: systemctl start agnocastd; or name its socket in AGNOCAST_SOCKET\n"},
      {{"status", "--socket", std::string(200, 'x')},
       2,
       "agnocast-ctl: " + std::string(200, 'x') +
           ": the path of a socket is longer than 107 bytes\nhint: see what is named beside it\n"},
  };
  for (const Case& c : cases) {
    const CtlResult result = run_ctl(daemon.socket_path(), c.words, c.environment);
    EXPECT_EQ(result.status, c.status) << c.err;
    EXPECT_EQ(result.err, c.err);
    EXPECT_EQ(result.out, "");
  }
}

TEST(Ctl, ReportsThatItsOutputCannotBeWritten) {
  DaemonProcess daemon;
  Node a(daemon.socket_path());
  // Longer than stdio's buffer, so that not only the last write fails.
  for (int i = 0; i < 100; ++i) a.publisher("/points/n" + std::to_string(i) + std::string(60, 'x'));
  const std::string unwritten =
      "agnocast-ctl: output: it cannot be written\nhint: df; agnocast-ctl status\n";
  for (const std::vector<std::string>& words : {std::vector<std::string>{"status"},
                                                {"topics"},
                                                {"topics", "--json"},
                                                {"--help"},
                                                {"verify", "--help"},
                                                {"--version"}}) {
    const CtlResult result = run_ctl(daemon.socket_path(), words, {}, {}, "/dev/full");
    EXPECT_EQ(result.status, 1) << words[0];
    EXPECT_EQ(result.err, unwritten) << words[0];
  }
}

TEST(Ctl, HasHelpForEverything) {
  const CtlResult all = run_ctl("/x", {"--help"});
  EXPECT_EQ(all.status, 0);
  for (const char* word : {"status", "topic list", "topic info NAME", "process list", "thread list",
                           "heap list", "verify", "--json", "Exit status", "Examples:"})
    EXPECT_THAT(all.out, HasSubstr(word));
  for (const std::vector<std::string>& words : {std::vector<std::string>{"status"},
                                                {"topic", "list"},
                                                {"topic", "info"},
                                                {"process", "list"},
                                                {"thread", "list"},
                                                {"heap", "list"},
                                                {"verify"},
                                                {"topics"}}) {
    auto with_help = words;
    with_help.emplace_back("--help");
    const CtlResult one = run_ctl("/x", with_help);
    EXPECT_EQ(one.status, 0) << one.err;
    EXPECT_THAT(one.out, HasSubstr("Examples:\n  agnocast-ctl "));
    EXPECT_THAT(one.out, HasSubstr("--socket PATH"));
  }
  EXPECT_THAT(run_ctl("/x", {"topic", "--help"}).out, HasSubstr("topic info NAME"));
  EXPECT_THAT(run_ctl("/x", {"--version"}).out, StartsWith("agnocast-ctl "));
  EXPECT_THAT(run_ctl("/x", {"status", "--version"}).out, StartsWith("agnocast-ctl "));
}

TEST(Ctl, ReportsThatTheDaemonIsAwayStoppedOrRefuses) {
  {
    DaemonProcess daemon;
    daemon.kill();
    const CtlResult gone = run_ctl(daemon.socket_path(), {"topic", "list"});
    EXPECT_EQ(gone.status, 3);
    EXPECT_THAT(gone.err,
                HasSubstr("agnocastd does not answer: Connection refused\nhint: start it"));
  }
  DaemonProcess daemon;
  ::kill(daemon.pid(), SIGSTOP);
  const CtlResult stopped = run_ctl(daemon.socket_path(), {"status"});
  ::kill(daemon.pid(), SIGCONT);
  EXPECT_EQ(stopped.status, 3);
  EXPECT_THAT(stopped.err, HasSubstr("agnocastd does not answer within 5 s\nhint: "));
  std::vector<std::unique_ptr<WireClient>> observers;
  for (std::uint32_t i = 0; i < abi::observer_count_max; ++i) {
    observers.push_back(std::make_unique<WireClient>(daemon.socket_path()));
    wire::Observe body{};
    body.fingerprint = abi::fingerprint();
    EXPECT_EQ(observers.back()->ask(Opcode::observe, body).opcode(), Opcode::observed);
  }
  const CtlResult refused = run_ctl(daemon.socket_path(), {"status"});
  EXPECT_EQ(refused.status, 1);
  EXPECT_THAT(refused.err, HasSubstr("this user may have 8 observers\nhint: close what"));
}

TEST(Ctl, ReportsThatTheSocketBelongsToAnotherProgram) {
  const std::string directory = make_directory(), path = directory + "/socket";
  const UniqueFd other(::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0));
  ASSERT_EQ(::bind(other.get(), unix_address(path)->get(), UnixAddress::size()), 0);
  ASSERT_EQ(::listen(other.get(), 1), 0);
  const CtlResult result = run_ctl(path, {"status"});
  EXPECT_EQ(result.status, 3);
  EXPECT_THAT(result.err, StartsWith("agnocast-ctl: " + path +
                                     ": this is the socket of another program\nhint: start it: "));
  remove_directory(directory);
}

TEST(Ctl, RefusesUsersThatMayNotLook) {
  if (::geteuid() != 0) GTEST_SKIP() << "needs root";
  DaemonProcess daemon({.config = "[daemon]\nsocket_mode = \"0600\"\n"});
  const CtlResult refused = run_ctl(daemon.socket_path(), {"topic", "list"}, {}, 65534);
  EXPECT_EQ(refused.status, 5) << refused.err;
  EXPECT_EQ(refused.err,
            "agnocast-ctl: " + daemon.socket_path() +
                ": this user may not do that: Permission denied\nhint: ask the administrator to be "
                "let in: into the group of the socket, see agnocast-ctl doctor\n");
}

TEST(Ctl, DoesNotDisturbByLooking) {
  DaemonProcess daemon;
  Node a(daemon.socket_path()), b(daemon.socket_path());
  a.open_window();
  a.commit(a.publisher("/points"), 2);
  b.subscription("/points");
  a.wire.drain();
  b.wire.drain();
  const std::size_t descriptors = daemon.descriptor_count();
  for (const std::vector<std::string>& words : {std::vector<std::string>{"status"},
                                                {"topics", "-v"},
                                                {"topic", "info", "-v", "/points"},
                                                {"processes"},
                                                {"threads"},
                                                {"heaps"},
                                                {"journal"},
                                                {"verify"}})
    EXPECT_EQ(run_ctl(daemon.socket_path(), words).status, 0);
  EXPECT_TRUE(a.wire.drain().empty());
  EXPECT_TRUE(b.wire.drain().empty());
  EXPECT_TRUE(eventually([&] { return daemon.descriptor_count() <= descriptors; }));
  const auto status = run_ctl(daemon.socket_path(), {"status", "-j"}).json();
  EXPECT_EQ(status["counters"]["processes_registered"], 2);
}
}  // namespace
}  // namespace agnocast::test
