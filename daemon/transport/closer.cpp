// SPDX-License-Identifier: Apache-2.0

#include <daemon/transport/closer.hpp>

#include <base/signals.hpp>
#include <daemon/transport/descriptor_store.hpp>

#include <sys/mman.h>

#include <algorithm>
#include <cstdint>
#include <system_error>
#include <utility>

namespace agnocast::daemon {
namespace {

#ifndef MADV_DONTNEED_LOCKED
#define MADV_DONTNEED_LOCKED 24  // Linux 5.18
#endif

// Piece by piece: a thread that maps or locks memory meanwhile waits for one piece only.
void unmap(const Mapping& mapping) noexcept {
  constexpr std::uint64_t piece_bytes = 16 << 20;
  for (std::uint64_t at = 0; at < mapping.bytes(); at += piece_bytes) {
    const std::uint64_t bytes = std::min(piece_bytes, mapping.bytes() - at);
    if (::madvise(mapping.base() + at, bytes, MADV_DONTNEED_LOCKED) != 0)
      ::madvise(mapping.base() + at, bytes, MADV_DONTNEED);
  }
}

}  // namespace

Closer::~Closer() {
  {
    const std::lock_guard lock(mutex_);
    stops_ = true;
  }
  changed_.notify_one();
  if (thread_.joinable()) thread_.join();
}

void Closer::close(std::vector<SharedFd> fds, std::shared_ptr<Mapping> mapping) {
  {
    const std::lock_guard lock(mutex_);
    waiting_.push_back({std::move(fds), std::move(mapping)});
  }
  changed_.notify_one();
  if (thread_.joinable()) return;
  const SignalsBlocked blocked;  // the first thread handles them
  try {
    thread_ = std::thread([this] { run(); });
  } catch (const std::system_error&) {  // no thread left: then this is slow
    waiting_.clear();
  }
}

void Closer::run() {
  std::unique_lock lock(mutex_);
  for (;;) {
    changed_.wait(lock, [this] { return stops_ || !waiting_.empty(); });
    if (waiting_.empty()) return;
    std::vector<Memory> now = std::exchange(waiting_, {});
    lock.unlock();
    for (const Memory& memory : now) {
      if (memory.mapping) unmap(*memory.mapping);
    }
    wait_for_manager();
    now.clear();
    lock.lock();
  }
}

}  // namespace agnocast::daemon
