// SPDX-License-Identifier: Apache-2.0

#include <base/sockets/unix_address.hpp>
#include <daemon/config/config_keys.hpp>
#include <daemon/config/scheduling_text.hpp>

#include <charconv>
#include <utility>

namespace agnocast::daemon {
namespace config_keys {
namespace {

constexpr std::uint64_t granule = abi::window_granule_bytes;
constexpr std::uint64_t mib = std::uint64_t{1} << 20;
constexpr std::uint64_t tib = std::uint64_t{1} << 40;
// Room for the name of a doorbell below it, with the usual name of the socket: "/agnocastd.sock",
// ".bells", "/2047.31". Listener checks the exact length.
constexpr std::size_t runtime_directory_bytes_max = socket_path_bytes_max - (15 + 6 + 8);

#define AGNOCAST_NUMBER(field)                                                   \
  [](const Config& config) { return static_cast<std::uint64_t>(config.field); }, \
      [](Config& config, std::uint64_t value) {                                  \
        config.field = static_cast<decltype(config.field)>(value);               \
      },                                                                         \
      nullptr, nullptr
#define AGNOCAST_TEXT(field) \
  nullptr, nullptr, [](Config& config) -> std::string& { return config.field; }, nullptr
#define AGNOCAST_TOPICS(field) \
  nullptr, nullptr, nullptr,   \
      [](Config& config) -> std::vector<std::string>& { return config.field; }

constexpr std::uint64_t many = std::uint64_t{1} << 32;  // beyond real values; sums fit
// The daemon looks through the list for each new topic.
constexpr std::uint64_t wide_topics_max = 256;

constexpr Key keys[] = {
    {"daemon", "socket", Kind::path, 0, socket_path_bytes_max, 0, "auto", 0,
     AGNOCAST_TEXT(daemon.socket),
     "where clients connect; auto: /run/agnocast/agnocastd.sock for root, "
     "$XDG_RUNTIME_DIR/agnocast/agnocastd.sock for other users"},
    {"daemon", "runtime_directory", Kind::path, 0, runtime_directory_bytes_max, 0, "auto", 0,
     AGNOCAST_TEXT(daemon.runtime_directory),
     "directory of the doorbells; auto: the directory of the socket"},
    {"daemon", "socket_mode", Kind::mode, 0600, 0777, 0, "", 0, AGNOCAST_NUMBER(daemon.socket_mode),
     "permissions to connect, as for chmod"},
    {"daemon", "socket_group", Kind::group, 0, 0, 0, "auto", 0, AGNOCAST_TEXT(daemon.socket_group),
     "group of the socket; auto: agnocast if that group exists"},
    {"daemon", "log_level", Kind::level, 0, 0, 0, "", 0, AGNOCAST_NUMBER(daemon.log_level),
     "error, warning, notice, info or debug"},
    {"daemon", "watchdog_seconds", Kind::count, 1, 3600, 0, "off", 0,
     AGNOCAST_NUMBER(daemon.watchdog_seconds),
     "without systemd: the supervisor kills and restarts a daemon whose loop has not run for so "
     "long"},

    {"heap", "window_bytes", Kind::bytes, 64 * mib, 16 * tib, granule, "auto", 0,
     AGNOCAST_NUMBER(heap.window_bytes),
     "addresses of one heap window (memory only as it is used); auto: 16GiB, at most a quarter of "
     "the memory"},
    {"heap", "windows_per_process", Kind::count, 1, abi::window_count_max, 0, "", 0,
     AGNOCAST_NUMBER(heap.windows_per_process),
     "heap windows of one process, the first one included"},
    // Programs that are not position-independent lie below 4 GiB; no machine has more than 2^56.
    {"heap", "arena_base", Kind::bytes, std::uint64_t{1} << 32, std::uint64_t{1} << 56, granule,
     "auto", 0, AGNOCAST_NUMBER(heap.arena_base),
     "start of the range of all windows, the same in every client; auto: from the address bits"},
    {"heap", "arena_bytes", Kind::bytes, 64 * mib, std::uint64_t{1} << 55, granule, "auto", 0,
     AGNOCAST_NUMBER(heap.arena_bytes), "length of that range; auto: from the address bits"},

    {"limits", "depth_max", Kind::count, 1, abi::depth_max, 0, "", 0,
     AGNOCAST_NUMBER(limits.depth_max), "deepest history of a publisher or subscription"},
    {"limits", "slots_per_publisher", Kind::count, 2, abi::slot_count_max, 0, "", 0,
     AGNOCAST_NUMBER(limits.slots_per_publisher),
     "messages of one publisher that exist at once, held ones included; more than depth_max"},
    {"limits", "clients", Kind::count, 1, abi::client_count_max, 0, "", 0,
     AGNOCAST_NUMBER(limits.clients), "processes"},
    {"limits", "topics", Kind::count, 1, abi::topic_count_max, 0, "", 0,
     AGNOCAST_NUMBER(limits.topics), "topics of all domains"},
    {"limits", "publishers_per_topic", Kind::count, 1, abi::publisher_count_max, 0, "", 0,
     AGNOCAST_NUMBER(limits.publishers_per_topic), "256 at most, except for wide topics"},
    {"limits", "subscriptions_per_topic", Kind::count, 1, abi::subscription_count_max, 0, "", 0,
     AGNOCAST_NUMBER(limits.subscriptions_per_topic), ""},
    {"limits", "wide_topics", Kind::topics, 0, wide_topics_max, 0, "", 0,
     AGNOCAST_TOPICS(limits.wide_topics),
     "topics with so many nodes that each of their subscriptions takes 1.1 MiB of addresses, not "
     "148 KiB"},

    {"quota", "clients", Kind::count, 1, many, 0, "unlimited", unlimited,
     AGNOCAST_NUMBER(quota.clients), "processes of one user"},
    {"quota", "topics", Kind::count, 1, many, 0, "unlimited", unlimited,
     AGNOCAST_NUMBER(quota.topics), "topics in which one user has publishers or subscriptions"},
    {"quota", "publishers", Kind::count, 0, many, 0, "unlimited", unlimited,
     AGNOCAST_NUMBER(quota.publishers), ""},
    {"quota", "subscriptions", Kind::count, 0, many, 0, "unlimited", unlimited,
     AGNOCAST_NUMBER(quota.subscriptions), ""},
    {"quota", "publishers_per_topic", Kind::count, 1, many, 0, "auto", 0,
     AGNOCAST_NUMBER(quota.publishers_per_topic),
     "publishers of one user in one topic; auto: three quarters of its places, or unlimited",
     "unlimited", unlimited},
    {"quota", "subscriptions_per_topic", Kind::count, 1, many, 0, "auto", 0,
     AGNOCAST_NUMBER(quota.subscriptions_per_topic), "the same for subscriptions", "unlimited",
     unlimited},
    {"quota", "heap_bytes", Kind::bytes, 64 * mib, std::uint64_t{1} << 55, 0, "auto", 0,
     AGNOCAST_NUMBER(quota.heap_bytes),
     "total length of the heap windows of one user; auto: three quarters of the arena, or "
     "unlimited",
     "unlimited", unlimited},
    {"quota", "held_messages", Kind::count, 1, many, 0, "unlimited", unlimited,
     AGNOCAST_NUMBER(quota.held_messages),
     "total of the messages that the subscriptions of one user may hold"},
    {"quota", "wait_sets", Kind::count, 1, many, 0, "unlimited", unlimited,
     AGNOCAST_NUMBER(quota.wait_sets),
     "wait sets of one user, where subscriptions sleep: one for each callback group, of which a "
     "process shares at most 48, and one for all subscriptions of a process without callbacks; "
     "each costs the daemon three descriptors"},
    {"quota", "callback_groups", Kind::count, 0, many, 0, "unlimited", unlimited,
     AGNOCAST_NUMBER(quota.callback_groups),
     "callback groups of one user that agnocastd knows, for thread rules and agnocast-ctl thread "
     "list"},
    {"quota", "callback_threads", Kind::count, 0, many, 0, "unlimited", unlimited,
     AGNOCAST_NUMBER(quota.callback_threads), "likewise threads that run callbacks"},
    {"quota", "queued_bytes", Kind::bytes, 1 * mib, std::uint64_t{1} << 40, 0, "unlimited",
     unlimited, AGNOCAST_NUMBER(quota.queued_bytes),
     "packets queued for processes of one user that do not read; beyond that, the process with the "
     "longest queue loses its connection"},
    {"quota", "queued_seconds", Kind::count, 1, 86'400, 0, "unlimited", unlimited,
     AGNOCAST_NUMBER(quota.queued_seconds),
     "how long a packet is queued; then the process loses its connection, and gets everything "
     "again when it comes back"},
    {"quota", "dumps_per_second", Kind::count, 1, 1000, 0, "unlimited", unlimited,
     AGNOCAST_NUMBER(quota.dumps_per_second),
     "long answers to observers of one user; further requests wait"},
};

#undef AGNOCAST_NUMBER
#undef AGNOCAST_TEXT
#undef AGNOCAST_TOPICS

}  // namespace

std::span<const Key> all() noexcept { return keys; }

std::vector<std::string_view> names_in(std::string_view section) {
  std::vector<std::string_view> names;
  for (const Key& key : keys) {
    if (key.section == section) names.push_back(key.name);
  }
  return names;
}

}  // namespace config_keys

namespace {

using config_keys::Key;
using config_keys::Kind;

constexpr std::string_view section_meanings[] = {
    "The process itself.", "Shared heaps: addresses that every client reserves.",
    "Limits of the daemon, for all users together.", "Limits for each user (uid)."};

std::string mode_text(std::uint64_t mode) {
  std::string text = "0";
  for (int shift = 6; shift >= 0; shift -= 3)
    text += static_cast<char>('0' + static_cast<char>(mode >> shift & 7));
  return text;
}

// Returns a TOML string; the text is from a checked configuration, so little needs escapes.
std::string toml_string(std::string_view text) {
  std::string result = "\"";
  for (const char c : text) {
    if (c == '"' || c == '\\') result += '\\';
    result += c;
  }
  return result + '"';
}

std::string list_text(const std::vector<std::string>& names) {
  std::string text = "[";
  for (const std::string& name : names) {
    if (text.size() > 1) text += ", ";
    text += toml_string(name);
  }
  return text + ']';
}

std::string value_text(const Key& key, const Config& config) {
  if (key.text != nullptr) {
    Config copy = config;
    const std::string& text = key.text(copy);
    return toml_string(text.empty() ? key.word : std::string_view(text));
  }
  if (key.topics != nullptr) {
    Config copy = config;
    return list_text(key.topics(copy));
  }
  const std::uint64_t value = key.number(config);
  for (const std::string_view word : {key.word, key.other_word}) {
    if (key.number_of_word(word) == value) return toml_string(word);
  }
  switch (key.kind) {
    case Kind::level:
      return toml_string(name_of(static_cast<LogLevel>(value)));
    case Kind::mode:
      return toml_string(mode_text(value));
    case Kind::bytes:
      return toml_string(bytes_text(value));
    default:
      return std::to_string(value);
  }
}

std::string thread_rule_text(const ThreadRule& rule) {
  std::string text = "\n[[thread]]\n";
  const auto add = [&](std::string_view key, const std::string& value) {
    text += std::string(key) + " = " + value + '\n';
  };
  if (rule.process) add("process", toml_string(*rule.process));
  if (rule.node) add("node", toml_string(*rule.node));
  if (rule.group) add("group", toml_string(*rule.group));
  add("users", list_text(rule.users.written));
  const abi::wire::ThreadScheduling& scheduling = rule.scheduling;
  if (scheduling.sets_policy != 0) add("policy", toml_string(policy_name(scheduling.policy)));
  if (scheduling.priority != 0) add("priority", std::to_string(scheduling.priority));
  if (scheduling.sets_nice != 0) add("nice", std::to_string(scheduling.nice));
  if (scheduling.runtime_ns != 0) {
    add("runtime", toml_string(duration_text(scheduling.runtime_ns)));
    add("deadline", toml_string(duration_text(scheduling.deadline_ns)));
    add("period", toml_string(duration_text(scheduling.period_ns)));
  }
  if (scheduling.sets_cpus != 0) add("cpus", toml_string(rule.written_cpus));
  return text;
}

std::string access_text(const Config& config) {
  std::string text =
      "\n# Rules for topics. The first rule that matches the topic and has a list for the action "
      "(publish\n"
      "# or subscribe) decides; without one, every user may. * and ? stand for characters of one "
      "name\n"
      "# between slashes, ** for anything. An empty list means no user. A process may publish only "
      "on\n"
      "# topics with the same subscribers, because they share its memory.\n"
      "#\n"
      "# [[access]]\n"
      "# topic = \"/lidar/**\"\n"
      "# domain = 0                          # ROS_DOMAIN_ID; all domains if left out\n"
      "# publish = [\"user:lidar\", \"uid:1000\"]\n"
      "# subscribe = [\"group:perception\", \"gid:1000\", \"*\"]\n";
  for (const AccessRule& rule : config.access) {
    text += "\n[[access]]\ntopic = " + toml_string(rule.topic) + '\n';
    if (rule.domain) text += "domain = " + std::to_string(*rule.domain) + '\n';
    if (rule.publish) text += "publish = " + list_text(rule.publish->written) + '\n';
    if (rule.subscribe) text += "subscribe = " + list_text(rule.subscribe->written) + '\n';
  }
  return text;
}

std::string threads_text(const Config& config) {
  std::string text =
      "\n# Scheduling of the threads that run callbacks. The first rule that matches a callback "
      "group of the\n"
      "# thread applies, if its list \"users\" has the user of the process. Patterns are as above; "
      "a rule\n"
      "# has at least one of process, node and group, and the others match everything. Processes "
      "choose\n"
      "# their names, so a rule gives its scheduling to whatever these users run.\n"
      "#\n"
      "# [[thread]]\n"
      "# process = \"lidar_*\"               # the first 15 characters of the program's name\n"
      "# node = \"/lidar/**\"                # fully qualified\n"
      "# group = \"points\"                  # the default group of a node is \"default\"\n"
      "# users = [\"user:lidar\", \"uid:1000\"]\n"
      "# policy = \"fifo\"                   # other, fifo, rr, batch, idle or deadline\n"
      "# priority = 40                     # 1 to 99; fifo and rr need it\n"
      "# cpus = \"2-3,6\"                    # not with deadline\n"
      "#\n"
      "# [[thread]]\n"
      "# node = \"/control\"\n"
      "# users = [\"gid:1000\"]\n"
      "# policy = \"deadline\"\n"
      "# runtime = \"2ms\"                   # ns, us, ms or s\n"
      "# deadline = \"5ms\"                  # as period if left out\n"
      "# period = \"10ms\"                   # as deadline if left out\n"
      "#\n"
      "# [[thread]]\n"
      "# node = \"**\"\n"
      "# users = [\"*\"]\n"
      "# nice = 5                          # -20 to 19; with other, batch or no policy\n";
  for (const ThreadRule& rule : config.threads) text += thread_rule_text(rule);
  return text;
}

constexpr std::pair<std::string_view, std::uint64_t> units[] = {{"TiB", std::uint64_t{1} << 40},
                                                                {"GiB", std::uint64_t{1} << 30},
                                                                {"MiB", std::uint64_t{1} << 20},
                                                                {"KiB", std::uint64_t{1} << 10},
                                                                {"B", 1}};

}  // namespace

std::string to_toml(const Config& config) {
  std::string text =
      "# Configuration of agnocastd; every key is optional. agnocastd --check-config finds "
      "mistakes,\n"
      "# agnocastd --print-config prints the effective values.\n";
  std::size_t section = 0;
  std::string_view current;
  for (const Key& key : config_keys::all()) {
    if (key.section != current) {
      current = key.section;
      text +=
          "\n# " + std::string(section_meanings[section++]) + "\n[" + std::string(current) + "]\n";
    }
    if (!key.meaning.empty()) text += "# " + std::string(key.meaning) + '\n';
    text += std::string(key.name) + " = " + value_text(key, config) + '\n';
  }
  return text + access_text(config) + threads_text(config);
}

std::optional<std::uint64_t> parse_bytes(std::string_view text) noexcept {
  std::uint64_t count = 0;
  const char* const end = text.data() + text.size();
  const auto parsed = std::from_chars(text.data(), end, count);
  if (parsed.ec != std::errc()) return std::nullopt;
  std::string_view rest(parsed.ptr, static_cast<std::size_t>(end - parsed.ptr));
  if (rest.starts_with(' ')) rest.remove_prefix(1);
  for (const auto& [unit, bytes] : units) {
    if (rest != unit) continue;
    if (count > std::numeric_limits<std::uint64_t>::max() / bytes) return std::nullopt;
    return count * bytes;
  }
  return std::nullopt;
}

std::string bytes_text(std::uint64_t bytes) {
  for (const auto& [unit, size] : units) {
    if (bytes >= size && bytes % size == 0) return std::to_string(bytes / size) + std::string(unit);
  }
  return "0B";
}

}  // namespace agnocast::daemon
