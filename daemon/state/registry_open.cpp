// SPDX-License-Identifier: Apache-2.0
//
// Registry, the beginning of a run: a fresh one, or one with the memory of an earlier daemon.
//
// Only the daemon writes that memory. Still, no value in it is used as an index before it is
// checked: an earlier build or a bug may have written it. The daemon reports damage and never
// guesses a repair; it rewrites only the board, which repeats the tables.

#include <daemon/state/registry.hpp>

#include <agnocast/abi/board.hpp>
#include <agnocast/abi/fingerprint.hpp>
#include <base/check.hpp>
#include <daemon/state/steps.hpp>
#include <journal/steps.hpp>

#include <cinttypes>
#include <cstdio>
#include <cstring>

namespace agnocast::daemon {
namespace {

using journal::DeathReason;

constexpr std::uint64_t magic_value = 0x6c6261742e6f6761;  // "ago.tabl" in memory order

constexpr std::uint64_t layout_of_tables() noexcept {
  abi::Fingerprint sum;
  sum.add(sizeof(TableHeader), offsetof(TableHeader, arena_base), offsetof(TableHeader, counters),
          offsetof(TableHeader, doorbells));
  sum.add(sizeof(ClientRecord), offsetof(ClientRecord, reason), offsetof(ClientRecord, wait_sets),
          offsetof(ClientRecord, readers), offsetof(ClientRecord, window_count),
          offsetof(ClientRecord, window), offsetof(ClientRecord, notified),
          offsetof(ClientRecord, name));
  sum.add(sizeof(TopicRecord), offsetof(TopicRecord, publishers),
          offsetof(TopicRecord, subscriptions), offsetof(TopicRecord, domain),
          offsetof(TopicRecord, layout_hash), offsetof(TopicRecord, name),
          offsetof(TopicRecord, type));
  sum.add(sizeof(PublisherRecord), offsetof(PublisherRecord, slot_count),
          offsetof(PublisherRecord, final_head), offsetof(PublisherRecord, creation),
          offsetof(PublisherRecord, last_joined), offsetof(PublisherRecord, notified),
          offsetof(PublisherRecord, node));
  sum.add(sizeof(SubscriptionRecord), offsetof(SubscriptionRecord, quota),
          offsetof(SubscriptionRecord, wait_set), offsetof(SubscriptionRecord, creation),
          offsetof(SubscriptionRecord, notified), offsetof(SubscriptionRecord, node));
  sum.add(ClientState::dead, ClientState::forgotten, EndpointState::leaving, EndpointState::orphan,
          EndpointState::over, EndpointState::dead);
  // The pending record may have to be redone, so records count too.
#define AGNOCAST_ADD_RECORD(name, number, arguments) \
  sum.add(number);                                   \
  for (const char letter : std::string_view(arguments)) sum.add(letter);
  AGNOCAST_RECORD_TABLE(AGNOCAST_ADD_RECORD)
#undef AGNOCAST_ADD_RECORD
  return sum.value();
}

tl::unexpected<Failure> other_layout(const char* whose, std::uint64_t found,
                                     std::uint64_t expected) {
  char text[160];
  std::snprintf(text, sizeof text,
                "%s of the previous agnocastd have layout 0x%016" PRIx64
                ", this agnocastd has layout 0x%016" PRIx64,
                whose, found, expected);
  return fail_with(Errc::layout_mismatch, text);
}

tl::unexpected<Failure> damaged(const char* what) {
  return fail_with(Errc::store_damaged,
                   std::string("the memory of the previous agnocastd is damaged: ") + what);
}

template <std::size_t size>
bool ends(const char (&name)[size]) noexcept {
  return std::memchr(name, 0, size) != nullptr;
}

/// Stores `value` unless it is there already. Returns the number of words changed.
template <class Word>
std::uint64_t agree(Word&& word, std::uint64_t value) noexcept {
  if (word.load(std::memory_order_relaxed) == value) return 0;
  AGNOCAST_CRASH_POINT(B_board_field);
  word.store(value, std::memory_order_release);
  return 1;
}

/// Repairs the word of a place without an endpoint: its record, with the generation, may be gone.
template <class Word>
std::uint64_t repair_free(Word&& word) noexcept {
  const std::uint64_t generation = abi::generation_of(word.load(std::memory_order_relaxed));
  return agree(word, abi::pack_board_word(generation, abi::BoardState::free));
}

}  // namespace

abi::BoardState on_board(EndpointState state) noexcept {
  switch (state) {
    case EndpointState::active:
      return abi::BoardState::active;
    case EndpointState::leaving:
      return abi::BoardState::leaving;
    case EndpointState::orphan:
      return abi::BoardState::orphan;
    case EndpointState::dead:
      return abi::BoardState::dead;
    case EndpointState::free:
    case EndpointState::over:
      break;
  }
  return abi::BoardState::free;
}

void Registry::create(std::uint64_t incarnation, const Format& format) {
  TableHeader& header = tables_.header;
  AGNOCAST_CHECK(format.doorbells.size() < sizeof header.doorbells);
  header.magic = magic_value;
  header.layout = layout_of_tables();
  header.arena_base = format.arena_base;
  header.arena_bytes = format.arena_bytes;
  header.window_bytes = format.window_bytes;
  header.began_ns = format.now_ns;
  format.doorbells.copy(header.doorbells, format.doorbells.size());
  auto* const board = reinterpret_cast<abi::BoardHeader*>(board_);
  board->fingerprint.store(abi::fingerprint(), std::memory_order_relaxed);
  board->incarnation.store(incarnation, std::memory_order_relaxed);
  board->magic.store(abi::board_magic, std::memory_order_release);
  log_.create(abi::fingerprint(), incarnation);
}

Result<void> Registry::check_log(const journal::RedoLog& log) {
  switch (log.state(abi::fingerprint())) {
    case journal::RedoLog::State::valid:
      return {};
    case journal::RedoLog::State::other_layout:
      if (log.fingerprint() == abi::fingerprint())
        return other_layout("the records", log.shape(), journal::RedoLog::own_shape);
      return other_layout("the regions", log.fingerprint(), abi::fingerprint());
    case journal::RedoLog::State::damaged:
      break;
  }
  return damaged(log.damage());
}

Result<void> Registry::check() const {
  if (auto checked = check_log(log_); !checked) return checked;
  const TableHeader& header = tables_.header;
  if (header.magic != magic_value) return damaged("the tables do not begin like tables");
  if (header.layout != layout_of_tables())
    return other_layout("the tables", header.layout, layout_of_tables());
  const auto* const board = reinterpret_cast<const abi::BoardHeader*>(board_);
  if (board->magic.load(std::memory_order_acquire) != abi::board_magic ||
      board->incarnation.load(std::memory_order_relaxed) != log_.incarnation())
    return damaged("board and redo log are of different incarnations");
  if (header.client_high > abi::client_count_max || header.topic_high > abi::topic_count_max ||
      !ends(header.doorbells))
    return damaged("the header of the tables is out of range");
  return {};
}

Result<void> Registry::open() {
  if (auto checked = check(); !checked) return checked;
  if (const auto record = log_.pending()) {
    // The tables are checked afterwards: a half-made change is no flaw.
    if (const char* const what = flaw_of_change(*record)) return damaged(what);
    apply(*record);
    log_.applied();
    redone_lsn_ = record->lsn;
  }
  if (const char* const what = flaw()) return damaged(what);
  rebuild();
  return {};
}

/// Returns what is wrong with this change, as far as apply() uses it as an index or reads up to
/// its end; null: nothing.
const char* Registry::flaw_of_change(const Record& record) const noexcept {
  const auto argument = [&](std::string_view name) {
    return record.argument[journal::argument_index(record.type, name)];
  };
  const auto has = [&](std::string_view name) {
    return journal::argument_index(record.type, name) != journal::argument_count;
  };
  const char* const flawed = "the pending change is out of range";
  if (journal::name_of(record.type).empty()) return "the pending change is of an unknown kind";
  const bool of_region =
      record.type == Type::unlinked && argument("kind") == static_cast<std::uint64_t>(Kind::region);
  for (const char* const process : {"client", "to", "by"}) {
    if (has(process) && argument(process) >= abi::client_count_max) return flawed;
  }
  if (has("window") && argument("window") >= abi::window_count_max) return flawed;
  if (record.type == Type::open_wait_set && argument("wait_set") >= abi::wait_set_count_max)
    return flawed;
  if (of_region) return record.argument[0] < abi::client_count_max ? nullptr : flawed;
  if (!has("topic")) return nullptr;
  if (argument("topic") >= abi::topic_count_max) return flawed;
  const auto topic = static_cast<std::uint32_t>(argument("topic"));
  if (!has("index")) return ends(tables_.topic[topic].name) ? nullptr : "the name of a topic";
  const bool publisher =
      has("kind") ? argument("kind") == static_cast<std::uint64_t>(Kind::publisher)
                  : record.type == Type::add_publisher || record.type == Type::raise_slots ||
                        record.type == Type::leave_publisher ||
                        record.type == Type::free_publisher || has("subscription");
  if (argument("index") >= (publisher ? abi::publisher_count_max : abi::subscription_count_max))
    return flawed;
  if (record.type == Type::add_publisher || record.type == Type::add_subscription) return nullptr;
  const EndpointRef ref{publisher ? Kind::publisher : Kind::subscription, TopicIndex{topic},
                        static_cast<std::uint32_t>(argument("index"))};
  return number(owner_of(ref)) < abi::client_count_max ? nullptr : "the owner of an endpoint";
}

const char* Registry::flaw_of_client(std::uint32_t index) const noexcept {
  const ClientRecord& record = tables_.client[index];
  if (record.state == ClientState::free) return nullptr;
  if (record.state > ClientState::forgotten) return "the state of a process";
  if (record.state != ClientState::alive && record.reason > DeathReason::revoked)
    return "the end of a process";
  if (record.generation == 0 || record.generation > tables_.header.last_generation)
    return "the generation of a process";
  if (record.window_count > abi::window_count_max) return "the windows of a process";
  if (record.wait_sets >> abi::wait_set_count_max != 0) return "the wait sets of a process";
  return ends(record.name) ? nullptr : "the name of a process";
}

const char* Registry::flaw_of_topic(std::uint32_t index) const noexcept {
  const TopicRecord& topic = tables_.topic[index];
  if (topic.state == TopicState::free) return nullptr;
  if (topic.state != TopicState::used) return "the state of a topic";
  if (topic.publisher_high > abi::publisher_count_max ||
      topic.subscription_high > abi::subscription_count_max)
    return "the endpoints of a topic";
  if (topic.link_blocks == 0 || topic.link_blocks > abi::link_block_max ||
      topic.publisher_high > topic.link_blocks * abi::link_block_count)
    return "the link blocks of a topic";
  if (!ends(topic.name) || !ends(topic.type)) return "the name of a topic";
  const auto are_places = [&](Kind kind, std::uint32_t high) {
    return !next_place(kind, TopicIndex{index}, high);
  };
  if (!are_places(Kind::publisher, topic.publisher_high) ||
      !are_places(Kind::subscription, topic.subscription_high))
    return "the places of a topic";
  const auto check = [&](const auto& record, std::uint64_t extent_bytes, bool state_is_known) {
    return state_is_known && number(record.client) < tables_.header.client_high &&
           client(record.client).state != ClientState::free && record.generation != 0 &&
           record.generation <= tables_.header.last_generation &&
           record.extent >= abi::page_bytes && record.extent % abi::cache_line_bytes == 0 &&
           record.extent <= abi::client_region_bytes - extent_bytes && ends(record.node);
  };
  const char* flaw = nullptr;
  for_each_publisher(TopicIndex{index}, [&](std::uint32_t, const PublisherRecord& record) {
    const bool known = record.state == EndpointState::active ||
                       record.state == EndpointState::orphan || record.state == EndpointState::over;
    if (!check(record, abi::publisher_extent_bytes, known) ||
        record.slot_count > abi::slot_count_max)
      flaw = "a publisher";
  });
  for_each_subscription(TopicIndex{index}, [&](std::uint32_t, const SubscriptionRecord& record) {
    const bool known = record.state == EndpointState::active ||
                       record.state == EndpointState::leaving ||
                       record.state == EndpointState::over || record.state == EndpointState::dead;
    if (!check(record, abi::subscription_extent_bytes(topic.link_blocks), known) ||
        record.wait_set >= abi::wait_set_count_max)
      flaw = "a subscription";
  });
  return flaw;
}

const char* Registry::flaw() const noexcept {
  for (std::uint32_t i = 0; i < tables_.header.client_high; ++i) {
    if (const char* const what = flaw_of_client(i)) return what;
  }
  for (std::uint32_t i = 0; i < tables_.header.topic_high; ++i) {
    if (const char* const what = flaw_of_topic(i)) return what;
  }
  return nullptr;
}

std::uint64_t Registry::repair_publisher(TopicIndex topic, std::uint32_t index) {
  using Entry = abi::PublisherEntry;
  const auto at = [&](std::size_t offset) -> decltype(auto) {
    return words(topic).publisher(index, offset);
  };
  if (!is_used({Kind::publisher, topic, index})) return repair_free(at(offsetof(Entry, word)));
  const PublisherRecord& record = publisher(topic, index);
  std::uint64_t repaired = 0;
  repaired += agree(at(offsetof(Entry, policies)), record.qos.policies);
  repaired += agree(at(offsetof(Entry, client)), number(record.client));
  repaired += agree(at(offsetof(Entry, extent)), record.extent);
  repaired += agree(at(offsetof(Entry, slot_count)), record.slot_count);
  repaired += agree(at(offsetof(Entry, deadline_ns)), record.qos.deadline_ns);
  repaired += agree(at(offsetof(Entry, lease_ns)), record.qos.lease_ns);
  repaired += agree(at(offsetof(Entry, final_head)), record.final_head);
  return repaired + agree(at(offsetof(Entry, word)),
                          abi::pack_board_word(record.generation, on_board(record.state)));
}

std::uint64_t Registry::repair_subscription(TopicIndex topic, std::uint32_t index) {
  using Entry = abi::SubscriptionEntry;
  const auto at = [&](std::size_t offset) -> decltype(auto) {
    return words(topic).subscription(index, offset);
  };
  if (!is_used({Kind::subscription, topic, index})) return repair_free(at(offsetof(Entry, word)));
  const SubscriptionRecord& record = subscription(topic, index);
  std::uint64_t repaired = 0;
  repaired += agree(at(offsetof(Entry, policies)), record.qos.policies);
  repaired += agree(at(offsetof(Entry, client)), number(record.client));
  repaired += agree(at(offsetof(Entry, extent)), record.extent);
  repaired += agree(at(offsetof(Entry, quota)), record.quota);
  repaired += agree(at(offsetof(Entry, wait_set)), record.wait_set);
  repaired += agree(at(offsetof(Entry, deadline_ns)), record.qos.deadline_ns);
  repaired += agree(at(offsetof(Entry, lease_ns)), record.qos.lease_ns);
  return repaired + agree(at(offsetof(Entry, word)),
                          abi::pack_board_word(record.generation, on_board(record.state)));
}

std::uint64_t Registry::repair_board() {
  std::uint64_t repaired = 0;
  for (std::uint32_t t = 0; t < topic_high(); ++t) {
    const TopicIndex at{t};
    const TopicRecord& record = topic(at);
    if (record.state == TopicState::free) continue;
    for (std::uint32_t i = 0; i < record.publisher_high; ++i) repaired += repair_publisher(at, i);
    for (std::uint32_t i = 0; i < record.subscription_high; ++i)
      repaired += repair_subscription(at, i);
    repaired += agree(words(at).publisher_high(), record.publisher_high);
    repaired += agree(words(at).subscription_high(), record.subscription_high);
    board(at).renew();
  }
  return repaired;
}

}  // namespace agnocast::daemon
