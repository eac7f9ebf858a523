// SPDX-License-Identifier: Apache-2.0

#include <bridge/inward/inward_routes.hpp>

#include <bridge/dds/names.hpp>

#include <agnocast/heap.hpp>

#include <algorithm>
#include <atomic>
#include <new>
#include <set>

namespace agnocast::bridge {
namespace {

// Bounds for one take from a reader before others get their turn; a reader that is being left
// gives all, bounded in case it keeps all and gets more meanwhile.
constexpr std::size_t takes_max = 64, former_takes_max = 10'000;

}  // namespace

template <class Condition>
void InwardRoutes::erase_inlets_if(Condition condition) {
  std::erase_if(inlets_, [&](const auto& entry) {
    if (!condition(entry.first, entry.second)) return false;
    inlet_of_.erase(entry.second.reader.get());
    return true;
  });
}

void InwardRoutes::end_changed(const Plan& plan) {
  std::set<ReaderKey> ended;
  erase_inlets_if([&](const ReaderKey& key, const OpenInlet& inlet) {
    const auto wanted = plan.inlets.find(key.of);
    return wanted != plan.inlets.end() && wanted->second.requested != inlet.plan.requested &&
           ended.insert(key).second;
  });
  const Time end = std::chrono::steady_clock::now() + linger;
  for (auto& [writer, source] : sources_.all()) source.way.end_inlets(ended, end);
}

void InwardRoutes::end_all() {
  sources_.clear();
  unplaced_.clear();
  erase_inlets_if([](const ReaderKey&, const OpenInlet&) { return true; });
}

ReaderKey InwardRoutes::reader_of(const Plan& plan, const ClassKey& key) {
  const Inlet& inlet = plan.inlets.at(key);
  return {key, inlet.depth, inlet.keep_all};
}

// Publishers first: they give the process a shared heap, into which DDS readers read.
InwardRoutes::Applied InwardRoutes::apply(const Plan& plan) {
  Applied applied;
  open_sources(plan, applied);
  open_inlets(plan);
  for (const Unbridged& each : plan.unbridged) {
    if (each.why == WhyNot::too_many)
      refusals_.note(
          "writers of " + each.topic,
          "more than the " + std::to_string(sources_per_topic_max) + " that a topic may have");
  }
  settle_at_ = std::chrono::steady_clock::now();
  return applied;
}

// A writer's last messages may come after its end is known, so its remote publisher lingers.
void InwardRoutes::open_sources(const Plan& plan, Applied& applied) {
  const Time end = std::chrono::steady_clock::now() + linger;
  std::map<TopicKey, std::size_t> counts;
  for (auto& [writer, source] : sources_.all()) {
    ++counts[source.plan.key];
    if (!source.end && !plan.sources.contains(writer)) source.end = end;
  }
  for (const auto& [writer, source] : plan.sources) {
    const ReaderKey inlet = reader_of(plan, {source.key, source.inlet});
    if (const auto old = sources_.all().find(writer); old != sources_.all().end()) {
      old->second.end.reset();
      old->second.plan = source;
      if (old->second.way.inlet() != inlet) old->second.way.go_over(inlet, end);
      continue;
    }
    // Lingering ones still count.
    std::size_t& count = counts[source.key];
    if (count >= sources_per_topic_max) {
      refusals_.note("new writer of " + source.key.topic,
                     "remote publishers of gone writers still occupy the topic");
      applied.again = end;
      continue;
    }
    const auto made = sources_.open(writer, source);
    if (!made) {
      refusals_.note("publisher of " + source.key.topic, text_of(made.error()));
      applied.refusal = made.error().code;
      if (applied.refusal == Errc::daemon_not_running) break;
      continue;
    }
    ++count;
    Way& way = (*made)->way;
    way = Way(inlet);
    // The reader that waited for it may have messages that the new one misses; a history contains
    // all of them.
    const auto looks_out = inlets_.lower_bound({inlet.of, 0, false});
    if (!source.inlet.transient_local && !inlets_.contains(inlet) && looks_out != inlets_.end() &&
        looks_out->first.of == inlet.of)
      way.begin_with(looks_out->first, end);
  }
}

void InwardRoutes::open_inlets(const Plan& plan) {
  std::set<ReaderKey> planned;
  for (const auto& [of, inlet] : plan.inlets) {
    const ReaderKey key = reader_of(plan, of);
    planned.insert(key);
    if (const auto open = inlets_.find(key); open != inlets_.end()) {
      open->second.plan = inlet;
      continue;
    }
    const TopicKey& topic = of.key;
    auto reader = participant_.create_reader(
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
  for (auto& [key, inlet] : inlets_) inlet.is_over = !planned.contains(key);
}

std::vector<DdsSample> InwardRoutes::take(DdsReader& inlet) {
  std::vector<DdsSample> taken;
  while (taken.size() < takes_max) {
    auto sample = inlet.take();
    if (!sample) break;
    taken.push_back(std::move(*sample));
  }
  return taken;
}

bool InwardRoutes::has_strangers(std::span<const DdsSample> taken) const {
  return std::any_of(taken.begin(), taken.end(),
                     [&](const DdsSample& sample) { return !has_source(sample.writer); });
}

void InwardRoutes::publish(const DdsReader* inlet, std::vector<DdsSample> taken) {
  const auto known = inlet_of_.find(inlet);
  if (known == inlet_of_.end()) return;
  const ReaderKey& key = *known->second;
  publish_former(key, taken);
  for (DdsSample& sample : taken) publish_one(key, std::move(sample));
}

// Messages through the DDS reader that a writer leaves came before.
void InwardRoutes::publish_former(const ReaderKey& inlet, std::span<const DdsSample> taken) {
  std::set<ReaderKey> left;
  for (const DdsSample& sample : taken) {
    const auto source = sources_.all().find(sample.writer);
    if (source == sources_.all().end()) continue;
    const Way& way = source->second.way;
    if (way.former() && way.inlet() == inlet) left.insert(*way.former());
  }
  for (const ReaderKey& former : left) {
    const auto open = inlets_.find(former);
    if (open == inlets_.end()) continue;
    for (std::size_t i = 0; i < former_takes_max; ++i) {
      auto sample = open->second.reader->take();
      if (!sample) break;
      publish_one(former, std::move(*sample));
    }
  }
}

void InwardRoutes::publish_unplaced() {
  auto unplaced = std::exchange(unplaced_, {});
  for (auto& [inlet, sample] : unplaced) publish_one(inlet, std::move(sample));
}

void InwardRoutes::publish_one(const ReaderKey& inlet, DdsSample sample) {
  if (sample.state != DdsSample::State::valid) return;
  const auto source = sources_.all().find(sample.writer);
  if (source != sources_.all().end()) {
    if (source->second.way.takes(inlet, sample.source_time_ns))
      sources_.publish(sample.writer, source->second, *static_cast<Received*>(sample.object.get()));
    return;
  }
  if (pace_.is_owed()) {
    if (unplaced_.size() < most_of(Limit::unplaced_messages))
      return void(unplaced_.emplace_back(inlet, std::move(sample)));
    participant_.limits().refuse(Limit::unplaced_messages);
  }
  if (const auto read = inlets_.find(inlet); read != inlets_.end()) ++read->second.without_source;
}

std::optional<Time> InwardRoutes::tidy(Time now) {
  const std::optional<Time> next_room = sources_.publish_waiting(now);
  if (settle_at_ && *settle_at_ <= now) settle_at_ = settle(now);
  return earliest(next_room, settle_at_);
}

std::optional<Time> InwardRoutes::settle(Time now) {
  const std::optional<Time> next = sources_.tidy(now);
  std::set<ReaderKey> needed;
  for (const auto& [writer, source] : sources_.all()) {
    needed.insert(source.way.inlet());
    if (source.way.former()) needed.insert(*source.way.former());
  }
  erase_inlets_if([&](const ReaderKey& key, const OpenInlet& inlet) {
    return inlet.is_over && !needed.contains(key);
  });
  return next;
}

RawDecoder InwardRoutes::decoder_of(std::shared_ptr<const BridgedType> type,
                                    const std::string& topic) const {
  struct Refused {
    std::atomic<std::uint64_t> count{0};
    Seldom tells;
  };
  return [&log = log_, type = std::move(type), topic, refused = std::make_shared<Refused>(),
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
          log.write(LogLevel::warning, "no memory for a message",
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
      log.write(
          LogLevel::warning, "malformed message",
          {{"topic", topic}, {"refused", std::to_string(count)}, {"why", read.error().text()}});
    return nullptr;
  };
}

void InwardRoutes::tell(const Plan& plan, const NodesByName& nodes) const {
  for (const auto& [key, inlet] : plan.inlets) {
    const auto open = inlets_.find({key, inlet.depth, inlet.keep_all});
    if (open == inlets_.end()) continue;
    for (const std::string& name : inlet.nodes) {
      if (const auto node = nodes.find(name); node != nodes.end())
        node->second->readers.push_back(open->second.reader->guid());
    }
  }
}

void InwardRoutes::look(BridgeStatus& now, const RosGraph::Others& others) const {
  std::map<Guid, std::string> node_of;
  for (const auto& [participant, entities] : others) {
    for (const RosNode& node : entities.nodes) {
      for (const Guid& writer : node.writers) {
        if (has_source(writer))
          node_of[writer] = (node.name_space == "/" ? "" : node.name_space) + '/' + node.name;
      }
    }
  }
  for (const auto& [writer, source] : sources_.all()) {
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
}

}  // namespace agnocast::bridge
