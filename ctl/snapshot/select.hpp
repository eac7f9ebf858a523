// SPDX-License-Identifier: Apache-2.0
//
// Select: which topics, processes and nodes the words of a command line mean, and what to say when there
// is none of that name.
#pragma once

#include <ctl/cli/arguments.hpp>
#include <ctl/snapshot/journal.hpp>
#include <ctl/snapshot/system.hpp>

#include <optional>
#include <string>
#include <vector>

namespace agnocast::ctl {

/// Not those that have left and are only being drained.
std::uint64_t active_count(const std::vector<Endpoint>& endpoints);

/// "points" is meant to be "/points".
std::string fully_qualified(const std::string& name);
/// A part of the name begins with an underscore.
bool is_hidden(const std::string& name);

/// What --topic and --process want to see. Problems: wrong_usage, what cannot be a topic's name.
Outcome<JournalFilter> filter_of(const Arguments& arguments);

/// Of the domain or of all, by name.
std::vector<const Topic*> topics_of(const System& system, const Arguments& arguments);
/// The topic of this name in the domain. Problems: no_such_thing, with what may have been meant.
Outcome<const Topic*> find_topic(const System& system, const Arguments& arguments,
                                 const std::string& name);

/// A service: a topic of requests that somebody subscribes to, who serves, or publishes on, who asks.
struct Service {
  std::string name, type;
  const Topic* requests;
};
/// Whose requests that topic has; nothing if it is no such topic.
std::optional<Service> service_of(const Topic& topic);
/// Of the domain or of all, by name.
std::vector<Service> services_of(const System& system, const Arguments& arguments);

/// "INDEX.GENERATION": never used twice.
std::string client_of(const wire::DumpProcess& process);
/// Every client that a pid has, or the one that INDEX.GENERATION names, or those of that name. Problems:
/// no_such_thing.
Outcome<std::vector<const Process*>> find_processes(const System& system, const std::string& name);

/// "/ns/talker".
std::string node_name_of(const Endpoint& endpoint);
/// A node: endpoints of one name in one process.
struct Node {
  std::string name, name_space;
  std::uint64_t client = 0, client_generation = 0;
  struct Of {
    const Topic* topic;
    const Endpoint* endpoint;
  };
  std::vector<Of> publishers, subscriptions;  // active ones, by topic

  std::string full_name() const;
};
/// Of the domain or of all, by name; two processes may have a node of the same name.
std::vector<Node> nodes_of(const System& system, const Arguments& arguments);

/// "the process NAME (pid 1, uid 2)", or "a process that is gone".
std::string process_words(const System& system, const Endpoint& endpoint);

}  // namespace agnocast::ctl
