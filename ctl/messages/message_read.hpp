// SPDX-License-Identifier: Apache-2.0
//
// Text to messages: YAML (and so JSON) as message_text.hpp prints it and as people write it.
#pragma once

#include <agnocast/generic.hpp>
#include <ctl/cli/problem.hpp>

#include <cstddef>
#include <string>
#include <vector>

namespace agnocast::ctl {

/// A message that was read, with the times in it that are to be those of its publishing: of a
/// header that is `auto` and a time that is `now`, as `ros2 topic pub` has it.
struct ReadMessage {
  OwnedGenericMessage message;
  std::vector<void*> times;  // std::int32_t seconds, then std::uint32_t nanoseconds

  void set_times(std::int64_t nanoseconds_since_epoch) const;
};

/// Each document of `text` as a message; an empty one at the end (echo ends with "---") is none.
/// Members that are not named have their defaults. Problems: failed, with the place: "header.stamp.sec:
/// 'x' is no int32". Bounded: documents nest as deep as the type.
Outcome<std::vector<ReadMessage>> read_messages(const std::string& text,
                                                const IntrospectedType& type);

}  // namespace agnocast::ctl
