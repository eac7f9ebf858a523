#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
#
# Goal: scripts/test refuses what it does not understand before it does anything, and
# scripts/repeat-tests says which tests failed in which runs, beside the load that was asked for,
# which ends with it. Method: both as programs; three tests of our own.
set -euo pipefail
scripts=$1
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
fail() { echo "FAILED: $1"; cat "$work/said" 2>/dev/null || true; exit 1; }
# expect STATUS TEXT COMMAND…
expect() {
  local status=0 wanted=$1 text=$2
  shift 2
  "$@" >"$work/said" 2>&1 </dev/null || status=$?
  [ $status -eq "$wanted" ] || fail "$*: ends with $status, not $wanted"
  grep -qF -- "$text" "$work/said" || fail "$*: does not say '$text'"
}

expect 0 "--repeat N [--load L]" "$scripts/test" --help
expect 2 "unknown option '--bogus'" "$scripts/test" --bogus
for number in 0 -1 x 1x 1000000 ""; do
  expect 2 "--repeat wants a number from 1, not '$number'" "$scripts/test" --repeat "$number"
done
expect 2 "--repeat wants" "$scripts/test" --repeat
for number in -1 x 1000 ""; do
  expect 2 "--load wants a number from 0 to 999, not '$number'" \
    "$scripts/test" --repeat 1 --load "$number"
done
expect 2 "--load goes with --repeat" "$scripts/test" --load 2

repeat=$scripts/repeat-tests
mkdir "$work/built"
expect 0 "N LOAD BUILD" "$repeat" --help
expect 2 "N, LOAD and BUILD are required" "$repeat" 1 2
expect 2 "N must be a number from 1 to 999999, not '0'" "$repeat" 0 0 "$work/built"
expect 2 "LOAD must be a number from 0 to 999, not 'much'" "$repeat" 1 much "$work/built"
expect 2 "no tests are built in '$work/built'" "$repeat" 1 0 "$work/built"

# One that passes, one that fails in each second run, one that sees the load: processes that
# compute, of the parent of its ctest.
cat >"$work/sees_load" <<'END'
ctest=$(ps -o ppid= -p $PPID)
test "$(ps -o args= --ppid $ctest | grep -c 'while :; do :; done')" = 2
END
cat >"$work/built/CTestTestfile.cmake" <<END
add_test(passes true)
add_test(alternates sh -c "echo run >>'$work/runs'; test \$((\$(wc -l <'$work/runs') % 2)) = 1")
add_test(sees_load bash "$work/sees_load")
END
expect 1 "alternates: failed in run 2 4" "$repeat" 4 2 "$work/built"
grep -q "passes: failed\|sees_load: failed" "$work/said" &&
  fail "a test that passed counts as failed"
expect 0 "no test failed" "$repeat" 2 0 "$work/built" -R passes
expect 1 "(ctest): failed in run 1" "$repeat" 1 0 "$work/built" -R nothing_has_this_name
