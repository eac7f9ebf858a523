// SPDX-License-Identifier: Apache-2.0
//
// Goal: remedies are safe commands whatever names they contain, and the doctor names exactly one
// reason why the daemon is out of reach. Method: the functions alone, with invented facts.

#include <tests/support/processes/shell.hpp>

#include <agnocast/error.hpp>
#include <ctl/doctor/doctor_facts.hpp>

#include <gtest/gtest.h>

#include <unistd.h>

#include <cerrno>
#include <filesystem>
#include <fstream>
#include <stdexcept>
#include <string>
#include <string_view>

namespace agnocast::ctl {
namespace {

std::string said_by_shell(const std::string& word) {
  const auto said = test::run_in_shell("bash -c \"$(cat <<'END'\nprintf %s " + word + "\nEND\n)\"");
  EXPECT_EQ(said.status, 0) << word;
  return said.text;
}

TEST(DoctorFill, QuotesAnyTextAsOneWord) {
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
      << "placeholders in values are not replaced";
  EXPECT_EQ(filled("COMMAND", {}, common), "COMMAND");
  EXPECT_EQ(filled("", {}, common), "");
}

// Every way in which a daemon can be out of reach, combined from what can be seen of it, triggers
// exactly one check; with a daemon present, none of them.
TEST(DoctorDoor, NamesExactlyOneReasonInEverySituation) {
  using Kind = Door::Kind;
  std::uint64_t cases = 0;
  for (const Kind kind : {Kind::nothing, Kind::socket, Kind::other}) {
    for (const char* const closed : {"", "/closed"}) {
      for (const int error : {0, ECONNREFUSED, EACCES, EPROTOTYPE, ETIMEDOUT, EIO}) {
        for (const Errc code : {Errc::daemon_not_running, Errc::permission_denied,
                                Errc::layout_mismatch, Errc::store_damaged, Errc::quota_exceeded,
                                Errc::protocol_violation, Errc::descriptors_withheld,
                                Errc::daemon_untrusted, Errc::os_failure, Errc::internal}) {
          for (const unsigned bits : {0u, 1u, 2u, 3u, 4u, 5u, 6u, 7u}) {
            // No answer comes where there is no socket, or where the path is closed.
            const bool can_answer = kind == Kind::socket && *closed == '\0';
            if (!can_answer && (error != 0 || code != Errc::daemon_not_running)) continue;
            if (*closed != '\0' && kind != Kind::nothing) continue;
            // An error code of the daemon comes only if it was reached.
            if (error != 0 && code != Errc::daemon_not_running) continue;
            // Not on the stack, where GCC 12 takes the optional for uninitialized.
            const auto owned = std::make_unique<Facts>();
            Facts& facts = *owned;
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

TEST(DoctorDoor, ReportsAStoppedDaemonOnlyAsStopped) {
  Facts facts;
  facts.away.emplace(Problem{Status::not_reachable, {}, {}, {}, Errc::daemon_not_running});
  facts.door.kind = Door::Kind::socket;
  facts.door.listener = 4711;
  facts.door.listener_stopped = true;
  for (const Check& check : door_checks) {
    if (check.needs == Check::Needs::daemon) continue;
    EXPECT_EQ(check.find(facts).size(), check.id == "daemon-stopped" ? 1u : 0u) << check.id;
  }
}

TEST(DoctorFacts, CommandsForTheSystemDaemonUseSystemd) {
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

const Check& bridge_check(std::string_view id) {
  for (const Check& check : bridge_checks)
    if (check.id == id) return check;
  throw std::out_of_range(std::string(id));
}

TEST(DoctorBridge, StartsTheUnitOfTheDomainAndNoSecondOne) {
  Facts facts;
  facts.door.is_systems = true;
  facts.unit_domain = 3;
  facts.dead_bridges = {{"/run/agnocast-bridge/bridge-3.sock", 3},
                        {"/run/agnocast-bridge/bridge-7.sock", 7}};
  const Check& check = bridge_check("bridge-not-running");
  auto found = check.find(facts);
  ASSERT_EQ(found.size(), 2u);
  EXPECT_EQ(found[0].words["BRIDGE"], "sudo systemctl enable --now agnocast-bridge");
  EXPECT_EQ(found[1].words["BRIDGE"], "sudo systemctl enable --now agnocast-bridge@7");
  facts.idle_bridge_units = {"agnocast-bridge.service", "agnocast-bridge@7.service"};
  found = check.find(facts);
  ASSERT_EQ(found.size(), 2u) << "each unit once, without its socket";
  EXPECT_EQ(found[0].words["BRIDGE"],
            "sudo systemctl restart agnocast-bridge.service || journalctl -u "
            "agnocast-bridge.service -n 20 --no-pager");
  facts.idle_bridge_units.clear();
  facts.dead_bridges.clear();
  facts.rival_bridge_unit = "agnocast-bridge@3.service";
  found = check.find(facts);
  ASSERT_EQ(found.size(), 1u);
  EXPECT_EQ(found[0].words["BRIDGE"],
            "sudo systemctl disable --now agnocast-bridge@3.service && sudo systemctl restart "
            "agnocast-bridge");
}

TEST(DoctorBridge, AddsTheLibrariesOfThisShellToThoseOfTheUnits) {
  const std::string prefix =
      std::string(::testing::TempDir()) + "doctor_test-" + std::to_string(::getpid());
  std::filesystem::create_directories(prefix + "/closed/lib");
  std::filesystem::permissions(prefix + "/closed", std::filesystem::perms(0750));
  std::ofstream(prefix + "/closed/lib/libmine_msgs__rosidl_typesupport_introspection_cpp.so") << "";
  Facts facts;
  facts.door.is_systems = true;
  BridgeState bridge;
  bridge.pid = 12;
  bridge.unbridged.push_back({"/mine", "mine_msgs/msg/Own", "unknown_type", "", true, false});
  facts.bridges = {bridge};
  facts.bridge_units[12] = "agnocast-bridge@7.service";
  facts.units_prefix_path = "/opt/old:/opt/both";
  const Check& check = bridge_check("bridge-type");
  auto found = check.find(facts);
  ASSERT_EQ(found.size(), 1u);
  EXPECT_EQ(filled(check.remedy, found[0].words, {}),
            ". WORKSPACE/setup.sh && agnocast-ctl doctor  # WORKSPACE has mine_msgs");
  facts.prefix_path = "/opt/both:" + prefix + "/closed";
  found = check.find(facts);
  ASSERT_EQ(found.size(), 1u);
  const std::string remedy = filled(check.remedy, found[0].words, {});
  EXPECT_NE(remedy.find("sudo chmod o+x " + shell_word(prefix + "/closed") + " && echo " +
                        shell_word("AMENT_PREFIX_PATH=/opt/both:" + prefix + "/closed:/opt/old") +
                        " | sudo tee -a /etc/default/agnocast-bridge && sudo systemctl restart "
                        "agnocast-bridge@7.service"),
            std::string::npos)
      << remedy;
  std::filesystem::remove_all(prefix);
}

TEST(DoctorBridge, GivesUnitsTheRangeOfTheShell) {
  Facts facts;
  facts.bridges.emplace_back();
  facts.bridges[0].pid = 5;
  facts.bridges[0].domain = 7;
  facts.bridge_units[5] = "agnocast-bridge@7.service";
  const auto remedy = [&](const std::string& shell, const std::string& bridge) {
    facts.shell_range = shell;
    facts.bridge_ranges[5] = bridge;
    const auto found = bridge_check("bridge-range").find(facts);
    return found.empty() ? std::string() : found[0].words.at("RANGE");
  };
  const std::string restart =
      " | sudo tee -a /etc/default/agnocast-bridge && sudo systemctl restart "
      "agnocast-bridge@7.service";
  EXPECT_EQ(remedy("", "ROS_LOCALHOST_ONLY=1"), "") << "sudo removes a shell's variables";
  facts.shell_has_range = true;
  EXPECT_EQ(remedy("", ""), "");
  EXPECT_EQ(remedy("ROS_LOCALHOST_ONLY=1", "ROS_LOCALHOST_ONLY=1"), "");
  const auto writes = [&](const std::string& words) { return "printf '%s\\n' " + words + restart; };
  EXPECT_EQ(remedy("ROS_LOCALHOST_ONLY=1", ""), writes("ROS_LOCALHOST_ONLY=1"));
  const std::string subnet = "ROS_LOCALHOST_ONLY=0 ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET";
  EXPECT_EQ(remedy("", "ROS_LOCALHOST_ONLY=1"), writes(subnet));
  EXPECT_EQ(remedy("", "ROS_AUTOMATIC_DISCOVERY_RANGE=OFF"), writes(subnet));
  EXPECT_EQ(remedy("ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST", "ROS_LOCALHOST_ONLY=1"),
            writes("ROS_LOCALHOST_ONLY=0 ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST"));
}

TEST(DoctorBridge, MovesAFileThatUnitsCannotSeeToWhereTheyCan) {
  Facts facts;
  facts.hidden_cyclonedds_file = "/tmp/c.xml";
  const auto found = bridge_check("cyclonedds-uri").find(facts);
  ASSERT_EQ(found.size(), 1u);
  EXPECT_EQ(found[0].words.at("URI"),
            "sudo install -D -m 644 /tmp/c.xml /etc/agnocast/cyclonedds.xml && sudo sed -i "
            "'/^CYCLONEDDS_URI=/s|/tmp/c.xml|/etc/agnocast/cyclonedds.xml|' "
            "/etc/default/agnocast-bridge && sudo systemctl restart 'agnocast-bridge*'");
}

}  // namespace
}  // namespace agnocast::ctl
