// SPDX-License-Identifier: Apache-2.0
//
// The files of a socket: its entry and the lock beside it, where other users may have made the same names
// first. No link is followed to them, and nothing of another user is used or changed. The caller checks their
// directory first, whose owner could replace them afterwards.
#pragma once

#include <agnocast/result.hpp>
#include <base/unique_fd.hpp>

#include <tl/expected.hpp>

#include <sys/types.h>

#include <string>

namespace agnocast {

/// Why a socket must not be made somewhere.
struct SocketRefusal {
  Errc code = Errc::os_failure;
  std::string what;  ///< one sentence for people, with the path in it
};
/// Whether nobody but root and this user can replace what lies in `directory`: the owner is one of them, or a user
/// without a number here, and others write there only where the sticky bit keeps names for their owners. Links on the
/// way are followed. Errors: permission_denied (others could); os_failure (not there, not a directory).
[[nodiscard]] tl::expected<void, SocketRefusal> check_socket_directory(
    const std::string& directory);

/// The directory in which `path` lies.
std::string directory_of(const std::string& path);

/// Opens the lock file at `path`, or makes it. Errors: permission_denied, when a link or something of another
/// user lies there (the text says which); os_failure.
[[nodiscard]] Result<UniqueFd> open_lock_file(const std::string& path) noexcept;

/// chmod() follows links, and not every kernel knows an fchmodat() that does not. The entry itself is opened,
/// and reached through that. False: errno says why; EPERM when it is no socket of this user.
bool set_mode_of_socket(const std::string& path, mode_t mode) noexcept;

}  // namespace agnocast
