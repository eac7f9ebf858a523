// SPDX-License-Identifier: Apache-2.0
//
// ServicePlan: the services that the bridge must route, as routes.hpp does for topics. Pure.
//
//   served   servers of this host:   client in DDS ─▶ DDS reader, writer ─▶ a client here ─▶ server
//   asked    servers in DDS, clients of this host, and no server here:
//                                    client ─▶ a service here ─▶ DDS writer, reader ─▶ server in DDS
//
// There is one route for each service and type, for any number of endpoints. Served routes wait
// for clients in DDS: if they waited for the other side, two hosts with only agnocast would never
// meet. A service is never both: a request that goes out would come in again through another
// bridge, without end. So a host's own servers, if any, answer its clients. A rule's "out" offers
// services of this host to DDS, its "in" offers those of DDS to this host.
#pragma once

#include <bridge/plan/routes.hpp>

#include <compare>
#include <map>
#include <set>
#include <string>
#include <vector>

namespace agnocast::bridge {

struct ServiceKey {
  std::string service, type;  ///< "/ns/add", "example_interfaces/srv/AddTwoInts"

  // clang-tidy 14 takes the zero behind <=> for a pointer. NOLINTNEXTLINE(modernize-use-nullptr)
  auto operator<=>(const ServiceKey&) const = default;
};
struct ServiceRoute {
  std::set<std::string> nodes;  ///< nodes of this host with the servers or clients, full names
  std::set<Guid> servers;       ///< if asked: the participants in DDS that serve it
};
struct ServicePlan {
  std::map<ServiceKey, ServiceRoute> served, asked;
  std::vector<Unbridged> unbridged;  ///< `topic` and `type` are the service's
};
ServicePlan plan_services(const Situation& situation);

}  // namespace agnocast::bridge
