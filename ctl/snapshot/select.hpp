// SPDX-License-Identifier: Apache-2.0
//
// Select: finds the topics, processes and nodes that a command line names, and reports names that
// do not exist.
#pragma once

#include <ctl/cli/arguments.hpp>
#include <ctl/snapshot/journal.hpp>
#include <ctl/snapshot/system.hpp>

#include <optional>
#include <string>
#include <vector>

namespace agnocast::ctl {

/// Counts active endpoints, not those that have left and are being drained.
std::uint64_t active_count(const std::vector<Endpoint>& endpoints);

/// Returns the name with its leading slash: "points" means "/points".
std::string fully_qualified(const std::string& name);
/// Returns whether a part of the name begins with an underscore.
bool is_hidden(const std::string& name);

/// Returns the filter of --topic and --process. Problems: wrong_usage (invalid topic name).
Outcome<JournalFilter> filter_of(const Arguments& arguments);

/// Returns the topics of the domain or of all domains, by name.
std::vector<const Topic*> topics_of(const System& system, const Arguments& arguments);
/// Returns the topic of this name in the domain. Problems: no_such_thing, with a similar name.
Outcome<const Topic*> find_topic(const System& system, const Arguments& arguments,
                                 const std::string& name);

/// A service: a topic of requests to which the servers subscribe and on which the clients publish.
struct Service {
  std::string name, type;
  const Topic* requests;
};
/// Returns the service whose requests the topic carries; nothing for any other topic.
std::optional<Service> service_of(const Topic& topic);
/// Returns the services of the domain or of all domains, by name.
std::vector<Service> services_of(const System& system, const Arguments& arguments);

/// Returns "INDEX.GENERATION", which is never used twice.
std::string client_of(const wire::DumpProcess& process);
/// Returns the processes of the domain or of all: also those of another one with a topic in it.
std::vector<const Process*> processes_of(const System& system, const Arguments& arguments);
/// Returns every client with this pid, or the one of INDEX.GENERATION, or all with this name.
/// Problems: no_such_thing.
Outcome<std::vector<const Process*>> find_processes(const System& system, const std::string& name);

/// Returns "/ns/talker".
std::string node_name_of(const Endpoint& endpoint);
/// A node: the endpoints with one node name in one process and domain.
struct Node {
  std::string name, name_space;
  std::uint64_t domain = 0;
  std::uint64_t client = 0, client_generation = 0;
  struct Of {
    const Topic* topic;
    const Endpoint* endpoint;
  };
  std::vector<Of> publishers, subscriptions;  // active ones, by topic

  std::string full_name() const;
};
/// Returns the nodes of the domain or of all, by name; two processes may share a node name.
std::vector<Node> nodes_of(const System& system, const Arguments& arguments);

/// Returns "NAME (pid 1, uid 2)", or "a process that is gone".
std::string process_words(const System& system, const Endpoint& endpoint);

}  // namespace agnocast::ctl
