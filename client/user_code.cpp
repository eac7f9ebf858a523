// SPDX-License-Identifier: Apache-2.0

#include <client/forked_child.hpp>
#include <client/user_code.hpp>

#include <atomic>
#include <chrono>
#include <cstdint>
#include <cstdlib>
#include <thread>

namespace agnocast {
namespace {

using Clock = std::chrono::steady_clock;

constexpr std::chrono::seconds wait_max{1};

// Constant initialisation and no destructors: they are used before and after every static object.
constinit std::atomic<bool> exit_began{false};
constinit std::atomic<std::uint64_t> running{0};  // UserCodes of all threads
thread_local constinit std::uint64_t running_here = 0;

void on_exit() noexcept {
  if (is_forked_child()) return;  // the numbers are the parent's
  // Either UserCode sees this, or it is seen here: both are seq_cst.
  exit_began.store(true);
  const Clock::time_point end = Clock::now() + wait_max;
  while (running.load() != running_here && Clock::now() < end)
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
}

}  // namespace

Result<void> end_user_code_at_exit() noexcept {
  static bool is_registered = false;  // under the lock of whoever connects
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

UserCode::UserCode() noexcept {
  ++running_here;
  running.fetch_add(1);
  may_run_ = !exit_began.load();
}

UserCode::~UserCode() {
  running.fetch_sub(1);
  --running_here;
}

}  // namespace agnocast
