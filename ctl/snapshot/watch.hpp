// SPDX-License-Identifier: Apache-2.0
//
// Watch: look after look at one system, over restarts of the daemon, for commands that go on. Between two
// looks counters move in the regions that are mapped, which costs nobody anything; the tables are asked
// for again only when the daemon's log says that they have changed.
#pragma once

#include <ctl/snapshot/system.hpp>

#include <cstdint>
#include <optional>
#include <string>

namespace agnocast::ctl {

class Watch {
 public:
  static Outcome<Watch> begin(const std::string& socket);

  /// As it was at the last look.
  const System& system() const noexcept { return *system_; }
  /// Looks again where something may have changed. While the daemon is away, for at most ten seconds of
  /// looks a tenth of a second apart, everything stays as it was: is_away(). Problems: as Observer.
  Outcome<void> renew();
  bool is_away() const noexcept { return failures_ != 0; }
  Observer& observer() noexcept { return observer_; }

 private:
  Watch(std::string socket, Observer observer)
      : socket_(std::move(socket)), observer_(std::move(observer)) {}
  Outcome<void> look();

  std::string socket_;
  Observer observer_;
  std::optional<System> system_;
  std::uint64_t newest_ = 0;  // record of the log at the last look
  std::uint64_t looked_ms_ = 0;
  int failures_ = 0;
};

}  // namespace agnocast::ctl
