// SPDX-License-Identifier: Apache-2.0
//
// Value: one place inside a message of any type (the message, a member, an element), as the
// introspection table describes it; and Path, how people name such a place: "a.b[2].c".
//
// A view: it is valid as long as its message, and copies nothing.
#pragma once

#include <agnocast/generic.hpp>
#include <ctl/cli/problem.hpp>

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

namespace agnocast::ctl {

using Scalar =
    std::variant<bool, std::int64_t, std::uint64_t, double, std::string_view, std::u16string_view>;

/// What a Value is, known without a message.
struct Shape {
  const MessageMembers* members = nullptr;  // of a message, or of the elements
  const MessageMember* member = nullptr;    // null: the message itself
  bool is_array = false;                    // the whole member, and not one element

  static Shape of(const MessageMembers& members) { return {&members, nullptr, false}; }
  bool is_message() const { return !is_array && members != nullptr; }
  bool is_scalar() const { return !is_array && members == nullptr; }
  bool is_text() const;
  bool is_boolean() const;
  /// A member of fixed length.
  bool is_fixed() const { return is_array && member->array_size_ != 0 && !member->is_upper_bound_; }
  Shape field(std::uint32_t index) const;
  Shape element() const { return {members, member, false}; }
  std::uint32_t field_count() const;
  std::string_view field_name(std::uint32_t index) const { return members->members_[index].name_; }
  /// Its index, or nothing.
  std::optional<std::uint32_t> find(std::string_view name) const;
  /// "float64", "string<=40", "int32[<=5]", "sensor_msgs/msg/PointField[]": as in a .msg file.
  std::string type_name() const;
};

class Value {
 public:
  Value(Shape shape, const void* at) : shape_(shape), at_(at) {}
  static Value of(const MessageMembers& members, const void* message) {
    return {Shape::of(members), message};
  }

  const Shape& shape() const { return shape_; }
  const void* address() const { return at_; }
  Value field(std::uint32_t index) const;
  /// Of arrays.
  std::size_t size() const;
  Value element(std::size_t index) const;
  Scalar scalar() const;

 private:
  Shape shape_;
  const void* at_;
  std::optional<bool> bit_ = {};  // an element of std::vector<bool>, which has no address
};

/// Where a value lies inside a message of one type. Checked against the type when it is made.
class Path {
 public:
  /// Problems: wrong_usage, with the position and what is there instead.
  static Outcome<Path> parse(std::string_view text, const MessageMembers& type);
  const Shape& shape() const { return shape_; }
  const std::string& text() const { return text_; }
  /// Nothing when an element is not there.
  std::optional<Value> in(const Value& message) const;

 private:
  struct Step {
    std::optional<std::uint32_t> field;
    std::size_t element = 0;
  };
  std::vector<Step> steps_;
  Shape shape_;
  std::string text_;
};

/// ROS's name of a type: "sensor_msgs/msg/PointCloud2".
std::string type_name(const MessageMembers& members);
/// "a, b, c", for what is misspelt.
std::string names_of_fields(const Shape& message);

}  // namespace agnocast::ctl
