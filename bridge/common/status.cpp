// SPDX-License-Identifier: Apache-2.0

#include <bridge/common/status.hpp>

#include <agnocast/version.hpp>

#include <nlohmann/json.hpp>

#include <unistd.h>

#include <algorithm>
#include <cstdio>

namespace agnocast::bridge {
namespace {

using Object = nlohmann::ordered_json;

Object qos_object(const QosClass& qos, std::size_t depth, bool keep_all) {
  return {{"reliability", qos.reliable ? "reliable" : "best_effort"},
          {"durability", qos.transient_local ? "transient_local" : "volatile"},
          {"history", keep_all ? "keep_all" : "keep_last"},
          {"depth", depth}};
}

std::uint64_t age(std::uint64_t since_ns, std::uint64_t now_ns) {
  return now_ns > since_ns ? now_ns - since_ns : 0;
}

Object age_or_null(std::uint64_t since_ns, std::uint64_t now_ns) {
  return since_ns == 0 ? Object(nullptr) : Object(age(since_ns, now_ns));
}

void add(Object& object, const TrafficNumbers& traffic, std::uint64_t now_ns) {
  object["messages"] = traffic.messages;
  object["bytes"] = traffic.bytes;
  object["unacknowledged"] = traffic.unacknowledged;
  object["refused"] = traffic.refused;
  object["age_ns"] = age(traffic.since_ns, now_ns);
  object["last_age_ns"] = age_or_null(traffic.last_ns, now_ns);
}

const char* word_of(Direction way) { return way == Direction::outward ? "out" : "in"; }

const char* word_of(WhyNot why) {
  switch (why) {
    case WhyNot::rule:
      return "rule";
    case WhyNot::no_reader:
      return "no_reader";
    case WhyNot::no_writer:
      return "no_writer";
    case WhyNot::no_server:
      return "no_server";
    case WhyNot::other_type:
      return "other_type";
    case WhyNot::unknown_type:
      return "unknown_type";
    case WhyNot::no_ros_name:
      return "no_ros_name";
    case WhyNot::too_many:
      return "too_many";
    case WhyNot::qos:
      break;
  }
  return "qos";
}

Object limits_of(const BridgeStatus& status) {
  Object list = Object::array();
  for (const BridgeStatus::LimitNow& limit : status.limits)
    list.push_back({{"limit", limit.name}, {"most", limit.most}, {"refused", limit.refused}});
  return list;
}

Object outlets_of(const BridgeStatus& status, std::uint64_t now_ns) {
  Object list = Object::array();
  for (const BridgeStatus::OutletNow& outlet : status.outlets) {
    Object object{{"topic", outlet.plan.tap.of.key.topic},
                  {"type", outlet.plan.tap.of.key.type},
                  {"node", outlet.plan.node},
                  {"publisher_generation", outlet.publisher},
                  {"guid", text_of(outlet.writer)},
                  {"qos", qos_object(outlet.plan.offered, outlet.plan.depth, outlet.plan.keep_all)},
                  {"matched", outlet.matched},
                  {"incompatible", outlet.incompatible}};
    add(object, outlet.traffic, now_ns);
    list.push_back(std::move(object));
  }
  return list;
}

Object sources_of(const BridgeStatus& status, std::uint64_t now_ns) {
  Object list = Object::array();
  for (const BridgeStatus::SourceNow& source : status.sources) {
    Object object{
        {"topic", source.plan.key.topic},
        {"type", source.plan.key.type},
        {"node", source.node},
        {"guid", text_of(source.writer)},
        {"qos", qos_object(source.plan.qos_class, source.plan.depth, source.plan.keep_all)}};
    add(object, source.traffic, now_ns);
    list.push_back(std::move(object));
  }
  return list;
}

Object inlets_of(const BridgeStatus& status) {
  Object list = Object::array();
  for (const BridgeStatus::InletNow& inlet : status.inlets) {
    list.push_back(
        {{"topic", inlet.key.key.topic},
         {"type", inlet.key.key.type},
         {"nodes", inlet.plan.nodes},
         {"guid", text_of(inlet.reader)},
         {"qos", qos_object(inlet.plan.requested, inlet.plan.depth, inlet.plan.keep_all)},
         {"matched", inlet.matched},
         {"incompatible", inlet.incompatible},
         {"malformed", inlet.malformed},
         {"without_source", inlet.without_source},
         {"overflow", inlet.overflow}});
  }
  return list;
}

Object services_of(const BridgeStatus& status, std::uint64_t now_ns) {
  Object list = Object::array();
  for (const BridgeStatus::ServiceNow& service : status.services) {
    const ServiceNumbers& numbers = service.numbers;
    list.push_back({{"service", service.key.service},
                    {"type", service.key.type},
                    {"direction", word_of(service.way)},
                    {"nodes", service.nodes},
                    {"reader_guid", text_of(service.reader)},
                    {"writer_guid", text_of(service.writer)},
                    {"matched_writers", service.matched_writers},
                    {"matched_readers", service.matched_readers},
                    {"requests", numbers.requests},
                    {"request_bytes", numbers.request_bytes},
                    {"responses", numbers.responses},
                    {"response_bytes", numbers.response_bytes},
                    {"malformed", numbers.malformed},
                    {"refused", numbers.refused},
                    {"timed_out", numbers.timed_out},
                    {"forgotten", numbers.forgotten},
                    {"unasked", numbers.unasked},
                    {"age_ns", age(numbers.since_ns, now_ns)},
                    {"last_age_ns", age_or_null(numbers.last_ns, now_ns)}});
  }
  return list;
}

Object taps_of(const BridgeStatus& status) {
  Object list = Object::array();
  for (const BridgeStatus::TapNow& tap : status.taps) {
    const ReaderKey& key = tap.key;
    list.push_back({{"topic", key.of.key.topic},
                    {"type", key.of.key.type},
                    {"qos", qos_object(key.of.qos_class, key.depth, key.keep_all)},
                    {"lost", tap.lost}});
  }
  return list;
}

Object unbridged_of(const BridgeStatus& status) {
  Object list = Object::array();
  for (const Unbridged& each : status.unbridged) {
    list.push_back({{"kind", each.is_service ? "service" : "topic"},
                    {"topic", each.topic},
                    {"type", each.type},
                    {"direction", word_of(each.way)},
                    {"why", word_of(each.why)},
                    {"detail", each.detail}});
  }
  return list;
}

Object failures_of(const BridgeStatus& status) {
  Object list = Object::array();
  for (const auto& [what, why] : status.failures) list.push_back({{"what", what}, {"why", why}});
  return list;
}

}  // namespace

std::string text_of(const Guid& guid) {
  std::string text;
  for (std::size_t i = 0; i < guid.bytes.size(); ++i) {
    char digits[4];
    std::snprintf(digits, sizeof digits, i != 0 && i % 4 == 0 ? ".%02x" : "%02x", guid.bytes[i]);
    text += digits;
  }
  return text;
}

std::string json_of(const BridgeStatus& status, std::uint64_t now_ns) {
  char version[32];
  std::snprintf(version, sizeof version, "%d.%d.%d", AGNOCAST_VERSION_MAJOR, AGNOCAST_VERSION_MINOR,
                AGNOCAST_VERSION_PATCH);
  const Object object{
      {"schema", "agnocast.bridge-status/1"},
      {"version", version},
      {"pid", ::getpid()},
      {"domain", status.domain},
      {"uptime_ns", age(status.since_ns, now_ns)},
      {"discovery_info", status.layout == GuidLayout::humble ? "humble" : "iron"},
      {"participants", status.participants},
      {"has_daemon", status.has_daemon},
      {"standby_for", status.standby_for ? Object(*status.standby_for) : Object(nullptr)},
      {"announced", status.announced},
      {"lost_early", status.lost_early},
      {"discovery_info_refused", status.discovery_info_refused},
      {"limits", limits_of(status)},
      {"outlets", outlets_of(status, now_ns)},
      {"sources", sources_of(status, now_ns)},
      {"taps", taps_of(status)},
      {"inlets", inlets_of(status)},
      {"services", services_of(status, now_ns)},
      {"unbridged", unbridged_of(status)},
      {"failures", failures_of(status)}};
  return object.dump(-1, ' ', false, Object::error_handler_t::replace) + '\n';
}

}  // namespace agnocast::bridge
