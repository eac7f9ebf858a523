// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <agnocastlib/endpoints.hpp>
#include <agnocastlib/failure_log.hpp>

#include <rclcpp/rclcpp.hpp>

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <utility>

namespace agnocast {

/// A publisher. Any thread may call any function.
template <class MessageT>
class Publisher : public core::Publisher<MessageT> {
  using Base = core::Publisher<MessageT>;

 public:
  using SharedPtr = std::shared_ptr<Publisher>;

  /// `node`: an rclcpp::Node or an agnocast::Node. Throws Error: daemon_not_running, hook_missing,
  /// type_mismatch, … (agnocast/error.hpp).
  template <class NodeT>
  Publisher(NodeT* node, const std::string& topic_name, const rclcpp::QoS& qos,
            const PublisherOptions& options = {})
      : Base(make(node, topic_name, qos, options)),
        gid_(agnocastlib::gid_of(this->untyped().persistent_id())),
        failures_(node->get_logger(), "publishing on '" + this->untyped().topic() + "'") {}

  /// Publishes a loan of this publisher; every copy of it becomes empty. A failure, after which
  /// the message is dropped, is logged, and so is the loss of agnocastd, without which messages
  /// reach known subscriptions only; try_publish() returns the failure instead.
  void publish(ipc_shared_ptr<MessageT>&& message) noexcept {
    ipc_shared_ptr<MessageT> loan = std::move(message);
    const PublishResult result = Base::publish(std::move(loan));
    loan.reset();  // after a failure; from here on this thread allocates private memory
    if (!result) failures_.report(result.code);
    agnocastlib::report_if_daemon_is_lost();
  }

  /// Returns the number of subscriptions in other processes. agnocast-bridge is one process.
  std::uint32_t get_subscription_count() const {
    const std::size_t all = Base::get_subscription_count(), here = get_intra_subscription_count();
    return static_cast<std::uint32_t>(all > here ? all - here : 0);  // two moments
  }
  /// Returns the number of subscriptions in this process.
  std::uint32_t get_intra_subscription_count() const {
    return static_cast<std::uint32_t>(this->untyped().local_subscription_count());
  }
  /// Unique on this host. Valid as long as the publisher.
  const rmw_gid_t& get_gid() const noexcept { return gid_; }

 private:
  template <class NodeT>
  static Base make(NodeT* node, const std::string& topic, const rclcpp::QoS& qos,
                   const PublisherOptions& options) {
    agnocastlib::refuse_other_system();
    return *core::create_publisher<MessageT>(
        *node, topic, qos, agnocastlib::translate(options, topic, node->get_logger()));
  }

  const rmw_gid_t gid_;
  agnocastlib::FailureLog failures_;
};

}  // namespace agnocast
