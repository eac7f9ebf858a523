// SPDX-License-Identifier: Apache-2.0
//
// Descriptor store: what of this process outlives it.
//
// A manager (systemd, or our own supervisor: see supervisor.hpp) keeps descriptors by name and
// hands them to the next run. What is put is in the manager's queue when put() returns: a death
// right after it loses nothing. The names:
//
//   board, journal, lock, listen     once, in this order: with the lock there is a life to go on
//   with rN   region of process N, to write          pN     its pidfd wN.K its window K, to read
//   eN.X   eventfd of its executor X
//
// A descriptor is put before the journal record that makes it count, and removed after the record
// that ends it. What a death in between leaves over is what nobody takes at the next start.
//
// Without a manager, or with one that keeps nothing, nothing is kept, and every call succeeds.
//
// A manager that listens for the daemon (socket activation) hands its socket in beside them, under
// the name `socket`. That one is the manager's for good, and never put or removed here.
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

/// So many descriptors, under names as long as ours, fit into one variable of the environment
/// (128 KiB): "w2047.7:" has eight bytes.
inline constexpr std::size_t kept_count_max = 16'000;

inline constexpr const char* passed_socket_name = "socket";

/// A descriptor that whoever started this process hands in (LISTEN_FDS), with its name.
struct HandedIn {
  std::string name;
  UniqueFd fd;
};
/// All of them, close-on-exec from now on; once, and before anything else is opened. Errors:
/// os_failure.
[[nodiscard]] Result<std::vector<HandedIn>> receive_descriptors();

class DescriptorStore {
 public:
  /// Nobody keeps anything.
  DescriptorStore() = default;
  /// Nobody keeps anything, and a socket may be handed in all the same. Errors: os_failure.
  [[nodiscard]] static Result<DescriptorStore> of_nobody();
  /// The manager that started this process (NOTIFY_SOCKET) and what it kept (LISTEN_FDS); once, and
  /// before anything else is opened. Errors: os_failure, invalid_argument (there is no manager).
  [[nodiscard]] static Result<DescriptorStore> of_manager();

  DescriptorStore(DescriptorStore&&) = default;
  DescriptorStore& operator=(DescriptorStore&&) = default;

  bool keeps() const noexcept { return keeps_; }
  /// There is a manager, and it keeps nothing: FileDescriptorStoreMax= is 0, or it knows no store.
  bool is_refused() const noexcept { return is_refused_; }

  /// How many it keeps; where the manager does not say it, what our unit asks it for.
  std::size_t capacity() const noexcept {
    return kept_count_max_ != SIZE_MAX ? kept_count_max_ : kept_count_max;
  }

  // --- from the previous run
  bool has(const std::string& name) const { return former_.count(name) != 0; }
  /// A descriptor that was kept; it stays in the store. Empty when there is none.
  UniqueFd take(const std::string& name);
  /// Names that nobody has taken.
  std::vector<std::string> left_over() const;
  /// Removes whatever was not taken, and waits until the manager has done so. The number.
  std::size_t remove_left_over();

  /// What the manager listens at for us; rightly one or none.
  std::vector<UniqueFd> take_passed_sockets() { return std::move(passed_); }

  // --- for the next run
  bool is_kept(const std::string& name) const { return kept_.count(name) != 0; }
  std::size_t kept_count() const noexcept { return kept_.size(); }
  /// Errors: limit_reached (the manager keeps no more), os_failure.
  [[nodiscard]] Result<void> put(const std::string& name, int fd);
  /// What is not kept may be removed as well.
  void remove(const std::string& name) noexcept;

  static std::string region(ClientIndex client);
  static std::string process(ClientIndex client);
  static std::string window(ClientIndex client, std::uint64_t window);
  static std::string eventfd(ClientIndex client, std::uint64_t executor);

 private:
  bool keeps_ = false;
  bool is_refused_ = false;
  std::size_t kept_count_max_ = SIZE_MAX;  // $FDSTORE, where the manager says it
  std::set<std::string> kept_;
  std::map<std::string, UniqueFd> former_;
  std::vector<UniqueFd> passed_;
};

/// sd_notify: READY=1, STATUS=…, STOPPING=1. Without NOTIFY_SOCKET nobody asks.
void notify(const std::string& state) noexcept;
/// Returns when the manager has done what it was told before, or after five seconds without a word.
void wait_for_manager() noexcept;

}  // namespace agnocast::daemon
