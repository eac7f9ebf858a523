// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <bench/case.hpp>

#include <vector>

namespace agnocast::bench {

const std::vector<Case>& cases();

}  // namespace agnocast::bench
