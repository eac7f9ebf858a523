# agnocast_every_message: headers that visit every message type of interfaces/, and the libraries
# of their packages. Missing if a package is not found. Typed endpoints take half a second per type
# to compile. The packages of every_kind have every kind of member, in messages, services and
# actions; the other types are tested by name.
set(every_kind test_msgs agnocast_test_msgs)
foreach(part every_kind rest)
  set(${part}_includes "")
  set(${part}_visits "")
endforeach()
set(every_message_names "")
set(every_message_libraries "")
find_package(test_interface_files QUIET)
foreach(package builtin_interfaces std_msgs geometry_msgs sensor_msgs unique_identifier_msgs
  action_msgs actionlib_msgs diagnostic_msgs
    example_interfaces nav_msgs rcl_interfaces rmw_dds_common rosgraph_msgs shape_msgs
    statistics_msgs std_srvs stereo_msgs test_msgs
    tf2_msgs trajectory_msgs visualization_msgs agnocast_test_msgs)
  find_package(${package} QUIET)
  # ROS 1 has packages of these names without such a target.
  if(NOT TARGET ${package}::${package}__rosidl_typesupport_introspection_cpp)
    message(STATUS
      "tests of every message: left out, ${package} is not found; "
      "run scripts/install-dependencies and build interfaces/ first")
    return()
  endif()
  set(part rest)
  if(package IN_LIST every_kind)
    set(part every_kind)
  endif()
  list(APPEND every_message_libraries ${${package}_TARGETS})
  file(GLOB files CONFIGURE_DEPENDS RELATIVE ${PROJECT_SOURCE_DIR}/interfaces/${package}
    ${PROJECT_SOURCE_DIR}/interfaces/${package}/msg/*.msg
    ${PROJECT_SOURCE_DIR}/interfaces/${package}/srv/*.srv
    ${PROJECT_SOURCE_DIR}/interfaces/${package}/action/*.action)
  if(package STREQUAL test_msgs)
    # A folder, a colon, and a file in it.
    foreach(file ${test_interface_files_MSG_FILES} ${test_interface_files_SRV_FILES}
      ${test_interface_files_ACTION_FILES})
      string(REGEX REPLACE ".*:" "" file ${file})
      list(APPEND files ${file})
    endforeach()
  endif()
  foreach(file ${files})
    get_filename_component(name ${file} NAME_WE)
    get_filename_component(kind ${file} DIRECTORY)
    # As rosidl names its headers.
    string(REGEX REPLACE "(.)([A-Z][a-z]+)" "\\1_\\2" header ${name})
    string(REGEX REPLACE "([a-z0-9])([A-Z])" "\\1_\\2" header ${header})
    string(TOLOWER ${header} header)
    string(APPEND ${part}_includes "#include <${package}/${kind}/${header}.hpp>\n")
    if(kind STREQUAL srv)
      set(names ${name}_Request ${name}_Response)
    elseif(kind STREQUAL action)
      set(names ${name}_Goal ${name}_Result ${name}_Feedback ${name}_SendGoal_Request
        ${name}_SendGoal_Response
        ${name}_GetResult_Request ${name}_GetResult_Response ${name}_FeedbackMessage)
    else()
      set(names ${name})
    endif()
    foreach(type ${names})
      string(APPEND ${part}_visits
        "  see(static_cast<${package}::${kind}::${type}*>(nullptr), "
        "\"${package}/${kind}/${type}\");\n")
      string(APPEND every_message_names "    \"${package}/${kind}/${type}\",\n")
    endforeach()
  endforeach()
endforeach()
file(CONFIGURE OUTPUT ${PROJECT_BINARY_DIR}/generated/every_kind_of_message.hpp @ONLY CONTENT
"#pragma once
@every_kind_includes@
namespace agnocast::test {

/// `see(T* null, name)` for types with every kind of member, of messages, services and actions.
template <class See>
void for_every_kind_of_message(See&& see) {
@every_kind_visits@}

}  // namespace agnocast::test
")
file(CONFIGURE OUTPUT ${PROJECT_BINARY_DIR}/generated/every_message.hpp @ONLY CONTENT
"#pragma once
#include <every_kind_of_message.hpp>
@rest_includes@
namespace agnocast::test {

/// `see(T* null, name)` for each type.
template <class See>
void for_every_message(See&& see) {
  for_every_kind_of_message(see);
@rest_visits@}

}  // namespace agnocast::test
")
# Names without the C++ types.
file(CONFIGURE OUTPUT ${PROJECT_BINARY_DIR}/generated/every_message_name.hpp @ONLY CONTENT
"#pragma once

namespace agnocast::test {

inline constexpr const char* every_message_name[] = {
@every_message_names@};

}  // namespace agnocast::test
")
add_library(agnocast_every_message INTERFACE)
target_include_directories(agnocast_every_message INTERFACE ${PROJECT_BINARY_DIR}/generated)
target_link_libraries(agnocast_every_message INTERFACE ${every_message_libraries})
