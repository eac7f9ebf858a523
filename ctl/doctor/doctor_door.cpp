// SPDX-License-Identifier: Apache-2.0
//
// The checks of this shell and of the path to the daemon. Of the checks that explain why there is
// no daemon exactly one reports: each excludes the others by what is at the path.

#include <base/text/text.hpp>
#include <ctl/doctor/doctor_facts.hpp>

#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <charconv>
#include <sstream>

namespace agnocast::ctl {
namespace {

using Ailments = std::vector<Ailment>;
using Kind = Door::Kind;

Ailments when(bool is_so, Ailment ailment) {
  Ailments found;
  if (is_so) found.push_back(std::move(ailment));
  return found;
}

std::string at_door(const Facts& facts) { return escaped(facts.door.path); }

/// Returns the words of a remedy that avoids the file at the path.
Fill socket_elsewhere(const Facts& facts) {
  if (facts.shell.socket == facts.door.path) return {{"ELSEWHERE", "unset AGNOCAST_SOCKET"}};
  return {{"ELSEWHERE", "mv " + shell_word(facts.door.path) + ' ' +
                            shell_word(facts.door.path + ".old") + " && " +
                            facts.common().at("START")}};
}

bool is_code(const Facts& facts, Errc code) { return facts.away && facts.away->code == code; }

bool is_refused_by_mode(const Facts& facts) {
  return facts.door.kind == Kind::socket && facts.door.error == EACCES && facts.door.closed.empty();
}
bool has_group(const Facts& facts) {
  const auto& groups = facts.shell.groups;
  return std::find(groups.begin(), groups.end(), facts.door.gid) != groups.end();
}
/// Returns whether the socket is open to a group that this user can be added to.
bool is_for_group(const Facts& facts) {
  return (facts.door.mode & 0020) != 0 && facts.door.gid != 0 && !has_group(facts);
}
Fill user_and_group(const Facts& facts) {
  return {{"USER", shell_word(facts.shell.user)},
          {"GROUP", shell_word(facts.door.group)},
          {"SOCKET", shell_word(facts.door.path)}};
}

Ailments no_runtime_directory(const Facts& facts) {
  return when(!facts.users_socket.empty(),
              {"XDG_RUNTIME_DIR is not set, but this user's daemon listens in " +
                   escaped(facts.users_socket),
               {{"DIRECTORY", shell_word(facts.users_socket)}}});
}
Ailments no_daemon(const Facts& facts) {
  return when(facts.away && facts.door.kind == Kind::nothing && facts.door.closed.empty() &&
                  facts.users_socket.empty(),
              {"there is no agnocastd: nothing is at " + at_door(facts)});
}
Ailments directory_closed(const Facts& facts) {
  return when(facts.away && !facts.door.closed.empty(),
              {"user " + escaped(facts.shell.user) + " may not enter " +
                   escaped(facts.door.closed) + " on the path to the socket",
               {{"DIRECTORY", shell_word(facts.door.closed)}}});
}
Ailments not_a_socket(const Facts& facts) {
  return when(facts.away && facts.door.kind == Kind::other,
              {at_door(facts) + " is not a socket", socket_elsewhere(facts)});
}
Ailments nobody_listens(const Facts& facts) {
  return when(facts.away && facts.door.kind == Kind::socket && facts.door.error == ECONNREFUSED &&
                  !facts.door.is_mounted,
              {"there is no agnocastd: nobody listens at " + at_door(facts)});
}
// A daemon that ended and one with a new socket look alike here: the mounted file is the old one.
Ailments socket_mounted(const Facts& facts) {
  const std::string& path = facts.door.path;
  return when(facts.away && facts.door.is_mounted && facts.door.error == ECONNREFUSED,
              {"nobody listens at " + at_door(facts) +
                   " any more, and the file is mounted without its directory",
               {{"DIRECTORY", shell_word(path.substr(0, path.rfind('/')))}}});
}
Ailments foreign_socket(const Facts& facts) {
  return when(
      facts.away && (facts.door.error == EPROTOTYPE || is_code(facts, Errc::protocol_violation)),
      {"another program listens at " + at_door(facts), socket_elsewhere(facts)});
}
Ailments daemon_untrusted(const Facts& facts) {
  return when(
      is_code(facts, Errc::daemon_untrusted),
      {"user " + std::to_string(facts.door.server) + " listens at " + at_door(facts) +
           ", but is neither root, nor this user, nor the user to whom root gave its directory",
       socket_elsewhere(facts)});
}
Ailments not_in_group(const Facts& facts) {
  return when(is_refused_by_mode(facts) && is_for_group(facts) && !facts.door.group_lists_user,
              {"user " + escaped(facts.shell.user) + " is not in the group " +
                   escaped(facts.door.group) + ", which may connect to " + at_door(facts),
               user_and_group(facts)});
}
Ailments group_not_in_shell(const Facts& facts) {
  return when(is_refused_by_mode(facts) && is_for_group(facts) && facts.door.group_lists_user,
              {"user " + escaped(facts.shell.user) + " is in the group " +
                   escaped(facts.door.group) + ", but this shell is older than that",
               user_and_group(facts)});
}
Ailments socket_mode(const Facts& facts) {
  char mode[8];
  std::snprintf(mode, sizeof mode, "%04o", static_cast<unsigned>(facts.door.mode));
  return when(is_refused_by_mode(facts) && !is_for_group(facts),
              {"mode " + std::string(mode) + " of " + at_door(facts) + " keeps user " +
                   escaped(facts.shell.user) + " out",
               user_and_group(facts)});
}
Ailments daemon_stopped(const Facts& facts) {
  const std::string pid = std::to_string(facts.door.listener);
  return when(facts.door.listener_stopped,
              {"agnocastd (pid " + pid + ") is stopped", {{"PID", pid}}});
}
Ailments other_layout(const Facts& facts) {
  return when(is_code(facts, Errc::layout_mismatch),
              {"agnocastd at " + at_door(facts) + ": " + (facts.away ? facts.away->why : "")});
}
Ailments store_damaged(const Facts& facts) {
  return when(is_code(facts, Errc::store_damaged),
              {"agnocastd at " + at_door(facts) + ": " + (facts.away ? facts.away->why : "")});
}
Ailments observers(const Facts& facts) {
  return when(is_code(facts, Errc::quota_exceeded),
              {"agnocastd refuses a further agnocast-ctl: " + (facts.away ? facts.away->why : ""),
               {{"USER", shell_word(facts.shell.user)}}});
}
// The answer came without its descriptors, although this process had room for them.
Ailments descriptors_withheld(const Facts& facts) {
  if (!is_code(facts, Errc::descriptors_withheld)) return {};
  const std::string& name = facts.shell.confinement;
  Ailment found{"connected to " + at_door(facts) + ", but no descriptor arrived"};
  if (name.empty()) {
    found.words["ALLOW"] = "sudo ss -xlp src " + shell_word(facts.door.path);
    found.cause =
        "no profile confines this shell: the program that listens there does not pass descriptors "
        "on";
  } else if (name.find(':') == std::string::npos || name.front() == '/') {
    found.words["ALLOW"] =
        "PROFILE=\"$(sudo grep -rlF " + shell_word(name) +
        " /etc/apparmor.d | head -n 1)\" && sudo sed -i " +
        shell_word("\\|" + name + ".*{|a include \"" + facts.share + "/apparmor/agnocast\"") +
        " \"$PROFILE\" && sudo apparmor_parser -r \"$PROFILE\"";
    found.cause = "the AppArmor profile " + escaped(name) + " of this shell blocks them";
  } else {
    const std::string module = facts.share + "/selinux/agnocast";
    found.words["ALLOW"] = "cd \"$(mktemp -d)\" && checkmodule -M -m -o agnocast.mod " +
                           shell_word(module + ".te") +
                           " && semodule_package -o agnocast.pp -m agnocast.mod -f " +
                           shell_word(module + ".fc") + " && sudo semodule -i agnocast.pp";
    found.cause = "the SELinux context " + escaped(name) + " of this shell blocks them";
  }
  return {found};
}
// Returns whether this process has no descriptor left: connecting itself succeeded.
bool is_short_of_descriptors(const Facts& facts) {
  return is_code(facts, Errc::os_failure) && facts.door.error == 0;
}
Ailments descriptors_short(const Facts& facts) {
  return when(is_short_of_descriptors(facts),
              {"connected to " + at_door(facts) +
               ", but this shell may not open the descriptors of the answer"});
}
Ailments daemon_silent(const Facts& facts) {
  // Reasons that another check reports.
  const Door& door = facts.door;
  const bool is_named =
      door.error == ECONNREFUSED || door.error == EACCES || door.error == EPROTOTYPE ||
      door.listener_stopped || is_code(facts, Errc::layout_mismatch) ||
      is_code(facts, Errc::store_damaged) || is_code(facts, Errc::quota_exceeded) ||
      is_code(facts, Errc::protocol_violation) || is_code(facts, Errc::descriptors_withheld) ||
      is_code(facts, Errc::daemon_untrusted) || is_short_of_descriptors(facts);
  return when(facts.away && door.kind == Kind::socket && door.closed.empty() && !is_named,
              {"the program that listens at " + at_door(facts) +
               " does not serve requests: " + (facts.away ? facts.away->why : "")});
}

Ailments other_daemon(const Facts& facts) {
  return when(!facts.systems_socket.empty(),
              {"AGNOCAST_SOCKET is " + at_door(facts) + ", but the daemon of this system is at " +
               facts.systems_socket});
}

std::optional<std::uint64_t> domain_of(const Facts& facts) {
  if (!facts.shell.domain) return 0;
  const std::string& text = *facts.shell.domain;
  std::uint64_t domain = 0;
  const auto parsed = std::from_chars(text.data(), text.data() + text.size(), domain);
  if (parsed.ec != std::errc() || parsed.ptr != text.data() + text.size() || domain > domain_max)
    return std::nullopt;
  return domain;
}
Ailments domain_invalid(const Facts& facts) {
  return when(!domain_of(facts),
              {"ROS_DOMAIN_ID is " + in_quotes(facts.shell.domain.value_or(""))});
}
Ailments domain_elsewhere(const Facts& facts) {
  const auto own = domain_of(facts);
  const auto& topics = facts.system().topics;
  const bool has_own = std::any_of(topics.begin(), topics.end(), [&](const auto& topic) {
    return topic.second.facts.domain == own;
  });
  if (!own || has_own || topics.empty()) return {};
  const std::uint64_t other = topics.begin()->second.facts.domain;
  return {{"this shell is in domain " + std::to_string(*own) +
               ", but all topics are in other domains, such as " + std::to_string(other),
           {{"DOMAIN", std::to_string(other)}}}};
}
Ailments switched_off(const Facts& facts) {
  const std::string value = facts.shell.agnocast.value_or("on");
  return when(value != "on", {"AGNOCAST is " + in_quotes(value) + " in this shell"});
}

/// Returns the files that LD_PRELOAD names.
std::vector<std::string> files_in(std::string text) {
  std::replace(text.begin(), text.end(), ':', ' ');
  std::istringstream words(text);
  std::vector<std::string> files;
  for (std::string file; words >> file;) files.push_back(file);
  return files;
}
std::string_view base_of(std::string_view path) { return path.substr(path.rfind('/') + 1); }
bool is_hook(std::string_view path) { return base_of(path).starts_with("libagnocast_heaphook"); }
bool is_allocator(std::string_view path) {
  const std::string_view name = base_of(path);
  return name.starts_with("libjemalloc") || name.starts_with("libtcmalloc") ||
         name.starts_with("libmimalloc");
}

Ailments allocator_in_front(const Facts& facts) {
  std::vector<std::string> files = files_in(facts.shell.preload.value_or(""));
  const auto hook = std::find_if(files.begin(), files.end(), is_hook);
  const auto allocator = std::find_if(files.begin(), hook, is_allocator);
  if (hook == files.end() || allocator == hook) return {};
  const std::string what =
      "LD_PRELOAD of this shell has " + escaped(*allocator) + " before the hook";
  std::rotate(files.begin(), hook, hook + 1);
  std::string order;
  for (const std::string& file : files) order += (order.empty() ? "" : ":") + file;
  return {{what, {{"FILES", shell_word(order)}}}};
}
Ailments shell_preload(const Facts& facts) {
  Ailments found;
  for (const std::string& file : files_in(facts.shell.preload.value_or(""))) {
    if (is_hook(file) && file.front() == '/' && ::access(file.c_str(), R_OK) != 0)
      found.push_back(
          {"LD_PRELOAD of this shell names " + escaped(file) + ", which cannot be read"});
  }
  return found;
}

using enum Check::Severity;
using enum Check::Needs;

// clang-format off
constexpr Check door_table[] = {
    {"domain-invalid", "ROS_DOMAIN_ID is a domain", failed, nothing,
     "a domain is a number from 0 to 232; with any other text no endpoint can be created",
     "export ROS_DOMAIN_ID=0", domain_invalid},
    {"switched-off", "agnocast is not switched off in this shell", warning, nothing,
     "programs that are started here have endpoints that neither publish nor receive (AGNOCAST=off), or none at all (any word but on and off)",
     "unset AGNOCAST", switched_off},
    {"hook-not-first", "no other allocator precedes the heap hook in LD_PRELOAD", failed, nothing,
     "the first allocator serves malloc, so no publisher can be created: hook_ineffective",
     "export LD_PRELOAD=FILES", allocator_in_front},
    {"hook-not-there", "the heap hook that LD_PRELOAD names can be read", failed, nothing,
     "the loader leaves it out: messages are copied, and of types that cannot be copied so no publisher can be created (hook_missing)",
     "unset LD_PRELOAD  # then: agnocast-run PROGRAM", shell_preload},
    {"other-daemon", "AGNOCAST_SOCKET does not bypass the daemon of this system", warning, nothing,
     "processes of different daemons do not see each other",
     "unset AGNOCAST_SOCKET", other_daemon},
    {"no-runtime-directory", "XDG_RUNTIME_DIR is set if this user's daemon is found through it", failed, nothing,
     "without it the library looks only for the system's daemon; su, cron and some containers do not set it",
     "export XDG_RUNTIME_DIR=DIRECTORY", no_runtime_directory},
    {"no-daemon", "there is a socket of agnocastd", failed, nothing,
     "the daemon was not started, or listens elsewhere",
     "START", no_daemon},
    {"directory-closed", "this user may enter the directories on the path to the socket", failed, nothing,
     "a directory on the path is closed to this user, whatever the mode of the socket",
     "sudo chmod a+x DIRECTORY", directory_closed},
    {"not-a-socket", "the file at the socket's path is a socket", failed, nothing,
     "the daemon does not replace a file that is not a socket, and does not start there",
     "ELSEWHERE", not_a_socket},
    {"nobody-listens", "somebody listens at the socket", failed, nothing,
     "the daemon was killed, or stopped by its service manager, and the socket file stayed",
     "START", nobody_listens},
    {"socket-mounted", "the socket was mounted with its directory", failed, nothing,
     "a file that is mounted into a container stays the socket of that moment; the daemon has made a new one since, or has ended. "
     "Mount the directory",
     "podman run --volume DIRECTORY:DIRECTORY IMAGE", socket_mounted},
    {"foreign-socket", "the socket belongs to agnocastd", failed, nothing,
     "it speaks another protocol: another program uses this path",
     "ELSEWHERE", foreign_socket},
    {"daemon-untrusted", "the user that listens at the socket is trusted", failed, nothing,
     "another user's program would learn who we are, and its memory would be mapped. If agnocastd runs as this user on purpose: "
     "export AGNOCAST_DAEMON_UID with the number of that user, or give that user the directory of the socket, as root",
     "ELSEWHERE", daemon_untrusted},
    {"not-in-group", "this user is in the socket's group", failed, nothing,
     "the socket is open to its group only; a new group takes effect at the next login",
     "sudo usermod -aG GROUP USER", not_in_group},
    {"group-not-in-shell", "this shell has the socket's group", failed, nothing,
     "the user was added to the group after this shell started",
     "newgrp GROUP", group_not_in_shell},
    {"socket-mode", "the socket's mode lets this user connect", failed, nothing,
     "its owner, group and mode ([daemon] socket_mode, socket_group) do not admit this user",
     "sudo groupadd -f agnocast && sudo chgrp agnocast SOCKET && sudo chmod 0660 SOCKET && sudo usermod -aG agnocast USER",
     socket_mode},
    {"daemon-stopped", "agnocastd is not stopped", failed, nothing,
     "SIGSTOP or a debugger has stopped it: messages flow, but nothing can be created or repaired",
     "kill -CONT PID", daemon_stopped},
    {"daemon-silent", "agnocastd answers", failed, nothing,
     "it hangs or has no descriptor left, or another program that never answers listens there",
     "ANEW", daemon_silent},
    {"descriptors-withheld", "the descriptors of the daemon's answers arrive", failed, nothing,
     "a security profile (AppArmor, SELinux) of this shell or container blocks them, or the program that listens there does not pass them on",
     "ALLOW", descriptors_withheld},
    {"descriptors-short", "this shell may open the descriptors that come with an answer", failed, nothing,
     "its limit of open files is too small, and the programs that it starts inherit it",
     "ulimit -n 4096", descriptors_short},
    {"observers", "this user may run one more agnocast-ctl", failed, nothing,
     "this user runs too many agnocast-ctl at once",
     "killall -u USER agnocast-ctl", observers},
    {"other-layout", "agnocastd and agnocast-ctl agree on the layout of shared memory", failed, nothing,
     "one of them, or the state that the daemon kept across its restart, is of another version",
     "ANEW", other_layout},
    {"store-damaged", "the state that agnocastd keeps across its restarts is intact", failed, nothing,
     "it serves nobody until this state is discarded; processes then join the new daemon by themselves",
     "ANEW", store_damaged},
    {"domain-elsewhere", "this shell's domain has topics, if any domain has some", warning, daemon,
     "topics of other domains are not visible here",
     "export ROS_DOMAIN_ID=DOMAIN", domain_elsewhere},
};
// clang-format on

}  // namespace

const std::span<const Check> door_checks = door_table;

}  // namespace agnocast::ctl
