// SPDX-License-Identifier: Apache-2.0
//
// Status: the state of a bridge at one moment, as values, and as the JSON object that its socket
// sends ("agnocast.bridge-status/1"). Pure; docs/bridge.md has the table of keys.
#pragma once

#include <bridge/dds/ros_graph.hpp>
#include <bridge/plan/routes.hpp>
#include <bridge/plan/service_plan.hpp>

#include <cstdint>
#include <optional>
#include <set>
#include <string>
#include <utility>
#include <vector>

namespace agnocast::bridge {

/// The traffic of one endpoint since its creation.
struct TrafficNumbers {
  std::uint64_t messages = 0;
  std::uint64_t bytes = 0;           // as CDR
  std::uint64_t unacknowledged = 0;  // dropped: a reader in DDS did not acknowledge
  std::uint64_t refused = 0;         // not CDR, no memory, or refused by the publisher here
  std::uint64_t since_ns = 0;        // monotonic
  std::uint64_t last_ns = 0;         // monotonic; 0: never
};

/// The traffic of the route of one service since its creation. Bytes are as CDR, headers included.
struct ServiceNumbers {
  std::uint64_t requests = 0, request_bytes = 0, responses = 0, response_bytes = 0;
  std::uint64_t malformed = 0;  // not of the service's type
  std::uint64_t refused = 0;    // not forwarded; the log gives the reason
  std::uint64_t timed_out = 0;  // requests whose server or reply route did not appear in time
  std::uint64_t forgotten = 0;  // unanswered requests that newer ones displaced
  std::uint64_t unasked = 0;    // responses to requests answered before or never made
  std::uint64_t since_ns = 0;   // monotonic
  std::uint64_t last_ns = 0;    // monotonic; 0: never
};

struct BridgeStatus {
  /// A publisher of this host and its DDS writer.
  struct DdsWriterNow {
    DdsWriterPlan plan;
    std::uint64_t publisher = 0;  // its generation
    Guid writer;
    std::uint32_t matched = 0, incompatible = 0;  // readers
    TrafficNumbers traffic;
  };
  /// A remote writer and its remote publisher on this host.
  struct RemotePublisherNow {
    RemotePublisherPlan plan;
    Guid writer;
    std::string node;  // from the ROS graph; empty: it names none
    TrafficNumbers traffic;
  };
  /// A DDS reader, for the remote publishers of one class.
  struct DdsReaderNow {
    ClassKey key;
    DdsReaderPlan plan;
    Guid reader;
    std::uint32_t matched = 0, incompatible = 0;  // writers
    std::uint64_t malformed = 0;                  // payloads that are not a message of the type
    std::uint64_t without_remote_publisher = 0;   // messages of writers without a remote publisher
    std::uint64_t overflow = 0;                   // payloads dropped because of a limit
  };
  /// A local reader, for the DDS writers of one class and depth.
  struct LocalReaderNow {
    ReaderKey key;
    std::uint64_t lost = 0;  // messages overwritten before they were taken
  };

  /// Outward: servers of this host for clients in DDS; inward: servers in DDS for clients of this
  /// host.
  struct ServiceNow {
    ServiceKey key;
    Direction way = Direction::outward;
    std::set<std::string> nodes;  // of this host, full names
    Guid reader, writer;
    std::uint32_t matched_writers = 0, matched_readers = 0;
    ServiceNumbers numbers;
  };

  std::uint32_t domain = 0;
  GuidLayout layout = GuidLayout::humble;
  std::uint64_t participants = 0;  // other participants
  bool has_daemon = true;
  std::optional<std::uint32_t> standby_for =
      {};                                    // the pid of the bridge that serves the domain instead
  std::uint64_t lost_early = 0;              // see DdsWriters::lost()
  std::uint64_t announced = 0;               // DDS writers without a reader
  std::uint64_t discovery_info_refused = 0;  // see RosGraph::refused()
  std::uint64_t since_ns = 0;                // monotonic
  struct LimitNow {
    const char* name = "";
    std::uint64_t most = 0, refused = 0;
  };
  std::vector<LimitNow> limits;  // see limits.hpp
  std::vector<DdsWriterNow> dds_writers;
  std::vector<RemotePublisherNow> remote_publishers;
  std::vector<DdsReaderNow> dds_readers;
  std::vector<ServiceNow> services;
  std::vector<LocalReaderNow> local_readers;
  std::vector<Unbridged> unbridged;
  std::vector<std::pair<std::string, std::string>> failures;  // what could not be made, why
};

/// Returns one line of JSON. Invalid UTF-8 in names is replaced.
std::string json_of(const BridgeStatus& status, std::uint64_t now_ns);
/// Returns "010f1c00.…": four groups, as ros2 prints them.
std::string text_of(const Guid& guid);

}  // namespace agnocast::bridge
