// SPDX-License-Identifier: Apache-2.0

#include <base/sockets/daemon_socket.hpp>

#include <fcntl.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <charconv>
#include <climits>
#include <cstdio>
#include <cstdlib>
#include <limits>
#include <new>
#include <optional>

namespace agnocast {
namespace {

template <class Number>
std::optional<Number> number_of(std::string_view text) noexcept {
  Number number{};
  const auto [end, problem] = std::from_chars(text.data(), text.data() + text.size(), number);
  if (problem != std::errc() || end != text.data() + text.size()) return std::nullopt;
  return number;
}

std::string first_line_of(const char* path) {
  std::array<char, 128> text{};
  const UniqueFd file(::open(path, O_RDONLY | O_CLOEXEC));
  const ssize_t bytes = file ? ::read(file.get(), text.data(), text.size()) : -1;
  const std::string all(text.data(), bytes > 0 ? static_cast<std::size_t>(bytes) : 0);
  return all.substr(0, all.find('\n'));
}

// The namespace of the whole host maps every number onto itself. Returns the stricter answer if
// nothing can be read.
bool has_unmapped_users() {
  unsigned long inside = 1, outside = 1, count = 0;
  const std::string line = first_line_of("/proc/self/uid_map");
  return std::sscanf(line.c_str(), "%lu %lu %lu", &inside, &outside, &count) != 3 || inside != 0 ||
         outside != 0 || count != std::numeric_limits<std::uint32_t>::max();
}

bool others_write(const struct stat& file) noexcept { return (file.st_mode & 0022) != 0; }

// Returns whether root made the directory (only root can write beside it) and gave it to this
// user.
bool is_given_by_root(const ServerFacts& facts, const std::string& path) {
  const std::size_t slash = path.rfind('/');
  if (path.empty() || path[0] != '/' || slash == 0) return false;
  const std::string directory = path.substr(0, slash);
  std::array<char, PATH_MAX> real{};
  if (::realpath(directory.c_str(), real.data()) == nullptr || directory != real.data())
    return false;
  const std::size_t above = directory.rfind('/');
  const std::string parent = above == 0 ? "/" : directory.substr(0, above);
  struct stat own {
  }, beside{};
  if (::lstat(directory.c_str(), &own) != 0 || ::lstat(parent.c_str(), &beside) != 0) return false;
  // In a user namespace the host's root has no number either; its mounter controls the
  // directories there.
  const bool is_roots = beside.st_uid == 0 || facts.is_unknown(beside.st_uid);
  return S_ISDIR(own.st_mode) && own.st_uid == facts.server && !others_write(own) && is_roots &&
         !others_write(beside);
}

}  // namespace

bool is_unknown_user(uid_t user) {
  constexpr uid_t usual = 65534;
  return user == number_of<uid_t>(first_line_of("/proc/sys/kernel/overflowuid")).value_or(usual) &&
         has_unmapped_users();
}

bool is_trusted_server(const ServerFacts& facts, const std::string& path) {
  if (facts.server == 0) return true;
  if (facts.server == facts.self && !facts.is_unknown(facts.self)) return true;
  if (number_of<uid_t>(facts.named) == facts.server) return true;
  return is_given_by_root(facts, path);
}

Result<PacketSocket> connect_to_daemon(const std::string& path,
                                       std::chrono::milliseconds patience) noexcept {
  Result<PacketSocket> socket = PacketSocket::connect(path, patience);
  if (!socket) return socket;
  ucred who{};
  socklen_t bytes = sizeof who;
  if (::getsockopt(socket->fd(), SOL_SOCKET, SO_PEERCRED, &who, &bytes) != 0)
    return fail(Errc::os_failure, "asking for the user that serves a socket", errno);
  ServerFacts facts;
  facts.server = who.uid;
  facts.self = ::geteuid();
  if (const char* const named = ::secure_getenv("AGNOCAST_DAEMON_UID"); named != nullptr)
    facts.named = named;
  try {
    if (is_trusted_server(facts, path)) return socket;
    return fail_with(Errc::daemon_untrusted,
                     path + " is served by user " + std::to_string(who.uid));
  } catch (const std::bad_alloc&) {
    return fail(Errc::os_failure, "asking for the user that serves a socket", ENOMEM);
  }
}

}  // namespace agnocast
