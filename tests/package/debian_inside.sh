# SPDX-License-Identifier: Apache-2.0
#
# Runs inside the machine of debian_test.sh. Beside it lie the packages, in first/ and next/, and a
# user's files.
#
#   debian_inside.sh DIRECTORY…     directories to hide here: where agnocast was built
. "$(dirname "$0")/support.sh"
for directory in "$@"; do
  if [ -d "$directory" ]; then mount -t tmpfs hidden "$directory"; fi
done
# A container's configuration starts no service and leaves out documents; nor do we need an index
# of manual pages.
rm -f /usr/sbin/policy-rc.d /etc/dpkg/dpkg.cfg.d/* /var/lib/man-db/auto-update
export DEBIAN_FRONTEND=noninteractive

library=$(dpkg-deb -f /opt/agnocast/first/libagnocast[0-9]*.deb Package)

say() { echo "== $1 (${SECONDS} s)"; }
dpkg_quietly() { dpkg "$@" >"$work/dpkg" 2>&1 </dev/null || { cat "$work/dpkg"; fail "dpkg $1"; }; }
units() { systemctl "$1" agnocastd.socket agnocastd.service 2>&1 | sort -u; }
main_pid() { systemctl show --value -p MainPID agnocastd; }
# Call it in a subshell of its own: it becomes the command.
become() {
  exec setpriv --reuid="$1" --regid="$1" --init-groups env HOME=/opt/agnocast/home "${@:2}"
}
as() { (become "$@"); }

# Lists the files in places where packages may leave some, except those that machine and dpkg write
# about themselves.
files() {
  find /etc /usr /var -xdev \
    \( -path /var/lib/dpkg -o -path /var/cache -o -path /var/log -o -path /var/tmp \) -prune -o \
    ! -type d ! -path '/etc/*-' ! -path /etc/.pwd.lock ! -path '/etc/ld.so.cache*' -print | sort
}
# Lists the files added since before the first package: one line each.
left() { comm -13 "$work/before" <(files); }

# A node of tests/hostile, steered: start_node NAME USER; ask NAME WORDS… prints its answer.
start_node() {
  mkfifo "$work/$1.in" "$work/$1.out"
  become "$2" /opt/agnocast/honest_node 0 <"$work/$1.in" >"$work/$1.out" 2>"$work/$1.err" &
  eval "$1_pid=$!"
  exec {fd}>"$work/$1.in"; eval "$1_in=$fd"
  exec {fd}<"$work/$1.out"; eval "$1_out=$fd"
}
ask() {
  local in=$1_in out=$1_out answer
  echo "${*:2}" >&"${!in}"
  read -r -t 60 -u "${!out}" answer ||
    { cat "$work/$1.err" >&2; fail "$1 does not answer '${*:2}'"; }
  echo "$answer"
}
# The publisher: PUBLISHED REFUSED. The subscriber: RECEIVED WRONG LOST.
sent() { ask publisher state | cut -d ' ' -f 1,2; }
got() { ask subscriber state | cut -d ' ' -f 3-5; }
# eventually TEXT COMMAND…: waits until the command prints this.
eventually() {
  local said=
  for _ in $(seq 600); do
    said=$("${@:2}")
    [ "$said" = "$1" ] && return 0
    sleep 0.1
  done
  fail "${*:2} says '$said', not '$1'"
}
flows_on() {
  local received
  received=$(got | cut -d ' ' -f 1)
  for _ in $(seq 600); do
    [ "$(got | cut -d ' ' -f 1)" -gt $((received + 100)) ] && return 0
    sleep 0.1
  done
  fail "messages do not flow: $(sent), $(got)"
}

# Its DDS stays on this machine.
has_bridge=$(ls /opt/agnocast/first/agnocast-bridge_*.deb 2>/dev/null || true)
bridge=${has_bridge:+agnocast-bridge}
cat >/etc/default/agnocast-bridge <<END
CYCLONEDDS_URI="<CycloneDDS><Domain id='any'><General>\
<Interfaces><NetworkInterface name='lo'/></Interfaces><AllowMulticast>false</AllowMulticast>\
</General></Domain></CycloneDDS>"
END
bridge_is() {
  [ -z "$bridge" ] || [ "$(systemctl is-active agnocast-bridge)" = "$1" ] ||
    { systemctl status agnocast-bridge; fail "the bridge is not $1: $2"; }
}

say "installation"
files >"$work/before"
dpkg_quietly -i /opt/agnocast/first/*.deb
[ "$(units is-active)" = active ] || fail "the daemon does not run after the installation"
[ "$(units is-enabled)" = enabled ] || fail "it would not run after the next start of the machine"
[ "$(readlink "/proc/$(main_pid)/exe")" = /usr/bin/agnocastd ] || fail "another program runs"
for page in agnocast-ctl.1 agnocast-run.1 agnocast-errors.7 agnocastd.8; do
  [ -f /usr/share/man/man${page#*.}/$page.gz ] || fail "there is no manual page $page"
done
for unit in service socket; do
  document=$(systemctl show --value -p Documentation agnocastd.$unit)
  [ -f "${document#file://}" ] || fail "agnocastd.$unit points to $document"
done
bridge_is active "after the installation"
if [ -n "$bridge" ]; then
  [ "$(systemctl is-enabled agnocast-bridge)" = enabled ] ||
    fail "the bridge would not run after the next start of the machine"
  [ -f /usr/share/man/man8/agnocast-bridge.8.gz ] && [ -f /usr/share/man/man5/bridge.toml.5.gz ] ||
    fail "manual pages of the bridge"
  document=$(systemctl show --value -p Documentation agnocast-bridge)
  [ -f "${document#file://}" ] || fail "agnocast-bridge.service points to $document"
  agnocast-bridge --check-config || fail "the configuration of the bridge as it is installed"
  [ -S /run/agnocast-bridge/bridge-0.sock ] || fail "the bridge has no socket for its status"
fi
useradd --groups agnocast one
useradd --groups agnocast two
useradd stranger
as one agnocast-ctl verify >"$work/out" || fail "$(cat "$work/out")"
expect 5 "this user may not do that" as stranger agnocast-ctl status
agnocastd --check-config || fail "the configuration as it is installed"
# The program of the commands that take part finds its libraries.
as one agnocast-ctl topic pub --help | grep "topic pub" >/dev/null ||
  fail "agnocast-ctl topic pub does not start"

say "a user's workspace"
mkdir /opt/agnocast/home
chown -R one /opt/agnocast/{workspace,home}
for prefix in /opt/agnocast/lib/*; do
  AMENT_PREFIX_PATH=$prefix${AMENT_PREFIX_PATH:+:$AMENT_PREFIX_PATH}
  LD_LIBRARY_PATH=$prefix/lib${LD_LIBRARY_PATH:+:$LD_LIBRARY_PATH}
done
export AMENT_PREFIX_PATH CMAKE_PREFIX_PATH=$AMENT_PREFIX_PATH LD_LIBRARY_PATH
cd /opt/agnocast/workspace
as one colcon --log-base log build --event-handlers console_direct+ \
  --cmake-args -DPython3_EXECUTABLE=/usr/bin/python3 >"$work/log" 2>&1 ||
  { cat "$work/log"; fail "colcon build"; }
nodes=/opt/agnocast/workspace/install/cloud_counter/lib/cloud_counter
# The package has messages of its own.
LD_LIBRARY_PATH=${nodes%/*}:$LD_LIBRARY_PATH
libraries=/usr/lib/$(dpkg-architecture -qDEB_HOST_MULTIARCH)
as two "$nodes/counter" 25 >"$work/counter" 2>&1 &
counter=$!
topic_is_there() {
  as one agnocast-ctl topic info /cloud_name >/dev/null 2>&1 && echo yes || echo no
}
eventually yes topic_is_there
expect 0 "25 clouds published, 0 bytes adopted" as one agnocast-run "$nodes/lidar" 25
wait $counter || { cat "$work/counter"; fail "counter"; }
grep -qx "25 clouds and 25 names are right" "$work/counter" ||
  fail "counter did not receive everything"
as one "$nodes/lidar" 1 >"$work/lidar" 2>&1 || { cat "$work/lidar"; fail "lidar without the hook"; }
grep -Eq '^1 cloud.* published, [1-9][0-9]* bytes adopted' "$work/lidar" ||
  { cat "$work/lidar"; fail "lidar without the hook did not copy"; }
expect 0 "$libraries/libagnocast_heaphook.so" agnocast-run cat /proc/self/maps
expect 1 "agnocast is switched off in this process" \
  as one env AGNOCAST=off agnocast-run "$nodes/lidar" 1

say "upgrade under traffic"
start_node publisher one
start_node subscriber two
[ "$(ask subscriber subscribe /numbers)" = ok ] || fail "subscribe"
[ "$(ask publisher publish /numbers)" = ok ] || fail "publish"
flows_on
grep -q "$libraries/libagnocast.so" "/proc/$subscriber_pid/maps" ||
  fail "the node does not run with the library of the package"
sed -i 's/^#log_level = .*/log_level = "debug"/' /etc/agnocast/agnocastd.toml
cp /etc/agnocast/agnocastd.toml "$work/changed"
before=$(main_pid)
dpkg_quietly -i /opt/agnocast/next/*.deb
[ "$(dpkg-query -W -f '${Version}' agnocastd)" != \
  "$(dpkg-deb -f /opt/agnocast/first/agnocastd_*.deb Version)" ] || fail "it is no upgrade"
[ "$(units is-active)" = active ] || fail "the daemon does not run after the upgrade"
[ "$(main_pid)" != "$before" ] || fail "the upgrade has not restarted the daemon"
eventually "serving; continues the previous run" systemctl show --value -p StatusText agnocastd
flows_on
bridge_is active "after the upgrade"
[ "$(ask publisher create /later)" = ok ] && [ "$(ask subscriber create /later)" = ok ] ||
  fail "nodes do not come back to the daemon"
cmp /etc/agnocast/agnocastd.toml "$work/changed" || fail "a changed configuration is lost"
# Not grep -q: it ends at the first match, and the writer then fails.
agnocastd --print-config | grep -x 'log_level = "debug"' >/dev/null ||
  fail "the changed configuration is not in force"
as one agnocast-ctl verify >"$work/out" || fail "$(cat "$work/out")"

say "what an administrator has disabled stays so"
systemctl disable --quiet --now agnocastd.socket agnocastd.service
dpkg_quietly -i /opt/agnocast/next/agnocastd_*.deb
[ "$(units is-active)" = inactive ] && [ "$(units is-enabled)" = disabled ] ||
  fail "it is enabled or started by an upgrade"
systemctl enable --quiet --now agnocastd.service
flows_on

say "removal under traffic"
dpkg_quietly -r $bridge agnocastd agnocast-ctl libagnocast-dev
[ -z "$(pgrep -x agnocastd)" ] || fail "the daemon runs on"
[ -z "$(pgrep -x agnocast-bridge)" ] || fail "the bridge runs on"
[ ! -e /run/agnocast/agnocastd.sock ] || fail "the socket is still there"
flows_on
ask publisher stop >/dev/null
eventually "$(sent | cut -d ' ' -f 1) 0 0" got
[ "$(sent | cut -d ' ' -f 2)" = 0 ] ||
  fail "messages were refused or copied: $(ask publisher state)"
kill -0 "$publisher_pid" "$subscriber_pid" || fail "a node has ended"

say "installed again without a purge"
dpkg_quietly -i /opt/agnocast/next/{agnocastd,agnocast-ctl}_*.deb
[ "$(units is-active)" = active ] && [ "$(units is-enabled)" = enabled ] ||
  fail "it does not run as it did before the removal"
cmp /etc/agnocast/agnocastd.toml "$work/changed" || fail "a changed configuration is lost"
dpkg_quietly -r agnocastd agnocast-ctl

say "a node that is switched off needs neither daemon nor hook"
dpkg_quietly -r libagnocast-heaphook
expect 1 "agnocast is switched off in this process" as one env AGNOCAST=off "$nodes/lidar" 1
expect 1 "agnocastd does not answer" as one "$nodes/lidar" 1
dpkg_quietly -r $library

say "what is left"
# dpkg remembers an administrator's settings of the units as well.
left | grep -vE -e ^/var/lib/systemd/deb-systemd-helper-enabled/ \
  -e '^/etc/systemd/system/.*[.]wants/agnocast(d|-bridge)[.]' >"$work/left"
[ "$(cat "$work/left")" = \
  "$(printf '%s\n' /etc/agnocast/agnocastd.toml ${bridge:+/etc/agnocast/bridge.toml})" ] ||
  { cat "$work/left"; fail "a removal leaves this"; }
dpkg_quietly -P $bridge agnocastd agnocast-ctl libagnocast-dev libagnocast-heaphook $library
[ -z "$(left)" ] || fail "a purge leaves $(left)"
[ ! -e /etc/agnocast ] && [ ! -e /run/agnocast ] && [ ! -e /run/agnocast-bridge ] ||
  fail "a purge leaves directories"
say "done"
