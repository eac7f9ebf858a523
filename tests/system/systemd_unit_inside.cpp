// SPDX-License-Identifier: Apache-2.0
//
// Goal: the restrictions of the unit (capabilities, namespaces, file systems) break none of the
// daemon's tasks, and systemd's journal has the log. Method: as systemd_inside.cpp.

#include <tests/support/machine/immutable_memory.hpp>
#include <tests/system/systemd_inside.hpp>

#include <cstring>

namespace agnocast::test {
namespace {

// --- the restrictions of the unit

TEST(Systemd, SeesHowManyMappingsAProcessMayHave) {
  ASSERT_TRUE(systemctl("start"));
  const auto count_in = [](const std::string& root) {
    std::uint64_t count = 0;
    std::ifstream(root + "/proc/sys/vm/max_map_count") >> count;
    return count;
  };
  EXPECT_EQ(count_in("/proc/" + std::to_string(main_pid()) + "/root"), count_in(""));
  EXPECT_GT(count_in(""), 0u);
}

// It has the capability for this, where the kernel supports such files.
TEST(Systemd, ForbidsHolesInRegions) {
  if (const int error = kernel_refuses_immutable_memory())
    GTEST_SKIP() << "it needs Linux 6.0 and CAP_LINUX_IMMUTABLE: " << std::strerror(error);
  ASSERT_TRUE(systemctl("restart", "agnocastd"));
  EXPECT_EQ(said("holes are allowed"), 0u);
}

// /proc/PID/maps shows whether a disconnected process still maps memory; its user and processes
// that may trace it can read it. The process lives, so there is no other sign.
TEST(Systemd, SeesThatAProcessOfAnotherUserHasUnmapped) {
  ASSERT_TRUE(systemctl("start"));
  const passwd* const user = ::getpwnam(two);
  ASSERT_NE(user, nullptr);
  const uid_t uid = user->pw_uid;
  const std::size_t before = wire_dump(socket_path).processes.size();
  Child process(0, [&](int commands, std::uint64_t) {
    ::prctl(PR_SET_PDEATHSIG, SIGKILL);
    auto node = std::make_unique<WireNode>(socket_path);
    if (::setgid(uid) != 0 || ::setuid(uid) != 0) ::_exit(3);
    // Owned by its user again, as for any process that was this user's from the beginning.
    ::prctl(PR_SET_DUMPABLE, 1);
    serve(commands, [&](char) -> char {
      node.reset();
      return '+';
    });
  });
  EXPECT_TRUE(soon([&] { return wire_dump(socket_path).processes.size() == before + 1; }));
  ASSERT_EQ(process.command('l'), '+');
  EXPECT_TRUE(soon([&] { return wire_dump(socket_path).processes.size() == before; }));
}

TEST(Systemd, ServesAndRepairsUsersInOtherPidAndNetworkNamespaces) {
  ASSERT_TRUE(stop_both());
  ASSERT_TRUE(systemctl("start"));
  UserNode subscriber(one, {"/usr/bin/unshare", "--net"});
  UserNode publisher(two, {"/usr/bin/unshare", "--pid", "--net", "--fork"});
  ASSERT_EQ(subscriber.ask("subscribe /stream"), "ok");
  ASSERT_EQ(publisher.ask("publish /stream"), "ok");
  EXPECT_TRUE(soon([&] { return subscriber.state().received >= 50; }));
  EXPECT_EQ(wire_dump(socket_path).processes.size(), 2u);
  const std::size_t gone = said("client gone");
  ASSERT_EQ(send(pid_in(wire_dump(socket_path), two), SIGKILL), 0);
  EXPECT_TRUE(soon([&] { return said("client gone") == gone + 1; }));
  EXPECT_EQ(subscriber.state().wrong, 0u);
}

TEST(Systemd, EntriesOfTheJournalAreFoundByTheirFieldsAndExplained) {
  ASSERT_TRUE(stop_both());
  ASSERT_EQ(std::system("journalctl --update-catalog"), 0);
  ASSERT_TRUE(systemctl("start"));
  WireClient client(socket_path);
  ASSERT_EQ(client.hello().opcode(), wire::Opcode::welcome);
  const std::string topic = "/found_" + std::to_string(::getpid());
  client.ask(wire::Opcode::create_publisher, WireClient::endpoint(topic, {5}, "test/msg/Type"));
  auto other = WireClient::endpoint(topic, {5}, "other/msg/Type");
  ASSERT_EQ(client.ask(wire::Opcode::create_publisher, other).refused_code(), Errc::type_mismatch);
  const std::string found = "journalctl --no-pager -u agnocastd AGNOCAST_TOPIC=" + topic +
                            " AGNOCAST_CODE=type_mismatch ";
  EXPECT_TRUE(soon([&] { return !output_of(found + "-q -o cat").empty(); }));
  EXPECT_NE(
      output_of(found + "-o json").find("\"AGNOCAST_PID\":\"" + std::to_string(::getpid()) + '"'),
      std::string::npos)
      << output_of(found + "-o json");
  const std::string explained = output_of(found + "-x");
  EXPECT_NE(explained.find("agnocast-ctl explain type_mismatch"), std::string::npos) << explained;
  const std::string level = output_of(
      "agnocast-ctl log-level debug >/dev/null && agnocast-ctl topic list >/dev/null; "
      "journalctl --no-pager -u agnocastd AGNOCAST_EVENT=observer -o cat | tail -n 1");
  EXPECT_NE(level.find("observer pid="), std::string::npos) << "changed while it runs: " << level;
  EXPECT_EQ(std::system("agnocast-ctl log-level info >/dev/null"), 0);
}

TEST(Systemd, RevokesAProcessOfAUser) {
  ASSERT_TRUE(stop_both());
  ASSERT_TRUE(systemctl("start"));
  UserNode stays(one), goes(two);
  ASSERT_EQ(stays.ask("subscribe /stream"), "ok");
  ASSERT_EQ(goes.ask("publish /stream"), "ok");
  const WireDump all = wire_dump(socket_path);
  ASSERT_EQ(all.processes.size(), 2u);
  EXPECT_EQ(std::system(("/usr/bin/agnocast-ctl process revoke " +
                         std::to_string(pid_in(all, two)) + " >/dev/null")
                            .c_str()),
            0);
  EXPECT_TRUE(soon([] { return said("client revoked") >= 1; }));
  EXPECT_EQ(stays.ask("create /more"), "ok");
  EXPECT_NE(goes.ask("create /more"), "ok");
}

// As a user would copy it. Its library path is the test's: the libraries of ROS messages are not
// installed here.
TEST(Systemd, TheExampleOfANodeServesAUserThatCameFirst) {
  if (!exists("/usr/bin/talker"))
    GTEST_SKIP() << "the examples are not built: std_msgs is not found";
  namespace fs = std::filesystem;
  fs::copy(AGNOCAST_INSIDE_DOCS "/systemd/examples/node.service",
           "/run/systemd/system/node.service");
  fs::create_directories("/run/systemd/system/node.service.d");
  std::ofstream("/run/systemd/system/node.service.d/test.conf")
      << "[Service]\nEnvironment=LD_LIBRARY_PATH=/opt/agnocast/lib\n";
  ASSERT_TRUE(stop_both());
  ASSERT_TRUE(systemctl("daemon-reload", ""));
  ASSERT_TRUE(systemctl("start", "node"));
  EXPECT_TRUE(soon([] { return property("ActiveState") == "active"; }))
      << "the node started the daemon";
  EXPECT_TRUE(soon([] { return wire_dump(socket_path).endpoints.size() == 1; }))
      << output_of("journalctl -u node --no-pager -o cat | tail");
  EXPECT_EQ(std::to_string(pid_in(wire_dump(socket_path), "robot")),
            output_of("systemctl show --value -p MainPID node"));
  EXPECT_TRUE(systemctl("stop", "node"));
  EXPECT_TRUE(soon([] { return wire_dump(socket_path).processes.empty(); }));
  fs::remove("/run/systemd/system/node.service");
  fs::remove_all("/run/systemd/system/node.service.d");
  EXPECT_TRUE(systemctl("daemon-reload", ""));
}

/// Returns the complaints of `systemd-analyze` about these, with its status.
std::string complaints(const std::string& arguments) {
  return output_of("systemd-analyze " + arguments + " 2>&1 || echo failed");
}

TEST(Systemd, FindsNothingToCriticizeInTheUnitsAndTheExamples) {
  const std::string units = "/usr/lib/systemd/system/agnocastd.";
  EXPECT_EQ(complaints("verify " + units + "service " + units + "socket"), "");
  namespace fs = std::filesystem;
  const std::string examples = AGNOCAST_INSIDE_DOCS "/systemd/examples/",
                    etc = "/etc/systemd/system/";
  if (!exists("/usr/bin/talker"))
    GTEST_SKIP() << "the examples are not built: std_msgs is not found";
  fs::copy(examples + "node.service", etc + "node.service");
  fs::create_directories(etc + "node.service.d");
  for (const char* const name : {"lock-limit.conf", "real-time.conf"})
    fs::copy(examples + name, etc + "node.service.d/" + name);
  fs::create_directories(etc + "agnocastd.service.d");
  fs::copy(examples + "daemon-real-time.conf", etc + "agnocastd.service.d/real-time.conf");
  EXPECT_EQ(complaints("verify " + etc + "node.service " + units + "service"), "");
  fs::remove_all(etc + "node.service");
  fs::remove_all(etc + "node.service.d");
  fs::remove_all(etc + "agnocastd.service.d");
  // Without a line that applies here, it only parses the file: /sys is the host's.
  EXPECT_EQ(
      output_of("systemd-tmpfiles --create --prefix=/nowhere " + examples + "huge-pages.conf 2>&1"),
      "");
  EXPECT_EQ(output_of("systemd-analyze cat-config tmpfiles.d | grep -x 'x /run/agnocast'"),
            "x /run/agnocast");
}

TEST(Systemd, IsExposedNoMoreThanTheDocumentSays) {
  std::ifstream document(AGNOCAST_INSIDE_DOCS "/docs/agnocastd.md");
  std::stringstream text;
  text << document.rdbuf();
  const std::string words = "exposure level ";
  const std::size_t at = text.str().find(words);
  ASSERT_NE(at, std::string::npos);
  const double stated = std::stod(text.str().substr(at + words.size()));
  const auto check = [](int tenths) {
    return complaints("security --offline=true --no-pager --threshold=" + std::to_string(tenths) +
                      " /usr/lib/systemd/system/agnocastd.service");
  };
  const int tenths = static_cast<int>(stated * 10 + 0.5);
  EXPECT_EQ(check(tenths).find("failed"), std::string::npos) << check(tenths);
  EXPECT_NE(check(tenths - 1).find("failed"), std::string::npos)
      << "the exposure is lower than documented";
}

}  // namespace
}  // namespace agnocast::test
