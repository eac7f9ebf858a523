// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <agnocast/message_filters/message_event.hpp>

#include <message_filters/connection.h>
#include <message_filters/simple_filter.h>

#include <functional>
#include <type_traits>
#include <utility>

namespace agnocast::message_filters {

using ::message_filters::Connection;

/// Base of the filters that pass messages of one type on. Callbacks take
/// `const ipc_shared_ptr<const M>&` or `const MessageEvent<const M>&`.
template <class M>
class SimpleFilter : public ::message_filters::SimpleFilter<M> {
  using Upstream = ::message_filters::SimpleFilter<M>;

 public:
  using MConstPtr = ipc_shared_ptr<const M>;
  using EventType = MessageEvent<const M>;
  using Callback = std::function<void(const MConstPtr&)>;
  using EventCallback = std::function<void(const EventType&)>;

  template <class C>
  Connection registerCallback(const C& callback) {
    using UpstreamEvent = detail::UpstreamEvent<M>;
    constexpr bool takes_message = std::is_invocable_v<const C&, const MConstPtr&>;
    constexpr bool takes_event = std::is_invocable_v<const C&, const EventType&>;
    static_assert(
        takes_message || takes_event || std::is_invocable_v<const C&, const UpstreamEvent&>,
        "agnocast: a filter's callback takes const agnocast::ipc_shared_ptr<const M>& or "
        "const agnocast::message_filters::MessageEvent<const M>&");
    if constexpr (takes_message || takes_event) {
      return Upstream::registerCallback(
          std::function<void(const UpstreamEvent&)>([callback](const UpstreamEvent& event) {
            if constexpr (takes_message) {
              callback(detail::from_upstream<M>(event).getMessage());
            } else {
              callback(detail::from_upstream<M>(event));
            }
          }));
    } else {
      return Upstream::registerCallback(std::function<void(const UpstreamEvent&)>(callback));
    }
  }
  template <class T, class P>
  Connection registerCallback(void (T::*callback)(P), T* object) {
    return registerCallback(std::function<void(P)>(
        [callback, object](P given) { (object->*callback)(std::forward<P>(given)); }));
  }

 protected:
  void signalMessage(const MConstPtr& message) { signalMessage(EventType(message)); }
  void signalMessage(const EventType& event) {
    Upstream::signalMessage(detail::to_upstream<M>(event));
  }
};

}  // namespace agnocast::message_filters
