// SPDX-License-Identifier: Apache-2.0
//
// BridgeCtl: bridges, plain DDS programs and agnocast-ctl, for tests of the bridge's reports about
// itself.
#pragma once

#include <agnocast/agnocast.hpp>
#include <base/sockets/unix_address.hpp>
#include <bridge/dds/participant.hpp>
#include <bridge/program/status_socket.hpp>
#include <tests/integration/bridge/dds/dds_domain.hpp>
#include <tests/support/json_judge.hpp>
#include <tests/support/machine/temporary_directory.hpp>
#include <tests/support/processes/ctl.hpp>
#include <tests/support/processes/daemon_process.hpp>
#include <tests/support/processes/plain_node.hpp>
#include <tests/support/processes/spun.hpp>
#include <tests/support/processes/steered_process.hpp>
#include <tests/support/soon.hpp>

#include <example_interfaces/srv/add_two_ints.hpp>
#include <std_msgs/msg/string.hpp>

#include <gmock/gmock.h>

#include <sys/resource.h>

#include <chrono>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <memory>
#include <new>
#include <optional>
#include <string>
#include <thread>
#include <utility>
#include <vector>

namespace agnocast::bridge {

using namespace std::chrono_literals;
using example_interfaces::srv::AddTwoInts;
using std_msgs::msg::String;
using test::CtlResult;
using test::DaemonProcess;
using test::Domain;
using test::PlainNode;
using test::soon;
using test::SteeredProcess;
using testing::HasSubstr;
using Clock = std::chrono::steady_clock;

inline constexpr auto patience = 5min;
inline constexpr const char* string_type = "std_msgs::msg::dds_::String_";
inline constexpr const char* add_type = "example_interfaces/srv/AddTwoInts";

/// Returns the answer of one connection to the socket.
inline std::string status_of(const std::string& path) {
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
    EXPECT_TRUE(soon([&] { return !status_of(socket_of(id)).empty(); }));
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
  /// Starts a client or a server in DDS, as rmw_cyclonedds makes them.
  static std::unique_ptr<SteeredProcess> plain(const char* role) {
    return std::make_unique<SteeredProcess>(
        std::vector<std::string>{AGNOCAST_PLAIN_SERVICE, std::to_string(domain->id()), role,
                                 topic(), "7"},
        std::vector<std::string>{});
  }
  static auto serve(const PlainNode& node) {
    return create_service<AddTwoInts>(node, topic(), [](const auto& request, auto& response) {
      response->sum = request->a + request->b;
    });
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
inline Domain* BridgeCtl::domain = nullptr;
inline DaemonProcess* BridgeCtl::daemon = nullptr;

}  // namespace agnocast::bridge
