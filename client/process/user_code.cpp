// SPDX-License-Identifier: Apache-2.0

#include <client/process/forked_child.hpp>
#include <client/process/user_code.hpp>

#include <dlfcn.h>
#include <unwind.h>

#include <atomic>
#include <chrono>
#include <cstdint>
#include <cstdlib>
#include <thread>

namespace agnocast {
namespace {

using Clock = std::chrono::steady_clock;

constexpr std::chrono::seconds wait_max{1};
// For callbacks in quick succession; none begins during the wait.
constexpr std::chrono::milliseconds decision_wait_max{20};

// Constant initialisation and no destructors: used before and after every static object.
constinit std::atomic<bool> exit_began{false};
constinit std::atomic<std::uint64_t> running{0};  // UserCodes of all threads
thread_local constinit std::uint64_t running_here = 0;

enum class Phase : std::uint32_t {
  usual,
  deciding,  // whether the user's last thread has ended: new user code waits for the answer
  over,
};
constinit std::atomic<Phase> phase{Phase::usual};

void on_exit() noexcept {
  if (is_forked_child()) return;  // the counts belong to the parent
  // Either UserCode sees this store, or this thread sees the count: both are seq_cst.
  exit_began.store(true);
  const Clock::time_point end = Clock::now() + wait_max;
  while (running.load() != running_here && Clock::now() < end)
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
}

// Searches the stack of this thread for exit(). A destructor of a static object that was made
// after the first endpoint runs before the library's exit handler, so no flag can tell.
struct ExitSearch {
  const void* names[2];
  bool is_found = false;
};
_Unwind_Reason_Code look_at_frame(_Unwind_Context* frame, void* search) noexcept {
  auto& wanted = *static_cast<ExitSearch*>(search);
  // The call is before the address that it returns to.
  auto* const call = reinterpret_cast<void*>(_Unwind_GetIP(frame) - 1);
  const void* const function = _Unwind_FindEnclosingFunction(call);
  for (const void* name : wanted.names) {
    if (function != nullptr && function == name) wanted.is_found = true;
  }
  return wanted.is_found ? _URC_END_OF_STACK : _URC_NO_REASON;
}
bool is_inside_exit() noexcept {
  // Not &std::exit: in a program that is not position-independent, that is a local stub.
  ExitSearch search{{::dlsym(RTLD_DEFAULT, "exit"), ::dlsym(RTLD_DEFAULT, "quick_exit")}};
  _Unwind_Backtrace(look_at_frame, &search);
  return search.is_found;
}

}  // namespace

Result<void> end_user_code_at_exit() noexcept {
  static bool is_registered = false;  // under the lock of prepare_process()
  if (is_registered) return {};
  if (std::atexit([] { on_exit(); }) != 0)
    return fail(Errc::os_failure, "registering an exit handler");
  is_registered = true;
  return {};
}

bool exit_has_begun() noexcept { return exit_began.load(); }

Result<void> refuse_after_exit() noexcept {
  if (!exit_has_begun()) return {};
  return fail(Errc::shut_down, "exit handlers of this process have begun");
}

bool end_user_code_if(bool (*is_last)() noexcept) noexcept {
  // Either UserCode sees this store, or this thread sees the count: both are seq_cst.
  phase.store(Phase::deciding);
  const Clock::time_point end = Clock::now() + decision_wait_max;
  while (running.load() != 0 && Clock::now() < end)
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  const bool over = running.load() == 0 && is_last();
  phase.store(over ? Phase::over : Phase::usual);
  phase.notify_all();
  return over;
}

bool user_threads_have_ended() noexcept { return phase.load() == Phase::over; }

UserCode::UserCode() noexcept {
  ++running_here;
  for (;;) {
    running.fetch_add(1);
    const Phase now = phase.load();
    // Nested user code may always run: the outer one is still running.
    may_run_ = (now == Phase::usual || running_here > 1) && !exit_began.load();
    if (now != Phase::deciding || running_here > 1) return;
    running.fetch_sub(1);
    phase.wait(Phase::deciding);
  }
}

bool ExitPatience::is_over() noexcept {
  static std::atomic<Clock::rep> end{0};  // 0: no wait yet
  if (!is_inside_exit()) return false;
  const Clock::time_point now = Clock::now();
  Clock::rep none = 0;
  // The caller has already waited for one interval.
  end.compare_exchange_strong(none, (now + wait_max - look).time_since_epoch().count());
  return now.time_since_epoch().count() >= end.load();
}

UserCode::~UserCode() {
  running.fetch_sub(1);
  --running_here;
}

}  // namespace agnocast
