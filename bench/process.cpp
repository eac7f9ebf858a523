// SPDX-License-Identifier: Apache-2.0

#include <bench/process.hpp>

#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <map>
#include <mutex>
#include <stdexcept>
#include <system_error>
#include <thread>
#include <utility>

namespace agnocast::bench {
namespace {

using Clock = std::chrono::steady_clock;
constexpr auto pause = std::chrono::milliseconds(1);

struct Pipe {
  int ends[2] = {-1, -1};
  void make() {
    if (::pipe2(ends, O_CLOEXEC) != 0)
      throw std::system_error(errno, std::generic_category(), "pipe");
  }
  ~Pipe() {
    for (const int end : ends) {
      if (end >= 0) ::close(end);
    }
  }
  int take(int which) { return std::exchange(ends[which], -1); }
};

[[noreturn]] void become(const Process::Options& options, const Pipe& in, const Pipe& out,
                         pid_t parent) {
  ::prctl(PR_SET_PDEATHSIG, options.end_signal);
  if (::getppid() != parent) ::_exit(127);
  sigset_t none;
  ::sigemptyset(&none);
  ::sigprocmask(SIG_SETMASK, &none, nullptr);
  ::signal(SIGPIPE, SIG_DFL);  // the child would inherit that it is ignored
  if (!options.output.empty()) {
    const int file =
        ::open(options.output.c_str(), O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0600);
    if (file >= 0) ::dup2(file, STDOUT_FILENO), ::dup2(file, STDERR_FILENO);
  }
  if (options.has_pipes) ::dup2(in.ends[0], STDIN_FILENO), ::dup2(out.ends[1], STDOUT_FILENO);
  for (const int descriptor : options.descriptors) ::fcntl(descriptor, F_SETFD, 0);
  for (const std::string& variable : options.environment) ::putenv(::strdup(variable.c_str()));
  std::vector<char*> arguments;
  for (const std::string& word : options.command)
    arguments.push_back(const_cast<char*>(word.c_str()));
  arguments.push_back(nullptr);
  ::execvp(arguments[0], arguments.data());
  ::dprintf(STDERR_FILENO, "agnocast-bench: %s: %s\n", arguments[0], std::strerror(errno));
  ::_exit(127);
}

// Used by a process that computes, not by one that looks at a clock now and then.
constexpr auto computing_least = std::chrono::milliseconds(50);

/// Returns the processor time that all threads of the process have used.
std::chrono::nanoseconds computed_by(pid_t process) {
  clockid_t clock{};
  timespec used{};
  if (::clock_getcpuclockid(process, &clock) != 0 || ::clock_gettime(clock, &used) != 0) return {};
  return std::chrono::seconds(used.tv_sec) + std::chrono::nanoseconds(used.tv_nsec);
}

int status_of(int wait_status) {
  return WIFEXITED(wait_status) ? WEXITSTATUS(wait_status) : 128 + WTERMSIG(wait_status);
}

std::map<std::string_view, RoleMain>& roles() {
  static std::map<std::string_view, RoleMain> all;
  return all;
}

// Never destroyed: a signal may come while the process ends. The mutex also guards the pid and
// status of every Process, because a pid that was waited for may be reused at once.
struct Everyone {
  std::recursive_mutex mutex;
  std::vector<Process*> processes;
};
Everyone& everyone() {
  static auto* const all = new Everyone;
  return *all;
}

}  // namespace

Process::Process(Options options)
    : end_signal_(options.end_signal), at_end_(options.at_end), name_(options.command.at(0)) {
  Pipe in, out;
  if (options.has_pipes) in.make(), out.make();
  const pid_t parent = ::getpid();
  const std::lock_guard lock(everyone().mutex);
  everyone().processes.reserve(everyone().processes.size() + 1);
  pid_ = ::fork();
  if (pid_ < 0) throw std::system_error(errno, std::generic_category(), "fork");
  if (pid_ == 0) become(options, in, out, parent);
  everyone().processes.push_back(this);
  input_ = in.take(1);
  output_ = out.take(0);
}

Process::Process(Process&& other) noexcept
    : input_(std::exchange(other.input_, -1)),
      output_(std::exchange(other.output_, -1)),
      end_signal_(other.end_signal_),
      name_(std::move(other.name_)),
      buffer_(std::move(other.buffer_)) {
  const std::lock_guard lock(everyone().mutex);
  pid_ = std::exchange(other.pid_, -1);
  at_end_ = std::exchange(other.at_end_, nullptr);
  status_ = other.status_;
  std::replace(everyone().processes.begin(), everyone().processes.end(), &other, this);
}

Process::~Process() {
  if (pid_ > 0) (void)end(end_signal_);
  if (at_end_ != nullptr) at_end_();
  {
    const std::lock_guard lock(everyone().mutex);
    std::erase(everyone().processes, this);
  }
  if (input_ >= 0) ::close(input_);
  if (output_ >= 0) ::close(output_);
}

std::optional<int> Process::status() {
  const std::lock_guard lock(everyone().mutex);
  int wait_status = 0;
  if (!status_ && ::waitpid(pid_, &wait_status, WNOHANG) == pid_) status_ = status_of(wait_status);
  return status_;
}

std::optional<int> Process::wait(std::chrono::milliseconds at_most) {
  const auto end = Clock::now() + at_most;
  while (!status() && Clock::now() < end) std::this_thread::sleep_for(pause);
  return status_;
}

int Process::end(int signal) {
  const auto send_signal = [this](int number) {
    const std::lock_guard lock(everyone().mutex);
    if (!status()) ::kill(pid_, number);
  };
  send_signal(signal);
  if (!wait(std::chrono::seconds(10))) send_signal(SIGKILL);
  while (!status()) std::this_thread::sleep_for(pause);
  return *status_;
}

void Process::end_all() noexcept {
  everyone().mutex.lock();  // and never unlocked
  for (const bool is_killed : {true, false}) {
    for (Process* const process : everyone().processes) {
      if ((process->end_signal_ == SIGKILL) != is_killed) continue;
      (void)process->end(process->end_signal_);
      if (process->at_end_ != nullptr) process->at_end_();
    }
  }
}

bool Process::send(std::string_view line) {
  const std::string text = std::string(line) + "\n";
  return ::write(input_, text.data(), text.size()) == static_cast<ssize_t>(text.size());
}

std::string Process::line(std::chrono::milliseconds at_most) {
  const auto computed_before = computed_by(pid_);
  auto computed = computed_before;
  auto end = Clock::now() + at_most;
  for (;;) {
    if (const auto line_end = buffer_.find('\n'); line_end != std::string::npos) {
      std::string line = buffer_.substr(0, line_end);
      buffer_.erase(0, line_end + 1);
      return line;
    }
    const auto left = std::chrono::duration_cast<std::chrono::milliseconds>(end - Clock::now());
    pollfd entry{output_, POLLIN, 0};
    if (left.count() <= 0 || ::poll(&entry, 1, static_cast<int>(left.count())) == 0) {
      const auto now = computed_by(pid_);
      const bool computes = now - std::exchange(computed, now) >= computing_least;
      if (!computes || now - computed_before >= at_most)
        throw std::runtime_error(name_ + " has stopped answering");
      end = Clock::now() + at_most;
      continue;
    }
    char bytes[4096];
    const ssize_t count = ::read(output_, bytes, sizeof bytes);
    if (count == 0) throw std::runtime_error(name_ + " has ended unexpectedly");
    if (count > 0) buffer_.append(bytes, static_cast<std::size_t>(count));
  }
}

std::vector<std::string> as_role(std::string_view role, std::vector<std::string> arguments) {
  arguments.insert(arguments.begin(), {"/proc/self/exe", "%" + std::string(role)});
  return arguments;
}

RegisterRole::RegisterRole(std::string_view name, RoleMain main) { roles().emplace(name, main); }

RoleMain find_role(std::string_view name) {
  const auto found = roles().find(name);
  return found == roles().end() ? nullptr : found->second;
}

int run_role(const std::string& name, const std::vector<std::string>& arguments) {
  const RoleMain main = find_role(name);
  if (main == nullptr) {
    std::fprintf(stderr, "agnocast-bench: no role '%s'\n", name.c_str());
    return 2;
  }
  ::prctl(PR_SET_NAME, ("bench-" + name).substr(0, 15).c_str());
  return main(arguments);
}

}  // namespace agnocast::bench
