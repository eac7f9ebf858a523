// SPDX-License-Identifier: Apache-2.0
//
// Goal: a bridge says what it has and what it has not, agnocast-ctl bridge shows it, and neither is held up or misled by
// the other end of the socket. Method: the real agnocastd, agnocast-bridge and agnocast-ctl; this process has the agnocast
// endpoints and is the other participant in DDS; sockets of its own in the place of a bridge's that say something else.

#include <agnocast/agnocast.hpp>
#include <base/unix_address.hpp>
#include <bridge/dds/participant.hpp>
#include <bridge/program/status_socket.hpp>
#include <tests/integration/bridge/dds_domain.hpp>
#include <tests/support/ctl.hpp>
#include <tests/support/daemon_process.hpp>
#include <tests/support/json_judge.hpp>
#include <tests/support/plain_node.hpp>
#include <tests/support/steered_process.hpp>
#include <tests/support/temporary_directory.hpp>

#include <example_interfaces/srv/add_two_ints.hpp>
#include <std_msgs/msg/string.hpp>

#include <gmock/gmock.h>

#include <sys/resource.h>

#include <chrono>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <functional>
#include <memory>
#include <new>
#include <optional>
#include <string>
#include <thread>
#include <utility>
#include <vector>

namespace agnocast::bridge {
namespace {

using namespace std::chrono_literals;
using example_interfaces::srv::AddTwoInts;
using std_msgs::msg::String;
using test::CtlResult;
using test::DaemonProcess;
using test::Domain;
using test::PlainNode;
using test::SteeredProcess;
using testing::HasSubstr;
using Clock = std::chrono::steady_clock;

constexpr auto patience = 20s;
constexpr const char* string_type = "std_msgs::msg::dds_::String_";
constexpr const char* add_type = "example_interfaces/srv/AddTwoInts";

bool eventually(const std::function<bool()>& condition) {
  const auto end = Clock::now() + patience;
  while (!condition()) {
    if (Clock::now() > end) return false;
    std::this_thread::sleep_for(20ms);
  }
  return true;
}

/// What one connection to the socket gives.
std::string status_of(const std::string& path) {
  const UniqueFd socket(::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0));
  if (::connect(socket.get(), unix_address(path)->get(), UnixAddress::size()) != 0) return {};
  std::string text;
  char buffer[4096];
  for (ssize_t count = 0; (count = ::read(socket.get(), buffer, sizeof buffer)) > 0;)
    text.append(buffer, static_cast<std::size_t>(count));
  return text;
}

class BridgeCtl : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    domain = new Domain;
    ::setenv("ROS_DOMAIN_ID", std::to_string(domain->id()).c_str(), 1);
    daemon = new DaemonProcess;
    ::setenv("AGNOCAST_SOCKET", daemon->socket_path().c_str(), 1);
  }
  BridgeCtl() : participant_(domain->participant()) {}

  std::unique_ptr<SteeredProcess> bridge(std::uint32_t id, std::vector<std::string> more = {}) {
    std::vector<std::string> words{AGNOCAST_BRIDGE, "--domain", std::to_string(id)};
    words.insert(words.end(), more.begin(), more.end());
    auto started = std::make_unique<SteeredProcess>(words, std::vector<std::string>{});
    EXPECT_TRUE(eventually([&] { return !status_of(socket_of(id)).empty(); }));
    return started;
  }
  static std::string socket_of(std::uint32_t id) {
    const std::string daemons = daemon->socket_path();
    return daemons.substr(0, daemons.rfind('/')) + "/bridge-" + std::to_string(id) + ".sock";
  }
  static CtlResult ctl(std::vector<std::string> words) {
    words.insert(words.begin(), "bridge");
    return test::run_ctl(daemon->socket_path(), std::move(words));
  }
  static nlohmann::json route_of(const std::string& topic, const char* way) {
    const auto said = ctl({"list", "-d", "0.2", "-j"}).json();
    for (const auto& bridge : said["bridges"]) {
      for (const auto& route : bridge["routes"])
        if (route["topic"] == topic && route["direction"] == way) return route;
    }
    return nullptr;
  }
  static nlohmann::json lack_of(const std::string& topic, const char* way) {
    const auto said = ctl({"list", "-d", "0.05", "-j"}).json();
    for (const auto& bridge : said["bridges"]) {
      for (const auto& lack : bridge["unbridged"])
        if (lack["topic"] == topic && lack["direction"] == way) return lack;
    }
    return nullptr;
  }
  static nlohmann::json service_of(const std::string& name) {
    const auto said = ctl({"list", "-d", "0.05", "-j"}).json();
    for (const auto& bridge : said["bridges"]) {
      for (const auto& service : bridge["services"])
        if (service["service"] == name) return service;
    }
    return nullptr;
  }
  /// A client or a server in DDS, as rmw_cyclonedds has them.
  static std::unique_ptr<SteeredProcess> plain(const char* role) {
    return std::make_unique<SteeredProcess>(
        std::vector<std::string>{AGNOCAST_PLAIN_SERVICE, std::to_string(domain->id()), role,
                                 topic(), "7"},
        std::vector<std::string>{});
  }
  static auto serve() {
    return create_service<AddTwoInts>(
        PlainNode(), topic(),
        [](const auto& request, auto& response) { response->sum = request->a + request->b; });
  }
  std::unique_ptr<DdsReader> reads(const std::string& topic, const char* type, bool reliable) {
    DdsQos qos;
    qos.reliable = reliable;
    qos.depth = 100;
    return participant_
        ->create_reader("rt" + topic, type, qos, [](RawPieces) { return std::make_shared<int>(); })
        .value();
  }
  static std::string topic() {
    return std::string("/") + testing::UnitTest::GetInstance()->current_test_info()->name();
  }

  static Domain* domain;
  static DaemonProcess* daemon;
  std::unique_ptr<DdsParticipant> participant_;
};
Domain* BridgeCtl::domain = nullptr;
DaemonProcess* BridgeCtl::daemon = nullptr;

TEST_F(BridgeCtl, ShowsWhatGoesOutAndWhatComesIn) {
  const auto running = bridge(domain->id());
  const auto reader = reads(topic(), string_type, true);
  auto publisher = create_publisher<String>(PlainNode(), topic(), 50);
  auto subscription = create_subscription<String>(PlainNode(), topic() + "_in", 50);
  const auto writer = participant_->create_writer("rt" + topic() + "_in", string_type, {}).value();
  ASSERT_TRUE(eventually([&] { return reader->matched() == 1 && writer->matched() == 1; }));
  for (int i = 0; i < 20; ++i) {
    auto loan = publisher->borrow_loaned_message();
    loan->data = "12345";
    ASSERT_TRUE(publisher->publish(std::move(loan)));
    ASSERT_TRUE(writer->write(
        16,
        [](std::span<std::byte> room) {
          const unsigned char bytes[16] = {0, 1, 0, 0, 4, 0, 0, 0, 'a', 'b', 'c', 0};
          std::memcpy(room.data(), bytes, 12);
          return std::size_t{12};
        },
        1));
  }
  // A payload that is no string: longer than there is.
  ASSERT_TRUE(writer->write(
      8,
      [](std::span<std::byte> room) {
        const unsigned char bytes[8] = {0, 1, 0, 0, 99, 0, 0, 0};
        std::memcpy(room.data(), bytes, 8);
        return std::size_t{8};
      },
      1));
  ASSERT_TRUE(eventually([&] {
    const auto out = route_of(topic(), "out"), in = route_of(topic() + "_in", "in");
    return !out.is_null() && out["messages"] == 20 && !in.is_null() && in["malformed"] == 1;
  })) << ctl({"list", "-v"}).out;
  const auto out = route_of(topic(), "out");
  EXPECT_EQ(out["type"], "std_msgs/msg/String");
  EXPECT_EQ(out["endpoints"], 1);
  EXPECT_EQ(out["matched"], 1);
  EXPECT_EQ(out["bytes"], 20 * 14) << "encapsulation, length, letters, zero";
  EXPECT_TRUE(out["last_age_ns"].is_number());
  const auto in = route_of(topic() + "_in", "in");
  EXPECT_EQ(in["endpoints"], 1);
  EXPECT_GE(in["messages"], 1);

  const auto info = ctl({"info", topic(), "-j"}).json();
  ASSERT_EQ(info["bridges"].size(), 1u);
  const auto endpoint = info["bridges"][0]["endpoints"][0];
  EXPECT_EQ(endpoint["node"], "/ns/node");
  EXPECT_EQ(endpoint["qos"]["depth"], 50);
  EXPECT_EQ(info["bridges"][0]["domain"], domain->id());
  const std::string text = ctl({"info", topic().substr(1)}).out;
  EXPECT_THAT(text, HasSubstr("To DDS: /ns/node"));
  EXPECT_THAT(text, HasSubstr("Matched: 1 reader, 0 refused"));
  EXPECT_THAT(text, HasSubstr("Messages: 20, 280 B"));
  EXPECT_THAT(ctl({"list"}).out, HasSubstr(topic()));
  test::judge_json(status_of(socket_of(domain->id())));
}

TEST_F(BridgeCtl, SaysWhyWhatBothSidesHaveIsNotBridged) {
  const auto running = bridge(domain->id());
  auto other_type = create_publisher<String>(PlainNode(), topic() + "_type", 5);
  auto weak = create_publisher<String>(PlainNode(), topic() + "_qos", QoS(5).best_effort());
  auto alone = create_publisher<String>(PlainNode(), topic() + "_alone", 5);
  const auto reads_other = reads(topic() + "_type", "std_msgs::msg::dds_::Int32_", true);
  const auto reads_strictly = reads(topic() + "_qos", string_type, true);
  ASSERT_TRUE(eventually([&] {
    const auto type = lack_of(topic() + "_type", "out"), qos = lack_of(topic() + "_qos", "out");
    return !type.is_null() && type["why"] == "other_type" && !qos.is_null() && qos["why"] == "qos";
  })) << ctl({"list", "-v"}).out;
  EXPECT_THAT(lack_of(topic() + "_type", "out")["detail"].get<std::string>(),
              HasSubstr("std_msgs/msg/Int32"));
  EXPECT_EQ(lack_of(topic() + "_alone", "out")["why"], "no_reader");
  const std::string text = ctl({"list"}).out;
  EXPECT_THAT(text, HasSubstr("reliability or durability do not match"));
  EXPECT_THAT(text, HasSubstr("it has another type in DDS"));
  EXPECT_THAT(text, testing::Not(HasSubstr("it has no reader in DDS")));
  EXPECT_THAT(ctl({"list", "-v"}).out, HasSubstr("it has no reader in DDS"));
  EXPECT_THAT(ctl({"info", topic() + "_qos"}).out, HasSubstr("Not to DDS: reliability"));
}

TEST_F(BridgeCtl, ShowsAServiceOfThisHostThatAClientInDdsAsks) {
  const auto running = bridge(domain->id());
  const auto service = serve();
  const auto client = plain("client");
  ASSERT_TRUE(eventually([&] { return client->ask("matched") == "1 1"; }));
  for (int i = 1; i <= 3; ++i) {
    ASSERT_EQ(client->ask("ask " + std::to_string(i) + " 1 2"), "Success");
    ASSERT_TRUE(eventually([&] { return client->ask("take") != "none"; }));
  }
  // One that is cut off, and one of a client that has no ear for answers.
  const auto writer = participant_
                          ->create_writer("rq" + topic() + "Request",
                                          "example_interfaces::srv::dds_::AddTwoInts_Request_", {})
                          .value();
  const auto zeros = [](std::span<std::byte> room) {
    std::fill(room.begin(), room.end(), std::byte{0});
    room[1] = std::byte{1};
    return room.size();
  };
  ASSERT_TRUE(eventually([&] { return writer->matched() == 1; }));
  ASSERT_TRUE(writer->write(36, zeros, 1));
  ASSERT_TRUE(eventually([&] {
    const auto now = service_of(topic());
    return !now.is_null() && now["timed_out"] == 1 && now["responses"] == 3;
  })) << ctl({"list", "-v"}).out;
  const auto reader = participant_
                          ->create_reader("rr" + topic() + "Reply",
                                          "example_interfaces::srv::dds_::AddTwoInts_Response_", {},
                                          [](RawPieces) { return std::make_shared<int>(); })
                          .value();
  ASSERT_TRUE(eventually([&] {
    const auto now = service_of(topic());
    return !now.is_null() && now["matched"] == 2;
  }));
  ASSERT_TRUE(writer->write(24, zeros, 1));
  ASSERT_TRUE(eventually([&] { return service_of(topic())["malformed"] == 1; }));

  const auto now = service_of(topic());
  EXPECT_EQ(now["type"], add_type);
  EXPECT_EQ(now["direction"], "out");
  EXPECT_EQ(now["nodes"], nlohmann::json({"/ns/node"}));
  EXPECT_EQ(now["requests"], 3);
  EXPECT_EQ(now["request_bytes"], 3 * 36) << "encapsulation, id and number, two numbers";
  EXPECT_EQ(now["response_bytes"], 3 * 28);
  EXPECT_EQ(now["refused"], 0);
  EXPECT_EQ(now["forgotten"], 0);
  EXPECT_TRUE(now["last_age_ns"].is_number());
  const auto info = ctl({"info", topic(), "-j"}).json();
  EXPECT_EQ(info["bridges"][0]["services"][0]["reader_guid"], now["reader_guid"]);
  const std::string text = ctl({"info", topic().substr(1)}).out;
  EXPECT_THAT(text, HasSubstr("Service to DDS, server: /ns/node"));
  EXPECT_THAT(text, HasSubstr("Matched: 2 clients"));
  EXPECT_THAT(text, HasSubstr("Requests: 3, 108 B"));
  EXPECT_THAT(text, HasSubstr("Dropped: 1 malformed, 0 refused, 1 timed out, 0 forgotten"));
  EXPECT_THAT(ctl({"list"}).out, HasSubstr("RESPONSES"));
  EXPECT_THAT(
      test::run_ctl(daemon->socket_path(), {"--complete", "bridge", "info", topic().substr(0, 4)})
          .out,
      HasSubstr(topic()));
  test::judge_json(status_of(socket_of(domain->id())));
}

TEST_F(BridgeCtl, ShowsAServiceInDdsThatThisHostAsksAndSaysWhenThereIsNone) {
  const auto running = bridge(domain->id());
  const auto client = create_client<AddTwoInts>(PlainNode(), topic());
  ASSERT_TRUE(eventually([&] { return !lack_of(topic(), "in").is_null(); }));
  EXPECT_EQ(lack_of(topic(), "in")["kind"], "service");
  EXPECT_EQ(lack_of(topic(), "in")["why"], "no_server");
  EXPECT_THAT(ctl({"info", topic()}).out,
              HasSubstr("Service not from DDS: it has no server in DDS"));
  EXPECT_THAT(ctl({"list"}).out, testing::Not(HasSubstr(topic()))) << "that is no mistake";
  EXPECT_THAT(ctl({"list", "-v"}).out, HasSubstr(topic()));

  const auto server = plain("server");
  ASSERT_TRUE(client->wait_for_service(patience));
  auto request = client->borrow_loaned_request();
  request->a = 1;
  auto answer = client->async_send_request(std::move(request));
  std::string asked;
  ASSERT_TRUE(eventually([&] { return (asked = server->ask("next")) != "none"; }));
  const std::string head = asked.substr(0, asked.find(' ', asked.find(' ') + 1));
  ASSERT_EQ(server->ask("answer " + head + " 1"), "Success");
  ASSERT_EQ(answer.wait_for(patience), std::future_status::ready);
  ASSERT_TRUE(eventually([&] {
    const auto now = service_of(topic());
    return !now.is_null() && now["responses"] == 1;
  }));
  const auto now = service_of(topic());
  EXPECT_EQ(now["direction"], "in");
  EXPECT_EQ(now["matched"], 1);
  EXPECT_EQ(now["requests"], 1);
  EXPECT_EQ(now["request_bytes"], 36);
  EXPECT_EQ(now["response_bytes"], 28);
  EXPECT_TRUE(lack_of(topic(), "in").is_null());
  const std::string text = ctl({"info", topic()}).out;
  EXPECT_THAT(text, HasSubstr("Service from DDS, client: /ns/node"));
  EXPECT_THAT(text, HasSubstr("Matched: 1 server"));
  test::judge_json(status_of(socket_of(domain->id())));
}

TEST_F(BridgeCtl, ShowsTheHistoryAndTheNodesThatEndpointsHaveNow) {
  const auto running = bridge(domain->id());
  DdsQos keep_all;
  keep_all.keep_all = true;
  const auto writer = participant_->create_writer("rt" + topic(), string_type, keep_all).value();
  auto first = create_subscription<String>(PlainNode(), topic(), QoS(5).keep_all());
  const auto bridges = [&] {
    const CtlResult said = ctl({"info", topic(), "-j"});
    return said.status == 0 ? said.json()["bridges"] : nlohmann::json::array();
  };
  const auto nodes = [&] {
    const auto all = bridges();
    return all.empty() || all[0]["inlets"].empty() ? nlohmann::json()
                                                   : all[0]["inlets"][0]["nodes"];
  };
  ASSERT_TRUE(eventually([&] {
    const auto all = bridges();
    return !all.empty() && all[0]["endpoints"].size() == 1 && all[0]["inlets"].size() == 1;
  }));
  const auto now = bridges()[0];
  EXPECT_EQ(now["endpoints"][0]["qos"]["history"], "keep_all");
  EXPECT_EQ(now["inlets"][0]["qos"]["history"], "keep_all");
  EXPECT_EQ(now["inlets"][0]["nodes"], nlohmann::json({"/ns/node"}));
  Node other("other", "/ns");
  auto second = create_subscription<String>(other, topic(), QoS(5).keep_all());
  EXPECT_TRUE(eventually([&] {
    return nodes() == nlohmann::json({"/ns/node", "/ns/other"});
  })) << nodes();
  first.reset();
  EXPECT_TRUE(eventually([&] { return nodes() == nlohmann::json({"/ns/other"}); })) << nodes();
  EXPECT_EQ(bridges()[0]["inlets"][0]["guid"], now["inlets"][0]["guid"]) << "it is the same one";
}

TEST_F(BridgeCtl, ShowsTheBridgesOfAllDomainsAndSaysWhenThereIsNone) {
  const CtlResult none = ctl({"list"});
  EXPECT_EQ(none.status, 3);
  EXPECT_THAT(none.err, HasSubstr("\nhint: agnocast-bridge --socket " + daemon->socket_path()));
  const Domain second;
  const auto one = bridge(domain->id()), two = bridge(second.id());
  EXPECT_EQ(ctl({"list", "-j"}).json()["bridges"].size(), 2u);
  const auto of_second = ctl({"list", "--domain", std::to_string(second.id()), "-j"}).json();
  ASSERT_EQ(of_second["bridges"].size(), 1u);
  EXPECT_EQ(of_second["bridges"][0]["domain"], second.id());
  EXPECT_EQ(ctl({"list", "--domain", "200"}).status, 3);
  EXPECT_EQ(ctl({"info", "/nowhere"}).status, 4);
}

TEST_F(BridgeCtl, RulesDecideWhatThereIsInDdsAndMayChange) {
  const test::TemporaryDirectory directory;
  const std::string file = directory.path() + "/bridge.toml";
  std::ofstream(file)
      << "default = \"none\"\n"
         "[[topic]]\nname = \"" +
             topic() +
             "\"\ntype = \"std_msgs/msg/String\"\n"
             "always = true\nto_dds = { reliability = \"best_effort\", depth = 3 }\n"
             "from_dds = { durability = \"transient_local\" }\n";
  const auto running = bridge(domain->id(), {"--config", file});
  auto publisher = create_publisher<String>(PlainNode(), topic(), 50);
  auto other = create_publisher<String>(PlainNode(), topic() + "_other", 50);
  const auto reads_other = reads(topic() + "_other", string_type, false);
  const auto in_dds = [&](Remote::Kind kind) -> std::optional<DdsQos> {
    (void)participant_->discovered();
    for (const auto& [guid, remote] : participant_->remotes())
      if (remote.topic == "rt" + topic() && remote.kind == kind) return remote.qos;
    return std::nullopt;
  };
  ASSERT_TRUE(eventually([&] {
    return in_dds(Remote::Kind::writer).has_value() && in_dds(Remote::Kind::reader).has_value();
  })) << "nobody is on the other side, of the reader on neither";
  EXPECT_FALSE(in_dds(Remote::Kind::writer)->reliable);
  EXPECT_TRUE(in_dds(Remote::Kind::reader)->transient_local);
  // An answer may be a few milliseconds old.
  EXPECT_TRUE(eventually([&] {
    const CtlResult said = ctl({"info", topic(), "-j"});
    if (said.status != 0) return false;
    const auto endpoints = said.json()["bridges"][0]["endpoints"];
    return endpoints.size() == 1 && endpoints[0]["qos"]["depth"] == 3;
  }));
  EXPECT_EQ(lack_of(topic() + "_other", "out")["why"], "rule");

  std::ofstream(file) << "[[topic]]\nname = \"" + topic() +
                             "\"\nalways = true\n"
                             "direction = \"out\"\nto_dds = { reliability = \"reliable\" }\n";
  ASSERT_EQ(::kill(running->pid(), SIGHUP), 0);
  EXPECT_TRUE(eventually([&] {
    const auto writer = in_dds(Remote::Kind::writer);
    return writer && writer->reliable && !in_dds(Remote::Kind::reader);
  }));
  EXPECT_TRUE(eventually([&] { return reads_other->matched() == 1; }))
      << "no rule speaks of it now";
}

TEST_F(BridgeCtl, IsOneOfADomainAndReplacesADeadOne) {
  auto running = bridge(domain->id());
  SteeredProcess second({AGNOCAST_BRIDGE, "--domain", std::to_string(domain->id())}, {});
  EXPECT_EQ(second.finish(), 1);
  running.reset();  // SIGKILL: the socket stays
  EXPECT_EQ(ctl({"list"}).status, 3) << "nobody listens at what is left";
  running = bridge(domain->id());
  EXPECT_EQ(ctl({"list"}).status, 0);
}

TEST_F(BridgeCtl, ABridgeIsNotHeldUpByWhoDoesNotReadAndSleepsWhenNobodyComes) {
  const auto running = bridge(domain->id());
  std::vector<UniqueFd> idle;
  for (int i = 0; i < 100; ++i) {
    idle.emplace_back(::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0));
    ASSERT_EQ(::connect(idle.back().get(), unix_address(socket_of(domain->id()))->get(),
                        UnixAddress::size()),
              0);
  }
  EXPECT_EQ(ctl({"list", "-d", "0.1"}).status, 0);
  idle.clear();
  const auto pid = ctl({"list", "-d", "0.1", "-j"}).json()["bridges"][0]["pid"].get<int>();
  const auto wakes = [&] {
    std::ifstream status("/proc/" + std::to_string(pid) + "/status");
    for (std::string line; std::getline(status, line);) {
      if (line.starts_with("voluntary_ctxt_switches:")) return std::stol(line.substr(24));
    }
    return -1L;
  };
  // What DDS tells of the others of this machine may still come.
  EXPECT_TRUE(eventually([&] {
    const long before = wakes();
    std::this_thread::sleep_for(2s);
    return before >= 0 && wakes() - before <= 2;
  }));
}

TEST_F(BridgeCtl, WhoNeverReadsGivesUpItsPlaceToWhoDoes) {
  // More than a socket's buffer takes of it.
  const std::string text(8 << 20, 'x');
  const std::string path = socket_of(102);
  auto socket = StatusSocket::take(path);
  ASSERT_TRUE(socket) << socket.error().why;
  ASSERT_TRUE((*socket)->listen([&] { return text; }));
  std::vector<UniqueFd> silent;
  for (int i = 0; i < 50; ++i) {
    silent.emplace_back(::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0));
    ASSERT_EQ(::connect(silent.back().get(), unix_address(path)->get(), UnixAddress::size()), 0);
  }
  const auto began = Clock::now();
  EXPECT_EQ(status_of(path).size(), text.size());
  EXPECT_LT(Clock::now() - began, 5s) << "that is when silent ones are dropped anyway";
}

TEST_F(BridgeCtl, WithoutMemoryTheStatusIsNotSaidOnceAndThenItIs) {
  const std::string path = socket_of(104);
  auto socket = StatusSocket::take(path);
  ASSERT_TRUE(socket) << socket.error().why;
  ASSERT_TRUE((*socket)->listen([has_memory = false]() mutable {
    if (!std::exchange(has_memory, true)) throw std::bad_alloc();
    return std::string("here");
  }));
  EXPECT_EQ(status_of(path), "");
  EXPECT_EQ(status_of(path), "here");
}

TEST_F(BridgeCtl, ABridgeWithoutDescriptorsSleepsUntilItHasSome) {
  const auto running = bridge(domain->id());
  const std::string process = "/proc/" + std::to_string(running->pid());
  rlimit before{};
  ASSERT_EQ(::prlimit(running->pid(), RLIMIT_NOFILE, nullptr, &before), 0);
  const rlimit none{3, before.rlim_max};
  ASSERT_EQ(::prlimit(running->pid(), RLIMIT_NOFILE, &none, nullptr), 0);
  const UniqueFd client(::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0));
  ASSERT_EQ(
      ::connect(client.get(), unix_address(socket_of(domain->id()))->get(), UnixAddress::size()),
      0);
  const auto used_ns = [&] {
    std::uint64_t sum = 0;
    for (const auto& task : std::filesystem::directory_iterator(process + "/task")) {
      std::uint64_t own = 0;
      std::ifstream(task.path() / "schedstat") >> own;
      sum += own;
    }
    return sum;
  };
  // A thread that turns without end takes seconds of these.
  const std::uint64_t at_first = used_ns();
  std::this_thread::sleep_for(3s);
  EXPECT_LT(used_ns() - at_first, 300'000'000u);
  ASSERT_EQ(::prlimit(running->pid(), RLIMIT_NOFILE, &before, nullptr), 0);
  char first = 0;
  EXPECT_EQ(::read(client.get(), &first, 1), 1) << "it has waited";
}

TEST_F(BridgeCtl, SaysWhichBridgeStandsByAndWhatItHasLost) {
  const std::string path = socket_of(103);
  auto socket = StatusSocket::take(path);
  ASSERT_TRUE(socket) << socket.error().why;
  ASSERT_TRUE((*socket)->listen([] {
    return std::string(
        R"({"schema":"agnocast.bridge-status/1","version":"1","pid":12,"domain":7,"uptime_ns":1,)"
        R"("discovery_info":"iron","participants":0,"has_daemon":true,"standby_for":11,)"
        R"("announced":6,"lost_early":3,"discovery_info_refused":4,)"
        R"("limits":[{"limit":"endpoints","most":9,"refused":7},{"limit":"x","most":1,"refused":0}],)"
        R"("outlets":[],"sources":[],)"
        R"("taps":[{"topic":"/t","type":"p/msg/T","lost":5,"qos":{"reliability":"reliable",)"
        R"("durability":"volatile","history":"keep_last","depth":2}}],)"
        R"("inlets":[{"topic":"/i","type":"p/msg/T","nodes":[],"guid":"0","qos":{)"
        R"("reliability":"reliable","durability":"volatile","history":"keep_last","depth":2},)"
        R"("matched":0,"incompatible":0,"malformed":0,"without_source":0,"overflow":8}],)"
        R"("services":[],"unbridged":[],"failures":[]})");
  }));
  const std::string text = ctl({"list", "-d", "0.05"}).out;
  EXPECT_THAT(text, HasSubstr("the bridge of domain 7 (pid 12) is on standby for pid 11"));
  EXPECT_THAT(text, HasSubstr("has lost 3 messages of publishers"));
  const auto said = ctl({"list", "-d", "0.05", "-j"}).json()["bridges"][0];
  EXPECT_EQ(said["standby_for"], 11);
  EXPECT_EQ(said["lost_early"], 3);
  EXPECT_THAT(text, HasSubstr("has refused 4 messages about nodes in DDS"));
  EXPECT_EQ(said["discovery_info_refused"], 4);
  EXPECT_THAT(text, HasSubstr("announces 6 publishers in DDS without a reader there"));
  EXPECT_EQ(said["announced"], 6);
  EXPECT_THAT(text, HasSubstr("has refused 7 beyond the limit endpoints (9)"));
  EXPECT_THAT(text, testing::Not(HasSubstr("limit x")));
  EXPECT_EQ(said["limits"].size(), 2u);
  ASSERT_EQ(said["routes"].size(), 2u);
  EXPECT_EQ(said["routes"][0]["topic"], "/i");
  EXPECT_EQ(said["routes"][0]["overflow"], 8);
  EXPECT_THAT(text, HasSubstr("/i")) << "a route that only drops is shown";
  const auto inlet = ctl({"info", "/i", "-j"}).json()["bridges"][0]["inlets"][0];
  EXPECT_EQ(inlet["overflow"], 8);
  EXPECT_THAT(
      ctl({"info", "/i"}).out,
      HasSubstr("Dropped: 0 malformed, 0 of writers without a publisher here, 8 over a limit"));
  EXPECT_EQ(said["routes"][1]["lost"], 5);
  EXPECT_THAT(ctl({"info", "/t"}).out,
              HasSubstr("Lost on the way to DDS: 5 messages (reliable, volatile, keep_last 2)"));
}

TEST_F(BridgeCtl, RefusesWhatNoBridgeSays) {
  const std::string path = socket_of(101);
  const auto says = [&](const std::string& text, bool ends) {
    ::unlink(path.c_str());
    const UniqueFd listener(::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0));
    EXPECT_EQ(::bind(listener.get(), unix_address(path)->get(), UnixAddress::size()), 0);
    EXPECT_EQ(::listen(listener.get(), 1), 0);
    std::thread server([&] {
      const UniqueFd client(::accept4(listener.get(), nullptr, nullptr, SOCK_CLOEXEC));
      for (std::size_t at = 0; at < text.size();) {
        const ssize_t sent = ::send(client.get(), text.data() + at, text.size() - at, MSG_NOSIGNAL);
        if (sent <= 0) break;
        at += static_cast<std::size_t>(sent);
      }
      char end = 0;
      if (!ends) (void)!::read(client.get(), &end, 1);  // until it gives up
    });
    const CtlResult result = ctl({"list", "-j"});
    server.join();
    ::unlink(path.c_str());
    EXPECT_THAT(result.out, "") << text.substr(0, 80);
    return result.status;
  };
  const std::string right =
      R"({"schema":"agnocast.bridge-status/1","version":"1","pid":1,"domain":1,"uptime_ns":1,)"
      R"("discovery_info":"iron","participants":0,"has_daemon":true,"outlets":[],"sources":[],)"
      R"("taps":[],"inlets":[],"services":[],"unbridged":[],"failures":[)";
  for (const std::string& lie :
       {std::string("hello"), std::string("[]"), std::string("{\"schema\":1}"),
        std::string(200'000, '['), right + "{\"what\":1,\"why\":\"\"}]}",
        right + "{\"what\":\"" + std::string(5000, 'x') + "\",\"why\":\"\"}]}",
        std::string(right).replace(right.find("\"pid\":1"), 7, "\"pid\":-1") + "]}",
        std::string(right).replace(right.find("\"domain\":1"), 10, "\"domain\":999") + "]}",
        right + "]", std::string(20 << 20, ' ')})
    EXPECT_EQ(says(lie, true), 1) << lie.substr(0, 300);
  EXPECT_EQ(says("", true), 124) << "busy";
  EXPECT_EQ(says("{", false), 124) << "never ends";
}

}  // namespace
}  // namespace agnocast::bridge
