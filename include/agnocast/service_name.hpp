// SPDX-License-Identifier: Apache-2.0
//
// The topics of a service, and how to distinguish them from others. Their names begin with a
// token that is reserved for them:
//
//   /_service/request/ns/name                    requests of all clients
//   /_service/reply/c0123456789abcdef/ns/name    responses to one client
//
// for the service /ns/name. The second one contains the client's number in hexadecimal digits.
#pragma once

#include <agnocast/export.hpp>

#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>

namespace agnocast {

/// The purpose of a topic.
struct TopicRole {
  enum class Kind : std::uint8_t { topic, request, reply };
  Kind kind = Kind::topic;
  std::string service;       ///< "/ns/name"; empty for an ordinary topic
  std::uint64_t client = 0;  ///< for a reply: the receiving client
};

/// Returns the role of a fully qualified topic name, also of another process. Any thread.
[[nodiscard]] AGNOCAST_PUBLIC TopicRole role_of_topic(std::string_view topic);
/// Returns whether the name begins with the token of services, which topics of users may not use.
[[nodiscard]] AGNOCAST_PUBLIC bool is_service_topic(std::string_view topic) noexcept;

/// Return the topics of the service `service` ("/ns/name").
[[nodiscard]] AGNOCAST_PUBLIC std::string request_topic(std::string_view service);
[[nodiscard]] AGNOCAST_PUBLIC std::string reply_topic(std::string_view service,
                                                      std::uint64_t client);
/// Longest name of a service in bytes, so that the names of its topics are not too long.
inline constexpr std::size_t service_name_length_max = 255 - 33;

}  // namespace agnocast
