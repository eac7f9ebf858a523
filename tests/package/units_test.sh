# Goal: units installed under any prefix start the programs installed there and point to their
# documents. Method: read them.
. "$(dirname "$0")/support.sh"
units=$PREFIX/lib/systemd/system
grep -qx "ExecStart=$PREFIX/$BINDIR/agnocastd --fd-store=manager" "$units/agnocastd.service" ||
  fail "agnocastd.service starts something else"
for unit in "$units"/agnocastd.{service,socket}; do
  document=$(sed -n 's,^Documentation=file://,,p' "$unit")
  [ -f "$document" ] || fail "$unit points to '$document'"
done
documents=$(dirname "$(dirname "$document")")
for file in LICENSE README.md systemd/agnocastd.toml systemd/examples/node.service; do
  [ -f "$documents/$file" ] || fail "there is no $documents/$file"
done
grep -q "^ExecStart=$PREFIX/$BINDIR/agnocast-run $PREFIX/$BINDIR/talker" \
  "$documents/systemd/examples/node.service" || fail "node.service"
"$PREFIX/$BINDIR/agnocastd" --check-config --config "$documents/systemd/agnocastd.toml" ||
  fail "agnocastd.toml"
if [ -e "$PREFIX/$BINDIR/agnocast-bridge" ]; then
  grep -qx "ExecStart=$PREFIX/$BINDIR/agnocast-bridge" "$units/agnocast-bridge.service" ||
    fail "agnocast-bridge.service starts something else"
  grep -qx "ExecStart=$PREFIX/$BINDIR/agnocast-bridge --domain %i" \
    "$units/agnocast-bridge@.service" || fail "agnocast-bridge@.service"
  grep -qx "ExecReload=$PREFIX/$BINDIR/agnocast-bridge --check-config" \
    "$units/agnocast-bridge.service" || fail "agnocast-bridge.service looks at another file"
  grep -qx "ExecReload=$PREFIX/$BINDIR/agnocast-bridge --domain %i --check-config" \
    "$units/agnocast-bridge@.service" || fail "agnocast-bridge@.service looks at another file"
  for unit in "$units"/agnocast-bridge{,@}.service; do
    document=$(sed -n 's,^Documentation=file://,,p' "$unit")
    [ -f "$document" ] || fail "$unit points to '$document'"
  done
  "$PREFIX/$BINDIR/agnocast-bridge" --check-config --config "$documents/systemd/bridge.toml" ||
    fail "bridge.toml"
  [ -f "$PREFIX/lib/sysusers.d/agnocast-bridge.conf" ] || fail "user of the bridge"
fi
[ -f "$PREFIX/lib/sysusers.d/agnocast.conf" ] && [ -f "$PREFIX/lib/tmpfiles.d/agnocast.conf" ] ||
  fail "group or tmpfiles rule"
