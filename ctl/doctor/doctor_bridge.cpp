// SPDX-License-Identifier: Apache-2.0
//
// The checks of the bridges to DDS.

#include <base/text/text.hpp>
#include <ctl/cli/console.hpp>
#include <ctl/doctor/doctor_facts.hpp>

#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <set>
#include <sstream>

namespace agnocast::ctl {
namespace {

using Ailments = std::vector<Ailment>;

// The node that owns the endpoints of a bridge.
constexpr std::string_view bridge_node = "_agnocast_bridge";
// The buffer holds a received message in fragments, each with the kernel's bookkeeping.
constexpr std::uint64_t buffer_factor = 2;

std::string start_of(const Facts& facts, std::uint64_t domain) {
  const std::string number = std::to_string(domain);
  if (facts.door.is_systems)
    return "sudo systemctl enable --now agnocast-bridge" +
           (domain == facts.unit_domain ? std::string() : '@' + number);
  return "agnocast-bridge --socket " + shell_word(facts.door.path) + " --domain " + number + " &";
}

Ailments not_running(const Facts& facts) {
  Ailments found;
  for (const std::string& unit : facts.idle_bridge_units)
    found.push_back(
        {escaped(unit) + " is enabled, but its bridge does not answer",
         {{"BRIDGE", "sudo systemctl restart " + shell_word(unit) + " || journalctl -u " +
                         shell_word(unit) + " -n 20 --no-pager"}}});
  if (!facts.rival_bridge_unit.empty())
    found.push_back(
        {"agnocast-bridge.service and " + escaped(facts.rival_bridge_unit) +
             " are both enabled, for domain " + std::to_string(facts.unit_domain),
         {{"BRIDGE", "sudo systemctl disable --now " + shell_word(facts.rival_bridge_unit) +
                         " && sudo systemctl restart agnocast-bridge"}},
         "one of them serves the domain, so the other one cannot"});
  const auto has_idle_unit = [&](std::uint64_t domain) {
    const std::string instance = "agnocast-bridge@" + std::to_string(domain) + ".service";
    const auto& idle = facts.idle_bridge_units;
    return std::any_of(idle.begin(), idle.end(), [&](const std::string& unit) {
      return unit == instance || (unit == "agnocast-bridge.service" && domain == facts.unit_domain);
    });
  };
  for (const auto& [path, domain] : facts.dead_bridges)
    if (!has_idle_unit(domain))
      found.push_back(
          {"nobody listens at " + escaped(path), {{"BRIDGE", start_of(facts, domain)}}});
  return found;
}

Ailments elsewhere(const Facts& facts) {
  if (facts.bridges.empty()) return {};
  std::set<std::uint64_t> bridged, used;
  for (const BridgeState& bridge : facts.bridges) bridged.insert(bridge.domain);
  for (const auto& [index, topic] : facts.system().topics) {
    const auto is_a_nodes = [](const Endpoint& endpoint) {
      return !endpoint.node_name.starts_with(bridge_node);
    };
    if (std::any_of(topic.publishers.begin(), topic.publishers.end(), is_a_nodes) ||
        std::any_of(topic.subscriptions.begin(), topic.subscriptions.end(), is_a_nodes))
      used.insert(topic.facts.domain);
  }
  const auto is_bridged = [&](std::uint64_t domain) { return bridged.count(domain) != 0; };
  if (std::any_of(used.begin(), used.end(), is_bridged)) return {};
  Ailments found;
  for (const std::uint64_t domain : used)
    found.push_back(
        {"this host has nodes in domain " + std::to_string(domain) + ", but no bridge serves it",
         {{"BRIDGE", start_of(facts, domain)}}});
  return found;
}

/// Returns the command that starts a bridge of this shell again, with this shell's variables.
std::string start_again(const BridgeState& bridge, const std::string& command) {
  return "kill " + std::to_string(bridge.pid) + " && flock " + shell_word(bridge.path + ".lock") +
         " true && " + command + " &";
}

Ailments other_range(const Facts& facts) {
  Ailments found;
  if (!facts.shell_has_range) return found;
  for (const BridgeState& bridge : facts.bridges) {
    const auto range = facts.bridge_ranges.find(bridge.pid);
    if (range == facts.bridge_ranges.end() || range->second == facts.shell_range) continue;
    const auto words_of = [](const std::string& variable) {
      return variable.empty() ? "no limit" : variable;
    };
    // Both, because the older variable wins.
    std::string wanted = "ROS_LOCALHOST_ONLY=1";
    if (facts.shell_range != wanted)
      wanted =
          "ROS_LOCALHOST_ONLY=0 " +
          (facts.shell_range.empty() ? "ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET" : facts.shell_range);
    const auto command = facts.bridge_commands.find(bridge.pid);
    const auto unit = facts.bridge_units.find(bridge.pid);
    found.push_back(
        {"the bridge of domain " + std::to_string(bridge.domain) + " looks for others with " +
             escaped(words_of(range->second)) + ", this shell's nodes with " +
             escaped(words_of(facts.shell_range)),
         {{"RANGE", command != facts.bridge_commands.end()
                        ? start_again(bridge, command->second)
                        : "printf '%s\\n' " + escaped(wanted) +
                              " | sudo tee -a /etc/default/agnocast-bridge && sudo systemctl "
                              "restart " +
                              (unit == facts.bridge_units.end() ? "'agnocast-bridge*'"
                                                                : shell_word(unit->second))}}});
  }
  return found;
}

std::vector<std::string> prefixes_in(const std::string& path) {
  std::vector<std::string> prefixes;
  std::istringstream in(path);
  for (std::string prefix; std::getline(in, prefix, ':');)
    if (!prefix.empty()) prefixes.push_back(prefix);
  return prefixes;
}

/// Returns the directories on the path that only their owner and group may enter.
std::vector<std::string> closed_on_the_way_to(const std::string& path) {
  std::vector<std::string> closed;
  for (std::size_t at = path.find('/', 1); at != std::string::npos; at = path.find('/', at + 1)) {
    struct stat facts {};
    const std::string directory = path.substr(0, at);
    if (::stat(directory.c_str(), &facts) == 0 && (facts.st_mode & S_IXOTH) == 0)
      closed.push_back(directory);
  }
  return closed;
}

/// Adds the remedy that gives the bridge this shell's libraries, and why the bridge lacks them.
Ailment with_remedy(const Facts& facts, const BridgeState& bridge, const std::string& package,
                    Ailment ailment) {
  const std::string library = "/lib/lib" + package + "__rosidl_typesupport_introspection_cpp.so";
  std::string where;
  std::vector<std::string> prefixes = prefixes_in(facts.prefix_path);
  for (const std::string& prefix : prefixes)
    if (where.empty() && ::access((prefix + library).c_str(), F_OK) == 0) where = prefix;
  std::string& remedy = ailment.words["PATHS"];
  if (where.empty()) {
    ailment.cause +=
        "; this shell does not have it either. Source its workspace here, and doctor "
        "prints the command for the bridge";
    remedy = ". WORKSPACE/setup.sh && agnocast-ctl doctor  # WORKSPACE has " + shell_word(package);
    return ailment;
  }
  const auto command = facts.bridge_commands.find(bridge.pid);
  if (command != facts.bridge_commands.end()) {
    ailment.cause += "; this shell has it in " + escaped(where);
    remedy = start_again(bridge, command->second);
    return ailment;
  }
  for (const std::string& old : prefixes_in(facts.units_prefix_path))
    if (std::find(prefixes.begin(), prefixes.end(), old) == prefixes.end()) prefixes.push_back(old);
  std::string all;
  for (const std::string& prefix : prefixes) all += (all.empty() ? "" : ":") + prefix;
  const std::vector<std::string> closed = closed_on_the_way_to(where + library);
  for (const std::string& directory : closed) {
    ailment.cause += "; the user agnocast-bridge may not enter " + escaped(directory);
    remedy += "sudo chmod o+x " + shell_word(directory) + " && ";
  }
  if (closed.empty()) ailment.cause += "; this shell has it in " + escaped(where);
  const auto unit = facts.bridge_units.find(bridge.pid);
  // The last assignment of a variable counts, and this one includes the former value.
  remedy += "echo " + shell_word("AMENT_PREFIX_PATH=" + all) +
            " | sudo tee -a /etc/default/agnocast-bridge && sudo systemctl restart " +
            (unit == facts.bridge_units.end() ? "'agnocast-bridge*'" : shell_word(unit->second));
  return ailment;
}

Ailments type_not_found(const Facts& facts) {
  Ailments found;
  for (const BridgeState& bridge : facts.bridges) {
    for (const BridgeLack& lack : bridge.unbridged) {
      // A refused type was found; no command fixes it.
      if (lack.why != "unknown_type" || lack.detail.starts_with(sentence_of(Errc::type_refused)))
        continue;
      found.push_back(with_remedy(
          facts, bridge, lack.type.substr(0, lack.type.find('/')),
          {escaped(lack.topic) + ": the bridge of domain " + std::to_string(bridge.domain) +
               " cannot find " + escaped(lack.type),
           {},
           lack.detail.empty() ? "it is in neither AMENT_PREFIX_PATH nor type_paths of the bridge"
                               : escaped(lack.detail)}));
    }
  }
  return found;
}

Ailments configuration(const Facts& facts) {
  Ailments found;
  for (const auto& [file, what] : facts.bridge_faults)
    found.push_back({what, {{"CONFIG", shell_word(file)}}});
  return found;
}
Ailments cyclonedds(const Facts& facts) {
  Ailments found;
  if (!facts.hidden_cyclonedds_file.empty()) {
    const std::string& file = facts.hidden_cyclonedds_file;
    const std::string place = "/etc/agnocast/cyclonedds.xml";
    found.push_back(
        {"CYCLONEDDS_URI of the units names " + escaped(file) + ", which the units cannot see",
         {{"URI", "sudo install -D -m 644 " + shell_word(file) + ' ' + place + " && sudo sed -i " +
                      shell_word("/^CYCLONEDDS_URI=/s|" + file + '|' + place + '|') +
                      " /etc/default/agnocast-bridge && sudo systemctl restart "
                      "'agnocast-bridge*'"}},
         "the units of the bridge have a private /tmp and /var/tmp (PrivateTmp=)"});
  }
  if (!facts.cyclonedds_fault.empty())
    found.push_back({facts.cyclonedds_fault,
                     {{"URI",
                       "agnocast-bridge --check-config  # then: unset CYCLONEDDS_URI, or "
                       "/etc/default/agnocast-bridge"}}});
  return found;
}

Ailments receive_buffer(const Facts& facts) {
  Ailments found;
  if (facts.receive_buffer_max == 0) return found;
  std::set<std::string> named;
  for (const BridgeState& bridge : facts.bridges) {
    for (const BridgeEndpoint& endpoint : bridge.endpoints) {
      if (endpoint.is_out || endpoint.messages == 0) continue;
      const std::uint64_t mean = endpoint.bytes / endpoint.messages;
      if (mean <= facts.receive_buffer_max / buffer_factor || !named.insert(endpoint.topic).second)
        continue;
      found.push_back({escaped(endpoint.topic) + " receives messages of " + bytes_for_people(mean) +
                       " from DDS, but a socket buffer is limited to " +
                       bytes_for_people(facts.receive_buffer_max)});
    }
  }
  return found;
}

using enum Check::Severity;
using enum Check::Needs;

// clang-format off
constexpr Check bridge_table[] = {
    {"bridge-configuration", "the configuration of the bridge is valid", failed, nothing,
     "the file was changed after the bridge read it, or prevents its start; the next start fails",
     "sudo \"${EDITOR:-vi}\" CONFIG && agnocast-bridge --check-config --config CONFIG", configuration},
    {"cyclonedds-uri", "Cyclone DDS accepts CYCLONEDDS_URI", failed, nothing,
     "the variable, or the file that it names, is not a valid configuration of Cyclone DDS: no process that uses it can join a domain",
     "URI", cyclonedds},
    {"bridge-not-running", "every bridge that should run is running", failed, nothing,
     "it has ended or cannot start, so topics do not reach DDS; its log gives the reason",
     "BRIDGE", not_running},
    {"bridge-elsewhere", "a bridge serves a domain that nodes of this host use", warning, daemon,
     "a bridge connects its DDS domain only with nodes of the same domain on this host",
     "BRIDGE", elsewhere},
    {"bridge-range", "bridges look for others as far as the nodes of this shell do", warning, nothing,
     "one of them uses the loopback device or this host only: the bridge and these nodes do not find each other in DDS",
     "RANGE", other_range},
    {"bridge-type", "bridges find the types of the topics and services on both sides", failed, nothing,
     "the library of the message package is neither below AMENT_PREFIX_PATH nor in type_paths of the bridge",
     "PATHS", type_not_found},
    {"receive-buffer", "socket buffers can hold the messages from DDS", warning, nothing,
     "the kernel drops fragments that do not fit: reliable messages are sent again, best-effort messages are lost",
     "echo 'net.core.rmem_max = 16777216' | sudo tee /etc/sysctl.d/60-agnocast-bridge.conf && sudo sysctl --load /etc/sysctl.d/60-agnocast-bridge.conf",
     receive_buffer},
};
// clang-format on

}  // namespace

const std::span<const Check> bridge_checks = bridge_table;

}  // namespace agnocast::ctl
