# Goal: an installed agnocast is enough for a plain CMake project in C++17 without ROS. Method:
# configure, build and run one that exchanges messages of its own type, with the installed daemon
# and agnocast-run.
. "$(dirname "$0")/support.sh"
unset AMENT_PREFIX_PATH COLCON_PREFIX_PATH
cmake -S "$here/consumer" -B "$work/build" -DCMAKE_PREFIX_PATH="$PREFIX" >"$work/log" 2>&1 ||
  { cat "$work/log"; fail "configure"; }
cmake --build "$work/build" >"$work/log" 2>&1 || { cat "$work/log"; fail "build"; }
use_prefix "$PREFIX"
start_daemon
expect 0 "100 maps, 0 bytes adopted" agnocast-run "$work/build/consumer"
expect 1 "the heap hook is not loaded" "$work/build/consumer"
