// SPDX-License-Identifier: Apache-2.0

#include <ctl/snapshot/numbers.hpp>

#include <region/windows.hpp>

#include <algorithm>
#include <bit>
#include <cstddef>

namespace agnocast::ctl {
namespace {

using M = SharedMemory;
using Words = region::PublisherWords<M>;
using Line = region::LinkWords<M>;

using enum std::memory_order;

// Returns the number of words with hold bits for these slots; words behind the link line have
// memory only if there are such slots.
std::uint64_t hold_word_count(std::uint64_t slot_count) noexcept {
  return std::min<std::uint64_t>((slot_count + 63) / 64, abi::slot_count_max / 64);
}

PublisherCounters counters_in(const Words& words, const Endpoint& publisher) {
  using Fields = abi::PublisherEndpoint;
  PublisherCounters counters;
  const std::uint64_t head = abi::sequence_of(words.head().load(acquire));
  counters.published =
      head > publisher.facts.first_sequence ? head - publisher.facts.first_sequence : 0;
  const auto counter = [&](std::uint64_t offset) { return words.counter(offset).load(relaxed); };
  counters.published_bytes = counter(offsetof(Fields, published_bytes));
  counters.adopted_messages = counter(offsetof(Fields, adopted_messages));
  counters.adopted_bytes = counter(offsetof(Fields, adopted_bytes));
  counters.refused_no_slot = counter(offsetof(Fields, refused_no_slot));
  counters.refused_would_block = counter(offsetof(Fields, refused_would_block));
  counters.refused_heap_exhausted = counter(offsetof(Fields, refused_heap_exhausted));
  return counters;
}

/// Returns whether the extent still belongs to the endpoint: it may be reused while it is read.
bool was_its_own(const System& system, const Topic& topic, const Endpoint& endpoint) {
  std::atomic_thread_fence(acquire);
  return system.is_still_there(topic, endpoint);
}

}  // namespace

std::optional<PublisherCounters> counters_of_publisher(const System& system, const Topic& topic,
                                                       const Endpoint& publisher) {
  std::byte* const region = system.region_of(publisher);
  if (region == nullptr) return std::nullopt;
  const PublisherCounters counters = counters_in({region, publisher.facts.extent}, publisher);
  if (!was_its_own(system, topic, publisher)) return std::nullopt;
  return counters;
}

std::optional<PublisherNumbers> numbers_of_publisher(const System& system, const Topic& topic,
                                                     const Endpoint& publisher) {
  std::byte* const region = system.region_of(publisher);
  if (region == nullptr) return std::nullopt;
  const Words words{region, publisher.facts.extent};
  PublisherNumbers numbers{counters_in(words, publisher)};
  for (std::uint64_t slot = 0; slot < publisher.facts.slot_count; ++slot) {
    if (words.slot_id(slot).load(relaxed) != 0) ++numbers.messages;
  }
  for (std::uint64_t word = 0; word < hold_word_count(publisher.facts.slot_count); ++word) {
    std::uint64_t held = 0;
    for (const Endpoint& subscription : topic.subscriptions) {
      std::byte* const holder = system.region_of(subscription);
      if (holder == nullptr || !subscription.takes_messages()) continue;
      const Line line{holder, subscription.facts.extent, publisher.facts.index};
      if (line.publisher_generation().load(acquire) == publisher.facts.generation)
        held |= line.hold(word).load(relaxed);
    }
    numbers.held += static_cast<std::uint64_t>(std::popcount(held));
  }
  if (!was_its_own(system, topic, publisher)) return std::nullopt;
  return numbers;
}

std::optional<std::uint64_t> unreachable_of_subscription(const System& system, const Topic& topic,
                                                         const Endpoint& subscription) {
  std::byte* const region = system.region_of(subscription);
  if (region == nullptr) return std::nullopt;
  const region::SubscriptionWords<M> words{region, subscription.facts.extent};
  const std::uint64_t count =
      words.counter(offsetof(abi::SubscriptionCounters, unreachable)).load(relaxed);
  if (!was_its_own(system, topic, subscription)) return std::nullopt;
  return count;
}

std::optional<SubscriptionNumbers> numbers_of_subscription(const System& system, const Topic& topic,
                                                           const Endpoint& subscription) {
  std::byte* const region = system.region_of(subscription);
  if (region == nullptr) return std::nullopt;
  SubscriptionNumbers numbers;
  const std::uint64_t depth = abi::reach_of(abi::unpack_qos(subscription.facts.qos));
  for (const Endpoint& publisher : topic.publishers) {
    if (!subscription.takes_messages()) break;
    const Line line{region, subscription.facts.extent, publisher.facts.index};
    if (line.publisher_generation().load(acquire) != publisher.facts.generation) continue;
    ++numbers.linked;
    for (std::uint64_t word = 0; word < hold_word_count(publisher.facts.slot_count); ++word)
      numbers.held += static_cast<std::uint64_t>(std::popcount(line.hold(word).load(relaxed)));
    const std::uint64_t cursor = line.cursor().load(acquire);
    if (std::byte* const queue = system.region_of(publisher); queue != nullptr) {
      const std::uint64_t end =
          abi::sequence_of(Words{queue, publisher.facts.extent}.head().load(acquire)) + 1;
      numbers.unread += std::min(end > cursor ? end - cursor : 0, depth);
    }
  }
  const region::SubscriptionWords<M> words{region, subscription.facts.extent};
  using Fields = abi::SubscriptionCounters;
  numbers.lost = words.counter(offsetof(Fields, lost)).load(relaxed);
  numbers.malformed = words.counter(offsetof(Fields, malformed)).load(relaxed);
  numbers.unreachable = words.counter(offsetof(Fields, unreachable)).load(relaxed);
  numbers.expired = words.counter(offsetof(Fields, expired)).load(relaxed);
  if (!was_its_own(system, topic, subscription)) return std::nullopt;
  return numbers;
}

RecentStamps recent_stamps(const System& system, const Endpoint& publisher, std::size_t count) {
  RecentStamps recent;
  std::byte* const region = system.region_of(publisher);
  if (region == nullptr) return recent;
  const Words words{region, publisher.facts.extent};
  const std::uint64_t head = abi::sequence_of(words.head().load(acquire));
  if (head <= publisher.facts.first_sequence) return recent;
  recent.newest = head - publisher.facts.first_sequence;
  // A slot that a newer message uses says nothing about the older message that used it before.
  std::vector<bool> used(abi::slot_count_max, false);
  for (std::uint64_t sequence = head;
       sequence > publisher.facts.first_sequence && recent.stamps_ns.size() < count; --sequence) {
    const std::uint64_t entry = words.order(sequence).load(acquire);
    const std::uint32_t slot = abi::slot_of(entry);
    if (abi::sequence_of(entry) != sequence || slot >= abi::slot_count_max || used[slot]) break;
    used[slot] = true;
    const std::uint64_t stamp = words.slot_stamp(slot).load(relaxed);
    if (!recent.stamps_ns.empty() && stamp > recent.stamps_ns.back()) break;  // reused just now
    recent.stamps_ns.push_back(stamp);
  }
  std::reverse(recent.stamps_ns.begin(), recent.stamps_ns.end());
  return recent;
}

double slowed(double rate_hz, std::uint64_t newest_ns, std::uint64_t now_ns) noexcept {
  const double silence_ns = now_ns > newest_ns ? static_cast<double>(now_ns - newest_ns) : 0;
  return rate_hz * silence_ns > 2e9 ? 1e9 / silence_ns : rate_hz;
}

std::optional<double> rate_of(const RecentStamps& recent, std::uint64_t now_ns) noexcept {
  const auto& stamps = recent.stamps_ns;
  if (recent.newest == 0) return 0;
  if (stamps.size() < 2 || stamps.back() == stamps.front()) return std::nullopt;
  const double rate = static_cast<double>(stamps.size() - 1) * 1e9 /
                      static_cast<double>(stamps.back() - stamps.front());
  return slowed(rate, stamps.back(), now_ns);
}

std::vector<MessageFacts> messages_of(const System& system, const Topic& topic,
                                      const Endpoint& publisher) {
  std::byte* const region = system.region_of(publisher);
  if (region == nullptr) return {};
  const Words words{region, publisher.facts.extent};
  const std::uint64_t end = abi::sequence_of(words.head().load(acquire)) + 1;
  struct Reader {
    const Endpoint* subscription;
    Line line;
    std::uint64_t from;  // unread from here
  };
  std::vector<Reader> readers;
  for (const Endpoint& subscription : topic.subscriptions) {
    std::byte* const holder = system.region_of(subscription);
    if (holder == nullptr || !subscription.takes_messages()) continue;
    const Line line{holder, subscription.facts.extent, publisher.facts.index};
    if (line.publisher_generation().load(acquire) != publisher.facts.generation) continue;
    const std::uint64_t window = abi::reach_of(abi::unpack_qos(subscription.facts.qos));
    readers.push_back(
        {&subscription, line,
         std::max(line.cursor().load(acquire), region::minus_at_least(end, window, 0))});
  }
  std::vector<MessageFacts> messages;
  for (std::uint64_t slot = 0; slot < publisher.facts.slot_count; ++slot) {
    const std::uint64_t id = words.slot_id(slot).load(acquire);
    if (id == 0) continue;
    MessageFacts message;
    message.retired = (id & abi::retired_mark) != 0;
    const std::uint64_t sequence = id & ~abi::retired_mark;
    message.sequence = sequence - std::min(publisher.facts.first_sequence, sequence);
    message.slot = slot;
    message.address = words.slot_address(slot).load(relaxed);
    message.object_bytes = words.slot_size(slot).load(relaxed);
    message.stamp_ns = words.slot_stamp(slot).load(relaxed);
    for (const Reader& reader : readers) {
      if ((reader.line.hold(slot / 64).load(relaxed) >> slot % 64 & 1) != 0) {
        message.holders.push_back(reader.subscription);
      } else if (!message.retired && sequence >= reader.from && sequence < end) {
        message.unread_by.push_back(reader.subscription);
      }
    }
    messages.push_back(std::move(message));
  }
  std::sort(messages.begin(), messages.end(),
            [](const auto& a, const auto& b) { return a.sequence < b.sequence; });
  if (!was_its_own(system, topic, publisher)) return {};
  return messages;
}

namespace {

/// Adds the slots of one publisher that these subscriptions hold or have not read.
void add_slots(const System& system, const Endpoint& publisher,
               const std::vector<const Endpoint*>& subscriptions, KeptNumbers& kept) {
  std::byte* const queue = system.region_of(publisher);
  if (queue == nullptr) return;
  const Words words{queue, publisher.facts.extent};
  const std::uint64_t end = abi::sequence_of(words.head().load(acquire)) + 1;
  struct Linked {
    Line line;
    std::uint64_t from;  // unread from here
  };
  std::vector<Linked> linked;
  for (const Endpoint* const subscription : subscriptions) {
    const Line line{system.region_of(*subscription), subscription->facts.extent,
                    publisher.facts.index};
    if (line.publisher_generation().load(acquire) != publisher.facts.generation) continue;
    const std::uint64_t window = abi::reach_of(abi::unpack_qos(subscription->facts.qos));
    linked.push_back(
        {line, std::max(line.cursor().load(acquire), region::minus_at_least(end, window, 0))});
  }
  for (std::uint64_t slot = 0; !linked.empty() && slot < publisher.facts.slot_count; ++slot) {
    const std::uint64_t id = words.slot_id(slot).load(acquire);
    const bool is_kept = id != 0 && std::any_of(linked.begin(), linked.end(), [&](const Linked& l) {
                           return (id & ~abi::retired_mark) >= l.from ||
                                  (l.line.hold(slot / 64).load(relaxed) >> slot % 64 & 1) != 0;
                         });
    if (!is_kept) continue;
    ++kept.slots;
    kept.object_bytes += words.slot_size(slot).load(relaxed);
  }
}

}  // namespace

KeptNumbers numbers_of_kept(const System& system, const Process& process) {
  KeptNumbers kept;
  for (const std::uint32_t index : process.topics) {
    const Topic& topic = system.topics.at(index);
    std::vector<const Endpoint*> own;
    for (const Endpoint& subscription : topic.subscriptions) {
      if (!process.owns(subscription) || !subscription.takes_messages()) continue;
      const auto numbers = numbers_of_subscription(system, topic, subscription);
      if (!numbers) continue;
      kept.unread += numbers->unread;
      kept.held += numbers->held;
      kept.lost += numbers->lost;
      // Without these the subscription keeps no slot, so none is read.
      if (numbers->unread + numbers->held != 0) own.push_back(&subscription);
    }
    if (own.empty()) continue;
    for (const Endpoint& publisher : topic.publishers) add_slots(system, publisher, own, kept);
  }
  return kept;
}

std::uint64_t heap_used(const Process& process) noexcept {
  if (!process.region) return 0;
  std::uint64_t used = 0;
  for (std::uint32_t w = 0; w < process.facts.window_count; ++w)
    used += region::load_frontier<M>(process.region.base(), w, process.facts.window[w].bytes);
  return used;
}

std::vector<WindowNumbers> numbers_of_windows(const System& system, const Process& process) {
  if (!process.region) return {};
  std::vector<WindowNumbers> windows(process.facts.window_count);
  for (std::uint32_t w = 0; w < process.facts.window_count; ++w)
    windows[w].used_bytes =
        region::load_frontier<M>(process.region.base(), w, process.facts.window[w].bytes);
  for (const std::uint32_t index : process.topics) {
    for (const Endpoint& publisher : system.topics.at(index).publishers) {
      if (!process.owns(publisher) || system.region_of(publisher) == nullptr) continue;
      const Words words{process.region.base(), publisher.facts.extent};
      for (std::uint64_t slot = 0; slot < publisher.facts.slot_count; ++slot) {
        if (words.slot_id(slot).load(acquire) == 0) continue;
        const std::uint64_t address = words.slot_address(slot).load(relaxed);
        for (std::uint32_t w = 0; w < process.facts.window_count; ++w) {
          const auto& window = process.facts.window[w];
          if (address - window.base < window.bytes) ++windows[w].messages;
        }
      }
    }
  }
  return windows;
}

}  // namespace agnocast::ctl
