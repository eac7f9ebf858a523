// SPDX-License-Identifier: Apache-2.0
//
// Goal: whatever part of a committed change was made when the daemon died, redoing its record
// completes it and changes nothing else; docs/recovery.md, rows @R. Method: every kind of record
// is made once on a registry; then the memory is reset to the state before, with some of the
// changed words already changed (every subset if they are few, else each one, all but each one,
// and all beginnings and ends), the record is left committed but not applied, and a new registry
// is opened over it.

#include <daemon/state/registry.hpp>
#include <tests/support/memory/registry_memory.hpp>

#include <gtest/gtest.h>

#include <cstdio>
#include <cstring>
#include <functional>
#include <set>
#include <vector>

namespace agnocast::daemon {
namespace {

using journal::DeathReason;
using journal::LeaveCause;
using journal::RecordType;

constexpr std::uint64_t subset_words_max = 8;

/// The part of the memory that the few places of this test use, as words.
class Words {
 public:
  explicit Words(const Registry::Memory& memory) {
    auto& tables = *reinterpret_cast<Tables*>(memory.tables);
    add(&tables.header, sizeof tables.header);
    for (std::uint32_t c = 0; c < 4; ++c)
      add(&tables.client[c], sizeof(ClientRecord), offsetof(ClientRecord, name));
    for (std::uint32_t t = 0; t < 2; ++t) {
      add(&tables.topic[t], sizeof(TopicRecord), offsetof(TopicRecord, name));
      for (std::uint32_t i = 0; i < 2; ++i) {
        add(&tables.publisher[t][i], sizeof(PublisherRecord), offsetof(PublisherRecord, node));
        add(&tables.subscription[t][i], sizeof(SubscriptionRecord),
            offsetof(SubscriptionRecord, node));
      }
      std::byte* const line = memory.board + abi::topic_offset(t);
      epochs_.insert(words_.size());
      add(line, abi::publisher_entry_offset(2));
      add(line + abi::subscription_entry_offset(abi::publisher_count_max, 0),
          2 * sizeof(abi::SubscriptionEntry));
    }
  }
  using State = std::vector<std::uint64_t>;
  State state() const {
    State state;
    for (const std::uint64_t* const word : words_) state.push_back(*word);
    return state;
  }
  void put(const State& state) const {
    for (std::size_t i = 0; i < words_.size(); ++i) *words_[i] = state[i];
  }
  /// Returns whether the word is written before the record: part of every beginning.
  bool is_name(std::size_t word) const { return names_.count(word) != 0; }
  /// Returns whether the word may advance once more than necessary.
  bool is_epoch(std::size_t word) const { return epochs_.count(word) != 0; }

 private:
  void add(void* at, std::size_t bytes, std::size_t name_offset = SIZE_MAX) {
    for (std::size_t offset = 0; offset < bytes; offset += 8) {
      if (offset >= name_offset) names_.insert(words_.size());
      words_.push_back(reinterpret_cast<std::uint64_t*>(static_cast<std::byte*>(at) + offset));
    }
  }
  std::vector<std::uint64_t*> words_;
  std::set<std::size_t> names_, epochs_;
};

class Redo : public testing::Test {
 protected:
  Redo() : words(memory.parts()), life(std::make_unique<Registry>(memory.parts())) {
    life->create(1);
  }

  std::uint64_t& applied() {
    // The word at 128 of the log (journal/redo_log.hpp).
    return *reinterpret_cast<std::uint64_t*>(memory.parts().log + 128);
  }

  void redo_from(const Words::State& before, const Words::State& after,
                 const std::vector<std::size_t>& changed, const std::vector<bool>& made) {
    Words::State middle = before;
    for (std::size_t i = 0; i < before.size(); ++i)
      if (words.is_name(i)) middle[i] = after[i];
    for (std::size_t i = 0; i < changed.size(); ++i)
      if (made[i]) middle[changed[i]] = after[changed[i]];
    words.put(middle);
    applied() -= 1;
    Registry next(memory.parts());
    ASSERT_TRUE(next.open());
    ++redone;
    const Words::State found = words.state();
    for (std::size_t i = 0; i < found.size(); ++i) {
      if (words.is_epoch(i)) {
        ASSERT_LE(found[i] - after[i], 1u) << "an epoch";
      } else {
        ASSERT_EQ(found[i], after[i]) << "word " << i;
      }
    }
    ASSERT_FALSE(next.log().pending().has_value());
  }

  /// Runs `operation`, which makes exactly one record, of this type.
  void step(RecordType type, const std::function<void(Registry&)>& operation) {
    SCOPED_TRACE(std::string(journal::name_of(type)));
    const std::uint64_t lsn = life->log().committed_lsn();
    const Words::State before = words.state();
    operation(*life);
    ASSERT_EQ(life->log().committed_lsn(), lsn + 1) << "the operation must make exactly one record";
    ASSERT_EQ(life->log().read(lsn + 1)->type, type);
    const Words::State after = words.state();
    std::vector<std::size_t> changed;
    for (std::size_t i = 0; i < before.size(); ++i)
      if (before[i] != after[i] && !words.is_name(i)) changed.push_back(i);
    EXPECT_FALSE(changed.empty()) << "this test does not see the change";
    if (changed.size() <= subset_words_max) {
      for (std::uint64_t set = 0; set < std::uint64_t{1} << changed.size(); ++set) {
        std::vector<bool> made;
        for (std::size_t i = 0; i < changed.size(); ++i) made.push_back((set >> i & 1) != 0);
        redo_from(before, after, changed, made);
      }
    } else {
      for (std::size_t i = 0; i <= changed.size(); ++i) {
        std::vector<bool> beginning, end, one, others;
        for (std::size_t k = 0; k < changed.size(); ++k) {
          beginning.push_back(k < i);
          end.push_back(k >= i);
          one.push_back(k == i);
          others.push_back(k != i);
        }
        for (const auto& made : {beginning, end, one, others})
          redo_from(before, after, changed, made);
      }
    }
    words.put(after);
    seen.insert(type);
    // Data kept beside the tables must be derived again.
    life = std::make_unique<Registry>(memory.parts());
    ASSERT_TRUE(life->open());
  }

  test::RegistryMemory memory;
  Words words;
  std::unique_ptr<Registry> life;
  std::set<RecordType> seen;
  std::uint64_t redone = 0;
};

TEST_F(Redo, CompletesEveryChangeWhateverPartWasMade) {
  using R = Registry;
  const ClientIndex a{0}, b{1};
  const TopicIndex t{0};
  const abi::Qos qos{4, false, true, false, false};
  const EndpointRef publisher{Kind::publisher, t, 0}, subscription{Kind::subscription, t, 0};
  for (const auto* const name : {"a", "b"})
    step(RecordType::register_client, [&](R& r) {
      ASSERT_TRUE(r.add_client({1000, 1001, 77, 3, name}));
    });
  step(RecordType::open_window, [&](R& r) { r.open_window(a, {0x200000000000, 1 << 21, 0}); });
  step(RecordType::open_wait_set, [&](R& r) { r.open_wait_set(b, 5); });
  step(RecordType::readers, [&](R& r) { r.set_readers(a, 0x1234567890); });
  step(RecordType::add_topic, [&](R& r) { ASSERT_TRUE(r.add_topic({3, "/topic", "T", 9})); });
  step(RecordType::add_publisher,
       [&](R& r) { r.add_publisher(a, t, qos, r.plan_publisher(a, t, qos).value(), "talker"); });
  step(RecordType::add_subscription, [&](R& r) {
    auto plan = r.plan_subscription(b, t, qos, {7, 3}).value();
    plan.raises.clear();
    r.add_subscription(b, t, qos, {7, 3}, 5, plan, "listener");
  });
  step(RecordType::raise_slots, [&](R& r) { r.raise_slots(t, {0, 512}); });
  step(RecordType::announced, [&](R& r) { r.notify(publisher, b); });
  step(RecordType::announced, [&](R& r) { r.notify(subscription, a); });
  step(RecordType::rejoined, [&](R& r) { r.note_rejoined(a); });
  step(RecordType::recovered,
       [&](R& r) { r.note_recovered({.pid = 4, .dead_count = 6, .board_word_count = 7}); });
  step(RecordType::reader_withdrawn, [&](R& r) {
    r.note_withdrawn({publisher, subscription}, abi::Withdrawal::over_share);
  });
  step(RecordType::reader_served_again, [&](R& r) {
    r.note_served_again({publisher, subscription});
  });
  step(RecordType::reader_mute, [&](R& r) { r.note_mute(subscription); });
  step(RecordType::leave_publisher,
       [&](R& r) { r.orphan_publisher(t, 0, abi::pack_entry(99, 3), LeaveCause::rolled_back); });
  step(RecordType::leave_subscription,
       [&](R& r) { r.change_subscription(t, 0, EndpointState::leaving); });
  step(RecordType::leave_subscription,
       [&](R& r) { r.change_subscription(t, 0, EndpointState::over); });
  step(RecordType::client_dead, [&](R& r) { r.client_died(a, DeathReason::died); });
  step(RecordType::topic_forgotten, [&](R& r) { r.acknowledge_topic(a, t); });
  step(RecordType::client_forgotten, [&](R& r) { r.client_forgotten(a); });
  step(RecordType::unlinked, [&](R& r) { r.acknowledge_unmap(publisher, b); });
  step(RecordType::unlinked, [&](R& r) { r.acknowledge_region_unmap(a, b); });
  step(RecordType::free_publisher, [&](R& r) { r.end_publisher(t, 0, EndpointState::over); });
  step(RecordType::free_publisher, [&](R& r) { r.end_publisher(t, 0, EndpointState::free); });
  step(RecordType::free_subscription, [&](R& r) { r.free_subscription(t, 0); });
  step(RecordType::free_topic, [&](R& r) { r.free_topic(t); });
  step(RecordType::client_end, [&](R& r) { r.free_client(a); });
  // Reused places.
  step(RecordType::register_client, [&](R& r) {
    ASSERT_EQ(r.add_client({1, 2, 78, 3, "c"}).value(), a);
  });
  step(RecordType::add_topic, [&](R& r) { ASSERT_EQ(r.add_topic({3, "/x", "T", 9}).value(), t); });
  step(RecordType::add_publisher,
       [&](R& r) { r.add_publisher(a, t, qos, r.plan_publisher(a, t, qos).value(), "talker"); });
#define AGNOCAST_WAS_SEEN(name, number, arguments) \
  EXPECT_TRUE(number == 0 || seen.count(RecordType::name) == 1) << #name << " was not redone";
  AGNOCAST_RECORD_TABLE(AGNOCAST_WAS_SEEN)
#undef AGNOCAST_WAS_SEEN
  std::printf("redo: %zu kinds of records, %llu ways to die in them\n", seen.size(),
              static_cast<unsigned long long>(redone));
}

// A checksum shows that a record is complete, not that this build can apply it.
TEST_F(Redo, RefusesAChangeThatItCannotApplyAndWritesNothing) {
  const std::uint64_t far = std::uint64_t{1} << 31;
  const struct {
    RecordType type;
    std::vector<std::uint64_t> arguments;
  } changes[] = {
      {static_cast<RecordType>(99), {}},  // of a later build
      {RecordType::register_client, {abi::client_count_max, 1}},
      {RecordType::client_end, {far, 1}},
      {RecordType::open_window, {0, abi::window_count_max}},
      {RecordType::open_wait_set, {0, abi::wait_set_count_max}},
      {RecordType::add_topic, {far, 1}},
      {RecordType::free_topic, {abi::topic_count_max, 1}},
      {RecordType::add_publisher, {0, abi::publisher_count_max, 1, 0}},
      {RecordType::add_publisher, {0, 0, 1, abi::client_count_max}},
      {RecordType::add_subscription, {0, abi::subscription_count_max, 1, 0}},
      {RecordType::free_subscription, {far, 0, 1, 0}},
      {RecordType::topic_forgotten, {0, abi::client_count_max, 1}},
      {RecordType::topic_forgotten, {abi::topic_count_max, 0, 1}},
      {RecordType::announced, {0, 0, abi::client_count_max, 0, 1, 0}},
      {RecordType::announced, {0, far, 0, 1, 1, 0}},
      {RecordType::reader_withdrawn, {abi::topic_count_max, 0, 1, 0}},
      {RecordType::reader_served_again, {0, abi::publisher_count_max, 1, 0}},
      {RecordType::reader_mute, {0, abi::subscription_count_max, 1, 0}},
      {RecordType::reader_mute, {0, 0, 1, abi::client_count_max}},
      {RecordType::unlinked, {far, 0, 0, static_cast<std::uint64_t>(Kind::region), 1, 0}},
  };
  for (const auto& [type, arguments] : changes) {
    SCOPED_TRACE(static_cast<unsigned>(type));
    const test::RegistryMemory fresh;
    Registry(fresh.parts()).create(1);
    const Words all(fresh.parts());
    const auto before = all.state();
    journal::RedoLog log(fresh.parts().log);
    log.commit(type, arguments.data(), arguments.size());
    Registry next(fresh.parts());
    const auto opened = next.open();
    ASSERT_FALSE(opened);
    EXPECT_EQ(opened.error().code, Errc::store_damaged);
    EXPECT_EQ(all.state(), before);
    EXPECT_TRUE(log.pending()) << "the record must stay for the build that can apply it";
  }
}

}  // namespace
}  // namespace agnocast::daemon
