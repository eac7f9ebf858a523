// SPDX-License-Identifier: Apache-2.0
//
// Processes and windows for the hook tests; see support.hpp. Also main().

#include "support.hpp"

#include <cerrno>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <string_view>

#include <dlfcn.h>
#include <fcntl.h>
#include <grp.h>
#include <poll.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

namespace hook_test {

namespace {
bool own_process = false;
}

Announced announced{};

std::string hook_path() { return AGNOCAST_TEST_HOOK_PATH; }

bool hook_is_linked() {
  // The outer process is never preloaded.
  return !own_process && dlsym(RTLD_DEFAULT, "agnocast_heaphook") != nullptr;
}

bool in_own_process() { return own_process; }

Outcome run(const std::vector<std::string>& arguments, const RunOptions& options) {
  std::vector<std::string> environment = options.environment;
  environment.push_back("PATH=/usr/local/bin:/usr/bin:/bin");
  environment.push_back("HOME=/nonexistent");
  environment.push_back("LANG=C");
  if (options.preload) environment.push_back("LD_PRELOAD=" + hook_path());
  std::vector<char*> argv;
  for (const std::string& argument : arguments) argv.push_back(const_cast<char*>(argument.c_str()));
  argv.push_back(nullptr);
  std::vector<char*> envp;
  for (const std::string& variable : environment)
    envp.push_back(const_cast<char*>(variable.c_str()));
  envp.push_back(nullptr);

  int out[2];
  int err[2];
  if (pipe2(out, O_CLOEXEC) != 0 || pipe2(err, O_CLOEXEC) != 0) return {};
  const pid_t pid = fork();
  if (pid == 0) {
    setpgid(0, 0);
    prctl(PR_SET_PDEATHSIG, SIGKILL);
    dup2(out[1], STDOUT_FILENO);
    dup2(err[1], STDERR_FILENO);
    const int null = open("/dev/null", O_RDONLY);
    dup2(null, STDIN_FILENO);
    if (!options.directory.empty() && chdir(options.directory.c_str()) != 0) _exit(126);
    if (options.run_as_uid >= 0) {
      const auto id = static_cast<unsigned>(options.run_as_uid);
      if (setgroups(0, nullptr) != 0 || setgid(id) != 0 || setuid(id) != 0) _exit(126);
    }
    execvpe(argv[0], argv.data(), envp.data());
    _exit(127);
  }
  close(out[1]);
  close(err[1]);

  Outcome outcome;
  const auto end = std::chrono::steady_clock::now() + options.timeout;
  pollfd polled[2] = {{out[0], POLLIN, 0}, {err[0], POLLIN, 0}};
  std::string* streams[2] = {&outcome.output, &outcome.error};
  bool in_time = true;
  while (polled[0].fd >= 0 || polled[1].fd >= 0) {
    const auto left = std::chrono::duration_cast<std::chrono::milliseconds>(
        end - std::chrono::steady_clock::now());
    if (left.count() <= 0) {
      in_time = false;
      break;
    }
    if (poll(polled, 2, static_cast<int>(left.count())) < 0 && errno != EINTR) break;
    for (int i = 0; i < 2; ++i) {
      if (polled[i].fd < 0 || polled[i].revents == 0) continue;
      char buffer[4096];
      const ssize_t count = read(polled[i].fd, buffer, sizeof buffer);
      if (count > 0) {
        streams[i]->append(buffer, static_cast<std::size_t>(count));
      } else if (count == 0 || errno != EINTR) {
        polled[i].fd = -1;
      }
    }
  }
  if (!in_time) kill(-pid, SIGKILL);
  int status = 0;
  waitpid(pid, &status, 0);
  close(out[0]);
  close(err[0]);
  if (in_time)
    outcome.exit_status = WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
  return outcome;
}

void run_in_own_process(const char* suite, const char* name) {
  char self[4096];
  const ssize_t length = readlink("/proc/self/exe", self, sizeof self - 1);
  ASSERT_GT(length, 0);
  self[length] = 0;
  RunOptions options;
  options.preload = !hook_is_linked();
  const std::string filter = std::string("--gtest_filter=") + suite + "." + name;
  const Outcome outcome = run({self, "--in-own-process", filter, "--gtest_brief=1"}, options);
  if (outcome.exit_status == 0 && outcome.output.find("[  SKIPPED ]") != std::string::npos) {
    // GoogleTest prints the place, and the reason on the next line.
    constexpr std::string_view place = ": Skipped\n";
    const std::size_t at = outcome.output.find(place);
    GTEST_SKIP() << (at == std::string::npos ? outcome.output
                                             : outcome.output.substr(at + place.size()));
  }
  EXPECT_EQ(outcome.exit_status, 0)
      << (outcome.exit_status == -1 ? "timed out\n" : "") << outcome.output << outcome.error;
  EXPECT_NE(outcome.output.find("[  PASSED  ] 1 test"), std::string::npos)
      << outcome.output << outcome.error;
}

const agnocast_heaphook_table& hook() {
  static const agnocast_heaphook_table* const table = [] {
    using Find = const agnocast_heaphook_table* (*)();
    const auto find = reinterpret_cast<Find>(dlsym(RTLD_DEFAULT, "agnocast_heaphook"));
    if (find == nullptr) {
      std::fputs("no hook in this process\n", stderr);
      std::abort();
    }
    return find();
  }();
  return *table;
}

WindowFile::WindowFile(std::size_t length, std::uintptr_t base) {
  window.base = reinterpret_cast<void*>(base);
  window.length = length;
  window.write_fd = memfd_create("agnocast_test_window", MFD_CLOEXEC | MFD_ALLOW_SEALING);
  if (window.write_fd < 0 || ftruncate(window.write_fd, static_cast<off_t>(length)) != 0 ||
      fcntl(window.write_fd, F_ADD_SEALS, F_SEAL_SHRINK | F_SEAL_GROW) != 0) {
    std::perror("memfd");
    std::abort();
  }
  const std::string path = "/proc/self/fd/" + std::to_string(window.write_fd);
  window.read_fd = open(path.c_str(), O_RDONLY | O_CLOEXEC);
}

WindowFile::~WindowFile() {
  close(window.write_fd);
  close(window.read_fd);
}

std::size_t WindowFile::resident_bytes() const {
  struct stat status;
  return fstat(window.read_fd, &status) == 0 ? static_cast<std::size_t>(status.st_blocks) * 512 : 0;
}

agnocast_heaphook_options options_for(std::uint32_t scope) {
  agnocast_heaphook_options options{};
  options.scope = scope;
  options.grown = [](void* context, std::uint32_t window, std::uint64_t frontier) {
    auto& there = *static_cast<Announced*>(context);
    there.frontier[window].store(frontier, std::memory_order_release);
    there.calls.fetch_add(1, std::memory_order_relaxed);
  };
  options.context = &announced;
  return options;
}

void attach(const WindowFile& file, std::uint32_t scope) {
  const agnocast_heaphook_options options = options_for(scope);
  ASSERT_EQ(hook().attach(&file.window, &options), AGNOCAST_HEAPHOOK_OK) << std::strerror(errno);
}

Directory::Directory() {
  std::string name =
      (std::filesystem::temp_directory_path() / "agnocast_hook_test_XXXXXX").string();
  if (mkdtemp(name.data()) == nullptr) std::abort();
  chmod(name.c_str(), 0755);
  path = name;
}

Directory::~Directory() {
  std::error_code ignored;
  std::filesystem::remove_all(path, ignored);
}

bool is_shared(const void* address) { return hook().owns(address) == 1; }

agnocast_heaphook_usage usage() {
  agnocast_heaphook_usage usage;
  hook().usage(&usage);
  return usage;
}

std::size_t self_status_kib(const char* field) {
  std::ifstream status("/proc/self/status");
  std::string line;
  while (std::getline(status, line)) {
    if (line.rfind(std::string(field) + ":", 0) == 0)
      return std::stoul(line.substr(std::strlen(field) + 1));
  }
  return 0;
}

void* libc_symbol(const char* name) {
  static void* const libc = dlopen("libc.so.6", RTLD_LAZY | RTLD_NOLOAD);
  return libc == nullptr ? nullptr : dlsym(libc, name);
}

int wait_for(int pid) {
  int status = 0;
  if (pid < 0 || waitpid(pid, &status, 0) != pid) return -1;
  return WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
}

}  // namespace hook_test

int main(int argc, char** argv) {
  for (int i = 1; i < argc; ++i) {
    if (std::strcmp(argv[i], "--in-own-process") == 0) hook_test::own_process = true;
  }
  testing::InitGoogleTest(&argc, argv);
  return RUN_ALL_TESTS();
}
