// SPDX-License-Identifier: Apache-2.0
//
// Refusals: requests that the daemon refused, in words.
#pragma once

#include <agnocast/abi/observe.hpp>

#include <string>

namespace agnocast::ctl {

namespace wire = abi::wire;

/// Returns "CODE: publisher of /topic: why (2 s ago, 3 times)".
std::string refusal_words(const wire::DumpRefusal& refusal);

}  // namespace agnocast::ctl
