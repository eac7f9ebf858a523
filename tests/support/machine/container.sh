#!/bin/bash
# SPDX-License-Identifier: Apache-2.0
#
# Runs a program in what the kernel sees as a container: its own mount, IPC, PID, UTS and network
# namespaces, a root with only the host's programs, its own /proc and explicit mounts. Needs root.
#
#   CONTAINER_ROOT     an empty directory in which the root is built
#   CONTAINER_MOUNTS   lines "OUTSIDE INSIDE": directories or files
#   CONTAINER_UID      the user; CONTAINER_GROUPS: its other groups, separated by commas
#   CONTAINER_USER_NAMESPACE   not empty: the user makes the container and is root in it (rootless)
#
# The program is process 1 of the container, and dies with its parent, the process of this script.
set -e
PATH=$PATH:/usr/sbin:/sbin  # not every user's PATH has them
as_user=(setpriv "--reuid=$CONTAINER_UID" "--regid=$CONTAINER_UID")
if [ -n "$CONTAINER_GROUPS" ]; then
  as_user+=("--groups=$CONTAINER_GROUPS")
else
  as_user+=(--clear-groups)
fi
if [ -z "$CONTAINER_INSIDE" ]; then
  export CONTAINER_INSIDE=yes
  # The user may have no access to this file's directory.
  again=(unshare --mount --ipc --pid --uts --net --fork --kill-child)
  inside=(bash -c "$(cat "$0")" "$0" "$@")
  [ -z "$CONTAINER_USER_NAMESPACE" ] ||
    exec "${as_user[@]}" "${again[@]}" --user --map-root-user -- "${inside[@]}"
  exec "${again[@]}" -- "${inside[@]}"
fi

root=$CONTAINER_ROOT
mount --make-rprivate /
mount -t tmpfs -o mode=0755 container "$root"
mount_at() {
  if [ -d "$1" ]; then
    mkdir -p "$root$2"
  else
    mkdir -p "$root${2%/*}"
    touch "$root$2"
  fi
  mount --rbind "$1" "$root$2"
}
for path in /bin /dev /etc /lib /lib32 /lib64 /libx32 /sbin /usr; do
  if [ -L "$path" ]; then
    cp -P "$path" "$root$path"
  elif [ -e "$path" ]; then
    mount_at "$path" "$path"
  fi
done
while read -r outside inside; do
  [ -z "$outside" ] || mount_at "$outside" "$inside"
done <<<"$CONTAINER_MOUNTS"
mkdir -p "$root/proc" "$root/tmp" "$root/former"
chmod 1777 "$root/tmp"
mount -t proc container "$root/proc"
hostname container
cd "$root"
pivot_root . former
umount -l /former
cd /
[ -z "$CONTAINER_USER_NAMESPACE" ] || exec "$@"
exec "${as_user[@]}" --bounding-set=-all --no-new-privs --pdeathsig KILL "$@"
