# Goal: a user of agnocast in a colcon workspace needs `<depend>agnocast</depend>`,
# find_package(agnocast) and nothing else.
# Method: build such a workspace on top of the installation, start its nodes with the installed
# agnocastd and agnocast-run, and check their output. In the project's own colcon build the
# underlay is its install/setup.bash, else an installation by itself.
. "$(dirname "$0")/support.sh"
export PATH=/usr/bin:$PATH
if [ "$BUILT" = "$PROJECT/build/agnocast" ] && [ -f "$PROJECT/install/setup.bash" ]; then
  set +u; . "$PROJECT/install/setup.bash"; set -u
else
  use_prefix "$PREFIX"
fi
cp -r "$here/workspace" "$work/workspace"
cd "$work/workspace"
colcon --log-base log build --event-handlers console_direct+ \
  --cmake-args -DPython3_EXECUTABLE=/usr/bin/python3 >"$work/log" 2>&1 ||
  { cat "$work/log"; fail "colcon build"; }
grep -E "warning:|CMake Warning" "$work/log" && fail "building it warns"
set +u; . install/setup.bash; set -u
nodes=install/cloud_counter/lib/cloud_counter

start_daemon
"$nodes/counter" 25 >"$work/counter.out" 2>&1 &
counter=$!
wait_for "$work/daemon.log" "kind=subscription topic=/cloud_count"
wait_for "$work/daemon.log" "kind=subscription topic=/cloud_name"
expect 0 "25 clouds published, 0 bytes adopted" agnocast-run "$nodes/lidar" 25
status=0
wait $counter || status=$?
cat "$work/counter.out"
[ $status -eq 0 ] || fail "counter ended with $status"
grep -qx "25 clouds and 25 names are right" "$work/counter.out" ||
  fail "counter did not receive everything"
