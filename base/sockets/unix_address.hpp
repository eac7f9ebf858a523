// SPDX-License-Identifier: Apache-2.0
//
// UnixAddress: a path in the kernel's form. Never an abstract name: those have no permissions.
#pragma once

#include <agnocast/result.hpp>

#include <sys/socket.h>
#include <sys/un.h>

#include <cstring>
#include <string_view>

namespace agnocast {

/// 107 bytes and the terminating zero.
inline constexpr std::size_t socket_path_bytes_max = sizeof(sockaddr_un::sun_path) - 1;

struct UnixAddress {
  sockaddr_un address{};

  const sockaddr* get() const noexcept { return reinterpret_cast<const sockaddr*>(&address); }
  static constexpr socklen_t size() noexcept { return sizeof(sockaddr_un); }
};

/// Makes an address. Errors: invalid_argument (empty, over 107 bytes, or a zero byte in it).
[[nodiscard]] inline Result<UnixAddress> unix_address(std::string_view path) noexcept {
  if (path.empty()) return fail(Errc::invalid_argument, "the path of a socket is empty");
  if (path.size() > socket_path_bytes_max)
    return fail(Errc::invalid_argument, "the path of a socket is longer than 107 bytes");
  if (path.find('\0') != std::string_view::npos)
    return fail(Errc::invalid_argument, "the path of a socket has a zero byte in it");
  UnixAddress result;
  result.address.sun_family = AF_UNIX;
  std::memcpy(result.address.sun_path, path.data(), path.size());
  return result;
}

}  // namespace agnocast
