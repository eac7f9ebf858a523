// SPDX-License-Identifier: Apache-2.0

#include <base/immortal.hpp>
#include <base/memory/mapping.hpp>
#include <client/heap/address_users.hpp>
#include <client/process/steps.hpp>

#include <sys/stat.h>

#include <algorithm>
#include <new>

namespace agnocast {

AddressUsers& AddressUsers::instance() noexcept { return immortal<AddressUsers>(); }

AddressUsers::File AddressUsers::file_of(int fd) noexcept {
  struct stat file {};
  if (::fstat(fd, &file) != 0) return {};
  return {file.st_dev, file.st_ino};
}

bool AddressUsers::enter(std::uint64_t base, std::uint64_t bytes, const File& file,
                         std::uint64_t window_set) noexcept {
  const std::lock_guard lock(mutex_);
  for (Range& range : ranges_) {
    if (range.base >= base + bytes || base >= range.base + range.bytes) continue;
    if (range.base != base || range.bytes != bytes || range.file != file) return false;
    ++range.users;
    return true;
  }
  try {
    ranges_.push_back({base, bytes, file, window_set, 1, 0});
  } catch (const std::bad_alloc&) {
    return false;
  }
  if (window_set == own) return true;
  lowest_.store(std::min(lowest_.load(std::memory_order_relaxed), base), std::memory_order_relaxed);
  highest_.store(std::max(highest_.load(std::memory_order_relaxed), base + bytes),
                 std::memory_order_relaxed);
  return true;
}

void AddressUsers::mapped(std::uint64_t base, std::uint64_t bytes) noexcept {
  const std::lock_guard lock(mutex_);
  for (Range& range : ranges_) {
    if (range.base == base) range.mapped = std::max(range.mapped, bytes);
  }
}

WindowSet AddressUsers::window_set_of_another(std::uint64_t address) noexcept {
  const std::lock_guard lock(mutex_);
  const auto found = std::find_if(ranges_.begin(), ranges_.end(), [&](const Range& range) {
    return address - range.base < range.bytes;
  });
  WindowSet all;
  if (found == ranges_.end() || found->window_set == own) return all;
  for (const Range& range : ranges_) {
    if (range.window_set == found->window_set)
      static_cast<void>(all.add(range.base, range.base + range.mapped));
  }
  return all;
}

void AddressUsers::leave(std::uint64_t base) noexcept {
  const std::lock_guard lock(mutex_);
  const auto found = std::find_if(ranges_.begin(), ranges_.end(),
                                  [&](const Range& range) { return range.base == base; });
  if (found == ranges_.end() || --found->users > 0) return;
  if (found->mapped != 0) {
    AGNOCAST_CRASH_POINT(C_peer_cover);
    Mapping::cover(reinterpret_cast<std::byte*>(base), found->mapped);
  }
  ranges_.erase(found);
}

}  // namespace agnocast
