// SPDX-License-Identifier: Apache-2.0

#include <daemon/closer.hpp>

#include <base/signals.hpp>
#include <daemon/descriptor_store.hpp>

#include <iterator>
#include <system_error>
#include <utility>

namespace agnocast::daemon {

Closer::~Closer() {
  {
    const std::lock_guard lock(mutex_);
    stops_ = true;
  }
  changed_.notify_one();
  if (thread_.joinable()) thread_.join();
}

void Closer::close(std::vector<SharedFd> fds) {
  {
    const std::lock_guard lock(mutex_);
    waiting_.insert(waiting_.end(), std::make_move_iterator(fds.begin()),
                    std::make_move_iterator(fds.end()));
  }
  changed_.notify_one();
  if (thread_.joinable()) return;
  const SignalsBlocked blocked;  // they are the first thread's business
  try {
    thread_ = std::thread([this] { run(); });
  } catch (const std::system_error&) {  // no thread left: then it takes its time
    waiting_.clear();
  }
}

void Closer::run() {
  std::unique_lock lock(mutex_);
  for (;;) {
    changed_.wait(lock, [this] { return stops_ || !waiting_.empty(); });
    if (waiting_.empty()) return;
    std::vector<SharedFd> now = std::exchange(waiting_, {});
    lock.unlock();
    wait_for_manager();
    now.clear();
    lock.lock();
  }
}

}  // namespace agnocast::daemon
