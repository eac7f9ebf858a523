// SPDX-License-Identifier: Apache-2.0
//
// Effects: what a decision of the life cycle brings about, as values.
//
// A decision (endings.hpp, leaving.hpp, announcing.hpp) reads the registry and returns effects.
// EffectRunner carries them out, in their order. A decision does no I/O and changes no table; the
// runner decides nothing.
//
// Some decisions must see what an earlier effect has changed: whether a place is free is known when
// its last reader
// has let go. Such a decision is an effect itself (FreeUnused …). The runner asks for it when its turn comes, and
// carries out the answer before it goes on.
//
// The daemon may die between any two effects. The next one finds what the records before that say,
// so an effect that tells others of a change comes behind the effect that records it.
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

/// Nobody publishes there any more, and what is behind this head is not read.
struct OrphanPublisher {
  EndpointRef ref;
  std::uint64_t final_head = 0;
  journal::LeaveCause cause = journal::LeaveCause::left;
};
struct ChangeSubscription {
  EndpointRef ref;
  EndpointState state = EndpointState::leaving;
};
/// The publisher's word on the board is free; its place is too if the state is.
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
/// The place of a process is free, and so are its memory and its addresses.
struct FreeClient {
  ClientIndex client{};
};
/// The process is to be told of the endpoint, and has to unmap it before the place is used again.
struct RecordMember {
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
  std::uint64_t executor = 0;
};
using Packet =
    std::variant<wire::Reference, wire::Orphaned, wire::Done, wire::EndpointCreated, wire::Own>;
struct Send {
  ClientIndex to{};
  Packet packet;
};
/// The process of `receiver` is told of `subject`, and gets the descriptors of its process and its
/// doorbells. The record of that (RecordMember) is made first.
struct Announce {
  EndpointRef subject, receiver;
};
/// What is the matter with an endpoint, for its owner.
struct Notice {
  EndpointRef ref;
  Errc code{};
  std::string text;
  abi::QosPolicy policy = abi::QosPolicy::none;
};
/// The process comes back on a new connection, and is told everything once more.
struct BeginAnew {
  ClientIndex client{};
};

// --- what the daemon keeps in its own memory

/// It does not matter any more in which packet this was announced to the process.
struct ForgetAnnounced {
  ClientIndex client{};
  Announced subject;
};
struct CountAnsweredAgain {};

// --- decisions whose turn comes later (endings.hpp)

struct FreeUnused {
  EndpointRef ref;
};
struct FreeUnusedTopic {
  TopicIndex topic{};
};
struct FreeUnusedClient {
  ClientIndex client{};
};
/// Of too many endpoints of the topic that are over, the oldest.
struct GiveUpOrphans {
  TopicIndex topic{};
};
struct GiveUpSubscriptions {
  TopicIndex topic{};
};

/// The crash point B_settle: a place was found to be unused, and nothing has been freed.
struct BeginFree {};

}  // namespace effect

using Effect =
    std::variant<effect::OrphanPublisher, effect::ChangeSubscription, effect::EndPublisher,
                 effect::FreeSubscription, effect::FreeTopic, effect::FreeClient,
                 effect::RecordMember, effect::Acknowledge, effect::AcknowledgeRegion, effect::Ring,
                 effect::Send, effect::Announce, effect::Notice, effect::BeginAnew,
                 effect::ForgetAnnounced, effect::CountAnsweredAgain, effect::FreeUnused,
                 effect::FreeUnusedTopic, effect::FreeUnusedClient, effect::GiveUpOrphans,
                 effect::GiveUpSubscriptions, effect::BeginFree>;

/// A deque, because a list for a thousand readers must fit into the pieces of the memory reserve
/// (memory_reserve.hpp).
using Effects = std::deque<Effect>;

inline void append(Effects& to, const Effects& more) {
  to.insert(to.end(), more.begin(), more.end());
}

}  // namespace agnocast::daemon
