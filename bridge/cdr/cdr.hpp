// SPDX-License-Identifier: Apache-2.0
//
// CDR: messages as the bytes that ROS 2 sends over DDS (XCDR1), directly from and into the memory
// of a message. A CdrType is made once from rosidl's table of a message type; it knows which
// members have the same form in memory and on the wire, and moves them with memcpy, whole
// sequences at once.
//
// Written: little-endian, encapsulation 00 01 00 00, exact length, zero padding. Read: both byte
// orders, from the pieces that DDS received, without joining them in one buffer. The input comes
// from another host: every count is checked against the rest of the input before memory is
// allocated for it, so the input bounds the memory (cdr_memory_factor). docs/bridge.md has the
// rules and limits.
//
// Any thread may call any function here, for different messages at the same time.
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

/// Reading allocates at most this many bytes for each byte of input, plus one element of each
/// sequence around a failing member, plus the allocations of default elements. No member takes
/// more memory, with its padding, than this factor times its minimum bytes on the wire: a
/// std::vector<bool> takes 40 bytes for a count of 4, a std::string 32, one byte before a double
/// 8. A string allocates at most twice its characters, which are on the wire as well.
inline constexpr std::size_t cdr_memory_factor = 10;
/// The maximum nesting of messages in sequences and arrays of messages.
inline constexpr int cdr_depth_max = 64;

/// A message type, ready for writing and reading. Cheap to copy; its table must outlive it.
class CdrType {
 public:
  /// Allocates. Errors: type_refused with the member: wchar, long double, rosidl::Buffer, a
  /// message without members, nested deeper than cdr_depth_max. Throws std::bad_alloc.
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
  no_room,         ///< writing: the memory is too small, or the message changes
  uncountable,     ///< writing: a count that does not fit into 32 bits
  elsewhere,       ///< writing: the message refers to memory outside its publisher's
};

/// Why a message was not read or not written.
struct CdrFailure {
  CdrReason reason = CdrReason::truncated;
  std::size_t byte = 0;  ///< from the first byte of the encapsulation
  std::string member;    ///< "fields[2].name"; empty before the first member

  /// Returns "truncated at byte 812 in fields[2].name".
  std::string text() const;
};

template <class T>
using CdrResult = tl::expected<T, CdrFailure>;

/// The header of rmw_cyclonedds between encapsulation and body of requests and replies.
struct ServiceHeader {
  std::uint64_t client_id = 0;
  std::int64_t sequence_number = 0;

  bool operator==(const ServiceHeader&) const = default;
};

/// The pieces of one payload, in order: encapsulation, then the rest. Any may be empty.
using CdrInput = std::span<const std::span<const std::byte>>;

/// Returns how many bytes write_cdr() writes: constant for messages of fixed size, else one look
/// at each sequence and string. Allocates nothing. `within`: windows_of() a message of another
/// process; null: the message is this process's own. 0: the message is not completely in these
/// windows.
std::size_t cdr_bytes(const CdrType& type, const void* message,
                      const WindowSet* within = nullptr) noexcept;
std::size_t service_cdr_bytes(const CdrType& type, const void* message,
                              const WindowSet* within = nullptr) noexcept;

/// Writes the message to the beginning of `to` and returns the length: cdr_bytes(), unless the
/// message changes meanwhile. Allocates only for a failure: no_room, uncountable, above_bound,
/// elsewhere. Writes a bool that is neither 0 nor 1 as 1.
[[nodiscard]] CdrResult<std::size_t> write_cdr(const CdrType& type, const void* message,
                                               std::span<std::byte> to,
                                               const WindowSet* within = nullptr);
[[nodiscard]] CdrResult<std::size_t> write_service_cdr(const CdrType& type,
                                                       const ServiceHeader& header,
                                                       const void* message, std::span<std::byte> to,
                                                       const WindowSet* within = nullptr);

/// Reads into `message`, a constructed message whose contents are replaced. Returns the number of
/// input bytes read; the rest is padding or unknown. After a failure, or a std::bad_alloc,
/// `message` is valid and some of its members are read.
[[nodiscard]] CdrResult<std::size_t> read_cdr(const CdrType& type, CdrInput from, void* message);
[[nodiscard]] CdrResult<std::size_t> read_service_cdr(const CdrType& type, CdrInput from,
                                                      ServiceHeader& header, void* message);

}  // namespace agnocast::bridge
