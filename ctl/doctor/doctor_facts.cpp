// SPDX-License-Identifier: Apache-2.0

#include <ctl/doctor/doctor_facts.hpp>

#include <base/clock.hpp>
#include <base/text/text.hpp>
#include <ctl/doctor/machine_files.hpp>
#include <ctl/snapshot/numbers.hpp>
#include <journal/record.hpp>

#include <dirent.h>
#include <fcntl.h>
#include <grp.h>
#include <pwd.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <filesystem>
#include <string_view>
#include <system_error>

namespace agnocast::ctl {
namespace {

constexpr const char* usual_configuration = "/etc/agnocast/agnocastd.toml";
constexpr int cap_ipc_lock = 14, cap_sys_nice = 23;
// Enough to include the restarts of the last minutes, unless much has happened since.
constexpr std::uint64_t journal_records = 1024;

bool is_agnocastd(pid_t pid) { return pid > 0 && command_name(pid).starts_with("agnocastd"); }

// --- this shell

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
    std::string directory = path.substr(0, at);
    if (::faccessat(AT_FDCWD, directory.c_str(), X_OK, AT_EACCESS) != 0 && errno == EACCES)
      return directory;
  }
  return {};
}

pid_t parent_of(pid_t pid) {
  const std::string status = contents_of(of_process(pid, "status"));
  return static_cast<pid_t>(number_in(line_after(status, "PPid:")).value_or(0));
}

/// Device and inode of a file; nothing if there is none. Asks no server of a file system, which a
/// descriptor of another process may lead to (statx(2), AT_STATX_DONT_SYNC).
std::optional<std::array<std::uint64_t, 3>> identity_of(const std::string& path) {
  struct statx file {};
  if (::statx(AT_FDCWD, path.c_str(), AT_STATX_DONT_SYNC, STATX_INO, &file) != 0)
    return std::nullopt;
  return std::array<std::uint64_t, 3>{file.stx_dev_major, file.stx_dev_minor, file.stx_ino};
}

// Returns the holder of the lock beside the socket: the caller of listen() may have died since. 0:
// it cannot be seen. The keeper of the daemon's descriptors holds the lock as well. Daemons in
// containers have other files of the same name.
pid_t daemon_of(const std::string& path) {
  const std::string lock = path + ".lock";
  const std::string name_of_lock = lock.substr(lock.rfind('/') + 1);
  const auto wanted = identity_of(lock);
  pid_t found = 0;
  if (!wanted) return found;
  for_each_entry("/proc", [&](const std::string& name) {
    const pid_t pid = static_cast<pid_t>(number_in(name).value_or(0));
    if (pid == 0 || !is_agnocastd(pid)) return;
    const std::string descriptors = of_process(pid, "fd/");
    for_each_entry(descriptors, [&](const std::string& number) {
      const std::string descriptor = descriptors + number;
      if (target_of(descriptor).ends_with(name_of_lock) && identity_of(descriptor) == wanted &&
          (found == 0 || parent_of(pid) == found))
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

}  // namespace

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
  const std::uint64_t capabilities = number_in(line_after(status, "CapEff:"), 16).value_or(0);
  running.may_lock_all = (capabilities >> cap_ipc_lock & 1) != 0;
  running.may_schedule_all = (capabilities >> cap_sys_nice & 1) != 0;
  const std::string limits = contents_of(of_process(pid, "limits"));
  running.lock_limit = limit_in(limits, "Max locked memory");
  running.address_limit = limit_in(limits, "Max address space");
  return running;
}

namespace {

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
    if (process.facts.state != wire::ProcessState::dead && is_visible(process.facts))
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

std::string configuration_of(pid_t pid) {
  if (std::string named = named_configuration_of(pid); !named.empty()) return named;
  return ::access(usual_configuration, F_OK) == 0 ? usual_configuration : "";
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

// --- what the daemon says

void collect_look(const Arguments& arguments, Facts& facts) {
  if (facts.door.listener_stopped) {
    facts.away = Problem{Status::not_reachable, {}, {}, {}, Errc::daemon_not_running};
    return;
  }
  auto look = look_at(arguments.socket, {.threads = true});
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
  Arguments everywhere;
  everywhere.all_domains = true;
  facts.threads = threads_of(system, everywhere);
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

namespace {
/// Returns a command that writes the settings in force as `script` of sed changes them.
std::string edit_configuration(const std::string& configuration, const std::string& script) {
  const std::string file = shell_word(configuration.empty() ? usual_configuration : configuration);
  // If agnocastd is not found here or may not read the file, NEW is empty and nothing is written.
  return "NEW=\"$(agnocastd --print-config" + (configuration.empty() ? "" : " --config " + file) +
         " | sed '" + script + "')\" && [ -n \"$NEW\" ] && printf '%s\\n' \"$NEW\" | sudo tee " +
         file + " > /dev/null";
}
}  // namespace

std::string Facts::configure(const std::string& section, const std::string& key,
                             std::uint64_t value) const {
  return edit_configuration(configuration, "/^\\[" + section + "\\]/,/^\\[/s/^" + key + " = .*/" +
                                               key + " = " + std::to_string(value) + "/");
}

std::string Facts::make_wide(const std::string& topic) const {
  const std::string name = '"' + topic + '"';
  return edit_configuration(
      configuration, "\\|^wide_topics = .*" + name + "|!s|^wide_topics = \\[|&" + name + ", |");
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
