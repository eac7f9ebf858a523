// SPDX-License-Identifier: Apache-2.0
//
// Support for tests of the heap hook: processes with the hook, windows without a daemon.
//
// A process has one hook, which attaches once, so every HOOKED_TEST body runs in its own process:
// the test program starts itself again with LD_PRELOAD (or, in the build that links the hook,
// without) and a filter for that one test. The outer process has a timeout for it and reports its
// output. Inside, all of GoogleTest works; its own allocations come from libc because they are
// outside every scope.
#pragma once

#include <agnocast/abi/heaphook.h>

#include <gtest/gtest.h>

#include <atomic>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

namespace hook_test {

// The result of a finished process.
struct Outcome {
  int exit_status = -1;  // exit code, 128 + signal, or -1 when it ran out of time and was killed
  std::string output;    // stdout
  std::string error;     // stderr
};

struct RunOptions {
  std::chrono::seconds timeout{60};
  std::vector<std::string> environment;  // NAME=value, on top of PATH, HOME and LANG=C
  bool preload = false;
  int run_as_uid = -1;
  std::string directory;
};

// Runs a program to its end and returns its exit status and both streams.
Outcome run(const std::vector<std::string>& arguments, const RunOptions& options = {});

// Returns the path of libagnocast_heaphook.so.
std::string hook_path();
// Returns whether this program is the variant that links the hook. Call it outside of bodies.
bool hook_is_linked();

// Bodies: HOOKED_TEST(Suite, Claim) { … }
void run_in_own_process(const char* suite, const char* name);
bool in_own_process();

#define HOOKED_TEST(suite, name)                      \
  static void body_of_##suite##_##name();             \
  TEST(suite, name) {                                 \
    if (::hook_test::in_own_process()) {              \
      body_of_##suite##_##name();                     \
    } else {                                          \
      ::hook_test::run_in_own_process(#suite, #name); \
    }                                                 \
  }                                                   \
  static void body_of_##suite##_##name()

// Returns the hook of this process.
const agnocast_heaphook_table& hook();

inline constexpr std::size_t MiB = std::size_t{1} << 20;
// 256 GiB: free in ordinary processes, below the end of 39-bit address spaces.
inline constexpr std::uintptr_t window_address = std::uintptr_t{1} << 38;

// A memfd with a read-write and a read-only descriptor, as the daemon makes them.
struct WindowFile {
  explicit WindowFile(std::size_t length, std::uintptr_t base = window_address);
  ~WindowFile();
  WindowFile(const WindowFile&) = delete;
  WindowFile& operator=(const WindowFile&) = delete;
  std::size_t resident_bytes() const;

  agnocast_heaphook_window window{};
};

// The frontiers that the hook announced, written by the callback (which may not allocate).
struct Announced {
  std::atomic<std::uint64_t> frontier[AGNOCAST_HEAPHOOK_WINDOWS_MAX];
  std::atomic<int> calls;
};
extern Announced announced;

agnocast_heaphook_options options_for(std::uint32_t scope);
// Attaches a first window; the test fails when that does not work.
void attach(const WindowFile& file, std::uint32_t scope = AGNOCAST_HEAPHOOK_SCOPE_LOAN);

class Scope {
 public:
  Scope() { hook().enter(); }
  ~Scope() { hook().leave(); }
  Scope(const Scope&) = delete;
  Scope& operator=(const Scope&) = delete;
};

bool is_shared(const void* address);
agnocast_heaphook_usage usage();
std::size_t self_status_kib(const char* field);  // a line of /proc/self/status

// A new directory that all users may enter, removed with its content at the end.
class Directory {
 public:
  Directory();
  ~Directory();
  Directory(const Directory&) = delete;
  Directory& operator=(const Directory&) = delete;
  std::string path;
};

// Keeps the compiler from removing a malloc whose block is never used.
template <typename T>
T* opaque(T* pointer) {
  asm volatile("" : "+r"(pointer) : : "memory");
  return pointer;
}

// Returns the definition that the hook interposes, for comparison.
template <typename F>
F libc_function(const char* name);
void* libc_symbol(const char* name);
template <typename F>
F libc_function(const char* name) {
  return reinterpret_cast<F>(libc_symbol(name));
}

// Runs a function in a forked child. Returns 0 when it returned true, else as wait_for (128 +
// signal, 99 = timeout).
template <typename F>
int in_forked_child(F body);
int wait_for(int pid);

}  // namespace hook_test

#include <unistd.h>

namespace hook_test {
template <typename F>
int in_forked_child(F body) {
  const int pid = fork();
  if (pid == 0) {
    alarm(30);
    _exit(body() ? 0 : 1);
  }
  return wait_for(pid);
}
}  // namespace hook_test
