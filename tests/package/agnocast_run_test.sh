# Goal: the installed agnocast-run preloads the hook beside it, wherever that is, passes on its
# command's output and status, and refuses unknown options. Method: run it; copy the installation
# elsewhere; call it by a link.
. "$(dirname "$0")/support.sh"
run=$PREFIX/$BINDIR/agnocast-run

expect 0 "$PREFIX/$LIBDIR/libagnocast_heaphook.so" "$run" cat /proc/self/maps
expect 37 "said" "$run" sh -c 'echo said; exit 37'
expect 0 "[a b] [c]" "$run" sh -c 'echo "[$1] [$2]"' x 'a b' c
expect 0 "first.so" env LD_PRELOAD= "$run" \
  sh -c 'LD_PRELOAD="$LD_PRELOAD first.so"; echo $LD_PRELOAD'
"$run" sh -c 'kill -TERM $$' 2>/dev/null && fail "a signal is not passed on" ||
  [ $? -eq 143 ] || fail "a signal is not passed on"

expect 0 "scope=" "$run" sh -c 'echo scope=$AGNOCAST_SCOPE'
expect 0 "scope=all" "$run" --scope all sh -c 'echo scope=$AGNOCAST_SCOPE'
expect 0 "scope=loan" env AGNOCAST_SCOPE=all "$run" --scope loan sh -c 'echo scope=$AGNOCAST_SCOPE'
expect 2 "--scope needs loan or all, not 'some'" "$run" --scope some true
expect 2 "--scope needs loan or all, not ''" "$run" --scope
expect 2 "hint: usage: agnocast-run" "$run"
expect 2 "unknown option '--bogus'" "$run" --bogus true
expect 2 "no command" "$run" --
expect 0 "usage: agnocast-run" "$run" --help
expect 127 "not found" "$run" /nonexistent/command
expect 0 "--help of the command" "$run" sh -c 'echo $1 of the command' x --help

cp -a "$PREFIX" "$work/moved"
expect 0 "$work/moved/$LIBDIR/libagnocast_heaphook.so" \
  "$work/moved/$BINDIR/agnocast-run" cat /proc/self/maps
ln -s "$work/moved/$BINDIR/agnocast-run" "$work/link"
expect 0 "$work/moved/$LIBDIR/libagnocast_heaphook.so" "$work/link" cat /proc/self/maps
mv "$work/moved" "$work/with a space"
expect 1 "no path with a space" "$work/with a space/$BINDIR/agnocast-run" true
rm "$work/with a space/$LIBDIR/libagnocast_heaphook.so"
expect 1 "no heap hook beside this program" "$work/with a space/$BINDIR/agnocast-run" true
