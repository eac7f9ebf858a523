// SPDX-License-Identifier: Apache-2.0
//
// Goal: agnocastd starts where it can, reports in one clear line why it does not where it cannot,
// and leaves nothing behind at its end. Method: the real program; exact text and exit status.

#include <base/sockets/packet_socket.hpp>
#include <tests/support/processes/child.hpp>
#include <tests/support/processes/daemon_process.hpp>
#include <tests/support/wire/listen_at.hpp>
#include <tests/support/wire/wire_client.hpp>
#include <tests/support/wire/wire_dump.hpp>

#include <fcntl.h>
#include <gtest/gtest.h>
#include <sys/file.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <unistd.h>

#include <atomic>
#include <chrono>
#include <csignal>
#include <cstdint>
#include <cstdlib>
#include <filesystem>
#include <fstream>

namespace agnocast::test {
namespace {

constexpr uid_t other_uid = 65534;

class Directory {
 public:
  Directory() : path_(make_directory()) {}
  ~Directory() { remove_directory(path_); }
  Directory(const Directory&) = delete;
  Directory& operator=(const Directory&) = delete;
  std::string operator/(const std::string& name) const { return path_ + "/" + name; }
  const std::string& path() const { return path_; }

 private:
  std::string path_;
};

void write_file(const std::string& path, const std::string& text) { std::ofstream(path) << text; }
bool exists(const std::string& path) {
  struct stat entry {};
  return ::lstat(path.c_str(), &entry) == 0;
}
mode_t mode_of(const std::string& path) {
  struct stat entry {};
  return ::lstat(path.c_str(), &entry) == 0 ? entry.st_mode & 07777 : 0;
}

TEST(DaemonStart, CreatesDirectoryAndSocketWithTheirModesAndRemovesTheSocketAtItsEnd) {
  for (const int signal : {SIGTERM, SIGINT}) {
    DaemonProcess daemon({.config = "[daemon]\nsocket_mode = \"0640\"\n"});
    const std::string run = daemon.directory() + "/run";
    EXPECT_EQ(mode_of(run), 0755u);
    EXPECT_EQ(mode_of(daemon.socket_path()), 0640u);
    EXPECT_EQ(mode_of(run + "/agnocastd.sock.bells"), 0700u);
    EXPECT_TRUE(PacketSocket::connect(daemon.socket_path()));
    EXPECT_EQ(daemon.stop(signal), 0) << daemon.log();
    EXPECT_FALSE(exists(daemon.socket_path()));
    EXPECT_FALSE(exists(run + "/agnocastd.sock.bells"));
    EXPECT_NE(daemon.log().find("ready"), std::string::npos);
    EXPECT_NE(daemon.log().find("ended"), std::string::npos);
  }
}

TEST(DaemonStart, TakesThePlaceOfOneThatWasKilled) {
  Directory directory;
  const std::string socket = directory / "run/agnocastd.sock";
  std::string left;
  {
    DaemonProcess first;
    first.kill();
    // Its remains: a socket without a listener, a lock without an owner, a directory of doorbells.
    left = first.directory() + "/run";
    ASSERT_TRUE(exists(first.socket_path()));
    std::filesystem::rename(left, directory / "run");
  }
  ASSERT_TRUE(exists(socket));
  ::chmod(directory.path().c_str(), 0755);
  DaemonProcess second({.socket = socket});
  EXPECT_TRUE(PacketSocket::connect(socket));
}

TEST(DaemonStart, ReportsThatAnotherOneIsRunning) {
  DaemonProcess daemon;
  const Ended second = run_daemon({"--socket", daemon.socket_path()});
  EXPECT_EQ(second.status, 1);
  EXPECT_EQ(second.err, "agnocastd: another agnocastd is running at " + daemon.socket_path() +
                            "\nhint: stop it, or start this one with another --socket\n");
  EXPECT_TRUE(PacketSocket::connect(daemon.socket_path())) << "the first one goes on";
  EXPECT_TRUE(daemon.is_running());
}

TEST(DaemonStart, DoesNotTakeThePlaceOfOneWhoseSocketWasRemoved) {
  DaemonProcess daemon;
  ASSERT_EQ(::unlink(daemon.socket_path().c_str()), 0);
  const Ended second = run_daemon({"--socket", daemon.socket_path()});
  EXPECT_EQ(second.status, 1);
  EXPECT_EQ(second.err.substr(0, second.err.find('\n')),
            "agnocastd: another agnocastd is running at " + daemon.socket_path());
}

TEST(DaemonStart, LeavesTheSocketOfAnotherListenerAlone) {
  Directory directory;
  const std::string path = directory / "agnocastd.sock";
  const auto listener = test::listen_at(path);
  ASSERT_TRUE(listener);
  const Ended ended = run_daemon({"--socket", path});
  EXPECT_EQ(ended.status, 1);
  EXPECT_EQ(ended.err.substr(0, ended.err.find('\n')),
            "agnocastd: another agnocastd is running at " + path);
  EXPECT_TRUE(exists(path));
}

TEST(DaemonStart, DoesNotReplaceAFileThatIsNoSocket) {
  Directory directory;
  const std::string path = directory / "agnocastd.sock";
  write_file(path, "precious");
  const Ended ended = run_daemon({"--socket", path});
  EXPECT_EQ(ended.status, 1);
  EXPECT_EQ(ended.err.substr(0, ended.err.find('\n')),
            "agnocastd: cannot use " + path + ": it exists and is not a socket");
  std::string content;
  std::getline(std::ifstream(path), content);
  EXPECT_EQ(content, "precious");
}

TEST(DaemonStart, ReportsAnUnusableDirectory) {
  Directory directory;
  const auto first_line = [](const Ended& ended) {
    return ended.err.substr(0, ended.err.find('\n'));
  };
  const Ended missing = run_daemon({"--socket", directory / "no/such/agnocastd.sock"});
  EXPECT_EQ(missing.status, 1);
  EXPECT_EQ(first_line(missing), "agnocastd: cannot make directory " + (directory / "no/such") +
                                     ": No such file or directory");
  write_file(directory / "file", "");
  const Ended file = run_daemon({"--socket", directory / "file/agnocastd.sock"});
  EXPECT_EQ(file.status, 1);
  EXPECT_EQ(first_line(file),
            "agnocastd: cannot use " + (directory / "file") + ": it is not a directory");
  std::filesystem::create_directory(directory / "open");
  ::chmod((directory / "open").c_str(), 0777);
  const Ended open = run_daemon({"--socket", directory / "open/agnocastd.sock"});
  EXPECT_EQ(open.status, 1);
  EXPECT_EQ(first_line(open), "agnocastd: cannot use directory " + (directory / "open") +
                                  ": others may write there and could replace the socket");
  if (::geteuid() != 0) GTEST_SKIP() << "the rest needs root";
  std::filesystem::create_directory(directory / "roots");
  const Ended denied = run_daemon({"--socket", directory / "roots/agnocastd.sock"}, other_uid);
  EXPECT_EQ(denied.status, 1);
  EXPECT_EQ(first_line(denied), "agnocastd: cannot write in directory " + (directory / "roots") +
                                    ": Permission denied");
}

// /tmp and the like: every user may create names there, and none may remove another user's.
TEST(DaemonStart, UsesAndChangesNoFileOfAnotherUser) {
  if (::geteuid() != 0) GTEST_SKIP() << "needs root";
  const auto content = [](const std::string& path) {
    std::string text;
    std::getline(std::ifstream(path), text);
    return text;
  };
  Directory directory;
  ::chmod(directory.path().c_str(), 01777);
  const std::string socket = directory / "agnocastd.sock", lock = socket + ".lock";
  const auto refusal = [&] {
    const Ended ended = run_daemon({"--socket", socket});
    EXPECT_EQ(ended.status, 1);
    EXPECT_FALSE(exists(socket));
    return ended.err.substr(0, ended.err.find('\n'));
  };
  write_file(directory / "precious", "1234567");
  ASSERT_EQ(::symlink("precious", lock.c_str()), 0);
  EXPECT_EQ(refusal(), "agnocastd: cannot use " + lock + ": it is a symbolic link");
  EXPECT_EQ(content(directory / "precious"), "1234567");
  ASSERT_EQ(::unlink(lock.c_str()), 0);

  write_file(lock, "another's");
  ASSERT_EQ(::chown(lock.c_str(), other_uid, other_uid), 0);
  const std::string refused = refusal();
  // The kernel may refuse first (fs.protected_regular).
  EXPECT_TRUE(refused == "agnocastd: cannot use " + lock + ": it is not a file of this user" ||
              refused == "agnocastd: cannot write in directory " + directory.path() +
                             ": Permission denied")
      << refused;
  EXPECT_EQ(content(lock), "another's");
  ASSERT_EQ(::unlink(lock.c_str()), 0);

  const std::string doorbells = socket + ".bells";
  std::filesystem::create_directory(directory / "kept");
  write_file(directory / "kept/file", "");
  ASSERT_EQ(::symlink("kept", doorbells.c_str()), 0);
  EXPECT_EQ(refusal(),
            "agnocastd: cannot use " + doorbells + ": it is not a directory of this user");
  EXPECT_TRUE(exists(directory / "kept/file"));
  ASSERT_EQ(::unlink(doorbells.c_str()), 0);

  std::filesystem::create_directory(directory / "another");
  ASSERT_EQ(::chown((directory / "another").c_str(), other_uid, other_uid), 0);
  const Ended owned = run_daemon({"--socket", directory / "another/agnocastd.sock"});
  EXPECT_EQ(owned.status, 1);
  EXPECT_EQ(owned.err.substr(0, owned.err.find('\n')),
            "agnocastd: cannot use directory " + (directory / "another") + ": user " +
                std::to_string(other_uid) + " owns it and could replace the socket");
  EXPECT_TRUE(std::filesystem::is_empty(directory / "another"));
}

TEST(DaemonStart, RefusesPathsThatDoNotFitIntoAnAddress) {
  Directory directory;
  const Ended ended = run_daemon({"--socket", directory / (std::string(120, 'x') + ".sock")});
  EXPECT_EQ(ended.status, 2);
  EXPECT_NE(ended.err.find("107"), std::string::npos) << ended.err;
  const Ended doorbells = run_daemon({"--socket", directory / (std::string(75, 'x') + ".sock")});
  EXPECT_EQ(doorbells.status, 1);
  EXPECT_NE(doorbells.err.find("must have at most"), std::string::npos) << doorbells.err;
}

TEST(DaemonStart, ReportsEveryMistakeOfAConfiguration) {
  Directory directory;
  write_file(directory / "bad.toml", "[limits]\ndepth_max = 5000\n[quota]\nclinets = 3\n");
  const Ended ended =
      run_daemon({"--config", directory / "bad.toml", "--socket", directory / "agnocastd.sock"});
  EXPECT_EQ(ended.status, 1);
  EXPECT_NE(ended.err.find("bad.toml:2"), std::string::npos) << ended.err;
  EXPECT_NE(ended.err.find("bad.toml:4"), std::string::npos) << ended.err;
  EXPECT_FALSE(exists(directory / "agnocastd.sock"));
  const Ended check = run_daemon({"--config", directory / "bad.toml", "--check-config"});
  EXPECT_EQ(check.status, 1);
  const Ended none = run_daemon({"--config", directory / "none.toml", "--check-config"});
  EXPECT_EQ(none.status, 1);
}

TEST(DaemonStart, RefusesAnArenaThatDoesNotFit) {
  Directory directory;
  write_file(directory / "arena.toml", "[heap]\narena_base = 0x7ffff0000000\n");
  const Ended ended =
      run_daemon({"--config", directory / "arena.toml", "--socket", directory / "agnocastd.sock"});
  EXPECT_EQ(ended.status, 1);
  EXPECT_EQ(ended.err.substr(0, ended.err.find('\n')),
            "agnocastd: the arena does not fit into the addresses of this machine");
}

TEST(DaemonStart, PrintsVersionAndHelpAndRefusesUnknownOptions) {
  const Ended help = run_daemon({"--help"});
  EXPECT_EQ(help.status, 0);
  for (const char* option : {"--socket", "--config", "--foreground", "--log-level",
                             "--check-config", "--print-config", "--version", "--help"})
    EXPECT_NE(help.out.find(option), std::string::npos) << option;
  EXPECT_EQ(help.err, "");
  EXPECT_EQ(run_daemon({"--version"}).status, 0);
  for (const char* option : {"--help", "--version", "--print-config"}) {
    const std::string command =
        std::string(AGNOCAST_TEST_DAEMON) + " " + option + " >/dev/full 2>&1";
    const int status = std::system(command.c_str());
    EXPECT_EQ(WEXITSTATUS(status), 1) << option;
  }
  const Ended unknown = run_daemon({"--sokcet", "/x"});
  EXPECT_EQ(unknown.status, 2);
  EXPECT_EQ(unknown.err, "agnocastd: --sokcet: unknown option\nhint: agnocastd --socket\n");
}

TEST(DaemonStart, NamesMistakesOfItsConfigurationAndTheirCode) {
  Directory directory;
  const std::string file = directory / "c.toml";
  std::ofstream(file) << "[heap]\nwindow_bytes = 5\nwindows = 3\n";
  const Ended ended = run_daemon({"--config", file, "--socket", directory / "s"});
  EXPECT_EQ(ended.status, 1);
  EXPECT_NE(ended.err.find(file + ":3"), std::string::npos) << ended.err;
  EXPECT_TRUE(ended.err.ends_with(
      "agnocastd: bad_configuration: the configuration of agnocastd cannot be used\n"
      "hint: agnocast-ctl explain bad_configuration\n"))
      << ended.err;
}

TEST(DaemonStart, APermittedUserIsNeverRefusedWhileItStarts) {
  if (::geteuid() != 0) GTEST_SKIP() << "needs root and another user";
  Directory directory;
  const std::string path = directory / "agnocastd.sock";
  struct Seen {
    std::atomic<bool> stop;
    std::atomic<std::uint64_t> connected, too_early, refused;
  };
  auto* const seen = static_cast<Seen*>(
      ::mmap(nullptr, sizeof(Seen), PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0));
  ASSERT_NE(static_cast<void*>(seen), MAP_FAILED);
  const pid_t test = ::getpid();
  Child other([&] {
    if (::setuid(other_uid) != 0) return 1;
    while (!seen->stop && ::getppid() == test) {
      const auto connected = PacketSocket::connect(path, std::chrono::milliseconds(0));
      if (connected) {
        ++seen->connected;
      } else if (connected.error().code == Errc::daemon_not_running) {
        ++seen->too_early;
      } else {
        ++seen->refused;
      }
    }
    return 0;
  });
  for (int i = 0; i < 40; ++i) {
    DaemonProcess daemon({.socket = path});
    const std::uint64_t before = seen->connected;
    EXPECT_TRUE(eventually([&] { return seen->connected > before; }));
  }
  seen->stop = true;
  EXPECT_EQ(other.wait(), 0);
  EXPECT_EQ(seen->refused, 0u) << "of " << seen->connected << " and " << seen->too_early;
  ::munmap(seen, sizeof(Seen));
}

TEST(DaemonStart, NeedsNoRoot) {
  if (::geteuid() != 0)
    GTEST_SKIP() << "needs root to become another user; without root every other test covers this";
  DaemonProcess daemon({.uid = other_uid});
  EXPECT_TRUE(PacketSocket::connect(daemon.socket_path()));
  EXPECT_NE(daemon.log().find("unprivileged=yes"), std::string::npos) << daemon.log();
  EXPECT_NE(daemon.log().find("warning holes are allowed"), std::string::npos) << daemon.log();
  EXPECT_EQ(daemon.stop(), 0);
}

TEST(DaemonStart, ReportsOnceThatItsManagerKeepsNothingAndGoesOn) {
  // the test closes the sockets passed to it
  DaemonProcess daemon({.arguments = {"--fd-store=manager"}});
  EXPECT_EQ(WireClient(daemon.socket_path()).hello().opcode(), wire::Opcode::welcome);
  const std::string log = daemon.log();
  const std::size_t said = log.find("warning nothing is kept");
  ASSERT_NE(said, std::string::npos) << log;
  EXPECT_EQ(log.find("nothing is kept", said + 20), std::string::npos);
  EXPECT_NE(log.find("FileDescriptorStoreMax="), std::string::npos) << log;
  EXPECT_EQ(daemon.stop(), 0);
  EXPECT_FALSE(exists(daemon.socket_path())) << "no other process uses it";
}

TEST(DaemonStart, ListensAtAPassedSocketAndLeavesItInPlace) {
  for (const std::string keeper : {"own", "none"}) {
    Directory directory;
    const std::string path = directory / "passed.sock";
    const auto passed = listen_at(path);
    ASSERT_TRUE(passed);
    ASSERT_EQ(::chmod(path.c_str(), 0600), 0);
    ASSERT_EQ(::fcntl(passed->fd(), F_SETFL, 0), 0);  // as systemd passes it: it blocks
    WireClient early(path);
    DaemonProcess daemon({.arguments = {"--fd-store=" + keeper}, .sockets = {passed->fd()}});
    EXPECT_EQ(early.hello().opcode(), wire::Opcode::welcome);
    EXPECT_FALSE(exists(daemon.socket_path()));
    EXPECT_TRUE(daemon.wait_for_log("its path is " + path + " and not " + daemon.socket_path() +
                                    ", its mode is 0600 and not 0666"));
    EXPECT_EQ(mode_of(path), 0600u);
    if (keeper == "own") {
      const std::uint64_t incarnation = wire_dump(path).incarnation;
      EXPECT_TRUE(daemon.wait_for_next(daemon.kill_worker()));
      EXPECT_EQ(wire_dump(path).incarnation, incarnation);
      EXPECT_EQ(daemon.log().find("previous incarnation lost"), std::string::npos);
    }
    EXPECT_TRUE(exists(path + ".bells"));
    EXPECT_EQ(daemon.stop(), 0);
    EXPECT_FALSE(exists(path + ".bells"));
    EXPECT_TRUE(PacketSocket::connect(path)) << "the daemon does not remove a passed socket";
  }
}

TEST(DaemonStart, NamesTheFaultOfAPassedSocket) {
  Directory directory;
  const auto first = listen_at(directory / "first"), second = listen_at(directory / "second");
  const auto mute = PacketListener::bind(directory / "mute");
  const auto without_path = [](int type) {
    UniqueFd fd(::socket(AF_UNIX, type | SOCK_CLOEXEC, 0));
    const sockaddr_un any{AF_UNIX, {}};  // for this length the kernel chooses an abstract name
    EXPECT_EQ(::bind(fd.get(), reinterpret_cast<const sockaddr*>(&any), sizeof(sa_family_t)), 0);
    EXPECT_EQ(::listen(fd.get(), 1), 0);
    return fd;
  };
  const UniqueFd stream = without_path(SOCK_STREAM), nameless = without_path(SOCK_SEQPACKET);
  ASSERT_TRUE(first && second && mute);
  const std::vector<std::string> alone = {"--fd-store=none", "--socket", directory / "own"};
  for (const int wrong : {mute->fd(), stream.get(), nameless.get()}) {
    const Ended ended = run_daemon(alone, {}, {}, {wrong});
    EXPECT_EQ(ended.status, 1);
    EXPECT_NE(ended.err.find("cannot use the passed socket: it must be of AF_UNIX and "
                             "SOCK_SEQPACKET, listen, and have an absolute path"),
              std::string::npos)
        << ended.err;
  }
  const Ended ended = run_daemon(alone, {}, {}, {first->fd(), second->fd()});
  EXPECT_EQ(ended.status, 1);
  EXPECT_EQ(ended.err,
            "agnocastd: the service manager passes 2 sockets\n"
            "hint: use only one ListenSequentialPacket= in agnocastd.socket\n");
}

TEST(DaemonStart, ALogThatNobodyReadsStopsNothing) {
  int ends[2];
  ASSERT_EQ(::pipe2(ends, O_CLOEXEC), 0);
  const UniqueFd reader(ends[0]), writer(ends[1]);  // as a shell passes it to its children
  const auto own = [](const UniqueFd& end, int flags) {
    return UniqueFd(
        ::open(("/proc/self/fd/" + std::to_string(end.get())).c_str(), flags | O_NONBLOCK));
  };
  const UniqueFd filler = own(writer, O_WRONLY), drain = own(reader, O_RDONLY);
  ASSERT_TRUE(filler && drain);
  const std::string text(4096, '.');
  const auto fill = [&](std::size_t bytes) {
    while (::write(filler.get(), text.data(), bytes) > 0) {
    }
  };
  const auto read_all = [&] {
    std::string all;
    char part[4096];
    for (ssize_t bytes = 0; (bytes = ::read(drain.get(), part, sizeof part)) > 0;)
      all.append(part, static_cast<std::size_t>(bytes));
    return all;
  };
  fill(text.size());
  fill(1);
  const Directory directory;
  const std::string socket = directory / "run/agnocastd.sock";
  Child daemon([&] {
    ::dup2(writer.get(), STDERR_FILENO);
    ::execl(AGNOCAST_TEST_DAEMON, AGNOCAST_TEST_DAEMON, "--socket", socket.c_str(), "--log-level",
            "debug", static_cast<char*>(nullptr));
    return 1;
  });
  const auto is_welcome = [&] {
    return exists(socket) && PacketSocket::connect(socket).has_value() &&
           WireClient(socket).hello().opcode() == wire::Opcode::welcome;
  };
  ASSERT_TRUE(eventually(is_welcome)) << "the daemon logs that it is ready";
  const auto worker = [&]() -> pid_t {
    const std::string pid = std::to_string(daemon.pid());
    std::ifstream children("/proc/" + pid + "/task/" + pid + "/children");
    pid_t child = 0;
    children >> child;
    return child;
  };
  const pid_t before = worker();
  ASSERT_GT(before, 0);
  ASSERT_EQ(::kill(before, SIGKILL), 0);
  ASSERT_TRUE(eventually([&] { return worker() != before && worker() > 0; }))
      << "the supervisor logs that it died";
  ASSERT_TRUE(eventually(is_welcome));
  std::string said = read_all();
  ASSERT_TRUE(is_welcome());
  EXPECT_TRUE(eventually([&] {
    said += read_all();
    return said.find("lines were lost") != std::string::npos;
  }));
  fill(text.size());
  fill(1);
  daemon.kill(SIGTERM);
  EXPECT_EQ(daemon.wait(), 0);
}

}  // namespace
}  // namespace agnocast::test
