# Goal: the installed profiles compile, permit every file that a publisher, a subscription and the
# daemon open, and permit no memory for code. Method: the tools of AppArmor and SELinux; strace of
# the installed programs, compared with the rules. Enforcement by a kernel is not tested: it needs
# a kernel with such a module.
. "$(dirname "$0")/support.sh"
share=$PREFIX/share/agnocast
for file in apparmor/agnocast apparmor/usr.bin.agnocastd selinux/agnocast.te selinux/agnocast.fc; do
  [ -f "$share/$file" ] || fail "there is no $share/$file"
done
export PATH=$PATH:/usr/sbin:/sbin
for tool in apparmor_parser checkmodule semodule_package strace; do
  command -v $tool >/dev/null ||
    { echo "SKIPPED: $tool is not installed (scripts/install-dependencies)"; exit 77; }
done

# --- they compile; and a wrong rule does not
compiles() { apparmor_parser --skip-kernel-load --skip-cache "$1" 2>"$work/parser"; }
node_profile() {
  printf '%s\n' 'abi <abi/3.0>,' 'include <tunables/global>' 'profile node /usr/bin/node {' \
    '  include <abstractions/base>' "  include \"$1\"" '}'
}
node_profile "$share/apparmor/agnocast" >"$work/node"
sed 's/type=seqpacket/type=seqpackets/' "$share/apparmor/agnocast" >"$work/misspelt"
node_profile "$work/misspelt" >"$work/wrong"
for profile in "$work/node" "$share/apparmor/usr.bin.agnocastd"; do
  compiles "$profile" || { cat "$work/parser" >&2; fail "$profile does not compile"; }
done
! compiles "$work/wrong" || fail "a wrong rule compiles"
# As doctor's remedy adds it to a profile that lacks it.
printf '%s\n' 'include <tunables/global>' 'profile node /usr/bin/node {' \
  '  include <abstractions/base>' '}' >"$work/mended"
sed -i "\\|node.*{|a include \"$share/apparmor/agnocast\"" "$work/mended"
grep -q "apparmor/agnocast" "$work/mended" && compiles "$work/mended" ||
  fail "the remedy of doctor makes a profile that does not compile"

module() { checkmodule -M -m -o "$work/agnocast.mod" "$1" >"$work/checkmodule" 2>&1; }
module "$share/selinux/agnocast.te" ||
  { cat "$work/checkmodule" >&2; fail "agnocast.te does not compile"; }
semodule_package -o "$work/agnocast.pp" -m "$work/agnocast.mod" -f "$share/selinux/agnocast.fc" ||
  fail "agnocast.fc"
[ -s "$work/agnocast.pp" ] || fail "there is no module"
sed 's/agnocastd_tmpfs_t : file {/no_such_t : file {/' "$share/selinux/agnocast.te" \
  >"$work/agnocast.te"
! module "$work/agnocast.te" || fail "a wrong rule compiles"

# --- the rules cover every file that the programs open
strace -o "$work/probe" true 2>"$work/probe.log" ||
  { echo "SKIPPED: strace may not trace here"; exit 77; }
use_prefix "$PREFIX"
export AGNOCAST_SOCKET=$work/agnocast/agnocastd.sock
strace -f -qq -y -e trace=%file,%desc,%network -o "$work/daemon.trace" \
  agnocastd --socket "$AGNOCAST_SOCKET" --fd-store=none 2>"$work/daemon.log" &
tracer=$!
wait_for "$work/daemon.log" " ready "
daemon=$(sed -n 's/.* ready pid=\([0-9]*\) .*/\1/p' "$work/daemon.log")
# start_tool NAME FIRST…: a traced client tool (tests/integration/client), and the first lines of
# its input.
start_tool() {
  local name=$1 line
  shift
  mkfifo "$work/$name.in"
  strace -f -qq -y -e trace=%file,%desc,%network -o "$work/$name.trace" \
    "$BUILT/tests/integration/client/client_tool" <"$work/$name.in" >"$work/$name.out" 2>&1 &
  exec {to}>"$work/$name.in"
  for line in "$@"; do echo "$line" >&"$to"; done
}
start_tool subscriber "sub /points 5" "wait 30000" take release
subscriber=$!
to_subscriber=$to
wait_for "$work/subscriber.out" ok
start_tool publisher "pub /points 5"
publisher=$!
wait_for "$work/publisher.out" ok
echo "publish 3 100" >&"$to"
wait_for "$work/subscriber.out" 1
exec {to}>&- {to_subscriber}>&-
wait $subscriber $publisher || { cat "$work"/*.out >&2; fail "no message came"; }
kill "$daemon"
wait $tracer || fail "the daemon has not ended well"
daemon=

python3 - "$share/apparmor" "$work" <<'PYTHON' || fail "rules are missing"
import re, sys

rules_in, work = sys.argv[1:]

def pattern(glob):
    """AppArmor's globs as a regular expression."""
    for name, value in {"@{PROC}": "/proc", "@{pids}": "[0-9]*", "@{pid}": "[0-9]*",
                        "@{tid}": "[0-9]*", "@{multiarch}": "*-linux-gnu*"}.items():
        glob = glob.replace(name, value)
    out, depth = "", 0
    for part in re.findall(r"\*\*|\[[^]]*\]\*|.", glob):
        if part == "**": out += ".*"
        elif part.startswith("["): out += part[:-1] + "+"
        elif part == "*": out += "[^/]*"
        elif part == "{": out, depth = out + "(?:", depth + 1
        elif part == "}": out, depth = out + ")", depth - 1
        elif part == "," and depth: out += "|"
        else: out += re.escape(part)
    return re.compile(out + r"\Z")

def rules(name):
    found = []
    for line in open(f"{rules_in}/{name}"):
        rule = re.match(r"\s*(?:owner )?(/\S+|@\{PROC\}\S+) ([a-z]+),$", line)
        if rule: found.append((pattern(rule[1]), rule[2]))
    return found

def opened(name):
    """Paths and memory with the rights that were asked for, as the rules would see them."""
    for line in open(f"{work}/{name}.trace"):
        call = re.match(r'\d+ +(\w+)\((.*)', line)
        if not call or "ENOENT" in line or "unfinished" in line: continue
        what, rest = call[1], call[2]
        if what in ("open", "openat"):
            path = re.search(r'"([^"]*)"', rest)[1]
            # Rules name a directory with a slash at its end.
            if "O_DIRECTORY" in rest: path = path.rstrip("/") + "/"
            yield path, "rw" if re.search("O_RDWR", rest) else "w" if "O_WRONLY" in rest else "r"
        elif what in ("connect", "bind") and "AF_UNIX" in rest and 'sun_path="' in rest:
            yield re.search(r'sun_path="([^"]*)"', rest)[1], "rw"
        elif what == "mmap" and "MAP_SHARED" in rest and "memfd:" in rest:
            yield (re.search(r"<(/memfd:[^>]*)>", rest)[1].replace(" (deleted)", ""),
                   "rw" if "PROT_WRITE" in rest else "r")
            if "PROT_EXEC" in rest: yield "memory for code", "m"
        elif what == "fcntl" and "OFD_SETLK" in rest:
            yield re.search(r"<(/memfd:[^>]*)>", rest)[1].replace(" (deleted)", ""), "k"

# Common to all programs: abstractions/base has them. (Python's own files are not in the traces.)
common = re.compile(r"/(usr/)?lib\d*/|/etc/(ld\.so|localtime|nsswitch|group|passwd|gcrypt)"
                    r"|/usr/share/(zoneinfo|locale)|/dev/(null|urandom)|/etc/selinux"
                    r"|/sys/fs/selinux|/proc/sys/crypto|/proc/filesystems|/proc/mounts"
                    r"|/proc/thread-self|/(usr|lib|etc|run|var|sys|dev)?\Z")
missing, count = set(), 0
for program, profile in (("publisher", "agnocast"), ("subscriber", "agnocast"),
                         ("daemon", "usr.bin.agnocastd")):
    allowed = rules(profile)
    assert allowed, profile
    for path, rights in opened(program):
        path = path.replace(f"{work}/agnocast", "/run/agnocast").replace("/proc/self/", "/proc/1/")
        path = re.sub(r".*/(libagnocast[^/]*)\Z", r"/usr/lib/\1", path)
        path = re.sub(r".*/agnocastd\Z", "/usr/bin/agnocastd", path)
        if common.match(path) and "agnocast" not in path: continue
        # A socket by its descriptor: the rules apply to the name that it was bound to.
        if re.match("/proc/1/fd/[0-9]+\\Z", path) and rights == "rw": continue
        if not path.startswith("/") and path != "memory for code": continue
        count += 1
        having = "".join(letters for rule, letters in allowed if rule.match(path))
        if not set(rights) <= set(having): missing.add((program, path, rights))
for program, path, rights in sorted(missing):
    print(f"{program} opens {path} ({rights}), and no rule allows it")
print(f"{count} accesses")
sys.exit(1 if missing or count < 20 else 0)
PYTHON
