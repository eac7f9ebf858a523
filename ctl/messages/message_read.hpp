// SPDX-License-Identifier: Apache-2.0
//
// Text to messages: YAML (hence JSON), as message_text.hpp prints it or as people write it.
#pragma once

#include <agnocast/generic.hpp>
#include <ctl/cli/problem.hpp>

#include <cstddef>
#include <string>
#include <vector>

namespace agnocast::ctl {

/// A message that was read, and the times in it that are set when it is published: those of a
/// header `auto` and of a time `now`, as in `ros2 topic pub`.
struct ReadMessage {
  OwnedGenericMessage message;
  std::vector<void*> times;  // std::int32_t seconds, then std::uint32_t nanoseconds

  void set_times(std::int64_t nanoseconds_since_epoch) const;
};

/// Returns each document of `text` as a message, except an empty one at the end (echo ends with
/// "---"). Unnamed members keep their defaults. Problems: failed, with the place:
/// "header.stamp.sec: 'x' is not of type int32". Bounded: documents nest as deep as the type.
Outcome<std::vector<ReadMessage>> read_messages(const std::string& text,
                                                const IntrospectedType& type);

}  // namespace agnocast::ctl
