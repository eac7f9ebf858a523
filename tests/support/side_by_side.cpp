// SPDX-License-Identifier: Apache-2.0
//
// side_by_side N PROGRAM [ARGUMENTS]: runs a GoogleTest program whose tests mostly wait, as N
// parallel processes with an equal share of its tests each (GTEST_TOTAL_SHARDS), and prints their
// output in sequence. CTest counts it as one job, like the program alone. Exits with 0 if all of
// them did. For a table of attacks (scripts/attack-table) it is one process, because each attack's
// cost is measured.

#include <base/descriptors/unique_fd.hpp>

#include <signal.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <cstdio>
#include <cstdlib>
#include <string>
#include <utility>
#include <vector>

namespace {

struct Part {
  agnocast::UniqueFd said;
  pid_t pid = -1;
};

[[noreturn]] void become(int index, int count, int said, pid_t parent, char** program) {
  ::prctl(PR_SET_PDEATHSIG, SIGKILL);
  if (::getppid() != parent) ::_exit(126);
  ::setenv("GTEST_TOTAL_SHARDS", std::to_string(count).c_str(), 1);
  ::setenv("GTEST_SHARD_INDEX", std::to_string(index).c_str(), 1);
  ::dup2(said, STDOUT_FILENO);
  ::dup2(said, STDERR_FILENO);
  ::execv(program[0], program);
  ::_exit(127);
}

/// Prints the output of a part as it comes, until the part ends; a hanging part is killed with
/// this process. Returns whether it exited with 0.
bool follow(const Part& part) {
  int status = -1;
  ::off_t printed = 0;
  for (bool is_over = part.pid < 0; !is_over;) {
    is_over = ::waitpid(part.pid, &status, WNOHANG) != 0;
    std::array<char, 65536> buffer;
    for (ssize_t count = 0;
         (count = ::pread(part.said.get(), buffer.data(), buffer.size(), printed)) > 0;
         printed += count)
      std::fwrite(buffer.data(), 1, static_cast<std::size_t>(count), stdout);
    std::fflush(stdout);
    if (!is_over) ::usleep(10'000);
  }
  if (WIFSIGNALED(status)) std::printf("ended by signal %d\n", WTERMSIG(status));
  return status == 0;
}

}  // namespace

int main(int argc, char** argv) {
  const bool is_measured = std::getenv("AGNOCAST_ATTACK_TABLE") != nullptr;
  const int count = argc < 3 ? 0 : is_measured ? 1 : std::atoi(argv[1]);
  if (count <= 0) return 2;
  const pid_t own = ::getpid();
  std::vector<Part> parts;
  for (int i = 0; i < count; ++i) {
    Part part{agnocast::UniqueFd(::memfd_create("said", MFD_CLOEXEC)), ::fork()};
    if (part.pid == 0) become(i, count, part.said.get(), own, argv + 2);
    parts.push_back(std::move(part));
  }
  bool all = true;
  for (const Part& part : parts) all = follow(part) && all;
  return all ? 0 : 1;
}
