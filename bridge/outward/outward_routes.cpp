// SPDX-License-Identifier: Apache-2.0

#include <bridge/outward/outward_routes.hpp>

#include <algorithm>
#include <chrono>
#include <string>
#include <utility>

namespace agnocast::bridge {

void OutwardRoutes::end_changed(const Plan& plan) {
  std::vector<std::uint64_t> changed;
  outlets_.for_each([&](std::uint64_t publisher, const OpenOutlet& outlet) {
    const auto wanted = plan.outlets.find(publisher);
    if (wanted != plan.outlets.end() &&
        (wanted->second.offered != outlet.plan.offered || wanted->second.tap != outlet.plan.tap))
      changed.push_back(publisher);
  });
  for (const std::uint64_t publisher : changed) {
    outlets_.close(publisher);
    outlet_keys_.erase(publisher);
  }
}

void OutwardRoutes::end_all() {
  outlets_.close_all();
  outlet_keys_.clear();
  announced_.clear();
}

// A local reader that survives agnocastd gets no history twice: the new DDS writers need a new
// reader.
void OutwardRoutes::begin_anew() {
  std::erase_if(taps_, [](const auto& tap) { return tap.first.of.qos_class.transient_local; });
  end_all();
  planned_for_.clear();
}

std::optional<Time> OutwardRoutes::tidy(Time now) {
  const std::optional<Time> next = outlets_.tidy(now) ? std::optional(now + linger) : std::nullopt;
  if (settle_at_ && *settle_at_ <= now) {
    end_taps();
    settle_at_ = next;
  }
  return earliest(next, settle_at_);
}

void OutwardRoutes::end_taps() {
  const std::set<ReaderKey> lingering = outlets_.lingering();
  std::erase_if(
      taps_, [&](const auto& tap) { return tap.second.is_over && !lingering.contains(tap.first); });
}

// Local readers before DDS writers: messages in between wait.
Errc OutwardRoutes::apply(const Plan& plan, std::span<const EndpointInfo> local) {
  std::set<std::uint64_t> without, present;
  for (const EndpointInfo& endpoint : local) {
    present.insert(endpoint.generation);
    if (!plan.outlets.contains(endpoint.generation)) without.insert(endpoint.generation);
  }
  close_others(plan, present);
  outlets_.set_without(without);
  TapsOfTopic former;
  for (const auto& [key, tap] : taps_) former[key.of.key].insert(key);
  const Errc refusal = open_taps(plan);
  open_outlets(plan, std::move(former), without);
  outlets_.set_without(std::move(without));
  announced_.open(plan, participant_, refusals_);
  planned_for_ = std::move(present);
  settle_at_ = std::chrono::steady_clock::now();
  return refusal;
}

void OutwardRoutes::close_others(const Plan& plan, const std::set<std::uint64_t>& present) {
  std::erase_if(outlet_keys_, [&](std::uint64_t publisher) {
    if (plan.outlets.contains(publisher)) return false;
    if (present.contains(publisher)) {
      outlets_.close(publisher);
    } else {
      outlets_.close_later(publisher, std::chrono::steady_clock::now());
    }
    return true;
  });
  announced_.end_others(plan);
  for (auto& [key, tap] : taps_) tap.is_over = !plan.taps.contains(key);
  end_taps();
  // A local reader brings a history once. A publisher known before, without a DDS writer or with
  // another, needs it again.
  for (const auto& [publisher, outlet] : plan.outlets) {
    if (outlet.tap.of.qos_class.transient_local && planned_for_.contains(publisher) &&
        !outlet_keys_.contains(publisher)) {
      taps_.erase(outlet.tap);
      outlets_.forget_waiting(outlet.tap);
    }
  }
}

Errc OutwardRoutes::open_taps(const Plan& plan) {
  std::vector<std::size_t> lane_taps(lanes_.size());
  for (const auto& [key, tap] : taps_) ++lane_taps[tap.lane];
  // A local reader also gets messages of other publishers, which must not displace those that it
  // passes on.
  const SubscriptionOptions options = SubscriptionOptions().depth_per_publisher();
  for (const ReaderKey& key : plan.taps) {
    if (taps_.contains(key)) continue;
    const auto emptiest = std::min_element(lane_taps.begin(), lane_taps.end());
    const auto lane = static_cast<std::size_t>(emptiest - lane_taps.begin());
    const TopicKey& topic = key.of.key;
    auto made = try_create_generic_subscription(
        *lanes_[lane], topic.topic, types_.at(topic.type)->introspected,
        qos_of(key.of.qos_class, key.depth, key.keep_all),
        [this, key, type = types_.at(topic.type)](GenericMessage message) {
          outlets_.pass(std::move(message), key, type->cdr);
        },
        options);
    if (made) {
      taps_[key] = {lane, std::move(*made), false};
      ++*emptiest;
    } else {
      refusals_.note("subscription of " + topic.topic, text_of(made.error()));
      if (made.error().code == Errc::daemon_not_running) return Errc::daemon_not_running;
    }
  }
  return Errc::ok;
}

void OutwardRoutes::open_outlets(const Plan& plan, TapsOfTopic former,
                                 std::set<std::uint64_t>& without) {
  for (const auto& [publisher, outlet] : plan.outlets) {
    if (outlet_keys_.contains(publisher)) continue;
    const TopicKey& topic = outlet.tap.of.key;
    DdsResult<std::unique_ptr<DdsWriter>> writer = announced_.take_over(publisher);
    if (*writer == nullptr) writer = create_writer_of(participant_, outlet);
    if (!writer) {
      refusals_.note("writer of " + topic.topic, writer.error().text());
      without.insert(publisher);
      continue;
    }
    auto open = std::make_unique<OpenOutlet>();
    open->plan = outlet;
    open->type = types_.at(topic.type);
    open->writer = std::move(*writer);
    // A new publisher, whose first messages another local reader may have.
    const std::set<ReaderKey>& taps = former[topic];
    open->has_begun = outlet.tap.of.qos_class.transient_local || planned_for_.contains(publisher) ||
                      taps.size() == taps.count(outlet.tap);
    outlets_.open(publisher, std::move(open));
    outlet_keys_.insert(publisher);
  }
}

void OutwardRoutes::tell(const NodesByName& nodes) const {
  outlets_.for_each([&](std::uint64_t, const OpenOutlet& outlet) {
    if (const auto node = nodes.find(outlet.plan.node); node != nodes.end())
      node->second->writers.push_back(outlet.writer->guid());
  });
  announced_.for_each([&](const Outlet& outlet, const DdsWriter& writer) {
    if (const auto node = nodes.find(outlet.node); node != nodes.end())
      node->second->writers.push_back(writer.guid());
  });
}

void OutwardRoutes::look(BridgeStatus& now) const {
  now.lost_early = outlets_.lost();
  now.announced = announced_.size();
  outlets_.for_each([&](std::uint64_t publisher, const OpenOutlet& outlet) {
    // Asking a writer waits for its current write.
    if (!outlet.is_held) {
      outlet.matched = outlet.writer->matched();
      outlet.incompatible = outlet.writer->incompatible();
    }
    now.outlets.push_back({outlet.plan, publisher, outlet.writer->guid(), outlet.matched,
                           outlet.incompatible, outlet.traffic.numbers()});
  });
  for (const auto& [key, tap] : taps_)
    now.taps.push_back({key, tap.subscription->get_lost_count()});
}

}  // namespace agnocast::bridge
