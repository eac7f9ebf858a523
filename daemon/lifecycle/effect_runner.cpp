// SPDX-License-Identifier: Apache-2.0
//
// EffectRunner: see the header.

#include <daemon/lifecycle/effect_runner.hpp>

#include <daemon/state/steps.hpp>

#include <variant>

namespace agnocast::daemon {

void EffectRunner::run(const Effects& effects) {
  for (const Effect& one : effects) std::visit([this](const auto& it) { carry_out(it); }, one);
}

// --- one record each

void EffectRunner::carry_out(const effect::OrphanPublisher& effect) {
  registry_.orphan_publisher(effect.ref.topic, effect.ref.index, effect.final_head, effect.cause);
}
void EffectRunner::carry_out(const effect::ChangeSubscription& effect) {
  registry_.change_subscription(effect.ref.topic, effect.ref.index, effect.state);
}
void EffectRunner::carry_out(const effect::EndPublisher& effect) {
  registry_.end_publisher(effect.ref.topic, effect.ref.index, effect.state);
}
void EffectRunner::carry_out(const effect::FreeSubscription& effect) {
  registry_.free_subscription(effect.ref.topic, effect.ref.index);
}
void EffectRunner::carry_out(const effect::FreeTopic& effect) {
  registry_.free_topic(effect.topic);
  if (on_topic_freed) on_topic_freed(effect.topic);
}
void EffectRunner::carry_out(const effect::FreeClient& effect) {
  registry_.free_client(effect.client);
  if (on_client_freed) on_client_freed(effect.client);
}
void EffectRunner::carry_out(const effect::RecordNotified& effect) {
  announcer_.record_notified(effect.ref, effect.to);
}
void EffectRunner::carry_out(const effect::Acknowledge& effect) {
  registry_.acknowledge_unmap(effect.ref, effect.by);
}
void EffectRunner::carry_out(const effect::AcknowledgeRegion& effect) {
  registry_.acknowledge_region_unmap(effect.owner, effect.by);
}

// --- what others see

void EffectRunner::carry_out(const effect::Ring& effect) {
  AGNOCAST_CRASH_POINT(B_ring);
  doorbells_.ring(effect.client, effect.wait_set);
}
void EffectRunner::carry_out(const effect::Send& effect) {
  std::visit([&](const auto& packet) { channel_.send(effect.to, packet_of(packet), {}); },
             effect.packet);
}
void EffectRunner::carry_out(const effect::Announce& effect) {
  announcer_.announce(effect.subject, effect.receiver);
}
void EffectRunner::carry_out(const effect::Notice& effect) {
  announcer_.notice(effect.ref, effect.code, effect.text, effect.policy);
}
void EffectRunner::carry_out(const effect::BeginAnew& effect) {
  channel_.begin_anew(effect.client,
                      "the daemon does not remember all announcements to processes of its user");
}

// --- what the daemon keeps in its own memory

void EffectRunner::carry_out(const effect::ForgetAnnounced& effect) {
  Session* const session = channel_.session_of(effect.client);
  if (session != nullptr) session->announcements().forget(effect.subject);
}
void EffectRunner::carry_out(const effect::CountAnsweredAgain&) {
  ++registry_.counters().requests_answered_again;
}

// --- decisions that depend on earlier effects

void EffectRunner::carry_out(const effect::FreeUnused& effect) {
  run(endings_.free_unused(effect.ref));
}
void EffectRunner::carry_out(const effect::FreeUnusedTopic& effect) {
  run(endings_.free_unused_topic(effect.topic));
}
void EffectRunner::carry_out(const effect::FreeUnusedClient& effect) {
  run(endings_.free_unused_client(effect.client));
}
void EffectRunner::carry_out(const effect::GiveUpOrphans& effect) {
  run(endings_.give_up_orphans(effect.topic));
}
void EffectRunner::carry_out(const effect::GiveUpSubscriptions& effect) {
  run(endings_.give_up_subscriptions(effect.topic));
}
void EffectRunner::carry_out(const effect::BeginFree&) { AGNOCAST_CRASH_POINT(B_vacate); }

}  // namespace agnocast::daemon
