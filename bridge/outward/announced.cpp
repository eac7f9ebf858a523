// SPDX-License-Identifier: Apache-2.0

#include <bridge/outward/announced.hpp>

#include <bridge/dds/names.hpp>

#include <string>
#include <utility>

namespace agnocast::bridge {
namespace {

bool is_same(const DdsWriterPlan& a, const DdsWriterPlan& b) noexcept {
  return a.offered == b.offered && a.depth == b.depth && a.keep_all == b.keep_all;
}

}  // namespace

DdsResult<std::unique_ptr<DdsWriter>> create_writer_of(DdsParticipant& participant,
                                                       const DdsWriterPlan& dds_writer) {
  const TopicKey& topic = dds_writer.local_reader.of.key;
  return participant.create_writer(
      *dds_topic_of({DdsTopicKind::topic, topic.topic}), *dds_type_of(topic.type),
      dds_qos_of(dds_writer.offered, dds_writer.depth, dds_writer.keep_all, dds_writer.times));
}

void Announced::end_others(const Plan& plan) {
  for (auto at = writers_.begin(); at != writers_.end();) {
    const auto is_wanted = [&](const auto& planned) {
      const auto wanted = planned.find(at->first);
      return wanted != planned.end() && is_same(wanted->second, at->second.plan);
    };
    if (is_wanted(plan.announced) || is_wanted(plan.dds_writers)) {
      ++at;
    } else {
      deleter_.end(std::move(at->second.writer));
      at = writers_.erase(at);
    }
  }
}

std::unique_ptr<DdsWriter> Announced::take_over(std::uint64_t publisher) {
  const auto found = writers_.find(publisher);
  if (found == writers_.end()) return nullptr;
  std::unique_ptr<DdsWriter> writer = std::move(found->second.writer);
  writers_.erase(found);
  return writer;
}

void Announced::open(const Plan& plan, DdsParticipant& participant, Refusals& refusals) {
  for (const auto& [publisher, dds_writer] : plan.announced) {
    if (writers_.contains(publisher)) continue;
    auto writer = create_writer_of(participant, dds_writer);
    if (writer)
      writers_[publisher] = {dds_writer, std::move(*writer)};
    else
      refusals.note("writer of " + dds_writer.local_reader.of.key.topic, writer.error().text());
  }
}

void Announced::clear() {
  for (auto& [publisher, one] : writers_) deleter_.end(std::move(one.writer));
  writers_.clear();
}

}  // namespace agnocast::bridge
