// SPDX-License-Identifier: Apache-2.0

#include <daemon/transport/request_reading.hpp>

#include <agnocast/abi/limits.hpp>
#include <base/text/log.hpp>
#include <base/text/names.hpp>
#include <base/text/text.hpp>

#include <algorithm>
#include <cinttypes>
#include <cstdio>
#include <cstring>
#include <iterator>

namespace agnocast::daemon {
namespace {

using Packet = std::span<const std::byte>;

constexpr std::uint64_t generation_max = (std::uint64_t{1} << 48) - 1;

template <class Body>
Body raw_body_of(Packet packet) noexcept {
  Body body;
  std::memcpy(static_cast<void*>(&body), packet.data(), sizeof body);
  return body;
}
template <class Body>
Body body_of(Packet packet) noexcept {
  auto body = raw_body_of<Body>(packet);
  body.header.request &= ~wire::asked_again;
  return body;
}
bool is_asked_again(Packet packet) noexcept {
  return (raw_body_of<wire::Header>(packet).request & wire::asked_again) != 0;
}

Rejected refuse(const wire::Header& header, Errc code, std::string text) {
  return {header.request, code, std::move(text), false};
}

// Returns what is wrong with an index or generation; null: nothing. A region has no `topic`.
const char* check_reference(wire::Kind kind, std::uint32_t topic, std::uint64_t index,
                            std::uint64_t generation, bool region_allowed) noexcept {
  if (generation == 0 || generation > generation_max) return "a generation is out of range";
  switch (kind) {
    case wire::Kind::publisher:
      if (index >= abi::publisher_count_max) return "a publisher's index is out of range";
      break;
    case wire::Kind::subscription:
      if (index >= abi::subscription_count_max) return "a subscription's index is out of range";
      break;
    case wire::Kind::region:
      if (!region_allowed) return "this request does not apply to a region";
      if (index >= abi::client_count_max) return "a process's index is out of range";
      return nullptr;
    default:
      return "an unknown kind of endpoint";
  }
  return topic < abi::topic_count_max ? nullptr : "a topic's index is out of range";
}

Request decode_hello(Packet packet) {
  const auto hello = body_of<wire::Hello>(packet);
  std::string_view name;
  if (!text_of(hello.process_name, name))
    return refuse(hello.header, Errc::protocol_violation, "the name of the process does not end");
  return hello;
}

Request decode_rejoin(Packet packet) {
  const auto body = body_of<wire::Rejoin>(packet);
  if (body.client >= abi::client_count_max)
    return refuse(body.header, Errc::protocol_violation, "a process's index is out of range");
  return body;
}

Request decode_window(Packet packet) {
  const auto body = body_of<wire::WindowRequest>(packet);
  if (body.window >= abi::window_count_max)
    return refuse(body.header, Errc::window_exhausted,
                  "a process has at most " + std::to_string(abi::window_count_max) + " windows");
  return body;
}

Request decode_bring(Packet packet) {
  const auto body = body_of<wire::BringWindow>(packet);
  if (body.window >= abi::window_count_max || body.first > body.window)
    return refuse(body.header, Errc::protocol_violation, "a window's number is out of range");
  return body;
}

Request decode_wait_set(Packet packet) {
  const auto body = body_of<wire::WaitSetRequest>(packet);
  if (body.wait_set >= abi::wait_set_count_max)
    return refuse(
        body.header, Errc::limit_reached,
        "a process has at most " + std::to_string(abi::wait_set_count_max) + " wait sets");
  return WaitSetRequest{is_asked_again(packet), body.header.request, body.wait_set};
}

/// Returns a node's full name: with a slash in front.
std::string absolute(std::string_view node) {
  return std::string(node.starts_with('/') ? "" : "/") + std::string(node);
}

Request decode_create(Packet packet) {
  auto body = body_of<wire::CreateEndpoint>(packet);
  CreateRequest request;
  request.quota_or_less = (body.quota & wire::quota_or_less) != 0;
  body.quota &= ~wire::quota_or_less;
  request.again = is_asked_again(packet);
  request.kind = body.header.opcode == wire::Opcode::create_publisher ? wire::Kind::publisher
                                                                      : wire::Kind::subscription;
  request.request = body.header.request;
  request.layout_hash = body.layout_hash;
  request.wait_set = body.wait_set;
  request.quota = body.quota;
  if (body.domain != 0) request.domain = body.domain - 1;
  std::string_view topic, type, node;
  if (!text_of(body.topic, topic))
    return refuse(body.header, Errc::protocol_violation, "the name of the topic does not end");
  if (!text_of(body.type, type))
    return refuse(body.header, Errc::protocol_violation, "the name of the type does not end");
  if (!text_of(body.node, node))
    return refuse(body.header, Errc::protocol_violation, "the name of the node does not end");
  if (type.empty()) return refuse(body.header, Errc::invalid_argument, "the type has no name");
  if (!std::all_of(type.begin(), type.end(), [](char c) { return c >= ' ' && c <= '~'; }))
    return refuse(body.header, Errc::invalid_name,
                  "type " + in_quotes(type) + ": a character that cannot be printed");
  if (const auto problem = check_namespace(absolute(node)))
    return refuse(body.header, Errc::invalid_name,
                  "node " + in_quotes(node) + ": " + problem->text());
  if ((body.qos.policies & ~abi::policy_bits) != 0)
    return refuse(body.header, Errc::invalid_argument, "an unknown quality of service");
  request.qos = abi::unpack_qos(body.qos);
  if (request.qos.depth == 0 || request.qos.depth > abi::depth_max)
    return refuse(body.header, Errc::depth_refused,
                  "depth " + std::to_string(request.qos.depth) + " is outside 1 to " +
                      std::to_string(abi::depth_max));
  for (const std::uint64_t time :
       {request.qos.deadline_ns, request.qos.lifespan_ns, request.qos.lease_ns}) {
    if (time > abi::qos_time_max_ns)
      return refuse(body.header, Errc::invalid_argument, "a time of more than 292 years");
  }
  if (request.kind == wire::Kind::subscription && request.qos.lifespan_ns != 0)
    return refuse(body.header, Errc::invalid_argument, "only a publisher has a lifespan");
  if (request.kind == wire::Kind::publisher && request.qos.ignore_local)
    return refuse(body.header, Errc::invalid_argument,
                  "only a subscription can ignore publishers of its process");
  if (request.kind == wire::Kind::subscription) {
    if (body.wait_set >= abi::wait_set_count_max)
      return refuse(body.header, Errc::protocol_violation, "a wait set's index is out of range");
    if (body.quota == 0)
      return refuse(body.header, Errc::invalid_argument,
                    "a subscription must be able to hold one message");
    if (body.quota > abi::slot_count_max)
      return refuse(body.header, Errc::quota_exceeded,
                    "a subscription holds at most " + std::to_string(abi::slot_count_max) +
                        " messages, " + std::to_string(body.quota) + " are asked for");
  }
  request.topic = topic;
  request.type = type;
  request.node = node;
  return request;
}

template <class Wanted>
Request decode_reference(Packet packet) {
  const auto body = body_of<wire::Reference>(packet);
  const char* const wrong =
      check_reference(body.kind, body.topic, body.index, body.generation, false);
  if (wrong != nullptr) return refuse(body.header, Errc::protocol_violation, wrong);
  return Wanted{is_asked_again(packet), body};
}

Request decode_unlinked(Packet packet) {
  const auto body = body_of<wire::Unlinked>(packet);
  const char* const wrong =
      check_reference(body.kind, body.topic, body.index, body.generation, true);
  if (wrong != nullptr) return refuse(body.header, Errc::protocol_violation, wrong);
  return body;
}

Request decode_blocked(Packet packet) {
  const auto body = body_of<wire::Blocked>(packet);
  std::string_view what;
  if (!text_of(body.what, what))
    return refuse(body.header, Errc::protocol_violation,
                  "the text of a blocked range does not end");
  return body;
}

Request decode_withdrawn(Packet packet) {
  const auto body = body_of<wire::Withdrawn>(packet);
  const char* wrong = check_reference(wire::Kind::publisher, body.topic, body.publisher,
                                      body.publisher_generation, false);
  if (wrong == nullptr)
    wrong = check_reference(wire::Kind::subscription, body.topic, body.subscription,
                            body.subscription_generation, false);
  if (wrong == nullptr && body.why > static_cast<std::uint32_t>(abi::Withdrawal::not_attached))
    wrong = "an unknown reason";
  if (wrong != nullptr) return refuse(body.header, Errc::protocol_violation, wrong);
  return body;
}

Request decode_callback_group(Packet packet) {
  const auto body = body_of<wire::CallbackGroup>(packet);
  std::string_view node, name;
  if (!text_of(body.node, node) || !text_of(body.name, name))
    return refuse(body.header, Errc::protocol_violation,
                  "the name of a callback group or its node does not end");
  return body;
}

Request decode_callback_thread(Packet packet) {
  const auto body = body_of<wire::CallbackThread>(packet);
  if (body.thread == 0 || body.thread > INT32_MAX)
    return refuse(body.header, Errc::protocol_violation, "a thread's id is out of range");
  return body;
}

// Accepts any numbers: those of another table are answered with this one.
Request decode_watch_graph(Packet packet) { return body_of<wire::WatchGraph>(packet); }
Request decode_observe(Packet packet) { return body_of<wire::Observe>(packet); }
Request decode_dump(Packet packet) { return body_of<wire::Dump>(packet); }
// Accepts any numbers: records that do not exist are not sent.
Request decode_read_journal(Packet packet) { return body_of<wire::ReadJournal>(packet); }

Request decode_revoke(Packet packet) {
  const auto body = body_of<wire::Revoke>(packet);
  const char* const wrong =
      check_reference(wire::Kind::region, 0, body.client, body.generation, true);
  if (wrong != nullptr) return refuse(body.header, Errc::protocol_violation, wrong);
  return body;
}

Request decode_set_log_level(Packet packet) {
  const auto body = body_of<wire::SetLogLevel>(packet);
  if (body.level != 0 && (body.level < static_cast<std::uint64_t>(LogLevel::error) ||
                          body.level > static_cast<std::uint64_t>(LogLevel::debug)))
    return refuse(body.header, Errc::invalid_argument, "an unknown log level");
  return body;
}

Request decode_ask_access(Packet packet) {
  const auto body = body_of<wire::AskAccess>(packet);
  std::string_view topic;
  if (!text_of(body.topic, topic))
    return refuse(body.header, Errc::protocol_violation, "the name of the topic does not end");
  return body;
}

struct Row {
  wire::Opcode opcode;
  std::size_t bytes;
  Role role;  // role of a connection that may send it
  Request (*decode)(Packet packet);
  std::size_t descriptors = 0;  // descriptors that come with it
};

constexpr Row rows[] = {
    {wire::Opcode::hello, sizeof(wire::Hello), Role::unknown, decode_hello},
    {wire::Opcode::rejoin, sizeof(wire::Rejoin), Role::unknown, decode_rejoin},
    {wire::Opcode::open_window, sizeof(wire::WindowRequest), Role::client, decode_window},
    {wire::Opcode::open_wait_set, sizeof(wire::WaitSetRequest), Role::client, decode_wait_set},
    {wire::Opcode::create_publisher, sizeof(wire::CreateEndpoint), Role::client, decode_create},
    {wire::Opcode::create_subscription, sizeof(wire::CreateEndpoint), Role::client, decode_create},
    {wire::Opcode::leave, sizeof(wire::Reference), Role::client, decode_reference<LeaveRequest>},
    {wire::Opcode::drained, sizeof(wire::Reference), Role::client,
     decode_reference<DrainedRequest>},
    {wire::Opcode::unlinked, sizeof(wire::Unlinked), Role::client, decode_unlinked},
    {wire::Opcode::blocked, sizeof(wire::Blocked), Role::client, decode_blocked},
    {wire::Opcode::withdrawn, sizeof(wire::Withdrawn), Role::client, decode_withdrawn},
    {wire::Opcode::callback_group, sizeof(wire::CallbackGroup), Role::client,
     decode_callback_group},
    {wire::Opcode::callback_thread, sizeof(wire::CallbackThread), Role::client,
     decode_callback_thread},
    {wire::Opcode::bring_window, sizeof(wire::BringWindow), Role::client, decode_bring, 1},
    {wire::Opcode::watch_graph, sizeof(wire::WatchGraph), Role::client, decode_watch_graph},
    {wire::Opcode::observe, sizeof(wire::Observe), Role::unknown, decode_observe},
    {wire::Opcode::dump, sizeof(wire::Dump), Role::observer, decode_dump},
    {wire::Opcode::revoke, sizeof(wire::Revoke), Role::observer, decode_revoke},
    {wire::Opcode::read_journal, sizeof(wire::ReadJournal), Role::observer, decode_read_journal},
    {wire::Opcode::set_log_level, sizeof(wire::SetLogLevel), Role::observer, decode_set_log_level},
    {wire::Opcode::ask_access, sizeof(wire::AskAccess), Role::observer, decode_ask_access},
};

// Returns why a connection in this role must not send that.
const char* out_of_place(Role role, wire::Opcode opcode) noexcept {
  if (role == Role::unknown) return "the first request must be hello";
  if (role == Role::observer) return "an observer may not take part";
  if (opcode == wire::Opcode::hello) return "hello may be sent only once";
  return opcode == wire::Opcode::rejoin
             ? "this connection has a client already"
             : "a client may not observe; an observer needs a connection of its own";
}

}  // namespace

Request decode(std::span<const std::byte> packet, const Envelope& envelope, Role role) {
  const auto end = [](std::uint64_t request, const char* text) {
    return Rejected{request, Errc::protocol_violation, text, true};
  };
  if (packet.size() < sizeof(wire::Header)) return end(0, "a packet is shorter than its header");
  auto header = raw_body_of<wire::Header>(packet);
  header.request &= ~wire::asked_again;
  if (envelope.truncated) return end(header.request, "a packet is too long");
  if (header.bytes != packet.size())
    return end(header.request, "the length of a packet differs from its header");
  const Row* const row = std::find_if(std::begin(rows), std::end(rows),
                                      [&](const Row& r) { return r.opcode == header.opcode; });
  const std::size_t wanted = row != std::end(rows) ? row->descriptors : 0;
  if (envelope.descriptor_count != wanted || envelope.descriptors_lost)
    return refuse(header, Errc::protocol_violation,
                  wanted == 0 ? "descriptors came with a request"
                              : "a window that is brought comes with one descriptor");
  if (row == std::end(rows))
    return refuse(header, Errc::protocol_violation,
                  "unknown request " + std::to_string(static_cast<std::uint32_t>(header.opcode)));
  const bool introduces =
      header.opcode == wire::Opcode::hello || header.opcode == wire::Opcode::rejoin;
  if (introduces && packet.size() != row->bytes)
    return refuse(header, Errc::layout_mismatch,
                  std::string("the library's ") +
                      (header.opcode == wire::Opcode::hello ? "hello" : "rejoin") + " has " +
                      std::to_string(packet.size()) + " bytes, the daemon's has " +
                      std::to_string(row->bytes));
  if (packet.size() != row->bytes)
    return refuse(header, Errc::protocol_violation,
                  "a request of " + std::to_string(packet.size()) + " bytes should have " +
                      std::to_string(row->bytes));
  if (role != row->role)
    return refuse(header, Errc::protocol_violation, out_of_place(role, header.opcode));
  return row->decode(packet);
}

bool text_of(const wire::Name& name, std::string_view& text) noexcept {
  const void* const end = std::memchr(name.text, 0, sizeof name.text);
  if (end == nullptr) return false;
  text = {name.text, static_cast<std::size_t>(static_cast<const char*>(end) - name.text)};
  return true;
}

wire::Name name_of(std::string_view text) noexcept {
  wire::Name name{};
  std::memcpy(name.text, text.data(), std::min(text.size(), sizeof name.text - 1));
  return name;
}

wire::Name copy_of(const char (&text)[wire::name_bytes]) noexcept {
  wire::Name name{};
  std::memcpy(name.text, text, sizeof name.text - 1);
  return name;
}

std::string printable(std::string_view text) {
  std::string result(text);
  for (char& c : result) {
    if (c < ' ' || c > '~') c = '?';
  }
  return result;
}

std::string hexadecimal(std::uint64_t value) {
  char text[32];
  std::snprintf(text, sizeof text, "0x%016" PRIx64, value);
  return text;
}

std::uint64_t request_id_of(const Request& request) noexcept {
  return std::visit(
      [](const auto& body) -> std::uint64_t {
        if constexpr (requires { body.header; })
          return body.header.request;
        else if constexpr (requires { body.reference; })
          return body.reference.header.request;
        else
          return body.request;
      },
      request);
}

}  // namespace agnocast::daemon
