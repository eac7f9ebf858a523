// SPDX-License-Identifier: Apache-2.0
//
// Messages as bytes. These need no context: rosbag2 calls them in a library it has loaded for them
// alone.

#include <ros2/rmw_agnocast_cpp/src/common.hpp>

#include <rmw/serialized_message.h>

#include <array>
#include <span>

using namespace agnocast;
using namespace agnocast::rmw;

extern "C" {

rmw_ret_t rmw_get_serialized_message_size(const rosidl_message_type_support_t*,
                                          const rosidl_runtime_c__Sequence__bound*, size_t*) {
  return refuse(RMW_RET_UNSUPPORTED, "sizes are known of messages, not of types");
}

rmw_ret_t rmw_serialize(const void* ros_message, const rosidl_message_type_support_t* type_support,
                        rmw_serialized_message_t* serialized_message) {
  AGNOCAST_RMW_NOT_NULL(ros_message);
  AGNOCAST_RMW_NOT_NULL(type_support);
  AGNOCAST_RMW_NOT_NULL(serialized_message);
  return guarded([&]() -> rmw_ret_t {
    const auto support = MessageSupport::of(type_support);
    if (!support) return refuse(support.error());
    OwnedGenericMessage in_cpp;
    const void* message = ros_message;
    if (const CLayout* const layout = support->c_layout()) {
      in_cpp = support->type().make();
      if (const auto copied = layout->to_cpp(ros_message, in_cpp.get()); !copied)
        return refuse(copied.error());
      message = in_cpp.get();
    }
    const std::size_t bytes = bridge::cdr_bytes(support->cdr(), message);
    if (serialized_message->buffer_capacity < bytes) {
      if (const rmw_ret_t grown = rmw_serialized_message_resize(serialized_message, bytes);
          grown != RMW_RET_OK)
        return grown;
    }
    const auto written = bridge::write_cdr(
        support->cdr(), message, {reinterpret_cast<std::byte*>(serialized_message->buffer), bytes});
    if (!written) return refuse(RMW_RET_ERROR, written.error().text());
    serialized_message->buffer_length = *written;
    return RMW_RET_OK;
  });
}

rmw_ret_t rmw_deserialize(const rmw_serialized_message_t* serialized_message,
                          const rosidl_message_type_support_t* type_support, void* ros_message) {
  AGNOCAST_RMW_NOT_NULL(serialized_message);
  AGNOCAST_RMW_NOT_NULL(type_support);
  AGNOCAST_RMW_NOT_NULL(ros_message);
  return guarded([&]() -> rmw_ret_t {
    const auto support = MessageSupport::of(type_support);
    if (!support) return refuse(support.error());
    const std::array pieces{
        std::span(reinterpret_cast<const std::byte*>(serialized_message->buffer),
                  serialized_message->buffer_length)};
    const CLayout* const layout = support->c_layout();
    OwnedGenericMessage in_cpp;
    if (layout != nullptr) in_cpp = support->type().make();
    const auto read =
        bridge::read_cdr(support->cdr(), pieces, layout != nullptr ? in_cpp.get() : ros_message);
    if (!read) return refuse(RMW_RET_ERROR, read.error().text());
    if (layout == nullptr) return RMW_RET_OK;
    const auto copied = layout->to_c(in_cpp.get(), ros_message);
    return copied ? rmw_ret_t{RMW_RET_OK} : refuse(copied.error());
  });
}

}  // extern "C"
