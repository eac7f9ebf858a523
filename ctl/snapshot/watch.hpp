// SPDX-License-Identifier: Apache-2.0
//
// Watch: repeated looks at one system, across restarts of the daemon, for commands that repeat.
// Between two looks only counters in mapped regions are read, which costs no other process
// anything; the tables are requested again only when the daemon's log shows a change.
#pragma once

#include <ctl/snapshot/system.hpp>

#include <cstdint>
#include <optional>
#include <string>

namespace agnocast::ctl {

class Watch {
 public:
  static Outcome<Watch> begin(const std::string& socket, LookOptions options = {});

  /// Returns the system of the last look.
  const System& system() const noexcept { return *system_; }
  /// Looks again if something may have changed. While the daemon is absent (is_away()), for at
  /// most 100 attempts 0.1 s apart, the system stays as it was. Problems: as Observer.
  Outcome<void> renew();
  bool is_away() const noexcept { return failures_ != 0; }
  Observer& observer() noexcept { return observer_; }

 private:
  Watch(std::string socket, LookOptions options, Observer observer)
      : socket_(std::move(socket)), options_(options), observer_(std::move(observer)) {}
  Outcome<void> look();

  std::string socket_;
  LookOptions options_;
  Observer observer_;
  std::optional<System> system_;
  std::uint64_t newest_ = 0;  // newest record of the log at the last look
  std::uint64_t looked_ms_ = 0;
  int failures_ = 0;
};

}  // namespace agnocast::ctl
