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

// Bound for one take from a reader before others get their turn.
constexpr std::size_t takes_max = 64;
// One that is being left gives all, unless it receives more than this thread publishes.
constexpr std::chrono::seconds takes_all_max{1};

bool gets_history(const QosClass& requested) noexcept {
  return requested.reliable && requested.transient_local;
}

}  // namespace

template <class Condition>
void InwardRoutes::erase_dds_readers_if(Condition condition) {
  std::erase_if(dds_readers_, [&](const auto& entry) {
    if (!condition(entry.first, entry.second)) return false;
    dds_reader_of_.erase(entry.second.reader.get());
    return true;
  });
}

void InwardRoutes::end_changed(const Plan& plan) {
  std::set<ReaderKey> ended;
  for (const auto& [key, dds_reader] : dds_readers_) {
    const auto wanted = plan.dds_readers.find(key.of);
    if (wanted != plan.dds_readers.end() && wanted->second.requested != dds_reader.plan.requested)
      ended.insert(key);
  }
  publish_all_of(ended);
  erase_dds_readers_if(
      [&](const ReaderKey& key, const OpenDdsReader&) { return ended.contains(key); });
  const Time now = std::chrono::steady_clock::now();
  for (auto& [writer, remote_publisher] : remote_publishers_.all())
    remote_publisher.handover.end_dds_readers(ended, now);
}

void InwardRoutes::end_all() {
  remote_publishers_.clear();
  unplaced_.clear();
  erase_dds_readers_if([](const ReaderKey&, const OpenDdsReader&) { return true; });
}

ReaderKey InwardRoutes::reader_of(const Plan& plan, const ClassKey& key) {
  const DdsReaderPlan& dds_reader = plan.dds_readers.at(key);
  return {key, dds_reader.depth, dds_reader.keep_all};
}

// Publishers first: they give the process a shared heap, into which DDS readers read.
InwardRoutes::Applied InwardRoutes::apply(const Plan& plan) {
  Applied applied;
  open_remote_publishers(plan, applied);
  open_dds_readers(plan);
  for (const Unbridged& each : plan.unbridged) {
    if (each.why == WhyNot::too_many)
      refusals_.note("writers of " + each.topic,
                     "more than the " + std::to_string(remote_publishers_per_topic_max) +
                         " that a topic may have");
  }
  settle_at_ = std::chrono::steady_clock::now();
  return applied;
}

// From the creation of a reliable reader until a writer's next heartbeat, Cyclone gives a
// best-effort reader nothing of that writer, and then some messages again.
ReaderHandover::Left InwardRoutes::left_of(const ReaderKey& left, const QosClass& requested) const {
  const auto open = dds_readers_.find(left);
  if (open == dds_readers_.end()) return ReaderHandover::Left::ended;
  return requested.reliable && !open->second.plan.requested.reliable ? ReaderHandover::Left::lossy
                                                                     : ReaderHandover::Left::useful;
}

std::map<ReaderKey, std::vector<OpenRemotePublisher*>> InwardRoutes::leaving(const Plan& plan) {
  std::map<ReaderKey, std::vector<OpenRemotePublisher*>> leaving;
  for (const auto& [writer, remote_publisher] : plan.remote_publishers) {
    const auto open = remote_publishers_.all().find(writer);
    if (open == remote_publishers_.all().end()) continue;
    const ReaderKey next = reader_of(plan, {remote_publisher.key, remote_publisher.dds_reader});
    if (open->second.handover.dds_reader() != next) leaving[next].push_back(&open->second);
  }
  return leaving;
}

// A writer's last messages may come after its end is known, so its remote publisher lingers.
void InwardRoutes::open_remote_publishers(const Plan& plan, Applied& applied) {
  const Time now = std::chrono::steady_clock::now();
  const Time end = now + linger;
  std::map<TopicKey, std::size_t> counts;
  for (auto& [writer, remote_publisher] : remote_publishers_.all()) {
    ++counts[remote_publisher.plan.key];
    if (!remote_publisher.end && !plan.remote_publishers.contains(writer))
      remote_publisher.end = end;
  }
  for (const auto& [writer, remote_publisher] : plan.remote_publishers) {
    const ReaderKey dds_reader =
        reader_of(plan, {remote_publisher.key, remote_publisher.dds_reader});
    if (const auto old = remote_publishers_.all().find(writer);
        old != remote_publishers_.all().end()) {
      old->second.end.reset();
      old->second.plan = remote_publisher;
      continue;
    }
    // Lingering ones still count.
    std::size_t& count = counts[remote_publisher.key];
    if (count >= remote_publishers_per_topic_max) {
      refusals_.note("new writer of " + remote_publisher.key.topic,
                     "remote publishers of gone writers still occupy the topic");
      applied.again = end;
      continue;
    }
    const auto made = remote_publishers_.open(writer, remote_publisher);
    if (!made) {
      refusals_.note("publisher of " + remote_publisher.key.topic, text_of(made.error()));
      applied.refusal = made.error().code;
      if (applied.refusal == Errc::daemon_not_running) break;
      continue;
    }
    ++count;
    ReaderHandover& handover = (*made)->handover;
    handover = ReaderHandover(dds_reader);
    // The reader that waited for it may have messages that the new one misses; a history contains
    // all of them.
    const auto looks_out = dds_readers_.lower_bound({dds_reader.of, 0, false});
    if (!remote_publisher.dds_reader.transient_local && !dds_readers_.contains(dds_reader) &&
        looks_out != dds_readers_.end() && looks_out->first.of == dds_reader.of)
      handover.begin_with(looks_out->first, now);
  }
}

void InwardRoutes::open_dds_readers(const Plan& plan) {
  const auto remote_publishers = leaving(plan);
  std::set<ReaderKey> planned;
  // First those that get the history again: any reliable one makes best-effort ones lossy.
  for (const bool repeats : {true, false}) {
    for (const auto& [of, dds_reader] : plan.dds_readers) {
      if (gets_history(dds_reader.requested) != repeats) continue;
      const ReaderKey key = reader_of(plan, of);
      planned.insert(key);
      const auto found = remote_publishers.find(key);
      open_dds_reader(key, dds_reader,
                      found == remote_publishers.end() ? std::span<OpenRemotePublisher* const>()
                                                       : found->second);
    }
  }
  for (auto& [key, dds_reader] : dds_readers_) dds_reader.is_over = !planned.contains(key);
}

void InwardRoutes::open_dds_reader(const ReaderKey& key, const DdsReaderPlan& plan,
                                   std::span<OpenRemotePublisher* const> remote_publishers) {
  const auto left = [&](const ReaderKey& present) { return left_of(present, plan.requested); };
  std::set<ReaderKey> lossy;
  for (const OpenRemotePublisher* const each : remote_publishers) {
    if (left(each->handover.dds_reader()) == ReaderHandover::Left::lossy)
      lossy.insert(each->handover.dds_reader());
  }
  publish_all_of(lossy);
  if (const auto open = dds_readers_.find(key); open != dds_readers_.end()) {
    open->second.plan = plan;
  } else if (!create_dds_reader(key, plan)) {
    return;
  }
  // What came meanwhile; a history has it too.
  if (!gets_history(plan.requested)) publish_all_of(lossy);
  const Time now = std::chrono::steady_clock::now();
  for (OpenRemotePublisher* const each : remote_publishers)
    each->handover.go_over(key, left, gets_history(plan.requested), now);
}

bool InwardRoutes::create_dds_reader(const ReaderKey& key, const DdsReaderPlan& plan) {
  const TopicKey& topic = key.of.key;
  auto reader = participant_.create_reader(*dds_topic_of({DdsTopicKind::topic, topic.topic}),
                                           *dds_type_of(topic.type),
                                           dds_qos_of(plan.requested, plan.depth, plan.keep_all),
                                           decoder_of(types_.at(topic.type), topic.topic));
  if (!reader) {
    refusals_.note("reader of " + topic.topic, reader.error().text());
    return false;
  }
  const auto made = dds_readers_.emplace(key, OpenDdsReader{std::move(*reader), plan, false}).first;
  dds_reader_of_[made->second.reader.get()] = &made->first;
  return true;
}

std::vector<DdsSample> InwardRoutes::take(DdsReader& dds_reader) {
  std::vector<DdsSample> taken;
  while (taken.size() < takes_max) {
    auto sample = dds_reader.take();
    if (!sample) break;
    taken.push_back(std::move(*sample));
  }
  return taken;
}

bool InwardRoutes::has_unknown_writers(std::span<const DdsSample> taken) const {
  return std::any_of(taken.begin(), taken.end(),
                     [&](const DdsSample& sample) { return !has_remote_publisher(sample.writer); });
}

void InwardRoutes::publish(const DdsReader& dds_reader, std::vector<DdsSample> taken) {
  const ReaderKey& key = *dds_reader_of_.at(&dds_reader);
  publish_former(key, taken);
  for (DdsSample& sample : taken) publish_one(key, std::move(sample));
}

// Messages through the DDS reader that a writer leaves came before.
void InwardRoutes::publish_former(const ReaderKey& dds_reader, std::span<const DdsSample> taken) {
  std::set<ReaderKey> left;
  for (const DdsSample& sample : taken) {
    const auto remote_publisher = remote_publishers_.all().find(sample.writer);
    if (remote_publisher == remote_publishers_.all().end()) continue;
    const ReaderHandover& handover = remote_publisher->second.handover;
    if (handover.former() && handover.dds_reader() == dds_reader) left.insert(*handover.former());
  }
  // Those that were taken already are next.
  std::set<ReaderKey> done{dds_reader};
  for (const ReaderKey& former : left) publish_all_of(former, done);
}

void InwardRoutes::publish_all_of(const std::set<ReaderKey>& dds_readers) {
  std::set<ReaderKey> done;
  for (const ReaderKey& dds_reader : dds_readers) publish_all_of(dds_reader, done);
}

// Recursive: as deep as writers have gone over from one DDS reader to the next within a second.
void InwardRoutes::publish_all_of(const ReaderKey& dds_reader, std::set<ReaderKey>& done) {
  if (!done.insert(dds_reader).second) return;
  std::set<ReaderKey> formers;
  for (const auto& [writer, remote_publisher] : remote_publishers_.all()) {
    const ReaderHandover& handover = remote_publisher.handover;
    if (handover.former() && handover.dds_reader() == dds_reader)
      formers.insert(*handover.former());
  }
  for (const ReaderKey& former : formers) publish_all_of(former, done);
  const auto open = dds_readers_.find(dds_reader);
  if (open == dds_readers_.end()) return;
  const Time end = std::chrono::steady_clock::now() + takes_all_max;
  do {
    auto sample = open->second.reader->take();
    if (!sample) return;
    publish_one(dds_reader, std::move(*sample));
  } while (std::chrono::steady_clock::now() < end);
}

void InwardRoutes::publish_unplaced() {
  auto unplaced = std::exchange(unplaced_, {});
  for (auto& [dds_reader, sample] : unplaced) publish_one(dds_reader, std::move(sample));
}

void InwardRoutes::publish_one(const ReaderKey& dds_reader, DdsSample sample) {
  if (sample.state != DdsSample::State::valid) return;
  const auto remote_publisher = remote_publishers_.all().find(sample.writer);
  if (remote_publisher != remote_publishers_.all().end()) {
    if (remote_publisher->second.handover.takes(dds_reader, sample.source_time_ns))
      remote_publishers_.publish(sample.writer, remote_publisher->second,
                                 *static_cast<Received*>(sample.object.get()));
    return;
  }
  // A plan is pending, or will be: this sample may be the first sign of its writer.
  if (pace_.is_owed() || participant_.has_changes()) {
    if (unplaced_.size() < most_of(Limit::unplaced_messages))
      return void(unplaced_.emplace_back(dds_reader, std::move(sample)));
    participant_.limits().refuse(Limit::unplaced_messages);
  }
  if (const auto read = dds_readers_.find(dds_reader); read != dds_readers_.end())
    ++read->second.without_remote_publisher;
}

std::optional<Time> InwardRoutes::tidy(Time now) {
  const std::optional<Time> next_room = remote_publishers_.publish_waiting(now);
  if (settle_at_ && *settle_at_ <= now) settle_at_ = settle(now);
  return earliest(next_room, settle_at_);
}

// This thread may have been starved for longer than what it ends here stays.
void InwardRoutes::publish_last(Time now) {
  std::set<ReaderKey> due;
  for (const auto& [writer, remote_publisher] : remote_publishers_.all()) {
    const ReaderHandover& handover = remote_publisher.handover;
    if (handover.is_former_due(now)) due.insert(*handover.former());
    if (handover.is_rejecting_due(now) || (remote_publisher.end && *remote_publisher.end <= now))
      due.insert(handover.dds_reader());
  }
  publish_all_of(due);
  for (auto& [writer, remote_publisher] : remote_publishers_.all())
    remote_publisher.handover.end_due(now);
}

std::optional<Time> InwardRoutes::settle(Time now) {
  publish_last(now);
  const std::optional<Time> next = remote_publishers_.tidy(now);
  std::set<ReaderKey> needed;
  for (const auto& [writer, remote_publisher] : remote_publishers_.all()) {
    needed.insert(remote_publisher.handover.dds_reader());
    if (remote_publisher.handover.former()) needed.insert(*remote_publisher.handover.former());
  }
  erase_dds_readers_if([&](const ReaderKey& key, const OpenDdsReader& dds_reader) {
    return dds_reader.is_over && !needed.contains(key);
  });
  return next;
}

RawDecoder InwardRoutes::decoder_of(std::shared_ptr<const BridgedType> type,
                                    const std::string& topic) const {
  struct Refused {
    std::atomic<std::uint64_t> count{0};
    Seldom reports;
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
        if (starved->reports.now())
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
    if (refused->reports.now())
      log.write(
          LogLevel::warning, "malformed message",
          {{"topic", topic}, {"refused", std::to_string(count)}, {"why", read.error().text()}});
    return nullptr;
  };
}

void InwardRoutes::tell(const Plan& plan, const NodesByName& nodes) const {
  for (const auto& [key, dds_reader] : plan.dds_readers) {
    const auto open = dds_readers_.find({key, dds_reader.depth, dds_reader.keep_all});
    if (open == dds_readers_.end()) continue;
    for (const std::string& name : dds_reader.nodes) {
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
        if (has_remote_publisher(writer)) node_of[writer] = full_name_of(node);
      }
    }
  }
  for (const auto& [writer, remote_publisher] : remote_publishers_.all()) {
    const auto node = node_of.find(writer);
    now.remote_publishers.push_back({remote_publisher.plan, writer,
                                     node == node_of.end() ? std::string() : node->second,
                                     remote_publisher.traffic.numbers()});
  }
  for (const auto& [key, dds_reader] : dds_readers_) {
    now.dds_readers.push_back({key.of, dds_reader.plan, dds_reader.reader->guid(),
                               dds_reader.reader->matched(), dds_reader.reader->incompatible(),
                               dds_reader.reader->refused(), dds_reader.without_remote_publisher,
                               dds_reader.reader->overflow()});
  }
}

}  // namespace agnocast::bridge
