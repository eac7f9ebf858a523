// SPDX-License-Identifier: Apache-2.0

#include <bridge/program/bridge.hpp>

#include <bridge/dds/names.hpp>
#include <bridge/program/pauses.hpp>

#include <algorithm>
#include <string>
#include <thread>
#include <utility>

namespace agnocast::bridge {
namespace {

// Writing means copying and sending: more than four threads are rarely busy at once.
constexpr std::size_t lanes_max = 4;

Lanes make_lanes() {
  const std::size_t count =
      std::clamp<std::size_t>(std::thread::hardware_concurrency(), 1, lanes_max);
  Lanes lanes;
  for (std::size_t i = 0; i < count; ++i)
    lanes.push_back(
        std::make_unique<Lane>(std::string(bridge_node) + (i == 0 ? "" : '_' + std::to_string(i))));
  return lanes;
}

}  // namespace

DdsResult<std::unique_ptr<Bridge>> Bridge::create(BridgeOptions options, const Log& log) {
  Lanes lanes = make_lanes();
  auto participant = DdsParticipant::create({.domain = options.domain});
  if (!participant) return tl::unexpected(participant.error());
  auto graph = RosGraph::create(**participant, options.speak);
  if (!graph) return tl::unexpected(graph.error());
  return std::unique_ptr<Bridge>(new Bridge(std::move(options), log, std::move(lanes),
                                            std::move(*participant), std::move(*graph)));
}

Bridge::Bridge(BridgeOptions options, const Log& log, Lanes lanes,
               std::unique_ptr<DdsParticipant> participant, std::unique_ptr<RosGraph> graph)
    : alive_interval_(options.alive ? options.alive_interval : std::chrono::nanoseconds(0)),
      alive_(std::move(options.alive)),
      lanes_(std::move(lanes)),
      participant_(std::move(participant)),
      ros_graph_(std::move(graph)),
      types_(std::move(options.type_paths)),
      refusals_(log),
      outward_(*participant_, lanes_, types_, log, deleter_, refusals_),
      inward_(*participant_, lanes_.front()->node, types_, pace_, log, deleter_, refusals_),
      services_(*participant_, lanes_.front()->node, types_, log, deleter_, refusals_),
      watch_(log, [this] { participant_->interrupt(); }),
      marker_(options.domain, participant_->guid(), watch_, log),
      planner_(options.domain, {std::move(options.rules), options.otherwise, options.announce},
               marker_, types_, pace_, refusals_,
               [this](const Guid& writer) { return inward_.has_remote_publisher(writer); }),
      discovery_info_(options.domain, *ros_graph_, log, refusals_),
      limits_log_(participant_->limits(), log),
      status_(options.domain, {*participant_, *ros_graph_, outward_, inward_, services_, watch_,
                               marker_, planner_, refusals_}) {}

Bridge::~Bridge() = default;

void Bridge::stop() noexcept { watch_.stop(); }

void Bridge::set_rules(std::vector<Rule> rules, Direction otherwise, bool announce) {
  planner_.set_rules({std::move(rules), otherwise, announce});
  participant_->interrupt();
}

std::optional<BridgeStatus> Bridge::status(std::chrono::milliseconds patience) {
  return status_.ask(patience);
}

DdsResult<void> Bridge::run() {
  watch_.start();
  const bool is_watched = alive_interval_ > std::chrono::nanoseconds(0);
  const std::chrono::nanoseconds longest = is_watched ? alive_interval_ : no_end;
  while (!watch_.stops()) {
    const auto ready = participant_->wait(std::min(longest, tidy()));
    if (!ready) return tl::unexpected(ready.error());
    if (is_watched) alive_();
    move(*ready);
    limits_log_.write();
    status_.answer();
  }
  watch_.join();
  return {};
}

void Bridge::move(const DdsParticipant::Ready& ready) {
  // Discovery first: a writer must be known before its samples are taken.
  if (ready.discovery) planner_.note(participant_->discovered());
  const bool may_hear =
      ready.discovery || std::find(ready.readers.begin(), ready.readers.end(),
                                   discovery_info_.reader()) != ready.readers.end();
  if (may_hear && discovery_info_.hear()) planner_.note_change();
  // Both calls renew something, so neither may be skipped because the other one found a change.
  const bool is_local_new = renew_local();
  const bool are_rules_new = planner_.renew_rules();
  // The plan may end readers; inward_ knows those that remain.
  const std::vector<DdsReader*> readers(ready.readers.begin(), ready.readers.end());
  if (is_local_new || are_rules_new || planner_.is_due(std::chrono::steady_clock::now())) plan();
  for (DdsReader* const reader : readers) {
    if (inward_.has(reader)) take_from(*reader);
  }
  services_.move(readers);
}

bool Bridge::renew_local() {
  auto latest = watch_.take_latest();
  if (!latest) return false;
  if (planner_.renew_local(std::move(*latest))) outward_.begin_anew();
  return true;
}

void Bridge::take_from(DdsReader& dds_reader) {
  std::vector<DdsSample> taken = InwardRoutes::take(dds_reader);
  // Samples of a writer that came after run() read the discovery: they wait for a plan.
  const bool has_unknown = inward_.has_unknown_writers(taken);
  // First, since a plan may end the reader.
  inward_.publish(dds_reader, std::move(taken));
  if (!has_unknown) return;
  planner_.note(participant_->discovered());
  if (planner_.is_due(std::chrono::steady_clock::now())) plan();
}

void Bridge::plan() {
  if (planner_.plan(participant_->remotes(),
                    [this](const Planner::Plans& plans) { return carry_out(plans); }))
    inward_.publish_unplaced();
}

Planner::CarriedOut Bridge::carry_out(const Planner::Plans& plans) {
  if (plans.ends_all) {
    outward_.end_all();
    inward_.end_all();
  }
  outward_.end_changed(plans.topics);
  inward_.end_changed(plans.topics);
  const Errc outward = outward_.apply(plans.topics, planner_.local());
  const InwardRoutes::Applied inward = inward_.apply(plans.topics);
  const Errc services = services_.apply(plans.services);
  const bool is_standby = marker_.standby_for().has_value();
  discovery_info_.say(is_standby ? std::span<const EndpointInfo>() : planner_.local(),
                      [&](const NodesByName& nodes) {
                        outward_.tell(nodes);
                        inward_.tell(plans.topics, nodes);
                        services_.tell(nodes);
                      });
  const auto answered = [](Errc refusal) { return refusal != Errc::daemon_not_running; };
  return {answered(outward) && answered(inward.refusal) && answered(services), inward.again};
}

std::chrono::nanoseconds Bridge::tidy() {
  const Time now = std::chrono::steady_clock::now();
  std::optional<Time> next = services_.send_kept(now);
  next = earliest(next, outward_.tidy(now));
  next = earliest(next, inward_.tidy(now));
  next = earliest(next, planner_.due());
  return next ? std::max<std::chrono::nanoseconds>(*next - now, std::chrono::nanoseconds(0))
              : no_end;
}

}  // namespace agnocast::bridge
