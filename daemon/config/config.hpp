// SPDX-License-Identifier: Apache-2.0
//
// Config: what agnocastd is told by /etc/agnocast/agnocastd.toml. One table (in config.cpp) holds
// every key with its bounds and its explanation; the reader, the printed configuration and
// systemd/agnocastd.toml are made from it.
//
// A file is taken whole or not at all: every mistake in it is reported with its place and what to
// do, and the daemon keeps what it had. What depends on the machine or on who runs the daemon is
// "auto" here (0 or empty) and is decided by the part that knows: the address plan, the options.
#pragma once

#include <agnocast/abi/client_region.hpp>
#include <agnocast/abi/limits.hpp>
#include <base/text/log.hpp>
#include <config/mistake.hpp>
#include <daemon/config/access.hpp>

#include <tl/expected.hpp>

#include <sys/types.h>

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

/// What one user may have by default of something that there is for everybody: nobody takes the
/// last places alone. Of what is too little to be divided, all.
constexpr std::uint64_t share_of_one_user(std::uint64_t all) noexcept { return all - all / 4; }

struct Config {
  struct Daemon {
    std::string socket;             // empty: see options.hpp
    std::string runtime_directory;  // empty: the directory of the socket
    std::uint32_t socket_mode = 0660;
    std::string socket_group;  // empty: the group "agnocast" if there is one
    LogLevel log_level = LogLevel::info;
    // 0: off. As long as WatchdogSec= of the unit: a loop that hangs costs nobody messages, and no
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
  // Of the daemon as a whole; at most what the shared layout has room for.
  struct Limits {
    std::uint32_t depth_max = abi::depth_max;
    std::uint32_t slots_per_publisher = abi::slot_count_max;
    std::uint32_t clients = abi::client_count_max;
    std::uint32_t topics = abi::topic_count_max;
    std::uint32_t publishers_per_topic = abi::publisher_count_max;
    std::uint32_t subscriptions_per_topic = abi::subscription_count_max;
    friend bool operator==(const Limits&, const Limits&) = default;
  };
  // Of each user.
  struct Quota {
    std::uint64_t clients = share_of_one_user(abi::client_count_max);
    std::uint64_t topics = share_of_one_user(abi::topic_count_max);
    std::uint64_t publishers = 16'384;
    std::uint64_t subscriptions = 32'768;
    // Of one topic. 0: share_of_one_user() of [limits] of the same name.
    std::uint64_t publishers_per_topic = 0;
    std::uint64_t subscriptions_per_topic = 0;
    // Of addresses; memory is what cgroups limit. 0: share_of_one_user() of the arena.
    std::uint64_t heap_bytes = 0;
    std::uint64_t held_messages = 1'048'576;
    std::uint64_t executors = 4'096;  // each is two descriptors of the daemon
    // Eight of the longest dumps (5.3 MB, of full tables) and as much again for processes that come
    // back all at once; they are told in parts.
    std::uint64_t queued_bytes = std::uint64_t{96} << 20;
    // Longer than a process is kept from reading by load, shorter than anybody waits for memory.
    std::uint64_t queued_seconds = 30;
    // What full tables cost then is a tenth or two of a core; tools look once a second.
    std::uint64_t dumps_per_second = 20;
    /// Bytes of the regions of one user's processes together. The memory of an endpoint that has
    /// ended stays with its process for the next one; twice what the endpoints need that there may
    /// be at once, as extents of two sizes leave gaps.
    std::uint64_t region_bytes() const noexcept {
      return 2 * (publishers * abi::publisher_extent_bytes +
                  subscriptions * abi::subscription_extent_bytes);
    }
    friend bool operator==(const Quota&, const Quota&) = default;
  };

  Daemon daemon;
  Heap heap;
  Limits limits;
  Quota quota;
  std::vector<AccessRule> access;
  friend bool operator==(const Config&, const Config&) = default;
};

using ConfigError = config::Mistake;

/// A configuration, or every mistake in the order of the file (at least one).
using ConfigResult = tl::expected<Config, std::vector<ConfigError>>;

/// Numbers of user and group names; tests bring their own.
struct NameLookup {
  std::function<std::optional<uid_t>(const std::string&)> user;
  std::function<std::optional<gid_t>(const std::string&)> group;
  /// The system's (getpwnam, getgrnam).
  static NameLookup system();
};

[[nodiscard]] ConfigResult load_config(const std::string& file,
                                       const NameLookup& names = NameLookup::system());
/// `file` is only named in errors.
[[nodiscard]] ConfigResult parse_config(std::string_view text, const std::string& file,
                                        const NameLookup& names = NameLookup::system());

/// The configuration as a file with explanations, which parse_config reads back to the same.
std::string to_toml(const Config& config);

/// "16GiB" to a number; nothing when it is none. Units: B, KiB, MiB, GiB, TiB.
std::optional<std::uint64_t> parse_bytes(std::string_view text) noexcept;
/// The shortest exact form: "16GiB", "1536MiB", "4097B".
std::string bytes_text(std::uint64_t bytes);

}  // namespace agnocast::daemon
