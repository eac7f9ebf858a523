// SPDX-License-Identifier: Apache-2.0
//
// Goal: agnocast::Graph says that no daemon is there, before the first one and after the last one.
// Method: a socket at which nothing, then the real daemon, then nothing listens.

#include <agnocast/graph.hpp>
#include <tests/support/processes/daemon_process.hpp>

#include <gmock/gmock.h>

#include <chrono>
#include <cstdlib>
#include <ctime>
#include <string>

namespace agnocast {
namespace {

using namespace std::chrono_literals;
using test::DaemonProcess;
using testing::IsEmpty;

TEST(GraphWithoutDaemon, ReportsAMissingDaemonAndConnectsOnceOneRuns) {
  const std::string directory = test::make_directory();
  const std::string socket = directory + "/agnocastd.sock";
  ::setenv("AGNOCAST_SOCKET", socket.c_str(), 1);
  Graph graph;
  const std::clock_t before = std::clock();
  const auto nobody = graph.wait(1s);
  EXPECT_LT(std::clock() - before, CLOCKS_PER_SEC / 3) << "it has asked all the time";
  ASSERT_FALSE(nobody);
  EXPECT_EQ(nobody.error().code, Errc::daemon_not_running);
  {
    DaemonProcess daemon({.socket = socket});
    const auto somebody = graph.wait(60s);
    ASSERT_TRUE(somebody) << somebody.error().what;
    ASSERT_TRUE(*somebody);
    EXPECT_THAT((*somebody)->endpoints, IsEmpty());
  }
  const auto gone = graph.wait(1s);
  ASSERT_FALSE(gone);
  EXPECT_EQ(gone.error().code, Errc::daemon_not_running);
  ::unsetenv("AGNOCAST_SOCKET");
  test::remove_directory(directory);
}

}  // namespace
}  // namespace agnocast
