// SPDX-License-Identifier: Apache-2.0
//
// AttackRow: what one attack cost its victims and the daemon, as one row of the table that
// scripts/attack-table prints.
//
// A Stage writes a row for its test by itself: figures of the daemon before the attack and after the
// attackers have gone, and what the honest pair saw. A test of a program with this file that writes none gets one
// at its end without figures, and a test that was skipped one that says why.
//
// Rows are appended, a line of JSON each, to the file that AGNOCAST_ATTACK_TABLE names; without it nothing
// is written. The figures are for people: no test judges by them, for they depend on the machine.
#pragma once

#include <sys/types.h>

#include <cstdint>

namespace agnocast::test {

/// What a process uses; all 0 when it is gone.
struct ProcessUse {
  std::uint64_t descriptors = 0;
  std::uint64_t mappings = 0;        ///< lines of /proc/PID/maps
  std::uint64_t resident_bytes = 0;  ///< shared memory included
  std::uint64_t cpu_ns = 0;          ///< since it began
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

  /// Looks at the daemon as it is before the attack.
  explicit AttackRow(pid_t daemon);
  /// Writes the row of the test that is running; `daemon` is another one than before when it was
  /// restarted, and its time on the CPU then counts from its own start. Once; later calls do nothing.
  void write(pid_t daemon, const Victim& victim);

 private:
  pid_t before_pid_;
  ProcessUse before_;
  std::int64_t begin_ns_;
  bool written_ = false;
};

}  // namespace agnocast::test
