// SPDX-License-Identifier: Apache-2.0
//
// Value: one place inside a message of any type (the message, a member, an element), as the
// introspection table describes it. Path: the name of such a place, as users write it: "a.b[2].c".
//
// A Value is a view: it is valid as long as its message, and copies nothing.
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

/// The type of a Value, known without a message.
struct Shape {
  const MessageMembers* members = nullptr;  // of a message, or of the elements
  const MessageMember* member = nullptr;    // null: the message itself
  bool is_array = false;                    // the whole member, not one element

  static Shape of(const MessageMembers& members) { return {&members, nullptr, false}; }
  bool is_message() const { return !is_array && members != nullptr; }
  bool is_scalar() const { return !is_array && members == nullptr; }
  bool is_text() const;
  bool is_boolean() const;
  /// Returns whether it is an array of fixed length.
  bool is_fixed() const { return is_array && member->array_size_ != 0 && !member->is_upper_bound_; }
  Shape field(std::uint32_t index) const;
  Shape element() const { return {members, member, false}; }
  std::uint32_t field_count() const;
  std::string_view field_name(std::uint32_t index) const { return members->members_[index].name_; }
  /// Returns the field's index, or nothing.
  std::optional<std::uint32_t> find(std::string_view name) const;
  /// Returns the type as in a .msg file: "float64", "string<=40", "sensor_msgs/msg/PointField[]".
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
  /// Only for arrays.
  std::size_t size() const;
  Value element(std::size_t index) const;
  Scalar scalar() const;

 private:
  Shape shape_;
  const void* at_;
  std::optional<bool> bit_ = {};  // an element of std::vector<bool>, which has no address
};

/// The place of a value inside a message of one type. Checked against the type when it is made.
class Path {
 public:
  /// Parses a path. Problems: wrong_usage, with the place and the names that exist there.
  static Outcome<Path> parse(std::string_view text, const MessageMembers& type);
  const Shape& shape() const { return shape_; }
  const std::string& text() const { return text_; }
  /// Returns the value, or nothing if an element does not exist.
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

/// Returns the ROS name of a type: "sensor_msgs/msg/PointCloud2".
std::string type_name(const MessageMembers& members);
/// Returns "a, b, c", for hints about misspelt fields.
std::string names_of_fields(const Shape& message);

}  // namespace agnocast::ctl
