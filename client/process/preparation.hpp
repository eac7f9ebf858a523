// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <agnocast/result.hpp>

namespace agnocast {

/// Prepares this process for threads and callbacks of the library: forked children, the end of the
/// process, signals. Call it before the first thread of the library; later calls do nothing. Any
/// thread, not in a forked child. Errors: os_failure (call it again).
[[nodiscard]] Result<void> prepare_process() noexcept;

}  // namespace agnocast
