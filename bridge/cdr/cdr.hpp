// SPDX-License-Identifier: Apache-2.0
//
// CDR: messages as the bytes that ROS 2 sends over DDS (XCDR1), straight from and into the memory of
// a message. A CdrType is made once from rosidl's table of a message type; it knows which members lie
// in memory as they lie on the wire, and those are moved by memcpy, whole sequences of them at once.
//
// Written: little-endian, encapsulation 00 01 00 00, exact length, padding zero. Read: both byte
// orders, from the pieces that DDS received, without making one buffer of them. What is read is
// another host's: every count is checked against what is left of the input before anything is
// allocated for it, so memory is bounded by the input (cdr_memory_factor). docs/bridge.md has the
// rules and the limits.
//
// Everything here may be called by any thread, for different messages at the same time.
#pragma once

#include <agnocast/generic.hpp>
#include <agnocast/relay.hpp>
#include <agnocast/result.hpp>

#include <tl/expected.hpp>

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <utility>

namespace agnocast::bridge {

struct CdrPlan;

/// Reading allocates at most so many bytes for each byte of input, and beside that one element of each
/// sequence that the failing member is in, and what defaults of elements allocate. No member takes
/// more memory, its padding included, for the bytes that it takes on the wire at least: a
/// std::vector<bool> is 40 bytes for a count of 4, a std::string 32, one byte before a double 8. What a
/// string allocates is at most twice its characters, which are on the wire as well.
inline constexpr std::size_t cdr_memory_factor = 10;
/// How deep messages nest in sequences and arrays of messages.
inline constexpr int cdr_depth_max = 64;

/// A message type, ready to be written and read. Cheap to copy; its table must outlive it.
class CdrType {
 public:
  /// Allocates. Errors: type_refused with the member: wchar, long double, rosidl::Buffer, a message
  /// without members, nested deeper than cdr_depth_max. Throws std::bad_alloc.
  [[nodiscard]] static Result<CdrType> of(const MessageMembers& members);

  const MessageMembers& members() const noexcept { return *members_; }
  const CdrPlan& plan() const noexcept { return *plan_; }

 private:
  CdrType(const MessageMembers& members, std::shared_ptr<const CdrPlan> plan) noexcept
      : members_(&members), plan_(std::move(plan)) {}

  const MessageMembers* members_;
  std::shared_ptr<const CdrPlan> plan_;
};

enum class CdrReason : std::uint8_t {
  truncated,       ///< the input ends; `byte` is its length
  parameter_list,  ///< the encapsulation says PL_CDR: discovery, or a type of another extensibility
  xcdr2,           ///< the encapsulation says XCDR2, which has other alignments
  overlong,        ///< a count or length that the rest of the input cannot hold
  above_bound,     ///< more elements or characters than the type allows
  unterminated,    ///< the last byte of a string is not zero
  no_utf16,        ///< a wide character of more than 16 bits
  no_room,         ///< of writing: the memory is too small, or somebody changes the message
  uncountable,     ///< of writing: a count that does not fit into 32 bits
  elsewhere,       ///< of writing: the message leads out of its publisher's memory
};

/// Why a message was not read or not written.
struct CdrFailure {
  CdrReason reason = CdrReason::truncated;
  std::size_t byte = 0;  ///< from the first byte of the encapsulation
  std::string member;    ///< "fields[2].name"; empty before the first member

  /// "truncated at byte 812 in fields[2].name"
  std::string text() const;
};

template <class T>
using CdrResult = tl::expected<T, CdrFailure>;

/// What rmw_cyclonedds has between encapsulation and body of requests and replies.
struct ServiceHeader {
  std::uint64_t client_id = 0;
  std::int64_t sequence_number = 0;

  bool operator==(const ServiceHeader&) const = default;
};

/// The pieces of one payload, in order: encapsulation, then what follows. Any may be empty.
using CdrInput = std::span<const std::span<const std::byte>>;

/// How many bytes write_cdr() writes. Constant for messages of fixed size, else one look at each
/// sequence and string. Allocates nothing. `within`: where a message of another process may lie with all
/// it leads to, windows_of() of it; null: it is this process's own. 0: it leads elsewhere.
std::size_t cdr_bytes(const CdrType& type, const void* message,
                      const WindowSet* within = nullptr) noexcept;
std::size_t service_cdr_bytes(const CdrType& type, const void* message,
                              const WindowSet* within = nullptr) noexcept;

/// Writes the message to the beginning of `to`; the value is the length, cdr_bytes() unless somebody
/// changes the message meanwhile. Allocates nothing but a failure: no_room, uncountable, above_bound,
/// elsewhere. A bool that is neither 0 nor 1 is written as 1.
[[nodiscard]] CdrResult<std::size_t> write_cdr(const CdrType& type, const void* message,
                                               std::span<std::byte> to,
                                               const WindowSet* within = nullptr);
[[nodiscard]] CdrResult<std::size_t> write_service_cdr(const CdrType& type,
                                                       const ServiceHeader& header,
                                                       const void* message,
                                                       std::span<std::byte> to,
                                                       const WindowSet* within = nullptr);

/// Reads into `message`, a constructed message whose contents are replaced; the value is how many
/// bytes of the input it took: what follows is padding, or none of ours. After a failure, or a
/// std::bad_alloc, `message` is a message of which some members are read.
[[nodiscard]] CdrResult<std::size_t> read_cdr(const CdrType& type, CdrInput from, void* message);
[[nodiscard]] CdrResult<std::size_t> read_service_cdr(const CdrType& type, CdrInput from,
                                                      ServiceHeader& header, void* message);

}  // namespace agnocast::bridge
