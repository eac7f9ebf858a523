// SPDX-License-Identifier: Apache-2.0

#include <daemon/state/accounts.hpp>

#include <algorithm>
#include <iterator>

namespace agnocast::daemon {
namespace {

constexpr std::uint64_t Usage::*usage_fields[] = {
    &Usage::clients, &Usage::publishers, &Usage::subscriptions, &Usage::wait_sets,
    &Usage::windows, &Usage::heap_bytes, &Usage::held_messages, &Usage::topics};
static_assert(sizeof(Usage) == std::size(usage_fields) * sizeof(std::uint64_t));

Usage usage_of_one(Kind kind, std::uint64_t held_messages) noexcept {
  Usage one;
  ++(kind == Kind::publisher ? one.publishers : one.subscriptions);
  one.held_messages = held_messages;
  return one;
}

std::uint64_t& count_of(Places& places, Kind kind) noexcept {
  return kind == Kind::publisher ? places.publishers : places.subscriptions;
}

}  // namespace

Usage& Usage::operator+=(const Usage& more) noexcept {
  for (const auto field : usage_fields) this->*field += more.*field;
  return *this;
}

Usage& Usage::operator-=(const Usage& less) noexcept {
  for (const auto field : usage_fields) this->*field -= less.*field;
  return *this;
}

void Accounts::add(std::uint32_t uid, const Usage& part) { accounts_[uid].usage += part; }

void Accounts::subtract(std::uint32_t uid, const Usage& part) {
  Account& account = accounts_[uid];
  account.usage -= part;
  if (account.usage == Usage()) accounts_.erase(uid);
}

void Accounts::add_endpoint(std::uint32_t uid, Kind kind, TopicIndex topic,
                            std::uint64_t held_messages) {
  Account& account = accounts_[uid];
  account.usage += usage_of_one(kind, held_messages);
  ++count_of(account.topics[number(topic)], kind);
  account.usage.topics = account.topics.size();
}

void Accounts::remove_endpoint(std::uint32_t uid, Kind kind, TopicIndex topic,
                               std::uint64_t held_messages) {
  Account& account = accounts_[uid];
  account.usage -= usage_of_one(kind, held_messages);
  Places& places = account.topics[number(topic)];
  --count_of(places, kind);
  if (places.publishers + places.subscriptions == 0) account.topics.erase(number(topic));
  account.usage.topics = account.topics.size();
}

Usage Accounts::usage_of(std::uint32_t uid) const {
  const auto found = accounts_.find(uid);
  return found == accounts_.end() ? Usage() : found->second.usage;
}

bool Accounts::takes_part(std::uint32_t uid, TopicIndex topic) const {
  const auto found = accounts_.find(uid);
  return found != accounts_.end() && found->second.topics.count(number(topic)) != 0;
}

std::optional<std::uint32_t> Accounts::next_user(std::optional<std::uint32_t> after) const {
  const auto next = after ? accounts_.upper_bound(*after) : accounts_.begin();
  if (next == accounts_.end()) return std::nullopt;
  return next->first;
}

std::optional<TopicIndex> Accounts::next_topic_of(std::uint32_t uid,
                                                  std::optional<TopicIndex> after) const {
  const auto account = accounts_.find(uid);
  if (account == accounts_.end()) return std::nullopt;
  const auto& topics = account->second.topics;
  const auto next = after ? topics.upper_bound(number(*after)) : topics.begin();
  if (next == topics.end()) return std::nullopt;
  return TopicIndex{next->first};
}

Places Accounts::user_places(std::uint32_t uid, TopicIndex topic) const {
  const auto found = accounts_.find(uid);
  if (found == accounts_.end()) return {};
  const auto places = found->second.topics.find(number(topic));
  return places == found->second.topics.end() ? Places() : places->second;
}

Places Accounts::most_places_of(std::uint32_t uid) const {
  Places most;
  const auto found = accounts_.find(uid);
  if (found == accounts_.end()) return most;
  for (const auto& [topic, places] : found->second.topics) {
    most.publishers = std::max(most.publishers, places.publishers);
    most.subscriptions = std::max(most.subscriptions, places.subscriptions);
  }
  return most;
}

}  // namespace agnocast::daemon
