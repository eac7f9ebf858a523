// SPDX-License-Identifier: Apache-2.0
//
// Bridges: what each agnocast-bridge beside a daemon says of itself (docs/bridge.md, "Status"). All of it is input: read
// within a bound of time and size, and taken over field by field; a bridge that says something else is an error.
#pragma once

#include <ctl/cli/arguments.hpp>
#include <ctl/cli/console.hpp>
#include <ctl/cli/problem.hpp>

#include <algorithm>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace agnocast::ctl {

struct BridgeQos {
  std::string reliability, durability, history;
  std::uint64_t depth = 0;
};

/// A publisher of this host and its writer in DDS, or the other way round.
struct BridgeEndpoint {
  std::string topic, type;
  bool is_out = true;
  std::string node, guid;
  BridgeQos qos;
  std::uint64_t matched = 0, incompatible = 0;  // of what goes out: readers
  std::uint64_t messages = 0, bytes = 0, unacknowledged = 0, refused = 0;
  std::uint64_t age_ns = 0;
  std::optional<std::uint64_t> last_age_ns;
};
/// A reader in DDS.
struct BridgeInlet {
  std::string topic, type, guid;
  std::vector<std::string> nodes;  // of this host, whose subscriptions it serves
  BridgeQos qos;
  std::uint64_t matched = 0, incompatible = 0;  // writers
  std::uint64_t malformed = 0, without_source = 0;
  std::uint64_t overflow = 0;  // payloads that were dropped for a limit
};
/// A subscription of the bridge, to the publishers of this host that have outlets.
struct BridgeTap {
  std::string topic, type;
  BridgeQos qos;
  std::uint64_t lost = 0;
};
/// A service: of this host's servers for clients in DDS (out), or of servers in DDS for this host's clients.
struct BridgeService {
  std::string service, type;
  bool is_out = true;
  std::vector<std::string> nodes;  // of this host
  std::string reader_guid, writer_guid;
  std::uint64_t matched_writers = 0, matched_readers = 0;
  std::uint64_t requests = 0, request_bytes = 0, responses = 0, response_bytes = 0;
  std::uint64_t malformed = 0, refused = 0, timed_out = 0, forgotten = 0;
  std::uint64_t unasked = 0;  // responses that nobody waits for
  std::uint64_t age_ns = 0;
  std::optional<std::uint64_t> last_age_ns;

  /// Both ends of each are there.
  std::uint64_t matched() const { return std::min(matched_writers, matched_readers); }
  std::uint64_t dropped() const { return malformed + refused + timed_out + forgotten; }
};
struct BridgeLack {
  std::string topic, type, why, detail;  // a service's, if it is one
  bool is_out = true;
  bool is_service = false;

  /// Somebody in DDS has the topic as well, and nobody has said that it is not to be bridged.
  bool is_a_mistake() const {
    return why != "no_reader" && why != "no_writer" && why != "no_server" && why != "rule";
  }
};

struct BridgeState {
  std::string path;  // its socket
  std::string version, discovery_info;
  std::uint64_t pid = 0, domain = 0, uptime_ns = 0, participants = 0;
  bool has_daemon = false;
  std::optional<std::uint64_t> standby_for;  // the pid of the bridge that is active in its place
  std::uint64_t announced = 0;   // writers in DDS that nobody reads
  std::uint64_t lost_early = 0;  // messages of publishers that nobody had told of in time
  std::uint64_t discovery_info_refused = 0;  // messages about ROS's graph
  struct Limit {
    std::string limit;
    std::uint64_t most = 0, refused = 0;
  };
  std::vector<Limit> limits;  // of what others in DDS may make it keep
  std::vector<BridgeEndpoint> endpoints;
  std::vector<BridgeInlet> inlets;
  std::vector<BridgeTap> taps;
  std::vector<BridgeService> services;
  std::vector<BridgeLack> unbridged;
  std::vector<std::pair<std::string, std::string>> failures;  // what, why
};

/// Where bridges of this daemon have their sockets: AGNOCAST_BRIDGE_SOCKET, else bridge-*.sock beside the daemon's and,
/// of the system's daemon, in /run/agnocast-bridge.
std::vector<std::string> bridge_sockets(const std::string& daemon_socket);

/// Problems: not_reachable (nobody listens), permission_denied, timed_out, failed (it says something else).
Outcome<BridgeState> read_bridge(const std::string& path);
/// The same of a text, for tests.
Outcome<BridgeState> parse_bridge(std::string_view text, const std::string& path);

/// All that answer, of the domain if --domain is given, by domain. Problems: not_reachable (there is none), and those of
/// read_bridge when none answers.
Outcome<std::vector<BridgeState>> read_bridges(const Arguments& arguments);

}  // namespace agnocast::ctl
