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

Object dds_writers_of(const BridgeStatus& status, std::uint64_t now_ns) {
  Object list = Object::array();
  for (const BridgeStatus::DdsWriterNow& dds_writer : status.dds_writers) {
    Object object{{"topic", dds_writer.plan.local_reader.of.key.topic},
                  {"type", dds_writer.plan.local_reader.of.key.type},
                  {"node", dds_writer.plan.node},
                  {"publisher_generation", dds_writer.publisher},
                  {"guid", text_of(dds_writer.writer)},
                  {"qos", qos_object(dds_writer.plan.offered, dds_writer.plan.depth,
                                     dds_writer.plan.keep_all)},
                  {"matched", dds_writer.matched},
                  {"incompatible", dds_writer.incompatible}};
    add(object, dds_writer.traffic, now_ns);
    list.push_back(std::move(object));
  }
  return list;
}

Object remote_publishers_of(const BridgeStatus& status, std::uint64_t now_ns) {
  Object list = Object::array();
  for (const BridgeStatus::RemotePublisherNow& remote_publisher : status.remote_publishers) {
    Object object{{"topic", remote_publisher.plan.key.topic},
                  {"type", remote_publisher.plan.key.type},
                  {"node", remote_publisher.node},
                  {"guid", text_of(remote_publisher.writer)},
                  {"qos", qos_object(remote_publisher.plan.qos_class, remote_publisher.plan.depth,
                                     remote_publisher.plan.keep_all)}};
    add(object, remote_publisher.traffic, now_ns);
    list.push_back(std::move(object));
  }
  return list;
}

Object dds_readers_of(const BridgeStatus& status) {
  Object list = Object::array();
  for (const BridgeStatus::DdsReaderNow& dds_reader : status.dds_readers) {
    list.push_back({{"topic", dds_reader.key.key.topic},
                    {"type", dds_reader.key.key.type},
                    {"nodes", dds_reader.plan.nodes},
                    {"guid", text_of(dds_reader.reader)},
                    {"qos", qos_object(dds_reader.plan.requested, dds_reader.plan.depth,
                                       dds_reader.plan.keep_all)},
                    {"matched", dds_reader.matched},
                    {"incompatible", dds_reader.incompatible},
                    {"malformed", dds_reader.malformed},
                    {"without_remote_publisher", dds_reader.without_remote_publisher},
                    {"overflow", dds_reader.overflow}});
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

Object local_readers_of(const BridgeStatus& status) {
  Object list = Object::array();
  for (const BridgeStatus::LocalReaderNow& local_reader : status.local_readers) {
    const ReaderKey& key = local_reader.key;
    list.push_back({{"topic", key.of.key.topic},
                    {"type", key.of.key.type},
                    {"qos", qos_object(key.of.qos_class, key.depth, key.keep_all)},
                    {"lost", local_reader.lost}});
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
      {"dds_writers", dds_writers_of(status, now_ns)},
      {"remote_publishers", remote_publishers_of(status, now_ns)},
      {"local_readers", local_readers_of(status)},
      {"dds_readers", dds_readers_of(status)},
      {"services", services_of(status, now_ns)},
      {"unbridged", unbridged_of(status)},
      {"failures", failures_of(status)}};
  return object.dump(-1, ' ', false, Object::error_handler_t::replace) + '\n';
}

}  // namespace agnocast::bridge
