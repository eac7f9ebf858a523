// SPDX-License-Identifier: Apache-2.0
//
// Config: the configuration of agnocastd from /etc/agnocast/agnocastd.toml. One table (in
// config_keys.cpp) has every key with its bounds and its explanation; the reader, the printed
// configuration and systemd/agnocastd.toml are made from it.
//
// A file is accepted as a whole or not at all: every mistake is reported with its place and a
// remedy. Values that depend on the machine or on the daemon's user are "auto" here (0 or empty);
// the address plan and the options decide them.
#pragma once

#include <agnocast/abi/client_region.hpp>
#include <agnocast/abi/limits.hpp>
#include <base/text/log.hpp>
#include <config/mistake.hpp>
#include <daemon/config/access.hpp>
#include <daemon/config/thread_rules.hpp>

#include <tl/expected.hpp>

#include <sys/types.h>

#include <algorithm>
#include <cstdint>
#include <functional>
#include <limits>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace agnocast::daemon {

/// "unlimited" in the file.
inline constexpr std::uint64_t unlimited = std::numeric_limits<std::uint64_t>::max();

/// Returns one user's default share of something that all users share: no user takes the last
/// places alone. Amounts that are too small to divide are given whole.
constexpr std::uint64_t share_of_one_user(std::uint64_t all) noexcept { return all - all / 4; }

struct Config {
  struct Daemon {
    std::string socket;             // empty: see options.hpp
    std::string runtime_directory;  // empty: the directory of the socket
    std::uint32_t socket_mode = 0660;
    std::string socket_group;  // empty: the group "agnocast" if it exists
    LogLevel log_level = LogLevel::info;
    // 0: off. The same as WatchdogSec= of the unit: a loop that hangs costs no messages, and no
    // load of a machine keeps a process from running for so long.
    std::uint32_t watchdog_seconds = 30;
    friend bool operator==(const Daemon&, const Daemon&) = default;
  };
  struct Heap {
    std::uint64_t window_bytes = 0;  // 0: from the memory of the machine
    std::uint32_t windows_per_process = abi::window_count_max;
    std::uint64_t arena_base = 0;   // 0: from its address bits
    std::uint64_t arena_bytes = 0;  // 0: likewise
    friend bool operator==(const Heap&, const Heap&) = default;
  };
  // For the daemon as a whole; at most the capacity of the shared layout.
  struct Limits {
    std::uint32_t depth_max = abi::depth_max;
    std::uint32_t slots_per_publisher = abi::slot_count_max;
    std::uint32_t clients = abi::client_count_max;
    std::uint32_t topics = abi::topic_count_max;
    std::uint32_t publishers_per_topic = abi::publisher_count_max;
    std::uint32_t subscriptions_per_topic = abi::subscription_count_max;
    /// Names of topics that may have more publishers than one link block has lines; in any domain.
    std::vector<std::string> wide_topics = {"/rosout", "/parameter_events", "/diagnostics"};
    friend bool operator==(const Limits&, const Limits&) = default;
  };
  // For each user.
  struct Quota {
    std::uint64_t clients = share_of_one_user(abi::client_count_max);
    std::uint64_t topics = share_of_one_user(abi::topic_count_max);
    std::uint64_t publishers = 16'384;
    std::uint64_t subscriptions = 32'768;
    // In one topic. 0: share_of_one_user() of its places.
    std::uint64_t publishers_per_topic = 0;
    std::uint64_t subscriptions_per_topic = 0;
    // Address space; cgroups limit memory. 0: share_of_one_user() of the arena.
    std::uint64_t heap_bytes = 0;
    std::uint64_t held_messages = 1'048'576;
    std::uint64_t wait_sets = 4'096;  // each costs the daemon three descriptors
    // Eight of the longest dumps (5.3 MB, with full tables) and as much again for processes that
    // come back all at once; those are notified in parts.
    std::uint64_t queued_bytes = std::uint64_t{96} << 20;
    // Longer than load keeps a process from reading, shorter than a user waits for memory.
    std::uint64_t queued_seconds = 30;
    // With full tables this costs a tenth or two of a core; tools look once a second.
    std::uint64_t dumps_per_second = 20;
    // Four processes with the required 2,000 groups, in less than 5 MB of a dump; threads likewise.
    std::uint64_t callback_groups = 8'192;
    std::uint64_t callback_threads = 4'096;
    friend bool operator==(const Quota&, const Quota&) = default;
  };

  Daemon daemon;
  Heap heap;
  Limits limits;
  Quota quota;
  std::vector<AccessRule> access;
  std::vector<ThreadRule> threads;
  /// Returns the limit for the regions of one user's processes, in bytes. The memory of an ended
  /// endpoint stays with its process for the next one; twice the need of all endpoints that may
  /// exist at once in a domain, as extents of several sizes leave gaps.
  std::uint64_t region_bytes() const noexcept {
    if (quota.publishers == unlimited || quota.subscriptions == unlimited) return unlimited;
    const std::uint64_t wide = std::min<std::uint64_t>(
        quota.subscriptions, limits.wide_topics.size() * limits.subscriptions_per_topic);
    return 2 * (quota.publishers * abi::publisher_extent_bytes +
                (quota.subscriptions - wide) * abi::subscription_extent_bytes(1) +
                wide * abi::subscription_extent_bytes(abi::link_block_max));
  }
  friend bool operator==(const Config&, const Config&) = default;
};

using ConfigError = config::Mistake;

/// A configuration, or every mistake in the order of the file (at least one).
using ConfigResult = tl::expected<Config, std::vector<ConfigError>>;

/// Finds the numbers of user and group names; tests bring their own.
struct NameLookup {
  std::function<std::optional<uid_t>(const std::string&)> user;
  std::function<std::optional<gid_t>(const std::string&)> group;
  /// Returns the system's (getpwnam, getgrnam).
  static NameLookup system();
};

[[nodiscard]] ConfigResult load_config(const std::string& file,
                                       const NameLookup& names = NameLookup::system());
/// `file` is used in errors only.
[[nodiscard]] ConfigResult parse_config(std::string_view text, const std::string& file,
                                        const NameLookup& names = NameLookup::system());

/// Returns the configuration as a file with explanations; parse_config reads the same back.
std::string to_toml(const Config& config);

/// Returns the number of "16GiB"; nothing when it is none. Units: B, KiB, MiB, GiB, TiB.
std::optional<std::uint64_t> parse_bytes(std::string_view text) noexcept;
/// Returns the shortest exact form: "16GiB", "1536MiB", "4097B".
std::string bytes_text(std::uint64_t bytes);

}  // namespace agnocast::daemon
