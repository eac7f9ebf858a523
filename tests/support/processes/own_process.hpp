// SPDX-License-Identifier: Apache-2.0
//
// Runs a part of a test in its own process: for decisions made once per process, such as the
// heap's scope, and for code that may end it. The test program must not have used the library.
#pragma once

#include <tests/support/processes/child.hpp>

#include <gtest/gtest.h>

#include <cstdio>
#include <exception>
#include <utility>

namespace agnocast::test {

/// The child prints failed expectations of `body`. Returns whether all held and it ended normally.
template <class Body>
testing::AssertionResult in_own_process(Body&& body) {
  std::fflush(nullptr);
  Child child([&body]() noexcept {
    try {
      std::forward<Body>(body)();
    } catch (const std::exception& error) {
      ADD_FAILURE() << "threw: " << error.what();
    }
    std::fflush(nullptr);
    return testing::Test::HasFailure() ? 1 : 0;
  });
  const int status = child.wait();
  if (status == 0) return testing::AssertionSuccess();
  return testing::AssertionFailure() << (status > 0 ? "failed, status " : "ended by signal ")
                                     << (status > 0 ? status : -status);
}

}  // namespace agnocast::test
