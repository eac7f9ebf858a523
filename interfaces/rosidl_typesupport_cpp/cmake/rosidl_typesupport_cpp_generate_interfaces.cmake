# SPDX-License-Identifier: Apache-2.0
#
# Runs inside rosidl_generate_interfaces() of a message package: adds the target that
# rosidl_get_typesupport_target(… rosidl_typesupport_cpp) returns and that other packages link as
# <package>::<package>__rosidl_typesupport_cpp.
set(typesupport_target ${rosidl_generate_interfaces_TARGET}__rosidl_typesupport_cpp)

add_library(${typesupport_target} INTERFACE)
add_library(${PROJECT_NAME}::${typesupport_target} ALIAS ${typesupport_target})
target_link_libraries(${typesupport_target} INTERFACE
  ${rosidl_generate_interfaces_TARGET}__rosidl_generator_cpp
  ${rosidl_generate_interfaces_TARGET}__rosidl_typesupport_introspection_cpp)

# Compiling the introspection of a message is parsing the same headers: 0.4 s, and 0.1 s with them precompiled in 1.2 s.
list(LENGTH rosidl_generate_interfaces_IDL_TUPLES interface_count)
if(interface_count GREATER 4)
  target_precompile_headers(${rosidl_generate_interfaces_TARGET}__rosidl_typesupport_introspection_cpp PRIVATE
    <algorithm> <array> <memory> <string> <vector> <rosidl_runtime_cpp/bounded_vector.hpp>
    <rosidl_typesupport_introspection_cpp/message_introspection.hpp>)
endif()

if(NOT rosidl_generate_interfaces_SKIP_INSTALL)
  install(TARGETS ${typesupport_target} EXPORT ${typesupport_target})
  ament_export_targets(${typesupport_target})
  rosidl_export_typesupport_targets(__rosidl_typesupport_cpp ${typesupport_target})
endif()
