// SPDX-License-Identifier: Apache-2.0
//
// Writes a log line that any client can cause; limited per user, unless the log level is debug.
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
