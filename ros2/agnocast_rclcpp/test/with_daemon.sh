#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Runs a program under agnocast-run with an agnocastd of its own, and in a ROS domain that tests of
# other workspaces on this machine hardly have: with_daemon.sh PROGRAM [ARGUMENTS]
# AGNOCAST_TEST_CONFIG: its configuration.
set -euo pipefail

directory=$(mktemp -d)
daemon=
trap 'test -z "$daemon" || kill "$daemon" 2>/dev/null; wait; rm -rf "$directory"' EXIT
export AGNOCAST_SOCKET=$directory/agnocastd.sock
agnocastd --foreground --socket "$AGNOCAST_SOCKET" \
  ${AGNOCAST_TEST_CONFIG:+--config "$AGNOCAST_TEST_CONFIG"} >"$directory/log" 2>&1 &
daemon=$!
export AGNOCAST_TEST_DAEMON=$daemon  # its supervisor
for ((i = 0; i < 100; ++i)); do
  if [ -S "$AGNOCAST_SOCKET" ]; then break; fi
  sleep 0.1
done
[ -S "$AGNOCAST_SOCKET" ] || { cat "$directory/log" >&2; exit 1; }
export ROS_DOMAIN_ID=$((1 + $$ % 100))
AGNOCAST_DAEMON_UID=$(id -u) agnocast-run "$@"
