// SPDX-License-Identifier: Apache-2.0
//
// How topic names resolve: the untyped half of node_like.hpp.

#include <agnocast/node_like.hpp>
#include <base/names.hpp>
#include <base/text.hpp>

#include <utility>

namespace agnocast::detail {
namespace {

tl::unexpected<Failure> refuse(const std::string& topic, const NameProblem& problem) {
  return fail_with(Errc::invalid_name, "topic " + in_quotes(topic) + ": " + problem.text());
}

}  // namespace

Result<std::string> expand_topic(const std::string& topic, const std::string& node_name,
                                 const std::string& node_namespace) {
  auto expanded = expand_topic_name(topic, node_name, node_namespace);
  if (!expanded) return refuse(topic, expanded.error());
  return std::move(*expanded);
}

Result<void> require_topic(const std::string& topic) {
  if (const auto problem = check_topic_name(topic)) return refuse(topic, *problem);
  return {};
}

}  // namespace agnocast::detail
