// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <tests/support/processes/plain_node.hpp>

namespace agnocast {

inline const test::PlainNode node;

}  // namespace agnocast
