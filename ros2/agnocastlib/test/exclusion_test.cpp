// SPDX-License-Identifier: Apache-2.0
//
// Goal: a process with the library of the kernel-module system ends at load time, and says why.
// Method: a library of that name with its function is preloaded into a program, and loaded into
// this one.

#include "common.hpp"

#include <dlfcn.h>
#include <sys/wait.h>

#include <array>
#include <stdexcept>

namespace agnocastlib {
namespace {

struct Ended {
  int status;
  std::string output;
};
Ended run(const std::string& command) {
  FILE* const pipe = ::popen((command + " 2>&1").c_str(), "r");
  std::string output;
  std::array<char, 256> part;
  while (std::fgets(part.data(), part.size(), pipe) != nullptr) output += part.data();
  const int status = ::pclose(pipe);
  return {WIFEXITED(status) ? WEXITSTATUS(status) : -1, output};
}

TEST(ExclusionTest, AProgramBeginsWithoutTheOtherSystem) {
  const Ended ended = run(PROGRAM);
  EXPECT_EQ(ended.status, 0);
  EXPECT_THAT(ended.output, testing::HasSubstr("began"));
}

TEST(ExclusionTest, AProgramBesideTheOtherSystemEndsBeforeItBegins) {
  const Ended ended = run("LD_PRELOAD=" OTHER_SYSTEM ":$LD_PRELOAD " PROGRAM);
  EXPECT_EQ(ended.status, 1);
  EXPECT_THAT(ended.output, testing::HasSubstr("cannot be in one process"));
  EXPECT_THAT(ended.output, testing::HasSubstr(OTHER_SYSTEM));
  EXPECT_THAT(ended.output, testing::Not(testing::HasSubstr("began")));
}

using ExclusionWithRclcpp = AgnocastTest;

TEST_F(ExclusionWithRclcpp, EndpointsAreRefusedAfterItWasLoaded) {
  const auto node = std::make_shared<rclcpp::Node>("node");
  (void)agnocast::create_publisher<String>(node.get(), "before", 1);
  void* const other = ::dlopen(OTHER_SYSTEM, RTLD_NOW | RTLD_LOCAL);
  ASSERT_NE(other, nullptr) << ::dlerror();
  try {
    (void)agnocast::create_publisher<String>(node.get(), "topic", 1);
    ADD_FAILURE() << "nothing was thrown";
  } catch (const std::runtime_error& error) {
    EXPECT_THAT(error.what(), testing::HasSubstr("cannot be in one process"));
  }
  EXPECT_THROW(agnocast::create_subscription<String>(node.get(), "topic", 1), std::runtime_error);
  ::dlclose(other);
  EXPECT_NO_THROW((void)agnocast::create_publisher<String>(node.get(), "topic", 1));
}

}  // namespace
}  // namespace agnocastlib
