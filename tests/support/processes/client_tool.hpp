// SPDX-License-Identifier: Apache-2.0
//
// ClientTool: a process of tests/integration/client/programs/client_tool.cpp, steered line by line.
#pragma once

#include <tests/support/processes/steered_process.hpp>

#include <gtest/gtest.h>

#include <initializer_list>
#include <string>

namespace agnocast::test {

class ClientTool : public SteeredProcess {
 public:
  explicit ClientTool(const std::string& socket_path)
      : SteeredProcess({AGNOCAST_CLIENT_TOOL}, {"AGNOCAST_SOCKET=" + socket_path}) {}
};

/// Takes and releases until no message is left. Returns the numbers, each followed by a space.
inline std::string take_all(ClientTool& subscriber) {
  std::string numbers;
  for (;;) {
    const std::string number = subscriber.ask("take");
    if (number == "none") return numbers;
    numbers += number + " ";
    EXPECT_EQ(subscriber.ask("release"), "ok");
  }
}

/// Creates the subscription with `sub`, then the publisher with `pub`, and waits for the match.
inline testing::AssertionResult meet(ClientTool& subscriber, const std::string& sub,
                                     ClientTool& publisher, const std::string& pub) {
  if (const std::string said = subscriber.ask(sub); said != "ok")
    return testing::AssertionFailure() << sub << ": " << said;
  if (const std::string said = publisher.ask(pub); said != "ok")
    return testing::AssertionFailure() << pub << ": " << said;
  if (publisher.eventually("matched", "1")) return testing::AssertionSuccess();
  return testing::AssertionFailure() << "matched: " << publisher.ask("matched");
}

/// Returns whether the tools become connected by themselves within the time limit.
inline testing::AssertionResult are_connected(std::initializer_list<ClientTool*> tools) {
  for (ClientTool* const tool : tools) {
    if (!tool->eventually("state", "connected"))
      return testing::AssertionFailure() << "process " << tool->pid() << ": " << tool->ask("state");
  }
  return testing::AssertionSuccess();
}

}  // namespace agnocast::test
