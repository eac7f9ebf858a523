// SPDX-License-Identifier: Apache-2.0

#include <daemon/config/toml_reading.hpp>

#include <base/text/text.hpp>

#include <charconv>
#include <cstdint>

namespace agnocast::daemon {
namespace {

constexpr std::string_view principal_examples =
    "\"user:NAME\", \"group:NAME\", \"uid:1000\", \"gid:1000\" or \"*\"";

}  // namespace

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
