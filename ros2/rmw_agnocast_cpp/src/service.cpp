// SPDX-License-Identifier: Apache-2.0
//
// Services and clients.

#include <ros2/rmw_agnocast_cpp/src/common.hpp>
#include <ros2/rmw_agnocast_cpp/src/endpoints.hpp>

#include <rosidl_runtime_c/service_type_support_struct.h>
#include <rosidl_typesupport_introspection_c/identifier.h>
#include <rosidl_typesupport_introspection_c/service_introspection.h>
#include <rosidl_typesupport_introspection_cpp/identifier.hpp>
#include <rosidl_typesupport_introspection_cpp/service_introspection.hpp>

#include <chrono>
#include <cstring>

using namespace agnocast;
using namespace agnocast::rmw;

namespace {

/// Handles for the halves of a service, which have tables but no handles of their own.
template <class Members>
rosidl_message_type_support_t handle_of(const char* of_type, const Members* members) {
  rosidl_message_type_support_t handle{};
  handle.typesupport_identifier = of_type;
  handle.data = members;
  handle.func = get_message_typesupport_handle_function;
  return handle;
}

Result<ServiceSupport> support_of(const rosidl_service_type_support_t* handle) {
  const auto make = [](const auto& request, const auto& response) -> Result<ServiceSupport> {
    auto first = MessageSupport::of(&request), second = MessageSupport::of(&response);
    if (!first) return tl::unexpected<Failure>(first.error());
    if (!second) return tl::unexpected<Failure>(second.error());
    return ServiceSupport{std::move(*first), std::move(*second)};
  };
  const char* const in_cpp = rosidl_typesupport_introspection_cpp::typesupport_identifier;
  if (const auto* const found = handle->func(handle, in_cpp)) {
    const auto& members =
        *static_cast<const rosidl_typesupport_introspection_cpp::ServiceMembers*>(found->data);
    return make(handle_of(in_cpp, members.request_members_),
                handle_of(in_cpp, members.response_members_));
  }
  rmw_reset_error();
  const char* const in_c = rosidl_typesupport_introspection_c__identifier;
  if (const auto* const found = handle->func(handle, in_c)) {
    const auto& members =
        *static_cast<const rosidl_typesupport_introspection_c__ServiceMembers*>(found->data);
    return make(handle_of(in_c, members.request_members_),
                handle_of(in_c, members.response_members_));
  }
  rmw_reset_error();
  return fail(Errc::type_refused, "a service's type support without introspection");
}

std::int64_t now_ns() {
  return std::chrono::duration_cast<std::chrono::nanoseconds>(
             std::chrono::system_clock::now().time_since_epoch())
      .count();
}

void tell(std::uint64_t client, std::int64_t number, rmw_service_info_t* info) {
  *info = {};
  std::memcpy(info->request_id.writer_guid, &client, sizeof client);
  info->request_id.sequence_number = number;
  info->source_timestamp = info->received_timestamp = now_ns();
}

/// Called when the first server of a client is matched. Nodes that wait for one sleep until the
/// graph changes; the change that showed the server may have come before the match.
void tell_of_server(const void* client, std::size_t) {
  const auto& data = *static_cast<const ClientData*>(client);
  data.listener.forget(data.endpoint->server_arrival());
  const std::lock_guard lock(data.context->mutex);
  data.context->tell_nodes();
}

}  // namespace

extern "C" {

rmw_service_t* rmw_create_service(const rmw_node_t* node,
                                  const rosidl_service_type_support_t* type_support,
                                  const char* service_name, const rmw_qos_profile_t* qos_profile) {
  return make_endpoint<rmw_service_t, ServiceData>(
      node, type_support, service_name, qos_profile, rmw_service_allocate, rmw_service_free,
      [&](rmw_service_t&, ServiceData& data) -> Result<void> {
        const auto support = support_of(type_support);
        if (!support) return tl::unexpected<Failure>(support.error());
        // A service is reliable and volatile here, whatever is asked for.
        auto endpoint = ServiceServer::create(data_of<NodeData>(node).name, service_name, *support,
                                              QoS(QoS(data.qos).depth()));
        if (!endpoint) return tl::unexpected<Failure>(endpoint.error());
        data.endpoint = std::move(*endpoint);
        return {};
      },
      [](rmw_service_t& handle) -> const char*& { return handle.service_name; });
}

rmw_ret_t rmw_destroy_service(rmw_node_t* node, rmw_service_t* service) {
  return destroy_endpoint<ServiceData>(node, service, rmw_service_free,
                                       [&] { return service->service_name; });
}

rmw_ret_t rmw_take_request(const rmw_service_t* service, rmw_service_info_t* request_header,
                           void* ros_request, bool* taken) {
  AGNOCAST_RMW_OURS(service);
  AGNOCAST_RMW_NOT_NULL(request_header);
  AGNOCAST_RMW_NOT_NULL(ros_request);
  AGNOCAST_RMW_NOT_NULL(taken);
  return guarded([&] {
    RequestId id;
    *taken = data_of<ServiceData>(service).endpoint->take(ros_request, id);
    if (*taken) tell(id.client, id.sequence, request_header);
    return rmw_ret_t{RMW_RET_OK};
  });
}

rmw_ret_t rmw_send_response(const rmw_service_t* service, rmw_request_id_t* request_header,
                            void* ros_response) {
  AGNOCAST_RMW_OURS(service);
  AGNOCAST_RMW_NOT_NULL(request_header);
  AGNOCAST_RMW_NOT_NULL(ros_response);
  return guarded([&] {
    RequestId id;
    std::memcpy(&id.client, request_header->writer_guid, sizeof id.client);
    id.sequence = request_header->sequence_number;
    const auto sent = data_of<ServiceData>(service).endpoint->send(id, ros_response);
    return sent ? rmw_ret_t{RMW_RET_OK} : refuse(sent.error());
  });
}

rmw_ret_t rmw_service_request_subscription_get_actual_qos(const rmw_service_t* service,
                                                          rmw_qos_profile_t* qos) {
  AGNOCAST_RMW_OURS(service);
  AGNOCAST_RMW_NOT_NULL(qos);
  *qos = data_of<ServiceData>(service).qos;
  return RMW_RET_OK;
}
rmw_ret_t rmw_service_response_publisher_get_actual_qos(const rmw_service_t* service,
                                                        rmw_qos_profile_t* qos) {
  return rmw_service_request_subscription_get_actual_qos(service, qos);
}

rmw_ret_t rmw_service_set_on_new_request_callback(rmw_service_t* service,
                                                  rmw_event_callback_t callback,
                                                  const void* user_data) {
  AGNOCAST_RMW_OURS(service);
  auto& data = data_of<ServiceData>(service);
  return listen(data.listener, *data.endpoint, callback, user_data);
}

rmw_client_t* rmw_create_client(const rmw_node_t* node,
                                const rosidl_service_type_support_t* type_support,
                                const char* service_name, const rmw_qos_profile_t* qos_policies) {
  return make_endpoint<rmw_client_t, ClientData>(
      node, type_support, service_name, qos_policies, rmw_client_allocate, rmw_client_free,
      [&](rmw_client_t&, ClientData& data) -> Result<void> {
        const auto support = support_of(type_support);
        if (!support) return tl::unexpected<Failure>(support.error());
        auto endpoint = ServiceClient::create(data_of<NodeData>(node).name, service_name, *support,
                                              QoS(QoS(data.qos).depth()));
        if (!endpoint) return tl::unexpected<Failure>(endpoint.error());
        data.endpoint = std::move(*endpoint);
        data.context = node->context->impl;
        return {};
      },
      [](rmw_client_t& handle) -> const char*& { return handle.service_name; });
}

rmw_ret_t rmw_destroy_client(rmw_node_t* node, rmw_client_t* client) {
  return destroy_endpoint<ClientData>(node, client, rmw_client_free,
                                      [&] { return client->service_name; });
}

rmw_ret_t rmw_send_request(const rmw_client_t* client, const void* ros_request,
                           int64_t* sequence_id) {
  AGNOCAST_RMW_OURS(client);
  AGNOCAST_RMW_NOT_NULL(ros_request);
  AGNOCAST_RMW_NOT_NULL(sequence_id);
  return guarded([&] {
    const auto sent = data_of<ClientData>(client).endpoint->send(ros_request);
    if (!sent) return refuse(sent.error());
    *sequence_id = *sent;
    return rmw_ret_t{RMW_RET_OK};
  });
}

rmw_ret_t rmw_take_response(const rmw_client_t* client, rmw_service_info_t* request_header,
                            void* ros_response, bool* taken) {
  AGNOCAST_RMW_OURS(client);
  AGNOCAST_RMW_NOT_NULL(request_header);
  AGNOCAST_RMW_NOT_NULL(ros_response);
  AGNOCAST_RMW_NOT_NULL(taken);
  return guarded([&] {
    std::int64_t number = 0;
    *taken = data_of<ClientData>(client).endpoint->take(ros_response, number);
    if (*taken) tell(0, number, request_header);
    return rmw_ret_t{RMW_RET_OK};
  });
}

rmw_ret_t rmw_client_request_publisher_get_actual_qos(const rmw_client_t* client,
                                                      rmw_qos_profile_t* qos) {
  AGNOCAST_RMW_OURS(client);
  AGNOCAST_RMW_NOT_NULL(qos);
  *qos = data_of<ClientData>(client).qos;
  return RMW_RET_OK;
}
rmw_ret_t rmw_client_response_subscription_get_actual_qos(const rmw_client_t* client,
                                                          rmw_qos_profile_t* qos) {
  return rmw_client_request_publisher_get_actual_qos(client, qos);
}

rmw_ret_t rmw_client_set_on_new_response_callback(rmw_client_t* client,
                                                  rmw_event_callback_t callback,
                                                  const void* user_data) {
  AGNOCAST_RMW_OURS(client);
  auto& data = data_of<ClientData>(client);
  return listen(data.listener, *data.endpoint, callback, user_data);
}

rmw_ret_t rmw_service_server_is_available(const rmw_node_t* node, const rmw_client_t* client,
                                          bool* is_available) {
  // rmw's tests want RMW_RET_ERROR for a null node here.
  RMW_CHECK_ARGUMENT_FOR_NULL(node, RMW_RET_ERROR);
  AGNOCAST_RMW_OURS(node);
  RMW_CHECK_ARGUMENT_FOR_NULL(client, RMW_RET_ERROR);
  AGNOCAST_RMW_OURS(client);
  RMW_CHECK_ARGUMENT_FOR_NULL(is_available, RMW_RET_ERROR);
  return guarded([&] {
    auto& data = data_of<ClientData>(client);
    const auto is_there = [&] { return data.endpoint->server_count() != 0; };
    bool found = is_there();
    if (!found) {
      // Without a listener nodes learn of it when they ask again, which they do at intervals.
      (void)data.listener.listen(data.endpoint->server_arrival(), tell_of_server, &data);
      found = is_there();  // one that came meanwhile may not be reported
    }
    *is_available = found;
    return rmw_ret_t{RMW_RET_OK};
  });
}

}  // extern "C"
