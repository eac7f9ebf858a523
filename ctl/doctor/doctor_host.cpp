// SPDX-License-Identifier: Apache-2.0
//
// The checks of the daemon, its limits, and the host.

#include <agnocast/error.hpp>
#include <base/text/names.hpp>
#include <base/text/text.hpp>
#include <ctl/cli/console.hpp>
#include <ctl/doctor/doctor_facts.hpp>

#include <algorithm>
#include <charconv>
#include <limits>
#include <set>

namespace agnocast::ctl {
namespace {

using Ailments = std::vector<Ailment>;

// Updates and changes of the configuration restart it as well.
constexpr std::uint64_t restarts_max = 3;
// For every limit: a warning at nine tenths leaves time to act.
constexpr std::uint64_t near_in_tenths = 9;
constexpr std::uint64_t log_level_debug = 7;
// LimitNOFILE= of the unit, and four times the kernel's usual number of mappings.
constexpr std::uint64_t usual_descriptors = 65536, many_mappings = 262144;

bool is_near(std::uint64_t used, std::uint64_t limit) {
  return limit != unlimited && limit != 0 && used * 10 >= limit * near_in_tenths;
}

std::string pid_of(const Facts& facts) { return std::to_string(facts.system().daemon.pid); }

std::uint64_t doubled(std::uint64_t limit) { return limit > unlimited / 4 ? limit : limit * 2; }

/// The limit that a refusal names: "[quota] topics is 3", and nothing else.
struct Named {
  std::string section, key;
  std::uint64_t value = 0;
};
std::optional<Named> named_in(const std::string& why) {
  const std::size_t open = why.find('['), close = why.find("] ", open);
  if (open == std::string::npos || close == std::string::npos) return std::nullopt;
  constexpr std::string_view is = " is ";
  const std::size_t end = why.find(is, close + 2);
  if (end == std::string::npos) return std::nullopt;
  Named named{why.substr(open + 1, close - open - 1), why.substr(close + 2, end - close - 2)};
  const char* const digits = why.data() + end + is.size();
  if (std::from_chars(digits, why.data() + why.size(), named.value).ec != std::errc() ||
      (named.section != "quota" && named.section != "limits" && named.section != "heap") ||
      named.key.find_first_not_of("abcdefghijklmnopqrstuvwxyz_") != std::string::npos)
    return std::nullopt;  // it becomes part of a command, and may contain names of other users
  return named;
}

/// Adds recent refusals with this code, each for a limit that has not been named before.
void add_refused(const Facts& facts, Errc code, std::set<std::string>& keys, Ailments& found) {
  for (const wire::DumpRefusal& refusal : facts.system().refusals) {
    if (static_cast<Errc>(refusal.code) != code || refusal.age_ns > lately_ns) continue;
    const std::string why = text_of(refusal.why);
    const auto named = named_in(why);
    if (!named || !keys.insert(named->key + std::to_string(refusal.uid)).second) continue;
    found.push_back(
        {"uid " + std::to_string(refusal.uid) + " was refused: " + escaped(why),
         {{"CONFIGURE", facts.configure(named->section, named->key, doubled(named->value))}}});
  }
}

Ailments configuration_wrong(const Facts& facts) {
  if (facts.configuration_fault.empty()) return {};
  return {{facts.configuration_fault}};
}
Ailments program_replaced(const Facts& facts) {
  if (!facts.program_replaced) return {};
  return {
      {"agnocastd (pid " + pid_of(facts) + ") runs a program file that has been replaced since"}};
}
Ailments nothing_kept(const Facts& facts) {
  if (facts.system().daemon.kept_descriptors_max != 0) return {};
  return {{"no process keeps the descriptors of agnocastd (pid " + pid_of(facts) + ")"}};
}
Ailments restarts(const Facts& facts) {
  if (facts.restarts_lately < restarts_max) return {};
  return {{"agnocastd restarted " + std::to_string(facts.restarts_lately) +
           " times within ten minutes"}};
}
Ailments descriptors(const Facts& facts) {
  if (facts.descriptors == 0 || !is_near(facts.descriptors, facts.descriptor_limit)) return {};
  const std::uint64_t count =
      std::min(std::max(doubled(facts.descriptor_limit), usual_descriptors), facts.descriptors_max);
  return {{"agnocastd (pid " + pid_of(facts) + ") uses " + std::to_string(facts.descriptors) +
               " descriptors of " + std::to_string(facts.descriptor_limit),
           {{"PID", pid_of(facts)}, {"COUNT", std::to_string(count)}}}};
}
Ailments debug_log(const Facts& facts) {
  if (facts.system().daemon.log_level < log_level_debug) return {};
  return {{"agnocastd logs at level debug"}};
}

Ailments quota(const Facts& facts) {
  Ailments found;
  std::set<std::string> keys;
  const wire::UserShare& quota = facts.system().daemon.quota;
  for (const wire::DumpUser& user : facts.system().users) {
    const wire::UserShare& use = user.use;
    const struct {
      const char* key;
      std::uint64_t used, limit;
    } shares[] = {
        {"clients", use.clients, quota.clients},
        {"topics", use.topics, quota.topics},
        {"publishers", use.publishers, quota.publishers},
        {"subscriptions", use.subscriptions, quota.subscriptions},
        {"publishers_per_topic", use.publishers_per_topic, quota.publishers_per_topic},
        {"subscriptions_per_topic", use.subscriptions_per_topic, quota.subscriptions_per_topic},
        {"wait_sets", use.wait_sets, quota.wait_sets},
        {"heap_bytes", use.heap_bytes, quota.heap_bytes},
        {"held_messages", use.held_messages, quota.held_messages},
        {"callback_groups", use.callback_groups, quota.callback_groups},
        {"callback_threads", use.callback_threads, quota.callback_threads}};
    for (const auto& share : shares) {
      if (!is_near(share.used, share.limit)) continue;
      // Nothing is refused for these two.
      const bool is_of_threads = std::string_view(share.key).starts_with("callback_");
      keys.insert(share.key + std::to_string(user.uid));
      found.push_back({"uid " + std::to_string(user.uid) + " uses " + std::to_string(share.used) +
                           " of [quota] " + share.key + " = " + std::to_string(share.limit),
                       {{"CONFIGURE", facts.configure("quota", share.key, doubled(share.limit))}},
                       is_of_threads ? "further ones stay unknown to the daemon, and no rule for "
                                       "threads reaches them"
                                     : ""});
    }
  }
  add_refused(facts, Errc::quota_exceeded, keys, found);
  return found;
}

Ailments tables(const Facts& facts) {
  Ailments found;
  std::set<std::string> keys;
  const System& system = facts.system();
  const wire::DaemonLimits& limits = system.daemon.limits;
  const auto look = [&](const std::string& where, const char* key, std::uint64_t used,
                        std::uint64_t limit, std::uint64_t most) {
    if (!is_near(used, limit)) return;
    for (const wire::DumpUser& user : system.users) keys.insert(key + std::to_string(user.uid));
    found.push_back(
        {where + std::to_string(used) + " of [limits] " + key + " = " + std::to_string(limit),
         {{"CONFIGURE", facts.configure("limits", key, std::min(doubled(limit), most))}}});
  };
  look("there are ", "clients", system.processes.size(), limits.clients, abi::client_count_max);
  look("there are ", "topics", system.topics.size(), limits.topics, abi::topic_count_max);
  for (const auto& [index, topic] : system.topics) {
    const std::string has = escaped(topic.name) + " has ";
    const std::uint64_t links = topic.facts.link_blocks * abi::link_block_count;
    if (links < limits.publishers_per_topic) {
      // By default a user has three quarters.
      if (is_near(topic.publishers.size(), links - links / 4) && !check_topic_name(topic.name))
        found.push_back({has + std::to_string(topic.publishers.size()) + " of " +
                             std::to_string(links) +
                             " publishers; it began without being in [limits] wide_topics",
                         {{"CONFIGURE", facts.make_wide(topic.name)}},
                         "further ones are refused; the change is for a topic "
                         "that begins anew, when it has no endpoint left"});
    } else {
      look(has, "publishers_per_topic", topic.publishers.size(), limits.publishers_per_topic,
           abi::publisher_count_max);
    }
    look(has, "subscriptions_per_topic", topic.subscriptions.size(), limits.subscriptions_per_topic,
         abi::subscription_count_max);
  }
  add_refused(facts, Errc::limit_reached, keys, found);
  return found;
}

Ailments depth(const Facts& facts) {
  Ailments found;
  std::set<std::string> keys;
  add_refused(facts, Errc::depth_refused, keys, found);
  return found;
}

bool has_several_users(const Facts& facts) {
  std::set<std::uint64_t> uids;
  if (facts.look) {
    for (const auto& [index, process] : facts.look->system.processes)
      uids.insert(process.facts.uid);
  }
  return uids.size() > 1;
}

Ailments page_collapse(const Facts& facts) {
  if (facts.huge_pages.empty() || facts.huge_pages == "deny" || !has_several_users(facts))
    return {};
  return {
      {"shmem_enabled is " + facts.huge_pages + ", and processes of several users are connected"}};
}

Ailments huge_pages(const Facts& facts) {
  if (has_several_users(facts)) return {};  // see page_collapse()
  if (facts.huge_pages != "never" && facts.huge_pages != "deny") return {};
  return {{"huge pages of shared memory are off (shmem_enabled is " + facts.huge_pages + ")"}};
}

Ailments mappings(const Facts& facts) {
  Ailments found;
  for (const auto& [pid, process] : facts.processes) {
    if (!is_near(process.map_count, facts.map_count_max)) continue;
    found.push_back(
        {"process " + std::to_string(pid) + " has " + std::to_string(process.map_count) +
             " mappings of " + std::to_string(facts.map_count_max),
         {{"COUNT", std::to_string(std::max(doubled(facts.map_count_max), many_mappings))}}});
  }
  return found;
}

using enum Check::Severity;
using enum Check::Needs;

// clang-format off
constexpr Check host_table[] = {
    {"configuration-wrong", "the daemon's configuration is valid", failed, nothing,
     "the file was changed after the daemon read it, or prevents its start; the next start fails",
     "sudo \"${EDITOR:-vi}\" FILE && agnocastd --check-config --config FILE", configuration_wrong},
    {"old-daemon", "agnocastd runs the program that is installed", warning, daemon,
     "an update has replaced the file; the daemon still runs the former version",
     "RELOAD", program_replaced},
    {"nothing-kept", "the descriptors of agnocastd survive its death", warning, daemon,
     "it was started with --fd-store=none, or its service manager keeps none (FileDescriptorStoreMax=): its death ends every session",
     "ANEW", nothing_kept},
    {"daemon-restarts", "agnocastd does not die repeatedly", failed, daemon,
     "it dies and restarts repeatedly; its log gives the reason",
     "journalctl --identifier=agnocastd --priority=err --since=-10min", restarts},
    {"descriptor-limit", "agnocastd may open more descriptors", warning, daemon,
     "each process costs it about eight; without free ones it refuses new processes (LimitNOFILE= of the unit)",
     "sudo prlimit --pid PID --nofile=COUNT", descriptors},
    {"debug-log", "agnocastd does not log at level debug", warning, daemon,
     "one line for every registration and endpoint slows it down and fills the log",
     "agnocast-ctl log-level info", debug_log},
    {"quota", "no user is near a quota", failed, daemon,
     "further requests are refused with quota_exceeded",
     "CONFIGURE && RELOAD", quota},
    {"table-full", "the tables of the daemon have free rows", failed, daemon,
     "further requests are refused with limit_reached",
     "CONFIGURE && RELOAD", tables},
    {"depth", "no history was refused for its depth recently", failed, daemon,
     "a publisher or subscription wants more than [limits] allows: depth_refused",
     "CONFIGURE && RELOAD", depth},
    {"huge-pages", "shared memory can use huge pages", warning, nothing,
     "without huge pages for shared memory, large messages cost thirty times as many page faults",
     "echo 'w /sys/kernel/mm/transparent_hugepage/shmem_enabled - - - - advise' | sudo tee /etc/tmpfiles.d/agnocast-pages.conf "
     "&& sudo systemd-tmpfiles --create /etc/tmpfiles.d/agnocast-pages.conf", huge_pages},
    {"page-collapse", "no reader can delay other users through shared pages", warning, daemon,
     "a process that may read shared memory may collapse its pages into huge ones (MADV_COLLAPSE, Linux 6.1); meanwhile every process that accesses them waits",
     "echo 'w /sys/kernel/mm/transparent_hugepage/shmem_enabled - - - - deny' | sudo tee /etc/tmpfiles.d/agnocast-pages.conf "
     "&& sudo systemd-tmpfiles --create /etc/tmpfiles.d/agnocast-pages.conf", page_collapse},
    {"mapping-limit", "no process is near its limit of mappings", failed, daemon,
     "each peer process costs about ten mappings; without free ones its messages are lost. The processes of one other user get a quarter, those of all other users half",
     "sudo sysctl -w vm.max_map_count=COUNT", mappings},
};
// clang-format on

}  // namespace

const std::span<const Check> host_checks = host_table;

}  // namespace agnocast::ctl
