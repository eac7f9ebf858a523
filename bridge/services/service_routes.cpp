// SPDX-License-Identifier: Apache-2.0

#include <bridge/services/service_routes.hpp>

#include <bridge/common/retry_interval.hpp>
#include <bridge/dds/names.hpp>

#include <algorithm>
#include <ctime>
#include <exception>
#include <iterator>
#include <span>
#include <string_view>
#include <utility>

namespace agnocast::bridge {
namespace {

// How long a request waits until the routes to its server and back exist.
constexpr std::chrono::seconds patience{1};
// One endpoint carries requests of many clients, in bursts: more than ROS's 10 for one client.
constexpr std::int32_t service_depth = 1'000;
QoS service_qos() { return QoS(100); }
// Bound for one take from a reader, before others get their turn.
constexpr std::size_t takes_max = 64;
// Requests that servers in DDS have not answered: beyond this the oldest are dropped.
constexpr std::size_t requests_max = 1'000;

DdsQos qos_with(std::string user_data) {
  DdsQos qos;
  qos.depth = service_depth;
  qos.user_data = std::move(user_data);
  return qos;
}

DdsResult<WriteOutcome> write(DdsWriter& writer, const BridgedType& type,
                              const ServiceHeader& header, const void* body, std::size_t bytes,
                              const WindowSet& within) {
  timespec now{};
  ::clock_gettime(CLOCK_REALTIME, &now);
  return writer.write(
      bytes,
      [&](std::span<std::byte> room) -> std::size_t {
        return write_service_cdr(type.cdr, header, body, room, &within).value_or(0);
      },
      std::int64_t{now.tv_sec} * 1'000'000'000 + now.tv_nsec);
}

/// Returns the participant of a writer: the first 12 bytes of its GUID.
Guid participant_of(Guid writer) noexcept {
  std::fill(writer.bytes.begin() + 12, writer.bytes.end(), std::uint8_t{0});
  return writer;
}

/// Returns client id and number from in front of the body; nothing if the payload is too short.
std::optional<ServiceHeader> header_of(std::span<const std::byte> payload) {
  constexpr std::size_t encapsulation_bytes = 4;
  if (payload.size() < encapsulation_bytes + 16) return std::nullopt;
  const bool is_little = payload[1] == std::byte{1};
  const auto number = [&](std::size_t at) {
    std::uint64_t value = 0;
    for (std::size_t i = 0; i < 8; ++i)
      value |= std::to_integer<std::uint64_t>(payload[at + i]) << 8 * (is_little ? i : 7 - i);
    return value;
  };
  ServiceHeader header;
  header.client_id = number(encapsulation_bytes);
  header.sequence_number = static_cast<std::int64_t>(number(encapsulation_bytes + 8));
  return header;
}

std::string why_not(const DdsResult<WriteOutcome>& written) {
  return written ? "it cannot be written as CDR, refers to memory outside its publisher's, or "
                   "there is no "
                   "memory for it"
                 : written.error().text();
}

}  // namespace

void ServiceRoutes::dropped(const Log& log, ServiceTraffic& traffic,
                            ServiceTraffic::Counter& reason, const std::string& service,
                            const std::string& why) {
  const std::uint64_t count = ++reason;
  if (traffic.reports.now())
    log.write(LogLevel::warning, "request or response dropped",
              {{"service", service}, {"dropped", std::to_string(count)}, {"why", why}});
}

Errc ServiceRoutes::apply(const ServicePlan& plan) {
  std::erase_if(served_, [&](const auto& route) {
    if (plan.served.contains(route.first)) return false;
    served_by_.erase(route.second.requests.get());
    keeping_.erase(route.first);
    for (const Kept& kept : route.second.kept)
      kept_bytes_ -= held_bytes_of(kept.request->bytes.size());
    deleter_.end(route.second.answering);
    return true;
  });
  std::erase_if(asked_, [&](const auto& route) {
    const auto wanted = plan.asked.find(route.first);
    if (wanted != plan.asked.end() && !is_in_vain(*route.second.asking, wanted->second.servers))
      return false;
    asked_by_.erase(route.second.responses.get());
    deleter_.end(route.second.asking);
    return true;
  });
  const auto type_of_service = [&](const ServiceKey& key) {
    return BridgedService{types_.at(key.type + "_Request"), types_.at(key.type + "_Response")};
  };
  refusal_ = Errc::ok;
  for (const auto& [key, route] : plan.served) {
    if (refusal_ != Errc::daemon_not_running && !served_.contains(key))
      serve(key, route, type_of_service(key));
    if (const auto open = served_.find(key); open != served_.end()) {
      open->second.plan = route;
      open->second.next_look = {};  // new endpoints may be reply routes of kept requests
    }
  }
  for (const auto& [key, route] : plan.asked) {
    if (refusal_ != Errc::daemon_not_running && !asked_.contains(key))
      ask(key, route, type_of_service(key));
    if (const auto open = asked_.find(key); open != asked_.end()) {
      open->second.plan = route;
      const std::lock_guard lock(open->second.asking->mutex);
      open->second.asking->servers = route.servers;
    }
  }
  return refusal_;
}

void ServiceRoutes::refuse(const std::string& what, const Failure& why) {
  refusals_.note(what, text_of(why));
  refusal_ = why.code;
}

DdsResult<ServiceRoutes::Ends> ServiceRoutes::make_ends(const ServiceKey& key, ServiceRole role) {
  const RawDecoder keep = [](RawPieces pieces) -> std::shared_ptr<void> {
    auto raw = std::make_shared<Raw>();
    for (const auto& piece : pieces)
      raw->bytes.insert(raw->bytes.end(), piece.begin(), piece.end());
    return raw;
  };
  Ends ends;
  ends.id = participant_.guid();
  ++ids_;
  for (std::size_t i = 0; i < 4; ++i)
    ends.id.bytes[12 + i] = static_cast<std::uint8_t>(ids_ >> (24 - 8 * i));
  const DdsQos qos = qos_with(service_user_data(role, ends.id));
  const std::string request_topic = *dds_topic_of({DdsTopicKind::request, key.service});
  const std::string reply_topic = *dds_topic_of({DdsTopicKind::reply, key.service});
  const std::string request_type = *dds_type_of(key.type + "_Request");
  const std::string reply_type = *dds_type_of(key.type + "_Response");
  const bool is_server = role == ServiceRole::server;
  auto writer = participant_.create_writer(is_server ? reply_topic : request_topic,
                                           is_server ? reply_type : request_type, qos);
  if (!writer) return tl::unexpected(writer.error());
  auto reader = participant_.create_reader(is_server ? request_topic : reply_topic,
                                           is_server ? request_type : reply_type, qos, keep,
                                           most_of(Limit::request_bytes_of_service));
  if (!reader) return tl::unexpected(reader.error());
  ends.writer = std::move(*writer);
  ends.reader = std::move(*reader);
  return ends;
}

void ServiceRoutes::serve(const ServiceKey& key, const ServiceRoute& route,
                          const BridgedService& type) {
  auto client = try_create_generic_client(node_, key.service, type.introspected(), service_qos());
  if (!client) return refuse("client of " + key.service, client.error());
  auto ends = make_ends(key, ServiceRole::server);
  if (!ends) return refusals_.note("server of " + key.service + " in DDS", ends.error().text());
  Served& served = served_[key];
  served.plan = route;
  served.answering = std::make_shared<Answering>();
  served.answering->type = type;
  served.answering->responses = std::move(ends->writer);
  served.answering->service = key.service;
  served.requests = std::move(ends->reader);
  served.client = std::move(*client);
  served_by_[served.requests.get()] = key;
}

void ServiceRoutes::ask(const ServiceKey& key, const ServiceRoute& route,
                        const BridgedService& type) {
  auto ends = make_ends(key, ServiceRole::client);
  if (!ends) return refusals_.note("client of " + key.service + " in DDS", ends.error().text());
  auto asking = std::make_shared<Asking>();
  asking->type = type;
  asking->requests = std::move(ends->writer);
  asking->client_id = GuidHash()(ends->id);
  asking->servers = route.servers;
  asking->service = key.service;
  auto service = try_create_generic_service(
      node_, key.service, type.introspected(),
      [asking, &log = log_](const GenericServiceRequest& request) {
        try {
          write_request(log, *asking, request);
        } catch (const std::exception& error) {
          dropped(log, asking->traffic, asking->traffic.refused, asking->service, error.what());
        }
      },
      service_qos());
  if (!service) return refuse("service " + key.service, service.error());
  asked_by_[ends->reader.get()] = key;
  asked_[key] = {route, std::move(asking), std::move(ends->reader), std::move(*service)};
}

void ServiceRoutes::move(std::span<DdsReader* const> ready) {
  for (DdsReader* const reader : ready) {
    if (const auto key = served_by_.find(reader); key != served_by_.end()) {
      keep_requests(key->second);
    } else if (const auto other = asked_by_.find(reader); other != asked_by_.end()) {
      take_responses(asked_.at(other->second));
    }
  }
}

void ServiceRoutes::keep_requests(const ServiceKey& key) {
  Served& served = served_.at(key);
  for (std::size_t i = 0; i < takes_max; ++i) {
    const auto sample = served.requests->take();
    if (!sample) break;
    if (sample->state != DdsSample::State::valid) continue;
    if (!keep(served, std::static_pointer_cast<Raw>(sample->object), sample->writer)) {
      ServiceTraffic& traffic = served.answering->traffic;
      dropped(log_, traffic, traffic.refused, key.service, "too many requests at once");
      continue;
    }
    keeping_.insert(key);
    if (served.has_room) served.next_look = {};
  }
}

bool ServiceRoutes::keep(Served& served, std::shared_ptr<Raw> request, const Guid& writer) {
  const std::size_t bytes = held_bytes_of(request->bytes.size());
  if (kept_bytes_ + bytes > held_bytes_max) return false;
  if (served.kept.size() >= most_of(Limit::requests)) {
    participant_.limits().refuse(Limit::requests);
    if (!make_place(served, participant_of(writer))) return false;
  }
  if (!served.kept.empty() &&
      served.kept_bytes + bytes > most_of(Limit::request_bytes_of_service)) {
    participant_.limits().refuse(Limit::request_bytes_of_service);
    return false;
  }
  served.kept.push_back({std::move(request), writer, std::chrono::steady_clock::now() + patience});
  ++served.kept_of[participant_of(writer)];
  served.kept_bytes += bytes;
  kept_bytes_ += bytes;
  return true;
}

bool ServiceRoutes::make_place(Served& served, const Guid& client) {
  const auto most =
      std::max_element(served.kept_of.begin(), served.kept_of.end(),
                       [](const auto& a, const auto& b) { return a.second < b.second; });
  const auto own = served.kept_of.find(client);
  const std::size_t own_count = own == served.kept_of.end() ? 0 : own->second;
  if (most == served.kept_of.end() || most->second <= own_count + 1) return false;
  const auto newest = std::find_if(served.kept.rbegin(), served.kept.rend(), [&](const Kept& kept) {
    return participant_of(kept.writer) == most->first;
  });
  ServiceTraffic& traffic = served.answering->traffic;
  dropped(log_, traffic, traffic.refused, served.answering->service, "too many requests at once");
  if (served.next && served.next->request == newest->request) served.next.reset();
  forget(served, *newest);
  served.kept.erase(std::next(newest).base());
  return true;
}

void ServiceRoutes::forget(Served& served, const Kept& kept) {
  const std::size_t bytes = held_bytes_of(kept.request->bytes.size());
  kept_bytes_ -= bytes;
  served.kept_bytes -= bytes;
  if (const auto of_client = served.kept_of.find(participant_of(kept.writer));
      of_client != served.kept_of.end() && --of_client->second == 0)
    served.kept_of.erase(of_client);
}

void ServiceRoutes::take_responses(Asked& asked) {
  for (std::size_t i = 0; i < takes_max; ++i) {
    const auto sample = asked.responses->take();
    if (!sample) break;
    if (sample->state != DdsSample::State::valid) continue;
    try {
      answer(asked, *std::static_pointer_cast<Raw>(sample->object));
    } catch (const std::exception& error) {
      ServiceTraffic& traffic = asked.asking->traffic;
      dropped(log_, traffic, traffic.refused, asked.asking->service, error.what());
    }
  }
}

std::optional<Time> ServiceRoutes::send_kept(Time now) {
  std::optional<Time> next;
  std::erase_if(keeping_, [&](const ServiceKey& key) {
    Served& served = served_.at(key);
    if (served.next_look <= now) {
      served.interval = retry_interval_after(served.interval, look_at_kept(served, now));
      served.next_look = now + served.interval;
    }
    if (served.kept.empty()) return true;
    next = std::min(next.value_or(served.next_look), served.next_look);
    return false;
  });
  return next;
}

// In order, except for requests whose clients cannot be answered yet: these block no others.
bool ServiceRoutes::look_at_kept(Served& served, Time now) {
  const auto answering = served.answering;
  ServiceTraffic& traffic = answering->traffic;
  const auto drop_after = [&](Time end, ServiceTraffic::Counter& reason, const char* why) {
    if (now <= end) return false;
    dropped(log_, traffic, reason, answering->service, why);
    return true;
  };
  bool has_server = served.client->service_is_ready(), any = false;
  served.has_room = true;
  std::optional<std::vector<std::uint64_t>> matched;
  std::map<std::pair<Guid, std::string_view>, bool> ways;  // reply routes, by client
  const auto has_way = [&](const Guid& writer) {
    const auto client = participant_.remotes().find(writer);
    if (client == participant_.remotes().end()) return true;
    const auto [way, is_new] =
        ways.try_emplace({client->second.participant, client->second.qos.user_data});
    if (is_new) {
      if (!matched) matched = answering->responses->matched_readers();
      way->second = can_be_answered(served, client->second, *matched);
    }
    return way->second;
  };
  const auto is_done = [&](const Kept& kept) {
    if (has_server && served.has_room && has_way(kept.writer)) {
      const Sent sent = served.pending.has_room(now) ? send_on(served, kept, now) : Sent::no_room;
      has_server = sent != Sent::no_server;
      served.has_room = sent != Sent::no_room;
      any = any || sent == Sent::sent;
      if (sent == Sent::sent || sent == Sent::dropped) return true;
    }
    if (has_server && !served.has_room)
      return drop_after(std::max(kept.end, served.pending.newest() + PendingRequests::patience),
                        traffic.refused, "the server takes no more");
    return drop_after(kept.end, traffic.timed_out, "no route to the server and back");
  };
  std::erase_if(served.kept, [&](const Kept& kept) {
    if (!is_done(kept)) return false;
    forget(served, kept);
    if (served.next && served.next->request == kept.request) served.next.reset();
    return true;
  });
  return any;
}

bool ServiceRoutes::can_be_answered(Served& served, const Remote& client,
                                    std::span<const std::uint64_t> matched) const {
  if (served.ways_back_at != participant_.remotes_version()) {
    served.ways_back_at = participant_.remotes_version();
    served.ways_back.clear();
    const std::string replies = *dds_topic_of({DdsTopicKind::reply, served.answering->service});
    for (const auto& [guid, remote] : participant_.remotes()) {
      if (remote.kind == Remote::Kind::reader && remote.topic == replies)
        served.ways_back.emplace(
            std::pair(remote.participant, remote.qos.user_data),  // its clientid
            remote.instance);
    }
  }
  const auto [begin, end] =
      served.ways_back.equal_range({client.participant, client.qos.user_data});
  return std::any_of(begin, end, [&](const auto& way) {
    return std::binary_search(matched.begin(), matched.end(), way.second);
  });
}

ServiceRoutes::Sent ServiceRoutes::send_on(Served& served, const Kept& kept, Time now) try {
  const auto answering = served.answering;
  ServiceTraffic& traffic = answering->traffic;
  if (!served.next || served.next->request != kept.request) {
    served.next.reset();
    Decoded decoded{kept.request, {}, served.client->borrow_loaned_request()};
    const std::span<const std::byte> piece(kept.request->bytes);
    const auto read = read_service_cdr(answering->type.request->cdr, {&piece, 1}, decoded.header,
                                       decoded.loan.get());
    (void)served.client->pause(decoded.loan.handle());
    if (!read) {
      dropped(log_, traffic, traffic.malformed, answering->service, read.error().text());
      return Sent::dropped;
    }
    served.next = std::move(decoded);
  }
  const auto header = std::make_shared<const ServiceHeader>(served.next->header);
  const auto sent = served.client->try_async_send_request(
      std::move(served.next->loan),
      [answering, header, &log = log_](const GenericClient::SharedFuture& future) {
        ServiceTraffic& counts = answering->traffic;
        try {
          const GenericMessage& response = future.get();
          const BridgedType& type = *answering->type.response;
          const WindowSet within = windows_of(response);
          const std::size_t bytes = service_cdr_bytes(type.cdr, response.get(), &within);
          const auto written =
              write(*answering->responses, type, *header, response.get(), bytes, within);
          if (written && *written == WriteOutcome::sent) {
            counts.count_response(bytes);
          } else {
            dropped(log, counts, counts.refused, answering->service, why_not(written));
          }
        } catch (const std::exception& error) {
          dropped(log, counts, counts.refused, answering->service, error.what());
        }
      });
  if (sent) {
    traffic.count_request(kept.request->bytes.size());
    const auto oldest = served.pending.add(sent->request_id, header, now);
    if (oldest && served.client->remove_pending_request(*oldest)) ++traffic.forgotten;
    return Sent::sent;
  }
  if (sent.error().code == Errc::no_server) return Sent::no_server;
  if (sent.error().code == Errc::would_block) return Sent::no_room;
  dropped(log_, traffic, traffic.refused, answering->service, text_of(sent.error()));
  return Sent::dropped;
} catch (const std::exception& error) {
  ServiceTraffic& traffic = served.answering->traffic;
  dropped(log_, traffic, traffic.refused, served.answering->service, error.what());
  return Sent::dropped;
}

// The clients learn that the service has ended because the route is made again; other pending
// requests end, too.
bool ServiceRoutes::is_in_vain(Asking& asking, const std::set<Guid>& servers) {
  const std::lock_guard lock(asking.mutex);
  return std::any_of(asking.pending.begin(), asking.pending.end(), [&](const auto& entry) {
    const std::set<Guid>& had = entry.second.servers;
    return std::none_of(had.begin(), had.end(),
                        [&](const Guid& server) { return servers.contains(server); });
  });
}

void ServiceRoutes::write_request(const Log& log, Asking& asking,
                                  const GenericServiceRequest& request) {
  GenericServiceRequest to_answer = request;
  to_answer.release();
  std::int64_t number = 0;
  {
    const std::lock_guard lock(asking.mutex);
    number = ++asking.newest;
    if (asking.pending.size() >= requests_max) {
      asking.pending.erase(asking.pending.begin());
      ++asking.traffic.forgotten;
    }
    asking.pending[number] = {std::move(to_answer), asking.servers};
  }
  const BridgedType& type = *asking.type.request;
  const void* const body = request.message().get();
  const WindowSet within = windows_of(request.message());
  const std::size_t bytes = service_cdr_bytes(type.cdr, body, &within);
  const auto written =
      write(*asking.requests, type, {asking.client_id, number}, body, bytes, within);
  if (written && *written == WriteOutcome::sent) return asking.traffic.count_request(bytes);
  dropped(log, asking.traffic, asking.traffic.refused, asking.service, why_not(written));
  const std::lock_guard lock(asking.mutex);
  asking.pending.erase(number);
}

void ServiceRoutes::answer(Asked& asked, const Raw& raw) {
  Asking& asking = *asked.asking;
  const auto received = header_of(raw.bytes);
  if (!received)
    return dropped(log_, asking.traffic, asking.traffic.malformed, asking.service,
                   "it has no client id and number");
  if (received->client_id != asking.client_id) return;  // all clients of a service share the topic
  {
    // Another server was faster, or the request never existed.
    const std::lock_guard lock(asking.mutex);
    if (!asking.pending.contains(received->sequence_number)) return void(++asking.traffic.unasked);
  }
  ServiceHeader header;
  auto response = asked.service->borrow_loaned_response();
  const std::span<const std::byte> piece(raw.bytes);
  const auto read =
      read_service_cdr(asking.type.response->cdr, {&piece, 1}, header, response.get());
  if (!read)
    return dropped(log_, asking.traffic, asking.traffic.malformed, asking.service,
                   read.error().text());
  GenericServiceRequest request;
  {
    const std::lock_guard lock(asking.mutex);
    const auto found = asking.pending.find(header.sequence_number);
    if (found == asking.pending.end()) return void(++asking.traffic.unasked);
    request = std::move(found->second.request);
    asking.pending.erase(found);
  }
  const PublishResult sent = asked.service->send_response(request, std::move(response));
  if (sent) return asking.traffic.count_response(raw.bytes.size());
  dropped(log_, asking.traffic, asking.traffic.refused, asking.service, sentence_of(sent.code));
}

void ServiceRoutes::tell(const NodesByName& nodes) const {
  const auto add = [&](const ServiceRoute& route, const DdsReader& reader,
                       const DdsWriter& writer) {
    for (const std::string& name : route.nodes) {
      const auto node = nodes.find(name);
      if (node == nodes.end()) continue;
      node->second->readers.push_back(reader.guid());
      node->second->writers.push_back(writer.guid());
    }
  };
  for (const auto& [key, served] : served_)
    add(served.plan, *served.requests, *served.answering->responses);
  for (const auto& [key, asked] : asked_)
    add(asked.plan, *asked.responses, *asked.asking->requests);
}

std::vector<BridgeStatus::ServiceNow> ServiceRoutes::look() const {
  std::vector<BridgeStatus::ServiceNow> list;
  const auto add = [&](const ServiceKey& key, Direction way, const ServiceRoute& plan,
                       const DdsReader& reader, const DdsWriter& writer,
                       const ServiceTraffic& traffic) {
    list.push_back({key, way, plan.nodes, reader.guid(), writer.guid(), reader.matched(),
                    writer.matched(), traffic.numbers()});
  };
  for (const auto& [key, served] : served_)
    add(key, Direction::outward, served.plan, *served.requests, *served.answering->responses,
        served.answering->traffic);
  for (const auto& [key, asked] : asked_)
    add(key, Direction::inward, asked.plan, *asked.responses, *asked.asking->requests,
        asked.asking->traffic);
  return list;
}

}  // namespace agnocast::bridge
