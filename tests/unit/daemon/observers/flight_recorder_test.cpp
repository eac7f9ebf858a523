// SPDX-License-Identifier: Apache-2.0
//
// Goal: the flight recorder sends the requested records that still exist, in order and never more
// than the log holds; it names a place only while the same endpoint or process is there; a damaged
// record is sent as such. Method: the registry over anonymous memory; records overwritten, places
// reused, a bit flipped.

#include <daemon/observers/flight_recorder.hpp>
#include <tests/support/memory/registry_memory.hpp>

#include <gtest/gtest.h>

#include <cstring>
#include <string>

namespace agnocast::daemon {
namespace {

using journal::RecordType;

struct Answer {
  std::vector<wire::JournalRecord> records;
  wire::JournalEnd end{};

  const wire::JournalRecord* newest(RecordType type) const {
    for (auto at = records.rbegin(); at != records.rend(); ++at)
      if (at->type == static_cast<std::uint32_t>(type)) return &*at;
    return nullptr;
  }
};

class FlightRecorder : public testing::Test {
 protected:
  FlightRecorder() : registry(memory.parts()) { registry.create(1); }

  Answer ask(std::uint64_t last, std::uint64_t count) const {
    wire::ReadJournal request{};
    request.header.request = 7;
    request.last = last;
    request.count = count;
    Answer answer;
    const auto packets = make_journal(registry, request, 1'000);
    for (std::size_t i = 0; i < packets.size(); ++i) {
      wire::Header header{};
      std::memcpy(&header, packets[i].bytes.data(), sizeof header);
      EXPECT_EQ(header.request, 7u);
      EXPECT_EQ(header.bytes, packets[i].bytes.size());
      if (header.opcode == wire::Opcode::journal_end) {
        EXPECT_EQ(i + 1, packets.size()) << "the end comes last";
        std::memcpy(static_cast<void*>(&answer.end), packets[i].bytes.data(), sizeof answer.end);
      } else {
        answer.records.emplace_back();
        std::memcpy(static_cast<void*>(&answer.records.back()), packets[i].bytes.data(),
                    sizeof answer.records.back());
      }
    }
    EXPECT_EQ(answer.end.record_count, answer.records.size());
    for (std::size_t i = 1; i < answer.records.size(); ++i)
      EXPECT_EQ(answer.records[i].lsn, answer.records[i - 1].lsn + 1) << "in order without gaps";
    return answer;
  }
  ClientIndex client(const char* name, std::uint32_t pid) {
    return registry.add_client({1000, 1000, pid, 0, name}).value();
  }
  PublisherPlan publisher(ClientIndex owner, TopicIndex at) {
    const abi::Qos qos{1, false, true, false, false};
    const PublisherPlan plan = registry.plan_publisher(owner, at, qos).value();
    registry.add_publisher(owner, at, qos, plan, "node");
    return plan;
  }

  test::RegistryMemory memory;
  Registry registry;
};

TEST_F(FlightRecorder, SendsTheNewestExistingRecordsOnly) {
  EXPECT_TRUE(ask(0, 10).records.empty()) << "nothing has happened yet";
  const ClientIndex a = client("a", 1);
  for (std::uint64_t i = 1; i < journal::RedoLog::record_count + 10; ++i) registry.note_rejoined(a);
  const std::uint64_t newest = journal::RedoLog::record_count + 10;
  Answer answer = ask(0, 3);
  EXPECT_EQ(answer.end.newest, newest);
  EXPECT_EQ(answer.end.oldest, 11u);
  ASSERT_EQ(answer.records.size(), 3u);
  EXPECT_EQ(answer.records.back().lsn, newest);
  EXPECT_EQ(answer.records.back().state, wire::JournalState::applied);
  EXPECT_GE(answer.records[1].stamp_ns, answer.records[0].stamp_ns);
  EXPECT_GT(answer.records[0].stamp_ns, 0u);
  answer = ask(0, ~std::uint64_t{0});
  ASSERT_EQ(answer.records.size(), journal::RedoLog::record_count);
  EXPECT_EQ(answer.records.front().lsn, 11u);
  EXPECT_EQ(ask(12, 5).records.size(), 2u) << "11 and 12; older ones are overwritten";
  EXPECT_TRUE(ask(10, 5).records.empty());
  EXPECT_EQ(ask(~std::uint64_t{0}, 1).records.at(0).lsn, newest);
  EXPECT_TRUE(ask(0, 0).records.empty()) << "the answer has only the newest number";
  EXPECT_EQ(ask(0, 0).end.now_ns, 1'000u);
}

TEST_F(FlightRecorder, NamesAPlaceOnlyUntilItIsReused) {
  const ClientIndex a = client("lidar", 812), b = client("viewer", 813);
  const TopicIndex t = registry.add_topic({0, "/points", "T", 1}).value();
  const auto p = publisher(a, t);
  const EndpointRef ref{Kind::publisher, t, p.index};
  registry.notify(ref, b);
  registry.acknowledge_unmap(ref, b);
  registry.acknowledge_region_unmap(a, b);
  registry.orphan_publisher(t, p.index, 0, journal::LeaveCause::rolled_back);
  const auto check = [&](bool known) {
    const Answer answer = ask(0, 100);
    for (const RecordType type :
         {RecordType::add_publisher, RecordType::announced, RecordType::leave_publisher}) {
      const auto* const record = answer.newest(type);
      ASSERT_NE(record, nullptr);
      EXPECT_STREQ(record->topic.text, known ? "/points" : "");
      EXPECT_STREQ(record->process.name.text, known ? "lidar" : "");
      EXPECT_EQ(record->process.pid, known ? 812u : 0u);
    }
    EXPECT_STREQ(answer.newest(RecordType::announced)->receiver.name.text, known ? "viewer" : "");
    const auto* const unlinked = answer.newest(RecordType::unlinked);
    EXPECT_STREQ(unlinked->topic.text, "") << "a region belongs to no topic";
    EXPECT_STREQ(unlinked->process.name.text, known ? "lidar" : "");
    EXPECT_STREQ(unlinked->receiver.name.text, known ? "viewer" : "");
  };
  check(true);
  registry.end_publisher(t, p.index, EndpointState::free);
  registry.free_topic(t);
  for (const ClientIndex gone : {a, b}) {
    registry.client_died(gone, journal::DeathReason::died);
    registry.client_forgotten(gone);
    registry.free_client(gone);
  }
  check(true);  // the places are not reused yet
  EXPECT_EQ(client("thief", 900), a);
  EXPECT_EQ(client("other", 901), b);
  EXPECT_EQ(registry.add_topic({0, "/other", "T", 1}).value(), t);
  check(false);
  EXPECT_STREQ(ask(0, 1).records.at(0).topic.text, "/other");
}

TEST_F(FlightRecorder, NamesBothSidesOfAWithdrawalAndKeepsTheirPids) {
  const ClientIndex a = client("lidar", 812), b = client("viewer", 813);
  const TopicIndex t = registry.add_topic({0, "/points", "T", 1}).value();
  const auto p = publisher(a, t);
  const abi::Qos qos{1, false, true, false, false};
  const auto s = registry.plan_subscription(b, t, qos, {1, 1}).value();
  registry.add_subscription(b, t, qos, {1, 1}, 5, s, "node");
  const EndpointRef reader{Kind::subscription, t, s.index};
  registry.note_withdrawn({{Kind::publisher, t, p.index}, reader}, abi::Withdrawal::over_share);
  registry.note_served_again({{Kind::publisher, t, p.index}, reader});
  registry.note_mute(reader);
  const auto check = [&](bool known) {
    const Answer answer = ask(0, 100);
    for (const RecordType type : {RecordType::reader_withdrawn, RecordType::reader_served_again}) {
      const auto* const record = answer.newest(type);
      ASSERT_NE(record, nullptr);
      const auto argument = [&](const char* name) {
        return record->argument[journal::argument_index(type, name)];
      };
      EXPECT_STREQ(record->topic.text, known ? "/points" : "");
      EXPECT_STREQ(record->process.name.text, known ? "lidar" : "");
      EXPECT_STREQ(record->receiver.name.text, known ? "viewer" : "");
      EXPECT_EQ(record->process.pid, 812u);
      EXPECT_EQ(record->receiver.pid, 813u);
      EXPECT_EQ(argument("uid"), 1000u);
      EXPECT_EQ(argument("reader_uid"), 1000u);
      EXPECT_EQ(argument("subscription"), s.index);
    }
    const auto* const mute = answer.newest(RecordType::reader_mute);
    ASSERT_NE(mute, nullptr);
    EXPECT_EQ(mute->process.pid, 813u);
    EXPECT_EQ(mute->receiver.pid, 0u);
  };
  check(true);
  EXPECT_EQ(ask(0, 3).records.at(0).argument[11],
            static_cast<std::uint64_t>(abi::Withdrawal::over_share));
  EXPECT_EQ(registry.counters().readers_withdrawn, 1u);
  EXPECT_EQ(registry.counters().readers_served_again, 1u);
  EXPECT_EQ(registry.counters().readers_mute, 1u);
  registry.orphan_publisher(t, p.index, 0, journal::LeaveCause::nothing_open);
  registry.end_publisher(t, p.index, EndpointState::free);
  registry.change_subscription(t, s.index, EndpointState::dead);
  registry.free_subscription(t, s.index);
  registry.free_topic(t);
  for (const ClientIndex gone : {a, b}) {
    registry.client_died(gone, journal::DeathReason::died);
    registry.client_forgotten(gone);
    registry.free_client(gone);
  }
  EXPECT_EQ(client("thief", 900), a);
  EXPECT_EQ(client("other", 901), b);
  EXPECT_EQ(registry.add_topic({0, "/other", "T", 1}).value(), t);
  check(false);
}

TEST_F(FlightRecorder, RecordsAndCountsTheReasonOfADeath) {
  const ClientIndex a = client("a", 1), b = client("b", 2), c = client("c", 3);
  registry.client_died(a, journal::DeathReason::died);
  registry.client_died(b, journal::DeathReason::revoked);
  registry.client_died(c, journal::DeathReason::unmapped);
  EXPECT_EQ(ask(0, 1).records.at(0).argument[2], 1u) << "DeathReason::unmapped";
  registry.note_recovered({.pid = 44, .dead_count = 2, .board_word_count = 3});
  const auto recovered = ask(0, 1).records.at(0);
  EXPECT_EQ(recovered.argument[0], 44u);
  EXPECT_EQ(recovered.argument[2], 2u);
  EXPECT_EQ(recovered.argument[3], 3u);
  const wire::DaemonCounters& counters = registry.counters();
  EXPECT_EQ(counters.clients_registered, 3u);
  EXPECT_EQ(counters.clients_died, 1u);
  EXPECT_EQ(counters.clients_revoked, 1u);
  EXPECT_EQ(counters.clients_unmapped, 1u);
  EXPECT_EQ(counters.restarts, 1u);
  EXPECT_EQ(counters.clients_died_meanwhile, 2u);
}

TEST_F(FlightRecorder, CountsOnceEvenIfARecordIsRedone) {
  const ClientIndex a = client("a", 1);
  registry.client_died(a, journal::DeathReason::died);
  // The word at 128 of the log is `applied` (journal/redo_log.hpp).
  auto& applied = SharedMemory::word(memory.parts().log, 128);
  for (int again = 0; again < 3; ++again) {
    applied.store(applied.load() - 1);
    EXPECT_EQ(ask(0, 1).records.at(0).state, wire::JournalState::pending);
    Registry next(memory.parts());
    ASSERT_TRUE(next.open());
    EXPECT_EQ(next.redone_lsn(), 2u);
    EXPECT_EQ(next.counters().clients_died, 1u);
    EXPECT_EQ(next.counters().clients_registered, 1u) << "counters survive a daemon restart";
  }
  EXPECT_EQ(ask(0, 1).records.at(0).state, wire::JournalState::applied);
}

TEST_F(FlightRecorder, MarksADamagedRecord) {
  const ClientIndex a = client("a", 1);
  for (int i = 0; i < 3; ++i) registry.note_rejoined(a);
  memory.parts().log[abi::page_bytes + 2 * sizeof(journal::Record) + 30] ^= std::byte{4};
  const Answer answer = ask(0, 10);
  ASSERT_EQ(answer.records.size(), 4u);
  EXPECT_EQ(answer.records[1].state, wire::JournalState::damaged);
  EXPECT_EQ(answer.records[1].lsn, 2u);
  EXPECT_EQ(answer.records[1].stamp_ns, 0u) << "none of its content is sent";
  EXPECT_EQ(answer.records[2].state, wire::JournalState::applied);
}

}  // namespace
}  // namespace agnocast::daemon
