// SPDX-License-Identifier: Apache-2.0
//
// ReaderHandover: the DDS reader through which the messages of one remote writer come. When
// subscriptions or rules change, a writer goes over to another DDS reader; both then get its
// messages, the new one perhaps later. Messages come through the former one until the new one gives
// one that is not older, or for a limited time; not through one that may lose messages meanwhile.
// Older ones from the new one are rejected by their source time, also for a limited time, because
// the clock of the writer may be set back. So each message that the new one, or one that loses
// nothing, has received within these times comes once and in order. Pure.
#pragma once

#include <bridge/common/linger.hpp>
#include <bridge/plan/routes.hpp>

#include <chrono>
#include <cstdint>
#include <functional>
#include <optional>
#include <set>
#include <utility>

namespace agnocast::bridge {

/// How long older messages of a new DDS reader are rejected. A history that comes later comes
/// twice.
inline constexpr std::chrono::seconds rejecting_max{10};

class ReaderHandover {
 public:
  /// A DDS reader that a writer leaves.
  enum class Left : std::uint8_t {
    ended,   ///< it gives nothing more
    useful,  ///< it gets all messages until the new one does
    lossy,   ///< it may lose messages from now on
  };

  ReaderHandover() = default;
  explicit ReaderHandover(ReaderKey dds_reader) : dds_reader_(std::move(dds_reader)) {}

  const ReaderKey& dds_reader() const noexcept { return dds_reader_; }
  /// Returns the DDS reader through which its messages still come.
  const std::optional<ReaderKey>& former() const noexcept { return former_; }

  /// Another DDS reader was there before the writer, so it may have messages that this one missed.
  void begin_with(const ReaderKey& former, Time now);
  /// `left_of` returns the state of a DDS reader; `repeats` says whether the new one gets the
  /// history again.
  void go_over(const ReaderKey& dds_reader, const std::function<Left(const ReaderKey&)>& left_of,
               bool repeats, Time now);
  /// These DDS readers have ended. A reader that replaces them may get history that was passed on
  /// already.
  void end_dds_readers(const std::set<ReaderKey>& ended, Time now);
  /// Returns whether to pass on a message from this DDS reader; older ones are then rejected.
  bool takes(const ReaderKey& by, std::int64_t source_time_ns);

  /// Return whether the time of the former DDS reader, or that of rejecting, is over. Take all that
  /// the former one or, in the second case, both have received, then call end_due() with the same
  /// `now`.
  bool is_former_due(Time now) const noexcept { return former_ && former_end_ <= now; }
  bool is_rejecting_due(Time now) const noexcept { return !has_begun_ && rejecting_end_ <= now; }
  void end_due(Time now) noexcept;
  /// Returns when something becomes due.
  std::optional<Time> next() const;

 private:
  void reject(Time now) noexcept;

  ReaderKey dds_reader_;
  // False from a change of the DDS reader until the new one gives a message that is not older than
  // the last one, or the time of rejecting is over.
  bool has_begun_ = true;
  Time rejecting_end_;
  // Messages come through this one until has_begun_, or until its time is over.
  std::optional<ReaderKey> former_;
  bool former_has_begun_ = true;
  Time former_end_;
  // Messages before the first one of dds_reader_ may be lost, as long as it has not begun.
  bool lacks_ = false;
  std::int64_t newest_ns_ = 0;  // source time
};

}  // namespace agnocast::bridge
