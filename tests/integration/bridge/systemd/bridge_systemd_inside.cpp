// SPDX-License-Identifier: Apache-2.0
//
// Runs inside the machine of bridge_systemd_test.sh: the units of the bridge, killed, hanging,
// reloaded, in several domains. This process has the agnocast endpoints, and is the other
// participant in DDS.

#include <agnocast/agnocast.hpp>
#include <bridge/cdr/cdr.hpp>
#include <bridge/dds/participant.hpp>
#include <tests/integration/bridge/dds/dds_domain.hpp>
#include <tests/support/machine/systemctl.hpp>
#include <tests/support/processes/plain_node.hpp>
#include <tests/support/soon.hpp>

#include <std_msgs/msg/string.hpp>

#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <memory>
#include <sstream>
#include <string>
#include <vector>

namespace agnocast::bridge {
namespace {

using namespace std::chrono_literals;
using std_msgs::msg::String;
using test::Domain;
using test::output_of;
using test::PlainNode;
using Clock = std::chrono::steady_clock;

constexpr const char* configuration = "/etc/agnocast/bridge.toml";

std::string property(const std::string& name) { return test::property_of("agnocast-bridge", name); }
bool systemctl(const std::string& verb, const std::string& unit = "agnocast-bridge") {
  return test::run_systemctl(verb, unit);
}
pid_t main_pid() { return test::main_pid_of("agnocast-bridge"); }
template <class Condition>
bool eventually(Condition condition) {
  return test::soon(condition);
}
void write_file(const std::string& path, const std::string& text) { std::ofstream(path) << text; }
void configure(const std::string& more) {
  write_file(configuration, "type_paths = [\"/opt/agnocast/lib\"]\n" + more);
}

CdrType string_type() {
  return CdrType::of(*static_cast<const MessageMembers*>(MessageTraits<String>::table())).value();
}

/// A publisher and a subscription of this host, a reader and a writer in DDS.
class Traffic {
 public:
  explicit Traffic(const Domain& domain)
      : participant_(domain.participant()),
        publisher_(create_publisher<String>(PlainNode(), "/out", 10)),
        subscription_(create_subscription<String>(PlainNode(), "/in", 10)) {
    DdsQos qos;
    qos.depth = 10;
    reader_ = participant_
                  ->create_reader("rt/out", name, qos,
                                  [type = type_](RawPieces pieces) -> std::shared_ptr<void> {
                                    auto message = std::make_shared<String>();
                                    if (!read_cdr(type, pieces, message.get())) return nullptr;
                                    return message;
                                  })
                  .value();
    writer_ = participant_->create_writer("rt/in", name, qos).value();
  }

  /// Sends one message each way and takes those that have arrived.
  void turn() {
    auto loan = publisher_->borrow_loaned_message();
    loan->data = "out";
    EXPECT_TRUE(publisher_->publish(std::move(loan)));
    String in;
    in.data = "in";
    (void)writer_->write(
        cdr_bytes(type_, &in),
        [&](std::span<std::byte> room) { return write_cdr(type_, &in, room).value_or(0); }, 1);
    take();
  }
  void take() {
    while (const auto sample = reader_->take())
      came_out_ |= sample->state == DdsSample::State::valid;
    while (subscription_->take()) came_in_ = true;
  }
  void forget() {
    take();
    came_out_ = came_in_ = false;
  }
  bool came_out() const { return came_out_; }
  bool came_in() const { return came_in_; }
  bool flows() {
    forget();
    return eventually([this] {
      turn();
      return came_out_ && came_in_;
    });
  }
  bool is_read() const { return reader_->matched() == 1; }

 private:
  static constexpr const char* name = "std_msgs::msg::dds_::String_";
  CdrType type_ = string_type();
  std::unique_ptr<DdsParticipant> participant_;
  std::unique_ptr<DdsReader> reader_;
  std::unique_ptr<DdsWriter> writer_;
  Publisher<String>::SharedPtr publisher_;
  Subscription<String>::SharedPtr subscription_;
  bool came_out_ = false, came_in_ = false;
};

class BridgeUnit : public testing::Test {
 protected:
  void SetUp() override {
    ::setenv("ROS_DOMAIN_ID", std::to_string(domain_.id()).c_str(), 1);
    write_file("/etc/default/agnocast-bridge",
               "ROS_DOMAIN_ID=" + std::to_string(domain_.id()) +
                   "\nLD_LIBRARY_PATH=/opt/agnocast/lib\nCYCLONEDDS_URI='" +
                   std::getenv("CYCLONEDDS_URI") + "'\n");
    configure("");
    ASSERT_TRUE(systemctl("start", "agnocastd"));
    ASSERT_TRUE(systemctl("restart")) << output_of("systemctl status agnocast-bridge");
  }
  void TearDown() override {
    if (HasFailure())
      std::printf("%s\n", output_of("journalctl -u agnocast-bridge -u agnocastd --no-pager -o cat "
                                    "| tail -n 40")
                              .c_str());
    systemctl("stop");
  }

  static inline Domain domain_;
};

void print(const char* what, std::vector<double> seconds) {
  std::sort(seconds.begin(), seconds.end());
  std::printf("%s again after a kill: p50 %.3f s, max %.3f s of %zu\n", what,
              seconds[seconds.size() / 2], seconds.back(), seconds.size());
}

TEST_F(BridgeUnit, RunsAgainAfterEachKillAndMessagesFlowBothWays) {
  Traffic traffic(domain_);
  ASSERT_TRUE(traffic.flows());
  std::vector<double> out, in;
  for (int kill = 0; kill < 8; ++kill) {
    const pid_t pid = main_pid();
    ASSERT_GT(pid, 1);
    const auto began = Clock::now();
    ASSERT_EQ(::kill(pid, SIGKILL), 0);
    ASSERT_TRUE(
        eventually([&] { return !std::filesystem::exists("/proc/" + std::to_string(pid)); }));
    traffic.forget();
    double out_s = 0, in_s = 0;
    ASSERT_TRUE(eventually([&] {
      traffic.turn();
      const double now_s = std::chrono::duration<double>(Clock::now() - began).count();
      if (traffic.came_out() && out_s == 0) out_s = now_s;
      if (traffic.came_in() && in_s == 0) in_s = now_s;
      return out_s != 0 && in_s != 0;
    })) << (out_s == 0 ? "nothing goes out " : "")
        << (in_s == 0 ? "nothing comes in" : "");
    EXPECT_NE(main_pid(), pid);
    out.push_back(out_s);
    in.push_back(in_s);
  }
  print("to DDS", out);
  print("from DDS", in);
}

TEST_F(BridgeUnit, GoesOnWithAnotherDaemon) {
  Traffic traffic(domain_);
  ASSERT_TRUE(traffic.flows());
  const pid_t pid = main_pid();
  ASSERT_TRUE(systemctl("restart", "agnocastd"));
  EXPECT_TRUE(traffic.flows());
  EXPECT_EQ(main_pid(), pid);
}

TEST_F(BridgeUnit, IsRestartedWhenItHangsButNotWhenItIsIdle) {
  std::filesystem::create_directories("/run/systemd/system/agnocast-bridge.service.d");
  write_file("/run/systemd/system/agnocast-bridge.service.d/test.conf",
             "[Service]\nWatchdogSec=10s\n");
  ASSERT_TRUE(systemctl("daemon-reload", ""));
  ASSERT_TRUE(systemctl("restart"));
  const pid_t idle = main_pid();
  std::string last = property("WatchdogTimestampMonotonic");
  for (int sign = 0; sign < 3; ++sign) {  // longer than it may be silent
    ASSERT_TRUE(eventually([&] { return property("WatchdogTimestampMonotonic") != last; }));
    last = property("WatchdogTimestampMonotonic");
  }
  EXPECT_EQ(main_pid(), idle);
  ASSERT_EQ(::kill(idle, SIGSTOP), 0);
  EXPECT_TRUE(eventually([&] { return main_pid() > 1 && main_pid() != idle; }));
  std::filesystem::remove_all("/run/systemd/system/agnocast-bridge.service.d");
  ASSERT_TRUE(systemctl("daemon-reload", ""));
}

TEST_F(BridgeUnit, AppliesReloadedRulesAndKeepsTheOldOnesWhenTheyAreWrong) {
  Traffic traffic(domain_);
  ASSERT_TRUE(traffic.flows());
  const pid_t pid = main_pid();
  configure("default = \"none\"\n");
  ASSERT_TRUE(systemctl("reload"));
  EXPECT_TRUE(eventually([&] { return !traffic.is_read(); }));
  configure("default = 3\n");
  EXPECT_FALSE(systemctl("reload")) << "the caller of reload gets the failure";
  ASSERT_EQ(::kill(pid, SIGHUP), 0);
  EXPECT_TRUE(eventually([] {
    return output_of(
               "journalctl -u agnocast-bridge --no-pager 'AGNOCAST_EVENT=configuration "
               "rejected' AGNOCAST_WHY='this is not a direction' -o cat")
               .find("bridge.toml:2:11") != std::string::npos;
  }));
  EXPECT_FALSE(traffic.is_read());
  configure("");
  ASSERT_TRUE(systemctl("reload"));
  EXPECT_TRUE(traffic.flows());
  EXPECT_EQ(main_pid(), pid);
}

TEST_F(BridgeUnit, ServesAFurtherDomainWithTheTemplate) {
  const Domain other;
  const std::string unit = "agnocast-bridge@" + std::to_string(other.id());
  ASSERT_TRUE(systemctl("start", unit)) << output_of("systemctl status " + unit);
  for (const std::uint32_t id : {domain_.id(), other.id()})
    EXPECT_TRUE(
        std::filesystem::is_socket("/run/agnocast-bridge/bridge-" + std::to_string(id) + ".sock"));
  EXPECT_EQ(output_of("stat -c '%a %U %G' /run/agnocast-bridge/bridge-" +
                      std::to_string(other.id()) + ".sock"),
            "660 agnocast-bridge agnocast");
  ASSERT_TRUE(systemctl("stop", unit));
  EXPECT_EQ(property("ActiveState"), "active");
  const std::string second = "agnocast-bridge@" + std::to_string(domain_.id());
  EXPECT_FALSE(std::system(("timeout 3 systemctl start " + second).c_str()) == 0)
      << "two bridges of one domain";
  systemctl("stop", second);
}

/// Returns doctor's remedy for the first finding of a check; empty without a finding.
std::string remedy_of(const std::string& check, const std::string& environment) {
  std::istringstream said(output_of("env " + environment + " agnocast-ctl doctor 2>&1"));
  bool is_it = false;
  for (std::string line; std::getline(said, line);) {
    if (!line.starts_with(' ')) is_it = line.find(": " + check + ": ") != std::string::npos;
    if (const std::string key = "  fix:   "; is_it && line.starts_with(key))
      return line.substr(key.size());
  }
  return {};
}
int mend(std::string remedy) {
  for (std::size_t at = 0; (at = remedy.find("sudo ", at)) != std::string::npos;)
    remedy.erase(at, 5);
  return std::system((remedy + " >/dev/null").c_str());
}

TEST_F(BridgeUnit, FindsAWorkspaceInAClosedHomeAfterDoctorsRemedy) {
  const std::string home = "/home/somebody", workspace = home + "/ws";
  std::filesystem::create_directories(workspace);
  std::filesystem::copy("/opt/agnocast/lib", workspace + "/lib");
  std::filesystem::permissions(home, std::filesystem::perms(0750));
  write_file(configuration, "");
  write_file("/etc/default/agnocast-bridge", "ROS_DOMAIN_ID=" + std::to_string(domain_.id()) +
                                                 "\nCYCLONEDDS_URI='" +
                                                 std::getenv("CYCLONEDDS_URI") + "'\n");
  ASSERT_TRUE(systemctl("restart"));
  Traffic traffic(domain_);
  const std::string shell = "AMENT_PREFIX_PATH=" + workspace;
  std::string remedy;
  ASSERT_TRUE(eventually([&] { return !(remedy = remedy_of("bridge-type", shell)).empty(); }))
      << output_of("agnocast-ctl doctor");
  EXPECT_EQ(mend(remedy), 0) << remedy;
  EXPECT_TRUE(traffic.flows()) << remedy << '\n' << output_of("agnocast-ctl bridge list -v");
  EXPECT_EQ(remedy_of("bridge-type", shell), "");
  std::filesystem::remove_all(home);
}

TEST_F(BridgeUnit, StartsWithAFileOfCycloneDdsInTmpAfterDoctorsRemedy) {
  write_file("/tmp/dds.xml", std::getenv("CYCLONEDDS_URI"));
  write_file("/etc/default/agnocast-bridge",
             "ROS_DOMAIN_ID=" + std::to_string(domain_.id()) +
                 "\nLD_LIBRARY_PATH=/opt/agnocast/lib\nCYCLONEDDS_URI=file:///tmp/dds.xml\n");
  (void)systemctl("restart --no-block");
  const std::string remedy = remedy_of("cyclonedds-uri", "");
  EXPECT_EQ(mend(remedy), 0) << remedy;
  Traffic traffic(domain_);
  EXPECT_TRUE(traffic.flows());
  EXPECT_EQ(remedy_of("cyclonedds-uri", ""), "");
  std::filesystem::remove("/tmp/dds.xml");
}

TEST_F(BridgeUnit, HasValidUnitsThatAreAsTightAsTheDocumentSays) {
  const std::string units = "/usr/lib/systemd/system/agnocast-bridge";
  EXPECT_EQ(output_of("systemd-analyze verify " + units + ".service " + units + "@7.service 2>&1"),
            "");
  std::ifstream document("/usr/share/doc/agnocast/docs/bridge.md");
  std::stringstream text;
  text << document.rdbuf();
  const std::string words = "exposure level ";
  const std::size_t at = text.str().find(words);
  ASSERT_NE(at, std::string::npos);
  const double stated = std::stod(text.str().substr(at + words.size()));
  const auto is_within = [&](int tenths) {
    return std::system(("systemd-analyze security --offline=true --no-pager --threshold=" +
                        std::to_string(tenths) + ' ' + units + ".service >/dev/null 2>&1")
                           .c_str()) == 0;
  };
  const int tenths = static_cast<int>(stated * 10 + 0.5);
  EXPECT_TRUE(is_within(tenths)) << output_of(
      "systemd-analyze security --offline=true --no-pager " + units + ".service");
  EXPECT_FALSE(is_within(tenths - 1)) << "the exposure is lower than documented";
}

}  // namespace
}  // namespace agnocast::bridge
