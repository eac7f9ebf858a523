// SPDX-License-Identifier: Apache-2.0

#include <base/step.hpp>
#include <client/forked_child.hpp>
#include <client/subscription_endpoint.hpp>

#include <algorithm>
#include <new>
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
  auto link =
      std::make_shared<Link>(identity, std::move(peer), sleeper_, self_.quota, self_.wake_control);
  links_.reserve(links_.size() + 1);
  AGNOCAST_CRASH_POINT(C_link);
  if (!link->core_.link(publisher.from_start)) return false;
  AGNOCAST_CRASH_POINT(C_linked);
  links_.push_back(std::move(link));
  book.linked(publisher.generation);
  events_->gained();
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
    if (!std::exchange(link->ceased_, true)) events_->ceased();
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
    if (!std::exchange(link->ceased_, true)) events_->ceased();
  }
}

void SubscriptionEndpoint::close() noexcept {
  const std::lock_guard lock(mutex_);
  closed_ = true;
  for (const auto& link : links_) link->closing_.store(true, std::memory_order_release);
  for (Successor& successor : successors_) {
    successor.endpoint->close();
    if (successor.waiting) let_go(*successor.waiting);
    successor.waiting.reset();
  }
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
  if (!successors_.empty()) [[unlikely]]
    return take_in_order();
  return take_here();
}

std::optional<Received> SubscriptionEndpoint::take_here() noexcept {
  if (closed_ || has_finished_ || !is_member()) return std::nullopt;
  drop_beyond_depth();
  // A link whose candidate was gone when looked at closely is asked again; each round loses or
  // takes something.
  for (std::size_t round = 0; round <= links_.size(); ++round) {
    const std::shared_ptr<Link> link = oldest();
    if (link == nullptr) return std::nullopt;
    link->windows_seen_ = link->peer().heap().window_count();
    HeapLook windows(link->peer().heap(), link->ceased_ || is_alone_);
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
  if (has_news_here()) return true;
  if (successors_.empty()) [[likely]]
    return false;
  // What take_in_order() holds back is no news: whoever asks would turn in circles.
  if (has_unread()) return false;
  for (std::size_t i = 0; i < successors_.size(); ++i) {
    const SubscriptionEndpoint& endpoint = *successors_[i].endpoint;
    if (successors_[i].waiting || endpoint.has_news()) return true;
    if (i + 1 == successors_.size()) break;
    const std::lock_guard its_lock(endpoint.mutex_);
    if (endpoint.has_unread()) return false;
  }
  return false;
}

bool SubscriptionEndpoint::has_news_here() const noexcept {
  return !closed_ && std::any_of(links_.begin(), links_.end(), [this](const auto& link) {
    return (link->is_ready() || (is_alone_ && link->held_count() < self_.quota)) &&
           link->core_.has_news();
  });
}

std::uint64_t SubscriptionEndpoint::lost() const noexcept {
  if (is_forked_child()) return 0;
  const std::lock_guard lock(mutex_);
  std::uint64_t sum = lost_before_;
  for (const auto& link : links_) sum += link->core_.lost();
  for (const Successor& successor : successors_) sum += successor.endpoint->lost();
  return sum;
}

std::uint64_t SubscriptionEndpoint::malformed() const noexcept {
  if (is_forked_child()) return 0;
  const std::lock_guard lock(mutex_);
  std::uint64_t sum = malformed_before_;
  for (const auto& link : links_) sum += link->core_.malformed();
  for (const Successor& successor : successors_) sum += successor.endpoint->malformed();
  return sum;
}

std::uint64_t SubscriptionEndpoint::unreachable() const noexcept {
  if (is_forked_child()) return 0;
  const std::lock_guard lock(mutex_);
  std::uint64_t sum = unreachable_before_;
  for (const auto& link : links_) sum += link->core_.unreachable();
  for (const Successor& successor : successors_) sum += successor.endpoint->unreachable();
  return sum;
}

std::size_t SubscriptionEndpoint::publisher_count() const noexcept {
  if (is_forked_child()) return 0;
  const std::lock_guard lock(mutex_);
  std::size_t most = static_cast<std::size_t>(
      std::count_if(links_.begin(), links_.end(), [](const auto& link) { return !link->ceased_; }));
  // While publishers move, one may be in two memberships.
  for (const Successor& successor : successors_)
    most = std::max(most, successor.endpoint->publisher_count());
  return most;
}

std::size_t SubscriptionEndpoint::link_count() const noexcept {
  if (is_forked_child()) return 0;
  const std::lock_guard lock(mutex_);
  std::size_t sum = links_.size();
  for (const Successor& successor : successors_) sum += successor.endpoint->link_count();
  return sum;
}

// --- after the daemon's store was lost

template <class Function>
void Link::for_each_handled(Function function) const {
  const std::uint64_t cursor = core_.cursor();
  const std::uint64_t begin =
      std::max(identity_.first_sequence,
               cursor - std::min<std::uint64_t>(cursor, identity_.offered.depth + 1));
  for (std::uint64_t sequence = begin + 1; sequence < cursor; ++sequence) {
    const std::uint64_t entry = identity_.publisher.order(sequence).load(std::memory_order_acquire);
    const std::uint64_t slot = abi::slot_of(entry);
    if (abi::sequence_of(entry) != sequence || slot >= abi::slot_count_max) continue;
    function(identity_.publisher.slot_address(slot).load(std::memory_order_relaxed),
             identity_.publisher.slot_stamp(slot).load(std::memory_order_relaxed));
  }
}

void SubscriptionEndpoint::let_go(const Received& received) noexcept {
  if (received.link->release(received.taken.slot)) received.link->wake_control();
}

bool SubscriptionEndpoint::has_handled(const Received& received) const noexcept {
  bool found = false;
  const auto look = [&](std::uint64_t address, std::uint64_t stamp) {
    found = found || (address == received.taken.address && stamp == received.taken.stamp_ns);
  };
  if (received.taken.stamp_ns <= newest_handled_) {
    for (const Handled& handled : handled_) look(handled.address, handled.stamp);
  }
  for (const auto& link : links_) {
    if (link->keeps_history()) link->for_each_handled(look);
  }
  return found;
}

bool SubscriptionEndpoint::was_handled(const Received& received) const noexcept {
  if (!received.link->keeps_history()) return false;
  if (has_handled(received)) return true;
  for (const Successor& successor : successors_) {
    const SubscriptionEndpoint& other = *successor.endpoint;
    const std::lock_guard lock(other.mutex_);
    if (std::find(other.links_.begin(), other.links_.end(), received.link) != other.links_.end())
      return false;  // it and those after it
    if (other.has_handled(received)) return true;
  }
  return false;
}

/// Something is there that must be taken before anything newer, whether it can be taken now or not.
bool SubscriptionEndpoint::has_unread() const noexcept {
  return !closed_ && std::any_of(links_.begin(), links_.end(),
                                 [](const auto& link) { return link->core_.has_news(); });
}

// A publisher commits to its former queue, then moves, then commits to the next. So the newest
// membership is looked at first: whatever was committed before what is found there is found by the
// looks that follow, and is delivered before it.
std::optional<Received> SubscriptionEndpoint::take_in_order() noexcept {
  for (;;) {
    for (auto successor = successors_.rbegin(); successor != successors_.rend(); ++successor) {
      if (!successor->waiting) successor->waiting = successor->endpoint->take();
    }
    if (auto taken = take_here()) return taken;
    if (has_unread()) return std::nullopt;  // until something is released
    bool again = false;
    for (std::size_t i = 0; i < successors_.size() && !again; ++i) {
      Successor& successor = successors_[i];
      if (successor.waiting) {
        const Received taken = *std::exchange(successor.waiting, std::nullopt);
        if (!was_handled(taken)) return taken;
        let_go(taken);
        again = true;
      } else if (i + 1 < successors_.size()) {
        const std::lock_guard lock(successor.endpoint->mutex_);
        if (successor.endpoint->has_unread()) return std::nullopt;
      }
    }
    if (!again) return std::nullopt;
  }
}

void SubscriptionEndpoint::remember(const Handled& handled) {
  if (handled_.size() == handled_count_max) handled_.erase(handled_.begin());
  handled_.push_back(handled);
  newest_handled_ = std::max(newest_handled_, handled.stamp);
}

void SubscriptionEndpoint::be_alone() noexcept {
  {
    const std::lock_guard lock(mutex_);
    is_alone_ = true;
  }
  sleeper_->wake();
}

bool SubscriptionEndpoint::add_successor(const std::shared_ptr<SubscriptionEndpoint>& successor) {
  {
    const std::lock_guard lock(mutex_);
    if (closed_) return false;
    if (!successors_.empty()) successors_.back().endpoint->be_succeeded();
    successors_.push_back({successor, std::nullopt});
  }
  be_succeeded();
  sleeper_->wake();  // what it got meanwhile rang for nobody who knew it
  return true;
}

std::shared_ptr<SubscriptionEndpoint> SubscriptionEndpoint::in_membership(
    const Context* context, const std::shared_ptr<SubscriptionEndpoint>& self) const {
  if (self_.context == context) return self;
  const std::lock_guard lock(mutex_);
  for (const Successor& successor : successors_) {
    if (successor.endpoint->context() == context) return successor.endpoint;
  }
  return nullptr;
}

std::vector<std::shared_ptr<SubscriptionEndpoint>> SubscriptionEndpoint::successors() const {
  const std::lock_guard lock(mutex_);
  std::vector<std::shared_ptr<SubscriptionEndpoint>> all;
  all.reserve(successors_.size());
  for (const Successor& successor : successors_) all.push_back(successor.endpoint);
  return all;
}

void SubscriptionEndpoint::collect_alone() {
  bool found = false;
  {
    const std::lock_guard lock(mutex_);
    for (auto at = links_.begin(); at != links_.end();) {
      const std::shared_ptr<Link>& link = *at;
      if (!link->ceased_ && link->has_ceased_alone()) {
        link->ceased_ = true;
        found = true;
        events_->ceased();
      }
      const bool over = closed_ || (link->ceased_ && !link->core_.has_news());
      link->closing_.store(over, std::memory_order_release);
      if (!over || link->held_count() != 0) {
        ++at;
        continue;
      }
      if (closed_) link->core_.stand_aside();
      if (link->keeps_history()) {
        link->for_each_handled([&](std::uint64_t address, std::uint64_t stamp) {
          remember({address, stamp});
        });
      }
      lost_before_ += link->core_.lost();
      malformed_before_ += link->core_.malformed();
      unreachable_before_ += link->core_.unreachable();
      at = links_.erase(at);
    }
  }
  if (found) sleeper_->wake();
}

bool SubscriptionEndpoint::is_finished() const noexcept {
  const std::lock_guard lock(mutex_);
  return (closed_ || is_succeeded_.load(std::memory_order_acquire)) && links_.empty();
}

void SubscriptionEndpoint::finish() noexcept {
  {
    const std::lock_guard lock(mutex_);
    has_finished_ = true;
  }
  if (const auto first = first_.lock()) first->absorb(*this);
}

/// A successor of this one has finished.
void SubscriptionEndpoint::absorb(SubscriptionEndpoint& successor) noexcept {
  std::shared_ptr<SubscriptionEndpoint> gone;  // after the lock
  const std::lock_guard lock(mutex_);
  const auto found =
      std::find_if(successors_.begin(), successors_.end(),
                   [&](const Successor& entry) { return entry.endpoint.get() == &successor; });
  if (found == successors_.end()) return;
  const std::lock_guard its_lock(successor.mutex_);
  lost_before_ += std::exchange(successor.lost_before_, 0);
  malformed_before_ += std::exchange(successor.malformed_before_, 0);
  unreachable_before_ += std::exchange(successor.unreachable_before_, 0);
  try {
    for (const Handled& handled : successor.handled_) remember(handled);
  } catch (const std::bad_alloc&) {
    // History may come twice.
  }
  gone = std::move(found->endpoint);
  successors_.erase(found);
}

}  // namespace agnocast
