// SPDX-License-Identifier: Apache-2.0
//
// Goal: each command shows what exists: nodes, messages and their holders, rates, pairs that are
// not zero-copy and why, pictures, the whole as one object; and every command of the table has
// help, refuses bad input and leaves no trace when it looks. Method: the real daemon, raw clients
// whose regions this test writes like honest processes, agnocast-ctl as a program of its own.

#include <base/clock.hpp>
#include <ctl/cli/commands.hpp>
#include <ctl/cli/help.hpp>
#include <tests/integration/ctl/ctl_node.hpp>
#include <tests/support/processes/ctl.hpp>
#include <tests/support/processes/daemon_process.hpp>
#include <tests/support/soon.hpp>

#include <gmock/gmock.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <sstream>
#include <string>
#include <thread>
#include <vector>

namespace agnocast::test {
namespace {

using abi::Qos;
using testing::ContainsRegex;
using testing::HasSubstr;
using Node = CtlNode;
using Words = std::vector<std::string>;

constexpr std::uint64_t second_ns = 1'000'000'000;

class CtlLook : public testing::Test {
 protected:
  CtlResult ctl(Words words, const std::vector<std::string>& environment = {}) {
    return run_ctl(daemon_.socket_path(), std::move(words), environment);
  }
  std::string out(Words words) {
    const CtlResult result = ctl(std::move(words));
    EXPECT_EQ(result.status, 0) << result.err;
    EXPECT_EQ(result.err, "");
    return result.out;
  }
  nlohmann::json json(Words words) {
    words.emplace_back("-j");
    const CtlResult result = ctl(std::move(words));
    EXPECT_EQ(result.status, 0) << result.err;
    return result.json();
  }

  DaemonProcess daemon_;
};

TEST_F(CtlLook, FindsTopicsByTypeAndTypesByTopic) {
  Node a(daemon_.socket_path()), far(daemon_.socket_path(), 7);
  a.publisher("/left", {7}, "/talker", "std_msgs/msg/String");
  a.publisher("/right", {7}, "/talker", "std_msgs/msg/String");
  a.publisher("/_hidden", {7}, "/talker", "std_msgs/msg/String");
  far.publisher("/far", {7}, "/talker", "std_msgs/msg/String");
  EXPECT_EQ(out({"topic", "find", "std_msgs/msg/String"}), "/left\n/right\n");
  EXPECT_EQ(out({"topic", "find", "std_msgs/msg/String", "--include-hidden-topics"}),
            "/_hidden\n/left\n/right\n");
  EXPECT_EQ(out({"topic", "find", "-c", "std_msgs/msg/String"}), "2\n");
  EXPECT_EQ(out({"topic", "find", "std_msgs/msg/String", "--all-domains"}),
            "/far\n/left\n/right\n");
  EXPECT_EQ(out({"topic", "find", "no_msgs/msg/No"}), "");
  EXPECT_EQ(json({"topic", "find", "std_msgs/msg/String"})["topics"][1], "/right");
  EXPECT_EQ(out({"topic", "type", "left"}), "std_msgs/msg/String\n");
  EXPECT_EQ(json({"topic", "type", "/left"})["type"], "std_msgs/msg/String");
  EXPECT_EQ(ctl({"topic", "type", "/lft"}).status, 4);
  EXPECT_THAT(ctl({"topic", "type", "/lft"}).err,
              HasSubstr("hint: agnocast-ctl topic type /left\n"));
}

TEST_F(CtlLook, ShowsNodesInTheFormatOfRos2) {
  Node a(daemon_.socket_path()), b(daemon_.socket_path());
  a.publisher("/points", {7}, "/lidar/top", "sensor_msgs/msg/PointCloud2");
  a.publisher("/points", {7}, "/lidar/top", "sensor_msgs/msg/PointCloud2");
  a.subscription("/clock", {5}, "/lidar/top", "rosgraph_msgs/msg/Clock");
  a.subscription("/_service/request/ns/add", {5}, "/lidar/top", "test/srv/Add_Request");
  a.publisher("/_service/request/sum", {5}, "/lidar/top", "test/srv/Sum_Request");
  b.subscription("/points", {5}, "/viewer", "sensor_msgs/msg/PointCloud2");
  b.subscription("/_private/x", {5}, "/_tool", "test/msg/Type");
  EXPECT_EQ(out({"node", "list"}), "/lidar/top\n/viewer\n");
  EXPECT_EQ(out({"nodes", "-a"}), "/_tool\n/lidar/top\n/viewer\n");
  EXPECT_EQ(out({"nodes", "-c"}), "2\n");
  EXPECT_EQ(out({"node", "info", "/lidar/top"}),
            "/lidar/top\n  Subscribers:\n    /clock: rosgraph_msgs/msg/Clock\n"
            "  Publishers:\n    /points: sensor_msgs/msg/PointCloud2\n"
            "  Service Servers:\n    /ns/add: test/srv/Add\n  Service Clients:\n    /sum: "
            "test/srv/Sum\n");
  EXPECT_EQ(out({"node", "info", "_tool"}),
            "/_tool\n  Subscribers:\n  Publishers:\n  Service Servers:\n  Service Clients:\n");
  EXPECT_EQ(out({"node", "info", "_tool", "--include-hidden-topics"}),
            "/_tool\n  Subscribers:\n    /_private/x: test/msg/Type\n  Publishers:\n"
            "  Service Servers:\n  Service Clients:\n");
  const auto info = json({"node", "info", "lidar/top"});
  EXPECT_EQ(info["schema"], "agnocast.node-info/1");
  EXPECT_EQ(info["nodes"][0]["pid"], ::getpid());
  EXPECT_EQ(info["nodes"][0]["publishers"].size(), 3u) << "each endpoint";
  EXPECT_EQ(info["nodes"][0]["service_servers"][0]["service"], "/ns/add");
  EXPECT_EQ(info["nodes"][0]["service_clients"][0]["type"], "test/srv/Sum");
  const CtlResult missing = ctl({"node", "info", "/lidar/tap"});
  EXPECT_EQ(missing.status, 4);
  EXPECT_EQ(
      missing.err,
      "agnocast-ctl: /lidar/tap: there is no such node in domain 0; did you mean /lidar/top?\n"
      "hint: agnocast-ctl node info /lidar/top\n");
  Node twin(daemon_.socket_path());
  twin.publisher("/points", {7}, "/viewer", "sensor_msgs/msg/PointCloud2");
  EXPECT_THAT(out({"node", "info", "/viewer"}),
              HasSubstr("There are 2 nodes in the graph with the exact name \"/viewer\".\n"));
}

TEST_F(CtlLook, NamesTheHoldersOfAMessageAndItsUnreadSubscriptions) {
  Node a(daemon_.socket_path()), b(daemon_.socket_path());
  a.open_window();
  const auto p = a.publisher("/points", {7}, "/lidar");
  const auto s = b.subscription("/points", {5}, "/viewer");
  a.commit(p, 4);
  a.stamp(p, 4, second_ns, 1000);
  b.link(s, p, 2, 1);  // took two, holds the first
  const auto list = json({"message", "list", "/points"});
  ASSERT_EQ(list["message_count"], 4);
  const auto& first = list["messages"][0];
  EXPECT_EQ(first["sequence"], 1);
  EXPECT_EQ(first["held_by"][0]["node_name"], "viewer");
  EXPECT_EQ(first["held_by"][0]["pid"], ::getpid());
  EXPECT_TRUE(first["unread_by"].empty());
  EXPECT_GE(first["age_ns"], 3 * second_ns);
  EXPECT_LT(first["age_ns"], 60 * second_ns);
  EXPECT_TRUE(list["messages"][1]["held_by"].empty());
  EXPECT_TRUE(list["messages"][1]["unread_by"].empty()) << "nobody has it unread";
  EXPECT_EQ(list["messages"][3]["unread_by"][0]["node_name"], "viewer");
  EXPECT_THAT(out({"messages"}), ContainsRegex("/points +lidar +1 +[0-9.]+ s +64 B +viewer \\("));
  EXPECT_EQ(ctl({"message", "list", "/none"}).status, 4);
}

TEST_F(CtlLook, SaysOfEachPairWhetherItIsZeroCopyAndWhyNot) {
  Node a(daemon_.socket_path()), b(daemon_.socket_path());
  a.open_window();
  const Qos reliable{5, false, true, false, false}, best_effort{5, false, false, false, false};
  const auto p = a.publisher("/points", reliable, "/lidar");
  const auto weak = a.publisher("/points", best_effort, "/weak");
  const auto s = b.subscription("/points", reliable, "/viewer");
  const auto states = [&] {
    std::vector<std::string> all;
    const auto info = json({"topic", "info", "/points"});
    for (const auto& pair : info["pairs"]) all.push_back(pair["state"]);
    return all;
  };
  EXPECT_EQ(states(), (std::vector<std::string>{"joining", "incompatible_qos"}));
  b.link(s, p, 0, 0);
  EXPECT_EQ(states(), (std::vector<std::string>{"zero_copy", "incompatible_qos"}));
  const std::string process = " of wire_client (pid " + std::to_string(::getpid()) + ", uid " +
                              std::to_string(::geteuid()) + ")";
  EXPECT_THAT(out({"topic", "info", "-v", "/points"}),
              HasSubstr("Is it zero-copy?\n  /lidar -> /viewer: yes\n  /weak" + process +
                        " -> /viewer" + process +
                        ": no, incompatible_qos: reliable is requested, best effort is "
                        "offered\n"));
  auto& endpoint = *reinterpret_cast<abi::PublisherEndpoint*>(a.region.base() + p.extent);
  a.commit(p, 3);
  endpoint.adopted_messages.store(2);
  endpoint.adopted_bytes.store(2048);
  EXPECT_THAT(
      out({"topic", "info", "-v", "/points"}),
      HasSubstr("/lidar" + process + " -> /viewer" + process +
                ": no, adopted: 2 of 3 messages were built outside the shared heap, 2.0 KiB "
                "of them copied into it by publish\n"));
  const region::SubscriptionWords<SharedMemory> counters{b.region.base(), s.extent};
  counters.counter(offsetof(abi::SubscriptionCounters, unreachable)).store(4);
  EXPECT_EQ(states()[0], "unreachable");
  EXPECT_EQ(weak.index, 1u);
}

TEST_F(CtlLook, ShowsTheWorstFirst) {
  Node a(daemon_.socket_path()), b(daemon_.socket_path());
  a.open_window();
  const auto fast = a.publisher("/fast", {20}, "/lidar");
  a.commit(fast, 11);
  const auto before = std::chrono::steady_clock::now();
  a.stamp(fast, 11, second_ns, 5000);
  const auto s = b.subscription("/fast", {10}, "/slow_viewer");
  b.link(s, fast, 2, 0);  // 9 of 10 unread
  a.publisher("/silent");
  const auto held = a.publisher("/held", {20}, "/lidar");
  a.commit(held, 2);
  a.stamp(held, 2, 5 * second_ns, 10);
  const auto h = b.subscription("/held", {10}, "/holder");
  b.link(h, held, 2, 1);
  auto other = WireClient::endpoint("/fast", {5}, "other/msg/Type");
  EXPECT_EQ(a.wire.ask(wire::Opcode::create_publisher, other).refused_code(), Errc::type_mismatch);

  const auto top = json({"top", "-n", "1"});
  const std::chrono::duration<double> silence = std::chrono::steady_clock::now() - before;
  EXPECT_EQ(top["schema"], "agnocast.top/1");
  ASSERT_EQ(top["topics"].size(), 3u);
  const auto& first = top["topics"][0];
  EXPECT_EQ(first["topic"], "/fast");
  EXPECT_EQ(first["state"], "refused");
  EXPECT_EQ(first["lag_messages"], 9);
  EXPECT_EQ(first["message_mean_bytes"], 5000);
  EXPECT_GT(first["rate_hz"].get<double>(), 0.95 / std::max(1.0, silence.count())) << "it sinks";
  EXPECT_LT(first["rate_hz"].get<double>(), 1.05);
  EXPECT_EQ(first["notes"].size(), 2u);
  EXPECT_EQ(top["topics"][1]["topic"], "/held");
  EXPECT_EQ(top["topics"][1]["state"], "holding");
  EXPECT_EQ(top["topics"][1]["held_messages"], 1);
  EXPECT_EQ(top["topics"][2]["state"], "idle");
  EXPECT_EQ(top["totals"]["refused"], 1);
  const std::string text = out({"top", "-b", "-n", "1"});
  EXPECT_THAT(text, ContainsRegex("\nX +/fast +Type +"));
  EXPECT_THAT(text,
              ContainsRegex("`- slow reader: /slow_viewer pid [0-9]+ \\(depth 10, 9 unread\\)\n"));
  EXPECT_THAT(text, ContainsRegex(
                        "`- refused: wire_client pid [0-9]+: type_mismatch: publisher of /fast: "));
  EXPECT_THAT(text, ContainsRegex("\nH +/held .*\n  `- holder: /holder pid "));
  EXPECT_EQ(json({"top", "-n", "1", "--sort", "topic"})["topics"][2]["topic"], "/silent");
}

TEST_F(CtlLook, DrawsAPicture) {
  Node a(daemon_.socket_path()), b(daemon_.socket_path());
  a.open_window();
  const auto p = a.publisher("/points", {20}, "/lidar", "my_msgs::Cloud<\"a\">");
  const auto s = b.subscription("/points", {5}, "/viewer", "my_msgs::Cloud<\"a\">");
  EXPECT_EQ(
      out({"graph"}),
      "digraph agnocast {\n  rankdir=LR;\n  node [fontname=\"sans-serif\"];\n"
      "  n0 [label=\"/lidar\", shape=box];\n  n1 [label=\"/viewer\", shape=box];\n"
      "  t0 [label=\"/points\\nmy_msgs::Cloud<\\\"a\\\">\", shape=ellipse];\n"
      "  n0 -> t0 [label=\"0.0 Hz\"];\n"
      "  t0 -> n1 [label=\"the subscription has not linked yet\", style=dashed, color=red];\n}\n");
  b.link(s, p, 0, 0);
  const std::string mermaid = out({"graph", "--format", "mermaid"});
  EXPECT_THAT(mermaid, HasSubstr("flowchart LR\n"));
  EXPECT_THAT(mermaid, HasSubstr("  n0 -->|\"0.0 Hz\"| t0\n  t0 --> n1\n"));
  const auto graph = json({"graph"});
  EXPECT_EQ(graph["edges"].size(), 2u);
  EXPECT_EQ(graph["edges"][1]["direction"], "subscribes");
  EXPECT_EQ(graph["edges"][1]["is_zero_copy"], true);
  EXPECT_EQ(ctl({"graph", "--format", "svg"}).status, 2);
}

TEST_F(CtlLook, DumpsEverythingAsOneObject) {
  Node a(daemon_.socket_path());
  a.open_window();
  a.commit(a.publisher("/points"), 2);
  auto deep = WireClient::endpoint("/points", {1}, "other/msg/Type");
  a.wire.ask(wire::Opcode::create_publisher, deep);
  const CtlResult result = ctl({"dump"});
  EXPECT_EQ(result.status, 0);
  const auto dump = result.json();
  EXPECT_EQ(dump["schema"], "agnocast.dump/1");
  EXPECT_EQ(dump["status"]["schema"], "agnocast.status/1");
  EXPECT_EQ(dump["topics"].size(), 1u);
  EXPECT_EQ(dump["processes"].size(), 1u);
  EXPECT_EQ(dump["windows"].size(), 1u);
  EXPECT_EQ(dump["threads"].size(), 0u);
  EXPECT_EQ(dump["messages"].size(), 2u);
  EXPECT_EQ(dump["refusals"][0]["code"], "type_mismatch");
  EXPECT_EQ(std::count(result.out.begin(), result.out.end(), '\n'), 1) << "one line";
}

TEST_F(CtlLook, ShowsOneProcess) {
  Node a(daemon_.socket_path());
  a.open_window();
  a.publisher("/points", {7}, "/lidar");
  a.subscription("/clock");
  auto other = WireClient::endpoint("/points", {1}, "other/msg/Type");
  a.wire.ask(wire::Opcode::create_publisher, other);
  const std::string pid = std::to_string(::getpid());
  for (const std::string& name : {pid, std::string("wire_client"), std::string("0.1")}) {
    const std::string info = out({"process", "info", name});
    EXPECT_THAT(info, HasSubstr("wire_client (pid " + pid + ", uid "));
    EXPECT_THAT(info, HasSubstr("Publishers:\n    /points: test/msg/Type\n"));
    EXPECT_THAT(info, HasSubstr("Subscribers:\n    /clock: test/msg/Type\n"));
    EXPECT_THAT(info, HasSubstr("Refused recently:\n    type_mismatch: publisher of /points: "));
  }
  const auto info = json({"process", "info", pid});
  EXPECT_EQ(info["processes"][0]["windows"].size(), 1u);
  EXPECT_EQ(info["processes"][0]["refusals"][0]["topic"], "/points");
  EXPECT_EQ(json({"heap", "info", pid})["window_count"], 1);
  EXPECT_EQ(ctl({"process", "info", "nobody"}).status, 4);
  EXPECT_EQ(ctl({"heap", "info", "999999"}).status, 4);
}

TEST_F(CtlLook, ChangesTheLogLevelOfTheDaemon) {
  EXPECT_EQ(out({"log-level"}), "info\n");
  EXPECT_EQ(out({"log-level", "debug"}), "debug\n");
  Node a(daemon_.socket_path());
  EXPECT_TRUE(daemon_.wait_for_log("client registered"));
  EXPECT_EQ(json({"log-level"})["log_level"], "debug");
  EXPECT_EQ(json({"status"})["daemon"]["log_level"], "debug");
  const CtlResult wrong = ctl({"log-level", "debgu"});
  EXPECT_EQ(wrong.status, 2);
  EXPECT_EQ(
      wrong.err,
      "agnocast-ctl: \"debgu\": unknown level; use one of error, warning, notice, info, debug\n"
      "hint: agnocast-ctl log-level debug\n");
}

TEST_F(CtlLook, ExplainsCodesWithoutADaemon) {
  const CtlResult one = run_ctl("/nonexistent/socket", {"explain", "hook_missing"});
  EXPECT_EQ(one.status, 0);
  EXPECT_EQ(one.out, "hook_missing (" + std::to_string(static_cast<int>(Errc::hook_missing)) +
                         ")\n  what    " + sentence_of(Errc::hook_missing) + "\n  why     " +
                         cause_of(Errc::hook_missing) + "\n  remedy  " +
                         remedy_of(Errc::hook_missing) + "\n");
  EXPECT_EQ(out({"explain", std::to_string(static_cast<int>(Errc::hook_missing))}), one.out);
  EXPECT_THAT(out({"explain"}), HasSubstr("revoked "));
  EXPECT_EQ(json({"explain", "revoked"})["codes"][0]["remedy"], remedy_of(Errc::revoked));
  const CtlResult wrong = ctl({"explain", "hook_mising"});
  EXPECT_EQ(wrong.status, 4);
  EXPECT_EQ(wrong.err,
            "agnocast-ctl: hook_mising: there is no such code; did you mean hook_missing?\n"
            "hint: agnocast-ctl explain hook_missing\n");
}

/// agnocast-ctl beside the test, until Ctrl-C or the end of the test; what it prints are objects.
class Beside {
 public:
  Beside(const DaemonProcess& daemon, Words words) : file_(daemon.directory() + "/beside") {
    words.insert(words.begin(), AGNOCAST_TEST_CTL);
    words.emplace_back("-j");
    std::vector<char*> arguments;
    for (std::string& word : words) arguments.push_back(word.data());
    arguments.push_back(nullptr);
    pid_ = ::fork();
    if (pid_ != 0) return;
    ::setenv("AGNOCAST_SOCKET", daemon.socket_path().c_str(), 1);
    if (std::freopen(file_.c_str(), "w", stdout) == nullptr) ::_exit(98);
    ::execv(arguments[0], arguments.data());
    ::_exit(99);
  }
  ~Beside() {
    if (pid_ <= 0) return;
    ::kill(pid_, SIGKILL);
    ::waitpid(pid_, nullptr, 0);
  }
  Beside(const Beside&) = delete;
  Beside& operator=(const Beside&) = delete;

  std::vector<nlohmann::json> objects() const {
    std::vector<nlohmann::json> all;
    std::ifstream in(file_);
    for (std::string line; std::getline(in, line);)
      all.push_back(nlohmann::json::parse(line, nullptr, false));
    return all;
  }
  /// Returns the last object, which may be incomplete.
  nlohmann::json last() const {
    auto all = objects();
    return all.empty() ? nlohmann::json() : std::move(all.back());
  }
  /// Presses Ctrl-C. Returns the exit status.
  int interrupt() {
    EXPECT_EQ(::kill(pid_, SIGINT), 0);
    int status = 0;
    EXPECT_EQ(::waitpid(pid_, &status, 0), pid_);
    pid_ = 0;
    return WIFEXITED(status) ? WEXITSTATUS(status) : -1;
  }

 private:
  std::string file_;
  pid_t pid_ = 0;
};

TEST_F(CtlLook, MeasuresWithoutSubscribing) {
  Node a(daemon_.socket_path());
  a.open_window();
  const auto p = a.publisher("/points", {20}, "/lidar");
  const region::PublisherWords<SharedMemory> words{a.region.base(), p.extent};
  // Acts as a publisher at 200 Hz, by its stamps, whose messages of 1000 bytes are read at once. It
  // uses the slots in turn: a look that is held up has time until its slot is used again.
  const std::uint64_t begin = monotonic_ns();
  std::uint64_t published = 0;
  const auto publish = [&] {
    const std::uint64_t sequence = p.first_sequence + 1 + published;
    const std::uint64_t slot = published % abi::slot_count_max;
    words.slot_id(slot).store(0);
    words.slot_stamp(slot).store(begin + published * second_ns / 200);
    words.slot_id(slot).store(sequence);
    words.order(sequence).store(abi::pack_entry(sequence, slot));
    words.counter(offsetof(abi::PublisherEndpoint, published_bytes)).store(++published * 1000);
    words.head().store(abi::pack_entry(sequence, slot));
    ::usleep(1000);
  };
  // Counts those that come after its first look, and before its last one.
  for (const char* const verb : {"hz", "bw"}) {
    Beside measures(daemon_, {"topic", verb, "points", "-w", "400"});
    const auto has = [&](std::uint64_t count) {
      const auto report = measures.last();
      return report.is_object() && report["topics"][0]["messages"] == count;
    };
    ASSERT_TRUE(eventually([&] { return has(0); }));
    for (int i = 0; i < 399; ++i) publish();
    ASSERT_TRUE(eventually([&] { return has(399); })) << measures.last();
    publish();  // a look that read the size before it and the message after it misses one size
    ASSERT_TRUE(eventually([&] { return has(400); })) << measures.last();
    const auto report = measures.last();
    EXPECT_EQ(report["schema"], "agnocast.topic-" + std::string(verb) + "/1");
    const auto& topic = report["topics"][0];
    EXPECT_EQ(topic["window"], 400);
    EXPECT_NEAR(topic["rate_hz"].get<double>(), 200, 0.001) << "by the stamps";
    EXPECT_NEAR(topic["message_mean_bytes"].get<double>(), 1000, 4);
    EXPECT_NEAR(topic["bytes_per_second"].get<double>(), 200'000, 800);
    EXPECT_EQ(measures.interrupt(), 0);
    for (const auto& each : measures.objects()) judge_json(each.dump());
  }
  // As text, of what comes within one second.
  std::atomic<bool> over{false};
  std::thread publishing([&] {
    while (!over) publish();
  });
  const auto text_with = [&](Words words_of_ctl, const std::string& part) {
    std::string text;
    EXPECT_TRUE(soon([&] {
      text = ctl(words_of_ctl).out;
      return text.find(part) != std::string::npos;
    })) << text;
    return text;
  };
  EXPECT_THAT(text_with({"topic", "hz", "points", "-n", "1"}, "average"),
              ContainsRegex("^average rate: 200\\.000\n\tmin: 0\\.005s max: 0\\.005s std dev: "
                            "0\\.00000s window: [0-9]+\n$"));
  EXPECT_THAT(text_with({"topic", "bw", "points", "-n", "1"}, " from 100 messages"),
              ContainsRegex("^[0-9.]+ [KM]?B/s from 100 messages\n\tMessage size mean: [0-9.]+ "
                            "K?B min: [0-9.]+ K?B max: [0-9.]+ [KM]?B\n$"));
  EXPECT_THAT(
      text_with({"topic", "hz", "points", "points", "-n", "1"}, "/points"),
      ContainsRegex("^topic +rate +min_delta +max_delta +stddev +window\n/points +200\\.000 +"));
  over = true;
  publishing.join();
  EXPECT_EQ(ctl({"topic", "hz", "/none"}).status, 4);
}

TEST_F(CtlLook, ShowsEventsAsTheyHappen) {
  Node a(daemon_.socket_path());
  a.open_window();
  const auto p = a.publisher("/points", {7}, "/lidar");
  const auto s = a.subscription("/points", {5}, "/viewer");
  a.link(s, p, 0, 0);
  Beside monitor(daemon_, {"monitor"});
  const auto has = [&](const char* key, const char* value) {
    const auto all = monitor.objects();
    return std::any_of(all.begin(), all.end(), [&](const auto& event) {
      return !event.is_discarded() && event.contains(key) && event[key] == value;
    });
  };
  // The monitor has started when it prints an event.
  int number = 0;
  ASSERT_TRUE(eventually([&] {
    a.publisher("/t" + std::to_string(number++));
    return has("event", "journal");
  }));
  const region::SubscriptionWords<SharedMemory> counters{a.region.base(), s.extent};
  counters.counter(offsetof(abi::SubscriptionCounters, lost)).store(3);
  auto other = WireClient::endpoint("/points", {1}, "other/msg/Type");
  a.wire.ask(wire::Opcode::create_publisher, other);
  EXPECT_TRUE(eventually([&] { return has("event", "lost"); }));
  EXPECT_TRUE(eventually([&] { return has("event", "refused"); }));
  EXPECT_EQ(monitor.interrupt(), 0) << "Ctrl-C ends it";
  for (const auto& event : monitor.objects()) {
    judge_json(event.dump());
    if (event["event"] != "lost") continue;
    EXPECT_EQ(event["messages"], 3);
    EXPECT_EQ(event["topic"], "/points");
    EXPECT_THAT(event["text"], HasSubstr("subscription of /points by wire_client (pid "));
  }
}

// --- all commands of the table

/// Returns arguments with which it runs, or none when it goes on for ever or changes something.
Words words_of(const ctl::Command& command) {
  Words words{std::string(command.noun)};
  if (!command.verb.empty()) words.emplace_back(command.verb);
  for (const ctl::Subject* const subject : command.subjects)
    words.emplace_back(subject == &ctl::subjects::type           ? "test/msg/Type"
                       : subject == &ctl::subjects::service      ? "/add"
                       : subject == &ctl::subjects::service_type ? "test/srv/Add"
                       : subject == &ctl::subjects::node         ? "/lidar"
                       : subject == &ctl::subjects::code         ? "hook_missing"
                       : subject == &ctl::subjects::level        ? "info"
                       : subject == &ctl::subjects::named_process ||
                               subject == &ctl::subjects::process
                           ? "wire_client"
                           : "/points");
  return words;
}
// As a node of its own: integration_ctl_topic tests these.
bool takes_part(const ctl::Command& command) {
  return command.verb == "echo" || command.verb == "pub" || command.verb == "delay" ||
         command.verb == "call";
}
bool is_one_shot(const ctl::Command& command) {
  const auto is = [&](const char* noun, const char* verb) {
    return command.noun == noun && command.verb == verb;
  };
  return !is("process", "revoke") && !is("topic", "hz") && !is("topic", "bw") &&
         !is("monitor", "") && !is("top", "");
}

TEST_F(CtlLook, EveryCommandHasHelpAndRefusesUnknownArguments) {
  for (const ctl::Command& command : ctl::all_commands) {
    const std::string name = ctl::full_name(command);
    Words words = words_of(command);
    Words help = words;
    help.emplace_back("--help");
    EXPECT_EQ(out(help), ctl::help_of(command)) << name;
    EXPECT_THAT(ctl::help_of(command),
                HasSubstr("Examples:\n  agnocast-ctl " + std::string(command.noun)));
    EXPECT_FALSE(command.description.empty()) << name;
    Words unknown = words;
    unknown.emplace_back("--no-such-option");
    const CtlResult refused = ctl(unknown);
    EXPECT_EQ(refused.status, 2) << name;
    EXPECT_THAT(refused.err,
                testing::StartsWith("agnocast-ctl: --no-such-option: unknown option\nhint: "));
    Words more = words;
    more.insert(more.end(), 9, "more");
    const bool takes_many =
        !command.subjects.empty() && command.subjects.back()->count == ctl::Subject::Count::many;
    EXPECT_TRUE(takes_many || ctl(more).status == 2) << name;
    if (!command.subjects.empty() &&
        command.subjects.front()->count != ctl::Subject::Count::optional) {
      Words less{std::string(command.noun)};
      if (!command.verb.empty()) less.emplace_back(command.verb);
      const CtlResult missing = ctl(less);
      EXPECT_EQ(missing.status, 2) << name;
      EXPECT_THAT(missing.err,
                  HasSubstr(std::string(command.subjects.front()->name) + ": is missing\n"));
    }
    for (const ctl::Option* const option : command.options) {
      if (option->kind == ctl::Option::Kind::flag) continue;
      const std::string spelling(option->names.substr(option->names.rfind(',') + 1));
      Words wrong = words;
      wrong.push_back(spelling);
      wrong.emplace_back(option->kind == ctl::Option::Kind::text ? "" : "wrong!");
      EXPECT_EQ(ctl(wrong).status, 2) << name << ' ' << spelling;
    }
    if (takes_part(command)) continue;
    Words away = words;
    away.insert(away.end(), {"--socket", "/nonexistent/socket"});
    // explain needs no daemon; for doctor the missing daemon is a finding.
    const int wanted = command.noun == "explain" ? 0 : command.noun == "doctor" ? 6 : 3;
    EXPECT_EQ(ctl(away).status, wanted) << name;
  }
}

TEST_F(CtlLook, EveryCommandLooksWithoutATrace) {
  Node a(daemon_.socket_path()), b(daemon_.socket_path());
  a.open_window();
  const auto p = a.publisher("/points", {7}, "/lidar");
  a.commit(p, 2);
  a.stamp(p, 2, second_ns, 100);
  b.subscription("/points");
  b.subscription("/_service/request/add");
  a.wire.drain();
  b.wire.drain();
  const auto before = json({"topic", "info", "/points"});
  const std::size_t descriptors = daemon_.descriptor_count();
  for (const ctl::Command& command : ctl::all_commands) {
    // integration_bridge_ctl covers the commands that ask bridges.
    if (takes_part(command) || command.noun == "bridge") continue;
    Words words = words_of(command);
    if (!is_one_shot(command)) {
      // It goes on without end, or changes something.
      if (command.verb != "hz" && command.verb != "bw" && command.noun != "top") continue;
      words.insert(words.end(), {"-n", "1"});
    }
    words.emplace_back("-j");
    const CtlResult result = ctl(words);
    EXPECT_EQ(result.status, 0) << ctl::full_name(command) << ": " << result.err;
    const auto object = result.json();
    EXPECT_THAT(object["schema"].get<std::string>(),
                testing::MatchesRegex("agnocast\\.[a-z-]+/[0-9]+"))
        << ctl::full_name(command);
  }
  EXPECT_TRUE(a.wire.drain().empty());
  EXPECT_TRUE(b.wire.drain().empty());
  EXPECT_EQ(json({"topic", "info", "/points"}), before) << "neither a match nor a counter changes";
  EXPECT_TRUE(eventually([&] { return daemon_.descriptor_count() <= descriptors; }));
  EXPECT_EQ(json({"status"})["counters"]["processes_registered"], 2);
}

}  // namespace
}  // namespace agnocast::test
