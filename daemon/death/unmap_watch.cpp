// SPDX-License-Identifier: Apache-2.0

#include <daemon/death/unmap_watch.hpp>

#include <region/views.hpp>

#include <algorithm>
#include <set>
#include <utility>

namespace agnocast::daemon {
namespace {

// Looks in a row that give certainty about a deaf process, at most one a second: five seconds are
// long for a thread that only has to read a packet.
constexpr unsigned deaf_looks_needed = 5;
// The same for any other process. A refused library asks every five seconds
// (Reconnection::pause_refused), and a slow machine may have hundreds of them to notify.
constexpr unsigned looks_needed = 30;
// Records and words of shared memory that one call reads. An endpoint that is begun is finished:
// another 131,000 at most, on a wide topic that is full.
constexpr std::uint64_t steps_per_call = 16'384;
// The same for one user, so that four have a time slice in each call.
constexpr std::uint64_t steps_per_slice = steps_per_call / 4;

}  // namespace

// Returns whether its own lines show a hold. The quota bounds a process that sets bits for
// nothing: see hold_watch.hpp.
bool UnmapWatch::holds(const SubscriptionRecord& subscription, const EndpointRef& of) {
  if ((subscription.state != EndpointState::active &&
       subscription.state != EndpointState::leaving) ||
      !regions_.is_open(subscription.client))
    return false;
  const region::LinkWords<SharedMemory> line{regions_.region(subscription.client),
                                             subscription.extent, of.index};
  // The words behind the line have memory only if there are slots for them.
  const std::uint64_t slots = std::max<std::uint64_t>(
      registry_.publisher(of.topic, of.index).slot_count, abi::near_slot_count);
  for (std::uint64_t word = 0; word < (slots + 63) / 64; ++word) {
    ++steps_;
    if (line.hold(word).load(std::memory_order_acquire) != 0) return true;
  }
  return false;
}

void UnmapWatch::note_debtors(Round& round, std::uint64_t generation, const EndpointRef& ref) {
  const AnnounceSet& notified = registry_.notified_of(ref);
  std::set<ClientIndex> holders;
  if (ref.kind == Kind::publisher) {
    registry_.for_each_subscription(
        ref.topic, [&](std::uint32_t, const SubscriptionRecord& subscription) {
          ++steps_;
          if (notified.contains(number(subscription.client)) &&
              holders.count(subscription.client) == 0 && holds(subscription, ref))
            holders.insert(subscription.client);
        });
  }
  steps_ += registry_.client_high() / 64 + 1;
  for (std::uint32_t i = 0; i < registry_.client_high(); ++i) {
    const ClientIndex client{i};
    if (notified.contains(i) && registry_.is_alive(client) && holders.count(client) == 0)
      ++round.debts.try_emplace(client, Finding{client, ref, generation, 0}).first->second.count;
  }
}

void UnmapWatch::use_time_slice(std::uint32_t uid, Round& round,
                                std::map<ClientIndex, Finding>& found) {
  const auto of_user = endings_.given_up().find(uid);
  const std::uint64_t until = steps_ + steps_per_slice;
  for (; steps_ < until; ++round.next) {
    if (of_user == endings_.given_up().end()) return conclude(round, found);
    const auto oldest = of_user->second.lower_bound(round.next);
    if (oldest == of_user->second.end()) return conclude(round, found);
    round.next = oldest->first;
    note_debtors(round, oldest->first, oldest->second);
  }
}

std::vector<UnmapWatch::Finding> UnmapWatch::look() {
  const auto& given_up = endings_.given_up();
  std::map<ClientIndex, Finding> found;
  std::erase_if(rounds_, [&](const auto& one) { return !given_up.contains(one.first); });
  steps_ = 0;
  for (std::size_t round = 0; round < given_up.size() && steps_ < steps_per_call; ++round) {
    auto user = given_up.lower_bound(next_user_);
    if (user == given_up.end()) user = given_up.begin();
    use_time_slice(user->first, rounds_[user->first], found);
    next_user_ = user->first + 1;  // 0 after the last number there is
  }
  std::vector<Finding> all;
  all.reserve(found.size());
  for (const auto& [client, finding] : found) all.push_back(finding);
  return all;
}

void UnmapWatch::notified_again(ClientIndex client) {
  for (auto& [uid, round] : rounds_) {
    const auto found = round.suspects.find(client);
    if (found != round.suspects.end()) found->second.deaf = 0;
  }
}

bool UnmapWatch::is_true(const Finding& finding) const {
  const EndpointRef& ref = finding.oldest;
  return registry_.is_used(ref) && registry_.generation_of(ref) == finding.generation &&
         registry_.notified_of(ref).contains(number(finding.client));
}

UnmapWatch::Suspect UnmapWatch::looked_at(const Round& round, const Finding& debt) const {
  const auto before = round.suspects.find(debt.client);
  const bool same = before != round.suspects.end() && before->second.generation == debt.generation;
  Suspect suspect = same ? before->second : Suspect{debt.generation};
  ++suspect.looks;
  const Session* const session = channel_.session_of(debt.client);
  const std::uint64_t sent =
      session == nullptr ? 0 : session->packet_count() - session->queued_count();
  const bool is_deaf = session != nullptr && !session->held_back() &&
                       (!session->has_output() || (same && sent == suspect.sent));
  suspect.deaf = is_deaf ? suspect.deaf + 1 : 0;
  suspect.sent = sent;
  return suspect;
}

void UnmapWatch::conclude(Round& round, std::map<ClientIndex, Finding>& found) {
  std::map<ClientIndex, Suspect> suspects;
  for (const auto& [client, debt] : round.debts) {
    const Suspect suspect = looked_at(round, debt);
    if (suspect.deaf >= deaf_looks_needed || suspect.looks >= looks_needed) {
      found.try_emplace(client, debt);
    } else {
      suspects.emplace(client, suspect);
    }
  }
  round.suspects = std::move(suspects);
  round.debts.clear();
  round.next = 0;
}

}  // namespace agnocast::daemon
