// SPDX-License-Identifier: Apache-2.0
//
// Users of tests.
#pragma once

#include <cstdint>

namespace agnocast::daemon {

constexpr std::uint32_t alice = 1000, bob = 2000;

}  // namespace agnocast::daemon
