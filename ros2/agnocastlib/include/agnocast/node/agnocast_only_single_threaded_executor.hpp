// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <agnocast/node/agnocast_only_executor.hpp>

namespace agnocast {

class AgnocastOnlySingleThreadedExecutor : public AgnocastOnlyExecutor {
 public:
  /// `next_exec_timeout_ms` has no effect: nothing is polled.
  explicit AgnocastOnlySingleThreadedExecutor(int next_exec_timeout_ms = 50);
};

}  // namespace agnocast
