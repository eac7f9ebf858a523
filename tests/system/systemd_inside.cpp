// SPDX-License-Identifier: Apache-2.0
//
// Runs inside the machine of systemd_test.sh: our unit, real clients, kill -9, restart and stop.
//
// One test speaks the protocol by itself, so that it can say what must be known where; the other has
// two ordinary nodes of two users that never stop.

#include <tests/recovery/stage.hpp>
#include <tests/support/steered_process.hpp>
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

  // Both at once.
  const pid_t old = main_pid();
  ::kill(old, SIGKILL);
  publisher.end();
  ASSERT_TRUE(eventually([&] { return is_next(old); }));
  EXPECT_TRUE(eventually([&] { return wire_dump(socket_path).daemon.counters.clients_died == 1; }));

  ASSERT_TRUE(systemctl("stop"));
  // The count of daemons that began here stays: the next one gives out other addresses.
  EXPECT_TRUE(std::filesystem::exists("/run/agnocast/agnocastd.sock.lock"));
  ASSERT_TRUE(systemctl("start"));
  const WireDump anew = wire_dump(socket_path);
  EXPECT_NE(anew.incarnation, first.incarnation);
  EXPECT_TRUE(anew.processes.empty());
  EXPECT_EQ(property("NFileDescriptorStore"), "4");
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

TEST(Systemd, LosesNoMessageOfTwoUsersOverDeathsAndRestartsUnderTraffic) {
  ASSERT_TRUE(systemctl("stop"));
  ASSERT_TRUE(systemctl("start")) << output_of("systemctl status agnocastd");
  const std::uint64_t incarnation = wire_dump(socket_path).incarnation;
  UserNode subscriber(65534), publisher(65533);
  ASSERT_EQ(subscriber.ask("subscribe /stream"), "ok");
  ASSERT_EQ(publisher.ask("publish /stream"), "ok");
  const auto goes_on = [&] {
    const std::uint64_t wanted = subscriber.state().received + 50;
    return eventually([&] { return subscriber.state().received >= wanted; });
  };
  ASSERT_TRUE(goes_on());

  for (int life = 0; life < 6; ++life) {
    const pid_t old = main_pid();
    if (life % 2 == 0) {
      ASSERT_EQ(::kill(old, SIGKILL), 0);
    } else {
      ASSERT_TRUE(systemctl("restart"));
    }
    // Asked for while nobody is there, or while everybody comes back.
    EXPECT_EQ(publisher.ask("create /more"), "ok");
    EXPECT_EQ(subscriber.ask("create /more"), "ok");
    ASSERT_TRUE(eventually([&] { return is_next(old); }))
        << output_of("systemctl status agnocastd");
    EXPECT_TRUE(goes_on());
    EXPECT_EQ(wire_dump(socket_path).incarnation, incarnation);
  }

  ASSERT_EQ(publisher.ask("stop"), "ok");
  const UserNode::State sent = publisher.state();
  EXPECT_TRUE(eventually([&] { return subscriber.state().received == sent.published; }));
  const UserNode::State got = subscriber.state();
  EXPECT_EQ(got.received, sent.published);
  EXPECT_GE(got.received, 6u * 50u);
  EXPECT_EQ(got.lost, 0u);
  EXPECT_EQ(got.wrong, 0u);
  EXPECT_EQ(sent.refused, 0u);
  EXPECT_EQ(wire_dump(socket_path).processes.size(), 2u);
  std::printf("%llu messages over 6 lives\n", static_cast<unsigned long long>(got.received));
}

}  // namespace
}  // namespace agnocast::test
