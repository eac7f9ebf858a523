// SPDX-License-Identifier: Apache-2.0
//
// The checks of this shell and of the way to the daemon. Of those that say why there is no daemon exactly
// one speaks: each excludes the others by what stands at the path.

#include <base/text.hpp>
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

/// How to do without what stands there.
Fill elsewhere(const Facts& facts) {
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
/// A group that people are put into may connect.
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
              {"XDG_RUNTIME_DIR is not set, and this user's daemon listens in " +
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
              {"user " + escaped(facts.shell.user) + " may not walk through " +
                   escaped(facts.door.closed) + " to the socket",
               {{"DIRECTORY", shell_word(facts.door.closed)}}});
}
Ailments not_a_socket(const Facts& facts) {
  return when(facts.away && facts.door.kind == Kind::other,
              {at_door(facts) + " is no socket", elsewhere(facts)});
}
Ailments nobody_listens(const Facts& facts) {
  return when(facts.away && facts.door.kind == Kind::socket && facts.door.error == ECONNREFUSED &&
                  !facts.door.is_mounted,
              {"there is no agnocastd: nobody listens at " + at_door(facts)});
}
// Whether the daemon is away or has made its socket anew cannot be seen from here: the file stays what it was.
Ailments socket_mounted(const Facts& facts) {
  const std::string& path = facts.door.path;
  return when(
      facts.away && facts.door.is_mounted && facts.door.error == ECONNREFUSED,
      {"nobody listens at " + at_door(facts) + " any more, and the file is mounted by itself",
       {{"DIRECTORY", shell_word(path.substr(0, path.rfind('/')))}}});
}
Ailments foreign_socket(const Facts& facts) {
  return when(
      facts.away && (facts.door.error == EPROTOTYPE || is_code(facts, Errc::protocol_violation)),
      {"another program listens at " + at_door(facts), elsewhere(facts)});
}
Ailments daemon_untrusted(const Facts& facts) {
  return when(is_code(facts, Errc::daemon_untrusted),
              {"user " + std::to_string(facts.door.server) + " listens at " + at_door(facts) +
                   ", and neither root, nor this user, nor whom root has given its directory",
               elsewhere(facts)});
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
                   escaped(facts.door.group) + ", but this shell began before",
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
  return when(
      is_code(facts, Errc::quota_exceeded),
      {"agnocastd lets no further agnocast-ctl look: " + (facts.away ? facts.away->why : ""),
       {{"USER", shell_word(facts.shell.user)}}});
}
// An answer without the descriptors that belong to it, although there was room for them.
Ailments descriptors_withheld(const Facts& facts) {
  if (!is_code(facts, Errc::descriptors_withheld)) return {};
  const std::string& name = facts.shell.confinement;
  Ailment found{"connected to " + at_door(facts) + ", but no descriptor arrived"};
  if (name.empty()) {
    found.words["ALLOW"] = "sudo ss -xlp src " + shell_word(facts.door.path);
    found.cause = "no profile confines this shell: what listens there passes no descriptors on";
  } else if (name.find(':') == std::string::npos || name.front() == '/') {
    found.words["ALLOW"] =
        "PROFILE=\"$(sudo grep -rlF " + shell_word(name) +
        " /etc/apparmor.d | head -n 1)\" && sudo sed -i " +
        shell_word("\\|" + name + ".*{|a include \"" + facts.share + "/apparmor/agnocast\"") +
        " \"$PROFILE\" && sudo apparmor_parser -r \"$PROFILE\"";
    found.cause = "the AppArmor profile " + escaped(name) + " of this shell keeps them away";
  } else {
    const std::string module = facts.share + "/selinux/agnocast";
    found.words["ALLOW"] = "cd \"$(mktemp -d)\" && checkmodule -M -m -o agnocast.mod " +
                           shell_word(module + ".te") +
                           " && semodule_package -o agnocast.pp -m agnocast.mod -f " +
                           shell_word(module + ".fc") + " && sudo semodule -i agnocast.pp";
    found.cause = "the SELinux context " + escaped(name) + " of this shell keeps them away";
  }
  return {found};
}
// Connecting itself has gone well.
bool is_short_of_descriptors(const Facts& facts) {
  return is_code(facts, Errc::os_failure) && facts.door.error == 0;
}
Ailments descriptors_short(const Facts& facts) {
  return when(is_short_of_descriptors(facts),
              {"connected to " + at_door(facts) + ", but this shell may not open what comes"});
}
Ailments daemon_silent(const Facts& facts) {
  // What another check names.
  const Door& door = facts.door;
  const bool is_named =
      door.error == ECONNREFUSED || door.error == EACCES || door.error == EPROTOTYPE ||
      door.listener_stopped || is_code(facts, Errc::layout_mismatch) ||
      is_code(facts, Errc::store_damaged) || is_code(facts, Errc::quota_exceeded) ||
      is_code(facts, Errc::protocol_violation) || is_code(facts, Errc::descriptors_withheld) ||
      is_code(facts, Errc::daemon_untrusted) ||
      is_short_of_descriptors(facts);
  return when(facts.away && door.kind == Kind::socket && door.closed.empty() && !is_named,
              {"whoever listens at " + at_door(facts) +
               " does not serve: " + (facts.away ? facts.away->why : "")});
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
               ", and all topics are in others: " + std::to_string(other),
           {{"DOMAIN", std::to_string(other)}}}};
}
Ailments switched_off(const Facts& facts) {
  const std::string value = facts.shell.agnocast.value_or("on");
  return when(value != "on", {"AGNOCAST is " + in_quotes(value) + " in this shell"});
}

/// Of LD_PRELOAD.
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
      "LD_PRELOAD of this shell has " + escaped(*allocator) + " in front of the hook";
  std::rotate(files.begin(), hook, hook + 1);
  std::string order;
  for (const std::string& file : files) order += (order.empty() ? "" : ":") + file;
  return {{what, {{"FILES", shell_word(order)}}}};
}
Ailments shell_preload(const Facts& facts) {
  Ailments found;
  for (const std::string& file : files_in(facts.shell.preload.value_or(""))) {
    if (is_hook(file) && file.front() == '/' && ::access(file.c_str(), R_OK) != 0)
      found.push_back({"LD_PRELOAD of this shell names " + escaped(file) + ", which is not there"});
  }
  return found;
}

constexpr auto failed = Check::Severity::failed;
constexpr auto warning = Check::Severity::warning;
constexpr auto always = Check::Needs::nothing;
constexpr auto daemon = Check::Needs::daemon;

// clang-format off
constexpr Check table[] = {
    {"domain-invalid", "ROS_DOMAIN_ID is a domain", failed, always,
     "a domain is a number from 0 to 232; with another text no endpoint can be created",
     "export ROS_DOMAIN_ID=0", domain_invalid},
    {"switched-off", "agnocast is not switched off in this shell", warning, always,
     "what is started here has endpoints that neither publish nor receive (AGNOCAST=off), or none at all (any word but on and off)",
     "unset AGNOCAST", switched_off},
    {"hook-not-first", "no other allocator stands before the heap hook in LD_PRELOAD", failed, always,
     "the allocator in front serves malloc, so no publisher can be created: hook_ineffective",
     "export LD_PRELOAD=FILES", allocator_in_front},
    {"hook-not-there", "the heap hook that LD_PRELOAD names is there", failed, always,
     "the loader leaves it out, and no publisher can be created: hook_missing",
     "unset LD_PRELOAD  # then: agnocast-run PROGRAM", shell_preload},
    {"other-daemon", "AGNOCAST_SOCKET does not lead past the daemon of this system", warning, always,
     "who goes to different daemons does not meet",
     "unset AGNOCAST_SOCKET", other_daemon},
    {"no-runtime-directory", "XDG_RUNTIME_DIR is set where a user's daemon is to be found by it", failed, always,
     "without it the library looks for the system's daemon only; su, cron and some containers do not set it",
     "export XDG_RUNTIME_DIR=DIRECTORY", no_runtime_directory},
    {"no-daemon", "there is a socket of agnocastd", failed, always,
     "the daemon was not started, or listens elsewhere",
     "START", no_daemon},
    {"directory-closed", "this user may walk to the socket", failed, always,
     "a directory on the way is closed to this user, whatever the socket's own mode says",
     "sudo chmod a+x DIRECTORY", directory_closed},
    {"not-a-socket", "what is at the socket's path is a socket", failed, always,
     "the daemon leaves alone what is no socket, and does not start there",
     "ELSEWHERE", not_a_socket},
    {"nobody-listens", "somebody listens at the socket", failed, always,
     "the daemon was killed, or stopped by its service manager, and the socket stayed",
     "START", nobody_listens},
    {"socket-mounted", "the socket came here with its directory", failed, always,
     "a file that is mounted into a container stays the socket that was there then; the daemon has made another one since, or is away. "
     "Mount the directory",
     "podman run --volume DIRECTORY:DIRECTORY IMAGE", socket_mounted},
    {"foreign-socket", "the socket is agnocastd's", failed, always,
     "it speaks another protocol: another program has this path",
     "ELSEWHERE", foreign_socket},
    {"daemon-untrusted", "who listens at the socket is trusted", failed, always,
     "another user's program would be told who we are, and its memory would be mapped. If agnocastd has a user of its own, and that one is meant: "
     "export AGNOCAST_DAEMON_UID with its number, or give it the directory of the socket as root",
     "ELSEWHERE", daemon_untrusted},
    {"not-in-group", "this user is in the socket's group", failed, always,
     "the socket is open to its group only; a new membership is seen by the next login",
     "sudo usermod -aG GROUP USER", not_in_group},
    {"group-not-in-shell", "this shell has the socket's group", failed, always,
     "the user was put into the group after this shell had begun",
     "newgrp GROUP", group_not_in_shell},
    {"socket-mode", "the socket's mode lets this user connect", failed, always,
     "neither its owner, its group nor its mode ([daemon] socket_mode, socket_group) is for this user",
     "sudo groupadd -f agnocast && sudo chgrp agnocast SOCKET && sudo chmod 0660 SOCKET && sudo usermod -aG agnocast USER",
     socket_mode},
    {"daemon-stopped", "agnocastd is not stopped", failed, always,
     "SIGSTOP or a debugger holds it: messages flow, but nothing can be created or repaired",
     "kill -CONT PID", daemon_stopped},
    {"daemon-silent", "agnocastd answers", failed, always,
     "it hangs or has no descriptor left, or another program listens there that never answers",
     "ANEW", daemon_silent},
    {"descriptors-withheld", "the descriptors of the daemon's answers arrive", failed, always,
     "a security profile (AppArmor, SELinux) of this shell or container keeps them away, or what listens there passes none on",
     "ALLOW", descriptors_withheld},
    {"descriptors-short", "this shell may open the descriptors that come with an answer", failed, always,
     "its limit of open files is too small, as is that of what it starts",
     "ulimit -n 4096", descriptors_short},
    {"observers", "this user may look once more", failed, always,
     "agnocast-ctl runs too often at once",
     "killall -u USER agnocast-ctl", observers},
    {"other-layout", "agnocastd and agnocast-ctl agree on the layout of shared memory", failed, always,
     "one of both, or what the daemon kept over its restart, is of another version",
     "ANEW", other_layout},
    {"store-damaged", "what agnocastd keeps across its restarts is whole", failed, always,
     "it serves nobody until what it kept is given up; processes then go to the new daemon by themselves",
     "ANEW", store_damaged},
    {"domain-elsewhere", "this shell's domain has topics where others have", warning, daemon,
     "what is in another domain is neither seen nor heard here",
     "export ROS_DOMAIN_ID=DOMAIN", domain_elsewhere},
};
// clang-format on

}  // namespace

const std::span<const Check> door_checks = table;

}  // namespace agnocast::ctl
