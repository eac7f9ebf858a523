// SPDX-License-Identifier: Apache-2.0
//
// As reregistration.hpp, for tests that have the library in their own process: all tests of a
// suite use one socket for their daemons, and each daemon is killed with its supervisor.
#pragma once

#include <agnocast/agnocast.hpp>
#include <tests/integration/client/programs/second_process.hpp>
#include <tests/support/processes/daemon_process.hpp>

#include <gtest/gtest.h>

#include <cstdint>
#include <cstdlib>
#include <memory>
#include <string>
#include <utility>
#include <vector>

namespace agnocast {

using test::eventually;
using test::Number;

class ReregistrationInProcess : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    directory = test::make_directory();
    ::setenv("AGNOCAST_SOCKET", socket().c_str(), 1);
    begin();
  }
  static void TearDownTestSuite() {
    daemon.reset();
    test::remove_directory(directory);
  }
  static std::string socket() { return directory + "/agnocastd.sock"; }
  static void begin(const std::string& limits = {}) {
    test::DaemonOptions options;
    options.socket = socket();
    if (!limits.empty())
      options.config = "[heap]\nwindow_bytes = \"64MiB\"\narena_bytes = \"64GiB\"\n" + limits;
    daemon = std::make_unique<test::DaemonProcess>(options);
  }
  static void end() {
    daemon->kill();
    daemon.reset();
    // Before the next daemon: reconnecting may be faster than a look.
    ASSERT_TRUE(eventually([] { return connection_state() != ConnectionState::connected; }));
  }
  static void await_connection() {
    ASSERT_TRUE(eventually([] { return connection_state() == ConnectionState::connected; }));
  }
  static void lose(const std::string& limits = {}) {
    end();
    begin(limits);
    await_connection();
  }
  static void publish(Publisher<Number>& publisher, std::uint64_t value) {
    auto number = publisher.borrow_loaned_message();
    number->value = value;
    const PublishResult result = publisher.publish(std::move(number));
    ASSERT_TRUE(result) << sentence_of(result.code);
  }

  inline static std::string directory;
  inline static std::unique_ptr<test::DaemonProcess> daemon;
};

/// Returns the numbers from first to last.
inline std::vector<std::uint64_t> range(std::uint64_t first, std::uint64_t last) {
  std::vector<std::uint64_t> values;
  for (std::uint64_t value = first; value <= last; ++value) values.push_back(value);
  return values;
}

}  // namespace agnocast
