// SPDX-License-Identifier: Apache-2.0
//
// Regions: the memory that the daemon makes. Board and tables once, a client region and heap
// windows per process.
//
// A process gets a writable descriptor of its own region and windows; all others get one that was
// opened for reading. The daemon keeps its own writable mapping of every client region: to prepare
// extents before they are given out, and to repair the queues of a dead process. It is one mapping
// of the kernel, whatever lies in it: mappings are limited (vm.max_map_count), and mlock of a part
// would split one into three. So nothing is locked here; a process that must not wait for a
// swapped-out page locks its own mappings (mlockall).
//
// A region is as long as the extents given out of it, a window as long as its owner's use of it. A
// reader has a descriptor of the whole, and touching a hole through a mapping allocates a page,
// which no limit of the reader counts; beyond the end nothing can be touched. Neither ever gets
// shorter, and the daemon backs an extent with memory before it announces it, so that no process
// gets SIGBUS when it reads what was announced to it.
//
// A page fault waits while a hole is being punched over its page, for as long as the punching
// process likes. So no process can punch holes into a region, the daemon included: stores clear an
// extent, and its memory stays with its process until that ends.
//
// The daemon puts every memfd into the descriptor store before it announces it, and removes it
// when its process is over; so a restarted daemon has the same memory again.
//
// The registry decides whose region it is and when it goes; nothing here decides.
#pragma once

#include <agnocast/result.hpp>
#include <base/memory/mapping.hpp>
#include <daemon/state/per_client.hpp>
#include <daemon/state/registry.hpp>
#include <daemon/transport/closer.hpp>
#include <daemon/transport/descriptor_store.hpp>
#include <daemon/transport/errands.hpp>
#include <daemon/transport/shared_fd.hpp>

#include <sys/types.h>

#include <cstddef>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <unordered_map>
#include <vector>

namespace agnocast::daemon {

class Regions {
 public:
  /// Makes board and tables, empty and not in the store yet: see keep(). Errors: os_failure.
  [[nodiscard]] static Result<Regions> create(DescriptorStore& store);
  /// Adopts board and journal of a previous run. Errors: layout_mismatch, store_damaged (they have
  /// the wrong sizes), os_failure.
  [[nodiscard]] static Result<Regions> adopt(DescriptorStore& store, UniqueFd board,
                                             UniqueFd journal);
  /// Puts board and journal into the store. Errors: as DescriptorStore::put.
  [[nodiscard]] Result<void> keep() const;

  Registry::Memory memory() const noexcept;
  const SharedFd& board_reader() const noexcept { return board_reader_; }

  /// Makes a fresh region for the process in this place, and closes the previous one. Errors:
  /// limit_reached (of mappings), os_failure.
  [[nodiscard]] Result<void> open_client(ClientIndex client, std::uint64_t generation);
  /// Takes region and windows of a process out of the store; `used_bytes` of the region were given
  /// out. Errors: endpoint_gone (a part is missing; the rest is held), os_failure.
  [[nodiscard]] Result<void> adopt_client(ClientIndex client, std::uint64_t window_count,
                                          std::uint64_t used_bytes);
  const SharedFd& region_writer(ClientIndex client) const noexcept {
    return of(client).region_writer;
  }
  const SharedFd& region_reader(ClientIndex client) const noexcept {
    return of(client).region_reader;
  }
  bool is_open(ClientIndex client) const noexcept { return static_cast<bool>(of(client).region); }
  /// Returns the daemon's own mapping.
  std::byte* region(ClientIndex client) const noexcept { return of(client).region->base(); }
  /// Device and inode of the region in /proc/PID/maps.
  struct FileId {
    std::uint64_t device = 0;
    std::uint64_t inode = 0;
    friend bool operator==(const FileId&, const FileId&) = default;
  };
  FileId region_file(ClientIndex client) const noexcept { return of(client).file; }

  /// Checks that holes in regions can be forbidden here. Errors: as of forbid_holes().
  [[nodiscard]] static Result<void> can_forbid_holes();

  /// A process that may write to the file of a region may keep the kernel's lock of it for ever.
  /// With errands nothing below waits for that: back() does not take the lock, clear() takes it in
  /// another thread. Without errands (tests) renew() takes it in place.
  void use(Errands& errands) noexcept { errands_ = &errands; }
  /// Backs `bytes` from `offset` on with memory; costs nothing when repeated with the same offset.
  /// Errors: os_failure.
  [[nodiscard]] Result<void> back(ClientIndex client, std::uint64_t offset, std::uint64_t bytes);
  /// Backs what a subscription with this extent has for publishers of its topic. Costs and errors
  /// as back(), for each link block.
  [[nodiscard]] Result<void> back_links(ClientIndex client, std::uint64_t extent,
                                        const LinkBlocks& slots);
  /// The part of a region that one endpoint has.
  struct Extent {
    std::uint64_t offset = 0, bytes = 0;
    friend bool operator==(const Extent&, const Extent&) = default;
  };
  struct OfUser {
    std::uint32_t uid;
    std::uint64_t given_bytes_max;  // limit for the regions of all its processes, each from its
                                    // beginning to the end of its farthest extent
  };
  /// Makes an extent all zero, as if never used, in an errand of this user; then calls `then`.
  /// Errors: limit_reached, quota_exceeded. Throws std::bad_alloc when there is no thread for it.
  [[nodiscard]] Result<void> clear(ClientIndex client, const OfUser& user, const Extent& extent,
                                   std::function<void()> then);
  /// Returns whether the extent's last change was a clear() that has ended.
  bool is_clear(ClientIndex client, const Extent& extent) const noexcept;
  /// Makes an extent as if never used, and backs its first backed_bytes. Errors: os_failure.
  [[nodiscard]] Result<void> renew(ClientIndex client, const Extent& extent,
                                   std::uint64_t backed_bytes);

  /// Makes a heap window for the addresses at `base`, stores it and keeps a descriptor for
  /// readers. Returns the writable one, for its owner alone. Errors: os_failure.
  [[nodiscard]] Result<SharedFd> open_window(ClientIndex client, std::uint64_t base, uid_t owner);
  /// Checks that an agnocastd of this user made `window` as the window at `base` for a process of
  /// `owner`: sealed memory of that name, no longer than `bytes`, which no other user can make;
  /// open for writing, as only its owner got it. Errors: permission_denied.
  [[nodiscard]] static Result<void> check_window(int window, std::uint64_t base,
                                                 std::uint64_t bytes, uid_t owner);
  /// Puts a checked window that its owner has brought into the store. Errors: os_failure.
  [[nodiscard]] Result<void> bring_window(ClientIndex client, const UniqueFd& window);
  /// Returns the writable descriptor once more, for an owner that did not get the answer. It is
  /// the same as long as an answer with it is on its way: endless requests cost one descriptor.
  /// Errors: os_failure.
  [[nodiscard]] Result<SharedFd> window_writer(ClientIndex client, std::uint64_t window);
  const std::vector<SharedFd>& window_readers(ClientIndex client) const noexcept {
    return of(client).window_readers;
  }

  /// The process is dead and recovered: unmaps its region and closes writable descriptors.
  /// Descriptors for readers stay while its place is taken: a process that was without a
  /// connection at the death still gets the last messages, and observers look at the region.
  void unmap_client(ClientIndex client) noexcept;
  /// The process is over, or never began: closes everything. Its memory is freed a little later.
  void close_client(ClientIndex client) noexcept;

  /// Returns how many processes can have a region mapped here if the kernel allows
  /// `map_count_max`.
  static std::uint64_t regions_max(std::uint64_t map_count_max) noexcept;

 private:
  struct Cleared {
    Extent extent;
    Result<void> result;
  };
  struct ClientMemory {
    SharedFd region_writer;
    SharedFd region_reader;
    std::shared_ptr<Mapping> region;  // an errand may still store into it
    FileId file;
    std::vector<SharedFd> window_readers;
    std::map<std::uint64_t, std::weak_ptr<SharedFd::element_type>> window_writers;  // in answers
    std::optional<Cleared> cleared;
    std::uint64_t last_clear = 0;  // numbered; of several waiting ones the last counts
    std::map<std::uint64_t, std::uint64_t> backed_bytes;  // by the offset where they begin
    std::uint32_t uid = 0;
    std::uint64_t given_bytes = 0;  // to the end of the farthest cleared extent
  };

  // Each process of a user has one; those of ended processes are skipped. More than a user's quota
  // of processes, and a bound on what the daemon remembers for a user that is stuck.
  static constexpr std::size_t clearing_waiting_max = 4096;

  explicit Regions(DescriptorStore& store) : store_(&store) {}
  [[nodiscard]] static Result<Regions> map(DescriptorStore& store, UniqueFd board,
                                           UniqueFd journal);
  [[nodiscard]] Result<void> map_region(ClientMemory& memory, UniqueFd writer) const;
  void free_elsewhere(ClientMemory memory) noexcept;
  [[nodiscard]] Result<void> count_growth(ClientIndex client, const OfUser& user,
                                          const Extent& extent);
  const ClientMemory& of(ClientIndex client) const noexcept { return clients_[client]; }

  DescriptorStore* store_;
  std::unique_ptr<Closer> closer_ = std::make_unique<Closer>();
  Errands* errands_ = nullptr;
  std::shared_ptr<char> here_ = std::make_shared<char>();  // expires before errands that end later
  UniqueFd board_fd_, journal_fd_;
  SharedFd board_reader_;
  Mapping board_, journal_;
  PerClient<ClientMemory> clients_;
  std::unordered_map<std::uint32_t, std::uint64_t> given_bytes_;  // by uid
  std::uint64_t map_count_max_ = 0;                               // vm.max_map_count
};

}  // namespace agnocast::daemon
