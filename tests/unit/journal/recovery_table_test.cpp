// SPDX-License-Identifier: Apache-2.0
//
// Goal: the tables of recovery are complete and unambiguous, docs/recovery.md explains exactly
// these rows, and the shipped code decides as they do. Method: feed every combination of possible
// findings to every table, where it must match one row; every row must be matched; compare the
// document's labels and decisions with the code's; run a publisher's reclamation scan, announce
// set, announcement state and redo log for every combination of theirs.

#include <agnocast/abi/client_region.hpp>
#include <dataplane/publisher_core.hpp>
#include <journal/announce_set.hpp>
#include <journal/board_steps.hpp>
#include <journal/cases.hpp>
#include <journal/queue_recovery.hpp>
#include <journal/record.hpp>
#include <journal/redo_log.hpp>
#include <tests/support/memory/aligned_region.hpp>
#include <tests/support/recovery_document.hpp>

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cstdio>
#include <functional>
#include <map>
#include <memory>
#include <set>
#include <string>

namespace agnocast::journal {
namespace {

using M = SharedMemory;

/// Calls `visit` with every combination: one kind per field.
template <std::size_t field_count>
void for_each_combination(
    const std::array<unsigned, field_count>& kinds,
    const std::function<void(const std::array<std::uint8_t, field_count>&)>& visit) {
  std::array<unsigned, field_count> at{};
  for (;;) {
    std::array<std::uint8_t, field_count> found{};
    for (std::size_t i = 0; i < field_count; ++i) found[i] = static_cast<std::uint8_t>(1u << at[i]);
    visit(found);
    std::size_t i = 0;
    while (i < field_count && ++at[i] == kinds[i]) at[i++] = 0;
    if (i == field_count) return;
  }
}

std::size_t combinations = 0, rows_seen = 0;

/// Checks that each combination matches one row, that each row matches, and the document.
template <class Decision, std::size_t field_count, std::size_t row_count>
void check_table(const CaseRow<Decision, field_count> (&rows)[row_count],
                 const std::array<unsigned, field_count>& kinds,
                 std::map<std::string, std::vector<std::string>>& document) {
  std::map<std::string, int> used;
  for_each_combination<field_count>(kinds, [&](const auto& found) {
    ++combinations;
    std::string labels;
    for (const auto& row : rows) {
      if (!row.matches(found)) continue;
      labels += std::string(row.label) + ' ';
      ++used[row.label];
    }
    std::string what;
    for (const std::uint8_t field : found) what += std::to_string(field) + ' ';
    ASSERT_EQ(std::count(labels.begin(), labels.end(), ' '), 1)
        << "found " << what << "matches: " << labels;
    EXPECT_EQ(case_of(rows, found).label + std::string(" "), labels);
  });
  for (const auto& row : rows) {
    ++rows_seen;
    EXPECT_GT(used[row.label], 0) << row.label << " is never found";
    const auto documented = document.find(row.label);
    ASSERT_NE(documented, document.end()) << "docs/recovery.md does not have " << row.label;
    ASSERT_EQ(documented->second.size(), 4u) << row.label;
    EXPECT_EQ(documented->second[2], '`' + std::string(word_of(row.decision)) + '`') << row.label;
    for (const std::string& column : documented->second)
      EXPECT_FALSE(column.empty()) << row.label << " has an empty column";
    document.erase(documented);
  }
}

TEST(RecoveryTables, HaveExactlyOneRowPerCombinationAndTheDocumentExplainsEach) {
  auto document = test::read_recovery_document();
  const std::size_t documented = document.size();
  check_table<IntentDecision, 3>(intent::rows, {3, 3, 2}, document);
  check_table<RemainsDecision, 5>(remains::rows, {3, 2, 2, 2, 2}, document);
  check_table<LogDecision, 4>(log::rows, {2, 2, 3, 2}, document);
  check_table<AnnounceDecision, 3>(announce::rows, {2, 2, 3}, document);
  check_table<RequestDecision, 3>(request::rows, {5, 2, 3}, document);
  check_table<RejoinDecision, 6>(rejoin::rows, {2, 2, 2, 2, 3, 2}, document);
  check_table<StoredDecision, 3>(stored::rows, {6, 2, 4}, document);
  check_table<FoundDecision, 3>(found::rows, {3, 2, 2}, document);
  check_table<EndDecision, 3>(end::rows, {3, 2, 2}, document);
  check_table<BroughtDecision, 6>(brought::rows, {3, 2, 2, 2, 2, 2}, document);
  // Redo: one row for every kind of record; tests/unit/daemon/state/redo_test.cpp runs them.
#define AGNOCAST_CHECK_RECORD(name, number, arguments)                                            \
  if (number != 0) {                                                                              \
    const auto row = document.find("@R" #number);                                                 \
    ASSERT_NE(row, document.end()) << "docs/recovery.md does not have @R" #number " (" #name ")"; \
    EXPECT_EQ(row->second.at(0), "`" #name "`");                                                  \
    EXPECT_EQ(row->second.size(), 4u) << #name;                                                   \
    document.erase(row);                                                                          \
    ++rows_seen;                                                                                  \
  }
  AGNOCAST_RECORD_TABLE(AGNOCAST_CHECK_RECORD)
#undef AGNOCAST_CHECK_RECORD
  for (const auto& [label, columns] : document)
    ADD_FAILURE() << label << " is in docs/recovery.md, but no table has it";
  std::printf("recovery tables: %zu rows, %zu combinations, each with exactly one row\n", rows_seen,
              combinations);
  EXPECT_EQ(rows_seen, documented);
}

TEST(RecoveryTables, DecideIntentsFromTheirCopies) {
  using namespace intent;
  constexpr std::uint64_t slots = 4, head = 100;
  std::set<std::string> labels;
  for (const std::uint64_t op :
       {std::uint64_t{0}, abi::intent_publish, std::uint64_t{2}, ~std::uint64_t{0}}) {
    for (const std::uint64_t sequence : {std::uint64_t{0}, head - 1, head, head + 1, head + 2}) {
      for (std::uint64_t slot = 0; slot <= slots; ++slot)
        labels.insert(intent_case({op, sequence, slot, abi::pack_entry(head, 1)}, slots).label);
    }
  }
  EXPECT_EQ(labels.size(), std::size(rows));
  EXPECT_EQ(decide({abi::intent_publish, head + 1, 3, abi::pack_entry(head, 1)}, slots),
            IntentDecision::roll_back);
  EXPECT_EQ(decide({abi::intent_publish, head, 9, abi::pack_entry(head, 1)}, slots),
            IntentDecision::roll_forward);
}

// --- S, as the shipped reclamation scan does it

struct Freed {
  std::set<std::uint64_t> live;
  void ring(std::uint64_t, std::uint64_t) {}
  void freed(std::uint64_t, std::uint64_t address) { live.erase(address); }
};

bool scan_keeps(const std::array<std::uint8_t, 5>& found) {
  constexpr std::uint64_t generation = 9, extent = abi::page_bytes, member = 1;
  const std::uint64_t first = abi::first_sequence_of(generation);
  test::AlignedRegion board{abi::topic_bytes}, publisher, subscriber;
  const region::TopicWords<M> topic{board.base(), 0};
  const region::PublisherWords<M> words{publisher.base(), extent};
  const abi::Qos offered{4, false, true, false, false}, requested{8, false, true, false, false};
  words.head().store(abi::pack_entry(first, 0));
  BoardSteps<M> steps(topic);
  steps.add_publisher(0, generation, {offered, 0, extent, 64});
  steps.add_subscription(0, member, {requested, 1, extent, 8, 0});
  auto core = std::make_unique<dataplane::PublisherCore<M>>(
      dataplane::PublisherCore<M>::Identity{topic, words, 0, generation, first, offered, 64, 0});
  Freed environment;
  if (found[1] == remains::mapped)
    core->attach(0, member, subscriber.base(), extent, offsetof(abi::ClientRegionHeader, wait_set),
                 0, environment);
  environment.live.insert(0x1000);
  EXPECT_EQ(core->publish({0x1000, 16, 1}, environment), dataplane::PublishOutcome::published);
  EXPECT_EQ(environment.live.size(), 1u) << "the subscription may take it";
  const std::uint64_t sequence = first + 1;
  std::uint64_t slot = 0;
  while (words.slot_id(slot).load() != sequence) ++slot;
  const region::LinkWords<M> line{subscriber.base(), extent, 0};
  line.publisher_generation().store(found[2] == remains::linked ? generation : generation - 1);
  line.hold(0).store(found[3] == remains::held ? std::uint64_t{1} << slot : 0);
  line.cursor().store(found[4] == remains::past ? sequence + 1 : sequence);
  for (const abi::BoardState state :
       {abi::BoardState::dead, abi::BoardState::revoked, abi::BoardState::free}) {
    // The three states that count as over are one kind; all must give the same result.
    if (found[0] != remains::over) break;
    auto copy = std::make_unique<dataplane::PublisherCore<M>>(*core);
    Freed other = environment;
    steps.set_subscription(0, member, state);
    copy->scan(other);
    EXPECT_TRUE(other.live.empty()) << static_cast<int>(state);
    words.slot_id(slot).store(sequence);
  }
  if (found[0] == remains::leaving) steps.set_subscription(0, member, abi::BoardState::leaving);
  // The first scan marks it, the second frees it.
  core->scan(environment);
  core->scan(environment);
  return !environment.live.empty();
}

TEST(RecoveryTables, AgreeWithAPublishersReclamationScan) {
  for_each_combination<5>({3, 2, 2, 2, 2}, [](const auto& found) {
    const auto& row = case_of(remains::rows, found);
    EXPECT_EQ(scan_keeps(found), row.decision == RemainsDecision::keep) << row.label;
  });
}

// --- L, as the log does it

TEST(RecoveryTables, AgreeWithTheRedoLog) {
  constexpr std::uint64_t fingerprint = 42;
  for_each_combination<4>({2, 2, 3, 2}, [](const auto& found) {
    const auto& row = case_of(log::rows, found);
    SCOPED_TRACE(row.label);
    test::AlignedRegion region{RedoLog::bytes};
    RedoLog log(region.base());
    if (found[0] == log::ours) log.create(fingerprint + (found[1] == log::other ? 1 : 0), 7);
    for (std::uint64_t i = 0; i < 3; ++i) {
      log.commit(RecordType::announced, &i, 1);
      if (i < 2 || found[2] == log::equal) log.applied();
    }
    // The word at 128 is `applied` (journal/redo_log.hpp).
    if (found[2] == log::impossible) M::word(region.base(), 128).store(9);
    if (found[3] == log::damaged)
      region.base()[abi::page_bytes + 3 * sizeof(Record) + 40] ^= std::byte{1};
    const bool usable = row.decision == LogDecision::go_on || row.decision == LogDecision::redo;
    EXPECT_EQ(log.state(fingerprint), usable ? RedoLog::State::valid
                                      : row.decision == LogDecision::refuse_layout
                                          ? RedoLog::State::other_layout
                                          : RedoLog::State::damaged);
    if (usable) {
      EXPECT_EQ(log.pending().has_value(), row.decision == LogDecision::redo);
    }
  });
}

// --- U, as announce set and announcement state do it

TEST(RecoveryTables, AgreeWithAnnounceSetsAndStates) {
  constexpr std::uint64_t generation = 5, client = 3;
  for_each_combination<3>({2, 2, 3}, [](const auto& found) {
    const auto& row = case_of(announce::rows, found);
    if (row.decision == AnnounceDecision::impossible) return;
    SCOPED_TRACE(row.label);
    AnnounceSet<M> set;
    AnnouncementState<M> announcement;
    set.begin(generation);
    if (found[0] == announce::notified) set.notify(client);
    if (found[2] != announce::never) announcement.linked(generation);
    if (found[2] == announce::unlinked) announcement.unlinked(generation);
    // The new connection: the daemon notifies each client in the set again, the client answers.
    AnnounceDecision done = AnnounceDecision::nothing;
    if (set.contains(client)) {
      switch (announcement.on_announce(generation)) {
        case AnnouncementState<M>::Action::link:
          done = AnnounceDecision::link;
          announcement.linked(generation);
          break;
        case AnnouncementState<M>::Action::nothing:
          done = AnnounceDecision::ignore;
          break;
        case AnnouncementState<M>::Action::say_unlinked:
          done = AnnounceDecision::say_unlinked;
          set.acknowledge(client, generation);
          break;
      }
    }
    EXPECT_EQ(done, row.decision);
    EXPECT_EQ(set.reusable(), announcement.current() != generation)
        << "reusable while it is linked, or not reusable although it is not";
  });
}

static_assert(decide_rejoin({true, true, true, true, rejoin::alive, true}) ==
              RejoinDecision::take_back);
static_assert(decide_request(request::create, true, request::done) ==
              RequestDecision::answer_as_before);
static_assert(decide_stored(stored::process, false, stored::alive) ==
              StoredDecision::owner_is_lost);

}  // namespace
}  // namespace agnocast::journal
