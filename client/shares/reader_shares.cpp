// SPDX-License-Identifier: Apache-2.0

#include <client/shares/reader_shares.hpp>

#include <algorithm>
#include <utility>

namespace agnocast {
namespace {

// So a publisher has half of its heap even if all foreign readers are at their limit.
constexpr std::uint64_t share_of_all(std::uint64_t heap_bytes) noexcept { return heap_bytes / 2; }
constexpr std::uint64_t share_of_one(std::uint64_t heap_bytes) noexcept { return heap_bytes / 4; }

/// Returns what each of these users may keep of a heap of this size.
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

// Ignores refusals between two checks if the first finds that the heap may grow: they may have
// happened before the next window came, or before it was refused.
bool ReaderShares::has_refused(const Room& room) noexcept {
  const bool could_grow = std::exchange(may_grow_, room.may_grow);
  const bool is_more = std::exchange(refused_, room.refused) != room.refused;
  return is_more && !could_grow && !room.may_grow;
}

std::vector<ReaderShares::Above> ReaderShares::look(Clock::time_point now, const Room& room,
                                                    std::uint64_t together,
                                                    std::span<const Held> users) {
  const bool is_refused = has_refused(room);
  if (is_refused) {
    refused_at_ = now;
  } else if (refused_at_ && now - *refused_at_ > full_for) {
    refused_at_.reset();
    above_.forget_all();
  }
  const bool is_beyond = together > share_of_all(room.may_become);
  const std::uint64_t share = share_in(std::min(room.taken, room.may_become), together, users);
  std::vector<Above> above;
  UserPatience::Uids costly;
  if (is_beyond || refused_at_) {
    for (const Held& user : users) {
      if (user.bytes <= share) continue;
      above.push_back({user.uid, share});
      costly.insert(user.uid);
    }
  }
  above_.look(now, costly);
  // A publisher may allocate rarely: without a new refusal there may be room again.
  if (!is_refused && !is_beyond) return {};
  std::erase_if(above, [&](const Above& user) { return !above_.is_over(user.uid); });
  for (const Above& user : above) {
    above_.forget(user.uid);
    bans_.add({user.uid, false}, now);
  }
  return above;
}

}  // namespace agnocast
