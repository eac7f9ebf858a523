// SPDX-License-Identifier: Apache-2.0

#include <base/step.hpp>
#include <client/forked_child.hpp>
#include <client/subscription_endpoint.hpp>

#include <algorithm>
#include <utility>

namespace agnocast {

bool SubscriptionEndpoint::add_publisher(const Publisher& publisher, std::shared_ptr<Peer> peer) {
  if (publisher.index >= abi::publisher_count_max) return false;
  const std::lock_guard lock(mutex_);
  if (publisher.index >= books_.size()) books_.resize(publisher.index + 1);
  Book& book = books_[publisher.index];
  const Book::Action action = book.on_announce(publisher.generation);
  if (action == Book::Action::nothing) {
    sleeper_->wake();  // a message may have waited for a window that came with the announcement
    return true;
  }
  // The line is another link's: rule RU excludes that.
  if (action == Book::Action::say_unlinked || book.current() != 0 || closed_) return false;
  const Link::Core::Identity identity{self_.topic,
                                      {peer->region(), publisher.extent},
                                      {self_.region, self_.extent, publisher.index},
                                      publisher.index,
                                      publisher.generation,
                                      publisher.first_sequence,
                                      publisher.qos,
                                      self_.qos,
                                      self_.message_bytes,
                                      self_.message_alignment};
  auto link = std::make_shared<Link>(identity, std::move(peer), sleeper_, self_.quota);
  links_.reserve(links_.size() + 1);
  AGNOCAST_CRASH_POINT(C_link);
  if (!link->core_.link(publisher.from_start)) return false;
  AGNOCAST_CRASH_POINT(C_linked);
  links_.push_back(std::move(link));
  book.linked(publisher.generation);
  events_.gained();
  sleeper_->wake();  // what was committed before the link existed could not ring for it
  return true;
}

void SubscriptionEndpoint::orphan(std::uint64_t publisher, std::uint64_t generation,
                                  bool give_up) noexcept {
  const std::lock_guard lock(mutex_);
  for (const auto& link : links_) {
    if (link->publisher() != publisher || link->generation() != generation) continue;
    AGNOCAST_CRASH_POINT(C_orphaned);
    link->core_.observe_publisher();
    if (!std::exchange(link->ceased_, true)) events_.ceased();
    if (!give_up) continue;
    while (link->core_.unread() > 0) link->core_.skip();
    note_losses(*link);
  }
  // Publishers that come and go must not pile up behind a subscription that nobody looks at: beyond
  // its depth it owes nothing to those that are gone.
  drop_beyond_depth();
  sleeper_->wake();
}

void SubscriptionEndpoint::revoke() noexcept {
  const std::lock_guard lock(mutex_);
  for (const auto& link : links_) {
    if (!std::exchange(link->ceased_, true)) events_.ceased();
  }
}

void SubscriptionEndpoint::close() noexcept {
  const std::lock_guard lock(mutex_);
  closed_ = true;
  for (const auto& link : links_) link->closing_.store(true, std::memory_order_release);
}

std::vector<std::shared_ptr<Link>> SubscriptionEndpoint::collect_unlinked() {
  const std::lock_guard lock(mutex_);
  std::vector<std::shared_ptr<Link>> over;
  for (const auto& link : links_) {
    // Of a line that is not linked publishers know less than of one that stands still: what they
    // keep for it they keep until the daemon says that the subscription has left.
    if (!departure_.is_known() && !link->core_.drained()) continue;
    link->closing_.store(true, std::memory_order_release);
    if (link->held_count() == 0) over.push_back(link);
  }
  for (const auto& link : over) {
    AGNOCAST_CRASH_POINT(C_unlink);
    link->core_.unlink();
    books_[link->publisher()].unlinked(link->generation());
    lost_before_ += link->core_.lost();
    malformed_before_ += link->core_.malformed();
    unreachable_before_ += link->core_.unreachable();
    links_.erase(std::find(links_.begin(), links_.end(), link));
  }
  return over;
}

bool SubscriptionEndpoint::is_linked_to(std::uint64_t publisher,
                                        std::uint64_t generation) const noexcept {
  const std::lock_guard lock(mutex_);
  return std::any_of(links_.begin(), links_.end(), [&](const auto& link) {
    return link->publisher() == publisher && link->generation() == generation;
  });
}

bool SubscriptionEndpoint::is_empty() const noexcept {
  const std::lock_guard lock(mutex_);
  return closed_ && departure_.is_known() && links_.empty();
}

std::shared_ptr<Link> SubscriptionEndpoint::oldest() const noexcept {
  const std::shared_ptr<Link>* best = nullptr;
  std::uint64_t best_stamp = 0;
  for (const auto& link : links_) {
    if (!link->is_ready()) continue;
    const auto stamp = link->core_.next_stamp();
    if (!stamp || (best != nullptr && *stamp >= best_stamp)) continue;
    best = &link;
    best_stamp = *stamp;
  }
  return best != nullptr ? *best : nullptr;
}

// keep-last counts over all publishers, as the history of a DDS reader does.
void SubscriptionEndpoint::drop_beyond_depth() noexcept {
  if (links_.size() < 2 || self_.qos.keep_all) return;
  std::uint64_t unread = 0;
  for (const auto& link : links_) unread += link->core_.unread();
  for (; unread > self_.qos.depth; --unread) {
    Link* oldest_link = nullptr;
    std::uint64_t oldest_stamp = 0;
    for (const auto& link : links_) {
      const auto stamp = link->core_.next_stamp();
      if (!stamp || (oldest_link != nullptr && *stamp >= oldest_stamp)) continue;
      oldest_link = link.get();
      oldest_stamp = *stamp;
    }
    if (oldest_link == nullptr) return;
    oldest_link->core_.skip();
    note_losses(*oldest_link);
  }
}

// Into the client region, where agnocast-ctl reads it.
void SubscriptionEndpoint::note_losses(Link& link) noexcept {
  const std::uint64_t lost = link.core_.lost() - std::exchange(link.lost_noted_, link.core_.lost());
  if (lost == 0) return;  // what is malformed or unreachable is lost as well
  const std::uint64_t malformed =
      link.core_.malformed() - std::exchange(link.malformed_noted_, link.core_.malformed());
  const dataplane::SubscriptionWords<SharedMemory> words{self_.region, self_.extent};
  using Counters = abi::SubscriptionCounters;
  words.counter(offsetof(Counters, lost)).fetch_add(lost, std::memory_order_relaxed);
  words.counter(offsetof(Counters, malformed)).fetch_add(malformed, std::memory_order_relaxed);
  const std::uint64_t unreachable =
      link.core_.unreachable() - std::exchange(link.unreachable_noted_, link.core_.unreachable());
  words.counter(offsetof(Counters, unreachable)).fetch_add(unreachable, std::memory_order_relaxed);
}

// A process that was stopped while it was revoked may come here before its control thread has read
// of it; publishers keep nothing for it any more.
bool SubscriptionEndpoint::is_member() const noexcept {
  return self_.topic.subscription(self_.index, offsetof(abi::SubscriptionEntry, word))
             .load(std::memory_order_acquire) ==
         abi::pack_member(self_.generation, abi::MemberState::active);
}

std::optional<Received> SubscriptionEndpoint::take() noexcept {
  if (!is_served()) return std::nullopt;
  const std::lock_guard lock(mutex_);
  if (closed_ || !is_member()) return std::nullopt;
  drop_beyond_depth();
  // A link whose candidate was gone when looked at closely is asked again; each round loses or
  // takes something.
  for (std::size_t round = 0; round <= links_.size(); ++round) {
    const std::shared_ptr<Link> link = oldest();
    if (link == nullptr) return std::nullopt;
    link->windows_seen_ = link->peer().heap().window_count();
    HeapLook windows(link->peer().heap(), link->ceased_);
    const auto taken = link->core_.take(windows);
    note_losses(*link);
    if (taken) {
      link->held_.fetch_add(1, std::memory_order_relaxed);
      // The last message of a publisher that is gone: its release is what the control thread waits
      // for.
      if (link->core_.drained()) link->closing_.store(true, std::memory_order_release);
      return Received{*taken, link};
    }
  }
  return std::nullopt;
}

bool SubscriptionEndpoint::has_news() const noexcept {
  if (!is_served()) return false;
  const std::lock_guard lock(mutex_);
  return !closed_ && std::any_of(links_.begin(), links_.end(), [](const auto& link) {
    return link->is_ready() && link->core_.has_news();
  });
}

std::uint64_t SubscriptionEndpoint::lost() const noexcept {
  if (is_forked_child()) return 0;
  const std::lock_guard lock(mutex_);
  std::uint64_t sum = lost_before_;
  for (const auto& link : links_) sum += link->core_.lost();
  return sum;
}

std::uint64_t SubscriptionEndpoint::malformed() const noexcept {
  if (is_forked_child()) return 0;
  const std::lock_guard lock(mutex_);
  std::uint64_t sum = malformed_before_;
  for (const auto& link : links_) sum += link->core_.malformed();
  return sum;
}

std::uint64_t SubscriptionEndpoint::unreachable() const noexcept {
  if (is_forked_child()) return 0;
  const std::lock_guard lock(mutex_);
  std::uint64_t sum = unreachable_before_;
  for (const auto& link : links_) sum += link->core_.unreachable();
  return sum;
}

std::size_t SubscriptionEndpoint::publisher_count() const noexcept {
  if (is_forked_child()) return 0;
  const std::lock_guard lock(mutex_);
  return static_cast<std::size_t>(
      std::count_if(links_.begin(), links_.end(), [](const auto& link) { return !link->ceased_; }));
}

std::size_t SubscriptionEndpoint::link_count() const noexcept {
  if (is_forked_child()) return 0;
  const std::lock_guard lock(mutex_);
  return links_.size();
}

}  // namespace agnocast
