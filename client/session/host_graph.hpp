// SPDX-License-Identifier: Apache-2.0
//
// HostGraph: the daemon's graph table, as this process has it mapped, for everybody in the process
// who watches the graph.
//
//   nobody asks ──ask()──▶ one request at the daemon ──it answers, or the session fails──▶ nobody asks
//                                                         └──▶ all who wait are woken
//
// The request outlives the connection: the next daemon process answers it at once, with a table of
// its own. Without a request nothing would tell that the table is another process's, so it goes
// with the connection. The control thread maps a table; readers of an earlier one keep that as long
// as they like.
#pragma once

#include <agnocast/abi/graph_table.hpp>
#include <agnocast/result.hpp>
#include <base/immortal.hpp>
#include <base/memory/mapping.hpp>
#include <client/connection/connection.hpp>

#include <algorithm>
#include <cstdint>
#include <memory>
#include <mutex>
#include <optional>
#include <vector>

namespace agnocast {

/// A mapped graph table. The daemon may change it at any time.
class GraphTable {
 public:
  /// Errors: protocol_violation (it is no graph table), those of Mapping::map, os_failure.
  [[nodiscard]] static Result<std::shared_ptr<const GraphTable>> map(int fd, std::uint64_t number);

  /// Returns its number among the tables of all daemon processes.
  std::uint64_t number() const noexcept { return number_; }
  std::uint64_t incarnation() const noexcept {
    return header().incarnation.load(std::memory_order_relaxed);
  }
  /// Returns how often it has changed. [sync:graph] acquire, ahead of the entries.
  std::uint64_t changes() const noexcept {
    return header().changes.load(std::memory_order_acquire);
  }
  /// Returns how many entries may be read.
  std::uint64_t entry_count() const noexcept {
    return std::min<std::uint64_t>(header().entry_high.load(std::memory_order_acquire),
                                   abi::graph_entry_max);
  }
  /// Returns how many endpoints have no entry.
  std::uint64_t missing_count() const noexcept {
    return header().missing.load(std::memory_order_relaxed);
  }
  const abi::GraphEntry& entry(std::uint64_t index) const noexcept {
    return *reinterpret_cast<const abi::GraphEntry*>(mapping_.base() +
                                                     abi::graph_entry_offset(index));
  }

 private:
  GraphTable(Mapping mapping, std::uint64_t number) noexcept
      : mapping_(std::move(mapping)), number_(number) {}
  const abi::GraphHeader& header() const noexcept {
    return *reinterpret_cast<const abi::GraphHeader*>(mapping_.base());
  }

  Mapping mapping_;
  std::uint64_t number_;
};

/// Any thread.
class HostGraph {
 public:
  static HostGraph& instance() noexcept { return immortal<HostGraph>(); }

  /// Returns the table of the last answer; null: ask() first. While a request waits for a daemon
  /// that is away, it is that of the last one.
  std::shared_ptr<const GraphTable> table() const;
  /// Asks the daemon to answer when there are other changes than `seen`, unless a request waits
  /// already. Connects first if necessary, which may take five seconds. Errors: those of Context,
  /// if the request cannot be made.
  [[nodiscard]] Result<void> ask(std::uint64_t seen);
  /// How many requests have failed, and why the last one did. It does not allocate, because a
  /// failure is reported even without memory.
  struct Failures {
    std::uint64_t count = 0;
    Errc code = Errc::ok;
    char detail[detail_bytes_max] = "";
  };
  Failures failures() const noexcept;

  /// This eventfd is raised by each answer and each failure, until remove().
  void add(int eventfd);
  void remove(int eventfd) noexcept;

  /// Control thread of the present session.
  void connection_ended() noexcept;

 private:
  void on_answer(Result<Incoming*> answer) noexcept;
  Result<void> take(Incoming& packet);
  void wake_all() const noexcept;

  mutable std::mutex mutex_;
  std::shared_ptr<const GraphTable> table_;
  bool is_asked_ = false;
  Failures failures_;
  std::vector<int> waiting_;
};

}  // namespace agnocast
