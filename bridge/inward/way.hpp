// SPDX-License-Identifier: Apache-2.0
//
// Way: by which inlet the messages of one remote writer come. When others subscribe, or the rules change, a writer goes
// over to another inlet; both then get its messages, the new one perhaps later. Until the new one gives what is not older
// than what has come, or its time is over, messages go on by the former one, so each comes once and in order. Pure.
#pragma once

#include <bridge/common/linger.hpp>
#include <bridge/plan/routes.hpp>

#include <cstdint>
#include <optional>
#include <set>
#include <utility>

namespace agnocast::bridge {

class Way {
 public:
  Way() = default;
  explicit Way(ReaderKey inlet) : inlet_(std::move(inlet)) {}

  const ReaderKey& inlet() const noexcept { return inlet_; }
  /// The inlet that its messages still come by.
  const std::optional<ReaderKey>& former() const noexcept { return former_; }

  /// Another inlet looked out for the writer, and may have read what the own one is too late for.
  void begin_with(const ReaderKey& former, Time end);
  void go_over(const ReaderKey& inlet, Time end);
  /// These inlets have ended. A reader in their place may get a history that has come.
  void end_inlets(const std::set<ReaderKey>& ended, Time end);
  /// Whether a message that came by this inlet is passed on; then what is older is not.
  bool takes(const ReaderKey& by, std::int64_t source_time_ns);
  /// What has had its time is over. Returns when there is something to do again.
  std::optional<Time> tidy(Time now);

 private:
  ReaderKey inlet_;
  // False after it has gone over to another inlet, until that gives what is not older than what has come. Until
  // then, or its time is over, messages come by the former one.
  bool has_begun_ = true;
  std::optional<ReaderKey> former_;
  Time former_end_;
  std::int64_t newest_ns_ = 0;  // source time
};

}  // namespace agnocast::bridge
