# Sourced by the tests of this folder. PREFIX: the installation; BINDIR, LIBDIR inside it; PROJECT,
# BUILT: sources and build tree. Provides a private directory, $work, which is removed at the end
# of the test, and these functions.
set -euo pipefail
here=$(dirname "$(readlink -f "$0")")
work=$(mktemp -d)
daemon=
finish() {
  if [ -n "$daemon" ]; then
    kill "$daemon" 2>/dev/null || true
    wait "$daemon" 2>/dev/null || true
  fi
  rm -rf "$work"
}
trap finish EXIT

fail() { echo "FAILED: $*" >&2; exit 1; }

# Sets the variables that a workspace's setup.bash sets for an installed package, for the
# installation under $1.
use_prefix() {
  export PATH=$1/$BINDIR:$PATH CMAKE_PREFIX_PATH=$1${CMAKE_PREFIX_PATH:+:$CMAKE_PREFIX_PATH}
  export LD_LIBRARY_PATH=$1/$LIBDIR${LD_LIBRARY_PATH:+:$LD_LIBRARY_PATH}
}

# Starts a private instance of the installed daemon; AGNOCAST_SOCKET is set when it serves.
start_daemon() {
  export AGNOCAST_SOCKET=$work/agnocastd.sock
  agnocastd --socket "$AGNOCAST_SOCKET" --log-level debug 2>"$work/daemon.log" &
  daemon=$!
  wait_for "$work/daemon.log" " ready "
}

# wait_for FILE TEXT: waits until the file holds the text.
wait_for() {
  for _ in $(seq 600); do
    grep -qF -- "$2" "$1" 2>/dev/null && return 0
    sleep 0.1
  done
  cat "$1" >&2 || true
  fail "'$2' did not appear in $1"
}

# expect STATUS TEXT COMMAND…: checks the exit status, and a text in stdout or stderr.
expect() {
  local wanted=$1 text=$2 status=0
  shift 2
  "$@" >"$work/out" 2>&1 || status=$?
  [ $status -eq "$wanted" ] || { cat "$work/out" >&2; fail "$* ended with $status, not $wanted"; }
  grep -qF -- "$text" "$work/out" || { cat "$work/out" >&2; fail "$* did not print '$text'"; }
}
