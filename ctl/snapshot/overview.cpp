// SPDX-License-Identifier: Apache-2.0

#include <ctl/snapshot/overview.hpp>

#include <agnocast/error.hpp>
#include <base/text/text.hpp>
#include <ctl/snapshot/numbers.hpp>
#include <ctl/snapshot/refusals.hpp>
#include <ctl/snapshot/select.hpp>
#include <region/views.hpp>

#include <algorithm>
#include <bit>
#include <cmath>
#include <utility>

namespace agnocast::ctl {
namespace {

using Words = region::PublisherWords<SharedMemory>;
using Line = region::LinkWords<SharedMemory>;

using enum std::memory_order;

constexpr std::size_t recent_max = 16;
constexpr std::uint64_t long_hold_ns = 1'000'000'000;
// Refusals that a user who looks now may still be interested in.
constexpr std::uint64_t fresh_ns = 60'000'000'000;

std::string who(const System& system, const Endpoint& endpoint) {
  const Process* const process = system.process_of(endpoint);
  return escaped(endpoint.node_namespace == "/"
                     ? '/' + endpoint.node_name
                     : endpoint.node_namespace + '/' + endpoint.node_name) +
         " pid " + (process == nullptr ? "gone" : std::to_string(process->facts.pid));
}

/// The state of one subscription towards all publishers of its topic.
struct Reading {
  std::uint64_t unread = 0;  // the maximum over the publishers
  std::uint64_t held = 0;
  std::uint64_t oldest_held_ns = 0;
};

Reading reading_of(const System& system, const Topic& topic, const Endpoint& subscription,
                   std::uint64_t now_ns) {
  Reading reading;
  std::byte* const region = system.region_of(subscription);
  if (region == nullptr || !subscription.takes_messages()) return reading;
  const std::uint64_t depth = abi::reach_of(abi::unpack_qos(subscription.facts.qos));
  for (const Endpoint& publisher : topic.publishers) {
    std::byte* const queue = system.region_of(publisher);
    const Line line{region, subscription.facts.extent, publisher.facts.index};
    if (queue == nullptr || line.publisher_generation().load(acquire) != publisher.facts.generation)
      continue;
    const Words words{queue, publisher.facts.extent};
    const std::uint64_t end = abi::sequence_of(words.head().load(acquire)) + 1;
    const std::uint64_t cursor = line.cursor().load(acquire);
    reading.unread = std::max(reading.unread, std::min(end > cursor ? end - cursor : 0, depth));
    const std::uint64_t slot_words =
        std::min<std::uint64_t>((publisher.facts.slot_count + 63) / 64, abi::slot_count_max / 64);
    for (std::uint64_t word = 0; word < slot_words; ++word) {
      for (std::uint64_t held = line.hold(word).load(relaxed); held != 0; held &= held - 1) {
        const std::uint64_t slot = word * 64 + static_cast<std::uint64_t>(std::countr_zero(held));
        const std::uint64_t stamp = words.slot_stamp(slot).load(relaxed);
        ++reading.held;
        reading.oldest_held_ns = std::max(reading.oldest_held_ns, now_ns - std::min(now_ns, stamp));
      }
    }
  }
  return reading;
}

void add_subscription(const System& system, const Topic& topic, const Endpoint& subscription,
                      std::uint64_t now_ns, Row& row) {
  const Reading reading = reading_of(system, topic, subscription, now_ns);
  row.lag = std::max(row.lag, reading.unread);
  row.held += reading.held;
  row.oldest_held_ns = std::max(row.oldest_held_ns, reading.oldest_held_ns);
  if (std::byte* const region = system.region_of(subscription); region != nullptr) {
    const region::SubscriptionWords<SharedMemory> words{region, subscription.facts.extent};
    row.lost += words.counter(offsetof(abi::SubscriptionCounters, lost)).load(relaxed);
  }
  const std::uint64_t depth = abi::reach_of(abi::unpack_qos(subscription.facts.qos));
  // With a depth of one or two, nearly everything is unread now and then.
  if (depth > 2 && reading.unread * 4 >= depth * 3) {
    row.trouble = std::min(row.trouble, Trouble::lagging);
    row.notes.push_back("slow reader: " + who(system, subscription) + " (depth " +
                        std::to_string(depth) + ", " + std::to_string(reading.unread) + " unread)");
  }
  if (reading.oldest_held_ns > long_hold_ns) {
    row.trouble = std::min(row.trouble, Trouble::holding);
    row.notes.push_back("holder: " + who(system, subscription) + " (" +
                        counted(reading.held, "message") + ", the oldest published " +
                        time_for_people(reading.oldest_held_ns) + " ago)");
  }
  const abi::Qos requested = abi::unpack_qos(subscription.facts.qos);
  for (const Endpoint& publisher : topic.publishers) {
    const bool is_ignored =
        requested.ignore_local && publisher.facts.client == subscription.facts.client;
    if (publisher.state() != abi::BoardState::active || is_ignored ||
        abi::qos_match(abi::unpack_qos(publisher.facts.qos), requested))
      continue;
    row.trouble = Trouble::refused;
    row.notes.push_back("not matched: " + who(system, publisher) + " and " +
                        who(system, subscription) + " (quality of service)");
  }
}

}  // namespace

// Returns the rate since the last look that found new messages. It uses the stamps, so the time of
// the look does not matter.
Overview::Seen Overview::look_at(const System& system, const Endpoint& publisher,
                                 std::uint64_t now_ns) const {
  const auto found = seen_.find(publisher.facts.generation);
  Seen seen = found == seen_.end() ? Seen{} : found->second;
  std::byte* const region = system.region_of(publisher);
  if (region == nullptr) return seen;
  const RecentStamps recent = recent_stamps(system, publisher, recent_max);
  const std::uint64_t bytes = Words{region, publisher.facts.extent}
                                  .counter(offsetof(abi::PublisherEndpoint, published_bytes))
                                  .load(relaxed);
  const std::uint64_t news = recent.newest - std::min(seen.count, recent.newest);
  if (news != 0 && !recent.stamps_ns.empty()) {
    const std::uint64_t newest_ns = recent.stamps_ns.back();
    seen.rate_hz =
        seen.newest_ns != 0 && newest_ns > seen.newest_ns
            ? static_cast<double>(news) * 1e9 / static_cast<double>(newest_ns - seen.newest_ns)
            : rate_of(recent, now_ns);
    seen.message_bytes = (bytes - std::min(seen.bytes, bytes)) / news;
    seen.count = recent.newest;
    seen.bytes = bytes;
    seen.newest_ns = newest_ns;
  } else if (recent.newest == 0) {
    seen.rate_hz = 0;
  }
  return seen;
}

std::vector<Row> Overview::look(const System& system, bool all_domains, std::uint64_t domain,
                                std::uint64_t now_ns) {
  std::map<std::uint64_t, Seen> now;
  std::vector<Row> rows;
  for (const auto& [index, topic] : system.topics) {
    if (!all_domains && topic.facts.domain != domain) continue;
    Row row;
    row.topic = &topic;
    row.publishers = active_count(topic.publishers);
    row.subscriptions = active_count(topic.subscriptions);
    for (const Endpoint& publisher : topic.publishers) {
      const Seen seen = look_at(system, publisher, now_ns);
      now[publisher.facts.generation] = seen;
      const double rate = seen.rate_hz ? slowed(*seen.rate_hz, seen.newest_ns, now_ns) : 0;
      row.rate_known = row.rate_known && seen.rate_hz;
      row.rate_hz += rate;
      row.bytes_per_second += rate * static_cast<double>(seen.message_bytes);
      row.message_bytes = std::max(row.message_bytes, seen.message_bytes);
      // A rate that would be printed as 0.0 counts as idle.
      if (rate >= 0.05 || (!seen.rate_hz && now_ns - seen.newest_ns < fresh_ns))
        row.trouble = std::min(row.trouble, Trouble::running);
      if (publisher.state() == abi::BoardState::orphan) {
        row.trouble = std::min(row.trouble, Trouble::dead);
        row.notes.push_back("publisher gone, but not fully read: " + who(system, publisher));
      }
    }
    for (const Endpoint& subscription : topic.subscriptions)
      add_subscription(system, topic, subscription, now_ns, row);
    for (const wire::DumpRefusal& refusal : system.refusals) {
      if (refusal.age_ns > fresh_ns || refusal.domain != topic.facts.domain ||
          text_of(refusal.topic) != topic.name)
        continue;
      row.trouble = Trouble::refused;
      row.notes.push_back("refused: " + escaped(text_of(refusal.process_name)) + " pid " +
                          std::to_string(refusal.pid) + ": " + refusal_words(refusal));
    }
    rows.push_back(std::move(row));
  }
  seen_ = std::move(now);
  return rows;
}

Totals Overview::totals_of(const System& system, const std::vector<Row>& rows) {
  Totals totals;
  totals.topics = rows.size();
  totals.processes = system.processes.size();
  for (const auto& [index, process] : system.processes) totals.heap_bytes += heap_used(process);
  for (const Row& row : rows) totals.lost += row.lost;
  const wire::DaemonCounters& counters = system.daemon.counters;
  totals.refused = counters.requests_refused + counters.connections_refused;
  totals.recoveries = counters.clients_died + counters.restarts;
  totals.uptime_ns = system.daemon.uptime_ns;
  return totals;
}

char letter_of(Trouble trouble) noexcept { return "XLHDRI"[static_cast<std::size_t>(trouble)]; }

const char* word_of(Trouble trouble) noexcept {
  constexpr const char* words[] = {"refused", "lagging", "holding", "dead", "running", "idle"};
  return words[static_cast<std::size_t>(trouble)];
}

void sort_rows(std::vector<Row>& rows, const std::string& column) {
  const auto by = [&](auto larger) { std::stable_sort(rows.begin(), rows.end(), larger); };
  std::stable_sort(rows.begin(), rows.end(),
                   [](const Row& a, const Row& b) { return a.topic->name < b.topic->name; });
  if (column == "trouble") by([](const Row& a, const Row& b) { return a.trouble < b.trouble; });
  if (column == "rate") by([](const Row& a, const Row& b) { return a.rate_hz > b.rate_hz; });
  if (column == "size")
    by([](const Row& a, const Row& b) { return a.message_bytes > b.message_bytes; });
  if (column == "bandwidth")
    by([](const Row& a, const Row& b) { return a.bytes_per_second > b.bytes_per_second; });
  if (column == "lag") by([](const Row& a, const Row& b) { return a.lag > b.lag; });
  if (column == "hold")
    by([](const Row& a, const Row& b) { return a.oldest_held_ns > b.oldest_held_ns; });
  if (column == "lost") by([](const Row& a, const Row& b) { return a.lost > b.lost; });
}

Object object_of(const Row& row) {
  return {{"state", word_of(row.trouble)},
          {"topic", row.topic->name},
          {"type", row.topic->type},
          {"domain", row.topic->facts.domain},
          {"rate_hz", row.rate_known ? Object(row.rate_hz) : Object(nullptr)},
          {"message_mean_bytes", row.message_bytes},
          {"bytes_per_second", static_cast<std::uint64_t>(std::llround(row.bytes_per_second))},
          {"publisher_count", row.publishers},
          {"subscription_count", row.subscriptions},
          {"lag_messages", row.lag},
          {"held_messages", row.held},
          {"oldest_held_ns", row.oldest_held_ns},
          {"lost_messages", row.lost},
          {"notes", row.notes}};
}

Object object_of(const Totals& totals) {
  return {{"topics", totals.topics},         {"processes", totals.processes},
          {"heap_bytes", totals.heap_bytes}, {"lost_messages", totals.lost},
          {"refused", totals.refused},       {"recoveries", totals.recoveries},
          {"uptime_ns", totals.uptime_ns}};
}

}  // namespace agnocast::ctl
