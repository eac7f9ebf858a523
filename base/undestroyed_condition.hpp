// SPDX-License-Identifier: Apache-2.0
//
// UndestroyedCondition: a condition variable that is never destroyed. pthread_cond_destroy() waits
// until all waiters are gone. In a forked child they are threads of the parent, so it would wait
// for ever. On Linux a condition variable owns nothing but its bytes.
#pragma once

#include <condition_variable>
#include <new>

namespace agnocast {

class UndestroyedCondition {
 public:
  UndestroyedCondition() noexcept {
    ::new (static_cast<void*>(&condition_)) std::condition_variable;
  }
  ~UndestroyedCondition() {}
  UndestroyedCondition(const UndestroyedCondition&) = delete;
  UndestroyedCondition& operator=(const UndestroyedCondition&) = delete;
  std::condition_variable* operator->() noexcept { return &condition_; }

 private:
  union {
    std::condition_variable condition_;
  };
};

}  // namespace agnocast
