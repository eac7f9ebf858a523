// SPDX-License-Identifier: Apache-2.0

#include <client/executors/node_thread.hpp>

#include <base/descriptors/kept_fd.hpp>
#include <base/signals.hpp>
#include <client/executors/callback_waits.hpp>
#include <client/process/forked_child.hpp>
#include <client/process/library_thread.hpp>
#include <client/process/user_code.hpp>

#include <cxxabi.h>
#include <pthread.h>
#include <sys/epoll.h>

#include <cerrno>
#include <cstdint>
#include <new>
#include <system_error>
#include <utility>
#include <vector>

namespace agnocast {
namespace {

/// Tags in the epoll set of a thread.
constexpr std::uint64_t eventfd_tag = 0, datagram_tag = 1, tick_tag = 2;

/// The sources of a node in the last cycle. Weak: a destroyed source frees the objects of its
/// callback at once.
struct Cycle {
  std::vector<std::weak_ptr<CallbackSource>> sources;
  std::uint64_t listed = 0;  // list_changes(); 0: never
};

void run_cycle(NodeCallbacks& node, NodeCallbacks::ExecutorId self, Cycle& cycle, bool& any) {
  if (node.list_changes() != cycle.listed) {
    cycle.sources.clear();
    cycle.listed = 0;  // in case memory runs out
    cycle.listed = node.list(self, cycle.sources);
  }
  for (const auto& listed : cycle.sources) {
    const UserCode code;  // destroyed after the source, which may own the callback
    if (!code.may_run()) return;
    const auto source = listed.lock();
    if (source == nullptr || !source->has_work()) continue;
    if (is_forked_child()) return;
    take_on_signals(source->signals);
    try {
      any = node.run(self, *source) || any;
    } catch (const ::abi::__forced_unwind&) {
      throw;  // the callback ends its thread: pthread_exit()
    } catch (...) {
      // It has no receiver, and the library must not end the process.
      any = true;
      source->exception_count.fetch_add(1, std::memory_order_relaxed);
    }
  }
}

}  // namespace

// --- consecutive threads

/// Lives during the whole function of one thread.
struct NodeThread::Life {
  const std::shared_ptr<NodeThread>& self;
  bool has_returned = false;

  ~Life() {
    if (has_returned || is_forked_child()) return;
    // A callback has called pthread_exit(), or the thread was cancelled. If no thread can be
    // made, the node's callbacks wait for an executor.
    const std::lock_guard lock(self->mutex_);
    if (self->is_joined_ || exit_has_begun()) return;
    (void)start_next(self);
  }
};

Result<std::shared_ptr<NodeThread>> NodeThread::start(std::shared_ptr<NodeCallbacks> node) {
  UniqueFd epoll = keep(UniqueFd(::epoll_create1(EPOLL_CLOEXEC)));
  if (!epoll) return fail(Errc::os_failure, "preparing a callback thread", errno);
  auto tick = SleepTick::in(epoll.get(), tick_tag);
  if (!tick) return tl::unexpected<Failure>(tick.error());
  if (Result<void> added = node->wait_set()->add_to(epoll.get(), eventfd_tag, datagram_tag); !added)
    return tl::unexpected<Failure>(added.error());
  const auto made =
      std::make_shared<NodeThread>(std::move(node), std::move(epoll), std::move(*tick));
  const std::lock_guard lock(made->mutex_);
  if (Result<void> started = start_next(made); !started)
    return tl::unexpected<Failure>(started.error());
  return made;
}

NodeThread::~NodeThread() {
  // Its number may soon belong to another file.
  if (!is_forked_child()) node_->wait_set()->remove_from(epoll_.get());
}

/// Call it under the mutex.
Result<void> NodeThread::start_next(const std::shared_ptr<NodeThread>& self) {
  int error = 0;
  self->before_ = std::move(self->thread_);
  try {
    const SignalsBlocked blocked;
    self->thread_ = std::thread([self] { self->run(self); });
  } catch (const std::system_error& refused) {
    error = refused.code().value();
  } catch (const std::bad_alloc&) {
    error = ENOMEM;
  }
  if (error != 0) {
    self->thread_ = std::move(self->before_);
    return fail(Errc::os_failure, "starting a callback thread", error);
  }
  ::pthread_setname_np(self->thread_.native_handle(), "agnocast-call");
  return {};
}

void NodeThread::run(const std::shared_ptr<NodeThread>& self) {
  ::pthread_setcancelstate(PTHREAD_CANCEL_DISABLE, nullptr);  // see sleep()
  const LibraryThread registered(
      [](void* node) noexcept { static_cast<NodeCallbacks*>(node)->stop(); }, node_.get(),
      LibraryThread::Sleep::can_be_cancelled);
  std::thread before;
  {
    const std::lock_guard lock(mutex_);
    before.swap(before_);
  }
  if (before.joinable()) before.join();
  Life life{self};
  serve();
  life.has_returned = true;
}

/// The only place where this thread can be cancelled, so that cancellation leaves no library
/// function half done.
int NodeThread::sleep(epoll_event (&events)[3]) const {
  if (has_lost_kept()) return unrung_pause(-1);
  ::pthread_setcancelstate(PTHREAD_CANCEL_ENABLE, nullptr);
  const int count = ::epoll_wait(epoll_.get(), events, 3, -1);
  ::pthread_setcancelstate(PTHREAD_CANCEL_DISABLE, nullptr);
  return count >= 0 || errno == EINTR ? count : unrung_pause(-1);
}

void NodeThread::join() noexcept {
  std::thread thread;
  {
    const std::lock_guard lock(mutex_);
    is_joined_ = true;
    thread.swap(thread_);
  }
  if (!thread.joinable()) return;
  CallbackWaits& waits = CallbackWaits::instance();
  if (thread.get_id() == std::this_thread::get_id() || !waits.begin(thread.get_id(), nullptr))
    return thread.detach();
  thread.join();
  waits.end();
}

void NodeThread::abandon() noexcept { new std::thread(std::move(thread_)); }

void NodeThread::serve() {
  NodeCallbacks& node = *node_;
  const NodeCallbacks::ExecutorId self = &node;
  node.disarm(self);  // the previous thread may have been cancelled in its sleep
  Cycle cycle;
  bool has_rung = false;  // the datagram doorbell: drain it before the next sleep
  while (node.await(self)) {
    try {
      bool any = false;
      run_cycle(node, self, cycle, any);
      if (is_forked_child()) return;  // a callback has forked, and has returned in the child
      if (exit_has_begun()) return;   // for good: unread messages stay unread
      if (LibraryThread::is_over()) return;
      if (any) continue;
    } catch (const std::bad_alloc&) {
      // No memory for the list: messages stay unread until there is memory.
    }
    shed_signals();
    if (std::exchange(has_rung, false)) node.drain(self);
    if (node.arm_or_find_work(self)) continue;
    epoll_event events[3];
    const int count = sleep(events);
    node.disarm(self);
    for (int i = 0; i < count; ++i) {
      if (events[i].data.u64 == datagram_tag) has_rung = true;
      if (events[i].data.u64 == tick_tag) tick_.wind_up();
    }
  }
}

}  // namespace agnocast
