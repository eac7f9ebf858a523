// SPDX-License-Identifier: Apache-2.0

#include <ctl/doctor/doctor_facts.hpp>

#include <base/clock.hpp>
#include <base/text/text.hpp>
#include <ctl/snapshot/numbers.hpp>
#include <journal/record.hpp>

#include <dirent.h>
#include <fcntl.h>
#include <grp.h>
#include <pwd.h>
#include <spawn.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <charconv>
#include <cstdlib>
#include <filesystem>
#include <sstream>
#include <string_view>
#include <system_error>

namespace agnocast::ctl {
namespace {

// Bound for files whose length others choose: environment and mappings of a process.
constexpr std::size_t file_bytes_max = std::size_t{4} << 20;
constexpr const char* usual_configuration = "/etc/agnocast/agnocastd.toml";
constexpr int cap_ipc_lock = 14;
// Enough to include the restarts of the last minutes, unless much has happened since.
constexpr std::uint64_t journal_records = 1024;

std::string contents_of(const std::string& path) {
  const UniqueFd file(::open(path.c_str(), O_RDONLY | O_CLOEXEC));
  std::string text;
  std::array<char, 16384> buffer;
  while (file && text.size() < file_bytes_max) {
    const ssize_t count = ::read(file.get(), buffer.data(), buffer.size());
    if (count < 0 && errno == EINTR) continue;
    if (count <= 0) break;
    text.append(buffer.data(), static_cast<std::size_t>(count));
  }
  return text;
}

std::string target_of(const std::string& link) {
  std::array<char, 4096> path;
  const ssize_t bytes = ::readlink(link.c_str(), path.data(), path.size());
  return bytes > 0 ? std::string(path.data(), static_cast<std::size_t>(bytes)) : std::string();
}

std::string of_process(pid_t pid, const char* what) {
  return "/proc/" + std::to_string(pid) + '/' + what;
}

std::optional<std::uint64_t> number_in(std::string_view text, int base = 10) {
  while (!text.empty() && (text.front() == ' ' || text.front() == '\t')) text.remove_prefix(1);
  std::uint64_t number = 0;
  const auto parsed = std::from_chars(text.data(), text.data() + text.size(), number, base);
  if (parsed.ec != std::errc()) return std::nullopt;
  return number;
}

/// Returns the rest of the first line that begins with `key`.
std::string_view line_after(std::string_view text, std::string_view key) {
  for (std::size_t at = 0; at < text.size();) {
    const std::size_t end = std::min(text.find('\n', at), text.size());
    const std::string_view line = text.substr(at, end - at);
    if (line.starts_with(key)) return line.substr(key.size());
    at = end + 1;
  }
  return {};
}

std::vector<std::string> split(const std::string& text, char mark) {
  std::vector<std::string> parts;
  std::istringstream in(text);
  for (std::string part; std::getline(in, part, mark);) parts.push_back(part);
  return parts;
}

std::string command_name(pid_t pid) {
  std::string name = contents_of(of_process(pid, "comm"));
  if (!name.empty()) name.pop_back();
  return name;
}
bool is_agnocastd(pid_t pid) { return pid > 0 && command_name(pid).starts_with("agnocastd"); }

// --- this shell

std::optional<std::string> variable(const char* name) {
  const char* const value = ::secure_getenv(name);
  if (value == nullptr || *value == '\0') return std::nullopt;
  return value;
}

/// Returns the AppArmor profile (without the mode behind it) or SELinux context; empty: none.
std::string confinement() {
  std::string name = contents_of("/proc/self/attr/apparmor/current");
  if (name.empty()) name = contents_of("/proc/self/attr/current");
  name.resize(std::min(name.find_first_of("\n\0", 0, 2), name.size()));
  if (name.ends_with(')')) name.resize(std::min(name.rfind(" ("), name.size()));
  return name == "unconfined" ? std::string() : name;
}

Shell look_at_shell() {
  Shell shell{variable("AGNOCAST_SOCKET"),
              variable("XDG_RUNTIME_DIR"),
              variable("ROS_DOMAIN_ID"),
              variable("AGNOCAST"),
              variable("LD_PRELOAD"),
              ::geteuid(),
              {},
              {},
              confinement()};
  std::array<gid_t, 1024> groups;
  const int count = ::getgroups(groups.size(), groups.data());
  for (int i = 0; i < count; ++i) shell.groups.push_back(groups[static_cast<std::size_t>(i)]);
  shell.groups.push_back(::getegid());
  const passwd* const user = ::getpwuid(shell.uid);
  shell.user = user == nullptr ? std::to_string(shell.uid) : user->pw_name;
  return shell;
}

// --- the socket

std::string first_closed(const std::string& path) {
  for (std::size_t at = path.find('/', 1); at != std::string::npos; at = path.find('/', at + 1)) {
    const std::string directory = path.substr(0, at);
    if (::faccessat(AT_FDCWD, directory.c_str(), X_OK, AT_EACCESS) != 0 && errno == EACCES)
      return directory;
  }
  return {};
}

template <class Use>
void for_each_entry(const std::string& directory, Use use) {
  DIR* const entries = ::opendir(directory.c_str());
  if (entries == nullptr) return;
  while (const dirent* const entry = ::readdir(entries)) {
    if (entry->d_name[0] != '.') use(std::string(entry->d_name));
  }
  ::closedir(entries);
}

pid_t parent_of(pid_t pid) {
  const std::string status = contents_of(of_process(pid, "status"));
  return static_cast<pid_t>(number_in(line_after(status, "PPid:")).value_or(0));
}

// Returns the holder of the lock beside the socket: the caller of listen() may have died since. 0:
// it cannot be seen. The keeper of the daemon's descriptors holds the lock as well.
pid_t daemon_of(const std::string& path) {
  const std::string lock = path + ".lock";
  pid_t found = 0;
  for_each_entry("/proc", [&](const std::string& name) {
    const pid_t pid = static_cast<pid_t>(number_in(name).value_or(0));
    if (pid == 0 || !is_agnocastd(pid)) return;
    const std::string descriptors = of_process(pid, "fd/");
    for_each_entry(descriptors, [&](const std::string& number) {
      if (target_of(descriptors + number) == lock && (found == 0 || parent_of(pid) == found))
        found = pid;
    });
  });
  return found;
}

bool is_mount_point(const std::string& path) {
  std::error_code unknown;
  const std::string real = std::filesystem::canonical(path, unknown).string();
  for (const std::string& line : split(contents_of("/proc/self/mountinfo"), '\n')) {
    const auto words = split(line, ' ');
    if (words.size() > 4 && words[4] == real) return true;
  }
  return false;
}

bool is_listener_stopped(const Door& door) {
  wire::DumpProcess process{};
  process.pid = static_cast<std::uint32_t>(std::max<pid_t>(door.listener, 0));
  return is_stopped(process);
}

Door look_at_door(const std::string& path, const Shell& shell) {
  Door door;
  door.path = path;
  door.is_systems = path == system_socket;
  door.closed = first_closed(path);
  struct stat file {};
  if (::stat(path.c_str(), &file) != 0) return door;
  door.kind = S_ISSOCK(file.st_mode) ? Door::Kind::socket : Door::Kind::other;
  door.mode = file.st_mode & 07777;
  door.is_mounted = is_mount_point(path);
  door.gid = file.st_gid;
  door.group = std::to_string(file.st_gid);
  if (const group* const group = ::getgrgid(file.st_gid); group != nullptr) {
    door.group = group->gr_name;
    for (char** member = group->gr_mem; *member != nullptr; ++member)
      door.group_lists_user = door.group_lists_user || shell.user == *member;
  }
  if (door.kind != Door::Kind::socket) return door;
  auto socket = PacketSocket::connect(path, std::chrono::milliseconds(200));
  if (!socket) {
    door.error = socket.error().os_errno != 0 ? socket.error().os_errno : EIO;
  } else {
    ucred who{};
    socklen_t bytes = sizeof who;
    if (::getsockopt(socket->fd(), SOL_SOCKET, SO_PEERCRED, &who, &bytes) == 0) {
      door.listener = who.pid;
      door.server = who.uid;
    }
  }
  if (const pid_t daemon = daemon_of(path); daemon != 0) door.listener = daemon;
  door.listener_stopped = is_listener_stopped(door);
  return door;
}

// --- processes

std::optional<std::uint64_t> limit_in(std::string_view limits, std::string_view name) {
  return number_in(line_after(limits, name));  // "unlimited" is no number
}

void read_environment(Running& running) {
  for (const std::string& entry : split(contents_of(of_process(running.pid, "environ")), '\0')) {
    const std::size_t equals = entry.find('=');
    const std::string name = entry.substr(0, equals);
    if (equals != std::string::npos && (name.starts_with("AGNOCAST") || name == "LD_PRELOAD" ||
                                        name == "ROS_DOMAIN_ID" || name == "XDG_RUNTIME_DIR"))
      running.environment[name] = entry.substr(equals + 1);
  }
}

void read_maps(Running& running) {
  const std::string maps = contents_of(of_process(running.pid, "maps"));
  running.map_count = static_cast<std::uint64_t>(std::count(maps.begin(), maps.end(), '\n'));
  constexpr std::string_view deleted = " (deleted)";
  for (std::size_t at = 0; (at = maps.find("/libagnocast", at)) != std::string::npos;) {
    const std::size_t end = std::min(maps.find('\n', at), maps.size());
    const std::size_t line = maps.rfind('\n', at) + 1;  // npos + 1 is 0
    std::string path = maps.substr(maps.find('/', line), end - maps.find('/', line));
    const bool is_replaced = path.ends_with(deleted);
    if (is_replaced) path.resize(path.size() - deleted.size());
    const auto same = [&](const Running::Library& library) { return library.path == path; };
    if (std::none_of(running.libraries.begin(), running.libraries.end(), same))
      running.libraries.push_back({path, is_replaced});
    at = end;
  }
}

Running look_at_process(pid_t pid) {
  Running running;
  running.pid = pid;
  wire::DumpProcess named{};
  named.pid = static_cast<std::uint32_t>(pid);
  running.is_stopped = is_stopped(named);
  for (const std::string& word : split(contents_of(of_process(pid, "cmdline")), '\0'))
    running.command += (running.command.empty() ? "" : " ") + shell_word(word);
  running.time_namespace = target_of(of_process(pid, "ns/time"));
  read_environment(running);
  read_maps(running);
  const std::string status = contents_of(of_process(pid, "status"));
  running.locked_bytes = number_in(line_after(status, "VmLck:")).value_or(0) * 1024;
  running.address_bytes = number_in(line_after(status, "VmSize:")).value_or(0) * 1024;
  std::string_view effective = line_after(status, "CapEff:");
  running.may_lock_all = (number_in(effective, 16).value_or(0) >> cap_ipc_lock & 1) != 0;
  const std::string limits = contents_of(of_process(pid, "limits"));
  running.lock_limit = limit_in(limits, "Max locked memory");
  running.address_limit = limit_in(limits, "Max address space");
  return running;
}

/// Returns whether the pid names the daemon's process here: not if it is in another PID namespace.
bool is_same_process(const wire::DumpProcess& facts) {
  const std::string status = contents_of(of_process(static_cast<pid_t>(facts.pid), "status"));
  // Real, effective, saved: the daemon received one of them when the process connected.
  std::istringstream uids{std::string(line_after(status, "Uid:"))};
  for (std::uint64_t uid = 0; facts.pid != 0 && uids >> uid;) {
    if (uid == facts.uid) return true;
  }
  return false;
}

bool means(const Running& running, const Facts& facts, bool is_named) {
  const auto& of = running.environment;
  if (const auto socket = of.find("AGNOCAST_SOCKET"); socket != of.end())
    return socket->second == facts.door.path;
  if (is_named) return false;
  const auto directory = of.find("XDG_RUNTIME_DIR");
  return facts.door.is_systems ||
         (directory != of.end() && directory->second + user_socket == facts.door.path);
}

void collect_processes(Facts& facts, bool is_named) {
  for (const auto& [index, process] : facts.system().processes) {
    const pid_t pid = static_cast<pid_t>(process.facts.pid);
    if (process.facts.state != wire::ProcessState::dead && is_same_process(process.facts))
      facts.processes.try_emplace(pid, look_at_process(pid));
  }
  for_each_entry("/proc", [&](const std::string& name) {
    const pid_t pid = static_cast<pid_t>(number_in(name).value_or(0));
    if (pid == 0 || pid == ::getpid() || facts.processes.count(pid) != 0) return;
    Running outsider;
    outsider.pid = pid;
    read_environment(outsider);
    if (!means(outsider, facts, is_named)) return;
    read_maps(outsider);
    if (!outsider.libraries.empty()) facts.outsiders.push_back(look_at_process(pid));
  });
}

// --- the daemon's process

/// Returns the path that a process was given with --config; empty: none.
std::string named_configuration_of(pid_t pid) {
  const auto words = split(contents_of(of_process(pid, "cmdline")), '\0');
  for (std::size_t i = 0; i < words.size(); ++i) {
    std::string path;
    if (words[i].starts_with("--config=")) path = words[i].substr(9);
    if (words[i] == "--config" && i + 1 < words.size()) path = words[i + 1];
    if (path.empty()) continue;
    return path.front() == '/' ? path : target_of(of_process(pid, "cwd")) + '/' + path;
  }
  return {};
}
std::string configuration_of(pid_t pid) {
  if (std::string named = named_configuration_of(pid); !named.empty()) return named;
  return ::access(usual_configuration, F_OK) == 0 ? usual_configuration : "";
}

/// Returns what a program prints to stderr when it fails; empty: it succeeds or does not exist.
std::string complaint_of(std::vector<std::string> words) {
  int ends[2];
  if (::pipe2(ends, O_CLOEXEC) != 0) return {};
  UniqueFd read(ends[0]), write(ends[1]);
  posix_spawn_file_actions_t actions;
  ::posix_spawn_file_actions_init(&actions);
  ::posix_spawn_file_actions_addopen(&actions, STDOUT_FILENO, "/dev/null", O_WRONLY, 0);
  ::posix_spawn_file_actions_adddup2(&actions, write.get(), STDERR_FILENO);
  std::vector<char*> argv;
  for (std::string& word : words) argv.push_back(word.data());
  argv.push_back(nullptr);
  pid_t pid = 0;
  const int error = ::posix_spawnp(&pid, argv[0], &actions, nullptr, argv.data(), environ);
  ::posix_spawn_file_actions_destroy(&actions);
  write.reset();
  if (error != 0) return {};
  std::string said = contents_of("/dev/fd/" + std::to_string(read.get()));
  int status = 0;
  while (::waitpid(pid, &status, 0) < 0 && errno == EINTR) {
  }
  if (!WIFEXITED(status) || WEXITSTATUS(status) == 0) return {};
  return said;
}

/// Returns the error of `agnocastd --check-config`; empty: none, or no such program here.
std::string fault_in(const std::string& configuration) {
  if (configuration.empty() || ::access(configuration.c_str(), R_OK) != 0) return {};
  const std::string said = complaint_of({"agnocastd", "--check-config", "--config", configuration});
  return escaped(said.substr(0, said.find('\n')));
}

void collect_daemon(Facts& facts) {
  pid_t pid = facts.door.listener;
  if (facts.look) pid = static_cast<pid_t>(facts.system().daemon.pid);
  facts.configuration = configuration_of(pid);
  if (!is_agnocastd(pid)) return;
  facts.daemon = look_at_process(pid);
  facts.supervisor = is_agnocastd(parent_of(pid)) ? parent_of(pid) : pid;
  facts.program_replaced = target_of(of_process(pid, "exe")).ends_with(" (deleted)");
  facts.descriptor_limit =
      limit_in(contents_of(of_process(pid, "limits")), "Max open files").value_or(0);
  for_each_entry(of_process(pid, "fd"), [&](const std::string&) { ++facts.descriptors; });
}

// --- the bridges

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

void collect_running_bridges(Facts& facts) {
  for (const BridgeState& bridge : facts.bridges) {
    const auto pid = static_cast<pid_t>(bridge.pid);
    if (command_name(pid) != "agnocast-bridge") continue;
    if (std::string unit = unit_of(pid); !unit.empty()) {
      facts.bridge_units[bridge.pid] = std::move(unit);
    } else {
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

void collect_bridges(const Arguments& arguments, Facts& facts) {
  const std::string prefix = "bridge-", suffix = ".sock";
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
  const auto answers_for = [&](std::uint64_t domain) {
    return std::any_of(facts.bridges.begin(), facts.bridges.end(),
                       [&](const BridgeState& bridge) { return bridge.domain == domain; });
  };
  facts.unit_domain = domain_of_unit();
  const auto is_installed = [](const std::string& name) {
    return ::access((enabled_units + name).c_str(), F_OK) == 0;
  };
  std::size_t instances = 0;
  bool has_unit = false;
  std::string rival;
  if (facts.door.is_systems) {
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
  }
  if (has_unit && !rival.empty()) {
    facts.rival_bridge_unit = rival;
    std::erase(facts.idle_bridge_units, rival);
  } else if (has_unit && !answers_for(facts.unit_domain) && facts.bridges.size() <= instances) {
    // A drop-in may have given it another domain: one that no instance serves.
    facts.idle_bridge_units.emplace_back("agnocast-bridge.service");
  }
  collect_running_bridges(facts);
  facts.prefix_path = variable("AMENT_PREFIX_PATH").value_or("");
  facts.receive_buffer_max = number_in(contents_of("/proc/sys/net/core/rmem_max")).value_or(0);

  std::vector<std::string> check{"env"};
  if (facts.door.is_systems) {
    facts.units_prefix_path = default_of("AMENT_PREFIX_PATH");
    const std::string uri = default_of("CYCLONEDDS_URI");
    facts.hidden_cyclonedds_file = hidden_file_in(uri);
    if (!uri.empty()) check.push_back("CYCLONEDDS_URI=" + uri);
  }
  check.insert(check.end(), {"agnocast-bridge", "--check-config"});
  // The files of running bridges, and those that a bridge of any domain would read if started now.
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
  for (const std::string& file : files) {
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

// --- what the daemon says

void collect_look(const Arguments& arguments, Facts& facts) {
  if (facts.door.listener_stopped) {
    facts.away = Problem{Status::not_reachable, {}, {}, {}, Errc::daemon_not_running};
    return;
  }
  auto look = look_at(arguments.socket);
  if (!look) {
    facts.away = look.error();
    // It may have been stopped just now, and not answer for that reason.
    facts.door.listener_stopped = is_listener_stopped(facts.door);
    return;
  }
  facts.look = std::move(*look);
  const System& system = facts.system();
  facts.now_ns = monotonic_ns();
  for (const auto& [index, topic] : system.topics) facts.pairs[&topic] = pairs_of(system, topic);
  for (const wire::DumpRefusal& refusal : system.refusals) {
    std::optional<Rule>& rule = facts.rules.emplace_back();
    if (static_cast<Errc>(refusal.code) != Errc::access_denied) continue;
    const auto access = facts.look->observer.access(refusal.domain, text_of(refusal.topic));
    if (!access) continue;
    const wire::AccessIs& is =
        refusal.kind == wire::Kind::publisher ? access->publish : access->subscribe;
    if (is.line != 0) rule = Rule{is.line, text_of(is.pattern), is.principals};
  }
  if (system.daemon.counters.restarts == 0) return;
  const auto journal = facts.look->observer.read_journal(0, journal_records);
  if (!journal) return;
  for (const wire::JournalRecord& record : journal->records) {
    if (static_cast<journal::RecordType>(record.type) == journal::RecordType::recovered &&
        record.stamp_ns + lately_ns > journal->end.now_ns)
      ++facts.restarts_lately;
  }
}

bool answers(const std::string& path) {
  return path.size() <= 107 && PacketSocket::connect(path, std::chrono::milliseconds(200));
}

}  // namespace

std::string Facts::configure(const std::string& section, const std::string& key,
                             std::uint64_t value) const {
  const std::string file = shell_word(configuration.empty() ? usual_configuration : configuration);
  // If agnocastd is not found here or may not read the file, NEW is empty and nothing is written.
  return "NEW=\"$(agnocastd --print-config" + (configuration.empty() ? "" : " --config " + file) +
         " | sed '/^\\[" + section + "\\]/,/^\\[/s/^" + key + " = .*/" + key + " = " +
         std::to_string(value) + "/')\" && [ -n \"$NEW\" ] && printf '%s\\n' \"$NEW\" | sudo tee " +
         file + " > /dev/null";
}

Fill Facts::common() const {
  const std::string path = shell_word(door.path);
  const std::string config = configuration.empty() ? usual_configuration : configuration;
  const bool needs_config = !configuration.empty() && configuration != usual_configuration;
  Fill words{{"FILE", shell_word(config)}};
  if (door.is_systems) {
    words["START"] = "sudo systemctl start agnocastd";
    words["ANEW"] = "sudo systemctl stop agnocastd && sudo systemctl start agnocastd";
    words["RELOAD"] = "sudo systemctl restart agnocastd";
    return words;
  }
  words["START"] = "agnocastd --socket " + path +
                   (needs_config ? " --config " + shell_word(configuration) : "") + " &";
  if (supervisor > 0) {
    const std::string pid = std::to_string(supervisor);
    // The lock is free once the daemon has ended.
    words["ANEW"] = "kill " + pid + " && flock " + shell_word(door.path + ".lock") + " true && " +
                    words["START"];
    words["RELOAD"] = "kill -HUP " + pid;
  } else {
    // Another user's daemon: its pid cannot be seen from here.
    words["ANEW"] = words["RELOAD"] = "sudo agnocast-ctl doctor --socket " + path;
  }
  return words;
}

Facts collect_facts(const Arguments& arguments) {
  Facts facts;
  facts.shell = look_at_shell();
  facts.door = look_at_door(arguments.socket, facts.shell);
  std::error_code unknown;
  facts.share = (std::filesystem::read_symlink("/proc/self/exe", unknown).parent_path() /
                 AGNOCAST_SHARE_FROM_BIN)
                    .lexically_normal()
                    .string();
  const bool is_named = facts.shell.socket || arguments.has(options::socket);
  collect_look(arguments, facts);
  collect_daemon(facts);
  if (facts.look) collect_processes(facts, is_named);
  collect_bridges(arguments, facts);
  facts.configuration_fault = fault_in(facts.configuration);
  if (facts.shell.socket && !facts.door.is_systems && answers(system_socket))
    facts.systems_socket = system_socket;
  if (!is_named && !facts.shell.runtime_directory && facts.door.kind == Door::Kind::nothing) {
    const std::string directory = "/run/user/" + std::to_string(facts.shell.uid);
    if (answers(directory + user_socket)) facts.users_socket = directory;
  }
  const std::string huge = contents_of("/sys/kernel/mm/transparent_hugepage/shmem_enabled");
  if (const std::size_t at = huge.find('['); at != std::string::npos)
    facts.huge_pages = huge.substr(at + 1, huge.find(']') - at - 1);
  facts.descriptors_max = number_in(contents_of("/proc/sys/fs/nr_open")).value_or(0);
  facts.map_count_max = number_in(contents_of("/proc/sys/vm/max_map_count")).value_or(0);
  return facts;
}

}  // namespace agnocast::ctl
