// SPDX-License-Identifier: Apache-2.0
//
// PeerTable: the processes that this one has mapped in one session, itself included, each as long
// as anybody here uses it: links, attachments, held messages. Control thread only; only uses end
// anywhere.
//
//   announced ──▶ region mapped, windows known ──▶ in use ──last use ends──▶ unmapped by collect(), and then said to the
//   daemon (rule RU), which reuses nothing that somebody still maps
//
// What comes with an announcement was written by the daemon; what lies in the regions by other
// processes. Neither is used beyond what the arena and the user's shares allow (client/shares/).
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
  /// What a table belongs to; must outlive its peers.
  struct Self {
    Key key;
    SparseRegion* region = nullptr;
    const Arena* arena = nullptr;
    std::shared_ptr<const ControlWake> wake = {};  // rung when the last use of a peer has ended
  };

  explicit PeerTable(EndpointTable& endpoints) noexcept : endpoints_(endpoints) {}
  /// Before the control thread begins.
  void begin(Self self) noexcept { self_ = std::move(self); }

  bool is_self(const Key& process) const noexcept { return process == self_.key; }
  PeerOwner owner_of(const abi::wire::Announcement& announcement) const noexcept;
  bool has(const Key& process) const noexcept { return peers_.count(process) != 0; }
  bool is_empty() const noexcept { return peers_.empty(); }

  /// The process of an announced endpoint, mapped as far as the endpoint needs it, in use until the
  /// last copy goes. The first `used` descriptors are its own, whatever comes of it. Null: it
  /// cannot be mapped. Allocates.
  std::shared_ptr<Peer> use(const abi::wire::Announcement& announcement, std::span<UniqueFd> fds,
                            std::size_t& used);
  /// A window of a process that is known. Nothing happens if it is not.
  void add_window(const Key& process, const PeerHeap::Announced& window, UniqueFd fd);
  /// The same of this process itself, whose hook maps it.
  void add_own_window(const PeerHeap::Announced& window) {
    add_window(self_.key, window, UniqueFd());
  }

  /// Unmaps whom nobody uses, and tells `unmapped` of each then, but for this process itself.
  void collect(const std::function<void(const Key&)>& unmapped);
  /// The same without a daemon that wants to know.
  void collect_alone() noexcept;

 private:
  struct Known {
    std::unique_ptr<Peer> peer;
    std::shared_ptr<std::atomic<std::uint64_t>> users;
  };

  Known* map(const abi::wire::Announcement& announcement, std::span<UniqueFd> fds);
  bool open_endpoint(Known& known, const abi::wire::Announcement& announcement,
                     std::span<UniqueFd> fds);
  Result<void> add_window_of(Known& known, const PeerHeap::Announced& window, UniqueFd fd);
  std::shared_ptr<Peer> use(Known& known) const;

  EndpointTable& endpoints_;
  Self self_;
  std::map<Key, Known> peers_;
};

}  // namespace agnocast
