# SPDX-License-Identifier: Apache-2.0
#
# A real systemd as PID 1 of namespaces of its own, for tests of units. To be sourced by bash; needs root.
#
#   machine_start DIR      boots. DIR is the caller's and empty but for DIR/files, a tree that is laid over the root directory
#   machine_run DIR CMD…   runs a command inside
#   machine_stop DIR       ends it and everything in it
#
# Its root is an overlay of the host's, with everything that is written in a tmpfs of the machine; /tmp and /run are empty. All
# mounts are made in a mount namespace that nobody else sees, and the kernel's settings are read-only in it; so nothing of the host
# changes and nothing is left.

machine_start() {
  local dir=$1 state="" i
  cat >"$dir/init" <<'INIT'
#!/bin/bash
set -e
dir=$1
mount --make-rprivate /
mkdir "$dir/machine"
mount -t tmpfs machine "$dir/machine"
mkdir "$dir"/machine/{written,work,root}
root=$dir/machine/root
mount -t overlay machine -o "lowerdir=/,upperdir=$dir/machine/written,workdir=$dir/machine/work" "$root"
cp -a "$dir/files/." "$root/"
mkdir -p "$root"/{proc,sys,dev,tmp,run}
mount --rbind /sys "$root/sys"
mount --rbind /dev "$root/dev"
mount -t tmpfs machine "$root/tmp"
mount -t tmpfs machine "$root/run"
mount -t proc machine "$root/proc"
# Most of what is in there is the host's as well, and systemd would write it when it boots.
for settings in proc/sys sys/kernel/mm; do
  mount --bind "$root/$settings" "$root/$settings"
  mount -o remount,bind,ro "$root/$settings"
done
cd "$root"
mkdir -p former
pivot_root . former
cd /
umount -l /former
exec env -i container=test PATH=/usr/sbin:/usr/bin:/sbin:/bin /usr/lib/systemd/systemd --system --log-level=warning \
  --log-target=console --unit=basic.target
INIT
  chmod +x "$dir/init"
  setsid unshare --pid --mount --uts --ipc --cgroup --fork --kill-child "$dir/init" "$dir" >"$dir/log" 2>&1 </dev/null &
  echo $! >"$dir/outer"
  for i in $(seq 150); do
    # PID 1 of the machine, by its number out here.
    cat "/proc/$(cat "$dir/outer")/task/$(cat "$dir/outer")/children" 2>/dev/null | tr -d ' ' >"$dir/pid"
    if [ -s "$dir/pid" ] && [ "$(cat "/proc/$(cat "$dir/pid")/comm" 2>/dev/null)" = systemd ]; then
      state=$(machine_run "$dir" systemctl is-system-running 2>/dev/null || true)
      case $state in running | degraded) return 0 ;; esac
    fi
    sleep 0.2
  done
  echo "the machine does not come up: $state" >&2
  cat "$dir/log" >&2
  return 1
}

machine_run() {
  local dir=$1
  shift
  nsenter -t "$(cat "$dir/pid")" -a "$@"
}

machine_stop() {
  local dir=$1
  if [ -s "$dir/pid" ]; then kill -KILL "$(cat "$dir/pid")" 2>/dev/null || true; fi
  if [ -s "$dir/outer" ]; then wait "$(cat "$dir/outer")" 2>/dev/null || true; fi
}
