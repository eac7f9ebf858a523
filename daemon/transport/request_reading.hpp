// SPDX-License-Identifier: Apache-2.0
//
// Requests: from the bytes of a packet to a request. Pure.
//
// A table has for every opcode the length of its body, the role it needs, and the check of its
// fields. Everything in a packet is input: a request from decode() has names that end, indexes
// inside the tables, a quality of service that exists. The endpoint manager checks whether an
// index belongs to the sender.
#pragma once

#include <agnocast/abi/observe.hpp>
#include <agnocast/abi/wire.hpp>
#include <agnocast/abi/words.hpp>
#include <agnocast/error.hpp>

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <variant>

namespace agnocast::daemon {

namespace wire = abi::wire;

// `again`: repeated, because the connection was lost before an answer came.
struct CreateRequest {
  bool again = false;
  wire::Kind kind = wire::Kind::publisher;
  std::uint64_t request = 0;
  abi::Qos qos;
  std::uint64_t layout_hash = 0;
  std::uint64_t wait_set = 0;
  std::uint64_t quota = 0;
  bool quota_or_less = false;           // for publishers of other users
  std::optional<std::uint64_t> domain;  // none: that of the process
  std::string topic;
  std::string type;
  std::string node;
};
struct WaitSetRequest {
  bool again = false;
  std::uint64_t request = 0;
  std::uint64_t wait_set = 0;
};
struct LeaveRequest {
  bool again = false;
  wire::Reference reference;
};
struct DrainedRequest {
  bool again = false;
  wire::Reference reference;
};

/// Why a packet is not served. The daemon answers `refused`, or ends the connection when nothing
/// in the packet can be trusted (not even the position of its request id).
struct Rejected {
  std::uint64_t request = 0;
  Errc code = Errc::protocol_violation;
  std::string text;
  bool ends_connection = false;
};

using Request =
    std::variant<wire::Hello, wire::Rejoin, wire::WindowRequest, WaitSetRequest, CreateRequest,
                 LeaveRequest, DrainedRequest, wire::Unlinked, wire::Blocked, wire::Withdrawn,
                 wire::CallbackGroup, wire::CallbackThread, wire::WatchGraph, wire::BringWindow,
                 wire::Observe, wire::Dump, wire::ReadJournal, wire::Revoke, wire::SetLogLevel,
                 wire::AskAccess, Rejected>;

/// The role of a connection decides which requests it may send: hello or rejoin makes it a client,
/// observe an observer, for good.
enum class Role : std::uint8_t { unknown, client, observer };

/// Facts about a received packet beside its bytes.
struct Envelope {
  std::size_t descriptor_count = 0;
  bool truncated = false;
  bool descriptors_lost = false;
};

/// Parses a packet and never reads beyond it. Request ids come out without wire::asked_again.
Request decode(std::span<const std::byte> packet, const Envelope& envelope, Role role);

/// Returns the id by which a request is answered; 0 when there is none.
std::uint64_t request_id_of(const Request& request) noexcept;

/// Gets the text of a name. Returns false when no NUL ends it.
bool text_of(const wire::Name& name, std::string_view& text) noexcept;
/// Returns a text for a packet: truncated if necessary, always ended.
wire::Name name_of(std::string_view text) noexcept;
/// Returns the name of a record: always ended, whatever its bytes are.
wire::Name copy_of(const char (&text)[wire::name_bytes]) noexcept;
/// Returns a text for people: control characters and broken bytes are replaced, so that no client
/// writes into the user's terminal.
std::string printable(std::string_view text);
/// Returns a hash or an address as 0x and 16 digits.
std::string hexadecimal(std::uint64_t value);

}  // namespace agnocast::daemon
