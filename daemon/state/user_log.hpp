// SPDX-License-Identifier: Apache-2.0
//
// A line of the log that any client can cause: limited for each user, unless somebody looks at
// everything.
#pragma once

#include <base/text/log.hpp>

#include <cstdint>
#include <string>
#include <string_view>

namespace agnocast::daemon {

inline void log_for_user(Log& log, LogLevel level, std::uint32_t uid, std::string_view event,
                         Log::Fields fields) {
  if (log.is_written(LogLevel::debug)) {
    log.write(level, event, fields);
  } else {
    log.write_limited(std::string(event) + " uid=" + std::to_string(uid), level, event, fields);
  }
}

}  // namespace agnocast::daemon
