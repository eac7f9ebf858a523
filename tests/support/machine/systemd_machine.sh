# SPDX-License-Identifier: Apache-2.0
#
# A real systemd as PID 1 of its own namespaces, for tests of units. Sourced by bash; needs root.
#
#   machine_start DIR      boots. DIR has only DIR/files, a tree that is copied over the root
#   machine_run DIR CMD…   runs a command inside
#   machine_stop DIR       ends it and everything in it
#
# Its root is an overlay of the host's with all writes in a tmpfs; /tmp and /run are empty. It has a
# private mount namespace with read-only kernel settings, so the host does not change.

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
mount -t overlay machine \
  -o "lowerdir=/,upperdir=$dir/machine/written,workdir=$dir/machine/work" "$root"
cp -a "$dir/files/." "$root/"
mkdir -p "$root"/{proc,sys,dev,tmp,run}
mount --rbind /sys "$root/sys"
mount --rbind /dev "$root/dev"
mount -t tmpfs machine "$root/tmp"
mount -t tmpfs machine "$root/run"
mount -t proc machine "$root/proc"
# Most settings there are the host's as well, and systemd would write them when it boots.
for settings in proc/sys sys/kernel/mm; do
  mount --bind "$root/$settings" "$root/$settings"
  mount -o remount,bind,ro "$root/$settings"
done
cd "$root"
mkdir -p former
pivot_root . former
cd /
umount -l /former
exec env -i container=test PATH=/usr/sbin:/usr/bin:/sbin:/bin /usr/lib/systemd/systemd --system \
  --log-level=warning --log-target=console --unit=basic.target
INIT
  chmod +x "$dir/init"
  setsid unshare --pid --mount --uts --ipc --cgroup --fork --kill-child "$dir/init" "$dir" \
    >"$dir/log" 2>&1 </dev/null &
  echo $! >"$dir/outer"
  for i in $(seq 150); do
    # PID 1 of the machine, by its number outside.
    cat "/proc/$(cat "$dir/outer")/task/$(cat "$dir/outer")/children" 2>/dev/null |
      tr -d ' ' >"$dir/pid"
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
