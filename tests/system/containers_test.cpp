// SPDX-License-Identifier: Apache-2.0
//
// Goal: containers of different users, which share nothing but the *directory* of the socket,
// exchange messages without a copy as processes of the host do: at the same addresses, over a
// restart of the daemon, with later containers; a death in one leaves nothing. agnocast-ctl works
// outside and inside.
// Method: the daemon on the host; client tools as process 1 of their own namespaces (mount with an
// empty root, IPC, PID, UTS, network, once also user); /proc shows the kernel's mappings.

#include <agnocast/error.hpp>
#include <tests/support/machine/container.hpp>
#include <tests/support/processes/client_tool.hpp>
#include <tests/support/processes/ctl.hpp>
#include <tests/support/processes/daemon_process.hpp>

#include <gmock/gmock.h>
#include <grp.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <fstream>
#include <map>
#include <optional>
#include <sstream>
#include <string>
#include <vector>

namespace agnocast::test {
namespace {

using testing::ElementsAre;
using testing::StartsWith;

constexpr uid_t lidar = 61001, viewer = 61002, stranger = 61003;
// The client's default path; and another one.
constexpr const char* usual_place = "/run/agnocast";
constexpr const char* other_place = "/sockets";

const char* const configuration =
    "[daemon]\nsocket_mode = \"0660\"\nsocket_group = \"games\"\n"
    "[heap]\nwindow_bytes = \"64MiB\"\narena_bytes = \"64GiB\"\n"
    "[[access]]\ntopic = \"/points\"\npublish = [\"uid:61001\"]\n";

std::string directory_of(const std::string& path) { return path.substr(0, path.rfind('/')); }

/// Returns the file's identity: a new file may get the number of a removed one.
std::string identity_of(const std::string& path) {
  struct stat file {};
  if (::stat(path.c_str(), &file) != 0) return {};
  return std::to_string(file.st_ino) + ' ' + std::to_string(file.st_ctim.tv_sec) + ' ' +
         std::to_string(file.st_ctim.tv_nsec);
}

/// A line of /proc/PID/maps.
struct Mapped {
  std::string rights, inode, what;
};
std::optional<Mapped> mapped_at(pid_t pid, std::uint64_t address) {
  std::ifstream maps("/proc/" + std::to_string(pid) + "/maps");
  for (std::string line; std::getline(maps, line);) {
    std::uint64_t first = 0, end = 0;
    char dash = 0;
    std::istringstream words(line);
    words >> std::hex >> first >> dash >> end;
    if (address < first || address >= end) continue;
    Mapped mapped;
    std::string offset, device;
    words >> mapped.rights >> offset >> device >> mapped.inode;
    std::getline(words >> std::ws, mapped.what);
    return mapped;
  }
  return std::nullopt;
}

class Containers : public testing::TestWithParam<bool> {
 protected:
  void SetUp() override {
    if (!Container::is_possible())
      GTEST_SKIP() << "needs root that may create mount, PID, IPC, UTS and network namespaces";
    if (::getgrnam("games") == nullptr) GTEST_SKIP() << "there is no group games here";
    if (GetParam() && !Container::is_possible(true))
      GTEST_SKIP() << "users may not create user namespaces here, or may not mount /proc in them";
    daemon_.emplace(DaemonOptions{.config = configuration});
    directory_ = directory_of(daemon_->socket_path());
  }
  /// In the socket's group, with the socket's directory at the client's default path.
  ContainerOptions options(uid_t uid) const {
    return {.uid = uid,
            .groups = {::getgrnam("games")->gr_gid},
            .mounts = {{directory_, usual_place}},
            .environment = {"AGNOCAST_SOCKET="},
            .has_user_namespace = GetParam()};
  }
  /// Returns pids and users, as the daemon sees them.
  std::map<pid_t, uid_t> members() const {
    std::map<pid_t, uid_t> all;
    const auto listed = run_ctl(daemon_->socket_path(), {"process", "list", "-j"}).json();
    for (const auto& process : listed["processes"]) all[process["pid"]] = process["uid"];
    return all;
  }

  std::optional<DaemonProcess> daemon_;
  std::string directory_;
};

std::string take_all(Container& subscriber) {
  std::string numbers;
  for (;;) {
    const std::string number = subscriber->ask("take");
    if (number == "none") return numbers;
    numbers += number + ' ';
    EXPECT_EQ(subscriber->ask("release"), "ok");
  }
}

// Long because the containers of one story go through all of its steps.
TEST_P(Containers, OfDifferentUsersTalkThroughTheSocketsDirectoryAlsoAfterARestart) {
  Container publisher({AGNOCAST_CLIENT_TOOL}, options(lidar));
  ContainerOptions elsewhere = options(viewer);
  elsewhere.mounts[0].second = other_place;
  elsewhere.environment = {"AGNOCAST_SOCKET=" + std::string(other_place) + "/agnocastd.sock"};
  Container subscriber({AGNOCAST_CLIENT_TOOL}, elsewhere);
  ASSERT_EQ(subscriber->ask("sub /points 20"), "ok");
  ASSERT_EQ(publisher->ask("pub /points 20"), "ok");
  ASSERT_TRUE(publisher->eventually("matched", "1"));

  // They share no namespace: each one is the process's own.
  for (const char* kind : {"mnt", "ipc", "pid", "uts", "net"}) {
    std::vector<std::string> all;
    for (const std::string& process :
         {std::string("self"), std::to_string(publisher.pid()), std::to_string(subscriber.pid())}) {
      char name[64] = "";
      EXPECT_GT(::readlink(("/proc/" + process + "/ns/" + kind).c_str(), name, sizeof name - 1), 0);
      EXPECT_EQ(std::count(all.begin(), all.end(), name), 0) << kind << " of " << process;
      all.emplace_back(name);
    }
  }
  EXPECT_EQ(members(),
            (std::map<pid_t, uid_t>{{publisher.pid(), lidar}, {subscriber.pid(), viewer}}))
      << "with pids of the host";

  ASSERT_EQ(publisher->ask("publish 5 1000"), "ok");
  ASSERT_EQ(subscriber->ask("wait 10000"), "news");
  ASSERT_EQ(subscriber->ask("take"), "1");
  // The same memory at the same address: written there, read only here.
  const std::uint64_t address = std::stoull(subscriber->ask("address"));
  const auto there = mapped_at(publisher.pid(), address),
             here = mapped_at(subscriber.pid(), address);
  ASSERT_TRUE(there && here);
  EXPECT_EQ(there->rights, "rw-s");
  EXPECT_EQ(here->rights, "r--s");
  EXPECT_EQ(there->inode, here->inode);
  EXPECT_THAT(here->what, StartsWith("/memfd:agnocast"));
  ASSERT_EQ(subscriber->ask("release"), "ok");
  EXPECT_EQ(take_all(subscriber), "2 3 4 5 ");

  // The daemon dies, and the next one continues its state.
  ASSERT_TRUE(daemon_->wait_for_next(daemon_->kill_worker()));
  ASSERT_EQ(publisher->ask("publish 2 1000"), "ok");
  ASSERT_EQ(subscriber->ask("wait 10000"), "news");
  EXPECT_EQ(take_all(subscriber), "6 7 ");

  // The daemon dies with its store: the next one creates another socket in the directory.
  const std::string before = identity_of(daemon_->socket_path());
  daemon_->kill();
  ASSERT_EQ(publisher->ask("publish 1 1000"), "ok") << "messages need no daemon";
  EXPECT_EQ(subscriber->ask("wait 10000"), "news");
  EXPECT_EQ(take_all(subscriber), "8 ");
  const DaemonProcess next({.config = configuration, .socket = daemon_->socket_path()});
  ASSERT_NE(identity_of(daemon_->socket_path()), before);
  for (Container* const one : {&publisher, &subscriber})
    ASSERT_TRUE((*one)->eventually("state", "connected")) << (*one)->ask("state");

  // A later container finds it as well.
  Container late({AGNOCAST_CLIENT_TOOL}, options(viewer));
  ASSERT_EQ(late->ask("sub /points 20"), "ok");
  ASSERT_TRUE(publisher->eventually("matched", "2"));
  ASSERT_EQ(publisher->ask("publish 3 1000"), "ok");
  for (Container* const one : {&subscriber, &late}) {
    ASSERT_EQ((*one)->ask("wait 10000"), "news");
    EXPECT_EQ(take_all(*one), "9 10 11 ");
  }
  EXPECT_EQ(subscriber->ask("lost"), "0");

  // The host frees a dead process of a container, with its held messages.
  ASSERT_EQ(publisher->ask("publish 20 1000"), "ok");
  ASSERT_EQ(late->ask("take"), "12");
  ASSERT_EQ(publisher->ask("publish 20 1000"), "ok");
  ASSERT_TRUE(publisher->eventually("allocated", "21")) << "the newest 20, and the held one";
  late.kill_inside();
  EXPECT_TRUE(eventually([&] { return members().size() == 2; }));
  EXPECT_TRUE(publisher->eventually("matched", "1"));
  ASSERT_EQ(publisher->ask("publish 1 1000"), "ok");
  EXPECT_TRUE(publisher->eventually("allocated", "20")) << publisher->ask("allocated");
}

TEST_P(Containers, ReportWhatTheSocketAndTheRulesForbid) {
  ContainerOptions of_stranger = options(stranger);
  of_stranger.groups.clear();
  Container outside({AGNOCAST_CLIENT_TOOL}, of_stranger);
  EXPECT_THAT(outside->ask("sub /points 1"),
              StartsWith("error " + std::to_string(static_cast<int>(Errc::permission_denied))));
  Container subscriber({AGNOCAST_CLIENT_TOOL}, options(viewer));
  EXPECT_THAT(subscriber->ask("pub /points 1"),
              StartsWith("error " + std::to_string(static_cast<int>(Errc::access_denied))));
  EXPECT_TRUE(daemon_->wait_for_log("uid=61002 topic=/points code=access_denied"));
}

TEST_P(Containers, ShowTheSameSystemFromInside) {
  Container publisher({AGNOCAST_CLIENT_TOOL}, options(lidar));
  ASSERT_EQ(publisher->ask("pub /points 1"), "ok");
  Container shell({"/bin/sh"}, options(viewer));
  const auto ask = [&](const std::string& words) {
    const std::string answer = shell->ask(AGNOCAST_TEST_CTL " " + words + " --json=short 2>&1");
    const auto parsed = nlohmann::json::parse(answer, nullptr, false);
    EXPECT_FALSE(parsed.is_discarded()) << answer;
    return parsed;
  };
  const auto listed = ask("process list")["processes"];
  ASSERT_EQ(listed.size(), 1u);
  EXPECT_EQ(listed[0]["pid"], publisher.pid()) << "as the daemon sees it";
  EXPECT_EQ(listed[0]["uid"], lidar);
  const auto access = ask("access /points");
  EXPECT_EQ(access["publish"]["who"][0]["id"], lidar);
  EXPECT_EQ(access["socket"]["path"], std::string(usual_place) + "/agnocastd.sock");
  for (const auto& check : ask("doctor")["checks"])
    EXPECT_TRUE(check["status"] != "failed") << check.dump();
}

// A mounted file stays the old socket; a mounted directory has the current one.
TEST_P(Containers, WithTheSocketFileLoseTheDaemonAtARestartAndDoctorReportsIt) {
  ContainerOptions with_file = options(viewer);
  with_file.mounts = {{daemon_->socket_path(), std::string(usual_place) + "/agnocastd.sock"}};
  Container file({"/bin/sh"}, with_file), directory({"/bin/sh"}, options(viewer));
  // Root looks like nobody from inside, and the directory of a mounted file proves nothing.
  if (GetParam()) {
    ASSERT_EQ(file->ask("export AGNOCAST_DAEMON_UID=65534; echo ok"), "ok");
  }
  const auto found_in = [](Container& container) {
    std::vector<std::string> found;
    const auto report = nlohmann::json::parse(
        container->ask(AGNOCAST_TEST_CTL " doctor --json=short 2>/dev/null"), nullptr, false);
    for (const auto& check : report["checks"]) {
      if (check["status"] == "failed") found.push_back(check["id"]);
    }
    return found;
  };
  EXPECT_THAT(found_in(file), ElementsAre()) << "as long as the daemon keeps its socket";
  daemon_->kill();
  EXPECT_THAT(found_in(directory), ElementsAre("nobody-listens"));
  const DaemonProcess next({.config = configuration, .socket = daemon_->socket_path()});
  EXPECT_THAT(found_in(file), ElementsAre("socket-mounted"));
  EXPECT_THAT(found_in(directory), ElementsAre()) << "as the remedy says";
}

INSTANTIATE_TEST_SUITE_P(Rootful, Containers, testing::Values(false));
INSTANTIATE_TEST_SUITE_P(Rootless, Containers, testing::Values(true));

}  // namespace
}  // namespace agnocast::test
