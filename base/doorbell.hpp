// SPDX-License-Identifier: Apache-2.0
//
// Doorbell: how a publisher wakes an executor that sleeps in epoll_wait.
//
// An executor has two bells in its epoll set, because the cheap one can be abused:
//
//   eventfd          registered edge-triggered and never read, so a wake-up is one system call on
//                    each side. Its O_NONBLOCK is shared by all holders; one of them could clear it
//                    and fill the counter, and then ring() would block. Handed only to processes of
//                    the same user, who could as well kill each other.
//   datagram socket  bound by the daemon inside a directory that only the daemon may enter, with
//   one
//                    connected sending socket per publisher process. MSG_DONTWAIT is per call, and
//                    a holder can neither block nor silence another one. Works after its name is
//                    gone.
//
// A ring carries no data: whoever wakes looks at the queues. So a full queue of datagrams is as
// good as a ring: the socket is readable already. A full eventfd is not: no edge follows, and the
// datagram is sent as well.
//
// Before Linux 6.16 somebody may send descriptors with it, whose close takes as long as he likes (closing.hpp).
// They are looked for before a datagram is taken, and thrown away by another thread.
#pragma once

#include <agnocast/result.hpp>
#include <base/unique_fd.hpp>

#include <cstdint>
#include <string>
#include <string_view>
#include <utility>

namespace agnocast {

/// The sending end: what a publisher process has for one executor of another process. Any thread.
class Doorbell {
 public:
  enum class Rung : std::uint8_t {
    rung,       ///< the executor wakes, or is awake
    gone,       ///< nobody listens any more
    exhausted,  ///< the kernel is out of memory; the executor's safety timeout remains
  };

  /// Mute: rings nobody.
  Doorbell() = default;
  /// `eventfd` may be empty: then every ring is a datagram.
  explicit Doorbell(UniqueFd datagram, UniqueFd eventfd = UniqueFd()) noexcept
      : datagram_(std::move(datagram)), eventfd_(std::move(eventfd)) {}

  /// Wakes the executor: one system call (two when somebody filled the eventfd). Never sleeps, see
  /// the file's head.
  Rung ring() const noexcept;

  explicit operator bool() const noexcept { return static_cast<bool>(datagram_); }
  int datagram_fd() const noexcept { return datagram_.get(); }
  int eventfd() const noexcept { return eventfd_.get(); }

 private:
  UniqueFd datagram_;
  UniqueFd eventfd_;
};

/// The receiving end: an executor's two bells. Made by the daemon, passed to the executor's
/// process.
class DoorbellReceiver {
 public:
  DoorbellReceiver() = default;
  DoorbellReceiver(UniqueFd eventfd, UniqueFd datagram) noexcept
      : eventfd_(std::move(eventfd)), datagram_(std::move(datagram)) {}
  DoorbellReceiver(DoorbellReceiver&&) = default;
  DoorbellReceiver& operator=(DoorbellReceiver&& other) noexcept {
    std::swap(eventfd_, other.eventfd_);  // the other's end closes what was here
    std::swap(datagram_, other.datagram_);
    return *this;
  }
  /// Never waits for what somebody has sent to the socket.
  ~DoorbellReceiver();

  /// Adds both bells to an epoll set: the eventfd edge-triggered, the socket level-triggered.
  /// Errors: os_failure with errno.
  [[nodiscard]] Result<void> add_to(int epoll, std::uint64_t eventfd_tag,
                                    std::uint64_t datagram_tag) const noexcept;
  /// The opposite. Nothing happens if they are not in it.
  void remove_from(int epoll) const noexcept;
  /// Takes the socket alone out of an epoll set.
  void mute(int epoll) const noexcept;
  /// Empties the socket; to be called only when the socket was what rang. Never waits for what
  /// somebody has sent, and gives up after a bound: what a flood leaves behind wakes the executor
  /// again. False: what is in it cannot be got rid of, and it has to be muted.
  bool drain() const noexcept;

  explicit operator bool() const noexcept { return static_cast<bool>(datagram_); }
  int eventfd() const noexcept { return eventfd_.get(); }
  int datagram_fd() const noexcept { return datagram_.get(); }

 private:
  UniqueFd eventfd_;
  UniqueFd datagram_;
};

/// Daemon: both bells of a new executor, the socket bound at `directory`/`name`; an entry of this
/// name that a former life left is replaced. Errors: permission_denied (the directory is not ours
/// alone), invalid_argument (path over 107 bytes, or a slash in the name), os_failure with errno.
[[nodiscard]] Result<DoorbellReceiver> make_doorbell(const std::string& directory,
                                                     std::string_view name) noexcept;

/// Daemon: a socket that sends to the one bound at `directory`/`name`, for one publisher process.
/// Errors: endpoint_gone (nobody has the receiver any more, or its entry was removed),
/// invalid_argument (path), os_failure with errno.
[[nodiscard]] Result<UniqueFd> connect_doorbell(const std::string& directory,
                                                std::string_view name) noexcept;
/// Daemon: the same, for a receiver whose name is only known to its socket.
[[nodiscard]] Result<UniqueFd> connect_doorbell(int receiver) noexcept;
/// Daemon: one that reaches nobody, for a publisher that rings the eventfd. Errors: os_failure.
[[nodiscard]] Result<UniqueFd> make_mute_doorbell() noexcept;

}  // namespace agnocast
