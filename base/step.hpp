// SPDX-License-Identifier: Apache-2.0
//
// Step: a named place in the code. A numbered step of the protocol (docs/protocol.md), or a place
// between two changes of the control plane that other processes see. The crash sweep kills the
// process before each step, the explorer omits each protocol step in turn, and both print the
// names.
//
// A top folder has a table of its own steps, steps.hpp, so that a new step concerns only what
// includes that folder. tests/support/crash/step_names.hpp has all tables.
#pragma once

#include <cstdint>

namespace agnocast {

/// The number of a step. The steps themselves are constants in agnocast::steps.
enum class Step : std::uint16_t {};

inline constexpr Step no_step{0xffff};

#ifdef AGNOCAST_CRASH_POINTS
/// Tests only: may end this process with SIGKILL. See tests/support/crash/crash_point.hpp.
void crash_point(Step name) noexcept;
#endif

}  // namespace agnocast

/// Defines the steps of a table, a macro that lists X(name, text). The first has the number
/// `first`; the numbers of two rooms must not overlap.
#define AGNOCAST_STEPS(room, first, table)                               \
  namespace agnocast::steps {                                            \
  namespace numbers {                                                    \
  enum : int { before_##room = first - 1, table(AGNOCAST_STEP_NUMBER) }; \
  }                                                                      \
  table(AGNOCAST_STEP_CONSTANT)                                          \
  }
#define AGNOCAST_STEP_NUMBER(name, text) name,
#define AGNOCAST_STEP_CONSTANT(name, text) inline constexpr Step name{numbers::name};

/// For templates over the memory policy M (base/memory/memory_policy.hpp). Names the following
/// statement: the crash sweep may kill the process before it, the explorer may omit it.
#define AGNOCAST_STEP(name) if (M::step(::agnocast::steps::name))

/// For code that is no template over the memory policy: a place between two changes that other
/// processes see. One name may stand in several places. Empty in a build without crash points.
#ifdef AGNOCAST_CRASH_POINTS
#define AGNOCAST_CRASH_POINT(name) ::agnocast::crash_point(::agnocast::steps::name)
#else
#define AGNOCAST_CRASH_POINT(name) static_cast<void>(0)
#endif
