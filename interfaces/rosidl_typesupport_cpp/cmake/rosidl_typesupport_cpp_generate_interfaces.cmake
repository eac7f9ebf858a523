# SPDX-License-Identifier: Apache-2.0
#
# Runs inside rosidl_generate_interfaces() of a message package: adds the library that
# rosidl_get_typesupport_target(… rosidl_typesupport_cpp) returns and that other packages link as
# <package>::<package>__rosidl_typesupport_cpp.
set(typesupport_target ${rosidl_generate_interfaces_TARGET}__rosidl_typesupport_cpp)
set(introspection_target ${rosidl_generate_interfaces_TARGET}__rosidl_typesupport_introspection_cpp)

# msg/Name.idl, srv/Name.idl, action/Name.idl: rosidl derives the names of all messages of an
# interface from its name.
set(type_supports "")
foreach(idl ${rosidl_generate_interfaces_ABS_IDL_FILES})
  get_filename_component(kind ${idl} DIRECTORY)
  get_filename_component(kind ${kind} NAME)
  get_filename_component(interface ${idl} NAME_WE)
  if(kind STREQUAL "action")
    string(APPEND type_supports "AGNOCAST_ACTION(${kind}, ${interface})\n")
  elseif(kind STREQUAL "srv")
    string(APPEND type_supports "AGNOCAST_SERVICE(${kind}, ${interface})\n")
  else()
    string(APPEND type_supports "AGNOCAST_MESSAGE(${kind}, ${interface})\n")
  endif()
endforeach()
set(type_support_source ${CMAKE_CURRENT_BINARY_DIR}/${typesupport_target}.cpp)
configure_file(${rosidl_typesupport_cpp_DIR}/type_support.cpp.in ${type_support_source} @ONLY)

add_library(${typesupport_target} SHARED ${type_support_source})
add_library(${PROJECT_NAME}::${typesupport_target} ALIAS ${typesupport_target})
set_target_properties(${typesupport_target} PROPERTIES CXX_STANDARD 17)
if(rosidl_generate_interfaces_LIBRARY_NAME)
  set_target_properties(${typesupport_target} PROPERTIES
    OUTPUT_NAME ${rosidl_generate_interfaces_LIBRARY_NAME}__rosidl_typesupport_cpp)
endif()
target_link_libraries(${typesupport_target}
  PUBLIC ${rosidl_generate_interfaces_TARGET}__rosidl_generator_cpp PRIVATE ${introspection_target})
foreach(package ${rosidl_generate_interfaces_DEPENDENCY_PACKAGE_NAMES})
  target_link_libraries(${typesupport_target} PUBLIC ${${package}_TARGETS__rosidl_typesupport_cpp})
endforeach()
add_dependencies(${rosidl_generate_interfaces_TARGET} ${typesupport_target})

# Compiling the introspection of a message is parsing the same headers: 0.4 s, and 0.1 s with them
# precompiled in 1.2 s.
list(LENGTH rosidl_generate_interfaces_IDL_TUPLES interface_count)
if(interface_count GREATER 4)
  target_precompile_headers(${introspection_target} PRIVATE
    <algorithm> <array> <memory> <string> <vector> <rosidl_runtime_cpp/bounded_vector.hpp>
    <rosidl_typesupport_introspection_cpp/message_introspection.hpp>)
endif()

if(NOT rosidl_generate_interfaces_SKIP_INSTALL)
  install(TARGETS ${typesupport_target} EXPORT ${typesupport_target} LIBRARY DESTINATION lib)
  ament_export_libraries(${typesupport_target})
  ament_export_targets(${typesupport_target})
  rosidl_export_typesupport_targets(__rosidl_typesupport_cpp ${typesupport_target})
endif()
