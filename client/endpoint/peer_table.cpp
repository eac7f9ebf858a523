// SPDX-License-Identifier: Apache-2.0

#include <client/endpoint/peer_table.hpp>
#include <client/process/steps.hpp>

#include <iterator>

namespace agnocast {

namespace wire = abi::wire;
using wire::Kind;

PeerOwner PeerTable::owner_of(const wire::Announcement& announcement) const noexcept {
  return {announcement.uid, announcement.same_user != 0 ||
                                is_self({announcement.client, announcement.client_generation})};
}

std::shared_ptr<Peer> PeerTable::use(Known& known) const {
  known.users->fetch_add(1, std::memory_order_relaxed);
  // The peer itself stays in the table; its users share only the counter.
  return {known.peer.get(), [users = known.users, wake = self_.wake](Peer*) {
            if (users->fetch_sub(1, std::memory_order_acq_rel) == 1) (*wake)();
          }};
}

std::shared_ptr<Peer> PeerTable::use(const wire::Announcement& announcement,
                                     std::span<UniqueFd> fds, std::size_t& used) {
  used = 1 + announcement.window_count;
  if (announcement.window_count > abi::window_count_max) return nullptr;
  const auto found = peers_.find({announcement.client, announcement.client_generation});
  const bool is_known = found != peers_.end() && found->second.peer->has_file();
  if (fds.size() < used && !(is_known && announcement.window_count == 0)) return nullptr;
  Known* const known = found != peers_.end() ? &found->second : map(announcement, fds);
  if (known == nullptr) return nullptr;
  for (std::uint32_t i = 0; i < announcement.window_count; ++i) {
    const auto& window = announcement.window[i];
    if (!add_window_of(*known, {i, window.base, window.bytes, window.first}, std::move(fds[1 + i])))
      return nullptr;
  }
  AGNOCAST_CRASH_POINT(C_peer_extent);
  return open_endpoint(*known, announcement, fds) ? use(*known) : nullptr;
}

/// Maps a process that is not known yet. Returns null if it cannot be mapped.
PeerTable::Known* PeerTable::map(const wire::Announcement& announcement, std::span<UniqueFd> fds) {
  const Key key{announcement.client, announcement.client_generation};
  Known known;
  known.users = std::make_shared<std::atomic<std::uint64_t>>(0);
  if (is_self(key)) {
    known.peer = std::make_unique<Peer>(key.first, key.second, self_.region->base());
  } else {
    AGNOCAST_CRASH_POINT(C_peer_map);
    Result<SparseRegion> region =
        SparseRegion::make(UniqueFd(), abi::client_region_bytes, Mapping::Access::read);
    if (!region || !region->open(0, abi::page_bytes, fds[0].get())) return nullptr;
    known.peer =
        std::make_unique<Peer>(key.first, key.second, owner_of(announcement), std::move(*region));
    // Its first page, at offset 0.
    if (!known.peer->count_mappings(0)) return nullptr;
  }
  return &peers_.emplace(key, std::move(known)).first->second;
}

bool PeerTable::open_endpoint(Known& known, const wire::Announcement& announcement,
                              std::span<UniqueFd> fds) {
  UniqueFd none;
  UniqueFd& file = fds.empty() ? none : fds[0];
  const bool is_own = is_self({announcement.client, announcement.client_generation});
  const auto open = [&](std::uint64_t offset, std::uint64_t bytes) {
    return (is_own ? self_.region->open(offset, bytes) : known.peer->open(offset, bytes, file))
        .has_value();
  };
  if (announcement.kind == Kind::publisher)
    return open(announcement.extent, abi::publisher_extent_bytes) && open_own_links(announcement);
  // An own one may be announced before its creation is answered, which was requested again.
  const std::uint64_t publisher = announcement.own_index;
  return publisher < abi::publisher_count_max &&
         open(announcement.extent, abi::subscription_extent_bytes(1)) &&
         (publisher < abi::link_block_count ||
          open(announcement.extent + abi::link_block_offset(publisher), abi::link_block_bytes));
}

/// Makes the link lines accessible that a subscription of this process has for the publisher.
bool PeerTable::open_own_links(const wire::Announcement& announcement) {
  const auto subscription = endpoints_.subscription({announcement.topic, announcement.own_index},
                                                    announcement.own_generation);
  if (subscription == nullptr) return true;  // it has ended meanwhile
  return announcement.index < abi::publisher_count_max &&
         self_.region
             ->open(subscription->identity().extent + abi::link_block_offset(announcement.index),
                    abi::link_block_bytes)
             .has_value();
}

void PeerTable::add_window(const Key& process, const PeerHeap::Announced& window, UniqueFd fd) {
  const auto found = peers_.find(process);
  if (found != peers_.end()) (void)add_window_of(found->second, window, std::move(fd));
}

Result<void> PeerTable::add_window_of(Known& known, const PeerHeap::Announced& window,
                                      UniqueFd fd) {
  PeerHeap& heap = known.peer->heap();
  if (!self_.arena->contains(window.base, window.length))
    return fail(Errc::protocol_violation, "a window outside the arena");
  AGNOCAST_CRASH_POINT(C_peer_window);
  if (heap.has(window.number)) return {};
  const std::uint64_t before = heap.window_count();
  Result<void> added;
  if (is_self({known.peer->client(), known.peer->generation()})) {
    added = heap.add_own(window);
  } else if (!self_.arena->has(window.base, window.length)) {
    added = heap.add_blocked(window);
  } else if (!known.peer->count_mappings(Peer::part_of_window(window.number))) {
    added = heap.add_without_file(window);
  } else if (auto counted = DescriptorShare::instance().take(known.peer->owner(), 1)) {
    added = heap.add(window, std::move(fd), std::move(counted));
  } else {
    added = heap.add_without_file(window);
  }
  // A take may have found a message there already, and have left it.
  if (heap.window_count() != before) endpoints_.wake_wait_sets();
  return added;
}

void PeerTable::collect(const std::function<void(const Key&)>& unmapped) {
  for (auto it = peers_.begin(); it != peers_.end();) {
    if (it->second.users->load(std::memory_order_acquire) != 0) {
      ++it;
      continue;
    }
    const Key process = it->first;
    AGNOCAST_CRASH_POINT(C_peer_unmap);
    it = peers_.erase(it);  // unmapped here, reported afterwards
    if (!is_self(process)) unmapped(process);
  }
}

void PeerTable::collect_alone() noexcept {
  for (auto it = peers_.begin(); it != peers_.end();)
    it = it->second.users->load(std::memory_order_acquire) == 0 ? peers_.erase(it) : std::next(it);
}

}  // namespace agnocast
