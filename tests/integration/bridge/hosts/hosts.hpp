// SPDX-License-Identifier: Apache-2.0
//
// Two hosts on this one: network namespaces connected by a veth pair, each with an agnocastd, an
// agnocast-bridge and processes of its own. Needs root.
#pragma once

#include <tests/support/processes/ctl.hpp>
#include <tests/support/processes/daemon_process.hpp>
#include <tests/support/processes/held.hpp>
#include <tests/support/processes/steered_process.hpp>

#include <gtest/gtest.h>

#include <chrono>
#include <cstdlib>
#include <functional>
#include <map>
#include <memory>
#include <sstream>
#include <string>
#include <thread>
#include <vector>

namespace agnocast::test {

inline bool can_make_network_namespaces() {
  return std::system("unshare --net true 2>/dev/null && ip -V >/dev/null 2>&1") == 0;
}

/// Keeps its namespace alive until it ends.
class NetworkNamespace {
 public:
  NetworkNamespace() { EXPECT_EQ(holder_.ask("there"), "there"); }
  std::string pid() const { return std::to_string(holder_.pid()); }
  std::string path() const { return "/proc/" + pid() + "/ns/net"; }
  void run(const std::string& command) const {
    EXPECT_EQ(std::system(("nsenter --net=" + path() + " " + command).c_str()), 0) << command;
  }

 private:
  SteeredProcess holder_{{"/usr/bin/unshare", "--net", "/bin/cat"}, {}};
};

class Host {
 public:
  Host(std::string lease, int number)
      : lease_(std::move(lease)), address_("10.77.0." + std::to_string(number)) {}

  void start_bridge(std::uint32_t domain = 0) {
    bridges_[domain] = std::make_unique<SteeredProcess>(
        std::vector<std::string>{"/usr/bin/nsenter", "--net=" + network_.path(), AGNOCAST_BRIDGE},
        std::vector<std::string>{
            "AGNOCAST_SOCKET=" + daemon_->socket_path(), "ROS_DOMAIN_ID=" + std::to_string(domain),
            "CYCLONEDDS_URI=<CycloneDDS><Domain><General><Interfaces><NetworkInterface address='" +
                address_ +
                "'/></Interfaces></General><Discovery><SPDPInterval>500 "
                "ms</SPDPInterval><LeaseDuration>" +
                lease_ + "</LeaseDuration></Discovery></Domain></CycloneDDS>"});
  }
  /// Starts one that finds its device by itself, or as `variables` say.
  void start_plain_bridge(std::vector<std::string> variables) {
    variables.push_back("AGNOCAST_SOCKET=" + daemon_->socket_path());
    bridges_[0] = std::make_unique<SteeredProcess>(
        std::vector<std::string>{"/usr/bin/nsenter", "--net=" + network_.path(), AGNOCAST_BRIDGE},
        variables);
  }
  SteeredProcess& bridge(std::uint32_t domain = 0) { return *bridges_.at(domain); }
  /// Starts a process with agnocast endpoints.
  std::unique_ptr<SteeredProcess> process(std::uint32_t domain = 0) const {
    return std::make_unique<SteeredProcess>(
        std::vector<std::string>{AGNOCAST_LOCAL_PEER},
        std::vector<std::string>{"AGNOCAST_SOCKET=" + daemon_->socket_path(),
                                 "ROS_DOMAIN_ID=" + std::to_string(domain)});
  }
  DaemonProcess& daemon() { return *daemon_; }
  NetworkNamespace& network() { return network_; }
  const std::string& address() const { return address_; }

 private:
  std::string lease_, address_;
  NetworkNamespace network_;
  std::unique_ptr<DaemonProcess> daemon_ = std::make_unique<DaemonProcess>();
  std::map<std::uint32_t, std::unique_ptr<SteeredProcess>> bridges_;
};

struct TwoHosts {
  explicit TwoHosts(const std::string& lease = "10 s") : left(lease, 1), right(lease, 2) {
    EXPECT_EQ(std::system(("ip link add cable netns " + left.network().pid() +
                           " type veth peer name cable netns " + right.network().pid())
                              .c_str()),
              0);
    for (Host* const host : {&left, &right}) {
      host->network().run("ip address add " + host->address() + "/24 dev cable");
      host->network().run("ip link set lo up");
      host->network().run("ip link set cable up");
      host->network().run("ip route add 224.0.0.0/4 dev cable");
    }
  }
  void unplug() { left.network().run("ip link set cable down"); }
  void plug() {
    left.network().run("ip link set cable up");
    left.network().run("ip route replace 224.0.0.0/4 dev cable");
  }
  Host left, right;
};

/// The messages of a local_peer's subscription, by the names of publishers; and the publishers
/// that it knows.
struct Heard {
  std::map<std::string, std::vector<std::uint64_t>> numbers;
  std::map<std::string, std::vector<std::string>> publishers;

  void take(SteeredProcess& process, const std::string& subscription) {
    std::istringstream words(process.ask("take " + subscription));
    for (std::string word; words >> word;) {
      const std::size_t slash = word.find('/'), sharp = word.find('#');
      if (sharp == std::string::npos) {
        ADD_FAILURE() << word;
        return;
      }
      const std::string name = word.substr(slash + 1, sharp - slash - 1);
      numbers[name].push_back(std::stoull(word.substr(sharp + 1)));
      auto& of = publishers[name];
      if (of.empty() || of.back() != word.substr(0, slash)) of.push_back(word.substr(0, slash));
    }
  }
  bool has(const std::string& name, std::uint64_t number) const {
    const auto found = numbers.find(name);
    return found != numbers.end() && !found->second.empty() && found->second.back() >= number;
  }
  bool is_once_and_in_order() const {
    for (const auto& [name, list] : numbers)
      for (std::size_t i = 1; i < list.size(); ++i)
        if (list[i - 1] >= list[i]) return false;
    return true;
  }
  /// Returns whether no number between is missing.
  bool is_complete(const std::string& name) const {
    const auto found = numbers.find(name);
    return found != numbers.end() && !found->second.empty() &&
           found->second.back() - found->second.front() + 1 == found->second.size();
  }
};

// Only a failing test waits this long.
constexpr std::chrono::seconds patience{60};

inline bool eventually_s(const std::function<bool()>& condition) {
  const auto end = std::chrono::steady_clock::now() + patience;
  while (!condition()) {
    if (std::chrono::steady_clock::now() > end) return false;
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
  }
  return true;
}

class Hosts : public testing::Test {
 protected:
  void SetUp() override {
    if (!can_make_network_namespaces())
      GTEST_SKIP() << "no network namespace can be made (unshare --net), or there is no ip";
  }
  static void expect_sound(Host& host) {
    const CtlResult verified = run_ctl(host.daemon().socket_path(), {"verify"});
    EXPECT_EQ(verified.status, 0) << verified.out << verified.err;
  }
};

}  // namespace agnocast::test
