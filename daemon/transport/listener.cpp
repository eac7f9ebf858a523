// SPDX-License-Identifier: Apache-2.0

#include <daemon/transport/listener.hpp>

#include <base/descriptors/closing.hpp>
#include <base/sockets/socket_file.hpp>
#include <base/sockets/unix_address.hpp>

#include <dirent.h>
#include <fcntl.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <charconv>
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <memory>
#include <string_view>
#include <system_error>

namespace agnocast::daemon {
namespace {

// The longest name of a doorbell must fit into a socket's address after its directory.
constexpr std::size_t doorbells_length_max = 107 - (sizeof "/2047.31" - 1);

std::string reason(int error) { return std::generic_category().message(error); }

tl::unexpected<Complaint> complain(Errc code, std::string what) {
  return tl::unexpected<Complaint>(Complaint{code, std::move(what)});
}

/// Sets the mode of a directory that this process has just made, whatever the umask. It may have
/// been replaced since, so no link is followed.
bool set_mode(const std::string& directory, mode_t mode) noexcept {
  const UniqueFd made(::open(directory.c_str(), O_RDONLY | O_DIRECTORY | O_NOFOLLOW | O_CLOEXEC));
  struct stat entry {};
  return made && ::fstat(made.get(), &entry) == 0 && entry.st_uid == ::geteuid() &&
         ::fchmod(made.get(), mode) == 0;
}

tl::expected<void, Complaint> make_directory(const std::string& directory) {
  if (::mkdir(directory.c_str(), 0755) == 0) {
    if (!set_mode(directory, 0755))
      return complain(Errc::os_failure, "cannot use directory " + directory + ": " + reason(errno));
  } else if (errno != EEXIST) {
    return complain(Errc::os_failure, "cannot make directory " + directory + ": " + reason(errno));
  }
  if (auto checked = check_socket_directory(directory); !checked)
    return complain(checked.error().code, std::move(checked.error().what));
  return {};
}

// Returns the number in the lock file, or 0 for any other content.
std::uint64_t read_count(int lock) noexcept {
  char text[20];
  const ssize_t bytes = ::pread(lock, text, sizeof text, 0);
  std::uint32_t count = 0;
  if (bytes > 0) std::from_chars(text, text + bytes, count);
  return count;
}

void write_count(int lock, std::uint64_t count) noexcept {
  char text[20];
  char* const end = std::to_chars(text, text + sizeof text, static_cast<std::uint32_t>(count)).ptr;
  // A failure costs the next daemon its fresh addresses and nothing else.
  if (::pwrite(lock, text, static_cast<std::size_t>(end - text), 0) == end - text) [[maybe_unused]]
    const int cut = ::ftruncate(lock, end - text);
}

void clear_doorbells(const std::string& directory) noexcept {
  const std::unique_ptr<DIR, int (*)(DIR*)> entries(::opendir(directory.c_str()), &::closedir);
  if (entries == nullptr) return;
  while (const dirent* const entry = ::readdir(entries.get())) {
    if (entry->d_name[0] != '.') ::unlinkat(::dirfd(entries.get()), entry->d_name, 0);
  }
}

tl::expected<void, Complaint> make_doorbells(const std::string& directory) {
  if (::mkdir(directory.c_str(), 0700) != 0 && errno != EEXIST)
    return complain(Errc::os_failure, "cannot make directory " + directory + ": " + reason(errno));
  struct stat entry {};
  if (::lstat(directory.c_str(), &entry) != 0)
    return complain(Errc::os_failure, "cannot use directory " + directory + ": " + reason(errno));
  if (!S_ISDIR(entry.st_mode) || entry.st_uid != ::geteuid())
    return complain(Errc::permission_denied,
                    "cannot use " + directory + ": it is not a directory of this user");
  if (!set_mode(directory, 0700))
    return complain(Errc::os_failure, "cannot use directory " + directory + ": " + reason(errno));
  clear_doorbells(directory);
  return {};
}

tl::expected<void, Complaint> clear_socket(const std::string& path) {
  struct stat entry {};
  if (::lstat(path.c_str(), &entry) != 0) {
    if (errno == ENOENT) return {};
    return complain(Errc::os_failure, "cannot use " + path + ": " + reason(errno));
  }
  if (!S_ISSOCK(entry.st_mode))
    return complain(Errc::os_failure, "cannot use " + path + ": it exists and is not a socket");
  const auto other = PacketSocket::connect(path);
  if (other) return complain(Errc::already_running, "another agnocastd is running at " + path);
  if (other.error().code != Errc::daemon_not_running || other.error().os_errno == ETIMEDOUT)
    return complain(Errc::os_failure, "cannot use " + path + ": another program has this socket (" +
                                          reason(other.error().os_errno) + ")");
  if (::unlink(path.c_str()) != 0 && errno != ENOENT)
    return complain(Errc::os_failure,
                    "cannot remove the stale socket " + path + ": " + reason(errno));
  return {};
}

// Ignores a name whose socket is gone: a death right after a bind leaves one.
bool somebody_listens(const std::string& path) noexcept {
  if (::access(path.c_str(), F_OK) != 0) return false;
  const auto probe = PacketSocket::connect(path, std::chrono::milliseconds{0});
  return probe || probe.error().os_errno != ECONNREFUSED;
}

constexpr std::string_view doorbells_suffix = ".bells", lock_suffix = ".lock";

}  // namespace

tl::expected<std::string, Complaint> Listener::place_of(const UniqueFd& passed) {
  const auto option = [&](int name) {
    int value = -1;
    socklen_t bytes = sizeof value;
    return ::getsockopt(passed.get(), SOL_SOCKET, name, &value, &bytes) == 0 ? value : -1;
  };
  UnixAddress address;
  socklen_t bytes = UnixAddress::size();
  if (option(SO_DOMAIN) != AF_UNIX || option(SO_TYPE) != SOCK_SEQPACKET ||
      option(SO_ACCEPTCONN) != 1 ||
      ::getsockname(passed.get(), reinterpret_cast<sockaddr*>(&address.address), &bytes) != 0 ||
      bytes > UnixAddress::size() || address.address.sun_path[0] != '/')
    return complain(Errc::invalid_argument,
                    "cannot use the passed socket: it must be of AF_UNIX and "
                    "SOCK_SEQPACKET, listen, and have an absolute path "
                    "(ListenSequentialPacket=/run/agnocast/agnocastd.sock)");
  const char* const path = address.address.sun_path;
  return std::string(path, ::strnlen(path, sizeof address.address.sun_path));
}

tl::expected<void, Complaint> Listener::listen_at(const std::string& path, UniqueFd passed) {
  is_passed_ = true;
  path_ = path;
  socket_ = PacketListener(std::move(passed));
  refuse_descriptors(socket_.fd());
  if (auto wanted = socket_.want_credentials(true); !wanted)
    return complain(Errc::os_failure,
                    "cannot listen at " + path + ": " + reason(wanted.error().os_errno));
  return {};
}

std::string Listener::differences(const ListenerOptions& options) const {
  if (!is_passed_) return "";
  struct stat entry {};
  if (::lstat(path_.c_str(), &entry) != 0)
    return "no client can reach " + path_ + ": " + reason(errno);
  std::string all;
  const auto add = [&](const std::string& what, const std::string& is, const std::string& wanted) {
    if (is != wanted) all += (all.empty() ? "" : ", ") + what + " is " + is + " and not " + wanted;
  };
  const auto octal = [](mode_t mode) {
    std::array<char, 8> text{};
    std::snprintf(text.data(), text.size(), "%04o", mode & 07777U);
    return std::string(text.data());
  };
  add("its path", path_, options.path);
  add("its mode", octal(entry.st_mode), octal(options.mode));
  if (options.group) add("its group", std::to_string(entry.st_gid), std::to_string(*options.group));
  return all;
}

tl::expected<Listener, Complaint> Listener::open(const ListenerOptions& options, UniqueFd passed) {
  std::string path = options.path;
  if (passed) {
    auto place = place_of(passed);
    if (!place) return tl::unexpected(place.error());
    path = std::move(*place);
  }
  const std::string& directory = options.runtime_directory;
  const std::string base = directory + "/" + path.substr(path.rfind('/') + 1);
  if (path.empty() || path.size() > 107)
    return complain(Errc::invalid_argument,
                    "cannot use socket path " + path + ": it must have 1 to 107 bytes");
  Listener listener;
  listener.doorbells_ = base;
  listener.doorbells_ += doorbells_suffix;
  if (listener.doorbells_.size() > doorbells_length_max)
    return complain(Errc::invalid_argument, "cannot use runtime directory " + directory + ": " +
                                                listener.doorbells_ + " must have at most " +
                                                std::to_string(doorbells_length_max) + " bytes");
  for (const std::string& wanted : {directory_of(path), directory}) {
    if (auto made = make_directory(wanted); !made) return tl::unexpected(made.error());
  }

  if (auto locked = listener.lock(base, path); !locked) return tl::unexpected(locked.error());
  listener.former_count_ = read_count(listener.lock_.get());
  write_count(listener.lock_.get(), listener.former_count_ + 1);
  if (!passed) {
    if (auto cleared = clear_socket(path); !cleared) return tl::unexpected(cleared.error());
  }
  if (auto made = make_doorbells(listener.doorbells_); !made) return tl::unexpected(made.error());

  auto listening = passed ? listener.listen_at(path, std::move(passed)) : listener.listen(options);
  if (!listening) return tl::unexpected(listening.error());
  return listener;
}

/// `base`: start of the names in the runtime directory.
tl::expected<void, Complaint> Listener::lock(const std::string& base, const std::string& path) {
  const std::string lock_path = std::string(base).append(lock_suffix);
  // In a sticky directory for all users another user may have made the name first.
  auto opened = open_lock_file(lock_path);
  if (!opened && opened.error().code == Errc::permission_denied)
    return complain(Errc::permission_denied,
                    "cannot use " + lock_path + ": " + opened.error().what);
  if (!opened) {
    const int error = opened.error().os_errno;
    return complain(error == EACCES || error == EPERM ? Errc::permission_denied : Errc::os_failure,
                    "cannot write in directory " + directory_of(lock_path) + ": " + reason(error));
  }
  lock_ = std::move(*opened);
  if (::flock(lock_.get(), LOCK_EX | LOCK_NB) == 0) return {};
  if (errno == EWOULDBLOCK)
    return complain(Errc::already_running, "another agnocastd is running at " + path);
  return complain(Errc::os_failure, "cannot lock " + lock_path + ": " + reason(errno));
}

tl::expected<void, Complaint> Listener::listen(const ListenerOptions& options) {
  const std::string& path = options.path;
  auto socket = PacketListener::bind(path);
  if (!socket) {
    if (socket.error().code == Errc::already_running)
      return complain(Errc::already_running, "another agnocastd is running at " + path);
    return complain(socket.error().code,
                    "cannot listen at " + path + ": " + reason(socket.error().os_errno));
  }
  path_ = path;  // from here on the destructor has something to remove
  socket_ = std::move(*socket);
  refuse_descriptors(socket_.fd());  // if the kernel can; Acceptor checks every connection
  if (auto wanted = socket_.want_credentials(true); !wanted)
    return complain(Errc::os_failure,
                    "cannot listen at " + path + ": " + reason(wanted.error().os_errno));
  if (options.group && ::lchown(path.c_str(), static_cast<uid_t>(-1), *options.group) != 0)
    return complain(Errc::permission_denied, "cannot give " + path + " to group " +
                                                 std::to_string(*options.group) + ": " +
                                                 reason(errno));
  if (!set_mode_of_socket(path, options.mode))
    return complain(Errc::os_failure, "cannot set the mode of " + path + ": " + reason(errno));
  if (auto listening = socket_.listen(); !listening)
    return complain(Errc::os_failure,
                    "cannot listen at " + path + ": " + reason(listening.error().os_errno));
  return {};
}

tl::expected<Listener, Complaint> Listener::adopt(const ListenerOptions& options, UniqueFd passed,
                                                  UniqueFd socket, UniqueFd lock,
                                                  const std::string& doorbells) {
  Listener listener;
  listener.removes_ = false;
  listener.doorbells_ = doorbells;
  std::string path = options.path;
  if (passed) {
    auto place = place_of(passed);
    if (!place) return tl::unexpected(place.error());
    path = std::move(*place);
  } else if (socket) {
    UnixAddress address;
    socklen_t bytes = UnixAddress::size();
    int listens = 0;
    socklen_t listens_bytes = sizeof listens;
    if (::getsockname(socket.get(), reinterpret_cast<sockaddr*>(&address.address), &bytes) != 0 ||
        ::getsockopt(socket.get(), SOL_SOCKET, SO_ACCEPTCONN, &listens, &listens_bytes) != 0 ||
        listens == 0)
      return complain(Errc::internal, "the stored socket does not listen");
    ::fcntl(socket.get(), F_SETFL, ::fcntl(socket.get(), F_GETFL) | O_NONBLOCK);
    path = address.address.sun_path;
  }
  if (!lock) {
    const std::string base =
        doorbells.substr(0, doorbells.size() - std::min(doorbells.size(), doorbells_suffix.size()));
    if (auto locked = listener.lock(base, path); !locked) return tl::unexpected(locked.error());
  } else if (::flock(lock.get(), LOCK_EX | LOCK_NB) != 0) {
    return complain(Errc::already_running, "another agnocastd holds the stored lock");
  } else {
    listener.lock_ = std::move(lock);
  }
  listener.former_count_ = std::max<std::uint64_t>(read_count(listener.lock_.get()), 1) - 1;
  if (::mkdir(doorbells.c_str(), 0700) == 0) static_cast<void>(set_mode(doorbells, 0700));
  if (passed) {
    if (auto listening = listener.listen_at(path, std::move(passed)); !listening)
      return tl::unexpected(listening.error());
    return listener;
  }
  if (socket && somebody_listens(path)) {
    listener.socket_ = PacketListener(std::move(socket));
    refuse_descriptors(listener.socket_.fd());
    listener.path_ = path;
    return listener;
  }
  listener.renewed_ = true;
  // Closing it ends the connections in a queue that no client can reach any more.
  close_without_waiting(std::move(socket));
  if (auto cleared = clear_socket(path); !cleared) return tl::unexpected(cleared.error());
  ListenerOptions again = options;
  again.path = path;
  if (auto listening = listener.listen(again); !listening) return tl::unexpected(listening.error());
  return listener;
}

Result<void> Listener::keep(DescriptorStore& store) const {
  if (!store.is_kept("lock")) {
    if (auto kept = store.put("lock", lock_.get()); !kept) return kept;
  }
  if (renewed_ || is_passed_) store.remove("listen");  // the previous one, out of reach
  if (is_passed_) return {};
  return store.is_kept("listen") ? Result<void>() : store.put("listen", socket_.fd());
}

Listener::~Listener() {
  // Connections that wait to be accepted end with the socket, with all that they carry: the end of
  // the process closes it without lingering.
  static_cast<void>(socket_.release().release());
  if (path_.empty() || !removes_) return;
  if (!is_passed_) ::unlink(path_.c_str());
  clear_doorbells(doorbells_);
  ::rmdir(doorbells_.c_str());
}

}  // namespace agnocast::daemon
