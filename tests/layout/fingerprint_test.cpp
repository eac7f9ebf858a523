// SPDX-License-Identifier: Apache-2.0
//
// Goal: nobody changes the contract between processes by accident. Method: the fingerprint of every size, offset, limit and number is written
// down here. If this test fails, the layout changed: was it meant? Then this is the new value, and docs and byte drawings change with it.

#include <agnocast/abi/fingerprint.hpp>

#include <gtest/gtest.h>

namespace agnocast::abi {
namespace {

TEST(Layout, HasTheFingerprintThatIsWrittenDown) {
  EXPECT_EQ(fingerprint(), 0x362c93b5a7fb23acu) << std::hex << "it is 0x" << fingerprint();
}

}  // namespace
}  // namespace agnocast::abi
