// SPDX-License-Identifier: Apache-2.0
//
// GraphTable: the graph table of this daemon process (abi/graph_table.hpp). It begins with the
// first process that asks, and then follows the registry.
//
//   none ──open()──▶ filled from the registry ──update()──▶ as the registry is, changes + 1
//
// Its file has memory for every entry before a reader may look at it, and never gets shorter: it is
// as long as the most endpoints that there were at once need. Endpoints beyond the limit, or beyond
// the memory of the machine, are counted as missing, and tried again each second.
#pragma once

#include <agnocast/abi/graph_table.hpp>
#include <agnocast/result.hpp>
#include <base/memory/mapping.hpp>
#include <daemon/state/registry.hpp>
#include <daemon/transport/shared_fd.hpp>

#include <cstdint>
#include <unordered_map>
#include <vector>

namespace agnocast::daemon {

class GraphTable {
 public:
  /// `entries_max`: at most abi::graph_entry_max; less for tests.
  explicit GraphTable(Registry& registry, std::uint32_t entries_max = abi::graph_entry_max) noexcept
      : registry_(registry), entries_max_(entries_max) {}

  /// Makes and fills the table, unless it is there. Errors: os_failure.
  [[nodiscard]] Result<void> open();
  bool is_open() const noexcept { return reader_ != nullptr; }
  /// Writes what has changed in the registry. Returns whether there is something new for readers.
  bool update(std::uint64_t now_ms);

  /// Returns the descriptor for readers.
  const SharedFd& reader() const noexcept { return reader_; }
  /// Returns the number of this table, which no other daemon process of the machine's uptime has.
  std::uint64_t number() const noexcept { return number_; }
  std::uint64_t changes() const noexcept;
  std::uint64_t missing() const noexcept { return missing_.size(); }

 private:
  /// An endpoint's place in the registry as a number.
  using Place = std::uint64_t;

  abi::GraphHeader& header() const noexcept;
  abi::GraphEntry& entry(std::uint32_t index) const noexcept;
  void fill();
  bool follow(const EndpointRef& ref);
  bool put(const EndpointRef& ref);
  bool remove(Place place);
  bool has_room() const noexcept;
  std::uint32_t free_entry();
  void grow();

  Registry& registry_;
  const std::uint32_t entries_max_;
  UniqueFd writer_;
  SharedFd reader_;
  Mapping mapping_;
  std::uint64_t number_ = 0;
  std::unordered_map<Place, std::uint32_t> entries_;  // by place
  std::unordered_map<Place, EndpointRef> missing_;
  std::vector<std::uint32_t> free_;  // below entry_high
  std::uint64_t retried_ms_ = 0;     // when missing endpoints were last tried
};

}  // namespace agnocast::daemon
