// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <base/descriptors/unique_fd.hpp>

#include <optional>

namespace agnocast::daemon {

/// A socket that can be reached only through a descriptor of it: it was bound in a directory of
/// ours, and its name is removed.
struct HiddenSocket {
  UniqueFd socket;
  UniqueFd way;  // O_PATH; its /proc/self/fd/N is an address
};

/// Makes one in the first directory of /run, XDG_RUNTIME_DIR, TMPDIR and /tmp that can be written;
/// nothing: in none.
std::optional<HiddenSocket> hidden_socket();

}  // namespace agnocast::daemon
