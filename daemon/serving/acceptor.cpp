// SPDX-License-Identifier: Apache-2.0
//
// Acceptor: see the header.

#include <daemon/serving/acceptor.hpp>

#include <agnocast/abi/limits.hpp>
#include <base/sockets/peer_identity.hpp>
#include <daemon/state/memory_reserve.hpp>
#include <daemon/state/steps.hpp>

#include <fcntl.h>
#include <sys/epoll.h>

#include <cerrno>
#include <memory>
#include <string>
#include <string_view>
#include <utility>

namespace agnocast::daemon {

namespace {

// Connections accepted in a row: a process that connects again and again would never let it end.
constexpr unsigned connections_per_slice = 8;

// Tells a connection why it is refused, before it is closed.
void send_refused(const PacketSocket& socket, Errc code, std::string_view text) noexcept {
  auto packet = make_body<wire::Refused>(wire::Opcode::refused);
  packet.code = static_cast<std::uint32_t>(code);
  packet.text = name_of(text);
  static_cast<void>(socket.send(packet_of(packet)));
}

}  // namespace

Acceptor::Acceptor(const AcceptorParts& parts)
    : of_(parts), spare_(::open("/dev/null", O_RDONLY | O_CLOEXEC)) {}

Acceptor::~Acceptor() { of_.dispatcher.remove(listening_); }

Result<void> Acceptor::start() {
  const auto token = of_.dispatcher.add(of_.listener.socket().fd(), EPOLLIN,
                                        [this](std::uint32_t) { knocks_ = true; });
  if (!token) return tl::unexpected(token.error());
  listening_ = *token;
  return {};
}

void Acceptor::accept_some() {
  if (!std::exchange(knocks_, false)) return;
  for (unsigned round = 0; round < connections_per_slice; ++round) {
    auto socket = of_.listener.socket().accept();
    if (!socket) {
      if (socket.error().os_errno == EMFILE || socket.error().os_errno == ENFILE) {
        turn_away();
      } else {
        of_.log.write_limited("accept", LogLevel::warning, "connection not accepted",
                              {{"errno", socket.error().os_errno}});
      }
      return;  // level-triggered: waiting connections are reported again
    }
    if (!*socket) return;
    accept(std::move(**socket));
  }
}

void Acceptor::pause_listening() {
  of_.dispatcher.change(listening_, 0);
  listens_ = false;
}

void Acceptor::listen_again() {
  if (std::exchange(listens_, true)) return;
  if (!spare_) spare_.reset(::open("/dev/null", O_RDONLY | O_CLOEXEC));
  of_.dispatcher.change(listening_, EPOLLIN);
}

void Acceptor::turn_away() {
  ++of_.registry.counters().connections_refused;
  spare_.reset();
  {
    auto socket = of_.listener.socket().accept();
    // The last connection is still being closed. The dispatcher keeps reporting waiting ones.
    if (!socket) pause_listening();
    if (socket && *socket) {
      send_refused(**socket, Errc::limit_reached, "the daemon has no descriptor left");
      const std::uint32_t uid = uid_of((*socket)->fd());
      close(std::move(**socket), uid);
    }
  }
  spare_.reset(::open("/dev/null", O_RDONLY | O_CLOEXEC));
  of_.log.write_limited(
      "descriptors", LogLevel::error, "connection refused",
      {{"code", word_of(Errc::limit_reached)}, {"why", "no descriptor left; raise LimitNOFILE"}});
}

void Acceptor::accept(PacketSocket socket) {
  if (!MemoryReserve::refill()) {
    ++of_.registry.counters().connections_refused;
    send_refused(socket, Errc::limit_reached, no_memory_text);
    const std::uint32_t uid = uid_of(socket.fd());
    close(std::move(socket), uid);
    return;
  }
  auto identity = identify_peer(socket.fd());
  if (!identity) {
    of_.log.write_limited("identify", LogLevel::warning, "connection refused",
                          {{"code", word_of(identity.error().code)},
                           {"errno", identity.error().os_errno},
                           {"why", identity.error().what}});
    send_refused(socket, identity.error().code, identity.error().what);
    const std::uint32_t uid = uid_of(socket.fd());
    close(std::move(socket), uid);
    return;
  }
  AGNOCAST_CRASH_POINT(B_accepted);
  const std::uint32_t uid = identity->uid;
  if (const std::size_t stuck = of_.disposal.stuck(uid); stuck > 1)
    of_.log.write_limited("disposal uid=" + std::to_string(uid), LogLevel::error,
                          "connections cannot be closed",
                          {{"pid", identity->pid},
                           {"uid", uid},
                           {"threads", stuck},
                           {"why", "closing what this user has sent does not return"}});
  // A user with as many clients as allowed can still observe them: such a connection can only
  // observe. Processes that have lost their connection may come back.
  const UserConnections& used = of_.connections.user(uid);
  const bool only_observes = used.clients >= of_.quota.clients + used.detached;
  if (only_observes && used.observers >= abi::observer_count_max)
    refuse_over_quota(std::move(socket), *identity);
  else
    attach(std::move(socket), std::move(*identity), only_observes);
}

void Acceptor::refuse_over_quota(PacketSocket socket, const PeerIdentity& identity) {
  ++of_.registry.counters().connections_refused;
  send_refused(socket, Errc::quota_exceeded, of_.admission.clients_text());
  of_.log.write_limited("connections uid=" + std::to_string(identity.uid), LogLevel::warning,
                        "connection refused",
                        {{"pid", identity.pid},
                         {"uid", identity.uid},
                         {"limit", "[quota] clients"},
                         {"value", of_.quota.clients},
                         {"used", of_.connections.user(identity.uid).clients},
                         {"asked", 1},
                         {"code", "quota_exceeded"}});
  close(std::move(socket), identity.uid);
}

void Acceptor::attach(PacketSocket socket, PeerIdentity identity, bool only_observes) {
  // A previous daemon may have listened without refusing descriptors.
  const bool may_carry = !refuses_descriptors(socket.fd());
  if (may_carry) refuse_descriptors(socket.fd());
  const PeerId id = of_.connections.next_id();
  const UserConnections& used = of_.connections.user(identity.uid);
  used.kept->bytes_max = of_.quota.queued_bytes;
  auto peer =
      std::make_unique<Peer>(Peer{id, Session(std::move(socket), std::move(identity), used.kept)});
  peer->session.set_may_carry(may_carry);
  const auto connection = of_.dispatcher.add(peer->session.socket().fd(), EPOLLIN,
                                             of_.scheduler.event_handler(id, false));
  const auto process = !connection
                           ? connection
                           : of_.dispatcher.add(peer->session.identity().process.fd(), EPOLLIN,
                                                of_.scheduler.event_handler(id, true));
  if (!process) {
    if (connection) of_.dispatcher.remove(*connection);
    send_refused(peer->session.socket(), process.error().code, process.error().what);
    of_.connections.close(*peer);
    return;
  }
  peer->connection = *connection;
  peer->process = *process;
  peer->counts_as_observer = only_observes;
  of_.namespaces.find(of_.connections.add(std::move(peer)));
}

void Acceptor::close(PacketSocket socket, std::uint32_t uid) {
  if (refuses_descriptors(socket.fd())) return;
  of_.disposal.close_connection(uid, socket.release());
}

}  // namespace agnocast::daemon
