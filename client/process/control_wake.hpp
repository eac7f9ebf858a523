// SPDX-License-Identifier: Apache-2.0
//
// ControlWake: what wakes the control thread of one session. Shared by everything that may have
// something for it to do, so that a late wake finds a descriptor that is still its own.
#pragma once

#include <agnocast/result.hpp>
#include <base/descriptors/kept_fd.hpp>
#include <base/descriptors/unique_fd.hpp>
#include <base/immortal.hpp>
#include <client/process/forked_child.hpp>

#include <sys/eventfd.h>
#include <unistd.h>

#include <cerrno>
#include <cstdint>
#include <memory>
#include <mutex>
#include <utility>
#include <vector>

namespace agnocast {

class ControlWake {
 public:
  explicit ControlWake(UniqueFd eventfd) noexcept : eventfd_(std::move(eventfd)) {}
  /// A new one, or one that was given back. Errors: os_failure.
  [[nodiscard]] static Result<std::shared_ptr<const ControlWake>> make() {
    {
      Unused& unused = immortal<Unused>();
      const std::lock_guard lock(unused.mutex);
      if (!unused.all.empty()) {
        auto wake = std::move(unused.all.back());
        unused.all.pop_back();
        return wake;
      }
    }
    UniqueFd eventfd = keep(UniqueFd(::eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK)));
    if (!eventfd) return fail(Errc::os_failure, "preparing the control thread", errno);
    return std::make_shared<const ControlWake>(std::move(eventfd));
  }

  /// Its thread has ended. A thread that still uses it wakes the one that has it next, for nothing;
  /// so its number is never somebody else's.
  static void give_back(std::shared_ptr<const ControlWake> wake) {
    Unused& unused = immortal<Unused>();
    const std::lock_guard lock(unused.mutex);
    unused.all.push_back(std::move(wake));
  }

  int fd() const noexcept { return eventfd_.get(); }
  /// Any thread; one system call.
  void operator()() const noexcept {
    if (is_forked_child() || !may_use(fd())) return;  // it would wake the parent's
    const std::uint64_t one = 1;
    [[maybe_unused]] const ssize_t written =
        ::write(eventfd_.get(), &one, sizeof one);  // full: it is awake anyway
  }

 private:
  struct Unused {
    std::mutex mutex;
    std::vector<std::shared_ptr<const ControlWake>> all;
  };

  UniqueFd eventfd_;
};

}  // namespace agnocast
