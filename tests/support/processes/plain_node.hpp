// SPDX-License-Identifier: Apache-2.0
//
// A node with the members that create_publisher needs and no other, and a bounded wait, for tests
// of the public interface.
#pragma once

#include <chrono>
#include <thread>

namespace agnocast::test {

struct PlainNode {
  const char* get_name() const { return "node"; }
  const char* get_namespace() const { return "/ns"; }
  const char* get_fully_qualified_name() const { return "/ns/node"; }
};

/// Returns the next message, or none after five minutes, which only a test that fails takes.
template <class SubscriptionPointer>
auto take_soon(const SubscriptionPointer& subscription) {
  const auto end = std::chrono::steady_clock::now() + std::chrono::minutes(5);
  for (;;) {
    auto message = subscription->take();
    if (message || std::chrono::steady_clock::now() > end) return message;
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
}

}  // namespace agnocast::test
