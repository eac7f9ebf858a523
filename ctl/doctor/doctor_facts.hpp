// SPDX-License-Identifier: Apache-2.0
//
// Facts: what doctor knows, collected once: from this shell, the socket, the daemon's answer, its regions,
// and /proc. What cannot be read (another user's process, no such file) is left empty, and checks say
// nothing of it.
#pragma once

#include <ctl/cli/arguments.hpp>
#include <ctl/doctor/doctor.hpp>
#include <ctl/snapshot/bridges.hpp>
#include <ctl/snapshot/pairs.hpp>
#include <ctl/snapshot/system.hpp>

#include <sys/types.h>

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

namespace agnocast::ctl {

/// The shell that runs us.
struct Shell {
  std::optional<std::string> socket, runtime_directory, domain, agnocast, preload;
  uid_t uid = 0;
  std::vector<gid_t> groups;
  std::string user;
  std::string confinement;  // its AppArmor profile or SELinux context; empty: none
};

/// The socket, and what stands at it.
struct Door {
  enum class Kind : std::uint8_t { nothing, socket, other };
  std::string path;
  bool is_systems = false;  // the place of the system's daemon
  Kind kind = Kind::nothing;
  bool is_mounted = false;  // the file by itself, not with its directory
  std::string closed;       // the first directory on the way that this user may not walk through
  mode_t mode = 0;
  gid_t gid = 0;
  std::string group;
  bool group_lists_user = false;  // in the database of groups, whatever this shell has
  int error = 0;                  // of connect; 0: somebody listens
  uid_t server = 0;               // who made it listen
  pid_t listener = 0;             // who began to listen; 0: nobody, or long ago
  bool listener_stopped = false;
};

/// A process, as /proc has it.
struct Running {
  struct Library {
    std::string path;
    bool is_replaced = false;  // the file is another one now, or none
  };
  pid_t pid = 0;
  std::string command;  // its command line, ready for a shell
  bool is_stopped = false;
  std::uint64_t map_count = 0;
  std::vector<Library> libraries;                               // ours: libagnocast*.so
  std::map<std::string, std::string, std::less<>> environment;  // what is about us
  std::optional<std::uint64_t> lock_limit, address_limit;       // nothing: unlimited, or unknown
  std::uint64_t locked_bytes = 0, address_bytes = 0;
  bool may_lock_all = false;
  std::string time_namespace;
};

/// A rule that refused somebody.
struct Rule {
  std::uint32_t line = 0;
  std::string pattern, principals;
};

struct Facts {
  Shell shell;
  Door door;
  std::optional<Problem> away;  // why there is no look
  std::optional<Look> look;
  std::string systems_socket;  // another daemon that serves the system; empty: none, or this one
  std::string users_socket;    // of this user's own directory, which the shell does not name

  // The daemon's process.
  Running daemon;
  pid_t supervisor = 0;  // whom to signal: the daemon itself when it has none
  bool program_replaced = false;
  std::uint64_t descriptors = 0, descriptor_limit = 0;
  std::string configuration;  // its path; empty: it reads none
  std::string configuration_fault;
  std::uint64_t restarts_lately = 0;

  std::string share;  // where profiles are installed
  // The host.
  std::string huge_pages;  // of shared memory: "never"
  std::uint64_t map_count_max = 0;
  std::uint64_t descriptors_max = 0;  // that any process may be allowed

  // Bridges to DDS.
  std::vector<BridgeState> bridges;
  std::vector<std::pair<std::string, std::uint64_t>> dead_bridges;  // sockets, and their domains
  std::vector<std::string> idle_bridge_units;                       // enabled, and none answers
  std::uint64_t unit_domain = 0;  // of agnocast-bridge.service
  std::string rival_bridge_unit;  // an instance of that domain, and both are enabled
  /// Of each bridge, by its pid: the unit that it is of, or the command line of one that is none's.
  std::map<std::uint64_t, std::string> bridge_units, bridge_commands;
  std::vector<std::pair<std::string, std::string>> bridge_faults;  // files, and what is wrong
  std::string cyclonedds_fault;        // of CYCLONEDDS_URI, this shell's or that of the units
  std::string hidden_cyclonedds_file;  // which that of the units names, and they do not see
  std::string prefix_path, units_prefix_path;  // AMENT_PREFIX_PATH of this shell, and of the units
  std::uint64_t receive_buffer_max = 0;

  std::map<pid_t, Running> members;  // by pid, as far as /proc shows them
  std::vector<Running> outsiders;    // have the library and mean this daemon, and are no members
  std::vector<std::optional<Rule>> rules;  // of system().refusals, each

  const System& system() const { return look->system; }
  /// Of all topics; pairs by topic.
  std::map<const Topic*, std::vector<Pair>> pairs;
  std::uint64_t now_ns = 0;

  /// START, ANEW, RELOAD, FILE.
  Fill common() const;
  /// A command: what is in force, with one key changed, becomes the configuration.
  std::string configure(const std::string& section, const std::string& key,
                        std::uint64_t value) const;
};

/// How far back "lately" is.
inline constexpr std::uint64_t lately_ns = 600'000'000'000;

Facts collect_facts(const Arguments& arguments);

}  // namespace agnocast::ctl
