// SPDX-License-Identifier: Apache-2.0
//
// AttackRow: the cost of one attack to its victims and the daemon, as one row of the table that
// scripts/attack-table prints.
//
// A Stage writes a row for its test by itself: the daemon's figures before the attack and after
// the attackers have gone, and the honest pair's losses. A test without a row gets one without
// figures at its end; a skipped test gets one that states the reason.
//
// Rows are appended, one line of JSON each, to the file that AGNOCAST_ATTACK_TABLE names; without
// the variable nothing is written. The figures are for people: they depend on the machine, so no
// test judges them.
#pragma once

#include <sys/types.h>

#include <cstdint>

namespace agnocast::test {

/// Resources of a process; all 0 when it is gone.
struct ProcessUse {
  std::uint64_t descriptors = 0;
  std::uint64_t mappings = 0;        ///< lines of /proc/PID/maps
  std::uint64_t resident_bytes = 0;  ///< shared memory included
  std::uint64_t cpu_ns = 0;          /// since the process began
};
ProcessUse use_of(pid_t pid);

class AttackRow {
 public:
  struct Victim {
    std::uint64_t messages = 0;  ///< received
    std::uint64_t lost = 0;
    std::uint64_t refused = 0;  ///< publishes
    double largest_gap_ms = 0;  ///< between two messages at the receiver
  };

  /// Records the daemon's figures before the attack.
  explicit AttackRow(pid_t daemon);
  /// Writes the row of the running test. When `daemon` is not the process from before (a restart),
  /// its CPU time counts from its own start. Only the first call writes.
  void write(pid_t daemon, const Victim& victim);

 private:
  pid_t before_pid_;
  ProcessUse before_;
  std::int64_t begin_ns_;
  bool written_ = false;
};

}  // namespace agnocast::test
