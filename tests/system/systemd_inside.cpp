// SPDX-License-Identifier: Apache-2.0
//
// Runs inside the machine of systemd_test.sh: our units, real clients, kill -9, a hang, restart, stop and other programs.
//
// Some tests speak the protocol by themselves, so that they can say what must be known where; the others have
// two ordinary nodes of two users that never stop. As the unit is installed, the daemon has hardly any rights here; so
// everything that it does in these tests it can do without the others.

#include <base/memfd.hpp>
#include <tests/recovery/stage.hpp>
#include <tests/support/steered_process.hpp>
#include <tests/support/wire_client.hpp>
#include <tests/support/wire_dump.hpp>
#include <tests/support/wire_node.hpp>

#include <grp.h>
#include <gtest/gtest.h>
#include <pwd.h>
#include <sys/prctl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <array>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <memory>
#include <sstream>
#include <string>

namespace agnocast::test {
namespace {

using sweep::Child;
using sweep::serve;

constexpr const char* socket_path = "/run/agnocast/agnocastd.sock";
constexpr abi::Qos deep{10, false, true, false, false};

std::string output_of(const std::string& command) {
  const std::unique_ptr<std::FILE, int (*)(std::FILE*)> pipe(::popen(command.c_str(), "re"),
                                                             &::pclose);
  std::string text;
  std::array<char, 256> part{};
  while (std::fgets(part.data(), part.size(), pipe.get()) != nullptr) text += part.data();
  while (!text.empty() && text.back() == '\n') text.pop_back();
  return text;
}
std::string property(const char* name) {
  return output_of(std::string("systemctl show --value -p ") + name + " agnocastd");
}
bool systemctl(const std::string& verb, const std::string& unit = "agnocastd.service") {
  return std::system(("systemctl " + verb + " " + unit + " 2>&1").c_str()) == 0;
}
bool exists(const std::string& path) { return std::filesystem::exists(path); }
bool socket_listens() {
  return output_of("systemctl is-active agnocastd.socket") == "active" && exists(socket_path);
}
/// Without the socket nobody brings the daemon back.
bool stop_both() {
  return systemctl("stop", "agnocastd.socket") && property("ActiveState") == "inactive";
}
template <class Condition>
bool eventually(Condition condition) {
  for (int rounds = 0; rounds < 200; ++rounds) {
    if (condition()) return true;
    ::usleep(100'000);
  }
  return condition();
}
bool goes_on_with_what_was() {
  return property("StatusText") == "serving; goes on with what was there before";
}
pid_t main_pid() { return static_cast<pid_t>(std::atoi(property("MainPID").c_str())); }
/// kill(2) to one process: what could not be asked for is no process, and 0 would be everybody in the test's group.
int send(pid_t pid, int signal) { return pid > 1 ? ::kill(pid, signal) : -1; }
bool is_another(pid_t now, pid_t old) { return now > 0 && now != old; }
bool is_next(pid_t old) {
  return is_another(main_pid(), old) && property("ActiveState") == "active" &&
         property("SubState") == "running";
}

/// How often the journal of the unit says this.
std::size_t said(const std::string& text) {
  return std::strtoul(
      output_of("journalctl -u agnocastd -o cat --no-pager | grep -c -F -- '" + text + "'").c_str(),
      nullptr, 10);
}

/// The unit of the daemon with something else in [Service].
class DropIn {
 public:
  explicit DropIn(const std::string& lines) {
    std::filesystem::create_directories(directory);
    std::ofstream(std::string(directory) + "/test.conf") << "[Service]\n" << lines << "\n";
    EXPECT_EQ(std::system("systemctl daemon-reload"), 0);
  }
  ~DropIn() {
    std::filesystem::remove_all(directory);
    EXPECT_EQ(std::system("systemctl daemon-reload"), 0);
  }
  DropIn(const DropIn&) = delete;
  DropIn& operator=(const DropIn&) = delete;

 private:
  static constexpr const char* directory = "/run/systemd/system/agnocastd.service.d";
};
/// With this it is started again only a while after its main process has ended.
constexpr const char* slow_start = "RestartSec=5s";
bool is_away() { return property("MainPID") == "0" && property("SubState") == "auto-restart"; }

/// The program of the unit, as a package would replace it: another file under the same name.
void install(const char* program) {
  namespace fs = std::filesystem;
  const std::string name = "/usr/bin/agnocastd";
  fs::copy_file(program, name + ".new", fs::copy_options::overwrite_existing);
  fs::rename(name + ".new", name);
}

char answer(bool done) { return testing::Test::HasFailure() ? '!' : done ? '+' : '-'; }
Child publisher_child() {
  return Child(0, [](int commands, std::uint64_t) {
    ::prctl(PR_SET_PDEATHSIG, SIGKILL);
    WireNode node(socket_path);
    if (!node.create_publisher("/topic", deep)) ::_exit(3);
    std::uint64_t number = 0;
    serve(commands, [&](char what) -> char {
      if (what == 'w') return answer(node.wait_for([&] { return node.attached_count() == 1; }));
      return answer(node.publish(++number));
    });
  });
}

TEST(Systemd, KeepsTheIncarnationOverDeathAndRestartAndLetsItGoWithAStop) {
  ASSERT_TRUE(systemctl("start")) << output_of("systemctl status agnocastd");
  const WireDump first = wire_dump(socket_path);
  WireNode subscriber(socket_path);
  ASSERT_TRUE(subscriber.create_subscription("/topic", deep));
  Child publisher = publisher_child();
  ASSERT_TRUE(subscriber.wait_for([&] { return subscriber.link_count() == 1; }));
  ASSERT_EQ(publisher.command('w'), '+');
  // Three of the daemon (the socket is its unit's); region and pidfd of both, an eventfd, a window.
  EXPECT_TRUE(eventually([] { return property("NFileDescriptorStore") == "9"; }))
      << property("NFileDescriptorStore");

  std::uint64_t published = 0;
  for (int life = 0; life < 6; ++life) {
    const pid_t old = main_pid();
    if (life % 2 == 0) {
      ASSERT_EQ(send(old, SIGKILL), 0);
    } else {
      ASSERT_TRUE(systemctl("restart"));
    }
    ASSERT_EQ(publisher.command('p'), '+');
    EXPECT_EQ(subscriber.take(), ++published);
    subscriber.release();
    ASSERT_TRUE(eventually([&] { return is_next(old); }))
        << output_of("systemctl status agnocastd");
    const WireDump all = wire_dump(socket_path);
    EXPECT_EQ(all.incarnation, first.incarnation);
    EXPECT_EQ(all.processes.size(), 2u);
    EXPECT_EQ(all.daemon.counters.restarts, static_cast<std::uint64_t>(life + 1));
    EXPECT_EQ(property("NFileDescriptorStore"), "9");
  }
  EXPECT_TRUE(goes_on_with_what_was()) << property("StatusText");

  // Both at once: the process ends while nobody is there who would see it.
  const pid_t old = main_pid();
  {
    const DropIn slow(slow_start);
    ASSERT_EQ(send(old, SIGKILL), 0);
    ASSERT_TRUE(eventually([] { return is_away(); }));
    publisher.end();
    // Everything of it is still kept, its pidfd too, which a manager that polls would drop.
    ::usleep(500'000);
    EXPECT_EQ(property("NFileDescriptorStore"), "9");
    ASSERT_TRUE(is_away()) << "or this shows nothing";
  }
  ASSERT_TRUE(eventually([&] { return is_next(old); }));
  EXPECT_TRUE(eventually([&] { return wire_dump(socket_path).daemon.counters.clients_died == 1; }));
  EXPECT_TRUE(eventually([] { return said("clients_lost=0") >= 7; })) << said("clients_lost=0");
  EXPECT_EQ(said("clients_lost="), said("clients_lost=0"));
  EXPECT_EQ(said("client lost"), 0u);

  ASSERT_TRUE(systemctl("stop"));
  // The count of daemons that began here stays: the next one gives out other addresses.
  EXPECT_TRUE(exists("/run/agnocast/agnocastd.sock.lock"));
  EXPECT_TRUE(socket_listens()) << "whoever comes next starts the daemon again";
  ASSERT_TRUE(systemctl("start"));
  const WireDump anew = wire_dump(socket_path);
  EXPECT_NE(anew.incarnation, first.incarnation);
  EXPECT_TRUE(anew.processes.empty());
  EXPECT_EQ(property("NFileDescriptorStore"), "3");
}

// As a package does it: the file is another one, then the unit is restarted.
TEST(Systemd, GoesOnWithAReplacedProgramAndHarmsNothingWithOneOfAnotherLayout) {
  ASSERT_TRUE(stop_both());
  ASSERT_TRUE(systemctl("start")) << output_of("systemctl status agnocastd");
  const std::uint64_t incarnation = wire_dump(socket_path).incarnation;
  WireNode subscriber(socket_path);
  ASSERT_TRUE(subscriber.create_subscription("/topic", deep));
  Child publisher = publisher_child();
  ASSERT_TRUE(subscriber.wait_for([&] { return subscriber.link_count() == 1; }));
  ASSERT_EQ(publisher.command('w'), '+');
  std::uint64_t published = 0;
  const auto goes_on = [&] {
    ASSERT_EQ(publisher.command('p'), '+');
    EXPECT_EQ(subscriber.take(), ++published);
    subscriber.release();
  };
  goes_on();
  std::filesystem::copy_file("/usr/bin/agnocastd", "/opt/agnocast/agnocastd");
  const auto is_whole = [&] {
    const WireDump all = wire_dump(socket_path);
    EXPECT_EQ(all.incarnation, incarnation);
    EXPECT_EQ(all.processes.size(), 2u);
    EXPECT_EQ(all.endpoints.size(), 2u);
    EXPECT_EQ(property("NFileDescriptorStore"), "9");
  };

  install("/opt/agnocast/agnocastd");
  ASSERT_TRUE(systemctl("restart"));
  EXPECT_TRUE(goes_on_with_what_was()) << property("StatusText");
  is_whole();
  goes_on();

  // It stays, so that the unit is not started over and over, and says why it serves nobody.
  install("/opt/agnocast/agnocastd_of_another_layout");
  ASSERT_TRUE(systemctl("restart"));
  for (int life = 0; life < 2; ++life) {
    EXPECT_TRUE(eventually([] {
      return property("SubState") == "running" &&
             property("StatusText").find("refusing everybody") != std::string::npos;
    })) << property("StatusText");
    EXPECT_TRUE(eventually([] { return said("refusing everybody") >= 1; }));
    EXPECT_NE(output_of("journalctl -u agnocastd -o cat --no-pager | grep -F 'layout'"), "");
    EXPECT_EQ(WireClient(socket_path).hello().refused_code(), Errc::layout_mismatch);
    EXPECT_EQ(property("NFileDescriptorStore"), "9");
    goes_on();
    if (life == 0) {
      const pid_t old = main_pid();
      ASSERT_EQ(send(old, SIGKILL), 0);
      ASSERT_TRUE(eventually([&] { return is_next(old); }));
    }
  }

  install("/opt/agnocast/agnocastd");
  ASSERT_TRUE(systemctl("restart"));
  EXPECT_TRUE(goes_on_with_what_was()) << property("StatusText");
  is_whole();
  goes_on();
  EXPECT_EQ(said("client lost"), 0u);
}

/// An honest_node (tests/hostile/) of a user that is not root, with all groups of that user. `before` is a program that
/// runs it.
class UserNode {
 public:
  explicit UserNode(const std::string& user, const std::vector<std::string>& before = {})
      : process_(arguments(user, before), {}) {}
  std::string ask(const std::string& line) { return process_.ask(line); }
  struct State {
    std::uint64_t published = 0, refused = 0, received = 0, wrong = 0, lost = 0;
  };
  State state() {
    State state;
    const std::string text = ask("state");
    std::istringstream words(text);
    words >> state.published >> state.refused >> state.received >> state.wrong >> state.lost;
    EXPECT_FALSE(words.fail()) << text;
    return state;
  }

 private:
  static std::vector<std::string> arguments(const std::string& user,
                                            std::vector<std::string> before) {
    for (const std::string& word :
         {std::string("/usr/bin/setpriv"), "--reuid=" + user, "--regid=" + user,
          std::string("--init-groups"), std::string(AGNOCAST_INSIDE_NODE), std::string("0")})
      before.push_back(word);
    return before;
  }

  SteeredProcess process_;
};
constexpr const char* one = "agnocast-one";
constexpr const char* two = "agnocast-two";
constexpr const char* stranger = "agnocast-stranger";

/// Of the one process of this user that is there.
pid_t pid_in(const WireDump& all, const char* user) {
  const passwd* const entry = ::getpwnam(user);
  for (const wire::DumpProcess& process : all.processes) {
    if (entry != nullptr && process.uid == entry->pw_uid) return static_cast<pid_t>(process.pid);
  }
  ADD_FAILURE() << user << " has no process";
  return 0;
}

/// A stream of one user to another. It goes on until the end.
struct Stream {
  UserNode subscriber{one}, publisher{two};
  UserNode::State got;

  void begin() {
    ASSERT_EQ(subscriber.ask("subscribe /stream"), "ok");
    ASSERT_EQ(publisher.ask("publish /stream"), "ok");
    ASSERT_TRUE(goes_on());
  }
  bool goes_on() {
    const std::uint64_t wanted = subscriber.state().received + 50;
    return eventually([&] { return subscriber.state().received >= wanted; });
  }
  /// Whatever was published has come, and is right.
  void end() {
    ASSERT_EQ(publisher.ask("stop"), "ok");
    const UserNode::State sent = publisher.state();
    EXPECT_TRUE(eventually([&] { return subscriber.state().received == sent.published; }));
    got = subscriber.state();
    EXPECT_EQ(got.received, sent.published);
    EXPECT_EQ(got.lost, 0u);
    EXPECT_EQ(got.wrong, 0u);
    EXPECT_EQ(sent.refused, 0u);
  }
};

TEST(Systemd, LosesNoMessageOfTwoUsersOverDeathsAndRestartsUnderTraffic) {
  ASSERT_TRUE(stop_both());
  ASSERT_TRUE(systemctl("start")) << output_of("systemctl status agnocastd");
  const std::uint64_t incarnation = wire_dump(socket_path).incarnation;
  Stream stream;
  ASSERT_NO_FATAL_FAILURE(stream.begin());

  for (int life = 0; life < 6; ++life) {
    const pid_t old = main_pid();
    if (life % 2 == 0) {
      ASSERT_EQ(send(old, SIGKILL), 0);
    } else {
      ASSERT_TRUE(systemctl("restart"));
    }
    // Asked for while nobody is there, or while everybody comes back.
    EXPECT_EQ(stream.publisher.ask("create /more"), "ok");
    EXPECT_EQ(stream.subscriber.ask("create /more"), "ok");
    ASSERT_TRUE(eventually([&] { return is_next(old); }))
        << output_of("systemctl status agnocastd");
    EXPECT_TRUE(stream.goes_on());
    EXPECT_EQ(wire_dump(socket_path).incarnation, incarnation);
  }

  ASSERT_NO_FATAL_FAILURE(stream.end());
  EXPECT_GE(stream.got.received, 6u * 50u);
  EXPECT_EQ(wire_dump(socket_path).processes.size(), 2u);
  std::printf("%llu messages over 6 lives\n", static_cast<unsigned long long>(stream.got.received));
}

// What a manager's stop takes away comes back with nobody's help: the processes are members of the next
// daemon, and the stream has no gap.
TEST(Systemd, StoppedAndStartedFindsTwoUsersAgainUnderTraffic) {
  ASSERT_TRUE(stop_both());
  ASSERT_TRUE(systemctl("start")) << output_of("systemctl status agnocastd");
  Stream stream;
  ASSERT_NO_FATAL_FAILURE(stream.begin());
  for (int life = 0; life < 4; ++life) {
    const std::uint64_t before = wire_dump(socket_path).incarnation;
    if (life % 2 == 0) {
      ASSERT_TRUE(stop_both());
      EXPECT_TRUE(stream.goes_on()) << "without a daemon";
      EXPECT_EQ(property("ActiveState"), "inactive");
      ASSERT_TRUE(systemctl("start"));
    } else {
      // The socket stays, and nodes that come back bring the daemon.
      ASSERT_TRUE(systemctl("stop"));
      ASSERT_TRUE(eventually([] { return property("ActiveState") == "active"; }));
    }
    EXPECT_NE(wire_dump(socket_path).incarnation, before);
    EXPECT_TRUE(eventually([] {
      const WireDump all = wire_dump(socket_path);
      return all.processes.size() == 2 && all.endpoints.size() == 2;
    })) << "they are members again, by themselves";
    EXPECT_EQ(stream.subscriber.ask("create /more"), "ok");
    EXPECT_EQ(stream.publisher.ask("create /more"), "ok");
    EXPECT_TRUE(stream.goes_on());
  }
  ASSERT_NO_FATAL_FAILURE(stream.end());
  std::printf("%llu messages over 4 stops\n", static_cast<unsigned long long>(stream.got.received));
}

// --- the socket

TEST(Systemd, NodesThatAreThereFirstBringTheDaemonAndAreServedWhenItIsUp) {
  ASSERT_TRUE(stop_both());
  ASSERT_TRUE(systemctl("start", "agnocastd.socket"));
  EXPECT_EQ(property("ActiveState"), "inactive");
  const DropIn late("ExecStartPre=/bin/sleep 2");
  UserNode subscriber(one), publisher(two);
  EXPECT_EQ(subscriber.ask("subscribe /first"), "ok");
  EXPECT_EQ(property("ActiveState"), "active");
  EXPECT_EQ(publisher.ask("publish /first"), "ok");
  EXPECT_TRUE(eventually([&] { return subscriber.state().received >= 50; }));
}

TEST(Systemd, OnlyTheGroupMayConnect) {
  ASSERT_TRUE(systemctl("start"));
  struct stat entry {};
  ASSERT_EQ(::stat(socket_path, &entry), 0);
  const group* const members = ::getgrnam("agnocast");
  ASSERT_NE(members, nullptr);
  EXPECT_EQ(entry.st_gid, members->gr_gid);
  EXPECT_EQ(entry.st_mode & 07777U, 0660U);
  EXPECT_EQ(UserNode(one).ask("create /topic"), "ok");
  EXPECT_EQ(UserNode(stranger).ask("create /topic"), sentence_of(Errc::permission_denied));
}

TEST(Systemd, TheUnitOfTheSocketDecidesAndAConfigurationThatDiffersIsNamed) {
  ASSERT_TRUE(systemctl("start"));
  const std::uint64_t incarnation = wire_dump(socket_path).incarnation;
  std::filesystem::create_directories("/etc/agnocast");
  std::ofstream("/etc/agnocast/agnocastd.toml")
      << "[daemon]\nsocket = \"/run/other.sock\"\nsocket_mode = \"0666\"\n";
  EXPECT_EQ(said("socket is not as configured"), 0u);
  EXPECT_TRUE(systemctl("restart"));
  EXPECT_TRUE(eventually([] {
    return said(
               "its path is /run/agnocast/agnocastd.sock and not /run/other.sock, its mode is "
               "0660 and not 0666") == 1;
  })) << output_of("journalctl -u agnocastd -o cat --no-pager | tail");
  std::filesystem::remove_all("/etc/agnocast");
  EXPECT_EQ(wire_dump(socket_path).incarnation, incarnation);
  EXPECT_EQ(UserNode(stranger).ask("create /topic"), sentence_of(Errc::permission_denied));
  EXPECT_FALSE(exists("/run/other.sock"));
}

TEST(Systemd, ARestartOfTheSocketIsARestartOfTheDaemonUnderTraffic) {
  ASSERT_TRUE(stop_both());
  ASSERT_TRUE(systemctl("start"));
  const std::uint64_t incarnation = wire_dump(socket_path).incarnation;
  Stream stream;
  ASSERT_NO_FATAL_FAILURE(stream.begin());
  for (int life = 0; life < 3; ++life) {
    const pid_t old = main_pid();
    ASSERT_TRUE(systemctl("restart", "agnocastd.socket"));
    ASSERT_TRUE(eventually([&] { return is_next(old); }));
    EXPECT_EQ(stream.publisher.ask("create /more"), "ok");
    EXPECT_EQ(stream.subscriber.ask("create /more"), "ok");
    EXPECT_EQ(wire_dump(socket_path).incarnation, incarnation);
    EXPECT_FALSE(std::filesystem::is_empty("/run/agnocast/agnocastd.sock.bells"));
  }
  ASSERT_NO_FATAL_FAILURE(stream.end());
}

// Two sockets are there then, of which the kept one has no name any more.
TEST(Systemd, ADaemonThatListenedByItselfGoesOnWithTheUnitOfASocketUnderTraffic) {
  const std::string units = "/usr/lib/systemd/system/agnocastd.";
  const std::string alone = "/run/systemd/system/agnocastd.service";
  ASSERT_TRUE(stop_both());
  std::filesystem::rename(units + "socket", units + "aside");
  // Making a socket of a group takes rights that the daemon does not need otherwise.
  ASSERT_EQ(std::system(("grep -v 'agnocastd.socket\\|^SystemCallFilter\\|^CapabilityB' " + units +
                         "service >" + alone)
                            .c_str()),
            0);
  ASSERT_TRUE(systemctl("daemon-reload", ""));
  ASSERT_TRUE(systemctl("start"));
  EXPECT_EQ(output_of("systemctl is-active agnocastd.socket"), "inactive");
  EXPECT_EQ(property("NFileDescriptorStore"), "4") << "with the socket";
  const std::uint64_t incarnation = wire_dump(socket_path).incarnation;
  Stream stream;
  EXPECT_NO_FATAL_FAILURE(stream.begin());

  std::filesystem::rename(units + "aside", units + "socket");
  std::filesystem::remove(alone);
  const int kept = std::atoi(property("NFileDescriptorStore").c_str());
  ASSERT_TRUE(systemctl("daemon-reload", ""));
  ASSERT_TRUE(systemctl("restart"));
  EXPECT_TRUE(socket_listens());
  EXPECT_EQ(wire_dump(socket_path).incarnation, incarnation);
  EXPECT_TRUE(
      eventually([&] { return property("NFileDescriptorStore") == std::to_string(kept - 1); }));
  EXPECT_EQ(stream.publisher.ask("create /more"), "ok");
  EXPECT_EQ(stream.subscriber.ask("create /more"), "ok");
  ASSERT_NO_FATAL_FAILURE(stream.end());
}

TEST(Systemd, LeavesNothingButTheLockWhenServiceAndSocketAreStopped) {
  ASSERT_TRUE(systemctl("start"));
  UserNode node(one);
  EXPECT_EQ(node.ask("subscribe /topic"), "ok");
  EXPECT_FALSE(std::filesystem::is_empty("/run/agnocast/agnocastd.sock.bells"));
  ASSERT_TRUE(stop_both());
  EXPECT_EQ(output_of("ls -A /run/agnocast"), "agnocastd.sock.lock");
  EXPECT_EQ(output_of("stat -c %a /run/agnocast/agnocastd.sock.lock"), "600");
  EXPECT_EQ(property("NFileDescriptorStore"), "0");
  ASSERT_TRUE(systemctl("start"));
  EXPECT_TRUE(eventually([] { return wire_dump(socket_path).processes.size() == 1; }));
}

// A node that comes back connects to the socket, which would start the daemon; its unit says how fast.
TEST(Systemd, NobodyWhoConnectsMakesADaemonThatDiesComeBackFasterThanItsUnitSays) {
  ASSERT_TRUE(systemctl("start"));
  UserNode node(one);
  EXPECT_EQ(node.ask("subscribe /topic"), "ok");
  const pid_t old = main_pid();
  {
    const DropIn slow(slow_start);
    ASSERT_EQ(send(old, SIGKILL), 0);
    ASSERT_TRUE(eventually([] { return is_away(); }));
    const WireClient waits(socket_path);
    ::usleep(1'000'000);
    EXPECT_TRUE(is_away());
  }
  ASSERT_TRUE(eventually([&] { return is_next(old); }));
  EXPECT_EQ(node.ask("create /more"), "ok");
}

// A socket has limits of its own, after which it would be closed.
TEST(Systemd, DiesAndFailsToStartAgainAndAgainUnderTrafficAndTheSocketStays) {
  ASSERT_TRUE(stop_both());
  ASSERT_TRUE(systemctl("start"));
  const std::uint64_t incarnation = wire_dump(socket_path).incarnation;
  Stream stream;
  ASSERT_NO_FATAL_FAILURE(stream.begin());
  {
    const DropIn fast("RestartSec=0");
    for (int life = 0; life < 10; ++life) {
      const pid_t old = main_pid();
      ASSERT_EQ(send(old, SIGKILL), 0);
      ASSERT_TRUE(eventually([&] { return is_another(main_pid(), old); }));
    }
  }
  {
    const DropIn broken("RestartSec=20ms\nExecStartPre=/bin/false");
    const auto restarts = [] { return std::atoi(property("NRestarts").c_str()); };
    const int before = restarts();
    ASSERT_EQ(send(main_pid(), SIGKILL), 0);
    EXPECT_TRUE(eventually([&] { return restarts() >= before + 30; })) << restarts() - before;
  }
  EXPECT_TRUE(eventually([] { return property("SubState") == "running"; }));
  EXPECT_TRUE(socket_listens());
  EXPECT_EQ(stream.publisher.ask("create /more"), "ok");
  EXPECT_EQ(wire_dump(socket_path).incarnation, incarnation);
  ASSERT_NO_FATAL_FAILURE(stream.end());
}

// --- the watchdog

TEST(Systemd, ADaemonThatHangsIsEndedAndGoesOnUnderTrafficAndOneThatIsIdleIsNot) {
  ASSERT_TRUE(stop_both());
  const DropIn impatient("WatchdogSec=2s");
  ASSERT_TRUE(systemctl("start"));
  const std::uint64_t incarnation = wire_dump(socket_path).incarnation;
  const pid_t idle = main_pid();
  std::string last;
  for (int sign = 0; sign < 4; ++sign) {  // two intervals
    ASSERT_TRUE(eventually([&] { return property("WatchdogTimestampMonotonic") != last; }));
    last = property("WatchdogTimestampMonotonic");
  }
  EXPECT_EQ(main_pid(), idle);

  Stream stream;
  ASSERT_NO_FATAL_FAILURE(stream.begin());
  for (int life = 0; life < 2; ++life) {
    const pid_t old = main_pid();
    ASSERT_EQ(send(old, SIGSTOP), 0);
    ASSERT_TRUE(eventually([&] { return is_next(old); }))
        << output_of("systemctl status agnocastd");
    EXPECT_TRUE(stream.goes_on());
    EXPECT_EQ(stream.publisher.ask("create /more"), "ok");
    EXPECT_EQ(wire_dump(socket_path).incarnation, incarnation);
  }
  ASSERT_NO_FATAL_FAILURE(stream.end());
}

// --- what the unit takes from the daemon

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

// It has the capability that this takes, where the kernel knows such files.
TEST(Systemd, ForbidsHolesInRegions) {
  const auto file = make_memfd("agnocast-probe", 0);
  ASSERT_TRUE(file);
  if (!forbid_holes(file->get())) GTEST_SKIP() << "nor may root here";
  ASSERT_TRUE(systemctl("restart", "agnocastd"));
  EXPECT_EQ(said("holes are allowed"), 0u);
}

// Whether a process that has left still maps something is in /proc/PID/maps, which is for its user and for
// who may trace it. It lives, so there is nothing else to tell by.
TEST(Systemd, SeesThatAProcessOfAnotherUserHasLetGo) {
  ASSERT_TRUE(systemctl("start"));
  const passwd* const user = ::getpwnam(two);
  ASSERT_NE(user, nullptr);
  const uid_t uid = user->pw_uid;
  const std::size_t before = wire_dump(socket_path).processes.size();
  Child process(0, [&](int commands, std::uint64_t) {
    ::prctl(PR_SET_PDEATHSIG, SIGKILL);
    auto node = std::make_unique<WireNode>(socket_path);
    if (::setgid(uid) != 0 || ::setuid(uid) != 0) ::_exit(3);
    // Its own again, as of any process that was this user's from the beginning.
    ::prctl(PR_SET_DUMPABLE, 1);
    serve(commands, [&](char) -> char {
      node.reset();
      return '+';
    });
  });
  EXPECT_TRUE(eventually([&] { return wire_dump(socket_path).processes.size() == before + 1; }));
  ASSERT_EQ(process.command('l'), '+');
  EXPECT_TRUE(eventually([&] { return wire_dump(socket_path).processes.size() == before; }));
}

TEST(Systemd, ServesAndRepairsUsersInOtherPidAndNetworkNamespaces) {
  ASSERT_TRUE(stop_both());
  ASSERT_TRUE(systemctl("start"));
  UserNode subscriber(one, {"/usr/bin/unshare", "--net"});
  UserNode publisher(two, {"/usr/bin/unshare", "--pid", "--net", "--fork"});
  ASSERT_EQ(subscriber.ask("subscribe /stream"), "ok");
  ASSERT_EQ(publisher.ask("publish /stream"), "ok");
  EXPECT_TRUE(eventually([&] { return subscriber.state().received >= 50; }));
  EXPECT_EQ(wire_dump(socket_path).processes.size(), 2u);
  const std::size_t gone = said("client gone");
  ASSERT_EQ(send(pid_in(wire_dump(socket_path), two), SIGKILL), 0);
  EXPECT_TRUE(eventually([&] { return said("client gone") == gone + 1; }));
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
  EXPECT_TRUE(eventually([&] { return !output_of(found + "-q -o cat").empty(); }));
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
  EXPECT_TRUE(eventually([] { return said("client revoked") >= 1; }));
  EXPECT_EQ(stays.ask("create /more"), "ok");
  EXPECT_NE(goes.ask("create /more"), "ok");
}

// As somebody would copy it. Its library path is the test's: what ROS messages need is not installed here.
TEST(Systemd, TheExampleOfANodeServesAUserWhoWasThereFirst) {
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
  EXPECT_TRUE(eventually([] { return property("ActiveState") == "active"; })) << "by the node";
  EXPECT_TRUE(eventually([] { return wire_dump(socket_path).endpoints.size() == 1; }))
      << output_of("journalctl -u node --no-pager -o cat | tail");
  EXPECT_EQ(std::to_string(pid_in(wire_dump(socket_path), "robot")),
            output_of("systemctl show --value -p MainPID node"));
  EXPECT_TRUE(systemctl("stop", "node"));
  EXPECT_TRUE(eventually([] { return wire_dump(socket_path).processes.empty(); }));
  fs::remove("/run/systemd/system/node.service");
  fs::remove_all("/run/systemd/system/node.service.d");
  EXPECT_TRUE(systemctl("daemon-reload", ""));
}

/// What `systemd-analyze` says against these, beside its status.
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
  // Without a line that applies here, it is only read: /sys is that of the host.
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
  EXPECT_NE(check(tenths - 1).find("failed"), std::string::npos) << "it is better than is said";
}

}  // namespace
}  // namespace agnocast::test
