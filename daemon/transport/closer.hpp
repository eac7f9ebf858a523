// SPDX-License-Identifier: Apache-2.0
//
// Closer: lets go of the memory of processes that have ended.
//
// Closing the last descriptor of a memfd frees its pages, a tenth of a second and more for each
// GiB; unmapping it takes as long, and waits for locks that readers of the file have as well. The
// daemon must not keep everybody waiting for that. So a thread of its own does both. It waits until
// the manager has removed its copies from the store: otherwise the manager might be the last, which
// under systemd is PID 1.
//
// The thread touches nothing but the descriptors that it was given. It begins with the first of
// them. A death of the daemon needs no care: a process that ends closes everything.
#pragma once

#include <base/memory/mapping.hpp>
#include <daemon/transport/shared_fd.hpp>

#include <condition_variable>
#include <memory>
#include <mutex>
#include <thread>
#include <vector>

namespace agnocast::daemon {

class Closer {
 public:
  Closer() = default;
  /// Closes what is left, and waits for that.
  ~Closer();
  Closer(const Closer&) = delete;
  Closer& operator=(const Closer&) = delete;

  /// Takes over these uses of descriptors that were removed from the store, and a mapping of one of
  /// them; closes them soon.
  void close(std::vector<SharedFd> fds, std::shared_ptr<Mapping> mapping = {});

 private:
  void run();

  std::mutex mutex_;
  std::condition_variable changed_;
  struct Memory {
    std::vector<SharedFd> fds;
    std::shared_ptr<Mapping> mapping;
  };
  std::vector<Memory> waiting_;
  bool stops_ = false;
  std::thread thread_;
};

}  // namespace agnocast::daemon
