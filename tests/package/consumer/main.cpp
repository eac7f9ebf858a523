// SPDX-License-Identifier: Apache-2.0
#include <agnocast/error.hpp>
#include <agnocast/result.hpp>

#include <string>

int main() {
  const agnocast::Result<int> result = agnocast::fail(agnocast::Errc::no_slot, "consumer");
  return std::string(agnocast::sentence_of(result.error().code)).empty() ? 1 : 0;
}
