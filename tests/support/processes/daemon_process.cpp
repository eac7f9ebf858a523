// SPDX-License-Identifier: Apache-2.0

#include <tests/support/processes/daemon_process.hpp>

#include <base/descriptors/pidfd.hpp>
#include <tests/support/machine/seccomp_filter.hpp>

#include <dirent.h>
#include <fcntl.h>
#include <grp.h>
#include <gtest/gtest.h>
#include <linux/close_range.h>
#include <linux/filter.h>
#include <linux/seccomp.h>
#include <poll.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/un.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <csignal>
#include <cstddef>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <memory>
#include <sstream>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

namespace agnocast::test {
namespace {

constexpr int patience_ms = 60'000;  // only what fails takes it
constexpr unsigned pause_us = 2'000;

const char* const default_config_of_daemon = "[daemon]\nsocket_mode = \"0666\"\n";
const char* const default_config_of_heap =
    "[heap]\nwindow_bytes = \"64MiB\"\narena_bytes = \"64GiB\"\n" AGNOCAST_TEST_ARENA_BASE;

std::string content_of(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  std::ostringstream text;
  text << file.rdbuf();
  return text.str();
}

// Tests look at the daemon far more often than people do, and would wait for their user's next
// allowed look.
std::string with_looks_unlimited(std::string config) {
  if (config.find("dumps_per_second") != std::string::npos) return config;
  const std::string quota = "[quota]\n";
  const std::size_t at = config.find(quota);
  const std::string unlimited = "dumps_per_second = \"unlimited\"\n";
  return at == std::string::npos ? config + quota + unlimited
                                 : config.insert(at + quota.size(), unlimited);
}

struct Start {
  std::string program = AGNOCAST_TEST_DAEMON;
  std::vector<std::string> arguments;
  std::vector<std::string> environment;  // NAME=value, beside the test's own
  std::optional<uid_t> uid;
  std::string out;  // files
  std::string err;
  bool without_peer_pidfd = false;
  bool without_passrights = false;
  std::vector<int> sockets;
};

/// The environment of a daemon, made before fork: in the child, setenv() would wait for ever if
/// another thread was inside it at the fork.
class Environment {
 public:
  explicit Environment(const Start& what) {
    static constexpr std::string_view not_passed[] = {"NOTIFY_SOCKET", "AGNOCAST_SOCKET",
                                                      "JOURNAL_STREAM", "FDSTORE"};
    for (char** variable = environ; *variable != nullptr; ++variable) {
      const std::string_view text = *variable, name = text.substr(0, text.find('='));
      const bool is_set_anew =
          std::any_of(what.environment.begin(), what.environment.end(), [&](const auto& other) {
            return other.size() > name.size() && other.starts_with(name) &&
                   other[name.size()] == '=';
          });
      if (!is_set_anew &&
          std::find(std::begin(not_passed), std::end(not_passed), name) == std::end(not_passed))
        variables_.emplace_back(text);
    }
    variables_.insert(variables_.end(), what.environment.begin(), what.environment.end());
    if (!what.sockets.empty()) {
      std::string names = "LISTEN_FDNAMES=socket";
      for (std::size_t i = 1; i < what.sockets.size(); ++i) names += ":socket";
      variables_.push_back(names);
      variables_.push_back("LISTEN_FDS=" + std::to_string(what.sockets.size()));
      variables_.push_back(listen_pid + std::string(pid_digits, ' '));
    }
    for (std::string& variable : variables_) pointers_.push_back(variable.data());
    pointers_.push_back(nullptr);
  }
  /// In the child, whose pid is part of it. The last variable is LISTEN_PID then.
  void note_pid() {
    std::snprintf(variables_.back().data() + listen_pid.size(), pid_digits, "%d", ::getpid());
  }
  char** get() { return pointers_.data(); }

 private:
  static constexpr std::size_t pid_digits = 12;
  const std::string listen_pid = "LISTEN_PID=";
  std::vector<std::string> variables_;
  std::vector<char*> pointers_;
};

// As systemd passes them.
void pass(const std::vector<int>& sockets) {
  constexpr int first = 3, elsewhere = 100;
  std::vector<int> copies;
  for (const int socket : sockets) copies.push_back(::fcntl(socket, F_DUPFD_CLOEXEC, elsewhere));
  for (std::size_t i = 0; i < copies.size(); ++i) ::dup2(copies[i], first + static_cast<int>(i));
}

// From here on, also after exec, getsockopt(…, SO_PEERPIDFD, …) fails with ENOPROTOOPT.
bool deny_peer_pidfd() {
  constexpr std::uint32_t so_peerpidfd = 77;
  const auto load = [](std::size_t offset) {
    return sock_filter{BPF_LD | BPF_W | BPF_ABS, 0, 0, static_cast<std::uint32_t>(offset)};
  };
  sock_filter filter[] = {
      load(offsetof(seccomp_data, nr)),
      {BPF_JMP | BPF_JEQ | BPF_K, 0, 3, SYS_getsockopt},
      load(offsetof(seccomp_data, args) + 2 * sizeof(std::uint64_t)),  // little endian
      {BPF_JMP | BPF_JEQ | BPF_K, 0, 1, so_peerpidfd},
      {BPF_RET | BPF_K, 0, 0, SECCOMP_RET_ERRNO | ENOPROTOOPT},
      {BPF_RET | BPF_K, 0, 0, SECCOMP_RET_ALLOW},
  };
  sock_fprog program{static_cast<unsigned short>(std::size(filter)), filter};
  return ::prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) == 0 &&
         ::syscall(SYS_seccomp, SECCOMP_SET_MODE_FILTER, 0, &program) == 0;
}

bool deny_passrights() {
  constexpr std::uint32_t so_passrights = 83;
  return deny_getsockopt(SYS_setsockopt, SOL_SOCKET, so_passrights, ENOPROTOOPT) &&
         deny_getsockopt(SYS_getsockopt, SOL_SOCKET, so_passrights, ENOPROTOOPT);
}

pid_t start(const Start& what) {
  std::vector<std::string> arguments{what.program};
  arguments.insert(arguments.end(), what.arguments.begin(), what.arguments.end());
  std::vector<char*> argv;
  for (std::string& argument : arguments) argv.push_back(argument.data());
  argv.push_back(nullptr);
  Environment environment(what);
  const pid_t parent = ::getpid();
  const pid_t pid = ::fork();
  if (pid != 0) return pid;
  // Dies with the test in any case.
  ::prctl(PR_SET_PDEATHSIG, SIGKILL);
  if (::getppid() != parent) ::_exit(127);
  const int out = ::open(what.out.c_str(), O_WRONLY | O_CREAT | O_APPEND, 0666);
  const int err = ::open(what.err.c_str(), O_WRONLY | O_CREAT | O_APPEND, 0666);
  if (out < 0 || err < 0) ::_exit(126);
  ::dup2(out, STDOUT_FILENO);
  ::dup2(err, STDERR_FILENO);
  // None of our descriptors: the first daemon would inherit them and the next would not.
  ::close_range(3, ~0U, CLOSE_RANGE_CLOEXEC);
  if (!what.sockets.empty()) {
    pass(what.sockets);
    environment.note_pid();
  }
  // Another user may have no access to the program's directory.
  const int program = ::open(argv[0], O_PATH | O_CLOEXEC);
  if (what.uid) {
    if (::setgroups(0, nullptr) != 0 || ::setgid(*what.uid) != 0 || ::setuid(*what.uid) != 0)
      ::_exit(125);
    ::prctl(PR_SET_PDEATHSIG, SIGKILL);  // setuid clears it
  }
  if (what.without_peer_pidfd && !deny_peer_pidfd()) ::_exit(124);
  if (what.without_passrights && !deny_passrights()) ::_exit(123);
  if (what.uid) ::fexecve(program, argv.data(), environment.get());
  ::execve(argv[0], argv.data(), environment.get());
  ::_exit(127);
}

std::size_t count_descriptors(pid_t pid) {
  std::size_t count = 0;
  const std::string path = "/proc/" + std::to_string(pid) + "/fd";
  const std::unique_ptr<DIR, int (*)(DIR*)> entries(::opendir(path.c_str()), &::closedir);
  if (entries == nullptr) return 0;
  while (const dirent* const entry = ::readdir(entries.get())) {
    if (entry->d_name[0] != '.') ++count;
  }
  return count;
}

// Waits for the end of a child. Returns -1 if a signal ended it or it had to be killed.
int end_of(pid_t pid) {
  const auto process = Pidfd::open(pid);
  pollfd entry{process ? process->fd() : -1, POLLIN, 0};
  if (process && ::poll(&entry, 1, patience_ms) == 0) ::kill(pid, SIGKILL);
  int status = 0;
  while (::waitpid(pid, &status, 0) < 0 && errno == EINTR) {
  }
  return WIFEXITED(status) ? WEXITSTATUS(status) : -1;
}

}  // namespace

namespace detail {
void pause_briefly() { ::usleep(pause_us); }
bool time_is_up(unsigned rounds) { return rounds > patience_ms * 1000u / pause_us; }
}  // namespace detail

std::string make_directory() {
  const char* const root = std::getenv("TMPDIR");
  std::string path = std::string(root != nullptr && *root != '\0' ? root : "/tmp") + "/agd-XXXXXX";
  if (::mkdtemp(path.data()) == nullptr || ::chmod(path.c_str(), 0755) != 0) {
    std::perror("making a directory for a test");
    std::abort();
  }
  return path;
}

void remove_directory(const std::string& path) {
  std::error_code ignored;
  std::filesystem::remove_all(path, ignored);
}

DaemonProcess::DaemonProcess(DaemonOptions options) : directory_(make_directory()) {
  begin(options);
}

void DaemonProcess::begin(const DaemonOptions& options) {
  socket_path_ = options.socket.empty() ? directory_ + "/run/agnocastd.sock" : options.socket;
  {
    std::ofstream config(directory_ + "/agnocastd.toml");
    const std::string whole =
        options.config.empty()
            ? default_config_of_daemon + options.more_daemon_config + default_config_of_heap
            : options.config;
    config << with_looks_unlimited(whole + options.more_config);
  }
  if (options.uid) {
    // Others may only look; the daemon's user makes run/ itself.
    EXPECT_EQ(::chown(directory_.c_str(), *options.uid, *options.uid), 0);
    // All clients of this test mean that user's daemon.
    ::setenv("AGNOCAST_DAEMON_UID", std::to_string(*options.uid).c_str(), 1);
  }

  const UniqueFd ready(::socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC, 0));
  const std::string notify = directory_ + "/notify";
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  std::strncpy(address.sun_path, notify.c_str(), sizeof address.sun_path - 1);
  ASSERT_EQ(::bind(ready.get(), reinterpret_cast<sockaddr*>(&address), sizeof address), 0)
      << notify;
  ASSERT_EQ(::chmod(notify.c_str(), 0666), 0);

  Start what;
  if (!options.program.empty()) what.program = options.program;
  what.arguments = {"--foreground", "--config", directory_ + "/agnocastd.toml", "--socket",
                    socket_path_};
  what.arguments.insert(what.arguments.end(), options.arguments.begin(), options.arguments.end());
  what.environment = options.environment;
  what.environment.push_back("NOTIFY_SOCKET=" + notify);
  what.uid = options.uid;
  what.without_peer_pidfd = options.without_peer_pidfd;
  what.without_passrights = options.without_passrights;
  what.sockets = options.sockets;
  what.out = directory_ + "/out";
  what.err = directory_ + "/log";
  pid_ = start(what);
  const auto process = Pidfd::open(pid_);
  ASSERT_TRUE(process);
  pollfd entries[] = {{ready.get(), POLLIN, 0}, {process->fd(), POLLIN, 0}};
  // Closes descriptors of other notifications: this service manager keeps none.
  for (std::string text; !text.starts_with("READY=1\n");) {
    if (::poll(entries, 2, patience_ms) <= 0 || (entries[0].revents & POLLIN) == 0) {
      ADD_FAILURE() << "agnocastd does not serve; it wrote:\n" << log();
      return;
    }
    text.resize(64);
    text.resize(static_cast<std::size_t>(
        std::max<ssize_t>(0, ::recv(ready.get(), text.data(), text.size(), 0))));
  }
}

namespace {

/// Returns what the process does just now: a daemon that does not answer may wait in the kernel, or
/// for a processor. proc(5); nothing for a process that is gone.
std::string doings_of(pid_t pid) {
  std::ostringstream text;
  for (const char* const name : {"stat", "wchan", "syscall", "schedstat", "stack"}) {
    std::ifstream file("/proc/" + std::to_string(pid) + "/" + name);
    std::ostringstream content;
    content << file.rdbuf();
    text << "  " << name << ": " << content.str() << '\n';
  }
  return text.str();
}

}  // namespace

DaemonProcess::~DaemonProcess() {
  if (testing::Test::HasFailure() && pid_ > 0) {
    for (const pid_t process : {pid_, pid()})
      std::fprintf(stderr, "agnocastd %d:\n%s", static_cast<int>(process),
                   doings_of(process).c_str());
  }
  kill();
  ::unsetenv("AGNOCAST_DAEMON_UID");
  if (testing::Test::HasFailure()) std::fprintf(stderr, "agnocastd wrote:\n%s", log().c_str());
  remove_directory(directory_);
}

int DaemonProcess::stop(int signal) {
  if (pid_ <= 0) return -1;
  ::kill(pid_, signal == 0 ? SIGTERM : signal);
  return end_of(std::exchange(pid_, -1));
}

void DaemonProcess::kill() {
  if (pid_ <= 0) return;
  const pid_t worker = pid();
  const auto process = worker > 0 && worker != pid_ ? Pidfd::open(worker) : Result<Pidfd>();
  ::kill(pid_, SIGKILL);
  end_of(std::exchange(pid_, -1));
  if (worker <= 0 || !process || !*process) return;
  pollfd entry{process->fd(), POLLIN, 0};
  EXPECT_EQ(::poll(&entry, 1, patience_ms), 1) << "the daemon outlived its supervisor";
}

pid_t DaemonProcess::kill_worker(int signal) {
  const pid_t worker = pid();
  EXPECT_NE(worker, pid_) << "this daemon has no supervisor";
  if (worker > 0 && worker != pid_) ::kill(worker, signal);
  return worker;
}

bool DaemonProcess::wait_for_next(pid_t old) const {
  return eventually([&] {
    const pid_t worker = pid();
    if (worker <= 0 || worker == old) return false;
    return log().find(" ready pid=" + std::to_string(worker) + " ") != std::string::npos;
  });
}

pid_t DaemonProcess::worker_of(pid_t pid) {
  if (pid <= 0) return -1;
  std::ifstream arguments("/proc/" + std::to_string(pid) + "/cmdline", std::ios::binary);
  std::ostringstream text;
  text << arguments.rdbuf();
  if (text.str().find("--fd-store=none") != std::string::npos) return pid;
  std::ifstream children("/proc/" + std::to_string(pid) + "/task/" + std::to_string(pid) +
                         "/children");
  // The last one: an earlier worker may not be gone yet.
  pid_t child = -1, last = -1;
  while (children >> child) last = child;
  return last;
}

bool DaemonProcess::is_running() {
  siginfo_t info{};
  return pid_ > 0 &&
         ::waitid(P_PID, static_cast<id_t>(pid_), &info, WEXITED | WNOHANG | WNOWAIT) == 0 &&
         info.si_pid == 0;
}

std::string DaemonProcess::log() const { return content_of(directory_ + "/log"); }

bool DaemonProcess::wait_for_log(const std::string& text) const {
  return eventually([&] { return log().find(text) != std::string::npos; });
}

std::size_t DaemonProcess::descriptor_count() const { return count_descriptors(pid()); }

// A supervisor that sleeps (or is stopped by a test) has completed its work so far and has no
// descriptor open temporarily to send a message.
std::size_t DaemonProcess::kept_count() const {
  const auto rests = [this] {
    const std::string stat = content_of("/proc/" + std::to_string(pid_) + "/stat");
    const std::size_t name_end = stat.rfind(") ");
    return name_end != std::string::npos && std::string("ST").find(stat[name_end + 2]) < 2;
  };
  std::size_t count = 0;
  EXPECT_TRUE(eventually([&] {
    const bool rested = rests();
    count = count_descriptors(pid_);
    return rested && rests();
  }));
  return count;
}
std::size_t DaemonProcess::resident_bytes() const {
  std::ifstream file("/proc/" + std::to_string(pid()) + "/statm");
  std::size_t size = 0, resident = 0;
  file >> size >> resident;
  return resident * 4096;
}

std::size_t DaemonProcess::shared_bytes() const {
  // Without the program's own pages, which grow with whatever it does for the first time.
  std::ifstream file("/proc/" + std::to_string(pid()) + "/status");
  std::string word;
  while (file >> word && word != "RssShmem:") {
  }
  std::size_t kib = 0;
  file >> kib;
  return kib * 1024;
}

Ended run_daemon(const std::vector<std::string>& arguments, std::optional<uid_t> uid,
                 const std::vector<std::string>& environment, const std::vector<int>& sockets) {
  const std::string directory = make_directory();
  ::chmod(directory.c_str(), 0777);
  Start what;
  what.arguments = arguments;
  what.environment = environment;
  what.sockets = sockets;
  what.uid = uid;
  what.out = directory + "/out";
  what.err = directory + "/err";
  Ended ended;
  ended.status = end_of(start(what));
  ended.out = content_of(what.out);
  ended.err = content_of(what.err);
  remove_directory(directory);
  return ended;
}

}  // namespace agnocast::test
