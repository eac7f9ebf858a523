// SPDX-License-Identifier: Apache-2.0

#include <daemon/lifecycle/regions.hpp>

#include <agnocast/abi/fingerprint.hpp>
#include <base/descriptors/closing.hpp>
#include <base/memory/map_count.hpp>
#include <base/memory/memfd.hpp>
#include <base/memory/populate.hpp>
#include <daemon/state/steps.hpp>
#include <daemon/transport/request_reading.hpp>

#include <fcntl.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <memory>
#include <new>
#include <string>
#include <utility>

namespace agnocast::daemon {
namespace {

constexpr std::uint64_t journal_bytes = journal::RedoLog::bytes + tables_bytes;
static_assert(journal::RedoLog::bytes % abi::page_bytes == 0, "the tables begin with a page");

std::uint64_t bytes_of(int fd) noexcept {
  struct stat file {};
  return ::fstat(fd, &file) == 0 ? static_cast<std::uint64_t>(file.st_size) : 0;
}

// The kernel keeps the name of a memfd for ever, and every process can see it. So each window has
// its address in its name, which ties it to one place, and its owner's uid: places are given out
// again, and a process that has kept a previous window could bring it. No space: people cut lines
// of /proc/PID/maps.
std::string name_of_window(std::uint64_t base, uid_t owner) {
  return "agnocast-heap-" + hexadecimal(base) + "-" + std::to_string(owner);
}

std::string file_of(int fd) {
  char file[96];  // the longest name of ours, and a few bytes more
  const std::string entry = "/proc/self/fd/" + std::to_string(fd);
  const ssize_t bytes = ::readlink(entry.c_str(), file, sizeof file);
  return bytes < 0 ? std::string() : std::string(file, static_cast<std::size_t>(bytes));
}

// The daemon's own mappings: libraries, stacks, large blocks of malloc, board and tables. These
// are some hundred; with fewer than this left, malloc fails next.
constexpr std::uint64_t mappings_kept = 2048;

// Zeroes the extent of any kind of endpoint. Pages that were never written stay without memory.
Result<void> clear_memory(int fd, std::byte* region, const Regions::Extent& extent) noexcept {
  alignas(std::uint64_t) std::byte page[abi::page_bytes];
  static constexpr std::byte zero[abi::page_bytes] = {};
  const std::uint64_t end = extent.offset + extent.bytes;
  for (std::uint64_t at = extent.offset; at < end; at += abi::page_bytes) {
    // Most of an extent is a hole. Neither call allocates anything there.
    const off_t data = ::lseek(fd, static_cast<off_t>(at), SEEK_DATA);
    if (data < 0 && errno == ENXIO) break;  // no more of it in the file
    if (data < 0) return fail(Errc::os_failure, "clearing an extent", errno);
    at = std::max(at, static_cast<std::uint64_t>(data) / abi::page_bytes * abi::page_bytes);
    if (at >= end) break;
    const ssize_t read = ::pread(fd, page, sizeof page, static_cast<off_t>(at));
    if (read < 0) return fail(Errc::os_failure, "clearing an extent", errno);
    if (read == 0) break;  // the file ends before here
    if (std::memcmp(page, zero, static_cast<std::size_t>(read)) != 0)
      std::memset(region + at, 0, sizeof page);
  }
  // Drops the daemon's own view of the pages: it costs page tables.
  ::madvise(region + extent.offset, extent.bytes, MADV_DONTNEED);
  return {};
}
// Looking for data and lengthening wait for the lock of the file, which the process holds while it
// writes by system calls.
Result<void> clear_extent(int fd, const std::weak_ptr<Mapping>& region,
                          const Regions::Extent& extent) noexcept {
  AGNOCAST_CRASH_POINT(B_clear);
  if (const auto mapped = region.lock()) {
    if (auto cleared = clear_memory(fd, mapped->base(), extent); !cleared) return cleared;
  }
  return lengthen(fd, extent.offset + extent.bytes);
}

}  // namespace

Result<Regions> Regions::map(DescriptorStore& store, UniqueFd board, UniqueFd journal) {
  auto reader = reopen_read_only(board.get());
  if (!reader) return tl::unexpected(reader.error());
  auto board_mapping = Mapping::map(board.get(), abi::board_bytes, Mapping::Access::read_write);
  if (!board_mapping) return tl::unexpected(board_mapping.error());
  auto journal_mapping = Mapping::map(journal.get(), journal_bytes, Mapping::Access::read_write);
  if (!journal_mapping) return tl::unexpected(journal_mapping.error());
  Regions regions(store);
  regions.board_fd_ = std::move(board);
  regions.board_reader_ = share(std::move(*reader));
  regions.board_ = std::move(*board_mapping);
  regions.journal_fd_ = std::move(journal);
  regions.journal_ = std::move(*journal_mapping);
  regions.map_count_max_ = read_map_count_max();
  return regions;
}

Result<Regions> Regions::create(DescriptorStore& store) {
  auto board = make_memfd("agnocast-board", abi::board_bytes);
  if (!board) return tl::unexpected(board.error());
  auto journal = make_memfd("agnocast-journal", journal_bytes);
  if (!journal) return tl::unexpected(journal.error());
  return map(store, std::move(*board), std::move(*journal));
}

Result<Regions> Regions::adopt(DescriptorStore& store, UniqueFd board, UniqueFd journal) {
  if (bytes_of(board.get()) == abi::board_bytes && bytes_of(journal.get()) == journal_bytes)
    return map(store, std::move(board), std::move(journal));
  // Another build has other sizes. Its log begins like this build's and says which build it is.
  struct alignas(abi::page_bytes) Copy {
    std::byte bytes[journal::RedoLog::bytes];
  };
  const auto copy = std::make_unique<Copy>();
  static_cast<void>(::pread(journal.get(), copy->bytes, sizeof copy->bytes, 0));
  if (auto checked = Registry::check_log(journal::RedoLog(copy->bytes)); !checked)
    return tl::unexpected(checked.error());
  return fail_with(Errc::store_damaged, "the memory of the previous agnocastd has the wrong size");
}

Result<void> Regions::keep() const {
  if (auto kept = store_->put("board", board_fd_.get()); !kept) return kept;
  return store_->put("journal", journal_fd_.get());
}

Registry::Memory Regions::memory() const noexcept {
  return {journal_.base(), journal_.base() + journal::RedoLog::bytes, board_.base()};
}

Result<void> Regions::map_region(ClientMemory& memory, UniqueFd writer) const {
  auto reader = reopen_read_only(writer.get());
  if (!reader) return tl::unexpected(reader.error());
  auto mapping = Mapping::map(writer.get(), abi::client_region_bytes, Mapping::Access::read_write);
  if (!mapping) return tl::unexpected(mapping.error());
  // Mapping leaves writable mappings in core dumps; this one is memory of other processes.
  ::madvise(mapping->base(), mapping->bytes(), MADV_DONTDUMP);
  AGNOCAST_CRASH_POINT(B_region_made);
  struct stat file {};
  if (::fstat(writer.get(), &file) != 0) return fail(Errc::os_failure, "looking at a memfd", errno);
  memory.file = {file.st_dev, file.st_ino};
  memory.region = std::make_shared<Mapping>(std::move(*mapping));
  memory.region_writer = share(std::move(writer));
  memory.region_reader = share(std::move(*reader));
  return {};
}

Result<void> Regions::can_forbid_holes() {
  const auto file = make_memfd("agnocast-region", 0);
  if (!file) return tl::unexpected(file.error());
  return forbid_holes(file->get());
}

std::uint64_t Regions::regions_max(std::uint64_t map_count_max) noexcept {
  return map_count_max > mappings_kept ? map_count_max - mappings_kept : 0;
}
static_assert(65'530 - mappings_kept >= abi::client_count_max, "as the kernel has it by default");

Result<void> Regions::open_client(ClientIndex client, std::uint64_t generation) {
  close_client(client);
  const auto mapped = static_cast<std::uint64_t>(
      std::count_if(clients_.begin(), clients_.end(),
                    [](const ClientMemory& one) { return static_cast<bool>(one.region); }));
  if (mapped >= regions_max(map_count_max_))
    return fail_with(Errc::limit_reached, "agnocastd maps a region for each process, and has " +
                                              std::to_string(mapped) + "; vm.max_map_count is " +
                                              std::to_string(map_count_max_));
  auto writer = make_memfd("agnocast-region", abi::page_bytes, Length::may_grow);
  if (!writer) return tl::unexpected(writer.error());
  const int fd = writer->get();
  static_cast<void>(forbid_holes(fd));
  // The process that gets this open file description shows by the lock that it lives. Any process
  // that can read the region could lock it for reading and so keep the process from joining: so
  // the lock is taken before a descriptor for reading exists.
  if (auto locked = lock_for_writing(fd); !locked) return locked;
  ClientMemory& memory = clients_[client];
  auto opened = map_region(memory, std::move(*writer));
  if (opened) opened = back(client, 0, abi::page_bytes);
  if (opened) opened = store_->put(DescriptorStore::region(client), fd);
  if (!opened) {
    close_client(client);
    return opened;
  }
  auto* const header = reinterpret_cast<abi::ClientRegionHeader*>(memory.region->base());
  AGNOCAST_CRASH_POINT(B_region_sign);
  header->fingerprint.store(abi::fingerprint(), std::memory_order_relaxed);
  AGNOCAST_CRASH_POINT(B_region_sign);
  header->generation.store(generation, std::memory_order_relaxed);
  AGNOCAST_CRASH_POINT(B_region_sign);
  header->magic.store(abi::client_region_magic, std::memory_order_release);
  return {};
}

Result<void> Regions::adopt_client(ClientIndex client, std::uint64_t window_count,
                                   std::uint64_t used_bytes) {
  ClientMemory& memory = clients_[client];
  bool whole = true;
  for (std::uint64_t w = 0; w < window_count; ++w) {
    UniqueFd reader = store_->take(DescriptorStore::window(client, w));
    whole = whole && reader;
    if (whole) {
      memory.window_readers.push_back(share(std::move(reader)));
    } else if (reader) {
      store_->remove(DescriptorStore::window(client, w));  // close_client() would not
    }
  }
  UniqueFd writer = store_->take(DescriptorStore::region(client));
  if (!writer || bytes_of(writer.get()) < used_bytes)
    return fail(Errc::endpoint_gone, "the region of a process was not kept");
  if (auto mapped = map_region(memory, std::move(writer)); !mapped) return mapped;
  if (!whole) return fail(Errc::endpoint_gone, "a window of a process was not kept");
  return {};
}

Result<void> Regions::back(ClientIndex client, std::uint64_t offset, std::uint64_t bytes) {
  ClientMemory& memory = clients_[client];
  std::uint64_t& before = memory.backed_bytes[offset];
  if (before >= bytes) return {};
  std::byte* const at = memory.region->base() + offset;
  AGNOCAST_CRASH_POINT(B_back);
  if (auto backed = populate(at, bytes); !backed) return backed;
  // The pages stay allocated; the daemon's own view of them costs page tables.
  ::madvise(at, bytes, MADV_DONTNEED);
  before = bytes;
  return {};
}

Result<void> Regions::back_links(ClientIndex client, std::uint64_t extent,
                                 const LinkBlocks& slots) {
  Result<void> backed;
  for (std::size_t block = 0; block < slots.size() && backed; ++block) {
    if (slots[block] == 0) continue;
    backed = back(client, extent + abi::link_block_offset(block * abi::link_block_count),
                  abi::used_link_bytes(slots[block]));
  }
  return backed;
}

bool Regions::is_clear(ClientIndex client, const Extent& extent) const noexcept {
  const auto& cleared = of(client).cleared;
  return cleared && cleared->extent == extent;
}

// The memory of an extent stays with its process when the endpoint has ended; no quota of
// endpoints counts it.
Result<void> Regions::count_growth(ClientIndex client, const OfUser& user, const Extent& extent) {
  ClientMemory& memory = clients_[client];
  const std::uint64_t end = extent.offset + extent.bytes;
  const std::uint64_t more = end > memory.given_bytes ? end - memory.given_bytes : 0;
  std::uint64_t& all = given_bytes_[user.uid];
  if (all + more > user.given_bytes_max)
    return fail_with(Errc::quota_exceeded,
                     "the processes of this user keep " + std::to_string(all) +
                         " bytes for present and past endpoints; " +
                         std::to_string(user.given_bytes_max) + " are allowed");
  all += more;
  memory.given_bytes += more;
  memory.uid = user.uid;
  return {};
}

// A waiting errand keeps no file open: what its process has put there goes with the process.
Result<void> Regions::clear(ClientIndex client, const OfUser& user, const Extent& extent,
                            std::function<void()> then) {
  if (auto counted = count_growth(client, user, extent); !counted) return counted;
  const std::uint32_t uid = user.uid;
  if (errands_->waiting(Errands::Lane::clearing, uid) >= clearing_waiting_max)
    return fail(Errc::limit_reached, "too many processes of this user wait for memory");
  ClientMemory& memory = clients_[client];
  const auto result = std::make_shared<Result<void>>();
  const std::uint64_t clear = memory.last_clear + 1;
  const bool runs = errands_->try_run(
      Errands::Lane::clearing, uid,
      [waits = std::weak_ptr(memory.region_writer), mapped = std::weak_ptr(memory.region), extent,
       result] {
        const SharedFd file = waits.lock();
        if (!file) return;
        use_in_own_table(file->get(), [&](int fd) { *result = clear_extent(fd, mapped, extent); });
      },
      [this, here = std::weak_ptr(here_), client, region = memory.file, clear, extent, result,
       then = std::move(then)] {
        if (here.expired()) return;
        ClientMemory& now = clients_[client];
        // An older errand may still clear an extent that an endpoint has by now.
        if (now.file == region && now.last_clear == clear) now.cleared = Cleared{extent, *result};
        then();
      });
  if (!runs) throw std::bad_alloc();
  memory.last_clear = clear;
  memory.cleared.reset();
  return {};
}

Result<void> Regions::renew(ClientIndex client, const Extent& extent, std::uint64_t backed_bytes) {
  ClientMemory& memory = clients_[client];
  const bool is_clear_now = is_clear(client, extent);
  const auto cleared = std::exchange(memory.cleared, std::nullopt);
  auto result = is_clear_now ? cleared->result
                             : clear_extent(memory.region_writer->get(), memory.region, extent);
  if (!result) return result;
  memory.backed_bytes.erase(memory.backed_bytes.lower_bound(extent.offset),
                            memory.backed_bytes.lower_bound(extent.offset + extent.bytes));
  return back(client, extent.offset, backed_bytes);
}

Result<SharedFd> Regions::open_window(ClientIndex client, std::uint64_t base, uid_t owner) {
  // Its owner lengthens it as it uses more of it.
  auto writer = make_memfd(name_of_window(base, owner).c_str(), 0, Length::may_grow);
  if (!writer) return tl::unexpected(writer.error());
  auto reader = reopen_read_only(writer->get());
  if (!reader) return tl::unexpected(reader.error());
  std::vector<SharedFd>& readers = clients_[client].window_readers;
  if (auto kept = store_->put(DescriptorStore::window(client, readers.size()), reader->get());
      !kept)
    return tl::unexpected(kept.error());
  readers.push_back(share(std::move(*reader)));
  return share(std::move(*writer));
}

Result<void> Regions::check_window(int window, std::uint64_t base, std::uint64_t bytes,
                                   uid_t owner) {
  struct stat file {};
  constexpr int seals = F_SEAL_SHRINK | F_SEAL_SEAL;
  const bool is_ours = ::fcntl(window, F_GET_SEALS) >= 0 && ::fstat(window, &file) == 0 &&
                       S_ISREG(file.st_mode) && (file.st_mode & 07777) == 0600 &&
                       file.st_uid == ::geteuid() &&
                       static_cast<std::uint64_t>(file.st_size) <= bytes &&
                       (::fcntl(window, F_GET_SEALS) & seals) == seals &&
                       (::fcntl(window, F_GETFL) & (O_ACCMODE | O_PATH)) == O_RDWR &&
                       file_of(window) == "/memfd:" + name_of_window(base, owner) + " (deleted)";
  if (is_ours) return {};
  return fail_with(Errc::permission_denied,
                   "this is not a window that agnocastd made for this address and user");
}

Result<void> Regions::bring_window(ClientIndex client, const UniqueFd& window) {
  auto reader = reopen_read_only(window.get());
  if (!reader) return tl::unexpected(reader.error());
  std::vector<SharedFd>& readers = clients_[client].window_readers;
  if (auto kept = store_->put(DescriptorStore::window(client, readers.size()), reader->get());
      !kept)
    return kept;
  readers.push_back(share(std::move(*reader)));
  return {};
}

Result<SharedFd> Regions::window_writer(ClientIndex client, std::uint64_t window) {
  auto& on_its_way = clients_[client].window_writers[window];
  if (SharedFd same = on_its_way.lock()) return same;
  const std::string path =
      "/proc/self/fd/" + std::to_string(of(client).window_readers[window]->get());
  UniqueFd writer(::open(path.c_str(), O_RDWR | O_CLOEXEC));
  if (!writer) return fail(Errc::os_failure, "re-opening a window", errno);
  SharedFd shared = share(std::move(writer));
  on_its_way = shared;
  return shared;
}

// Unmapping and the last close wait for locks that readers of the file can hold as well.
void Regions::free_elsewhere(ClientMemory memory) noexcept {
  try {
    std::vector<SharedFd> fds = std::move(memory.window_readers);
    fds.push_back(std::move(memory.region_reader));
    fds.push_back(std::move(memory.region_writer));
    closer_->close(std::move(fds), std::move(memory.region));
  } catch (const std::bad_alloc&) {
    // Then it is freed here.
  }
}

void Regions::unmap_client(ClientIndex client) noexcept {
  ClientMemory& memory = clients_[client];
  if (!memory.region) return;
  ClientMemory writable;
  writable.region_writer = std::move(memory.region_writer);
  writable.region = std::move(memory.region);
  free_elsewhere(std::move(writable));
}

void Regions::close_client(ClientIndex client) noexcept {
  ClientMemory memory = std::exchange(clients_[client], ClientMemory());
  if (memory.region_reader) store_->remove(DescriptorStore::region(client));
  for (std::size_t w = 0; w < memory.window_readers.size(); ++w)
    store_->remove(DescriptorStore::window(client, w));
  if (const auto given = given_bytes_.find(memory.uid); given != given_bytes_.end()) {
    given->second -= memory.given_bytes;
    if (given->second == 0) given_bytes_.erase(given);
  }
  if (memory.region_reader || !memory.window_readers.empty()) free_elsewhere(std::move(memory));
}

}  // namespace agnocast::daemon
