// SPDX-License-Identifier: Apache-2.0
#pragma once

namespace agnocast {

/// The session (client/session/) that an endpoint belongs to. It outlives the endpoint, which only
/// tells it from another one.
class EndpointOwner {
 protected:
  EndpointOwner() = default;
  ~EndpointOwner() = default;
};

}  // namespace agnocast
