// SPDX-License-Identifier: Apache-2.0
//
// ObserverRequests: see the header.

#include <daemon/observers/observer_requests.hpp>

#include <agnocast/abi/fingerprint.hpp>
#include <base/check.hpp>
#include <base/text/names.hpp>
#include <daemon/admission/check_caller.hpp>
#include <daemon/state/memory_reserve.hpp>

#include <unistd.h>

#include <algorithm>
#include <cstring>
#include <string>
#include <string_view>

namespace agnocast::daemon {

namespace {

// Writes as many words as fit, separated by commas.
template <std::size_t size>
void write_list(const std::vector<std::string>& words, char (&text)[size]) {
  std::string all;
  for (const std::string& word : words) {
    const std::string next = (all.empty() ? "" : ", ") + word;
    if (all.size() + next.size() + std::string_view(", ...").size() >= size) {
      all += ", ...";
      break;
    }
    all += next;
  }
  std::memcpy(text, all.data(), std::min(all.size(), size - 1));
}

}  // namespace

Result<void> ObserverRequests::observe(Peer& peer, const wire::Observe& request) {
  if (auto known = check_caller(peer.session.identity(), request.fingerprint); !known) return known;
  MemoryReserve::no_return();
  UserConnections& used = connections_.user(peer.session.identity().uid);
  if (!peer.counts_as_observer) {
    if (auto admitted = admission_.admit_observer(used.observers); !admitted) return admitted;
    connections_.count_as_observer(peer);
  }
  connections_.become_observer(peer);
  auto packet = make_body<wire::Observed>(wire::Opcode::observed, request.header.request);
  packet.fingerprint = abi::fingerprint();
  packet.incarnation = registry_.incarnation();
  packet.client_region_bytes = abi::client_region_bytes;
  output_.reply(peer, packet_of(packet), {regions_.board_reader()});
  log_.write(LogLevel::debug, "observer",
             {{"pid", peer.session.identity().pid}, {"uid", peer.session.identity().uid}});
  return {};
}

Result<void> ObserverRequests::dump(Peer& peer, const wire::Dump& request) {
  answers_.ask(peer, request);
  return {};
}

Result<void> ObserverRequests::read_journal(Peer& peer, const wire::ReadJournal& request) {
  answers_.ask(peer, request);
  return {};
}

Result<void> ObserverRequests::revoke(Peer& peer, const wire::Revoke& request) {
  const ClientIndex client{static_cast<std::uint32_t>(request.client)};
  if (number(client) >= registry_.client_high() || !registry_.is_alive(client) ||
      registry_.client(client).generation != request.generation)
    return fail_with(Errc::endpoint_gone, "there is no such process, or it is without a session");
  const PeerIdentity& who = peer.session.identity();
  const ClientRecord& record = registry_.client(client);
  if (who.uid != 0 && who.uid != ::geteuid() && who.uid != record.uid)
    return fail_with(Errc::permission_denied, "user " + std::to_string(who.uid) +
                                                  " may not revoke a process of user " +
                                                  std::to_string(record.uid));
  Peer* const revoked = connections_.of_client(client);
  AGNOCAST_CHECK(revoked != nullptr);
  termination_.revoke(*revoked, "revoked by user " + std::to_string(who.uid) + " (pid " +
                                    std::to_string(who.pid) + ")");
  output_.reply(peer, packet_of(make_body<wire::Done>(wire::Opcode::done, request.header.request)));
  return {};
}

Result<void> ObserverRequests::set_log_level(Peer& peer, const wire::SetLogLevel& request) {
  const PeerIdentity& who = peer.session.identity();
  if (request.level != 0) {
    if (who.uid != 0 && who.uid != ::geteuid())
      return fail_with(Errc::permission_denied, "user " + std::to_string(who.uid) +
                                                    " may not change the log level of agnocastd");
    log_.set_level(static_cast<LogLevel>(request.level));
    log_.write(LogLevel::notice, "log level",
               {{"level", name_of(log_.level())}, {"pid", who.pid}, {"uid", who.uid}});
  }
  auto answer = make_body<wire::LogLevelIs>(wire::Opcode::log_level_is, request.header.request);
  answer.level = static_cast<std::uint64_t>(log_.level());
  output_.reply(peer, packet_of(answer));
  return {};
}

Result<void> ObserverRequests::ask_access(Peer& peer, const wire::AskAccess& request) {
  std::string_view topic;
  AGNOCAST_CHECK(text_of(request.topic, topic));  // decode() has checked it
  if (const auto problem = check_topic_name(topic))
    return fail_with(Errc::invalid_name, "topic " + printable(topic) + ": " + problem->text());
  const auto& rules = rules_;
  for (const Action action : {Action::publish, Action::subscribe}) {
    auto answer = make_body<wire::AccessIs>(wire::Opcode::access_is, request.header.request);
    answer.kind = action == Action::publish ? Kind::publisher : Kind::subscription;
    answer.rule_count = static_cast<std::uint32_t>(rules.size());
    const AccessRule* const rule = deciding_rule(rules, request.domain, topic, action);
    answer.everybody = rule == nullptr ? 1 : 0;
    if (rule != nullptr) {
      const Principals& who = action == Action::publish ? *rule->publish : *rule->subscribe;
      answer.line = rule->line;
      answer.everybody = who.everybody ? 1 : 0;
      answer.pattern = name_of(rule->topic);
      write_list(who.written, answer.principals);
    }
    output_.reply(peer, packet_of(answer));
  }
  return {};
}

}  // namespace agnocast::daemon
