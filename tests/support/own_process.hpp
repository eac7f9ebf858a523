// SPDX-License-Identifier: Apache-2.0
//
// Runs a piece of a test in a process of its own: for what a process decides once, such as the scope
// of its heap, and for what may end it. The test program itself must not have used the library.
#pragma once

#include <tests/support/child.hpp>

#include <gtest/gtest.h>

#include <cstdio>
#include <exception>
#include <utility>

namespace agnocast::test {

/// Expectations inside `body` are printed by the child. True if all held and it ended by itself.
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
