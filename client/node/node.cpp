// SPDX-License-Identifier: Apache-2.0

#include <agnocast/node.hpp>
#include <base/text/names.hpp>
#include <base/text/text.hpp>
#include <client/node/arguments.hpp>

#include <cstdio>
#include <iterator>
#include <mutex>
#include <set>
#include <utility>

namespace agnocast {
namespace {

Arguments parse_or_throw(const std::vector<std::string>& arguments) {
  Result<Arguments> parsed = parse_arguments(arguments);
  if (!parsed) throw Error(parsed.error());
  return std::move(*parsed);
}

// A user who passes a parameter file expects an effect, and may not know that there is none: an
// error would keep launch files from starting the program, and silence would hide the fact.
void warn_of(const Arguments& arguments) {
  static std::mutex mutex;
  static std::set<std::string>* const said =
      new std::set<std::string>;  // init() may be called at exit
  std::string program = arguments.others.empty() ? std::string() : arguments.others.front();
  program.erase(0, program.rfind('/') + 1);
  const std::lock_guard lock(mutex);
  for (const std::string& argument : arguments.ignored) {
    if (!said->insert(argument).second) continue;
    std::fprintf(stderr, "%s: warning: %s: this argument has no effect\n", program.c_str(),
                 argument.c_str());
  }
}

void require(const std::optional<NameProblem>& problem, const char* what, const std::string& name) {
  if (!problem) return;
  const std::string text = std::string(what) + " " + in_quotes(name) + ": " + problem->text();
  throw Error(failure_with(Errc::invalid_name, text.c_str()));
}

}  // namespace

void core::init(int argc, char const* const* argv, const InitOptions& options) {
  Arguments arguments = parse_or_throw({argv, argv + argc});
  if (options.warns_of_ignored_arguments()) warn_of(arguments);
  set_global_arguments(std::move(arguments));
}

std::vector<std::string> core::remove_ros_arguments(int argc, char const* const* argv) {
  return parse_or_throw({argv, argv + argc}).others;
}

std::vector<std::string> core::ignored_ros_arguments(int argc, char const* const* argv) {
  return parse_or_throw({argv, argv + argc}).ignored;
}

struct Node::Names {
  std::string name, node_namespace, full;
  std::vector<RemapRule> rules;
  std::vector<std::string> ignored;
};

Node::Node(const std::string& name, const NodeOptions& options) : Node(name, "", options) {}

Node::Node(const std::string& name, const std::string& node_namespace, const NodeOptions& options) {
  auto names = std::make_shared<Names>();
  Arguments own = parse_or_throw(options.arguments());
  names->rules = std::move(own.rules);
  names->ignored = std::move(own.ignored);
  if (options.use_global_arguments()) {
    Arguments all = global_arguments();
    const auto append = [](auto& to, auto& from) {
      to.insert(to.end(), std::make_move_iterator(from.begin()),
                std::make_move_iterator(from.end()));
    };
    append(names->rules, all.rules);
    append(names->ignored, all.ignored);
  }
  require(check_node_name(name), "node name", name);
  names->name = name;
  if (const RemapRule* rule = find_rule(names->rules, RemapRule::Kind::node_name, name))
    names->name = rule->to;
  names->node_namespace = node_namespace.empty() || node_namespace.front() != '/'
                              ? "/" + node_namespace
                              : node_namespace;
  require(check_namespace(names->node_namespace), "namespace", names->node_namespace);
  if (const RemapRule* rule = find_rule(names->rules, RemapRule::Kind::node_namespace, names->name))
    names->node_namespace = rule->to;
  names->full = (names->node_namespace == "/" ? "" : names->node_namespace) + "/" + names->name;
  require(check_topic_name(names->full), "node", names->full);  // together they may be too long
  names_ = std::move(names);
}

Node::~Node() = default;

const char* Node::get_name() const noexcept { return names_->name.c_str(); }
const char* Node::get_namespace() const noexcept { return names_->node_namespace.c_str(); }
const char* Node::get_fully_qualified_name() const noexcept { return names_->full.c_str(); }
const std::vector<std::string>& Node::ignored_arguments() const noexcept { return names_->ignored; }

Result<std::string> Node::try_resolve_topic_name(const std::string& topic) const {
  Result<std::string> expanded = detail::expand_topic(topic, names_->name, names_->node_namespace);
  if (!expanded) return expanded;
  return remap(names_->rules, RemapRule::Kind::topic, *expanded, names_->name,
               names_->node_namespace);
}

std::string Node::resolve_topic_name(const std::string& topic) const {
  Result<std::string> resolved = try_resolve_topic_name(topic);
  if (!resolved) throw Error(resolved.error());
  return std::move(*resolved);
}

Result<std::string> Node::try_resolve_service_name(const std::string& service) const {
  Result<std::string> expanded =
      detail::expand_service(service, names_->name, names_->node_namespace);
  if (!expanded) return expanded;
  return remap(names_->rules, RemapRule::Kind::service, *expanded, names_->name,
               names_->node_namespace);
}

std::string Node::resolve_service_name(const std::string& service) const {
  Result<std::string> resolved = try_resolve_service_name(service);
  if (!resolved) throw Error(resolved.error());
  return std::move(*resolved);
}

}  // namespace agnocast
