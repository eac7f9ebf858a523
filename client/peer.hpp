// SPDX-License-Identifier: Apache-2.0
//
// Peer: another process as this one sees it. Its client region and heap stay mapped as long as
// anybody here has a reference: links, attachments of publishers, held messages. When the last is
// gone the control thread tells the daemon (rule RU).
#pragma once

#include <client/peer_heap.hpp>
#include <client/sparse_region.hpp>

#include <cstddef>
#include <cstdint>
#include <utility>

namespace agnocast {

class Peer {
 public:
  /// `region`: its client region, for reading; the first page is open.
  Peer(std::uint64_t client, std::uint64_t generation, SparseRegion region) noexcept
      : client_(client),
        generation_(generation),
        region_(std::move(region)),
        base_(region_.base()),
        heap_(base_) {}
  /// This very process: `region` belongs to the context, which is immortal.
  Peer(std::uint64_t client, std::uint64_t generation, std::byte* region) noexcept
      : client_(client), generation_(generation), base_(region), heap_(base_) {}

  std::uint64_t client() const noexcept { return client_; }
  std::uint64_t generation() const noexcept { return generation_; }
  std::byte* region() const noexcept { return base_; }
  /// Makes an endpoint of it accessible. Not of this very process.
  [[nodiscard]] Result<void> open(std::uint64_t extent, std::uint64_t bytes) noexcept {
    return region_.open(extent, bytes);
  }
  PeerHeap& heap() noexcept { return heap_; }
  /// Without a daemon to say so. One system call.
  bool is_alive() const noexcept { return region_.base() == nullptr || region_.is_claimed(); }

 private:
  std::uint64_t client_;
  std::uint64_t generation_;
  SparseRegion region_;
  std::byte* base_;
  PeerHeap heap_;  // after region_: it reads frontiers from there, and goes first
};

}  // namespace agnocast
