// SPDX-License-Identifier: Apache-2.0
//
// Graph: an observer that requests dumps without regions, each answered once the daemon's log has
// advanced (include/agnocast/abi/observe.hpp). It trusts the daemon as every client does: indexes
// are only keys here, never places in memory, and a body of another length or an unknown kind
// ends the connection.

#include <agnocast/graph.hpp>

#include <agnocast/abi/fingerprint.hpp>
#include <agnocast/abi/words.hpp>
#include <base/descriptors/unique_fd.hpp>
#include <base/sockets/answer_packet.hpp>
#include <base/sockets/daemon_socket.hpp>
#include <base/sockets/socket_path.hpp>
#include <client/connection/connection.hpp>

#include <poll.h>
#include <sys/eventfd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <map>
#include <new>
#include <span>
#include <string_view>
#include <thread>
#include <utility>

namespace agnocast {
namespace {

namespace wire = abi::wire;
using wire::Opcode;
using Clock = std::chrono::steady_clock;
using std::chrono::milliseconds;

// A daemon under load answers within milliseconds.
constexpr milliseconds answer_patience{5'000};
// Combines changes: nodes come with a dozen endpoints each.
constexpr milliseconds gather_time{10};
// Longer than any useful wait, and short enough to be added to a time.
constexpr milliseconds patience_max = std::chrono::hours(24 * 365);
// A restarted daemon is back within some ten milliseconds.
constexpr milliseconds reconnect_interval{50};

std::string text_of(const wire::Name& name) {
  return {name.text, ::strnlen(name.text, sizeof name.text)};
}

QoS qos_of(const abi::QosWords& words) noexcept {
  const abi::Qos from = abi::unpack_qos(words);
  const auto time = [](std::uint64_t ns) {
    return std::chrono::nanoseconds(static_cast<std::int64_t>(std::min(ns, abi::qos_time_max_ns)));
  };
  QoS qos(from.depth);
  if (from.keep_all) qos.keep_all(from.depth);
  from.reliable ? qos.reliable() : qos.best_effort();
  if (from.transient_local) qos.transient_local();
  if (from.manual_liveliness) qos.liveliness(Liveliness::manual_by_topic);
  return qos.deadline(time(from.deadline_ns))
      .lifespan(time(from.lifespan_ns))
      .liveliness_lease_duration(time(from.lease_ns));
}

tl::unexpected<Failure> nonsense() noexcept {
  return fail(Errc::protocol_violation, "an answer from agnocastd");
}

bool takes_part(abi::BoardState state) noexcept { return state == abi::BoardState::active; }

}  // namespace

class Graph::State {
 public:
  State() : interrupted_(::eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC)) {
    if (!interrupted_) throw std::bad_alloc();
  }

  Result<std::optional<GraphSnapshot>> wait(milliseconds patience) {
    const Clock::time_point deadline = Clock::now() + std::min(patience, patience_max);
    for (;;) {
      auto snapshot = wait_connected(deadline);
      if (snapshot) return snapshot;
      socket_.close();
      const bool may_come = snapshot.error().code == Errc::daemon_not_running;
      if (!may_come || Clock::now() >= deadline) return snapshot;
      if (sleep_until(std::min(deadline, Clock::now() + reconnect_interval)))
        return std::optional<GraphSnapshot>();
    }
  }
  void interrupt() noexcept {
    const std::uint64_t one = 1;
    (void)!::write(interrupted_.get(), &one, sizeof one);  // if full, it is interrupted already
  }

 private:
  Result<std::optional<GraphSnapshot>> wait_connected(Clock::time_point deadline) {
    if (!socket_) {
      if (auto connected = connect(); !connected) return tl::unexpected(connected.error());
    }
    if (!is_asked_) {
      if (seen_lsn_ && sleep_until(looked_ + gather_time)) return std::optional<GraphSnapshot>();
      wire::Dump request{};
      request.without_regions = 1;
      request.waits = seen_lsn_ ? 1 : 0;
      request.seen = seen_lsn_.value_or(0);
      if (auto sent = send(Opcode::dump, request); !sent) return tl::unexpected(sent.error());
      is_asked_ = true;
    }
    const Result<bool> readable = wait_readable(
        seen_lsn_ ? deadline : Clock::now() + answer_patience, Stop::when_interrupted);
    if (!readable) return tl::unexpected(readable.error());
    if (!*readable) {
      if (seen_lsn_ || was_interrupted_) return std::optional<GraphSnapshot>();
      return fail(Errc::daemon_not_running, "agnocastd does not answer within 5 s", ETIMEDOUT);
    }
    auto snapshot = read_dump();
    if (!snapshot) return tl::unexpected(snapshot.error());
    is_asked_ = false;
    looked_ = Clock::now();
    return std::optional<GraphSnapshot>(std::move(*snapshot));
  }

  Result<void> connect() {
    is_asked_ = false;
    seen_lsn_.reset();
    packet_.begin({});
    auto socket = connect_to_daemon(socket_path());
    if (!socket) return tl::unexpected(socket.error());
    socket_ = std::move(*socket);
    wire::Observe hello{};
    hello.fingerprint = abi::fingerprint();
    if (auto sent = send(Opcode::observe, hello); !sent) return sent;
    if (auto body = next_body(); !body) return body;
    wire::Observed observed{};
    if (packet_.header().opcode != Opcode::observed || !packet_.read(observed)) return nonsense();
    return {};
  }

  template <class Body>
  Result<void> send(Opcode opcode, Body body) noexcept {
    body.header = {opcode, sizeof body, 1};
    const auto sent = socket_.send(std::as_bytes(std::span(&body, 1)), {}, Wait::yes);
    if (!sent) return tl::unexpected(sent.error());
    // A refused connection still has the refusal to read.
    return {};
  }

  /// Moves to the next body of an answer. Errors also: a refusal by the daemon.
  Result<void> next_body() {
    if (!packet_.advance()) {
      const Result<bool> readable = wait_readable(Clock::now() + answer_patience, Stop::never);
      if (!readable) return tl::unexpected(readable.error());
      auto packet = socket_.receive(packet_.buffer());
      if (!packet) return tl::unexpected(packet.error());
      if (packet->kind == Packet::Kind::nothing)
        return fail(Errc::daemon_not_running, "agnocastd does not answer within 5 s", ETIMEDOUT);
      if (packet->kind == Packet::Kind::end)
        return fail(Errc::daemon_not_running, "the connection to agnocastd has ended");
      if (packet->truncated) return nonsense();
      packet_.begin(std::move(*packet));
    }
    if (!packet_.is_whole()) return nonsense();
    if (packet_.header().opcode != Opcode::refused) return {};
    wire::Refused refused{};
    if (!packet_.read(refused)) return nonsense();
    return tl::unexpected(refusal_of(refused));
  }

  Result<GraphSnapshot> read_dump() {
    GraphSnapshot snapshot;
    std::map<std::uint64_t, wire::DumpProcess> processes;
    std::map<std::uint32_t, wire::DumpTopic> topics;
    for (;;) {
      if (auto body = next_body(); !body) return tl::unexpected(body.error());
      switch (packet_.header().opcode) {
        case Opcode::dump_daemon: {
          wire::DumpDaemon daemon{};
          if (!packet_.read(daemon)) return nonsense();
          snapshot.incarnation = daemon.incarnation;
          break;
        }
        case Opcode::dump_process: {
          wire::DumpProcess process{};
          if (!packet_.read(process)) return nonsense();
          processes[process.client] = process;
          break;
        }
        case Opcode::dump_topic: {
          wire::DumpTopic topic{};
          if (!packet_.read(topic)) return nonsense();
          topics[topic.topic] = topic;
          break;
        }
        case Opcode::dump_endpoint: {
          wire::DumpEndpoint endpoint{};
          if (!packet_.read(endpoint)) return nonsense();
          const auto topic = topics.find(endpoint.topic);
          if (topic == topics.end()) return nonsense();
          const auto process = processes.find(endpoint.client);
          if (process == processes.end() ||
              process->second.generation != endpoint.client_generation ||
              !takes_part(abi::state_of(endpoint.board_word)))
            break;
          snapshot.endpoints.push_back(info_of(endpoint, topic->second, process->second));
          break;
        }
        case Opcode::dump_user:
        case Opcode::dump_refusal:
          break;
        case Opcode::dump_end: {
          wire::DumpEnd end{};
          if (!packet_.read(end)) return nonsense();
          seen_lsn_ = end.lsn;
          return snapshot;
        }
        default:
          return nonsense();
      }
    }
  }

  static EndpointInfo info_of(const wire::DumpEndpoint& endpoint, const wire::DumpTopic& topic,
                              const wire::DumpProcess& process) {
    EndpointInfo info;
    info.kind = endpoint.kind == wire::Kind::publisher ? EndpointKind::publisher
                                                       : EndpointKind::subscription;
    info.domain = topic.domain;
    info.topic = text_of(topic.name);
    info.type = text_of(topic.type);
    info.layout_hash = topic.layout_hash;
    const std::string node = text_of(endpoint.node);
    const std::size_t slash = node.rfind('/');
    info.node_name = slash == std::string::npos ? node : node.substr(slash + 1);
    info.node_namespace = slash == std::string::npos || slash == 0 ? "/" : node.substr(0, slash);
    info.qos = qos_of(endpoint.qos);
    info.generation = endpoint.generation;
    info.pid = process.pid;
    info.uid = process.uid;
    info.client = process.generation;
    info.process_name = text_of(process.name);
    return info;
  }

  enum class Stop : std::uint8_t { never, when_interrupted };
  /// Returns whether there is something to read before the deadline. An answer is not interrupted
  /// half way.
  Result<bool> wait_readable(Clock::time_point deadline, Stop stop) {
    was_interrupted_ = false;
    std::array<pollfd, 2> entries{{{socket_.fd(), POLLIN, 0}, {interrupted_.get(), POLLIN, 0}}};
    for (;;) {
      const auto left = std::chrono::ceil<milliseconds>(deadline - Clock::now()).count();
      const int ready = ::poll(entries.data(), stop == Stop::never ? 1 : entries.size(),
                               static_cast<int>(std::clamp<std::int64_t>(left, 0, 1'000'000'000)));
      if (ready < 0 && errno == EINTR) continue;
      if (ready < 0) return fail(Errc::os_failure, "waiting for agnocastd", errno);
      if (entries[0].revents != 0) return true;
      if (entries[1].revents != 0) was_interrupted_ = consume_interrupt();
      return false;
    }
  }
  /// Returns whether it was interrupted.
  bool sleep_until(Clock::time_point end) {
    pollfd entry{interrupted_.get(), POLLIN, 0};
    for (;;) {
      const auto left = std::chrono::ceil<milliseconds>(end - Clock::now()).count();
      if (left <= 0) return false;
      if (::poll(&entry, 1, static_cast<int>(left)) > 0) return consume_interrupt();
    }
  }
  bool consume_interrupt() noexcept {
    std::uint64_t count = 0;
    return ::read(interrupted_.get(), &count, sizeof count) == sizeof count;
  }

  UniqueFd interrupted_;
  PacketSocket socket_;
  AnswerPacket packet_;
  bool is_asked_ = false, was_interrupted_ = false;
  std::optional<std::uint64_t> seen_lsn_;  // of the last dump; none before the first
  Clock::time_point looked_{};
};

Graph::Graph() : state_(std::make_unique<State>()) {}
Graph::~Graph() = default;
Graph::Graph(Graph&&) noexcept = default;
Graph& Graph::operator=(Graph&&) noexcept = default;

Result<std::optional<GraphSnapshot>> Graph::wait(milliseconds patience) {
  return state_->wait(patience);
}
void Graph::interrupt() noexcept { state_->interrupt(); }

}  // namespace agnocast
