// SPDX-License-Identifier: Apache-2.0
//
// Goal: every record of the daemon's log becomes a sentence with its subject and event, however
// little is known of it, and foreign names cannot write into a terminal. Method: hand-made
// records; every record type; the important sentences word by word.

#include <ctl/commands/objects.hpp>
#include <ctl/snapshot/journal.hpp>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include <cstring>
#include <map>
#include <set>
#include <string>

namespace agnocast::ctl {
namespace {

using journal::RecordType;
using wire::JournalRecord;
using wire::JournalState;

JournalRecord record(RecordType type, const std::map<std::string, std::uint64_t>& arguments) {
  JournalRecord result{};
  result.lsn = 4711;
  result.state = JournalState::applied;
  result.type = static_cast<std::uint32_t>(type);
  for (const auto& [name, value] : arguments) {
    const std::size_t index = journal::argument_index(type, name);
    if (index == journal::argument_count) {
      ADD_FAILURE() << journal::name_of(type) << " has no " << name;
    } else {
      result.argument[index] = value;
    }
  }
  return result;
}
JournalRecord named(JournalRecord result, const char* topic, const char* process,
                    std::uint32_t pid) {
  std::strcpy(result.topic.text, topic);
  std::strcpy(result.process.name.text, process);
  result.process.pid = pid;
  return result;
}
JournalRecord told(JournalRecord result, const char* process, std::uint32_t pid) {
  std::strcpy(result.receiver.name.text, process);
  result.receiver.pid = pid;
  return result;
}
std::string sentence(const JournalRecord& it) { return subject_of(it) + ": " + deed_of(it); }

TEST(Journal, DescribesDeathsAndRecoveries) {
  const auto publisher = [](std::uint64_t cause) {
    return sentence(named(record(RecordType::leave_publisher, {{"index", 3}, {"cause", cause}}),
                          "/points", "lidar", 812));
  };
  const std::string who = "publisher 3 of /points (lidar, pid 812): ";
  EXPECT_EQ(publisher(0), who + "left");
  EXPECT_EQ(publisher(1), who + "ended with its process, nothing was open");
  EXPECT_EQ(publisher(2), who + "ended with its process, last message rolled back");
  EXPECT_EQ(publisher(3), who + "ended with its process, last message rolled forward");
  EXPECT_EQ(publisher(4), who + "ended with its process, its last operation is corrupt");
  const auto death = [](std::uint64_t reason) {
    return sentence(named(record(RecordType::client_dead, {{"client", 7}, {"reason", reason}}), "",
                          "lidar", 812));
  };
  EXPECT_EQ(death(0), "process 7 (lidar, pid 812): died");
  EXPECT_EQ(death(1), "process 7 (lidar, pid 812): unmapped its memory and still runs");
  EXPECT_EQ(death(2), "process 7 (lidar, pid 812): was revoked and still runs");
  EXPECT_EQ(sentence(record(
                RecordType::recovered,
                {{"pid", 99}, {"redone_lsn", 4710}, {"dead_count", 1}, {"board_word_count", 2}})),
            "agnocastd (pid 99): took over, completed #4710, 1 process had died, 2 "
            "words of the board rewritten");
  EXPECT_EQ(sentence(record(RecordType::recovered, {{"pid", 99}})),
            "agnocastd (pid 99): took over, no operation was in progress, 0 processes had died, 0 "
            "words of the board rewritten");
  EXPECT_EQ(sentence(named(record(RecordType::rejoined, {{"client", 7}}), "", "lidar", 812)),
            "process 7 (lidar, pid 812): came back");
}

TEST(Journal, DescribesNotificationsAndAcknowledgements) {
  const auto kind = [](wire::Kind it) { return static_cast<std::uint64_t>(it); };
  EXPECT_EQ(sentence(told(
                named(record(RecordType::announced,
                             {{"index", 0}, {"kind", kind(wire::Kind::subscription)}, {"to", 5}}),
                      "/points", "viewer", 2),
                "lidar", 812)),
            "subscription 0 of /points (viewer, pid 2): lidar (pid 812) is notified");
  EXPECT_EQ(sentence(named(record(RecordType::unlinked,
                                  {{"index", 4}, {"kind", kind(wire::Kind::publisher)}, {"by", 5}}),
                           "/points", "lidar", 812)),
            "publisher 4 of /points (lidar, pid 812): process 5 (forgotten) has unmapped it");
  EXPECT_EQ(
      sentence(told(named(record(RecordType::unlinked,
                                 {{"client", 7}, {"kind", kind(wire::Kind::region)}, {"by", 5}}),
                          "", "lidar", 812),
                    "viewer", 2)),
      "memory of process 7 (lidar, pid 812): viewer (pid 2) has unmapped it");
}

TEST(Journal, DescribesWithdrawnReadersAndTheReason) {
  const auto withdrawn = [](std::uint64_t why) {
    return told(
        named(record(RecordType::reader_withdrawn,
                     {{"index", 0}, {"subscription", 2}, {"reader_uid", 1001}, {"why", why}}),
              "/points", "camera", 820),
        "viewer", 977);
  };
  const std::string who = "publisher 0 of /points (camera, pid 820): reports that it ";
  const std::string reader = "serves subscription 2 (viewer, pid 977, uid 1001)";
  EXPECT_EQ(sentence(withdrawn(1)),
            who + "no longer " + reader + ": it held more messages than it may");
  EXPECT_EQ(sentence(withdrawn(2)),
            who + "no longer " + reader + ": its user kept too much of the heap");
  EXPECT_EQ(sentence(withdrawn(3)),
            who + "no longer " + reader + ": its process could not be mapped");
  // The names belong to other processes now; the pids are those of the record.
  EXPECT_EQ(sentence(told(named(withdrawn(2), "", "", 820), "", 977)),
            "publisher 0 of topic 0 (forgotten) (pid 820): reports that it no longer serves "
            "subscription 2 (pid 977, uid 1001): "
            "its user kept too much of the heap");
  EXPECT_EQ(sentence(told(named(record(RecordType::reader_served_again,
                                       {{"index", 0}, {"subscription", 2}, {"reader_uid", 1001}}),
                                "/points", "camera", 820),
                          "viewer", 977)),
            who + reader + " again");
  EXPECT_EQ(sentence(named(
                record(RecordType::reader_mute, {{"index", 2}, {"wait_set", 4}, {"uid", 1001}}),
                "/points", "viewer", 977)),
            "subscription 2 of /points (viewer, pid 977): has no doorbell (wait set 4, uid 1001), "
            "it finds messages only by polling");
  const auto object = record_object(withdrawn(2), {});
  EXPECT_EQ(object["type"], "reader_withdrawn");
  EXPECT_EQ(object["arguments"]["why"], "over_share");
  EXPECT_EQ(object["arguments"]["reader_uid"], 1001);
  for (const char* const process : {"camera", "820", "viewer", "977"})
    EXPECT_TRUE(passes(withdrawn(2), {"/points", process})) << process;
}

TEST(Journal, HasASentenceForEveryRecord) {
  std::set<std::string> sentences;
  const auto check = [&](const char* name, RecordType type) {
    JournalRecord known = named(record(type, {}), "/points", "lidar", 812);
    if (type == RecordType::leave_subscription)
      known.argument[2] = static_cast<std::uint64_t>(journal::EndpointState::leaving);
    EXPECT_NE(deed_of(known), "unknown") << name;
    EXPECT_FALSE(subject_of(record(type, {})).empty()) << name;
    EXPECT_TRUE(sentences.insert(sentence(known)).second)
        << name << " has the sentence of another record: " << sentence(known);
  };
#define AGNOCAST_CHECK_SENTENCE(name, number, arguments) check(#name, RecordType::name);
  AGNOCAST_RECORD_TABLE(AGNOCAST_CHECK_SENTENCE)
#undef AGNOCAST_CHECK_SENTENCE
}

TEST(Journal, ReportsUnreadableRecords) {
  JournalRecord damaged{};
  damaged.lsn = 4711;
  damaged.state = JournalState::damaged;
  EXPECT_EQ(sentence(damaged), "record: damaged: not a valid record");
  JournalRecord strange = record(RecordType::announced, {});
  strange.type = 999;
  EXPECT_EQ(sentence(strange), "record: damaged: not a valid record");
  EXPECT_EQ(sentence(record(RecordType::free_publisher, {{"topic", 3}, {"index", 1}})),
            "publisher 1 of topic 3 (forgotten) (forgotten): removed, its entry is free");
  // A topic cannot have this name; a process can.
  EXPECT_EQ(sentence(named(record(RecordType::rejoined, {{"client", 7}}), "", "\x1b[2J", 1)),
            "process 7 (\\x1b[2J, pid 1): came back");
}

TEST(Journal, FiltersByTopicAndProcess) {
  const JournalRecord it =
      told(named(record(RecordType::announced, {}), "/points", "lidar", 812), "viewer", 2);
  EXPECT_TRUE(passes(it, {}));
  EXPECT_TRUE(passes(it, {"/points", ""}));
  EXPECT_FALSE(passes(it, {"/point", ""}));
  for (const char* const process : {"lidar", "812", "viewer", "2"})
    EXPECT_TRUE(passes(it, {"", process})) << process;
  for (const char* const process : {"0", "lida", "81"})
    EXPECT_FALSE(passes(it, {"", process})) << process;
  EXPECT_FALSE(passes(it, {"/points", "other"}));
  JournalRecord damaged{};
  damaged.state = JournalState::damaged;
  EXPECT_TRUE(passes(damaged, {}));
  EXPECT_FALSE(passes(damaged, {"/points", ""}));
}

}  // namespace
}  // namespace agnocast::ctl
