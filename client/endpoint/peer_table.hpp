// SPDX-License-Identifier: Apache-2.0
//
// PeerTable: the processes that this one has mapped in one session, itself included, each as long
// as a link, attachment or held message uses it. Control thread only; but uses may end in any
// thread.
//
//   announced ──▶ region mapped, windows known ──▶ in use ──last use ends──▶ unmapped by collect()
//
// collect() reports to the daemon afterwards (rule RU): it reuses nothing that any process still
// maps.
//
// The daemon wrote the announcement; other processes wrote the regions. Neither is trusted beyond
// what the arena and the user's shares allow (client/shares/).
#pragma once

#include <agnocast/abi/wire.hpp>
#include <agnocast/result.hpp>
#include <base/descriptors/unique_fd.hpp>
#include <client/endpoint/endpoint_table.hpp>
#include <client/endpoint/peer.hpp>
#include <client/heap/arena.hpp>
#include <client/heap/sparse_region.hpp>
#include <client/process/control_wake.hpp>
#include <client/shares/peer_owner.hpp>

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <span>
#include <utility>

namespace agnocast {

class PeerTable {
 public:
  /// A process: client and generation.
  using Key = std::pair<std::uint64_t, std::uint64_t>;
  /// The session of the table; must outlive its peers.
  struct Self {
    Key key;
    SparseRegion* region = nullptr;
    const Arena* arena = nullptr;
    std::shared_ptr<const ControlWake> wake = {};  // called when the last use of a peer has ended
  };

  explicit PeerTable(EndpointTable& endpoints) noexcept : endpoints_(endpoints) {}
  /// Call before the control thread begins.
  void begin(Self self) noexcept { self_ = std::move(self); }

  bool is_self(const Key& process) const noexcept { return process == self_.key; }
  PeerOwner owner_of(const abi::wire::Announcement& announcement) const noexcept;
  bool has(const Key& process) const noexcept { return peers_.count(process) != 0; }
  bool is_empty() const noexcept { return peers_.empty(); }

  /// Returns the process of an announced endpoint, mapped as far as the endpoint needs it, in use
  /// until the last copy is gone. The first `used` descriptors belong to it, also if the result is
  /// null: it cannot be mapped. Allocates.
  std::shared_ptr<Peer> use(const abi::wire::Announcement& announcement, std::span<UniqueFd> fds,
                            std::size_t& used);
  /// Adds a window of a known process; does nothing if the process is not known.
  void add_window(const Key& process, const PeerHeap::Announced& window, UniqueFd fd);
  /// Adds a window of this process itself, which the hook maps.
  void add_own_window(const PeerHeap::Announced& window) {
    add_window(self_.key, window, UniqueFd());
  }

  /// Unmaps unused processes and then calls `unmapped` for each, except for this process itself.
  void collect(const std::function<void(const Key&)>& unmapped);
  /// Does the same without a daemon to notify.
  void collect_alone() noexcept;

 private:
  struct Known {
    std::unique_ptr<Peer> peer;
    std::shared_ptr<std::atomic<std::uint64_t>> users;
  };

  Known* map(const abi::wire::Announcement& announcement, std::span<UniqueFd> fds);
  bool open_endpoint(Known& known, const abi::wire::Announcement& announcement,
                     std::span<UniqueFd> fds);
  bool open_own_links(const abi::wire::Announcement& announcement);
  Result<void> add_window_of(Known& known, const PeerHeap::Announced& window, UniqueFd fd);
  std::shared_ptr<Peer> use(Known& known) const;

  EndpointTable& endpoints_;
  Self self_;
  std::map<Key, Known> peers_;
};

}  // namespace agnocast
