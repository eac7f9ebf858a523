// SPDX-License-Identifier: Apache-2.0
//
// Goal: the contract between processes never changes by accident. Method: this test records the
// fingerprint of every size, offset, limit and number. If it fails, the layout changed. If that
// was intended, record the new value, and update docs and byte drawings.

#include <agnocast/abi/fingerprint.hpp>

#include <gtest/gtest.h>

namespace agnocast::abi {
namespace {

TEST(Layout, HasTheRecordedFingerprint) {
  EXPECT_EQ(fingerprint(), 0x5c69e95171bd0676u) << std::hex << "it is 0x" << fingerprint();
}

}  // namespace
}  // namespace agnocast::abi
