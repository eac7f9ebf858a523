// SPDX-License-Identifier: Apache-2.0

#include <agnocastlib/forked_child.hpp>

#include <sys/types.h>
#include <unistd.h>

#include <atomic>

namespace agnocastlib {

bool is_forked_child() noexcept {
  static std::atomic<pid_t> owner{0};  // the process of the first call
  const pid_t self = ::getpid();
  pid_t known = 0;
  return !owner.compare_exchange_strong(known, self, std::memory_order_relaxed) && known != self;
}

}  // namespace agnocastlib
