// SPDX-License-Identifier: Apache-2.0

#include <client/shares/descriptor_share.hpp>

#include <base/descriptors/unique_fd.hpp>
#include <base/immortal.hpp>
#include <base/memory/map_count.hpp>

#include <fcntl.h>
#include <sys/eventfd.h>
#include <sys/resource.h>

#include <algorithm>
#include <array>

namespace agnocast {

bool can_open(unsigned count) noexcept {
  std::array<UniqueFd, 2 * PeerShare::left_free> probes;
  probes[0].reset(::eventfd(0, EFD_CLOEXEC));
  for (unsigned i = 1; i < std::min<std::size_t>(count, probes.size()) && probes[i - 1]; ++i)
    probes[i].reset(::fcntl(probes[0].get(), F_DUPFD_CLOEXEC, 0));
  return static_cast<bool>(probes[std::clamp<std::size_t>(count, 1, probes.size()) - 1]);
}

DescriptorShare& DescriptorShare::instance() noexcept { return immortal<DescriptorShare>(); }

MappingShare& MappingShare::instance() noexcept { return immortal<MappingShare>(); }

std::uint64_t DescriptorShare::limit() const noexcept {
  rlimit soft{};
  return ::getrlimit(RLIMIT_NOFILE, &soft) == 0 ? soft.rlim_cur : 0;
}

bool DescriptorShare::are_free(unsigned count) const noexcept { return can_open(count); }

// Read each time: an administrator may have raised it because of this process.
std::uint64_t MappingShare::limit() const noexcept { return read_map_count_max(); }

bool PeerShare::fits(Owner owner, std::uint64_t count) const noexcept {
  if (owner.is_own) return true;
  const std::uint64_t whole = limit();
  const auto found = used_.find(owner.uid);
  const std::uint64_t used =
      found != used_.end() ? found->second.load(std::memory_order_relaxed) : 0;
  return used + count <= whole / foreign_user_divisor &&
         foreign_.load(std::memory_order_relaxed) + count <= whole / foreign_divisor;
}

PeerShare::Part PeerShare::take(Owner owner, std::uint64_t count) {
  const bool has_room = are_free(left_free);
  const std::lock_guard lock(mutex_);
  if (!has_room || !fits(owner, count)) {
    was_refused_ = true;
    refused_ = owner;
    return {};
  }
  if (owner.is_own) return {nullptr, nullptr, count};
  auto& user = used_[owner.uid];
  user.fetch_add(count, std::memory_order_relaxed);
  foreign_.fetch_add(count, std::memory_order_relaxed);
  return {&user, &foreign_, count};
}

bool PeerShare::has_more() noexcept {
  {
    const std::lock_guard lock(mutex_);
    // Requires room for several: otherwise the next one would be refused again.
    if (!was_refused_ || !fits(refused_, limit() / foreign_user_divisor / 8)) return false;
  }
  if (!are_free(2 * left_free)) return false;
  const std::lock_guard lock(mutex_);
  return std::exchange(was_refused_, false);
}

}  // namespace agnocast
