// SPDX-License-Identifier: Apache-2.0
//
// Goal: a daemon accepts or refuses the memory of its predecessor, whatever it contains; it never
// crashes or loops, and never touches memory of another layout. Method: a daemon over plain memory
// does what the input says, is cut off in the middle of a change, and then the input changes bytes
// of its log and of its tables. Accepted memory must answer everything that the daemon asks, take
// further changes, and be accepted once more.

#include <daemon/observers/dump.hpp>
#include <daemon/state/registry.hpp>

#include <fuzzer/FuzzedDataProvider.h>
#include <sys/mman.h>

#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <optional>
#include <string>
#include <vector>

namespace {

using namespace agnocast;
using namespace agnocast::daemon;

#define REQUIRE(condition)                                                                      \
  ((condition)                                                                                  \
       ? static_cast<void>(0)                                                                   \
       : (std::fprintf(stderr, "fuzz_journal: not true: %s (line %d)\n", #condition, __LINE__), \
          std::abort()))

/// Made once, emptied for each input. The page behind the last byte is inaccessible.
class Memory {
 public:
  Memory() {
    void* const at = ::mmap(nullptr, bytes + abi::page_bytes, PROT_READ | PROT_WRITE,
                            MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
    if (at == MAP_FAILED) std::abort();
    base_ = static_cast<std::byte*>(at);
    ::mprotect(base_ + bytes, abi::page_bytes, PROT_NONE);
  }
  void empty() { ::madvise(base_, bytes, MADV_DONTNEED); }
  Registry::Memory parts() const {
    return {base_, base_ + journal::RedoLog::bytes, base_ + journal::RedoLog::bytes + tables_bytes};
  }

 private:
  static constexpr std::uint64_t bytes = journal::RedoLog::bytes + tables_bytes + abi::board_bytes;
  std::byte* base_;
};

/// A few changes: processes, topics and endpoints in every state.
void live(Registry& registry, FuzzedDataProvider& input) {
  std::vector<ClientIndex> clients;
  std::vector<EndpointRef> endpoints;
  const abi::Qos qos{3, false, true, false, false};
  for (int step = input.ConsumeIntegralInRange(0, 24); step > 0; --step) {
    const auto what = input.ConsumeIntegralInRange(0, 9);
    if (clients.empty() || what == 0) {
      if (const auto made = registry.add_client({1, 1, 1, 0, "process"})) {
        clients.push_back(*made);
        registry.open_wait_set(*made, 0);
        registry.open_window(*made, {std::uint64_t{1} << 45, 2 << 20, 0});
      }
      continue;
    }
    const ClientIndex client =
        clients[input.ConsumeIntegralInRange<std::size_t>(0, clients.size() - 1)];
    if (what <= 4 && registry.is_alive(client)) {
      const std::string name = what % 2 == 0 ? "/a" : "/b";
      auto topic = registry.find_topic(0, name);
      if (!topic) {
        const auto made = registry.add_topic({0, name, "type", 1});
        if (!made) continue;  // damaged tables may be full
        topic = *made;
      }
      if (input.ConsumeBool()) {
        const auto plan = registry.plan_publisher(client, *topic, qos);
        if (!plan) continue;
        registry.add_publisher(client, *topic, qos, *plan, "node");
        endpoints.push_back({Kind::publisher, *topic, plan->index});
      } else {
        const auto plan = registry.plan_subscription(client, *topic, qos, {700, 9});
        if (!plan) continue;
        for (const SlotRaise& raise : plan->raises) registry.raise_slots(*topic, raise);
        registry.add_subscription(client, *topic, qos, {700, 9}, 0, *plan, "node");
        endpoints.push_back({Kind::subscription, *topic, plan->index});
      }
    } else if (!endpoints.empty()) {
      const EndpointRef ref =
          endpoints[input.ConsumeIntegralInRange<std::size_t>(0, endpoints.size() - 1)];
      const bool publisher = ref.kind == Kind::publisher;
      if (what == 5) registry.notify(ref, client);
      if (what == 6) registry.acknowledge_unmap(ref, client);
      if (what == 7 && publisher &&
          registry.publisher(ref.topic, ref.index).state == EndpointState::active)
        registry.orphan_publisher(ref.topic, ref.index, 12);
      if (what == 8 && !publisher)
        registry.change_subscription(ref.topic, ref.index, EndpointState::dead);
    }
  }
}

std::uint64_t interesting(FuzzedDataProvider& input) {
  switch (input.ConsumeIntegralInRange(0, 3)) {
    case 0:
      return input.ConsumeIntegral<std::uint64_t>();
    case 1:
      return ~std::uint64_t{0} >> input.ConsumeIntegralInRange(0, 63);
    default:
      return input.ConsumeIntegral<std::uint8_t>();
  }
}

void damage(std::byte* at, std::uint64_t bytes, FuzzedDataProvider& input) {
  const std::uint64_t offset = input.ConsumeIntegralInRange<std::uint64_t>(0, (bytes - 1) / 8) * 8;
  const std::uint64_t value = interesting(input);
  std::memcpy(at + offset, &value, sizeof value);
}

/// Asks everything that a daemon asks.
void ask(const Registry& registry) {
  for (std::uint32_t uid = 0; uid < 3; ++uid) static_cast<void>(registry.accounts().usage_of(uid));
  DumpFacts facts;
  facts.process_of = [](ClientIndex) { return DumpFacts::Process{}; };
  static_cast<void>(make_dump(registry, facts, abi::wire::Dump{}));
  const abi::Qos qos{1, false, true, false, false};
  for (std::uint32_t c = 0; c < registry.client_high(); ++c) {
    const ClientIndex client{c};
    static_cast<void>(registry.can_free(client));
    for (const EndpointRef& ref : registry.endpoints_of(client)) {
      static_cast<void>(registry.notified_of(ref).reusable());
      REQUIRE(registry.owner_of(ref) == client);
    }
    if (!registry.is_alive(client)) continue;
    for (std::uint32_t t = 0; t < registry.topic_high(); ++t) {
      if (registry.topic(TopicIndex{t}).state == TopicState::free) continue;
      static_cast<void>(registry.plan_publisher(client, TopicIndex{t}, qos));
      static_cast<void>(registry.plan_subscription(client, TopicIndex{t}, qos, {4, 1}));
    }
  }
}

/// Changes up to six words of the log or of the tables; returns whether there was one.
bool damage(const Registry::Memory& parts, std::uint64_t newest, FuzzedDataProvider& input) {
  const int count = input.ConsumeIntegralInRange(0, 6);
  for (int i = 0; i < count; ++i) {
    switch (input.ConsumeIntegralInRange(0, 6)) {
      case 0:
        damage(parts.log, 4 * abi::cache_line_bytes, input);
        break;
      case 1:
        damage(parts.log + abi::page_bytes, (newest + 2) % 4096 * sizeof(journal::Record), input);
        break;
      case 2:
        damage(parts.log, journal::RedoLog::bytes, input);
        break;
      case 3:
        damage(parts.tables, sizeof(TableHeader), input);
        break;
      case 4:
        damage(parts.tables + offsetof(Tables, client), 3 * sizeof(ClientRecord), input);
        break;
      case 5:
        damage(parts.tables + offsetof(Tables, topic), 2 * sizeof(TopicRecord), input);
        break;
      default:
        damage(input.ConsumeBool() ? parts.tables + offsetof(Tables, publisher)
                                   : parts.tables + offsetof(Tables, subscription),
               2 * sizeof(SubscriptionRecord), input);
        break;
    }
  }
  return count != 0;
}

/// A daemon that accepted the memory continues, and leaves memory that another one can accept.
void go_on(Registry& second, const Registry::Memory& parts, bool damaged,
           FuzzedDataProvider& input) {
  ask(second);
  static_cast<void>(second.repair_board());
  const std::uint64_t before = second.log().committed_lsn();
  second.note_recovered({1, 0, 0});
  REQUIRE(second.log().committed_lsn() == before + 1);
  // Damage where open() does not look must not be relied on: the first change is tried.
  if (damaged) {
    static_cast<void>(second.add_client({1, 1, 1, 0, "newcomer"}));
  } else {
    live(second, input);
  }
  Registry third(parts);
  if (const auto again = third.open(); !again) {
    // Memory that a change has brought into use may be damaged too; then that is reported.
    REQUIRE(damaged && again.error().code == Errc::store_damaged);
    return;
  }
  REQUIRE(third.redone_lsn() == 0);
  ask(third);
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  static Memory memory;
  memory.empty();
  FuzzedDataProvider input(data, size);
  const Registry::Memory parts = memory.parts();
  Registry first(parts);
  first.create(7);
  live(first, input);
  const std::uint64_t newest = first.log().committed_lsn();
  // The last change was decided, and its daemon died in the middle of it.
  const bool pending = newest != 0 && input.ConsumeBool();
  if (pending) SharedMemory::word(parts.log, 2 * abi::cache_line_bytes).store(newest - 1);
  const bool damaged = damage(parts, newest, input);
  std::vector<std::byte> log_before(parts.log, parts.log + 2 * abi::page_bytes);

  journal::RedoLog log(parts.log);
  for (const std::uint64_t lsn : {std::uint64_t{0}, std::uint64_t{1}, newest, newest + 1,
                                  ~std::uint64_t{0}, interesting(input)}) {
    if (const auto record = log.read(lsn)) REQUIRE(record->lsn == lsn);
  }
  static_cast<void>(log.pending());

  Registry second(parts);
  const auto opened = second.open();
  if (opened) {
    go_on(second, parts, damaged, input);
    return 0;
  }
  REQUIRE(damaged);
  // Damage is found after the change under way is completed; another layout is found before.
  if (opened.error().code == Errc::layout_mismatch)
    REQUIRE(std::memcmp(log_before.data(), parts.log, log_before.size()) == 0);
  return 0;
}
