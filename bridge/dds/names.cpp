// SPDX-License-Identifier: Apache-2.0

#include <bridge/dds/names.hpp>

#include <algorithm>
#include <array>

namespace agnocast::bridge {
namespace {

// ASCII, whatever the locale.
bool is_lower(char c) { return c >= 'a' && c <= 'z'; }
bool is_upper(char c) { return c >= 'A' && c <= 'Z'; }
bool is_digit(char c) { return c >= '0' && c <= '9'; }
bool is_letter(char c) { return is_lower(c) || is_upper(c); }

constexpr std::size_t name_bytes_max = 255;

bool is_topic_name(std::string_view name) {
  if (name.size() < 2 || name.size() > name_bytes_max || name.front() != '/' || name.back() == '/')
    return false;
  for (std::size_t i = 1; i < name.size(); ++i) {
    const bool begins = name[i - 1] == '/';
    if (is_letter(name[i]) || name[i] == '_') continue;
    if (begins || !(is_digit(name[i]) || name[i] == '/')) return false;
  }
  return true;
}

// In the order of DdsTopicKind.
struct Affixes {
  DdsTopicKind kind;
  std::string_view prefix;
  std::string_view suffix;
};
constexpr std::array affixes = {Affixes{DdsTopicKind::topic, "rt", ""},
                                Affixes{DdsTopicKind::request, "rq", "Request"},
                                Affixes{DdsTopicKind::reply, "rr", "Reply"}};

// The types that rosidl generates for services and actions; only these are messages.
constexpr std::array<std::string_view, 3> service_parts = {"_Request", "_Response", "_Event"};
constexpr std::array<std::string_view, 10> action_parts = {
    "_SendGoal_Request",   "_SendGoal_Response", "_SendGoal_Event", "_GetResult_Request",
    "_GetResult_Response", "_GetResult_Event",   "_Goal",           "_Result",
    "_Feedback",           "_FeedbackMessage"};

bool is_package(std::string_view name) {
  return !name.empty() && is_lower(name.front()) &&
         std::all_of(name.begin(), name.end(),
                     [](char c) { return is_lower(c) || is_digit(c) || c == '_'; });
}
bool is_interface(std::string_view name) {
  return !name.empty() && is_upper(name.front()) &&
         std::all_of(name.begin(), name.end(), [](char c) { return is_letter(c) || is_digit(c); });
}
template <std::size_t count>
bool is_part(std::string_view name, const std::array<std::string_view, count>& parts) {
  return std::any_of(parts.begin(), parts.end(), [&](std::string_view part) {
    return name.ends_with(part) && is_interface(name.substr(0, name.size() - part.size()));
  });
}

struct TypeName {
  std::string_view package;
  std::string_view folder;
  std::string_view name;

  bool is_valid() const {
    if (!is_package(package)) return false;
    if (folder == "msg") return is_interface(name);
    if (folder == "srv") return is_part(name, service_parts);
    return folder == "action" && is_part(name, action_parts);
  }
};

/// Returns `text` up to the separator and removes both from it; without a separator all of it.
std::string_view cut(std::string_view& text, std::string_view separator) {
  const std::size_t at = text.find(separator);
  const std::string_view first = text.substr(0, at);
  text.remove_prefix(at == std::string_view::npos ? text.size() : at + separator.size());
  return first;
}

}  // namespace

std::optional<std::string> dds_topic_of(const RosTopic& topic) {
  if (!is_topic_name(topic.name)) return std::nullopt;
  const auto& of = affixes[static_cast<std::size_t>(topic.kind)];
  return std::string(of.prefix) + topic.name + std::string(of.suffix);
}

std::optional<RosTopic> ros_topic_of(std::string_view dds_topic) {
  for (const Affixes& of : affixes) {
    if (dds_topic.size() < of.prefix.size() + of.suffix.size() ||
        !dds_topic.starts_with(of.prefix) || !dds_topic.ends_with(of.suffix))
      continue;
    dds_topic.remove_prefix(of.prefix.size());
    dds_topic.remove_suffix(of.suffix.size());
    if (!is_topic_name(dds_topic)) return std::nullopt;
    return RosTopic{of.kind, std::string(dds_topic)};
  }
  return std::nullopt;
}

std::optional<std::string> dds_type_of(std::string_view ros_type) {
  const std::string_view package = cut(ros_type, "/");
  const std::string_view folder = cut(ros_type, "/");
  const TypeName type{package, folder, ros_type};
  if (!type.is_valid()) return std::nullopt;
  return std::string(package) + "::" + std::string(folder) + "::dds_::" + std::string(ros_type) +
         "_";
}

std::optional<std::string> ros_type_of(std::string_view dds_type) {
  const std::string_view package = cut(dds_type, "::");
  const std::string_view folder = cut(dds_type, "::");
  const std::string_view module = cut(dds_type, "::");
  if (module != "dds_" || !dds_type.ends_with('_')) return std::nullopt;
  dds_type.remove_suffix(1);
  const TypeName type{package, folder, dds_type};
  if (!type.is_valid()) return std::nullopt;
  return std::string(package) + "/" + std::string(folder) + "/" + std::string(dds_type);
}

}  // namespace agnocast::bridge
