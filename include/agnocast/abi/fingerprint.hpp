// SPDX-License-Identifier: Apache-2.0
//
// Fingerprint of everything that two processes must agree on: every size and offset of the shared
// regions and of the wire, every limit, every number with a meaning, and the packing of words.
// Client and daemon compare it exactly in hello, so two different builds never touch each other's
// memory. Add each new field of a struct here. tests/layout holds the value, so it cannot change
// by accident.
#pragma once

#include <agnocast/abi/board.hpp>
#include <agnocast/abi/client_region.hpp>
#include <agnocast/abi/graph_table.hpp>
#include <agnocast/abi/limits.hpp>
#include <agnocast/abi/observe.hpp>
#include <agnocast/abi/wire.hpp>
#include <agnocast/abi/words.hpp>

#include <cstddef>
#include <cstdint>

namespace agnocast::abi {

// Increment it when the meaning of a word changes but its place does not.
#ifdef AGNOCAST_OTHER_LAYOUT  // for tests: simulates another build
inline constexpr std::uint64_t layout_version = 0x7e57;
#else
inline constexpr std::uint64_t layout_version = 2;
#endif

// FNV-1a over numbers, each as eight bytes: two different lists collide with probability 2^-64.
class Fingerprint {
 public:
  template <class... Numbers>
  constexpr Fingerprint& add(Numbers... numbers) noexcept {
    (add_one(static_cast<std::uint64_t>(numbers)), ...);
    return *this;
  }
  constexpr std::uint64_t value() const noexcept { return hash_; }

 private:
  constexpr void add_one(std::uint64_t number) noexcept {
    for (int byte = 0; byte < 8; ++byte)
      hash_ = (hash_ ^ (number >> 8 * byte & 0xff)) * 0x100000001b3;
  }
  std::uint64_t hash_ = 0xcbf29ce484222325;
};

/// Returns the fingerprint of this layout. Long because it lists each size, offset and limit once.
constexpr std::uint64_t fingerprint() noexcept {
  Fingerprint sum;
  sum.add(layout_version, cache_line_bytes, page_bytes, depth_max, ring_count, slot_count_max,
          near_slot_count, publisher_count_max, subscription_count_max, orphan_count_max,
          topic_count_max, client_count_max, window_count_max, wait_set_count_max,
          observer_count_max, heap_move_max, blocked_count_max, callback_group_count_max,
          callback_thread_count_max, callback_spin_count_max, cpu_count_max, graph_entry_max,
          graph_block_entries);
  // Packing of words, by the results for probe values.
  sum.add(pack_entry(0x123456789abc, 0xdef0), sequence_of(0xfedcba9876543210),
          slot_of(0xfedcba9876543210), retired_mark, first_sequence_of(0x12345),
          pack_board_word(0x123456789abc, BoardState::leaving), generation_of(0xfedcba9876543210),
          pack_policies({0x1234, true, false, false, false}),
          pack_policies({0, false, true, false, false}),
          pack_policies({0, false, false, true, false}),
          pack_policies({0, false, false, false, true}),
          pack_policies({0, false, false, false, false, true}), policy_bits, qos_time_max_ns,
          reach_of({7, false, true, true, false}), intent_idle, intent_publish, intent_moved,
          cursor_aside, pack_withdrawal(35, Withdrawal::not_attached), Withdrawal::none,
          Withdrawal::over_quota, Withdrawal::over_share);
  sum.add(QosPolicy::none, QosPolicy::durability, QosPolicy::deadline, QosPolicy::liveliness,
          QosPolicy::reliability, QosPolicy::liveliness_lease);
  sum.add(sizeof(QosWords), offsetof(QosWords, policies), offsetof(QosWords, deadline_ns),
          offsetof(QosWords, lifespan_ns), offsetof(QosWords, lease_ns));
  sum.add(BoardState::free, BoardState::active, BoardState::leaving, BoardState::orphan,
          BoardState::revoked, BoardState::dead);
  sum.add(order_offset(3), slot_offset(ring_count, 3), link_offset(300), far_hold_offset(9),
          publisher_entry_offset(3), subscription_entry_offset(5, 3), topic_offset(3), topic_bytes);
  sum.add(sizeof(QueueSlot), offsetof(QueueSlot, id), offsetof(QueueSlot, address),
          offsetof(QueueSlot, stamp_ns), offsetof(QueueSlot, size));
  sum.add(sizeof(PublisherEndpoint), offsetof(PublisherEndpoint, head),
          offsetof(PublisherEndpoint, persistent_id), offsetof(PublisherEndpoint, inherited),
          offsetof(PublisherEndpoint, published_bytes), offsetof(PublisherEndpoint, asserted_ns),
          offsetof(PublisherEndpoint, intent_op), offsetof(PublisherEndpoint, intent_sequence),
          offsetof(PublisherEndpoint, intent_slot), offsetof(PublisherEndpoint, adopted_messages),
          offsetof(PublisherEndpoint, adopted_bytes), offsetof(PublisherEndpoint, refused_no_slot),
          offsetof(PublisherEndpoint, refused_would_block),
          offsetof(PublisherEndpoint, refused_heap_exhausted),
          offsetof(PublisherEndpoint, withdrawn));
  sum.add(link_block_count, client_region_bytes, sizeof(SubscriptionCounters),
          offsetof(SubscriptionCounters, lost), offsetof(SubscriptionCounters, malformed),
          offsetof(SubscriptionCounters, unreachable),
          offsetof(SubscriptionCounters, persistent_id), offsetof(SubscriptionCounters, expired));
  sum.add(sizeof(LinkLine), offsetof(LinkLine, publisher_generation), offsetof(LinkLine, cursor),
          offsetof(LinkLine, hold));
  sum.add(sizeof(WaitSetLine), offsetof(WaitSetLine, armed));
  sum.add(sizeof(WindowEntry), offsetof(WindowEntry, base), offsetof(WindowEntry, length),
          offsetof(WindowEntry, frontier), offsetof(WindowEntry, reserved));
  sum.add(sizeof(ClientRegionHeader), offsetof(ClientRegionHeader, magic),
          offsetof(ClientRegionHeader, fingerprint), offsetof(ClientRegionHeader, generation),
          offsetof(ClientRegionHeader, window), offsetof(ClientRegionHeader, reserved),
          offsetof(ClientRegionHeader, wait_set));
  sum.add(sizeof(BoardHeader), offsetof(BoardHeader, magic), offsetof(BoardHeader, fingerprint),
          offsetof(BoardHeader, incarnation));
  sum.add(sizeof(TopicHeader), offsetof(TopicHeader, epoch), offsetof(TopicHeader, word),
          offsetof(TopicHeader, publisher_high), offsetof(TopicHeader, subscription_high));
  sum.add(sizeof(PublisherEntry), offsetof(PublisherEntry, word),
          offsetof(PublisherEntry, policies), offsetof(PublisherEntry, client),
          offsetof(PublisherEntry, extent), offsetof(PublisherEntry, slot_count),
          offsetof(PublisherEntry, final_head), offsetof(PublisherEntry, deadline_ns),
          offsetof(PublisherEntry, lease_ns));
  sum.add(sizeof(SubscriptionEntry), offsetof(SubscriptionEntry, word),
          offsetof(SubscriptionEntry, policies), offsetof(SubscriptionEntry, client),
          offsetof(SubscriptionEntry, extent), offsetof(SubscriptionEntry, quota),
          offsetof(SubscriptionEntry, wait_set), offsetof(SubscriptionEntry, deadline_ns),
          offsetof(SubscriptionEntry, lease_ns));
  sum.add(sizeof(GraphHeader), offsetof(GraphHeader, magic), offsetof(GraphHeader, fingerprint),
          offsetof(GraphHeader, incarnation), offsetof(GraphHeader, changes),
          offsetof(GraphHeader, entry_high), offsetof(GraphHeader, missing));
  sum.add(sizeof(GraphEntry), offsetof(GraphEntry, word), offsetof(GraphEntry, kind),
          offsetof(GraphEntry, domain), offsetof(GraphEntry, layout_hash),
          offsetof(GraphEntry, policies), offsetof(GraphEntry, deadline_ns),
          offsetof(GraphEntry, lifespan_ns), offsetof(GraphEntry, lease_ns),
          offsetof(GraphEntry, client), offsetof(GraphEntry, pid), offsetof(GraphEntry, uid),
          offsetof(GraphEntry, reserved), offsetof(GraphEntry, topic), offsetof(GraphEntry, type),
          offsetof(GraphEntry, node), offsetof(GraphEntry, process), graph_entry_offset(3));
  sum.add(sizeof(wire::Header), offsetof(wire::Header, opcode), offsetof(wire::Header, bytes),
          offsetof(wire::Header, request));
  sum.add(sizeof(wire::Hello), offsetof(wire::Hello, header), offsetof(wire::Hello, fingerprint),
          offsetof(wire::Hello, domain), offsetof(wire::Hello, process_name));
  sum.add(sizeof(wire::Welcome), offsetof(wire::Welcome, header),
          offsetof(wire::Welcome, fingerprint), offsetof(wire::Welcome, incarnation),
          offsetof(wire::Welcome, client), offsetof(wire::Welcome, client_generation),
          offsetof(wire::Welcome, arena_base), offsetof(wire::Welcome, arena_bytes),
          offsetof(wire::Welcome, client_region_bytes));
  sum.add(sizeof(wire::Reference), offsetof(wire::Reference, header),
          offsetof(wire::Reference, kind), offsetof(wire::Reference, topic),
          offsetof(wire::Reference, index), offsetof(wire::Reference, generation));
  sum.add(sizeof(wire::Unlinked), offsetof(wire::Unlinked, header), offsetof(wire::Unlinked, kind),
          offsetof(wire::Unlinked, topic), offsetof(wire::Unlinked, index),
          offsetof(wire::Unlinked, generation), offsetof(wire::Unlinked, seen));
  sum.add(sizeof(wire::WindowRequest), offsetof(wire::WindowRequest, header),
          offsetof(wire::WindowRequest, window));
  sum.add(sizeof(wire::WindowOpened), offsetof(wire::WindowOpened, header),
          offsetof(wire::WindowOpened, window), offsetof(wire::WindowOpened, base),
          offsetof(wire::WindowOpened, bytes), offsetof(wire::WindowOpened, first));
  sum.add(sizeof(wire::BringWindow), offsetof(wire::BringWindow, header),
          offsetof(wire::BringWindow, window), offsetof(wire::BringWindow, base),
          offsetof(wire::BringWindow, bytes), offsetof(wire::BringWindow, first));
  sum.add(sizeof(wire::WindowAnnounced), offsetof(wire::WindowAnnounced, header),
          offsetof(wire::WindowAnnounced, client),
          offsetof(wire::WindowAnnounced, client_generation),
          offsetof(wire::WindowAnnounced, window), offsetof(wire::WindowAnnounced, base),
          offsetof(wire::WindowAnnounced, bytes), offsetof(wire::WindowAnnounced, first));
  sum.add(sizeof(wire::Withdrawn), offsetof(wire::Withdrawn, header),
          offsetof(wire::Withdrawn, topic), offsetof(wire::Withdrawn, why),
          offsetof(wire::Withdrawn, publisher), offsetof(wire::Withdrawn, publisher_generation),
          offsetof(wire::Withdrawn, subscription),
          offsetof(wire::Withdrawn, subscription_generation), offsetof(wire::Withdrawn, bytes));
  sum.add(sizeof(wire::Blocked), offsetof(wire::Blocked, header), offsetof(wire::Blocked, base),
          offsetof(wire::Blocked, bytes), offsetof(wire::Blocked, what), sizeof(wire::MoveHeap),
          offsetof(wire::MoveHeap, header), offsetof(wire::MoveHeap, window),
          offsetof(wire::Announcement::Window, base), offsetof(wire::Announcement::Window, bytes),
          offsetof(wire::Announcement::Window, first));
  sum.add(sizeof(wire::CallbackGroup), offsetof(wire::CallbackGroup, header),
          offsetof(wire::CallbackGroup, executor), offsetof(wire::CallbackGroup, group),
          offsetof(wire::CallbackGroup, is_there), offsetof(wire::CallbackGroup, reentrant),
          offsetof(wire::CallbackGroup, node), offsetof(wire::CallbackGroup, name));
  sum.add(sizeof(wire::CallbackThread), offsetof(wire::CallbackThread, header),
          offsetof(wire::CallbackThread, executor), offsetof(wire::CallbackThread, thread),
          offsetof(wire::CallbackThread, is_there));
  sum.add(sizeof(wire::WatchGraph), offsetof(wire::WatchGraph, header),
          offsetof(wire::WatchGraph, table), offsetof(wire::WatchGraph, seen));
  sum.add(sizeof(wire::GraphChanged), offsetof(wire::GraphChanged, header),
          offsetof(wire::GraphChanged, table), offsetof(wire::GraphChanged, changes));
  sum.add(sizeof(wire::DoorbellsRenewed), offsetof(wire::DoorbellsRenewed, header),
          offsetof(wire::DoorbellsRenewed, wait_set));
  sum.add(sizeof(wire::WaitSetRequest), offsetof(wire::WaitSetRequest, header),
          offsetof(wire::WaitSetRequest, wait_set));
  sum.add(sizeof(wire::CreateEndpoint), offsetof(wire::CreateEndpoint, header),
          offsetof(wire::CreateEndpoint, qos), offsetof(wire::CreateEndpoint, layout_hash),
          offsetof(wire::CreateEndpoint, wait_set), offsetof(wire::CreateEndpoint, quota),
          offsetof(wire::CreateEndpoint, domain), offsetof(wire::CreateEndpoint, topic),
          offsetof(wire::CreateEndpoint, type), offsetof(wire::CreateEndpoint, node));
  sum.add(sizeof(wire::EndpointCreated), offsetof(wire::EndpointCreated, header),
          offsetof(wire::EndpointCreated, topic), offsetof(wire::EndpointCreated, reserved),
          offsetof(wire::EndpointCreated, index), offsetof(wire::EndpointCreated, generation),
          offsetof(wire::EndpointCreated, extent), offsetof(wire::EndpointCreated, slot_count),
          offsetof(wire::EndpointCreated, first_sequence));
  sum.add(sizeof(wire::Announcement), offsetof(wire::Announcement, header),
          offsetof(wire::Announcement, kind), offsetof(wire::Announcement, topic),
          offsetof(wire::Announcement, own_index), offsetof(wire::Announcement, own_generation),
          offsetof(wire::Announcement, index), offsetof(wire::Announcement, generation),
          offsetof(wire::Announcement, client), offsetof(wire::Announcement, client_generation),
          offsetof(wire::Announcement, extent), offsetof(wire::Announcement, qos),
          offsetof(wire::Announcement, first_sequence), offsetof(wire::Announcement, wait_set),
          offsetof(wire::Announcement, from_start), offsetof(wire::Announcement, window_count),
          offsetof(wire::Announcement, doorbell_count), offsetof(wire::Announcement, uid),
          offsetof(wire::Announcement, same_user), offsetof(wire::Announcement, reserved),
          offsetof(wire::Announcement, quota), offsetof(wire::Announcement, window));
  sum.add(sizeof(wire::Orphaned), offsetof(wire::Orphaned, header), offsetof(wire::Orphaned, topic),
          offsetof(wire::Orphaned, reserved), offsetof(wire::Orphaned, index),
          offsetof(wire::Orphaned, generation), offsetof(wire::Orphaned, final_head));
  sum.add(sizeof(wire::Refused), offsetof(wire::Refused, header), offsetof(wire::Refused, code),
          offsetof(wire::Refused, os_errno), offsetof(wire::Refused, text));
  sum.add(sizeof(wire::Notice), offsetof(wire::Notice, header), offsetof(wire::Notice, code),
          offsetof(wire::Notice, kind), offsetof(wire::Notice, topic),
          offsetof(wire::Notice, policy), offsetof(wire::Notice, index),
          offsetof(wire::Notice, generation), offsetof(wire::Notice, text));
  sum.add(sizeof(wire::Done), offsetof(wire::Done, header));
  sum.add(sizeof(wire::Rejoin), offsetof(wire::Rejoin, header), offsetof(wire::Rejoin, fingerprint),
          offsetof(wire::Rejoin, incarnation), offsetof(wire::Rejoin, client),
          offsetof(wire::Rejoin, client_generation));
  sum.add(sizeof(wire::Rejoined), offsetof(wire::Rejoined, header),
          offsetof(wire::Rejoined, incarnation));
  sum.add(sizeof(wire::Own), offsetof(wire::Own, header), offsetof(wire::Own, kind),
          offsetof(wire::Own, topic), offsetof(wire::Own, index), offsetof(wire::Own, generation),
          offsetof(wire::Own, creation), offsetof(wire::Own, active), offsetof(wire::Own, reserved),
          wire::asked_again);
  sum.add(sizeof(wire::Observe), offsetof(wire::Observe, header),
          offsetof(wire::Observe, fingerprint));
  sum.add(sizeof(wire::Observed), offsetof(wire::Observed, header),
          offsetof(wire::Observed, fingerprint), offsetof(wire::Observed, incarnation),
          offsetof(wire::Observed, client_region_bytes));
  sum.add(sizeof(wire::Dump), offsetof(wire::Dump, header), offsetof(wire::Dump, with_threads));
  sum.add(sizeof(wire::Revoke), offsetof(wire::Revoke, header), offsetof(wire::Revoke, client),
          offsetof(wire::Revoke, generation));
  sum.add(sizeof(wire::ReadJournal), offsetof(wire::ReadJournal, header),
          offsetof(wire::ReadJournal, last), offsetof(wire::ReadJournal, count));
  sum.add(sizeof(wire::JournalProcess), offsetof(wire::JournalProcess, pid),
          offsetof(wire::JournalProcess, reserved), offsetof(wire::JournalProcess, name));
  sum.add(sizeof(wire::JournalRecord), offsetof(wire::JournalRecord, header),
          offsetof(wire::JournalRecord, lsn), offsetof(wire::JournalRecord, stamp_ns),
          offsetof(wire::JournalRecord, type), offsetof(wire::JournalRecord, state),
          offsetof(wire::JournalRecord, argument), offsetof(wire::JournalRecord, topic),
          offsetof(wire::JournalRecord, process), offsetof(wire::JournalRecord, receiver));
  sum.add(sizeof(wire::JournalEnd), offsetof(wire::JournalEnd, header),
          offsetof(wire::JournalEnd, record_count), offsetof(wire::JournalEnd, oldest),
          offsetof(wire::JournalEnd, newest), offsetof(wire::JournalEnd, now_ns));
  sum.add(sizeof(wire::DaemonCounters), offsetof(wire::DaemonCounters, clients_registered),
          offsetof(wire::DaemonCounters, clients_died),
          offsetof(wire::DaemonCounters, clients_unmapped),
          offsetof(wire::DaemonCounters, clients_revoked),
          offsetof(wire::DaemonCounters, clients_rejoined),
          offsetof(wire::DaemonCounters, intents_rolled_back),
          offsetof(wire::DaemonCounters, intents_rolled_forward),
          offsetof(wire::DaemonCounters, intents_corrupt), offsetof(wire::DaemonCounters, restarts),
          offsetof(wire::DaemonCounters, clients_died_meanwhile),
          offsetof(wire::DaemonCounters, requests_answered_again),
          offsetof(wire::DaemonCounters, requests_refused),
          offsetof(wire::DaemonCounters, connections_refused),
          offsetof(wire::DaemonCounters, readers_withdrawn),
          offsetof(wire::DaemonCounters, readers_served_again),
          offsetof(wire::DaemonCounters, readers_mute));
  sum.add(sizeof(wire::DaemonLimits), offsetof(wire::DaemonLimits, clients),
          offsetof(wire::DaemonLimits, topics), offsetof(wire::DaemonLimits, publishers_per_topic),
          offsetof(wire::DaemonLimits, subscriptions_per_topic),
          offsetof(wire::DaemonLimits, slots_per_publisher),
          offsetof(wire::DaemonLimits, depth_max),
          offsetof(wire::DaemonLimits, windows_per_process));
  sum.add(sizeof(wire::UserShare), offsetof(wire::UserShare, clients),
          offsetof(wire::UserShare, publishers), offsetof(wire::UserShare, subscriptions),
          offsetof(wire::UserShare, wait_sets), offsetof(wire::UserShare, heap_bytes),
          offsetof(wire::UserShare, held_messages), offsetof(wire::UserShare, topics),
          offsetof(wire::UserShare, queued_bytes), offsetof(wire::UserShare, queued_seconds),
          offsetof(wire::UserShare, dumps_per_second),
          offsetof(wire::UserShare, publishers_per_topic),
          offsetof(wire::UserShare, subscriptions_per_topic),
          offsetof(wire::UserShare, callback_groups), offsetof(wire::UserShare, callback_threads));
  sum.add(sizeof(wire::DumpDaemon), offsetof(wire::DumpDaemon, header),
          offsetof(wire::DumpDaemon, version_major), offsetof(wire::DumpDaemon, version_minor),
          offsetof(wire::DumpDaemon, version_patch), offsetof(wire::DumpDaemon, pid),
          offsetof(wire::DumpDaemon, uid), offsetof(wire::DumpDaemon, log_level),
          offsetof(wire::DumpDaemon, incarnation), offsetof(wire::DumpDaemon, uptime_ns),
          offsetof(wire::DumpDaemon, arena_base), offsetof(wire::DumpDaemon, arena_bytes),
          offsetof(wire::DumpDaemon, window_bytes), offsetof(wire::DumpDaemon, windows_used),
          offsetof(wire::DumpDaemon, connections), offsetof(wire::DumpDaemon, observers),
          offsetof(wire::DumpDaemon, kept_descriptors),
          offsetof(wire::DumpDaemon, kept_descriptors_max), offsetof(wire::DumpDaemon, counters),
          offsetof(wire::DumpDaemon, limits), offsetof(wire::DumpDaemon, quota));
  sum.add(sizeof(wire::DumpProcess), offsetof(wire::DumpProcess, header),
          offsetof(wire::DumpProcess, client), offsetof(wire::DumpProcess, generation),
          offsetof(wire::DumpProcess, pid), offsetof(wire::DumpProcess, uid),
          offsetof(wire::DumpProcess, gid), offsetof(wire::DumpProcess, state),
          offsetof(wire::DumpProcess, domain), offsetof(wire::DumpProcess, age_ns),
          offsetof(wire::DumpProcess, wait_sets), offsetof(wire::DumpProcess, silent_wait_sets),
          offsetof(wire::DumpProcess, window_count), offsetof(wire::DumpProcess, region_count),
          offsetof(wire::DumpProcess, window), offsetof(wire::DumpProcess, blocked_bytes),
          offsetof(wire::DumpProcess, threads_left_out), offsetof(wire::DumpProcess, name),
          offsetof(wire::DumpProcess, blocked_by));
  sum.add(sizeof(wire::DumpTopic), offsetof(wire::DumpTopic, header),
          offsetof(wire::DumpTopic, topic), offsetof(wire::DumpTopic, link_blocks),
          offsetof(wire::DumpTopic, generation), offsetof(wire::DumpTopic, domain),
          offsetof(wire::DumpTopic, layout_hash), offsetof(wire::DumpTopic, name),
          offsetof(wire::DumpTopic, type));
  sum.add(sizeof(wire::DumpEndpoint), offsetof(wire::DumpEndpoint, header),
          offsetof(wire::DumpEndpoint, kind), offsetof(wire::DumpEndpoint, topic),
          offsetof(wire::DumpEndpoint, index), offsetof(wire::DumpEndpoint, generation),
          offsetof(wire::DumpEndpoint, board_word), offsetof(wire::DumpEndpoint, client),
          offsetof(wire::DumpEndpoint, client_generation), offsetof(wire::DumpEndpoint, qos),
          offsetof(wire::DumpEndpoint, extent), offsetof(wire::DumpEndpoint, slot_count),
          offsetof(wire::DumpEndpoint, first_sequence), offsetof(wire::DumpEndpoint, quota),
          offsetof(wire::DumpEndpoint, quota_of_others), offsetof(wire::DumpEndpoint, wait_set),
          offsetof(wire::DumpEndpoint, node));
  sum.add(sizeof(wire::DumpUser), offsetof(wire::DumpUser, header), offsetof(wire::DumpUser, uid),
          offsetof(wire::DumpUser, connections), offsetof(wire::DumpUser, observers),
          offsetof(wire::DumpUser, use));
  sum.add(sizeof(wire::DumpEnd), offsetof(wire::DumpEnd, header),
          offsetof(wire::DumpEnd, process_count), offsetof(wire::DumpEnd, topic_count),
          offsetof(wire::DumpEnd, endpoint_count), offsetof(wire::DumpEnd, user_count),
          offsetof(wire::DumpEnd, refusal_count), offsetof(wire::DumpEnd, callback_group_count),
          offsetof(wire::DumpEnd, callback_thread_count),
          offsetof(wire::DumpEnd, thread_executors_count), offsetof(wire::DumpEnd, lsn));
  sum.add(sizeof(wire::DumpCallbackGroup), offsetof(wire::DumpCallbackGroup, header),
          offsetof(wire::DumpCallbackGroup, client),
          offsetof(wire::DumpCallbackGroup, client_generation),
          offsetof(wire::DumpCallbackGroup, executor), offsetof(wire::DumpCallbackGroup, group),
          offsetof(wire::DumpCallbackGroup, reentrant), offsetof(wire::DumpCallbackGroup, reserved),
          offsetof(wire::DumpCallbackGroup, node), offsetof(wire::DumpCallbackGroup, name));
  sum.add(sizeof(wire::ThreadScheduling), offsetof(wire::ThreadScheduling, sets_policy),
          offsetof(wire::ThreadScheduling, policy), offsetof(wire::ThreadScheduling, priority),
          offsetof(wire::ThreadScheduling, sets_nice), offsetof(wire::ThreadScheduling, nice),
          offsetof(wire::ThreadScheduling, runtime_ns),
          offsetof(wire::ThreadScheduling, deadline_ns),
          offsetof(wire::ThreadScheduling, period_ns), offsetof(wire::ThreadScheduling, sets_cpus),
          offsetof(wire::ThreadScheduling, cpus));
  sum.add(sizeof(wire::DumpCallbackThread), offsetof(wire::DumpCallbackThread, header),
          offsetof(wire::DumpCallbackThread, client),
          offsetof(wire::DumpCallbackThread, client_generation),
          offsetof(wire::DumpCallbackThread, thread),
          offsetof(wire::DumpCallbackThread, executor_count),
          offsetof(wire::DumpCallbackThread, rule), offsetof(wire::DumpCallbackThread, setting),
          offsetof(wire::DumpCallbackThread, call), offsetof(wire::DumpCallbackThread, os_errno),
          offsetof(wire::DumpCallbackThread, scheduling));
  sum.add(sizeof(wire::DumpThreadExecutors), offsetof(wire::DumpThreadExecutors, header),
          offsetof(wire::DumpThreadExecutors, executor));
  sum.add(sizeof(wire::DumpRefusal), offsetof(wire::DumpRefusal, header),
          offsetof(wire::DumpRefusal, code), offsetof(wire::DumpRefusal, uid),
          offsetof(wire::DumpRefusal, pid), offsetof(wire::DumpRefusal, kind),
          offsetof(wire::DumpRefusal, domain), offsetof(wire::DumpRefusal, age_ns),
          offsetof(wire::DumpRefusal, times), offsetof(wire::DumpRefusal, process_name),
          offsetof(wire::DumpRefusal, topic), offsetof(wire::DumpRefusal, why));
  sum.add(sizeof(wire::SetLogLevel), offsetof(wire::SetLogLevel, header),
          offsetof(wire::SetLogLevel, level));
  sum.add(sizeof(wire::LogLevelIs), offsetof(wire::LogLevelIs, header),
          offsetof(wire::LogLevelIs, level));
  sum.add(sizeof(wire::AskAccess), offsetof(wire::AskAccess, header),
          offsetof(wire::AskAccess, domain), offsetof(wire::AskAccess, topic));
  sum.add(sizeof(wire::AccessIs), offsetof(wire::AccessIs, header), offsetof(wire::AccessIs, kind),
          offsetof(wire::AccessIs, line), offsetof(wire::AccessIs, everybody),
          offsetof(wire::AccessIs, rule_count), offsetof(wire::AccessIs, pattern),
          offsetof(wire::AccessIs, principals));
  sum.add(wire::version, wire::name_bytes, wire::packet_bytes_max, wire::answer_bytes_max,
          wire::descriptor_count_max, sizeof(wire::Announcement::Window));
  using wire::Opcode;
  sum.add(Opcode::hello, Opcode::open_window, Opcode::open_wait_set, Opcode::create_publisher,
          Opcode::create_subscription, Opcode::leave, Opcode::drained, Opcode::unlinked,
          Opcode::welcome, Opcode::window_opened, Opcode::wait_set_opened, Opcode::endpoint_created,
          Opcode::done, Opcode::refused, Opcode::announce, Opcode::window_announced, Opcode::forget,
          Opcode::orphaned, Opcode::kick, Opcode::notice);
  sum.add(Opcode::rejoin, Opcode::rejoined, Opcode::own, Opcode::region, Opcode::revoked,
          Opcode::revoke, Opcode::blocked, Opcode::bring_window, Opcode::withdrawn,
          Opcode::move_heap, Opcode::read_journal, Opcode::journal_record, Opcode::journal_end);
  sum.add(Opcode::observe, Opcode::dump, Opcode::observed, Opcode::dump_daemon,
          Opcode::dump_process, Opcode::dump_topic, Opcode::dump_endpoint, Opcode::dump_user,
          Opcode::dump_end, Opcode::dump_refusal, Opcode::set_log_level, Opcode::log_level_is,
          Opcode::ask_access, Opcode::access_is, wire::ProcessState::connected,
          wire::ProcessState::orphaned, wire::ProcessState::dead, wire::ProcessState::revoked,
          wire::JournalState::applied, wire::JournalState::pending, wire::JournalState::damaged);
  sum.add(Opcode::watch_graph, Opcode::graph_changed, Opcode::doorbells_renewed);
  sum.add(Opcode::callback_group, Opcode::callback_thread, Opcode::dump_callback_group,
          Opcode::dump_callback_thread, Opcode::dump_thread_executors, wire::ThreadSetting::no_rule,
          wire::ThreadSetting::due, wire::ThreadSetting::applied, wire::ThreadSetting::not_allowed,
          wire::ThreadSetting::refused, wire::ThreadSetting::not_found, wire::ThreadCall::none,
          wire::ThreadCall::sched_setattr, wire::ThreadCall::sched_setaffinity);
  sum.add(wire::Kind::publisher, wire::Kind::subscription, wire::Kind::region);
  return sum.value();
}

}  // namespace agnocast::abi
