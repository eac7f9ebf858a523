// SPDX-License-Identifier: Apache-2.0
//
// Goal: remedies are commands whatever the names in them hold, and of the reasons for which there is no daemon
// exactly one is named. Method: the functions alone, and facts made up.

#include <agnocast/error.hpp>
#include <ctl/doctor_facts.hpp>

#include <gtest/gtest.h>

#include <cerrno>
#include <cstdio>
#include <string>

namespace agnocast::ctl {
namespace {

std::string said_by_shell(const std::string& word) {
  std::FILE* const shell =
      ::popen(("bash -c \"$(cat <<'END'\nprintf %s " + word + "\nEND\n)\"").c_str(), "r");
  std::string said;
  for (int c = 0; shell != nullptr && (c = std::fgetc(shell)) != EOF;) said += static_cast<char>(c);
  EXPECT_EQ(::pclose(shell), 0) << word;
  return said;
}

TEST(DoctorFill, MakesOneWordOfWhateverThereIs) {
  EXPECT_EQ(shell_word("/run/agnocast/agnocastd.sock"), "/run/agnocast/agnocastd.sock");
  EXPECT_EQ(shell_word(""), "''");
  for (const std::string& text :
       {std::string("; rm -rf /"), std::string("$(id)"), std::string("it's"), std::string("a\\b"),
        std::string("two\nlines"), std::string("\x1b[31m"), std::string("`id`"), std::string("~"),
        std::string("*?[a]"), std::string("\"$HOME\"")}) {
    const std::string word = shell_word(text);
    EXPECT_EQ(said_by_shell(word), text) << word;
    for (const char c : word) EXPECT_TRUE(c >= ' ' && c < 127) << word;
  }
}

TEST(DoctorFill, FillsWholeWordsOnceAndLeavesTheRest) {
  const Fill common{{"START", "start it"}, {"FILE", "/etc/PID"}};
  EXPECT_EQ(filled("kill -CONT PID && START", {{"PID", "12"}}, common),
            "kill -CONT 12 && start it");
  EXPECT_EQ(filled("unset AGNOCAST_SOCKET", {{"SOCKET", "x"}}, common), "unset AGNOCAST_SOCKET");
  EXPECT_EQ(filled("edit FILE", {{"PID", "12"}}, common), "edit /etc/PID")
      << "values are not looked into";
  EXPECT_EQ(filled("COMMAND", {}, common), "COMMAND");
  EXPECT_EQ(filled("", {}, common), "");
}

// Every way in which a daemon can be out of reach, put together from what can be seen of it, is named by
// exactly one check; with a daemon there, none of them speaks.
TEST(DoctorDoor, NamesOneReasonWhateverThereIs) {
  using Kind = Door::Kind;
  std::uint64_t cases = 0;
  for (const Kind kind : {Kind::nothing, Kind::socket, Kind::other}) {
    for (const char* const closed : {"", "/closed"}) {
      for (const int error : {0, ECONNREFUSED, EACCES, EPROTOTYPE, ETIMEDOUT, EIO}) {
        for (const Errc code :
             {Errc::daemon_not_running, Errc::permission_denied, Errc::layout_mismatch,
              Errc::store_damaged, Errc::quota_exceeded, Errc::protocol_violation,
              Errc::descriptors_withheld, Errc::os_failure, Errc::internal}) {
          for (const unsigned bits : {0u, 1u, 2u, 3u, 4u, 5u, 6u, 7u}) {
            // Nobody answers where there is nothing, or nothing that can be walked to.
            const bool can_answer = kind == Kind::socket && *closed == '\0';
            if (!can_answer && (error != 0 || code != Errc::daemon_not_running)) continue;
            if (*closed != '\0' && kind != Kind::nothing) continue;
            // A code of the daemon's comes only when it was reached.
            if (error != 0 && code != Errc::daemon_not_running) continue;
            Facts facts;
            facts.away = Problem{Status::failed, "what", "why", "hint", code};
            facts.door.kind = kind;
            facts.door.closed = closed;
            facts.door.error = error;
            facts.door.gid = 60;
            facts.door.mode = (bits & 1) != 0 ? 0660 : 0600;
            facts.door.group_lists_user = (bits & 2) != 0;
            if ((bits & 4) != 0)
              facts.users_socket = kind == Kind::nothing && *closed == '\0' ? "/run/user/7" : "";
            std::string said;
            int speaking = 0;
            for (const Check& check : door_checks) {
              if (check.needs == Check::Needs::daemon || check.find(facts).empty()) continue;
              ++speaking;
              said += std::string(check.id) + ' ';
            }
            EXPECT_EQ(speaking, 1)
                << said << "kind " << int(kind) << " closed " << closed << " error " << error
                << " code " << word_of(code) << " bits " << bits;
            ++cases;
            facts.away.reset();
            facts.door.error = 0;
            facts.users_socket.clear();
            for (const Check& check : door_checks) {
              if (check.needs == Check::Needs::nothing) {
                EXPECT_TRUE(check.find(facts).empty()) << check.id;
              }
            }
          }
        }
      }
    }
  }
  EXPECT_GT(cases, 100u);
}

TEST(DoctorDoor, SaysStoppedAndNothingElseOfAStoppedDaemon) {
  Facts facts;
  facts.away = Problem{Status::not_reachable, {}, {}, {}, Errc::daemon_not_running};
  facts.door.kind = Door::Kind::socket;
  facts.door.listener = 4711;
  facts.door.listener_stopped = true;
  for (const Check& check : door_checks) {
    if (check.needs == Check::Needs::daemon) continue;
    EXPECT_EQ(check.find(facts).size(), check.id == "daemon-stopped" ? 1u : 0u) << check.id;
  }
}

TEST(DoctorFacts, CommandsOfTheSystemsDaemonAreSystemds) {
  Facts facts;
  facts.door.path = system_socket;
  facts.door.is_systems = true;
  EXPECT_EQ(facts.common()["START"], "sudo systemctl start agnocastd");
  EXPECT_EQ(facts.common()["RELOAD"], "sudo systemctl restart agnocastd");
  EXPECT_EQ(facts.common()["FILE"], "/etc/agnocast/agnocastd.toml");
  EXPECT_EQ(
      facts.configure("quota", "topics", 8),
      "NEW=\"$(agnocastd --print-config | sed '/^\\[quota\\]/,/^\\[/s/^topics = .*/topics = 8/')\""
      " && [ -n \"$NEW\" ] && printf '%s\\n' \"$NEW\" | sudo tee "
      "/etc/agnocast/agnocastd.toml > /dev/null");
  facts.door.path = "/tmp/my dir/a.sock";
  facts.door.is_systems = false;
  facts.supervisor = 12;
  facts.configuration = "/tmp/c.toml";
  EXPECT_EQ(facts.common()["START"],
            "agnocastd --socket '/tmp/my dir/a.sock' --config /tmp/c.toml &");
  EXPECT_EQ(facts.common()["RELOAD"], "kill -HUP 12");
  EXPECT_EQ(facts.common()["ANEW"],
            "kill 12 && flock '/tmp/my dir/a.sock.lock' true && " + facts.common()["START"]);
}

}  // namespace
}  // namespace agnocast::ctl
