// SPDX-License-Identifier: Apache-2.0

#include <bridge/program/planner.hpp>

#include <agnocast/connection_state.hpp>
#include <bridge/program/pauses.hpp>

#include <chrono>
#include <string>
#include <utility>

namespace agnocast::bridge {
namespace {

// Bound for writers that came and went since the newest plan and still get their remote publisher.
constexpr std::size_t gone_writers_max = 1'000;

Time soon() { return std::chrono::steady_clock::now() + daemon_interval; }

}  // namespace

Planner::Planner(std::uint32_t domain, Rules rules, Marker& marker, MessageTypes& types,
                 PlanPace& pace, Refusals& refusals, HasRemotePublisher has_remote_publisher)
    : domain_(domain),
      marker_(marker),
      types_(types),
      pace_(pace),
      refusals_(refusals),
      has_remote_publisher_(std::move(has_remote_publisher)),
      rules_(std::move(rules)) {}

void Planner::set_rules(Rules rules) {
  const std::lock_guard lock(next_mutex_);
  next_rules_ = std::move(rules);
}

bool Planner::renew_rules() {
  const std::lock_guard lock(next_mutex_);
  if (!next_rules_) return false;
  rules_ = *std::exchange(next_rules_, std::nullopt);
  return true;
}

bool Planner::renew_local(GraphSnapshot local) {
  const std::uint64_t before = std::exchange(local_, std::move(local)).incarnation;
  return local_.incarnation != before;
}

void Planner::note(const std::vector<RemoteChange>& changes) {
  if (!changes.empty()) pace_.changed();
  for (const RemoteChange& change : changes) {
    const Remote& remote = change.remote;
    if (!change.is_there && remote.kind == Remote::Kind::writer &&
        !has_remote_publisher_(remote.guid) && gone_writers_.size() < gone_writers_max)
      gone_writers_.push_back(remote);
  }
}

bool Planner::is_due(Time now) const { return (again_ && *again_ <= now) || pace_.is_due(now); }

bool Planner::plan(const DdsParticipant::Remotes& remotes, const CarryOut& carry_out) {
  again_.reset();
  // While the daemon is absent, creating an endpoint would block this thread and all its traffic.
  if (connection_state() == ConnectionState::reconnecting) {
    again_ = soon();
    pace_.put_off(*again_);
    return false;
  }
  const std::vector<Remote> gone = std::exchange(gone_writers_, {});
  const Time begin = std::chrono::steady_clock::now();
  bool is_whole = true;
  if (!gone.empty()) {
    DdsParticipant::Remotes with_gone = remotes;
    for (const Remote& remote : gone) with_gone.emplace(remote.guid, remote);
    is_whole = plan_once(with_gone, carry_out);
  }
  is_whole = is_whole && plan_once(remotes, carry_out);
  const Time end = std::chrono::steady_clock::now();
  if (is_whole) {
    pace_.made(begin, end);
  } else {
    pace_.changed();
    pace_.put_off(end + daemon_interval);
    gone_writers_ = gone;
  }
  return true;
}

bool Planner::plan_once(const DdsParticipant::Remotes& remotes, const CarryOut& carry_out) {
  const bool was_active = !marker_.standby_for();
  const Marker::Role role = marker_.find_role(local_);
  if (role == Marker::Role::unknown) {
    if (!marker_.is_there()) again_ = soon();
    if (marker_.is_refused()) marker_.note_refusal(refusals_);
    return false;
  }
  refusals_.begin_plan();
  marker_.note_refusal(refusals_);
  Plans plans;
  if (role == Marker::Role::active) {
    const Situation now = situation(remotes);
    plans.topics = plan_of(now);
    plans.services = plan_services(now);
  } else {
    plans.ends_all = was_active;
  }
  const CarriedOut carried_out = carry_out(plans);
  if (carried_out.again) again_ = carried_out.again;
  if (!carried_out.is_whole) again_ = soon();
  unbridged_ = std::move(plans.topics.unbridged);
  unbridged_.insert(unbridged_.end(), plans.services.unbridged.begin(),
                    plans.services.unbridged.end());
  return carried_out.is_whole;
}

Situation Planner::situation(const DdsParticipant::Remotes& remotes) {
  return {domain_,
          local_.endpoints,
          &remotes,
          rules_.list,
          [this](const std::string& type) { return types_.problem_of(type); },
          rules_.otherwise,
          has_remote_publisher_,
          rules_.announce};
}

}  // namespace agnocast::bridge
