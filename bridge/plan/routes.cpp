// SPDX-License-Identifier: Apache-2.0

#include <bridge/plan/routes.hpp>

#include <agnocast/service_name.hpp>
#include <bridge/dds/names.hpp>

#include <algorithm>
#include <utility>

namespace agnocast::bridge {
namespace {

// The depth assumed for a history that is not announced: DDS need not announce it, and only
// Cyclone does.
constexpr std::size_t unknown_depth = 10;
// A keep-last reader counts the messages of all its writers together; messages that come while the
// bridge creates endpoints must not displace earlier ones.
constexpr std::size_t dds_reader_depth_min = 100;
/// In few steps, because another depth makes a new DDS reader.
std::size_t dds_reader_depth_of(std::size_t wanted) noexcept {
  std::size_t depth = dds_reader_depth_min;
  while (depth < wanted) depth *= 2;
  return depth;
}

const QosOverride no_override;

/// Subscriptions of one class, with the same requests to every writer.
struct Wanting {
  std::size_t depth = 1;
  bool keep_all = false;
  std::set<std::string> nodes;
};
/// All endpoints of one topic name, by ROS types.
struct Side {
  std::map<std::string, std::vector<const EndpointInfo*>> publishers;
  std::map<std::string, std::map<QosClass, Wanting>> subscriptions;
  std::map<std::string, std::vector<const Remote*>> writers;
  std::map<std::string, std::set<QosClass>> readers;
};

QosClass class_of(const QoS& qos) noexcept {
  return {qos.is_reliable() && !qos.is_best_available(), qos.is_transient_local()};
}
QosClass class_of(const DdsQos& qos) noexcept { return {qos.reliable, qos.transient_local}; }

/// 0 is none here, and infinite in DDS.
std::chrono::nanoseconds dds_time(std::chrono::nanoseconds time) noexcept {
  return time.count() == 0 ? DdsQos::infinite : time;
}
std::chrono::nanoseconds own_time(std::chrono::nanoseconds time) noexcept {
  return time == DdsQos::infinite ? std::chrono::nanoseconds(0)
                                  : std::max(time, std::chrono::nanoseconds(1));
}

/// DDS 1.4, 2.2.3: the offer must be at least the request.
bool serves(const QosClass& offered, const QosClass& requested) noexcept {
  return (offered.reliable || !requested.reliable) &&
         (offered.transient_local || !requested.transient_local);
}

/// Keep-all has agnocast's bound, which no depth may exceed.
std::size_t depth_of(const DdsQos& qos) noexcept {
  const std::size_t most = QoS(1).keep_all().depth();
  if (qos.keep_all) return most;
  return qos.depth < 1 ? unknown_depth : std::min(static_cast<std::size_t>(qos.depth), most);
}

QosClass overridden(QosClass own, const QosOverride& by_rule) noexcept {
  return {by_rule.reliable.value_or(own.reliable),
          by_rule.transient_local.value_or(own.transient_local)};
}

class Planner {
 public:
  explicit Planner(const Situation& situation) : situation_(situation) {}

  Plan plan() {
    gather();
    for (const auto& [topic, side] : sides_) {
      outward(topic, side);
      inward(topic, side);
    }
    return std::move(plan_);
  }

 private:
  void gather() {
    for (const Rule& rule : situation_.rules) {
      if (rule.always && !rule.type.empty()) sides_[rule.topic].subscriptions[rule.type];
    }
    for (const EndpointInfo& endpoint : situation_.local) {
      if (endpoint.domain != situation_.domain || is_bridge(endpoint) ||
          is_service_topic(endpoint.topic))
        continue;
      Side& side = sides_[endpoint.topic];
      if (endpoint.kind == EndpointKind::publisher) {
        side.publishers[endpoint.type].push_back(&endpoint);
      } else {
        Wanting& wanting = side.subscriptions[endpoint.type][class_of(endpoint.qos)];
        wanting.depth = std::max(wanting.depth, endpoint.qos.depth());
        wanting.keep_all |= endpoint.qos.is_keep_all();
        wanting.nodes.insert(full_name_of(endpoint));
      }
    }
    for (const auto& [guid, remote] : *situation_.remote) {
      if (remote.kind == Remote::Kind::participant) continue;
      const auto topic = ros_topic_of(remote.topic);
      const auto type = ros_type_of(remote.type);
      if (!topic || topic->kind != DdsTopicKind::topic || !type) continue;
      const auto found = sides_.find(topic->name);  // only names of this host or a rule
      if (found == sides_.end()) continue;
      if (remote.kind == Remote::Kind::writer) {
        found->second.writers[*type].push_back(&remote);
      } else {
        found->second.readers[*type].insert(class_of(remote.qos));
      }
    }
  }

  void outward(const std::string& topic, const Side& side) {
    for (const auto& [type, publishers] : side.publishers) {
      const TopicKey key{topic, type};
      const Verdict verdict = verdict_on(key);
      const QosOverride& by_rule = verdict.rule == nullptr ? no_override : verdict.rule->to_dds;
      const bool is_announced = may_be_announced(key, verdict);
      if (!is_open(key, Direction::outward, verdict, side.readers, WhyNot::no_reader)) {
        for (const EndpointInfo* const publisher : publishers) {
          if (is_announced)
            plan_.announced[publisher->generation] = dds_writer_of(key, *publisher, by_rule);
        }
        continue;
      }
      const auto readers = side.readers.find(type);
      const auto is_read = [&](const QosClass& offered) {
        return readers != side.readers.end() &&
               std::any_of(readers->second.begin(), readers->second.end(),
                           [&](const QosClass& wanted) { return serves(offered, wanted); });
      };
      bool any = false;
      for (const EndpointInfo* const publisher : publishers) {
        DdsWriterPlan dds_writer = dds_writer_of(key, *publisher, by_rule);
        if (!is_always(verdict) && !is_read(dds_writer.offered)) {
          if (is_announced) plan_.announced[publisher->generation] = std::move(dds_writer);
          continue;
        }
        any = true;
        plan_.local_readers.insert(dds_writer.local_reader);
        plan_.dds_writers[publisher->generation] = std::move(dds_writer);
      }
      if (!any) not_bridged(key, Direction::outward, WhyNot::qos, "no reader in DDS matches");
    }
  }

  static DdsWriterPlan dds_writer_of(const TopicKey& key, const EndpointInfo& publisher,
                                     const QosOverride& by_rule) {
    const QosClass own = class_of(publisher.qos);
    const std::size_t depth = publisher.qos.depth();
    const bool keep_all = publisher.qos.is_keep_all();
    return {{{key, own}, depth, keep_all},
            keep_all && !by_rule.depth,
            by_rule.depth.value_or(depth),
            full_name_of(publisher),
            overridden(own, by_rule),
            {dds_time(publisher.qos.deadline()), dds_time(publisher.qos.lifespan())}};
  }
  /// Returns whether a later reader would get the topic: only then it is announced.
  bool may_be_announced(const TopicKey& key, const Verdict& verdict) {
    return situation_.announce && goes(verdict.direction, Direction::outward) &&
           has_ros_name(key) && !problem_of(key.type);
  }

  void inward(const std::string& topic, const Side& side) {
    for (const auto& [type, subscriptions] : side.subscriptions)
      inward({topic, type}, side, subscriptions);
  }
  // Long because DDS readers and remote publishers are planned from the same writers and classes of
  // QoS.
  void inward(const TopicKey& key, const Side& side,
              const std::map<QosClass, Wanting>& subscriptions) {
    const Verdict verdict = verdict_on(key);
    const bool is_wanted_always = is_always(verdict) && goes(verdict.direction, Direction::inward);
    if (subscriptions.empty() && !is_wanted_always) return;
    const QosOverride& by_rule = verdict.rule == nullptr ? no_override : verdict.rule->from_dds;
    std::map<QosClass, DdsReaderPlan> dds_readers;
    const auto dds_reader_of = [&](const QosClass& qos_class, std::size_t depth) -> DdsReaderPlan& {
      DdsReaderPlan& dds_reader = dds_readers[qos_class];
      dds_reader.requested = overridden(qos_class, by_rule);
      dds_reader.depth =
          by_rule.depth.value_or(std::max(dds_reader.depth, dds_reader_depth_of(depth)));
      return dds_reader;
    };
    bool any = false;
    const bool is_there = is_open(key, Direction::inward, verdict, side.writers, WhyNot::no_writer);
    if (is_there) {
      const auto found = side.writers.find(key.type);
      std::vector<std::pair<const Remote*, QosClass>>
          places;  // writers, and the classes of their DDS readers
      std::map<QosClass, std::set<QosClass>> served_by;
      for (const Remote* const writer :
           found == side.writers.end() ? std::vector<const Remote*>() : found->second) {
        const QosClass offered = class_of(writer->qos);
        std::set<QosClass> served;
        QosClass wanted{false, false};  // the strongest request
        for (const auto& [own, wanting] : subscriptions) {
          if (!serves(offered, own)) continue;
          served.insert(own);
          wanted = {wanted.reliable || own.reliable, wanted.transient_local || own.transient_local};
        }
        if (served.empty() && !is_always(verdict)) continue;
        if (served.empty()) wanted = offered;
        if (!serves(offered, overridden(wanted, by_rule))) continue;
        places.emplace_back(writer, wanted);
        served_by[wanted].merge(served);
      }
      any = !places.empty();
      choose(key, places);
      for (const auto& [writer, wanted] : places) {
        const std::size_t depth = depth_of(writer->qos);
        plan_.remote_publishers[writer->guid] = {
            key,    class_of(writer->qos),
            depth,  writer->qos.keep_all,
            wanted, {writer->qos.deadline, writer->qos.lifespan}};
        dds_reader_of(wanted, depth).keep_all |= writer->qos.keep_all && !by_rule.depth;
      }
      for (const auto& [qos_class, served] : served_by) {
        for (const QosClass& own : served) {
          const Wanting& wanting = subscriptions.at(own);
          dds_reader_of(qos_class, wanting.depth)
              .nodes.insert(wanting.nodes.begin(), wanting.nodes.end());
        }
      }
      if (is_always(verdict) && found == side.writers.end()) {
        any = true;
        QosClass wanted;
        if (!subscriptions.empty()) wanted = subscriptions.begin()->first;
        DdsReaderPlan& dds_reader = dds_reader_of(overridden(wanted, by_rule), unknown_depth);
        for (const auto& [own, wanting] : subscriptions)
          dds_reader.nodes.insert(wanting.nodes.begin(), wanting.nodes.end());
      }
      if (!any) not_bridged(key, Direction::inward, WhyNot::qos, "no writer in DDS matches");
    }
    // DDS readers for writers that are still to come.
    if (goes(verdict.direction, Direction::inward) && has_ros_name(key) && !problem_of(key.type)) {
      for (const auto& [wanted, wanting] : subscriptions) {
        const QosClass own = wanted;
        const bool is_read =
            std::any_of(dds_readers.begin(), dds_readers.end(), [&](const auto& dds_reader) {
              return dds_reader.first != own &&
                     dds_reader.second.requested == overridden(own, by_rule);
            });
        if (is_read) continue;
        DdsReaderPlan& dds_reader = dds_reader_of(own, wanting.depth);
        dds_reader.keep_all |= wanting.keep_all && !by_rule.depth;
        dds_reader.nodes.insert(wanting.nodes.begin(), wanting.nodes.end());
      }
    }
    for (auto& [qos_class, dds_reader] : dds_readers) {
      if (dds_reader.keep_all)
        dds_reader.depth = dds_reader_depth_min;  // depth has no meaning for keep-all
      plan_.dds_readers[{key, qos_class}] = std::move(dds_reader);
    }
  }

  /// Writers with a remote publisher keep it, so that nobody displaces another's, except those of
  /// a participant beyond its share.
  void choose(const TopicKey& key, std::vector<std::pair<const Remote*, QosClass>>& writers) {
    if (writers.size() <= remote_publishers_per_topic_max) return;
    using Writer = std::pair<const Remote*, QosClass>;
    const auto has_remote_publisher = [&](const Writer& writer) {
      return situation_.has_remote_publisher && situation_.has_remote_publisher(writer.first->guid);
    };
    std::sort(writers.begin(), writers.end(), [&](const Writer& a, const Writer& b) {
      return std::pair(!has_remote_publisher(a), a.first->guid) <
             std::pair(!has_remote_publisher(b), b.first->guid);
    });
    std::map<Guid, std::size_t> of_participant;
    std::stable_partition(writers.begin(), writers.end(), [&](const Writer& writer) {
      return ++of_participant[writer.first->participant] <= remote_publishers_of_participant_share;
    });
    not_bridged(key, Direction::inward, WhyNot::too_many,
                std::to_string(writers.size() - remote_publishers_per_topic_max) + " of " +
                    std::to_string(writers.size()) +
                    " writers do not fit: the limit for a topic is " +
                    std::to_string(remote_publishers_per_topic_max));
    writers.resize(remote_publishers_per_topic_max);
  }

  Verdict verdict_on(const TopicKey& key) const {
    return verdict_of(situation_.rules, key.topic, key.type, situation_.otherwise);
  }
  static bool is_always(const Verdict& verdict) noexcept {
    return verdict.rule != nullptr && verdict.rule->always;
  }

  /// Returns whether there is anything to bridge; records the reason if not.
  template <class Others>
  bool is_open(const TopicKey& key, Direction way, const Verdict& verdict, const Others& others,
               WhyNot nobody) {
    if (!goes(verdict.direction, way)) {
      not_bridged(key, way, WhyNot::rule, reason_of(verdict));
      return false;
    }
    if (!has_ros_name(key)) {
      not_bridged(key, way, WhyNot::no_ros_name, "not the name of a ROS message type: " + key.type);
      return false;
    }
    if (!others.contains(key.type) && !is_always(verdict)) {
      if (!others.empty()) {
        not_bridged(key, way, WhyNot::other_type, "in DDS it is " + others.begin()->first);
        return false;
      }
      // Another bridge waits for a reader, and nobody creates readers for an unknown type.
      const bool is_unknown = way == Direction::inward && problem_of(key.type);
      not_bridged(
          key, way, nobody,
          is_unknown ? "its message type is not available here: " + *problem_of(key.type) : "");
      return false;
    }
    const std::optional<std::string>& problem = problem_of(key.type);
    if (problem) not_bridged(key, way, WhyNot::unknown_type, *problem);
    return !problem;
  }
  static bool has_ros_name(const TopicKey& key) {
    return dds_type_of(key.type) && dds_topic_of({DdsTopicKind::topic, key.topic});
  }
  const std::optional<std::string>& problem_of(const std::string& type) {
    const auto [problem, is_new] = problems_.try_emplace(type);
    if (is_new) problem->second = situation_.problem_of_type(type);
    return problem->second;
  }
  void not_bridged(const TopicKey& key, Direction way, WhyNot why, std::string detail) {
    plan_.unbridged.push_back({key.topic, key.type, way, why, std::move(detail)});
  }

  const Situation& situation_;
  std::map<std::string, Side> sides_;
  std::map<std::string, std::optional<std::string>> problems_;
  Plan plan_;
};

}  // namespace

DdsQos dds_qos_of(const QosClass& qos_class, std::size_t depth, bool keep_all,
                  const QosTimes& times) {
  DdsQos qos;
  qos.reliable = qos_class.reliable;
  qos.transient_local = qos_class.transient_local;
  qos.keep_all = keep_all;
  qos.depth = static_cast<std::int32_t>(std::min<std::size_t>(depth, 100'000));
  qos.deadline = times.deadline;
  qos.lifespan = times.lifespan;
  return qos;
}

QoS qos_of(const QosClass& qos_class, std::size_t depth, bool keep_all, const QosTimes& times) {
  QoS qos(depth);
  if (keep_all) qos.keep_all(depth);
  if (!qos_class.reliable) qos.best_effort();
  if (qos_class.transient_local) qos.transient_local();
  return qos.deadline(own_time(times.deadline)).lifespan(own_time(times.lifespan));
}

std::string full_name_of(const EndpointInfo& endpoint) {
  return (endpoint.node_namespace == "/" ? "" : endpoint.node_namespace) + '/' + endpoint.node_name;
}

std::string reason_of(const Verdict& verdict) {
  if (verdict.rule == nullptr) return "no rule matches it, so default decides";
  return "the rule \"" + verdict.rule->topic + "\" in line " + std::to_string(verdict.rule->line);
}

Plan plan_of(const Situation& situation) { return Planner(situation).plan(); }

}  // namespace agnocast::bridge
