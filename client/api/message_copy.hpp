// SPDX-License-Identifier: Apache-2.0
//
// Copies a message into one block: the object, then the elements and texts that it refers to, in
// the order of its plan. The copy is what its type's own copy would be for everybody who reads it;
// nobody destroys it, its memory is freed as a whole.
//
//     | std_msgs/String |          |  sensor_msgs/PointCloud2  | frame_id… | fields[0..2] | name… | data… |
//       a short text is in the object itself
//
// No function of the type is called. Which types can be copied so: flat ones, and described ones
// (message_plan.hpp) where the words of strings and of std::vector<bool> are those known here.
#pragma once

#include <agnocast/message_type.hpp>

#include <cstddef>
#include <cstdint>

namespace agnocast::detail {

/// Returns whether messages of the type can be copied into one block. May throw std::bad_alloc.
[[nodiscard]] bool is_copied_into_block(const MessageType& type);

/// Measures and copies one message, which no thread changes meanwhile. Throws nothing, allocates
/// nothing; recursion is as deep as sequences nest in the type.
class MessageCopy {
 public:
  /// `message`: behind its header, if the type has one. Both must outlive this object.
  MessageCopy(const MessageType& type, const void* message) noexcept;

  /// Returns the size of the block, in bytes. It begins with the header.
  std::size_t block_bytes() const noexcept { return block_bytes_; }
  /// Returns the alignment of the block, a power of two.
  std::size_t alignment() const noexcept;
  /// Writes the copy. Returns false if it needs more than block_bytes(): the message was changed.
  [[nodiscard]] bool write(void* block) const noexcept;

 private:
  const MessageType& type_;
  const std::byte* const object_;
  std::size_t block_bytes_ = 0;
};

}  // namespace agnocast::detail
