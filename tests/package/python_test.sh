# SPDX-License-Identifier: Apache-2.0
#
# Goal: the CMake lines of the README work wherever another python3 is first in PATH, and CMake
# uses the Python that the user names.
# Method: a python3 without ament's modules goes first in PATH; configure the project by its preset
# with the benchmark, and a message package; check which Python the cache has.
#
#   python_test.sh SOURCES
. "$(dirname "$0")/support.sh"
sources=$1
modules="import ament_package, catkin_pkg, lark, em"
/usr/bin/python3 -c "$modules" 2>/dev/null ||
  { echo "SKIPPED: /usr/bin/python3 has no modules of ament and rosidl"; exit 77; }

# As that of a virtual environment: without the system's packages.
mkdir "$work/first"
printf '#!/bin/sh\nexec /usr/bin/python3 -S "$@"\n' >"$work/first/python3"
chmod +x "$work/first/python3"
export PATH=$work/first:$PATH
python3 -c "$modules" 2>/dev/null && fail "the first python3 has the modules"

# chosen BUILD: prints the Python that the CMake code of ament runs there.
chosen() { sed -n 's/^Python3_EXECUTABLE:[A-Z]*=//p' "$work/$1/CMakeCache.txt"; }
configured() {
  local build=$1
  shift
  cmake "$@" -B "$work/$build" >"$work/log" 2>&1 || { cat "$work/log"; fail "cmake $*"; }
  "$(chosen "$build")" -c "$modules" || fail "cmake $*: it has chosen '$(chosen "$build")'"
}
cd "$sources"
configured preset --preset dev -DAGNOCAST_BUILD_TESTS=OFF -DAGNOCAST_BUILD_BENCH=ON
configured messages -S interfaces/rosidl_default_generators -G Ninja

ln -s /usr/bin/python3 "$work/named"
cmake -S . -B "$work/own" -G Ninja -DAGNOCAST_BUILD_TESTS=OFF \
  -DPython3_EXECUTABLE="$work/named" >"$work/log" 2>&1 ||
  { cat "$work/log"; fail "cmake with a named Python"; }
[ "$(chosen own)" = "$work/named" ] || fail "the named Python is not used, but '$(chosen own)'"
