// SPDX-License-Identifier: Apache-2.0

#include <ctl/snapshot/audit.hpp>

#include <agnocast/abi/fingerprint.hpp>
#include <base/text/text.hpp>
#include <region/windows.hpp>

#include <algorithm>
#include <bit>
#include <chrono>
#include <cstddef>
#include <cstdio>
#include <initializer_list>
#include <map>
#include <memory>
#include <thread>
#include <utility>
#include <vector>

namespace agnocast::ctl {
namespace {

using M = SharedMemory;
using Words = region::PublisherWords<M>;
using Line = region::LinkWords<M>;
using journal::Invariant;

using enum std::memory_order;
// How often to try to copy a queue while its publisher is between two messages.
constexpr int copies_max = 64;
constexpr std::chrono::microseconds pause_between_copies{200};
// How often to check a link again that seems broken.
constexpr int tries_max = 16;

/// A copy of a queue, made word by word.
class QueueCopy {
 public:
  explicit QueueCopy(std::uint64_t slot_count)
      : bytes_(abi::slot_offset(M::ring_count(), slot_count)), memory_(bytes_ / 8) {}

  Words words() { return {reinterpret_cast<std::byte*>(memory_.data()), 0}; }

  /// Copies the queue while its publisher is between two messages; false if it never was.
  bool take_at_rest(const Words& queue) {
    for (int i = 0; i < copies_max; ++i) {
      // The publisher is inside an operation, and may need the processor that we use.
      if (i != 0) std::this_thread::sleep_for(pause_between_copies);
      if (queue.intent_op().load(acquire) != abi::intent_idle) continue;
      const std::uint64_t head = queue.head().load(acquire);
      take(queue);
      // The copy used acquire loads, so these loads come after it.
      if (queue.intent_op().load(acquire) == abi::intent_idle &&
          queue.head().load(acquire) == head && words().head().load(relaxed) == head &&
          words().intent_op().load(relaxed) == abi::intent_idle)
        return true;
    }
    take(queue);  // in motion: enough for the invariants that always hold
    return false;
  }

 private:
  void take(const Words& queue) {
    for (std::uint64_t at = 0; at < bytes_; at += 8)
      memory_[at / 8] = M::word(queue.region, queue.extent + at).load(acquire);
  }

  std::uint64_t bytes_;
  std::vector<std::uint64_t> memory_;
};

class Auditor {
 public:
  Auditor(const System& system, std::uint64_t region_bytes)
      : system_(system), region_bytes_(region_bytes) {}

  Audit run() {
    check_windows();
    check_extents();
    for (const auto& [index, process] : system_.processes) check_region(process);
    for (const auto& [index, topic] : system_.topics) {
      check_board(topic);
      for (const Endpoint& publisher : topic.publishers) check_queue(topic, publisher);
      for (const Endpoint& subscription : topic.subscriptions) check_links(topic, subscription);
    }
    return std::move(audit_);
  }

 private:
  void found(Invariant invariant, std::string where, std::array<std::uint64_t, 3> words,
             bool seen_at_rest = false) {
    audit_.findings.insert({invariant, std::move(where), words, seen_at_rest});
  }

  static std::string name_of(const Process& process) {
    return "process " + std::to_string(process.facts.pid) + " (" + escaped(process.name) + ")";
  }
  std::string name_of(const Topic& topic, const Endpoint& endpoint) const {
    const Process* const owner = system_.process_of(endpoint);
    return escaped(topic.name) + (endpoint.is_publisher() ? " publisher " : " subscription ") +
           std::to_string(endpoint.facts.index) + " (generation " +
           std::to_string(endpoint.facts.generation) +
           (owner == nullptr ? "" : ", pid " + std::to_string(owner->facts.pid)) + ")";
  }

  // --- the whole system: what the daemon assigned

  void check_windows() {
    const wire::DumpDaemon& daemon = system_.daemon;
    std::map<std::uint64_t, std::pair<std::uint64_t, const Process*>> windows;
    for (const auto& [index, process] : system_.processes) {
      for (std::uint32_t w = 0; w < process.facts.window_count; ++w) {
        const auto& window = process.facts.window[w];
        if (window.base < daemon.arena_base || window.bytes > daemon.arena_bytes ||
            window.base - daemon.arena_base > daemon.arena_bytes - window.bytes)
          found(Invariant::window_inside, name_of(process), {w, window.base, window.bytes});
        if (!windows.emplace(window.base, std::pair(window.bytes, &process)).second)
          found(Invariant::window_overlap, name_of(process), {w, window.base, window.bytes});
      }
    }
    std::uint64_t end = 0;
    for (const auto& [base, window] : windows) {
      if (base < end)
        found(Invariant::window_overlap, name_of(*window.second), {0, base, window.first});
      end = std::max(end, base + window.first);
    }
  }

  void check_extents() {
    struct Extent {
      std::uint64_t begin, end;
      std::string where;
    };
    std::map<std::uint64_t, std::vector<Extent>> extents;  // by process
    const auto note = [&](const Topic& topic, const Endpoint& endpoint) {
      const std::uint64_t bytes = topic.extent_bytes(endpoint);
      const std::uint64_t begin = endpoint.facts.extent;
      const std::string where = name_of(topic, endpoint);
      if (system_.process_of(endpoint) == nullptr)
        found(Invariant::endpoint_process, where,
              {endpoint.facts.client, endpoint.facts.client_generation, 0});
      if (begin < abi::page_bytes || begin % abi::page_bytes != 0 || begin > region_bytes_ ||
          region_bytes_ - begin < bytes)
        return found(Invariant::extent_inside, where, {begin, 0, 0});
      extents[endpoint.facts.client].push_back({begin, begin + bytes, where});
    };
    for (const auto& [index, topic] : system_.topics) {
      for (const Endpoint& e : topic.publishers) note(topic, e);
      for (const Endpoint& e : topic.subscriptions) note(topic, e);
    }
    for (auto& [client, list] : extents) {
      std::sort(list.begin(), list.end(),
                [](const Extent& a, const Extent& b) { return a.begin < b.begin; });
      for (std::size_t i = 1; i < list.size(); ++i) {
        if (list[i].begin < list[i - 1].end)
          found(Invariant::extent_overlap, list[i].where + " and " + list[i - 1].where,
                {list[i].begin, list[i - 1].begin, 0});
      }
    }
  }

  // --- a process: the first page of its region

  void check_region(const Process& process) {
    if (!process.region_fault.empty())
      return found(Invariant::region_readable, name_of(process), {0, 0, 0});
    if (!process.region) return;
    std::byte* const region = process.region.base();
    using Header = abi::ClientRegionHeader;
    const auto word = [&](std::size_t offset) { return M::word(region, offset).load(acquire); };
    if (word(offsetof(Header, magic)) != abi::client_region_magic ||
        word(offsetof(Header, fingerprint)) != abi::fingerprint() ||
        word(offsetof(Header, generation)) != process.facts.generation)
      found(Invariant::region_header, name_of(process),
            {word(offsetof(Header, magic)), word(offsetof(Header, fingerprint)),
             word(offsetof(Header, generation))});
    for (std::uint32_t w = 0; w < process.facts.window_count; ++w) {
      const std::size_t at = offsetof(Header, window) + w * sizeof(abi::WindowEntry);
      const std::uint64_t base = word(at + offsetof(abi::WindowEntry, base));
      const std::uint64_t length = word(at + offsetof(abi::WindowEntry, length));
      const std::uint64_t frontier = word(at + offsetof(abi::WindowEntry, frontier));
      const auto& given = process.facts.window[w];
      const std::string where = name_of(process) + " window " + std::to_string(w);
      // Zero: the process has not written it yet.
      if ((base != 0 && base != given.base) || (length != 0 && length != given.bytes))
        found(Invariant::window_header, where, {base, length, 0});
      if (frontier > given.bytes || frontier % abi::page_bytes != 0)
        found(Invariant::window_frontier, where, {frontier, 0, 0});
    }
  }

  // --- a topic: the board against the dump

  void check_board(const Topic& topic) {
    const auto words = system_.words_of(topic);
    std::vector<bool> publishers(abi::publisher_count_max),
        subscriptions(abi::subscription_count_max);
    for (const Endpoint& endpoint : topic.publishers) {
      publishers[endpoint.facts.index] = true;
      check_publisher_entry(topic, endpoint);
    }
    for (const Endpoint& endpoint : topic.subscriptions) {
      subscriptions[endpoint.facts.index] = true;
      check_subscription_entry(topic, endpoint);
    }
    const std::string at = escaped(topic.name);
    const auto check_free = [&](const std::vector<bool>& used, std::uint64_t high, const char* kind,
                                const auto& word_of) {
      for (std::uint64_t i = 0; i < std::min<std::uint64_t>(high, used.size()); ++i) {
        if (used[i]) continue;
        const std::uint64_t word = word_of(i);
        if (abi::state_of(word) != abi::BoardState::free)
          found(Invariant::board_free, at + kind + std::to_string(i), {word, 0, 0});
      }
    };
    check_free(publishers, words.publisher_high().load(acquire), " publisher ",
               [&](std::uint64_t i) {
                 return words.publisher(i, offsetof(abi::PublisherEntry, word)).load(acquire);
               });
    check_free(subscriptions, words.subscription_high().load(acquire), " subscription ",
               [&](std::uint64_t i) {
                 return words.subscription(i, offsetof(abi::SubscriptionEntry, word)).load(acquire);
               });
  }

  void check_publisher_entry(const Topic& topic, const Endpoint& endpoint) {
    using Entry = abi::PublisherEntry;
    const wire::DumpEndpoint& facts = endpoint.facts;
    const auto words = system_.words_of(topic);
    check_entry(
        topic, endpoint, offsetof(Entry, word),
        [&](std::size_t field) { return words.publisher(facts.index, field).load(acquire); },
        {{offsetof(Entry, policies), facts.qos.policies},
         {offsetof(Entry, client), facts.client},
         {offsetof(Entry, extent), facts.extent},
         {offsetof(Entry, slot_count), facts.slot_count},
         {offsetof(Entry, deadline_ns), facts.qos.deadline_ns},
         {offsetof(Entry, lease_ns), facts.qos.lease_ns}});
  }
  void check_subscription_entry(const Topic& topic, const Endpoint& endpoint) {
    using Entry = abi::SubscriptionEntry;
    const wire::DumpEndpoint& facts = endpoint.facts;
    const auto words = system_.words_of(topic);
    check_entry(
        topic, endpoint, offsetof(Entry, word),
        [&](std::size_t field) { return words.subscription(facts.index, field).load(acquire); },
        {{offsetof(Entry, policies), facts.qos.policies},
         {offsetof(Entry, client), facts.client},
         {offsetof(Entry, extent), facts.extent},
         {offsetof(Entry, quota), facts.quota},
         {offsetof(Entry, wait_set), facts.wait_set},
         {offsetof(Entry, deadline_ns), facts.qos.deadline_ns},
         {offsetof(Entry, lease_ns), facts.qos.lease_ns}});
  }
  /// Compares board words with the dump. `fields`: offsets on the board, and the dumped values.
  template <class Word>
  void check_entry(const Topic& topic, const Endpoint& endpoint, std::size_t member, Word word,
                   std::initializer_list<std::pair<std::size_t, std::uint64_t>> fields) {
    const std::string where = name_of(topic, endpoint);
    // A free entry keeps its last generation.
    expect(where, word(member), endpoint.facts.board_word, 0);
    if (endpoint.state() == abi::BoardState::free) return;
    std::uint64_t number = 0;
    for (const auto& [offset, dumped] : fields) expect(where, word(offset), dumped, ++number);
  }
  void expect(const std::string& where, std::uint64_t board, std::uint64_t dumped,
              std::uint64_t field) {
    if (board != dumped) found(Invariant::board_endpoint, where, {field, board, dumped});
  }

  // --- a publisher

  void check_queue(const Topic& topic, const Endpoint& publisher) {
    if (publisher.state() == abi::BoardState::free) return;  // its owner is closing it
    std::byte* const region = system_.region_of(publisher);
    if (region == nullptr) return;
    const std::uint64_t slot_count = publisher.facts.slot_count;
    QueueCopy copy(slot_count);
    const bool at_rest = copy.take_at_rest({region, publisher.facts.extent});
    const std::string where = name_of(topic, publisher);
    if (at_rest) {
      ++audit_.queues;
    } else {
      audit_.in_motion.insert(where);
    }
    journal::Witness witness;
    const Invariant broken = journal::verify_queue(copy.words(), publisher.facts.first_sequence,
                                                   slot_count, at_rest, &witness);
    if (broken != Invariant::none) {
      found(broken, where, {witness.place, witness.word, 0}, at_rest);
    } else if (at_rest) {
      check_addresses(publisher, copy.words(), where);
    }
  }

  // Returns whether the process opened a window after the dump.
  static bool has_newer_window(const Process& process) {
    const std::uint32_t next = process.facts.window_count;
    return next < abi::window_count_max &&
           M::word(process.region.base(),
                   offsetof(abi::ClientRegionHeader, window) + next * sizeof(abi::WindowEntry))
                   .load(acquire) != 0;
  }

  void check_addresses(const Endpoint& publisher, const Words& queue, const std::string& where) {
    const Process& owner = *system_.process_of(publisher);
    if (has_newer_window(owner)) return;
    for (std::uint64_t slot = 0; slot < publisher.facts.slot_count; ++slot) {
      const std::uint64_t id = queue.slot_id(slot).load(relaxed);
      if (id == 0) continue;
      const std::uint64_t address = queue.slot_address(slot).load(relaxed);
      const std::uint64_t size = queue.slot_size(slot).load(relaxed);
      bool inside = false;
      for (std::uint32_t w = 0; w < owner.facts.window_count; ++w) {
        const auto& window = owner.facts.window[w];
        const std::uint64_t frontier =
            region::load_frontier<M>(owner.region.base(), w, window.bytes);
        inside = inside || (address >= window.base && size <= frontier &&
                            address - window.base <= frontier - size);
      }
      if (!inside) return found(Invariant::queue_address, where, {slot, id, address}, true);
    }
  }

  // --- a subscription

  void check_links(const Topic& topic, const Endpoint& subscription) {
    std::byte* const region = system_.region_of(subscription);
    if (!subscription.takes_messages() || region == nullptr) return;
    if (is_stopped(system_.process_of(subscription)->facts)) return;
    // Nobody looks at a link block without a publisher, and it may have no memory.
    std::map<std::uint64_t, std::vector<const Endpoint*>> blocks;
    for (const Endpoint& publisher : topic.publishers) {
      std::vector<const Endpoint*>& block = blocks[publisher.facts.index / abi::link_block_count];
      block.resize(abi::link_block_count);
      block[publisher.facts.index % abi::link_block_count] = &publisher;
    }
    for (const auto& [number, block] : blocks) {
      for (std::uint64_t i = 0; i < abi::link_block_count; ++i)
        check_line(topic, subscription, region, number * abi::link_block_count + i, block[i]);
    }
  }

  /// `publisher`: the one with this index, null if there is none.
  void check_line(const Topic& topic, const Endpoint& subscription, std::byte* region,
                  std::uint64_t index, const Endpoint* publisher) {
    const Line line{region, subscription.facts.extent, index};
    const std::uint64_t generation = line.publisher_generation().load(acquire);
    const std::string where = name_of(topic, subscription) + " link " + std::to_string(index);
    if (generation == 0) {
      check_unlinked(line, where);
    } else if (publisher == nullptr || publisher->facts.generation != generation) {
      found(Invariant::link_generation, where, {generation, 0, 0});
    } else {
      check_link(subscription, *publisher, line, where);
    }
  }

  void check_unlinked(const Line& line, const std::string& where) {
    for (std::uint64_t word = 0; word < M::near_slot_count() / 64; ++word) {
      if (const std::uint64_t bits = line.hold(word).load(acquire); bits != 0)
        found(Invariant::link_unlinked_zero, where, {1 + word, bits, 0});
    }
  }

  void check_link(const Endpoint& subscription, const Endpoint& publisher, const Line& line,
                  const std::string& where) {
    std::byte* const queue = system_.region_of(publisher);
    if (queue == nullptr) return;
    ++audit_.links;
    const std::uint64_t slot_count = publisher.facts.slot_count;
    // A take in progress may look like a broken link; the next try finds it complete.
    for (int i = 0; i < tries_max; ++i) {
      journal::Witness witness;
      const Invariant broken = journal::verify_link(
          line, Words{queue, publisher.facts.extent}, publisher.facts.generation,
          publisher.facts.first_sequence, slot_count, &witness);
      if (broken == Invariant::none) break;
      found(broken, where, {witness.place, witness.word, publisher.facts.generation});
    }
    std::uint64_t held = 0;
    for (std::uint64_t word = 0; word * 64 < slot_count; ++word)
      held += static_cast<std::uint64_t>(std::popcount(line.hold(word).load(acquire)));
    if (held > system_.hold_quota(subscription, publisher))
      found(Invariant::hold_quota, where, {held, 0, 0});
  }

  const System& system_;
  std::uint64_t region_bytes_;
  Audit audit_;
};

}  // namespace

Audit audit(const System& system, std::uint64_t client_region_bytes) {
  return Auditor(system, client_region_bytes).run();
}

void keep_what_lasts(std::set<Finding>& findings, const Audit& later) {
  std::erase_if(findings, [&](const Finding& finding) {
    const bool could_not_be_seen =
        finding.seen_at_rest && later.in_motion.count(finding.where) != 0;
    return later.findings.count(finding) == 0 && !could_not_be_seen;
  });
}

}  // namespace agnocast::ctl
