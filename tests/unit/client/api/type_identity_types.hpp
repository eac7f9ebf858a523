// SPDX-License-Identifier: Apache-2.0
//
// Types that two translation units with different compiler switches use; see
// type_identity_test.cpp.
#pragma once

#include <agnocast/message_type.hpp>

#include <cstdint>
#include <string>

namespace identity_test {

struct Pose {
  double x, y;
  std::uint32_t id;
};

struct Named {
  std::string text;
};

struct Hashes {
  std::uint64_t pose;
  std::uint64_t named;
  std::uint64_t cloud;
  std::uint64_t everything;
  std::string pose_name;
};

// The other translation unit: C++17, optimised, libstdc++ assertions on.
Hashes hashes_of_other_unit();

}  // namespace identity_test

template <>
struct agnocast::MessageTraits<identity_test::Named> {
  static constexpr const char* name = "identity_test/Named";
  static constexpr std::uint64_t version = 3;
};
