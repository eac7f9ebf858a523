// SPDX-License-Identifier: Apache-2.0
//
// ClientTool: a process of tests/integration/client_tool, steered line by line.
#pragma once

#include <tests/support/steered_process.hpp>

#include <string>

namespace agnocast::test {

class ClientTool : public SteeredProcess {
 public:
  explicit ClientTool(const std::string& socket_path)
      : SteeredProcess({AGNOCAST_CLIENT_TOOL}, {"AGNOCAST_SOCKET=" + socket_path}) {}
};

}  // namespace agnocast::test
