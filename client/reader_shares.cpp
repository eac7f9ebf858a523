// SPDX-License-Identifier: Apache-2.0

#include <client/reader_shares.hpp>

#include <algorithm>
#include <numeric>

namespace agnocast {
namespace {

// So a publisher whose readers of all other users are at their limit has half of its heap.
constexpr std::uint64_t one_user_of(std::uint64_t heap_bytes) noexcept { return heap_bytes / 4; }
constexpr std::uint64_t all_users_of(std::uint64_t heap_bytes) noexcept { return heap_bytes / 2; }

}  // namespace

std::optional<std::uint32_t> ReaderShares::look(Clock::time_point now, std::uint64_t refused,
                                                std::uint64_t heap_bytes,
                                                std::span<const Held> users) {
  if (refused != refused_) refused_at_ = now;
  refused_ = refused;
  const bool is_full = refused_at_ && now - *refused_at_ < full_for;
  const auto most = std::max_element(users.begin(), users.end(), [](const Held& a, const Held& b) {
    return a.bytes < b.bytes;
  });
  const std::uint64_t sum =
      std::accumulate(users.begin(), users.end(), std::uint64_t{0},
                      [](std::uint64_t before, const Held& held) { return before + held.bytes; });
  if (!is_full || most == users.end() || most->bytes == 0 ||
      (most->bytes < one_user_of(heap_bytes) && sum < all_users_of(heap_bytes))) {
    over_.reset();
    return std::nullopt;
  }
  // Who has most may change from look to look; the heap stays full all the same.
  if (!over_) over_since_ = now;
  over_ = most->uid;
  if (now - over_since_ < patience) return std::nullopt;
  over_.reset();
  out_until_[most->uid] = now + out_for;
  return most->uid;
}

bool ReaderShares::is_out(std::uint32_t uid, Clock::time_point now) const {
  const auto found = out_until_.find(uid);
  return found != out_until_.end() && now < found->second;
}

}  // namespace agnocast
