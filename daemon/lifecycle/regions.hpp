// SPDX-License-Identifier: Apache-2.0
//
// Regions: the memory that the daemon makes. Board and tables once, a client region and heap
// windows per process.
//
// A process gets a writable descriptor of its own region and windows; everybody else one that was
// opened for reading. The daemon keeps its own writable mapping of every client region: to prepare
// extents before they are given out, and to repair the queues of a dead process. It is one mapping
// of the kernel's, whatever lies in it: those are counted too (vm.max_map_count), and a lock of a
// part would make three of one. So nothing is locked here; who must not wait for a page that was
// swapped out locks what it maps itself (mlockall).
//
// A region is as long as what was given out of it, a window as what its owner has put to use. A
// reader has a descriptor of the whole, and touching a hole through a mapping makes a page, which
// no limit of the reader counts; beyond the end there is nothing to be touched. Neither ever gets
// shorter, and what is given out is backed by memory before anybody is told of it, so that nobody
// meets SIGBUS who reads what he was told of.
//
// A page fault waits for a hole that is being punched over its page, as long as the one who punches
// it likes. So nobody can punch holes into a region, the daemon included: an extent is cleared by
// stores, and its memory stays with its process until that ends.
//
// Every memfd is put into the descriptor store before anybody is told of it, and removed when its
// process is over; so a restarted daemon has the same memory again.
//
// Whose region it is and when it goes is the registry's business; nothing here decides.
#pragma once

#include <agnocast/result.hpp>
#include <base/memory/mapping.hpp>
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
  /// Board and tables, empty and not in the store yet: see keep(). Errors: os_failure with errno.
  [[nodiscard]] static Result<Regions> create(DescriptorStore& store);
  /// Board and journal of a previous run. Errors: layout_mismatch, store_damaged (they have
  /// the wrong sizes), os_failure.
  [[nodiscard]] static Result<Regions> adopt(DescriptorStore& store, UniqueFd board,
                                             UniqueFd journal);
  /// Puts board and journal into the store. Errors: as DescriptorStore::put.
  [[nodiscard]] Result<void> keep() const;

  Registry::Memory memory() const noexcept;
  const SharedFd& board_reader() const noexcept { return board_reader_; }

  /// A fresh region for the process in this place; what was there before is gone. Errors:
  /// limit_reached (of mappings), os_failure.
  [[nodiscard]] Result<void> open_client(ClientIndex client, std::uint64_t generation);
  /// Region and windows of a process, out of the store; of the region, `used_bytes` were given out.
  /// Errors: endpoint_gone (something of it is not there; what is there is held), os_failure.
  [[nodiscard]] Result<void> adopt_client(ClientIndex client, std::uint64_t window_count,
                                          std::uint64_t used_bytes);
  const SharedFd& region_writer(ClientIndex client) const noexcept {
    return of(client).region_writer;
  }
  const SharedFd& region_reader(ClientIndex client) const noexcept {
    return of(client).region_reader;
  }
  bool is_open(ClientIndex client) const noexcept { return static_cast<bool>(of(client).region); }
  /// The daemon's own mapping.
  std::byte* region(ClientIndex client) const noexcept { return of(client).region->base(); }
  /// Device and inode by which the region shows in /proc/PID/maps.
  struct FileId {
    std::uint64_t device = 0;
    std::uint64_t inode = 0;
    friend bool operator==(const FileId&, const FileId&) = default;
  };
  FileId region_file(ClientIndex client) const noexcept { return of(client).file; }

  /// Whether holes in regions can be forbidden here. Errors: as of forbid_holes().
  [[nodiscard]] static Result<void> can_forbid_holes();

  /// A process that may write to the file of a region may keep the kernel's lock of it for ever.
  /// With errands nothing below waits for that: back() does not take the lock, clear() takes it
  /// elsewhere. Without errands (tests) renew() takes it in place.
  void use(Errands& errands) noexcept { errands_ = &errands; }
  /// Backs the first `bytes` of the extent at `offset` with memory; free where that was done
  /// before. Errors: os_failure.
  [[nodiscard]] Result<void> back(ClientIndex client, std::uint64_t offset, std::uint64_t bytes);
  /// A part of a region that one endpoint has.
  struct Extent {
    std::uint64_t offset = 0, bytes = 0;
    friend bool operator==(const Extent&, const Extent&) = default;
  };
  struct OfUser {
    std::uint32_t uid;
    std::uint64_t given_bytes_max;  // of regions of all its processes, from their beginnings to the
                                    // ends of their farthest extents
  };
  /// Makes an extent as if never used, all zero, in an errand of this user; then calls `then`.
  /// Errors: limit_reached, quota_exceeded. Throws std::bad_alloc when there is no thread for it.
  [[nodiscard]] Result<void> clear(ClientIndex client, const OfUser& user, const Extent& extent,
                                   std::function<void()> then);
  /// Whether clear() was the last that happened to it, and has ended.
  bool is_clear(ClientIndex client, const Extent& extent) const noexcept;
  /// An extent as if never used, of which the first backed_bytes are backed. Errors: os_failure.
  [[nodiscard]] Result<void> renew(ClientIndex client, const Extent& extent,
                                   std::uint64_t backed_bytes);

  /// A heap window for the addresses at `base`, in the store; keeps what readers need. Yields the
  /// writable descriptor, which is its owner's alone. Errors: os_failure.
  [[nodiscard]] Result<SharedFd> open_window(ClientIndex client, std::uint64_t base, uid_t owner);
  /// Whether this is what an agnocastd of this user made as the window at `base` for a process of
  /// `owner`: sealed memory of that name, no longer than that, which no other user can make; open
  /// for writing, as its owner alone was given it. Errors: permission_denied.
  [[nodiscard]] static Result<void> check_window(int window, std::uint64_t base,
                                                 std::uint64_t bytes, uid_t owner);
  /// A window that its owner has brought and that was checked goes into the store. Errors:
  /// os_failure.
  [[nodiscard]] Result<void> bring_window(ClientIndex client, const UniqueFd& window);
  /// The writable descriptor once more: its owner did not get the answer. The same as long as an
  /// answer with it is on its way: who asks without end costs one descriptor. Errors: os_failure.
  [[nodiscard]] Result<SharedFd> window_writer(ClientIndex client, std::uint64_t window);
  const std::vector<SharedFd>& window_readers(ClientIndex client) const noexcept {
    return of(client).window_readers;
  }

  /// The process is dead and recovered: unmaps its region, and closes what can write. What readers
  /// need stays for as long as its place is taken: who was without a connection when it died is
  /// still to be announced its last messages, and observers look at it.
  void unmap_client(ClientIndex client) noexcept;
  /// The process is over, or never came to life: nothing is kept. Its memory is freed a little
  /// later.
  void close_client(ClientIndex client) noexcept;

  /// How many processes can have a region mapped here, when the kernel allows so many mappings.
  static std::uint64_t regions_max(std::uint64_t map_count_max) noexcept;

 private:
  struct Cleared {
    Extent extent;
    Result<void> result;
  };
  struct ClientMemory {
    SharedFd region_writer;
    SharedFd region_reader;
    std::shared_ptr<Mapping> region;  // an errand may still store there
    FileId file;
    std::vector<SharedFd> window_readers;
    std::map<std::uint64_t, std::weak_ptr<SharedFd::element_type>> window_writers;  // on their way
    std::optional<Cleared> cleared;
    std::uint64_t last_clear = 0;  // numbered; of several that wait the last one counts
    std::map<std::uint64_t, std::uint64_t> backed_bytes;  // by the offset of the extent
    std::uint32_t uid = 0;
    std::uint64_t given_bytes = 0;  // to the end of the farthest extent that was cleared
  };

  // Each process of a user has one, and those of its processes that have ended are passed over:
  // more than a user's processes (its quota), and a bound of what a user that is stuck makes the
  // daemon remember.
  static constexpr std::size_t clearing_waiting_max = 4096;

  explicit Regions(DescriptorStore& store) : store_(&store), clients_(abi::client_count_max) {}
  [[nodiscard]] static Result<Regions> map(DescriptorStore& store, UniqueFd board,
                                           UniqueFd journal);
  [[nodiscard]] Result<void> map_region(ClientMemory& memory, UniqueFd writer) const;
  void free_elsewhere(ClientMemory memory) noexcept;
  [[nodiscard]] Result<void> count_growth(ClientIndex client, const OfUser& user,
                                          const Extent& extent);
  const ClientMemory& of(ClientIndex client) const noexcept { return clients_[number(client)]; }

  DescriptorStore* store_;
  std::unique_ptr<Closer> closer_ = std::make_unique<Closer>();
  Errands* errands_ = nullptr;
  std::shared_ptr<char> here_ = std::make_shared<char>();  // for errands that end later
  UniqueFd board_fd_, journal_fd_;
  SharedFd board_reader_;
  Mapping board_, journal_;
  std::vector<ClientMemory> clients_;
  std::unordered_map<std::uint32_t, std::uint64_t> given_bytes_;  // by uid
  std::uint64_t map_count_max_ = 0;                               // vm.max_map_count
};

}  // namespace agnocast::daemon
