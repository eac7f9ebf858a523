#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
#
# Goal: real ROS 2 nodes receive from ours and send to ours, call ours and serve them, and ROS's
# tools show ours under their own names and run our programs; a node of rclcpp that uses agnocast is
# there once; ROS_LOCALHOST_ONLY means the same to the bridge. Method: in a sourced ROS 2 workspace
# with rmw_cyclonedds and demo_nodes_cpp: its command line and its demo nodes, our examples, the
# real daemon and bridge, in a domain of their own on the loopback interface.
#
#   ros2_test.sh BUILD_DIRECTORY
# RELAY_PREFIX: where the component of agnocast_rclcpp's tests is, if agnocast is in the sourced
# workspace; without it, the parts that need these are left out.
set -euo pipefail
build=$1

skip() { echo "SKIPPED: $1"; exit 77; }
command -v ros2 >/dev/null || skip "needs ROS 2: source the setup file of a workspace before ctest"
ros2 pkg prefix rmw_cyclonedds_cpp >/dev/null 2>&1 ||
  skip "needs rmw_cyclonedds_cpp in the sourced workspace"
ros2 pkg prefix demo_nodes_cpp >/dev/null 2>&1 ||
  skip "needs demo_nodes_cpp in the sourced workspace"

dir=$(mktemp -d)
pids=()
end() { kill "${pids[@]}" 2>/dev/null || true; wait 2>/dev/null || true; rm -rf "$dir"; }
trap end EXIT
fail() { echo "FAILED: $1"; tail -n 20 "$dir"/*.log || true; exit 1; }
start() { local log=$1; shift; "$@" >"$dir/$log.log" 2>&1 & pids+=($!); }
# Waits until the command's output has the text; ROS's discovery and its daemon take their time.
shows() {
  local text=$1 said; shift
  for _ in $(seq 20); do
    said=$(timeout 20 "$@" 2>&1 || true)
    case $said in *"$text"*) return 0 ;; esac
    sleep 0.5
  done
  fail "\"$*\" does not show \"$text\": $said"
}

start_talker() {
  start "$1" env LD_PRELOAD="$build/heaphook/libagnocast_heaphook.so" \
    "$build/examples/talker" --rate 10
}

export RMW_IMPLEMENTATION=rmw_cyclonedds_cpp ROS_DOMAIN_ID=$((20 + $$ % 70))
export AGNOCAST_SOCKET=$dir/agnocastd.sock ROS2CLI_DISABLE_DAEMON=1
export CYCLONEDDS_URI="<CycloneDDS><Domain id='any'><General>\
<Interfaces><NetworkInterface name='lo' multicast='false'/></Interfaces>
  <AllowMulticast>false</AllowMulticast></General>\
<Discovery><ParticipantIndex>auto</ParticipantIndex>
  <MaxAutoParticipantIndex>50</MaxAutoParticipantIndex>\
<Peers><Peer address='127.0.0.1'/></Peers></Discovery></Domain></CycloneDDS>"
start agnocastd "$build/daemon/agnocastd" --socket "$AGNOCAST_SOCKET" --foreground
for _ in $(seq 100); do [ -S "$AGNOCAST_SOCKET" ] && break; sleep 0.1; done
start bridge "$build/bridge/agnocast-bridge"

# Ours → ROS 2.
start_talker talker
shows /talker ros2 node list --no-daemon
# While nobody reads it: its writer is announced.
shows "/chatter [std_msgs/msg/String]" ros2 topic list --no-daemon -t
shows "/chatter: std_msgs/msg/String" ros2 node info --no-daemon /talker
shows "Node name: talker" ros2 topic info --no-daemon -v /chatter
# Readers that find the type in DDS. hz runs until it is interrupted, and Python would buffer its
# output until then.
shows "data:" ros2 topic echo --no-daemon --once /chatter
shows "average rate:" env PYTHONUNBUFFERED=1 timeout -s INT 8 ros2 topic hz /chatter

# ROS 2 → ours. The program itself: ros2 run would leave it behind.
start demo "$(ros2 pkg prefix demo_nodes_cpp)/lib/demo_nodes_cpp/talker" \
  --ros-args -r chatter:=from_ros
# The listener judges our talker's numbers, so it reports that these differ.
timeout 30 "$build/examples/listener" --topic from_ros --count 3 --verbose \
  >"$dir/listener.log" 2>&1 || true
grep -qF "I heard: 'Hello World: " "$dir/listener.log" ||
  fail "our listener does not hear ROS's talker"
echo "heard each other"

# A service each way; our client sends copies.
start server env LD_PRELOAD="$build/heaphook/libagnocast_heaphook.so" \
  "$build/examples/add_two_ints_server" --ros-args -r add_two_ints:=of_ours
shows "sum=5" ros2 service call /of_ours example_interfaces/srv/AddTwoInts "{a: 2, b: 3}"
start demo_server "$(ros2 pkg prefix demo_nodes_cpp)/lib/demo_nodes_cpp/add_two_ints_server"
shows "Sum: 5" timeout 15 "$build/examples/add_two_ints_client" 2 3
echo "served each other"

# Our programs by ROS's command.
if [ -n "${RELAY_PREFIX:-}" ]; then
  shows "Hello World: 3" ros2 run agnocast talker --rate 10 --count 3 --verbose \
    --ros-args -r chatter:=run
  echo "ros2 run runs them"
fi

# A node of rclcpp that uses agnocast: its own process announces it in DDS, and the bridge does not.
if [ -n "${RELAY_PREFIX:-}" ]; then
  export AMENT_PREFIX_PATH=$RELAY_PREFIX:$AMENT_PREFIX_PATH
  start container \
    "$(ros2 pkg prefix agnocast_rclcpp)/lib/agnocast_rclcpp/agnocast_component_container"
  shows /ComponentManager ros2 node list --no-daemon
  timeout 60 ros2 component load /ComponentManager agnocast_rclcpp_test_components \
    agnocast_rclcpp::Relay >"$dir/load.log" 2>&1 || fail "the component is not loaded"
  shows /in ros2 topic list --no-daemon
  shows /out_ ros2 topic list --no-daemon
  shows /relay ros2 node list --no-daemon
  nodes=$(ros2 node list --no-daemon 2>&1)
  [ "$(grep -c '^/relay$' <<<"$nodes")" = 1 ] || fail "/relay is not there once: $nodes"
  case $nodes in *"share an exact name"*) fail "$nodes" ;; esac
  topics=$(ros2 topic list --no-daemon)
  out=$(grep -m 1 '^/out_' <<<"$topics")
  start pub ros2 topic pub --rate 10 /in std_msgs/msg/String "data: relayed"
  shows "data: relayed" ros2 topic echo --no-daemon --once "$out" std_msgs/msg/String
  # ros2 node info knows the topics that its own process announces, agnocast-ctl those of ours.
  shows /in "$build/ctl/agnocast-ctl" node info /relay
  shows "$out" "$build/ctl/agnocast-ctl" node info /relay
  echo "the node of rclcpp is there once, and relays"
fi

# Nodes on the loopback device alone, whatever devices the host has.
unset CYCLONEDDS_URI
export ROS_LOCALHOST_ONLY=1 ROS_DOMAIN_ID=$((ROS_DOMAIN_ID + 1))
start local_bridge "$build/bridge/agnocast-bridge"
start_talker local_talker
shows "data:" ros2 topic echo --no-daemon --once /chatter
echo "heard by ROS_LOCALHOST_ONLY=1"
