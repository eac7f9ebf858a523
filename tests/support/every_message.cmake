# agnocast_every_message: headers that visit every message type of interfaces/, and the libraries of their packages. Not there when
# a package is not found.
set(every_message_includes "")
set(every_message_visits "")
set(every_message_names "")
set(every_message_libraries "")
foreach(package builtin_interfaces std_msgs geometry_msgs sensor_msgs agnocast_test_msgs)
  find_package(${package} QUIET)
  # ROS 1 has packages of these names without such a target.
  if(NOT TARGET ${package}::${package}__rosidl_typesupport_introspection_cpp)
    message(STATUS "tests of every message: left out, ${package} is not found; build interfaces/ first")
    return()
  endif()
  list(APPEND every_message_libraries ${package}::${package}__rosidl_typesupport_introspection_cpp)
  file(GLOB files CONFIGURE_DEPENDS RELATIVE ${PROJECT_SOURCE_DIR}/interfaces/${package}
    ${PROJECT_SOURCE_DIR}/interfaces/${package}/msg/*.msg ${PROJECT_SOURCE_DIR}/interfaces/${package}/srv/*.srv)
  foreach(file ${files})
    get_filename_component(name ${file} NAME_WE)
    get_filename_component(kind ${file} DIRECTORY)
    # As rosidl names its headers.
    string(REGEX REPLACE "(.)([A-Z][a-z]+)" "\\1_\\2" header ${name})
    string(REGEX REPLACE "([a-z0-9])([A-Z])" "\\1_\\2" header ${header})
    string(TOLOWER ${header} header)
    string(APPEND every_message_includes "#include <${package}/${kind}/${header}.hpp>\n")
    if(kind STREQUAL srv)
      set(names ${name}_Request ${name}_Response)
    else()
      set(names ${name})
    endif()
    foreach(type ${names})
      string(APPEND every_message_visits
        "  see(static_cast<${package}::${kind}::${type}*>(nullptr), \"${package}/${kind}/${type}\");\n")
      string(APPEND every_message_names "    \"${package}/${kind}/${type}\",\n")
    endforeach()
  endforeach()
endforeach()
file(CONFIGURE OUTPUT ${PROJECT_BINARY_DIR}/generated/every_message.hpp @ONLY CONTENT
"#pragma once
@every_message_includes@
namespace agnocast::test {

/// `see(T* null, name)` for each type.
template <class See>
void for_every_message(See&& see) {
@every_message_visits@}

}  // namespace agnocast::test
")
# Without the C++ types, which take long to compile.
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
