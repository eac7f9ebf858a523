// SPDX-License-Identifier: Apache-2.0

#include <base/text/names.hpp>
#include <base/text/text.hpp>
#include <config/toml_file.hpp>
#include <daemon/config/config_keys.hpp>
#include <daemon/config/rule_reading.hpp>
#include <daemon/config/toml_reading.hpp>
#include <daemon/state/hold_pool.hpp>

#include <grp.h>
#include <pwd.h>

#include <algorithm>
#include <cerrno>
#include <charconv>
#include <cstring>
#include <utility>

namespace agnocast::daemon {
namespace {

using config_keys::Key;
using config_keys::Kind;

constexpr std::string_view sections[] = {"daemon", "heap", "limits", "quota", "access", "thread"};

std::string number_text(const Key& key, std::uint64_t value) {
  return key.kind == Kind::bytes ? bytes_text(value) : std::to_string(value);
}

class Reader {
 public:
  Reader(const std::string& file, const NameLookup& names) : toml_(file, names) {}

  ConfigResult read(const toml::table& root) {
    for (const auto& [key, node] : root) read_section(key, node);
    if (toml_.count() == 0) check_together();
    if (toml_.count() == 0) return std::move(config_);
    return tl::unexpected(toml_.take());
  }

 private:
  void read_section(const toml::key& key, const toml::node& node) {
    const std::string_view name = key.str();
    if (std::find(std::begin(sections), std::end(sections), name) == std::end(sections)) {
      unknown_section(key);
      return;
    }
    if (name == "access") return read_access_rules(toml_, node, config_.access);
    if (name == "thread") return read_thread_rules(toml_, node, config_.threads);
    const toml::table* const table = node.as_table();
    if (table == nullptr) {
      toml_.wrong_type(node, std::string(name), "a section: [" + std::string(name) + "]");
      return;
    }
    for (const auto& [inner, value] : *table) read_key(name, inner, value);
  }

  void unknown_section(const toml::key& key) {
    // Checks first for a key outside of its section, the likelier mistake.
    for (const Key& known : config_keys::all()) {
      if (known.name != key.str()) continue;
      toml_.report(key.source().begin, escaped(key.str()), "is outside of its section",
                   "write it below [" + std::string(known.section) + "]");
      return;
    }
    toml_.unknown(key, escaped(key.str()), sections);
  }

  void read_key(std::string_view section, const toml::key& name, const toml::node& node) {
    for (const Key& key : config_keys::all()) {
      if (key.section != section || key.name != name.str()) continue;
      places_.push_back({&key, node.source().begin});
      if (key.text != nullptr) {
        read_text(key, node);
      } else if (key.topics != nullptr) {
        read_topics(key, node);
      } else {
        read_number(key, node);
      }
      return;
    }
    toml_.unknown(name, std::string(section) + '.' + escaped(name.str()),
                  config_keys::names_in(section));
  }

  void read_topics(const Key& key, const toml::node& node) {
    const auto* const list = node.as_array();
    if (list == nullptr) return toml_.wrong_type(node, key.full(), "a list of topics");
    if (list->size() > key.most)
      return toml_.report(node.source().begin, key.full(),
                          std::to_string(list->size()) + " topics are too many",
                          "name at most " + std::to_string(key.most));
    std::vector<std::string> topics;
    for (const toml::node& one : *list) {
      const auto* const name = one.as_string();
      if (name == nullptr) return toml_.wrong_type(one, key.full(), "the name of a topic");
      if (const auto problem = check_topic_name(name->get()))
        return toml_.report(one.source().begin, key.full(),
                            in_quotes(name->get()) + ": " + problem->text(),
                            "write it as `agnocast-ctl topic list` shows it: \"/rosout\"");
      if (std::find(topics.begin(), topics.end(), name->get()) != topics.end())
        return toml_.report(one.source().begin, key.full(),
                            in_quotes(name->get()) + " is there twice", "remove one");
      topics.push_back(name->get());
    }
    key.topics(config_) = std::move(topics);
  }

  void read_number(const Key& key, const toml::node& node) {
    const Place& place = node.source().begin;
    if (key.kind == Kind::level) {
      const auto* const text = node.as_string();
      if (text == nullptr) {
        toml_.wrong_type(node, key.full(), "one of " + std::string(log_level_names));
      } else if (const auto level = log_level_of(text->get())) {
        key.set_number(config_, static_cast<std::uint64_t>(*level));
      } else {
        toml_.report(place, key.full(), in_quotes(text->get()) + " is not a log level",
                     "use " + std::string(log_level_names));
      }
      return;
    }
    std::uint64_t value = 0;
    std::string written;
    if (const auto* const integer = node.as_integer()) {
      written = std::to_string(integer->get());
      if (integer->get() < 0) return out_of_range(key, place, written);
      value = static_cast<std::uint64_t>(integer->get());
      if (key.kind == Kind::mode && (value < key.least || value > key.most)) {
        toml_.report(place, key.full(), written + " is not a socket mode",
                     "write it octal, with the owner's rights in it: \"0660\" or 0o660");
        return;
      }
    } else if (const auto* const text = node.as_string()) {
      written = in_quotes(text->get());
      if (const auto number = key.number_of_word(text->get())) {
        key.set_number(config_, *number);
        return;
      }
      const auto parsed = number_in(key, text->get());
      if (!parsed) {
        toml_.report(place, key.full(), written + " is not a " + noun_of(key),
                     "write " + form_of(key));
        return;
      }
      value = *parsed;
    } else {
      toml_.wrong_type(node, key.full(), form_of(key));
      return;
    }
    if (value < key.least || value > key.most) return out_of_range(key, place, written);
    if (key.unit != 0 && value % key.unit != 0) {
      toml_.report(place, key.full(), written + " is not a multiple of " + bytes_text(key.unit),
                   "the next ones are " + bytes_text(value / key.unit * key.unit) + " and " +
                       bytes_text((value / key.unit + 1) * key.unit));
      return;
    }
    key.set_number(config_, value);
  }

  static std::optional<std::uint64_t> number_in(const Key& key, std::string_view text) {
    if (key.kind == Kind::bytes) return parse_bytes(text);
    if (key.kind != Kind::mode) return std::nullopt;
    std::uint64_t mode = 0;
    const auto end = text.data() + text.size();
    const auto parsed = std::from_chars(text.data(), end, mode, 8);
    if (text.empty() || parsed.ec != std::errc() || parsed.ptr != end) return std::nullopt;
    if (mode < key.least || mode > key.most) return std::nullopt;
    return mode;
  }
  static std::string noun_of(const Key& key) {
    return key.kind == Kind::bytes ? "size" : key.kind == Kind::mode ? "socket mode" : "number";
  }
  static std::string form_of(const Key& key) {
    std::string form = "an integer";
    if (key.kind == Kind::bytes)
      form = "an integer of bytes, or a size like \"16GiB\" (B, KiB, MiB, GiB, TiB)";
    if (key.kind == Kind::mode) form = "it octal, with the owner's rights in it: \"0660\" or 0o660";
    return form + key.or_words();
  }
  void out_of_range(const Key& key, const Place& place, const std::string& written) {
    const std::string remedy =
        "use " + number_text(key, key.least) + " to " + number_text(key, key.most);
    toml_.report(place, key.full(), written + " is out of range", remedy + key.or_words());
  }

  void read_text(const Key& key, const toml::node& node) {
    const auto* const value = node.as_string();
    if (value == nullptr) {
      toml_.wrong_type(
          node, key.full(),
          key.kind == Kind::path ? "a path, or \"auto\"" : "the name of a group, or \"auto\"");
      return;
    }
    const std::string& text = value->get();
    const Place& place = node.source().begin;
    if (text == key.word) {
      key.text(config_).clear();
      return;
    }
    if (key.kind == Kind::group) {
      if (!toml_.names().group(text)) {
        toml_.report(place, key.full(), "there is no group " + in_quotes(text),
                     "create it (groupadd --system), or use another one");
        return;
      }
    } else if (!check_path(key, place, text)) {
      return;
    }
    key.text(config_) = text;
  }

  bool check_path(const Key& key, const Place& place, const std::string& text) {
    const bool is_printable = std::none_of(text.begin(), text.end(), [](char c) {
      return static_cast<unsigned char>(c) < ' ' || c == 0x7f;
    });
    if (text.empty() || text.front() != '/' || text.back() == '/' || !is_printable) {
      toml_.report(place, key.full(), in_quotes(text) + " is not the absolute path of a file",
                   "start with a slash, end without one, and use no control characters");
      return false;
    }
    if (text.size() > key.most) {
      toml_.report(place, key.full(),
                   "a path of " + std::to_string(text.size()) + " bytes is too long",
                   "use at most " + std::to_string(key.most) + " (the kernel's bound for sockets)");
      return false;
    }
    return true;
  }

  // Conflicts between keys are reported at the place of the key that the file has.

  Place place_of(std::string_view section, std::string_view name) const {
    for (const auto& [key, place] : places_) {
      if (key->section == section && key->name == name) return place;
    }
    return {};
  }
  void conflict(std::string_view section, std::string_view first, std::string_view second,
                std::string what, std::string remedy) {
    Place place = place_of(section, first);
    std::string key = std::string(section) + '.' + std::string(first);
    if (place.line == 0) {
      place = place_of(section, second);
      key = std::string(section) + '.' + std::string(second);
    }
    toml_.report(place, std::move(key), std::move(what), std::move(remedy));
  }

  void check_together() {
    const Config::Limits& limits = config_.limits;
    if (limits.slots_per_publisher <= limits.depth_max) {
      conflict("limits", "slots_per_publisher", "depth_max",
               "slots_per_publisher (" + std::to_string(limits.slots_per_publisher) +
                   ") leaves no room beside a history of depth_max (" +
                   std::to_string(limits.depth_max) + ")",
               "make slots_per_publisher larger than depth_max");
    } else if (const std::uint64_t needed = std::uint64_t{limits.depth_max} + slots_beside_history +
                                            limits.subscriptions_per_topic;
               limits.slots_per_publisher < needed) {
      conflict("limits", "slots_per_publisher", "subscriptions_per_topic",
               "slots_per_publisher (" + std::to_string(limits.slots_per_publisher) +
                   ") leaves no room for a message of each of subscriptions_per_topic (" +
                   std::to_string(limits.subscriptions_per_topic) +
                   ") beside a history of depth_max (" + std::to_string(limits.depth_max) + ")",
               "make it at least " + std::to_string(needed) + ", or one of the others less");
    }
    const Config::Heap& heap = config_.heap;
    if (heap.window_bytes != 0 && heap.arena_bytes != 0 && heap.arena_bytes < heap.window_bytes) {
      conflict("heap", "arena_bytes", "window_bytes",
               "arena_bytes (" + bytes_text(heap.arena_bytes) +
                   ") is less than one window_bytes (" + bytes_text(heap.window_bytes) + ")",
               "use one window for each process at least");
    }
    if (heap.window_bytes != 0 && config_.quota.heap_bytes != 0 &&
        config_.quota.heap_bytes < heap.window_bytes) {
      conflict("quota", "heap_bytes", "heap_bytes",
               "heap_bytes (" + bytes_text(config_.quota.heap_bytes) +
                   ") is less than one window (" + bytes_text(heap.window_bytes) + ")",
               "no process could publish; use a multiple of heap.window_bytes");
    }
  }

  TomlReading toml_;
  Config config_;
  std::vector<std::pair<const Key*, Place>> places_;
};

// Returns line and column (from 1) of a character beyond ASCII outside a comment, or nothing. TOML
// allows them in strings too, but toml++ 3.3 has undefined behaviour for them wherever a space is
// allowed, and no value here needs them (a string may use \uXXXX).
std::optional<std::pair<std::uint32_t, std::uint32_t>> foreign_character(std::string_view text) {
  std::uint32_t line = 1, column = 0;
  char quote = '\0';
  bool comment = false, escaped_one = false;
  for (const char c : text) {
    ++column;
    if (c == '\n') {
      ++line;
      column = 0;
      quote = '\0';
      comment = escaped_one = false;
    } else if (comment) {
      continue;
    } else if ((static_cast<unsigned char>(c) & 0x80) != 0) {
      return std::pair(line, column);
    } else if (escaped_one) {
      escaped_one = false;
    } else if (quote == '\0') {
      comment = c == '#';
      if (c == '"' || c == '\'') quote = c;
    } else if (c == quote) {
      quote = '\0';
    } else {
      escaped_one = quote == '"' && c == '\\';
    }
  }
  return std::nullopt;
}

ConfigResult unreadable(const std::string& file, int error) {
  const char* remedy = "name another file with --config";
  if (error == EACCES || error == EPERM) remedy = "let the user of agnocastd read it";
  return tl::unexpected(std::vector<ConfigError>{
      {file, 0, 0, "", std::string("cannot be read: ") + std::strerror(error), remedy}});
}

}  // namespace

NameLookup NameLookup::system() {
  return {[](const std::string& name) -> std::optional<uid_t> {
            const passwd* const entry = ::getpwnam(name.c_str());
            return entry != nullptr ? std::optional(entry->pw_uid) : std::nullopt;
          },
          [](const std::string& name) -> std::optional<gid_t> {
            const struct ::group* const entry = ::getgrnam(name.c_str());
            return entry != nullptr ? std::optional(entry->gr_gid) : std::nullopt;
          }};
}

ConfigResult parse_config(std::string_view text, const std::string& file, const NameLookup& names) {
  if (const auto place = foreign_character(text))
    return tl::unexpected(std::vector<ConfigError>{{file, place->first, place->second, "",
                                                    "a character that is not ASCII",
                                                    "write it in a comment, or as \\uXXXX"}});
  auto table = config::parse_toml(text, file, "correct the TOML there");
  if (table) return Reader(file, names).read(*table);
  table.error().what = escaped(table.error().what, 400);
  return tl::unexpected(std::vector<ConfigError>{std::move(table.error())});
}

ConfigResult load_config(const std::string& file, const NameLookup& names) {
  const auto text = config::read_file(file);
  return text ? parse_config(*text, file, names) : unreadable(file, text.error());
}

}  // namespace agnocast::daemon
