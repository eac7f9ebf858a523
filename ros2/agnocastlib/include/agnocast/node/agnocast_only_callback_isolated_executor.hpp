// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <agnocast/node/agnocast_only_executor.hpp>

namespace agnocast {

/// See CallbackIsolatedAgnocastExecutor.
class AgnocastOnlyCallbackIsolatedExecutor : public AgnocastOnlyExecutor {
 public:
  /// `next_exec_timeout_ms` has no effect: nothing is polled.
  explicit AgnocastOnlyCallbackIsolatedExecutor(int next_exec_timeout_ms = 50);
  void cancel() override;
};

}  // namespace agnocast
