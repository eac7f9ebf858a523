// SPDX-License-Identifier: Apache-2.0
//
// bridge list, bridge info: the topics and services that the bridges to DDS carry, their traffic,
// and those that are not bridged, with the reason. Rates come from the counters of two looks.

#include <base/text/text.hpp>
#include <ctl/cli/commands.hpp>
#include <ctl/cli/waiting.hpp>
#include <ctl/snapshot/bridges.hpp>
#include <ctl/snapshot/select.hpp>

#include <algorithm>
#include <cstdio>
#include <map>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

namespace agnocast::ctl {
namespace {

/// The traffic of one endpoint between two looks.
struct Rate {
  double messages_hz = 0, bytes_per_second = 0;
};
using Rates = std::map<std::tuple<std::uint64_t, bool, std::string>, Rate>;  // domain, out, guid

Rates rates_between(const std::vector<BridgeState>& before, const std::vector<BridgeState>& after) {
  Rates rates;
  for (const BridgeState& bridge : after) {
    const auto former = std::find_if(before.begin(), before.end(), [&](const BridgeState& one) {
      return one.pid == bridge.pid && one.domain == bridge.domain;
    });
    if (former == before.end() || bridge.uptime_ns <= former->uptime_ns) continue;
    const double seconds = static_cast<double>(bridge.uptime_ns - former->uptime_ns) * 1e-9;
    for (const BridgeEndpoint& endpoint : bridge.endpoints) {
      for (const BridgeEndpoint& was : former->endpoints) {
        if (was.guid != endpoint.guid || was.is_out != endpoint.is_out) continue;
        if (endpoint.messages < was.messages || endpoint.bytes < was.bytes) continue;
        rates[{bridge.domain, endpoint.is_out, endpoint.guid}] = {
            static_cast<double>(endpoint.messages - was.messages) / seconds,
            static_cast<double>(endpoint.bytes - was.bytes) / seconds};
      }
    }
  }
  return rates;
}

/// The endpoints of one topic and direction.
struct Route {
  std::string topic, type;
  bool is_out = true;
  std::uint64_t endpoints = 0, matched = 0, messages = 0, bytes = 0, unacknowledged = 0,
                refused = 0, malformed = 0, lost = 0, without_remote_publisher = 0, overflow = 0;
  std::optional<std::uint64_t> last_age_ns;
  double messages_hz = 0, bytes_per_second = 0;

  std::uint64_t dropped() const {
    return unacknowledged + refused + malformed + lost + without_remote_publisher + overflow;
  }
};

std::vector<Route> routes_of(const BridgeState& bridge, const Rates& rates) {
  std::map<std::tuple<std::string, std::string, bool>, Route> routes;
  const auto route_of = [&](const std::string& topic, const std::string& type,
                            bool is_out) -> Route& {
    Route& route = routes[{topic, type, is_out}];
    route.topic = topic;
    route.type = type;
    route.is_out = is_out;
    return route;
  };
  for (const BridgeEndpoint& endpoint : bridge.endpoints) {
    Route& route = route_of(endpoint.topic, endpoint.type, endpoint.is_out);
    ++route.endpoints;
    route.matched = std::max(route.matched, endpoint.matched);
    route.messages += endpoint.messages;
    route.bytes += endpoint.bytes;
    route.unacknowledged += endpoint.unacknowledged;
    route.refused += endpoint.refused;
    if (endpoint.last_age_ns)
      route.last_age_ns =
          std::min(route.last_age_ns.value_or(*endpoint.last_age_ns), *endpoint.last_age_ns);
    const auto rate = rates.find({bridge.domain, endpoint.is_out, endpoint.guid});
    if (rate == rates.end()) continue;
    route.messages_hz += rate->second.messages_hz;
    route.bytes_per_second += rate->second.bytes_per_second;
  }
  for (const BridgeDdsReader& dds_reader : bridge.dds_readers) {
    Route& route = route_of(dds_reader.topic, dds_reader.type, false);
    route.matched += dds_reader.matched;
    route.malformed += dds_reader.malformed;
    route.without_remote_publisher += dds_reader.without_remote_publisher;
    route.overflow += dds_reader.overflow;
  }
  for (const BridgeLocalReader& local_reader : bridge.local_readers)
    route_of(local_reader.topic, local_reader.type, true).lost += local_reader.lost;
  std::vector<Route> list;
  for (auto& [key, route] : routes) list.push_back(std::move(route));
  return list;
}

const char* way_word(bool is_out) { return is_out ? "out" : "in"; }

std::string one_place(double value) {
  char text[32];
  std::snprintf(text, sizeof text, "%.1f", value);
  return text;
}
std::string age_words(const std::optional<std::uint64_t>& age_ns) {
  return age_ns ? time_for_people(*age_ns) : "-";
}

/// Returns the reason with its details, for people.
std::string why_words(const BridgeLack& lack) {
  const std::pair<const char*, const char*> words[] = {
      {"rule", "a rule of the configuration excludes it"},
      {"no_reader", "it has no reader in DDS"},
      {"no_writer", "it has no writer in DDS"},
      {"no_server", "it has no server in DDS"},
      {"other_type", "it has another type in DDS"},
      {"unknown_type", "its message type is not available here"},
      {"no_ros_name", "it has no name in ROS"},
      {"too_many", "DDS has more writers than a topic may have publishers"},
      {"qos", "reliability or durability do not match"}};
  std::string text = escaped(lack.why);
  for (const auto& [why, meaning] : words) {
    if (lack.why == why) text = meaning;
  }
  return lack.detail.empty() ? text : text + ": " + escaped(lack.detail);
}

Object qos_object(const BridgeQos& qos) {
  return {{"reliability", qos.reliability},
          {"durability", qos.durability},
          {"history", qos.history},
          {"depth", qos.depth}};
}
Object number_or_null(const std::optional<std::uint64_t>& number) {
  return number ? Object(*number) : Object(nullptr);
}
Object lack_object(const BridgeLack& lack) {
  return {{"kind", lack.is_service ? "service" : "topic"},
          {"topic", lack.topic},
          {"type", lack.type},
          {"direction", way_word(lack.is_out)},
          {"why", lack.why},
          {"detail", lack.detail}};
}
Object service_object(const BridgeService& service) {
  return {{"service", service.service},
          {"type", service.type},
          {"direction", way_word(service.is_out)},
          {"nodes", service.nodes},
          {"reader_guid", service.reader_guid},
          {"writer_guid", service.writer_guid},
          {"matched", service.matched()},
          {"requests", service.requests},
          {"request_bytes", service.request_bytes},
          {"responses", service.responses},
          {"response_bytes", service.response_bytes},
          {"malformed", service.malformed},
          {"refused", service.refused},
          {"timed_out", service.timed_out},
          {"forgotten", service.forgotten},
          {"unasked", service.unasked},
          {"age_ns", service.age_ns},
          {"last_age_ns", number_or_null(service.last_age_ns)}};
}
Object limits_object(const BridgeState& bridge) {
  Object list = Object::array();
  for (const BridgeState::Limit& limit : bridge.limits)
    list.push_back({{"limit", limit.limit}, {"most", limit.most}, {"refused", limit.refused}});
  return list;
}
Object heading_object(const BridgeState& bridge) {
  return {{"domain", bridge.domain},
          {"pid", bridge.pid},
          {"version", bridge.version},
          {"uptime_ns", bridge.uptime_ns},
          {"discovery_info", bridge.discovery_info},
          {"participants", bridge.participants},
          {"has_daemon", bridge.has_daemon},
          {"standby_for", number_or_null(bridge.standby_for)},
          {"announced", bridge.announced},
          {"lost_early", bridge.lost_early},
          {"discovery_info_refused", bridge.discovery_info_refused},
          {"limits", limits_object(bridge)}};
}

Object list_object(const std::vector<BridgeState>& bridges, const Rates& rates) {
  Object list = Object::array();
  for (const BridgeState& bridge : bridges) {
    Object routes = Object::array(), services = Object::array(), unbridged = Object::array(),
           failures = Object::array();
    for (const Route& route : routes_of(bridge, rates)) {
      routes.push_back({{"topic", route.topic},
                        {"type", route.type},
                        {"direction", way_word(route.is_out)},
                        {"endpoints", route.endpoints},
                        {"matched", route.matched},
                        {"rate_hz", route.messages_hz},
                        {"bytes_per_second", static_cast<std::uint64_t>(route.bytes_per_second)},
                        {"messages", route.messages},
                        {"bytes", route.bytes},
                        {"unacknowledged", route.unacknowledged},
                        {"refused", route.refused},
                        {"malformed", route.malformed},
                        {"lost", route.lost},
                        {"without_remote_publisher", route.without_remote_publisher},
                        {"overflow", route.overflow},
                        {"last_age_ns", number_or_null(route.last_age_ns)}});
    }
    for (const BridgeService& service : bridge.services)
      services.push_back(service_object(service));
    for (const BridgeLack& lack : bridge.unbridged) unbridged.push_back(lack_object(lack));
    for (const auto& [what, why] : bridge.failures)
      failures.push_back({{"what", what}, {"why", why}});
    Object object = heading_object(bridge);
    object["routes"] = std::move(routes);
    object["services"] = std::move(services);
    object["unbridged"] = std::move(unbridged);
    object["failures"] = std::move(failures);
    list.push_back(std::move(object));
  }
  return {{"schema", "agnocast.bridge-list/1"}, {"bridges", std::move(list)}};
}

// Prints what no table has room for, a line each.
void print_remarks(const std::vector<BridgeState>& bridges, Console& console) {
  for (const BridgeState& bridge : bridges) {
    const std::string name = "\nthe bridge of domain " + std::to_string(bridge.domain) + " (pid " +
                             std::to_string(bridge.pid) + ") ";
    if (!bridge.has_daemon) console.line(name + "is not connected to a daemon");
    if (bridge.standby_for)
      console.line(name + "is on standby for pid " + std::to_string(*bridge.standby_for));
    if (bridge.announced != 0)
      console.line(name + "announces " + counted(bridge.announced, "publisher") +
                   " in DDS without a reader there");
    if (bridge.lost_early != 0)
      console.line(name + "has lost " + counted(bridge.lost_early, "message") +
                   " of publishers that were announced to it too late");
    if (bridge.discovery_info_refused != 0)
      console.line(name + "has refused " + counted(bridge.discovery_info_refused, "message") +
                   " about nodes in DDS (ros_discovery_info)");
    for (const BridgeState::Limit& limit : bridge.limits) {
      if (limit.refused != 0)
        console.line(name + "has refused " + std::to_string(limit.refused) + " beyond the limit " +
                     escaped(limit.limit) + " (" + std::to_string(limit.most) + ")");
    }
    for (const auto& [what, why] : bridge.failures)
      console.line("\n" + escaped(what) + " could not be made: " + escaped(why));
  }
}

void print_list(const std::vector<BridgeState>& bridges, const Rates& rates, bool is_verbose,
                Console& console) {
  Table table({"DOMAIN", "TOPIC", "TYPE", "WAY", "ENDPOINTS", "MATCHED", "RATE", "BW", "MESSAGES",
               "DROPPED", "LAST"});
  Table services({"DOMAIN", "SERVICE", "TYPE", "WAY", "MATCHED", "REQUESTS", "RESPONSES", "BYTES",
                  "DROPPED", "LAST"});
  Table lacks({"DOMAIN", "TOPIC OR SERVICE", "TYPE", "WAY", "WHY NOT"});
  std::uint64_t alone = 0;
  bool has_routes = false, has_services = false, has_lacks = false;
  for (const BridgeState& bridge : bridges) {
    const std::string domain = std::to_string(bridge.domain);
    for (const Route& route : routes_of(bridge, rates)) {
      // A reader without a writer: the list of topics that are not bridged shows it.
      if (!is_verbose && route.endpoints + route.matched + route.dropped() == 0) continue;
      has_routes = true;
      table.add({domain, escaped(route.topic), escaped(route.type), way_word(route.is_out),
                 std::to_string(route.endpoints), std::to_string(route.matched),
                 one_place(route.messages_hz),
                 bytes_for_people(static_cast<std::uint64_t>(route.bytes_per_second)) + "/s",
                 std::to_string(route.messages), std::to_string(route.dropped()),
                 age_words(route.last_age_ns)});
    }
    for (const BridgeService& service : bridge.services) {
      has_services = true;
      services.add({domain, escaped(service.service), escaped(service.type),
                    way_word(service.is_out), std::to_string(service.matched()),
                    std::to_string(service.requests), std::to_string(service.responses),
                    bytes_for_people(service.request_bytes + service.response_bytes),
                    std::to_string(service.dropped()), age_words(service.last_age_ns)});
    }
    for (const BridgeLack& lack : bridge.unbridged) {
      if (!is_verbose && !lack.is_a_mistake()) {
        ++alone;
        continue;
      }
      has_lacks = true;
      lacks.add({domain, escaped(lack.topic), escaped(lack.type), way_word(lack.is_out),
                 why_words(lack)});
    }
  }
  if (has_routes) table.print(console);
  if (!has_routes && !has_services) console.line("nothing is bridged now");
  if (has_services) {
    if (has_routes) console.line("");
    services.print(console);
  }
  if (has_lacks) {
    console.line("");
    lacks.print(console);
  }
  if (alone != 0)
    console.line("\nnot shown: " + std::to_string(alone) +
                 " without a peer in DDS, or excluded by a rule (-v)");
  print_remarks(bridges, console);
}

std::string list_of(const std::vector<std::string>& nodes) {
  std::string text;
  for (const std::string& node : nodes) text += (text.empty() ? "" : ", ") + escaped(node);
  return text.empty() ? "no node" : text;
}
std::string qos_words(const BridgeQos& qos) {
  const std::string depth = qos.history == "keep_last" ? ' ' + std::to_string(qos.depth) : "";
  return escaped(qos.reliability) + ", " + escaped(qos.durability) + ", " + escaped(qos.history) +
         depth;
}

/// The facts of one bridge about one topic or service; empty if it does not know the name.
struct About {
  const BridgeState* bridge = nullptr;
  std::vector<const BridgeEndpoint*> endpoints;
  std::vector<const BridgeDdsReader*> dds_readers;
  std::vector<const BridgeLocalReader*> local_readers;
  std::vector<const BridgeService*> services;
  std::vector<const BridgeLack*> unbridged;
};

void print_service(const BridgeService& service, Console& console) {
  console.line((service.is_out ? "\nService to DDS, server: " : "\nService from DDS, client: ") +
               list_of(service.nodes));
  console.line("  Type: " + escaped(service.type));
  console.line(std::string("  In DDS: ") +
               (service.is_out ? "requests are read by " : "responses are read by ") +
               escaped(service.reader_guid) + ", " + (service.is_out ? "responses" : "requests") +
               " written by " + escaped(service.writer_guid));
  console.line("  Matched: " + counted(service.matched(), service.is_out ? "client" : "server"));
  console.line("  Requests: " + std::to_string(service.requests) + ", " +
               bytes_for_people(service.request_bytes));
  console.line("  Responses: " + std::to_string(service.responses) + ", " +
               bytes_for_people(service.response_bytes) + ", the last message " +
               (service.last_age_ns ? time_for_people(*service.last_age_ns) + " ago" : "never"));
  if (service.dropped() != 0)
    console.line("  Dropped: " + std::to_string(service.malformed) + " malformed, " +
                 std::to_string(service.refused) + " refused, " +
                 std::to_string(service.timed_out) + " timed out, " +
                 std::to_string(service.forgotten) + " forgotten");
  if (service.unasked != 0)
    console.line("  Unasked: " + counted(service.unasked, "response") +
                 " without a pending request");
  console.line("  Age: " + duration_for_people(service.age_ns));
}

void print_about(const About& about, Console& console) {
  const BridgeState& bridge = *about.bridge;
  console.line(console.strong("Domain " + std::to_string(bridge.domain)) + ": agnocast-bridge " +
               escaped(bridge.version) + " (pid " + std::to_string(bridge.pid) + "), for " +
               duration_for_people(bridge.uptime_ns) + ", " +
               counted(bridge.participants, "other participant", "other participants"));
  for (const BridgeEndpoint* const endpoint : about.endpoints) {
    console.line(std::string("\n") + (endpoint->is_out ? "To DDS: " : "From DDS: ") +
                 (endpoint->node.empty() ? "a writer without a node" : escaped(endpoint->node)));
    console.line("  Type: " + escaped(endpoint->type));
    console.line("  Writer in DDS: " + escaped(endpoint->guid));
    console.line("  QoS: " + qos_words(endpoint->qos));
    if (endpoint->is_out)
      console.line("  Matched: " + counted(endpoint->matched, "reader") + ", " +
                   std::to_string(endpoint->incompatible) + " refused because of their QoS");
    console.line(
        "  Messages: " + std::to_string(endpoint->messages) + ", " +
        bytes_for_people(endpoint->bytes) + ", the last one " +
        (endpoint->last_age_ns ? time_for_people(*endpoint->last_age_ns) + " ago" : "never"));
    if (endpoint->unacknowledged + endpoint->refused != 0)
      console.line("  Dropped: " + std::to_string(endpoint->unacknowledged) +
                   " not acknowledged, " + std::to_string(endpoint->refused) + " refused");
    console.line("  Age: " + duration_for_people(endpoint->age_ns));
  }
  for (const BridgeDdsReader* const dds_reader : about.dds_readers) {
    console.line("\nReader in DDS: " + escaped(dds_reader->guid) + ", for " +
                 list_of(dds_reader->nodes));
    console.line("  Type: " + escaped(dds_reader->type));
    console.line("  QoS: " + qos_words(dds_reader->qos));
    console.line("  Matched: " + counted(dds_reader->matched, "writer") + ", " +
                 std::to_string(dds_reader->incompatible) + " refused because of their QoS");
    if (dds_reader->malformed + dds_reader->without_remote_publisher + dds_reader->overflow != 0)
      console.line("  Dropped: " + std::to_string(dds_reader->malformed) + " malformed, " +
                   std::to_string(dds_reader->without_remote_publisher) +
                   " of writers without a publisher here, " + std::to_string(dds_reader->overflow) +
                   " over a limit");
  }
  for (const BridgeLocalReader* const local_reader : about.local_readers) {
    if (local_reader->lost != 0)
      console.line("\nLost on the way to DDS: " + counted(local_reader->lost, "message") + " (" +
                   qos_words(local_reader->qos) + "), not taken in time");
  }
  for (const BridgeService* const service : about.services) print_service(*service, console);
  for (const BridgeLack* const lack : about.unbridged)
    console.line(std::string(lack->is_service ? "\nService not " : "\nNot ") +
                 (lack->is_out ? "to" : "from") + " DDS: " + why_words(*lack) + " (" +
                 escaped(lack->type) + ')');
}

Object about_object(const About& about) {
  Object endpoints = Object::array(), dds_readers = Object::array(),
         local_readers = Object::array(), services = Object::array(), unbridged = Object::array();
  for (const BridgeEndpoint* const endpoint : about.endpoints) {
    endpoints.push_back({{"direction", way_word(endpoint->is_out)},
                         {"type", endpoint->type},
                         {"node", endpoint->node},
                         {"guid", endpoint->guid},
                         {"qos", qos_object(endpoint->qos)},
                         {"matched", endpoint->matched},
                         {"incompatible", endpoint->incompatible},
                         {"messages", endpoint->messages},
                         {"bytes", endpoint->bytes},
                         {"unacknowledged", endpoint->unacknowledged},
                         {"refused", endpoint->refused},
                         {"age_ns", endpoint->age_ns},
                         {"last_age_ns", number_or_null(endpoint->last_age_ns)}});
  }
  for (const BridgeDdsReader* const dds_reader : about.dds_readers)
    dds_readers.push_back({{"type", dds_reader->type},
                           {"nodes", dds_reader->nodes},
                           {"guid", dds_reader->guid},
                           {"qos", qos_object(dds_reader->qos)},
                           {"matched", dds_reader->matched},
                           {"incompatible", dds_reader->incompatible},
                           {"malformed", dds_reader->malformed},
                           {"without_remote_publisher", dds_reader->without_remote_publisher},
                           {"overflow", dds_reader->overflow}});
  for (const BridgeLocalReader* const local_reader : about.local_readers)
    local_readers.push_back({{"type", local_reader->type},
                             {"qos", qos_object(local_reader->qos)},
                             {"lost", local_reader->lost}});
  for (const BridgeService* const service : about.services)
    services.push_back(service_object(*service));
  for (const BridgeLack* const lack : about.unbridged) unbridged.push_back(lack_object(*lack));
  Object object = heading_object(*about.bridge);
  object["endpoints"] = std::move(endpoints);
  object["dds_readers"] = std::move(dds_readers);
  object["local_readers"] = std::move(local_readers);
  object["services"] = std::move(services);
  object["unbridged"] = std::move(unbridged);
  return object;
}

}  // namespace

Outcome<void> list_bridges(const Arguments& arguments, Console& console) {
  const int interval_ms = static_cast<int>(arguments.real(options::bridge_delay) * 1000);
  auto before = read_bridges(arguments);
  if (!before) return tl::unexpected(before.error());
  const Waiting waiting;
  while (waiting.sleep_ms(interval_ms)) {
    auto now = read_bridges(arguments);
    if (!now) return tl::unexpected(now.error());
    const Rates rates = rates_between(*before, *now);
    if (arguments.json == Json::no) {
      print_list(*now, rates, arguments.has(options::verbose), console);
    } else {
      console.object(list_object(*now, rates), arguments.json);
    }
    if (!arguments.has(options::bridge_watch)) return {};
    if (arguments.json == Json::no) console.line("");
    console.flush();
    before = std::move(now);
  }
  return {};
}

Outcome<void> show_bridged(const Arguments& arguments, Console& console) {
  const auto bridges = read_bridges(arguments);
  if (!bridges) return tl::unexpected(bridges.error());
  const std::string topic = fully_qualified(arguments.subject(0));
  std::vector<About> all;
  for (const BridgeState& bridge : *bridges) {
    About about{&bridge, {}, {}, {}, {}, {}};
    for (const BridgeEndpoint& endpoint : bridge.endpoints)
      if (endpoint.topic == topic) about.endpoints.push_back(&endpoint);
    for (const BridgeDdsReader& dds_reader : bridge.dds_readers)
      if (dds_reader.topic == topic) about.dds_readers.push_back(&dds_reader);
    for (const BridgeLocalReader& local_reader : bridge.local_readers)
      if (local_reader.topic == topic) about.local_readers.push_back(&local_reader);
    for (const BridgeService& service : bridge.services)
      if (service.service == topic) about.services.push_back(&service);
    for (const BridgeLack& lack : bridge.unbridged)
      if (lack.topic == topic) about.unbridged.push_back(&lack);
    if (!about.endpoints.empty() || !about.dds_readers.empty() || !about.local_readers.empty() ||
        !about.services.empty() || !about.unbridged.empty())
      all.push_back(std::move(about));
  }
  if (all.empty())
    return problem(Status::no_such_thing, escaped(topic),
                   "no bridge knows it: this host has no topic or service of that name in "
                   "a domain with a bridge",
                   "agnocast-ctl topic list --all-domains; agnocast-ctl service list "
                   "--all-domains");
  if (arguments.json == Json::no) {
    for (const About& about : all) print_about(about, console);
    return {};
  }
  Object list = Object::array();
  for (const About& about : all) list.push_back(about_object(about));
  console.object(
      {{"schema", "agnocast.bridge-info/1"}, {"topic", topic}, {"bridges", std::move(list)}},
      arguments.json);
  return {};
}

}  // namespace agnocast::ctl
