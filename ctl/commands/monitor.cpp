// SPDX-License-Identifier: Apache-2.0
//
// monitor: events from now on. Decisions of the daemon come from its log, so none is missed.
// Changes inside processes (messages lost, adopted or refused, a process that stops) come from the
// differences of counters, read five times a second.

#include <base/text/text.hpp>
#include <ctl/cli/commands.hpp>
#include <ctl/cli/waiting.hpp>
#include <ctl/commands/objects.hpp>
#include <ctl/snapshot/journal.hpp>
#include <ctl/snapshot/numbers.hpp>
#include <ctl/snapshot/refusals.hpp>
#include <ctl/snapshot/select.hpp>
#include <ctl/snapshot/watch.hpp>

#include <cstdint>
#include <map>
#include <string>
#include <tuple>
#include <utility>

namespace agnocast::ctl {
namespace {

constexpr int look_interval_ms = 200;

/// Everything that is compared from look to look.
struct Snapshot {
  struct Counter {
    std::uint64_t value = 0;
    std::string subject, topic;  // "subscription of /points by listener (pid 1, uid 2)"
  };
  // Keyed by generation of the endpoint and name of the counter.
  std::map<std::pair<std::uint64_t, const char*>, Counter> counters;
  std::map<std::uint64_t, std::pair<std::string, std::string>> states;  // of processes: name, state
  std::map<std::tuple<std::uint32_t, std::uint32_t, std::uint32_t, std::string, std::uint32_t>,
           std::pair<std::uint64_t, wire::DumpRefusal>>
      refusals;  // times, refusal
};

const char* state_word_of(const wire::DumpProcess& process) {
  if (process.state == wire::ProcessState::orphaned) return "has lost its connection";
  if (process.state != wire::ProcessState::connected) return "has no session any more";
  return is_stopped(process) ? "is stopped" : "is running";
}

Snapshot snapshot_of(const System& system) {
  Snapshot now;
  for (const auto& entry : system.topics) {
    const Topic& topic = entry.second;
    for (const Endpoint& publisher : topic.publishers) {
      const auto numbers = counters_of_publisher(system, topic, publisher);
      if (!numbers) continue;
      const std::string subject =
          "publisher of " + escaped(topic.name) + " by " + process_words(system, publisher);
      const auto put = [&](const char* what, std::uint64_t value) {
        now.counters[{publisher.facts.generation, what}] = {value, subject, topic.name};
      };
      put("adopted", numbers->adopted_messages);
      put("refused_no_slot", numbers->refused_no_slot);
      put("refused_would_block", numbers->refused_would_block);
      put("refused_heap_exhausted", numbers->refused_heap_exhausted);
    }
    for (const Endpoint& subscription : topic.subscriptions) {
      const auto numbers = numbers_of_subscription(system, topic, subscription);
      if (!numbers) continue;
      const std::string subject =
          "subscription of " + escaped(topic.name) + " by " + process_words(system, subscription);
      now.counters[{subscription.facts.generation, "lost"}] = {numbers->lost, subject, topic.name};
      now.counters[{subscription.facts.generation, "unreachable"}] = {numbers->unreachable, subject,
                                                                      topic.name};
    }
  }
  for (const auto& [index, process] : system.processes)
    now.states[process.facts.generation] = {
        escaped(process.name) + " (pid " + std::to_string(process.facts.pid) + ")",
        state_word_of(process.facts)};
  for (const wire::DumpRefusal& refusal : system.refusals)
    now.refusals[{refusal.code, refusal.uid, refusal.pid, text_of(refusal.topic),
                  static_cast<std::uint32_t>(refusal.kind)}] = {refusal.times, refusal};
  return now;
}

class Monitor {
 public:
  Monitor(const Arguments& arguments, Console& console, JournalFilter filter)
      : arguments_(arguments), console_(console), filter_(std::move(filter)) {}

  void tell(const Journal& journal) {
    for (const wire::JournalRecord& record : journal.records) {
      if (!passes(record, filter_)) continue;
      if (arguments_.json == Json::no) {
        console_.line(line_of(record, journal));
      } else {
        Object object{{"schema", "agnocast.monitor/1"}, {"event", "journal"}};
        object.update(record_object(record, journal));
        console_.object(object, Json::compact);
      }
    }
  }

  void tell(const Snapshot& before, const Snapshot& now) {
    for (const auto& [key, counter] : now.counters) {
      const auto known = before.counters.find(key);
      const std::uint64_t was = known == before.counters.end() ? 0 : known->second.value;
      if (counter.value <= was || !is_wanted(counter.topic, counter.subject)) continue;
      say(key.second, counter.subject,
          counted(counter.value - was, "message") + ' ' + phrase_of(key.second) + " (" +
              std::to_string(counter.value) + " in all)",
          {{"topic", counter.topic},
           {"messages", counter.value - was},
           {"messages_in_all", counter.value}});
    }
    for (const auto& [generation, process] : now.states) {
      const auto known = before.states.find(generation);
      if (known == before.states.end() || known->second.second == process.second ||
          !is_wanted({}, process.first))
        continue;
      say("process_state", process.first, process.second, {{"state", process.second}});
    }
    for (const auto& [key, refusal] : now.refusals) {
      const auto known = before.refusals.find(key);
      if (known != before.refusals.end() && known->second.first == refusal.first) continue;
      const std::string who = escaped(text_of(refusal.second.process_name)) + " (pid " +
                              std::to_string(refusal.second.pid) + ")";
      if (!is_wanted(text_of(refusal.second.topic), who)) continue;
      say("refused", who, "refused: " + refusal_words(refusal.second),
          {{"refusal", refusal_object(refusal.second)}});
    }
  }

 private:
  static std::string phrase_of(const char* counter) {
    const std::string what = counter;
    if (what == "adopted") return "copied into the shared heap";
    if (what == "lost") return "lost";
    if (what == "unreachable") return "at addresses that the process uses otherwise";
    return "not published: " + what.substr(std::string("refused_").size());
  }

  // Searches a name or pid in the text that names the process.
  bool is_wanted(const std::string& topic, const std::string& subject) const {
    if (!filter_.topic.empty() && topic != filter_.topic) return false;
    return filter_.process.empty() ||
           subject.find(escaped(filter_.process) + " (pid ") != std::string::npos ||
           subject.find("(pid " + filter_.process + ')') != std::string::npos ||
           subject.find("(pid " + filter_.process + ',') != std::string::npos;
  }

  void say(const char* event, const std::string& subject, const std::string& what, Object facts) {
    if (arguments_.json == Json::no)
      return console_.line(now_for_people() + ' ' + subject + ": " + what);
    Object object{{"schema", "agnocast.monitor/1"},
                  {"event", event},
                  {"time", now_for_programs()},
                  {"text", subject + ": " + what}};
    object.update(facts);
    console_.object(object, Json::compact);
  }

  const Arguments& arguments_;
  Console& console_;
  JournalFilter filter_;
};

}  // namespace

Outcome<void> monitor_system(const Arguments& arguments, Console& console) {
  auto filter = filter_of(arguments);
  if (!filter) return tl::unexpected(filter.error());
  const Waiting waiting;
  auto watch = Watch::begin(arguments.socket);
  if (!watch) return tl::unexpected(watch.error());
  auto log = watch->observer().read_journal(0, 0);
  if (!log) return tl::unexpected(log.error());
  std::uint64_t shown = log->end.newest;
  Snapshot before = snapshot_of(watch->system());
  Monitor monitor(arguments, console, std::move(*filter));
  while (waiting.sleep_ms(look_interval_ms)) {
    if (auto renewed = watch->renew(); !renewed) return renewed;
    if (watch->is_away()) continue;
    if (auto news = watch->observer().read_journal(0, 0)) {
      if (news->end.newest < shown) shown = 0;  // another incarnation of the daemon
      if (news->end.newest != shown) {
        const std::uint64_t newest = news->end.newest;
        news = watch->observer().read_journal(newest, newest - shown);
        if (news) {
          monitor.tell(*news);
          shown = newest;
        }
      }
    }
    Snapshot now = snapshot_of(watch->system());
    monitor.tell(before, now);
    before = std::move(now);
    console.flush();
  }
  return {};
}

}  // namespace agnocast::ctl
