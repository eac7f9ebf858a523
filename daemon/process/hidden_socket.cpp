// SPDX-License-Identifier: Apache-2.0

#include <daemon/process/hidden_socket.hpp>

#include <base/sockets/unix_address.hpp>

#include <fcntl.h>
#include <sys/socket.h>
#include <unistd.h>

#include <cstdlib>
#include <string>

namespace agnocast::daemon {

std::optional<HiddenSocket> hidden_socket() {
  const char* const roots[] = {"/run", ::secure_getenv("XDG_RUNTIME_DIR"),
                               ::secure_getenv("TMPDIR"), "/tmp"};
  for (const char* const root : roots) {
    if (root == nullptr || *root == '\0') continue;
    std::string directory = std::string(root) + "/agnocastd-XXXXXX";
    if (::mkdtemp(directory.data()) == nullptr) continue;
    const std::string path = directory + "/notify";
    HiddenSocket made;
    made.socket.reset(::socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0));
    const auto address = unix_address(path);
    const int on = 1;
    if (made.socket && address &&
        ::setsockopt(made.socket.get(), SOL_SOCKET, SO_PASSCRED, &on, sizeof on) == 0 &&
        ::bind(made.socket.get(), address->get(), UnixAddress::size()) == 0)
      made.way.reset(::open(path.c_str(), O_PATH | O_CLOEXEC | O_NOFOLLOW));
    ::unlink(path.c_str());
    ::rmdir(directory.c_str());
    if (made.way) return made;
  }
  return std::nullopt;
}

}  // namespace agnocast::daemon
