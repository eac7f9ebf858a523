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
  rejecting_since_.reset();
}

void ReaderHandover::end_dds_readers(const std::set<ReaderKey>& ended) {
  if (former_ && ended.contains(*former_)) former_.reset();
  if (!ended.contains(dds_reader_)) return;
  has_begun_ = false;
  rejecting_since_.reset();
}

bool ReaderHandover::takes(const ReaderKey& by, std::int64_t source_time_ns, Time now) {
  const bool is_own = dds_reader_ == by;
  if (!is_own && former_ != by) return false;  // the other DDS reader has it too
  if (is_own && !has_begun_) {
    const bool is_older = source_time_ns < newest_ns_;
    if (is_older && !rejecting_since_) rejecting_since_ = now;
    if (is_older && now < *rejecting_since_ + rejecting_max) return false;
    has_begun_ = true;
    former_.reset();
    if (source_time_ns == newest_ns_) return false;
  }
  newest_ns_ = source_time_ns;
  return true;
}

}  // namespace agnocast::bridge
