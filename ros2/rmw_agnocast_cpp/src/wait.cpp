// SPDX-License-Identifier: Apache-2.0
//
// Wait sets.

#include <ros2/rmw_agnocast_cpp/src/common.hpp>

#include <algorithm>
#include <optional>

using namespace agnocast;
using namespace agnocast::rmw;

namespace {

/// What a wait set keeps from one wait to the next, so that a cycle of an executor allocates
/// nothing.
struct WaitSetData {
  explicit WaitSetData(WaitPool& pool) noexcept : set(pool) {}
  WaitSet set;
  WaitSet::Conditions conditions;
  WaitSet::Readables readables;
};

template <class Data>
void add(WaitSet::Readables& to, void* const* handles, std::size_t count) {
  for (std::size_t i = 0; i < count; ++i)
    to.push_back(handles[i] != nullptr ? static_cast<Data*>(handles[i])->endpoint.get() : nullptr);
}

}  // namespace

extern "C" {

rmw_wait_set_t* rmw_create_wait_set(rmw_context_t* context, size_t) {
  RMW_CHECK_ARGUMENT_FOR_NULL(context, nullptr);
  RMW_CHECK_TYPE_IDENTIFIERS_MATCH(context, context->implementation_identifier, identifier,
                                   return nullptr);
  RMW_CHECK_FOR_NULL_WITH_MSG(context->impl, "the context is not initialized", return nullptr);
  rmw_wait_set_t* const made = rmw_wait_set_allocate();
  auto* const data = new (std::nothrow) WaitSetData(context->impl->pool);
  if (made == nullptr || data == nullptr) {
    if (made != nullptr) rmw_wait_set_free(made);
    delete data;
    RMW_SET_ERROR_MSG("there is no memory left");
    return nullptr;
  }
  *made = {};
  made->implementation_identifier = identifier;
  made->data = data;
  return made;
}

rmw_ret_t rmw_destroy_wait_set(rmw_wait_set_t* wait_set) {
  // rcl's tests want RMW_RET_ERROR for null here.
  RMW_CHECK_ARGUMENT_FOR_NULL(wait_set, RMW_RET_ERROR);
  RMW_CHECK_TYPE_IDENTIFIERS_MATCH(wait_set, wait_set->implementation_identifier, identifier,
                                   return RMW_RET_INCORRECT_RMW_IMPLEMENTATION);
  delete static_cast<WaitSetData*>(wait_set->data);
  rmw_wait_set_free(wait_set);
  return RMW_RET_OK;
}

rmw_ret_t rmw_wait(rmw_subscriptions_t* subscriptions, rmw_guard_conditions_t* guard_conditions,
                   rmw_services_t* services, rmw_clients_t* clients, rmw_events_t* events,
                   rmw_wait_set_t* wait_set, const rmw_time_t* wait_timeout) {
  AGNOCAST_RMW_OURS(wait_set);
  return guarded([&]() -> rmw_ret_t {
    auto& data = data_of<WaitSetData>(wait_set);
    data.conditions.clear();
    data.readables.clear();
    if (guard_conditions != nullptr) {
      for (std::size_t i = 0; i < guard_conditions->guard_condition_count; ++i)
        data.conditions.push_back(static_cast<Condition*>(guard_conditions->guard_conditions[i]));
    }
    if (subscriptions != nullptr)
      add<SubscriptionData>(data.readables, subscriptions->subscribers,
                            subscriptions->subscriber_count);
    if (services != nullptr)
      add<ServiceData>(data.readables, services->services, services->service_count);
    if (clients != nullptr)
      add<ClientData>(data.readables, clients->clients, clients->client_count);
    if (events != nullptr) {
      for (std::size_t i = 0; i < events->event_count; ++i) {
        const auto* const event = static_cast<const rmw_event_t*>(events->events[i]);
        data.readables.push_back(event != nullptr ? listenable_of(*event) : nullptr);
      }
    }
    std::optional<WaitSet::Duration> timeout;
    if (wait_timeout != nullptr && !rmw_time_equal(*wait_timeout, RMW_DURATION_INFINITE))
      timeout = WaitSet::Duration(rmw_time_total_nsec(*wait_timeout));
    const auto waited = data.set.wait(data.conditions, data.readables, timeout);
    if (!waited) {
      const auto clear = [](void** handles, std::size_t count) {
        std::fill_n(handles, count, nullptr);
      };
      if (guard_conditions != nullptr)
        clear(guard_conditions->guard_conditions, guard_conditions->guard_condition_count);
      if (subscriptions != nullptr)
        clear(subscriptions->subscribers, subscriptions->subscriber_count);
      if (services != nullptr) clear(services->services, services->service_count);
      if (clients != nullptr) clear(clients->clients, clients->client_count);
      if (events != nullptr) clear(events->events, events->event_count);
      return refuse(waited.error());
    }
    if (guard_conditions != nullptr) {
      for (std::size_t i = 0; i < guard_conditions->guard_condition_count; ++i)
        if (!data.set.is_condition_ready(i)) guard_conditions->guard_conditions[i] = nullptr;
    }
    std::size_t at = 0;
    const auto keep_ready = [&](void** handles, std::size_t count) {
      for (std::size_t i = 0; i < count; ++i, ++at)
        if (!data.set.is_readable_ready(at)) handles[i] = nullptr;
    };
    if (subscriptions != nullptr)
      keep_ready(subscriptions->subscribers, subscriptions->subscriber_count);
    if (services != nullptr) keep_ready(services->services, services->service_count);
    if (clients != nullptr) keep_ready(clients->clients, clients->client_count);
    if (events != nullptr) keep_ready(events->events, events->event_count);
    return *waited ? RMW_RET_OK : RMW_RET_TIMEOUT;
  });
}

}  // extern "C"
