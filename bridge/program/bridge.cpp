// SPDX-License-Identifier: Apache-2.0

#include <bridge/program/bridge.hpp>

#include <bridge/dds/names.hpp>

#include <algorithm>
#include <chrono>
#include <exception>
#include <stdexcept>
#include <utility>

namespace agnocast::bridge {
namespace {

using std::chrono::milliseconds;

// How long a thread sleeps when nothing happens: for ever.
constexpr auto no_end = std::chrono::hours(24 * 365);
// Between two looks for a daemon that is not there.
constexpr milliseconds daemon_interval(1'000);
// Writers that came and went since the newest plan, and get their source all the same.
constexpr std::size_t gone_writers_max = 1'000;
// Writing is copying and sending: more threads than this are rarely busy at once.
constexpr std::size_t lanes_max = 4;
// On it each bridge has its marker.
constexpr const char* marker_topic = "/_agnocast_bridge";
constexpr const char* marker_task = "endpoint by which other bridges see this one";

OutwardRoutes::Lanes make_lanes() {
  const std::size_t count =
      std::clamp<std::size_t>(std::thread::hardware_concurrency(), 1, lanes_max);
  OutwardRoutes::Lanes lanes;
  for (std::size_t i = 0; i < count; ++i)
    lanes.push_back(
        std::make_unique<Node>(std::string(bridge_node) + (i == 0 ? "" : '_' + std::to_string(i))));
  return lanes;
}

std::string marker_node_of(const Guid& participant) {
  std::string name = std::string(bridge_node) + '_';
  for (const std::uint8_t byte : participant.bytes) {
    for (const int digit : {byte >> 4, byte & 15}) name += "0123456789abcdef"[digit];
  }
  return name;
}

}  // namespace

DdsResult<std::unique_ptr<Bridge>> Bridge::create(BridgeOptions options, const Log& log) {
  OutwardRoutes::Lanes lanes = make_lanes();
  auto participant = DdsParticipant::create({.domain = options.domain});
  if (!participant) return tl::unexpected(participant.error());
  auto graph = RosGraph::create(**participant, options.speak);
  if (!graph) return tl::unexpected(graph.error());
  return std::unique_ptr<Bridge>(new Bridge(std::move(options), log, std::move(lanes),
                                            std::move(*participant), std::move(*graph)));
}

Bridge::Bridge(BridgeOptions options, const Log& log, OutwardRoutes::Lanes lanes,
               std::unique_ptr<DdsParticipant> participant, std::unique_ptr<RosGraph> graph)
    : options_(std::move(options)),
      log_(log),
      lanes_(std::move(lanes)),
      participant_(std::move(participant)),
      ros_graph_(std::move(graph)),
      types_(options_.type_paths),
      refusals_(log),
      outward_(*participant_, lanes_, types_, log, reaper_, refusals_),
      inward_(*participant_, *lanes_.front(), types_, pace_, log, reaper_, refusals_),
      services_(*participant_, *lanes_.front(), types_, log, reaper_, refusals_),
      rules_{options_.rules, options_.otherwise, options_.announce},
      marker_node_(marker_node_of(participant_->guid())) {}

Bridge::~Bridge() {
  stop();
  if (graph_thread_.joinable()) graph_thread_.join();
  marker_.reset();
}

void Bridge::stop() noexcept {
  {
    const std::lock_guard lock(pause_mutex_);
    stops_ = true;
  }
  paused_.notify_all();
  graph_.interrupt();
  participant_->interrupt();
}

void Bridge::daemon_is(bool there, const std::string& why) {
  const Daemon now = there ? Daemon::there : Daemon::away;
  const Daemon before = daemon_.exchange(now);
  if (before == now || (there && before == Daemon::unknown)) return;
  if (there) return log_.write(LogLevel::notice, "agnocastd is there again");
  log_.write(LogLevel::warning, "agnocastd is not there", {{"why", why}});
}

// That agnocastd goes, the marker is told; this thread hears of it when it is back.
void Bridge::watch_graph() try {
  while (!stops_) {
    const bool was_there = daemon_ == Daemon::there;
    auto now =
        graph_.wait(was_there ? std::chrono::duration_cast<milliseconds>(no_end) : daemon_interval);
    if (now && *now) {
      daemon_is(true, "");
      const std::lock_guard lock(mutex_);
      latest_ = std::move(**now);
      participant_->interrupt();
    } else if (!now) {
      daemon_is(false, text_of(now.error()));
      if (now.error().code == Errc::daemon_not_running) continue;  // it was waited for
      std::unique_lock lock(pause_mutex_);
      paused_.wait_for(lock, daemon_interval, [this] { return stops_.load(); });
    }
  }
} catch (const std::exception&) {
  failed_ = std::current_exception();
  stop();
}

bool Bridge::show_oneself() {
  if (marker_ != nullptr) return true;
  if (marker_lane_ == nullptr) marker_lane_ = std::make_unique<Node>(marker_node_);
  SubscriptionOptions options;
  options.connection_callback([this](ConnectionInfo& info) {
    daemon_is(info.state != ConnectionState::reconnecting, "the connection has ended");
    if (info.state != ConnectionState::island || info.reason != Errc::revoked) return;
    is_revoked_ = true;  // for good: only another process can go on
    stop();
  });
  auto made = try_create_generic_subscription(
      *marker_lane_, marker_topic, TypeIdentity{"agnocast_bridge", 1}, QoS(1), nullptr, options);
  if (!made) {
    no_marker_ = {made.error().code, text_of(made.error())};
    return false;
  }
  marker_ = std::move(*made);
  no_marker_.reset();
  return true;
}

Bridge::Role Bridge::find_role() {
  if (local_.incarnation == 0) return Role::unknown;  // the graph will tell
  // Without a marker, since the configuration of agnocastd does not allow it, nobody stands by for this one, as this one
  // for nobody. What else is in the way passes.
  if (!show_oneself())
    return no_marker_->code == Errc::access_denied ? Role::active : Role::unknown;
  const EndpointInfo* own = nullptr;
  const EndpointInfo* oldest = nullptr;
  for (const EndpointInfo& endpoint : local_.endpoints) {
    if (endpoint.domain != options_.domain || endpoint.topic != marker_topic ||
        !is_bridge(endpoint))
      continue;
    if (endpoint.node_name == marker_node_) own = &endpoint;
    if (oldest == nullptr || endpoint.generation < oldest->generation) oldest = &endpoint;
  }
  if (own == nullptr) return Role::unknown;
  const auto was_for = std::exchange(standby_for_, std::nullopt);
  if (oldest != own) {
    standby_for_ = oldest->pid;
    if (!was_for)
      log_.write(LogLevel::notice, "stands by: another bridge of this domain is here",
                 {{"pid", std::to_string(oldest->pid)}});
    return Role::standby;
  }
  if (was_for)
    log_.write(LogLevel::notice, "takes over: the other bridge of this domain is gone",
               {{"pid", std::to_string(*was_for)}});
  return Role::active;
}

// Whoever is active has what we had: nothing lingers.
void Bridge::stand_by() {
  outward_.end_all();
  inward_.end_all();
}

bool Bridge::renew_local() {
  std::optional<GraphSnapshot> latest;
  {
    const std::lock_guard lock(mutex_);
    latest.swap(latest_);
  }
  if (!latest) return false;
  const std::uint64_t before = local_.incarnation;
  local_ = std::move(*latest);
  if (local_.incarnation != before) outward_.begin_anew();
  return true;
}

std::chrono::nanoseconds Bridge::tidy() {
  const Time now = std::chrono::steady_clock::now();
  std::optional<Time> next;
  const auto wake_at = [&](Time time) { next = next ? std::min(*next, time) : time; };
  if (const auto next_look = services_.send_kept(now)) wake_at(*next_look);
  if (const auto next_end = outward_.tidy(now)) wake_at(*next_end);
  if (const auto next_end = inward_.tidy(now)) wake_at(*next_end);
  if (plan_again_) wake_at(*plan_again_);
  if (const auto due = pace_.due()) wake_at(*due);
  return next ? std::max(*next - now, std::chrono::nanoseconds(0)) : no_end;
}

DdsResult<void> Bridge::run() {
  graph_thread_ = std::thread([this] { watch_graph(); });
  const bool is_watched = options_.alive && options_.alive_interval > std::chrono::nanoseconds(0);
  const std::chrono::nanoseconds longest = is_watched ? options_.alive_interval : no_end;
  while (!stops_) {
    const auto ready = participant_->wait(std::min(longest, tidy()));
    if (!ready) return tl::unexpected(ready.error());
    if (is_watched) options_.alive();
    // Discovery first: who has written is known before what he has written.
    if (ready->discovery) note(participant_->discovered());
    if (ready->discovery || std::find(ready->readers.begin(), ready->readers.end(),
                                      ros_graph_->reader()) != ready->readers.end()) {
      if (const auto others = ros_graph_->update(); !others)
        refusals_.note("ros_discovery_info", others.error().text());
      if (const std::uint64_t count = ros_graph_->refused();
          count > discovery_info_refused_ && tells_discovery_info_.now()) {
        discovery_info_refused_ = count;
        log_.write(LogLevel::warning, "malformed ros_discovery_info",
                   {{"refused", std::to_string(count)}});
      }
    }
    // Each of them renews something: none may be left out because another one has changed.
    const bool is_local_new = renew_local();
    const bool are_rules_new = renew_rules();
    const bool is_time = plan_again_ && *plan_again_ <= std::chrono::steady_clock::now();
    const bool has_changed = is_local_new || are_rules_new || is_time;
    // The plan may end some of them; inward_ knows which are left.
    const std::vector<DdsReader*> readers(ready->readers.begin(), ready->readers.end());
    if (has_changed || pace_.is_due(std::chrono::steady_clock::now())) look_around();
    for (DdsReader* const reader : readers) {
      if (inward_.has(reader)) take_from(*reader);
    }
    services_.move(readers);
    tell_limits();
    answer_status();
  }
  graph_.interrupt();
  graph_thread_.join();
  if (failed_) std::rethrow_exception(failed_);
  if (is_revoked_) throw std::runtime_error("agnocastd has revoked this process, its log says why");
  return {};
}

void Bridge::set_rules(std::vector<Rule> rules, Direction otherwise, bool announce) {
  const std::lock_guard lock(mutex_);
  next_rules_ = Rules{std::move(rules), otherwise, announce};
  participant_->interrupt();
}

bool Bridge::renew_rules() {
  const std::lock_guard lock(mutex_);
  if (!next_rules_) return false;
  rules_ = *std::exchange(next_rules_, std::nullopt);
  return true;
}

std::optional<BridgeStatus> Bridge::status(std::chrono::milliseconds patience) {
  std::unique_lock lock(mutex_);
  answer_.reset();
  is_asked_ = true;
  participant_->interrupt();
  answered_.wait_for(lock, patience, [this] { return answer_.has_value(); });
  is_asked_ = false;
  return std::exchange(answer_, std::nullopt);
}

void Bridge::tell_limits() {
  const Limits& limits = participant_->limits();
  std::uint64_t all = 0;
  for (const LimitRow& row : limit_table) all += limits.refused(row.limit);
  if (all == limits_told_ || !tells_limits_.now()) return;
  limits_told_ = all;
  std::string text;
  for (const LimitRow& row : limit_table) {
    if (const std::uint64_t refused = limits.refused(row.limit); refused != 0)
      text += (text.empty() ? "" : ", ") + std::string(row.name) + ' ' + std::to_string(refused);
  }
  log_.write(LogLevel::warning, "beyond a limit", {{"refused", text}});
}

void Bridge::answer_status() {
  {
    const std::lock_guard lock(mutex_);
    if (!is_asked_) return;
  }
  BridgeStatus now = look();
  const std::lock_guard lock(mutex_);
  answer_ = std::move(now);
  answered_.notify_all();
}

BridgeStatus Bridge::look() const {
  BridgeStatus now;
  now.domain = options_.domain;
  now.layout = ros_graph_->layout();
  const ConnectionState connection = connection_state();
  now.has_daemon = daemon_ == Daemon::there && connection != ConnectionState::reconnecting &&
                   connection != ConnectionState::island;
  now.standby_for = standby_for_;
  outward_.look(now);
  for (const LimitRow& row : limit_table)
    now.limits.push_back({row.name, row.most, participant_->limits().refused(row.limit)});
  now.discovery_info_refused = ros_graph_->refused();
  now.since_ns = since_ns_;
  for (const auto& [guid, remote] : participant_->remotes())
    now.participants += remote.kind == Remote::Kind::participant;
  inward_.look(now, ros_graph_->others());
  now.services = services_.look();
  now.unbridged = unbridged_;
  now.failures.assign(refusals_.now().begin(), refusals_.now().end());
  return now;
}

// A writer that came and went since the last look may have been matched with an inlet that was there already: it
// gets its source, which then lingers.
void Bridge::note(const std::vector<RemoteChange>& changes) {
  if (!changes.empty()) pace_.changed();
  for (const RemoteChange& change : changes) {
    const Remote& remote = change.remote;
    if (!change.is_there && remote.kind == Remote::Kind::writer &&
        !inward_.has_source(remote.guid) && gone_writers_.size() < gone_writers_max)
      gone_writers_.push_back(remote);
  }
}

void Bridge::look_around() {
  plan_again_.reset();
  // While the daemon is away whatever is made here would wait for it, and everything that flows for this thread.
  if (connection_state() == ConnectionState::reconnecting) {
    plan_again_ = std::chrono::steady_clock::now() + daemon_interval;
    return pace_.put_off(*plan_again_);
  }
  const std::vector<Remote> gone = std::exchange(gone_writers_, {});
  const Time begin = std::chrono::steady_clock::now();
  bool is_whole = true;
  if (!gone.empty()) {
    DdsParticipant::Remotes with_gone = participant_->remotes();
    for (const Remote& remote : gone) with_gone.emplace(remote.guid, remote);
    is_whole = plan_and_apply(with_gone);
  }
  is_whole = is_whole && plan_and_apply(participant_->remotes());
  const Time end = std::chrono::steady_clock::now();
  if (is_whole) {
    pace_.made(begin, end);
  } else {
    pace_.changed();
    pace_.put_off(end + daemon_interval);
    gone_writers_ = gone;
  }
  inward_.publish_unplaced();
}

bool Bridge::plan_and_apply(const DdsParticipant::Remotes& remotes) {
  is_cut_short_ = false;
  const bool was_active = !standby_for_;
  const Role role = find_role();
  if (role == Role::unknown) {
    if (marker_ == nullptr) plan_again_ = std::chrono::steady_clock::now() + daemon_interval;
    if (no_marker_ && no_marker_->code != Errc::daemon_not_running)
      refusals_.note(marker_task, no_marker_->why);
    return false;
  }
  if (role == Role::standby && was_active) stand_by();
  refusals_.begin_plan();
  if (no_marker_) refusals_.note(marker_task, no_marker_->why);
  const Situation situation{options_.domain,
                            local_.endpoints,
                            &remotes,
                            rules_.list,
                            [this](const std::string& type) { return types_.problem_of(type); },
                            rules_.otherwise,
                            [this](const Guid& writer) { return inward_.has_source(writer); },
                            rules_.announce};
  const bool is_active = role == Role::active;
  const Plan plan = is_active ? plan_of(situation) : Plan();
  const ServicePlan services = is_active ? plan_services(situation) : ServicePlan();
  outward_.end_changed(plan);
  inward_.end_changed(plan);
  (void)gives_up(outward_.apply(plan, local_.endpoints));
  const InwardRoutes::Applied inward = inward_.apply(plan);
  if (inward.again) plan_again_ = inward.again;
  (void)gives_up(inward.refusal);
  (void)gives_up(services_.apply(services));
  tell_ros(plan);
  unbridged_ = plan.unbridged;
  unbridged_.insert(unbridged_.end(), services.unbridged.begin(), services.unbridged.end());
  return !is_cut_short_;
}

// agnocastd does not answer, and each call waits for it: what is left of the plan is for later.
bool Bridge::gives_up(Errc why) {
  if (why != Errc::daemon_not_running) return false;
  is_cut_short_ = true;
  plan_again_ = std::chrono::steady_clock::now() + daemon_interval;
  return true;
}

void Bridge::take_from(DdsReader& inlet) {
  std::vector<DdsSample> taken = InwardRoutes::take(inlet);
  // Of a writer that came since run() looked.
  if (inward_.has_strangers(taken)) {
    note(participant_->discovered());
    if (pace_.is_due(std::chrono::steady_clock::now())) look_around();
  }
  inward_.publish(&inlet, std::move(taken));
}

void Bridge::tell_ros(const Plan& plan) {
  std::map<std::pair<std::string, std::string>, RosNode> nodes;
  NodesByName by_name;
  // By which other bridges know this one.
  nodes[{"/", std::string(bridge_node)}] = {"/", std::string(bridge_node), {}, {}};
  for (const EndpointInfo& endpoint : local_.endpoints) {
    if (standby_for_) break;
    if (endpoint.domain != options_.domain || is_bridge(endpoint)) continue;
    RosNode& node = nodes[{endpoint.node_namespace, endpoint.node_name}];
    node.name_space = endpoint.node_namespace;
    node.name = endpoint.node_name;
    by_name[full_name_of(endpoint)] = &node;
  }
  outward_.tell(by_name);
  inward_.tell(plan, by_name);
  services_.tell(by_name);
  std::vector<RosNode> list;
  for (auto& [name, node] : nodes) list.push_back(std::move(node));
  if (const auto said = ros_graph_->set_nodes(std::move(list)); !said)
    refusals_.note("ros_discovery_info", said.error().text());
}

}  // namespace agnocast::bridge
