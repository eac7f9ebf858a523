// SPDX-License-Identifier: Apache-2.0
#pragma once

namespace agnocast {

/// What an endpoint belongs to: a session of this process (client/session/), which outlives it. An
/// endpoint only tells it from another one.
class EndpointOwner {
 protected:
  EndpointOwner() = default;
  ~EndpointOwner() = default;
};

}  // namespace agnocast
