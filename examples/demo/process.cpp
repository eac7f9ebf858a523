// SPDX-License-Identifier: Apache-2.0

#include <examples/demo/process.hpp>

#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cerrno>
#include <csignal>
#include <cstdlib>
#include <cstring>
#include <utility>

namespace demo {
namespace {

using Clock = std::chrono::steady_clock;
// A round of latencies takes a second, and minutes where other programs leave it little time.
constexpr auto patience = std::chrono::minutes(5);

volatile std::sig_atomic_t caught_signal = 0;

extern "C" void note_signal(int signal) { caught_signal = signal; }

struct Pipe {
  int read = -1;
  int write = -1;
  Pipe() {
    int ends[2];
    if (::pipe2(ends, O_CLOEXEC) != 0) throw Failure(std::string("pipe: ") + std::strerror(errno));
    read = ends[0];
    write = ends[1];
  }
};

int status_of(int wait_status) {
  return WIFEXITED(wait_status) ? WEXITSTATUS(wait_status) : 128 + WTERMSIG(wait_status);
}

[[noreturn]] void become(const Process::Options& options, int input, int output, pid_t parent) {
  ::prctl(PR_SET_PDEATHSIG, SIGKILL);
  if (::getppid() != parent) ::_exit(127);
  ::dup2(input, STDIN_FILENO);
  ::dup2(output, STDOUT_FILENO);
  if (!options.error_file.empty()) {
    const int file =
        ::open(options.error_file.c_str(), O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0600);
    if (file >= 0) ::dup2(file, STDERR_FILENO);
  }
  if (options.descriptor_3 == 3) {
    ::fcntl(3, F_SETFD, 0);
  } else if (options.descriptor_3 >= 0) {
    ::dup2(options.descriptor_3, 3);
  }
  for (const auto& [name, value] : options.environment) ::setenv(name.c_str(), value.c_str(), 1);
  ::signal(SIGPIPE, SIG_DFL);
  std::vector<char*> arguments;
  for (const std::string& word : options.command)
    arguments.push_back(const_cast<char*>(word.c_str()));
  arguments.push_back(nullptr);
  ::execvp(arguments[0], arguments.data());
  ::dprintf(STDERR_FILENO, "demo: %s: %s\n", arguments[0], std::strerror(errno));
  ::_exit(127);
}

}  // namespace

void catch_signals() {
  struct sigaction action {};
  action.sa_handler = note_signal;  // no SA_RESTART: waiting calls must return
  for (const int signal : {SIGINT, SIGTERM, SIGHUP}) ::sigaction(signal, &action, nullptr);
  ::signal(SIGPIPE, SIG_IGN);
}

void check_signals() {
  if (caught_signal != 0) throw Interrupted{caught_signal};
}

Process::Process(Options options) : options_(std::move(options)) {
  const Pipe in, out;
  const pid_t parent = ::getpid();
  pid_ = ::fork();
  if (pid_ < 0) throw Failure(std::string("fork: ") + std::strerror(errno));
  if (pid_ == 0) become(options_, in.read, out.write, parent);
  ::close(in.read);
  ::close(out.write);
  input_ = in.write;
  output_ = out.read;
}

Process::~Process() {
  close_input();
  ::close(output_);
  if (status_) return;
  ::kill(pid_, SIGKILL);
  while (::waitpid(pid_, nullptr, 0) < 0 && errno == EINTR) continue;
}

void Process::send(const std::string& line) {
  const std::string text = line + "\n";
  if (::write(input_, text.data(), text.size()) != static_cast<ssize_t>(text.size()))
    throw Failure(name() + " no longer accepts orders");
}

void Process::close_input() {
  if (input_ >= 0) ::close(std::exchange(input_, -1));
}

std::string Process::line() {
  const auto end_of_patience = Clock::now() + patience;
  for (;;) {
    if (const auto end = buffer_.find('\n'); end != std::string::npos) {
      std::string line = buffer_.substr(0, end);
      buffer_.erase(0, end + 1);
      return line;
    }
    if (Clock::now() > end_of_patience) throw Failure(name() + " has stopped answering");
    pollfd descriptor{output_, POLLIN, 0};
    const int ready = ::poll(&descriptor, 1, 200);
    check_signals();
    if (ready <= 0) continue;
    char bytes[4096];
    const ssize_t count = ::read(output_, bytes, sizeof bytes);
    if (count == 0) throw Failure(name() + " ended, status " + std::to_string(wait()));
    if (count > 0) buffer_.append(bytes, static_cast<std::size_t>(count));
  }
}

int Process::wait() {
  const auto end_of_patience = Clock::now() + patience;
  while (!has_ended()) {
    check_signals();
    if (Clock::now() > end_of_patience) throw Failure(name() + " does not end");
    ::poll(nullptr, 0, 5);
  }
  return *status_;
}

bool Process::has_ended() {
  int wait_status = 0;
  if (!status_ && ::waitpid(pid_, &wait_status, WNOHANG) == pid_) status_ = status_of(wait_status);
  return status_.has_value();
}

}  // namespace demo
