#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
#
# Goal: an installation serves users under systemd: nodes find the daemon whichever comes first; it
# survives kill -9, restart and a hang as the same incarnation, two users who exchange messages
# meanwhile lose none, and a stop and a start take no message from them either: they rejoin the
# daemon without a store by themselves. A daemon of another layout in place of ours logs why it
# serves nobody and harms nothing. The units are as tight as their document says, and that is
# enough for all this.
# Method: a systemd of its own, agnocast as cmake --install puts it, and systemd_inside.cpp run in
# there.
#
#   systemd_test.sh BUILD_DIRECTORY INSIDE_PROGRAM SUPPORT_DIRECTORY NODE
#                   AGNOCASTD_OF_ANOTHER_LAYOUT [GTEST_OPTION…]
set -euo pipefail
PATH=$PATH:/usr/sbin:/sbin  # not everybody's has them
build=$1 inside=$2 node=$4 other=$5
. "$3/systemd_machine.sh"
shift 5

skip() { echo "SKIPPED: $1"; exit 77; }
[ "$(id -u)" -eq 0 ] || skip "needs root: it boots a systemd"
[ -x /usr/lib/systemd/systemd ] || skip "needs systemd"
for tool in unshare nsenter pivot_root; do command -v "$tool" >/dev/null || skip "needs $tool"; done

dir=$(mktemp -d)
trap 'machine_stop "$dir"; rm -rf "$dir"' EXIT
mkdir "$dir/files"
DESTDIR=$dir/files cmake --install "$build" --prefix /usr >"$dir/install" ||
  { cat "$dir/install"; exit 1; }
# Files that only the test needs: the machine cannot see the build directory.
mkdir "$dir/files/opt" "$dir/files/opt/agnocast"
cp "$inside" "$node" "$other" "$dir/files/opt/agnocast/"
mkdir "$dir/files/opt/agnocast/lib"
if [ -x "$dir/files/usr/bin/talker" ]; then
  ldd "$dir/files/usr/bin/talker" |
    awk '$1 !~ "^libagnocast" && $3 ~ "^/" && $3 !~ "^/(usr/)?lib" { print $3 }' |
    xargs -r cp -L -t "$dir/files/opt/agnocast/lib"
fi
chmod -R a+rX "$dir/files/opt/agnocast"
# Two users who may connect, one who may not, and the user of the example.
cat >"$dir/files/usr/lib/sysusers.d/agnocast-test.conf" <<'END'
u agnocast-one -
u agnocast-two -
u agnocast-stranger -
u robot -
m agnocast-one agnocast
m agnocast-two agnocast
END
# In a sandbox root may lack the right to mount.
unshare --mount --pid --fork true 2>/dev/null || skip "needs the right to make namespaces"
machine_start "$dir"
# As the scripts of a package do it.
machine_run "$dir" systemd-sysusers
machine_run "$dir" systemd-tmpfiles --create agnocast.conf
machine_run "$dir" systemctl enable --quiet agnocastd.service
machine_run "$dir" "/opt/agnocast/$(basename "$inside")" "$@"
