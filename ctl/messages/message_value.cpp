// SPDX-License-Identifier: Apache-2.0

#include <base/text/text.hpp>
#include <ctl/messages/message_value.hpp>

#include <charconv>
#include <cstring>

namespace agnocast::ctl {
namespace {

namespace ros = rosidl_typesupport_introspection_cpp;

// The only member of a message that has no members; hidden from users.
constexpr std::string_view no_member = "structure_needs_at_least_one_member";

template <class Number>
Number number_at(const void* at) {
  Number number;
  std::memcpy(&number, at, sizeof number);
  return number;
}

const char* element_name(const MessageMember& member) {
  switch (member.type_id_) {
    case ros::ROS_TYPE_BOOLEAN:
      return "bool";
    case ros::ROS_TYPE_OCTET:
      return "byte";
    case ros::ROS_TYPE_CHAR:
    case ros::ROS_TYPE_UINT8:
      return "uint8";
    case ros::ROS_TYPE_INT8:
      return "int8";
    case ros::ROS_TYPE_WCHAR:
      return "wchar";
    case ros::ROS_TYPE_UINT16:
      return "uint16";
    case ros::ROS_TYPE_INT16:
      return "int16";
    case ros::ROS_TYPE_UINT32:
      return "uint32";
    case ros::ROS_TYPE_INT32:
      return "int32";
    case ros::ROS_TYPE_UINT64:
      return "uint64";
    case ros::ROS_TYPE_INT64:
      return "int64";
    case ros::ROS_TYPE_FLOAT:
      return "float32";
    case ros::ROS_TYPE_DOUBLE:
      return "float64";
    case ros::ROS_TYPE_LONG_DOUBLE:
      return "long double";
    case ros::ROS_TYPE_STRING:
      return "string";
    case ros::ROS_TYPE_WSTRING:
      return "wstring";
    default:
      return "unknown";
  }
}

}  // namespace

std::string type_name(const MessageMembers& members) {
  std::string name = members.message_namespace_;
  for (std::size_t at = 0; (at = name.find("::")) != std::string::npos;) name.replace(at, 2, "/");
  return name + '/' + members.message_name_;
}

bool Shape::is_text() const {
  return is_scalar() &&
         (member->type_id_ == ros::ROS_TYPE_STRING || member->type_id_ == ros::ROS_TYPE_WSTRING);
}
bool Shape::is_boolean() const { return is_scalar() && member->type_id_ == ros::ROS_TYPE_BOOLEAN; }

std::uint32_t Shape::field_count() const {
  const bool is_empty = members->member_count_ == 1 && members->members_[0].name_ == no_member;
  return is_empty ? 0 : members->member_count_;
}

Shape Shape::field(std::uint32_t index) const {
  const MessageMember& of = members->members_[index];
  return {of.type_id_ == ros::ROS_TYPE_MESSAGE ? &detail::nested_members(of) : nullptr, &of,
          of.is_array_};
}

std::optional<std::uint32_t> Shape::find(std::string_view name) const {
  for (std::uint32_t i = 0; i < field_count(); ++i) {
    if (field_name(i) == name) return i;
  }
  return std::nullopt;
}

std::string Shape::type_name() const {
  std::string name = members != nullptr ? ctl::type_name(*members) : element_name(*member);
  if (member == nullptr) return name;
  if (members == nullptr && member->string_upper_bound_ != 0)
    name += "<=" + std::to_string(member->string_upper_bound_);
  if (!is_array) return name;
  if (member->array_size_ == 0) return name + "[]";
  return name + (member->is_upper_bound_ ? "[<=" : "[") + std::to_string(member->array_size_) + ']';
}

std::string names_of_fields(const Shape& message) {
  std::string names;
  for (std::uint32_t i = 0; i < message.field_count(); ++i)
    names += (i == 0 ? "" : ", ") + std::string(message.field_name(i));
  return names.empty() ? "none" : names;
}

Value Value::field(std::uint32_t index) const {
  return {shape_.field(index),
          static_cast<const std::byte*>(at_) + shape_.members->members_[index].offset_};
}

std::size_t Value::size() const {
  return shape_.is_fixed() ? shape_.member->array_size_ : shape_.member->size_function(at_);
}

Value Value::element(std::size_t index) const {
  const MessageMember& member = *shape_.member;
  Value value(shape_.element(), at_);
  if (member.type_id_ == ros::ROS_TYPE_BOOLEAN && !shape_.is_fixed()) {
    value.bit_ = (*static_cast<const std::vector<bool>*>(at_))[index];
  } else {
    value.at_ = member.get_const_function(at_, index);
  }
  return value;
}

Scalar Value::scalar() const {
  switch (shape_.member->type_id_) {
    case ros::ROS_TYPE_BOOLEAN:
      // A byte of another process may hold values that a bool cannot.
      return bit_ ? *bit_ : number_at<std::uint8_t>(at_) != 0;
    case ros::ROS_TYPE_INT8:
      return std::int64_t{number_at<std::int8_t>(at_)};
    case ros::ROS_TYPE_INT16:
      return std::int64_t{number_at<std::int16_t>(at_)};
    case ros::ROS_TYPE_INT32:
      return std::int64_t{number_at<std::int32_t>(at_)};
    case ros::ROS_TYPE_INT64:
      return number_at<std::int64_t>(at_);
    case ros::ROS_TYPE_UINT16:
    case ros::ROS_TYPE_WCHAR:
      return std::uint64_t{number_at<std::uint16_t>(at_)};
    case ros::ROS_TYPE_UINT32:
      return std::uint64_t{number_at<std::uint32_t>(at_)};
    case ros::ROS_TYPE_UINT64:
      return number_at<std::uint64_t>(at_);
    case ros::ROS_TYPE_FLOAT:
      return double{number_at<float>(at_)};
    case ros::ROS_TYPE_DOUBLE:
      return number_at<double>(at_);
    case ros::ROS_TYPE_LONG_DOUBLE:
      return static_cast<double>(number_at<long double>(at_));
    case ros::ROS_TYPE_STRING:
      return std::string_view(*static_cast<const std::string*>(at_));
    case ros::ROS_TYPE_WSTRING:
      return std::u16string_view(*static_cast<const std::u16string*>(at_));
    default:
      return std::uint64_t{number_at<std::uint8_t>(at_)};
  }
}

Outcome<Path> Path::parse(std::string_view text, const MessageMembers& type) {
  Path path;
  path.text_ = text;
  path.shape_ = Shape::of(type);
  const auto wrong = [&](const std::string& why) {
    return problem(Status::wrong_usage, in_quotes(text), why,
                   "the fields of " + type_name(type) + ": " + names_of_fields(Shape::of(type)));
  };
  std::string_view rest = text;
  for (bool first = true; !rest.empty() || first; first = false) {
    if (rest.starts_with('[')) {
      std::size_t index = 0;
      const auto read = std::from_chars(rest.data() + 1, rest.data() + rest.size(), index);
      if (read.ec != std::errc() || read.ptr == rest.data() + rest.size() || *read.ptr != ']')
        return wrong("'[' needs an index and ']'");
      if (!path.shape_.is_array) return wrong(path.shape_.type_name() + " has no elements");
      if (path.shape_.is_fixed() && index >= path.shape_.member->array_size_)
        return wrong("element " + std::to_string(index) + " is not in " + path.shape_.type_name());
      path.steps_.push_back({std::nullopt, index});
      path.shape_ = path.shape_.element();
      rest.remove_prefix(static_cast<std::size_t>(read.ptr + 1 - rest.data()));
      continue;
    }
    if (!first) {
      if (!rest.starts_with('.')) return wrong("a '.' or '[' is missing");
      rest.remove_prefix(1);
    }
    const std::string_view name = rest.substr(0, rest.find_first_of(".["));
    if (name.empty()) return wrong("a name is missing");
    if (!path.shape_.is_message())
      return wrong(path.shape_.type_name() + " has no field " + in_quotes(name));
    const auto field = path.shape_.find(name);
    if (!field)
      return wrong(path.shape_.type_name() + " has no field " + in_quotes(name) +
                   "; it has: " + names_of_fields(path.shape_));
    path.steps_.push_back({field, 0});
    path.shape_ = path.shape_.field(*field);
    rest.remove_prefix(name.size());
  }
  return path;
}

std::optional<Value> Path::in(const Value& message) const {
  Value value = message;
  for (const Step& step : steps_) {
    if (step.field) {
      value = value.field(*step.field);
    } else if (step.element < value.size()) {
      value = value.element(step.element);
    } else {
      return std::nullopt;
    }
  }
  return value;
}

}  // namespace agnocast::ctl
