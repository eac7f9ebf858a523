// SPDX-License-Identifier: Apache-2.0

#include <bridge/outward/outward_routes.hpp>

#include <algorithm>
#include <chrono>
#include <string>
#include <utility>

namespace agnocast::bridge {

void OutwardRoutes::end_changed(const Plan& plan) {
  std::vector<std::uint64_t> changed;
  dds_writers_.for_each([&](std::uint64_t publisher, const OpenDdsWriter& dds_writer) {
    const auto wanted = plan.dds_writers.find(publisher);
    if (wanted != plan.dds_writers.end() &&
        (wanted->second.offered != dds_writer.plan.offered ||
         wanted->second.local_reader != dds_writer.plan.local_reader))
      changed.push_back(publisher);
  });
  for (const std::uint64_t publisher : changed) {
    dds_writers_.close(publisher);
    dds_writer_keys_.erase(publisher);
  }
}

void OutwardRoutes::end_all() {
  dds_writers_.close_all();
  dds_writer_keys_.clear();
  announced_.clear();
}

// A local reader that survives agnocastd gets no history twice: the new DDS writers need a new
// reader.
void OutwardRoutes::begin_anew() {
  std::erase_if(local_readers_, [](const auto& local_reader) {
    return local_reader.first.of.qos_class.transient_local;
  });
  end_all();
  planned_for_.clear();
}

std::optional<Time> OutwardRoutes::tidy(Time now) {
  const std::optional<Time> next =
      dds_writers_.tidy(now) ? std::optional(now + linger) : std::nullopt;
  if (settle_at_ && *settle_at_ <= now) {
    end_local_readers();
    settle_at_ = next;
  }
  return earliest(next, settle_at_);
}

void OutwardRoutes::end_local_readers() {
  const std::set<ReaderKey> lingering = dds_writers_.lingering();
  std::erase_if(local_readers_, [&](const auto& local_reader) {
    return local_reader.second.is_over && !lingering.contains(local_reader.first);
  });
}

// Local readers before DDS writers: messages in between wait.
Errc OutwardRoutes::apply(const Plan& plan, std::span<const EndpointInfo> local) {
  std::set<std::uint64_t> without, present;
  for (const EndpointInfo& endpoint : local) {
    present.insert(endpoint.generation);
    if (!plan.dds_writers.contains(endpoint.generation)) without.insert(endpoint.generation);
  }
  close_others(plan, present);
  dds_writers_.set_without(without);
  LocalReadersOfTopic former;
  for (const auto& [key, local_reader] : local_readers_) former[key.of.key].insert(key);
  const Errc refusal = open_local_readers(plan);
  open_dds_writers(plan, std::move(former), without);
  dds_writers_.set_without(std::move(without));
  announced_.open(plan, participant_, refusals_);
  planned_for_ = std::move(present);
  settle_at_ = std::chrono::steady_clock::now();
  return refusal;
}

void OutwardRoutes::close_others(const Plan& plan, const std::set<std::uint64_t>& present) {
  std::erase_if(dds_writer_keys_, [&](std::uint64_t publisher) {
    if (plan.dds_writers.contains(publisher)) return false;
    if (present.contains(publisher)) {
      dds_writers_.close(publisher);
    } else {
      dds_writers_.close_later(publisher, std::chrono::steady_clock::now());
    }
    return true;
  });
  announced_.end_others(plan);
  for (auto& [key, local_reader] : local_readers_)
    local_reader.is_over = !plan.local_readers.contains(key);
  end_local_readers();
  // A local reader brings a history once. A publisher known before, without a DDS writer or with
  // another, needs it again.
  for (const auto& [publisher, dds_writer] : plan.dds_writers) {
    if (dds_writer.local_reader.of.qos_class.transient_local && planned_for_.contains(publisher) &&
        !dds_writer_keys_.contains(publisher)) {
      local_readers_.erase(dds_writer.local_reader);
      dds_writers_.forget_waiting(dds_writer.local_reader);
    }
  }
}

Errc OutwardRoutes::open_local_readers(const Plan& plan) {
  std::vector<std::size_t> lane_local_readers(lanes_.size());
  for (const auto& [key, local_reader] : local_readers_) ++lane_local_readers[local_reader.lane];
  // A local reader also gets messages of other publishers, which must not displace those that it
  // passes on.
  const SubscriptionOptions options = SubscriptionOptions().depth_per_publisher();
  for (const ReaderKey& key : plan.local_readers) {
    if (local_readers_.contains(key)) continue;
    const auto emptiest = std::min_element(lane_local_readers.begin(), lane_local_readers.end());
    const auto lane = static_cast<std::size_t>(emptiest - lane_local_readers.begin());
    const TopicKey& topic = key.of.key;
    auto made = try_create_generic_subscription(
        lanes_[lane]->node, topic.topic, types_.at(topic.type)->introspected,
        qos_of(key.of.qos_class, key.depth, key.keep_all),
        [this, key, type = types_.at(topic.type)](GenericMessage message) {
          dds_writers_.pass(std::move(message), key, type->cdr);
        },
        options);
    if (made) {
      local_readers_[key] = {lane, std::move(*made), false};
      ++*emptiest;
    } else {
      refusals_.note("subscription of " + topic.topic, text_of(made.error()));
      if (made.error().code == Errc::daemon_not_running) return Errc::daemon_not_running;
    }
  }
  return Errc::ok;
}

void OutwardRoutes::open_dds_writers(const Plan& plan, LocalReadersOfTopic former,
                                     std::set<std::uint64_t>& without) {
  for (const auto& [publisher, dds_writer] : plan.dds_writers) {
    if (dds_writer_keys_.contains(publisher)) continue;
    const TopicKey& topic = dds_writer.local_reader.of.key;
    DdsResult<std::unique_ptr<DdsWriter>> writer = announced_.take_over(publisher);
    if (*writer == nullptr) writer = create_writer_of(participant_, dds_writer);
    if (!writer) {
      refusals_.note("writer of " + topic.topic, writer.error().text());
      without.insert(publisher);
      continue;
    }
    auto open = std::make_unique<OpenDdsWriter>();
    open->plan = dds_writer;
    open->type = types_.at(topic.type);
    open->writer = std::move(*writer);
    // A new publisher, whose first messages another local reader may have.
    const std::set<ReaderKey>& local_readers = former[topic];
    open->has_begun = dds_writer.local_reader.of.qos_class.transient_local ||
                      planned_for_.contains(publisher) ||
                      local_readers.size() == local_readers.count(dds_writer.local_reader);
    dds_writers_.open(publisher, std::move(open));
    dds_writer_keys_.insert(publisher);
  }
}

void OutwardRoutes::tell(const NodesByName& nodes) const {
  dds_writers_.for_each([&](std::uint64_t, const OpenDdsWriter& dds_writer) {
    if (const auto node = nodes.find(dds_writer.plan.node); node != nodes.end())
      node->second->writers.push_back(dds_writer.writer->guid());
  });
  announced_.for_each([&](const DdsWriterPlan& dds_writer, const DdsWriter& writer) {
    if (const auto node = nodes.find(dds_writer.node); node != nodes.end())
      node->second->writers.push_back(writer.guid());
  });
}

void OutwardRoutes::look(BridgeStatus& now) const {
  now.lost_early = dds_writers_.lost();
  now.announced = announced_.size();
  dds_writers_.for_each([&](std::uint64_t publisher, const OpenDdsWriter& dds_writer) {
    // Asking a writer waits for its current write.
    if (!dds_writer.is_held) {
      dds_writer.matched = dds_writer.writer->matched();
      dds_writer.incompatible = dds_writer.writer->incompatible();
    }
    now.dds_writers.push_back({dds_writer.plan, publisher, dds_writer.writer->guid(),
                               dds_writer.matched, dds_writer.incompatible,
                               dds_writer.traffic.numbers()});
  });
  for (const auto& [key, local_reader] : local_readers_)
    now.local_readers.push_back({key, local_reader.subscription->get_lost_count()});
}

}  // namespace agnocast::bridge
