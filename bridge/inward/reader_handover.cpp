// SPDX-License-Identifier: Apache-2.0

#include <bridge/inward/reader_handover.hpp>

namespace agnocast::bridge {

void ReaderHandover::begin_with(const ReaderKey& former, Time end) {
  has_begun_ = false;
  former_ = former;
  former_end_ = end;
}

void ReaderHandover::go_over(const ReaderKey& dds_reader, Time end) {
  if (has_begun_) former_ = dds_reader_;  // else former_ stays the one before
  dds_reader_ = dds_reader;
  has_begun_ = former_ == dds_reader;
  if (has_begun_) former_.reset();
  former_end_ = end;
}

void ReaderHandover::end_dds_readers(const std::set<ReaderKey>& ended, Time end) {
  if (former_ && ended.contains(*former_)) former_.reset();
  if (!ended.contains(dds_reader_)) return;
  has_begun_ = false;
  former_end_ = end;
}

bool ReaderHandover::takes(const ReaderKey& by, std::int64_t source_time_ns) {
  const bool is_own = dds_reader_ == by;
  if (!is_own && former_ != by) return false;  // the other DDS reader has it too
  if (is_own && !has_begun_) {
    if (source_time_ns < newest_ns_) return false;
    has_begun_ = true;
    former_.reset();
    if (source_time_ns == newest_ns_) return false;
  }
  newest_ns_ = source_time_ns;
  return true;
}

std::optional<Time> ReaderHandover::tidy(Time now) {
  if (former_end_ <= now) former_.reset();
  if (former_end_ + linger <= now) has_begun_ = true;
  std::optional<Time> next;
  if (former_) next = former_end_;
  if (!has_begun_) next = earliest(next, former_end_ + linger);
  return next;
}

}  // namespace agnocast::bridge
