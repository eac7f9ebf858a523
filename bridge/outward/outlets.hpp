// SPDX-License-Identifier: Apache-2.0
//
// Outlets: the DDS writers of this host's publishers, and the way of a message from a tap to its writer.
//
// A publisher's first messages may come before the graph has told of it: they wait here, as many as their tap's
// depth, until a plan knows the publisher. So a history that is handed over is handed over whole. Its last ones may
// be unread when it is gone: its outlet, and the tap, stay for `linger` after that.
//
// What a new volatile publisher publishes before its own tap is linked only the taps of its topic's other publishers have, which
// may keep less than the own one, and be ahead of it or behind. So until the own tap has brought what follows on what was passed
// on, any tap's messages go on in their order, and what is behind a gap waits for it to be filled, for `linger` at most, or
// until the own tap has brought as many as it keeps.
//
// What waits is written by a thread of this, the outlets in turn: neither the thread that plans nor the tap's, which has
// other topics, shall wait for a reader in DDS that does not acknowledge.
#pragma once

#include <agnocast/generic.hpp>
#include <bridge/cdr/cdr.hpp>
#include <bridge/common/linger.hpp>
#include <bridge/common/log.hpp>
#include <bridge/common/message_types.hpp>
#include <bridge/common/reaper.hpp>
#include <bridge/common/traffic.hpp>
#include <bridge/common/worker.hpp>
#include <bridge/dds/participant.hpp>
#include <bridge/plan/routes.hpp>

#include <atomic>
#include <cstdint>
#include <deque>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <set>
#include <utility>

namespace agnocast::bridge {

struct OpenOutlet {
  Outlet plan;
  std::shared_ptr<const BridgedType> type;
  std::unique_ptr<DdsWriter> writer;
  Traffic traffic;
  std::mutex order;  // of `waited`; held while the tap's thread writes
  // What was there before it was open, or what keep-all holds up: written before anything else. The hold quota of the
  // tap bounds it, and what is beyond holds up the publisher.
  std::deque<GenericMessage> waited;
  bool has_begun = true;  // only what the own tap brings counts
  // What was passed on last. What is older by both has come before, by another tap; by the sequence number alone, it is of
  // another publisher that has had the generation under a former agnocastd.
  std::uint64_t newest = 0;
  std::uint64_t newest_ns = 0;
  mutable std::atomic<std::uint32_t> matched{0}, incompatible{0};  // when somebody looked last
  std::atomic<bool> is_held{false};  // something waits, so the outlets' thread alone writes
  std::atomic<bool> is_over{false};  // closed: nothing waits any longer

  /// Than what was asked about before.
  bool is_newer(const MessageInfo& info) noexcept {
    if (info.sequence <= newest && info.publish_time_ns <= newest_ns) return false;
    newest = info.sequence;
    newest_ns = info.publish_time_ns;
    return true;
  }
};

/// Any thread; messages of one tap come from one thread. A message that is written holds up what else its thread writes: the
/// tap's lane, or the one for what waits; while a reader does not acknowledge, for DdsQos::blocking_max.
class Outlets {
 public:
  /// Both must outlive it. `reaper` ends the writers; `wake` is called when tidy() gets something to do, by any thread.
  Outlets(const Log& log, Reaper& reaper, std::function<void()> wake)
      : log_(log), reaper_(reaper), wake_(std::move(wake)) {}

  /// Writes the message, keeps it for later, or drops it: its publisher has no outlet, or that of another tap.
  void pass(GenericMessage message, const ReaderKey& tap, const CdrType& type) noexcept;

  /// These publishers have no outlet and get none: what they publish is dropped, also what waits. Anybody
  /// else's waits.
  void set_without(std::set<std::uint64_t> publishers);
  /// What waited for it is written soon, in order and before anything else. Does not wait.
  void open(std::uint64_t publisher, std::unique_ptr<OpenOutlet> outlet);
  void close(std::uint64_t publisher);
  /// Everything, also what waits: generations mean others from now on.
  void close_all();

  /// The publisher is gone: its outlet is closed by tidy() when its time is over.
  void close_later(std::uint64_t publisher, Time now);
  /// Ends what has had its time: outlets of those that are gone, and messages of publishers that nobody has told of.
  /// False if there is nothing left that will have to be ended.
  bool tidy(Time now);
  /// The taps that outlets of publishers that are gone still need.
  std::set<ReaderKey> lingering() const;
  /// What waits by this tap, which is made anew and brings it again.
  void forget_waiting(const ReaderKey& tap);
  /// Messages of publishers that nobody told of in time, for which there was no room, or which gave way to newer ones before
  /// their writer had begun. Any thread.
  std::uint64_t lost() const noexcept { return lost_; }

  /// Calls look(generation, outlet) for each. Holds up nobody.
  template <class Look>
  void for_each(Look look) const {
    std::unique_lock lock(mutex_);
    const auto open = open_;
    lock.unlock();
    for (const auto& [publisher, outlet] : open) look(publisher, std::as_const(*outlet));
  }

 private:
  using Waiting = std::pair<std::uint64_t, ReaderKey>;  // publisher and tap
  struct Queue {
    Time since;
    std::deque<GenericMessage> messages;
    std::deque<std::size_t> bytes;  // of each
    std::size_t dropped = 0;        // for newer ones
  };

  /// True if tidy() has something to do that it had not before.
  bool keep(GenericMessage message, const ReaderKey& tap, const CdrType& type);
  void drop_front(Queue& queue);
  template <class Condition>
  void end_waiting_if(Condition condition);
  void lose(std::size_t messages, const char* why) noexcept;
  /// Hands the outlet what waits for it, up to a gap if it has not begun and it is not late. With both locks.
  void catch_up(OpenOutlet& outlet, std::uint64_t publisher, bool is_late = false);
  /// What it has waiting. With its lock.
  void write_soon(const std::shared_ptr<OpenOutlet>& outlet);
  /// False if nothing is left.
  bool write_waited(OpenOutlet& outlet);
  /// False if keep-all holds it up: it is to be written again.
  bool write(OpenOutlet& outlet, const GenericMessage& message) const;
  void end(std::shared_ptr<OpenOutlet> outlet) noexcept;

  const Log& log_;
  Reaper& reaper_;
  const std::function<void()> wake_;
  std::atomic<std::uint64_t> lost_{0};
  Seldom tells_lost_;
  mutable std::mutex mutex_;  // of what follows; never held while a message is written
  std::map<std::uint64_t, std::shared_ptr<OpenOutlet>> open_;
  std::set<std::uint64_t> without_;       // known publishers that have none
  std::map<std::uint64_t, Time> ending_;  // of open_, by when they end
  std::map<Waiting, Queue> waiting_;
  std::size_t held_bytes_ = 0;  // of waiting_
  Worker opener_;
};

}  // namespace agnocast::bridge
