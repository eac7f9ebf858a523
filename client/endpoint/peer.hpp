// SPDX-License-Identifier: Apache-2.0
//
// Peer: another process as this one sees it. Its client region and heap stay mapped as long as this
// process has a reference: a link, an attachment of a publisher, a held message. When the last one
// is gone, the control thread tells the daemon (rule RU).
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
  /// `region`: its client region, for reading, with the first page open and its file not kept yet.
  Peer(std::uint64_t client, std::uint64_t generation, DescriptorShare::Owner owner,
       SparseRegion region) noexcept
      : client_(client),
        generation_(generation),
        owner_(owner),
        region_(std::move(region)),
        base_(region_.base()),
        heap_(base_) {}
  /// This process itself: `region` belongs to the context, which is immortal.
  Peer(std::uint64_t client, std::uint64_t generation, std::byte* region) noexcept
      : client_(client), generation_(generation), owner_{0, true}, base_(region), heap_(base_) {}

  std::uint64_t client() const noexcept { return client_; }
  std::uint64_t generation() const noexcept { return generation_; }
  std::byte* region() const noexcept { return base_; }
  DescriptorShare::Owner owner() const noexcept { return owner_; }
  /// Makes a part of one of its endpoints accessible. Not for this process itself. `announced`: the
  /// region's file that came with the endpoint. It is taken if none is kept yet and the peer's user
  /// has a share left; it may be empty if one is kept. Errors: limit_reached, those of
  /// SparseRegion::open. Allocates.
  [[nodiscard]] Result<void> open(std::uint64_t offset, std::uint64_t bytes, UniqueFd& announced) {
    if (!region_.has_file() && announced) {
      counted_ = DescriptorShare::instance().take(owner_, 1);
      if (counted_) region_.keep_file(std::move(announced));
    }
    if (!count_mappings(offset))
      return fail(Errc::limit_reached, "the share of mappings of its user is used up");
    // If it was taken, the region has it. NOLINTNEXTLINE(bugprone-use-after-move)
    return region_.open(offset, bytes, announced.get());
  }
  bool has_file() const noexcept { return region_.has_file(); }
  /// Counts the mappings of one part: of its region, by the offset, or of a window. Once, because
  /// mappings stay. Returns false if its user has no share left: the part must not be mapped then.
  /// Allocates.
  [[nodiscard]] bool count_mappings(std::uint64_t part) {
    if (mapped_.count(part) != 0) return true;
    auto counted = MappingShare::instance().take(owner_, MappingShare::of_one_part);
    return counted && mapped_.emplace(part, std::move(counted)).second;
  }
  static constexpr std::uint64_t part_of_window(std::uint64_t number) noexcept { return ~number; }
  PeerHeap& heap() noexcept { return heap_; }
  /// Returns whether the process lives, without a daemon; one system call. Returns true if its file
  /// was not kept: there is no way to see its end then.
  bool is_alive() const noexcept { return region_.base() == nullptr || region_.is_claimed(); }

 private:
  std::uint64_t client_;
  std::uint64_t generation_;
  DescriptorShare::Owner owner_;
  DescriptorShare::Part counted_;
  std::map<std::uint64_t, PeerShare::Part> mapped_;  // by part; ends after the mappings
  SparseRegion region_;
  std::byte* base_;
  PeerHeap heap_;  // after region_, from which it reads frontiers: destroyed first
};

}  // namespace agnocast
