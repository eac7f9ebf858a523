// SPDX-License-Identifier: Apache-2.0
//
// CrashControl: controls the crash points of each daemon of an agnocastd_crash started meanwhile;
// see tests/support/crash/crash_point.hpp, which the test itself is built without.
#pragma once

#include <agnocast/abi/limits.hpp>
#include <base/descriptors/unique_fd.hpp>
#include <base/memory/mapping.hpp>
#include <base/step.hpp>

#include <fcntl.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <atomic>
#include <cstdint>
#include <cstdlib>
#include <string>

namespace agnocast::test {

class CrashControl {
 public:
  explicit CrashControl(const std::string& path) {
    const UniqueFd file(::open(path.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0600));
    EXPECT_EQ(::ftruncate(file.get(), abi::page_bytes), 0);
    mapping_ = Mapping::map(file.get(), abi::page_bytes, Mapping::Access::read_write).value();
    ::setenv("AGNOCAST_CRASH_CONTROL", path.c_str(), 1);
  }
  ~CrashControl() { ::unsetenv("AGNOCAST_CRASH_CONTROL"); }
  CrashControl(const CrashControl&) = delete;
  CrashControl& operator=(const CrashControl&) = delete;
  /// The next daemon dies at its n-th point, later ones do not; 0: none dies.
  void arm(std::uint64_t n) {
    word(0).store(0);
    word(1).store(n);
  }
  /// The first daemon that reaches this step dies there.
  void arm_at(Step step) {
    arm(0);
    word(3).store(static_cast<std::uint64_t>(step) + 1);
    word(1).store(1);
  }
  /// Returns whether the last death was at this step.
  bool died_at(Step step) { return word(2).load() == static_cast<std::uint64_t>(step) + 1; }

 private:
  std::atomic<std::uint64_t>& word(std::size_t i) {
    return reinterpret_cast<std::atomic<std::uint64_t>*>(mapping_.base())[i];
  }
  Mapping mapping_;
};

}  // namespace agnocast::test
