// SPDX-License-Identifier: Apache-2.0
//
// Listener: the socket where clients find the daemon, and proof that there is only one daemon.
//
//   SOCKET             where clients connect
//   RUN/NAME.lock      locked with flock while the daemon runs; NAME is the socket's last part.
//                      Counts the daemons that began here with nothing of an earlier one
//   RUN/NAME.bells/    names of the doorbells, for the daemon's user alone
//
// RUN is the socket's directory unless the configuration names another one.
//
// Only the holder of the lock may remove what a previous run left; a socket that still answers
// although the lock is free belongs to another program and is left alone. A clean end removes
// socket and doorbells; the lock file stays (removing it would let two others each lock a file of
// that name).
//
// All three outlive the process when a manager keeps descriptors: connections that come meanwhile
// wait in the socket's queue, the lock stays taken, and doorbells keep their names.
//
// A passed socket (socket activation) is used in preference to any other, where it is: its maker
// decides its name, owner and mode, and it is neither kept in the store nor removed.
//
// No client can connect before the socket has its final owner and mode; until then clients see no
// daemon, which is a reason to try again. It is not made under another name and renamed: it would
// keep that name (getsockname), and the next run finds the place by it.
//
// Every complaint is one sentence for people, with the path in it.
#pragma once

#include <agnocast/error.hpp>
#include <base/descriptors/unique_fd.hpp>
#include <base/sockets/packet_socket.hpp>
#include <daemon/transport/descriptor_store.hpp>

#include <tl/expected.hpp>

#include <sys/types.h>

#include <cstdint>
#include <optional>
#include <string>
#include <utility>

namespace agnocast::daemon {

struct Complaint {
  Errc code = Errc::os_failure;
  std::string what;  // "cannot …: why"
};

struct ListenerOptions {
  std::string path;
  std::string runtime_directory;
  mode_t mode = 0660;
  std::optional<gid_t> group;
};

class Listener {
 public:
  /// Returns the path of a passed socket. Complains unless it is an AF_UNIX, SOCK_SEQPACKET socket
  /// that listens and has a path.
  [[nodiscard]] static tl::expected<std::string, Complaint> place_of(const UniqueFd& passed);

  /// Listens at `passed`, or at a new socket if that is empty.
  [[nodiscard]] static tl::expected<Listener, Complaint> open(const ListenerOptions& options,
                                                              UniqueFd passed);

  /// Adopts socket and lock of a previous run, with its directory of doorbells; clears nothing.
  /// `passed` takes the place of the socket. Without it, a socket that was not kept or has lost
  /// its name is made anew: renewed(). So is a lock that was not kept.
  [[nodiscard]] static tl::expected<Listener, Complaint> adopt(const ListenerOptions& options,
                                                               UniqueFd passed, UniqueFd socket,
                                                               UniqueFd lock,
                                                               const std::string& doorbells);

  Listener(Listener&& other) noexcept
      : path_(std::exchange(other.path_, {})),
        doorbells_(std::exchange(other.doorbells_, {})),
        removes_(other.removes_),
        is_passed_(other.is_passed_),
        renewed_(other.renewed_),
        former_count_(other.former_count_),
        lock_(std::move(other.lock_)),
        socket_(std::move(other.socket_)) {}
  Listener& operator=(Listener&&) = delete;
  /// Removes socket and doorbells, unless remove_names(false) was called.
  ~Listener();

  const PacketListener& socket() const noexcept { return socket_; }
  const std::string& path() const noexcept { return path_; }
  const std::string& doorbells_directory() const noexcept { return doorbells_; }
  bool renewed() const noexcept { return renewed_; }
  bool is_passed() const noexcept { return is_passed_; }
  /// Returns how a passed socket differs from `options`, as a sentence; empty: in nothing, or it
  /// was not passed.
  std::string differences(const ListenerOptions& options) const;
  /// Returns how many daemons began here before this one.
  std::uint64_t former_count() const noexcept { return former_count_; }
  /// Puts lock and socket into the store unless they are there, the socket last; a renewed socket
  /// replaces the previous one. A passed one is not put. A death in between leaves the lock, which
  /// shows that a daemon was here. Errors: as DescriptorStore::put.
  [[nodiscard]] Result<void> keep(DescriptorStore& store) const;
  /// Sets whether the end removes socket and doorbells; if not, the next run continues with them.
  void remove_names(bool removes) noexcept { removes_ = removes; }

 private:
  Listener() = default;
  [[nodiscard]] tl::expected<void, Complaint> lock(const std::string& base,
                                                   const std::string& path);
  [[nodiscard]] tl::expected<void, Complaint> listen_at(const std::string& path, UniqueFd passed);
  [[nodiscard]] tl::expected<void, Complaint> listen(const ListenerOptions& options);

  std::string path_;  // empty: nothing to remove
  std::string doorbells_;
  bool removes_ = true;
  bool is_passed_ = false;
  bool renewed_ = false;
  std::uint64_t former_count_ = 0;
  UniqueFd lock_;
  PacketListener socket_;
};

}  // namespace agnocast::daemon
