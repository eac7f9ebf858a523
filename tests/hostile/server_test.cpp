// SPDX-License-Identifier: Apache-2.0
//
// Goal: nobody sends a byte to a false daemon of another user: not a process that finds it at the
// named path, not one that had the right daemon there before, not a program with raised rights
// whose environment names it, and not the tool.
// Method: an attacker binds the path, as anybody may in a directory like /tmp, and counts
// connections and received bytes.

#include <tests/hostile/stage.hpp>
#include <tests/support/processes/ctl.hpp>

#include <base/sockets/packet_socket.hpp>

#include <fcntl.h>
#include <sys/stat.h>
#include <sys/statvfs.h>

#include <filesystem>
#include <thread>

namespace agnocast::test {
namespace {

/// A directory in which every user may create files.
class Square {
 public:
  Square() : path_(make_directory()) { EXPECT_EQ(::chmod(path_.c_str(), 01777), 0); }
  ~Square() { remove_directory(path_); }
  std::string socket() const { return path_ + "/agnocastd.sock"; }
  std::string path() const { return path_; }

 private:
  std::string path_;
};

enum : std::size_t { connections, bytes };

/// Listens there, and reads from every connection.
void be_false_daemon(const std::string& path, Attack& attack) {
  auto listener = PacketListener::bind(path);
  ASSERT_TRUE(listener) << listener.error().what;
  ASSERT_TRUE(listener->listen());
  ASSERT_EQ(::chmod(path.c_str(), 0666), 0);
  attack.ready();
  std::vector<PacketSocket> all;
  while (attack.goes_on()) {
    auto next = listener->accept();
    if (next && *next) {
      all.push_back(std::move(**next));
      ++attack.word(connections);
    }
    std::array<std::byte, 4096> buffer{};
    for (const PacketSocket& socket : all) {
      const auto packet = socket.receive(buffer);
      if (packet && packet->kind == Packet::Kind::data) attack.word(bytes) += packet->bytes;
    }
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  ::unlink(path.c_str());
}

std::unique_ptr<SteeredProcess> node(const std::string& socket,
                                     std::vector<std::string> command = {},
                                     std::vector<std::string> variables = {}) {
  if (command.empty()) command = {AGNOCAST_HONEST_NODE, std::to_string(honest_uid)};
  variables.push_back("AGNOCAST_SOCKET=" + socket);
  return std::make_unique<SteeredProcess>(std::move(command), std::move(variables));
}

std::string untrusted() { return sentence_of(Errc::daemon_untrusted); }

TEST(HostileServer, ReceivesNothingFromAProcessThatFindsItAtTheNamedPath) {
  AGNOCAST_NEEDS_TWO_USERS();
  const Square square;
  Attacker attacker([&](Attack& attack) { be_false_daemon(square.socket(), attack); });
  if (!attacker.wait_until_ready()) return attacker.end();
  // An ordinary user, and root itself.
  for (const uid_t uid : {honest_uid, uid_t{0}}) {
    const auto victim = node(square.socket(), {AGNOCAST_HONEST_NODE, std::to_string(uid)});
    const std::string answer = victim->ask("create /named");
    EXPECT_EQ(answer, untrusted());
  }
  const auto doctor = run_ctl(square.socket(), {"doctor"});
  EXPECT_NE(doctor.out.find("daemon-untrusted"), std::string::npos) << doctor.out;
  EXPECT_NE(doctor.out.find(std::to_string(hostile_uid)), std::string::npos) << doctor.out;
  const auto status = run_ctl(square.socket(), {"status"});
  EXPECT_NE(status.status, 0);
  EXPECT_NE(status.err.find(untrusted()), std::string::npos) << status.err;
  EXPECT_TRUE(eventually([&] { return attacker.word(connections) >= 4; }));
  EXPECT_EQ(attacker.word(bytes), 0u);
  // A process that names that user as the daemon's uid does connect.
  const auto confiding =
      node(square.socket(), {}, {"AGNOCAST_DAEMON_UID=" + std::to_string(hostile_uid)});
  confiding->tell("create /confided");
  EXPECT_TRUE(eventually([&] { return attacker.word(bytes) > 0; }));
  attacker.end();
}

TEST(HostileServer, IsNotTakenForThePreviousDaemon) {
  AGNOCAST_NEEDS_TWO_USERS();
  const Square square;
  // Its lock and its doorbells, too, lie in a directory that everybody may write.
  auto daemon = std::make_unique<DaemonProcess>(DaemonOptions{
      .config =
          "[daemon]\nsocket_mode = \"0666\"\n"
          "[heap]\nwindow_bytes = \"64MiB\"\narena_bytes = \"4GiB\"\n" AGNOCAST_TEST_ARENA_BASE,
      .socket = square.socket()});
  const auto victim = node(square.socket());
  ASSERT_EQ(victim->ask("create /before"), "ok");
  EXPECT_EQ(daemon->stop(), 0);
  daemon.reset();
  Attacker attacker([&](Attack& attack) { be_false_daemon(square.socket(), attack); });
  if (!attacker.wait_until_ready()) return attacker.end();
  EXPECT_TRUE(eventually([&] { return attacker.word(connections) > 0; }));
  EXPECT_TRUE(victim->eventually("create /meanwhile", untrusted()));
  EXPECT_EQ(attacker.word(bytes), 0u);
  attacker.end();
  // The right daemon again: the process rejoins by itself.
  DaemonProcess next(
      {.config =
           "[daemon]\nsocket_mode = \"0666\"\n"
           "[heap]\nwindow_bytes = \"64MiB\"\narena_bytes = \"4GiB\"\n" AGNOCAST_TEST_ARENA_BASE,
       .socket = square.socket()});
  EXPECT_TRUE(eventually([&] { return victim->ask("create /after") == "ok"; }));
}

TEST(HostileServer, CannotBeNamedByTheEnvironmentOfAProgramWithRaisedRights) {
  AGNOCAST_NEEDS_TWO_USERS();
  const Square square;
  struct statvfs system {};
  ASSERT_EQ(::statvfs(square.path().c_str(), &system), 0);
  if ((system.f_flag & (ST_NOSUID | ST_NOEXEC)) != 0)
    GTEST_SKIP() << "set-uid programs have no effect in " << square.path();
  if (::access("/usr/bin/setpriv", X_OK) != 0) GTEST_SKIP() << "needs setpriv";
  const std::string program = square.path() + "/node";
  std::filesystem::copy_file(AGNOCAST_HONEST_NODE, program);
  ASSERT_EQ(::chown(program.c_str(), honest_uid, honest_uid), 0);
  ASSERT_EQ(::chmod(program.c_str(), 04755), 0);
  Attacker attacker([&](Attack& attack) { be_false_daemon(square.socket(), attack); });
  if (!attacker.wait_until_ready()) return attacker.end();
  const std::string user = std::to_string(hostile_uid);
  const std::vector<std::string> as_attacker{
      "/usr/bin/setpriv", "--reuid=" + user, "--regid=" + user, "--clear-groups", program, "0"};
  const auto victim =
      node(square.socket(), as_attacker,
           {"AGNOCAST_DAEMON_UID=" + user, "XDG_RUNTIME_DIR=" + square.path(), "ROS_DOMAIN_ID=0"});
  const std::string answer = victim->ask("create /raised");
  EXPECT_NE(answer, "ok");
  EXPECT_EQ(attacker.word(connections), 0u) << answer;
  EXPECT_EQ(attacker.word(bytes), 0u);
  // Nor does the process that starts it choose its domain.
  const auto elsewhere = node(square.socket(), as_attacker, {"ROS_DOMAIN_ID=7"});
  EXPECT_EQ(elsewhere->ask("create /raised"), sentence_of(Errc::invalid_argument));
  attacker.end();
}

}  // namespace
}  // namespace agnocast::test
