#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
#
# Goal: a package that was written for the kernel-module system is found, built, installed and run,
# and a component over agnocast_rclcpp in it.
# Method: the package in workspace/ has the CMake lines of that system's samples; its programs and
# its components, in each container, talk to each other.
#   workspace_test.sh FOLDER        where to build
set -euo pipefail

source=$(cd "$(dirname "$0")" && pwd)/workspace
build=$1
prefix=$build/install
patience_s=120  # no step asserts a time; one that takes so long has failed
cmake -S "$source" -B "$build" -DCMAKE_INSTALL_PREFIX="$prefix" -DBUILD_TESTING=OFF
cmake --build "$build"
cmake --install "$build" >/dev/null

export AMENT_PREFIX_PATH=$prefix:$AMENT_PREFIX_PATH
export LD_LIBRARY_PATH=$prefix/lib:${LD_LIBRARY_PATH:-}
log=$build/log
rm -rf "$log" && mkdir "$log"
pids=()
trap 'kill -KILL "${pids[@]}" 2>/dev/null || true; wait 2>/dev/null || true' EXIT
start() { # NAME COMMAND…
  local name=$1
  shift
  stdbuf -oL "$@" >"$log/$name" 2>&1 &
  pids+=($!)
}
stop() {
  local pid
  kill -INT "${pids[@]}" || true  # one may have ended: its status is looked at below
  for pid in "${pids[@]}"; do
    if ! timeout "$patience_s" tail --pid="$pid" -f /dev/null; then
      echo "a program did not end"
      exit 1
    fi
    wait "$pid" || { echo "FAILED: a program ended with status $?"; tail -n 3 "$log"/*; exit 1; }
  done
  pids=()
}
wait_for() { # NAME TEXT
  for ((i = 0; i < 10 * patience_s; ++i)); do
    if grep -q "$2" "$log/$1"; then return; fi
    sleep 0.1
  done
  echo "FAILED: $1 did not say '$2':"
  cat "$log/$1"
  exit 1
}

# Programs: the talker is a program of the package, the listeners are those of components.
start talker "$prefix/lib/sample/talker"
start listener "$prefix/lib/sample/listener"
start only_listener "$prefix/lib/sample/only_listener"
start adapter_listener "$prefix/lib/sample/adapter_listener"
wait_for listener "heard 20"
wait_for adapter_listener "heard 20"
wait_for only_listener "heard 20"
stop

# Components, without the preloaded hook: the containers have it linked.
unset LD_PRELOAD
container_of() {
  echo "$(IFS=:; for p in $AMENT_PREFIX_PATH; do
    if [ -x "$p/lib/agnocast_components/$1" ]; then
      echo "$p/lib/agnocast_components/$1"
      break
    fi
  done)"
}
for container in agnocast_component_container agnocast_component_container_mt \
    agnocast_component_container_cie; do
  start $container "$(container_of $container)"
  "$prefix/lib/sample/load" sample Talker Listener OnlyListener AdapterListener
  wait_for $container "\[listener\]: heard 20"
  wait_for $container "only_listener heard 20"
  wait_for $container "\[adapter_listener\]: heard 20"
  "$prefix/lib/sample/load" --unload
  stop
done
echo "all programs and containers ran"
