// SPDX-License-Identifier: Apache-2.0
//
// The files of a socket: its entry and the lock beside it, where other users may have made the
// same names first. These functions follow no links and use or change nothing of another user.
// The caller checks the directory first, because its owner could replace the files afterwards.
#pragma once

#include <agnocast/result.hpp>
#include <base/descriptors/unique_fd.hpp>

#include <tl/expected.hpp>

#include <sys/types.h>

#include <string>

namespace agnocast {

/// Why a directory is not safe for a socket.
struct SocketRefusal {
  Errc code = Errc::os_failure;
  std::string what;  ///< one sentence for the user, with the path
};
/// Checks that only root and this user can replace files in `directory`: the owner is one of
/// them, or a user without a number here, and others may write there only under the sticky bit,
/// which keeps names for their owners. Follows links on the way. Errors: permission_denied
/// (others could); os_failure (missing, not a directory).
[[nodiscard]] tl::expected<void, SocketRefusal> check_socket_directory(
    const std::string& directory);

/// Returns the directory that contains `path`.
std::string directory_of(const std::string& path);

/// Opens the lock file at `path`, or makes it. Errors: permission_denied, if a link or a file of
/// another user is there (the text says which); os_failure.
[[nodiscard]] Result<UniqueFd> open_lock_file(const std::string& path) noexcept;

/// Changes the mode of a socket's entry without following links: chmod() does, and not every
/// kernel has an fchmodat() that does not, so it opens the entry itself. Returns false with
/// errno; EPERM: no socket of this user.
bool set_mode_of_socket(const std::string& path, mode_t mode) noexcept;

}  // namespace agnocast
