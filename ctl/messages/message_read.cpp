// SPDX-License-Identifier: Apache-2.0

#include <base/text/text.hpp>
#include <ctl/cli/unicode.hpp>
#include <ctl/messages/message_read.hpp>
#include <ctl/messages/message_value.hpp>

#include <yaml-cpp/binary.h>
#include <yaml-cpp/yaml.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstring>
#include <limits>
#include <utility>

namespace agnocast::ctl {
namespace {

namespace ros = rosidl_typesupport_introspection_cpp;

// Thrown to end the reading of a document; read_messages() catches it.
struct Refusal {
  std::string place;
  std::string why;
};

std::string shown(const std::string& text) { return "'" + escaped(text, 60) + "'"; }

// Returns "a mapping", "a list" or the text: the node that is there instead of the expected one.
std::string kind_of(const YAML::Node& node) {
  if (node.IsMap()) return "a mapping";
  if (node.IsSequence()) return "a list";
  return node.IsScalar() ? shown(node.Scalar()) : "nothing";
}

bool is_quoted(const YAML::Node& node) { return node.Tag() == "!"; }
bool is_binary(const YAML::Node& node) { return node.Tag() == "tag:yaml.org,2002:binary"; }

// Reads decimal, 0x…, 0o… and 0b…, with an optional sign.
template <class Number>
bool read_integer(std::string_view text, Number& number, bool& is_number) {
  const bool is_negative = text.starts_with('-');
  if (is_negative || text.starts_with('+')) text.remove_prefix(1);
  int base = 10;
  for (const auto& [prefix, of] : {std::pair("0x", 16), std::pair("0o", 8), std::pair("0b", 2)}) {
    if (text.starts_with(prefix)) base = of;
  }
  if (base != 10) text.remove_prefix(2);
  std::uint64_t magnitude = 0;
  const char* const end = text.data() + text.size();
  const auto read = std::from_chars(text.data(), end, magnitude, base);
  is_number = !text.empty() && read.ptr == end && read.ec != std::errc::invalid_argument;
  if (!is_number || read.ec != std::errc()) return false;
  constexpr auto most = static_cast<std::uint64_t>(std::numeric_limits<Number>::max());
  if (is_negative) {
    constexpr bool is_signed = std::numeric_limits<Number>::is_signed;
    if (magnitude > (is_signed ? most + 1 : 0)) return false;
    number = static_cast<Number>(0 - magnitude);
  } else {
    if (magnitude > most) return false;
    number = static_cast<Number>(magnitude);
  }
  return true;
}

class Reader {
 public:
  explicit Reader(ReadMessage& target) : target_(target) {}

  void message(const YAML::Node& node, const MessageMembers& members, void* at) {
    const Shape shape = Shape::of(members);
    const std::string type = type_name(members);
    if (node.IsScalar() && !is_quoted(node)) {
      if (type == "builtin_interfaces/msg/Time" && node.Scalar() == "now")
        return target_.times.push_back(at);
      if (type == "std_msgs/msg/Header" && node.Scalar() == "auto") {
        const std::uint32_t stamp = shape.find("stamp").value();
        return target_.times.push_back(static_cast<std::byte*>(at) +
                                       members.members_[stamp].offset_);
      }
    }
    if (!node.IsMap()) refuse(kind_of(node) + " is not of type " + type);
    std::vector<std::uint32_t> seen;
    for (const auto& entry : node) {
      if (!entry.first.IsScalar()) refuse(type + " has no such field");
      const std::string& name = entry.first.Scalar();
      const auto field = shape.find(name);
      if (!field)
        refuse(type + " has no field " + shown(name) + "; it has: " + names_of_fields(shape));
      if (std::find(seen.begin(), seen.end(), *field) != seen.end())
        refuse("field " + shown(name) + " occurs twice");
      seen.push_back(*field);
      const MessageMember& member = members.members_[*field];
      const std::size_t length = place_.size();
      place_ += (place_.empty() ? "" : ".") + name;
      this->member(entry.second, shape.field(*field), static_cast<std::byte*>(at) + member.offset_);
      place_.resize(length);
    }
  }

  const std::string& place() const { return place_; }

 private:
  [[noreturn]] void refuse(std::string why) const { throw Refusal{place_, std::move(why)}; }

  void member(const YAML::Node& node, const Shape& shape, void* at) {
    if (!shape.is_array) return element(node, shape, at);
    const MessageMember& of = *shape.member;
    if (!node.IsSequence()) refuse(kind_of(node) + " is not of type " + shape.type_name());
    const std::size_t count = node.size();
    const bool fits = shape.is_fixed()     ? count == of.array_size_
                      : of.is_upper_bound_ ? count <= of.array_size_
                                           : true;
    if (!fits) refuse(std::to_string(count) + " elements do not fit " + shape.type_name());
    if (!shape.is_fixed()) of.resize_function(at, count);
    std::size_t index = 0;
    for (const YAML::Node& item : node) {
      const std::size_t length = place_.size();
      place_ += '[' + std::to_string(index) + ']';
      if (of.type_id_ == ros::ROS_TYPE_BOOLEAN && !shape.is_fixed()) {
        (*static_cast<std::vector<bool>*>(at))[index] = boolean(item, shape.element());
      } else {
        element(item, shape.element(), of.get_function(at, index));
      }
      place_.resize(length);
      ++index;
    }
  }

  void element(const YAML::Node& node, const Shape& shape, void* at) {
    if (shape.is_message()) return message(node, *shape.members, at);
    if (!node.IsScalar()) refuse(kind_of(node) + " is not of type " + shape.type_name());
    switch (shape.member->type_id_) {
      case ros::ROS_TYPE_BOOLEAN:
        return put(at, boolean(node, shape));
      case ros::ROS_TYPE_INT8:
        return integer<std::int8_t>(node, shape, at);
      case ros::ROS_TYPE_INT16:
        return integer<std::int16_t>(node, shape, at);
      case ros::ROS_TYPE_INT32:
        return integer<std::int32_t>(node, shape, at);
      case ros::ROS_TYPE_INT64:
        return integer<std::int64_t>(node, shape, at);
      case ros::ROS_TYPE_UINT16:
      case ros::ROS_TYPE_WCHAR:
        return integer<std::uint16_t>(node, shape, at);
      case ros::ROS_TYPE_UINT32:
        return integer<std::uint32_t>(node, shape, at);
      case ros::ROS_TYPE_UINT64:
        return integer<std::uint64_t>(node, shape, at);
      case ros::ROS_TYPE_FLOAT:
        return floating<float>(node, shape, at);
      case ros::ROS_TYPE_DOUBLE:
        return put(at, real(node, shape));
      case ros::ROS_TYPE_LONG_DOUBLE:
        return put(at, static_cast<long double>(real(node, shape)));
      case ros::ROS_TYPE_STRING:
        *static_cast<std::string*>(at) = text(node, shape);
        return;
      case ros::ROS_TYPE_WSTRING:
        *static_cast<std::u16string*>(at) = wide_text(node, shape);
        return;
      default:
        return integer<std::uint8_t>(node, shape, at);
    }
  }

  template <class Number>
  static void put(void* at, Number number) {
    std::memcpy(at, &number, sizeof number);
  }

  bool boolean(const YAML::Node& node, const Shape& shape) const {
    static constexpr std::string_view yes[] = {"true", "True", "TRUE", "yes", "Yes",
                                               "YES",  "on",   "On",   "ON"},
                                      no[] = {"false", "False", "FALSE", "no", "No",
                                              "NO",    "off",   "Off",   "OFF"};
    if (node.IsScalar() && !is_quoted(node)) {
      if (std::find(std::begin(yes), std::end(yes), node.Scalar()) != std::end(yes)) return true;
      if (std::find(std::begin(no), std::end(no), node.Scalar()) != std::end(no)) return false;
    }
    refuse(kind_of(node) + " is not of type " + shape.type_name());
  }

  template <class Number>
  void integer(const YAML::Node& node, const Shape& shape, void* at) const {
    Number number{};
    bool is_number = false;
    const bool fits =
        !is_quoted(node) && read_integer(std::string_view(node.Scalar()), number, is_number);
    if (!fits)
      refuse(kind_of(node) + (is_number ? " is out of the range of " : " is not of type ") +
             shape.type_name());
    put(at, number);
  }

  double real(const YAML::Node& node, const Shape& shape) const {
    std::string text = node.Scalar();
    if (is_quoted(node)) refuse(kind_of(node) + " is not of type " + shape.type_name());
    std::transform(text.begin(), text.end(), text.begin(),
                   [](char c) { return c >= 'A' && c <= 'Z' ? static_cast<char>(c + 32) : c; });
    if (text == ".nan" || text == "nan") return std::numeric_limits<double>::quiet_NaN();
    const bool is_negative = text.starts_with('-');
    if (is_negative || text.starts_with('+')) text.erase(0, 1);
    double number = std::numeric_limits<double>::infinity();
    if (text != ".inf" && text != "inf") {
      const char* const end = text.data() + text.size();
      const auto read = std::from_chars(text.data(), end, number);
      const bool begins_well =
          !text.empty() && (text[0] == '.' || (text[0] >= '0' && text[0] <= '9'));
      if (!begins_well || read.ptr != end || read.ec == std::errc::invalid_argument)
        refuse(kind_of(node) + " is not of type " + shape.type_name());
      if (read.ec != std::errc())
        refuse(kind_of(node) + " is out of the range of " + shape.type_name());
    }
    return is_negative ? -number : number;
  }
  template <class Number>
  void floating(const YAML::Node& node, const Shape& shape, void* at) const {
    const double number = real(node, shape);
    if (std::isfinite(number) && std::abs(number) > double{std::numeric_limits<Number>::max()})
      refuse(kind_of(node) + " is out of the range of " + shape.type_name());
    put(at, static_cast<Number>(number));
  }

  std::string bytes(const YAML::Node& node) const {
    const std::vector<unsigned char> raw = YAML::DecodeBase64(node.Scalar());
    if (raw.empty() && !node.Scalar().empty()) refuse(kind_of(node) + " is not valid base64");
    return {raw.begin(), raw.end()};
  }
  void require_bound(std::size_t count, const Shape& shape) const {
    const std::size_t bound = shape.member->string_upper_bound_;
    if (bound != 0 && count > bound)
      refuse(std::to_string(count) + " characters do not fit " + shape.type_name());
  }
  std::string text(const YAML::Node& node, const Shape& shape) const {
    std::string text = is_binary(node) ? bytes(node) : node.Scalar();
    require_bound(text.size(), shape);
    return text;
  }
  std::u16string wide_text(const YAML::Node& node, const Shape& shape) const {
    std::u16string text;
    if (is_binary(node)) {
      const auto words = from_utf16_bytes(bytes(node));
      if (!words) refuse("an odd number of bytes cannot be a " + shape.type_name());
      text = *words;
    } else {
      const auto letters = from_utf8(node.Scalar());
      if (!letters) refuse(kind_of(node) + " is not valid UTF-8");
      text = to_utf16(*letters);
    }
    require_bound(text.size(), shape);
    return text;
  }

  ReadMessage& target_;
  std::string place_;
};

tl::unexpected<Problem> unreadable(std::string what, std::string why) {
  return problem(Status::failed, std::move(what), std::move(why),
                 "write it as agnocast-ctl topic echo prints it");
}

}  // namespace

void ReadMessage::set_times(std::int64_t nanoseconds_since_epoch) const {
  constexpr std::int64_t second = 1'000'000'000;
  const auto seconds = static_cast<std::int32_t>(nanoseconds_since_epoch / second);
  const auto rest = static_cast<std::uint32_t>(nanoseconds_since_epoch % second);
  for (void* const time : times) {
    std::memcpy(time, &seconds, sizeof seconds);
    std::memcpy(static_cast<std::byte*>(time) + sizeof seconds, &rest, sizeof rest);
  }
}

Outcome<std::vector<ReadMessage>> read_messages(const std::string& text,
                                                const IntrospectedType& type) {
  std::vector<ReadMessage> messages;
  try {
    for (const YAML::Node& document : YAML::LoadAll(text)) {
      if (!document.IsDefined() || document.IsNull()) continue;
      ReadMessage& read = messages.emplace_back(ReadMessage{type.make(), {}});
      Reader(read).message(document, type.members(), read.message.get());
    }
  } catch (const Refusal& refusal) {
    return unreadable(refusal.place.empty() ? type_name(type.members()) : refusal.place,
                      refusal.why);
  } catch (const YAML::Exception& error) {
    const std::string where = error.mark.is_null()
                                  ? ""
                                  : "line " + std::to_string(error.mark.line + 1) + ", column " +
                                        std::to_string(error.mark.column + 1);
    return unreadable("YAML", where + (where.empty() ? "" : ": ") + escaped(error.msg));
  }
  if (messages.empty()) return unreadable("YAML", "there is no message in it");
  return messages;
}

}  // namespace agnocast::ctl
