// SPDX-License-Identifier: Apache-2.0
//
// What the functions of rmw share: the identifier, their checks, errors, and what lies behind the
// handles.
//
//   rmw_context_t  ─▶ rmw_context_impl_s   one of init … fini: waits, the graph, the nodes
//   rmw_node_t     ─▶ NodeData     name, graph guard condition
//   rmw_publisher_t, rmw_subscription_t, rmw_service_t, rmw_client_t ─▶ …Data: the endpoint of the
//                                  core, and the QoS that was asked for
//
// A function checks its arguments before it changes anything: null is RMW_RET_INVALID_ARGUMENT, a
// handle of another rmw RMW_RET_INCORRECT_RMW_IMPLEMENTATION, and outputs stay untouched.
#pragma once

#include <agnocast/error.hpp>
#include <agnocast/result.hpp>
#include <ros2/rmw_agnocast_cpp/core/graph_watch.hpp>
#include <ros2/rmw_agnocast_cpp/core/listener.hpp>
#include <ros2/rmw_agnocast_cpp/core/services.hpp>
#include <ros2/rmw_agnocast_cpp/core/topics.hpp>
#include <ros2/rmw_agnocast_cpp/core/wait_set.hpp>

#include <rmw/error_handling.h>
#include <rmw/rmw.h>
#include <rmw/impl/cpp/macros.hpp>

#include <sys/types.h>
#include <unistd.h>

#include <atomic>
#include <exception>
#include <memory>
#include <mutex>
#include <new>
#include <string>
#include <utility>
#include <vector>

namespace agnocast::rmw {

inline constexpr char identifier[] = "rmw_agnocast_cpp";

/// Sets the text of the error, and returns its code. Allocates nothing.
inline rmw_ret_t refuse(rmw_ret_t code, const char* text) noexcept {
  RMW_SET_ERROR_MSG(text);
  return code;
}
inline rmw_ret_t refuse(rmw_ret_t code, const std::string& text) noexcept {
  return refuse(code, text.c_str());
}
inline rmw_ret_t refuse(const Failure& failure) {
  const bool is_argument = failure.code == Errc::invalid_name ||
                           failure.code == Errc::invalid_argument ||
                           failure.code == Errc::type_refused;
  return refuse(is_argument ? RMW_RET_INVALID_ARGUMENT : RMW_RET_ERROR, text_of(failure));
}
/// Runs the body of a function; what it throws becomes an error of rmw.
template <class Body>
rmw_ret_t guarded(Body&& body) noexcept {
  try {
    return body();
  } catch (const std::bad_alloc&) {
    return refuse(RMW_RET_BAD_ALLOC, "there is no memory left");
  } catch (const std::exception& error) {
    return refuse(RMW_RET_ERROR, error.what());
  }
}

#define AGNOCAST_RMW_NOT_NULL(argument) \
  RMW_CHECK_ARGUMENT_FOR_NULL(argument, RMW_RET_INVALID_ARGUMENT)
#define AGNOCAST_RMW_OURS(handle)                                                           \
  AGNOCAST_RMW_NOT_NULL(handle);                                                            \
  RMW_CHECK_TYPE_IDENTIFIERS_MATCH(handle, (handle)->implementation_identifier, identifier, \
                                   return RMW_RET_INCORRECT_RMW_IMPLEMENTATION)

struct NodeData {
  NodeName name;
  Condition graph_changed;
  rmw_guard_condition_t graph_guard{};
};

template <class Endpoint>
struct EndpointData {
  explicit EndpointData(Listener& of_context) noexcept : listener(of_context) {}
  ~EndpointData() {
    if (endpoint == nullptr) return;
    for (Listenable* const one : endpoint->listenables()) listener.forget(*one);
  }
  EndpointData(const EndpointData&) = delete;
  EndpointData& operator=(const EndpointData&) = delete;

  Listener& listener;
  std::unique_ptr<Endpoint> endpoint;
  rmw_qos_profile_t qos{};
};
using PublisherData = EndpointData<TopicPublisher>;
using SubscriptionData = EndpointData<TopicSubscription>;
using ServiceData = EndpointData<ServiceServer>;
struct ClientData : EndpointData<ServiceClient> {
  using EndpointData::EndpointData;

  rmw_context_impl_t* context = nullptr;
};

template <class Data, class Handle>
Data& data_of(const Handle* handle) noexcept {
  return *static_cast<Data*>(handle->data);
}

/// Returns what a wait set waits for; null: the event is of no type.
Listenable* listenable_of(const rmw_event_t& event) noexcept;

/// The functions "set on new …".
inline rmw_ret_t listen(Listener& listener, Listenable& to, rmw_event_callback_t callback,
                        const void* user_data) noexcept {
  return guarded([&] {
    const Result<void> set = listener.listen(to, callback, user_data);
    return set ? rmw_ret_t{RMW_RET_OK} : refuse(set.error());
  });
}

/// Fills in what the profile leaves to this rmw. Returns false, with the error set, if a policy is
/// unknown.
bool resolve_qos(const rmw_qos_profile_t& asked, rmw_qos_profile_t& resolved);

/// A copy of a text for a handle, to be freed by rmw_free(); null without memory.
const char* copied_text(const std::string& text) noexcept;

}  // namespace agnocast::rmw

/// Behind a context from rmw_init() to rmw_context_fini(); endpoints are used, and wait sets wait,
/// also after rmw_shutdown().
struct rmw_context_impl_s {
  agnocast::rmw::WaitPool pool;
  agnocast::rmw::Listener listener{pool};
  std::atomic<bool> is_shut_down{false};
  std::mutex mutex;
  std::vector<agnocast::rmw::NodeData*> nodes;  // under the mutex
  std::uint64_t domain = 0;

  /// A forked child does not have the threads of this context, which may have held the mutex.
  bool is_in_child() const noexcept { return ::getpid() != process_; }
  /// Under the mutex: triggers the graph guard condition of each node.
  void tell_nodes() noexcept {
    for (agnocast::rmw::NodeData* const node : nodes) node->graph_changed.trigger();
  }
  /// Watched from the first call on. Throws std::system_error.
  agnocast::rmw::GraphWatch& graph();

 private:
  const pid_t process_ = ::getpid();
  std::mutex watching_;
  std::unique_ptr<agnocast::rmw::GraphWatch> graph_;  // ends first: it tells the nodes
};
