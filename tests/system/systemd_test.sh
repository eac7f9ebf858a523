#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
#
# Goal: under systemd the daemon survives kill -9 and restart as the same incarnation, two users who exchange messages meanwhile lose none,
# and a stop and a start take no message from them either: they come to the daemon that knows nobody by themselves. A daemon of another
# layout in place of ours says why it serves nobody and harms nothing.
# Method: a systemd of its own, our unit as it is installed, and systemd_inside.cpp run in there.
#
#   systemd_test.sh AGNOCASTD UNIT INSIDE_PROGRAM SUPPORT_DIRECTORY NODE LIBRARY HOOK AGNOCASTD_OF_ANOTHER_LAYOUT
set -euo pipefail
agnocastd=$1 unit=$2 inside=$3 node=$5 library=$6 hook=$7 other=$8
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
# Users' processes: what is built lies where the machine cannot see it.
mkdir -p "$dir/files/opt/agnocast" "$dir/files/etc/agnocast"
cp "$node" "$library" "$hook" "$other" "$dir/files/opt/agnocast/"
chmod -R a+rX "$dir/files/opt/agnocast"
printf '[daemon]\nsocket_mode = "0666"\n' >"$dir/files/etc/agnocast/agnocastd.toml"
# A sandbox may have root and no right to mount.
unshare --mount --pid --fork true 2>/dev/null || skip "needs the right to make namespaces"
machine_start "$dir"
machine_run "$dir" env LD_LIBRARY_PATH=/opt/agnocast /usr/bin/agnocast-systemd-inside
