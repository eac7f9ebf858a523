#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
#
# Goal: both shells complete agnocast-ctl, with names of the running system, and offer nothing
# without a daemon; the manual pages are clean. Method: the real shells with the installed scripts,
# and mandoc.
#
#   ctl_shells_test.sh AGNOCASTD CTL COMPLETIONS_DIRECTORY PAGE...
set -euo pipefail
agnocastd=$1 ctl=$2 completions=$3
shift 3
failed=0
fail() { echo "FAILED: $1"; failed=1; }

dir=$(mktemp -d)
for page in "$@"; do
  # mandoc looks for other pages where they are installed: these are not yet, those of the system
  # may not be.
  complaints=$(mandoc -Tlint "$page" 2>&1 |
    grep -v -e 'referenced manual not found' -e 'outdated mandoc.db') || true
  [ -z "$complaints" ] || fail "mandoc complains: $complaints"
done

export AGNOCAST_SOCKET=$dir/agnocastd.sock
daemon=
trap '[ -z "$daemon" ] || kill "$daemon"; rm -rf "$dir"' EXIT
mkdir "$dir/bin"
ln -s "$ctl" "$dir/bin/agnocast-ctl"
export PATH=$dir/bin:$PATH

# Prints bash's completions of these words, the last one as far as it is typed.
bash_offers() {
  bash --norc -c '. "$1"; shift; COMP_WORDS=(agnocast-ctl "$@"); COMP_CWORD=$#
    _agnocast_ctl; printf "%s\n" "${COMPREPLY[@]}"' \
    bash "$completions/agnocast-ctl.bash" "$@"
}
# The same for zsh: a completion function ends in compadd.
zsh_offers() {
  zsh -f -c 'compadd() { shift 1; print -l -- "$@" }
    file=$1; shift; words=(agnocast-ctl "$@"); CURRENT=$(($# + 1)); . "$file"' \
    zsh "$completions/_agnocast-ctl" "$@"
}
for shell in bash zsh; do
  [ "$(${shell}_offers topic ty | tr '\n' ' ')" = "type " ] || fail "$shell does not know the verbs"
  [ "$(${shell}_offers explain hook_m | tr '\n' ' ')" = "hook_missing " ] ||
    fail "$shell does not know the codes"
  said=$(${shell}_offers topic info / 2>&1 | tr -d '\n')
  [ -z "$said" ] || fail "$shell offers words without a daemon: $said"
done

"$agnocastd" --socket "$AGNOCAST_SOCKET" 2>"$dir/log" &
daemon=$!
for _ in $(seq 200); do "$ctl" status >/dev/null 2>&1 && break; sleep 0.05; done
"$ctl" status >/dev/null || { cat "$dir/log"; fail "no daemon"; }
for shell in bash zsh; do
  said=$(${shell}_offers topic info / 2>&1 | tr -d '\n')
  [ -z "$said" ] || fail "$shell offers topics that do not exist: $said"
done
exit $failed
