// SPDX-License-Identifier: Apache-2.0
//
// Doorbells: the doorbells of all wait sets, as the daemon that makes them keeps them.
//
// For every wait set the daemon keeps the eventfd (as does the descriptor store), to pass it on to
// publishers of the same user, and one datagram sender of its own. It rings by datagram only: an
// eventfd whose holder has cleared O_NONBLOCK would block its writer, and the daemon must not wait
// for a client. Each publisher process gets a newly connected sender with its announcement, which
// the daemon does not keep.
//
// The names in the directory are for the next daemon. This one holds an O_PATH descriptor of each,
// so nothing is lost when the names are removed meanwhile. A daemon that starts without them has
// eventfds alone: publishers of the same user ring those; for others such a wait set is silent
// until its process is back and gets a new socket.
#pragma once

#include <agnocast/result.hpp>
#include <base/descriptors/doorbell.hpp>
#include <daemon/state/tables.hpp>
#include <daemon/transport/descriptor_store.hpp>
#include <daemon/transport/shared_fd.hpp>

#include <cstddef>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <utility>
#include <vector>

namespace agnocast::daemon {

class Doorbells {
 public:
  /// Closes a receiver that may still hold packets of other processes of this user.
  using Close = std::function<void(std::uint32_t uid, UniqueFd)>;
  /// `directory` exists, and only this process's user may enter it.
  Doorbells(std::string directory, DescriptorStore& store, Close close = {})
      : directory_(std::move(directory)), store_(store), close_(std::move(close)) {}
  Doorbells(const Doorbells&) = delete;
  Doorbells& operator=(const Doorbells&) = delete;

  /// Makes doorbells (eventfd and bound socket) for the wait set's process, which is of this user.
  /// Returns the same ones again while they are on their way. Errors: os_failure.
  [[nodiscard]] Result<std::vector<SharedFd>> open(ClientIndex client, std::uint64_t wait_set,
                                                   std::uint32_t uid);
  /// Restores doorbells of a previous run from the store; their names are still in the directory.
  /// A doorbell whose receiver is gone is silent.
  void restore(ClientIndex client, std::uint64_t wait_set);
  /// Removes names that belong to no doorbell.
  void remove_unknown_names() noexcept;
  bool is_open(ClientIndex client, std::uint64_t wait_set) const {
    return doorbells_.count({number(client), wait_set}) != 0;
  }
  /// Returns what a publisher's process gets: (eventfd and) a datagram sender; nothing when the
  /// receiver is closed. Errors: os_failure: not now, there is no descriptor or no memory.
  [[nodiscard]] Result<std::vector<SharedFd>> for_publisher(ClientIndex client,
                                                            std::uint64_t wait_set, bool same_user);
  /// Makes new doorbells (the eventfd stays) for a process that is back, if the daemon found its
  /// wait set unreachable; returns none if nothing is lost. A process that closes them gets new
  /// ones a few times. Errors: os_failure.
  [[nodiscard]] Result<std::vector<SharedFd>> renew(ClientIndex client, std::uint64_t wait_set,
                                                    std::uint32_t uid);
  struct WaitSetPlace {
    ClientIndex client;
    std::uint64_t wait_set;
  };
  /// Checks whether the next few doorbells still have receivers. Returns those that are silent for
  /// the second look in a row, each once: a process that ends closes its doorbells a moment before
  /// the daemon is notified of its end.
  std::vector<WaitSetPlace> look();
  /// Returns whether datagrams do not reach it, as far as known.
  bool is_silent(ClientIndex client, std::uint64_t wait_set) const {
    const auto found = doorbells_.find({number(client), wait_set});
    return found == doorbells_.end() || found->second.is_silent;
  }
  /// Returns whether look() has returned it, or it was silent when this daemon began.
  bool is_known_silent(ClientIndex client, std::uint64_t wait_set) const {
    const auto found = doorbells_.find({number(client), wait_set});
    return found != doorbells_.end() && found->second.silent_looks == silent_looks_needed;
  }
  void ring(ClientIndex client, std::uint64_t wait_set) noexcept;
  void ring_all() noexcept;
  /// Closes the doorbells of a dead process.
  void close_client(ClientIndex client) noexcept;

 private:
  struct Entry {
    SharedFd eventfd;
    std::weak_ptr<SharedFd::element_type> given;  // the receiver, until it is sent
    Doorbell own;
    // O_PATH of the bound name: still a way to it when the name has been removed.
    UniqueFd way;
    bool is_silent = false;
    unsigned silent_looks = 0;  // in a row, up to silent_looks_needed
    unsigned renewals_left = 0;
  };
  Result<SharedFd> duplicate_receiver(int fd, std::uint32_t uid) const;
  // Each renewal is announced to publishers.
  static constexpr unsigned renewals_max = 3;
  static constexpr unsigned silent_looks_needed = 2;
  // Each look makes, connects and closes a socket: some 5 µs.
  static constexpr std::size_t looks_max = 64;
  /// Makes doorbells with this eventfd, or a new one. Does not put it into the store.
  Result<std::vector<SharedFd>> make(ClientIndex client, std::uint64_t wait_set, std::uint32_t uid,
                                     SharedFd eventfd);
  /// Stores the result of a try. Returns false if it shows nothing.
  static bool note(Entry& doorbell, const Result<UniqueFd>& sender) noexcept;
  Result<UniqueFd> connect_to(const UniqueFd& way, const std::string& name) const;
  UniqueFd way_to(const std::string& name) const;
  void close(ClientIndex client, std::uint64_t wait_set) noexcept;
  using Key = std::pair<std::uint32_t, std::uint64_t>;
  static std::string name_of(const Key& key) {
    return std::to_string(key.first) + "." + std::to_string(key.second);
  }

  std::string directory_;
  DescriptorStore& store_;
  Close close_;
  std::map<Key, Entry> doorbells_;
  Key looked_at_{};
};

}  // namespace agnocast::daemon
