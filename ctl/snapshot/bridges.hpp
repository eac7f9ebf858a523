// SPDX-License-Identifier: Apache-2.0
//
// Bridges: the status that each agnocast-bridge of a daemon reports (docs/bridge.md, "Status"). It
// is untrusted input, read within a bound of time and size, and field by field; any other answer
// is an error.
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

/// A publisher of this host with its writer in DDS, or a remote publisher with its publisher here.
struct BridgeEndpoint {
  std::string topic, type;
  bool is_out = true;
  std::string node, guid;
  BridgeQos qos;
  std::uint64_t matched = 0, incompatible = 0;  // for is_out: readers
  std::uint64_t messages = 0, bytes = 0, unacknowledged = 0, refused = 0;
  std::uint64_t age_ns = 0;
  std::optional<std::uint64_t> last_age_ns;
};
/// A DDS reader.
struct BridgeDdsReader {
  std::string topic, type, guid;
  std::vector<std::string> nodes;  // of this host, with the subscriptions that it serves
  BridgeQos qos;
  std::uint64_t matched = 0, incompatible = 0;  // writers
  std::uint64_t malformed = 0, without_remote_publisher = 0;
  std::uint64_t overflow = 0;  // payloads dropped because of a limit
};
/// A local reader: a subscription of the bridge to publishers of this host.
struct BridgeLocalReader {
  std::string topic, type;
  BridgeQos qos;
  std::uint64_t lost = 0;
};
/// A service: out, servers of this host for clients in DDS; else servers in DDS for clients here.
struct BridgeService {
  std::string service, type;
  bool is_out = true;
  std::vector<std::string> nodes;  // of this host
  std::string reader_guid, writer_guid;
  std::uint64_t matched_writers = 0, matched_readers = 0;
  std::uint64_t requests = 0, request_bytes = 0, responses = 0, response_bytes = 0;
  std::uint64_t malformed = 0, refused = 0, timed_out = 0, forgotten = 0;
  std::uint64_t unasked = 0;  // responses without a pending request
  std::uint64_t age_ns = 0;
  std::optional<std::uint64_t> last_age_ns;

  /// Returns the peers in DDS of which both endpoints are matched.
  std::uint64_t matched() const { return std::min(matched_writers, matched_readers); }
  std::uint64_t dropped() const { return malformed + refused + timed_out + forgotten; }
};
struct BridgeLack {
  std::string topic, type, why, detail;  // topic: the service's name, if it is one
  bool is_out = true;
  bool is_service = false;

  /// Returns whether DDS has the topic or service as well and no rule excludes it.
  bool is_a_mistake() const {
    return why != "no_reader" && why != "no_writer" && why != "no_server" && why != "rule";
  }
};

struct BridgeState {
  std::string path;  // its socket
  std::string version, discovery_info;
  std::uint64_t pid = 0, domain = 0, uptime_ns = 0, participants = 0;
  bool has_daemon = false;
  std::optional<std::uint64_t> standby_for;  // the pid of the bridge that serves the domain instead
  std::uint64_t announced = 0;               // DDS writers without a reader
  std::uint64_t lost_early = 0;              // messages of publishers announced too late
  std::uint64_t discovery_info_refused = 0;  // invalid messages about ROS's graph
  struct Limit {
    std::string limit;
    std::uint64_t most = 0, refused = 0;
  };
  std::vector<Limit> limits;  // of the memory that others in DDS may make it use
  std::vector<BridgeEndpoint> endpoints;
  std::vector<BridgeDdsReader> dds_readers;
  std::vector<BridgeLocalReader> local_readers;
  std::vector<BridgeService> services;
  std::vector<BridgeLack> unbridged;
  std::vector<std::pair<std::string, std::string>> failures;  // what, why
};

/// Returns the sockets of this daemon's bridges: AGNOCAST_BRIDGE_SOCKET, else bridge-*.sock beside
/// the daemon's socket and, for the system's daemon, in /run/agnocast-bridge.
std::vector<std::string> bridge_sockets(const std::string& daemon_socket);

/// Problems: not_reachable (no listener), permission_denied, timed_out, failed (invalid answer).
Outcome<BridgeState> read_bridge(const std::string& path);
/// Does the same with a text, for tests.
Outcome<BridgeState> parse_bridge(std::string_view text, const std::string& path);

/// Returns the bridges that answer, with --domain only that domain's, sorted by domain. Problems:
/// not_reachable (there is none), and those of read_bridge() if none answers.
Outcome<std::vector<BridgeState>> read_bridges(const Arguments& arguments);

}  // namespace agnocast::ctl
