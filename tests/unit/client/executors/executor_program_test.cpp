// SPDX-License-Identifier: Apache-2.0
//
// Executors of a process that ends, forks, or ends threads, at a bad moment. executor_program does
// that, once for each kind of executor.

#include <tests/support/processes/child.hpp>

#include <gtest/gtest.h>

#include <unistd.h>

#include <string>

namespace agnocast {
namespace {

/// Returns the exit status of the program.
int run_program(const std::string& mode, const std::string& kind) {
  test::Child child([&]() noexcept {
    ::execl(AGNOCAST_EXECUTOR_PROGRAM, AGNOCAST_EXECUTOR_PROGRAM, mode.c_str(), kind.c_str(),
            nullptr);
    return 127;
  });
  return child.wait();
}

class ExecutorProgram : public testing::TestWithParam<const char*> {};

TEST_P(ExecutorProgram, ExitInACallback) { EXPECT_EQ(run_program("exit", GetParam()), 7); }
TEST_P(ExecutorProgram, AForkedChildDestroysIt) { EXPECT_EQ(run_program("fork", GetParam()), 7); }
TEST_P(ExecutorProgram, AForkedChildReturnsFromACallback) {
  const int status = run_program("fork_inside", GetParam());
  // 7: the spin function threw. 0: the last thread of the child was not that of a spin function.
  EXPECT_TRUE(status == 7 || status == 0) << status;
}
TEST_P(ExecutorProgram, CallbacksEndTheirThreads) {
  EXPECT_EQ(run_program("thread_ends", GetParam()), 7);
}
INSTANTIATE_TEST_SUITE_P(Of, ExecutorProgram, testing::Values("multi", "isolated", "background"),
                         [](const auto& of) { return std::string(of.param); });

}  // namespace
}  // namespace agnocast
