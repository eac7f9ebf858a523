// SPDX-License-Identifier: Apache-2.0
//
// PacketSocket: one end of an AF_UNIX SOCK_SEQPACKET connection that carries descriptors.
//
// One call moves one packet, whole or not at all. Everything about sockets that can be forgotten is
// remembered here: EINTR, SIGPIPE, CLOEXEC, descriptors that arrive uninvited, packets longer than
// the buffer, and the packets that are still queued behind a connection reset. A received
// descriptor has an owner from the first moment, so nothing the peer sends can leak.
//
// An empty packet cannot be told from the end of the connection (recvmsg answers 0 to both), so we
// never send one, and a peer that does has ended its connection.
#pragma once

#include <agnocast/abi/wire.hpp>
#include <agnocast/result.hpp>
#include <base/unique_fd.hpp>

#include <sys/socket.h>

#include <array>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string_view>
#include <utility>
#include <vector>

namespace agnocast {

/// Whether a call may sleep in the kernel. `no` is per call (MSG_DONTWAIT): a flag of the shared
/// open file description could be cleared by the peer's holder of it.
enum class Wait : std::uint8_t { no, yes };

enum class Sent : std::uint8_t {
  sent,
  would_block,  ///< the peer has not read enough; nothing was sent
  peer_gone,    ///< the peer has closed; nothing was sent
};

/// What one receive() found. Owns the descriptors that came with it.
struct Packet {
  enum class Kind : std::uint8_t {
    data,
    nothing,  ///< no packet is there now (Wait::no only)
    end,      ///< the peer has closed and everything it sent was read
  };
  Kind kind = Kind::nothing;
  bool truncated = false;         ///< the packet was longer than the buffer; the rest is lost
  bool descriptors_lost = false;  ///< more came than descriptor_count_max, or than this process may
                                  ///< open; the rest was closed
  std::size_t bytes = 0;          ///< how many of the buffer are filled
  std::size_t descriptor_count = 0;
  std::array<UniqueFd, abi::wire::descriptor_count_max> descriptors;
  /// Who sent it, vouched for by the kernel; only after want_credentials(true).
  std::optional<ucred> credentials;

  std::span<UniqueFd> fds() noexcept { return {descriptors.data(), descriptor_count}; }
};

/// Why a packet came with fewer descriptors than its sender gives to it: os_failure with EMFILE or ENFILE if
/// no more can be opened here, else descriptors_withheld. To be asked while the packet still has what did
/// come. `what`: which packet, static text.
Failure failure_of_descriptors(const char* what) noexcept;

class PacketSocket {
 public:
  static constexpr std::chrono::milliseconds connect_patience{5000};

  PacketSocket() = default;
  /// Takes over a connected socket (of accept, socketpair, or a descriptor store).
  explicit PacketSocket(UniqueFd fd) noexcept : fd_(std::move(fd)) {}

  /// Connects to the listener at `path`; sleeps for `patience` at most while its queue is full.
  /// Errors: daemon_not_running (nobody listens there; ETIMEDOUT: who listens does not accept),
  /// permission_denied, invalid_argument (path empty or over 107 bytes), os_failure with errno.
  [[nodiscard]] static Result<PacketSocket> connect(
      std::string_view path, std::chrono::milliseconds patience = connect_patience) noexcept;
  /// Two connected ends.
  [[nodiscard]] static Result<std::pair<PacketSocket, PacketSocket>> pair() noexcept;

  /// Sends one packet and copies of `fds`, which stay the caller's. Wait::yes does not wait on a
  /// socket that is non-blocking itself. Errors: invalid_argument (no bytes, or more than
  /// descriptor_count_max descriptors), os_failure with errno (EMSGSIZE; ETOOMANYREFS: too many
  /// descriptors of this user are under way).
  [[nodiscard]] Result<Sent> send(std::span<const std::byte> bytes, std::span<const int> fds = {},
                                  Wait wait = Wait::no) const noexcept;
  /// Takes one packet into `buffer`. Errors: os_failure with errno.
  [[nodiscard]] Result<Packet> receive(std::span<std::byte> buffer,
                                       Wait wait = Wait::no) const noexcept;
  /// The same, with every descriptor that came: those that have no place in the packet go to `more`.
  /// For threads that may wait: what no number is free for is closed by the kernel in here.
  [[nodiscard]] Result<Packet> receive_all(std::span<std::byte> buffer,
                                           std::vector<UniqueFd>& more) const;
  /// What the next packet is, without taking it: as much of it as fits into `buffer`, and whether
  /// descriptors come with it, none of which is opened here. Only after want_credentials(true): the
  /// room that credentials fill is what keeps the kernel from opening any. Never sleeps. Errors:
  /// os_failure with errno.
  struct Peeked {
    Packet::Kind kind = Packet::Kind::nothing;
    bool truncated = false;
    bool has_descriptors = false;
    std::size_t bytes = 0;
  };
  [[nodiscard]] Result<Peeked> peek(std::span<std::byte> buffer) const noexcept;
  /// From now on every packet says who sent it (SO_PASSCRED). A packet that was sent before this
  /// may say pid 0; PacketListener::want_credentials leaves no such gap.
  [[nodiscard]] Result<void> want_credentials(bool wanted) const noexcept;

  int fd() const noexcept { return fd_.get(); }
  explicit operator bool() const noexcept { return static_cast<bool>(fd_); }
  UniqueFd release() noexcept { return std::move(fd_); }
  void close() noexcept { fd_.reset(); }

 private:
  Result<Packet> receive_into(std::span<std::byte> buffer, std::span<std::byte> control,
                              std::vector<UniqueFd>* more, Wait wait) const;

  UniqueFd fd_;
};

class PacketListener {
 public:
  PacketListener() = default;
  /// Takes over a listening socket (socket activation, or a descriptor store).
  explicit PacketListener(UniqueFd fd) noexcept : fd_(std::move(fd)) {}

  /// Makes a non-blocking socket and its entry at `path`, which is open to everybody and where everybody
  /// is told that nobody listens. So who comes while the caller says who may connect (chown, chmod)
  /// hears that it is too early, never that he may not. Removing a stale entry is the caller's.
  /// The process has umask 0 for a moment. Errors: already_running (the entry exists),
  /// permission_denied, invalid_argument (path), os_failure with errno.
  [[nodiscard]] static Result<PacketListener> bind(std::string_view path) noexcept;
  /// From now on whoever may connect does. Errors: os_failure with errno.
  [[nodiscard]] Result<void> listen() const noexcept;
  /// The next connection, non-blocking and CLOEXEC; empty when nobody waits. A peer that gave up
  /// meanwhile is passed over. Errors: os_failure with errno (EMFILE, ENFILE: the connection keeps
  /// waiting).
  [[nodiscard]] Result<std::optional<PacketSocket>> accept() const noexcept;
  /// Connections accepted from now on say with every packet who sent it, from the first on.
  [[nodiscard]] Result<void> want_credentials(bool wanted) const noexcept;

  int fd() const noexcept { return fd_.get(); }
  explicit operator bool() const noexcept { return static_cast<bool>(fd_); }
  UniqueFd release() noexcept { return std::move(fd_); }

 private:
  UniqueFd fd_;
};

/// From now on the kernel refuses descriptors that are sent to this socket, at their sender
/// (SO_PASSRIGHTS, Linux 6.16). A listener hands that on to the connections that are made from now
/// on. False where the kernel cannot.
bool refuse_descriptors(int socket) noexcept;
/// The opposite.
bool accept_descriptors(int socket) noexcept;
/// Whether the kernel refuses them now. What was sent before may still be in the queue.
bool refuses_descriptors(int socket) noexcept;

}  // namespace agnocast
