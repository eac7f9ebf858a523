// SPDX-License-Identifier: Apache-2.0

#include <daemon/config/toml_reading.hpp>

#include <base/text/text.hpp>

#include <charconv>
#include <cstdint>

namespace agnocast::daemon {
namespace {

constexpr std::string_view principal_examples =
    "\"user:NAME\", \"group:NAME\", \"uid:1000\", \"gid:1000\" or \"*\"";

std::string joined(std::span<const std::string_view> words) {
  std::string text;
  for (const std::string_view word : words) {
    if (!text.empty()) text += ", ";
    text += word;
  }
  return text;
}

std::string_view type_name(toml::node_type type) {
  switch (type) {
    case toml::node_type::table:
      return "a table";
    case toml::node_type::array:
      return "a list";
    case toml::node_type::string:
      return "a string";
    case toml::node_type::integer:
      return "an integer";
    case toml::node_type::floating_point:
      return "a number with a fraction";
    case toml::node_type::boolean:
      return "true or false";
    default:
      return "a date or time";
  }
}

}  // namespace

void TomlReading::wrong_type(const toml::node& node, const std::string& key,
                             std::string_view expected) {
  report(node.source().begin, key, std::string(type_name(node.type())) + " is not allowed here",
         "write " + std::string(expected));
}

void TomlReading::unknown(const toml::key& key, const std::string& full,
                          std::span<const std::string_view> known) {
  const std::string_view meant = nearest(key.str(), known);
  report(key.source().begin, full, "unknown key",
         meant.empty() ? "known here: " + joined(known)
                       : "did you mean \"" + std::string(meant) + "\"?");
}

std::vector<const toml::table*> TomlReading::tables(const toml::node& node,
                                                    const std::string& section) {
  const std::string expected = "each rule as a table: [[" + section + "]]";
  std::vector<const toml::table*> all;
  const toml::array* const list = node.as_array();
  if (list == nullptr) {
    wrong_type(node, section, expected);
    return all;
  }
  for (const toml::node& element : *list) {
    const toml::table* const table = element.as_table();
    if (table == nullptr) {
      wrong_type(element, section, expected);
    } else {
      all.push_back(table);
    }
  }
  return all;
}

Principals TomlReading::principals(const toml::node& node, const std::string& key) {
  Principals who;
  const toml::array* const list = node.as_array();
  if (list == nullptr) {
    wrong_type(node, key, "a list: [" + std::string(principal_examples) + "]");
    return who;
  }
  for (const toml::node& element : *list) {
    const auto* const text = element.as_string();
    if (text == nullptr) {
      wrong_type(element, key, "strings: " + std::string(principal_examples));
    } else if (read_principal(element.source().begin, key, text->get(), who)) {
      who.written.push_back(text->get());
    }
  }
  return who;
}

bool TomlReading::read_principal(const Place& place, const std::string& key,
                                 const std::string& text, Principals& who) {
  if (text == "*") {
    who.everybody = true;
    return true;
  }
  const std::size_t colon = text.find(':');
  const std::string kind = text.substr(0, colon == std::string::npos ? 0 : colon);
  const std::string name = colon == std::string::npos ? text : text.substr(colon + 1);
  if (kind == "uid" || kind == "gid") {
    std::uint32_t number = 0;
    const auto end = name.data() + name.size();
    const auto parsed = std::from_chars(name.data(), end, number);
    // The kernel's calls use the largest number for "no user".
    if (parsed.ec == std::errc() && parsed.ptr == end && !name.empty() && number != UINT32_MAX) {
      kind == "uid" ? who.uids.push_back(number) : who.gids.push_back(number);
      return true;
    }
    report(place, key,
           in_quotes(text) + " is not the id of a " + (kind == "uid" ? "user" : "group"),
           "use 0 to 4294967294");
    return false;
  }
  if (kind == "user") {
    if (const auto uid = names_.user(name)) {
      who.uids.push_back(*uid);
      return true;
    }
    report(place, key, "there is no user " + in_quotes(name),
           "correct the name, or use uid:NUMBER");
    return false;
  }
  if (kind == "group") {
    if (const auto gid = names_.group(name)) {
      who.gids.push_back(*gid);
      return true;
    }
    report(place, key, "there is no group " + in_quotes(name),
           "correct the name, or use gid:NUMBER");
    return false;
  }
  report(place, key, in_quotes(text) + " names no user or group",
         "write " + std::string(principal_examples));
  return false;
}

}  // namespace agnocast::daemon
