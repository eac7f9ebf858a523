// SPDX-License-Identifier: Apache-2.0

#include <bench/systems/cyclonedds_settings.hpp>

#include <unistd.h>

namespace agnocast::bench {
namespace {

/// Returns a value of CYCLONEDDS_URI, which may be the text itself. Called by the process that
/// starts the roles: its pid is the tag of all of them. 32 participants: a sender and the
/// receivers of the widest fan-out.
std::vector<std::string> configuration(const std::string& general, const std::string& more) {
  return {
      "CYCLONEDDS_URI=<CycloneDDS><Domain id=\"any\">"
      "<General><Interfaces><NetworkInterface name=\"lo\" multicast=\"false\"/></Interfaces>"
      "<AllowMulticast>false</AllowMulticast>" +
      general +
      "</General>"
      "<Discovery><ParticipantIndex>auto</ParticipantIndex>"
      "<MaxAutoParticipantIndex>32</MaxAutoParticipantIndex>"
      "<Tag>agnocast-bench-" +
      std::to_string(::getpid()) +
      "</Tag><Peers><Peer address=\"127.0.0.1\"/></Peers></Discovery>" + more +
      "</Domain></CycloneDDS>"};
}

}  // namespace

std::vector<std::string> cyclonedds_over_network() { return configuration("", ""); }
std::vector<std::string> cyclonedds_tuned() {
  return configuration("<MaxMessageSize>65500B</MaxMessageSize><FragmentSize>65000B</FragmentSize>",
                       "<Internal><SocketReceiveBufferSize max=\"16MiB\"/></Internal>");
}
std::vector<std::string> cyclonedds_over_iceoryx() {
  return configuration(
      "", "<SharedMemory><Enable>true</Enable><LogLevel>off</LogLevel></SharedMemory>");
}

}  // namespace agnocast::bench
