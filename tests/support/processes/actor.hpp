// SPDX-License-Identifier: Apache-2.0
//
// Shared by the steered actors of the tests: a node for the public interface, and a quality of
// service as text: depth and letters, e.g. 10tba (t transient local, b best effort, a keep-all).
#pragma once

#include <agnocast/qos.hpp>

#include <cstddef>
#include <string>
#include <utility>

namespace agnocast::test {

struct ActorNode {
  explicit ActorNode(std::string name) : name_("/" + std::move(name)) {}
  const char* get_name() const { return name_.c_str() + 1; }
  const char* get_namespace() const { return "/"; }
  const char* get_fully_qualified_name() const { return name_.c_str(); }

 private:
  std::string name_;
};

inline QoS qos_from_letters(const std::string& text) {
  std::size_t end = 0;
  const std::size_t depth = std::stoul(text, &end);
  QoS qos(depth);
  for (const char letter : text.substr(end)) {
    if (letter == 't') qos.transient_local();
    if (letter == 'b') qos.best_effort();
    if (letter == 'a') qos.keep_all(depth);
  }
  return qos;
}

}  // namespace agnocast::test
