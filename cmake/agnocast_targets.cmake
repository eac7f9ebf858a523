# What every target of this tree shares: language level, warnings, sanitizers, coverage. None of it reaches a consumer.

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
  set(CMAKE_CXX_COMPILER_LAUNCHER ${CCACHE_PROGRAM})
  set(CMAKE_C_COMPILER_LAUNCHER ${CCACHE_PROGRAM})
endif()

add_library(agnocast_warnings INTERFACE)
target_compile_options(agnocast_warnings INTERFACE
  -Wall -Wextra -Wpedantic -Wshadow -Wconversion -Wsign-conversion -Wformat=2 -Wundef
  -Werror=unused-result
  $<$<COMPILE_LANGUAGE:CXX>:-Wnon-virtual-dtor -Woverloaded-virtual -Wold-style-cast>
  $<$<CXX_COMPILER_ID:GNU>:-Wduplicated-cond -Wlogical-op>
  # False alarms of GCC 12: atomics at computed addresses as out of bounds, std::string concatenation as overlapping.
  $<$<CXX_COMPILER_ID:GNU>:-Wno-array-bounds -Wno-stringop-overflow -Wno-restrict>
  $<$<BOOL:${AGNOCAST_WARNINGS_AS_ERRORS}>:-Werror>)

add_library(agnocast_sanitizers INTERFACE)
if(AGNOCAST_SANITIZE)
  string(REPLACE ";" "," sanitize_list "${AGNOCAST_SANITIZE}")
  target_compile_options(agnocast_sanitizers INTERFACE -fsanitize=${sanitize_list} -fno-sanitize-recover=all -fno-omit-frame-pointer)
  target_link_options(agnocast_sanitizers INTERFACE -fsanitize=${sanitize_list})
  # ThreadSanitizer does not model fences. Payload accesses are ordered by acquire and release alone, so its verdict on them stands.
  target_compile_options(agnocast_sanitizers INTERFACE $<$<CXX_COMPILER_ID:GNU>:-Wno-tsan>)
  # What a sanitizer adds hides from GCC that something is set (std::regex).
  target_compile_options(agnocast_sanitizers INTERFACE $<$<CXX_COMPILER_ID:GNU>:-Wno-maybe-uninitialized>)
endif()
option(AGNOCAST_COVERAGE "Measure line coverage (gcov)" OFF)
if(AGNOCAST_COVERAGE)
  target_compile_options(agnocast_sanitizers INTERFACE --coverage)
  target_link_options(agnocast_sanitizers INTERFACE --coverage)
endif()

# agnocast_target_defaults(TARGET): warnings and sanitizers for one of our own targets, privately.
# Sanitizers make much code of little, so what runs for a moment only is not optimised under them: the directories that set
# AGNOCAST_SANITIZED_LEVEL. That, and line numbers alone, is three quarters of the time to compile it.
set(AGNOCAST_SANITIZED_LEVEL 1)
function(agnocast_target_defaults target)
  if(AGNOCAST_SANITIZE)
    target_compile_options(${target} PRIVATE -O${AGNOCAST_SANITIZED_LEVEL} -g1)
  endif()
  target_link_libraries(${target} PRIVATE $<BUILD_INTERFACE:agnocast_warnings> $<BUILD_INTERFACE:agnocast_sanitizers>)
endfunction()
