// SPDX-License-Identifier: Apache-2.0
//
// PacketSocket: one end of an AF_UNIX SOCK_SEQPACKET connection that carries descriptors.
//
// One call moves one packet, whole or not at all. It handles everything about sockets that is
// easily forgotten: EINTR, SIGPIPE, CLOEXEC, unexpected descriptors, packets longer than the
// buffer, and packets queued behind a connection reset. A received descriptor has an owner from
// the first moment, so a peer can cause no leak.
//
// An empty packet looks like the end of the connection (recvmsg returns 0 for both), so we never
// send one, and treat a received one as the end.
#pragma once

#include <agnocast/abi/wire.hpp>
#include <agnocast/result.hpp>
#include <base/descriptors/unique_fd.hpp>

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

/// Whether a call may sleep in the kernel. `no` is per call (MSG_DONTWAIT): the peer could clear
/// a flag of a shared open file description.
enum class Wait : std::uint8_t { no, yes };

enum class Sent : std::uint8_t {
  sent,
  would_block,  ///< the peer has not read enough; nothing was sent
  peer_gone,    ///< the peer has closed; nothing was sent
};

/// Result of one receive(). Owns its descriptors.
struct Packet {
  enum class Kind : std::uint8_t {
    data,
    nothing,  ///< no packet is there now (Wait::no only)
    end,      ///< the peer has closed and everything it sent was read
  };
  Kind kind = Kind::nothing;
  bool truncated = false;         ///< the packet was longer than the buffer; the rest is lost
  bool descriptors_lost = false;  ///< there were more than descriptor_count_max, or than this
                                  ///< process may open; the rest was closed
  std::size_t bytes = 0;          ///< filled bytes of the buffer
  std::size_t descriptor_count = 0;
  std::array<UniqueFd, abi::wire::descriptor_count_max> descriptors;
  /// The sender, from the kernel; only after want_credentials(true).
  std::optional<ucred> credentials;

  std::span<UniqueFd> fds() noexcept { return {descriptors.data(), descriptor_count}; }
};

/// Explains why a packet came with fewer descriptors than its sender attaches: os_failure with
/// EMFILE or ENFILE if no more can be opened here, else descriptors_withheld. Call it while the
/// packet still has the received ones. `what`: the packet, static text.
Failure failure_of_descriptors(const char* what) noexcept;

class PacketSocket {
 public:
  static constexpr std::chrono::milliseconds connect_patience{5000};

  PacketSocket() = default;
  /// Takes over a connected socket (from accept, socketpair, or a descriptor store).
  explicit PacketSocket(UniqueFd fd) noexcept : fd_(std::move(fd)) {}

  /// Connects to the listener at `path`; sleeps for `patience` at most while its queue is full.
  /// Errors: daemon_not_running (no listener; ETIMEDOUT: it does not accept), permission_denied,
  /// invalid_argument (path empty or over 107 bytes), os_failure with errno.
  [[nodiscard]] static Result<PacketSocket> connect(
      std::string_view path, std::chrono::milliseconds patience = connect_patience) noexcept;
  /// Makes two connected ends.
  [[nodiscard]] static Result<std::pair<PacketSocket, PacketSocket>> pair() noexcept;

  /// Sends one packet and copies of `fds`; the caller keeps those. Wait::yes does not wait if the
  /// socket itself is non-blocking. Errors: invalid_argument (no bytes, or more than
  /// descriptor_count_max descriptors), os_failure with errno (EMSGSIZE; ETOOMANYREFS: too many
  /// descriptors of this user are in transit).
  [[nodiscard]] Result<Sent> send(std::span<const std::byte> bytes, std::span<const int> fds = {},
                                  Wait wait = Wait::no) const noexcept;
  /// Receives one packet into `buffer`. Errors: os_failure with errno.
  [[nodiscard]] Result<Packet> receive(std::span<std::byte> buffer,
                                       Wait wait = Wait::no) const noexcept;
  /// The same with all received descriptors: those beyond the packet's places go to `more`. For
  /// threads that may wait: the kernel closes descriptors without a free number in here.
  [[nodiscard]] Result<Packet> receive_all(std::span<std::byte> buffer,
                                           std::vector<UniqueFd>& more) const;
  /// Peeks at the next packet: copies its beginning into `buffer`, and reports whether it has
  /// descriptors, without opening them. Only after want_credentials(true): the credentials fill
  /// the control buffer, so the kernel opens none. Never sleeps. Errors: os_failure with errno.
  struct Peeked {
    Packet::Kind kind = Packet::Kind::nothing;
    bool truncated = false;
    bool has_descriptors = false;
    std::size_t bytes = 0;
  };
  [[nodiscard]] Result<Peeked> peek(std::span<std::byte> buffer) const noexcept;
  /// Adds the sender's credentials to every packet received from now on (SO_PASSCRED). A packet
  /// sent before this call may have pid 0; PacketListener::want_credentials leaves no such gap.
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
  /// Takes over a listening socket (from socket activation, or a descriptor store).
  explicit PacketListener(UniqueFd fd) noexcept : fd_(std::move(fd)) {}

  /// Makes a non-blocking socket and its entry at `path` with open permissions, but does not
  /// listen yet. So a client that comes while the caller sets the permissions (chown, chmod) gets
  /// ECONNREFUSED, never EACCES. The caller removes a stale entry. The process has umask 0 for a
  /// moment. Errors: already_running (the entry exists), permission_denied, invalid_argument
  /// (path), os_failure with errno.
  [[nodiscard]] static Result<PacketListener> bind(std::string_view path) noexcept;
  /// Starts listening. Errors: os_failure with errno.
  [[nodiscard]] Result<void> listen() const noexcept;
  /// Accepts the next connection, non-blocking and CLOEXEC; empty if none waits. Skips a peer
  /// that has given up. Errors: os_failure with errno (EMFILE, ENFILE: the connection keeps
  /// waiting).
  [[nodiscard]] Result<std::optional<PacketSocket>> accept() const noexcept;
  /// Connections accepted from now on have the sender's credentials in every packet, from the
  /// first on.
  [[nodiscard]] Result<void> want_credentials(bool wanted) const noexcept;

  int fd() const noexcept { return fd_.get(); }
  explicit operator bool() const noexcept { return static_cast<bool>(fd_); }
  UniqueFd release() noexcept { return std::move(fd_); }

 private:
  UniqueFd fd_;
};

/// Makes the kernel refuse descriptors sent to this socket, at their sender (SO_PASSRIGHTS, Linux
/// 6.16). Connections to a listener made from now on inherit that. Returns false if the kernel
/// does not support it.
bool refuse_descriptors(int socket) noexcept;
/// Reverts refuse_descriptors().
bool accept_descriptors(int socket) noexcept;
/// Returns whether the kernel refuses them now. Descriptors sent earlier may still be in the
/// queue.
bool refuses_descriptors(int socket) noexcept;

}  // namespace agnocast
