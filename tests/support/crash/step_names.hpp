// SPDX-License-Identifier: Apache-2.0
//
// All steps with their names and texts, for tests that sweep over steps or print them.
#pragma once

#include <base/step.hpp>
#include <client/process/steps.hpp>
#include <daemon/state/steps.hpp>
#include <dataplane/steps.hpp>
#include <journal/steps.hpp>
#include <tests/model/steps.hpp>

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <functional>

namespace agnocast {

struct NamedStep {
  Step step;
  const char* name;
  const char* text;
};

#define AGNOCAST_NAMED_STEP(name, text) {steps::name, #name, text},
inline constexpr NamedStep dataplane_steps[] = {AGNOCAST_DATAPLANE_STEPS(AGNOCAST_NAMED_STEP)};
inline constexpr NamedStep journal_steps[] = {AGNOCAST_JOURNAL_STEPS(AGNOCAST_NAMED_STEP)};
inline constexpr NamedStep client_steps[] = {AGNOCAST_CLIENT_STEPS(AGNOCAST_NAMED_STEP)};
inline constexpr NamedStep daemon_steps[] = {AGNOCAST_DAEMON_STEPS(AGNOCAST_NAMED_STEP)};
inline constexpr NamedStep model_steps[] = {AGNOCAST_MODEL_STEPS(AGNOCAST_NAMED_STEP)};
inline constexpr auto all_steps = std::to_array<NamedStep>(
    {AGNOCAST_DATAPLANE_STEPS(AGNOCAST_NAMED_STEP) AGNOCAST_JOURNAL_STEPS(AGNOCAST_NAMED_STEP)
         AGNOCAST_CLIENT_STEPS(AGNOCAST_NAMED_STEP) AGNOCAST_DAEMON_STEPS(AGNOCAST_NAMED_STEP)
             AGNOCAST_MODEL_STEPS(AGNOCAST_NAMED_STEP)});
#undef AGNOCAST_NAMED_STEP
// A table that has grown into the next one's numbers would give two steps the same number.
static_assert(std::ranges::adjacent_find(all_steps, std::greater_equal<>(), &NamedStep::step) ==
                  all_steps.end(),
              "the numbers of two rooms meet");

/// One more than the greatest number: the size of arrays indexed by a step's number.
inline constexpr std::size_t step_bound = static_cast<std::size_t>(all_steps.back().step) + 1;

constexpr const char* name_of(Step step) noexcept {
  const auto* const found = std::ranges::find(all_steps, step, &NamedStep::step);
  return found != all_steps.end() ? found->name : "?";
}

}  // namespace agnocast
