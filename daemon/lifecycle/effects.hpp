// SPDX-License-Identifier: Apache-2.0
//
// Effects: the results of a decision of the life cycle, as values.
//
// A decision (endings.hpp, leaving.hpp, announcing.hpp) reads the registry and returns effects.
// EffectRunner carries them out in order. A decision does no I/O and changes no table; the runner
// decides nothing.
//
// Some decisions must see what an earlier effect has changed: a place is free only when its last
// reader has acknowledged. Such a decision is an effect itself (FreeUnused …): the runner asks for
// it in its order and carries out the answer before it goes on.
//
// The daemon may die between any two effects. The next one finds the records of the earlier
// effects, so an effect that notifies others of a change comes after the effect that records it.
#pragma once

#include <agnocast/abi/wire.hpp>
#include <agnocast/abi/words.hpp>
#include <agnocast/error.hpp>
#include <daemon/state/registry.hpp>
#include <daemon/transport/session.hpp>
#include <journal/record.hpp>

#include <cstdint>
#include <deque>
#include <string>
#include <utility>
#include <variant>

namespace agnocast::daemon {

namespace effect {

// --- one record of the redo log each

/// The publisher publishes no more, and messages behind this head are not read.
struct OrphanPublisher {
  EndpointRef ref;
  std::uint64_t final_head = 0;
  journal::LeaveCause cause = journal::LeaveCause::left;
};
struct ChangeSubscription {
  EndpointRef ref;
  EndpointState state = EndpointState::leaving;
};
/// Frees the publisher's word on the board, and its place too if the state is free.
struct EndPublisher {
  EndpointRef ref;
  EndpointState state = EndpointState::free;
};
struct FreeSubscription {
  EndpointRef ref;
};
struct FreeTopic {
  TopicIndex topic{};
};
/// Frees the place of a process, with its memory and its addresses.
struct FreeClient {
  ClientIndex client{};
};
/// The process is to be notified of the endpoint, and to unmap it before the place is reused.
struct RecordNotified {
  EndpointRef ref;
  ClientIndex to{};
};
/// A process has unmapped an endpoint, or the region of another process.
struct Acknowledge {
  EndpointRef ref;
  ClientIndex by{};
};
struct AcknowledgeRegion {
  ClientIndex owner{}, by{};
};

// --- what others see

struct Ring {
  ClientIndex client{};
  std::uint64_t wait_set = 0;
};
using Packet =
    std::variant<wire::Reference, wire::Orphaned, wire::Done, wire::EndpointCreated, wire::Own>;
struct Send {
  ClientIndex to{};
  Packet packet;
};
/// Announces `subject` to the process of `receiver`, with the descriptors and doorbells that it
/// needs. RecordNotified comes first.
struct Announce {
  EndpointRef subject, receiver;
};
/// A notice about an endpoint, for its owner.
struct Notice {
  EndpointRef ref;
  Errc code{};
  std::string text;
  abi::QosPolicy policy = abi::QosPolicy::none;
};
/// The process comes back on a new connection and is notified of everything once more.
struct BeginAnew {
  ClientIndex client{};
};

// --- what the daemon keeps in its own memory

/// The daemon need not know any more in which packet this was announced to the process.
struct ForgetAnnounced {
  ClientIndex client{};
  Announced subject;
};
struct CountAnsweredAgain {};

// --- decisions that come later (endings.hpp)

struct FreeUnused {
  EndpointRef ref;
};
struct FreeUnusedTopic {
  TopicIndex topic{};
};
struct FreeUnusedClient {
  ClientIndex client{};
};
/// Give up the oldest endpoints of the topic that are over, if there are too many.
struct GiveUpOrphans {
  TopicIndex topic{};
};
struct GiveUpSubscriptions {
  TopicIndex topic{};
};

/// The crash point B_vacate: an unused place was found, and nothing has been freed.
struct BeginFree {};

}  // namespace effect

using Effect =
    std::variant<effect::OrphanPublisher, effect::ChangeSubscription, effect::EndPublisher,
                 effect::FreeSubscription, effect::FreeTopic, effect::FreeClient,
                 effect::RecordNotified, effect::Acknowledge, effect::AcknowledgeRegion,
                 effect::Ring, effect::Send, effect::Announce, effect::Notice, effect::BeginAnew,
                 effect::ForgetAnnounced, effect::CountAnsweredAgain, effect::FreeUnused,
                 effect::FreeUnusedTopic, effect::FreeUnusedClient, effect::GiveUpOrphans,
                 effect::GiveUpSubscriptions, effect::BeginFree>;

/// A deque: a list for a thousand readers must fit into the pieces of the memory reserve
/// (memory_reserve.hpp).
using Effects = std::deque<Effect>;

inline void append(Effects& to, const Effects& more) {
  to.insert(to.end(), more.begin(), more.end());
}

}  // namespace agnocast::daemon
