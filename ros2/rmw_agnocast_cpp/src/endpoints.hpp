// SPDX-License-Identifier: Apache-2.0
//
// How the handles of publishers, subscriptions, services and clients begin and end.
#pragma once

#include <ros2/rmw_agnocast_cpp/src/common.hpp>

#include <rmw/allocators.h>
#include <rmw/validate_full_topic_name.h>

#include <cstring>

namespace agnocast::rmw {

/// The gid of a publisher, also in message infos.
inline rmw_gid_t gid_of(std::uint64_t generation) noexcept {
  rmw_gid_t gid{};
  gid.implementation_identifier = identifier;
  std::memcpy(gid.data, &generation, sizeof generation);
  return gid;
}

/// Checks what all creations check; returns the text of what is wrong, or null.
inline const char* wrong_name(const char* name, const rmw_qos_profile_t& qos) {
  if (*name == '\0') return "the name is empty";
  if (qos.avoid_ros_namespace_conventions) return nullptr;
  int result = RMW_TOPIC_VALID;
  if (rmw_validate_full_topic_name(name, &result, nullptr) != RMW_RET_OK) return "no name";
  return result == RMW_TOPIC_VALID ? nullptr : rmw_full_topic_name_validation_result_string(result);
}

/// Makes a handle: `fill(handle, data)` makes the endpoint, `name_in(handle)` is where its name
/// goes. Returns null with the error set.
template <class Handle, class Data, class Support, class Fill, class Name>
Handle* make_endpoint(const rmw_node_t* node, const Support* type_support, const char* name,
                      const rmw_qos_profile_t* qos, Handle* (*allocate)(), void (*free)(Handle*),
                      Fill fill, Name name_in) {
  RMW_CHECK_ARGUMENT_FOR_NULL(node, nullptr);
  RMW_CHECK_TYPE_IDENTIFIERS_MATCH(node, node->implementation_identifier, identifier,
                                   return nullptr);
  RMW_CHECK_ARGUMENT_FOR_NULL(type_support, nullptr);
  RMW_CHECK_ARGUMENT_FOR_NULL(name, nullptr);
  RMW_CHECK_ARGUMENT_FOR_NULL(qos, nullptr);
  if (const char* const wrong = wrong_name(name, *qos)) {
    RMW_SET_ERROR_MSG(wrong);
    return nullptr;
  }
  Handle* handle = nullptr;
  const rmw_ret_t made = guarded([&] {
    auto data = std::make_unique<Data>(node->context->impl->listener);
    if (!resolve_qos(*qos, data->qos)) return rmw_ret_t{RMW_RET_INVALID_ARGUMENT};
    handle = allocate();
    if (handle == nullptr) throw std::bad_alloc();
    *handle = {};
    handle->implementation_identifier = identifier;
    name_in(*handle) = copied_text(name);
    if (name_in(*handle) == nullptr) throw std::bad_alloc();
    if (Result<void> filled = fill(*handle, *data); !filled) return refuse(filled.error());
    handle->data = data.release();
    return rmw_ret_t{RMW_RET_OK};
  });
  if (made == RMW_RET_OK) return handle;
  if (handle != nullptr) {
    rmw_free(const_cast<char*>(name_in(*handle)));
    free(handle);
  }
  return nullptr;
}

template <class Data, class Handle, class Name>
rmw_ret_t destroy_endpoint(const rmw_node_t* node, Handle* handle, void (*free)(Handle*),
                           Name name_of) {
  AGNOCAST_RMW_OURS(node);
  AGNOCAST_RMW_OURS(handle);
  delete static_cast<Data*>(handle->data);
  rmw_free(const_cast<char*>(name_of()));
  free(handle);
  return RMW_RET_OK;
}

}  // namespace agnocast::rmw
