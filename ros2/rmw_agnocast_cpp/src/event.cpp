// SPDX-License-Identifier: Apache-2.0
//
// Events: none are reported yet, and rclcpp's own handlers do without.

#include <ros2/rmw_agnocast_cpp/src/common.hpp>

#include <rmw/event.h>

using namespace agnocast;
using namespace agnocast::rmw;

namespace {

rmw_ret_t no_events() { return refuse(RMW_RET_UNSUPPORTED, "there are no events yet"); }

}  // namespace

extern "C" {

rmw_ret_t rmw_publisher_event_init(rmw_event_t* rmw_event, const rmw_publisher_t* publisher,
                                   rmw_event_type_t) {
  AGNOCAST_RMW_NOT_NULL(rmw_event);
  AGNOCAST_RMW_OURS(publisher);
  return no_events();
}
rmw_ret_t rmw_subscription_event_init(rmw_event_t* rmw_event,
                                      const rmw_subscription_t* subscription, rmw_event_type_t) {
  AGNOCAST_RMW_NOT_NULL(rmw_event);
  AGNOCAST_RMW_OURS(subscription);
  return no_events();
}
rmw_ret_t rmw_take_event(const rmw_event_t* event_handle, void* event_info, bool* taken) {
  AGNOCAST_RMW_OURS(event_handle);
  AGNOCAST_RMW_NOT_NULL(event_info);
  AGNOCAST_RMW_NOT_NULL(taken);
  return no_events();
}
rmw_ret_t rmw_event_set_callback(rmw_event_t* event, rmw_event_callback_t, const void*) {
  AGNOCAST_RMW_OURS(event);
  return no_events();
}

}  // extern "C"
