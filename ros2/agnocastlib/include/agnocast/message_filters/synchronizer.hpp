// SPDX-License-Identifier: Apache-2.0
//
// Synchronizer: upstream's, with the filters, pointers and callbacks of this package.
#pragma once

#include <agnocast/message_filters/simple_filter.hpp>

#include <message_filters/null_types.h>
#include <message_filters/synchronizer.h>

#include <cstddef>
#include <functional>
#include <string>
#include <tuple>
#include <type_traits>
#include <utility>

namespace agnocast::message_filters {

using ::message_filters::NullType;

namespace detail {

/// A member function and its object, as something that is called.
template <class C, class T>
struct Bound {
  C callback;
  T* object;
  template <class... Arguments>
  auto operator()(Arguments&&... arguments) const
      -> decltype(std::invoke(callback, object, std::forward<Arguments>(arguments)...)) {
    return std::invoke(callback, object, std::forward<Arguments>(arguments)...);
  }
};

/// Callbacks of an upstream policy, which has nine inputs, `used` of them in use.
template <class Policy>
class Adapter {
  using Messages = typename Policy::Messages;
  template <std::size_t i>
  using Message = std::tuple_element_t<i, Messages>;
  template <std::size_t i>
  using Pointer = const ipc_shared_ptr<const Message<i>>&;
  template <std::size_t i>
  using Event = const MessageEvent<const Message<i>>&;
  static constexpr std::size_t used = Policy::RealTypeCount::value;

 public:
  template <class C>
  static auto adapt(C callback) {
    return adapt(std::move(callback), std::make_index_sequence<9>(),
                 std::make_index_sequence<used>());
  }

 private:
  template <class C, std::size_t... all, std::size_t... of_use>
  static auto adapt(C callback, std::index_sequence<all...>, std::index_sequence<of_use...>) {
    constexpr bool takes_messages = std::is_invocable_v<C&, Pointer<of_use>...>;
    constexpr bool takes_events = std::is_invocable_v<C&, Event<of_use>...>;
    static_assert(
        takes_messages || takes_events,
        "agnocast: a synchronizer's callback takes a const agnocast::ipc_shared_ptr<const "
        "M>& for each input, or a const agnocast::message_filters::MessageEvent<const M>& "
        "for each");
    return std::function<void(const UpstreamEvent<Message<all>>&...)>(
        [callback = std::move(callback)](const UpstreamEvent<Message<all>>&... events) mutable {
          const auto given = std::tie(events...);
          if constexpr (takes_messages) {
            callback(from_upstream<Message<of_use>>(std::get<of_use>(given)).getMessage()...);
          } else {
            callback(from_upstream<Message<of_use>>(std::get<of_use>(given))...);
          }
        });
  }
};

template <class Pointer>
inline constexpr bool is_ipc_pointer = false;
template <class M>
inline constexpr bool is_ipc_pointer<ipc_shared_ptr<M>> = true;
template <class Filter, class = void>
inline constexpr bool is_filter = false;
template <class Filter>
inline constexpr bool is_filter<Filter, std::void_t<typename Filter::MConstPtr>> =
    is_ipc_pointer<typename Filter::MConstPtr>;

}  // namespace detail

/// `Policy` is one of sync_policies. The functions of the policy, such as setAgePenalty(), are
/// those of upstream's. Callbacks run in the callback of the subscription whose message completed
/// the set.
template <class Policy>
class Synchronizer : public ::message_filters::Synchronizer<typename Policy::Upstream> {
  using Base = ::message_filters::Synchronizer<typename Policy::Upstream>;
  using Adapter = detail::Adapter<typename Policy::Upstream>;

 public:
  using typename Base::Messages;

  explicit Synchronizer(const Policy& policy) : Base(policy) {}
  template <class F0, class F1, class... F>
  Synchronizer(const Policy& policy, F0& f0, F1& f1, F&... others) : Base(policy) {
    connectInput(f0, f1, others...);
  }

  /// Filters are those of this package, as many as the policy has messages.
  template <class... F>
  void connectInput(F&... filters) {
    static_assert((detail::is_filter<F> && ...),
                  "agnocast: the inputs of agnocast::message_filters::Synchronizer are filters of "
                  "agnocast::message_filters; to mix them with those of rclcpp, use "
                  "<agnocast_rclcpp/message_filters.hpp>");
    Base::connectInput(filters...);
  }

  template <class C>
  Connection registerCallback(const C& callback) {
    return Base::registerCallback(Adapter::adapt(callback));
  }
  template <class C, class T>
  Connection registerCallback(const C& callback, T* object) {
    return registerCallback(detail::Bound<C, T>{callback, object});
  }
  /// For the policy ExactTime: called with sets that will not be complete, in which messages are
  /// missing.
  template <class C>
  Connection registerDropCallback(const C& callback) {
    return Base::registerDropCallback(Adapter::adapt(callback));
  }
  template <class C, class T>
  Connection registerDropCallback(const C& callback, T* object) {
    return registerDropCallback(detail::Bound<C, T>{callback, object});
  }

  /// Adds a message to input `i`, as a filter would.
  template <int i>
  void add(const ipc_shared_ptr<const std::tuple_element_t<i, Messages>>& message) {
    add<i>(MessageEvent<const std::tuple_element_t<i, Messages>>(message));
  }
  template <int i>
  void add(const MessageEvent<const std::tuple_element_t<i, Messages>>& event) {
    Base::template add<i>(detail::to_upstream<std::tuple_element_t<i, Messages>>(event));
  }
};

}  // namespace agnocast::message_filters
