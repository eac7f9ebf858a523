// SPDX-License-Identifier: Apache-2.0

#include <base/text/names.hpp>
#include <base/text/text.hpp>
#include <client/node/arguments.hpp>

#include <algorithm>
#include <array>
#include <cstddef>
#include <mutex>
#include <optional>
#include <string_view>
#include <utility>

namespace agnocast {
namespace {

enum class Option { none, remap, ignored_with_value, ignored };

constexpr std::array remap_options{std::string_view("-r"), std::string_view("--remap")};
constexpr std::array ignored_with_value{
    std::string_view("-p"),           std::string_view("--param"),
    std::string_view("-e"),           std::string_view("--enclave"),
    std::string_view("--log-level"),  std::string_view("--log-config-file"),
    std::string_view("--params-file")};
constexpr std::array ignored{std::string_view("--enable-rosout-logs"),
                             std::string_view("--disable-rosout-logs"),
                             std::string_view("--enable-stdout-logs"),
                             std::string_view("--disable-stdout-logs"),
                             std::string_view("--enable-external-lib-logs"),
                             std::string_view("--disable-external-lib-logs")};

template <class Names>
bool is_one_of(const Names& names, std::string_view argument) noexcept {
  return std::find(names.begin(), names.end(), argument) != names.end();
}

Option option_of(std::string_view argument) noexcept {
  if (is_one_of(remap_options, argument)) return Option::remap;
  if (is_one_of(ignored_with_value, argument)) return Option::ignored_with_value;
  if (is_one_of(ignored, argument)) return Option::ignored;
  return Option::none;
}

tl::unexpected<Failure> wrong(Errc code, const std::string& argument, const std::string& why) {
  return fail_with(code, in_quotes(argument) + ": " + why);
}

/// Checks a topic name of any node in any form.
std::optional<NameProblem> check_unexpanded(const std::string& name) {
  const auto expanded = expand_topic_name(name, "n", "/");
  if (expanded) return std::nullopt;
  return expanded.error();
}

bool cut_prefix(std::string& text, std::string_view prefix) {
  if (text.compare(0, prefix.size(), prefix) != 0) return false;
  text.erase(0, prefix.size());
  return true;
}

Result<void> add_rule(const std::string& argument, std::vector<RemapRule>& rules) {
  constexpr std::string_view arrow = ":=";
  const std::size_t middle = argument.find(arrow);
  if (middle == std::string::npos || middle == 0 || middle + arrow.size() == argument.size())
    return wrong(Errc::invalid_argument, argument, "a remap rule is from:=to");
  RemapRule rule;
  rule.from = argument.substr(0, middle);
  rule.to = argument.substr(middle + arrow.size());
  const std::size_t colon = rule.from.find(':');
  if (colon != std::string::npos && rule.from.compare(colon, 3, "://") != 0) {
    rule.node = rule.from.substr(0, colon);
    rule.from.erase(0, colon + 1);
    if (const auto problem = check_node_name(rule.node))
      return wrong(Errc::invalid_name, argument, "node: " + problem->text());
  }
  std::optional<NameProblem> problem;
  if (rule.from == "__node" || rule.from == "__name") {
    rule.kind = RemapRule::Kind::node_name;
    problem = check_node_name(rule.to);
  } else if (rule.from == "__ns") {
    rule.kind = RemapRule::Kind::node_namespace;
    if (rule.to.front() != '/') rule.to.insert(0, 1, '/');
    problem = check_namespace(rule.to);
  } else {
    if (cut_prefix(rule.from, "rostopic://")) rule.kind = RemapRule::Kind::topic;
    if (cut_prefix(rule.from, "rosservice://")) rule.kind = RemapRule::Kind::service;
    if (const auto left = check_unexpanded(rule.from))
      return wrong(Errc::invalid_name, argument, "left side: " + left->text());
    problem = check_unexpanded(rule.to);
  }
  if (problem) return wrong(Errc::invalid_name, argument, "right side: " + problem->text());
  rules.push_back(std::move(rule));
  return {};
}

struct Global {
  std::mutex mutex;
  Arguments arguments;
};
Global& global() {
  static Global* const all = new Global;  // static nodes may be made at any time
  return *all;
}

}  // namespace

Result<Arguments> parse_arguments(const std::vector<std::string>& arguments) {
  Arguments parsed;
  bool for_ros = false;
  for (std::size_t i = 0; i < arguments.size(); ++i) {
    const std::string& argument = arguments[i];
    if (argument == "--ros-args") {
      for_ros = true;
      continue;
    }
    if (!for_ros) {
      parsed.others.push_back(argument);
      continue;
    }
    if (argument == "--") {
      for_ros = false;
      continue;
    }
    const Option option = option_of(argument);
    if (option == Option::none)
      return wrong(Errc::invalid_argument, argument, "not an option of --ros-args");
    if (option == Option::ignored) {
      parsed.ignored.push_back(argument);
      continue;
    }
    if (++i == arguments.size())
      return wrong(Errc::invalid_argument, argument, "its value is missing");
    if (option == Option::ignored_with_value) {
      parsed.ignored.push_back(argument + ' ' + arguments[i]);
      continue;
    }
    if (Result<void> added = add_rule(arguments[i], parsed.rules); !added)
      return tl::unexpected<Failure>(added.error());
  }
  return parsed;
}

void set_global_arguments(Arguments arguments) {
  const std::lock_guard lock(global().mutex);
  global().arguments = std::move(arguments);
}

Arguments global_arguments() {
  const std::lock_guard lock(global().mutex);
  return global().arguments;
}

const RemapRule* find_rule(const std::vector<RemapRule>& rules, RemapRule::Kind kind,
                           const std::string& node) noexcept {
  const auto found = std::find_if(rules.begin(), rules.end(), [&](const RemapRule& rule) {
    return rule.kind == kind && (rule.node.empty() || rule.node == node);
  });
  return found != rules.end() ? &*found : nullptr;
}

Result<std::string> remap(const std::vector<RemapRule>& rules, RemapRule::Kind kind,
                          const std::string& name, const std::string& node_name,
                          const std::string& node_namespace) {
  for (const RemapRule& rule : rules) {
    if ((rule.kind != RemapRule::Kind::name && rule.kind != kind) ||
        (!rule.node.empty() && rule.node != node_name))
      continue;
    const auto from = expand_topic_name(rule.from, node_name, node_namespace);
    if (!from || *from != name) continue;
    auto to = expand_topic_name(rule.to, node_name, node_namespace);
    if (!to) return wrong(Errc::invalid_name, rule.to, to.error().text());
    return std::move(*to);
  }
  return name;
}

}  // namespace agnocast
