// SPDX-License-Identifier: Apache-2.0
//
// Goal: DDS finds 500 topics that only this host has, and the bridge subscribes to none of them.
// Method: as many publishers, a bridge that announces and one that does not; the test prints the
// cost of each and asserts none. In a network of its own the traffic is that of discovery alone:
//
//   unshare -n sh -c 'ip link set lo up; integration_bridge --gtest_filter=AnnounceMany.*'

#include <tests/integration/bridge/routes/bridge_side.hpp>
#include <tests/support/processes/plain_node.hpp>

#include <agnocast/agnocast.hpp>

#include <std_msgs/msg/string.hpp>

#include <unistd.h>

#include <algorithm>
#include <fstream>
#include <sstream>

namespace agnocast::test {
namespace {

using std_msgs::msg::String;
constexpr std::size_t topics = 500;

class AnnounceMany : public BridgeTest {
 protected:
  void SetUp() override {}
  std::string proc(const char* file) const {
    std::ostringstream text;
    text << std::ifstream("/proc/" + std::to_string(bridge_->pid()) + '/' + file).rdbuf();
    return text.str();
  }
  /// Returns the private memory of the bridge; its shared memory belongs to the regions.
  std::size_t private_kib() const {
    const std::string text = proc("status");
    const std::size_t at = text.find("RssAnon:");
    return at == text.npos ? 0 : std::stoul(text.substr(at + 8));
  }
  double cpu_ms() const {
    const std::string text = proc("stat");
    if (text.rfind(')') == text.npos) return 0;
    std::istringstream words(text.substr(text.rfind(')') + 2));
    std::string word;
    for (int i = 0; i < 11; ++i) words >> word;
    double user = 0, system = 0;
    words >> user >> system;
    return (user + system) * 1000 / static_cast<double>(::sysconf(_SC_CLK_TCK));
  }
  /// Returns all bytes that this network's loopback device has carried.
  static std::size_t loopback_bytes() {
    std::ifstream file("/proc/net/dev");
    for (std::string line; std::getline(file, line);) {
      const std::size_t at = line.find("lo:");
      if (at != line.npos) return std::stoul(line.substr(at + 3));
    }
    return 0;
  }
  std::size_t known() {
    other_.look(std::chrono::milliseconds(1));
    std::size_t count = 0;
    for (const auto& [guid, remote] : other_.participant().remotes())
      count += remote.kind == Remote::Kind::writer && remote.topic.starts_with(dds_topic() + "_");
    return count;
  }
};

TEST_F(AnnounceMany, TopicsAreFoundAndNothingIsSubscribedTo) {
  std::vector<Publisher<String>::SharedPtr> publishers;
  for (std::size_t i = 0; i < topics; ++i)
    publishers.push_back(
        create_publisher<String>(PlainNode(), topic() + '_' + std::to_string(i), QoS(1)));
  for (const bool announce : {false, true}) {
    const std::string file = daemon->directory() + "/many.toml";
    std::ofstream(file) << "announce = " << (announce ? "true" : "false") << '\n';
    const std::size_t bytes_before = loopback_bytes();
    const auto begin = std::chrono::steady_clock::now();
    start_bridge({"--config", file});
    if (announce) {
      ASSERT_TRUE(other_.eventually([&] { return known() == topics; })) << known();
    } else {
      ASSERT_TRUE(other_.eventually([&] { return said(" ready ") > 0; }));
    }
    const auto took = std::chrono::duration_cast<std::chrono::milliseconds>(
        std::chrono::steady_clock::now() - begin);
    std::this_thread::sleep_for(std::chrono::seconds(1));
    const std::size_t bytes = loopback_bytes() - bytes_before;
    const double used = cpu_ms();
    std::this_thread::sleep_for(std::chrono::seconds(10));
    std::cout << "announce = " << (announce ? "true" : "false") << ": " << took.count()
              << " ms until all are known, " << private_kib() << " KiB private memory, " << used
              << " ms of the processor, " << bytes / 1024 << " KiB over lo; in the 10 s after that "
              << cpu_ms() - used << " ms, " << (loopback_bytes() - bytes_before - bytes) / 1024
              << " KiB\n";
    EXPECT_EQ(known(), announce ? topics : 0u);
    for (const auto& publisher : publishers)
      EXPECT_EQ(publisher->get_linked_subscription_count(), 0u);
    bridge_.reset();
    other_.forget();
  }
}

}  // namespace
}  // namespace agnocast::test
