// SPDX-License-Identifier: Apache-2.0
//
// PeerOwner: the user of a peer's process, from the daemon. A uid alone does not identify this
// process's own user: the daemon and this process may be in different user namespaces.
#pragma once

#include <cstdint>

namespace agnocast {

struct PeerOwner {
  std::uint32_t uid = 0;  // in the daemon's namespace: a key, never compared with geteuid()
  bool is_own = false;    // this process's own user, in the same user namespace
};

}  // namespace agnocast
