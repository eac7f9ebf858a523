// SPDX-License-Identifier: Apache-2.0

#include <ctl/snapshot/bridges.hpp>

#include <base/clock.hpp>
#include <base/descriptors/unique_fd.hpp>
#include <base/sockets/unix_address.hpp>
#include <base/text/text.hpp>

#include <poll.h>
#include <sys/socket.h>

#include <algorithm>
#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <limits>
#include <utility>

namespace agnocast::ctl {
namespace {

constexpr const char* systems_directory = "/run/agnocast-bridge";
// Enough for thousands of endpoints; and the bound of one text.
constexpr std::size_t answer_bytes_max = std::size_t{16} << 20;
constexpr std::size_t text_bytes_max = 4096;
constexpr std::uint64_t patience_ms = 5'000;

using Value = nlohmann::json;

tl::unexpected<Problem> problem_of(Status status, const std::string& path, const std::string& why) {
  return problem(status, "the bridge at " + escaped(path), why,
                 status == Status::permission_denied ? "agnocast-ctl doctor"
                                                     : "systemctl status 'agnocast-bridge*'");
}

/// Reads fields of an answer that another program wrote, and remembers whether one was not valid.
class Fields {
 public:
  explicit Fields(const Value& object) : object_(object) {}

  void operator()(const char* key, std::string& value) {
    const Value* const found = find(key);
    if (found == nullptr || !found->is_string() ||
        found->get_ref<const std::string&>().size() > text_bytes_max)
      return fail();
    value = found->get_ref<const std::string&>();
  }
  void operator()(const char* key, std::uint64_t& value) {
    const Value* const found = find(key);
    if (found == nullptr || !found->is_number_unsigned()) return fail();
    value = found->get<std::uint64_t>();
  }
  void operator()(const char* key, bool& value) {
    const Value* const found = find(key);
    if (found == nullptr || !found->is_boolean()) return fail();
    value = found->get<bool>();
  }
  void operator()(const char* key, std::optional<std::uint64_t>& value) {
    const Value* const found = find(key);
    if (found != nullptr && found->is_null()) return;
    (*this)(key, value.emplace());
  }
  void operator()(const char* key, BridgeQos& value) {
    const Value* const found = find(key);
    if (found == nullptr) return fail();
    Fields inner(*found);
    inner("reliability", value.reliability);
    inner("durability", value.durability);
    inner("history", value.history);
    inner("depth", value.depth);
    is_right_ &= inner.is_right();
  }
  void operator()(const char* key, std::vector<std::string>& value) {
    const Value* const found = find(key);
    if (found == nullptr || !found->is_array()) return fail();
    for (const Value& element : *found) {
      if (!element.is_string() || element.get_ref<const std::string&>().size() > text_bytes_max)
        return fail();
      value.push_back(element.get_ref<const std::string&>());
    }
  }
  /// Calls read(fields) for each object of a list.
  template <class Read>
  void each(const char* key, Read read) {
    const Value* const found = find(key);
    if (found == nullptr || !found->is_array()) return fail();
    for (const Value& element : *found) {
      Fields inner(element);
      read(inner);
      is_right_ &= inner.is_right();
    }
  }
  bool has(const char* key) const { return find(key) != nullptr; }
  bool is_right() const { return is_right_; }
  void fail() { is_right_ = false; }

 private:
  const Value* find(const char* key) const {
    if (!object_.is_object()) return nullptr;
    const auto found = object_.find(key);
    return found == object_.end() ? nullptr : &*found;
  }

  const Value& object_;
  bool is_right_ = true;
};

void read_traffic(Fields& fields, BridgeEndpoint& endpoint) {
  fields("topic", endpoint.topic);
  fields("type", endpoint.type);
  fields("node", endpoint.node);
  fields("guid", endpoint.guid);
  fields("qos", endpoint.qos);
  fields("messages", endpoint.messages);
  fields("bytes", endpoint.bytes);
  fields("unacknowledged", endpoint.unacknowledged);
  fields("refused", endpoint.refused);
  fields("age_ns", endpoint.age_ns);
  fields("last_age_ns", endpoint.last_age_ns);
}

bool read_way(Fields& fields) {
  std::string way;
  fields("direction", way);
  if (way != "out" && way != "in") fields.fail();
  return way == "out";
}

Outcome<std::string> read_text(const std::string& path) {
  const auto address = unix_address(path);
  if (!address) return problem_of(Status::failed, path, address.error().what);
  const UniqueFd socket(::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0));
  if (!socket) return problem_of(Status::failed, path, std::strerror(errno));
  // EAGAIN: its queue is full, so treat it as one that nobody listens at.
  if (::connect(socket.get(), address->get(), UnixAddress::size()) != 0)
    return problem_of(errno == EACCES ? Status::permission_denied : Status::not_reachable, path,
                      std::strerror(errno));
  const std::uint64_t end = monotonic_ms() + patience_ms;
  std::string text;
  std::vector<char> buffer(65536);
  for (;;) {
    const std::uint64_t now = monotonic_ms();
    if (now >= end) return problem_of(Status::timed_out, path, "it does not answer");
    pollfd polled{socket.get(), POLLIN, 0};
    if (::poll(&polled, 1, static_cast<int>(end - now)) <= 0) continue;
    const ssize_t count = ::recv(socket.get(), buffer.data(), buffer.size(), MSG_DONTWAIT);
    if (count < 0 && (errno == EINTR || errno == EAGAIN)) continue;
    if (count < 0) return problem_of(Status::failed, path, std::strerror(errno));
    if (count == 0) return text;
    text.append(buffer.data(), static_cast<std::size_t>(count));
    if (text.size() > answer_bytes_max)
      return problem_of(Status::failed, path, "its answer is too long for a bridge");
  }
}

/// Reads what a bridge says of itself.
void read_head(Fields& fields, BridgeState& state) {
  fields("version", state.version);
  fields("pid", state.pid);
  fields("domain", state.domain);
  fields("uptime_ns", state.uptime_ns);
  fields("discovery_info", state.discovery_info);
  fields("participants", state.participants);
  fields("has_daemon", state.has_daemon);
  // A bridge that omits these and, below, the counts of losses is active and lost nothing.
  if (fields.has("standby_for")) fields("standby_for", state.standby_for);
  if (fields.has("announced")) fields("announced", state.announced);
  if (fields.has("lost_early")) fields("lost_early", state.lost_early);
  if (fields.has("discovery_info_refused"))
    fields("discovery_info_refused", state.discovery_info_refused);
  if (fields.has("limits")) {
    fields.each("limits", [&](Fields& of) {
      BridgeState::Limit& limit = state.limits.emplace_back();
      of("limit", limit.limit);
      of("most", limit.most);
      of("refused", limit.refused);
    });
  }
}

/// Reads topics: on both sides, what flows and what is lost.
void read_endpoints(Fields& fields, BridgeState& state) {
  fields.each("dds_writers", [&](Fields& of) {
    BridgeEndpoint& endpoint = state.endpoints.emplace_back();
    read_traffic(of, endpoint);
    of("matched", endpoint.matched);
    of("incompatible", endpoint.incompatible);
  });
  fields.each("remote_publishers", [&](Fields& of) {
    BridgeEndpoint& endpoint = state.endpoints.emplace_back();
    endpoint.is_out = false;
    read_traffic(of, endpoint);
  });
  fields.each("dds_readers", [&](Fields& of) {
    BridgeDdsReader& dds_reader = state.dds_readers.emplace_back();
    of("topic", dds_reader.topic);
    of("type", dds_reader.type);
    of("guid", dds_reader.guid);
    of("nodes", dds_reader.nodes);
    of("qos", dds_reader.qos);
    of("matched", dds_reader.matched);
    of("incompatible", dds_reader.incompatible);
    of("malformed", dds_reader.malformed);
    if (of.has("without_remote_publisher"))
      of("without_remote_publisher", dds_reader.without_remote_publisher);
    if (of.has("overflow")) of("overflow", dds_reader.overflow);
  });
  fields.each("local_readers", [&](Fields& of) {
    BridgeLocalReader& local_reader = state.local_readers.emplace_back();
    of("topic", local_reader.topic);
    of("type", local_reader.type);
    of("qos", local_reader.qos);
    if (of.has("lost")) of("lost", local_reader.lost);
  });
}

/// Reads services and their counts.
void read_services(Fields& fields, BridgeState& state) {
  fields.each("services", [&](Fields& of) {
    BridgeService& service = state.services.emplace_back();
    of("service", service.service);
    of("type", service.type);
    service.is_out = read_way(of);
    of("nodes", service.nodes);
    of("reader_guid", service.reader_guid);
    of("writer_guid", service.writer_guid);
    of("matched_writers", service.matched_writers);
    of("matched_readers", service.matched_readers);
    of("requests", service.requests);
    of("request_bytes", service.request_bytes);
    of("responses", service.responses);
    of("response_bytes", service.response_bytes);
    of("malformed", service.malformed);
    of("refused", service.refused);
    of("timed_out", service.timed_out);
    of("forgotten", service.forgotten);
    if (of.has("unasked")) of("unasked", service.unasked);
    of("age_ns", service.age_ns);
    of("last_age_ns", service.last_age_ns);
  });
}

/// Reads what is not bridged, and what failed.
void read_lacks(Fields& fields, BridgeState& state) {
  fields.each("unbridged", [&](Fields& of) {
    BridgeLack& lack = state.unbridged.emplace_back();
    std::string kind;
    of("kind", kind);
    if (kind != "topic" && kind != "service") of.fail();
    lack.is_service = kind == "service";
    of("topic", lack.topic);
    of("type", lack.type);
    of("why", lack.why);
    of("detail", lack.detail);
    lack.is_out = read_way(of);
  });
  fields.each("failures", [&](Fields& of) {
    auto& [what, why] = state.failures.emplace_back();
    of("what", what);
    of("why", why);
  });
}

}  // namespace

std::vector<std::string> bridge_sockets(const std::string& daemon_socket) {
  if (const char* const named = ::secure_getenv("AGNOCAST_BRIDGE_SOCKET");
      named != nullptr && *named != '\0')
    return {named};
  std::vector<std::string> directories{std::filesystem::path(daemon_socket).parent_path().string()};
  if (daemon_socket == system_socket) directories.emplace_back(systems_directory);
  std::vector<std::string> sockets;
  for (const std::string& directory : directories) {
    std::error_code unreadable;
    for (const auto& entry : std::filesystem::directory_iterator(directory, unreadable)) {
      const std::string name = entry.path().filename().string();
      if (name.starts_with("bridge-") && name.ends_with(".sock"))
        sockets.push_back(entry.path().string());
    }
  }
  std::sort(sockets.begin(), sockets.end());
  return sockets;
}

Outcome<BridgeState> parse_bridge(std::string_view text, const std::string& path) {
  if (text.empty()) return problem_of(Status::timed_out, path, "it is busy or is ending");
  const Value json = Value::parse(text, nullptr, false);
  Fields fields(json);
  std::string schema;
  fields("schema", schema);
  if (schema != "agnocast.bridge-status/1")
    return problem_of(Status::failed, path, "its answer is not valid for a bridge of this version");
  BridgeState state;
  state.path = path;
  read_head(fields, state);
  read_endpoints(fields, state);
  read_services(fields, state);
  read_lacks(fields, state);
  if (!fields.is_right() || state.domain > domain_max)
    return problem_of(Status::failed, path, "its answer is not valid for a bridge of this version");
  return state;
}

Outcome<BridgeState> read_bridge(const std::string& path) {
  const auto text = read_text(path);
  if (!text) return tl::unexpected(text.error());
  return parse_bridge(*text, path);
}

Outcome<std::vector<BridgeState>> read_bridges(const Arguments& arguments) {
  std::vector<BridgeState> bridges;
  std::optional<Problem> first;
  for (const std::string& path : bridge_sockets(arguments.socket)) {
    auto bridge = read_bridge(path);
    if (bridge) {
      if (!arguments.has(options::domain) || bridge->domain == arguments.domain)
        bridges.push_back(std::move(*bridge));
    } else if (bridge.error().status != Status::not_reachable && !first) {
      first = bridge.error();
    }
  }
  if (bridges.empty() && first) return tl::unexpected(*first);
  if (bridges.empty()) {
    const bool of_domain = arguments.has(options::domain);
    const std::string domain = std::to_string(arguments.domain);
    return problem(Status::not_reachable,
                   of_domain ? "agnocast-bridge of domain " + domain : "agnocast-bridge",
                   "none runs for the daemon at " + escaped(arguments.socket),
                   arguments.socket == system_socket
                       ? "systemctl start agnocast-bridge" + (of_domain ? '@' + domain : "")
                       : "agnocast-bridge --socket " + escaped(arguments.socket) +
                             (of_domain ? " --domain " + domain : ""));
  }
  std::sort(bridges.begin(), bridges.end(),
            [](const BridgeState& a, const BridgeState& b) { return a.domain < b.domain; });
  return bridges;
}

}  // namespace agnocast::ctl
