// SPDX-License-Identifier: Apache-2.0
//
// Goal: a program without exceptions can use the library, gets failures as results, or ends with
// the reason.
// Method: no_exceptions_node, compiled without them.

#include <tests/support/processes/daemon_process.hpp>
#include <tests/support/processes/steered_process.hpp>

#include <gmock/gmock.h>

#include <csignal>

namespace agnocast::test {
namespace {

TEST(NoExceptions, EverythingWorksAndAFailureIsAResult) {
  DaemonProcess daemon({.config = "[heap]\nwindow_bytes = \"64MiB\"\narena_bytes = \"4GiB\"\n"
                                  "[quota]\nheap_bytes = \"128MiB\"\n"});
  SteeredProcess node({AGNOCAST_NO_EXCEPTIONS_NODE, "use"},
                      {"AGNOCAST_SOCKET=" + daemon.socket_path()});
  EXPECT_EQ(node.answer(60), "ok");
  EXPECT_EQ(node.finish(), 0);
}

TEST(NoExceptions, AnExceptionEndsTheProgramWithItsReason) {
  SteeredProcess node({"/bin/sh", "-c", "exec \"$0\" throw 2>&1", AGNOCAST_NO_EXCEPTIONS_NODE},
                      {"AGNOCAST_SOCKET=/nowhere/agnocastd.sock"});
  EXPECT_EQ(node.answer(60), "terminate called after throwing an instance of 'agnocast::Error'");
  EXPECT_THAT(node.answer(), testing::HasSubstr("/nowhere/agnocastd.sock"));
  EXPECT_EQ(node.finish(), -SIGABRT);
}

}  // namespace
}  // namespace agnocast::test
