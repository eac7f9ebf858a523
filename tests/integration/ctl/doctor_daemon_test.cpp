// SPDX-License-Identifier: Apache-2.0
//
// Goal: whatever is wrong with the daemon, its limits or its host, doctor names exactly that, and
// its remedy repairs it. Method: each set-up broken for real; files of the test stand in for the
// host's settings.

#include <tests/integration/ctl/ctl_node.hpp>
#include <tests/support/machine/doctored.hpp>
#include <tests/support/memory/descriptors.hpp>
#include <tests/support/processes/child.hpp>

#include <gmock/gmock.h>
#include <sys/resource.h>
#include <sys/stat.h>

#include <filesystem>
#include <fstream>
#include <memory>
#include <string>
#include <vector>

namespace agnocast::test {
namespace {

using testing::Contains;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::Not;
using testing::StartsWith;
using Node = CtlNode;

class DoctorDaemon : public testing::Test {
 protected:
  void SetUp() override {
    if (!Doctored::has_namespaces()) GTEST_SKIP() << "needs root: a mount namespace";
  }
  /// Runs a remedy that makes the daemon read its configuration again. Our raw nodes do not rejoin
  /// by themselves, so doctor then finds them missing, but no longer the repaired problem.
  static void expect_mended_by_reload(DaemonProcess& daemon, Doctored& doctor,
                                      const Findings& findings) {
    const std::string id = findings.ids()[0];
    const pid_t old = daemon.pid();
    const Remedy remedy(findings.remedies[0]);
    EXPECT_EQ(remedy.status(), 0) << findings.remedies[0];
    EXPECT_TRUE(daemon.wait_for_next(old)) << findings.remedies[0];
    EXPECT_THAT(doctor.look().ids(), Not(Contains(id)));
  }
};

TEST_F(DoctorDaemon, NamesTheQuotaThatIsUsedUp) {
  DaemonProcess daemon({.more_config = "[quota]\ntopics = 4\n"});
  Doctored doctor(daemon.socket_path());
  Node node(daemon.socket_path());
  for (const char* topic : {"/a", "/b", "/c"}) node.publisher(topic);
  EXPECT_THAT(doctor.look().all, IsEmpty()) << "three of four";
  node.publisher("/d");
  const Findings findings = doctor.look();
  ASSERT_THAT(findings.all, ElementsAre("quota: uid " + std::to_string(::geteuid()) +
                                        " uses 4 of [quota] topics = 4"));
  EXPECT_EQ(findings.result.status, 6);
  expect_mended_by_reload(daemon, doctor, findings);
}

TEST_F(DoctorDaemon, NamesTheQuotaThatHasRefusedARequest) {
  DaemonProcess daemon({.more_config = "[quota]\nheld_messages = 10\n"});
  Doctored doctor(daemon.socket_path());
  Node node(daemon.socket_path());
  node.wire.open_wait_set();
  auto greedy = WireClient::endpoint("/points", {5});
  greedy.quota = 11;
  ASSERT_EQ(node.wire.ask(wire::Opcode::create_subscription, greedy).refused_code(),
            Errc::quota_exceeded);
  const Findings findings = doctor.look();
  ASSERT_THAT(findings.ids(), ElementsAre("quota"));
  EXPECT_THAT(findings.all[0], HasSubstr("was refused: [quota] held_messages is 10"));
  EXPECT_THAT(findings.remedies[0], HasSubstr("/^held_messages = .*/held_messages = 20/"));
}

TEST_F(DoctorDaemon, NamesTheTableThatIsFull) {
  DaemonProcess daemon({.more_config = "[limits]\ntopics = 4\n"});
  Doctored doctor(daemon.socket_path());
  Node node(daemon.socket_path());
  for (const char* topic : {"/a", "/b", "/c", "/d"}) node.publisher(topic);
  EXPECT_EQ(node.wire.create_publisher("/e").refused_code(), Errc::limit_reached);
  const Findings findings = doctor.look();
  ASSERT_THAT(findings.all, ElementsAre("table-full: there are 4 of [limits] topics = 4"));
  expect_mended_by_reload(daemon, doctor, findings);
}

TEST_F(DoctorDaemon, NamesATopicThatWillNeedToBeWide) {
  DaemonProcess daemon;
  Doctored doctor(daemon.socket_path());
  Node node(daemon.socket_path());
  for (int i = 0; i < 180; ++i) node.publisher("/crowded");
  const Findings findings = doctor.look();
  ASSERT_THAT(findings.all, ElementsAre("table-full: /crowded has 180 of 256 publishers; it "
                                        "began without being in [limits] wide_topics"));
  for (int times = 0; times < 2; ++times) {
    const Remedy remedy(findings.remedies[0]);
    std::ifstream in(daemon.directory() + "/agnocastd.toml");
    const std::string config{std::istreambuf_iterator<char>(in), {}};
    EXPECT_THAT(config, HasSubstr("wide_topics = [\"/crowded\", \"/rosout\", "));
  }
}

TEST_F(DoctorDaemon, NamesTheDepthThatWasRefused) {
  DaemonProcess daemon({.more_config = "[limits]\ndepth_max = 10\n"});
  Doctored doctor(daemon.socket_path());
  Node node(daemon.socket_path());
  ASSERT_EQ(node.wire.create_publisher("/deep", {11}).refused_code(), Errc::depth_refused);
  const Findings findings = doctor.look();
  ASSERT_THAT(findings.ids(), ElementsAre("depth"));
  expect_mended_by_reload(daemon, doctor, findings);
  std::ifstream in(daemon.directory() + "/agnocastd.toml");
  const std::string config{std::istreambuf_iterator<char>(in), {}};
  EXPECT_THAT(config, HasSubstr("depth_max = 20\n"));
  EXPECT_THAT(config, HasSubstr("window_bytes = \"64MiB\"\n")) << "earlier settings stay";
}

TEST_F(DoctorDaemon, ReportsThatAnUpdateAwaitsARestart) {
  const std::string directory = make_directory(), program = directory + "/agnocastd";
  std::filesystem::copy_file(AGNOCAST_TEST_DAEMON, program);
  {
    DaemonProcess daemon({.program = program});
    Doctored doctor(daemon.socket_path());
    EXPECT_THAT(doctor.look().all, IsEmpty());
    std::filesystem::copy_file(AGNOCAST_TEST_DAEMON, program + ".new");
    std::filesystem::rename(program + ".new", program);
    const Findings findings = doctor.look();
    ASSERT_THAT(findings.ids(), ElementsAre("old-daemon"));
    expect_mended_by_reload(daemon, doctor, findings);
  }
  remove_directory(directory);
}

TEST_F(DoctorDaemon, ReportsThatNothingIsKept) {
  DaemonProcess daemon({.arguments = {"--fd-store=none"}});
  Doctored doctor(daemon.socket_path());
  const pid_t old = daemon.pid();
  const Findings findings = doctor.look();
  ASSERT_THAT(findings.ids(), ElementsAre("nothing-kept"));
  const Remedy remedy(findings.remedies[0]);
  EXPECT_TRUE(soon([&] {
    const CtlResult status = run_ctl(daemon.socket_path(), {"status", "-j"});
    return status.status == 0 && status.json()["daemon"]["pid"] != old;
  }));
  EXPECT_THAT(doctor.look().all, IsEmpty());
}

TEST_F(DoctorDaemon, ReportsThatTheDaemonDiesRepeatedly) {
  DaemonProcess daemon;
  Doctored doctor(daemon.socket_path());
  for (int death = 0; death < 3; ++death) {
    EXPECT_THAT(doctor.look().all, IsEmpty()) << death;
    ASSERT_TRUE(daemon.wait_for_next(daemon.kill_worker()));
  }
  const Findings findings = doctor.look();
  EXPECT_THAT(findings.all,
              ElementsAre("daemon-restarts: agnocastd restarted 3 times within ten minutes"));
  EXPECT_THAT(findings.remedies[0], StartsWith("journalctl "));
}

TEST_F(DoctorDaemon, ReportsThatDescriptorsRunOut) {
  DaemonProcess daemon;
  Doctored doctor(daemon.socket_path());
  std::vector<std::unique_ptr<Node>> nodes;
  for (int i = 0; i < 8; ++i) nodes.push_back(std::make_unique<Node>(daemon.socket_path()));
  rlimit limit{};
  ASSERT_EQ(::prlimit(daemon.pid(), RLIMIT_NOFILE, nullptr, &limit), 0);
  limit.rlim_cur = daemon.descriptor_count() + 5;
  ASSERT_EQ(::prlimit(daemon.pid(), RLIMIT_NOFILE, &limit, nullptr), 0);
  const Findings findings = doctor.look();
  ASSERT_THAT(findings.ids(), ElementsAre("descriptor-limit"));
  EXPECT_THAT(findings.remedies[0],
              StartsWith("sudo prlimit --pid " + std::to_string(daemon.pid()) + " --nofile="));
  if (limit.rlim_max < 65536 && !may_raise_limits())
    GTEST_SKIP() << "the remedy needs CAP_SYS_RESOURCE";
  const Remedy remedy(findings.remedies[0]);
  EXPECT_EQ(remedy.status(), 0);
  EXPECT_THAT(doctor.look().all, IsEmpty());
}

TEST_F(DoctorDaemon, ReportsAVerboseLog) {
  DaemonProcess daemon({.arguments = {"--log-level", "debug"}});
  Doctored doctor(daemon.socket_path());
  const Findings findings = doctor.look();
  ASSERT_THAT(findings.ids(), ElementsAre("debug-log"));
  const Remedy remedy(findings.remedies[0], {"AGNOCAST_SOCKET=" + daemon.socket_path()});
  EXPECT_EQ(remedy.status(), 0);
  EXPECT_THAT(doctor.look().all, IsEmpty());
}

TEST_F(DoctorDaemon, ReportsADamagedStore) {
  DaemonProcess daemon;
  Doctored doctor(daemon.socket_path());
  const UniqueFd journal = descriptor_of(daemon.supervisor_pid(), "agnocast-journal");
  ASSERT_TRUE(journal);
  const pid_t old = daemon.pid();
  ASSERT_EQ(::kill(daemon.supervisor_pid(), SIGSTOP), 0);
  daemon.kill_worker();
  const std::uint64_t nonsense = 1;
  ASSERT_EQ(::pwrite(journal.get(), &nonsense, sizeof nonsense, 0), ssize_t{8});
  ASSERT_EQ(::kill(daemon.supervisor_pid(), SIGCONT), 0);
  ASSERT_TRUE(daemon.wait_for_log("refusing everybody"));
  ASSERT_TRUE(soon([&] { return daemon.pid() > 0 && daemon.pid() != old; }));
  const Findings findings = doctor.look();
  ASSERT_THAT(findings.ids(), ElementsAre("store-damaged"));
  const Remedy remedy(findings.remedies[0]);
  EXPECT_TRUE(soon([&] { return run_ctl(daemon.socket_path(), {"status"}).status == 0; }));
  EXPECT_THAT(doctor.look().all, IsEmpty());
}

// Stopping the worker is the only way to make it hang from outside; doctor reads a process state
// that hides the stop, or it would find daemon-stopped.
TEST_F(DoctorDaemon, RepairsADaemonThatHangs) {
  DaemonProcess daemon(
      {.config = "[daemon]\nsocket_mode = \"0666\"\nwatchdog_seconds = \"off\"\n"});
  Doctored doctor(daemon.socket_path());
  doctor.overlay()["/proc/" + std::to_string(daemon.pid()) + "/stat"] = "1 (agnocastd) S 1\n";
  daemon.kill_worker(SIGSTOP);
  const Findings findings = doctor.look();
  ASSERT_THAT(findings.ids(), ElementsAre("daemon-silent"));
  const Remedy remedy(findings.remedies[0]);
  EXPECT_TRUE(soon([&] { return run_ctl(daemon.socket_path(), {"status"}).status == 0; }));
  EXPECT_THAT(doctor.look().all, IsEmpty());
}

TEST_F(DoctorDaemon, NamesTheSettingsThatTheHostLacks) {
  DaemonProcess daemon;
  Doctored doctor(daemon.socket_path());
  Node node(daemon.socket_path());
  for (const char* word :
       {"always advise [never]\n", "always within_size advise never [deny] force\n"}) {
    doctor.overlay()[shmem_enabled] = word;
    const Findings findings = doctor.look();
    ASSERT_THAT(findings.ids(), ElementsAre("huge-pages"));
    EXPECT_THAT(findings.remedies[0], HasSubstr("/etc/tmpfiles.d/agnocast-pages.conf"));
    EXPECT_EQ(findings.result.status, 0) << "a warning";
  }
  doctor.overlay()[shmem_enabled] = "always [within_size] advise never\n";
  EXPECT_THAT(doctor.look().all, IsEmpty());
  doctor.overlay()["/proc/sys/vm/max_map_count"] = "30\n";
  const Findings findings = doctor.look();
  EXPECT_THAT(findings.ids(), ElementsAre("mapping-limit"));
  EXPECT_EQ(findings.remedies[0], "sudo sysctl -w vm.max_map_count=262144");
}

TEST_F(DoctorDaemon, ReportsThatReadersCouldKeepThePagesOfAnotherUser) {
  if (::geteuid() != 0) GTEST_SKIP() << "needs root, for a process of another user";
  DaemonProcess daemon({.config = "[daemon]\nsocket_mode = \"0666\"\n"});
  Doctored doctor(daemon.socket_path());
  Node node(daemon.socket_path());
  EXPECT_THAT(doctor.look().all, IsEmpty());
  const Child other([&] {
    if (::setuid(65534) != 0) return 1;
    const Node theirs(daemon.socket_path());
    return sleep_for_ever();
  });
  Findings findings;
  EXPECT_TRUE(soon([&] {
    findings = doctor.look();
    return !findings.all.empty();
  }));
  ASSERT_THAT(findings.ids(), ElementsAre("page-collapse"));
  EXPECT_THAT(findings.remedies[0], HasSubstr("- - - - deny'"));
  EXPECT_EQ(findings.result.status, 0) << "a warning";
  doctor.overlay()[shmem_enabled] = "always advise never [deny]\n";
  EXPECT_THAT(doctor.look().all, IsEmpty()) << "doctor does not ask for huge pages either";
}

}  // namespace
}  // namespace agnocast::test
