// SPDX-License-Identifier: Apache-2.0
//
// Steps that only the explorer has: statements and decisions that it models around the shipped
// templates (queue_scenario.hpp, reuse_scenario.hpp). base/step.hpp defines a step.
#pragma once

#include <base/step.hpp>

#define AGNOCAST_MODEL_STEPS(X)                         \
  X(S3_news, "has something been published meanwhile?") \
  X(D3_ring, "ring every subscription of the topic")    \
  X(R8_again, "announce again to every client after a reconnect")

AGNOCAST_STEPS(model, 768, AGNOCAST_MODEL_STEPS)
