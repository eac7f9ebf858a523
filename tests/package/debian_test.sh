#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
#
# Goal: the Debian packages are clean, can be installed, upgraded under traffic, removed and
# purged, and are all that a user needs to build and run a workspace of his own. Method: cpack
# makes them from this build tree, and a next version of them is made; lintian reads them; dpkg
# installs them in a machine of its own, with a real systemd, in which debian_inside.sh does the
# rest.
#
#   debian_test.sh BUILD_DIRECTORY SOURCE_DIRECTORY HONEST_NODE
set -euo pipefail
PATH=$PATH:/usr/sbin:/sbin  # not everybody's has them
build=$1 source=$2 node=$3
. "$source/tests/support/machine/systemd_machine.sh"

skip() { echo "SKIPPED: $1"; exit 77; }
[ "$(id -u)" -eq 0 ] || skip "needs root: it boots a systemd"
[ -x /usr/lib/systemd/systemd ] || skip "needs systemd"
for tool in lintian dpkg cpack unshare nsenter pivot_root setpriv; do
  command -v "$tool" >/dev/null || skip "needs $tool"
done
# In a sandbox root may lack the right to mount.
unshare --mount --pid --fork true 2>/dev/null || skip "needs the right to make namespaces"

dir=$(mktemp -d)
trap 'machine_stop "$dir"; rm -rf "$dir"' EXIT
here=$dir/files/opt/agnocast
mkdir -p "$here/lib"
mkdir "$here/first" "$here/next"
cpack --config "$build/CPackConfig.cmake" -B "$dir/cpack" >"$dir/log" 2>&1 ||
  { cat "$dir/log"; exit 1; }
mv "$dir"/cpack/*.deb "$here/first"
# The next version differs by its number alone: it takes a second instead of as long again.
for package in "$here"/first/*.deb; do
  rm -rf "$dir/unpacked"
  dpkg-deb -R "$package" "$dir/unpacked"
  grep -l 0upstream1 "$dir"/unpacked/DEBIAN/* | xargs sed -i 's/-0upstream1/-0upstream2/g'
  dpkg-deb -Znone -b "$dir/unpacked" \
    "$here/next/$(basename "${package/-0upstream1/-0upstream2}")" >/dev/null
done
lintian --allow-root --no-cfg --fail-on error,warning "$here"/first/*.deb

# The packages have every file of an ordinary installation, except for examples, demo and
# benchmark, which need message packages that Debian lacks, and colcon's hooks. Debian has libraries
# and units elsewhere.
files_of() { sed -E '/\/$/d; s,^\./(usr/)?,,; s,^lib/[^/]*-linux-gnu[^/]*/,lib/,' | sort -u; }
DESTDIR=$dir/plain cmake --install "$build" --prefix /usr >/dev/null
(cd "$dir/plain" && find . ! -type d) | files_of >"$dir/installed"
for package in "$here"/first/*.deb; do dpkg-deb --fsys-tarfile "$package" | tar t; done |
  files_of >"$dir/packaged"
forgotten=$(comm -23 "$dir/installed" "$dir/packaged" | grep -vxE \
  -e '(bin|lib/agnocast)/(talker|listener|cloud_(publisher|subscriber))' \
  -e '(bin|lib/agnocast)/add_two_ints_(server|client)' -e 'bin/agnocast-bench(-plot)?' \
  -e 'share/agnocast/schemas/bench-1.json' -e 'libexec/agnocast/(agnocast_)?demo.*' \
  -e 'share/doc/agnocast/LICENSE' -e 'share/agnocast/environment/.*') || true
[ -z "$forgotten" ] || { echo "FAILED: in no package: $forgotten"; exit 1; }

# A user's files: a workspace, and message packages that are no packages of Debian yet.
cp -r "$source/tests/package/workspace" "$here/workspace"
IFS=: read -r -a prefixes <<<"${AMENT_PREFIX_PATH:-}"
for prefix in "${prefixes[@]}"; do
  [ -e "$prefix/share/agnocast/package.xml" ] || cp -rL "$prefix" "$here/lib/"
done
cp "$node" "$here/honest_node"
cp "$source"/tests/package/{debian_inside,support}.sh "$here/"
chmod -R a+rX "$here"

machine_start "$dir"
machine_run "$dir" env -i PATH=/usr/sbin:/usr/bin:/sbin:/bin LANG=C.UTF-8 \
  bash /opt/agnocast/debian_inside.sh "$build" "$source"
