// SPDX-License-Identifier: Apache-2.0
//
// EndpointManager: see the header.

#include <base/check.hpp>
#include <daemon/lifecycle/endpoint_manager.hpp>
#include <daemon/lifecycle/references.hpp>
#include <daemon/state/memory_reserve.hpp>
#include <daemon/state/steps.hpp>
#include <journal/start_steps.hpp>

namespace agnocast::daemon {

EndpointManager::EndpointManager(Registry& registry, Regions& regions, Doorbells& doorbells,
                                 ClientChannel& channel)
    : registry_(registry),
      regions_(regions),
      doorbells_(doorbells),
      channel_(channel),
      endings_(registry),
      leaving_(registry, endings_),
      announcing_(registry, endings_),
      announcer_(registry, regions, doorbells, channel),
      runner_(registry, endings_, announcer_, doorbells, channel),
      welcome_back_(registry, announcing_, announcer_, runner_, channel) {
  runner_.on_client_freed = [this](ClientIndex client) {
    if (on_client_freed) on_client_freed(client);
  };
  runner_.on_topic_freed = [this](TopicIndex topic) {
    for (auto& [client, topics] : type_notices_) topics.reset(number(topic));
  };
}

// --- create

Result<void> EndpointManager::create(ClientIndex client, const CreateRequest& request) {
  const std::uint64_t domain = request.domain.value_or(registry_.client(client).domain);
  auto topic = registry_.find_topic(domain, request.topic);
  if (topic) {
    const TopicRecord& record = registry_.topic(*topic);
    if (record.type != request.type || record.layout_hash != request.layout_hash) {
      const std::string text = type_mismatch_text(client, *topic, request);
      notice_types(client, *topic, text);
      return fail_with(Errc::type_mismatch, text);
    }
  } else {
    const auto added =
        registry_.add_topic({domain, request.topic, request.type, request.layout_hash,
                             link_blocks_of_new(request.topic)});
    if (!added) return tl::unexpected(added.error());
    topic = *added;
  }
  auto created = request.kind == Kind::publisher ? create_publisher(client, *topic, request)
                                                 : create_subscription(client, *topic, request);
  if (!created) run(endings_.free_unused_topic(*topic));
  return created;
}

std::uint32_t EndpointManager::link_blocks_of_new(std::string_view topic) const {
  const bool is_wide =
      std::find(wide_topics_.begin(), wide_topics_.end(), topic) != wide_topics_.end();
  return is_wide ? abi::link_block_max : 1;
}

std::uint64_t EndpointManager::extent_bytes(ClientIndex client,
                                            const CreateRequest& request) const {
  if (request.kind == Kind::publisher) return abi::publisher_extent_bytes;
  const auto topic =
      registry_.find_topic(request.domain.value_or(registry_.client(client).domain), request.topic);
  return abi::subscription_extent_bytes(topic ? registry_.topic(*topic).link_blocks
                                              : link_blocks_of_new(request.topic));
}

Result<void> EndpointManager::create_publisher(ClientIndex client, TopicIndex topic,
                                               const CreateRequest& request) {
  const auto plan = registry_.plan_publisher(client, topic, request.qos);
  if (!plan) return endings_.explain_full(topic, plan.error(), {});
  const auto ready = regions_.renew(client, {plan->extent, abi::publisher_extent_bytes},
                                    abi::slot_offset(abi::ring_count, plan->slot_count));
  if (!ready) return ready;
  // No process looks there yet; the add that follows publishes it.
  const region::PublisherWords<SharedMemory> words{regions_.region(client), plan->extent};
  AGNOCAST_CRASH_POINT(B_head);
  words.head().store(abi::pack_entry(plan->first_sequence, 0), std::memory_order_release);
  // Its readers will use their link lines for it.
  LinkBlocks slots{};
  slots[plan->index / abi::link_block_count] = plan->slot_count;
  if (auto backed = back_links_of_all(topic, slots); !backed) return backed;
  registry_.add_publisher(client, topic, request.qos, *plan, request.node, request.request);
  run(announcing_.created({Kind::publisher, topic, plan->index}, request.request));
  return {};
}

Result<void> EndpointManager::create_subscription(ClientIndex client, TopicIndex topic,
                                                  const CreateRequest& request) {
  if (!doorbells_.is_open(client, request.wait_set))
    return fail(Errc::invalid_argument, "the wait set of the subscription is not open");
  const HoldPool pool = registry_.hold_pool();
  const HoldPool::Use use = registry_.pool_use(registry_.client(client).uid, topic);
  const HoldQuota quota{request.quota, request.quota_or_less
                                           ? pool.part(use, request.quota)
                                           : std::min(request.quota, pool.at_most(use))};
  const auto plan = registry_.plan_subscription(client, topic, request.qos, quota);
  if (!plan) return tl::unexpected(plan.error());
  if (auto ready = make_ready(topic, *plan, client, plan->extent); !ready) return ready;
  // Before it joins, publishers can keep the history that it may ask for (docs/protocol.md,
  // slots).
  for (const SlotRaise& raise : plan->raises) registry_.raise_slots(topic, raise);
  registry_.add_subscription(client, topic, request.qos, quota, request.wait_set, *plan,
                             request.node, request.request);
  set_starts(topic, plan->index);
  run(announcing_.created({Kind::subscription, topic, plan->index}, request.request));
  return {};
}

bool EndpointManager::answer_again(ClientIndex client, const CreateRequest& request) {
  const auto ref = registry_.find_creation(client, request.kind, request.request);
  if (!ref) return false;
  // The daemon may have ended between the two.
  if (ref->kind == Kind::subscription) set_starts(ref->topic, ref->index);
  run(announcing_.answered_again(*ref, request.request));
  return true;
}

void EndpointManager::set_starts(TopicIndex topic, std::uint32_t subscription) {
  const SubscriptionRecord& own = registry_.subscription(topic, subscription);
  if (own.state != EndpointState::active || !regions_.is_open(own.client)) return;
  registry_.for_each_publisher(topic, [&](std::uint32_t index, const PublisherRecord& publisher) {
    if (publisher.state != EndpointState::active || !matches(publisher, own) ||
        !regions_.is_open(publisher.client))
      return;
    const region::LinkWords<SharedMemory> line{regions_.region(own.client), own.extent, index};
    if (line.publisher_generation().load(std::memory_order_acquire) != 0 ||
        line.cursor().load(std::memory_order_acquire) != 0)
      return;
    journal::set_start<SharedMemory>({regions_.region(publisher.client), publisher.extent}, line);
  });
}

Result<void> EndpointManager::make_ready(TopicIndex topic, const SubscriptionPlan& plan,
                                         ClientIndex client, std::uint64_t extent) {
  LinkBlocks slots = registry_.slots_by_link_block(topic);
  for (const SlotRaise& raise : plan.raises) {
    std::uint64_t& most = slots[raise.index / abi::link_block_count];
    most = std::max(most, raise.slot_count);
  }
  auto ready = regions_.renew(
      client, {extent, abi::subscription_extent_bytes(registry_.topic(topic).link_blocks)},
      abi::page_bytes);
  if (ready) ready = regions_.back_links(client, extent, slots);
  for (const SlotRaise& raise : plan.raises) {
    const PublisherRecord& publisher = registry_.publisher(topic, raise.index);
    if (ready && regions_.is_open(publisher.client))
      ready = regions_.back(publisher.client, publisher.extent,
                            abi::slot_offset(abi::ring_count, raise.slot_count));
  }
  if (ready && !plan.raises.empty()) ready = back_links_of_all(topic, slots);
  return ready;
}

Result<void> EndpointManager::back_links_of_all(TopicIndex topic, const LinkBlocks& slots) {
  Result<void> backed;
  registry_.for_each_subscription(topic, [&](std::uint32_t, const SubscriptionRecord& record) {
    const bool counts =
        record.state == EndpointState::active || record.state == EndpointState::leaving;
    if (backed && counts && regions_.is_open(record.client))
      backed = regions_.back_links(record.client, record.extent, slots);
  });
  return backed;
}

// Written for both sides. Texts that may be long come last: a packet has 255 bytes for it.
std::string EndpointManager::type_mismatch_text(ClientIndex client, TopicIndex topic,
                                                const CreateRequest& request) const {
  const TopicRecord& there = registry_.topic(topic);
  return printable(request.type) + " (layout " + hexadecimal(request.layout_hash) +
         ") is asked for by process " + std::to_string(registry_.client(client).pid) + ", " +
         printable(there.type) + " (layout " + hexadecimal(there.layout_hash) +
         ") is the type of " + std::string(there.name);
}

void EndpointManager::notice_types(ClientIndex client, TopicIndex topic, const std::string& text) {
  auto notified = type_notices_[number(client)][number(topic)];
  if (notified) return;
  notified = true;
  registry_.for_each_publisher(topic, [&](std::uint32_t i, const PublisherRecord& record) {
    if (record.state == EndpointState::active)
      notice({Kind::publisher, topic, i}, Errc::type_mismatch, text);
  });
  registry_.for_each_subscription(topic, [&](std::uint32_t i, const SubscriptionRecord& record) {
    if (record.state == EndpointState::active)
      notice({Kind::subscription, topic, i}, Errc::type_mismatch, text);
  });
}

// --- doorbells that have changed

void EndpointManager::renewed(ClientIndex client, std::uint64_t wait_set) {
  for (const EndpointRef& ref : registry_.endpoints_of(client)) {
    if (ref.kind == Kind::subscription &&
        registry_.subscription(ref.topic, ref.index).wait_set == wait_set)
      renewed_.emplace(registry_.generation_of(ref), ref);
  }
}

void EndpointManager::announce_renewed() {
  // Each takes some 10 µs, including a new socket.
  constexpr std::size_t announcements_max = 200;
  for (std::size_t made = 0; !renewed_.empty() && made < announcements_max;) {
    const auto generation = renewed_.begin()->first;
    const EndpointRef ref = renewed_.begin()->second;
    renewed_.erase(renewed_.begin());
    if (!registry_.is_used(ref) || registry_.generation_of(ref) != generation) continue;
    const Effects announcements = announcing_.to_publishers_of(ref);
    run(announcements);
    made += announcements.size();
  }
}

// --- leave
//
// What a process reports of itself has happened already: it is never refused for lack of memory, so
// the reserve serves from the beginning of each of these.

Result<void> EndpointManager::leave(ClientIndex client, const LeaveRequest& request) {
  MemoryReserve::no_return();
  const EndpointRef ref = ref_of(request.reference);
  std::uint64_t final_head = 0;
  if (ref.kind == Kind::publisher && leaving_.is_own(client, request.reference)) {
    const region::PublisherWords<SharedMemory> words{
        regions_.region(client), registry_.publisher(ref.topic, ref.index).extent};
    // The process wrote it; readers check it like any other value of a publisher.
    final_head = words.head().load(std::memory_order_acquire);
  }
  return run(leaving_.leave(client, request, final_head));
}

Result<void> EndpointManager::drained(ClientIndex client, const DrainedRequest& request) {
  MemoryReserve::no_return();
  return run(leaving_.drained(client, request));
}

Result<void> EndpointManager::unlinked(ClientIndex client, const wire::Unlinked& statement) {
  MemoryReserve::no_return();
  Session* const session = channel_.session_of(client);
  AGNOCAST_CHECK(session != nullptr);
  return run(leaving_.unlinked(
      client, statement,
      {session->announcements(), session->packet_count(), welcome_back_.is_announcing(client)}));
}

Result<void> EndpointManager::run(const Result<Effects>& decision) {
  if (!decision) return tl::unexpected(decision.error());
  run(*decision);
  return {};
}

// --- the end of a process

void EndpointManager::forget_client(ClientIndex client) {
  registry_.client_forgotten(client);
  announcer_.forget_client(client);
  welcome_back_.forget_client(client);
  type_notices_.erase(number(client));
}

// This frees places on the way, and a topic goes with its last endpoint.
void EndpointManager::carry_out_what_is_owed() {
  const auto for_each_topic = [this](const auto& decide) {
    for (std::uint32_t t = 0; t < registry_.topic_high(); ++t) {
      if (registry_.topic(TopicIndex{t}).state == TopicState::used) decide(TopicIndex{t});
    }
  };
  for_each_topic([this](TopicIndex topic) {
    run(endings_.owed_acknowledgements(Kind::publisher, topic));
    run(endings_.owed_acknowledgements(Kind::subscription, topic));
  });
  for_each_topic([this](TopicIndex topic) { run(endings_.free_all_unused(topic)); });
  run(endings_.free_unused_clients());
  // A process that comes back learns at once what to unmap.
  for_each_topic([this](TopicIndex topic) {
    run(endings_.give_up_orphans(topic));
    run(endings_.give_up_subscriptions(topic));
  });
  run(endings_.give_up_gone());
}

}  // namespace agnocast::daemon
