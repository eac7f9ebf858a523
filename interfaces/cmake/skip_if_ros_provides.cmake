# SPDX-License-Identifier: Apache-2.0
#
# The skip rule of interfaces/: a package of this folder replaces the package of ROS 2 with the same
# name, so it must be skipped if a sourced ROS 2 provides the real one.
#
#     skip_if_ros_provides(MESSAGES)   the real one lists its messages in the ament index
#     skip_if_ros_provides(BUILD)      the real one has a package.xml
#
# Sourced means: in AMENT_PREFIX_PATH. That variable also has prefixes of this folder's own
# packages: of their siblings while colcon builds, of themselves after install/setup.bash was
# sourced, and of other workspaces with a copy of this folder. So our packages leave a mark in the
# ament index, and a prefix with the mark is never the real package. Comparing paths would depend on
# the layouts of colcon, and would skip a build into a second install folder because the first one
# is sourced.
#
# If the real one exists, the calling CMakeLists.txt ends here, after a STATUS message. It then has
# no install target, and colcon warns about that; an empty install target would be worse, because
# colcon's setup scripts would look for files that were not installed.

include(${CMAKE_CURRENT_LIST_DIR}/find_ros_python.cmake)

set(skip_rule_mark "agnocast_interfaces")

function(find_ros_prefix result file)
  set(${result} "" PARENT_SCOPE)
  file(TO_CMAKE_PATH "$ENV{AMENT_PREFIX_PATH}" prefixes)
  foreach(prefix IN LISTS prefixes)
    set(mark "${prefix}/share/ament_index/resource_index/${skip_rule_mark}/${PROJECT_NAME}")
    if(EXISTS "${prefix}/${file}" AND NOT EXISTS "${mark}")
      set(${result} "${prefix}" PARENT_SCOPE)
      return()
    endif()
  endforeach()
endfunction()

# A macro, so that return() leaves the caller.
macro(skip_if_ros_provides kind)
  if("${kind}" STREQUAL "MESSAGES")
    find_ros_prefix(ros_prefix "share/ament_index/resource_index/rosidl_interfaces/${PROJECT_NAME}")
  elseif("${kind}" STREQUAL "BUILD")
    find_ros_prefix(ros_prefix "share/${PROJECT_NAME}/package.xml")
  else()
    message(FATAL_ERROR "skip_if_ros_provides: MESSAGES or BUILD, not '${kind}'")
  endif()

  if(ros_prefix)
    message(STATUS
      "${PROJECT_NAME}: nothing to build or install, ROS 2 provides it in ${ros_prefix}")
    if(EXISTS
      "${CMAKE_INSTALL_PREFIX}/share/ament_index/resource_index/${skip_rule_mark}/${PROJECT_NAME}")
      message(WARNING "An earlier build installed our ${PROJECT_NAME} in ${CMAKE_INSTALL_PREFIX}, "
        "where it may hide the one of ROS 2. Please remove the folders build and install.")
    endif()
    return()
  endif()

  find_package(ament_cmake_core REQUIRED)
  ament_index_register_resource(${skip_rule_mark})

  # The sources of a generated library are compiled together, since reading the same headers for
  # each message takes most of the time. So a message is listed after those of its package that it
  # contains.
  set(CMAKE_UNITY_BUILD ON)
  set(CMAKE_UNITY_BUILD_BATCH_SIZE 0)
endmacro()
