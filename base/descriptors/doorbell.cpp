// SPDX-License-Identifier: Apache-2.0

#include <base/descriptors/closing.hpp>
#include <base/descriptors/doorbell.hpp>
#include <base/descriptors/kept_fd.hpp>
#include <base/sockets/packet_socket.hpp>
#include <base/sockets/unix_address.hpp>

#include <fcntl.h>
#include <sys/epoll.h>
#include <sys/eventfd.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>

namespace agnocast {
namespace {

// net.unix.max_dgram_qlen is 10 by default, 512 at some distributors: one or a few rounds.
constexpr unsigned drain_batch = 32;
constexpr unsigned drain_rounds_max = 32;

// Builds an address from directory and name, without allocating.
Result<UnixAddress> address_in(const std::string& directory, std::string_view name) noexcept {
  if (name.empty() || name.find('/') != std::string_view::npos)
    return fail(Errc::invalid_argument, "the name of a doorbell is empty or has a slash");
  char path[socket_path_bytes_max];
  const std::size_t bytes = directory.size() + 1 + name.size();
  if (bytes > sizeof path)
    return fail(Errc::invalid_argument, "the path of a socket is longer than 107 bytes");
  std::memcpy(path, directory.data(), directory.size());
  path[directory.size()] = '/';
  std::memcpy(path + directory.size() + 1, name.data(), name.size());
  return unix_address({path, bytes});
}

Result<UniqueFd> make_socket() noexcept {
  UniqueFd fd(::socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0));
  if (!fd) return fail(Errc::os_failure, "making a socket", errno);
  return fd;
}

Result<UniqueFd> connect_to(const UnixAddress& address, socklen_t address_bytes) noexcept {
  Result<UniqueFd> made = make_socket();
  if (!made) return made;
  UniqueFd& fd = *made;
  if (::connect(fd.get(), address.get(), address_bytes) == 0) return made;
  if (errno == ENOENT || errno == ECONNREFUSED)
    return fail(Errc::endpoint_gone, "connecting to a doorbell", errno);
  return fail(Errc::os_failure, "connecting to a doorbell", errno);
}

// Peeks first, then takes the same datagram: no other thread reads from this socket.
bool drain_carefully(int socket) noexcept {
  for (unsigned count = 0; count < drain_batch * drain_rounds_max; ++count) {
    msghdr message{};  // without room: the kernel opens nothing, but reports that it would have
    if (::recvmsg(socket, &message, MSG_PEEK | MSG_DONTWAIT) < 0) {
      if (errno == EINTR) continue;
      return true;
    }
    if ((message.msg_flags & MSG_CTRUNC) == 0) {
      static_cast<void>(::recv(socket, nullptr, 0, MSG_DONTWAIT));
    } else if (!throw_datagram_away(socket)) {
      return false;
    }
  }
  return true;
}

}  // namespace

Doorbell::Rung Doorbell::ring() const noexcept {
  if (!datagram_) return Rung::gone;
  if (has_lost_kept() && (!is_intact(datagram_.get()) || (eventfd_ && !is_intact(eventfd_.get()))))
    return Rung::gone;
  if (eventfd_) {
    const std::uint64_t one = 1;
    ssize_t status = 0;
    do {
      status = ::write(eventfd_.get(), &one, sizeof one);
    } while (status < 0 && errno == EINTR);
    if (status == sizeof one) return Rung::rung;
    // EAGAIN: another process filled the counter. Anything else: not an eventfd. The datagram
    // decides.
  }
  ssize_t status = 0;
  do {
    status = ::send(datagram_.get(), "", 1, MSG_DONTWAIT | MSG_NOSIGNAL);
  } while (status < 0 && errno == EINTR);
  if (status >= 0 || errno == EAGAIN) return Rung::rung;
  return errno == ENOMEM || errno == ENOBUFS ? Rung::exhausted : Rung::gone;
}

Result<void> DoorbellReceiver::add_to(int epoll, std::uint64_t eventfd_tag,
                                      std::uint64_t datagram_tag) const noexcept {
  epoll_event event{};
  event.events = EPOLLIN | EPOLLET;
  event.data.u64 = eventfd_tag;
  if (::epoll_ctl(epoll, EPOLL_CTL_ADD, eventfd_.get(), &event) != 0)
    return fail(Errc::os_failure, "adding an eventfd to an epoll set", errno);
  event.events = EPOLLIN;
  event.data.u64 = datagram_tag;
  if (::epoll_ctl(epoll, EPOLL_CTL_ADD, datagram_.get(), &event) != 0) {
    const int error = errno;
    ::epoll_ctl(epoll, EPOLL_CTL_DEL, eventfd_.get(), nullptr);
    return fail(Errc::os_failure, "adding a doorbell to an epoll set", error);
  }
  return {};
}

void DoorbellReceiver::remove_from(int epoll) const noexcept {
  if (has_lost_kept()) return;  // these numbers may belong to other files now
  ::epoll_ctl(epoll, EPOLL_CTL_DEL, eventfd_.get(), nullptr);
  ::epoll_ctl(epoll, EPOLL_CTL_DEL, datagram_.get(), nullptr);
}

void DoorbellReceiver::mute(int epoll) const noexcept {
  if (has_lost_kept()) return;
  ::epoll_ctl(epoll, EPOLL_CTL_DEL, datagram_.get(), nullptr);
}

DoorbellReceiver::~DoorbellReceiver() {
  if (datagram_ && !refuses_descriptors(datagram_.get()))
    close_without_waiting(std::move(datagram_));
}

bool DoorbellReceiver::drain() const noexcept {
  if (!may_use(datagram_.get())) return true;
  if (!refuses_descriptors(datagram_.get())) return drain_carefully(datagram_.get());
  mmsghdr messages[drain_batch];
  for (unsigned round = 0; round < drain_rounds_max; ++round) {
    std::memset(messages, 0, sizeof messages);
    const int count = ::recvmmsg(datagram_.get(), messages, drain_batch, MSG_DONTWAIT, nullptr);
    if (count < 0 && errno == EINTR) continue;
    if (count < static_cast<int>(drain_batch)) break;
  }
  return true;
}

Result<DoorbellReceiver> make_doorbell(const std::string& directory,
                                       std::string_view name) noexcept {
  const auto address = address_in(directory, name);
  if (!address) return tl::unexpected(address.error());
  // Any process that may enter the directory could connect a sender of its own.
  struct stat entry {};
  if (::stat(directory.c_str(), &entry) != 0)
    return fail(Errc::os_failure, "looking at the directory of doorbells", errno);
  if (!S_ISDIR(entry.st_mode) || entry.st_uid != ::geteuid() || (entry.st_mode & 077) != 0)
    return fail(Errc::permission_denied, "the directory of doorbells is not the daemon's alone");

  UniqueFd ringer(::eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC));
  if (!ringer) return fail(Errc::os_failure, "making an eventfd", errno);
  UniqueFd receiver(::socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0));
  if (!receiver) return fail(Errc::os_failure, "making a socket", errno);
  refuse_descriptors(receiver.get());
  if (::unlink(address->address.sun_path) != 0 && errno != ENOENT)
    return fail(Errc::os_failure, "replacing a doorbell", errno);
  if (::bind(receiver.get(), address->get(), UnixAddress::size()) != 0)
    return fail(Errc::os_failure, "binding a doorbell", errno);
  return DoorbellReceiver(std::move(ringer), std::move(receiver));
}

Result<UniqueFd> connect_doorbell(const std::string& directory, std::string_view name) noexcept {
  const auto address = address_in(directory, name);
  if (!address) return tl::unexpected(address.error());
  return connect_to(*address, UnixAddress::size());
}

Result<UniqueFd> connect_doorbell(int receiver) noexcept {
  UnixAddress address;
  socklen_t bytes = UnixAddress::size();
  if (::getsockname(receiver, reinterpret_cast<sockaddr*>(&address.address), &bytes) != 0)
    return fail(Errc::os_failure, "asking a doorbell for its name", errno);
  return connect_to(address, bytes);
}

Result<UniqueFd> make_mute_doorbell() noexcept { return make_socket(); }

}  // namespace agnocast
