// SPDX-License-Identifier: Apache-2.0
//
// ReaderHandover: the DDS reader through which the messages of one remote writer come. When
// subscriptions or rules change, a writer goes over to another DDS reader; both then get its
// messages, the new one perhaps later. Messages come through the former one until the new one gives
// one that is not older, or for a limited time, so each comes once and in order. Pure.
#pragma once

#include <bridge/common/linger.hpp>
#include <bridge/plan/routes.hpp>

#include <cstdint>
#include <optional>
#include <set>
#include <utility>

namespace agnocast::bridge {

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
  void end_dds_readers(const std::set<ReaderKey>& ended, Time end);
  /// Returns whether to pass on a message from this DDS reader; older ones are then rejected.
  bool takes(const ReaderKey& by, std::int64_t source_time_ns);
  /// Ends what is due. Returns when to call it again.
  std::optional<Time> tidy(Time now);

 private:
  ReaderKey dds_reader_;
  // False from a change of the DDS reader until the new one gives a message that is not older than
  // the last one. Until then, or until its time is over, messages come through the former one.
  bool has_begun_ = true;
  std::optional<ReaderKey> former_;
  Time former_end_;
  std::int64_t newest_ns_ = 0;  // source time
};

}  // namespace agnocast::bridge
