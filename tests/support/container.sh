#!/bin/bash
# SPDX-License-Identifier: Apache-2.0
#
# Runs a program in what a container is to the kernel: mount, IPC, PID, UTS and network namespaces of its own, an empty root
# with nothing of the host but its programs, its own /proc, and what is mounted into it on purpose. Needs root.
#
#   CONTAINER_ROOT     an empty directory, where the root is built
#   CONTAINER_MOUNTS   lines "OUTSIDE INSIDE": directories or files
#   CONTAINER_UID      the user; CONTAINER_GROUPS: its groups besides the one of the same number, separated by commas
#   CONTAINER_USER_NAMESPACE   not empty: that user makes the container itself, and is root in it (rootless)
#
# The program is process 1 of it, and the only child of the process that this becomes; it dies with that one.
set -e
PATH=$PATH:/usr/sbin:/sbin  # not everybody's has them
as_user=(setpriv "--reuid=$CONTAINER_UID" "--regid=$CONTAINER_UID")
if [ -n "$CONTAINER_GROUPS" ]; then
  as_user+=("--groups=$CONTAINER_GROUPS")
else
  as_user+=(--clear-groups)
fi
if [ -z "$CONTAINER_INSIDE" ]; then
  export CONTAINER_INSIDE=yes
  # The user may not be able to walk to this file.
  again=(unshare --mount --ipc --pid --uts --net --fork --kill-child)
  inside=(bash -c "$(cat "$0")" "$0" "$@")
  [ -z "$CONTAINER_USER_NAMESPACE" ] || exec "${as_user[@]}" "${again[@]}" --user --map-root-user -- "${inside[@]}"
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
