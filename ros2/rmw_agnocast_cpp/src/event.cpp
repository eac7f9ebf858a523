// SPDX-License-Identifier: Apache-2.0
//
// Events. The data of a handle is that of its publisher or subscription; its type says which.

#include <ros2/rmw_agnocast_cpp/src/common.hpp>

#include <rmw/event.h>
#include <rmw/events_statuses/events_statuses.h>

using namespace agnocast;
using namespace agnocast::rmw;

namespace {

PublisherEvents& of_publisher(const rmw_event_t& handle) noexcept {
  return data_of<PublisherData>(&handle).endpoint->events();
}
SubscriptionEvents& of_subscription(const rmw_event_t& handle) noexcept {
  return data_of<SubscriptionData>(&handle).endpoint->events();
}

bool is_of_publisher(rmw_event_type_t type) noexcept {
  return type == RMW_EVENT_LIVELINESS_LOST || type == RMW_EVENT_OFFERED_DEADLINE_MISSED ||
         type == RMW_EVENT_OFFERED_QOS_INCOMPATIBLE;
}
bool is_of_subscription(rmw_event_type_t type) noexcept {
  return type == RMW_EVENT_LIVELINESS_CHANGED || type == RMW_EVENT_REQUESTED_DEADLINE_MISSED ||
         type == RMW_EVENT_REQUESTED_QOS_INCOMPATIBLE || type == RMW_EVENT_MESSAGE_LOST;
}

rmw_ret_t begin(rmw_event_t& event, void* data, rmw_event_type_t type, bool exists) {
  if (!exists) return refuse(RMW_RET_UNSUPPORTED, "this endpoint has no such event");
  if (event.implementation_identifier != nullptr)
    return refuse(RMW_RET_INVALID_ARGUMENT, "the event is in use");
  event = {identifier, data, type};
  return RMW_RET_OK;
}

/// Writes counts into one of rmw's statuses, which have the same members.
template <class Status, class Info>
void write(void* to, const Info& from) noexcept {
  *static_cast<Status*>(to) = {from.total_count, from.total_count_change};
}

}  // namespace

namespace agnocast::rmw {

Listenable* listenable_of(const rmw_event_t& handle) noexcept {
  switch (handle.event_type) {
    case RMW_EVENT_LIVELINESS_CHANGED:
      return &of_subscription(handle).liveliness_changed;
    case RMW_EVENT_REQUESTED_DEADLINE_MISSED:
      return &of_subscription(handle).deadline_missed;
    case RMW_EVENT_REQUESTED_QOS_INCOMPATIBLE:
      return &of_subscription(handle).incompatible_qos;
    case RMW_EVENT_MESSAGE_LOST:
      return &of_subscription(handle).message_lost;
    case RMW_EVENT_LIVELINESS_LOST:
      return &of_publisher(handle).liveliness_lost;
    case RMW_EVENT_OFFERED_DEADLINE_MISSED:
      return &of_publisher(handle).deadline_missed;
    case RMW_EVENT_OFFERED_QOS_INCOMPATIBLE:
      return &of_publisher(handle).incompatible_qos;
    default:
      return nullptr;
  }
}

}  // namespace agnocast::rmw

extern "C" {

rmw_ret_t rmw_publisher_event_init(rmw_event_t* rmw_event, const rmw_publisher_t* publisher,
                                   rmw_event_type_t event_type) {
  AGNOCAST_RMW_NOT_NULL(rmw_event);
  AGNOCAST_RMW_OURS(publisher);
  return begin(*rmw_event, publisher->data, event_type, is_of_publisher(event_type));
}
rmw_ret_t rmw_subscription_event_init(rmw_event_t* rmw_event,
                                      const rmw_subscription_t* subscription,
                                      rmw_event_type_t event_type) {
  AGNOCAST_RMW_NOT_NULL(rmw_event);
  AGNOCAST_RMW_OURS(subscription);
  return begin(*rmw_event, subscription->data, event_type, is_of_subscription(event_type));
}

rmw_ret_t rmw_take_event(const rmw_event_t* event_handle, void* event_info, bool* taken) {
  AGNOCAST_RMW_OURS(event_handle);
  AGNOCAST_RMW_NOT_NULL(event_info);
  AGNOCAST_RMW_NOT_NULL(taken);
  const rmw_event_t& handle = *event_handle;
  switch (handle.event_type) {
    case RMW_EVENT_LIVELINESS_CHANGED: {
      const LivelinessChangedInfo now = of_subscription(handle).liveliness_changed.take();
      *static_cast<rmw_liveliness_changed_status_t*>(event_info) = {
          now.alive_count, now.not_alive_count, now.alive_count_change, now.not_alive_count_change};
      break;
    }
    case RMW_EVENT_REQUESTED_QOS_INCOMPATIBLE:
    case RMW_EVENT_OFFERED_QOS_INCOMPATIBLE: {
      const IncompatibleQosInfo now = is_of_publisher(handle.event_type)
                                          ? of_publisher(handle).incompatible_qos.take()
                                          : of_subscription(handle).incompatible_qos.take();
      *static_cast<rmw_qos_incompatible_event_status_t*>(event_info) = {
          now.total_count, now.total_count_change,
          static_cast<rmw_qos_policy_kind_t>(now.last_policy_kind)};
      break;
    }
    case RMW_EVENT_MESSAGE_LOST:
      write<rmw_message_lost_status_t>(event_info, of_subscription(handle).message_lost.take());
      break;
    case RMW_EVENT_REQUESTED_DEADLINE_MISSED:
      write<rmw_requested_deadline_missed_status_t>(event_info,
                                                    of_subscription(handle).deadline_missed.take());
      break;
    case RMW_EVENT_OFFERED_DEADLINE_MISSED:
      write<rmw_offered_deadline_missed_status_t>(event_info,
                                                  of_publisher(handle).deadline_missed.take());
      break;
    case RMW_EVENT_LIVELINESS_LOST:
      write<rmw_liveliness_lost_status_t>(event_info, of_publisher(handle).liveliness_lost.take());
      break;
    default:
      return refuse(RMW_RET_UNSUPPORTED, "there is no such event");
  }
  *taken = true;
  return RMW_RET_OK;
}
rmw_ret_t rmw_event_set_callback(rmw_event_t* event, rmw_event_callback_t callback,
                                 const void* user_data) {
  AGNOCAST_RMW_OURS(event);
  Listenable* const to = listenable_of(*event);
  if (to == nullptr) return refuse(RMW_RET_UNSUPPORTED, "there is no such event");
  Listener& listener = is_of_publisher(event->event_type)
                           ? data_of<PublisherData>(event).listener
                           : data_of<SubscriptionData>(event).listener;
  return listen(listener, *to, callback, user_data);
}

}  // extern "C"
