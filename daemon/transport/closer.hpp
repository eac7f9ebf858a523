// SPDX-License-Identifier: Apache-2.0
//
// Closer: frees the memory of processes that have ended.
//
// Closing the last descriptor of a memfd frees its pages, a tenth of a second and more for each
// GiB; unmapping it takes as long, and waits for locks that readers of the file can hold as well.
// The daemon must not make other processes wait for that, so a thread of its own does both. It
// waits until the manager has removed its copies from the store: otherwise the manager, under
// systemd PID 1, might close the last one.
//
// The thread touches only the descriptors that it was given. It starts with the first of them. A
// death of the daemon needs no care: the kernel then closes everything.
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
  /// Closes the rest, and waits for that.
  ~Closer();
  Closer(const Closer&) = delete;
  Closer& operator=(const Closer&) = delete;

  /// Takes over these descriptors, which were removed from the store, and a mapping of one of
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
