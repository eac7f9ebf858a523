// SPDX-License-Identifier: Apache-2.0
//
// Children and the observer of the revocation tests (daemon_revoke_test.cpp,
// daemon_put_out_test.cpp).
#pragma once

#include <agnocast/abi/observe.hpp>
#include <tests/recovery/stage.hpp>
#include <tests/support/processes/daemon_process.hpp>
#include <tests/support/soon.hpp>
#include <tests/support/wire/wire_dump.hpp>
#include <tests/support/wire/wire_node.hpp>

#include <grp.h>
#include <gtest/gtest.h>
#include <poll.h>
#include <signal.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <cstring>
#include <map>
#include <memory>
#include <optional>
#include <string>

namespace agnocast::test {

using abi::Qos;
using sweep::answer;
using sweep::Child;
using sweep::serve;

inline constexpr Qos deep{10, false, true, false, false};
inline constexpr const char* topic_name = "/revoked";
inline const DaemonOptions talkative{.arguments = {"--log-level", "debug"}};

/// Returns the answer to a hello on a new connection; none: the daemon hung up, since it had no
/// time to check whether the process was revoked.
inline std::optional<Incoming> greet(const std::string& socket) {
  auto connected = PacketSocket::connect(socket);
  if (!connected) return std::nullopt;
  wire::Hello hello{};
  hello.header = {wire::Opcode::hello, sizeof hello, 1};
  hello.fingerprint = abi::fingerprint();
  if (!connected->send(std::as_bytes(std::span(&hello, 1)), {}, Wait::yes)) return std::nullopt;
  pollfd entry{connected->fd(), POLLIN, 0};
  if (::poll(&entry, 1, WireClient::patience_ms) != 1) return std::nullopt;
  std::array<std::byte, wire::answer_bytes_max> buffer;
  const auto packet = connected->receive(buffer);
  if (!packet || packet->kind != Packet::Kind::data) return std::nullopt;
  return Incoming{{buffer.begin(), buffer.begin() + static_cast<std::ptrdiff_t>(packet->bytes)},
                  {}};
}

// Commands of every child: R reads packets up to `revoked` and the end after it · H says hello on
// a new connection and is refused · J the same with rejoin · A hello, and is welcome · e executes
// another program, and so does not answer.
inline char execute_common(WireNode& node, const std::string& socket, char what) {
  if (what == 'R') {
    for (;;) {
      const Incoming packet = node.wire().next();
      if (packet.bytes.empty()) return '-';
      if (packet.opcode() != wire::Opcode::revoked) continue;
      const auto body = packet.as<wire::Refused>();
      return answer(static_cast<Errc>(body.code) == Errc::revoked && body.text.text[0] != '\0' &&
                    node.wire().is_hung_up());
    }
  }
  if (what == 'e') ::execlp("sleep", "sleep", "60", static_cast<char*>(nullptr));
  if (what == 'J') {
    WireClient again(socket);
    return answer(again.rejoin(node.welcome()).refused_code() == Errc::revoked);
  }
  std::optional<Incoming> said;
  if (!soon([&] { return (said = greet(socket)).has_value(); })) return '-';
  if (what == 'H') return answer(said->refused_code() == Errc::revoked);
  return what == 'A' ? answer(said->opcode() == wire::Opcode::welcome) : '?';
}

// p publish · w until a subscription is attached · x packets, then a reclamation scan.
inline Child publisher_child(const std::string& socket) {
  return Child(0, [socket](int commands, std::uint64_t) {
    ::prctl(PR_SET_PDEATHSIG, SIGKILL);
    WireNode node(socket);
    if (!node.create_publisher(topic_name, deep)) ::_exit(3);
    std::uint64_t number = 0;
    serve(commands, [&](char what) -> char {
      switch (what) {
        case 'w':
          return answer(node.wait_for([&] { return node.attached_count() == 1; }));
        case 'p':
          return answer(node.publish(++number));
        default:
          return execute_common(node, socket, what);
      }
    });
  });
}

// w until a publisher is linked · t take · l holds more than it may.
inline Child subscriber_child(const std::string& socket) {
  return Child(0, [socket](int commands, std::uint64_t) {
    ::prctl(PR_SET_PDEATHSIG, SIGKILL);
    WireNode node(socket);
    if (!node.create_subscription(topic_name, deep)) ::_exit(3);
    serve(commands, [&](char what) -> char {
      switch (what) {
        case 'w':
          return answer(node.wait_for([&] { return node.link_count() == 1; }));
        case 't':
          return answer(node.take().has_value());
        case 'l':
          return answer(node.claim_holds(0, 5));
        default:
          return execute_common(node, socket, what);
      }
    });
  });
}

struct Observer {
  explicit Observer(const std::string& socket) : wire(socket) {
    wire::Observe body{};
    body.fingerprint = abi::fingerprint();
    EXPECT_EQ(wire.ask(wire::Opcode::observe, body).opcode(), wire::Opcode::observed);
  }
  Incoming revoke(std::uint64_t client, std::uint64_t generation) {
    wire::Revoke body{};
    body.client = client;
    body.generation = generation;
    return wire.ask(wire::Opcode::revoke, body);
  }
  /// Returns the current processes, by index.
  std::map<std::uint64_t, wire::DumpProcess> processes() {
    std::map<std::uint64_t, wire::DumpProcess> all;
    wire.send(wire::Opcode::dump, wire::Dump{});
    for (;;) {
      const Incoming packet = wire.next();
      if (packet.bytes.empty() || packet.opcode() == wire::Opcode::dump_end) return all;
      if (packet.opcode() != wire::Opcode::dump_process) continue;
      const auto process = packet.as<wire::DumpProcess>();
      all[process.client] = process;
    }
  }
  WireClient wire;
};

}  // namespace agnocast::test
