// SPDX-License-Identifier: Apache-2.0
//
// ReaderHandover: the DDS reader through which the messages of one remote writer come. When
// subscriptions or rules change, a writer goes over to another DDS reader; both then get its
// messages, the new one perhaps later. Messages come through the former one until the new one gives
// one that is not older, or for a limited time, so each comes once and in order. However late the
// new one gives its first messages, those that came already are rejected. Pure.
#pragma once

#include <bridge/common/linger.hpp>
#include <bridge/plan/routes.hpp>

#include <chrono>
#include <cstdint>
#include <optional>
#include <set>
#include <utility>

namespace agnocast::bridge {

/// How long older messages of the new DDS reader are rejected from the first one on. A history
/// comes in less time; and if the writer's clock was set back meanwhile, this much is lost.
inline constexpr std::chrono::seconds rejecting_max{10};

class ReaderHandover {
 public:
  ReaderHandover() = default;
  explicit ReaderHandover(ReaderKey dds_reader) : dds_reader_(std::move(dds_reader)) {}

  const ReaderKey& dds_reader() const noexcept { return dds_reader_; }
  /// Returns the DDS reader through which its messages still come.
  const std::optional<ReaderKey>& former() const noexcept { return former_; }

  /// Another DDS reader was there before the writer, so it may have messages that this one missed.
  void begin_with(const ReaderKey& former, Time end);
  void go_over(const ReaderKey& dds_reader, Time end);
  /// These DDS readers have ended. A reader that replaces them may get history that was passed on
  /// already.
  void end_dds_readers(const std::set<ReaderKey>& ended);
  /// Returns whether to pass on a message from this DDS reader; older ones are then rejected.
  bool takes(const ReaderKey& by, std::int64_t source_time_ns, Time now);
  /// Returns whether the time of the former DDS reader is over: take its last messages, then call
  /// end_former().
  bool is_former_due(Time now) const noexcept { return former_ && former_end_ <= now; }
  void end_former() noexcept { former_.reset(); }
  /// Returns when is_former_due() becomes true.
  std::optional<Time> next() const {
    if (!former_) return std::nullopt;
    return former_end_;
  }

 private:
  ReaderKey dds_reader_;
  // False from a change of the DDS reader until the new one gives a message that is not older than
  // the last one. Until then, or until its time is over, messages come through the former one.
  bool has_begun_ = true;
  std::optional<Time> rejecting_since_;
  std::optional<ReaderKey> former_;
  Time former_end_;
  std::int64_t newest_ns_ = 0;  // source time
};

}  // namespace agnocast::bridge
