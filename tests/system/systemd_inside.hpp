// SPDX-License-Identifier: Apache-2.0
//
// The daemon's units under a systemd of their own, and users with traffic, for systemd_inside.cpp
// and systemd_unit_inside.cpp.
#pragma once

#include <base/memory/memfd.hpp>
#include <tests/recovery/stage.hpp>
#include <tests/support/machine/systemctl.hpp>
#include <tests/support/processes/steered_process.hpp>
#include <tests/support/soon.hpp>
#include <tests/support/wire/wire_client.hpp>
#include <tests/support/wire/wire_dump.hpp>
#include <tests/support/wire/wire_node.hpp>

#include <grp.h>
#include <gtest/gtest.h>
#include <pwd.h>
#include <sys/prctl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <string>

namespace agnocast::test {

using sweep::Child;
using sweep::serve;

inline constexpr const char* socket_path = "/run/agnocast/agnocastd.sock";
inline constexpr abi::Qos deep{10, false, true, false, false};

inline std::string property(const char* name) { return property_of("agnocastd", name); }
inline bool systemctl(const std::string& verb, const std::string& unit = "agnocastd.service") {
  return run_systemctl(verb, unit);
}
inline bool exists(const std::string& path) { return std::filesystem::exists(path); }
inline bool socket_listens() {
  return output_of("systemctl is-active agnocastd.socket") == "active" && exists(socket_path);
}
/// Without the socket no connection restarts the daemon.
inline bool stop_both() {
  return systemctl("stop", "agnocastd.socket") && property("ActiveState") == "inactive";
}
inline bool goes_on_with_what_was() {
  return property("StatusText") == "serving; continues the previous run";
}
inline pid_t main_pid() { return main_pid_of("agnocastd"); }
/// kill(2) to one process: an unknown pid is no process, and 0 would be all processes in the
/// test's group.
inline int send(pid_t pid, int signal) { return pid > 1 ? ::kill(pid, signal) : -1; }
inline bool is_another(pid_t now, pid_t old) { return now > 0 && now != old; }
inline bool is_next(pid_t old) {
  return is_another(main_pid(), old) && property("ActiveState") == "active" &&
         property("SubState") == "running";
}

/// Returns how many lines of the unit's log have this text.
inline std::size_t said(const std::string& text) {
  return std::strtoul(
      output_of("journalctl -u agnocastd -o cat --no-pager | grep -c -F -- '" + text + "'").c_str(),
      nullptr, 10);
}

/// Adds lines to [Service] of the daemon's unit, until destroyed.
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
/// Nothing but an order starts the daemon again after the end of its main process.
inline constexpr const char* no_start = "RestartSec=1h";
inline bool is_away() {
  return property("MainPID") == "0" && property("SubState") == "auto-restart";
}

/// Replaces the program of the unit as a package would: another file under the same name.
inline void install(const char* program) {
  namespace fs = std::filesystem;
  const std::string name = "/usr/bin/agnocastd";
  fs::copy_file(program, name + ".new", fs::copy_options::overwrite_existing);
  fs::rename(name + ".new", name);
}

using sweep::answer;
inline Child publisher_child() {
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

/// An honest_node (tests/hostile/) of a user that is not root, with all groups of that user.
/// `before` is a program that runs it.
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
inline constexpr const char* one = "agnocast-one";
inline constexpr const char* two = "agnocast-two";
inline constexpr const char* stranger = "agnocast-stranger";

/// Returns the pid of this user's only process.
inline pid_t pid_in(const WireDump& all, const char* user) {
  const passwd* const entry = ::getpwnam(user);
  for (const wire::DumpProcess& process : all.processes) {
    if (entry != nullptr && process.uid == entry->pw_uid) return static_cast<pid_t>(process.pid);
  }
  ADD_FAILURE() << user << " has no process";
  return 0;
}

/// Creates an endpoint, again while the daemon has not answered within five seconds: load alone may
/// delay it for so long. No other refusal is accepted.
inline bool creates(UserNode& node, const std::string& line) {
  return soon([&] {
    const auto began = std::chrono::steady_clock::now();
    const std::string answer = node.ask(line);
    const bool is_late = answer.find("agnocastd does not answer") != std::string::npos &&
                         std::chrono::steady_clock::now() - began >= std::chrono::seconds(5);
    EXPECT_TRUE(answer == "ok" || is_late) << answer;
    return !is_late;
  });
}
inline bool creates_more(UserNode& node) { return creates(node, "create /more"); }

/// A stream from one user to another, until the end.
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
    return soon([&] { return subscriber.state().received >= wanted; });
  }
  /// Checks that every published message has arrived, and is right.
  void end() {
    ASSERT_EQ(publisher.ask("stop"), "ok");
    const UserNode::State sent = publisher.state();
    EXPECT_TRUE(soon([&] { return subscriber.state().received == sent.published; }));
    got = subscriber.state();
    EXPECT_EQ(got.received, sent.published);
    EXPECT_EQ(got.lost, 0u);
    EXPECT_EQ(got.wrong, 0u);
    EXPECT_EQ(sent.refused, 0u);
  }
};

}  // namespace agnocast::test
