// SPDX-License-Identifier: Apache-2.0
//
// Joining: how a process gets a session. docs/control-plane.md, "Connection and identity".
//
//   connect → hello → welcome: reserve the arena, map board and region → the control thread begins
//
// The steps before the thread may fail and are undone. If the daemon dies meanwhile, it is asked
// again until the request times out. Coming back later: rejoining.cpp.

#include <client/session/context.hpp>

#include <base/memory/mapping.hpp>
#include <client/process/forked_child.hpp>
#include <client/process/library_thread.hpp>
#include <client/process/preparation.hpp>
#include <client/process/steps.hpp>
#include <client/process/user_code.hpp>

#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <utility>

namespace agnocast {

namespace {

/// Returns whether a daemon is likely to listen soon: it has just died, or is starting. Between two
/// daemons the socket refuses connections, or is missing while the lock file beside it stays.
bool may_begin(const std::string& path, const Failure& why) noexcept {
  if (why.code != Errc::daemon_not_running) return false;
  if (why.os_errno == ECONNREFUSED) return true;
  return why.os_errno == ENOENT && ::access((path + ".lock").c_str(), F_OK) == 0;
}
constexpr std::chrono::seconds begin_patience{1};

}  // namespace

Result<void> Context::connect() {
  if (Result<void> refused = refuse_forked_child(); !refused) return refused;
  if (Result<void> refused = refuse_after_exit(); !refused) return refused;
  const std::lock_guard lock(connecting_);
  if (state_.is_connected()) return {};
  if (Result<void> prepared = prepare_process(); !prepared) return prepared;
  if (Result<void> found = registration_.find_daemon(); !found) return found;
  if (Result<void> known = become_known(); !known) return known;
  state_.step(SessionState::Step::connected);
  return {};
}

// If a daemon was there and has died meanwhile, another one follows: its hello gets the
// full patience of a request. If the daemon may have died just before, the client waits less.
Result<void> Context::become_known() {
  const auto deadline = Reconnection::Clock::now() + Connection::answer_timeout;
  std::optional<Reconnection::Clock::time_point> refused;  // time of the first refusal
  auto pause = Reconnection::pause_first;
  for (bool was_there = false;; pause = std::min(pause * 2, Reconnection::pause_last)) {
    Result<void> done = registration_.say_hello(deadline, heap_.is_open());
    AGNOCAST_CRASH_POINT(C_thread);
    if (done) done = start_control_thread();
    if (done) return done;
    was_there = was_there || registration_.has_connected();
    registration_.undo();
    const auto now = Reconnection::Clock::now();
    if (!refused) refused = now;
    if (done.error().code != Errc::daemon_not_running ||
        !(was_there || may_begin(registration_.path(), done.error())) ||
        now + pause >= (was_there ? deadline : *refused + begin_patience))
      return done;
    std::this_thread::sleep_for(pause);
  }
}

Result<void> Context::start_control_thread() {
  if (Result<void> prepared = control_.prepare(); !prepared) return prepared;
  registration_.connection().open();
  // The new session is reported when the endpoints have moved to it.
  if (state_.is_beginning()) return start_thread();
  const ConnectionState before = state_.set(ConnectionState::connected);
  Result<void> started = start_thread();
  if (!started) state_.set(before);
  return started;
}

Result<void> Context::start_thread() {
  const int refused = LibraryThread::start(
      "agnocast-ctl",
      [](void* context) -> void* {
        auto* const self = static_cast<Context*>(context);
        {
          const LibraryThread registered(
              [](void* of) noexcept { static_cast<Context*>(of)->wake_control(); }, context);
          self->control_.serve();
        }
        if (self->state_.is_dropped()) delete self;
        return nullptr;
      },
      this);
  has_thread_ = refused == 0;
  if (refused == 0) return {};
  // Too many threads, or no room for the stack? Both are EAGAIN.
  if (const Result<Mapping> stack = Mapping::map_private(LibraryThread::small_stack_bytes); !stack)
    return tl::unexpected<Failure>(stack.error());
  return fail(Errc::os_failure, "starting the control thread", refused);
}

void Context::Drop::operator()(Context* context) const noexcept {
  Heap::leave_region(context->registration_.region_base());
  if (!context->has_thread_) {
    delete context;
    return;
  }
  const auto wake = context->registration_.wake();
  context->state_.step(SessionState::Step::drop);  // its thread deletes it
  (*wake)();
}

}  // namespace agnocast
