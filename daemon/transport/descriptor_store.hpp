// SPDX-License-Identifier: Apache-2.0
//
// Descriptor store: the descriptors of this process that outlive it.
//
// A manager (systemd, or the daemon's own supervisor: see supervisor.hpp) keeps descriptors by
// name and hands them to the next run. When put() returns, the descriptor is in the manager's
// queue: a death right after it loses nothing. The names:
//
//   board, journal, lock, listen   once, in this order: if the lock is there, a run continues
//   rN     region of process N, writable            pN     its pidfd
//   wN.K   its window K, read-only                  eN.X   eventfd of its wait set X
//
// A descriptor is put before the log record that makes it count, and removed after the record that
// ends it. Those left over by a death in between are not taken by the next start.
//
// Without a manager, or with one that keeps nothing, nothing is kept, and every call succeeds.
//
// A manager that listens for the daemon (socket activation) hands its socket in beside them, under
// the name `socket`. It belongs to the manager and is never put or removed here.
#pragma once

#include <agnocast/result.hpp>
#include <base/descriptors/unique_fd.hpp>
#include <daemon/state/tables.hpp>

#include <cstddef>
#include <cstdint>
#include <map>
#include <set>
#include <string>
#include <utility>
#include <vector>

namespace agnocast::daemon {

/// So many descriptors, with names as long as these, fit into one variable of the environment (128
/// KiB): "w2047.7:" has eight bytes.
inline constexpr std::size_t kept_count_max = 16'000;

inline constexpr const char* passed_socket_name = "socket";

/// A descriptor, with its name, that the parent process hands in (LISTEN_FDS).
struct HandedIn {
  std::string name;
  UniqueFd fd;
};
/// Returns all of them, close-on-exec from now on. Call once, before opening anything else.
/// Errors: os_failure.
[[nodiscard]] Result<std::vector<HandedIn>> receive_descriptors();

class DescriptorStore {
 public:
  /// A store without a manager.
  DescriptorStore() = default;
  /// Returns a store without a manager, with a passed socket if there is one. Errors: os_failure.
  [[nodiscard]] static Result<DescriptorStore> of_nobody();
  /// Returns the store of the manager that started this process (NOTIFY_SOCKET), with what it kept
  /// (LISTEN_FDS). Call once, before opening anything else. Errors: os_failure, invalid_argument
  /// (there is no manager).
  [[nodiscard]] static Result<DescriptorStore> of_manager();

  DescriptorStore(DescriptorStore&&) = default;
  DescriptorStore& operator=(DescriptorStore&&) = default;

  bool keeps() const noexcept { return keeps_; }
  /// Returns whether there is a manager that keeps nothing: FileDescriptorStoreMax= is 0, or it
  /// has no store.
  bool is_refused() const noexcept { return is_refused_; }

  /// Returns how many it keeps; if the manager does not say, the number in the daemon's unit.
  std::size_t capacity() const noexcept {
    return kept_count_max_ != SIZE_MAX ? kept_count_max_ : kept_count_max;
  }

  // --- from the previous run
  bool has(const std::string& name) const { return former_.count(name) != 0; }
  /// Returns a descriptor that was kept; it stays in the store. Empty when there is none.
  UniqueFd take(const std::string& name);
  /// Returns the names that were not taken.
  std::vector<std::string> left_over() const;
  /// Removes descriptors that were not taken, and waits for the manager. Returns their number.
  std::size_t remove_left_over();

  /// Returns the sockets that the manager listens at for the daemon; normally one or none.
  std::vector<UniqueFd> take_passed_sockets() { return std::move(passed_); }

  // --- for the next run
  bool is_kept(const std::string& name) const { return kept_.count(name) != 0; }
  std::size_t kept_count() const noexcept { return kept_.size(); }
  /// Stores a descriptor. Errors: limit_reached (the manager keeps no more), os_failure.
  [[nodiscard]] Result<void> put(const std::string& name, int fd);
  /// Removes a name; it need not be kept.
  void remove(const std::string& name) noexcept;

  static std::string region(ClientIndex client);
  static std::string process(ClientIndex client);
  static std::string window(ClientIndex client, std::uint64_t window);
  static std::string eventfd(ClientIndex client, std::uint64_t wait_set);

 private:
  bool keeps_ = false;
  bool is_refused_ = false;
  std::size_t kept_count_max_ = SIZE_MAX;  // from $FDSTORE, if the manager sets it
  std::set<std::string> kept_;
  std::map<std::string, UniqueFd> former_;
  std::vector<UniqueFd> passed_;
};

/// sd_notify: READY=1, STATUS=…, STOPPING=1. Does nothing without NOTIFY_SOCKET.
void notify(const std::string& state) noexcept;
/// Waits until the manager has handled the earlier messages, or for five seconds.
void wait_for_manager() noexcept;

}  // namespace agnocast::daemon
