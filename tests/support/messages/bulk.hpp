// SPDX-License-Identifier: Apache-2.0
//
// Bulk: a message of any size whose data its own allocator puts into the shared heap.
#pragma once

#include <agnocast/agnocast.hpp>

#include <cstdint>

namespace agnocast::test {

struct Bulk : SharedMessage {
  SharedVector<std::uint8_t> data;
};

}  // namespace agnocast::test

template <>
struct agnocast::MessageTraits<agnocast::test::Bulk> {
  static constexpr const char* name = "tests/Bulk";
  static void for_each_pointer(const test::Bulk& bulk, PointerVisitor& visit) noexcept {
    visit("data", bulk.data);
  }
};
