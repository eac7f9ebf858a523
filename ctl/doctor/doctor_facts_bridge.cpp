// SPDX-License-Identifier: Apache-2.0
//
// What the doctor collects about bridges: those that run, units, configurations.

#include <base/text/text.hpp>
#include <ctl/doctor/doctor_facts.hpp>
#include <ctl/doctor/machine_files.hpp>

#include <unistd.h>

#include <algorithm>
#include <cstdlib>
#include <string_view>

namespace agnocast::ctl {
namespace {

constexpr const char* bridge_configurations = "/etc/agnocast/";
constexpr const char* bridge_configuration = "/etc/agnocast/bridge.toml";
constexpr const char* bridge_defaults = "/etc/default/agnocast-bridge";
constexpr const char* enabled_units = "/etc/systemd/system/multi-user.target.wants/";

/// Returns a variable's value in the file that the units read; the last assignment counts.
std::string default_of(const char* variable) {
  std::string value;
  const std::string key = std::string(variable) + '=';
  for (const std::string& line : split(contents_of(bridge_defaults), '\n'))
    if (line.starts_with(key)) value = line.substr(key.size());
  if (value.size() > 1 && (value.front() == '\'' || value.front() == '"') &&
      value.back() == value.front())
    value = value.substr(1, value.size() - 2);
  return value;
}

/// Returns the domain that agnocast-bridge.service serves.
std::uint64_t domain_of_unit() {
  const std::string text = contents_of(bridge_configuration);
  std::string_view written =
      line_after(std::string_view(text).substr(0, text.find("\n[")), "domain");
  written.remove_prefix(std::min(written.find_first_not_of(" =\t"), written.size()));
  if (const auto domain = number_in(written)) return *domain;
  return number_in(default_of("ROS_DOMAIN_ID")).value_or(0);
}

/// Returns the unit of a bridge, by the name of its cgroup; empty: it has none.
std::string unit_of(pid_t pid) {
  std::string path = contents_of(of_process(pid, "cgroup"));
  path.resize(std::min(path.find('\n'), path.size()));
  std::string unit = path.substr(path.rfind('/') + 1);
  return unit.starts_with("agnocast-bridge") && unit.ends_with(".service") ? unit : std::string();
}

/// Returns the variable that limits how far ROS 2 looks for others, "NAME=value", in the form that
/// means the same in every distribution (bridge/dds/discovery_range.hpp); empty: none does.
template <class Variable>
std::string discovery_range(const Variable& variable) {
  const std::string distribution = variable("ROS_DISTRO");
  std::string range = variable("ROS_AUTOMATIC_DISCOVERY_RANGE");
  if (variable("ROS_LOCALHOST_ONLY") == "1") {
    if (distribution.empty() || distribution <= "humble") return "ROS_LOCALHOST_ONLY=1";
    range = "LOCALHOST";
  }
  const bool is_limited = !range.empty() && range != "SUBNET" && range != "SYSTEM_DEFAULT";
  return is_limited ? "ROS_AUTOMATIC_DISCOVERY_RANGE=" + range : "";
}
std::string shells_variable(const char* name) {
  const char* const value = ::secure_getenv(name);
  return value != nullptr ? value : "";
}
/// Returns a variable with which the process was started.
std::string variable_of(const std::string& environment, const char* name) {
  const std::string key = std::string(name) + '=';
  for (const std::string& one : split(environment, '\0'))
    if (one.starts_with(key)) return one.substr(key.size());
  return {};
}

void collect_running_bridges(Facts& facts) {
  for (const char* const name : {"ROS_LOCALHOST_ONLY", "ROS_AUTOMATIC_DISCOVERY_RANGE"})
    facts.shell_has_range |= !shells_variable(name).empty();
  facts.shell_range = discovery_range(shells_variable);
  for (const BridgeState& bridge : facts.bridges) {
    const auto pid = static_cast<pid_t>(bridge.pid);
    if (command_name(pid) != "agnocast-bridge") continue;
    if (std::string unit = unit_of(pid); !unit.empty()) {
      facts.bridge_units[bridge.pid] = std::move(unit);
      facts.bridge_ranges[bridge.pid] = discovery_range(default_of);
    } else {
      // Readable for its own user.
      if (const std::string all = contents_of(of_process(pid, "environ")); !all.empty())
        facts.bridge_ranges[bridge.pid] =
            discovery_range([&](const char* name) { return variable_of(all, name); });
      facts.bridge_commands[bridge.pid] = look_at_process(pid).command;
    }
  }
}

/// Returns the file in /tmp that CYCLONEDDS_URI names: units have a private /tmp.
std::string hidden_file_in(const std::string& uri) {
  for (std::string word : split(uri, ',')) {
    if (word.starts_with("file://")) word.erase(0, 7);
    if (word.starts_with("/tmp/") || word.starts_with("/var/tmp/")) return word;
  }
  return {};
}

/// Finds the bridges that answer, and the sockets of those that ended without removing them.
void collect_sockets(const Arguments& arguments, Facts& facts) {
  const std::string prefix = "bridge-";
  for (const std::string& path : bridge_sockets(arguments.socket)) {
    auto bridge = read_bridge(path);
    if (bridge) {
      facts.bridges.push_back(std::move(*bridge));
    } else if (bridge.error().status == Status::not_reachable) {
      const std::string name = path.substr(path.rfind('/') + 1);
      if (!name.starts_with(prefix)) continue;
      if (const auto domain = number_in(std::string_view(name).substr(prefix.size())))
        facts.dead_bridges.emplace_back(path, *domain);
    }
  }
}

/// Finds enabled units without a bridge, and an instance for the domain of the unit itself.
void collect_units(Facts& facts) {
  const auto answers_for = [&](std::uint64_t domain) {
    return std::any_of(facts.bridges.begin(), facts.bridges.end(),
                       [&](const BridgeState& bridge) { return bridge.domain == domain; });
  };
  const auto is_installed = [](const std::string& name) {
    return ::access((enabled_units + name).c_str(), F_OK) == 0;
  };
  facts.unit_domain = domain_of_unit();
  if (!facts.door.is_systems) return;
  std::size_t instances = 0;
  bool has_unit = false;
  std::string rival;
  for_each_entry(enabled_units, [&](const std::string& name) {
    const std::string_view instance = "agnocast-bridge@";
    has_unit |= name == "agnocast-bridge.service" && is_installed(name);
    // A unit that is enabled but no longer installed leaves its link.
    if (!name.starts_with(instance) || !is_installed(name)) return;
    const auto domain = number_in(std::string_view(name).substr(instance.size()));
    if (domain == facts.unit_domain) rival = name;
    if (domain && answers_for(*domain)) {
      ++instances;
    } else {
      facts.idle_bridge_units.push_back(name);
    }
  });
  if (has_unit && !rival.empty()) {
    facts.rival_bridge_unit = rival;
    std::erase(facts.idle_bridge_units, rival);
  } else if (has_unit && !answers_for(facts.unit_domain) && facts.bridges.size() <= instances) {
    // A drop-in may have given it another domain: one that no instance serves.
    facts.idle_bridge_units.emplace_back("agnocast-bridge.service");
  }
}

/// Returns the configuration files of running bridges, and those that a bridge of any domain would
/// read if started now; the empty one stands for the default.
std::vector<std::string> configurations(const Facts& facts) {
  std::vector<std::string> files{""};
  for_each_entry(bridge_configurations, [&](const std::string& name) {
    if (name.starts_with("bridge-") && name.ends_with(".toml"))
      files.push_back(bridge_configurations + name);
  });
  for (const BridgeState& bridge : facts.bridges) {
    std::string file = named_configuration_of(static_cast<pid_t>(bridge.pid));
    if (!file.empty() && std::find(files.begin(), files.end(), file) == files.end())
      files.push_back(std::move(file));
  }
  return files;
}

/// Asks `agnocast-bridge --check-config` about each configuration, with the units' CYCLONEDDS_URI.
void collect_faults(Facts& facts) {
  std::vector<std::string> check{"env"};
  if (facts.door.is_systems) {
    facts.units_prefix_path = default_of("AMENT_PREFIX_PATH");
    const std::string uri = default_of("CYCLONEDDS_URI");
    facts.hidden_cyclonedds_file = hidden_file_in(uri);
    if (!uri.empty()) check.push_back("CYCLONEDDS_URI=" + uri);
  }
  check.insert(check.end(), {"agnocast-bridge", "--check-config"});
  for (const std::string& file : configurations(facts)) {
    std::vector<std::string> words = check;
    if (!file.empty()) words.insert(words.end(), {"--config", file});
    for (const std::string& line : split(complaint_of(std::move(words)), '\n')) {
      const std::string_view own = "agnocast-bridge: ";
      if (!line.starts_with(own)) continue;
      const std::string what = escaped(std::string_view(line).substr(own.size()));
      if (what.starts_with("CYCLONEDDS_URI")) {
        facts.cyclonedds_fault = what;
      } else if (!what.starts_with("ROS_DOMAIN_ID")) {
        facts.bridge_faults.emplace_back(file.empty() ? bridge_configuration : file, what);
      }
    }
  }
}

}  // namespace

void collect_bridges(const Arguments& arguments, Facts& facts) {
  collect_sockets(arguments, facts);
  collect_units(facts);
  collect_running_bridges(facts);
  facts.prefix_path = variable("AMENT_PREFIX_PATH").value_or("");
  facts.receive_buffer_max = number_in(contents_of("/proc/sys/net/core/rmem_max")).value_or(0);
  collect_faults(facts);
}

}  // namespace agnocast::ctl
