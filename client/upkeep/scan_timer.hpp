// SPDX-License-Identifier: Apache-2.0
//
// ScanTimer: decides how long the control thread may sleep before it must look at the publishers
// again. Pure.
//
// Scans of an idle publisher come soon after the last publish, then ever more rarely
// (docs/protocol.md, who runs a scan). A subscription that has not linked yet is checked sooner:
// usually it links within a millisecond, and does not ring when it has. A session without a daemon
// is checked at a constant interval, because no daemon reports which peers are gone.
#pragma once

#include <algorithm>

namespace agnocast {

class ScanTimer {
 public:
  static constexpr int first_ms = 100, last_ms = 1000;
  static constexpr int link_first_ms = 1;
  static constexpr int alone_ms = 20;

  /// Returns the next sleep. `reclaimable`: a scan may free a message. `awaits_link`: a
  /// subscription has not linked yet.
  int next_ms(bool reclaimable, bool awaits_link, bool is_alone) noexcept {
    if (!reclaimable) {
      pause_ = last_ms;
    } else {
      pause_ = was_reclaimable_ ? std::min(pause_ * 2, last_ms) : first_ms;
    }
    was_reclaimable_ = reclaimable;
    if (is_alone) return alone_ms;
    if (!awaits_link) {
      link_pause_ = link_first_ms;
      return pause_;
    }
    const int look = link_pause_;
    link_pause_ = std::min(link_pause_ * 2, first_ms);
    return std::min(pause_, look);
  }

 private:
  int pause_ = 0, link_pause_ = 0;
  bool was_reclaimable_ = false;
};

}  // namespace agnocast
