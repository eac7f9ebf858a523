// SPDX-License-Identifier: Apache-2.0
//
// CdrPlan: the steps that write and read a message of one type, in the order of the wire.
//
// Members of fixed size that follow each other without a gap in memory and on the wire are one
// run. CDR aligns a number to its size, counted from the start of the body, not of its struct; so
// two members are neighbours on the wire, wherever the struct lies, only if the later one needs no
// more alignment than the first of the run. A message that is a member is flattened into its
// parent; only arrays and sequences have plans of their own, for one element.
//
//   geometry_msgs/PoseArray   run: header.stamp.sec, .nanosec   8 bytes, aligned to 4
//                             text: header.frame_id
//                             elements: poses, each a run     7 doubles, 56 bytes, aligned to 8
//
// An element that is a single run of its own size is dense: one memcpy moves a sequence of such
// elements.
#pragma once

#include <bridge/cdr/cdr.hpp>

#include <cstddef>
#include <memory>
#include <string>
#include <variant>
#include <vector>

namespace agnocast::bridge {

inline constexpr std::size_t cdr_encapsulation_bytes = 4;
inline constexpr std::size_t cdr_service_header_bytes = 16;

/// One member in a run, or one array of numbers.
struct CdrPiece {
  std::string member;
  std::size_t offset = 0;  // in the run
  std::size_t width = 0;   // bytes of one number
  std::size_t count = 0;
  bool is_array = false;
  bool is_bool = false;

  std::size_t end() const noexcept { return offset + width * count; }
};

// Offsets of steps are relative to the message or the element. SIZE_MAX means no bound.
struct CdrRun {
  std::size_t offset = 0;
  std::size_t bytes = 0;
  std::size_t alignment = 1;
  bool has_bool = false;
  std::vector<CdrPiece> pieces;

  /// Returns the member at byte `offset`, with its index: "covariance[3]".
  std::string member_at(std::size_t offset) const;
};
struct CdrText {
  std::size_t offset = 0;
  std::size_t bound = 0;  // characters; for wide text UTF-16 units
  bool is_wide = false;
  std::string member;
};
/// std::vector<bool>, whose elements have no addresses.
struct CdrBits {
  std::size_t offset = 0;
  std::size_t bound = 0;
  const MessageMember* table = nullptr;
  std::string member;
};
struct CdrElements {
  std::size_t offset = 0;
  std::size_t fixed_count = 0;  // 0: a sequence
  std::size_t bound = 0;
  const MessageMember* table = nullptr;
  std::shared_ptr<const CdrPlan> element;
  std::string member;

  bool is_sequence() const noexcept { return fixed_count == 0; }
};
using CdrStep = std::variant<CdrRun, CdrText, CdrBits, CdrElements>;

struct CdrPlan {
  std::vector<CdrStep> steps;
  std::size_t memory_bytes = 0;    // sizeof the message or element
  std::size_t wire_bytes_min = 0;  // without padding, with empty sequences and strings; at least 1

  /// Returns the run that is the whole element (see above), else null.
  const CdrRun* dense() const noexcept;
};

inline std::size_t align_up(std::size_t position, std::size_t alignment) noexcept {
  return (position + alignment - 1) & ~(alignment - 1);
}

/// Returns "poses[3].position.x" for "poses", 3 and "position.x".
std::string element_name(const std::string& sequence, std::size_t index, const std::string& member);

}  // namespace agnocast::bridge
