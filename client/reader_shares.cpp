// SPDX-License-Identifier: Apache-2.0

#include <client/reader_shares.hpp>

#include <algorithm>
#include <numeric>
#include <utility>

namespace agnocast {
namespace {

// So a publisher whose readers of all other users are at their limit has half of its heap.
constexpr std::uint64_t all_users_of(std::uint64_t heap_bytes) noexcept { return heap_bytes / 2; }

}  // namespace

std::optional<std::uint32_t> ReaderShares::look(Clock::time_point now, std::uint64_t refused,
                                                std::uint64_t heap_bytes,
                                                std::span<const Held> users) {
  const bool is_refused = std::exchange(refused_, refused) != refused;
  const auto most = std::max_element(
      users.begin(), users.end(), [](const Held& a, const Held& b) { return a.bytes < b.bytes; });
  const std::uint64_t sum =
      std::accumulate(users.begin(), users.end(), std::uint64_t{0},
                      [](std::uint64_t before, const Held& held) { return before + held.bytes; });
  if (most == users.end() || most->bytes == 0 ||
      (most->bytes < one_user_of(heap_bytes) && sum < all_users_of(heap_bytes))) {
    over_since_.reset();
    return std::nullopt;
  }
  // A publisher may try rarely: between two refusals nothing says that there is room.
  if (!is_refused) return std::nullopt;
  if (!over_since_) over_since_ = now;
  if (now - *over_since_ < patience) return std::nullopt;
  over_since_.reset();
  out_until_[most->uid] = now + out_for;
  return most->uid;
}

bool ReaderShares::is_out(std::uint32_t uid, Clock::time_point now) const {
  const auto found = out_until_.find(uid);
  return found != out_until_.end() && now < found->second;
}

}  // namespace agnocast
