// SPDX-License-Identifier: Apache-2.0
//
// RefusalReport: see the header.

#include <daemon/admission/refusal_report.hpp>

#include <base/clock.hpp>

#include <optional>
#include <utility>

namespace agnocast::daemon {

void RefusalReport::report(Peer& peer, const Request& request, std::uint64_t id, Errc code,
                           int os_errno, std::string_view why) {
  remember(peer, request, code, why);
  answer(peer, request, id, code, os_errno, why);
}

void RefusalReport::answer(Peer& peer, const Request& request, std::uint64_t id, Errc code,
                           int os_errno, std::string_view text) {
  auto packet = make_body<wire::Refused>(wire::Opcode::refused, id);
  packet.code = static_cast<std::uint32_t>(code);
  packet.os_errno = static_cast<std::uint32_t>(os_errno);
  packet.text = name_of(text);
  const std::uint32_t uid = peer.session.identity().uid;
  ++registry_.counters().requests_refused;
  std::optional<std::string_view> topic, limit;
  std::optional<std::uint64_t> value, used, asked;
  if (const auto* const create = std::get_if<CreateRequest>(&request)) topic = create->topic;
  const Admission::Exceeded& exceeded = admission_.exceeded();
  if (code == Errc::quota_exceeded && !exceeded.limit.empty()) {
    limit = exceeded.limit;
    value = exceeded.value;
    used = exceeded.used;
    asked = exceeded.asked;
  }
  log_.write_limited("refused uid=" + std::to_string(uid), LogLevel::warning, "request refused",
                     {{"pid", peer.session.identity().pid},
                      {"uid", uid},
                      {"topic", topic},
                      {"limit", limit},
                      {"value", value},
                      {"used", used},
                      {"asked", asked},
                      {"code", word_of(code)},
                      {"errno", os_errno},
                      {"why", text}});
  output_.reply(peer, packet_of(packet));
}

void RefusalReport::remember(const Peer& peer, const Request& request, Errc code,
                             std::string_view why) {
  const PeerIdentity& who = peer.session.identity();
  Refusals::Refusal refusal;
  refusal.code = code;
  refusal.uid = who.uid;
  refusal.pid = static_cast<std::uint32_t>(who.pid);
  refusal.why = why;
  refusal.stamp_ns = monotonic_ns();
  if (const auto client = peer.session.client()) {
    refusal.domain = registry_.client(*client).domain;
    refusal.process_name = registry_.client(*client).name;
  }
  if (const auto* const create = std::get_if<CreateRequest>(&request)) {
    refusal.domain = create->domain.value_or(refusal.domain);
    refusal.kind = create->kind;
    refusal.topic = create->topic;
  }
  refusals_.add(std::move(refusal));
}

}  // namespace agnocast::daemon
