// SPDX-License-Identifier: Apache-2.0
//
// access: which users may publish and subscribe, why, and the permissions and quotas of one user.
//
// The daemon names the rule that decides and the users in it. This file finds the rest from the
// databases of users and groups and from the socket: the meaning of names and numbers on this
// host, the users that may connect, and whether a given user is one of those named.

#include <base/text/names.hpp>
#include <base/text/text.hpp>
#include <ctl/cli/commands.hpp>
#include <ctl/commands/objects.hpp>
#include <ctl/snapshot/select.hpp>
#include <ctl/snapshot/system.hpp>

#include <grp.h>
#include <pwd.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <charconv>
#include <cstdio>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace agnocast::ctl {
namespace {

std::optional<std::uint32_t> number_of(std::string_view text) {
  std::uint32_t number = 0;
  const auto parsed = std::from_chars(text.data(), text.data() + text.size(), number);
  if (parsed.ec != std::errc() || parsed.ptr != text.data() + text.size()) return std::nullopt;
  return number;
}

std::string user_name(uid_t uid) {
  const passwd* const user = ::getpwuid(uid);
  return user == nullptr ? std::string() : user->pw_name;
}
std::string group_name(gid_t gid) {
  const group* const found = ::getgrgid(gid);
  return found == nullptr ? std::string() : found->gr_name;
}

/// A user or group as this host knows it; an unknown name or number stays empty.
struct Someone {
  bool is_group = false;
  std::string name;
  std::optional<std::uint32_t> id;
  std::string written;  // as written in the rule

  static Someone user(uid_t uid) { return {false, user_name(uid), uid, {}}; }
  static Someone group(gid_t gid) { return {true, group_name(gid), gid, {}}; }

  /// Returns "user lidar (uid 1001)".
  std::string words() const {
    const std::string kind = is_group ? "group" : "user", number = is_group ? "gid " : "uid ";
    if (name.empty()) return number + std::to_string(id.value_or(0));
    return kind + ' ' + escaped(name) + " (" +
           (id ? number + std::to_string(*id) : "not known to this host") + ')';
  }
  Object object() const {
    Object object{{"kind", is_group ? "group" : "user"},
                  {"name", name.empty() ? Object() : Object(name)},
                  {"id", id ? Object(*id) : Object()}};
    if (!written.empty()) object["written"] = written;
    return object;
  }
};

/// Parses "user:lidar", "uid:1001", "group:video", "gid:44".
std::optional<Someone> someone_of(const std::string& written) {
  const std::size_t colon = written.find(':');
  if (colon == std::string::npos) return std::nullopt;
  const std::string kind = written.substr(0, colon), which = written.substr(colon + 1);
  Someone who;
  if (kind == "uid" || kind == "gid") {
    const auto id = number_of(which);
    if (!id) return std::nullopt;
    who = kind == "gid" ? Someone::group(*id) : Someone::user(*id);
  } else if (kind == "user" || kind == "group") {
    who = {kind == "group", which, std::nullopt, {}};
    if (const passwd* const user = who.is_group ? nullptr : ::getpwnam(which.c_str()))
      who.id = user->pw_uid;
    if (const ::group* const group = who.is_group ? ::getgrnam(which.c_str()) : nullptr)
      who.id = group->gr_gid;
  } else {
    return std::nullopt;
  }
  who.written = written;
  return who;
}

/// The users and groups that may do one thing, and why.
struct Allowed {
  bool everybody = false;
  std::vector<Someone> who;
  bool has_more = false;  // more than fit into the daemon's answer
  std::uint32_t line = 0;
  std::string pattern;
  std::string why;

  std::string words() const {
    if (everybody) return "everybody";
    std::string all;
    for (const Someone& one : who) all += (all.empty() ? "" : ", ") + one.words();
    if (has_more) all += ", and more";
    return all.empty() ? "nobody" : all;
  }
  /// Returns whether both name the same users and groups, however they are written.
  bool same_as(const Allowed& other) const {
    const auto all_in = [](const Allowed& these, const Allowed& those) {
      return std::all_of(these.who.begin(), these.who.end(), [&](const Someone& one) {
        return std::any_of(those.who.begin(), those.who.end(), [&](const Someone& another) {
          return one.is_group == another.is_group && one.id == another.id;
        });
      });
    };
    return everybody == other.everybody &&
           (everybody || (all_in(*this, other) && all_in(other, *this)));
  }
  Object object() const {
    Object list = Object::array();
    for (const Someone& one : who) list.push_back(one.object());
    Object rule;
    if (line != 0) rule = {{"line", line}, {"pattern", pattern}};
    return {{"everybody", everybody}, {"who", list}, {"has_more", has_more}, {"rule", rule}};
  }
};

Allowed allowed_by(const wire::AccessIs& is) {
  Allowed allowed;
  allowed.everybody = is.everybody != 0;
  allowed.line = is.line;
  allowed.pattern = text_of(is.pattern);
  if (is.line != 0) {
    allowed.why = "rule " + in_quotes(allowed.pattern) + ", line " + std::to_string(is.line) +
                  " of the configuration";
  } else {
    allowed.why = is.rule_count == 0 ? "there are no rules"
                                     : "none of " + counted(is.rule_count, "rule") + " matches it";
  }
  constexpr std::string_view separator = ", ";
  std::string_view rest = is.principals;
  while (!rest.empty() && !allowed.everybody) {
    const std::size_t end = std::min(rest.find(separator), rest.size());
    const std::string word(rest.substr(0, end));
    if (auto one = someone_of(word)) {
      allowed.who.push_back(std::move(*one));
    } else {
      allowed.has_more = true;
    }
    rest.remove_prefix(std::min(rest.size(), end + separator.size()));
  }
  return allowed;
}

/// The file at the socket's path, whose mode decides who may connect.
struct SocketFile {
  bool is_there = false;
  mode_t mode = 0;
  Someone owner, group;

  static SocketFile at(const std::string& path) {
    struct stat file {};
    if (::stat(path.c_str(), &file) != 0) return {};
    return {true, file.st_mode & 07777, Someone::user(file.st_uid), Someone::group(file.st_gid)};
  }
  std::string mode_text() const {
    char text[8];
    std::snprintf(text, sizeof text, "%04o", static_cast<unsigned>(mode));
    return text;
  }
  Allowed allowed() const {
    Allowed allowed;
    allowed.everybody = (mode & 0002) != 0;
    if ((mode & 0200) != 0) allowed.who.push_back(owner);
    if ((mode & 0020) != 0) allowed.who.push_back(group);
    allowed.why = "mode " + mode_text() + " of the socket";
    return allowed;
  }
};

struct User {
  Someone who;
  std::vector<gid_t> groups;

  /// Returns which of `others` includes this user; nullptr: none.
  const Someone* among(const std::vector<Someone>& others) const {
    const auto found = std::find_if(others.begin(), others.end(), [&](const Someone& one) {
      if (!one.id) return false;
      return one.is_group ? std::find(groups.begin(), groups.end(), *one.id) != groups.end()
                          : one.id == who.id;
    });
    return found == others.end() ? nullptr : &*found;
  }
};

User this_user() {
  User user{Someone::user(::geteuid()), {::getegid()}};
  std::vector<gid_t> groups(static_cast<std::size_t>(std::max(::getgroups(0, nullptr), 0)));
  const int count = ::getgroups(static_cast<int>(groups.size()), groups.data());
  groups.resize(static_cast<std::size_t>(std::max(count, 0)));
  user.groups.insert(user.groups.end(), groups.begin(), groups.end());
  return user;
}

Outcome<User> user_named(const std::string& name) {
  const auto number = number_of(name);
  const passwd* const found = number ? ::getpwuid(*number) : ::getpwnam(name.c_str());
  if (found == nullptr) {
    if (number) return User{Someone::user(*number), {}};
    return problem(Status::no_such_thing, in_quotes(name), "this host has no such user",
                   "getent passwd");
  }
  const std::string known = found->pw_name;
  const gid_t primary = found->pw_gid;
  User user{{false, known, found->pw_uid, {}}, {}};
  int count = 64;
  for (user.groups.resize(64);
       ::getgrouplist(known.c_str(), primary, user.groups.data(), &count) < 0;)
    user.groups.resize(static_cast<std::size_t>(count));
  user.groups.resize(static_cast<std::size_t>(count));
  return user;
}

/// The permission of one user; `allowed` is empty if the daemon's answer was cut short.
struct Verdict {
  std::optional<bool> allowed;
  std::string why;

  std::string word() const { return !allowed ? "unknown" : *allowed ? "yes" : "no"; }
  Object object() const {
    return {{"allowed", allowed ? Object(*allowed) : Object()}, {"why", why}};
  }
};

Verdict verdict_on(const User& user, const Allowed& allowed) {
  if (allowed.everybody) return {true, "everybody may"};
  if (const Someone* const one = user.among(allowed.who)) return {true, "as " + one->words()};
  if (allowed.has_more) return {std::nullopt, "the rule names more users than are shown here"};
  return {false, allowed.who.empty() ? "nobody may" : "is not one of them"};
}
Verdict verdict_on_door(const User& user, const SocketFile& socket) {
  // The first part of a mode that applies decides, as in the kernel; root may always connect.
  if (user.who.id == 0U) return {true, "root may always"};
  const bool is_owner = user.who.id == socket.owner.id;
  const bool is_member = !is_owner && user.among({socket.group}) != nullptr;
  const mode_t bit = is_owner ? 0200 : is_member ? 0020 : 0002;
  return {(socket.mode & bit) != 0, is_owner    ? "as its owner"
                                    : is_member ? "as " + socket.group.words()
                                                : "as neither its owner nor in its group"};
}

/// Another topic of a process that publishes this one, with other permitted subscribers: they read
/// the same heap. The daemon lets no process publish both, unless its rules have changed since.
struct Beside {
  std::string topic;
  std::uint64_t domain = 0;
  std::uint32_t pid = 0;
  Allowed subscribe;

  std::string why() const {
    return escaped(topic) + " (domain " + std::to_string(domain) + "), which process " +
           std::to_string(pid) + " also publishes (" + subscribe.why + "); restart it";
  }
  Object object() const {
    return {{"topic", topic}, {"domain", domain}, {"pid", pid}, {"subscribe", subscribe.object()}};
  }
};

struct Report {
  std::string topic, socket_path;
  std::uint64_t domain = 0;
  Allowed publish, subscribe;
  std::vector<Beside> beside;
  SocketFile socket;
  User user;
  wire::UserShare used{}, quota{};

  Verdict may_connect() const { return verdict_on_door(user, socket); }
};

Object object_of(const Report& report) {
  Object groups = Object::array();
  for (const gid_t gid : report.user.groups) groups.push_back(Someone::group(gid).object());
  Object memory = Object::array();
  for (const Beside& one : report.beside) memory.push_back(one.object());
  Object socket{{"path", report.socket_path}};
  socket["mode"] = report.socket.mode_text();
  socket["owner"] = report.socket.owner.object();
  socket["group"] = report.socket.group.object();
  return {{"schema", "agnocast.access/1"},
          {"topic", report.topic},
          {"domain", report.domain},
          {"publish", report.publish.object()},
          {"subscribe", report.subscribe.object()},
          {"memory", memory},
          {"socket", socket},
          {"user",
           {{"name", report.user.who.object()["name"]},
            {"uid", report.user.who.id.value_or(0)},
            {"groups", groups},
            {"publish", verdict_on(report.user, report.publish).object()},
            {"subscribe", verdict_on(report.user, report.subscribe).object()},
            {"connect", report.may_connect().object()},
            {"in_use", share_object(report.used)},
            {"quota", share_object(report.quota)}}}};
}

std::string share_text(const std::string& key, const Object& value) {
  if (value.is_null()) return "unlimited";
  const auto number = value.get<std::uint64_t>();
  return key.ends_with("_bytes") ? bytes_for_people(number) : std::to_string(number);
}

void print(const Report& report, Console& console) {
  console.line(escaped(report.topic) + " of domain " + std::to_string(report.domain) + ", at " +
               escaped(report.socket_path));
  console.line("");
  Table rules({"TO", "WHO MAY", "WHY"});
  const Allowed connect = report.socket.allowed();
  rules.add({"connect", connect.words(), connect.why});
  rules.add({"publish", report.publish.words(), report.publish.why});
  rules.add({"subscribe", report.subscribe.words(), report.subscribe.why});
  for (const Beside& one : report.beside) rules.add({"memory", one.subscribe.words(), one.why()});
  rules.print(console);
  console.line("");
  console.line(console.strong(report.user.who.words()));
  console.line("");
  Table verdicts({"MAY", "", "WHY"});
  const auto add = [&](const char* what, const Verdict& verdict) {
    verdicts.add({what, verdict.word(), verdict.why});
  };
  add("connect", report.may_connect());
  add("publish", verdict_on(report.user, report.publish));
  add("subscribe", verdict_on(report.user, report.subscribe));
  verdicts.print(console);
  console.line("");
  Table quotas({"QUOTA", "USED", "OF"});
  const Object used = share_object(report.used), quota = share_object(report.quota);
  for (const auto& [key, limit] : quota.items())
    quotas.add({key, share_text(key, used[key]), share_text(key, limit)});
  quotas.print(console);
}

std::uint64_t endpoints_of_user(const Look& look, const std::vector<Endpoint>& endpoints,
                                const User& user) {
  return static_cast<std::uint64_t>(
      std::count_if(endpoints.begin(), endpoints.end(), [&](const Endpoint& endpoint) {
        const auto owner = look.system.processes.find(endpoint.facts.client);
        return owner != look.system.processes.end() &&
               owner->second.facts.uid == user.who.id.value_or(0);
      }));
}

/// Returns the other topics that the publishers' processes publish for other readers.
Outcome<std::vector<Beside>> topics_beside(Look& look, const Report& report) {
  std::vector<Beside> all;
  const auto publishes = [](const Topic& topic, std::uint64_t client) {
    return std::any_of(topic.publishers.begin(), topic.publishers.end(),
                       [&](const Endpoint& publisher) { return publisher.facts.client == client; });
  };
  for (const auto& [index, own] : look.system.topics) {
    if (own.name != report.topic || own.facts.domain != report.domain) continue;
    for (const auto& [client, process] : look.system.processes) {
      if (!publishes(own, client)) continue;
      for (const auto& [other_index, other] : look.system.topics) {
        if (other_index == index || !publishes(other, client)) continue;
        const auto access = look.observer.access(other.facts.domain, other.name);
        if (!access) return tl::unexpected(access.error());
        Allowed subscribe = allowed_by(access->subscribe);
        if (!subscribe.same_as(report.subscribe))
          all.push_back({other.name, other.facts.domain, process.facts.pid, std::move(subscribe)});
      }
    }
  }
  return all;
}

}  // namespace

Outcome<void> show_access(const Arguments& arguments, Console& console) {
  const std::string topic = fully_qualified(arguments.subject(0));
  if (const auto wrong = check_topic_name(topic))
    return problem(Status::wrong_usage, in_quotes(topic), wrong->text(),
                   "agnocast-ctl access --help");
  auto user = arguments.has(options::user) ? user_named(arguments.text(options::user))
                                           : Outcome<User>(this_user());
  if (!user) return tl::unexpected(user.error());
  auto look = look_at(arguments.socket);
  if (!look) return tl::unexpected(look.error());
  const auto access = look->observer.access(arguments.domain, topic);
  if (!access) return tl::unexpected(access.error());
  Report report;
  report.topic = topic;
  report.domain = arguments.domain;
  report.publish = allowed_by(access->publish);
  report.subscribe = allowed_by(access->subscribe);
  auto beside = topics_beside(*look, report);
  if (!beside) return tl::unexpected(beside.error());
  report.beside = std::move(*beside);
  report.socket_path = arguments.socket;
  report.socket = SocketFile::at(arguments.socket);
  report.user = std::move(*user);
  report.quota = look->system.daemon.quota;
  for (const wire::DumpUser& one : look->system.users) {
    if (one.uid == report.user.who.id.value_or(0)) report.used = one.use;
  }
  report.used.publishers_per_topic = report.used.subscriptions_per_topic = 0;
  for (const auto& [index, one] : look->system.topics) {
    if (one.name != topic || one.facts.domain != arguments.domain) continue;
    report.used.publishers_per_topic = endpoints_of_user(*look, one.publishers, report.user);
    report.used.subscriptions_per_topic = endpoints_of_user(*look, one.subscriptions, report.user);
  }
  if (arguments.json == Json::no) {
    print(report, console);
  } else {
    console.object(object_of(report), arguments.json);
  }
  return {};
}

}  // namespace agnocast::ctl
