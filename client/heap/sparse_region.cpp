// SPDX-License-Identifier: Apache-2.0

#include <base/descriptors/kept_fd.hpp>
#include <base/memory/memfd.hpp>
#include <client/heap/sparse_region.hpp>
#include <client/process/forked_child.hpp>

#include <fcntl.h>
#include <sys/mman.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <iterator>
#include <new>
#include <utility>

namespace agnocast {

Result<SparseRegion> SparseRegion::make(UniqueFd fd, std::uint64_t bytes,
                                        Mapping::Access access) noexcept {
  Result<Mapping> reservation = Mapping::reserve(0, bytes);
  if (!reservation) return tl::unexpected<Failure>(reservation.error());
  SparseRegion region;
  region.fd_ = std::move(fd);
  region.reservation_ = std::move(*reservation);
  region.access_ = access;
  return region;
}

namespace {

// A lock of the open file description ("OFD"). It ends with the last descriptor and mapping of
// that description, so with the process, if no child has inherited one. Record locks belong to
// the process alone, but are lost when it closes any descriptor of the file, also the read-only
// one that it gets as a peer of its own: it would count as dead while it reads.
struct flock whole(short type) noexcept {
  struct flock lock {};
  lock.l_type = type;
  lock.l_whence = SEEK_SET;
  return lock;
}

}  // namespace

SparseRegion::~SparseRegion() {
  if (!is_ours_) return;
  struct flock lock = whole(F_UNLCK);
  if (is_intact(fd_.get())) ::fcntl(fd_.get(), F_OFD_SETLK, &lock);
  leave_to_forked_children(fd_.get());
}

void SparseRegion::swap(SparseRegion& other) noexcept {
  std::swap(fd_, other.fd_);
  std::swap(reservation_, other.reservation_);
  std::swap(access_, other.access_);
  std::swap(is_ours_, other.is_ours_);
  open_.swap(other.open_);
}

bool SparseRegion::is_open(std::uint64_t offset, std::uint64_t end) const noexcept {
  auto range = open_.upper_bound(offset);
  return range != open_.begin() && (--range)->second >= end;
}

void SparseRegion::note_open(std::uint64_t offset, std::uint64_t end) noexcept try {
  auto range = open_.upper_bound(offset);
  if (range != open_.begin() && std::prev(range)->second >= offset) {
    --range;  // it begins before, and touches
  } else {
    range = open_.emplace_hint(range, offset, end);
  }
  range->second = std::max(range->second, end);
  for (auto next = std::next(range); next != open_.end() && next->first <= range->second;) {
    range->second = std::max(range->second, next->second);
    next = open_.erase(next);
  }
} catch (const std::bad_alloc&) {  // then it is mapped again, which costs time only
}

Result<void> SparseRegion::claim() noexcept {
  if (Result<void> closed = close_in_forked_children(fd_.get()); !closed) return closed;
  is_ours_ = true;
  return lock_for_writing(fd_.get());
}

bool SparseRegion::is_claimed() const noexcept {
  // Asks whether a read lock would be refused. Readers cannot take a write lock, and so cannot
  // fake this.
  struct flock lock = whole(F_RDLCK);
  return ::fcntl(fd_.get(), F_OFD_GETLK, &lock) != 0 || lock.l_type != F_UNLCK;
}

Result<void> SparseRegion::open(std::uint64_t offset, std::uint64_t bytes, int file) noexcept {
  if (offset % abi::page_bytes != 0 || bytes > reservation_.bytes() ||
      offset > reservation_.bytes() - bytes) {
    return fail(Errc::invalid_argument, "a range outside its region");
  }
  const std::uint64_t whole = (bytes + abi::page_bytes - 1) & ~(abi::page_bytes - 1);
  if (is_open(offset, offset + whole)) return {};
  const int protection = access_ == Mapping::Access::read ? PROT_READ : PROT_READ | PROT_WRITE;
  std::byte* const at = reservation_.base() + offset;
  if (fd_) file = fd_.get();
  if (!is_intact(file)) return fail(Errc::os_failure, "mapping a part of a region", EBADF);
  if (::mmap(at, whole, protection, MAP_SHARED | MAP_FIXED, file, static_cast<off_t>(offset)) ==
      MAP_FAILED) {
    if (errno == EAGAIN) return tl::unexpected(lock_refusal(whole));
    return fail(Errc::os_failure, "mapping a part of a region", errno);
  }
  // A forked child must not store into the parent's region, and another process's memory must not
  // be in a core dump.
  if (access_ == Mapping::Access::read_write) ::madvise(at, whole, MADV_DONTFORK);
  if (access_ == Mapping::Access::read) ::madvise(at, whole, MADV_DONTDUMP);
  note_open(offset, offset + whole);
  return {};
}

}  // namespace agnocast
