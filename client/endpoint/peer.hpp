// SPDX-License-Identifier: Apache-2.0
//
// Peer: another process as this one sees it. Its client region and heap stay mapped as long as
// anybody here has a reference: links, attachments of publishers, held messages. When the last is
// gone the control thread tells the daemon (rule RU).
#pragma once

#include <client/heap/peer_heap.hpp>
#include <client/heap/sparse_region.hpp>
#include <client/shares/descriptor_share.hpp>

#include <cstddef>
#include <cstdint>
#include <map>
#include <utility>

namespace agnocast {

class Peer {
 public:
  /// `region`: its client region, for reading; the first page is open. Its file is not kept yet.
  Peer(std::uint64_t client, std::uint64_t generation, DescriptorShare::Owner owner,
       SparseRegion region) noexcept
      : client_(client),
        generation_(generation),
        owner_(owner),
        region_(std::move(region)),
        base_(region_.base()),
        heap_(base_) {}
  /// This very process: `region` belongs to the context, which is immortal.
  Peer(std::uint64_t client, std::uint64_t generation, std::byte* region) noexcept
      : client_(client), generation_(generation), owner_{0, true}, base_(region), heap_(base_) {}

  std::uint64_t client() const noexcept { return client_; }
  std::uint64_t generation() const noexcept { return generation_; }
  std::byte* region() const noexcept { return base_; }
  DescriptorShare::Owner owner() const noexcept { return owner_; }
  /// Makes an endpoint of it accessible. Not of this very process. `announced`: the region's file,
  /// as it came with the endpoint; it is kept if none is and the peer's user has a share left. May
  /// be empty if one is kept. Errors: limit_reached, as of SparseRegion::open. Allocates.
  [[nodiscard]] Result<void> open(std::uint64_t extent, std::uint64_t bytes, UniqueFd announced) {
    if (!region_.has_file() && announced) {
      counted_ = DescriptorShare::instance().take(owner_, 1);
      if (counted_) region_.keep_file(std::move(announced));
    }
    if (!count_mappings(extent))
      return fail(Errc::limit_reached, "the share of mappings of its user is used up");
    return region_.open(extent, bytes, announced.get());
  }
  bool has_file() const noexcept { return region_.has_file(); }
  /// Counts the mappings of one part of it: of its region, by the offset, or of a window. Once, as
  /// what is mapped stays. False: its user has no share left, so the part must not be mapped.
  /// Allocates.
  [[nodiscard]] bool count_mappings(std::uint64_t part) {
    if (mapped_.count(part) != 0) return true;
    auto counted = MappingShare::instance().take(owner_, MappingShare::of_one_part);
    return counted && mapped_.emplace(part, std::move(counted)).second;
  }
  static constexpr std::uint64_t part_of_window(std::uint64_t number) noexcept { return ~number; }
  PeerHeap& heap() noexcept { return heap_; }
  /// Without a daemon to say so. One system call. True if its file was not kept: nobody would tell
  /// when it ends.
  bool is_alive() const noexcept { return region_.base() == nullptr || region_.is_claimed(); }

 private:
  std::uint64_t client_;
  std::uint64_t generation_;
  DescriptorShare::Owner owner_;
  DescriptorShare::Part counted_;
  std::map<std::uint64_t, PeerShare::Part> mapped_;  // by part; ends behind the mappings themselves
  SparseRegion region_;
  std::byte* base_;
  PeerHeap heap_;  // after region_: it reads frontiers from there, and goes first
};

}  // namespace agnocast
