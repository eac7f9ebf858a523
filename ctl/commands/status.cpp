// SPDX-License-Identifier: Apache-2.0
//
// status: the daemon, its resources and its limits.

#include <agnocast/abi/fingerprint.hpp>
#include <base/text/text.hpp>
#include <ctl/cli/commands.hpp>
#include <ctl/commands/objects.hpp>
#include <ctl/snapshot/system.hpp>

#include <string>

namespace agnocast::ctl {
namespace {

struct Sums {
  std::uint64_t publishers = 0, subscriptions = 0, orphaned = 0, dead = 0;
};

Sums sums_of(const System& system) {
  Sums sums;
  for (const auto& [index, topic] : system.topics) {
    sums.publishers += topic.publishers.size();
    sums.subscriptions += topic.subscriptions.size();
  }
  for (const auto& [index, process] : system.processes) {
    if (process.facts.state == wire::ProcessState::orphaned) ++sums.orphaned;
    if (process.facts.state == wire::ProcessState::dead) ++sums.dead;
  }
  return sums;
}

std::uint64_t reaped_of(const wire::DaemonCounters& counters) noexcept {
  return counters.clients_died + counters.clients_unmapped + counters.clients_revoked;
}

std::string version_of(const wire::DumpDaemon& daemon) {
  return std::to_string(daemon.version_major) + '.' + std::to_string(daemon.version_minor) + '.' +
         std::to_string(daemon.version_patch);
}

}  // namespace

Object share_object(const wire::UserShare& share) {
  return {{"processes", limit_or_null(share.clients)},
          {"publishers", limit_or_null(share.publishers)},
          {"subscriptions", limit_or_null(share.subscriptions)},
          {"wait_sets", limit_or_null(share.wait_sets)},
          {"heap_bytes", limit_or_null(share.heap_bytes)},
          {"held_messages", limit_or_null(share.held_messages)},
          {"topics", limit_or_null(share.topics)},
          {"queued_bytes", limit_or_null(share.queued_bytes)},
          {"queued_seconds", limit_or_null(share.queued_seconds)},
          {"dumps_per_second", limit_or_null(share.dumps_per_second)},
          {"publishers_per_topic", limit_or_null(share.publishers_per_topic)},
          {"subscriptions_per_topic", limit_or_null(share.subscriptions_per_topic)},
          {"callback_groups", limit_or_null(share.callback_groups)},
          {"callback_threads", limit_or_null(share.callback_threads)}};
}

Object status_object(const System& system, const std::string& socket) {
  const wire::DumpDaemon& daemon = system.daemon;
  const Sums sums = sums_of(system);
  const wire::DaemonCounters& counters = daemon.counters;
  const wire::DaemonLimits& limits = daemon.limits;
  Object users = Object::array();
  for (const wire::DumpUser& user : system.users) {
    Object object{{"uid", user.uid}, {"connections", user.connections}};
    object["observers"] = user.observers;
    object["in_use"] = share_object(user.use);
    users.push_back(std::move(object));
  }
  return {{"schema", "agnocast.status/1"},
          {"daemon",
           {{"version", version_of(daemon)},
            {"pid", daemon.pid},
            {"uid", daemon.uid},
            {"socket", socket},
            {"uptime_ns", daemon.uptime_ns},
            {"incarnation", hexadecimal(daemon.incarnation)},
            {"layout", hexadecimal(abi::fingerprint())},
            {"connections", daemon.connections},
            {"observers", daemon.observers},
            {"log_level", level_word(daemon.log_level)},
            {"kept_descriptors", daemon.kept_descriptors},
            {"kept_descriptors_max", daemon.kept_descriptors_max}}},
          {"in_use",
           {{"processes", system.processes.size()},
            {"processes_orphaned", sums.orphaned},
            {"processes_dead", sums.dead},
            {"topics", system.topics.size()},
            {"publishers", sums.publishers},
            {"subscriptions", sums.subscriptions},
            {"windows", daemon.windows_used}}},
          {"arena",
           {{"base_address", hexadecimal(daemon.arena_base)},
            {"length_bytes", daemon.arena_bytes},
            {"window_bytes", daemon.window_bytes}}},
          {"counters",
           {{"processes_registered", counters.clients_registered},
            {"processes_reaped", reaped_of(counters)},
            {"processes_died", counters.clients_died},
            {"processes_unmapped", counters.clients_unmapped},
            {"processes_revoked", counters.clients_revoked},
            {"processes_rejoined", counters.clients_rejoined},
            {"intents_rolled_back", counters.intents_rolled_back},
            {"intents_rolled_forward", counters.intents_rolled_forward},
            {"intents_corrupt", counters.intents_corrupt},
            {"restarts", counters.restarts},
            {"processes_died_meanwhile", counters.clients_died_meanwhile},
            {"requests_answered_again", counters.requests_answered_again},
            {"requests_refused", counters.requests_refused},
            {"connections_refused", counters.connections_refused},
            {"readers_withdrawn", counters.readers_withdrawn},
            {"readers_served_again", counters.readers_served_again},
            {"readers_mute", counters.readers_mute}}},
          {"limits",
           {{"processes", limits.clients},
            {"topics", limits.topics},
            {"publishers_per_topic", limits.publishers_per_topic},
            {"subscriptions_per_topic", limits.subscriptions_per_topic},
            {"slots_per_publisher", limits.slots_per_publisher},
            {"depth_max", limits.depth_max},
            {"windows_per_process", limits.windows_per_process}}},
          {"quota_per_user", share_object(daemon.quota)},
          {"users", users}};
}

namespace {

std::string of_limit(std::uint64_t used, std::uint64_t limit) {
  return std::to_string(used) + " of " + std::to_string(limit);
}

void print(const System& system, const std::string& socket, Console& console) {
  const wire::DumpDaemon& daemon = system.daemon;
  const wire::DaemonCounters& counters = daemon.counters;
  const Sums sums = sums_of(system);
  const auto line = [&](std::string label, const std::string& value) {
    label.resize(15, ' ');
    console.line(console.strong(label) + value);
  };
  line("agnocastd", version_of(daemon) + ", pid " + std::to_string(daemon.pid) + ", uid " +
                        std::to_string(daemon.uid) + ", up " +
                        duration_for_people(daemon.uptime_ns));
  line("socket", escaped(socket));
  line("layout", hexadecimal(abi::fingerprint()));
  line("processes",
       of_limit(system.processes.size(), daemon.limits.clients) +
           (sums.orphaned == 0 ? ""
                               : ", " + std::to_string(sums.orphaned) + " without a connection") +
           (sums.dead == 0
                ? ""
                : ", " + std::to_string(sums.dead) + " ended and still in use by others"));
  line("topics", of_limit(system.topics.size(), daemon.limits.topics));
  line("publishers", std::to_string(sums.publishers));
  line("subscriptions", std::to_string(sums.subscriptions));
  line("heap windows",
       of_limit(daemon.windows_used,
                daemon.window_bytes == 0 ? 0 : daemon.arena_bytes / daemon.window_bytes) +
           ", each " + bytes_for_people(daemon.window_bytes) + ", from " +
           hexadecimal(daemon.arena_base));
  line("deaths", counted(reaped_of(counters), "process", "processes") + ": " +
                     std::to_string(counters.clients_died) + " died, " +
                     std::to_string(counters.clients_unmapped) + " left, " +
                     std::to_string(counters.clients_revoked) + " revoked");
  line("intents", std::to_string(counters.intents_rolled_back) + " rolled back, " +
                      std::to_string(counters.intents_rolled_forward) + " rolled forward, " +
                      std::to_string(counters.intents_corrupt) + " corrupt");
  line("restarts", std::to_string(counters.restarts) + " of the daemon; meanwhile " +
                       std::to_string(counters.clients_died_meanwhile) + " died; afterwards " +
                       counted(counters.clients_rejoined, "process", "processes") + " came back, " +
                       counted(counters.requests_answered_again, "request") + " answered again");
  line("refused", counted(counters.requests_refused, "request") + ", " +
                      counted(counters.connections_refused, "connection"));
  line("readers", std::to_string(counters.readers_withdrawn) + " withdrawn, " +
                      std::to_string(counters.readers_served_again) + " served again, " +
                      std::to_string(counters.readers_mute) + " mute");
  line("kept", daemon.kept_descriptors_max == 0
                   ? "nothing: the daemon's death ends every session"
                   : of_limit(daemon.kept_descriptors, daemon.kept_descriptors_max) +
                         " descriptors, for a restart of the daemon");
  line("log level", level_word(daemon.log_level));
  console.line("");
  Table table({"UID", "PROCESSES", "TOPICS", "PUBLISHERS", "SUBSCRIPTIONS", "WAIT SETS", "HEAP",
               "MAY HOLD", "OBSERVERS"});
  for (const wire::DumpUser& user : system.users)
    table.add({std::to_string(user.uid), std::to_string(user.use.clients),
               std::to_string(user.use.topics), std::to_string(user.use.publishers),
               std::to_string(user.use.subscriptions), std::to_string(user.use.wait_sets),
               bytes_for_people(user.use.heap_bytes), counted(user.use.held_messages, "message"),
               std::to_string(user.observers)});
  table.print(console);
}

}  // namespace

Outcome<void> show_status(const Arguments& arguments, Console& console) {
  const auto look = look_at(arguments.socket);
  if (!look) return tl::unexpected(look.error());
  if (arguments.json == Json::no) {
    print(look->system, arguments.socket, console);
  } else {
    console.object(status_object(look->system, arguments.socket), arguments.json);
  }
  return {};
}

}  // namespace agnocast::ctl
