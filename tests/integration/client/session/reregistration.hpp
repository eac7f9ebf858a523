// SPDX-License-Identifier: Apache-2.0
//
// Fixture of the tests of processes that move to another daemon: one daemon after the other at the
// same socket, killed with its supervisor or stopped, each without the previous one's store.
#pragma once

#include <tests/support/processes/client_tool.hpp>
#include <tests/support/processes/daemon_process.hpp>

#include <gtest/gtest.h>

#include <memory>
#include <string>

namespace agnocast {

using test::are_connected;
using test::ClientTool;
using test::eventually;

/// One daemon after the other at the same socket, each without the previous one's store.
class Reregistration : public testing::Test {
 protected:
  Reregistration() : directory_(test::make_directory()) { begin(); }
  ~Reregistration() override {
    daemon_.reset();
    test::remove_directory(directory_);
  }
  std::string socket() const { return directory_ + "/agnocastd.sock"; }
  void begin(test::DaemonOptions options = {}) {
    options.socket = socket();
    daemon_ = std::make_unique<test::DaemonProcess>(options);
  }
  void end(bool cleanly = false) {
    if (cleanly) {
      daemon_->stop();
    } else {
      daemon_->kill();
    }
  }
  void lose(bool cleanly = false) {
    end(cleanly);
    begin();
  }

  std::string directory_;
  std::unique_ptr<test::DaemonProcess> daemon_;
};

}  // namespace agnocast
