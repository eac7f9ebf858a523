#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
#
# Goal: under systemd a killed bridge is restarted at once, and messages flow both ways; its units
# are valid and tight.
# Method: a systemd of its own, agnocast as cmake --install puts it, and bridge_systemd_inside.cpp
# run in there.
#
#   bridge_systemd_test.sh BUILD_DIRECTORY INSIDE_PROGRAM SUPPORT_DIRECTORY [GTEST_OPTION…]
set -euo pipefail
PATH=$PATH:/usr/sbin:/sbin  # not everybody's has them
build=$1 inside=$2
. "$3/systemd_machine.sh"
shift 3

skip() { echo "SKIPPED: $1"; exit 77; }
[ "$(id -u)" -eq 0 ] || skip "needs root: it boots a systemd"
[ -x /usr/lib/systemd/systemd ] || skip "needs systemd"
for tool in unshare nsenter pivot_root; do command -v "$tool" >/dev/null || skip "needs $tool"; done
# In a sandbox root may lack the right to mount.
unshare --mount --pid --fork true 2>/dev/null || skip "needs the right to make namespaces"

dir=$(mktemp -d)
trap 'machine_stop "$dir"; rm -rf "$dir"' EXIT
mkdir "$dir/files"
DESTDIR=$dir/files cmake --install "$build" --prefix /usr >"$dir/install" ||
  { cat "$dir/install"; exit 1; }
# The machine cannot see the build directory, and message packages are not installed.
mkdir -p "$dir/files/opt/agnocast/lib" "$dir/files/etc/agnocast"
cp "$inside" "$dir/files/opt/agnocast/"
ldd "$inside" |
  awk '$1 !~ "^libagnocast" && $3 ~ "^/" && $3 !~ "^/(usr/)?lib" { print $3 }' |
  sort -u | xargs -r cp -L -t "$dir/files/opt/agnocast/lib"
chmod -R a+rX "$dir/files/opt/agnocast"
machine_start "$dir"
machine_run "$dir" systemd-sysusers
machine_run "$dir" systemd-tmpfiles --create agnocast.conf
machine_run "$dir" env LD_LIBRARY_PATH=/opt/agnocast/lib "/opt/agnocast/$(basename "$inside")" "$@"
