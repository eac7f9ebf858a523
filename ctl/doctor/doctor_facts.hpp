// SPDX-License-Identifier: Apache-2.0
//
// Facts: what doctor knows, collected once from this shell, the socket, the daemon's answer, its
// regions, and /proc. Facts that cannot be read (another user's process, a missing file) stay
// empty, and checks report nothing about them.
#pragma once

#include <ctl/cli/arguments.hpp>
#include <ctl/doctor/doctor.hpp>
#include <ctl/snapshot/bridges.hpp>
#include <ctl/snapshot/pairs.hpp>
#include <ctl/snapshot/system.hpp>
#include <ctl/snapshot/threads.hpp>

#include <sys/types.h>

#include <cstdint>
#include <limits>
#include <map>
#include <optional>
#include <string>
#include <vector>

namespace agnocast::ctl {

/// The shell that runs agnocast-ctl.
struct Shell {
  std::optional<std::string> socket, runtime_directory, domain, agnocast, preload;
  uid_t uid = 0;
  std::vector<gid_t> groups;
  std::string user;
  std::string confinement;  // its AppArmor profile or SELinux context; empty: none
};

/// The path of the socket, and the file at it.
struct Door {
  enum class Kind : std::uint8_t { nothing, socket, other };
  std::string path;
  bool is_systems = false;  // the path of the system's daemon
  Kind kind = Kind::nothing;
  bool is_mounted = false;  // the file without its directory
  std::string closed;       // the first directory on the path that this user may not enter
  mode_t mode = 0;
  gid_t gid = 0;
  std::string group;
  bool group_lists_user = false;  // in the group database, if not in this shell
  int error = 0;                  // errno of connect(); 0: somebody listens
  uid_t server = 0;               // the user that called listen()
  pid_t listener = 0;             // the daemon, else the caller of listen(); 0: unknown
  bool listener_stopped = false;
};

/// A process, as /proc shows it.
struct Running {
  struct Library {
    std::string path;
    bool is_replaced = false;  // the file was replaced or removed since
  };
  pid_t pid = 0;
  std::string command;  // its command line, quoted for a shell
  bool is_stopped = false;
  std::uint64_t map_count = 0;
  std::vector<Library> libraries;                               // ours: libagnocast*.so
  std::map<std::string, std::string, std::less<>> environment;  // variables of interest
  std::optional<std::uint64_t> lock_limit, address_limit;       // nothing: unlimited, or unknown
  std::uint64_t locked_bytes = 0, address_bytes = 0;
  bool may_lock_all = false;      // it has CAP_IPC_LOCK
  bool may_schedule_all = false;  // it has CAP_SYS_NICE
  std::string time_namespace;
};

/// The access rule behind a refusal.
struct Rule {
  std::uint32_t line = 0;
  std::string pattern, principals;
};

struct Facts {
  Shell shell;
  Door door;
  std::optional<Problem> away;  // why the daemon gave no answer
  std::optional<Look> look;
  std::string systems_socket;  // of the system's daemon; empty: none, or the same
  std::string users_socket;    // directory of this user's daemon, unknown to the shell

  // The daemon's process.
  Running daemon;
  pid_t supervisor = 0;  // the process to signal: the daemon itself if it has none
  bool program_replaced = false;
  std::uint64_t descriptors = 0, descriptor_limit = 0;
  std::string configuration;  // its path; empty: it reads none
  std::string configuration_fault;
  std::uint64_t restarts_lately = 0;

  std::string share;  // the directory of the security profiles
  // The host.
  std::string huge_pages;  // shmem_enabled: "never"
  std::uint64_t map_count_max = 0;
  std::uint64_t descriptors_max = 0;  // the highest limit for any process

  // Bridges to DDS.
  std::vector<BridgeState> bridges;
  std::vector<std::pair<std::string, std::uint64_t>> dead_bridges;  // sockets, with domains
  std::vector<std::string> idle_bridge_units;                       // enabled, without an answer
  std::uint64_t unit_domain = 0;                                    // of agnocast-bridge.service
  std::string rival_bridge_unit;  // an enabled instance of the same domain
  /// For each bridge, by its pid: its unit, or its command line if it has none.
  std::map<std::uint64_t, std::string> bridge_units, bridge_commands;
  /// How far bridges look for others, by their pids, and nodes of this shell: the variable with its
  /// value. Empty: as by default.
  std::map<std::uint64_t, std::string> bridge_ranges;
  std::string shell_range;
  bool shell_has_range = false;                                    // it sets one of the variables
  std::vector<std::pair<std::string, std::string>> bridge_faults;  // files and their mistakes
  std::string cyclonedds_fault;                // in CYCLONEDDS_URI of this shell or of the units
  std::string hidden_cyclonedds_file;          // a file that the units name and cannot see
  std::string prefix_path, units_prefix_path;  // AMENT_PREFIX_PATH of this shell and of the units
  std::uint64_t receive_buffer_max = 0;

  std::map<pid_t, Running> processes;      // by pid, as far as /proc shows them
  std::vector<Running> outsiders;          // processes of this daemon without a session
  std::vector<std::optional<Rule>> rules;  // one for each of system().refusals

  const System& system() const { return look->system; }
  /// The pairs of each topic.
  std::map<const Topic*, std::vector<Pair>> pairs;
  std::vector<CallbackThread> threads;  // that run callbacks, of all domains
  std::uint64_t now_ns = 0;

  /// Returns the values of START, ANEW, RELOAD and FILE.
  Fill common() const;
  /// Returns a command that writes the configuration: the settings in force with one key changed.
  std::string configure(const std::string& section, const std::string& key,
                        std::uint64_t value) const;
  /// The same with one more wide topic, whose name is one of a topic.
  std::string make_wide(const std::string& topic) const;
};

/// A limit or quota that limits nothing.
inline constexpr std::uint64_t unlimited = std::numeric_limits<std::uint64_t>::max();

/// The interval that "lately" means: ten minutes.
inline constexpr std::uint64_t lately_ns = 600'000'000'000;

Facts collect_facts(const Arguments& arguments);

// --- parts of it

/// Returns what /proc says of a process.
Running look_at_process(pid_t pid);
/// Collects running bridges, their units and their configurations (doctor_facts_bridge.cpp).
void collect_bridges(const Arguments& arguments, Facts& facts);

}  // namespace agnocast::ctl
