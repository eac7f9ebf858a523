// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <agnocast/node/agnocast_only_executor.hpp>

#include <cstddef>

namespace agnocast {

class AgnocastOnlyMultiThreadedExecutor : public AgnocastOnlyExecutor {
 public:
  /// `number_of_threads` 0: as many as processors, at least 2. `next_exec_timeout_ms` has no
  /// effect: nothing is polled.
  explicit AgnocastOnlyMultiThreadedExecutor(std::size_t number_of_threads = 0,
                                             bool yield_before_execute = false,
                                             int next_exec_timeout_ms = 50);
};

}  // namespace agnocast
