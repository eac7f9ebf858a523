// SPDX-License-Identifier: Apache-2.0

#include <client/endpoint/subscription_endpoint.hpp>
#include <client/process/forked_child.hpp>
#include <client/process/steps.hpp>
#include <dataplane/board_look.hpp>

#include <algorithm>
#include <new>
#include <utility>

namespace agnocast {

namespace {

// If the depth counts per publisher: unread messages of gone publishers beyond it, enough for the
// last messages of all that end together.
constexpr std::uint64_t gone_unread_max = 64;

}  // namespace

Link::~Link() {
  for (detail::Block* chain : {kept_.load(std::memory_order_acquire), spares_}) {
    while (chain != nullptr) delete static_cast<ReceivedBlock*>(std::exchange(chain, chain->next));
  }
}

SubscriptionEndpoint::SubscriptionEndpoint(const Identity& identity,
                                           std::shared_ptr<WaitSet> wait_set)
    : self_(identity),
      wait_set_(std::move(wait_set)),
      events_(identity.events != nullptr ? identity.events : std::make_shared<EndpointEvents>()) {
  if (identity.events == nullptr) events_->begin_deadline(identity.qos.deadline_ns);
  // Stored before any link: a publisher that sees a link sees the id.
  region::SubscriptionWords<SharedMemory>{self_.region, self_.extent}.persistent_id().store(
      self_.persistent_id, std::memory_order_relaxed);
}

bool SubscriptionEndpoint::add_publisher(const Publisher& publisher, std::shared_ptr<Peer> peer) {
  if (publisher.index >= abi::publisher_count_max) return false;
  const std::lock_guard lock(mutex_);
  if (publisher.index >= announcements_.size()) announcements_.resize(publisher.index + 1);
  Announcement& last = announcements_[publisher.index];
  const Announcement::Action action = last.on_announce(publisher.generation);
  if (action == Announcement::Action::nothing) {
    wait_set_->wake();  // a message may have waited for a window that came with the announcement
    return true;
  }
  // Another link uses this line; rule RU excludes that.
  if (action == Announcement::Action::say_unlinked || last.current() != 0 || closed_) return false;
  const Link::Core::Identity identity{self_.topic,
                                      {peer->region(), publisher.extent},
                                      {self_.region, self_.extent, publisher.index},
                                      publisher.index,
                                      publisher.generation,
                                      publisher.first_sequence,
                                      publisher.qos,
                                      self_.qos,
                                      self_.message_bytes,
                                      self_.message_alignment,
                                      self_.index};
  auto link = std::make_shared<Link>(identity, std::move(peer), wait_set_,
                                     std::min(self_.quota, publisher.quota), self_.wake_control);
  links_.reserve(links_.size() + 1);
  AGNOCAST_CRASH_POINT(C_link);
  if (!link->core_.link(publisher.from_start)) return false;
  AGNOCAST_CRASH_POINT(C_linked);
  links_.push_back(std::move(link));
  last.linked(publisher.generation);
  events_->look_at_leases_by(links_.back()->lease_.next_ns());
  events_->gained();
  may_expire_ = may_expire_ || publisher.qos.lifespan_ns != 0;
  wait_set_->wake();  // messages committed before the link existed could not ring for it
  return true;
}

void SubscriptionEndpoint::orphan(std::uint64_t publisher, std::uint64_t generation,
                                  bool give_up) noexcept {
  const std::lock_guard lock(mutex_);
  for (const auto& link : links_) {
    if (link->publisher() != publisher || link->generation() != generation) continue;
    AGNOCAST_CRASH_POINT(C_orphaned);
    link->core_.observe_publisher();
    link->is_orphaned_ = true;
    cease(*link);
    if (!give_up) continue;
    while (link->core_.unread() > 0) link->core_.skip();
    note_losses(*link);
  }
  // Gone publishers must not pile up behind a subscription that takes nothing: it owes them nothing
  // beyond its depth.
  drop_beyond_depth();
  wait_set_->wake();
}

/// Returns false if it had ceased before.
bool SubscriptionEndpoint::cease(Link& link) noexcept {
  if (std::exchange(link.ceased_, true)) return false;
  events_->ceased(link.lease_.is_alive());
  return true;
}

void SubscriptionEndpoint::revoke() noexcept {
  const std::lock_guard lock(mutex_);
  for (const auto& link : links_) cease(*link);
}

void SubscriptionEndpoint::close() noexcept {
  const std::lock_guard lock(mutex_);
  closed_ = true;
  for (const auto& link : links_) {
    link->closing_.store(true, std::memory_order_release);
    if (is_alone_) link->core_.stand_aside();
  }
  for (const auto& successor : successors_) successor->close();
}

std::vector<std::shared_ptr<Link>> SubscriptionEndpoint::collect_unlinked() {
  const std::lock_guard lock(mutex_);
  std::vector<std::shared_ptr<Link>> over;
  for (const auto& link : links_) {
    // Publishers know less about an unlinked line than about one that stands still: they would keep
    // its messages until the daemon reports that the subscription has left.
    if (!departure_.is_known() && !link->core_.drained()) continue;
    link->closing_.store(true, std::memory_order_release);
    if (link->held_count() == 0) over.push_back(link);
  }
  for (const auto& link : over) {
    AGNOCAST_CRASH_POINT(C_unlink);
    newest_before_ns_ =
        std::max(newest_before_ns_, std::min(link->core_.newest_stamp(), monotonic_ns()));
    link->core_.unlink();
    announcements_[link->publisher()].unlinked(link->generation());
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

const std::shared_ptr<Link>* SubscriptionEndpoint::oldest() const noexcept {
  const std::shared_ptr<Link>* best = nullptr;
  std::uint64_t best_stamp = 0;
  for (const auto& link : links_) {
    const auto stamp = link->next_stamp_;
    if (!stamp || (best != nullptr && *stamp >= best_stamp)) continue;
    best = &link;
    best_stamp = *stamp;
  }
  return best;
}

// keep-last counts over all publishers, like the history of a DDS reader. If it counts per
// publisher, each queue is its own bound, and there is one bound for all gone publishers.
void SubscriptionEndpoint::drop_beyond_depth() noexcept {
  if (links_.size() < 2 || self_.qos.keep_all) return;
  const bool of_gone = self_.depth_per_publisher;
  const std::uint64_t bound = of_gone ? self_.qos.depth + gone_unread_max : self_.qos.depth;
  std::uint64_t unread = 0;
  for (const auto& link : links_) {
    if (!of_gone || link->ceased_) unread += link->core_.unread();
  }
  for (; unread > bound; --unread) {
    Link* oldest_link = nullptr;
    std::uint64_t oldest_stamp = 0;
    for (const auto& link : links_) {
      if (of_gone && !link->ceased_) continue;
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

// Counts the losses in the client region, where agnocast-ctl reads them.
void SubscriptionEndpoint::note_losses(Link& link) noexcept {
  const std::uint64_t lost = link.core_.lost() - std::exchange(link.lost_noted_, link.core_.lost());
  if (lost == 0) return;  // malformed and unreachable messages are lost as well
  const std::uint64_t malformed =
      link.core_.malformed() - std::exchange(link.malformed_noted_, link.core_.malformed());
  const region::SubscriptionWords<SharedMemory> words{self_.region, self_.extent};
  using Counters = abi::SubscriptionCounters;
  words.counter(offsetof(Counters, lost)).fetch_add(lost, std::memory_order_relaxed);
  words.counter(offsetof(Counters, malformed)).fetch_add(malformed, std::memory_order_relaxed);
  const std::uint64_t unreachable =
      link.core_.unreachable() - std::exchange(link.unreachable_noted_, link.core_.unreachable());
  words.counter(offsetof(Counters, unreachable)).fetch_add(unreachable, std::memory_order_relaxed);
}

// A process that was stopped while it was revoked may come here before its control thread has read
// the packet; publishers keep nothing for it any more.
inline bool SubscriptionEndpoint::takes_part() const noexcept {
  return self_.topic.subscription(self_.index, offsetof(abi::SubscriptionEntry, word))
             .load(std::memory_order_acquire) ==
         abi::pack_board_word(self_.generation, abi::BoardState::active);
}

bool SubscriptionEndpoint::take(Receiver& receiver) noexcept {
  if (!is_served()) return false;
  const std::lock_guard lock(mutex_);
  if (!successors_.empty()) [[unlikely]]
    return take_in_order(receiver);
  return take_here(receiver);
}

inline bool SubscriptionEndpoint::may_take() const noexcept {
  return !closed_ && !has_finished_ && takes_part();
}

/// For a link with news. False at the quota, or while a window is missing: a retry would only spin.
bool SubscriptionEndpoint::can_take(Link& link) const noexcept {
  const bool is_full = link.held_count() >= link.quota();
  if (!is_full && (!link.core_.is_awaiting_window() || link.is_orphaned_ || is_alone_ ||
                   link.peer().heap().window_count() != link.windows_seen_)) [[likely]]
    return true;
  link.is_refused_ = true;
  if (is_full && !link.is_quota_reported_.exchange(true, std::memory_order_relaxed))
    events_->quota_reached();
  return false;
}

void SubscriptionEndpoint::look_at(Link& link) const noexcept {
  link.head_ = link.core_.look();
  see_next(link);
}
void SubscriptionEndpoint::see_next(Link& link) const noexcept {
  link.next_stamp_ = link.core_.next_stamp(link.head_);
  if (link.next_stamp_ && !can_take(link)) link.next_stamp_.reset();
}

// With one publisher nothing has to be compared; most takes that find nothing end here.
inline bool SubscriptionEndpoint::take_here(Receiver& receiver) noexcept {
  if (!may_take()) return false;
  if (links_.size() != 1) return take_oldest(receiver);
  const std::shared_ptr<Link>& link = links_.front();
  if (may_expire_) [[unlikely]]
    pass_over_expired();
  if (!link->core_.has_news() || !can_take(*link)) return false;
  link->head_ = link->core_.look();
  return take_from<false>(link, receiver, receiver.wanted()) == Attempt::taken;
}

/// Looks again at the links that had nothing to take.
void SubscriptionEndpoint::look_at_empty() const noexcept {
  for (const auto& link : links_) {
    if (!link->next_stamp_) look_at(*link);
  }
}

// One look at link after link may see a thread's last message and miss one that it published before
// with another publisher. So a message is taken only after a second look at every link that
// had none: all that was published before that message had been committed by then, and is seen. A
// message that the second look finds itself may be older than all others, and is taken: what its
// thread published before is older still, and was committed before the look began.
bool SubscriptionEndpoint::take_oldest(Receiver& receiver) noexcept {
  if (may_expire_) [[unlikely]]
    pass_over_expired();
  drop_beyond_depth();
  for (const auto& link : links_) look_at(*link);
  bool has_taken = false;
  // If a link's candidate is gone at the closer look, the link is asked again. If its publisher is
  // faster than that, the next call goes on.
  for (std::uint64_t lost = 0; lost < 2 * abi::ring_count;) {
    if (oldest() == nullptr) break;
    look_at_empty();
    const std::shared_ptr<Link>* const link = oldest();
    const Attempt attempt = take_from<true>(*link, receiver, 1);
    if (attempt == Attempt::no_room) break;
    if (attempt == Attempt::lost) {
      ++lost;
      look_at(**link);
      continue;
    }
    has_taken = true;
    if (receiver.wanted() == 0) break;
    see_next(**link);
  }
  return has_taken;
}

/// Takes from a link that was looked at. `taken`: at least one, at most `most`.
template <bool only_next>
SubscriptionEndpoint::Attempt SubscriptionEndpoint::take_from(const std::shared_ptr<Link>& link,
                                                              Receiver& receiver,
                                                              std::size_t most) noexcept {
  Attempt attempt = Attempt::lost;
  do {
    Received* const place = receiver.place(*link);
    if (place == nullptr) {
      link->is_refused_ = true;
      return attempt == Attempt::taken ? attempt : Attempt::no_room;
    }
    link->windows_seen_ = link->peer().heap().window_count();
    link->windows_.expect(link->is_orphaned_ ? Unannounced::ignored
                          : is_alone_        ? Unannounced::lost
                                             : Unannounced::awaited);
    const auto taken = link->core_.take<only_next>(link->windows_, link->head_);
    note_losses(*link);
    if (!taken) {
      link->is_refused_ |= link->core_.was_refused();
      if (link->ceased_ && !link->core_.has_news()) events_->publisher_exhausted();
      return attempt;
    }
    link->held_.fetch_add(1, std::memory_order_relaxed);
    // The last message of a gone publisher: the control thread waits for its release.
    if (link->core_.drained()) link->closing_.store(true, std::memory_order_release);
    if (counts_) arrived_ += link->count_taken(taken->sequence);
    place->taken = *taken;
    place->link = link;
    receiver.took();
    attempt = Attempt::taken;
  } while (--most != 0 && link->core_.has_news(link->head_) && can_take(*link));
  return attempt;
}

/// Skips the messages that are older than their publisher's lifespan: all that come after the first
/// younger one are younger still. Before every take, so that they displace nothing.
void SubscriptionEndpoint::pass_over_expired() noexcept {
  const std::uint64_t now = monotonic_ns();
  const region::SubscriptionWords<SharedMemory> words{self_.region, self_.extent};
  for (const auto& link : links_) {
    const std::uint64_t lifespan = link->lifespan_ns();
    if (lifespan == 0 || lifespan >= now) continue;
    const std::uint64_t head = link->core_.look();
    std::uint64_t passed = 0;
    while (passed < abi::ring_count && link->core_.pass_over_older(head, now - lifespan)) ++passed;
    if (passed == 0) continue;
    note_losses(*link);
    words.counter(offsetof(abi::SubscriptionCounters, expired))
        .fetch_add(passed, std::memory_order_relaxed);
    if (link->ceased_ && !link->core_.has_news()) events_->publisher_exhausted();
  }
}

bool SubscriptionEndpoint::has_news() const noexcept {
  if (!is_served()) return false;
  const std::lock_guard lock(mutex_);
  return successors_.empty() ? has_news_here() : has_news_in_order();
}

bool SubscriptionEndpoint::has_news_here() const noexcept {
  return may_take() && std::any_of(links_.begin(), links_.end(), [this](const auto& link) {
           return link->core_.has_news() && can_take(*link);
         });
}

/// Returns the stamp of the newest message that any publisher has committed; 0 if none is known.
std::uint64_t SubscriptionEndpoint::newest_stamp() const noexcept {
  if (!is_served()) return 0;
  const std::lock_guard lock(mutex_);
  std::uint64_t newest_ns = newest_before_ns_;
  for (const auto& link : links_) newest_ns = std::max(newest_ns, link->core_.newest_stamp());
  for (const auto& successor : successors_)
    newest_ns = std::max(newest_ns, successor->newest_stamp());
  return newest_ns;
}

/// Returns when to look again.
std::uint64_t SubscriptionEndpoint::look_at_leases() noexcept {
  if (!is_served()) return never_ns;
  const std::lock_guard lock(mutex_);
  std::uint64_t next_ns = never_ns;
  for (const auto& link : links_) {
    if (link->ceased_) continue;
    if (link->lease_.look(monotonic_ns(), link->shown_alive_ns()))
      events_->liveliness_changed(link->lease_.is_alive());
    next_ns = std::min(next_ns, link->lease_.next_ns());
  }
  for (const auto& successor : successors_)
    next_ns = std::min(next_ns, successor->look_at_leases());
  return next_ns;
}

std::uint64_t SubscriptionEndpoint::lost() const noexcept {
  if (is_forked_child()) return 0;
  const std::lock_guard lock(mutex_);
  std::uint64_t sum = lost_before_;
  for (const auto& link : links_) sum += link->core_.lost();
  for (const auto& successor : successors_) sum += successor->lost();
  return sum;
}

std::uint64_t SubscriptionEndpoint::malformed() const noexcept {
  if (is_forked_child()) return 0;
  const std::lock_guard lock(mutex_);
  std::uint64_t sum = malformed_before_;
  for (const auto& link : links_) sum += link->core_.malformed();
  for (const auto& successor : successors_) sum += successor->malformed();
  return sum;
}

std::uint64_t SubscriptionEndpoint::unreachable() const noexcept {
  if (is_forked_child()) return 0;
  const std::lock_guard lock(mutex_);
  std::uint64_t sum = unreachable_before_;
  for (const auto& link : links_) sum += link->core_.unreachable();
  for (const auto& successor : successors_) sum += successor->unreachable();
  return sum;
}

std::size_t SubscriptionEndpoint::publisher_count(bool linked) const noexcept {
  if (!is_served()) return 0;
  const std::lock_guard lock(mutex_);
  return with_successors_locked([&] {
    std::size_t count = 0, links = 0;
    for (std::size_t age = 0; age < successors_.size(); ++age) links += in_age(age).links_.size();
    const SubscriptionEndpoint& newest = in_age(successors_.size());
    // Nobody writes the board of a session whose daemon's store is lost, and while publishers move
    // to the next daemon, one may be on both boards.
    if (!linked && links == 0 && !newest.is_alone_ && !newest.has_finished_)
      return newest.matched_count();
    for (std::size_t age = 0; age <= successors_.size(); ++age) {
      for (const auto& link : in_age(age).links_) count += !link->ceased_ && !has_next(*link, age);
    }
    return count;
  });
}

std::size_t SubscriptionEndpoint::matched_count() const noexcept {
  const auto own = dataplane::active_subscription(self_.topic, self_.index);
  return own && own->generation == self_.generation
             ? dataplane::matching_publishers(self_.topic, own->of)
             : 0;
}

/// Returns whether a newer session has a queue of the same publisher: while publishers move, one
/// may be in two sessions.
bool SubscriptionEndpoint::has_next(const Link& link, std::size_t age) const noexcept {
  for (std::size_t i = age + 1; i <= successors_.size(); ++i) {
    const auto& links = in_age(i).links_;
    if (std::any_of(links.begin(), links.end(), [&](const auto& other) {
          return !other->ceased_ && other->origin() == link.origin();
        }))
      return true;
  }
  return false;
}

std::size_t SubscriptionEndpoint::link_count() const noexcept {
  if (is_forked_child()) return 0;
  const std::lock_guard lock(mutex_);
  std::size_t sum = links_.size();
  for (const auto& successor : successors_) sum += successor->link_count();
  return sum;
}

void SubscriptionEndpoint::for_each_writer(
    const std::function<void(std::uint64_t, bool)>& see) const {
  if (!is_served()) return;
  const std::lock_guard lock(mutex_);
  with_successors_locked([&] {
    for (std::size_t age = 0; age <= successors_.size(); ++age) {
      for (const auto& link : in_age(age).links_) {
        if (!link->ceased_ || link->core_.has_news()) see(link->persistent_id(), link->ceased_);
      }
    }
  });
}

// --- after the daemon's store was lost

template <class Do>
auto SubscriptionEndpoint::with_successors_locked(Do work, std::size_t locked) const
    -> decltype(work()) {
  if (locked == successors_.size()) return work();
  const std::lock_guard lock(successors_[locked]->mutex_);
  return with_successors_locked(work, locked + 1);
}

/// Returns whether an older session had a queue of the same publisher that was not empty: the
/// history that the publisher takes along is, or was, read to its end there.
bool SubscriptionEndpoint::has_former(const Link& link, std::size_t age) const noexcept {
  const Link::Origin origin = link.origin();
  for (std::size_t i = 0; i < age; ++i) {
    const SubscriptionEndpoint& former = in_age(i);
    if (std::find(former.followed_.begin(), former.followed_.end(), origin) !=
            former.followed_.end() ||
        std::any_of(former.links_.begin(), former.links_.end(), [&](const auto& other) {
          return other->origin() == origin && other->core_.has_begun();
        }))
      return true;
  }
  return false;
}

// A publisher commits to its previous queue, marks it, and then commits to the next one. So a
// reader that sees a message in the next queue, and looks at the previous one afterwards, sees the
// mark and all messages there. Queues of other publishers hold nothing back.
bool SubscriptionEndpoint::is_held_back(Link& link, std::size_t age) const noexcept {
  for (std::size_t i = 0; i < age; ++i) {
    const SubscriptionEndpoint& former = in_age(i);
    if (former.may_take() &&
        std::any_of(former.links_.begin(), former.links_.end(), [&](const auto& other) {
          return other->origin() == link.origin() && other->has_moved() && other->core_.has_news();
        }))
      return link.is_refused_ = true;
  }
  return false;
}

SubscriptionEndpoint::Candidate SubscriptionEndpoint::oldest_in_order() noexcept {
  Candidate best;
  for (std::size_t age = successors_.size() + 1; age-- > 0;) {
    SubscriptionEndpoint& of = in_age(age);
    if (!of.may_take()) continue;
    for (const auto& link : of.links_) {
      if (link->continues_ || !link->keeps_history() || !has_former(*link, age)) continue;
      link->continues_ = true;
      link->core_.want_history(0);
    }
    if (of.may_expire_) of.pass_over_expired();
    of.drop_beyond_depth();
    for (const auto& link : of.links_) {
      of.look_at(*link);
      const auto stamp = link->next_stamp_;
      if (!stamp || (best.link != nullptr && *stamp > best.stamp) || is_held_back(*link, age))
        continue;
      best = {&of, &link, *stamp};
    }
  }
  return best;
}

bool SubscriptionEndpoint::take_in_order(Receiver& receiver) noexcept {
  return with_successors_locked([&] {
    bool has_taken = false;
    // Each round takes, loses or passes over a message. If a publisher is faster than that, or more
    // is wanted, the next call goes on.
    for (std::uint64_t round = 0; round < 2 * abi::ring_count; ++round) {
      if (oldest_in_order().link == nullptr) break;
      Candidate next = oldest_in_order();  // a second look: see take_oldest
      if (next.link == nullptr) break;
      const Attempt attempt = next.of->take_from<true>(*next.link, receiver, 1);
      has_taken |= attempt == Attempt::taken;
      if (attempt == Attempt::no_room || receiver.wanted() == 0) break;
    }
    return has_taken;
  });
}

// Messages that are held back are no news: the caller would spin.
bool SubscriptionEndpoint::has_news_in_order() const noexcept {
  return with_successors_locked([this] {
    for (std::size_t age = successors_.size() + 1; age-- > 0;) {
      const SubscriptionEndpoint& of = in_age(age);
      if (of.may_take() && std::any_of(of.links_.begin(), of.links_.end(), [&](const auto& link) {
            return link->core_.has_news() && !is_held_back(*link, age) && of.can_take(*link);
          }))
        return true;
    }
    return false;
  });
}

// A message that cannot be taken yet is counted as well. Somebody may have tried in vain meanwhile,
// so all of its link are counted again when they can be taken.
Arrivals SubscriptionEndpoint::arrivals() noexcept {
  if (!is_served()) return {};
  const std::lock_guard lock(mutex_);
  return with_successors_locked([this] {
    Arrivals sum;
    for (std::size_t age = 0; age <= successors_.size(); ++age) {
      SubscriptionEndpoint& of = in_age(age);
      of.counts_ = true;
      for (const auto& link : of.links_) {
        if (!of.may_take()) break;
        of.arrived_ += link->core_.count_arrivals(link->counted_);
        if (!link->core_.has_news()) continue;
        if (is_held_back(*link, age) || !of.can_take(*link)) continue;
        const std::uint64_t unread = link->core_.unread();
        if (std::exchange(link->is_refused_, false)) of.arrived_ += unread;
        sum.unread += unread;
      }
      sum.count += of.arrived_;
    }
    if (!self_.qos.keep_all && !self_.depth_per_publisher)
      sum.unread = std::min<std::uint64_t>(sum.unread, self_.qos.depth);
    return sum;
  });
}

}  // namespace agnocast
