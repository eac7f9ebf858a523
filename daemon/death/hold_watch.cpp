// SPDX-License-Identifier: Apache-2.0

#include <daemon/death/hold_watch.hpp>

#include <region/views.hpp>

#include <algorithm>
#include <bit>

namespace agnocast::daemon {
namespace {

// Lines and places that one look reads, for all users.
constexpr std::uint32_t steps_per_look = 4096;
// The same for one user: a round over a user's lines takes one look for each share of them, times
// one for each eight users. A subscription that is begun is finished: at most 2048
// lines more.
constexpr std::uint32_t steps_per_slice = 512;
// Looks in a row above the quota that give certainty. One a second: there is no hurry, and a
// person can still see it with agnocast-ctl verify.
constexpr unsigned looks_needed = 6;

}  // namespace

/// Returns the number of held messages, or 0 when it is within its quota or gone.
std::uint64_t HoldWatch::held_beyond_quota(TopicIndex topic, std::uint32_t subscription,
                                           std::uint32_t publisher) const {
  const SubscriptionRecord& record = registry_.subscription(topic, subscription);
  if ((record.state != EndpointState::active && record.state != EndpointState::leaving) ||
      !regions_.is_open(record.client))
    return 0;
  const region::LinkWords<SharedMemory> line{regions_.region(record.client), record.extent,
                                             publisher};
  // The words behind the line have memory only if there are slots for them.
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
  return held > registry_.hold_quota(record, registry_.publisher(topic, publisher)) ? held : 0;
}

std::uint32_t HoldWatch::look_at(TopicIndex topic, std::uint32_t subscription) {
  std::uint32_t steps = 1;
  registry_.for_each_publisher(topic, [&](std::uint32_t publisher, const PublisherRecord&) {
    ++steps;
    if (held_beyond_quota(topic, subscription, publisher) != 0)
      suspects_.try_emplace(Key{number(topic), subscription, publisher},
                            Suspect{registry_.subscription(topic, subscription).generation, 0});
  });
  return steps;
}

// Looks at nothing twice in one time slice: it ends with the last topic of the user.
std::uint32_t HoldWatch::use_time_slice(std::uint32_t uid, Position& at) {
  std::uint32_t steps = 0;
  while (steps < steps_per_slice) {
    const auto next = at.topic && registry_.accounts().takes_part(uid, *at.topic)
                          ? registry_.next_place(Kind::subscription, *at.topic, at.place)
                          : std::nullopt;
    ++steps;
    if (!next) {
      at = {registry_.accounts().next_topic_of(uid, at.topic), 0};
      if (!at.topic) break;
      continue;
    }
    at.place = *next + 1;
    const ClientIndex owner = registry_.subscription(*at.topic, *next).client;
    if (registry_.client(owner).uid == uid) steps += look_at(*at.topic, *next);
  }
  return steps;
}

void HoldWatch::go_on() {
  std::erase_if(positions_,
                [&](const auto& one) { return !registry_.accounts().has_user(one.first); });
  std::uint32_t steps = 0;
  for (std::size_t round = 0; round < registry_.accounts().user_count() && steps < steps_per_look;
       ++round) {
    last_user_ = registry_.accounts().next_user(last_user_);
    if (!last_user_) last_user_ = registry_.accounts().next_user(std::nullopt);
    steps += use_time_slice(*last_user_, positions_[*last_user_]);
  }
}

std::vector<HoldWatch::Finding> HoldWatch::look() {
  go_on();
  std::map<std::uint32_t, Finding> found;  // by uid
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
      continue;
    }
    const SubscriptionRecord& record = registry_.subscription(ref.topic, subscription);
    if (++at->second.looks >= looks_needed &&
        found
            .try_emplace(
                registry_.client(record.client).uid,
                Finding{ref, held,
                        registry_.hold_quota(record, registry_.publisher(ref.topic, publisher))})
            .second) {
      at = suspects_.erase(at);
    } else {
      ++at;
    }
  }
  std::vector<Finding> all;
  all.reserve(found.size());
  for (const auto& [uid, finding] : found) all.push_back(finding);
  return all;
}

}  // namespace agnocast::daemon
