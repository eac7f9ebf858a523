// SPDX-License-Identifier: Apache-2.0
//
// Processes: five of two users, each with the knowledge of an honest one: what it has, and what it
// was notified of and has not acknowledged. The oracle records that, from packets alone; the
// daemon's loop keeps process and connection; the scenario reads what a process can name.
#pragma once

#include <agnocast/abi/client_region.hpp>
#include <agnocast/abi/wire.hpp>
#include <agnocast/abi/words.hpp>
#include <base/memory/mapping.hpp>
#include <base/sockets/packet_socket.hpp>
#include <daemon/state/tables.hpp>
#include <daemon/transport/session.hpp>

#include <tests/fuzz/protocol/peer_process.hpp>

#include <array>
#include <cstddef>
#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <vector>

namespace agnocast::daemon::fuzz {

using wire::Kind;
using wire::Opcode;

// So few windows that they are reused often. No window is ever mapped at its address.
inline constexpr std::uint64_t arena_base = std::uint64_t{1} << 45, window_bytes = 2 << 20,
                               window_count = 8;
// The incarnation of the one daemon that all of them use.
inline constexpr std::uint64_t incarnation = 1;

struct Range {
  std::uint64_t from = 0, to = 0;
  bool meets(const Range& other) const { return from < other.to && other.from < to; }
};
inline Range window_at(std::uint64_t base) { return {base, base + window_bytes}; }

/// A notification of another process's endpoint or region.
struct Notified {
  std::uint64_t packet = 0, generation = 0;
  std::uint64_t owner = 0;  // client
  Range extent;             // in the owner's region
  abi::Qos qos;
};

/// An endpoint of the process itself.
struct Endpoint {
  Kind kind = Kind::publisher;
  std::uint32_t topic = 0;
  std::uint64_t index = 0, generation = 0;
  Range extent;
  abi::Qos qos;
  std::uint64_t creation = 0;  // id of the request
  bool left = false;
};

struct Process {
  std::unique_ptr<PeerProcess> running;  // none before its first connection
  PacketSocket connection;               // none after it has ended
  std::uint64_t packet_count = 0;        // received on it
  bool greeted = false;                  // on it
  bool hung_up = false;                  // the daemon has ended it
  Mapping region;                        // its own
  std::optional<ClientIndex> client;
  std::uint64_t generation = 0;
  std::uint32_t uid = 0;
  std::map<Announced, Notified> notified;
  std::map<std::uint64_t, Notified> regions;            // by client
  std::map<std::uint64_t, std::vector<Range>> windows;  // by client
  std::vector<Endpoint> own;
  std::vector<Range> heap;          // its own windows
  std::vector<Range> blocked;       // ranges where it can have none
  bool revoked = false;             // but has not ended
  std::set<std::uint64_t> drained;  // generations of its former endpoints
  std::set<std::uint64_t> created;  // ids of the requests that made its endpoints, drained or not
};
using Processes = std::array<Process, 5>;

}  // namespace agnocast::daemon::fuzz
