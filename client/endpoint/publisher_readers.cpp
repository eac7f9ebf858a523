// SPDX-License-Identifier: Apache-2.0
//
// The control thread's look at a publisher's readers: what readers of other users keep of its
// messages, and which readers it no longer serves, or serves again. The rules, and how long a
// reader has: client/shares/reader_shares.hpp and client/shares/unmapped_users.hpp.

#include <client/endpoint/publisher_work.hpp>

#include <algorithm>
#include <array>
#include <utility>

namespace agnocast {

/// Returns how many subscriptions the topic may have had; one that comes now is seen next time.
std::size_t PublisherEndpoint::reader_count_max() const noexcept {
  const std::uint64_t high =
      identity_.core.topic.subscription_high().load(std::memory_order_acquire);
  return std::min<std::uint64_t>(high, SharedMemory::subscription_capacity);
}

void PublisherEndpoint::list_foreign_readers(std::vector<Reader>& readers) const {
  readers.clear();
  readers.reserve(reader_count_max());  // no allocation under the mutex
  const std::lock_guard lock(mutex_);
  for (const Attached& attached : attached_) {
    if (!attached.owner.is_own && readers.size() < readers.capacity())
      readers.push_back({{attached.index, attached.generation}, attached.owner.uid});
  }
}

std::uint64_t PublisherEndpoint::kept_bytes(
    std::span<const Core::EndpointId> readers) const noexcept {
  const std::lock_guard lock(mutex_);
  return core_ != nullptr ? core_->kept_bytes(readers) : 0;
}

void PublisherEndpoint::withdraw(const Core::EndpointId& reader) noexcept {
  in_control_thread([&](Work& work) {
    if (core_ == nullptr) return;
    if (core_->withdraw(reader.index, reader.generation, abi::Withdrawal::over_share))
      core_->scan(work);
  });
}

void PublisherEndpoint::note_unmapped(const EndpointId& endpoint, PeerOwner owner, bool is_out,
                                      ReaderShares::Clock::time_point now) {
  if (is_attached(endpoint.index, endpoint.generation)) return;
  Watched& watched = watched_[endpoint.index];
  if (watched.generation != endpoint.generation) watched = {endpoint.generation, now};
  watched.owner = owner;
  in_control_thread([&](Work& work) {
    if (core_ == nullptr || moved_) return;
    core_->scan(work);  // from here on the endpoint counts
    if (is_out &&
        core_->withdraw(endpoint.index, endpoint.generation, abi::Withdrawal::not_attached))
      core_->scan(work);
  });
}

/// An endpoint as seen in one look.
struct PublisherEndpoint::Seen {
  EndpointId id;
  bool is_mapped;
  std::optional<PeerOwner> owner;  // if it is mapped
};

/// The parameters of one look.
struct PublisherEndpoint::Look {
  ReaderShares::Clock::time_point now;
  const ReaderShares& shares;
  UnmappedUsers& unmapped_users;
  std::vector<Withdrawn>& news;

  bool may_be_served_again(abi::Withdrawal why, PeerOwner owner) const {
    return why == abi::Withdrawal::not_attached ||
           (why == abi::Withdrawal::over_share && !shares.is_out(owner, now));
  }
};

/// Lists the endpoints that take part and are not mapped, then the mapped ones that are withdrawn,
/// but not for good. Returns false if this publisher publishes nothing any more.
bool PublisherEndpoint::see_readers(std::vector<Seen>& seen) const {
  seen.reserve(2 * reader_count_max());  // no allocation under the mutex
  const auto see = [&](const Seen& one) {
    if (seen.size() < seen.capacity()) seen.push_back(one);
  };
  const std::lock_guard lock(mutex_);
  if (core_ == nullptr || moved_) return false;
  core_->for_each_unmapped([&](std::uint64_t index, std::uint64_t generation) {
    see({{index, generation}, false, std::nullopt});
  });
  for (const Attached& one : attached_) {
    const abi::Withdrawal why = core_->withdrawal(one.index, one.generation);
    const auto known = watched_.find(one.index);
    const bool is_notified = known != watched_.end() &&
                             known->second.generation == one.generation &&
                             known->second.why == abi::Withdrawal::over_quota;
    if (why != abi::Withdrawal::none && !is_notified)
      see({{one.index, one.generation}, true, one.owner});
  }
  return true;
}

void PublisherEndpoint::look_at_readers(ReaderShares::Clock::time_point now,
                                        const ReaderShares& shares, UnmappedUsers& unmapped_users,
                                        std::vector<Withdrawn>& news) {
  std::vector<Seen> seen;
  if (!see_readers(seen)) return;
  const Look look{now, shares, unmapped_users, news};
  std::map<std::uint64_t, Watched> watched;
  for (const Seen& reader : seen) {
    // Continue with what an earlier look has noted.
    const auto before = watched_.find(reader.id.index);
    const bool is_known =
        before != watched_.end() && before->second.generation == reader.id.generation;
    Watched& endpoint = watched
                            .emplace(reader.id.index,
                                     is_known ? before->second : Watched{reader.id.generation, now})
                            .first->second;
    if (reader.owner) endpoint.owner = reader.owner;
    look_at(reader, endpoint, look);
  }
  // Withdrawn for good: nothing is left to look at.
  for (const auto& [index, before] : watched_) {
    if (before.why == abi::Withdrawal::over_quota) watched.emplace(index, before);
  }
  watched_.swap(watched);
}

void PublisherEndpoint::look_at(const Seen& reader, Watched& endpoint, const Look& look) {
  const std::uint64_t index = reader.id.index, generation = reader.id.generation;
  const bool is_out = endpoint.owner && look.unmapped_users.is_out(*endpoint.owner, look.now);
  bool is_news = false, was_waited_for = false;
  std::uint64_t bytes = 0;
  in_control_thread([&](Work& work) {
    abi::Withdrawal why = core_->withdrawal(index, generation);
    if (why == abi::Withdrawal::none) {
      if (reader.is_mapped) return;
      if (!is_out && look.now - endpoint.since < ReaderShares::patience_to_attach) return;
      if (!core_->withdraw(index, generation, abi::Withdrawal::not_attached)) return;  // it ended
      why = abi::Withdrawal::not_attached;
      was_waited_for = !is_out;
    } else if (reader.is_mapped && look.may_be_served_again(why, *endpoint.owner) &&
               core_->serve_again(index, generation, work)) {
      why = abi::Withdrawal::none;
    } else if (!core_->is_disregarded(index) &&
               look.now - endpoint.since >= ReaderShares::patience) {
      core_->disregard(index, generation);
    }
    core_->scan(work);
    if (why == endpoint.why) return;
    is_news = true;
    bytes = core_->kept_bytes(std::array{Core::EndpointId{index, generation}});
    endpoint.why = why;
    endpoint.since = look.now;
  });
  if (was_waited_for && endpoint.owner) look.unmapped_users.ban(*endpoint.owner, look.now);
  if (!reader.is_mapped && endpoint.why == abi::Withdrawal::none && endpoint.owner)
    look.unmapped_users.note(*endpoint.owner);
  if (is_news) look.news.push_back({index, generation, endpoint.why, bytes});
}

}  // namespace agnocast
