// SPDX-License-Identifier: Apache-2.0
//
// Resolves names of topics and services: the untyped half of node_like.hpp.

#include <agnocast/node_like.hpp>
#include <agnocast/service_name.hpp>
#include <base/text/names.hpp>
#include <base/text/text.hpp>

#include <utility>

namespace agnocast::detail {
namespace {

tl::unexpected<Failure> refuse(const char* what, const std::string& name, const std::string& why) {
  return fail_with(Errc::invalid_name, what + (" " + in_quotes(name) + ": " + why));
}

Result<std::string> expand(const char* what, const std::string& name, const std::string& node_name,
                           const std::string& node_namespace) {
  auto expanded = expand_topic_name(name, node_name, node_namespace);
  if (!expanded) return refuse(what, name, expanded.error().text());
  return std::move(*expanded);
}

Result<void> require(const char* what, const std::string& name) {
  if (const auto problem = check_topic_name(name)) return refuse(what, name, problem->text());
  if (is_service_topic(name))
    return refuse(what, name, "names that begin with /_service/ are reserved for services");
  return {};
}

}  // namespace

Result<std::string> expand_topic(const std::string& topic, const std::string& node_name,
                                 const std::string& node_namespace) {
  return expand("topic", topic, node_name, node_namespace);
}
Result<void> require_topic(const std::string& topic) { return require("topic", topic); }

Result<std::string> expand_service(const std::string& service, const std::string& node_name,
                                   const std::string& node_namespace) {
  return expand("service", service, node_name, node_namespace);
}
Result<void> require_service(const std::string& service) {
  if (service.size() > service_name_length_max)
    return refuse("service", service,
                  "the name is longer than " + std::to_string(service_name_length_max) +
                      " characters, and its topics' names would be too long");
  return require("service", service);
}

}  // namespace agnocast::detail
