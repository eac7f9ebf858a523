// SPDX-License-Identifier: Apache-2.0
//
// The publishing and the receiving side of the soak (soak_client.cpp): the quality of service of
// each topic, and the checks of each message at the take and at the release.
#pragma once

#include <tests/system/random.hpp>
#include <tests/system/soak_client.hpp>
#include <tests/system/soak_parcel.hpp>

#include <agnocast/abi/heaphook.h>
#include <agnocast/agnocast.hpp>

#include <sys/prctl.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <deque>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <utility>
#include <vector>

namespace agnocast::test {

// After this long an expected event no longer comes.
inline constexpr std::uint64_t patience_ns = 20 * second;
inline constexpr std::uint64_t keep_all_bound = 20;
inline constexpr std::size_t held_max = 6;

inline std::string name_of(SoakTopic topic) {
  constexpr const char* names[] = {"last",   "deep",  "history", "complete",
                                   "effort", "large", "mixed"};
  return std::string("/soak/") + names[static_cast<std::size_t>(topic)];
}
inline ParcelPlan::Size size_on(SoakTopic topic) {
  if (topic == SoakTopic::large) return ParcelPlan::Size::large;
  return topic == SoakTopic::deep || topic == SoakTopic::mixed ? ParcelPlan::Size::middle
                                                               : ParcelPlan::Size::small;
}
inline QoS random_qos(Random& random) {
  QoS qos(1 + random.below(20));
  if (random.chance(30)) qos.keep_all(qos.depth());
  if (random.chance(50)) qos.best_effort();
  if (random.chance(50)) qos.transient_local();
  return qos;
}
inline QoS publisher_qos(SoakTopic topic, Random& random) {
  switch (topic) {
    case SoakTopic::last:
      return QoS(1);
    case SoakTopic::history:
      return QoS(5).transient_local();
    case SoakTopic::complete:
      return QoS(keep_all_bound).keep_all(keep_all_bound);
    case SoakTopic::effort:
      return QoS(5).best_effort();
    case SoakTopic::large:
      return QoS(3);
    case SoakTopic::mixed:
      return random_qos(random);
    default:
      return QoS(1 + random.below(10));
  }
}
inline QoS subscription_qos(SoakTopic topic, Random& random) {
  switch (topic) {
    case SoakTopic::last:
      return QoS(1);
    case SoakTopic::history:
      return QoS(1 + random.below(8)).transient_local();
    case SoakTopic::complete:
      return QoS(keep_all_bound).keep_all(keep_all_bound);
    case SoakTopic::effort:
      return QoS(5).best_effort();
    case SoakTopic::large:
      return QoS(1 + random.below(3));
    case SoakTopic::mixed:
      return random_qos(random);
    default:
      return QoS(1 + random.below(20));
  }
}

/// Returns whether the machine may refuse with this code; every other code is a complaint.
inline bool is_expected(Errc code) {
  return code == Errc::limit_reached || code == Errc::quota_exceeded;
}

struct Here {
  SoakBoard& board;
  SoakPlace& place;
};

/// Creates an endpoint. The daemon is dead now and then, and on a busy machine the next one may
/// not answer within the library's five seconds: such a refusal is counted and the request
/// repeated. A daemon that is away for all of this time counts as hanging.
template <class Create>
auto create_patiently(Here here, Create create) -> decltype(create()) {
  constexpr std::uint64_t daemon_patience_ns = 60'000'000'000;
  const std::uint64_t end = now_ns() + daemon_patience_ns;
  for (;;) {
    auto made = create();
    if (made || made.error().code != Errc::daemon_not_running || now_ns() > end) return made;
    here.board.refuse(made.error().code);
  }
}

// --- publishing ---

class Writer {
 public:
  static std::unique_ptr<Writer> make(Here here, Node& node, SoakTopic topic, Random& random) {
    const std::uint64_t index = here.board.publisher_count.fetch_add(1);
    if (index >= SoakBoard::publisher_count_max) return nullptr;
    PublisherRecord& record = here.board.publisher[index];
    record.topic = static_cast<std::uint64_t>(topic) + 1;
    record.born_ns = now_ns();
    const QoS qos = publisher_qos(topic, random);
    auto made = create_patiently(
        here, [&] { return try_create_publisher<Parcel>(node, name_of(topic), qos); });
    if (!made) {
      here.board.refuse(made.error().code);
      if (!is_expected(made.error().code))
        here.board.complain("no publisher on %s: %s", name_of(topic).c_str(),
                            text_of(made.error()).c_str());
      return nullptr;
    }
    ++here.place.publishers;
    here.place.joined = 1;
    const std::uint64_t token =
        index << ParcelPlan::size_bits | static_cast<std::uint64_t>(size_on(topic));
    return std::unique_ptr<Writer>(new Writer(here, std::move(*made), record, token));
  }

  void publish() {
    auto loan = publisher_->borrow_loaned_message();
    ParcelPlan(token_, number_ + 1).fill(*loan);
    record_.attempted = number_ + 1;
    const PublishResult result = publisher_->publish(std::move(loan));
    here_.board.adopted += result.adopted_bytes;
    if (result) {
      record_.committed = ++number_;
      ++here_.board.published;
      return;
    }
    here_.board.refuse(result.code);
    if (result.code != Errc::would_block && result.code != Errc::no_slot &&
        result.code != Errc::heap_exhausted && result.code != Errc::window_exhausted)
      here_.board.complain("publishing: %s", sentence_of(result.code));
  }

  /// Keeps a piece of the shared heap, untouched, so that messages soon lie in the next window.
  void take_room(std::size_t bytes) {
    const auto loan = publisher_->borrow_loaned_message();
    room_.emplace_back(std::malloc(bytes), &std::free);
  }

 private:
  Writer(Here here, Publisher<Parcel>::SharedPtr publisher, PublisherRecord& record,
         std::uint64_t token)
      : here_(here), publisher_(std::move(publisher)), record_(record), token_(token) {}
  Here here_;
  Publisher<Parcel>::SharedPtr publisher_;
  PublisherRecord& record_;
  std::uint64_t token_, number_ = 0;
  std::vector<std::unique_ptr<void, void (*)(void*)>> room_;
};

// --- receiving ---

/// A message in hand: compared at the take, and again before its release.
struct Held {
  ipc_shared_ptr<const Parcel> message;
  std::uint64_t token, number, until_ns;
};

inline void verify(Here here, const Held& held, const char* when) {
  here.place.reading_token = held.token;
  here.place.reading_number = held.number;
  const ParcelPlan plan(held.token, held.number);
  const auto difference = plan.compare(*held.message);
  if (difference.member != nullptr) {
    ++here.board.wrong;
    const MessageInfo& info = held.message.info();
    const PublisherRecord& record = here.board.publisher[held.token >> ParcelPlan::size_bits];
    here.board.complain(
        "WRONG BYTE at %s: token %#llx number %llu (sequence %llu of generation %llu, topic %llu, "
        "attempted %llu, committed %llu) at %p: %s[%llu] is %#llx, must be %#llx",
        when, static_cast<unsigned long long>(held.token),
        static_cast<unsigned long long>(held.number),
        static_cast<unsigned long long>(info.sequence),
        static_cast<unsigned long long>(info.publisher),
        static_cast<unsigned long long>(record.topic.load() - 1),
        static_cast<unsigned long long>(record.attempted.load()),
        static_cast<unsigned long long>(record.committed.load()),
        static_cast<const void*>(held.message.get()), difference.member,
        static_cast<unsigned long long>(difference.position),
        static_cast<unsigned long long>(difference.found),
        static_cast<unsigned long long>(difference.expected));
  }
  here.board.verified_bytes += plan.bytes();
  here.place.reading_token = 0;
}

/// A subscription and its rules:
///   of each publisher the numbers grow, the content is whole, and a number left out was counted
///   as lost; nothing at all is left out where both sides keep all. A publisher that is younger
///   than the subscription owes it every message from its first on.
class Reader {
 public:
  enum class Kind { take, callback, newest };

  static std::unique_ptr<Reader> make(Here here, Node& node, SoakTopic topic, Kind kind,
                                      const QoS& qos, std::uint64_t seed) {
    std::unique_ptr<Reader> reader(new Reader(here, topic, kind, qos, seed));
    const SubscriptionOptions options = SubscriptionOptions().hold_quota(2 * held_max);
    if (kind == Kind::callback) {
      const auto call = [own = reader.get()](ipc_shared_ptr<const Parcel> message) {
        own->called(std::move(message));
      };
      auto made = create_patiently(here, [&] {
        return try_create_subscription<Parcel>(node, name_of(topic), qos, call, options);
      });
      if (!made) return refused(here, topic, made.error());
      const std::lock_guard lock(reader->mutex_);
      reader->subscription_ = std::move(*made);
      reader->born_ns_ = now_ns();
    } else {
      auto made = create_patiently(here, [&] {
        return try_create_subscription<Parcel>(node, name_of(topic), qos, options);
      });
      if (!made) return refused(here, topic, made.error());
      reader->polled_ = std::move(*made);
      reader->born_ns_ = now_ns();
    }
    ++here.place.subscriptions;
    here.place.joined = 1;
    return reader;
  }

  /// Takes at most `most` messages; releases those held long enough.
  void tend(std::uint64_t most) {
    if (kind_ == Kind::newest) {
      look_at_newest();
    } else if (kind_ == Kind::take) {
      for (std::uint64_t i = 0; i < most; ++i) {
        auto message = polled_->take();
        const std::lock_guard lock(mutex_);
        if (!message) {
          found_nothing();
          break;
        }
        took(std::move(message));
      }
    }
    const std::lock_guard lock(mutex_);
    release_some(now_ns(), held_max);
  }

  /// Returns the held messages.
  std::deque<Held> end() {
    Subscription<Parcel>::SharedPtr called;
    {
      const std::lock_guard lock(mutex_);
      called.swap(subscription_);
    }
    called.reset();  // its callback does not run any more
    polled_.reset();
    return std::move(held_);
  }

  SoakTopic topic() const noexcept { return topic_; }
  /// Needs the mutex, or a single thread. Names the publishers with missing messages, among those
  /// it still remembers.
  void complain_of_missing() {
    std::map<std::uint64_t, std::uint64_t> last;  // by token
    for (const auto& [generation, seen] : seen_) last[seen.token] = seen.last;
    for (std::uint64_t i = 0; i < here_.board.publisher_count; ++i) {
      const PublisherRecord& record = here_.board.publisher[i];
      if (record.topic != static_cast<std::uint64_t>(topic_) + 1) continue;
      const std::uint64_t token =
          i << ParcelPlan::size_bits | static_cast<std::uint64_t>(size_on(topic_));
      if (last[token] < record.committed)
        complain(
            i < 14 ? "committed and not delivered, by a resident" : "committed and not delivered",
            {token, last[token]}, record.committed);
    }
  }
  /// Returns taken and lost together: for a resident, all messages ever committed on this topic.
  std::uint64_t accounted() {
    const std::lock_guard lock(mutex_);
    return taken_ + lost_now();
  }

 private:
  struct Seen {
    std::uint64_t token, last;
  };
  static constexpr std::size_t seen_max = 1 << 14;

  Reader(Here here, SoakTopic topic, Kind kind, const QoS& qos, std::uint64_t seed)
      : here_(here), topic_(topic), kind_(kind), qos_(qos), random_(seed) {}
  static std::unique_ptr<Reader> refused(Here here, SoakTopic topic, const Failure& why) {
    here.board.refuse(why.code);
    if (!is_expected(why.code))
      here.board.complain("no subscription on %s: %s", name_of(topic).c_str(),
                          text_of(why).c_str());
    return nullptr;
  }

  void called(ipc_shared_ptr<const Parcel> message) {
    const std::lock_guard lock(mutex_);
    took(std::move(message));
    release_some(now_ns(), held_max);
  }
  std::uint64_t lost_now() const {
    if (subscription_ != nullptr) return subscription_->get_lost_count();
    return polled_ != nullptr ? polled_->get_lost_count() : 0;
  }
  bool is_owed_from_start(std::uint64_t token) const {
    const std::uint64_t born = here_.board.publisher[token >> ParcelPlan::size_bits].born_ns;
    return born_ns_ != 0 && born > born_ns_;
  }

  void took(ipc_shared_ptr<const Parcel> message) {
    ++taken_;
    ++here_.board.taken;
    const MessageInfo info = message.info();
    auto found = seen_.find(info.publisher);
    if (found == seen_.end()) {
      const std::uint64_t token = message->token;
      const std::uint64_t index = token >> ParcelPlan::size_bits;
      if (index >= here_.board.publisher_count ||
          here_.board.publisher[index].topic != static_cast<std::uint64_t>(topic_) + 1) {
        ++here_.board.wrong;
        here_.board.complain("WRONG BYTE: token %#llx on %s (sequence %llu of generation %llu)",
                             static_cast<unsigned long long>(token), name_of(topic_).c_str(),
                             static_cast<unsigned long long>(info.sequence),
                             static_cast<unsigned long long>(info.publisher));
        return;
      }
      forget_oldest();
      const std::uint64_t before = is_owed_from_start(token) ? 0 : info.sequence - 1;
      found = seen_.emplace(info.publisher, Seen{token, before}).first;
    }
    Seen& seen = found->second;
    if (info.sequence <= seen.last) complain("out of order, or twice", seen, info.sequence);
    gaps_ += info.sequence - seen.last - 1;
    account(seen, info.sequence);
    seen.last = info.sequence;
    const std::uint64_t held_ns = random_.below(random_.chance(20) ? 30 : 3) * millisecond;
    Held held{std::move(message), seen.token, info.sequence, now_ns() + held_ns};
    verify(here_, held, "take");
    held_.push_back(std::move(held));
  }

  // The counter is read after the take, so it includes the losses of this take.
  void account(const Seen& seen, std::uint64_t number) {
    if (subscription_ == nullptr && polled_ == nullptr) return;  // called before creation returned
    const std::uint64_t lost = lost_now();
    if (lost < lost_) complain("the lost counter went back", seen, number);
    if (lost < gaps_) complain("a gap that is not counted as lost", seen, number);
    if (topic_ == SoakTopic::complete && lost != 0)
      complain("lost, though both sides keep all", seen, number);
    here_.board.lost += lost - lost_;
    // After a loss the subscription has its whole depth of newer messages to take; this is one of
    // them.
    promised_ = lost > lost_ ? qos_.depth() - 1 : promised_ - std::min<std::uint64_t>(promised_, 1);
    lost_ = lost;
    nothing_since_ns_ = 0;
  }
  // Messages in a window that is not announced yet come later, so a promise has some time.
  void found_nothing() {
    if (promised_ == 0) return;
    const std::uint64_t now = now_ns();
    if (nothing_since_ns_ == 0) nothing_since_ns_ = now;
    if (now - nothing_since_ns_ < patience_ns) return;
    here_.board.complain("%s: lost, but %llu fewer newer messages than the depth",
                         name_of(topic_).c_str(), static_cast<unsigned long long>(promised_));
    promised_ = 0;
    complain_of_missing();
  }

  void release_some(std::uint64_t now, std::size_t most) {
    while (!held_.empty() && (held_.size() > most || held_.front().until_ns <= now)) {
      verify(here_, held_.front(), "release");
      held_.pop_front();
      ++here_.board.released;
    }
  }

  void look_at_newest() {
    const auto message = polled_->take_data();
    if (!message) return;
    const MessageInfo info = message.info();
    const std::uint64_t token = message->token;
    if (token >> ParcelPlan::size_bits >= here_.board.publisher_count) {
      ++here_.board.wrong;
      here_.board.complain("WRONG BYTE: token %#llx is nobody's",
                           static_cast<unsigned long long>(token));
      return;
    }
    ++here_.board.taken;
    verify(here_, Held{message, token, info.sequence, 0}, "look");
  }

  // For a resident: forgets publishers that died long ago. The map is sorted by age.
  void forget_oldest() {
    if (seen_.size() < seen_max) return;
    for (auto oldest = seen_.begin(); seen_.size() > seen_max / 2; oldest = seen_.erase(oldest)) {
      while (is_resident(oldest->second)) ++oldest;
      if (topic_ != SoakTopic::complete) continue;
      const Seen& seen = oldest->second;
      if (seen.last < here_.board.publisher[seen.token >> ParcelPlan::size_bits].committed)
        complain("committed and never delivered", seen, seen.last + 1);
    }
  }
  static bool is_resident(const Seen& seen) {
    return seen.token >> ParcelPlan::size_bits < 2 * static_cast<std::uint64_t>(SoakTopic::count);
  }

  void complain(const char* what, const Seen& seen, std::uint64_t number) {
    here_.board.complain(
        "%s: %s: number %llu after %llu of token %#llx; lost %llu before %llu, gaps %llu, depth "
        "%zu, %s",
        name_of(topic_).c_str(), what, static_cast<unsigned long long>(number),
        static_cast<unsigned long long>(seen.last), static_cast<unsigned long long>(seen.token),
        static_cast<unsigned long long>(lost_now()), static_cast<unsigned long long>(lost_),
        static_cast<unsigned long long>(gaps_), qos_.depth(),
        is_owed_from_start(seen.token) ? "owed from its start" : "joined late");
  }

  Here here_;
  const SoakTopic topic_;
  const Kind kind_;
  const QoS qos_;
  Subscription<Parcel>::SharedPtr subscription_;  // one of the two
  PollingSubscriber<Parcel>::SharedPtr polled_;
  std::mutex mutex_;  // guards the members below
  Random random_;
  std::uint64_t born_ns_ = 0;
  std::map<std::uint64_t, Seen> seen_;  // by generation
  std::deque<Held> held_;
  std::uint64_t taken_ = 0, lost_ = 0, gaps_ = 0, promised_ = 0, nothing_since_ns_ = 0;
};

}  // namespace agnocast::test
