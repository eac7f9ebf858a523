# SPDX-License-Identifier: Apache-2.0
#
# Hooks into rosidl_generate_interfaces(). Extensions run in the order of their registration, and
# ours needs the target of the introspection: finding that first registers it first.
find_package(ament_cmake_core QUIET REQUIRED)
find_package(rosidl_cmake QUIET REQUIRED)
find_package(rosidl_typesupport_introspection_cpp QUIET REQUIRED)
ament_register_extension(rosidl_generate_idl_interfaces rosidl_typesupport_cpp
  rosidl_typesupport_cpp_generate_interfaces.cmake)
