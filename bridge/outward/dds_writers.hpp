// SPDX-License-Identifier: Apache-2.0
//
// DDS writers: the DDS writers of this host's publishers, and the messages on their way to them.
//
// A publisher's first messages may arrive before the graph shows it: they wait here, up to the
// depth of their local reader, until a plan knows the publisher. So a history is passed on
// complete. Its last messages may be unread when it is gone: its DDS writer and the local reader
// stay for `linger`.
//
// Messages of a new volatile publisher from before its own local reader is created reach only the
// readers of the topic's other publishers, which may keep less, and be ahead or behind. So until
// the own reader has brought the successor of the last message passed on, messages of any reader
// go on in their order. Messages behind a gap wait for at most `linger`, or until the own reader
// has brought as many as it keeps.
//
// A thread of this class writes waiting messages, one DDS writer after the other: neither run()
// nor a local reader with other topics may wait for a remote reader that does not acknowledge.
#pragma once

#include <agnocast/generic.hpp>
#include <bridge/cdr/cdr.hpp>
#include <bridge/common/linger.hpp>
#include <bridge/common/log.hpp>
#include <bridge/common/message_types.hpp>
#include <bridge/common/slow_deleter.hpp>
#include <bridge/common/traffic.hpp>
#include <bridge/common/worker.hpp>
#include <bridge/dds/participant.hpp>
#include <bridge/outward/source_times.hpp>
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

struct OpenDdsWriter {
  DdsWriterPlan plan;
  std::shared_ptr<const BridgedType> type;
  std::unique_ptr<DdsWriter> writer;
  Traffic traffic;
  std::mutex order;  // guards `waited`; held while the local reader's thread writes
  // Messages from before it was open, or blocked by keep-all: written before all others. The hold
  // quota of the local reader bounds them, and beyond it the publisher is blocked.
  std::deque<GenericMessage> waited;
  SourceTimes source_times;  // for the thread that writes
  bool has_begun = true;     // only messages of the own local reader count
  // The last message passed on. One that is older by both came before, through another local
  // reader; one older by the sequence number alone is from a publisher of a previous agnocastd.
  std::uint64_t newest = 0;
  std::uint64_t newest_ns = 0;
  mutable std::atomic<std::uint32_t> matched{0}, incompatible{0};  // at the last look
  std::atomic<bool> is_held{false};  // messages wait, so only the class's own thread writes
  std::atomic<bool> is_over{false};  // closed: nothing waits any longer

  /// Returns whether the message is newer than all that were asked about before.
  bool is_newer(const MessageInfo& info) noexcept {
    if (info.sequence <= newest && info.publish_time_ns <= newest_ns) return false;
    newest = info.sequence;
    newest_ns = info.publish_time_ns;
    return true;
  }
};

/// Any thread; messages of one local reader come from one thread. Writing a message delays the
/// other work of its thread, a lane or the thread for waiting messages; if a reader does not
/// acknowledge, by DdsQos::blocking_max.
class DdsWriters {
 public:
  /// Both must outlive it. `deleter` ends the writers; any thread calls `wake` when tidy() gets
  /// something to do.
  DdsWriters(const Log& log, SlowDeleter& deleter, std::function<void()> wake)
      : log_(log), deleter_(deleter), wake_(std::move(wake)) {}

  /// Writes or keeps the message; drops it if its publisher has no DDS writer, or another local
  /// reader's.
  void pass(GenericMessage message, const ReaderKey& local_reader, const CdrType& type) noexcept;

  /// Names publishers that get no DDS writer: their messages, also waiting ones, are dropped.
  /// Messages of unknown publishers wait.
  void set_without(std::set<std::uint64_t> publishers);
  /// Opens a DDS writer; its waiting messages are written soon and before others. Does not block.
  void open(std::uint64_t publisher, std::unique_ptr<OpenDdsWriter> dds_writer);
  void close(std::uint64_t publisher);
  /// Closes all, with the waiting messages: generations mean other publishers from now on.
  void close_all();

  /// For a publisher that is gone: tidy() closes its DDS writer after `linger`.
  void close_later(std::uint64_t publisher, Time now);
  /// Ends what is due: DDS writers of publishers that are gone, and messages of publishers that
  /// were never announced. Returns false if nothing is left to end.
  bool tidy(Time now);
  /// Returns the local readers that DDS writers of gone publishers still need.
  std::set<ReaderKey> lingering() const;
  /// Drops the messages of this local reader, which is made again and brings them again.
  void forget_waiting(const ReaderKey& local_reader);
  /// Returns the number of messages lost because their publisher was announced too late, there was
  /// no room, or newer ones displaced them before their writer had begun. Any thread.
  std::uint64_t lost() const noexcept { return lost_; }

  /// Calls look(generation, DDS writer) for each. Blocks no other thread.
  template <class Look>
  void for_each(Look look) const {
    std::unique_lock lock(mutex_);
    const auto open = open_;
    lock.unlock();
    for (const auto& [publisher, dds_writer] : open) look(publisher, std::as_const(*dds_writer));
  }

 private:
  using Waiting = std::pair<std::uint64_t, ReaderKey>;  // publisher and local reader
  struct Queue {
    Time since;
    std::deque<GenericMessage> messages;
    std::deque<std::size_t> bytes;  // of each
    std::size_t dropped = 0;        // displaced by newer ones
  };

  /// Returns true if tidy() has something new to do.
  bool keep(GenericMessage message, const ReaderKey& local_reader, const CdrType& type);
  void drop_front(Queue& queue);
  template <class Condition>
  void end_waiting_if(Condition condition);
  void lose(std::size_t messages, const char* why) noexcept;
  /// Gives the DDS writer its waiting messages, only up to a gap unless begun or late. With both
  /// locks.
  void catch_up(OpenDdsWriter& dds_writer, std::uint64_t publisher, bool is_late = false);
  /// Schedules its waiting messages. Call with its lock.
  void write_soon(const std::shared_ptr<OpenDdsWriter>& dds_writer);
  /// Returns false if nothing is left.
  bool write_waited(OpenDdsWriter& dds_writer);
  /// Returns false if keep-all blocks it: write it again later.
  bool write(OpenDdsWriter& dds_writer, const GenericMessage& message) const;
  void end(std::shared_ptr<OpenDdsWriter> dds_writer) noexcept;

  const Log& log_;
  SlowDeleter& deleter_;
  const std::function<void()> wake_;
  std::atomic<std::uint64_t> lost_{0};
  Seldom reports_lost_;
  mutable std::mutex mutex_;  // guards the rest; never held while a message is written
  std::map<std::uint64_t, std::shared_ptr<OpenDdsWriter>> open_;
  std::set<std::uint64_t> without_;       // known publishers without a DDS writer
  std::map<std::uint64_t, Time> ending_;  // those of open_ that end, and when
  std::map<Waiting, Queue> waiting_;
  std::size_t held_bytes_ = 0;  // in waiting_
  Worker opener_;
};

}  // namespace agnocast::bridge
