// SPDX-License-Identifier: Apache-2.0

#include <agnocast/service_name.hpp>
#include <base/text/names.hpp>

namespace agnocast {
namespace {

constexpr std::string_view root = "/_service/";
constexpr std::string_view request_prefix = "/_service/request";
constexpr std::string_view reply_prefix = "/_service/reply/c";
constexpr std::size_t digits = 16;
constexpr std::string_view digit = "0123456789abcdef";
static_assert(service_name_length_max + reply_prefix.size() + digits == name_length_max);

bool begins_with(std::string_view text, std::string_view prefix) noexcept {
  return text.substr(0, prefix.size()) == prefix;
}

}  // namespace

bool is_service_topic(std::string_view topic) noexcept { return begins_with(topic, root); }

TopicRole role_of_topic(std::string_view topic) {
  TopicRole role;
  std::string_view service;
  if (begins_with(topic, request_prefix)) {
    role.kind = TopicRole::Kind::request;
    service = topic.substr(request_prefix.size());
  } else if (begins_with(topic, reply_prefix) && topic.size() > reply_prefix.size() + digits) {
    // Only as reply_topic() writes it: one client has one name.
    for (const char c : topic.substr(reply_prefix.size(), digits)) {
      const std::size_t value = digit.find(c);
      if (value == digit.npos) return {};
      role.client = role.client << 4 | value;
    }
    role.kind = TopicRole::Kind::reply;
    service = topic.substr(reply_prefix.size() + digits);
  }
  if (check_topic_name(service)) return {};
  role.service = service;
  return role;
}

std::string request_topic(std::string_view service) {
  return std::string(request_prefix).append(service);
}

std::string reply_topic(std::string_view service, std::uint64_t client) {
  std::string topic(reply_prefix);
  for (int shift = 60; shift >= 0; shift -= 4) topic += digit[client >> shift & 15];
  return topic.append(service);
}

}  // namespace agnocast
