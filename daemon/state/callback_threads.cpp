// SPDX-License-Identifier: Apache-2.0

#include <daemon/state/callback_threads.hpp>

#include <algorithm>
#include <new>
#include <utility>

namespace agnocast::daemon {

using abi::wire::ThreadSetting;

void CallbackThreads::add_group(const GroupKey& key, std::string_view node, std::string_view name,
                                bool reentrant, const Rule& rule) {
  if (has_group(key)) return;
  const auto added =
      groups_.emplace(key, Group{std::string(node), std::string(name), reentrant, rule});
  if (!rule) return;
  try {
    const Rule before = first_rule_of(key.first);
    ++uses_[key.first][*rule];
    if (before && *before <= *rule) return;
  } catch (const std::bad_alloc&) {
    groups_.erase(added.first);
    throw;
  }
  choose_rules(key.first);
}

bool CallbackThreads::remove_group(const GroupKey& key) {
  const auto found = groups_.find(key);
  if (found == groups_.end()) return false;
  const Rule rule = found->second.rule;
  groups_.erase(found);
  if (!rule) return true;
  const auto uses = uses_.find(key.first);
  const bool was_first = uses->second.begin()->first == *rule;
  if (--uses->second[*rule] == 0) uses->second.erase(*rule);
  if (uses->second.empty()) uses_.erase(uses);
  if (was_first && first_rule_of(key.first) != rule) choose_rules(key.first);
  return true;
}

void CallbackThreads::add_thread(std::uint64_t executor, std::uint32_t thread) {
  if (has_thread(executor, thread)) return;
  const auto found = threads_.find(thread);
  if (found != threads_.end()) {
    found->second.executors.push_back(executor);
  } else {
    Thread added;
    added.executors.push_back(executor);
    threads_.emplace(thread, std::move(added));
  }
  ++spin_count_;
  choose_rule(thread, threads_.at(thread));
}

bool CallbackThreads::remove_thread(std::uint64_t executor, std::uint32_t thread) {
  if (!has_thread(executor, thread)) return false;
  const auto found = threads_.find(thread);
  std::erase(found->second.executors, executor);
  --spin_count_;
  if (found->second.executors.empty()) {
    if (found->second.is_due) std::erase(due_, thread);
    threads_.erase(found);
  } else {
    choose_rule(thread, found->second);
  }
  return true;
}

bool CallbackThreads::has_thread(std::uint64_t executor, std::uint32_t thread) const {
  const auto found = threads_.find(thread);
  if (found == threads_.end()) return false;
  const auto& executors = found->second.executors;
  return std::find(executors.begin(), executors.end(), executor) != executors.end();
}

CallbackThreads::Rule CallbackThreads::first_rule_of(std::uint64_t executor) const {
  const auto uses = uses_.find(executor);
  if (uses == uses_.end() || uses->second.empty()) return std::nullopt;
  return uses->second.begin()->first;
}

void CallbackThreads::choose_rules(std::uint64_t executor) {
  for (auto& [number, thread] : threads_) {
    const auto& executors = thread.executors;
    if (std::find(executors.begin(), executors.end(), executor) != executors.end())
      choose_rule(number, thread);
  }
}

void CallbackThreads::choose_rule(std::uint32_t number, Thread& thread) {
  Rule rule;
  for (const std::uint64_t executor : thread.executors) {
    const Rule its = first_rule_of(executor);
    if (its && (!rule || *its < *rule)) rule = its;
  }
  if (rule == thread.rule) return;
  if (rule && !thread.is_due) due_.push_back(number);
  thread.is_due = thread.is_due || rule;
  thread.rule = rule;
  thread.attempt = ++last_attempt_;
  thread.outcome = {rule ? ThreadSetting::due : ThreadSetting::no_rule};
}

std::optional<CallbackThreads::Due> CallbackThreads::next_due() {
  while (!due_.empty()) {
    const std::uint32_t number = due_.front();
    due_.pop_front();
    Thread& thread = threads_.at(number);
    thread.is_due = false;
    if (thread.rule) return Due{number, thread.attempt, *thread.rule};
  }
  return std::nullopt;
}

void CallbackThreads::note_outcome(const Due& due, const Outcome& outcome) {
  const auto found = threads_.find(due.thread);
  if (found != threads_.end() && found->second.attempt == due.attempt)
    found->second.outcome = outcome;
}

}  // namespace agnocast::daemon
