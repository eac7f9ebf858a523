// SPDX-License-Identifier: Apache-2.0
//
// message list: the messages in the queues, their holders, and who has not taken them yet.
//
// The begin of a hold is not recorded (it would cost every take a store); the age of the message
// is an upper bound.

#include <base/clock.hpp>
#include <base/text/text.hpp>
#include <ctl/cli/commands.hpp>
#include <ctl/commands/objects.hpp>
#include <ctl/snapshot/numbers.hpp>
#include <ctl/snapshot/select.hpp>
#include <ctl/snapshot/system.hpp>

#include <algorithm>
#include <string>
#include <vector>

namespace agnocast::ctl {
namespace {

std::uint64_t age_of(const MessageFacts& message, std::uint64_t now_ns) noexcept {
  return now_ns - std::min(now_ns, message.stamp_ns);
}

Object endpoints_object(const System& system, const std::vector<const Endpoint*>& endpoints) {
  Object list = Object::array();
  for (const Endpoint* const endpoint : endpoints) {
    const Process* const process = system.process_of(*endpoint);
    list.push_back({{"node_name", endpoint->node_name},
                    {"node_namespace", endpoint->node_namespace},
                    {"pid", process == nullptr ? Object(nullptr) : Object(process->facts.pid)},
                    {"subscription_generation", endpoint->facts.generation}});
  }
  return list;
}

std::string names_of(const System& system, const std::vector<const Endpoint*>& endpoints) {
  std::string text;
  for (const Endpoint* const endpoint : endpoints) {
    const Process* const process = system.process_of(*endpoint);
    text += (text.empty() ? "" : ", ") + escaped(endpoint->node_name) + " (" +
            (process == nullptr ? "gone" : std::to_string(process->facts.pid)) + ')';
  }
  return text.empty() ? "-" : text;
}

}  // namespace

Object messages_object(const System& system, const Topic& topic, std::uint64_t now_ns) {
  Object list = Object::array();
  for (const Endpoint& publisher : topic.publishers) {
    for (const MessageFacts& message : messages_of(system, topic, publisher))
      list.push_back({{"topic", topic.name},
                      {"publisher_generation", publisher.facts.generation},
                      {"node_name", publisher.node_name},
                      {"sequence", message.sequence},
                      {"slot", message.slot},
                      {"address", hexadecimal(message.address)},
                      {"object_bytes", message.object_bytes},
                      {"age_ns", age_of(message, now_ns)},
                      {"is_retired", message.retired},
                      {"held_by", endpoints_object(system, message.holders)},
                      {"unread_by", endpoints_object(system, message.unread_by)}});
  }
  return list;
}

Outcome<void> list_messages(const Arguments& arguments, Console& console) {
  const auto look = look_at(arguments.socket);
  if (!look) return tl::unexpected(look.error());
  std::vector<const Topic*> topics = topics_of(look->system, arguments);
  if (!arguments.subjects.empty()) {
    const auto topic = find_topic(look->system, arguments, arguments.subject(0));
    if (!topic) return tl::unexpected(topic.error());
    topics = {*topic};
  }
  const std::uint64_t now_ns = monotonic_ns();
  if (arguments.json != Json::no) {
    Object list = Object::array();
    for (const Topic* const topic : topics) {
      for (Object& message : messages_object(look->system, *topic, now_ns))
        list.push_back(std::move(message));
    }
    console.object(
        {{"schema", "agnocast.message-list/1"}, {"message_count", list.size()}, {"messages", list}},
        arguments.json);
    return {};
  }
  Table table({"TOPIC", "PUBLISHER", "NUMBER", "AGE", "OBJECT", "HELD BY", "UNREAD BY"});
  for (const Topic* const topic : topics) {
    for (const Endpoint& publisher : topic->publishers) {
      for (const MessageFacts& message : messages_of(look->system, *topic, publisher))
        table.add({escaped(topic->name), escaped(publisher.node_name),
                   std::to_string(message.sequence), time_for_people(age_of(message, now_ns)),
                   bytes_for_people(message.object_bytes), names_of(look->system, message.holders),
                   names_of(look->system, message.unread_by)});
    }
  }
  table.print(console);
  return {};
}

}  // namespace agnocast::ctl
