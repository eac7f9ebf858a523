// SPDX-License-Identifier: Apache-2.0
//
// Runs inside the machine of systemd_test.sh: our unit, real clients, kill -9, restart, stop and other programs.
//
// Two tests speak the protocol by themselves, so that they can say what must be known where; the others have
// two ordinary nodes of two users that never stop.

#include <tests/recovery/stage.hpp>
#include <tests/support/steered_process.hpp>
#include <tests/support/wire_client.hpp>
#include <tests/support/wire_dump.hpp>
#include <tests/support/wire_node.hpp>

#include <gtest/gtest.h>
#include <sys/prctl.h>
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
bool systemctl(const char* verb) {
  return std::system((std::string("systemctl ") + verb + " agnocastd").c_str()) == 0;
}
template <class Condition>
bool eventually(Condition condition) {
  for (int rounds = 0; rounds < 200; ++rounds) {
    if (condition()) return true;
    ::usleep(100'000);
  }
  return condition();
}
pid_t main_pid() { return static_cast<pid_t>(std::atoi(property("MainPID").c_str())); }
bool is_next(pid_t old) {
  return main_pid() > 0 && main_pid() != old && property("ActiveState") == "active" &&
         property("SubState") == "running";
}

/// How often the journal of the unit says this.
std::size_t said(const std::string& text) {
  return std::strtoul(
      output_of("journalctl -u agnocastd -o cat --no-pager | grep -c -F -- '" + text + "'").c_str(),
      nullptr, 10);
}

/// The unit is started again only a while after its main process has ended.
class SlowStart {
 public:
  SlowStart() {
    std::filesystem::create_directories(directory);
    std::ofstream(std::string(directory) + "/slow.conf") << "[Service]\nRestartSec=5s\n";
    EXPECT_EQ(std::system("systemctl daemon-reload"), 0);
  }
  ~SlowStart() {
    std::filesystem::remove_all(directory);
    EXPECT_EQ(std::system("systemctl daemon-reload"), 0);
  }
  SlowStart(const SlowStart&) = delete;
  SlowStart& operator=(const SlowStart&) = delete;
  static bool is_away() {
    return property("MainPID") == "0" && property("SubState") == "auto-restart";
  }

 private:
  static constexpr const char* directory = "/run/systemd/system/agnocastd.service.d";
};

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
  // Four of the daemon; region and pidfd of both, an eventfd, a window.
  EXPECT_TRUE(eventually([] { return property("NFileDescriptorStore") == "10"; }))
      << property("NFileDescriptorStore");

  std::uint64_t published = 0;
  for (int life = 0; life < 6; ++life) {
    const pid_t old = main_pid();
    if (life % 2 == 0) {
      ASSERT_EQ(::kill(old, SIGKILL), 0);
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
    EXPECT_EQ(property("NFileDescriptorStore"), "10");
  }
  EXPECT_EQ(property("StatusText"), "serving; goes on with what was there before");

  // Both at once: the process ends while nobody is there who would see it.
  const pid_t old = main_pid();
  {
    const SlowStart slow;
    ASSERT_EQ(::kill(old, SIGKILL), 0);
    ASSERT_TRUE(eventually([] { return SlowStart::is_away(); }));
    publisher.end();
    // Everything of it is still kept, its pidfd too, which a manager that polls would drop.
    ::usleep(500'000);
    EXPECT_EQ(property("NFileDescriptorStore"), "10");
    ASSERT_TRUE(SlowStart::is_away()) << "or this shows nothing";
  }
  ASSERT_TRUE(eventually([&] { return is_next(old); }));
  EXPECT_TRUE(eventually([&] { return wire_dump(socket_path).daemon.counters.clients_died == 1; }));
  EXPECT_TRUE(eventually([] { return said("clients_lost=0") >= 7; })) << said("clients_lost=0");
  EXPECT_EQ(said("clients_lost="), said("clients_lost=0"));
  EXPECT_EQ(said("client lost"), 0u);

  ASSERT_TRUE(systemctl("stop"));
  // The count of daemons that began here stays: the next one gives out other addresses.
  EXPECT_TRUE(std::filesystem::exists("/run/agnocast/agnocastd.sock.lock"));
  ASSERT_TRUE(systemctl("start"));
  const WireDump anew = wire_dump(socket_path);
  EXPECT_NE(anew.incarnation, first.incarnation);
  EXPECT_TRUE(anew.processes.empty());
  EXPECT_EQ(property("NFileDescriptorStore"), "4");
}

// As a package does it: the file is another one, then the unit is restarted.
TEST(Systemd, GoesOnWithAReplacedProgramAndHarmsNothingWithOneOfAnotherLayout) {
  ASSERT_TRUE(systemctl("stop"));
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
    EXPECT_EQ(property("NFileDescriptorStore"), "10");
  };

  install("/opt/agnocast/agnocastd");
  ASSERT_TRUE(systemctl("restart"));
  EXPECT_EQ(property("StatusText"), "serving; goes on with what was there before");
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
    EXPECT_EQ(property("NFileDescriptorStore"), "10");
    goes_on();
    if (life == 0) {
      const pid_t old = main_pid();
      ASSERT_EQ(::kill(old, SIGKILL), 0);
      ASSERT_TRUE(eventually([&] { return is_next(old); }));
    }
  }

  install("/opt/agnocast/agnocastd");
  ASSERT_TRUE(systemctl("restart"));
  EXPECT_EQ(property("StatusText"), "serving; goes on with what was there before");
  is_whole();
  goes_on();
  EXPECT_EQ(said("client lost"), 0u);
}

/// An honest_node (tests/hostile/) of a user that is not root.
class UserNode {
 public:
  explicit UserNode(uid_t uid)
      : process_({AGNOCAST_INSIDE_NODE, std::to_string(uid)},
                 {std::string("AGNOCAST_SOCKET=") + socket_path}) {}
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
  SteeredProcess process_;
};

/// A stream of one user to another. It goes on until the end.
struct Stream {
  UserNode subscriber{65534}, publisher{65533};
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
  ASSERT_TRUE(systemctl("stop"));
  ASSERT_TRUE(systemctl("start")) << output_of("systemctl status agnocastd");
  const std::uint64_t incarnation = wire_dump(socket_path).incarnation;
  Stream stream;
  ASSERT_NO_FATAL_FAILURE(stream.begin());

  for (int life = 0; life < 6; ++life) {
    const pid_t old = main_pid();
    if (life % 2 == 0) {
      ASSERT_EQ(::kill(old, SIGKILL), 0);
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
  ASSERT_TRUE(systemctl("stop"));
  ASSERT_TRUE(systemctl("start")) << output_of("systemctl status agnocastd");
  Stream stream;
  ASSERT_NO_FATAL_FAILURE(stream.begin());
  for (int life = 0; life < 4; ++life) {
    const std::uint64_t before = wire_dump(socket_path).incarnation;
    if (life % 2 == 0) {
      ASSERT_TRUE(systemctl("stop"));
      EXPECT_TRUE(stream.goes_on()) << "without a daemon";
      ASSERT_TRUE(systemctl("start"));
    } else {
      ASSERT_TRUE(systemctl("stop"));
      ASSERT_TRUE(systemctl("start"));
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

}  // namespace
}  // namespace agnocast::test
