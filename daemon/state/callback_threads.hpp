// SPDX-License-Identifier: Apache-2.0
//
// CallbackThreads: the callback groups of one process, its threads that run them, and the rule that
// each thread gets. Pure; as the process said on its present connection. Rules are numbers here, in
// the order of the configuration.
//
//   group ──in──▶ executor ◀──spins── thread
//
// The rule of a thread is the first one that matches a group of its executors. A change of groups
// makes the threads due whose rule changes; next_due() gives one after the other to who applies the
// rules.
#pragma once

#include <agnocast/abi/limits.hpp>
#include <agnocast/abi/observe.hpp>

#include <cstddef>
#include <cstdint>
#include <deque>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

namespace agnocast::daemon {

class CallbackThreads {
 public:
  using Rule = std::optional<std::size_t>;  // none: no rule matches
  struct Group {
    std::string node, name;
    bool reentrant;
    Rule rule;
  };
  /// What became of a thread's rule.
  struct Outcome {
    abi::wire::ThreadSetting setting = abi::wire::ThreadSetting::no_rule;
    abi::wire::ThreadCall call = abi::wire::ThreadCall::none;
    int os_errno = 0;
  };
  struct Thread {
    std::vector<std::uint64_t> executors;
    Rule rule;
    Outcome outcome;
    std::uint64_t attempt = 0;  // of which `outcome` is, or will be
    bool is_due = false;        // it is in the queue
  };
  /// A thread whose rule is to be applied.
  struct Due {
    std::uint32_t thread;
    std::uint64_t attempt;
    std::size_t rule;
  };
  using GroupKey = std::pair<std::uint64_t, std::uint64_t>;  // executor, group

  /// Repeated calls do nothing. They throw std::bad_alloc; then there is no effect, or a thread
  /// keeps its previous rule.
  /// `rule`: the first one that matches the group.
  void add_group(const GroupKey& key, std::string_view node, std::string_view name, bool reentrant,
                 const Rule& rule);
  void add_thread(std::uint64_t executor, std::uint32_t thread);
  /// Return false if there is none.
  bool remove_group(const GroupKey& key);
  bool remove_thread(std::uint64_t executor, std::uint32_t thread);
  /// Counts what was not added, because of a limit.
  void leave_out() noexcept { ++left_out_; }
  /// Does the same for what is removed.
  void leave_out_no_more() noexcept {
    if (left_out_ != 0) --left_out_;
  }

  bool has_due() const noexcept { return !due_.empty(); }
  /// Takes the next thread whose rule is to be applied; nothing: none is due.
  std::optional<Due> next_due();
  /// Does nothing if the thread has ended, or has got another rule meanwhile.
  void note_outcome(const Due& due, const Outcome& outcome);

  bool has_group(const GroupKey& key) const { return groups_.contains(key); }
  bool has_thread(std::uint64_t executor, std::uint32_t thread) const;
  const std::map<GroupKey, Group>& groups() const noexcept { return groups_; }
  const std::map<std::uint32_t, Thread>& threads() const noexcept { return threads_; }
  /// Returns the number of pairs of a thread and an executor that it spins.
  std::size_t spin_count() const noexcept { return spin_count_; }
  std::uint64_t left_out() const noexcept { return left_out_; }

 private:
  Rule first_rule_of(std::uint64_t executor) const;
  void choose_rules(std::uint64_t executor);
  void choose_rule(std::uint32_t number, Thread& thread);

  std::map<GroupKey, Group> groups_;
  std::map<std::uint64_t, std::map<std::size_t, std::size_t>> uses_;  // executor, rule: groups
  std::map<std::uint32_t, Thread> threads_;                           // by thread id
  std::size_t spin_count_ = 0;
  std::uint64_t last_attempt_ = 0;
  std::deque<std::uint32_t> due_;  // each thread once, and only threads that are there
  std::uint64_t left_out_ = 0;
};

}  // namespace agnocast::daemon
