// SPDX-License-Identifier: Apache-2.0
//
// How messages pass the filters of upstream's package message_filters, on which those of this
// package are built: as a std::shared_ptr whose deleter keeps the ipc_shared_ptr.
#pragma once

#include <agnocastlib/core.hpp>

#include <message_filters/message_event.h>
#include <rclcpp/time.hpp>

#include <memory>
#include <type_traits>
#include <utility>

namespace agnocast::message_filters {

/// A received message and when it came. Plain data.
template <class M>
class MessageEvent {
  static_assert(std::is_const_v<M>,
                "agnocast: received messages are read-only: use MessageEvent<const M>");

 public:
  using ConstMessage = M;
  using Message = std::remove_const_t<M>;
  using ConstMessagePtr = ipc_shared_ptr<M>;

  MessageEvent() = default;
  explicit MessageEvent(ConstMessagePtr message)
      : MessageEvent(std::move(message), rclcpp::Clock().now()) {}
  MessageEvent(ConstMessagePtr message, rclcpp::Time receipt_time)
      : message_(std::move(message)), receipt_time_(std::move(receipt_time)) {}

  const ConstMessagePtr& getMessage() const { return message_; }
  const ConstMessagePtr& getConstMessage() const { return message_; }
  rclcpp::Time getReceiptTime() const { return receipt_time_; }

  friend bool operator<(const MessageEvent& a, const MessageEvent& b) {
    if (a.message_.get() != b.message_.get()) return a.message_.get() < b.message_.get();
    return a.receipt_time_ < b.receipt_time_;
  }
  friend bool operator==(const MessageEvent& a, const MessageEvent& b) {
    return a.message_.get() == b.message_.get() && a.receipt_time_ == b.receipt_time_;
  }
  friend bool operator!=(const MessageEvent& a, const MessageEvent& b) { return !(a == b); }

 private:
  ConstMessagePtr message_;
  rclcpp::Time receipt_time_;
};

namespace detail {

template <class M>
using UpstreamEvent = ::message_filters::MessageEvent<const M>;

template <class M>
struct HoldMessage {
  ipc_shared_ptr<const M> held;
  void operator()(const M*) noexcept { held.reset(); }
};

template <class M>
UpstreamEvent<M> to_upstream(const MessageEvent<const M>& event) {
  const M* const message = event.getMessage().get();
  return UpstreamEvent<M>(std::shared_ptr<const M>(message, HoldMessage<M>{event.getMessage()}),
                          event.getReceiptTime());
}
/// Empty for the event of an input that is not used, or of a filter of upstream's.
template <class M>
MessageEvent<const M> from_upstream(const UpstreamEvent<M>& event) {
  const auto* const hold = std::get_deleter<HoldMessage<M>>(event.getConstMessage());
  if (hold == nullptr) return {};
  return MessageEvent<const M>(hold->held, event.getReceiptTime());
}

}  // namespace detail
}  // namespace agnocast::message_filters
