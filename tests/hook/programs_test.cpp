// SPDX-License-Identifier: Apache-2.0
//
// Goal: ordinary programs behave under the hook exactly as without it. Method: each script runs
// twice in an empty directory, once with LD_PRELOAD; the test compares standard output, standard
// error and exit status.

#include "support.hpp"

#include <string>

namespace {

using namespace hook_test;

const std::string programs = AGNOCAST_TEST_PROGRAMS;

struct Program {
  const char* name;
  const char* needs;   // a command that must exist, or ""
  const char* script;  // run by sh in an empty directory
};

const Program ordinary[] = {
    {"pipeline", "",
     "printf 'b\\na\\nc\\n' | sort | tr a-z A-Z | (while read x; do echo \"<$x>\"; done) ; exit 5"},
    {"stderr", "", "ls /does/not/exist; echo to-stderr >&2; false || echo status $?"},
    {"python_threads", "python3", R"(python3 - <<'EOF'
import threading, subprocess, os, json, time, zlib
out = []
def work(i): out.append(sum(len(str(k)) for k in range(i * 1000)))
threads = [threading.Thread(target=work, args=(i,)) for i in range(8)]
[t.start() for t in threads]; [t.join() for t in threads]
print(sorted(out)); print(subprocess.run(["echo", "sub"], capture_output=True).stdout)
while len(os.listdir("/proc/self/task")) > 1: time.sleep(0.01)
print(len(os.listdir("/proc/self/fd")))
print(zlib.crc32(json.dumps(list(range(50000))).encode()))
pid = os.fork()
if pid == 0: os._exit(len([str(i) for i in range(9)]))
print(os.waitpid(pid, 0)[1] >> 8)
EOF
)"},
    {"python_multiprocessing", "python3", R"(cat > m.py <<'EOF'
import multiprocessing as m
def f(x): return x * x
if __name__ == "__main__":
    for kind in ("fork", "spawn"):
        with m.get_context(kind).Pool(3) as pool: print(kind, pool.map(f, range(20)))
EOF
python3 m.py)"},
    {"compile_and_run", "g++", R"(cat > a.cpp <<'EOF'
#include <iostream>
#include <map>
#include <string>
#include <stdexcept>
int main() { std::map<int, std::string> m; for (int i = 0; i < 1000; ++i) m[i] = std::to_string(i);
  try { m.at(5000); } catch (const std::out_of_range&) { std::cout << "thrown\n"; }
  try { new char[~0ul >> 1]; } catch (const std::bad_alloc&) { std::cout << "bad_alloc\n"; }
  std::cout << m.size() << "\n"; }
EOF
g++ -O1 -o a a.cpp && ./a)"},
    {"git", "git",
     R"(export GIT_CONFIG_NOSYSTEM=1 GIT_AUTHOR_DATE='2020-01-01T00:00:00Z' GIT_COMMITTER_DATE='2020-01-01T00:00:00Z'
git init -q r && cd r && git config user.name n && git config user.email e@example.org
seq 1000 > f && git add f && git commit -qm one && seq 2000 > f && git commit -qam two && git log --stat --format=%H && git fsck 2>&1)"},
    {"tar_gzip", "",
     "mkdir d && seq 50000 > d/x && tar --mtime=@0 -cf - d | gzip -n | tee t.gz | cksum && gzip "
     "-dc t.gz | tar -tvf - | wc -l && gzip -dc t.gz | tar -xOf - d/x | cksum"},
    {"sort", "",
     "awk 'BEGIN { srand(7); for (i = 0; i < 100000; i++) print int(rand() * 1e9) }' | sort -n "
     "--parallel=2 | cksum"},
    {"awk", "awk",
     "seq 20000 | awk '{ a[$1 % 97] = a[$1 % 97] $1 } END { for (i = 0; i < 97; i++) n += "
     "length(a[i]); print n }'"},
    {"find_xargs", "",
     "mkdir -p a/b/c && touch a/1 a/b/2 a/b/c/3 && find a -type f -print0 | sort -z | xargs -0 -n1 "
     "-P2 ls | sort"},
    {"perl", "perl",
     R"(perl -e 'my %h; $h{$_ % 1000} .= $_ for 1..50000; print length(join "", map { $h{$_} } sort keys %h), "\n"; if (my $p = fork) { waitpid $p, 0; print $? >> 8, "\n" } else { exit 4 }')"},
    {"cmake", "cmake",
     "cmake -E echo hello && cmake -E make_directory x && cmake -E sha256sum /bin/sh > x/s && "
     "cmake -E compare_files x/s x/s"},
    {"ctest", "ctest",
     "ctest --show-only=json-v1 | head -c 60; ctest --version | head -1; ctest --no-such-option "
     "2>&1 | sed \"s,$PWD,DIR,\"; echo $?"},
    {"env_cleared", "", "env -i /bin/sh -c 'echo $LD_PRELOAD; /bin/echo cleared'"},
    {"find_big", "", "head -c 5000000 /dev/zero | od -v | md5sum"},
    {"killed", "", "sh -c 'kill -9 $$'; echo $?; sh -c 'kill -TERM $$'; echo $?"},
    {"fork_without_exec", "", "$PROGRAMS/hook_test_forks"},
    {"c_program_loading_cpp", "", "$PROGRAMS/hook_test_c_host $PROGRAMS/libhook_test_module.so"},
    {"own_malloc", "", "$PROGRAMS/hook_test_own_malloc"},
    {"deep_recursion_of_shells", "", "sh -c 'sh -c \"sh -c \\\"sh -c true; echo deep\\\"\"'"},
};

class OrdinaryPrograms : public testing::TestWithParam<Program> {};

TEST_P(OrdinaryPrograms, BehaveTheSame) {
  const Program& program = GetParam();
  if (*program.needs != 0 &&
      run({"sh", "-c", std::string("command -v ") + program.needs}).exit_status != 0) {
    GTEST_SKIP() << "no " << program.needs << " here";
  }
  Outcome outcomes[2];
  for (const bool preload : {false, true}) {
    Directory directory;
    RunOptions options;
    options.preload = preload;
    options.directory = directory.path;
    options.environment = {"PROGRAMS=" + programs};
    options.timeout = std::chrono::seconds(100);
    outcomes[preload ? 1 : 0] = run({"/bin/sh", "-c", program.script}, options);
    ASSERT_NE(outcomes[preload ? 1 : 0].exit_status, -1) << "timed out";
  }
  EXPECT_EQ(outcomes[1].output, outcomes[0].output);
  EXPECT_EQ(outcomes[1].error, outcomes[0].error);
  EXPECT_EQ(outcomes[1].exit_status, outcomes[0].exit_status);
  EXPECT_NE(outcomes[0].output + outcomes[0].error, "") << "the script printed nothing";
}

INSTANTIATE_TEST_SUITE_P(Hook, OrdinaryPrograms, testing::ValuesIn(ordinary),
                         [](const testing::TestParamInfo<Program>& test) {
                           return std::string(test.param.name);
                         });

}  // namespace
