// SPDX-License-Identifier: Apache-2.0
//
// topic list, topic info: in the form of ros2 topic, with additions of agnocast.

#include <base/text/text.hpp>
#include <ctl/cli/commands.hpp>
#include <ctl/commands/objects.hpp>
#include <ctl/snapshot/numbers.hpp>
#include <ctl/snapshot/pairs.hpp>
#include <ctl/snapshot/select.hpp>
#include <ctl/snapshot/system.hpp>

#include <algorithm>
#include <cstdio>
#include <string>
#include <vector>

namespace agnocast::ctl {
namespace {

std::string line_of(const Topic& topic, const Arguments& arguments, bool with_type) {
  std::string text = escaped(topic.name);
  if (with_type) text += " [" + escaped(topic.type) + "]";
  if (arguments.all_domains) text += " (domain " + std::to_string(topic.facts.domain) + ")";
  return text;
}

/// How many publishers and subscriptions a topic may have.
struct Room {
  std::uint64_t publishers, subscriptions;
};
Room room_of(const System& system, const Topic& topic) {
  const auto& limits = system.daemon.limits;
  const std::uint64_t links = topic.facts.link_blocks * abi::link_block_count;
  return {std::min(links, limits.publishers_per_topic), limits.subscriptions_per_topic};
}

Object summary_of(const System& system, const Topic& topic) {
  const Room room = room_of(system, topic);
  return {{"name", topic.name},
          {"type", topic.type},
          {"domain", topic.facts.domain},
          {"layout_hash", hexadecimal(topic.facts.layout_hash)},
          {"publisher_count", active_count(topic.publishers)},
          {"publisher_count_max", room.publishers},
          {"subscription_count", active_count(topic.subscriptions)},
          {"subscription_count_max", room.subscriptions}};
}

void list_both_sides(const std::vector<const Topic*>& topics, const Arguments& arguments,
                     Console& console) {
  const auto list = [&](const char* heading, const auto& endpoints_of, const char* one) {
    console.line(console.strong(heading));
    for (const Topic* topic : topics) {
      const std::uint64_t count = active_count(endpoints_of(*topic));
      if (count != 0)
        console.line(" * " + line_of(*topic, arguments, true) + " " + counted(count, one));
    }
  };
  list(
      "Published topics:", [](const Topic& t) -> const auto& { return t.publishers; }, "publisher");
  console.line("");
  list(
      "Subscribed topics:", [](const Topic& t) -> const auto& { return t.subscriptions; },
      "subscriber");
}

// --- info

const char* state_word(abi::BoardState state) noexcept {
  switch (state) {
    case abi::BoardState::active:
      return "active";
    case abi::BoardState::leaving:
      return "leaving";
    case abi::BoardState::orphan:
      return "orphan";
    case abi::BoardState::revoked:
      return "revoked";
    case abi::BoardState::dead:
      return "dead";
    case abi::BoardState::free:
      break;
  }
  return "over";
}
const char* meaning_of(abi::BoardState state) noexcept {
  switch (state) {
    case abi::BoardState::orphan:
      return "orphan: has ended, its last messages are still being read";
    case abi::BoardState::leaving:
      return "leaving: takes no more messages, still holds some";
    case abi::BoardState::dead:
      return "dead: its process has ended";
    case abi::BoardState::free:
      return "over: its process is closing it";
    default:
      return state_word(state);
  }
}

// Returns an id that is unique across restarts of the daemon, in the form of a DDS GID.
std::string gid_of(const System& system, const Endpoint& endpoint) {
  std::string text;
  for (const std::uint64_t word : {system.daemon.incarnation, endpoint.facts.generation}) {
    for (int shift = 56; shift >= 0; shift -= 8) {
      char byte[8];
      std::snprintf(byte, sizeof byte, "%s%02x", text.empty() ? "" : ".",
                    static_cast<unsigned>(word >> shift & 0xff));
      text += byte;
    }
  }
  return text;
}

Object qos_object(const abi::QosWords& words) {
  const abi::Qos qos = abi::unpack_qos(words);
  const auto time = [](std::uint64_t ns) { return ns == 0 ? Object(nullptr) : Object(ns); };
  return {{"reliability", qos.reliable ? "reliable" : "best_effort"},
          {"durability", qos.transient_local ? "transient_local" : "volatile"},
          {"history", qos.keep_all ? "keep_all" : "keep_last"},
          {"depth", qos.depth},
          {"lifespan_ns", time(qos.lifespan_ns)},
          {"deadline_ns", time(qos.deadline_ns)},
          {"liveliness", qos.manual_liveliness ? "manual_by_topic" : "automatic"},
          {"liveliness_lease_ns", time(qos.lease_ns)}};
}

/// As `ros2 topic info -v` prints it.
std::string qos_time(std::uint64_t ns) {
  return ns == 0 ? "Infinite" : std::to_string(ns) + " nanoseconds";
}

Object common_object(const System& system, const Endpoint& endpoint) {
  Object object{
      {"node_name", endpoint.node_name},         {"node_namespace", endpoint.node_namespace},
      {"gid", gid_of(system, endpoint)},         {"index", endpoint.facts.index},
      {"generation", endpoint.facts.generation}, {"state", state_word(endpoint.state())},
      {"qos", qos_object(endpoint.facts.qos)}};
  const Process* const process = system.process_of(endpoint);
  object["pid"] = process == nullptr ? Object(nullptr) : Object(process->facts.pid);
  object["uid"] = process == nullptr ? Object(nullptr) : Object(process->facts.uid);
  object["process_name"] = process == nullptr ? Object(nullptr) : Object(process->name);
  return object;
}

Object object_of(const System& system, const Topic& topic, const Endpoint& endpoint) {
  Object object = common_object(system, endpoint);
  const auto put = [&](const char* key, bool known, std::uint64_t value) {
    object[key] = known ? Object(value) : Object(nullptr);
  };
  if (endpoint.is_publisher()) {
    const auto found = numbers_of_publisher(system, topic, endpoint);
    const PublisherNumbers numbers = found.value_or(PublisherNumbers{});
    object["is_zero_copy"] = found ? Object(numbers.adopted_messages == 0) : Object(nullptr);
    put("published_messages", found.has_value(), numbers.published);
    put("published_bytes", found.has_value(), numbers.published_bytes);
    put("adopted_messages", found.has_value(), numbers.adopted_messages);
    put("adopted_bytes", found.has_value(), numbers.adopted_bytes);
    put("allocated_messages", found.has_value(), numbers.messages);
    put("held_messages", found.has_value(), numbers.held);
    put("slots", true, endpoint.facts.slot_count);
    put("refused_no_slot", found.has_value(), numbers.refused_no_slot);
    put("refused_would_block", found.has_value(), numbers.refused_would_block);
    put("refused_heap_exhausted", found.has_value(), numbers.refused_heap_exhausted);
  } else {
    const auto found = numbers_of_subscription(system, topic, endpoint);
    const SubscriptionNumbers numbers = found.value_or(SubscriptionNumbers{});
    put("linked_publishers", found.has_value(), numbers.linked);
    put("held_messages", found.has_value(), numbers.held);
    put("held_messages_max_per_publisher", true, endpoint.facts.quota);
    put("held_messages_max_per_publisher_of_others", true, endpoint.facts.quota_of_others);
    put("unread_messages", found.has_value(), numbers.unread);
    put("lost_messages", found.has_value(), numbers.lost);
    put("malformed_messages", found.has_value(), numbers.malformed);
    put("unreachable_messages", found.has_value(), numbers.unreachable);
    put("expired_messages", found.has_value(), numbers.expired);
  }
  return object;
}

void print_publisher_numbers(const System& system, const Topic& topic, const Endpoint& endpoint,
                             Console& console) {
  const auto found = numbers_of_publisher(system, topic, endpoint);
  if (!found) return console.line("Counters: not readable, the publisher is gone");
  const PublisherNumbers& numbers = *found;
  if (numbers.adopted_messages == 0) {
    console.line("Zero-copy: yes");
  } else {
    console.line("Zero-copy: no, " + std::to_string(numbers.adopted_bytes) + " bytes adopted (" +
                 counted(numbers.adopted_messages, "message") + ")");
  }
  console.line("Published: " + counted(numbers.published, "message") + ", " +
               bytes_for_people(numbers.published_bytes));
  console.line("Allocated: " + counted(numbers.messages, "message") + " of " +
               std::to_string(endpoint.facts.slot_count) + ", " + std::to_string(numbers.held) +
               " held by subscriptions");
  if (numbers.refused_no_slot + numbers.refused_would_block + numbers.refused_heap_exhausted != 0)
    console.line("Refused: " + std::to_string(numbers.refused_no_slot) + " no_slot, " +
                 std::to_string(numbers.refused_would_block) + " would_block, " +
                 std::to_string(numbers.refused_heap_exhausted) + " heap_exhausted");
}

void print_subscription_numbers(const System& system, const Topic& topic, const Endpoint& endpoint,
                                Console& console) {
  const auto found = numbers_of_subscription(system, topic, endpoint);
  if (!found) return console.line("Counters: not readable, the subscription is gone");
  console.line("Linked: " + counted(found->linked, "publisher"));
  console.line(
      "Held: " + counted(found->held, "message") + ", at most " +
      std::to_string(endpoint.facts.quota) + " of each publisher" +
      (endpoint.facts.quota_of_others == endpoint.facts.quota
           ? ""
           : ", " + std::to_string(endpoint.facts.quota_of_others) + " of those of other users"));
  console.line("Unread: " + counted(found->unread, "message"));
  console.line(
      "Lost: " + counted(found->lost, "message") +
      (found->malformed == 0 ? "" : ", " + std::to_string(found->malformed) + " malformed") +
      (found->unreachable == 0 ? "" : ", " + std::to_string(found->unreachable) + " unreachable"));
  if (found->expired != 0) console.line("Expired: " + counted(found->expired, "message"));
  if (system.is_silent(endpoint))
    console.line("Doorbell: none; while it waits, it polls once a second");
  const Process* const process = system.process_of(endpoint);
  if (process != nullptr && process->facts.blocked_bytes != 0)
    console.line("Blocked: " + bytes_for_people(process->facts.blocked_bytes) +
                 " of the arena, by " + escaped(process->blocked_by));
}

void print_endpoint(const System& system, const Topic& topic, const Endpoint& endpoint,
                    Console& console) {
  const abi::Qos qos = abi::unpack_qos(endpoint.facts.qos);
  console.line("Node name: " + escaped(endpoint.node_name));
  console.line("Node namespace: " + escaped(endpoint.node_namespace));
  console.line("Topic type: " + escaped(topic.type));
  console.line(std::string("Endpoint type: ") +
               (endpoint.is_publisher() ? "PUBLISHER" : "SUBSCRIPTION"));
  console.line("GID: " + gid_of(system, endpoint));
  console.line("QoS profile:");
  console.line(std::string("  Reliability: ") + (qos.reliable ? "RELIABLE" : "BEST_EFFORT"));
  console.line(std::string("  History (Depth): ") + (qos.keep_all ? "KEEP_ALL" : "KEEP_LAST") +
               " (" + std::to_string(qos.depth) + ")");
  console.line(std::string("  Durability: ") +
               (qos.transient_local ? "TRANSIENT_LOCAL" : "VOLATILE"));
  console.line("  Lifespan: " + qos_time(qos.lifespan_ns));
  console.line("  Deadline: " + qos_time(qos.deadline_ns));
  console.line(std::string("  Liveliness: ") +
               (qos.manual_liveliness ? "MANUAL_BY_TOPIC" : "AUTOMATIC"));
  console.line("  Liveliness lease duration: " + qos_time(qos.lease_ns));
  if (const Process* const process = system.process_of(endpoint); process != nullptr)
    console.line("Process: " + words_of(*process));
  if (endpoint.state() != abi::BoardState::active)
    console.line(std::string("State: ") + meaning_of(endpoint.state()));
  if (endpoint.is_publisher()) {
    print_publisher_numbers(system, topic, endpoint, console);
  } else {
    print_subscription_numbers(system, topic, endpoint, console);
  }
  console.line("");
}

void print_side(const System& system, const Topic& topic, const char* heading,
                const std::vector<Endpoint>& endpoints, bool verbose, Console& console) {
  const std::uint64_t active = active_count(endpoints);
  std::string text = std::string(heading) + ": " + std::to_string(active);
  if (active != endpoints.size())
    text += " (and " + std::to_string(endpoints.size() - active) + " that left or died)";
  console.line(text);
  if (!verbose) return;
  console.line("");
  for (const Endpoint& endpoint : endpoints) print_endpoint(system, topic, endpoint, console);
}

// Prints for each publisher whether each subscription gets its messages without a copy.
void print_pairs(const System& system, const Topic& topic, Console& console) {
  const std::vector<Pair> pairs = pairs_of(system, topic);
  if (pairs.empty()) return;
  // If the answer is no, the user needs the processes.
  const auto name_of = [&](const Pair& pair, const Endpoint& endpoint) {
    const std::string node = escaped(endpoint.node_namespace == "/"
                                         ? '/' + endpoint.node_name
                                         : endpoint.node_namespace + '/' + endpoint.node_name);
    const std::string process = process_words_of(system, endpoint);
    return is_zero_copy(pair.state) || process.empty() ? node : node + " of " + process;
  };
  console.line("Is it zero-copy?");
  for (const Pair& pair : pairs)
    console.line("  " + name_of(pair, *pair.publisher) + " -> " +
                 name_of(pair, *pair.subscription) + ": " + answer_of(pair));
}

}  // namespace

Outcome<void> list_topics(const Arguments& arguments, Console& console) {
  const auto look = look_at(arguments.socket);
  if (!look) return tl::unexpected(look.error());
  auto topics = topics_of(look->system, arguments);
  if (!arguments.has(options::hidden))
    std::erase_if(topics, [](const Topic* t) { return is_hidden(t->name); });
  if (arguments.json != Json::no) {
    Object list = Object::array();
    for (const Topic* topic : topics) list.push_back(summary_of(look->system, *topic));
    console.object(
        {{"schema", "agnocast.topic-list/1"}, {"topic_count", topics.size()}, {"topics", list}},
        arguments.json);
  } else if (arguments.has(options::count_topics)) {
    console.line(std::to_string(topics.size()));
  } else if (arguments.has(options::verbose)) {
    list_both_sides(topics, arguments, console);
  } else {
    for (const Topic* topic : topics)
      console.line(line_of(*topic, arguments, arguments.has(options::show_types)));
  }
  return {};
}

Outcome<void> show_topic(const Arguments& arguments, Console& console) {
  const auto look = look_at(arguments.socket);
  if (!look) return tl::unexpected(look.error());
  const auto topic = find_topic(look->system, arguments, arguments.subject(0));
  if (!topic) return tl::unexpected(topic.error());
  const auto sides = {std::pair("Publisher count", &(*topic)->publishers),
                      std::pair("Subscription count", &(*topic)->subscriptions)};
  if (arguments.json == Json::no) {
    console.line("Type: " + escaped((*topic)->type));
    if (arguments.has(options::verbose)) {
      const Room room = room_of(look->system, **topic);
      console.line("Room: " + counted(room.publishers, "publisher") + ", " +
                   counted(room.subscriptions, "subscription"));
      console.line("");
    }
    for (const auto& [heading, endpoints] : sides)
      print_side(look->system, **topic, heading, *endpoints, arguments.has(options::verbose),
                 console);
    if (arguments.has(options::verbose)) print_pairs(look->system, **topic, console);
    return {};
  }
  Object object{{"schema", "agnocast.topic-info/1"}};
  object.update(topic_object(look->system, **topic));
  console.object(object, arguments.json);
  return {};
}

Object topic_object(const System& system, const Topic& topic) {
  Object object = summary_of(system, topic);
  object["publishers"] = Object::array();
  object["subscriptions"] = Object::array();
  for (const Endpoint& publisher : topic.publishers)
    object["publishers"].push_back(object_of(system, topic, publisher));
  for (const Endpoint& subscription : topic.subscriptions)
    object["subscriptions"].push_back(object_of(system, topic, subscription));
  object["pairs"] = Object::array();
  for (const Pair& pair : pairs_of(system, topic))
    object["pairs"].push_back({{"publisher_generation", pair.publisher->facts.generation},
                               {"subscription_generation", pair.subscription->facts.generation},
                               {"state", word_of(pair.state)},
                               {"is_zero_copy", is_zero_copy(pair.state)},
                               {"why", pair.why}});
  return object;
}

Outcome<void> find_topics(const Arguments& arguments, Console& console) {
  const auto look = look_at(arguments.socket);
  if (!look) return tl::unexpected(look.error());
  auto topics = topics_of(look->system, arguments);
  std::erase_if(topics, [&](const Topic* topic) {
    return topic->type != arguments.subject(0) ||
           (!arguments.has(options::hidden) && is_hidden(topic->name));
  });
  if (arguments.json != Json::no) {
    Object names = Object::array();
    for (const Topic* topic : topics) names.push_back(topic->name);
    console.object({{"schema", "agnocast.topic-find/1"},
                    {"type", arguments.subject(0)},
                    {"topic_count", topics.size()},
                    {"topics", names}},
                   arguments.json);
  } else if (arguments.has(options::count_topics)) {
    console.line(std::to_string(topics.size()));
  } else {
    for (const Topic* topic : topics) console.line(escaped(topic->name));
  }
  return {};
}

Outcome<void> show_type(const Arguments& arguments, Console& console) {
  const auto look = look_at(arguments.socket);
  if (!look) return tl::unexpected(look.error());
  const auto topic = find_topic(look->system, arguments, arguments.subject(0));
  if (!topic) return tl::unexpected(topic.error());
  if (arguments.json == Json::no) {
    console.line(escaped((*topic)->type));
  } else {
    console.object({{"schema", "agnocast.topic-type/1"},
                    {"name", (*topic)->name},
                    {"type", (*topic)->type},
                    {"layout_hash", hexadecimal((*topic)->facts.layout_hash)}},
                   arguments.json);
  }
  return {};
}

}  // namespace agnocast::ctl
