// SPDX-License-Identifier: Apache-2.0
//
// AccessControl: see the header.

#include <daemon/admission/access_control.hpp>

#include <string>
#include <string_view>

namespace agnocast::daemon {
namespace {

std::string line_of(const Decision& decision) {
  return decision.rule ? "rule in line " + std::to_string(decision.line) : "no rule names it";
}

std::string line_of(const AccessRule* rule) {
  return rule != nullptr ? "rule in line " + std::to_string(rule->line) : "no rule names it";
}

}  // namespace

Subject subject_of(const PeerIdentity& identity) {
  Subject subject{identity.uid, identity.groups};
  subject.groups.push_back(identity.gid);
  return subject;
}

Result<void> AccessControl::check_endpoint(const PeerIdentity& who, ClientIndex client,
                                           const CreateRequest& request) const {
  const std::uint64_t domain = request.domain.value_or(registry_.client(client).domain);
  const bool publisher = request.kind == Kind::publisher;
  const Subject subject = subject_of(who);
  const Decision decision = decide(rules_, subject, domain, request.topic,
                                   publisher ? Action::publish : Action::subscribe);
  if (!decision.allowed)
    return fail_with(Errc::access_denied, "user " + std::to_string(subject.uid) + " may not " +
                                              (publisher ? "publish on " : "subscribe to ") +
                                              std::string(request.topic) + " (" +
                                              line_of(decision) + ")");
  return publisher ? check_readers(client, domain, request.topic)
                   : check_publishers(subject, domain, request.topic);
}

Result<void> AccessControl::check_readers(ClientIndex client, std::uint64_t domain,
                                          std::string_view topic) const {
  const ClientRecord& record = registry_.client(client);
  if (record.readers == 0) return {};
  const std::uint64_t wanted = readers_of(rules_, domain, topic);
  if (record.readers == wanted) return {};
  std::string others = "its earlier topics";
  for (const EndpointRef& ref : registry_.endpoints_of(client)) {
    const TopicRecord& other = registry_.topic(ref.topic);
    if (ref.kind != Kind::publisher || readers_of(rules_, other.domain, other.name) == wanted)
      continue;
    others = std::string(other.name) + " (" +
             line_of(deciding_rule(rules_, other.domain, other.name, Action::subscribe)) + ")";
    break;
  }
  return fail_with(Errc::readers_differ,
                   "other users may subscribe to " + std::string(topic) + " (" +
                       line_of(deciding_rule(rules_, domain, topic, Action::subscribe)) +
                       ") than to " + others + ", and all topics of a process lie in one heap");
}

Result<void> AccessControl::check_publishers(const Subject& who, std::uint64_t domain,
                                             std::string_view topic) const {
  const auto known = registry_.find_topic(domain, topic);
  if (rules_.empty() || !known) return {};
  Result<void> allowed;
  registry_.for_each_publisher(*known, [&](std::uint32_t, const PublisherRecord& publisher) {
    if (!allowed || publisher.state != EndpointState::active) return;
    for (const EndpointRef& ref : registry_.endpoints_of(publisher.client)) {
      const TopicRecord& other = registry_.topic(ref.topic);
      if (ref.kind != Kind::publisher || ref.topic == *known) continue;
      const Decision decision = decide(rules_, who, other.domain, other.name, Action::subscribe);
      if (decision.allowed) continue;
      allowed =
          fail_with(Errc::access_denied,
                    "process " + std::to_string(registry_.client(publisher.client).pid) +
                        " publishes " + std::string(topic) + " and " + std::string(other.name) +
                        ", to which user " + std::to_string(who.uid) + " may not subscribe (" +
                        line_of(decision) + "): restart it");
      return;
    }
  });
  return allowed;
}

void AccessControl::warn_of_other_readers(ClientIndex client) {
  const ClientRecord& record = registry_.client(client);
  for (const EndpointRef& ref : registry_.endpoints_of(client)) {
    const TopicRecord& topic = registry_.topic(ref.topic);
    if (ref.kind != Kind::publisher ||
        readers_of(rules_, topic.domain, topic.name) == record.readers)
      continue;
    log_.write_limited(
        "readers uid=" + std::to_string(record.uid), LogLevel::warning, "readers have changed",
        {{"topic", topic.name},
         {"client", number(client)},
         {"pid", record.pid},
         {"uid", record.uid},
         {"why", line_of(deciding_rule(rules_, topic.domain, topic.name, Action::subscribe))},
         {"hint", "processes that have its memory keep it: restart the publisher's process"}});
    return;
  }
}

std::string AccessControl::forbidden_endpoint(ClientIndex client,
                                              const PeerIdentity& identity) const {
  if (rules_.empty()) return {};
  const Subject who = subject_of(identity);
  for (const EndpointRef& ref : registry_.endpoints_of(client)) {
    const bool publisher = ref.kind == Kind::publisher;
    const bool is_active =
        publisher ? registry_.publisher(ref.topic, ref.index).state == EndpointState::active
                  : registry_.subscription(ref.topic, ref.index).state == EndpointState::active;
    if (!is_active) continue;
    const TopicRecord& topic = registry_.topic(ref.topic);
    const std::string_view name = topic.name;
    const Decision decision =
        decide(rules_, who, topic.domain, name, publisher ? Action::publish : Action::subscribe);
    if (decision.allowed) continue;
    return "user " + std::to_string(who.uid) + " may not " +
           (publisher ? "publish on " : "subscribe to ") + std::string(name) + " any more (" +
           line_of(decision) + ")";
  }
  return {};
}

}  // namespace agnocast::daemon
