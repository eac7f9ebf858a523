// SPDX-License-Identifier: Apache-2.0

#include <base/descriptors/kept_fd.hpp>
#include <base/sockets/packet_socket.hpp>
#include <base/sockets/unix_address.hpp>

#include <sys/eventfd.h>
#include <sys/stat.h>
#include <sys/time.h>
#include <sys/uio.h>

#include <algorithm>
#include <cerrno>
#include <cstdint>
#include <cstring>

#ifndef SO_PASSRIGHTS
#define SO_PASSRIGHTS 83  // Linux 6.16; another number on parisc and sparc, which we do not support
#endif

namespace agnocast {
namespace {

constexpr std::size_t descriptor_count_max = abi::wire::descriptor_count_max;
constexpr std::size_t descriptors_per_packet = 253;  // SCM_MAX_FD, the kernel's bound
// Room for both kinds of ancillary data at once. Padding lets the kernel deliver a few descriptors
// more than descriptor_count_max here; take_control() closes them.
constexpr std::size_t control_bytes =
    CMSG_SPACE(sizeof(int) * descriptor_count_max) + CMSG_SPACE(sizeof(ucred));

int flags_of(Wait wait) noexcept { return wait == Wait::no ? MSG_DONTWAIT : 0; }

// Gives every descriptor in the control data an owner, wanted or not.
void take_control(msghdr& message, Packet& packet, std::vector<UniqueFd>* more) {
  for (cmsghdr* part = CMSG_FIRSTHDR(&message); part != nullptr;
       part = CMSG_NXTHDR(&message, part)) {
    if (part->cmsg_level != SOL_SOCKET || part->cmsg_len < CMSG_LEN(0)) continue;
    const std::size_t bytes = part->cmsg_len - CMSG_LEN(0);
    const unsigned char* const data = CMSG_DATA(part);
    if (part->cmsg_type == SCM_RIGHTS) {
      for (std::size_t at = 0; at + sizeof(int) <= bytes; at += sizeof(int)) {
        int number = -1;
        std::memcpy(&number, data + at, sizeof number);
        UniqueFd fd(number);
        if (packet.descriptor_count < descriptor_count_max) {
          packet.descriptors[packet.descriptor_count++] = std::move(fd);
        } else if (more != nullptr) {
          more->push_back(std::move(fd));
        } else {
          packet.descriptors_lost = true;
        }
      }
    } else if (part->cmsg_type == SCM_CREDENTIALS && bytes >= sizeof(ucred)) {
      std::memcpy(&packet.credentials.emplace(), data, sizeof(ucred));
    }
  }
}

Result<void> pass_credentials(int fd, bool wanted) noexcept {
  const int value = wanted ? 1 : 0;
  if (::setsockopt(fd, SOL_SOCKET, SO_PASSCRED, &value, sizeof value) != 0)
    return fail(Errc::os_failure, "asking for the credentials of a sender", errno);
  return {};
}

bool pass_descriptors(int socket, bool wanted) noexcept {
  const int value = wanted ? 1 : 0;
  return ::setsockopt(socket, SOL_SOCKET, SO_PASSRIGHTS, &value, sizeof value) == 0;
}

// Limits the time that connect() waits for room in the listener's queue. Zero would mean for
// ever.
bool limit_sending(int fd, std::chrono::steady_clock::duration left) noexcept {
  const auto us = std::max<std::int64_t>(
      1, std::chrono::duration_cast<std::chrono::microseconds>(left).count());
  const timeval limit{us / 1'000'000, us % 1'000'000};
  return ::setsockopt(fd, SOL_SOCKET, SO_SNDTIMEO, &limit, sizeof limit) == 0;
}

}  // namespace

Result<PacketSocket> PacketSocket::connect(std::string_view path,
                                           std::chrono::milliseconds patience) noexcept {
  const auto address = unix_address(path);
  if (!address) return tl::unexpected(address.error());
  UniqueFd fd(::socket(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0));
  if (!fd) return fail(Errc::os_failure, "making a socket", errno);
  // EINTR while waiting for room in the listener's queue: nothing has happened yet, so repeat.
  const auto deadline = std::chrono::steady_clock::now() + patience;
  int status = 0;
  do {
    if (!limit_sending(fd.get(), deadline - std::chrono::steady_clock::now()))
      return fail(Errc::os_failure, "limiting how long a socket waits", errno);
    status = ::connect(fd.get(), address->get(), UnixAddress::size());
  } while (status != 0 && errno == EINTR);
  if (status == 0) {
    const timeval without_limit{};
    if (::setsockopt(fd.get(), SOL_SOCKET, SO_SNDTIMEO, &without_limit, sizeof without_limit) != 0)
      return fail(Errc::os_failure, "limiting how long a socket waits", errno);
    return PacketSocket(std::move(fd));
  }
  switch (errno) {
    case EAGAIN:
      return fail(Errc::daemon_not_running, "connecting to a socket", ETIMEDOUT);
    case ENOENT:
    case ECONNREFUSED:
      return fail(Errc::daemon_not_running, "connecting to a socket", errno);
    case EACCES:
    case EPERM:
      return fail(Errc::permission_denied, "connecting to a socket", errno);
    default:
      return fail(Errc::os_failure, "connecting to a socket", errno);
  }
}

// The kernel sets the same flag (MSG_CTRUNC) for two kinds of descriptors that it closed: those
// without a free number, and those that a security module does not let this process receive.
Failure failure_of_descriptors(const char* what) noexcept {
  const UniqueFd probe(::eventfd(0, EFD_CLOEXEC));
  if (!probe && (errno == EMFILE || errno == ENFILE)) return {Errc::os_failure, errno, what};
  return {Errc::descriptors_withheld, 0, what};
}

Result<std::pair<PacketSocket, PacketSocket>> PacketSocket::pair() noexcept {
  int ends[2];
  if (::socketpair(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0, ends) != 0)
    return fail(Errc::os_failure, "making a pair of sockets", errno);
  return std::pair(PacketSocket(UniqueFd(ends[0])), PacketSocket(UniqueFd(ends[1])));
}

Result<Sent> PacketSocket::send(std::span<const std::byte> bytes, std::span<const int> fds,
                                Wait wait) const noexcept {
  if (bytes.empty()) return fail(Errc::invalid_argument, "a packet to send is empty");
  if (fds.size() > descriptor_count_max)
    return fail(Errc::invalid_argument, "a packet to send has too many descriptors");

  if (!may_use(fd_.get())) return Sent::peer_gone;
  iovec data{const_cast<std::byte*>(bytes.data()), bytes.size()};
  msghdr message{};
  message.msg_iov = &data;
  message.msg_iovlen = 1;
  alignas(cmsghdr) std::byte control[control_bytes]{};
  if (!fds.empty()) {
    message.msg_control = control;
    message.msg_controllen = CMSG_SPACE(fds.size_bytes());
    cmsghdr* part = CMSG_FIRSTHDR(&message);
    part->cmsg_level = SOL_SOCKET;
    part->cmsg_type = SCM_RIGHTS;
    part->cmsg_len = CMSG_LEN(fds.size_bytes());
    std::memcpy(CMSG_DATA(part), fds.data(), fds.size_bytes());
  }
  ssize_t status = 0;
  do {
    status = ::sendmsg(fd_.get(), &message, MSG_NOSIGNAL | flags_of(wait));
  } while (status < 0 && errno == EINTR);
  if (status >= 0) return Sent::sent;  // SEQPACKET: all of it
  switch (errno) {
    case EAGAIN:
      return Sent::would_block;
    case EPIPE:
    case ECONNRESET:
    case ENOTCONN:
      return Sent::peer_gone;
    default:
      return fail(Errc::os_failure, "sending a packet", errno);
  }
}

Result<Packet> PacketSocket::receive(std::span<std::byte> buffer, Wait wait) const noexcept {
  alignas(cmsghdr) std::byte control[control_bytes];
  return receive_into(buffer, control, nullptr, wait);
}

Result<Packet> PacketSocket::receive_all(std::span<std::byte> buffer,
                                         std::vector<UniqueFd>& more) const {
  alignas(cmsghdr) std::byte
      control[CMSG_SPACE(sizeof(int) * descriptors_per_packet) + CMSG_SPACE(sizeof(ucred))];
  more.reserve(descriptors_per_packet);  // so that each has an owner from the first moment
  return receive_into(buffer, control, &more, Wait::no);
}

Result<Packet> PacketSocket::receive_into(std::span<std::byte> buffer, std::span<std::byte> control,
                                          std::vector<UniqueFd>* more, Wait wait) const {
  Packet packet;
  if (!may_use(fd_.get())) {
    packet.kind = Packet::Kind::end;
    return packet;
  }
  iovec data{buffer.data(), buffer.size()};
  msghdr message{};
  ssize_t status = 0;
  // A peer that closes without having read everything leaves ECONNRESET *in front of* the packets
  // it had sent. The kernel reports it once; the packets behind it must still be returned.
  bool reset_seen = false;
  for (;;) {
    message = {};
    message.msg_iov = &data;
    message.msg_iovlen = 1;
    message.msg_control = control.data();
    message.msg_controllen = control.size();
    status = ::recvmsg(fd_.get(), &message, MSG_CMSG_CLOEXEC | flags_of(wait));
    if (status >= 0) break;
    if (errno == EINTR) continue;
    if (errno == EAGAIN) return packet;
    if (errno != ECONNRESET) return fail(Errc::os_failure, "receiving a packet", errno);
    if (std::exchange(reset_seen, true)) {
      packet.kind = Packet::Kind::end;
      return packet;
    }
  }
  take_control(message, packet, more);
  packet.descriptors_lost = packet.descriptors_lost || (message.msg_flags & MSG_CTRUNC) != 0;
  packet.truncated = (message.msg_flags & MSG_TRUNC) != 0;
  packet.bytes = static_cast<std::size_t>(status);
  packet.kind = status == 0 && !packet.truncated ? Packet::Kind::end : Packet::Kind::data;
  return packet;
}

Result<PacketSocket::Peeked> PacketSocket::peek(std::span<std::byte> buffer) const noexcept {
  Peeked peeked;
  iovec data{buffer.data(), buffer.size()};
  alignas(cmsghdr) std::byte control[CMSG_SPACE(sizeof(ucred))];
  bool reset_seen = false;  // as in receive()
  for (;;) {
    msghdr message{};
    message.msg_iov = &data;
    message.msg_iovlen = 1;
    message.msg_control = control;
    message.msg_controllen = sizeof control;
    const ssize_t status = ::recvmsg(fd_.get(), &message, MSG_PEEK | MSG_DONTWAIT);
    if (status >= 0) {
      peeked.truncated = (message.msg_flags & MSG_TRUNC) != 0;
      peeked.has_descriptors = (message.msg_flags & MSG_CTRUNC) != 0;
      peeked.bytes = static_cast<std::size_t>(status);
      peeked.kind = status == 0 && !peeked.truncated ? Packet::Kind::end : Packet::Kind::data;
      return peeked;
    }
    if (errno == EINTR) continue;
    if (errno == EAGAIN) return peeked;
    if (errno != ECONNRESET) return fail(Errc::os_failure, "looking at a packet", errno);
    if (std::exchange(reset_seen, true)) {
      peeked.kind = Packet::Kind::end;
      return peeked;
    }
  }
}

Result<void> PacketSocket::want_credentials(bool wanted) const noexcept {
  return pass_credentials(fd_.get(), wanted);
}

Result<PacketListener> PacketListener::bind(std::string_view path) noexcept {
  const auto address = unix_address(path);
  if (!address) return tl::unexpected(address.error());
  UniqueFd fd(::socket(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC | SOCK_NONBLOCK, 0));
  if (!fd) return fail(Errc::os_failure, "making a socket", errno);
  // bind() gives the entry the mode of the socket's own inode, which is 0777, less the umask.
  // connect() checks the mode before it checks for a listener.
  const mode_t mask = ::umask(0);
  const int status = ::bind(fd.get(), address->get(), UnixAddress::size());
  const int error = errno;
  ::umask(mask);
  if (status == 0) return PacketListener(std::move(fd));
  if (error == EADDRINUSE) return fail(Errc::already_running, "binding a socket", error);
  if (error == EACCES || error == EPERM)
    return fail(Errc::permission_denied, "binding a socket", error);
  return fail(Errc::os_failure, "binding a socket", error);
}

Result<void> PacketListener::listen() const noexcept {
  if (::listen(fd_.get(), SOMAXCONN) == 0) return {};
  return fail(Errc::os_failure, "listening at a socket", errno);
}

Result<std::optional<PacketSocket>> PacketListener::accept() const noexcept {
  for (;;) {
    UniqueFd fd(::accept4(fd_.get(), nullptr, nullptr, SOCK_CLOEXEC | SOCK_NONBLOCK));
    if (fd) return std::optional(PacketSocket(std::move(fd)));
    if (errno == EAGAIN) return std::optional<PacketSocket>();
    if (errno != EINTR && errno != ECONNABORTED)
      return fail(Errc::os_failure, "accepting a connection", errno);
  }
}

Result<void> PacketListener::want_credentials(bool wanted) const noexcept {
  return pass_credentials(fd_.get(), wanted);
}

bool refuse_descriptors(int socket) noexcept { return pass_descriptors(socket, false); }

bool accept_descriptors(int socket) noexcept { return pass_descriptors(socket, true); }

bool refuses_descriptors(int socket) noexcept {
  int value = 1;
  socklen_t bytes = sizeof value;
  return ::getsockopt(socket, SOL_SOCKET, SO_PASSRIGHTS, &value, &bytes) == 0 && value == 0;
}

}  // namespace agnocast
