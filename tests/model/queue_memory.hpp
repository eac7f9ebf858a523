// SPDX-License-Identifier: Apache-2.0
//
// QueueScenario: the modelled words of shared memory and their initial values.
#pragma once

#include <tests/model/queue_scenario.hpp>

#include <iterator>

namespace agnocast::model {

inline QueueScenario::W QueueScenario::start() {
  machine.ring = plan_.ring;
  machine.store_buffers = plan_.store_buffers;
  build_map();
  W world;
  poke(world, board, offsetof(abi::TopicHeader, epoch), 1);
  poke(world, board, offsetof(abi::TopicHeader, publisher_high), 1);
  poke_publisher(world, offsetof(abi::PublisherEntry, word),
                 abi::pack_board_word(generation, abi::BoardState::active));
  const std::uint64_t slots = plan_.slots_before != 0 ? plan_.slots_before : plan_.slots;
  poke_publisher(world, offsetof(abi::PublisherEntry, slot_count), slots);
  poke(world, publisher_region, pe, abi::pack_entry(first, 0));
  poke(world, publisher_region, frontier_offset(0), page);
  new (world.state.publisher) PublisherPrivate(
      {topic(), words(), 0, generation, first, offered(), slots, plan_.deferred_limit});
  world.threads[publisher_main].pc = publish;
  world.threads[daemon_main].pc = idle;
  for (std::uint32_t s = 0; s < 2; ++s) {
    new (world.state.sub[s])
        SubscriptionPrivate(link_identity(s, 1), {sub_region0 + s}, armed_offset());
    const SubscriptionPlan& sub = plan_.sub[s];
    if (!sub.present) {
      world.threads[sub0 + s].pc = left;
    } else if (sub.late) {
      world.threads[sub0 + s].pc = join;
    } else {
      // Subscribed before the publisher came: on the board, and announced to it; it may link at
      // any time.
      world.state.generation[s] = 1;
      world.state.withdrawal[s] = sub.withdrawn;
      poke(world, board, offsetof(abi::TopicHeader, subscription_high), s + 1);
      poke_sub(world, s, offsetof(abi::SubscriptionEntry, word),
               abi::pack_board_word(1, abi::BoardState::active));
      poke_sub(world, s, offsetof(abi::SubscriptionEntry, policies),
               abi::pack_policies(requested(s, 1)));
      poke_sub(world, s, offsetof(abi::SubscriptionEntry, quota), sub.quota);
      world.state.announced[s] = 1;
      world.state.linked_to[s] = 1;
      if (sub.linked) {
        start_linked(world, s);
      } else {
        world.state.announce[s] = 1;
        world.threads[sub0 + s].pc = link_up;
      }
    }
  }
  return world;
}

inline void QueueScenario::build_map() const {
  address_map = {};
  char name[64];
  address_map.add(board, offsetof(abi::TopicHeader, epoch), "epoch");
  address_map.add(board, offsetof(abi::TopicHeader, publisher_high), "publisher_high");
  address_map.add(board, offsetof(abi::TopicHeader, subscription_high), "subscription_high");
  address_map.add(publisher_region, pe + offsetof(abi::PublisherEndpoint, withdrawn), "withdrawn");
  const std::uint64_t p = abi::publisher_entry_offset(0);
  address_map.add(board, p + offsetof(abi::PublisherEntry, word), "pub.word");
  address_map.add(board, p + offsetof(abi::PublisherEntry, slot_count), "pub.slot_count");
  address_map.add(board, p + offsetof(abi::PublisherEntry, final_head), "pub.final_head");
  for (std::uint64_t s = 0; s < 2; ++s) {
    const std::uint64_t at = abi::subscription_entry_offset(1, s);
    const char* fields[] = {"word",  "policies", "client",      "extent",
                            "quota", "wait_set", "deadline_ns", "lease_ns"};
    for (std::size_t f = 0; f < std::size(fields); ++f) {
      std::snprintf(name, sizeof name, "sub%llu.%s", static_cast<unsigned long long>(s), fields[f]);
      address_map.add(board, at + f * 8, name);
    }
  }
  address_map.add(publisher_region, frontier_offset(0), "frontier");
  address_map.add(publisher_region, frontier_offset(1), "frontier of the second window");
  address_map.add(publisher_region, pe, "head");
  const char* intent[] = {"intent.op", "intent.sequence", "intent.slot", "intent.address"};
  for (std::uint64_t f = 0; f < 4; ++f) {
    address_map.add(publisher_region, pe + offsetof(abi::PublisherEndpoint, intent_op) + f * 8,
                    intent[f]);
  }
  for (std::uint64_t i = 0; i < plan_.ring; ++i) {
    std::snprintf(name, sizeof name, "order[%llu]", static_cast<unsigned long long>(i));
    address_map.add(publisher_region, pe + abi::order_offset(i), name);
  }
  const char* slot[] = {"id", "address", "stamp", "size"};
  for (std::uint64_t i = 0; i < plan_.slots; ++i) {
    for (std::uint64_t f = 0; f < 4; ++f) {
      std::snprintf(name, sizeof name, "slot[%llu].%s", static_cast<unsigned long long>(i),
                    slot[f]);
      address_map.add(publisher_region, pe + abi::slot_offset(plan_.ring, i) + f * 8, name);
    }
  }
  for (std::uint32_t s = 0; s < 2; ++s) {
    const char* line[] = {"publisher_generation", "cursor", "hold"};
    for (std::uint64_t f = 0; f < 3; ++f) {
      std::snprintf(name, sizeof name, "s%u.%s", s, line[f]);
      address_map.add(static_cast<std::uint32_t>(client_region(s).id), line_offset(s) + f * 8,
                      name);
    }
    if (plan_.one_executor && s == 1) continue;
    std::snprintf(name, sizeof name, "s%u.armed", s);
    address_map.add(sub_region0 + s, armed_offset(), name);
  }
  if (address_map.count > word_count) Machine::give_up("word_count is too small");
}

}  // namespace agnocast::model
