// SPDX-License-Identifier: Apache-2.0
//
// Goal: whatever is wrong with a bridge, doctor names exactly that, and its repair. Method: the
// real agnocastd, agnocast-bridge and agnocast-ctl, each set-up broken for real; files of the test
// stand in for the host's settings.

#include <agnocast/agnocast.hpp>
#include <base/descriptors/unique_fd.hpp>
#include <bridge/dds/participant.hpp>
#include <tests/integration/bridge/dds/dds_domain.hpp>
#include <tests/support/machine/doctored.hpp>
#include <tests/support/machine/temporary_directory.hpp>
#include <tests/support/processes/plain_node.hpp>
#include <tests/support/processes/steered_process.hpp>

#include <std_msgs/msg/string.hpp>

#include <gmock/gmock.h>

#include <netinet/in.h>
#include <sys/socket.h>

#include <algorithm>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <map>
#include <memory>
#include <string>
#include <vector>

namespace agnocast::test {
namespace {

using bridge::RawPieces;
using std_msgs::msg::String;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::StartsWith;

constexpr const char* string_type = "std_msgs::msg::dds_::String_";
constexpr const char* rmem_max = "/proc/sys/net/core/rmem_max";

/// A replacement for the system's /etc, to be mounted there: the files that a program needs, and
/// those of the test.
class SystemsFiles {
 public:
  SystemsFiles() {
    for (const char* const file : {"passwd", "group", "nsswitch.conf", "ld.so.cache"}) {
      std::error_code missing;
      std::filesystem::copy_file(std::string("/etc/") + file, path() + '/' + file, missing);
    }
    for (const char* const directory : {"agnocast", "default", wants})
      std::filesystem::create_directories(path() + '/' + directory);
  }
  const std::string& path() const { return directory_.path(); }
  void write(const std::string& file, const std::string& text) const {
    std::ofstream(path() + '/' + file) << text;
  }
  /// The link points to "systemd/system/unit".
  void enable(const std::string& unit) const {
    std::filesystem::create_symlink("../unit", path() + '/' + wants + unit);
  }
  void disable(const std::string& unit) const {
    std::filesystem::remove(path() + '/' + wants + unit);
  }
  /// Runs a remedy with these files in /etc, up to the part that needs systemd; returns its
  /// status.
  int mend(std::string remedy) const {
    remedy.resize(std::min(remedy.find(" && sudo systemctl"), remedy.size()));
    for (std::size_t at = 0; (at = remedy.find("sudo ", at)) != std::string::npos;)
      remedy.erase(at, 5);
    const std::string script = path() + "/remedy";
    std::ofstream(script) << remedy << '\n';
    return Remedy("unshare --mount sh -c 'mount --bind " + path() + " /etc && . " + script + "'")
        .status();
  }

 private:
  static constexpr const char* wants = "systemd/system/multi-user.target.wants/";
  TemporaryDirectory directory_;
};

class DoctorBridge : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    domain = new Domain;
    ::setenv("ROS_DOMAIN_ID", std::to_string(domain->id()).c_str(), 1);
    daemon = new DaemonProcess;
    ::setenv("AGNOCAST_SOCKET", daemon->socket_path().c_str(), 1);
  }
  void SetUp() override {
    if (!Doctored::has_namespaces()) GTEST_SKIP() << "needs root: a mount namespace";
    doctor_.overlay()[rmem_max] = "16777216\n";
  }
  /// Removes the remains of bridges that the test killed.
  void TearDown() override {
    const std::string socket = daemon->socket_path();
    const std::filesystem::path directory = socket.substr(0, socket.rfind('/'));
    for (const auto& entry : std::filesystem::directory_iterator(directory)) {
      if (entry.path().filename().string().starts_with("bridge-"))
        std::filesystem::remove(entry.path());
    }
  }

  static std::unique_ptr<SteeredProcess> bridge(std::uint32_t id,
                                                const std::vector<std::string>& more = {},
                                                std::vector<std::string> words = {}) {
    words.insert(words.end(), {AGNOCAST_BRIDGE, "--domain", std::to_string(id)});
    words.insert(words.end(), more.begin(), more.end());
    auto started = std::make_unique<SteeredProcess>(words, std::vector<std::string>{});
    EXPECT_TRUE(soon([&] {
      return run_ctl(daemon->socket_path(),
                     {"bridge", "list", "-d", "0.05", "--domain", std::to_string(id)})
                 .status == 0;
    }));
    return started;
  }
  /// Returns doctor's findings about bridges. This process has a test's library, and is no
  /// ordinary node.
  std::vector<std::string> found(const std::vector<std::string>& environment = {}) {
    findings_ = doctor_.look(environment);
    std::vector<std::string> own;
    remedy_.clear();
    for (std::size_t i = 0; i < findings_.all.size(); ++i) {
      const std::string& one = findings_.all[i];
      for (const char* const id : {"bridge-", "cyclonedds-uri", "receive-buffer"}) {
        if (!one.starts_with(id)) continue;
        own.push_back(one);
        remedy_ = findings_.remedies[i];
      }
    }
    return own;
  }
  std::string topic() const {
    return std::string("/") + testing::UnitTest::GetInstance()->current_test_info()->name();
  }

  static Domain* domain;
  static DaemonProcess* daemon;
  Doctored doctor_{daemon->socket_path()};
  Findings findings_;
  std::string remedy_;
};
Domain* DoctorBridge::domain = nullptr;
DaemonProcess* DoctorBridge::daemon = nullptr;

TEST_F(DoctorBridge, FindsNothingWithoutABridgeOrAboutAHealthyOne) {
  EXPECT_THAT(found(), IsEmpty());
  auto publisher = create_publisher<String>(PlainNode(), topic(), 5);
  const auto running = bridge(domain->id());
  EXPECT_THAT(found(), IsEmpty());
}

TEST_F(DoctorBridge, NamesOneThatHasDiedAndItsRemedyStartsIt) {
  bridge(domain->id()).reset();  // SIGKILL
  EXPECT_THAT(found(), testing::ElementsAre(StartsWith("bridge-not-running: nobody listens at ")));
  EXPECT_THAT(remedy_, HasSubstr("--domain " + std::to_string(domain->id())));
  const Remedy remedy(remedy_);
  EXPECT_EQ(remedy.status(), 0) << remedy_;
  EXPECT_TRUE(soon([&] { return found().empty(); }));
}

TEST_F(DoctorBridge, NamesADomainWithNodesAndNoBridge) {
  auto publisher = create_publisher<String>(PlainNode(), topic(), 5);
  const Domain other;
  const auto running = bridge(other.id());
  EXPECT_THAT(found(),
              testing::ElementsAre("bridge-elsewhere: this host has nodes in domain " +
                                   std::to_string(domain->id()) + ", but no bridge serves it"));
  const Remedy remedy(remedy_);
  EXPECT_TRUE(soon([&] { return found().empty(); }));
}

TEST_F(DoctorBridge, NamesATypeThatABridgeDoesNotFind) {
  auto publisher = create_publisher<String>(PlainNode(), topic(), 5);
  const auto participant = domain->participant();
  const auto reader = participant
                          ->create_reader("rt" + topic(), string_type, {},
                                          [](RawPieces) { return std::shared_ptr<void>(); })
                          .value();
  const auto running = bridge(domain->id(), {},
                              {"/usr/bin/env", "-u", "AMENT_PREFIX_PATH", "-u", "LD_LIBRARY_PATH"});
  ASSERT_TRUE(soon([&] { return !found().empty(); }));
  EXPECT_THAT(found(), testing::ElementsAre("bridge-type: " + topic() + ": the bridge of domain " +
                                            std::to_string(domain->id()) +
                                            " cannot find std_msgs/msg/String"));
  EXPECT_THAT(findings_.result.out,
              HasSubstr("no libstd_msgs__rosidl_typesupport_introspection_cpp.so"));
  const Findings without = doctor_.look({"AMENT_PREFIX_PATH"});
  EXPECT_THAT(without.remedies,
              testing::Contains(". WORKSPACE/setup.sh && agnocast-ctl doctor  # WORKSPACE has "
                                "std_msgs"))
      << "a shell without it cannot provide it";
  const Remedy remedy(remedy_);
  EXPECT_EQ(remedy.status(), 0) << remedy_;
  EXPECT_TRUE(soon([&] {
    return found().empty() &&
           run_ctl(daemon->socket_path(), {"bridge", "list", "-d", "0.05"}).status == 0;
  })) << remedy_;
}

TEST_F(DoctorBridge, ChecksTheInstalledUnitsAndNotTheirLeftovers) {
  const SystemsFiles etc;
  doctor_.directories()["/etc"] = etc.path();
  doctor_.directories()["/run/agnocast"] = daemon->directory() + "/run";
  const auto seen = [&] { return found({"AGNOCAST_SOCKET", "CYCLONEDDS_URI"}); };
  const std::string id = std::to_string(domain->id());
  etc.write("agnocast/bridge.toml", "domain = " + id + "\n");
  auto publisher = create_publisher<String>(PlainNode(), topic(), 5);
  const auto running = bridge(domain->id());
  ASSERT_THAT(seen(), IsEmpty());

  etc.write("agnocast/bridge-100.toml", "default = 3\n");
  EXPECT_THAT(seen(),
              testing::ElementsAre("bridge-configuration: /etc/agnocast/"
                                   "bridge-100.toml:1:11: default: this is not a direction"));
  EXPECT_THAT(remedy_, HasSubstr("--config /etc/agnocast/bridge-100.toml"));
  etc.write("agnocast/bridge-100.toml", "");

  etc.enable("agnocast-bridge@100.service");
  EXPECT_THAT(seen(), IsEmpty()) << "the unit does not exist any more";
  etc.write("systemd/system/unit", "");
  EXPECT_THAT(seen(), testing::ElementsAre("bridge-not-running: agnocast-bridge@100.service is "
                                           "enabled, but its bridge does not answer"));
  EXPECT_THAT(remedy_, StartsWith("sudo systemctl restart agnocast-bridge@100.service || "));
  etc.disable("agnocast-bridge@100.service");
  etc.enable("agnocast-bridge.service");
  EXPECT_THAT(seen(), IsEmpty());
  etc.enable("agnocast-bridge@" + id + ".service");
  EXPECT_THAT(seen(), testing::ElementsAre("bridge-not-running: agnocast-bridge.service and "
                                           "agnocast-bridge@" +
                                           id + ".service are both enabled, for domain " + id));
}

TEST_F(DoctorBridge, NamesAFileOfCycloneDdsThatTheUnitsDoNotSeeAndItsRemedyMovesIt) {
  const SystemsFiles etc;
  doctor_.directories()["/etc"] = etc.path();
  doctor_.directories()["/run/agnocast"] = daemon->directory() + "/run";
  const std::string file =
      "/tmp/agnocast-doctor-test-" + std::to_string(::getpid()) + "-cyclonedds.xml";
  std::ofstream(file) << Domain::configuration("10 s");
  etc.write("default/agnocast-bridge", "CYCLONEDDS_URI=file://" + file + "\n");
  const auto seen = [&] { return found({"AGNOCAST_SOCKET", "CYCLONEDDS_URI"}); };
  EXPECT_THAT(seen(), testing::ElementsAre("cyclonedds-uri: CYCLONEDDS_URI of the units names " +
                                           file + ", which the units cannot see"));
  EXPECT_EQ(etc.mend(remedy_), 0) << remedy_;
  EXPECT_THAT(seen(), IsEmpty());
  std::filesystem::remove(file);
}

TEST_F(DoctorBridge, NamesABridgeThatLooksForOthersFartherThanTheNodes) {
  auto publisher = create_publisher<String>(PlainNode(), topic(), 5);
  const auto running = bridge(domain->id());
  EXPECT_THAT(found({"ROS_LOCALHOST_ONLY=0"}), IsEmpty());
  EXPECT_THAT(found({"ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET"}), IsEmpty());
  EXPECT_THAT(found({"ROS_AUTOMATIC_DISCOVERY_RANGE=SYSTEM_DEFAULT"}), IsEmpty());
  // Together with a device in CYCLONEDDS_URI it would be an error: Cyclone DDS takes each once.
  EXPECT_THAT(
      found({"ROS_LOCALHOST_ONLY=1", "CYCLONEDDS_URI="}),
      testing::ElementsAre("bridge-range: the bridge of domain " + std::to_string(domain->id()) +
                           " looks for others with no limit, this shell's nodes with "
                           "ROS_LOCALHOST_ONLY=1"));
  EXPECT_THAT(remedy_, StartsWith("kill " + std::to_string(running->pid()) + " && flock "));
}

TEST_F(DoctorBridge, NamesSettingsThatCycloneDdsRefuses) {
  const auto with = [&](const std::string& uri) { return found({"CYCLONEDDS_URI=" + uri}); };
  EXPECT_THAT(with(std::getenv("CYCLONEDDS_URI")), IsEmpty());
  for (const auto& [wrong, why] : std::map<std::string, std::string>{
           {"<CycloneDDS><Domain></CycloneDDS>", "Domain"},
           {"<CycloneDDS><NoSuchThing/></CycloneDDS>", "NoSuchThing"},
           {"file:///nowhere.xml", "nowhere.xml"}})
    EXPECT_THAT(with(wrong), testing::ElementsAre(testing::AllOf(
                                 StartsWith("cyclonedds-uri: CYCLONEDDS_URI: "), HasSubstr(why))));
}

// On an interface without multicast each process of a domain has two ports of its own.
TEST_F(DoctorBridge, FindsNothingWrongWithSettingsWhenTheDomainIsFull) {
  std::vector<UniqueFd> taken;
  // RTPS 2.3, 9.6.1.1.
  const auto first = static_cast<std::uint16_t>(7400 + 250 * domain->id() + 10);
  constexpr int processes_max = 10;  // of Cyclone DDS, MaxAutoParticipantIndex
  for (std::uint16_t port = 0; port < 2 * processes_max; ++port) {
    taken.emplace_back(::socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0));
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_port = htons(static_cast<std::uint16_t>(first + port));
    ASSERT_EQ(::bind(taken.back().get(), reinterpret_cast<sockaddr*>(&address), sizeof address), 0);
  }
  EXPECT_THAT(found({"ROS_DOMAIN_ID=" + std::to_string(domain->id())}), IsEmpty());
}

TEST_F(DoctorBridge, NamesMistakesInTheConfigurationOfOneThatRuns) {
  const TemporaryDirectory directory;
  const std::string file = directory.path() + "/bridge.toml";
  std::ofstream(file) << "default = \"both\"\n";
  auto publisher = create_publisher<String>(PlainNode(), topic(), 5);
  const auto running = bridge(domain->id(), {"--config", file});
  EXPECT_THAT(found(), IsEmpty());
  std::ofstream(file) << "default = \"some\"\n";
  EXPECT_THAT(found(), testing::ElementsAre("bridge-configuration: " + file +
                                            ":1:11: default: this is not a direction"));
  EXPECT_THAT(remedy_, HasSubstr("agnocast-bridge --check-config --config " + file));
}

TEST_F(DoctorBridge, NamesASocketBufferThatIsTooSmallForTheTraffic) {
  auto subscription = create_subscription<String>(PlainNode(), topic(), 5);
  const auto running = bridge(domain->id());
  const auto participant = domain->participant();
  const auto writer = participant->create_writer("rt" + topic(), string_type, {}).value();
  ASSERT_TRUE(soon([&] { return writer->matched() == 1; }));
  constexpr std::size_t letters = 1'000'000;
  ASSERT_TRUE(writer->write(
      letters + 8,
      [](std::span<std::byte> room) {
        const std::uint32_t count = letters;
        std::memset(room.data(), 'x', room.size());
        const unsigned char head[4] = {0, 1, 0, 0};
        std::memcpy(room.data(), head, 4);
        std::memcpy(room.data() + 4, &count, 4);
        room[letters + 7] = std::byte{0};
        return letters + 8;
      },
      1));
  ASSERT_TRUE(take_soon(subscription));
  EXPECT_THAT(found(), IsEmpty()) << "16 MiB";
  doctor_.overlay()[rmem_max] = "212992\n";
  // The bridge counts a message when it has published it, possibly after it was taken.
  EXPECT_TRUE(soon([&] { return !found().empty(); }));
  EXPECT_THAT(found(),
              testing::ElementsAre("receive-buffer: " + topic() +
                                   " receives messages of 976.6 KiB from DDS, but a socket "
                                   "buffer is limited to 208.0 KiB"));
  EXPECT_THAT(remedy_, HasSubstr("net.core.rmem_max = "));
  EXPECT_EQ(findings_.result.status, 0) << "a warning";
}

}  // namespace
}  // namespace agnocast::test
