// SPDX-License-Identifier: Apache-2.0
#include <agnocast/publisher.hpp>
// clang-format off: in this order
#include <agnocast/agnocast.hpp>
