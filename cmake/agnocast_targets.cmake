# Settings of every target in this tree: language level, warnings, sanitizers, coverage. None of
# them reaches a consumer.

set(CMAKE_CXX_STANDARD 20)
set(CMAKE_CXX_STANDARD_REQUIRED ON)
set(CMAKE_CXX_EXTENSIONS OFF)
set(CMAKE_POSITION_INDEPENDENT_CODE ON)
set(CMAKE_CXX_VISIBILITY_PRESET hidden)
set(CMAKE_VISIBILITY_INLINES_HIDDEN ON)
set(CMAKE_EXPORT_COMPILE_COMMANDS ON)
if(NOT CMAKE_BUILD_TYPE AND NOT CMAKE_CONFIGURATION_TYPES)
  set(CMAKE_BUILD_TYPE RelWithDebInfo CACHE STRING "Debug, RelWithDebInfo or Release" FORCE)
endif()
find_program(CCACHE_PROGRAM ccache)
if(CCACHE_PROGRAM AND PROJECT_IS_TOP_LEVEL)
  # ccache caches sources with precompiled headers only if it may ignore __TIME__ and unused macros
  # in them.
  set(CMAKE_CXX_COMPILER_LAUNCHER ${CMAKE_COMMAND} -E env CCACHE_SLOPPINESS=pch_defines,time_macros
    ${CCACHE_PROGRAM})
  set(CMAKE_C_COMPILER_LAUNCHER ${CCACHE_PROGRAM})
endif()

# Seconds that a test may take. Only one that hangs does: on a loaded machine the longest need five
# minutes.
set(agnocast_test_timeout 1200)

option(AGNOCAST_COMPILE_BY_ROOMS "Compile the sources of a directory together: a third of the time"
  ON)

add_library(agnocast_warnings INTERFACE)
target_compile_options(agnocast_warnings INTERFACE
  -Wall -Wextra -Wpedantic -Wconversion -Wsign-conversion -Wformat=2 -Wundef
  -Werror=unused-result
  # Names of other sources are no shadows: agnocast_compile_by_rooms().
  $<$<NOT:$<BOOL:$<TARGET_PROPERTY:UNITY_BUILD>>>:-Wshadow>
  $<$<COMPILE_LANGUAGE:CXX>:-Wnon-virtual-dtor -Woverloaded-virtual -Wold-style-cast>
  $<$<CXX_COMPILER_ID:GNU>:-Wduplicated-cond -Wlogical-op>
  # False alarms of GCC 12: it takes atomics at computed addresses for out of bounds, and the moves
  # and concatenations of std::string for overlapping or too long.
  $<$<CXX_COMPILER_ID:GNU>:-Wno-array-bounds -Wno-stringop-overflow -Wno-stringop-overread
  -Wno-restrict>
  $<$<BOOL:${AGNOCAST_WARNINGS_AS_ERRORS}>:-Werror>)

add_library(agnocast_sanitizers INTERFACE)
if(AGNOCAST_SANITIZE)
  string(REPLACE ";" "," sanitize_list "${AGNOCAST_SANITIZE}")
  target_compile_options(agnocast_sanitizers INTERFACE -fsanitize=${sanitize_list}
    -fno-sanitize-recover=all -fno-omit-frame-pointer)
  target_link_options(agnocast_sanitizers INTERFACE -fsanitize=${sanitize_list})
  if("thread" IN_LIST AGNOCAST_SANITIZE)
    target_compile_definitions(agnocast_sanitizers INTERFACE AGNOCAST_UNDER_THREAD_SANITIZER)
  endif()
  # This check tests memory with a pipe, and reports a fault where no descriptor is left.
  target_compile_options(agnocast_sanitizers INTERFACE -fno-sanitize=vptr)
  # ThreadSanitizer does not model fences. Payload accesses are ordered by acquire and release
  # alone, so its reports about them are valid.
  target_compile_options(agnocast_sanitizers INTERFACE $<$<CXX_COMPILER_ID:GNU>:-Wno-tsan>)
  # Sanitizer instrumentation hides from GCC that a variable is set (std::regex).
  target_compile_options(agnocast_sanitizers INTERFACE
    $<$<CXX_COMPILER_ID:GNU>:-Wno-maybe-uninitialized>)
endif()
option(AGNOCAST_COVERAGE "Measure line coverage (gcov)" OFF)
if(AGNOCAST_COVERAGE)
  target_compile_options(agnocast_sanitizers INTERFACE --coverage)
  target_link_options(agnocast_sanitizers INTERFACE --coverage)
endif()

# agnocast_compile_by_rooms(TARGET): compiles the sources of each directory together. Reading
# headers and making templates takes most of the time of a compiler, so this saves two thirds of it.
# Names in anonymous namespaces must be unique within a directory; agnocast_compile_alone() takes
# sources out. It hides a missing #include; scripts/check --tidy and scripts/test --full compile the
# product's sources alone.
function(agnocast_compile_by_rooms target)
  get_target_property(sources ${target} SOURCES)
  get_property(alone GLOBAL PROPERTY agnocast_compile_alone)
  foreach(source ${sources})
    cmake_path(ABSOLUTE_PATH source NORMALIZE OUTPUT_VARIABLE path)
    if(path IN_LIST alone)
      set_property(SOURCE ${source} PROPERTY SKIP_UNITY_BUILD_INCLUSION ON)
    elseif(source MATCHES "\\.cpp$")
      string(REPLACE "${PROJECT_SOURCE_DIR}/" "" room ${source})
      cmake_path(GET room PARENT_PATH room)
      if(NOT IS_ABSOLUTE "${source}" AND "${CMAKE_CURRENT_SOURCE_DIR}/" MATCHES
        "^${PROJECT_SOURCE_DIR}/tests/")
        set(room "")  # tests below one folder are small, and have the same headers
      endif()
      string(MAKE_C_IDENTIFIER "room_${room}" room)
      set_property(SOURCE ${source} PROPERTY UNITY_GROUP ${room})
    endif()
  endforeach()
  set_target_properties(${target} PROPERTIES UNITY_BUILD ON UNITY_BUILD_MODE GROUP)
endfunction()
# agnocast_compile_alone(SOURCES…): keeps sources apart in which one name fits several things.
function(agnocast_compile_alone)
  foreach(source ${ARGN})
    cmake_path(ABSOLUTE_PATH source)
    set_property(GLOBAL APPEND PROPERTY agnocast_compile_alone ${source})
  endforeach()
endfunction()

# agnocast_compile_unoptimised(SOURCES…): where tests are built, for those that read a command line.
# CLI11 is all in its header, and optimising it takes longer than the rest of the source.
function(agnocast_compile_unoptimised)
  if(NOT AGNOCAST_BUILD_TESTS)
    return()
  endif()
  agnocast_compile_alone(${ARGN})
  set_source_files_properties(${ARGN} PROPERTIES COMPILE_OPTIONS -O0 SKIP_PRECOMPILE_HEADERS ON)
endfunction()

# agnocast_target_defaults(TARGET): for one of our own targets, privately: warnings, sanitizers, and
# the top of the tree, where paths in #includes start. No target exports the top, so what links a
# library of ours finds only its public headers; scripts/layers limits what a room may include.
# Sanitizers produce much code, so short-lived programs are not optimised under them: their
# directories set AGNOCAST_SANITIZED_LEVEL. That, and debug information with line numbers only
# (-g1), for the sanitizers' reports, reduces the compile time to three quarters.
set(AGNOCAST_SANITIZED_LEVEL 1)
function(agnocast_target_defaults target)
  string(FIND "${CMAKE_CURRENT_SOURCE_DIR}" "${PROJECT_SOURCE_DIR}/tests" place)
  target_include_directories(${target} PRIVATE ${PROJECT_SOURCE_DIR})
  if(AGNOCAST_COMPILE_BY_ROOMS)
    agnocast_compile_by_rooms(${target})
  endif()
  if(AGNOCAST_SANITIZE)
    target_compile_options(${target} PRIVATE -O${AGNOCAST_SANITIZED_LEVEL} -g1)
    # Only what a test runs: programs for users, as far as tests depend on them.
    get_target_property(type ${target} TYPE)
    if(type STREQUAL EXECUTABLE AND place EQUAL -1)
      set_target_properties(${target} PROPERTIES EXCLUDE_FROM_ALL ON)
    endif()
  elseif(AGNOCAST_BUILD_TESTS)
    # No debug information: line numbers alone take some hundredths of the time to compile, and make
    # objects six times as large. The preset dev has all of it.
    target_compile_options(${target} PRIVATE $<$<CONFIG:RelWithDebInfo>:-g0>)
  endif()
  target_link_libraries(${target} PRIVATE $<BUILD_INTERFACE:agnocast_warnings>
    $<BUILD_INTERFACE:agnocast_sanitizers>)
endfunction()

# With the times of the headers in it, a compiler cache would know a precompiled header in no other
# clone.
set(agnocast_precompile_options "$<$<CXX_COMPILER_ID:Clang>:SHELL:-Xclang -fno-pch-timestamp>")
# agnocast_precompile(TARGET [GROUP name] [HEADERS …]): if tests are built, precompiles common
# headers once for all targets of a group, which have the same compile options. Only headers from
# outside this tree, so that a change in the tree recompiles only the sources that include it.
# They hide a missing #include; scripts/check --tidy and scripts/test --full do without.
function(agnocast_precompile target)
  if(NOT AGNOCAST_BUILD_TESTS)
    return()
  endif()
  cmake_parse_arguments(arg "" "GROUP" "HEADERS" ${ARGN})
  if(NOT arg_GROUP)
    set(arg_GROUP std)
  endif()
  set(headers agnocast_headers_${arg_GROUP})
  if(NOT TARGET ${headers})
    add_library(${headers} OBJECT ${PROJECT_SOURCE_DIR}/tests/support/headers.cpp)
    target_link_libraries(${headers} PRIVATE tl::expected)
    agnocast_target_defaults(${headers})
    target_compile_options(${headers} PRIVATE ${agnocast_precompile_options})
    target_precompile_headers(${headers} PRIVATE <tl/expected.hpp> <algorithm> <array> <atomic>
      <charconv> <chrono> <condition_variable>
      <cstdint> <cstring> <deque> <functional> <map> <memory> <mutex> <optional> <set> <span>
      <string> <string_view> <thread> <tuple>
      <unordered_map> <utility> <variant> <vector> ${arg_HEADERS})
  endif()
  target_precompile_headers(${target} REUSE_FROM ${headers})
endfunction()
