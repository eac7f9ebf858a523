// SPDX-License-Identifier: Apache-2.0
//
// Requests: bytes of a packet to something that may be acted on. Pure.
//
// A table says for every opcode how long its body is, whether it may come before hello, and which
// check its fields must pass. Everything in a packet is input: what comes out of decode() has names
// that end, indexes inside the tables, a quality of service that exists. Whether an index belongs
// to the sender is for the endpoint manager to know.
#pragma once

#include <agnocast/abi/observe.hpp>
#include <agnocast/abi/wire.hpp>
#include <agnocast/abi/words.hpp>
#include <agnocast/error.hpp>

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <string_view>
#include <variant>

namespace agnocast::daemon {

namespace wire = abi::wire;

// `again`: asked a second time, because the connection was lost before an answer came.
struct CreateRequest {
  bool again = false;
  wire::Kind kind = wire::Kind::publisher;
  std::uint64_t request = 0;
  abi::Qos qos;
  std::uint64_t layout_hash = 0;
  std::uint64_t executor = 0;
  std::uint64_t quota = 0;
  bool quota_or_less = false;  // of publishers of other users
  std::string topic;
  std::string type;
  std::string node;
};
struct ExecutorRequest {
  bool again = false;
  std::uint64_t request = 0;
  std::uint64_t executor = 0;
};
struct LeaveRequest {
  bool again = false;
  wire::Reference reference;
};
struct DrainedRequest {
  bool again = false;
  wire::Reference reference;
};

/// Why a packet is not acted on. It is answered with `refused`, or, when nothing in it can be
/// believed (not even where its request id is), the connection ends.
struct Rejected {
  std::uint64_t request = 0;
  Errc code = Errc::protocol_violation;
  std::string text;
  bool ends_connection = false;
};

using Request =
    std::variant<wire::Hello, wire::Rejoin, wire::WindowRequest, ExecutorRequest, CreateRequest,
                 LeaveRequest, DrainedRequest, wire::Unlinked, wire::Blocked, wire::Withdrawn,
                 wire::BringWindow, wire::Observe, wire::Dump, wire::ReadJournal, wire::Revoke,
                 wire::SetLogLevel, wire::AskAccess, Rejected>;

/// How far a connection has come, and so what may be said on it: hello or rejoin makes it a client,
/// observe an observer, for good.
enum class Role : std::uint8_t { unknown, client, observer };

/// What arrived with the bytes.
struct Envelope {
  std::size_t descriptor_count = 0;
  bool truncated = false;
  bool descriptors_lost = false;
};

/// Never reads beyond `packet`. Request ids come out without wire::asked_again.
Request decode(std::span<const std::byte> packet, const Envelope& envelope, Role role);

/// The id by which a request is answered; 0 when there is none.
std::uint64_t request_id_of(const Request& request) noexcept;

/// The text of a name, or nothing when no NUL ends it.
bool text_of(const wire::Name& name, std::string_view& text) noexcept;
/// A text for a packet: cut where it must be, always ended.
wire::Name name_of(std::string_view text) noexcept;
/// For people: control characters and broken bytes replaced, so that no client writes into our
/// terminal.
std::string printable(std::string_view text);
/// A hash or an address, as 0x and 16 digits.
std::string hexadecimal(std::uint64_t value);

}  // namespace agnocast::daemon
