# SPDX-License-Identifier: Apache-2.0

set(_agnocast_components_main ${CMAKE_CURRENT_LIST_DIR}/component_main.cpp.in)

# agnocast_components_register_node(<target> PLUGIN <class> EXECUTABLE <program>
#   [EXECUTOR <executor>] [RESOURCE_INDEX <index>] [SKIP_LIBRARY_DEPENDENCY])
#
# Registers the class of a shared library as a component, and adds a program that runs it. The
# program is linked with the heap hook. EXECUTOR is one of agnocastlib's; the default is
# SingleThreadedAgnocastExecutor. A macro, as that of rclcpp_components is, which sets variables of
# the calling file.
macro(agnocast_components_register_node target)
  cmake_parse_arguments(_agnocast "SKIP_LIBRARY_DEPENDENCY"
    "PLUGIN;EXECUTABLE;EXECUTOR;RESOURCE_INDEX" "" ${ARGN})
  if(_agnocast_UNPARSED_ARGUMENTS)
    message(FATAL_ERROR "agnocast_components_register_node(${target}): unknown arguments: "
      "${_agnocast_UNPARSED_ARGUMENTS}")
  endif()
  foreach(_agnocast_argument PLUGIN EXECUTABLE)
    if(NOT _agnocast_${_agnocast_argument})
      message(FATAL_ERROR
        "agnocast_components_register_node(${target}): ${_agnocast_argument} is missing")
    endif()
  endforeach()
  if(NOT _agnocast_EXECUTOR)
    set(_agnocast_EXECUTOR SingleThreadedAgnocastExecutor)
  endif()
  set(_agnocast_executors
    SingleThreadedAgnocastExecutor MultiThreadedAgnocastExecutor CallbackIsolatedAgnocastExecutor
    AgnocastOnlySingleThreadedExecutor AgnocastOnlyMultiThreadedExecutor
    AgnocastOnlyCallbackIsolatedExecutor)
  if(NOT _agnocast_EXECUTOR IN_LIST _agnocast_executors)
    message(FATAL_ERROR "agnocast_components_register_node(${target}): EXECUTOR is one of "
      "${_agnocast_executors}, not '${_agnocast_EXECUTOR}'")
  endif()

  find_package(rclcpp_components REQUIRED)
  if(_agnocast_RESOURCE_INDEX)
    rclcpp_components_register_nodes(${target} ${_agnocast_PLUGIN}
      RESOURCE_INDEX ${_agnocast_RESOURCE_INDEX})
  else()
    rclcpp_components_register_nodes(${target} ${_agnocast_PLUGIN})
  endif()

  set(_agnocast_executor ${_agnocast_EXECUTOR})
  set(_agnocast_plugin ${_agnocast_PLUGIN})
  set(_agnocast_library $<TARGET_FILE_NAME:${target}>)
  set(_agnocast_source ${PROJECT_BINARY_DIR}/agnocast_components/${_agnocast_EXECUTABLE})
  configure_file(${_agnocast_components_main} ${_agnocast_source}.cpp.in @ONLY)
  file(GENERATE OUTPUT ${_agnocast_source}.cpp INPUT ${_agnocast_source}.cpp.in)
  add_executable(${_agnocast_EXECUTABLE} ${_agnocast_source}.cpp)
  target_link_options(${_agnocast_EXECUTABLE} PRIVATE LINKER:--no-as-needed)
  target_link_libraries(${_agnocast_EXECUTABLE}
    agnocast::heaphook agnocast_components::agnocast_components)
  if(NOT _agnocast_SKIP_LIBRARY_DEPENDENCY)
    add_dependencies(${_agnocast_EXECUTABLE} ${target})
  endif()
  install(TARGETS ${_agnocast_EXECUTABLE} DESTINATION lib/${PROJECT_NAME})
endmacro()
