// SPDX-License-Identifier: Apache-2.0
//
// Doorbell: wakes an executor that sleeps in epoll_wait. A publisher rings it.
//
// An executor has two doorbells in its epoll set, because the cheap one can be abused:
//
//   eventfd          registered edge-triggered and never read, so a wake-up is one system call on
//                    each side. Its O_NONBLOCK is shared by all holders; one of them could clear it
//                    and fill the counter, and then ring() would block. Given only to processes of
//                    the same user, which can kill each other anyway.
//   datagram socket  bound by the daemon inside a directory that only the daemon may enter, with
//                    one connected sending socket per publisher process. MSG_DONTWAIT is per call,
//                    and a holder can neither block nor silence another one. Works after its name
//                    is gone.
//
// A ring carries no data: a woken executor checks its queues. So a full queue of datagrams is as
// good as a ring: the socket is readable already. A full eventfd is not, because no edge follows;
// ring() then sends the datagram as well.
//
// Before Linux 6.16 a sender may attach descriptors to a datagram, and can make their close last
// for ever (closing.hpp). The receiver peeks for descriptors, and another thread discards such
// datagrams.
#pragma once

#include <agnocast/result.hpp>
#include <base/descriptors/unique_fd.hpp>

#include <cstdint>
#include <string>
#include <string_view>
#include <utility>

namespace agnocast {

/// The sending end: a publisher process has one for each executor of another process. Any thread.
class Doorbell {
 public:
  enum class Rung : std::uint8_t {
    rung,       ///< the executor wakes, or is awake
    gone,       ///< there is no receiver any more
    exhausted,  ///< the kernel is out of memory; the executor's safety timeout remains
  };

  /// Mute: wakes no executor.
  Doorbell() = default;
  /// `eventfd` may be empty: then every ring is a datagram.
  explicit Doorbell(UniqueFd datagram, UniqueFd eventfd = UniqueFd()) noexcept
      : datagram_(std::move(datagram)), eventfd_(std::move(eventfd)) {}

  /// Wakes the executor: one system call (two if the eventfd is full). Never sleeps, see the
  /// file's head.
  Rung ring() const noexcept;

  explicit operator bool() const noexcept { return static_cast<bool>(datagram_); }
  int datagram_fd() const noexcept { return datagram_.get(); }
  int eventfd() const noexcept { return eventfd_.get(); }

 private:
  UniqueFd datagram_;
  UniqueFd eventfd_;
};

/// The receiving end: an executor's two doorbells. The daemon makes them and sends them to the
/// executor's process.
class DoorbellReceiver {
 public:
  DoorbellReceiver() = default;
  DoorbellReceiver(UniqueFd eventfd, UniqueFd datagram) noexcept
      : eventfd_(std::move(eventfd)), datagram_(std::move(datagram)) {}
  DoorbellReceiver(DoorbellReceiver&&) = default;
  DoorbellReceiver& operator=(DoorbellReceiver&& other) noexcept {
    std::swap(eventfd_, other.eventfd_);  // the other's destructor closes the old ones
    std::swap(datagram_, other.datagram_);
    return *this;
  }
  /// Never waits for descriptors that were sent to the socket.
  ~DoorbellReceiver();

  /// Adds both doorbells to an epoll set: the eventfd edge-triggered, the socket level-triggered.
  /// Errors: os_failure with errno.
  [[nodiscard]] Result<void> add_to(int epoll, std::uint64_t eventfd_tag,
                                    std::uint64_t datagram_tag) const noexcept;
  /// Removes both. Does nothing if they are not in the set.
  void remove_from(int epoll) const noexcept;
  /// Removes only the socket from an epoll set.
  void mute(int epoll) const noexcept;
  /// Empties the socket; call it only when the socket rang. Never waits for a sender, and stops
  /// after a bound: the rest of a flood wakes the executor again. Returns false if a datagram
  /// cannot be discarded; then mute the socket.
  bool drain() const noexcept;

  explicit operator bool() const noexcept { return static_cast<bool>(datagram_); }
  int eventfd() const noexcept { return eventfd_.get(); }
  int datagram_fd() const noexcept { return datagram_.get(); }

 private:
  UniqueFd eventfd_;
  UniqueFd datagram_;
};

/// Daemon: makes both doorbells of a new executor, the socket bound at `directory`/`name`;
/// replaces an entry left by a previous incarnation. Errors: permission_denied (the directory is
/// not the daemon's alone), invalid_argument (path over 107 bytes, or a slash in the name),
/// os_failure with errno.
[[nodiscard]] Result<DoorbellReceiver> make_doorbell(const std::string& directory,
                                                     std::string_view name) noexcept;

/// Daemon: makes a socket that sends to the one bound at `directory`/`name`, for one publisher
/// process. Errors: endpoint_gone (the receiver is closed, or its entry was removed),
/// invalid_argument (path), os_failure with errno.
[[nodiscard]] Result<UniqueFd> connect_doorbell(const std::string& directory,
                                                std::string_view name) noexcept;
/// Daemon: the same, for a receiver whose name only its socket knows.
[[nodiscard]] Result<UniqueFd> connect_doorbell(int receiver) noexcept;
/// Daemon: makes one that reaches no receiver, for a publisher that rings the eventfd. Errors:
/// os_failure.
[[nodiscard]] Result<UniqueFd> make_mute_doorbell() noexcept;

}  // namespace agnocast
