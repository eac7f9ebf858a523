// SPDX-License-Identifier: Apache-2.0
//
// Which services the bridge has to have, as routes.hpp says it of topics. Pure.
//
//   served   servers of this host:   client there ─▶ DDS reader, writer ─▶ a client here ─▶ server
//   asked    servers in DDS, clients of this host, and no server here:
//                                    client ─▶ a service here ─▶ DDS writer, reader ─▶ server there
//
// One route for each service and type, whoever and how many there are. Servers wait and clients come: if both waited for the
// other side, two hosts with nothing but agnocast would never meet. And a service is never both: a request that goes
// out would come in again by another bridge, without end. So a client is answered by its own host's servers if there
// are any. A rule's "out" offers services of this host to DDS, its
// "in" those of DDS to this host.
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

  auto operator<=>(const ServiceKey&) const = default;
};
struct ServiceRoute {
  std::set<std::string> nodes;  ///< of this host, full names: whose servers or clients it is for
  std::set<Guid> servers;       ///< of an asked one: the participants in DDS that serve it
};
struct ServicePlan {
  std::map<ServiceKey, ServiceRoute> served, asked;
  std::vector<Unbridged> unbridged;  ///< `topic` and `type` are the service's
};
ServicePlan plan_services(const Situation& situation);

}  // namespace agnocast::bridge
