// SPDX-License-Identifier: Apache-2.0

#include <client/reader_shares.hpp>

#include <algorithm>
#include <utility>

namespace agnocast {
namespace {

// So a publisher whose readers of all other users are at their limit has half of its heap.
constexpr std::uint64_t share_of_all(std::uint64_t heap_bytes) noexcept { return heap_bytes / 2; }
constexpr std::uint64_t share_of_one(std::uint64_t heap_bytes) noexcept { return heap_bytes / 4; }

/// What each of these users may keep of so large a heap.
std::uint64_t share_in(std::uint64_t heap_bytes, std::uint64_t together,
                       std::span<const ReaderShares::Held> users) {
  const std::uint64_t most = share_of_one(heap_bytes);
  if (together <= share_of_all(heap_bytes)) return most;
  std::vector<std::uint64_t> kept;
  for (const ReaderShares::Held& user : users) kept.push_back(user.bytes);
  std::sort(kept.begin(), kept.end());
  std::uint64_t left = share_of_all(heap_bytes);
  for (std::size_t i = 0; i < kept.size(); ++i) {
    const std::uint64_t equal_part = left / (kept.size() - i);
    if (kept[i] > equal_part) return std::min(most, equal_part);
    left -= kept[i];
  }
  return most;
}

}  // namespace

std::vector<ReaderShares::Above> ReaderShares::look(Clock::time_point now, const Room& room,
                                                    std::uint64_t together,
                                                    std::span<const Held> users) {
  // A publisher may try rarely: between two refusals nothing says that there is room.
  const bool is_refused = std::exchange(refused_, room.refused) != room.refused;
  const bool is_beyond = together > share_of_all(room.may_become);
  const std::uint64_t share = share_in(std::min(room.in_use, room.may_become), together, users);
  std::vector<Above> above;
  for (const Held& user : users) {
    if (user.bytes > share) above.push_back({user.uid, share});
  }
  if (above.empty()) {
    above_since_.reset();
    return {};
  }
  if (!is_refused && !is_beyond) return {};
  if (!above_since_) above_since_ = now;
  if (now - *above_since_ < patience) return {};
  above_since_.reset();
  for (const Above& user : above) bans_.add({user.uid, false}, now);
  return above;
}

}  // namespace agnocast
