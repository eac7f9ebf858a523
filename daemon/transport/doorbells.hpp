// SPDX-License-Identifier: Apache-2.0
//
// Doorbells: the doorbells of all executors, as their maker keeps them.
//
// Of every executor the daemon keeps the eventfd (the descriptor store does as well), to pass it on
// to publishers of the same user, and one datagram sender of its own. It rings by datagram only: an
// eventfd whose O_NONBLOCK its holder has cleared would block whoever writes to it, and the daemon
// must not wait for anybody. For every publisher process a sender of its own is connected when it
// is announced to, and not kept.
//
// The names in the directory are for the next daemon. This one goes its own way to each (O_PATH),
// so nothing is lost when they are removed meanwhile. A daemon that starts without them has
// eventfds alone: publishers of the same user ring those, for others such an executor is silent
// until its process is back and is given a new socket.
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
  /// Closes a receiver that others of this user may have sent something to.
  using Close = std::function<void(std::uint32_t uid, UniqueFd)>;
  /// `directory` exists and only this process's user may enter it.
  Doorbells(std::string directory, DescriptorStore& store, Close close = {})
      : directory_(std::move(directory)), store_(store), close_(std::move(close)) {}
  Doorbells(const Doorbells&) = delete;
  Doorbells& operator=(const Doorbells&) = delete;

  /// New doorbells: eventfd and bound socket, for the executor's process, which is of this user.
  /// Those that it was given before it never got, or they are still on their way: then it is given
  /// the same. Errors: os_failure.
  [[nodiscard]] Result<std::vector<SharedFd>> open(ClientIndex client, std::uint64_t executor,
                                                   std::uint32_t uid);
  /// Doorbells of a previous run, out of the store; their names are in the directory still. A
  /// doorbell whose receiver is gone is silent.
  void restore(ClientIndex client, std::uint64_t executor);
  /// Removes the names that belong to no doorbell.
  void remove_unknown_names() noexcept;
  bool is_open(ClientIndex client, std::uint64_t executor) const {
    return doorbells_.count({number(client), executor}) != 0;
  }
  /// What a publisher's process gets: (eventfd and) a datagram sender; nothing when nobody listens
  /// any more. Errors: os_failure: not now, there is no descriptor or no memory.
  [[nodiscard]] Result<std::vector<SharedFd>> for_publisher(ClientIndex client,
                                                            std::uint64_t executor, bool same_user);
  /// For a process that is back: new doorbells (the eventfd stays) of an executor that this daemon
  /// found without a way to it; none if nothing is lost. A process that closes what it is given
  /// gets it a few times. Errors: os_failure.
  [[nodiscard]] Result<std::vector<SharedFd>> renew(ClientIndex client, std::uint64_t executor,
                                                    std::uint32_t uid);
  struct Executor {
    ClientIndex client;
    std::uint64_t executor;
  };
  /// Looks at the next few doorbells in turn: has anybody the receivers? Returns those that are
  /// silent for the second look in a row, each once: a process that ends shuts its doorbells a
  /// moment before the daemon hears of its end.
  std::vector<Executor> look();
  /// As far as that is known: by datagram nobody reaches it.
  bool is_silent(ClientIndex client, std::uint64_t executor) const {
    const auto found = doorbells_.find({number(client), executor});
    return found == doorbells_.end() || found->second.is_silent;
  }
  /// look() has returned it, or it was silent when this daemon began.
  bool is_known_silent(ClientIndex client, std::uint64_t executor) const {
    const auto found = doorbells_.find({number(client), executor});
    return found != doorbells_.end() && found->second.silent_looks == silent_looks_needed;
  }
  void ring(ClientIndex client, std::uint64_t executor) noexcept;
  void ring_all() noexcept;
  /// The process is dead.
  void close_client(ClientIndex client) noexcept;

 private:
  struct Entry {
    SharedFd eventfd;
    std::weak_ptr<SharedFd::element_type> given;  // the receiver, until it is sent
    Doorbell own;
    // O_PATH of the bound name: a way to it when somebody has tidied up the directory.
    UniqueFd way;
    bool is_silent = false;
    unsigned silent_looks = 0;  // in a row, up to silent_looks_needed
    unsigned renewals_left = 0;
  };
  Result<SharedFd> duplicate_receiver(int fd, std::uint32_t uid) const;
  // Publishers are told of each.
  static constexpr unsigned renewals_max = 3;
  static constexpr unsigned silent_looks_needed = 2;
  // Each a socket that is made, connected and closed, some 5 µs.
  static constexpr std::size_t looks_max = 64;
  /// With this eventfd, or a new one. Not put into the store.
  Result<std::vector<SharedFd>> make(ClientIndex client, std::uint64_t executor, std::uint32_t uid,
                                     SharedFd eventfd);
  /// False: this try has told nothing.
  static bool note(Entry& doorbell, const Result<UniqueFd>& sender) noexcept;
  Result<UniqueFd> connect_to(const UniqueFd& way, const std::string& name) const;
  UniqueFd way_to(const std::string& name) const;
  void close(ClientIndex client, std::uint64_t executor) noexcept;
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
