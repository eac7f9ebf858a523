// SPDX-License-Identifier: Apache-2.0
//
// A script for the sweep of one side: name, quality of service, one letter per command.
#pragma once

#include <tests/recovery/stage.hpp>

#include <cstdint>
#include <ostream>

namespace agnocast::sweep {

struct Script {
  const char* name;
  Setup setup;
  const char* commands;
};

inline void PrintTo(const Script& script, std::ostream* out) { *out << script.name; }

constexpr abi::Qos keep_last(std::uint32_t depth, bool transient_local = false) {
  return {depth, transient_local, true, false, false};
}

}  // namespace agnocast::sweep
