// SPDX-License-Identifier: Apache-2.0
//
// Uses the package, and says that it began.

#include <agnocast/agnocast.hpp>
#include <std_msgs/msg/string.hpp>

#include <cstdio>

int main() {
  std::puts("began");
  agnocast::init(0, nullptr);
  agnocast::shutdown();
}
