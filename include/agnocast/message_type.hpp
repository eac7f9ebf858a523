// SPDX-License-Identifier: Apache-2.0
//
// MessageType: the library's description of one message type, made once when an endpoint is
// created.
//
// The library itself never sees T and never includes a header of rosidl. The user's translation
// unit reads the introspection table and passes it as small plain structs (below), because the
// layout of that table differs between releases of ROS 2 and only the user's compiler knows the
// present one.
#pragma once

#include <agnocast/export.hpp>
#include <agnocast/message_traits.hpp>
#include <agnocast/result.hpp>
#include <agnocast/type_identity.hpp>

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string_view>

namespace agnocast {

class PointerVisitor;

namespace detail {

struct MessagePlan;
struct AGNOCAST_PUBLIC DestroyPlan {
  void operator()(const MessagePlan* plan) const noexcept;
};

enum class ElementKind : std::uint8_t { primitive, boolean, string, u16string, message };
enum class ArrayKind : std::uint8_t { none, fixed, bounded, unbounded };

/// One member of a described message. Texts and functions live as long as the user's type
/// support.
struct FieldTable {
  const char* name;
  ElementKind element;
  ArrayKind array;
  std::uint8_t primitive_id;    ///< rosidl's number of a primitive element type
  bool is_polymorphic;          ///< marked by the generator (rosidl::Buffer)
  std::uint32_t element_bytes;  ///< sizeof one element; 0 for a message, see its own table
  std::size_t offset;           ///< bytes from the start of the message object
  std::size_t array_bound;      ///< elements of a fixed array, or the upper bound of a sequence
  std::size_t string_bound;     ///< characters of a bounded string, else 0
  const void* nested;           ///< table of the element, for messages
  std::size_t (*size)(const void* member);
  const void* (*get)(const void* member, std::size_t index);
  void (*resize)(void* member, std::size_t size);
};

struct MessageTable {
  const char* message_namespace;  ///< as in C++: "sensor_msgs::msg"
  const char* message_name;
  std::size_t message_bytes;
  std::size_t field_count;
};

/// Functions that read a table, compiled in the user's translation unit.
struct TableReader {
  MessageTable (*message)(const void* table);
  FieldTable (*field)(const void* table, std::size_t index);
  void (*construct)(const void* table,
                    void* memory);  ///< may throw what the message's constructor throws
  void (*destroy)(const void* table, void* memory);
};

/// Ends a message: destructor and deallocation. Its context lives as long as the process.
struct MessageEnd {
  void (*code)(const void* context, void* message) noexcept;
  const void* context;  ///< the table of a type found at run time, else null
  void operator()(void* message) const noexcept { code(context, message); }

  template <class T>
  static MessageEnd of() noexcept {
    return {[](const void*, void* message) noexcept { delete static_cast<T*>(message); }, nullptr};
  }
};

/// A type without a table.
struct PlainType {
  std::string_view name;
  std::uint64_t version;
  std::uint32_t bytes;
  std::uint32_t alignment;
  bool is_flat;                                                 ///< trivially copyable
  void (*visit)(const void* message, PointerVisitor& visitor);  ///< null: opaque, or flat
};

}  // namespace detail

/// A message type as the library knows it. Immutable, cheap to copy; any number of threads may
/// use it at the same time.
class MessageType {
 public:
  /// How residency is checked; see message_traits.hpp.
  enum class Kind : std::uint8_t { described, flat, visited, opaque };

  /// Returns "sensor_msgs/msg/PointCloud2", the name of the trait, or the C++ name. Valid as long
  /// as this object.
  AGNOCAST_PUBLIC std::string_view name() const noexcept;
  /// Returns a number that is equal in two processes if and only if one can read the messages of
  /// the other (see LayoutHash for the odds).
  AGNOCAST_PUBLIC std::uint64_t layout_hash() const noexcept;
  /// Return sizeof and alignof the message object with its header, in bytes.
  AGNOCAST_PUBLIC std::uint32_t message_bytes() const noexcept;
  AGNOCAST_PUBLIC std::uint32_t message_alignment() const noexcept;
  AGNOCAST_PUBLIC Kind kind() const noexcept;
  /// Returns the pair that is compared at match; its name is valid as long as this object.
  TypeIdentity identity() const noexcept { return {name(), layout_hash()}; }

  /// Throws std::bad_alloc.
  explicit MessageType(std::unique_ptr<const detail::MessagePlan, detail::DestroyPlan> plan)
      : plan_(std::move(plan)) {}
  const detail::MessagePlan& plan() const noexcept { return *plan_; }
  /// Returns the same type behind a header of `bytes` bytes, a multiple of its alignment, with a
  /// hash of its own. Messages are still identified by their own address; the header lies before
  /// it.
  MessageType behind_header(std::uint32_t bytes, std::uint64_t layout_hash) const noexcept {
    MessageType type = *this;
    type.header_bytes_ = bytes;
    type.layout_hash_ = layout_hash;
    return type;
  }
  std::uint32_t header_bytes() const noexcept { return header_bytes_; }

 private:
  std::shared_ptr<const detail::MessagePlan> plan_;
  std::uint32_t header_bytes_ = 0;
  std::uint64_t layout_hash_ = 0;  // with a header
};

namespace detail {

// `build` is the build_hash of the caller's translation unit.
[[nodiscard]] AGNOCAST_PUBLIC Result<MessageType> make_described_type(const TableReader& reader,
                                                                      const void* table,
                                                                      std::uint32_t alignment,
                                                                      std::uint64_t build) noexcept;
[[nodiscard]] AGNOCAST_PUBLIC Result<MessageType> make_plain_type(const PlainType& type,
                                                                  std::uint64_t build) noexcept;
// Returns the table that `find` returns for the type of this ROS name. Errors: type_not_found with
// the reason, os_failure with ENOMEM. In the library, because code that is compiled without
// exceptions cannot catch those of the libraries that it calls.
[[nodiscard]] AGNOCAST_PUBLIC Result<const void*> found_table(const void* (*find)(const void*),
                                                              const void* argument,
                                                              const char* name) noexcept;

template <class T>
void visit_message(const void* message, PointerVisitor& visitor) {
  MessageTraits<T>::for_each_pointer(*static_cast<const T*>(message), visitor);
}

}  // namespace detail

/// Returns the description of T. Does not compile if T cannot be a message; see
/// message_traits.hpp.
///
/// The tables of a rosidl type are verified: a default message of each nested type is built,
/// every sequence in it is resized to two elements, and the memory is compared with the layout of
/// a std::vector. So call it when endpoints are created: it allocates, runs the message's
/// constructors, and costs about a microsecond per member. Errors: type_refused: a member that
/// only works in this process (rosidl::Buffer), a table that contradicts itself, or a library
/// built with another standard library than the caller; type_not_found: the message package has
/// no introspection table, or its library cannot be loaded, which the next call tries again;
/// os_failure with ENOMEM. Throws nothing. Any thread.
template <class T>
[[nodiscard]] Result<MessageType> message_type_of() noexcept {
  static_assert(detail::require_message<T>());
  if constexpr (detail::is_described<T>) {
    const Result<const void*> table = MessageTraits<T>::try_table();
    if (!table) return tl::unexpected<Failure>(table.error());
    return detail::make_described_type(MessageTraits<T>::reader(), *table, alignof(T),
                                       detail::build_hash);
  } else {
    constexpr bool is_flat = std::is_trivially_copyable_v<T>;
    detail::PlainType type{
        detail::plain_name<T>(), detail::version_of<T>, sizeof(T), alignof(T), is_flat, nullptr};
    if constexpr (!is_flat && detail::is_visited<T>) type.visit = &detail::visit_message<T>;
    return detail::make_plain_type(type, detail::build_hash);
  }
}

}  // namespace agnocast
