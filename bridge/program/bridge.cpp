// SPDX-License-Identifier: Apache-2.0

#include <bridge/program/bridge.hpp>

#include <bridge/common/room.hpp>
#include <bridge/dds/names.hpp>

#include <agnocast/heap.hpp>

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
// What is taken of one reader before others have their turn; of one that is left, all that it may have, but for one that
// keeps all and gets more meanwhile.
constexpr std::size_t takes_max = 64, former_takes_max = 10'000;
// What keep-all may hold up of one writer, beside its publisher's own queue. More is dropped: messages of a DDS
// reader that does not take would hold up all topics.
constexpr std::size_t held_up_max = 1'000;
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
  sources_.clear();
  history_bytes_ = 0;
  unplaced_.clear();
  held_.clear();
  held_bytes_ = 0;
  erase_inlets_if([](const ReaderKey&, const OpenInlet&) { return true; });
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
  if (!held_.empty() && next_room_look_ <= now) {
    room_interval_ = room_interval_after(room_interval_, publish_waiting());
    next_room_look_ = now + room_interval_;
  }
  if (!held_.empty()) wake_at(next_room_look_);
  if (settle_at_ && *settle_at_ <= now) {
    settle_at_ = end_sources(now);
  }
  if (settle_at_) wake_at(*settle_at_);
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
    // The plan may end some of them; inlet_of_ knows which are left.
    const std::vector<DdsReader*> readers(ready->readers.begin(), ready->readers.end());
    if (has_changed || pace_.is_due(std::chrono::steady_clock::now())) look_around();
    for (DdsReader* const reader : readers) {
      if (inlet_of_.contains(reader)) take_from(*reader);
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

// QoS of an endpoint in DDS cannot change while it lives.
void Bridge::end_changed(const Plan& plan) {
  std::set<ReaderKey> ended;
  erase_inlets_if([&](const ReaderKey& key, const OpenInlet& inlet) {
    const auto wanted = plan.inlets.find(key.of);
    return wanted != plan.inlets.end() && wanted->second.requested != inlet.plan.requested &&
           ended.insert(key).second;
  });
  // Who reads in its place may get a history that has come.
  const Time end = std::chrono::steady_clock::now() + linger;
  for (auto& [writer, source] : sources_) {
    if (source.former_inlet && ended.contains(*source.former_inlet)) source.former_inlet.reset();
    if (!ended.contains(source.inlet)) continue;
    source.has_begun = false;
    source.former_end = end;
  }
}

template <class Condition>
void Bridge::erase_inlets_if(Condition condition) {
  std::erase_if(inlets_, [&](const auto& entry) {
    if (!condition(entry.first, entry.second)) return false;
    inlet_of_.erase(entry.second.reader.get());
    return true;
  });
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
  std::map<Guid, std::string> node_of;
  for (const auto& [participant, entities] : ros_graph_->others()) {
    for (const RosNode& node : entities.nodes) {
      for (const Guid& writer : node.writers) {
        if (sources_.contains(writer))
          node_of[writer] = (node.name_space == "/" ? "" : node.name_space) + '/' + node.name;
      }
    }
  }
  for (const auto& [writer, source] : sources_) {
    const auto node = node_of.find(writer);
    now.sources.push_back({source.plan, writer,
                           node == node_of.end() ? std::string() : node->second,
                           source.traffic.numbers()});
  }
  for (const auto& [key, inlet] : inlets_) {
    now.inlets.push_back({key.of, inlet.plan, inlet.reader->guid(), inlet.reader->matched(),
                          inlet.reader->incompatible(), inlet.reader->refused(),
                          inlet.without_source, inlet.reader->overflow()});
  }
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
        !sources_.contains(remote.guid) && gone_writers_.size() < gone_writers_max)
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
  publish_unplaced();
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
                            [this](const Guid& writer) { return sources_.contains(writer); },
                            rules_.announce};
  const bool is_active = role == Role::active;
  const Plan plan = is_active ? plan_of(situation) : Plan();
  const ServicePlan services = is_active ? plan_services(situation) : ServicePlan();
  outward_.end_changed(plan);
  end_changed(plan);
  (void)gives_up(outward_.apply(plan, local_.endpoints));
  apply_inward(plan);
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

// A writer's last messages may come after the word that it is gone, so its source lingers.
void Bridge::apply_inward(const Plan& plan) {
  const Time end = std::chrono::steady_clock::now() + linger;
  const auto reader_of = [&](const ClassKey& key) {
    const Inlet& inlet = plan.inlets.at(key);
    return ReaderKey{key, inlet.depth, inlet.keep_all};
  };
  std::map<TopicKey, std::size_t> counts;
  for (const auto& [writer, source] : sources_) ++counts[source.plan.key];
  // Publishers first: with them the process has a shared heap, into which inlets read.
  for (const auto& [writer, source] : plan.sources) {
    const ReaderKey inlet = reader_of({source.key, source.inlet});
    if (const auto old = sources_.find(writer); old != sources_.end()) {
      old->second.end.reset();
      old->second.plan = source;
      if (old->second.inlet != inlet) {
        go_over(old->second, inlet, end);
      }
      continue;
    }
    // Those that linger have places still.
    std::size_t& count = counts[source.key];
    if (count >= sources_per_topic_max) {
      refusals_.note("new writer of " + source.key.topic, "those that are gone have places still");
      plan_again_ = end;
      continue;
    }
    auto made = make_publisher(source, source.depth);
    if (!made) {
      refusals_.note("publisher of " + source.key.topic, text_of(made.error()));
      if (gives_up(made.error().code)) break;
      continue;
    }
    ++count;
    OpenSource& open = sources_[writer];
    open.plan = source;
    open.publisher = std::move(*made);
    open.depth = source.depth;
    open.inlet = inlet;
    // What looked out for it may have read already what the new one is too late for; of a history that has all.
    const auto looks_out = inlets_.lower_bound({inlet.of, 0, false});
    if (!source.inlet.transient_local && !inlets_.contains(inlet) && looks_out != inlets_.end() &&
        looks_out->first.of == inlet.of) {
      open.has_begun = false;
      open.former_inlet = looks_out->first;
      open.former_end = end;
    }
  }
  std::set<ReaderKey> planned;
  for (const auto& [of, inlet] : plan.inlets) {
    const ReaderKey key = reader_of(of);
    planned.insert(key);
    if (const auto open = inlets_.find(key); open != inlets_.end()) {
      open->second.plan = inlet;
      continue;
    }
    const TopicKey& topic = of.key;
    auto reader = participant_->create_reader(
        *dds_topic_of({DdsTopicKind::topic, topic.topic}), *dds_type_of(topic.type),
        dds_qos_of(inlet.requested, inlet.depth, inlet.keep_all),
        decoder_of(types_.at(topic.type), topic.topic));
    if (!reader) {
      refusals_.note("reader of " + topic.topic, reader.error().text());
      continue;
    }
    const auto made = inlets_.emplace(key, OpenInlet{std::move(*reader), inlet, false}).first;
    inlet_of_[made->second.reader.get()] = &made->first;
  }
  for (auto& [writer, source] : sources_) {
    if (!source.end && !plan.sources.contains(writer)) source.end = end;
  }
  for (auto& [key, inlet] : inlets_) inlet.is_over = !planned.contains(key);
  for (const Unbridged& each : plan.unbridged) {
    if (each.why == WhyNot::too_many)
      refusals_.note("writers of " + each.topic, "more than the " + std::to_string(sources_per_topic_max) +
                                              " that a topic has room for");
  }
  settle_at_ = std::chrono::steady_clock::now();
}

void Bridge::go_over(OpenSource& source, const ReaderKey& inlet, Time end) {
  if (source.has_begun) source.former_inlet = source.inlet;  // else by the one before that
  source.inlet = inlet;
  source.has_begun = source.former_inlet == inlet;
  if (source.has_begun) source.former_inlet.reset();
  source.former_end = end;
}

void Bridge::take_from(DdsReader& reader) {
  std::vector<DdsSample> taken;
  while (taken.size() < takes_max) {
    auto sample = reader.take();
    if (!sample) break;
    taken.push_back(std::move(*sample));
  }
  // Of a writer that came since run() looked.
  if (std::any_of(taken.begin(), taken.end(),
                  [&](const DdsSample& sample) { return !sources_.contains(sample.writer); })) {
    note(participant_->discovered());
    if (pace_.is_due(std::chrono::steady_clock::now())) look_around();
  }
  const auto known = inlet_of_.find(&reader);
  if (known == inlet_of_.end()) return;
  const ReaderKey& key = *known->second;
  // What came by the inlet that a writer leaves came before.
  std::set<ReaderKey> left;
  for (const DdsSample& sample : taken) {
    const auto source = sources_.find(sample.writer);
    if (source != sources_.end() && source->second.former_inlet && source->second.inlet == key)
      left.insert(*source->second.former_inlet);
  }
  for (const ReaderKey& former : left) {
    const auto inlet = inlets_.find(former);
    if (inlet == inlets_.end()) continue;
    for (std::size_t i = 0; i < former_takes_max; ++i) {
      auto sample = inlet->second.reader->take();
      if (!sample) break;
      publish(former, std::move(*sample));
    }
  }
  for (DdsSample& sample : taken) publish(key, std::move(sample));
}

void Bridge::publish_unplaced() {
  auto unplaced = std::exchange(unplaced_, {});
  for (auto& [inlet, sample] : unplaced) publish(inlet, std::move(sample));
}

void Bridge::publish(const ReaderKey& inlet, DdsSample sample) {
  if (sample.state != DdsSample::State::valid) return;
  const auto source = sources_.find(sample.writer);
  if (source == sources_.end()) {
    if (pace_.is_owed()) {
      if (unplaced_.size() < most_of(Limit::unplaced_messages))
        return void(unplaced_.emplace_back(inlet, std::move(sample)));
      participant_->limits().refuse(Limit::unplaced_messages);
    }
    if (const auto read = inlets_.find(inlet); read != inlets_.end()) ++read->second.without_source;
    return;
  }
  OpenSource& open = source->second;
  const bool is_own = open.inlet == inlet;
  if (!is_own && open.former_inlet != inlet) return;  // the other inlet has it too
  if (is_own && !open.has_begun) {
    if (sample.source_time_ns < open.newest_ns) return;
    open.has_begun = true;
    open.former_inlet.reset();
    if (sample.source_time_ns == open.newest_ns) return;
  }
  open.newest_ns = sample.source_time_ns;
  auto& received = *static_cast<Received*>(sample.object.get());
  if (open.waiting.empty() && publish_now(open, received)) return;
  const std::size_t bytes = held_bytes_of(received.bytes);
  if (open.waiting.size() >= held_up_max || held_bytes_ + bytes > held_bytes_max)
    return drop(open, sentence_of(Errc::would_block));
  if (held_.empty()) next_room_look_ = {};
  held_.insert(sample.writer);
  open.waiting.push_back(std::move(received));
  held_bytes_ += bytes;
}

Result<GenericPublisher::SharedPtr> Bridge::make_publisher(const Source& plan, std::size_t depth) {
  return try_create_generic_publisher(*lanes_[0], plan.key.topic,
                                      types_.at(plan.key.type)->introspected,
                                      qos_of(plan.qos_class, depth, plan.keep_all));
}

void Bridge::forget_history(OpenSource& source) {
  history_bytes_ -= source.history_bytes;
  source.history_bytes = 0;
  source.history.clear();
}

// A writer in DDS says how deep its history is, and fills it: of one that is beyond the limits the publisher is made anew
// with fewer places. Subscriptions get the new one's messages like the former one's; those that come later find less.
bool Bridge::fit_history(OpenSource& source, std::size_t bytes) {
  if (!source.plan.qos_class.transient_local) return true;
  const auto pop = [&] {
    history_bytes_ -= source.history.front();
    source.history_bytes -= source.history.front();
    source.history.pop_front();
  };
  while (source.history.size() >= source.depth) pop();
  Limits& limits = participant_->limits();
  const bool is_own = source.history_bytes + bytes > most_of(Limit::history_bytes_of_source);
  const bool is_all = history_bytes_ + bytes > most_of(Limit::history_bytes);
  if (!source.history.empty() && (is_own || is_all)) {
    limits.refuse(is_own ? Limit::history_bytes_of_source : Limit::history_bytes);
    const std::size_t depth = is_all ? 1 : std::max<std::size_t>(source.history.size() / 2, 1);
    auto made = make_publisher(source.plan, depth);
    if (!made) return false;
    reaper_.end(std::exchange(source.publisher, std::move(*made)));
    source.depth = depth;
    forget_history(source);
  }
  if (history_bytes_ + bytes > most_of(Limit::history_bytes) && history_bytes_ != 0) {
    limits.refuse(Limit::history_bytes);
    return false;
  }
  return true;
}

bool Bridge::publish_now(OpenSource& source, Received& received) {
  if (!fit_history(source, received.bytes)) {
    drop(source, "the histories of writers in DDS take as much as they may");
    return true;
  }
  const PublishResult result = source.publisher->publish(std::move(received.message));
  if (result.code == Errc::would_block) return false;
  if (result) {
    source.traffic.count(received.bytes);
    if (source.plan.qos_class.transient_local) {
      source.history.push_back(received.bytes);
      source.history_bytes += received.bytes;
      history_bytes_ += received.bytes;
    }
  } else {
    drop(source, sentence_of(result.code));
  }
  return true;
}

void Bridge::drop(OpenSource& source, const char* why, std::size_t messages) {
  const std::uint64_t dropped = source.traffic.refused += messages;
  if (!source.traffic.tells.now()) return;
  log_.write(LogLevel::warning, "message not published",
             {{"topic", source.plan.key.topic},
              {"dropped", std::to_string(dropped)},
              {"why", why}});
}

std::optional<Time> Bridge::end_sources(Time now) {
  std::set<ReaderKey> needed;
  std::optional<Time> next;
  const auto wake_at = [&](Time time) { next = next ? std::min(*next, time) : time; };
  for (auto at = sources_.begin(); at != sources_.end();) {
    OpenSource& source = at->second;
    const bool is_late = source.end && *source.end <= now;
    if (is_late && *source.end + held_linger <= now && !source.waiting.empty()) {
      drop(source, sentence_of(Errc::would_block), source.waiting.size());
      for (const Received& received : source.waiting) held_bytes_ -= held_bytes_of(received.bytes);
      source.waiting.clear();
      held_.erase(at->first);
    }
    if (is_late && source.waiting.empty()) {
      forget_history(source);
      reaper_.end(std::move(source.publisher));  // waits for an agnocastd that does not answer
      at = sources_.erase(at);
      continue;
    }
    // What both have had may still be there to be taken of the other one.
    if (source.former_end <= now) source.former_inlet.reset();
    if (source.former_end + linger <= now) source.has_begun = true;
    if (source.end) wake_at(is_late ? now + linger : *source.end);
    if (source.former_inlet) wake_at(source.former_end);
    if (!source.has_begun) wake_at(source.former_end + linger);
    needed.insert(source.inlet);
    if (source.former_inlet) needed.insert(*source.former_inlet);
    ++at;
  }
  erase_inlets_if([&](const ReaderKey& key, const OpenInlet& inlet) {
    return inlet.is_over && !needed.contains(key);
  });
  return next;
}

bool Bridge::publish_waiting() {
  bool any = false;
  std::erase_if(held_, [&](const Guid& writer) {
    OpenSource& source = sources_.at(writer);
    while (!source.waiting.empty()) {
      const std::size_t bytes = held_bytes_of(source.waiting.front().bytes);
      if (!publish_now(source, source.waiting.front())) return false;
      source.waiting.pop_front();
      held_bytes_ -= bytes;
      any = true;
    }
    return true;
  });
  return any;
}

// The message is made in the shared heap: the publisher that it is for is known only when it is taken.
RawDecoder Bridge::decoder_of(std::shared_ptr<const BridgedType> type, const std::string& topic) {
  struct Refused {
    std::atomic<std::uint64_t> count{0};
    Seldom tells;
  };
  return [this, type = std::move(type), topic, refused = std::make_shared<Refused>(),
          starved = std::make_shared<Refused>()](RawPieces pieces) -> std::shared_ptr<void> {
    std::shared_ptr<Received> received;
    const auto read = [&] {
      try {
        received = std::make_shared<Received>();
        const SharedHeapScope shared;
        received->message = type->introspected.make();
        return read_cdr(type->cdr, pieces, received->message.get());
      } catch (const std::bad_alloc&) {
        const std::uint64_t count = ++starved->count;
        if (starved->tells.now())
          log_.write(LogLevel::warning, "no memory for a message",
                     {{"topic", topic}, {"dropped", std::to_string(count)}});
        throw;
      }
    }();
    if (read) {
      received->bytes = *read;
      return received;
    }
    const std::uint64_t count = ++refused->count;
    if (refused->tells.now())
      log_.write(
          LogLevel::warning, "malformed message",
          {{"topic", topic}, {"refused", std::to_string(count)}, {"why", read.error().text()}});
    return nullptr;
  };
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
  for (const auto& [key, inlet] : plan.inlets) {
    const auto open = inlets_.find({key, inlet.depth, inlet.keep_all});
    if (open == inlets_.end()) continue;
    for (const std::string& name : inlet.nodes) {
      if (const auto node = by_name.find(name); node != by_name.end())
        node->second->readers.push_back(open->second.reader->guid());
    }
  }
  services_.tell(by_name);
  std::vector<RosNode> list;
  for (auto& [name, node] : nodes) list.push_back(std::move(node));
  if (const auto said = ros_graph_->set_nodes(std::move(list)); !said)
    refusals_.note("ros_discovery_info", said.error().text());
}

}  // namespace agnocast::bridge
