// SPDX-License-Identifier: Apache-2.0
//
// EffectRunner: carries out the effects that the life cycle has decided (effects.hpp), in order.
#pragma once

#include <daemon/lifecycle/announcer.hpp>
#include <daemon/lifecycle/effects.hpp>
#include <daemon/lifecycle/endings.hpp>
#include <daemon/state/registry.hpp>
#include <daemon/transport/client_channel.hpp>
#include <daemon/transport/doorbells.hpp>

#include <functional>

namespace agnocast::daemon {

class EffectRunner {
 public:
  EffectRunner(Registry& registry, Endings& endings, Announcer& announcer, Doorbells& doorbells,
               ClientChannel& channel) noexcept
      : registry_(registry),
        endings_(endings),
        announcer_(announcer),
        doorbells_(doorbells),
        channel_(channel) {}

  /// Called with a process whose place is free: its memory and addresses may be used again.
  std::function<void(ClientIndex)> on_client_freed;
  std::function<void(TopicIndex)> on_topic_freed;

  void run(const Effects& effects);

 private:
  void carry_out(const effect::OrphanPublisher& effect);
  void carry_out(const effect::ChangeSubscription& effect);
  void carry_out(const effect::EndPublisher& effect);
  void carry_out(const effect::FreeSubscription& effect);
  void carry_out(const effect::FreeTopic& effect);
  void carry_out(const effect::FreeClient& effect);
  void carry_out(const effect::RecordNotified& effect);
  void carry_out(const effect::Acknowledge& effect);
  void carry_out(const effect::AcknowledgeRegion& effect);
  void carry_out(const effect::Ring& effect);
  void carry_out(const effect::Send& effect);
  void carry_out(const effect::Announce& effect);
  void carry_out(const effect::Notice& effect);
  void carry_out(const effect::BeginAnew& effect);
  void carry_out(const effect::ForgetAnnounced& effect);
  void carry_out(const effect::CountAnsweredAgain& effect);
  void carry_out(const effect::FreeUnused& effect);
  void carry_out(const effect::FreeUnusedTopic& effect);
  void carry_out(const effect::FreeUnusedClient& effect);
  void carry_out(const effect::GiveUpOrphans& effect);
  void carry_out(const effect::GiveUpSubscriptions& effect);
  void carry_out(const effect::BeginFree& effect);

  Registry& registry_;
  Endings& endings_;
  Announcer& announcer_;
  Doorbells& doorbells_;
  ClientChannel& channel_;
};

}  // namespace agnocast::daemon
