// SPDX-License-Identifier: Apache-2.0
//
// Goal: whatever is wrong with this shell or with the way to the daemon, doctor names exactly
// that, and its remedy repairs it. Method: each set-up broken for real, agnocast-ctl as a program
// of its own.

#include <base/sockets/unix_address.hpp>
#include <tests/integration/ctl/ctl_node.hpp>
#include <tests/support/machine/doctored.hpp>
#include <tests/support/wire/listen_at.hpp>
#include <tests/support/wire/proxy_without_descriptors.hpp>

#include <gmock/gmock.h>
#include <grp.h>
#include <sys/resource.h>
#include <sys/stat.h>

#include <fstream>
#include <string>
#include <vector>

namespace agnocast::test {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::StartsWith;
using Node = CtlNode;

constexpr uid_t nobody = 65534;

/// Ends the daemon that a remedy has started; returns whether there was one.
bool end_daemon_at(const std::string& socket) {
  const CtlResult status = run_ctl(socket, {"status", "-j"});
  if (status.status != 0) return false;
  const pid_t worker = status.json()["daemon"]["pid"];
  return ::kill(worker, SIGINT) == 0;
}
bool serves(const std::string& socket) {
  return soon([&] { return run_ctl(socket, {"status"}).status == 0; });
}

class DoctorDoor : public testing::Test {
 protected:
  void SetUp() override {
    if (!Doctored::has_namespaces())
      GTEST_SKIP() << "needs root: a mount namespace and other users";
  }
};

TEST_F(DoctorDoor, FindsNothingInAHealthySystem) {
  DaemonProcess daemon;
  Doctored doctor(daemon.socket_path());
  const Findings findings = doctor.look();
  EXPECT_THAT(findings.all, IsEmpty());
  EXPECT_EQ(findings.result.status, 0) << findings.result.err;
  const CtlResult people = run_ctl(daemon.socket_path(), {"doctor", "-w"}, {}, {}, nullptr);
  EXPECT_THAT(people.out, HasSubstr(" checks passed"));
}

TEST_F(DoctorDoor, ReportsAMissingDaemonAndHowToStartOne) {
  const std::string directory = make_directory(), socket = directory + "/agnocastd.sock";
  Doctored doctor(socket);
  const Findings findings = doctor.look();
  ASSERT_THAT(findings.all,
              ElementsAre("no-daemon: there is no agnocastd: nothing is at " + socket));
  EXPECT_EQ(findings.result.status, 6);
  EXPECT_THAT(findings.result.err, StartsWith("agnocast-ctl: doctor: 1 check failed"));
  const Remedy remedy(findings.remedies[0]);
  EXPECT_TRUE(serves(socket));
  EXPECT_THAT(doctor.look().all, IsEmpty());
  EXPECT_TRUE(end_daemon_at(socket));
  remove_directory(directory);
}

TEST_F(DoctorDoor, ReportsASocketWithoutAListener) {
  DaemonProcess daemon;
  daemon.kill();
  Doctored doctor(daemon.socket_path());
  const Findings findings = doctor.look();
  ASSERT_THAT(findings.ids(), ElementsAre("nobody-listens"));
  const Remedy remedy(findings.remedies[0]);
  EXPECT_TRUE(serves(daemon.socket_path()));
  EXPECT_THAT(doctor.look().all, IsEmpty());
  EXPECT_TRUE(end_daemon_at(daemon.socket_path()));
}

TEST_F(DoctorDoor, ReportsThatAnotherFileIsThere) {
  const std::string directory = make_directory(), path = directory + "/thing";
  std::ofstream(path) << "no socket";
  Doctored doctor(path);
  Findings findings = doctor.look();
  EXPECT_THAT(findings.ids(), ElementsAre("not-a-socket"));
  EXPECT_EQ(findings.remedies[0], "unset AGNOCAST_SOCKET");
  findings = doctor.look({"AGNOCAST_SOCKET"}, {"--socket", path});
  ASSERT_THAT(findings.ids(), ElementsAre("not-a-socket"));
  {
    const Remedy remedy(findings.remedies[0]);
    EXPECT_TRUE(serves(path)) << findings.remedies[0];
    EXPECT_THAT(doctor.look().all, IsEmpty());
    EXPECT_TRUE(end_daemon_at(path));
    EXPECT_TRUE(soon([&] { return ::access(path.c_str(), F_OK) != 0; }));
  }
  ::unlink(path.c_str());
  {
    const UniqueFd other(::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0));
    ASSERT_EQ(::bind(other.get(), unix_address(path)->get(), UnixAddress::size()), 0);
    ASSERT_EQ(::listen(other.get(), 1), 0);
    findings = doctor.look();
    EXPECT_THAT(findings.ids(), ElementsAre("foreign-socket"));
    EXPECT_EQ(findings.remedies[0], "unset AGNOCAST_SOCKET");
    EXPECT_THAT(doctor.look({}, {"--socket", path}).ids(), ElementsAre("foreign-socket"));
  }
  ::unlink(path.c_str());
  {
    const auto mute = listen_at(path);
    ASSERT_TRUE(mute);
    EXPECT_THAT(doctor.look().ids(), ElementsAre("daemon-silent"));
  }
  remove_directory(directory);
}

TEST_F(DoctorDoor, NamesTheMissingGroup) {
  const group* const games = ::getgrnam("games");
  if (games == nullptr) GTEST_SKIP() << "there is no group games here";
  DaemonProcess daemon({.config = "[daemon]\nsocket_mode = \"0660\"\nsocket_group = \"games\"\n"});
  Doctored doctor(daemon.socket_path());
  doctor.set_user(nobody);
  const Findings findings = doctor.look();
  EXPECT_THAT(findings.ids(), ElementsAre("not-in-group"));
  EXPECT_EQ(findings.remedies[0], "sudo usermod -aG games nobody");
  // The state after that command: the shell is older.
  doctor.overlay()["/etc/group"] = "games:x:" + std::to_string(games->gr_gid) + ":nobody\n";
  const Findings later = doctor.look();
  EXPECT_THAT(later.ids(), ElementsAre("group-not-in-shell"));
  EXPECT_EQ(later.remedies[0], "newgrp games");
}

TEST_F(DoctorDoor, NamesThePermissionThatKeepsTheUserOut) {
  DaemonProcess daemon({.config = "[daemon]\nsocket_mode = \"0600\"\n"});
  Doctored doctor(daemon.socket_path());
  doctor.set_user(nobody);
  const Findings findings = doctor.look();
  ASSERT_THAT(findings.ids(), ElementsAre("socket-mode"));
  EXPECT_THAT(findings.remedies[0], HasSubstr("chmod 0660 " + daemon.socket_path()));
  ASSERT_EQ(::chmod(daemon.socket_path().c_str(), 0666), 0);
  EXPECT_THAT(doctor.look().all, IsEmpty());
  ASSERT_EQ(::chmod(daemon.directory().c_str(), 0700), 0);
  const Findings closed = doctor.look();
  ASSERT_THAT(closed.ids(), ElementsAre("directory-closed"));
  EXPECT_EQ(closed.remedies[0], "sudo chmod a+x " + daemon.directory());
  const Remedy remedy(closed.remedies[0]);
  EXPECT_THAT(doctor.look().all, IsEmpty());
}

TEST_F(DoctorDoor, ReportsThatTheDaemonIsStopped) {
  DaemonProcess daemon;
  Doctored doctor(daemon.socket_path());
  ASSERT_EQ(::kill(daemon.pid(), SIGSTOP), 0);
  // Under load it may not have run since, and then counts as running.
  ASSERT_TRUE(soon([&] {
    std::ifstream stat("/proc/" + std::to_string(daemon.pid()) + "/stat");
    std::string line;
    return std::getline(stat, line) && line.find(") T ") != std::string::npos;
  }));
  const Findings findings = doctor.look();
  ASSERT_THAT(findings.ids(), ElementsAre("daemon-stopped"));
  const Remedy remedy(findings.remedies[0]);
  EXPECT_THAT(doctor.look().all, IsEmpty());
}

TEST_F(DoctorDoor, ReportsThatTheDaemonHasAnotherLayout) {
  DaemonProcess daemon({.program = AGNOCAST_TEST_OTHER_DAEMON});
  Doctored doctor(daemon.socket_path());
  const Findings findings = doctor.look();
  ASSERT_THAT(findings.ids(), ElementsAre("other-layout"));
  const Remedy remedy(findings.remedies[0]);
  EXPECT_TRUE(serves(daemon.socket_path()));
  EXPECT_THAT(doctor.look().all, IsEmpty());
  EXPECT_TRUE(end_daemon_at(daemon.socket_path()));
}

TEST_F(DoctorDoor, NamesAListenerThatIsNotTrusted) {
  if (::geteuid() != 0) GTEST_SKIP() << "needs root, for a daemon of another user";
  constexpr uid_t other = 65534;
  DaemonProcess daemon({.uid = other});
  const std::string& path = daemon.socket_path();
  ::unsetenv("AGNOCAST_DAEMON_UID");
  Doctored doctor(path);
  const Findings findings = doctor.look();
  ASSERT_THAT(findings.ids(), ElementsAre("daemon-untrusted"));
  EXPECT_EQ(findings.all[0],
            "daemon-untrusted: user 65534 listens at " + path +
                ", but is neither root, nor this user, nor the user to whom root gave its "
                "directory");
  EXPECT_EQ(findings.remedies[0], "unset AGNOCAST_SOCKET");
  ::setenv("AGNOCAST_DAEMON_UID", "65534", 1);
  EXPECT_THAT(doctor.look().ids(), testing::Not(testing::Contains("daemon-untrusted")));
}

TEST_F(DoctorDoor, ReportsThatNoDescriptorArrivesAndWhy) {
  DaemonProcess daemon;
  const std::string path = daemon.directory() + "/proxy.sock";
  Doctored doctor(path);
  const ProxyWithoutDescriptors proxy(path, daemon.socket_path());
  Findings findings = doctor.look();
  ASSERT_THAT(findings.ids(), ElementsAre("descriptors-withheld"));
  EXPECT_EQ(findings.all[0],
            "descriptors-withheld: connected to " + path + ", but no descriptor arrived");
  EXPECT_EQ(findings.remedies[0], "sudo ss -xlp src " + path);
  const Remedy remedy(findings.remedies[0]);
  EXPECT_EQ(remedy.status(), 0);
  // The kernel's report about a shell with a profile; this kernel need not have such a module.
  const std::string says = "/proc/self/attr/current";
  if (::access(says.c_str(), F_OK) != 0) GTEST_SKIP() << "this kernel has no " << says;
  doctor.overlay()[says] = "/opt/my node (enforce)\n";
  const Findings confined = doctor.look();
  ASSERT_THAT(confined.ids(), ElementsAre("descriptors-withheld"));
  EXPECT_THAT(confined.remedies[0], HasSubstr("grep -rlF '/opt/my node' /etc/apparmor.d"));
  doctor.overlay()[says] = "my-node (enforce)\n";
  findings = doctor.look();
  ASSERT_THAT(findings.ids(), ElementsAre("descriptors-withheld"));
  EXPECT_THAT(findings.remedies[0], HasSubstr("grep -rlF my-node /etc/apparmor.d"));
  EXPECT_THAT(findings.remedies[0], HasSubstr("share/agnocast/apparmor/agnocast"));
  doctor.overlay()[says] = std::string("system_u:system_r:container_t:s0:c1,c2") + '\0';
  findings = doctor.look();
  ASSERT_THAT(findings.ids(), ElementsAre("descriptors-withheld"));
  EXPECT_THAT(findings.remedies[0], HasSubstr("share/agnocast/selinux/agnocast.te"));
  EXPECT_THAT(Doctored(daemon.socket_path()).look().all, IsEmpty()) << "without the proxy";
}

// The kernel drops descriptors for both reasons with the same flag; doctor has to tell them apart.
TEST_F(DoctorDoor, DistinguishesAProfileFromALimitOfOpenFiles) {
  DaemonProcess daemon;
  // The standard three and the connection.
  const CtlResult result = run_ctl(daemon.socket_path(), {"doctor", "-j"}, {}, {}, nullptr, [] {
    ::close_range(3, ~0U, 0);
    const rlimit four{4, 4};
    ::setrlimit(RLIMIT_NOFILE, &four);
  });
  for (const auto& check : result.json()["checks"]) {
    if (check["id"] == "descriptors-short") {
      EXPECT_EQ(check["status"], "failed");
      EXPECT_EQ(check["findings"][0]["remedy"], "ulimit -n 4096");
    } else {
      EXPECT_NE(check["status"], "failed") << check.dump();
    }
  }
  EXPECT_EQ(run_ctl(daemon.socket_path(), {"topic", "list"}, {}, {}, nullptr,
                    [] {
                      const rlimit mended{4096, 4096};
                      ::setrlimit(RLIMIT_NOFILE, &mended);
                    })
                .status,
            0);
}

TEST_F(DoctorDoor, ReportsTooManyObservers) {
  DaemonProcess daemon;
  std::vector<std::unique_ptr<WireClient>> observers;
  for (std::uint32_t i = 0; i < abi::observer_count_max; ++i) {
    observers.push_back(std::make_unique<WireClient>(daemon.socket_path()));
    wire::Observe observe{};
    observe.fingerprint = abi::fingerprint();
    EXPECT_EQ(observers.back()->ask(wire::Opcode::observe, observe).opcode(),
              wire::Opcode::observed);
  }
  Doctored doctor(daemon.socket_path());
  const Findings findings = doctor.look();
  EXPECT_THAT(findings.ids(), ElementsAre("observers"));
  EXPECT_THAT(findings.remedies[0], StartsWith("killall -u "));
  observers.clear();
  EXPECT_TRUE(soon([&] { return doctor.look().all.empty(); }));
}

TEST_F(DoctorDoor, ReportsThatTheShellUsesAnotherDaemonThanTheSystem) {
  DaemonProcess own, systems;
  Doctored doctor(own.socket_path());
  doctor.directories()["/run/agnocast"] = systems.directory() + "/run";
  const Findings findings = doctor.look();
  ASSERT_THAT(findings.ids(), ElementsAre("other-daemon"));
  EXPECT_EQ(findings.remedies[0], "unset AGNOCAST_SOCKET");
  EXPECT_EQ(findings.result.status, 0) << "a warning";
  const CtlResult counted = doctor.look({}, {"-w"}).result;
  EXPECT_EQ(counted.status, 6);
  EXPECT_EQ(counted.err,
            "agnocast-ctl: doctor: 1 check failed, the first of them other-daemon\nhint: unset "
            "AGNOCAST_SOCKET\n");
  EXPECT_THAT(doctor.look({"AGNOCAST_SOCKET"}).all, IsEmpty()) << "unset";
}

TEST_F(DoctorDoor, FindsTheUsersDaemonWithoutARuntimeDirectory) {
  DaemonProcess daemon;
  Doctored doctor(daemon.socket_path());
  const std::string home = "/run/user/" + std::to_string(::geteuid());
  doctor.directories()[home + "/agnocast"] = daemon.directory() + "/run";
  const Findings findings = doctor.look({"AGNOCAST_SOCKET", "XDG_RUNTIME_DIR"});
  ASSERT_THAT(findings.ids(), ElementsAre("no-runtime-directory"));
  EXPECT_EQ(findings.remedies[0], "export XDG_RUNTIME_DIR=" + home);
  EXPECT_THAT(doctor.look({"AGNOCAST_SOCKET", "XDG_RUNTIME_DIR=" + home}).all, IsEmpty());
}

TEST_F(DoctorDoor, NamesTheFaultOfTheDomain) {
  DaemonProcess daemon;
  Doctored doctor(daemon.socket_path());
  for (const std::string domain : {"seven", "233", "7 ", "-1"}) {
    const Findings findings = doctor.look({"ROS_DOMAIN_ID=" + domain});
    EXPECT_THAT(findings.ids(), ElementsAre("domain-invalid")) << domain;
    EXPECT_EQ(findings.result.status, 6);
  }
  Node node(daemon.socket_path(), 7);
  node.publisher("/far");
  const Findings findings = doctor.look();
  ASSERT_THAT(findings.ids(), ElementsAre("domain-elsewhere"));
  EXPECT_EQ(findings.remedies[0], "export ROS_DOMAIN_ID=7");
  EXPECT_THAT(doctor.look({"ROS_DOMAIN_ID=7"}).all, IsEmpty());
}

TEST_F(DoctorDoor, ReportsThatTheShellIsSwitchedOff) {
  DaemonProcess daemon;
  Doctored doctor(daemon.socket_path());
  EXPECT_THAT(doctor.look({"AGNOCAST=off"}).ids(), ElementsAre("switched-off"));
  EXPECT_THAT(doctor.look({"AGNOCAST=of"}).ids(), ElementsAre("switched-off"));
  EXPECT_THAT(doctor.look({"AGNOCAST=on"}).all, IsEmpty());
}

TEST_F(DoctorDoor, NamesTheFaultOfThePreload) {
  DaemonProcess daemon;
  Doctored doctor(daemon.socket_path());
  // The loader reports missing files, and goes on.
  Findings findings = doctor.look({"LD_PRELOAD=/nonexistent/libagnocast_heaphook.so"});
  EXPECT_THAT(findings.ids(), ElementsAre("hook-not-there"));
  findings = doctor.look({"LD_PRELOAD=libjemalloc.so.99:libagnocast_heaphook.so"});
  ASSERT_THAT(findings.ids(), ElementsAre("hook-not-first"));
  EXPECT_EQ(findings.remedies[0], "export LD_PRELOAD=libagnocast_heaphook.so:libjemalloc.so.99");
  EXPECT_THAT(doctor.look({findings.remedies[0].substr(7)}).all, IsEmpty());
}

TEST_F(DoctorDoor, ReportsAWrongConfiguration) {
  DaemonProcess daemon;
  Doctored doctor(daemon.socket_path());
  const std::string file = daemon.directory() + "/agnocastd.toml";
  std::ofstream(file, std::ios::app) << "[limits]\nclint = 3\n";
  const Findings findings = doctor.look();
  ASSERT_THAT(findings.ids(), ElementsAre("configuration-wrong"));
  EXPECT_THAT(findings.all[0], HasSubstr("clint"));
  EXPECT_THAT(findings.remedies[0], HasSubstr("agnocastd --check-config --config " + file));
}

}  // namespace
}  // namespace agnocast::test
