// SPDX-License-Identifier: Apache-2.0

#include <bench/pipeline/edge.hpp>

#include <unistd.h>

namespace agnocast::bench::pipeline {

const std::vector<Edge>& edges() {
  static const std::vector<Edge> all = {
#ifdef AGNOCAST_BENCH_PIPELINE_HAS_DDS
      cyclonedds_edge,
#endif
      agnocast_edge,
  };
  return all;
}

std::string cyclonedds_variable() {
  // On the loopback interface, without multicast, separate from every other DDS on this host.
  // Tuned for large messages: few packets, each as large as UDP permits, and a receive buffer as
  // large as the kernel permits.
  return "CYCLONEDDS_URI=<CycloneDDS><Domain id=\"any\">"
         "<General><Interfaces><NetworkInterface name=\"lo\" multicast=\"false\"/></Interfaces>"
         "<AllowMulticast>false</AllowMulticast>"
         "<MaxMessageSize>65500B</MaxMessageSize><FragmentSize>65000B</FragmentSize></General>"
         "<Discovery><ParticipantIndex>auto</ParticipantIndex>"
         "<MaxAutoParticipantIndex>20</MaxAutoParticipantIndex>"
         "<Tag>agnocast-bench-pipeline-" +
         std::to_string(::getpid()) +
         "</Tag><Peers><Peer address=\"127.0.0.1\"/></Peers></Discovery>"
         "<Internal><SocketReceiveBufferSize max=\"16MiB\"/></Internal></Domain></CycloneDDS>";
}

}  // namespace agnocast::bench::pipeline
