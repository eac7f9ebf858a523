// SPDX-License-Identifier: Apache-2.0
//
// Runner: calls the callbacks of one node's subscriptions, one at a time, on a thread of the
// library. It sleeps on the node's bells and costs nothing while nothing comes.
#pragma once

#include <agnocast/subscription.hpp>
#include <client/context.hpp>

#include <memory>
#include <string>
#include <thread>
#include <utility>

namespace agnocast {

class Runner {
 public:
  /// The one of the node with this fully qualified name; made with its first subscription, gone
  /// with its last.
  [[nodiscard]] static Result<std::shared_ptr<Runner>> of_node(const std::string& node);
  ~Runner();
  Runner(const Runner&) = delete;
  Runner& operator=(const Runner&) = delete;

  const std::shared_ptr<Sleeper>& sleeper() const noexcept;
  void add(const std::shared_ptr<SubscriptionEndpoint>& subscription,
           detail::UntypedSubscription::Callback callback);
  /// Afterwards its callback is not running and will not run, unless this is called from inside it.
  void remove(const SubscriptionEndpoint& subscription) noexcept;

 private:
  struct State;  // shared with the thread: the last subscription may go inside its own callback
  explicit Runner(std::shared_ptr<State> state) noexcept : state_(std::move(state)) {}

  std::shared_ptr<State> state_;
  std::thread thread_;
};

/// A received message as a Block, or null when there is none (or no memory for it: then it stays
/// unread).
detail::Block* take_block(SubscriptionEndpoint& subscription) noexcept;

}  // namespace agnocast
