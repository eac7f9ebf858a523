// SPDX-License-Identifier: Apache-2.0
//
// The topics that a service is made of, and how to tell them from others. They lie under a token that
// no other topic may begin with:
//
//   /_service/request/ns/name                    what clients ask
//   /_service/reply/c0123456789abcdef/ns/name    what one client is answered
//
// for the service /ns/name. The second one has the client's number in it, in hexadecimal digits.
#pragma once

#include <agnocast/export.hpp>

#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>

namespace agnocast {

/// What a topic is for.
struct TopicRole {
  enum class Kind : std::uint8_t { topic, request, reply };
  Kind kind = Kind::topic;
  std::string service;       ///< "/ns/name"; empty for an ordinary topic
  std::uint64_t client = 0;  ///< of a reply: the client that it is for
};

/// From a fully qualified name of a topic, also of another process. Any thread.
[[nodiscard]] AGNOCAST_PUBLIC TopicRole role_of_topic(std::string_view topic);
/// Whether no topic of a user may have this name: it begins with the token of services.
[[nodiscard]] AGNOCAST_PUBLIC bool is_service_topic(std::string_view topic) noexcept;

/// The topics of the service `service` ("/ns/name").
[[nodiscard]] AGNOCAST_PUBLIC std::string request_topic(std::string_view service);
[[nodiscard]] AGNOCAST_PUBLIC std::string reply_topic(std::string_view service,
                                                      std::uint64_t client);
/// Bytes that the name of a service can have, so that the names of its topics are not too long.
inline constexpr std::size_t service_name_length_max = 255 - 33;

}  // namespace agnocast
