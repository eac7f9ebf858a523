// SPDX-License-Identifier: Apache-2.0

#include <client/sparse_region.hpp>

#include <fcntl.h>
#include <sys/mman.h>
#include <unistd.h>

#include <cerrno>
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

// Nobody else locks a client region.
struct flock whole(short type) noexcept {
  struct flock lock {};
  lock.l_type = type;
  lock.l_whence = SEEK_SET;
  return lock;
}

}  // namespace

void SparseRegion::claim() const noexcept {
  struct flock lock = whole(F_WRLCK);
  ::fcntl(fd_.get(), F_OFD_SETLK, &lock);
}

bool SparseRegion::is_claimed() const noexcept {
  struct flock lock = whole(F_WRLCK);
  return ::fcntl(fd_.get(), F_OFD_GETLK, &lock) != 0 || lock.l_type != F_UNLCK;
}

Result<void> SparseRegion::open(std::uint64_t offset, std::uint64_t bytes) noexcept {
  if (offset % abi::page_bytes != 0 || bytes > reservation_.bytes() ||
      offset > reservation_.bytes() - bytes) {
    return fail(Errc::invalid_argument, "a range outside its region");
  }
  const std::uint64_t whole = (bytes + abi::page_bytes - 1) & ~(abi::page_bytes - 1);
  const int protection = access_ == Mapping::Access::read ? PROT_READ : PROT_READ | PROT_WRITE;
  std::byte* const at = reservation_.base() + offset;
  if (::mmap(at, whole, protection, MAP_SHARED | MAP_FIXED, fd_.get(),
             static_cast<off_t>(offset)) == MAP_FAILED) {
    if (errno == EAGAIN) return tl::unexpected(lock_refusal(whole));
    return fail(Errc::os_failure, "mapping a part of a region", errno);
  }
  // A child of fork must not store into the parent's region, and another process's memory has no
  // place in a core dump.
  if (access_ == Mapping::Access::read_write) ::madvise(at, whole, MADV_DONTFORK);
  if (access_ == Mapping::Access::read) ::madvise(at, whole, MADV_DONTDUMP);
  return {};
}

}  // namespace agnocast
