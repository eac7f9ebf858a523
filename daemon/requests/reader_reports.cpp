// SPDX-License-Identifier: Apache-2.0
//
// ReaderReports: see the header.

#include <daemon/requests/reader_reports.hpp>

#include <base/clock.hpp>
#include <daemon/lifecycle/endpoint_manager.hpp>
#include <daemon/state/user_log.hpp>
#include <journal/withdrawal.hpp>

namespace agnocast::daemon {

// A client reports this about its own publisher. The daemon looks the reader up and takes nothing
// about it from the client. (The reader may never have been announced to that process: it is also
// withdrawn when it could not be mapped.)
void ReaderReports::withdrawn(const PeerIdentity& who, ClientIndex client,
                              const wire::Withdrawn& report) {
  const ReaderPair pair{{Kind::publisher, static_cast<TopicIndex>(report.topic),
                         static_cast<std::uint32_t>(report.publisher)},
                        {Kind::subscription, static_cast<TopicIndex>(report.topic),
                         static_cast<std::uint32_t>(report.subscription)}};
  if (!registry_.is_used(pair.publisher) || !registry_.is_used(pair.reader) ||
      registry_.generation_of(pair.publisher) != report.publisher_generation ||
      registry_.generation_of(pair.reader) != report.subscription_generation ||
      registry_.owner_of(pair.publisher) != client)
    return;
  const auto why = static_cast<abi::Withdrawal>(report.why);
  const bool is_served = why == abi::Withdrawal::none;
  const ClientRecord& reader = registry_.client(registry_.owner_of(pair.reader));
  if (notes_.take(who.uid, reader.uid, monotonic_ms())) {
    is_served ? registry_.note_served_again(pair) : registry_.note_withdrawn(pair, why);
  } else {
    auto& counters = registry_.counters();
    ++(is_served ? counters.readers_served_again : counters.readers_withdrawn);
  }
  const auto& topic = registry_.topic(pair.publisher.topic).name;
  if (is_served) {
    log_for_user(log_, LogLevel::info, who.uid, "reader served again",
                 {{"topic", topic},
                  {"publisher_pid", who.pid},
                  {"publisher_uid", who.uid},
                  {"pid", reader.pid},
                  {"uid", reader.uid}});
  } else {
    log_for_user(log_, LogLevel::warning, who.uid, "reader withdrawn",
                 {{"topic", topic},
                  {"publisher_pid", who.pid},
                  {"publisher_uid", who.uid},
                  {"pid", reader.pid},
                  {"uid", reader.uid},
                  {"bytes", report.bytes},
                  {"why", journal::sentence_of(why)}});
  }
}

void ReaderReports::mute(const EndpointRef& subscription) {
  const ClientRecord& owner = registry_.client(registry_.owner_of(subscription));
  if (notes_.take(owner.uid, owner.uid, monotonic_ms())) {
    registry_.note_mute(subscription);
  } else {
    ++registry_.counters().readers_mute;
  }
}

void ReaderReports::created(ClientIndex client, const CreateRequest& request) {
  if (!doorbells_.is_known_silent(client, request.wait_set)) return;
  const auto made = registry_.find_creation(client, Kind::subscription, request.request);
  if (made) mute(*made);
}

void ReaderReports::look_for_silent_doorbells(std::uint64_t now_ms) {
  notes_.forget_unused(now_ms);
  for (const Doorbells::WaitSetPlace& silent : doorbells_.look()) {
    if (!registry_.is_alive(silent.client)) continue;
    for (const EndpointRef& ref : registry_.endpoints_of(silent.client)) {
      if (ref.kind != Kind::subscription) continue;
      const SubscriptionRecord& record = registry_.subscription(ref.topic, ref.index);
      if (record.state == EndpointState::active && record.wait_set == silent.wait_set) mute(ref);
    }
  }
}

}  // namespace agnocast::daemon
