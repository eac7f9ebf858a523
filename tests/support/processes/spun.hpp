// SPDX-License-Identifier: Apache-2.0
//
// Spun: a node whose callbacks a background executor runs, for tests that wait in their own thread.
#pragma once

#include <agnocast/executor.hpp>

#include <utility>

namespace agnocast::test {

template <class Node>
class Spun : public Node {
 public:
  template <class... Arguments>
  explicit Spun(Arguments&&... arguments) : Node{std::forward<Arguments>(arguments)...} {
    executor_.add_node(static_cast<Node&>(*this));
  }

 private:
  BackgroundExecutor executor_;
};

}  // namespace agnocast::test
