// SPDX-License-Identifier: Apache-2.0
//
// Goal: the screens in docs/screens.md equal the output of agnocast-ctl. Method: the system that
// the document describes, made of raw clients in processes of their own; every block whose first
// line is a command is run again and compared, without numbers. AGNOCAST_RECORD=1 rewrites them.

#include <tests/support/machine/doctored.hpp>
#include <tests/support/node_process.hpp>

#include <gmock/gmock.h>

#include <cstddef>
#include <cstdlib>
#include <fstream>
#include <iterator>
#include <regex>
#include <sstream>
#include <string>
#include <vector>

namespace agnocast::test {
namespace {

using Node = CtlNode;
constexpr std::uint64_t second_ns = 1'000'000'000;
constexpr const char* cloud = "sensor_msgs/msg/PointCloud2";
constexpr const char* image = "sensor_msgs/msg/Image";

/// Removes the parts that vary: numbers, the units of times and rates, and the widths of columns.
std::string shape_of(std::string text) {
  for (const auto& [pattern, with] :
       {std::pair("([0-9a-f]{2}\\.){15}[0-9a-f]{2}", "GID"), std::pair("0x[0-9a-f]+", "#"),
        std::pair("[0-9]+(\\.[0-9]+)?", "#"), std::pair("# (ns|us|ms|s|min|h)\\b", "# t"),
        std::pair("under # t", "# t"), std::pair("# [KMG]?i?B/s", "# B/s"), std::pair(" +", " "),
        std::pair(" +\n", "\n")})
    text = std::regex_replace(text, std::regex(pattern), with);
  return text;
}

// Long because it builds the one system that all screens show.
TEST(Screens, EqualTheOutput) {
  if (!Doctored::has_namespaces()) GTEST_SKIP() << "needs root: a mount namespace";
  const DaemonProcess daemon({.config = "", .more_config = ""});
  const std::string& socket = daemon.socket_path();
  Doctored shell(socket);

  wire::EndpointCreated points{};
  int ends[2];
  ASSERT_EQ(::pipe2(ends, O_CLOEXEC), 0);
  const NodeProcess lidar(
      socket,
      [&](Node& node) {
        node.open_window();
        const auto made = node.publisher("/lidar/points", {10}, "/lidar/driver", cloud);
        node.commit(made, 12);
        node.stamp(made, 12, second_ns / 2, 693'760);
        EXPECT_EQ(::write(ends[1], &made, sizeof made), ssize_t{sizeof made});
      },
      "lidar_driver");
  ASSERT_EQ(::read(ends[0], &points, sizeof points), ssize_t{sizeof points});
  const NodeProcess camera(
      socket,
      [&](Node& node) {
        node.open_window();
        const auto made = node.publisher("/camera/image", {5}, "/camera", image);
        node.commit(made, 4);
        node.stamp(made, 4, second_ns, 6'220'800);
        const region::PublisherWords<SharedMemory> words{node.region.base(), made.extent};
        words.counter(offsetof(abi::PublisherEndpoint, adopted_messages)).store(4);
        words.counter(offsetof(abi::PublisherEndpoint, adopted_bytes)).store(4 * 6'220'800);
        EXPECT_EQ(::write(ends[1], &made, sizeof made), ssize_t{sizeof made});
      },
      "camera");
  wire::EndpointCreated frames{};
  ASSERT_EQ(::read(ends[0], &frames, sizeof frames), ssize_t{sizeof frames});
  ::close(ends[0]);
  ::close(ends[1]);
  const NodeProcess perception(
      socket,
      [&](Node& node) {
        const auto own = node.subscription("/lidar/points", {10}, "/perception", cloud);
        node.link(own, points, 11, 2);
        const auto seen = node.subscription("/camera/image", {5}, "/perception", image);
        node.link(seen, frames, 4, 1);
      },
      "perception");
  const NodeProcess viewer(
      socket,
      [&](Node& node) {
        node.link(node.subscription("/lidar/points", {10}, "/viewer", cloud), points, 3, 1);
      },
      "viewer");
  const NodeProcess wrong(
      socket,
      [](Node& node) {
        auto body = WireClient::endpoint("/lidar/points", {10}, "my_msgs/msg/Points");
        body.node = wire_name("/old_viewer");
        node.wire.ask(wire::Opcode::create_publisher, body);
      },
      "old_viewer");

  const bool record = std::getenv("AGNOCAST_RECORD") != nullptr;
  std::ifstream file(AGNOCAST_TEST_SCREENS);
  std::string recorded;
  std::size_t count = 0;
  for (std::string line; std::getline(file, line);) {
    recorded += line + '\n';
    const bool is_diagram = line.starts_with("%% agnocast-ctl ");
    if (!is_diagram && !line.starts_with("$ agnocast-ctl ")) continue;
    ++count;
    std::vector<std::string> words;
    std::istringstream rest(line.substr(line.find("agnocast-ctl ") + 13));
    for (std::string word; rest >> word;) words.push_back(word);
    const CtlResult result = shell.run(words, {"COLUMNS=110"});
    std::string shown = result.out + result.err, written, next;
    for (const std::string place = daemon.directory() + "/run";
         shown.find(place) != std::string::npos;)
      shown.replace(shown.find(place), place.size(), "/run/agnocast");
    // The camera's command line is replaced by this program's.
    shown =
        std::regex_replace(shown, std::regex("(agnocast-run --scope all ).* &"), "$1./camera &");
    while (std::getline(file, next) && next != "```") written += next + '\n';
    recorded += shown + "```\n";
    if (record) continue;
    EXPECT_EQ(shape_of(written), shape_of(shown))
        << line << "if this is intended: AGNOCAST_RECORD=1 ctest -R integration_doctor";
  }
  EXPECT_EQ(count, 4U);
  if (record) std::ofstream(AGNOCAST_TEST_SCREENS) << recorded;
}

}  // namespace
}  // namespace agnocast::test
