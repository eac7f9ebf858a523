// SPDX-License-Identifier: Apache-2.0
//
// A dump of the daemon, requested on a separate connection.
#pragma once

#include <agnocast/abi/observe.hpp>
#include <tests/support/wire/wire_client.hpp>

#include <algorithm>
#include <string>
#include <vector>

namespace agnocast::test {

struct WireDump {
  std::uint64_t incarnation = 0;
  wire::DumpDaemon daemon{};
  std::vector<wire::DumpProcess> processes;
  std::vector<wire::DumpUser> users;
  std::vector<wire::DumpTopic> topics;
  std::vector<wire::DumpEndpoint> endpoints;
  std::vector<wire::DumpRefusal> refusals;
  std::vector<wire::DumpCallbackGroup> groups;
  std::vector<wire::DumpCallbackThread> threads;

  const wire::DumpProcess* process(std::uint64_t client) const {
    const auto found = std::find_if(processes.begin(), processes.end(),
                                    [&](const auto& p) { return p.client == client; });
    return found == processes.end() ? nullptr : &*found;
  }
};

inline WireDump wire_dump(const std::string& socket_path) {
  WireDump all;
  WireClient wire(socket_path);
  wire::Observe observe{};
  observe.fingerprint = abi::fingerprint();
  const Incoming observed = wire.ask(wire::Opcode::observe, observe);
  if (observed.opcode() != wire::Opcode::observed) {
    ADD_FAILURE() << "not observed: " << observed.refused_text();
    return all;
  }
  all.incarnation = observed.as<wire::Observed>().incarnation;
  wire::Dump request{};
  request.with_threads = 1;
  wire.send(wire::Opcode::dump, request);
  for (;;) {
    const Incoming packet = wire.next();
    switch (packet.opcode()) {
      case wire::Opcode::dump_daemon:
        all.daemon = packet.as<wire::DumpDaemon>();
        break;
      case wire::Opcode::dump_process:
        all.processes.push_back(packet.as<wire::DumpProcess>());
        break;
      case wire::Opcode::dump_topic:
        all.topics.push_back(packet.as<wire::DumpTopic>());
        break;
      case wire::Opcode::dump_endpoint:
        all.endpoints.push_back(packet.as<wire::DumpEndpoint>());
        break;
      case wire::Opcode::dump_refusal:
        all.refusals.push_back(packet.as<wire::DumpRefusal>());
        break;
      case wire::Opcode::dump_callback_group:
        all.groups.push_back(packet.as<wire::DumpCallbackGroup>());
        break;
      case wire::Opcode::dump_callback_thread:
        all.threads.push_back(packet.as<wire::DumpCallbackThread>());
        break;
      case wire::Opcode::dump_thread_executors:
        break;
      case wire::Opcode::dump_user:
        all.users.push_back(packet.as<wire::DumpUser>());
        break;
      default:
        EXPECT_EQ(packet.opcode(), wire::Opcode::dump_end);
        return all;
    }
  }
}

}  // namespace agnocast::test
