// SPDX-License-Identifier: Apache-2.0

#include <config/mistakes.hpp>

#include <base/text/text.hpp>

#include <algorithm>

namespace agnocast::config {
namespace {

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

void Mistakes::report(const toml::source_position& place, std::string key, std::string what,
                      std::string remedy) {
  list_.push_back({file_, static_cast<std::uint32_t>(place.line),
                   static_cast<std::uint32_t>(place.column), std::move(key), std::move(what),
                   std::move(remedy)});
}

std::vector<Mistake> Mistakes::take() {
  std::stable_sort(list_.begin(), list_.end(), [](const Mistake& a, const Mistake& b) {
    return std::pair(a.line, a.column) < std::pair(b.line, b.column);
  });
  return std::exchange(list_, {});
}

void Mistakes::wrong_type(const toml::node& node, const std::string& key,
                          std::string_view expected) {
  report(node.source().begin, key, std::string(type_name(node.type())) + " is not allowed here",
         "write " + std::string(expected));
}

void Mistakes::unknown(const toml::key& key, const std::string& full,
                       std::span<const std::string_view> known) {
  const std::string_view meant = nearest(key.str(), known);
  report(key.source().begin, full, "unknown key",
         meant.empty() ? "known here: " + joined(known)
                       : "did you mean \"" + std::string(meant) + "\"?");
}

std::vector<const toml::table*> Mistakes::tables(const toml::node& node,
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

}  // namespace agnocast::config
