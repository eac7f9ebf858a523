// SPDX-License-Identifier: Apache-2.0
//
// The checks of the processes, and of the messages between them.

#include <agnocast/error.hpp>
#include <base/text/text.hpp>
#include <ctl/cli/console.hpp>
#include <ctl/doctor/doctor_facts.hpp>
#include <ctl/snapshot/numbers.hpp>
#include <ctl/snapshot/select.hpp>
#include <region/views.hpp>

#include <algorithm>
#include <bit>
#include <map>

namespace agnocast::ctl {
namespace {

using Ailments = std::vector<Ailment>;
using Line = region::LinkWords<SharedMemory>;

constexpr std::uint64_t mebibyte = std::uint64_t{1} << 20;
// The locked memory that a first publisher needs (docs/errors.md, "Locked memory").
constexpr std::uint64_t publisher_lock_bytes = 26 * mebibyte;
// The addresses that one more peer process costs.
constexpr std::uint64_t peer_address_bytes = 1024 * mebibyte;

std::string node_of(const Endpoint& endpoint) { return escaped(node_name_of(endpoint)); }
std::string who(const Process& process) { return words_of(process); }
std::string who(const System& system, const Endpoint& endpoint) {
  const std::string process = process_words_of(system, endpoint);
  return node_of(endpoint) + (process.empty() ? "" : " of " + process);
}

// A process in a PID namespace unknown to the daemon has pid 0; `kill 0` would end this shell.
Fill pid_words(std::uint64_t pid) { return pid == 0 ? Fill{} : Fill{{"PID", std::to_string(pid)}}; }
Fill restart_of(const Facts& facts, pid_t pid) {
  Fill words = pid_words(static_cast<std::uint64_t>(pid));
  const auto process = facts.processes.find(pid);
  if (process != facts.processes.end() && !process->second.command.empty())
    words["COMMAND"] = process->second.command;
  for (const Running& outsider : facts.outsiders) {
    if (outsider.pid == pid) words["COMMAND"] = outsider.command;
  }
  return words;
}
Fill restart_of(const Facts& facts, const Process* process) {
  return process == nullptr ? Fill{} : restart_of(facts, static_cast<pid_t>(process->facts.pid));
}
Fill topic_words(const Topic& topic) {
  return {{"TOPIC", shell_word(topic.name)}, {"DOMAIN", std::to_string(topic.facts.domain)}};
}

Ailments in_state(const Facts& facts, wire::ProcessState state, const char* words) {
  Ailments found;
  for (const auto& [index, process] : facts.system().processes) {
    if (process.facts.state == state)
      found.push_back(
          {who(process) + words, restart_of(facts, static_cast<pid_t>(process.facts.pid))});
  }
  return found;
}

Ailments stopped(const Facts& facts) {
  Ailments found;
  for (const auto& [index, process] : facts.system().processes) {
    if (process.facts.state == wire::ProcessState::connected && is_stopped(process.facts))
      found.push_back({who(process) + " is stopped", pid_words(process.facts.pid)});
  }
  return found;
}
Ailments orphaned(const Facts& facts) {
  return in_state(facts, wire::ProcessState::orphaned, " has no connection and still runs");
}
Ailments revoked(const Facts& facts) {
  return in_state(facts, wire::ProcessState::revoked, " has no session any more and still runs");
}

bool is_linked(const System& system, const Endpoint& publisher, const Endpoint& subscription) {
  std::byte* const region = system.region_of(subscription);
  return region != nullptr &&
         Line{region, subscription.facts.extent, publisher.facts.index}.publisher_generation().load(
             std::memory_order_acquire) == publisher.facts.generation;
}
std::uint64_t held_by(const System& system, const Endpoint& publisher,
                      const Endpoint& subscription) {
  if (!subscription.takes_messages() || !is_linked(system, publisher, subscription)) return 0;
  const Line line{system.region_of(subscription), subscription.facts.extent, publisher.facts.index};
  std::uint64_t held = 0;
  const std::uint64_t words =
      std::min<std::uint64_t>((publisher.facts.slot_count + 63) / 64, abi::slot_count_max / 64);
  for (std::uint64_t word = 0; word < words; ++word)
    held +=
        static_cast<std::uint64_t>(std::popcount(line.hold(word).load(std::memory_order_relaxed)));
  return held;
}

Ailments dead_kept(const Facts& facts) {
  Ailments found;
  const System& system = facts.system();
  for (const auto& [index, topic] : system.topics) {
    for (const Endpoint& publisher : topic.publishers) {
      const Process* const dead = system.process_of(publisher);
      if (dead == nullptr || dead->facts.state != wire::ProcessState::dead) continue;
      for (const Endpoint& subscription : topic.subscriptions) {
        const Process* const holder = system.process_of(subscription);
        const std::uint64_t held = held_by(system, publisher, subscription);
        if (held == 0 || holder == nullptr) continue;
        found.push_back({"the memory of " + who(*dead) +
                             ", which has ended, is kept: " + who(system, subscription) +
                             " holds " + counted(held, "message") + " of " + escaped(topic.name),
                         restart_of(facts, holder)});
      }
    }
  }
  return found;
}

Ailments lock_limit(const Facts& facts) {
  Ailments found;
  for (const auto& [pid, process] : facts.processes) {
    if (process.may_lock_all || !process.lock_limit || process.locked_bytes == 0 ||
        process.locked_bytes + publisher_lock_bytes <= *process.lock_limit)
      continue;
    found.push_back({"process " + std::to_string(pid) + " has locked " +
                         bytes_for_people(process.locked_bytes) + " of at most " +
                         bytes_for_people(*process.lock_limit),
                     {{"PID", std::to_string(pid)}}});
  }
  return found;
}
Ailments address_limit(const Facts& facts) {
  Ailments found;
  for (const auto& [pid, process] : facts.processes) {
    if (!process.address_limit ||
        process.address_bytes + peer_address_bytes <= *process.address_limit)
      continue;
    found.push_back({"process " + std::to_string(pid) + " has " +
                         bytes_for_people(process.address_bytes) + " of addresses of at most " +
                         bytes_for_people(*process.address_limit),
                     {{"PID", std::to_string(pid)}}});
  }
  return found;
}
Ailments old_library(const Facts& facts) {
  Ailments found;
  for (const auto& [pid, process] : facts.processes) {
    for (const Running::Library& library : process.libraries) {
      if (library.is_replaced)
        found.push_back({"process " + std::to_string(pid) + " runs " + escaped(library.path) +
                             ", which has been replaced since",
                         restart_of(facts, pid)});
    }
  }
  return found;
}

Ailments hook_not_loaded(const Facts& facts) {
  Ailments found;
  for (const auto& [pid, process] : facts.processes) {
    const bool has_hook = std::any_of(
        process.libraries.begin(), process.libraries.end(), [](const Running::Library& library) {
          return library.path.find("/libagnocast_heaphook") != std::string::npos;
        });
    const auto preload = process.environment.find("LD_PRELOAD");
    if (has_hook || preload == process.environment.end()) continue;
    if (preload->second.find("libagnocast_heaphook") == std::string::npos) continue;
    found.push_back({"process " + std::to_string(pid) +
                         " has no heap hook, although LD_PRELOAD is " + in_quotes(preload->second),
                     restart_of(facts, pid)});
  }
  return found;
}
Ailments processes_switched_off(const Facts& facts) {
  Ailments found;
  for (const Running& outsider : facts.outsiders) {
    const auto word = outsider.environment.find("AGNOCAST");
    if (word == outsider.environment.end() || word->second != "off") continue;
    const std::string pid = std::to_string(outsider.pid);
    found.push_back(
        {"process " + pid + " runs with AGNOCAST=off", restart_of(facts, outsider.pid)});
  }
  return found;
}
Ailments other_time(const Facts& facts) {
  Ailments found;
  for (const auto& [pid, process] : facts.processes) {
    if (process.time_namespace.empty() || facts.daemon.time_namespace.empty() ||
        process.time_namespace == facts.daemon.time_namespace)
      continue;
    found.push_back({"process " + std::to_string(pid) + " has its own clocks (" +
                         escaped(process.time_namespace) + ", the daemon " +
                         escaped(facts.daemon.time_namespace) + ")",
                     restart_of(facts, pid)});
  }
  return found;
}

Ailments same_node(const Facts& facts) {
  Arguments everything;
  everything.all_domains = true;
  const System& system = facts.system();
  std::map<std::pair<std::uint64_t, std::string>, const Process*> seen;
  Ailments found;
  for (const Node& node : nodes_of(system, everything)) {
    const auto process = system.processes.find(node.client);
    if (process == system.processes.end() ||
        process->second.facts.generation != node.client_generation)
      continue;
    const Process* own = &process->second;
    const auto [first, is_new] = seen.try_emplace({node.domain, node.full_name()}, own);
    if (is_new) continue;
    const Process* other = first->second;
    if (own->facts.age_ns > other->facts.age_ns) std::swap(own, other);
    found.push_back({"there are two nodes " + escaped(node.full_name()) + ": in " + who(*other) +
                         " and in " + who(*own),
                     restart_of(facts, own)});
  }
  return found;
}

template <class Words>
Ailments of_pairs(const Facts& facts, PairState state, Words words) {
  Ailments found;
  for (const auto& [topic, pairs] : facts.pairs) {
    for (const Pair& pair : pairs) {
      if (pair.state != state) continue;
      found.push_back({escaped(topic->name) + ": " + who(facts.system(), *pair.publisher) + " -> " +
                           who(facts.system(), *pair.subscription) + ": " + pair.why,
                       words(*topic, pair)});
    }
  }
  return found;
}
Ailments qos(const Facts& facts) {
  return of_pairs(facts, PairState::incompatible,
                  [](const Topic& topic, const Pair&) { return topic_words(topic); });
}
Ailments adopted(const Facts& facts) {
  return of_pairs(facts, PairState::adopted, [&](const Topic&, const Pair& pair) {
    return restart_of(facts, facts.system().process_of(*pair.publisher));
  });
}
Ailments withdrawn(const Facts& facts) {
  // The publisher alone decides this, so it is no reason to end the reader.
  return of_pairs(facts, PairState::withdrawn,
                  [](const Topic& topic, const Pair&) { return topic_words(topic); });
}
Ailments unreachable(const Facts& facts) {
  return of_pairs(facts, PairState::unreachable, [&](const Topic&, const Pair& pair) {
    return restart_of(facts, facts.system().process_of(*pair.subscription));
  });
}

Ailments slow_reader(const Facts& facts) {
  Ailments found;
  const System& system = facts.system();
  for (const auto& [index, topic] : system.topics) {
    for (const Endpoint& subscription : topic.subscriptions) {
      const auto numbers = numbers_of_subscription(system, topic, subscription);
      const std::uint64_t depth = abi::reach_of(abi::unpack_qos(subscription.facts.qos));
      // With a depth of one or two, nearly everything is unread, and losses are normal.
      if (!numbers || depth <= 2 || numbers->lost == 0 || numbers->unread * 4 < depth * 3) continue;
      found.push_back({who(system, subscription) + " has lost " +
                           counted(numbers->lost, "message") + " of " + escaped(topic.name) +
                           " and has not read " + std::to_string(numbers->unread) + " (depth " +
                           std::to_string(depth) + ")",
                       topic_words(topic)});
    }
  }
  return found;
}
Ailments holder_at_quota(const Facts& facts) {
  Ailments found;
  const System& system = facts.system();
  for (const auto& [index, topic] : system.topics) {
    for (const Endpoint& subscription : topic.subscriptions) {
      for (const Endpoint& publisher : topic.publishers) {
        const std::uint64_t quota = system.hold_quota(subscription, publisher);
        if (quota == 0 || held_by(system, publisher, subscription) < quota ||
            publisher.state() != abi::BoardState::active ||
            subscription.state() != abi::BoardState::active)
          continue;
        found.push_back({who(system, subscription) + " holds all " + counted(quota, "message") +
                             " of " + escaped(topic.name) + " that it may hold",
                         restart_of(facts, system.process_of(subscription))});
      }
    }
  }
  return found;
}
Ailments no_doorbell(const Facts& facts) {
  Ailments found;
  const System& system = facts.system();
  for (const auto& [index, topic] : system.topics) {
    for (const Endpoint& subscription : topic.subscriptions) {
      if (subscription.state() != abi::BoardState::active || !system.is_silent(subscription))
        continue;
      found.push_back({who(system, subscription) + " finds messages of " + escaped(topic.name) +
                           " only by polling",
                       restart_of(facts, system.process_of(subscription))});
    }
  }
  return found;
}
Ailments heap_full(const Facts& facts) {
  Ailments found;
  const System& system = facts.system();
  for (const auto& [index, process] : system.processes) {
    std::uint64_t used = 0, length = 0;
    for (const WindowNumbers& window : numbers_of_windows(system, process))
      used += window.used_bytes;
    for (std::uint32_t w = 0; w < process.facts.window_count; ++w)
      length += process.facts.window[w].bytes;
    if (process.facts.window_count < system.daemon.limits.windows_per_process ||
        used / 9 < length / 10)
      continue;
    found.push_back(
        {who(process) + " uses " + bytes_for_people(used) + " of " + bytes_for_people(length) +
             " in all " + counted(process.facts.window_count, "window") + " that it may have",
         {{"CONFIGURE", facts.configure("heap", "window_bytes", system.daemon.window_bytes * 2)}}});
  }
  return found;
}

template <class Words>
Ailments refused(const Facts& facts, Errc code, Words words) {
  Ailments found;
  const auto& refusals = facts.system().refusals;
  for (std::size_t i = 0; i < refusals.size(); ++i) {
    const wire::DumpRefusal& refusal = refusals[i];
    if (static_cast<Errc>(refusal.code) != code || refusal.age_ns > lately_ns) continue;
    const std::string name = text_of(refusal.process_name);
    found.push_back({(name.empty() ? "process" : escaped(name)) + std::string(" (pid ") +
                         std::to_string(refusal.pid) + ", uid " + std::to_string(refusal.uid) +
                         ") was refused " + duration_for_people(refusal.age_ns) +
                         " ago: " + escaped(text_of(refusal.why)),
                     words(refusal, facts.rules[i])});
  }
  return found;
}
Ailments type_mismatch(const Facts& facts) {
  return refused(facts, Errc::type_mismatch, [](const wire::DumpRefusal& refusal, const auto&) {
    return Fill{{"TOPIC", shell_word(text_of(refusal.topic))},
                {"DOMAIN", std::to_string(refusal.domain)}};
  });
}
Ailments library_mismatch(const Facts& facts) {
  return refused(facts, Errc::layout_mismatch, [&](const wire::DumpRefusal& refusal, const auto&) {
    return restart_of(facts, static_cast<pid_t>(refusal.pid));
  });
}
Ailments permission(const Facts& facts) {
  return refused(facts, Errc::access_denied,
                 [](const wire::DumpRefusal&, const std::optional<Rule>& rule) {
                   return rule ? Fill{{"LINE", std::to_string(rule->line)}} : Fill{};
                 });
}

using enum Check::Severity;
using enum Check::Needs;

// clang-format off
constexpr Check process_table[] = {
    {"process-stopped", "no process is stopped", failed, daemon,
     "SIGSTOP or a debugger has stopped it: the messages that it holds stay in use, and others may wait for it",
     "kill -CONT PID", stopped},
    {"process-orphaned", "every running process has its connection", warning, daemon,
     "it has closed the connection, and still maps its region",
     "kill PID", orphaned},
    {"process-revoked", "no running process was revoked", failed, daemon,
     "its session was ended from outside; its endpoints neither publish nor receive until it is restarted",
     "kill PID && COMMAND &", revoked},
    {"dead-kept", "no memory of a publisher that has ended is kept", warning, daemon,
     "a subscription holds messages of a publisher that has ended, so its memory is not freed",
     "kill PID && COMMAND &", dead_kept},
    {"lock-limit", "processes that lock memory may lock more", failed, daemon,
     "heap and regions are locked as they grow; at the limit, publish or take fails with lock_limit (LimitMEMLOCK= of its unit)",
     "sudo prlimit --pid PID --memlock=unlimited", lock_limit},
    {"address-limit", "every process has free addresses", failed, daemon,
     "each peer process costs a gibibyte of addresses, not of memory (ulimit -v, LimitAS=)",
     "sudo prlimit --pid PID --as=unlimited", address_limit},
    {"old-library", "every process runs the library that is installed", warning, daemon,
     "an update has replaced the file; the process still runs the former version",
     "kill PID && COMMAND &", old_library},
    {"hook-not-loaded", "every process whose LD_PRELOAD names the heap hook has it", warning, daemon,
     "the loader has left it out, because the file does not exist or cannot be read: the process copies its messages, or cannot publish (hook_missing)",
     "kill PID && agnocast-run COMMAND &", hook_not_loaded},
    {"process-switched-off", "no process that means this daemon is switched off", warning, daemon,
     "it was started with AGNOCAST=off: its endpoints neither publish nor receive",
     "kill PID && env -u AGNOCAST COMMAND &", processes_switched_off},
    {"time-namespace", "all processes share the clocks of the daemon", failed, daemon,
     "it is in another time namespace, so stamps and ages of messages differ there",
     "kill PID && COMMAND &", other_time},
    {"same-node", "no two processes have a node of the same name", warning, daemon,
     "a node was started twice, or two nodes were given the same name; ros2 tools take them for one node",
     "kill PID", same_node},
    {"qos-mismatch", "every publisher offers the QoS that subscriptions of its topic request", failed, daemon,
     "they are not matched, so no message is delivered; change either program: the publisher must offer at least the requested QoS",
     "agnocast-ctl topic info -v TOPIC --domain DOMAIN", qos},
    {"type-mismatch", "no process was refused for another message type recently", failed, daemon,
     "the topic has another type, or the type was built with another layout; the command shows the topic's own type",
     "agnocast-ctl topic info -v TOPIC --domain DOMAIN", type_mismatch},
    {"library-mismatch", "no process was refused for another layout of shared memory recently", failed, daemon,
     "the process uses a libagnocast of another version than the daemon; restart it with the installed version",
     "kill PID && COMMAND &", library_mismatch},
    {"permission", "no process was refused by an access rule recently", failed, daemon,
     "the first [[access]] rule that matches the topic does not name this user",
     "sudo \"${EDITOR:-vi}\" +LINE FILE && RELOAD", permission},
    {"not-zero-copy", "no message was copied into the shared heap", warning, daemon,
     "the program runs without the heap hook, or fills messages outside a loan; with the hook and the scope all, all memory that it allocates is shared",
     "kill PID && agnocast-run --scope all COMMAND &", adopted},
    {"reader-withdrawn", "every publisher serves all of its subscriptions", failed, daemon,
     "the subscription held too many messages of a publisher of another user, or that publisher could not map it; it is served again once the cause is gone",
     "agnocast-ctl topic info -v TOPIC --domain DOMAIN", withdrawn},
    {"unreachable", "every subscription can map its publishers' heaps", failed, daemon,
     "the subscriber's process uses addresses of the publisher's heap; after a restart it reserves them first",
     "kill PID && COMMAND &", unreachable},
    {"slow-reader", "no subscription loses messages", warning, daemon,
     "it reads more slowly than the topic is published, or nothing spins its executor",
     "agnocast-ctl topic info -v TOPIC --domain DOMAIN", slow_reader},
    {"holder-at-quota", "no subscription holds all the messages that it may", warning, daemon,
     "it keeps messages and takes no further ones until it releases some",
     "agnocast-ctl process revoke PID", holder_at_quota},
    {"no-doorbell", "every subscription has a doorbell", warning, daemon,
     "it has closed or lost its doorbells; its publishers continue, and while it waits it polls for messages once a second",
     "kill PID && COMMAND &", no_doorbell},
    {"heap-full", "every publisher has room for messages", failed, daemon,
     "it has all the heap windows that it may have, and they are nearly full: publish fails with window_exhausted",
     "CONFIGURE && ANEW", heap_full},
};
// clang-format on

}  // namespace

const std::span<const Check> process_checks = process_table;

}  // namespace agnocast::ctl
