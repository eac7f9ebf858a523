// SPDX-License-Identifier: Apache-2.0

#include <daemon/hold_watch.hpp>

#include <client/dataplane/views.hpp>

#include <algorithm>
#include <bit>

namespace agnocast::daemon {
namespace {

// Lines and empty places that one look goes over: some tens of microseconds.
constexpr std::uint32_t steps_per_look = 4096;
// Looks in a row above the quota that make it certain. One a second: there is no hurry, and somebody
// who looks with agnocast-ctl verify can still see it.
constexpr unsigned looks_needed = 6;

}  // namespace

/// 0 when it is not above its quota, or not there.
std::uint64_t HoldWatch::held_beyond_quota(TopicIndex topic, std::uint32_t subscription,
                                           std::uint32_t publisher) const {
  const SubscriptionRecord& record = registry_.subscription(topic, subscription);
  if ((record.state != EndpointState::active && record.state != EndpointState::leaving) ||
      !regions_.is_open(record.client))
    return 0;
  const dataplane::LinkWords<SharedMemory> line{regions_.region(record.client), record.extent,
                                                publisher};
  // The words behind the line have memory only when there are slots for them.
  const std::uint64_t slots = std::max<std::uint64_t>(
      registry_.publisher(topic, publisher).slot_count, abi::near_slot_count);
  const std::uint64_t words = (slots + 63) / 64;
  std::uint64_t seen[abi::slot_count_max / 64] = {};
  std::uint64_t held = 0;
  for (std::uint64_t word = 0; word < words; ++word)
    seen[word] = line.hold(word).load(std::memory_order_acquire);
  for (std::uint64_t word = 0; word < words; ++word)
    held += static_cast<std::uint64_t>(
        std::popcount(seen[word] & line.hold(word).load(std::memory_order_acquire)));
  return held > record.quota ? held : 0;
}

void HoldWatch::go_on() {
  std::uint32_t left = steps_per_look;
  std::uint32_t begun = 0;  // topics: nobody is looked at twice in one look
  while (left > 0 && begun <= registry_.topic_high()) {
    if (topic_ >= registry_.topic_high()) topic_ = 0, subscription_ = 0;
    if (registry_.topic_high() == 0) return;
    const TopicIndex topic{topic_};
    const auto next = registry_.topic(topic).state == TopicState::free
                          ? std::nullopt
                          : registry_.next_place(Kind::subscription, topic, subscription_);
    if (!next) {
      ++topic_, ++begun, --left;
      subscription_ = 0;
      continue;
    }
    const std::uint32_t subscription = *next;
    subscription_ = subscription + 1;
    --left;
    registry_.for_each_publisher(topic, [&](std::uint32_t publisher, const PublisherRecord&) {
      left -= std::min(left, 1U);
      if (held_beyond_quota(topic, subscription, publisher) != 0)
        suspects_.try_emplace(Key{number(topic), subscription, publisher},
                              Suspect{registry_.subscription(topic, subscription).generation, 0});
    });
  }
}

std::optional<HoldWatch::Finding> HoldWatch::look() {
  go_on();
  for (auto at = suspects_.begin(); at != suspects_.end();) {
    const auto [topic, subscription, publisher] = at->first;
    const EndpointRef ref{Kind::subscription, TopicIndex{topic}, subscription};
    const bool is_there =
        registry_.is_used(ref) &&
        registry_.subscription(ref.topic, subscription).generation == at->second.generation &&
        registry_.is_used({Kind::publisher, ref.topic, publisher});
    const std::uint64_t held = is_there ? held_beyond_quota(ref.topic, subscription, publisher) : 0;
    if (held == 0) {
      at = suspects_.erase(at);
    } else if (++at->second.looks < looks_needed) {
      ++at;
    } else {
      suspects_.erase(at);
      return Finding{ref, held, registry_.subscription(ref.topic, subscription).quota};
    }
  }
  return std::nullopt;
}

}  // namespace agnocast::daemon
