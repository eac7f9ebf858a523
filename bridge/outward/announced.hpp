// SPDX-License-Identifier: Apache-2.0
//
// Announced: DDS writers of publishers of this host that have no reader in DDS. They make the
// topic visible there (`ros2 topic list`, and `echo` and `hz` without a type); nothing subscribes
// to the publisher on this host and nothing is written.
//
//   announced ── a reader comes ──▶ in use ── the last reader goes ──▶ announced, with a new writer
//
// The writer is new because a used one has a history, which the next reader would get besides the
// publisher's own. One thread, the participant's. Called by outward_routes.cpp.
#pragma once

#include <bridge/common/refusals.hpp>
#include <bridge/common/slow_deleter.hpp>
#include <bridge/dds/participant.hpp>
#include <bridge/plan/routes.hpp>

#include <cstddef>
#include <cstdint>
#include <map>
#include <memory>

namespace agnocast::bridge {

/// Creates the DDS writer of a publisher.
[[nodiscard]] DdsResult<std::unique_ptr<DdsWriter>> create_writer_of(
    DdsParticipant& participant, const DdsWriterPlan& dds_writer);

class Announced {
 public:
  /// `deleter` ends the writers, and must outlive it.
  explicit Announced(SlowDeleter& deleter) : deleter_(deleter) {}

  /// Ends every writer whose publisher the plan neither announces nor writes, or for which the
  /// plan has another QoS.
  void end_others(const Plan& plan);
  /// Returns the writer of this publisher and stops announcing it; null if there is none.
  std::unique_ptr<DdsWriter> take_over(std::uint64_t publisher);
  /// Creates the announced writers of the plan that do not exist yet.
  void open(const Plan& plan, DdsParticipant& participant, Refusals& refusals);
  void clear();

  std::size_t size() const noexcept { return writers_.size(); }
  template <class Look>
  void for_each(Look look) const {
    for (const auto& [publisher, one] : writers_) look(one.plan, *one.writer);
  }

 private:
  struct One {
    DdsWriterPlan plan;
    std::unique_ptr<DdsWriter> writer;
  };

  SlowDeleter& deleter_;
  std::map<std::uint64_t, One> writers_;  // by generation of the publisher
};

}  // namespace agnocast::bridge
