// SPDX-License-Identifier: Apache-2.0
//
// Subscriptions.

#include <ros2/rmw_agnocast_cpp/src/common.hpp>
#include <ros2/rmw_agnocast_cpp/src/endpoints.hpp>

#include <rcutils/types/uint8_array.h>
#include <rmw/get_network_flow_endpoints.h>

#include <chrono>
#include <cstring>

using namespace agnocast;
using namespace agnocast::rmw;

namespace {

void tell(const MessageInfo& info, rmw_message_info_t* to) {
  if (to == nullptr) return;
  *to = rmw_get_zero_initialized_message_info();
  to->source_timestamp = static_cast<rmw_time_point_value_t>(info.source_timestamp());
  to->received_timestamp = std::chrono::duration_cast<std::chrono::nanoseconds>(
                               std::chrono::system_clock::now().time_since_epoch())
                               .count();
  to->publication_sequence_number = RMW_MESSAGE_INFO_SEQUENCE_NUMBER_UNSUPPORTED;
  to->reception_sequence_number = RMW_MESSAGE_INFO_SEQUENCE_NUMBER_UNSUPPORTED;
  to->publisher_gid = gid_of(info.publisher);
}

rmw_ret_t take_one(const rmw_subscription_t* subscription, void* message, bool* taken,
                   rmw_message_info_t* info) {
  return guarded([&] {
    MessageInfo got;
    *taken = data_of<SubscriptionData>(subscription).endpoint->take(message, got);
    if (*taken) tell(got, info);
    return rmw_ret_t{RMW_RET_OK};
  });
}

rmw_ret_t take_bytes(const rmw_subscription_t* subscription, rmw_serialized_message_t* message,
                     bool* taken, rmw_message_info_t* info) {
  return guarded([&]() -> rmw_ret_t {
    MessageInfo got;
    std::vector<std::byte> bytes;
    if (!data_of<SubscriptionData>(subscription).endpoint->take_serialized(bytes, got)) {
      *taken = false;
      return RMW_RET_OK;
    }
    if (message->buffer_capacity < bytes.size() &&
        rmw_serialized_message_resize(message, bytes.size()) != RMW_RET_OK)
      return refuse(RMW_RET_BAD_ALLOC, "the bytes of the message cannot grow; it is lost");
    std::memcpy(message->buffer, bytes.data(), bytes.size());
    message->buffer_length = bytes.size();
    tell(got, info);
    *taken = true;
    return RMW_RET_OK;
  });
}

rmw_ret_t take_loan(const rmw_subscription_t* subscription, void** message, bool* taken,
                    rmw_message_info_t* info) {
  if (!subscription->can_loan_messages)
    return refuse(RMW_RET_UNSUPPORTED, "messages in C cannot be lent");
  AGNOCAST_RMW_NOT_NULL(message);
  AGNOCAST_RMW_NOT_NULL(taken);
  if (*message != nullptr)
    return refuse(RMW_RET_INVALID_ARGUMENT, "there is a message already where to put the loan");
  return guarded([&] {
    MessageInfo got;
    // rmw has no const loans; the memory is read-only all the same.
    *message =
        const_cast<void*>(data_of<SubscriptionData>(subscription).endpoint->take_loaned(got));
    *taken = *message != nullptr;
    if (*taken) tell(got, info);
    return rmw_ret_t{RMW_RET_OK};
  });
}

}  // namespace

extern "C" {

rmw_ret_t rmw_init_subscription_allocation(const rosidl_message_type_support_t*,
                                           const rosidl_runtime_c__Sequence__bound*,
                                           rmw_subscription_allocation_t*) {
  return refuse(RMW_RET_UNSUPPORTED, "subscriptions need no memory of their callers");
}
rmw_ret_t rmw_fini_subscription_allocation(rmw_subscription_allocation_t*) {
  return refuse(RMW_RET_UNSUPPORTED, "subscriptions need no memory of their callers");
}

rmw_subscription_t* rmw_create_subscription(const rmw_node_t* node,
                                            const rosidl_message_type_support_t* type_support,
                                            const char* topic_name,
                                            const rmw_qos_profile_t* qos_policies,
                                            const rmw_subscription_options_t* options) {
  RMW_CHECK_ARGUMENT_FOR_NULL(options, nullptr);
  if (options->require_unique_network_flow_endpoints ==
      RMW_UNIQUE_NETWORK_FLOW_ENDPOINTS_STRICTLY_REQUIRED) {
    RMW_SET_ERROR_MSG("messages do not go over a network, and have no flow endpoints");
    return nullptr;
  }
  return make_endpoint<rmw_subscription_t, SubscriptionData>(
      node, type_support, topic_name, qos_policies, rmw_subscription_allocate,
      rmw_subscription_free,
      [&](rmw_subscription_t& handle, SubscriptionData& data) -> Result<void> {
        const auto support = MessageSupport::of(type_support);
        if (!support) return tl::unexpected<Failure>(support.error());
        auto endpoint =
            TopicSubscription::create(data_of<NodeData>(node).name, topic_name, *support,
                                      QoS(data.qos), options->ignore_local_publications);
        if (!endpoint) return tl::unexpected<Failure>(endpoint.error());
        data.endpoint = std::move(*endpoint);
        handle.options = *options;
        handle.can_loan_messages = data.endpoint->can_lend();
        handle.is_cft_enabled = false;
        return {};
      },
      [](rmw_subscription_t& handle) -> const char*& { return handle.topic_name; });
}

rmw_ret_t rmw_destroy_subscription(rmw_node_t* node, rmw_subscription_t* subscription) {
  return destroy_endpoint<SubscriptionData>(node, subscription, rmw_subscription_free,
                                            [&] { return subscription->topic_name; });
}

rmw_ret_t rmw_subscription_count_matched_publishers(const rmw_subscription_t* subscription,
                                                    size_t* publisher_count) {
  AGNOCAST_RMW_OURS(subscription);
  AGNOCAST_RMW_NOT_NULL(publisher_count);
  *publisher_count =
      data_of<SubscriptionData>(subscription).endpoint->endpoint().get_publisher_count();
  return RMW_RET_OK;
}

rmw_ret_t rmw_subscription_get_actual_qos(const rmw_subscription_t* subscription,
                                          rmw_qos_profile_t* qos) {
  AGNOCAST_RMW_OURS(subscription);
  AGNOCAST_RMW_NOT_NULL(qos);
  *qos = data_of<SubscriptionData>(subscription).qos;
  return RMW_RET_OK;
}

rmw_ret_t rmw_subscription_set_content_filter(rmw_subscription_t*,
                                              const rmw_subscription_content_filter_options_t*) {
  return refuse(RMW_RET_UNSUPPORTED, "there are no content filters");
}
rmw_ret_t rmw_subscription_get_content_filter(const rmw_subscription_t*, rcutils_allocator_t*,
                                              rmw_subscription_content_filter_options_t*) {
  return refuse(RMW_RET_UNSUPPORTED, "there are no content filters");
}

rmw_ret_t rmw_take(const rmw_subscription_t* subscription, void* ros_message, bool* taken,
                   rmw_subscription_allocation_t*) {
  AGNOCAST_RMW_OURS(subscription);
  AGNOCAST_RMW_NOT_NULL(ros_message);
  AGNOCAST_RMW_NOT_NULL(taken);
  return take_one(subscription, ros_message, taken, nullptr);
}

rmw_ret_t rmw_take_with_info(const rmw_subscription_t* subscription, void* ros_message, bool* taken,
                             rmw_message_info_t* message_info, rmw_subscription_allocation_t*) {
  AGNOCAST_RMW_OURS(subscription);
  AGNOCAST_RMW_NOT_NULL(ros_message);
  AGNOCAST_RMW_NOT_NULL(taken);
  AGNOCAST_RMW_NOT_NULL(message_info);
  return take_one(subscription, ros_message, taken, message_info);
}

rmw_ret_t rmw_take_sequence(const rmw_subscription_t* subscription, size_t count,
                            rmw_message_sequence_t* message_sequence,
                            rmw_message_info_sequence_t* message_info_sequence, size_t* taken,
                            rmw_subscription_allocation_t*) {
  AGNOCAST_RMW_OURS(subscription);
  AGNOCAST_RMW_NOT_NULL(message_sequence);
  AGNOCAST_RMW_NOT_NULL(message_info_sequence);
  AGNOCAST_RMW_NOT_NULL(taken);
  if (count == 0 || count > message_sequence->capacity || count > message_info_sequence->capacity)
    return refuse(RMW_RET_INVALID_ARGUMENT, "no message is asked for, or more than fit");
  std::size_t got = 0;
  for (bool one = true; one && got < count;) {
    const rmw_ret_t result = take_one(subscription, message_sequence->data[got], &one,
                                      &message_info_sequence->data[got]);
    if (result != RMW_RET_OK && got == 0) return result;
    if (result != RMW_RET_OK) break;  // the next call reports it, if it is still so
    if (one) ++got;
  }
  *taken = message_sequence->size = message_info_sequence->size = got;
  return RMW_RET_OK;
}

rmw_ret_t rmw_take_serialized_message(const rmw_subscription_t* subscription,
                                      rmw_serialized_message_t* serialized_message, bool* taken,
                                      rmw_subscription_allocation_t*) {
  AGNOCAST_RMW_OURS(subscription);
  AGNOCAST_RMW_NOT_NULL(serialized_message);
  AGNOCAST_RMW_NOT_NULL(taken);
  return take_bytes(subscription, serialized_message, taken, nullptr);
}

rmw_ret_t rmw_take_serialized_message_with_info(const rmw_subscription_t* subscription,
                                                rmw_serialized_message_t* serialized_message,
                                                bool* taken, rmw_message_info_t* message_info,
                                                rmw_subscription_allocation_t*) {
  AGNOCAST_RMW_OURS(subscription);
  AGNOCAST_RMW_NOT_NULL(serialized_message);
  AGNOCAST_RMW_NOT_NULL(taken);
  AGNOCAST_RMW_NOT_NULL(message_info);
  return take_bytes(subscription, serialized_message, taken, message_info);
}

rmw_ret_t rmw_take_loaned_message(const rmw_subscription_t* subscription, void** loaned_message,
                                  bool* taken, rmw_subscription_allocation_t*) {
  AGNOCAST_RMW_OURS(subscription);
  return take_loan(subscription, loaned_message, taken, nullptr);
}

rmw_ret_t rmw_take_loaned_message_with_info(const rmw_subscription_t* subscription,
                                            void** loaned_message, bool* taken,
                                            rmw_message_info_t* message_info,
                                            rmw_subscription_allocation_t*) {
  AGNOCAST_RMW_OURS(subscription);
  AGNOCAST_RMW_NOT_NULL(message_info);
  return take_loan(subscription, loaned_message, taken, message_info);
}

rmw_ret_t rmw_return_loaned_message_from_subscription(const rmw_subscription_t* subscription,
                                                      void* loaned_message) {
  AGNOCAST_RMW_OURS(subscription);
  if (!subscription->can_loan_messages)
    return refuse(RMW_RET_UNSUPPORTED, "messages in C cannot be lent");
  AGNOCAST_RMW_NOT_NULL(loaned_message);
  if (data_of<SubscriptionData>(subscription).endpoint->give_back(loaned_message))
    return RMW_RET_OK;
  return refuse(RMW_RET_INVALID_ARGUMENT, "not a loan of this subscription");
}

rmw_ret_t rmw_subscription_set_on_new_message_callback(rmw_subscription_t* subscription,
                                                       rmw_event_callback_t callback,
                                                       const void* user_data) {
  AGNOCAST_RMW_OURS(subscription);
  auto& data = data_of<SubscriptionData>(subscription);
  return listen(data.listener, *data.endpoint, callback, user_data);
}

rmw_ret_t rmw_subscription_get_network_flow_endpoints(const rmw_subscription_t*,
                                                      rcutils_allocator_t*,
                                                      rmw_network_flow_endpoint_array_t*) {
  return refuse(RMW_RET_UNSUPPORTED, "messages do not go over a network");
}

}  // extern "C"
