// SPDX-License-Identifier: Apache-2.0

#include <ctl/snapshot/pairs.hpp>

#include <base/text/text.hpp>
#include <ctl/cli/console.hpp>
#include <ctl/snapshot/numbers.hpp>
#include <journal/mismatch.hpp>
#include <journal/withdrawal.hpp>
#include <region/views.hpp>

namespace agnocast::ctl {
namespace {

bool is_linked(const System& system, const Endpoint& publisher, const Endpoint& subscription) {
  std::byte* const region = system.region_of(subscription);
  if (region == nullptr) return false;
  const region::LinkWords<SharedMemory> line{region, subscription.facts.extent,
                                             publisher.facts.index};
  return line.publisher_generation().load(std::memory_order_acquire) == publisher.facts.generation;
}

std::string sentence_of(abi::Withdrawal why) {
  const std::string said = std::string("the publisher reports that ") + journal::sentence_of(why);
  return why == abi::Withdrawal::not_attached ? said : said + ", and no longer serves it";
}

const char* end_of(const Endpoint& publisher, const Endpoint& subscription) {
  if (publisher.state() == abi::BoardState::orphan)
    return "the publisher is gone; its unread messages are still delivered";
  if (publisher.state() != abi::BoardState::active) return "the publisher is gone";
  if (subscription.state() == abi::BoardState::leaving)
    return "the subscription has left and still holds messages";
  return subscription.state() != abi::BoardState::active ? "the subscription is gone" : nullptr;
}

Pair pair_of(const System& system, const Topic& topic, const Endpoint& publisher,
             const Endpoint& subscription) {
  Pair pair{&publisher, &subscription, PairState::unknown, {}};
  const abi::Qos offered = abi::unpack_qos(publisher.facts.qos);
  const abi::Qos requested = abi::unpack_qos(subscription.facts.qos);
  if (requested.ignore_local && publisher.facts.client == subscription.facts.client) {
    pair.state = PairState::ignored;
    pair.why = "the subscription ignores publishers of its own process";
    return pair;
  }
  if (!abi::qos_match(offered, requested)) {
    pair.state = PairState::incompatible;
    pair.why = journal::mismatch_text(offered, requested);
    return pair;
  }
  if (const char* const end = end_of(publisher, subscription); end != nullptr) {
    pair.state = PairState::ending;
    pair.why = end;
    return pair;
  }
  if (const abi::Withdrawal why = withdrawal_of(system, publisher, subscription);
      why != abi::Withdrawal::none) {
    pair.state = PairState::withdrawn;
    pair.why = sentence_of(why);
    return pair;
  }
  if (!is_linked(system, publisher, subscription)) {
    const Process* const process = system.process_of(subscription);
    pair.state = PairState::joining;
    pair.why = "the subscription has not linked yet";
    if (process != nullptr && is_stopped(process->facts))
      pair.why += ": its process is stopped (SIGSTOP or a debugger)";
    return pair;
  }
  const auto sent = counters_of_publisher(system, topic, publisher);
  const auto unreachable = unreachable_of_subscription(system, topic, subscription);
  if (!sent || !unreachable) {
    pair.why = "its counters cannot be read";
  } else if (*unreachable != 0) {
    const Process* const process = system.process_of(subscription);
    pair.state = PairState::unreachable;
    pair.why = counted(*unreachable, "message") + " unreachable: in the subscriber's process " +
               (process == nullptr || process->blocked_by.empty() ? "another mapping"
                                                                  : escaped(process->blocked_by)) +
               " is at their addresses";
  } else if (sent->adopted_messages != 0) {
    pair.state = PairState::adopted;
    pair.why = std::to_string(sent->adopted_messages) + " of " +
               counted(sent->published, "message") + " were built outside the shared heap, " +
               bytes_for_people(sent->adopted_bytes) + " of them copied into it by publish";
  } else {
    pair.state = PairState::zero_copy;
  }
  return pair;
}

}  // namespace

abi::Withdrawal withdrawal_of(const System& system, const Endpoint& publisher,
                              const Endpoint& subscription) noexcept {
  std::byte* const region = system.region_of(publisher);
  if (region == nullptr || subscription.facts.index >= abi::subscription_count_max)
    return abi::Withdrawal::none;
  const region::PublisherWords<SharedMemory> words{region, publisher.facts.extent};
  return abi::withdrawal_of(
      words.withdrawn(subscription.facts.index).load(std::memory_order_acquire),
      subscription.facts.index);
}

const char* word_of(PairState state) noexcept {
  switch (state) {
    case PairState::zero_copy:
      return "zero_copy";
    case PairState::adopted:
      return "adopted";
    case PairState::withdrawn:
      return "withdrawn";
    case PairState::unreachable:
      return "unreachable";
    case PairState::joining:
      return "joining";
    case PairState::incompatible:
      return "incompatible_qos";
    case PairState::ignored:
      return "ignored_local";
    case PairState::ending:
      return "ending";
    case PairState::unknown:
      break;
  }
  return "unknown";
}

std::string answer_of(const Pair& pair) {
  if (is_zero_copy(pair.state)) return "yes";
  return "no, " + std::string(word_of(pair.state)) + ": " + pair.why;
}

std::vector<Pair> pairs_of(const System& system, const Topic& topic) {
  std::vector<Pair> pairs;
  for (const Endpoint& publisher : topic.publishers) {
    for (const Endpoint& subscription : topic.subscriptions)
      pairs.push_back(pair_of(system, topic, publisher, subscription));
  }
  return pairs;
}

}  // namespace agnocast::ctl
