#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
#
# Goal: under systemd the daemon survives kill -9 and restart as the same incarnation, and a stop leaves nothing behind.
# Method: a systemd of its own, our unit as it is installed, and systemd_inside.cpp run in there.
#
#   systemd_test.sh AGNOCASTD UNIT INSIDE_PROGRAM SUPPORT_DIRECTORY
set -euo pipefail
agnocastd=$1 unit=$2 inside=$3
. "$4/systemd_machine.sh"

skip() { echo "SKIPPED: $1"; exit 77; }
[ "$(id -u)" -eq 0 ] || skip "needs root: it boots a systemd"
[ -x /usr/lib/systemd/systemd ] || skip "needs systemd"
for tool in unshare nsenter pivot_root; do command -v "$tool" >/dev/null || skip "needs $tool"; done

dir=$(mktemp -d)
trap 'machine_stop "$dir"; rm -rf "$dir"' EXIT
mkdir -p "$dir/files/usr/bin" "$dir/files/etc/systemd/system"
cp "$agnocastd" "$dir/files/usr/bin/agnocastd"
cp "$inside" "$dir/files/usr/bin/agnocast-systemd-inside"
cp "$unit" "$dir/files/etc/systemd/system/agnocastd.service"
# A sandbox may have root and no right to mount.
unshare --mount --pid --fork true 2>/dev/null || skip "needs the right to make namespaces"
machine_start "$dir"
machine_run "$dir" /usr/bin/agnocast-systemd-inside
