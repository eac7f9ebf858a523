// SPDX-License-Identifier: Apache-2.0

#include <bridge/inward/reader_handover.hpp>

namespace agnocast::bridge {

void ReaderHandover::reject(Time now) noexcept {
  has_begun_ = false;
  rejecting_end_ = now + rejecting_max;
}

void ReaderHandover::begin_with(const ReaderKey& former, Time now) {
  former_ = former;
  former_has_begun_ = true;
  former_end_ = now + linger;
  reject(now);
}

void ReaderHandover::go_over(const ReaderKey& dds_reader,
                             const std::function<Left(const ReaderKey&)>& left_of, bool repeats,
                             Time now) {
  if (former_ == dds_reader) {  // back again
    has_begun_ = former_has_begun_;
    former_.reset();
    dds_reader_ = dds_reader;
    return;
  }
  const Left left = left_of(dds_reader_);
  lacks_ = left == Left::lossy || (lacks_ && !has_begun_);
  if (former_ && left_of(*former_) != Left::useful) former_.reset();
  const bool is_outdone = lacks_ && repeats;
  if (left == Left::useful && !is_outdone && (has_begun_ || !former_)) {
    former_ = dds_reader_;
    former_has_begun_ = has_begun_;
  }
  former_end_ = now + linger;
  dds_reader_ = dds_reader;
  reject(now);
}

void ReaderHandover::end_dds_readers(const std::set<ReaderKey>& ended, Time now) {
  if (former_ && ended.contains(*former_)) former_.reset();
  if (ended.contains(dds_reader_)) reject(now);
}

bool ReaderHandover::takes(const ReaderKey& by, std::int64_t source_time_ns) {
  const bool is_own = dds_reader_ == by;
  if (!is_own && former_ != by) return false;  // the other DDS reader has it too
  bool& has_begun = is_own ? has_begun_ : former_has_begun_;
  if (!has_begun) {
    if (source_time_ns < newest_ns_) return false;
    has_begun = true;
    if (is_own) former_.reset();
    if (source_time_ns == newest_ns_) return false;
  }
  newest_ns_ = source_time_ns;
  return true;
}

void ReaderHandover::end_due(Time now) noexcept {
  if (is_former_due(now)) former_.reset();
  if (!is_rejecting_due(now)) return;
  has_begun_ = true;
  former_.reset();
}

std::optional<Time> ReaderHandover::next() const {
  std::optional<Time> next;
  if (former_) next = former_end_;
  if (!has_begun_) next = earliest(next, rejecting_end_);
  return next;
}

}  // namespace agnocast::bridge
