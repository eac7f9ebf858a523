// SPDX-License-Identifier: Apache-2.0
//
// Goal: endpoints that come and go leave nothing behind in the bridge, and an idle bridge does
// nothing. Method: the real bridge, observed in /proc.

#include <tests/integration/bridge/routes/bridge_side.hpp>
#include <tests/support/processes/held.hpp>
#include <tests/support/processes/plain_node.hpp>

#include <std_msgs/msg/string.hpp>

#include <gmock/gmock.h>

#include <chrono>
#include <filesystem>
#include <fstream>
#include <set>
#include <thread>

namespace agnocast::test {
namespace {

using namespace std::chrono_literals;
using std_msgs::msg::String;

class Flat : public BridgeTest {
 protected:
  std::string name(const char* way, std::size_t i) const {
    return topic() + "/" + way + std::to_string(i);
  }
  /// Returns the bridge's endpoints on this test's topics.
  std::size_t count(Remote::Kind kind) {
    std::size_t found = 0;
    for (const auto& [guid, remote] : other_.participant().remotes())
      found += remote.kind == kind && remote.topic.starts_with(dds_topic());
    return found;
  }
};

TEST_F(Flat, TenThousandEndpointsOfBothSidesComeAndGoAndLeaveNothing) {
  static constexpr std::size_t topics = 40, of_each = 12, rounds = 11, warm_rounds = 3;
  static_assert(topics * of_each * 2 * rounds >= 10'000);
  const auto staying = create_subscription<String>(PlainNode(), topic() + "/staying", 5);
  const auto one_round = [&] {
    std::vector<Publisher<String>::SharedPtr> publishers;
    std::vector<Subscription<String>::SharedPtr> subscriptions;
    for (std::size_t i = 0; i < topics; ++i) {
      publishers.push_back(create_publisher<String>(PlainNode(), name("out", i), 5));
      subscriptions.push_back(create_subscription<String>(PlainNode(), name("in", i), 5));
      for (std::size_t n = 0; n < of_each; ++n) {
        other_.reads<String>("rt" + name("out", i), {});
        other_.writes("rt" + name("in", i), dds_type_name<String>(), {});
      }
    }
    ASSERT_TRUE(other_.eventually([&] {
      return count(Remote::Kind::writer) == topics && count(Remote::Kind::reader) == topics + 1;
    }));
    // Every route exists on this side as well.
    ASSERT_TRUE(other_.eventually([&] {
      return std::all_of(
                 publishers.begin(), publishers.end(),
                 [](const auto& one) { return one->get_linked_subscription_count() == 1; }) &&
             std::all_of(subscriptions.begin(), subscriptions.end(), [](const auto& one) {
               return one->get_linked_publisher_count() == of_each;
             });
    }));
    other_.forget();
    // No messages flow any more; publishers stay announced as long as they exist.
    ASSERT_TRUE(other_.eventually([&] {
      return std::all_of(publishers.begin(), publishers.end(),
                         [](const auto& one) { return one->get_linked_subscription_count() == 0; });
    }));
    publishers.clear();
    subscriptions.clear();
    ASSERT_TRUE(other_.eventually(
        [&] { return count(Remote::Kind::writer) == 0 && count(Remote::Kind::reader) == 1; }));
  };
  for (std::size_t i = 0; i < warm_rounds; ++i) one_round();
  const Held before = held_by(bridge_->pid());
  // 7,680 leaked endpoints would exceed 30 MB each time. A peak, when a loaded machine let many
  // endpoints come at once, is there once and for all.
  std::vector<std::size_t> own_kib = {before.anonymous_kib};
  const auto is_flat = [&] {
    return own_kib.size() > 1 && own_kib.back() < *(own_kib.end() - 2) + 8 * 1024;
  };
  while (!is_flat() && own_kib.size() <= 4) {
    for (std::size_t i = warm_rounds; i < rounds; ++i) {
      one_round();
      if (HasFatalFailure()) return;
    }
    own_kib.push_back(held_by(bridge_->pid()).anonymous_kib);
  }
  EXPECT_TRUE(is_flat()) << testing::PrintToString(own_kib)
                         << " KiB are its own, one after the other";
  Held after;
  EXPECT_TRUE(other_.eventually([&] {
    after = held_by(bridge_->pid());
    return after.descriptors <= before.descriptors && after.threads <= before.threads;
  })) << after.descriptors
      << " descriptors, before " << before.descriptors << "; " << after.threads
      << " threads, before " << before.threads;
}

/// Returns how often each thread but Cyclone DDS's slept, and so woke; by name and id.
std::map<std::string, std::uint64_t> switches_of(pid_t pid) {
  static const std::set<std::string> of_cyclone = {"gc",     "tev",     "recv",        "recvMC",
                                                   "recvUC", "dq.user", "dq.builtins", "xmit.user"};
  std::map<std::string, std::uint64_t> counts;
  for (const auto& task :
       std::filesystem::directory_iterator("/proc/" + std::to_string(pid) + "/task")) {
    std::ifstream comm(task.path() / "comm"), status(task.path() / "status");
    std::string name;
    std::getline(comm, name);
    if (of_cyclone.contains(name)) continue;
    for (std::string line; std::getline(status, line);)
      if (line.starts_with("voluntary_ctxt_switches:"))
        counts[name + " " + task.path().filename().string()] = std::stoull(line.substr(24));
  }
  return counts;
}

TEST_F(Flat, WithoutMessagesTheBridgeSleepsAndTheLibrarysThreadsWakeOnceASecond) {
  constexpr std::size_t each_way = 50;
  std::vector<Publisher<String>::SharedPtr> publishers;
  std::vector<Subscription<String>::SharedPtr> subscriptions;
  for (std::size_t i = 0; i < each_way; ++i) {
    other_.reads<String>("rt" + name("out", i), {});
    other_.writes("rt" + name("in", i), dds_type_name<String>(), {});
    publishers.push_back(create_publisher<String>(PlainNode(), name("out", i), 5));
    subscriptions.push_back(create_subscription<String>(PlainNode(), name("in", i), 5));
  }
  ASSERT_TRUE(other_.eventually([&] {
    return std::all_of(publishers.begin(), publishers.end(),
                       [](const auto& one) { return one->get_linked_subscription_count() == 1; }) &&
           std::all_of(subscriptions.begin(), subscriptions.end(),
                       [](const auto& one) { return one->get_linked_publisher_count() == 1; });
  }));
  // New threads settle first, which may take a slow machine longer.
  std::string counted;
  EXPECT_TRUE(other_.eventually([&] {
    const auto begin = std::chrono::steady_clock::now();
    const auto before = switches_of(bridge_->pid());
    std::this_thread::sleep_for(4s);
    const auto after = switches_of(bridge_->pid());
    const auto seconds = static_cast<std::uint64_t>(
        std::chrono::ceil<std::chrono::seconds>(std::chrono::steady_clock::now() - begin).count());
    bool is_idle = true;
    counted.clear();
    for (const auto& [name, count] : after) {
      const auto at = before.find(name);
      const std::uint64_t more = count - (at == before.end() ? 0 : at->second);
      // The process's own threads have its name.
      is_idle &= more <= (name.starts_with("agnocast-bridge ") ? 0 : seconds + 1);
      counted += name + ": " + std::to_string(more) + "\n";
    }
    return is_idle;
  })) << counted;
}

}  // namespace
}  // namespace agnocast::test
