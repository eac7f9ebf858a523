// SPDX-License-Identifier: Apache-2.0
//
// SuiteDaemon: the fixture for tests of the public interface. It starts one daemon for all tests
// of a suite, because the library connects once per process.
#pragma once

#include <tests/support/processes/daemon_process.hpp>

#include <gtest/gtest.h>

#include <cstdlib>
#include <string>

namespace agnocast::test {

class SuiteDaemon : public testing::Test {
 protected:
  static void SetUpTestSuite() { start(); }
  static void TearDownTestSuite() {
    delete daemon;
    daemon = nullptr;
  }
  /// Starts the daemon and points the library to it. Suites with options hide SetUpTestSuite().
  static void start(const DaemonOptions& options = {}) {
    daemon = new DaemonProcess(options);
    ::setenv("AGNOCAST_SOCKET", daemon->socket_path().c_str(), 1);
  }
  static std::string test_name() {
    return testing::UnitTest::GetInstance()->current_test_info()->name();
  }
  /// Returns `name` with the test's name behind it: topics and nodes that no other test uses.
  static std::string own(const std::string& name) { return name + "_" + test_name(); }

  inline static DaemonProcess* daemon = nullptr;
};

}  // namespace agnocast::test
