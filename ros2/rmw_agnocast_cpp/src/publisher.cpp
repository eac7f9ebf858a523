// SPDX-License-Identifier: Apache-2.0
//
// Publishers.

#include <ros2/rmw_agnocast_cpp/src/common.hpp>
#include <ros2/rmw_agnocast_cpp/src/endpoints.hpp>

#include <rmw/get_network_flow_endpoints.h>

#include <cstring>

using namespace agnocast;
using namespace agnocast::rmw;

namespace {

rmw_ret_t result_of(const PublishResult& result) {
  if (result) return RMW_RET_OK;
  // A keep-all subscription that does not read: as a DDS writer whose blocking time is over.
  const rmw_ret_t code = result.code == Errc::would_block ? RMW_RET_TIMEOUT : RMW_RET_ERROR;
  return guarded([&] { return refuse(code, text_of(Failure{result.code, 0, "publishing", 0})); });
}

}  // namespace

extern "C" {

rmw_ret_t rmw_init_publisher_allocation(const rosidl_message_type_support_t*,
                                        const rosidl_runtime_c__Sequence__bound*,
                                        rmw_publisher_allocation_t*) {
  return refuse(RMW_RET_UNSUPPORTED, "publishers need no memory of their callers");
}
rmw_ret_t rmw_fini_publisher_allocation(rmw_publisher_allocation_t*) {
  return refuse(RMW_RET_UNSUPPORTED, "publishers need no memory of their callers");
}

rmw_publisher_t* rmw_create_publisher(const rmw_node_t* node,
                                      const rosidl_message_type_support_t* type_support,
                                      const char* topic_name, const rmw_qos_profile_t* qos_profile,
                                      const rmw_publisher_options_t* publisher_options) {
  RMW_CHECK_ARGUMENT_FOR_NULL(publisher_options, nullptr);
  if (publisher_options->require_unique_network_flow_endpoints ==
      RMW_UNIQUE_NETWORK_FLOW_ENDPOINTS_STRICTLY_REQUIRED) {
    RMW_SET_ERROR_MSG("messages do not go over a network, and have no flow endpoints");
    return nullptr;
  }
  rmw_publisher_t* const made = make_endpoint<rmw_publisher_t, PublisherData>(
      node, type_support, topic_name, qos_profile, rmw_publisher_allocate, rmw_publisher_free,
      [&](rmw_publisher_t& handle, PublisherData& data) -> Result<void> {
        const auto support = MessageSupport::of(type_support);
        if (!support) return tl::unexpected<Failure>(support.error());
        auto endpoint = TopicPublisher::create(data_of<NodeData>(node).name, topic_name, *support,
                                               QoS(data.qos));
        if (!endpoint) return tl::unexpected<Failure>(endpoint.error());
        data.endpoint = std::move(*endpoint);
        handle.options = *publisher_options;
        handle.can_loan_messages = data.endpoint->can_lend();
        return {};
      },
      [](rmw_publisher_t& handle) -> const char*& { return handle.topic_name; });
  return made;
}

rmw_ret_t rmw_destroy_publisher(rmw_node_t* node, rmw_publisher_t* publisher) {
  return destroy_endpoint<PublisherData>(node, publisher, rmw_publisher_free,
                                         [&] { return publisher->topic_name; });
}

rmw_ret_t rmw_publish(const rmw_publisher_t* publisher, const void* ros_message,
                      rmw_publisher_allocation_t*) {
  AGNOCAST_RMW_OURS(publisher);
  AGNOCAST_RMW_NOT_NULL(ros_message);
  return result_of(data_of<PublisherData>(publisher).endpoint->publish(ros_message));
}

rmw_ret_t rmw_publish_serialized_message(const rmw_publisher_t* publisher,
                                         const rmw_serialized_message_t* serialized_message,
                                         rmw_publisher_allocation_t*) {
  AGNOCAST_RMW_OURS(publisher);
  AGNOCAST_RMW_NOT_NULL(serialized_message);
  return result_of(data_of<PublisherData>(publisher).endpoint->publish_serialized(
      {reinterpret_cast<const std::byte*>(serialized_message->buffer),
       serialized_message->buffer_length}));
}

rmw_ret_t rmw_borrow_loaned_message(const rmw_publisher_t* publisher,
                                    const rosidl_message_type_support_t* type_support,
                                    void** ros_message) {
  AGNOCAST_RMW_OURS(publisher);
  if (!publisher->can_loan_messages)
    return refuse(RMW_RET_UNSUPPORTED, "messages in C cannot be lent");
  AGNOCAST_RMW_NOT_NULL(type_support);
  AGNOCAST_RMW_NOT_NULL(ros_message);
  if (*ros_message != nullptr)
    return refuse(RMW_RET_INVALID_ARGUMENT, "there is a message already where to put the loan");
  return guarded([&] {
    TopicPublisher& endpoint = *data_of<PublisherData>(publisher).endpoint;
    if (!endpoint.support().is_layout_of(*type_support))
      return refuse(RMW_RET_INVALID_ARGUMENT,
                    "a loan of another type than the publisher's, or in another language");
    *ros_message = endpoint.borrow();
    return rmw_ret_t{RMW_RET_OK};
  });
}

rmw_ret_t rmw_return_loaned_message_from_publisher(const rmw_publisher_t* publisher,
                                                   void* loaned_message) {
  AGNOCAST_RMW_OURS(publisher);
  if (!publisher->can_loan_messages)
    return refuse(RMW_RET_UNSUPPORTED, "messages in C cannot be lent");
  AGNOCAST_RMW_NOT_NULL(loaned_message);
  if (data_of<PublisherData>(publisher).endpoint->give_back(loaned_message)) return RMW_RET_OK;
  return refuse(RMW_RET_INVALID_ARGUMENT, "not a loan of this publisher");
}

rmw_ret_t rmw_publish_loaned_message(const rmw_publisher_t* publisher, void* ros_message,
                                     rmw_publisher_allocation_t*) {
  AGNOCAST_RMW_OURS(publisher);
  if (!publisher->can_loan_messages)
    return refuse(RMW_RET_UNSUPPORTED, "messages in C cannot be lent");
  AGNOCAST_RMW_NOT_NULL(ros_message);
  return result_of(data_of<PublisherData>(publisher).endpoint->publish_loaned(ros_message));
}

rmw_ret_t rmw_publisher_count_matched_subscriptions(const rmw_publisher_t* publisher,
                                                    size_t* subscription_count) {
  AGNOCAST_RMW_OURS(publisher);
  AGNOCAST_RMW_NOT_NULL(subscription_count);
  *subscription_count =
      data_of<PublisherData>(publisher).endpoint->endpoint().get_subscription_count();
  return RMW_RET_OK;
}

rmw_ret_t rmw_publisher_get_actual_qos(const rmw_publisher_t* publisher, rmw_qos_profile_t* qos) {
  AGNOCAST_RMW_OURS(publisher);
  AGNOCAST_RMW_NOT_NULL(qos);
  *qos = data_of<PublisherData>(publisher).qos;
  return RMW_RET_OK;
}

rmw_ret_t rmw_publisher_assert_liveliness(const rmw_publisher_t* publisher) {
  AGNOCAST_RMW_OURS(publisher);
  (void)data_of<PublisherData>(publisher).endpoint->endpoint().assert_liveliness();
  return RMW_RET_OK;
}

// A subscription acknowledges a message when its reader has it (DDS, wait_for_acknowledgments),
// whether its node takes it or not. Here it has it when the publish call returns, also beyond the
// end of the publisher's process.
rmw_ret_t rmw_publisher_wait_for_all_acked(const rmw_publisher_t* publisher, rmw_time_t) {
  AGNOCAST_RMW_OURS(publisher);
  return RMW_RET_OK;
}

rmw_ret_t rmw_get_gid_for_publisher(const rmw_publisher_t* publisher, rmw_gid_t* gid) {
  AGNOCAST_RMW_OURS(publisher);
  AGNOCAST_RMW_NOT_NULL(gid);
  *gid = gid_of(data_of<PublisherData>(publisher).endpoint->endpoint().get_generation());
  return RMW_RET_OK;
}

rmw_ret_t rmw_compare_gids_equal(const rmw_gid_t* gid1, const rmw_gid_t* gid2, bool* result) {
  AGNOCAST_RMW_OURS(gid1);
  AGNOCAST_RMW_OURS(gid2);
  AGNOCAST_RMW_NOT_NULL(result);
  *result = std::memcmp(gid1->data, gid2->data, sizeof gid1->data) == 0;
  return RMW_RET_OK;
}

rmw_ret_t rmw_publisher_get_network_flow_endpoints(const rmw_publisher_t*, rcutils_allocator_t*,
                                                   rmw_network_flow_endpoint_array_t*) {
  return refuse(RMW_RET_UNSUPPORTED, "messages do not go over a network");
}

}  // extern "C"
