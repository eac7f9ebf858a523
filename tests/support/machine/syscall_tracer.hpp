// SPDX-License-Identifier: Apache-2.0
//
// SyscallTracer: the system calls of another process's main thread between two marks.
//
// The traced program calls mark_begin(label) and mark_end(): system calls themselves, which do
// nothing and are recognised by their arguments. A child of the test traces that one thread with
// ptrace (other threads run freely) and writes a line for each pair of marks. vDSO calls never
// enter the kernel and are rightly not seen.
#pragma once

#include <base/descriptors/unique_fd.hpp>

#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/ptrace.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cerrno>
#include <cstdint>
#include <cstdio>
#include <optional>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

namespace agnocast::test {

inline constexpr std::uint64_t mark_begin_option = 0x41474e01, mark_end_option = 0x41474e02;
/// For the traced program: allows any process of this user to trace it.
inline void allow_tracing() { ::prctl(PR_SET_PTRACER, PR_SET_PTRACER_ANY, 0, 0, 0); }
inline void mark_begin(std::uint64_t label) {
  ::syscall(SYS_prctl, mark_begin_option, label, 0, 0, 0);
}
inline void mark_end() { ::syscall(SYS_prctl, mark_end_option, 0, 0, 0, 0); }

class SyscallTracer {
 public:
  struct Section {
    std::uint64_t label = 0;
    std::vector<long> calls;  // numbers, in order
  };

  /// Returns when `pid` is traced, or cannot be: see is_tracing() and is_forbidden().
  explicit SyscallTracer(pid_t pid) {
    int ends[2];
    if (::pipe2(ends, O_CLOEXEC) != 0) std::abort();
    said_.reset(ends[0]);
    const UniqueFd say(ends[1]);
    tracer_ = ::fork();
    if (tracer_ == 0) ::_exit(trace(pid, say.get()));
    std::string first;
    is_tracing_ = read_line(first) && first == "tracing";
    is_forbidden_ = first == "forbidden";
  }
  ~SyscallTracer() {
    ::kill(tracer_, SIGKILL);  // the kernel detaches
    ::waitpid(tracer_, nullptr, 0);
  }
  SyscallTracer(const SyscallTracer&) = delete;
  SyscallTracer& operator=(const SyscallTracer&) = delete;

  bool is_tracing() const noexcept { return is_tracing_; }
  /// Returns whether this system does not let a process trace another one of its user.
  bool is_forbidden() const noexcept { return is_forbidden_; }
  /// Returns the next section that ended; empty if none ends within 20 s.
  std::optional<Section> next() {
    std::string line;
    if (!read_line(line)) return std::nullopt;
    std::istringstream words(line);
    Section section;
    words >> section.label;
    for (long call = 0; words >> call;) section.calls.push_back(call);
    return section;
  }

 private:
  bool read_line(std::string& line) {
    for (;;) {
      if (const std::size_t end = text_.find('\n'); end != std::string::npos) {
        line = text_.substr(0, end);
        text_.erase(0, end + 1);
        return true;
      }
      pollfd readable{said_.get(), POLLIN, 0};
      char letters[4096];
      if (::poll(&readable, 1, 20000) <= 0) return false;
      const ssize_t count = ::read(said_.get(), letters, sizeof letters);
      if (count <= 0) return false;
      text_.append(letters, static_cast<std::size_t>(count));
    }
  }

  static void say(int fd, const std::string& line) {
    const std::string text = line + "\n";
    (void)!::write(fd, text.data(), text.size());
  }

  // Runs in the child. Ends with the traced thread.
  static int trace(pid_t pid, int fd) {
    if (::ptrace(PTRACE_SEIZE, pid, nullptr, PTRACE_O_TRACESYSGOOD) != 0) {
      if (errno == EPERM) say(fd, "forbidden");
      return 1;
    }
    if (::ptrace(PTRACE_INTERRUPT, pid, nullptr, nullptr) != 0) return 1;
    bool said = false;
    std::optional<std::string> section;
    for (int status = 0; ::waitpid(pid, &status, __WALL) == pid && WIFSTOPPED(status);) {
      if (!std::exchange(said, true)) say(fd, "tracing");
      const int signal = WSTOPSIG(status);
      if (signal == (SIGTRAP | 0x80)) note(pid, fd, section);
      const bool ours = signal == (SIGTRAP | 0x80) || status >> 16 == PTRACE_EVENT_STOP;
      ::ptrace(PTRACE_SYSCALL, pid, nullptr, ours ? 0 : signal);
    }
    return 0;
  }
  static void note(pid_t pid, int fd, std::optional<std::string>& section) {
    __ptrace_syscall_info info{};
    if (::ptrace(static_cast<__ptrace_request>(PTRACE_GET_SYSCALL_INFO), pid, sizeof info, &info) <=
        0)
      return;
    if (info.op != PTRACE_SYSCALL_INFO_ENTRY) return;
    const auto number = static_cast<long>(info.entry.nr);
    if (number == SYS_prctl && info.entry.args[0] == mark_begin_option) {
      section = std::to_string(info.entry.args[1]);
    } else if (number == SYS_prctl && info.entry.args[0] == mark_end_option) {
      if (section) say(fd, *section);
      section.reset();
    } else if (section) {
      *section += " " + std::to_string(number);
    }
  }

  pid_t tracer_ = -1;
  UniqueFd said_;
  std::string text_;
  bool is_tracing_ = false, is_forbidden_ = false;
};

}  // namespace agnocast::test
