// SPDX-License-Identifier: Apache-2.0

#include <daemon/config/rule_reading.hpp>

#include <agnocast/topic_pattern.hpp>
#include <base/text/names.hpp>
#include <base/text/text.hpp>
#include <daemon/config/scheduling_text.hpp>

#include <sched.h>

#include <algorithm>
#include <cstdint>
#include <initializer_list>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

namespace agnocast::daemon {
namespace {

// The kernel's names of threads (TASK_COMM_LEN), without the terminating zero.
constexpr std::size_t program_name_length_max = 15;
// The kernel's resolution of runtimes: sched_setattr(2) refuses shorter ones.
constexpr std::uint64_t runtime_ns_min = 1024;

/// Returns why a pattern can match no name of a callback group, as a sentence; nothing if it can.
std::optional<std::string> name_problem(std::string_view pattern) {
  if (pattern.empty()) return "the pattern is empty";
  if (pattern.size() > name_length_max) return "the pattern is longer than 255 characters";
  if (!std::all_of(pattern.begin(), pattern.end(), [](char c) { return c >= ' ' && c <= '~'; }))
    return "only characters of ASCII that can be printed are allowed";
  if (pattern.find("***") != std::string_view::npos) return "more than two stars in a row";
  return std::nullopt;
}

/// Likewise for names of programs, which the kernel makes.
std::optional<std::string> program_problem(std::string_view pattern) {
  if (auto problem = name_problem(pattern)) return problem;
  if (pattern.find('/') != std::string_view::npos) return "the name of a program has no slash";
  const auto stars = std::count(pattern.begin(), pattern.end(), '*');
  if (pattern.size() - static_cast<std::size_t>(stars) > program_name_length_max)
    return "the kernel keeps 15 characters of a program's name";
  return std::nullopt;
}

// Reads one table [[thread]].
class RuleReader {
 public:
  RuleReader(TomlReading& toml, const toml::table& table) : toml_(toml), table_(table) {}

  /// Returns nothing after a mistake.
  std::optional<ThreadRule> read() {
    rule_.line = static_cast<std::uint32_t>(place().line);
    for (const auto& [key, node] : table_) read_key(key, node);
    check_complete();
    // A policy with a mistake says nothing about the other keys.
    if (!table_.contains("policy") || scheduling().sets_policy != 0) check_together();
    if (toml_.count() != mistakes_before_) return std::nullopt;
    return std::move(rule_);
  }

 private:
  using Scheduling = abi::wire::ThreadScheduling;

  struct Key {
    std::string_view name;
    void (RuleReader::*read)(const toml::node&);
  };
  static const Key keys[11];

  void read_key(const toml::key& name, const toml::node& node) {
    std::vector<std::string_view> names;
    for (const Key& key : keys) {
      if (key.name == name.str()) return (this->*key.read)(node);
      names.push_back(key.name);
    }
    toml_.unknown(name, "thread." + escaped(name.str()), names);
  }

  Scheduling& scheduling() noexcept { return rule_.scheduling; }
  const Place& place() const { return table_.source().begin; }
  Place place_of(std::string_view key) const {
    const toml::node* const node = table_.get(key);
    return node != nullptr ? node->source().begin : place();
  }
  void report(std::string_view key, std::string what, std::string remedy) {
    toml_.report(place_of(key), "thread." + std::string(key), std::move(what), std::move(remedy));
  }

  // Keys

  void read_pattern(const toml::node& node, std::string_view key, std::string_view form,
                    std::optional<std::string> (*problem_of)(std::string_view),
                    std::optional<std::string>& pattern) {
    const auto* const text = node.as_string();
    if (text == nullptr) return toml_.wrong_type(node, "thread." + std::string(key), form);
    pattern = text->get();
    if (const auto problem = problem_of(*pattern))
      report(key, in_quotes(*pattern) + ": " + *problem, "write " + std::string(form));
  }
  void read_process(const toml::node& node) {
    read_pattern(node, "process",
                 "a pattern of the first 15 characters of the program's name: \"lidar_*\"",
                 program_problem, rule_.process);
  }
  void read_node(const toml::node& node) {
    read_pattern(node, "node", "a pattern of names of nodes: \"/lidar/**\"", topic_pattern_problem,
                 rule_.node);
  }
  void read_group(const toml::node& node) {
    read_pattern(node, "group", "a pattern of names of callback groups: \"points*\"", name_problem,
                 rule_.group);
  }
  void read_users(const toml::node& node) {
    rule_.users = toml_.principals(node, "thread.users");
    if (node.is_array() && node.as_array()->empty())
      report("users", "the rule has no effect", "name the users whose processes it is for");
  }

  void read_policy(const toml::node& node) {
    const auto* const text = node.as_string();
    if (text == nullptr)
      return toml_.wrong_type(node, "thread.policy", "one of " + std::string(policy_names));
    const auto policy = policy_of(text->get());
    if (!policy) {
      return report("policy", in_quotes(text->get()) + " is not a policy",
                    "use " + std::string(policy_names));
    }
    scheduling().sets_policy = 1;
    scheduling().policy = *policy;
  }

  std::optional<std::int64_t> number_of(const toml::node& node, std::string_view key,
                                        std::int64_t least, std::int64_t most) {
    const auto* const number = node.as_integer();
    if (number == nullptr) {
      toml_.wrong_type(node, "thread." + std::string(key), "an integer");
    } else if (number->get() < least || number->get() > most) {
      report(key, std::to_string(number->get()) + " is out of range",
             "use " + std::to_string(least) + " to " + std::to_string(most));
    } else {
      return number->get();
    }
    return std::nullopt;
  }
  void read_priority(const toml::node& node) {
    // sched_get_priority_min(2) and sched_get_priority_max(2) of Linux
    if (const auto priority = number_of(node, "priority", 1, 99))
      scheduling().priority = static_cast<std::uint32_t>(*priority);
  }
  void read_nice(const toml::node& node) {
    const auto nice = number_of(node, "nice", -20, 19);
    if (!nice) return;
    scheduling().sets_nice = 1;
    scheduling().nice = *nice;
  }

  void read_time(const toml::node& node, std::string_view key, std::uint64_t& nanoseconds) {
    constexpr const char* form = "a whole number and its unit: \"5ms\" (ns, us, ms, s)";
    const auto* const text = node.as_string();
    if (text == nullptr) return toml_.wrong_type(node, "thread." + std::string(key), form);
    if (const auto duration = parse_duration(text->get())) {
      nanoseconds = *duration;
    } else {
      report(key, in_quotes(text->get()) + " is not a duration below 2^63 ns",
             "write " + std::string(form));
    }
  }
  void read_runtime(const toml::node& node) { read_time(node, "runtime", scheduling().runtime_ns); }
  void read_deadline(const toml::node& node) {
    read_time(node, "deadline", scheduling().deadline_ns);
  }
  void read_period(const toml::node& node) { read_time(node, "period", scheduling().period_ns); }

  void read_cpus(const toml::node& node) {
    const auto* const text = node.as_string();
    if (text == nullptr)
      return toml_.wrong_type(node, "thread.cpus", "a list of processors as a string: \"0-3,6\"");
    rule_.written_cpus = text->get();
    if (const auto problem = read_cpu_list(rule_.written_cpus, scheduling().cpus)) {
      return report("cpus", in_quotes(rule_.written_cpus) + ": " + *problem,
                    "write processors from 0 to " + std::to_string(abi::cpu_count_max - 1) +
                        " like \"0-3,6\"");
    }
    scheduling().sets_cpus = 1;
  }

  // Rules

  void check_complete() {
    if (!table_.contains("users"))
      report("users", "is missing", "name the users whose processes it is for: [\"user:NAME\"]");
    if (!table_.contains("process") && !table_.contains("node") && !table_.contains("group")) {
      toml_.report(place(), "thread", "the rule names no callback groups",
                   "add process, node or group; node = \"**\" stands for every node");
    }
    if (!table_.contains("policy") && !table_.contains("nice") && !table_.contains("cpus"))
      toml_.report(place(), "thread", "the rule has no effect", "add policy, nice or cpus");
  }

  bool has_policy(std::initializer_list<std::uint32_t> policies) {
    return scheduling().sets_policy != 0 &&
           std::find(policies.begin(), policies.end(), scheduling().policy) != policies.end();
  }

  void check_together() {
    const bool has_priority = has_policy({SCHED_FIFO, SCHED_RR});
    if (has_priority && !table_.contains("priority")) {
      toml_.report(place_of("policy"), "thread.priority", "is missing",
                   "add one: priority = 1 to 99, the highest");
    }
    if (!has_priority && table_.contains("priority"))
      report("priority", "is for the policies fifo and rr", "remove it, or add such a policy");
    if (has_policy({SCHED_FIFO, SCHED_RR, SCHED_IDLE, SCHED_DEADLINE}) && table_.contains("nice"))
      report("nice", "is for the policies other and batch", "remove it, or use such a policy");
    if (!has_policy({SCHED_DEADLINE})) {
      for (const char* const key : {"runtime", "deadline", "period"}) {
        if (table_.contains(key))
          report(key, "is for the policy deadline", "remove it, or use that policy");
      }
      return;
    }
    if (table_.contains("cpus")) {
      report("cpus",
             "cannot be set with the policy deadline: the kernel wants such a thread to be allowed "
             "on all processors of its root domain (sched(7))",
             "remove it, and divide the processors with cpusets (cpuset(7))");
    }
    check_times();
  }

  void check_times() {
    const bool has_deadline = table_.contains("deadline");
    const bool has_period = table_.contains("period");
    if (!table_.contains("runtime")) {
      toml_.report(place_of("policy"), "thread.runtime", "is missing",
                   "add the time that the thread needs in each period: runtime = \"2ms\"");
    }
    if (!has_deadline && !has_period) {
      toml_.report(place_of("policy"), "thread.period", "is missing",
                   "add period, deadline or both: period = \"10ms\"");
    }
    if (toml_.count() != mistakes_before_) return;
    Scheduling& times = scheduling();
    if (!has_deadline) times.deadline_ns = times.period_ns;
    if (!has_period) times.period_ns = times.deadline_ns;
    if (times.runtime_ns < runtime_ns_min)
      report("runtime", written("runtime") + " is too short", "use 1024ns or more");
    check_order("runtime", times.runtime_ns, has_deadline ? "deadline" : "period",
                times.deadline_ns);
    if (has_deadline) check_order("deadline", times.deadline_ns, "period", times.period_ns);
  }

  std::string written(std::string_view key) const { return table_.get(key)->as_string()->get(); }
  void check_order(std::string_view shorter, std::uint64_t shorter_ns, std::string_view longer,
                   std::uint64_t longer_ns) {
    if (shorter_ns <= longer_ns) return;
    report(shorter,
           written(shorter) + " is more than the " + std::string(longer) + " (" + written(longer) +
               ')',
           "the order is runtime <= deadline <= period");
  }

  TomlReading& toml_;
  const toml::table& table_;
  const std::size_t mistakes_before_ = toml_.count();
  ThreadRule rule_;
};

// In the order of the printed configuration.
constexpr RuleReader::Key RuleReader::keys[] = {
    {"process", &RuleReader::read_process},   {"node", &RuleReader::read_node},
    {"group", &RuleReader::read_group},       {"users", &RuleReader::read_users},
    {"policy", &RuleReader::read_policy},     {"priority", &RuleReader::read_priority},
    {"nice", &RuleReader::read_nice},         {"runtime", &RuleReader::read_runtime},
    {"deadline", &RuleReader::read_deadline}, {"period", &RuleReader::read_period},
    {"cpus", &RuleReader::read_cpus},
};

// Returns whether `earlier` matches whatever `later` matches, as far as their text shows it.
bool covers(const ThreadRule& earlier, const ThreadRule& later) {
  const auto covers_names = [](const auto& wide, const auto& narrow) {
    return !wide || *wide == "**" || wide == narrow;
  };
  return covers_names(earlier.process, later.process) && covers_names(earlier.node, later.node) &&
         covers_names(earlier.group, later.group);
}

}  // namespace

void read_thread_rules(TomlReading& toml, const toml::node& node, std::vector<ThreadRule>& rules) {
  const std::vector<const toml::table*> tables = toml.tables(node, "thread");
  if (tables.size() > thread_rule_count_max) {
    toml.report(tables[thread_rule_count_max]->source().begin, "thread",
                "there are more than " + std::to_string(thread_rule_count_max) + " rules",
                "join some of them with patterns");
    return;
  }
  for (const toml::table* const table : tables) {
    auto rule = RuleReader(toml, *table).read();
    if (!rule) continue;
    // A rule that never decides shows that the order is wrong.
    const auto earlier = std::find_if(rules.begin(), rules.end(),
                                      [&](const ThreadRule& one) { return covers(one, *rule); });
    if (earlier != rules.end()) {
      toml.report(table->source().begin, "thread",
                  "never decides: line " + std::to_string(earlier->line) +
                      " has the same threads and comes first",
                  "join both rules, or put the narrower one first");
    }
    rules.push_back(std::move(*rule));
  }
}

}  // namespace agnocast::daemon
