# SPDX-License-Identifier: Apache-2.0
#
# Chooses the Python for the CMake code of ament and rosidl: the first python3 in PATH, /usr/bin
# last, that has their modules. FindPython3 would take the first one in PATH; one of pyenv or of a
# virtual environment lacks the modules, and the configuration then fails in a file of ament without
# a reason. A choice of the user (-DPython3_EXECUTABLE=…) stays. If no python3 has the modules,
# FindPython3 decides: a build without
# ROS messages needs none of them.

function(agnocast_find_ros_python)
  if(Python3_EXECUTABLE OR Python3_ROOT_DIR)
    return()
  endif()
  # Humble to Jazzy use EmPy 3; other distributions named "em" have no Interpreter.
  set(modules "import ament_package, catkin_pkg, lark, em; em.Interpreter")
  file(TO_CMAKE_PATH "$ENV{PATH}" directories)
  list(APPEND directories /usr/bin)
  list(REMOVE_DUPLICATES directories)
  foreach(directory IN LISTS directories)
    set(python "${directory}/python3")
    if(NOT EXISTS "${python}")
      continue()
    endif()
    execute_process(COMMAND "${python}" -c "${modules}" RESULT_VARIABLE result OUTPUT_QUIET
      ERROR_QUIET)
    if(result EQUAL 0)
      set(Python3_EXECUTABLE "${python}" CACHE FILEPATH
        "The Python that has the modules of ament and rosidl")
      return()
    endif()
  endforeach()
endfunction()

agnocast_find_ros_python()
