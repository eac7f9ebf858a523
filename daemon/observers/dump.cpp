// SPDX-License-Identifier: Apache-2.0

#include <daemon/observers/dump.hpp>

#include <daemon/transport/client_channel.hpp>

#include <algorithm>

namespace agnocast::daemon {
namespace {

using wire::Opcode;

class Writer {
 public:
  Writer(const Registry& registry, const DumpFacts& facts, const wire::Dump& request)
      : registry_(registry), facts_(facts), request_(request) {}

  std::vector<Outgoing> write() {
    put(Opcode::dump_daemon, facts_.daemon);
    for (std::uint32_t i = 0; i < registry_.client_high(); ++i) write_process(ClientIndex{i});
    for (std::uint32_t i = 0; i < registry_.topic_high(); ++i) write_topic(TopicIndex{i});
    write_users();
    write_refusals();
    if (request_.with_threads != 0) {
      for (std::uint32_t i = 0; i < registry_.client_high(); ++i) write_threads(ClientIndex{i});
    }
    end_.lsn = registry_.log().committed_lsn();
    put(Opcode::dump_end, end_);
    return std::move(packets_);
  }

 private:
  template <class Body>
  void put(Opcode opcode, Body body, std::vector<SharedFd> fds = {}) {
    body.header = {opcode, sizeof body, request_.header.request};
    const auto bytes = packet_of(body);
    packets_.push_back({{bytes.begin(), bytes.end()}, std::move(fds)});
  }

  void write_process(ClientIndex index) {
    const ClientRecord& record = registry_.client(index);
    if (record.state == ClientState::free) return;
    const DumpFacts::Process facts = facts_.process_of(index);
    wire::DumpProcess body{};
    body.client = number(index);
    body.generation = record.generation;
    body.pid = record.pid;
    body.uid = record.uid;
    body.gid = record.gid;
    body.state = facts.state;
    body.domain = record.domain;
    body.age_ns = facts.age_ns;
    body.wait_sets = record.wait_sets;
    body.window_count = static_cast<std::uint32_t>(record.window_count);
    const bool has_region = facts.region != nullptr;
    body.region_count = has_region ? 1 : 0;
    for (std::uint64_t w = 0; w < record.window_count; ++w)
      body.window[w] = {record.window[w].base, record.window[w].bytes, record.window[w].first};
    body.silent_wait_sets = facts.silent_wait_sets;
    body.blocked_bytes = facts.blocked_bytes;
    body.threads_left_out = facts.threads != nullptr ? facts.threads->left_out() : 0;
    body.blocked_by = name_of(facts.blocked_by);
    body.name = copy_of(record.name);
    std::vector<SharedFd> fds;
    if (has_region) fds.push_back(facts.region);
    put(Opcode::dump_process, body, std::move(fds));
    ++end_.process_count;
    owners_[record.uid];
  }

  void write_topic(TopicIndex index) {
    const TopicRecord& record = registry_.topic(index);
    if (record.state == TopicState::free) return;
    wire::DumpTopic body{};
    body.topic = number(index);
    body.link_blocks = record.link_blocks;
    body.generation = record.generation;
    body.domain = record.domain;
    body.layout_hash = record.layout_hash;
    body.name = copy_of(record.name);
    body.type = copy_of(record.type);
    put(Opcode::dump_topic, body);
    ++end_.topic_count;
    registry_.for_each_publisher(index, [&](std::uint32_t i, const PublisherRecord& publisher) {
      wire::DumpEndpoint endpoint = endpoint_of(Kind::publisher, index, i, publisher);
      endpoint.slot_count = publisher.slot_count;
      endpoint.first_sequence = abi::first_sequence_of(publisher.generation);
      write_endpoint(endpoint);
    });
    registry_.for_each_subscription(
        index, [&](std::uint32_t i, const SubscriptionRecord& subscription) {
          wire::DumpEndpoint endpoint = endpoint_of(Kind::subscription, index, i, subscription);
          endpoint.quota = subscription.quota;
          endpoint.quota_of_others = subscription.quota_of_others;
          endpoint.wait_set = subscription.wait_set;
          write_endpoint(endpoint);
        });
  }

  template <class Record>
  wire::DumpEndpoint endpoint_of(Kind kind, TopicIndex topic, std::uint32_t index,
                                 const Record& record) const {
    wire::DumpEndpoint body{};
    body.kind = kind;
    body.topic = number(topic);
    body.index = index;
    body.generation = record.generation;
    body.board_word = abi::pack_board_word(record.generation, on_board(record.state));
    body.client = number(record.client);
    body.client_generation = registry_.client(record.client).generation;
    body.qos = record.qos;
    body.extent = record.extent;
    body.node = copy_of(record.node);
    return body;
  }
  void write_endpoint(const wire::DumpEndpoint& body) {
    put(Opcode::dump_endpoint, body);
    ++end_.endpoint_count;
  }

  void write_users() {
    for (const auto& [uid, user] : facts_.users) owners_[uid] = user;
    for (const auto& [uid, user] : owners_) {
      const Usage usage = registry_.accounts().usage_of(uid);
      const Places places = registry_.accounts().most_places_of(uid);
      wire::DumpUser body{};
      body.uid = uid;
      body.connections = user.connections;
      body.observers = user.observers;
      body.use = {usage.clients,        usage.publishers,     usage.subscriptions,
                  usage.wait_sets,      usage.heap_bytes,     usage.held_messages,
                  usage.topics,         user.queued_bytes,    user.waits_ms / 1000,
                  user.answers_ahead,   places.publishers,    places.subscriptions,
                  user.callback_groups, user.callback_threads};
      put(Opcode::dump_user, body);
      ++end_.user_count;
    }
  }

  void write_refusals() {
    for (const Refusals::Refusal& refusal : facts_.refusals) {
      wire::DumpRefusal body{};
      body.code = static_cast<std::uint32_t>(refusal.code);
      body.uid = refusal.uid;
      body.pid = refusal.pid;
      body.kind = refusal.kind;
      body.domain = refusal.domain;
      body.age_ns = facts_.now_ns - std::min(refusal.stamp_ns, facts_.now_ns);
      body.times = refusal.times;
      body.process_name = name_of(refusal.process_name);
      body.topic = name_of(refusal.topic);
      body.why = name_of(refusal.why);
      put(Opcode::dump_refusal, body);
      ++end_.refusal_count;
    }
  }

  void write_threads(ClientIndex index) {
    const ClientRecord& record = registry_.client(index);
    if (record.state == ClientState::free) return;
    const CallbackThreads* const threads = facts_.process_of(index).threads;
    if (threads == nullptr) return;
    for (const auto& [key, group] : threads->groups()) {
      wire::DumpCallbackGroup body{};
      body.client = number(index);
      body.client_generation = record.generation;
      body.executor = key.first;
      body.group = key.second;
      body.reentrant = group.reentrant ? 1 : 0;
      body.node = name_of(group.node);
      body.name = name_of(group.name);
      put(Opcode::dump_callback_group, body);
      ++end_.callback_group_count;
    }
    for (const auto& [id, thread] : threads->threads()) {
      wire::DumpCallbackThread body{};
      body.client = number(index);
      body.client_generation = record.generation;
      body.thread = id;
      body.setting = thread.outcome.setting;
      body.call = thread.outcome.call;
      body.os_errno = static_cast<std::uint32_t>(thread.outcome.os_errno);
      if (thread.rule) {
        body.rule = facts_.thread_rules[*thread.rule].line;
        body.scheduling = facts_.thread_rules[*thread.rule].scheduling;
      }
      body.executor_count = static_cast<std::uint32_t>(thread.executors.size());
      put(Opcode::dump_callback_thread, body);
      ++end_.callback_thread_count;
      write_executors(thread.executors);
    }
  }
  void write_executors(std::span<const std::uint64_t> executors) {
    while (!executors.empty()) {
      const auto some =
          executors.first(std::min<std::size_t>(executors.size(), wire::thread_executor_count_max));
      wire::DumpThreadExecutors body{};
      std::copy(some.begin(), some.end(), body.executor);
      put(Opcode::dump_thread_executors, body);
      ++end_.thread_executors_count;
      executors = executors.subspan(some.size());
    }
  }

  const Registry& registry_;
  const DumpFacts& facts_;
  const wire::Dump& request_;
  std::map<std::uint32_t, DumpFacts::User> owners_;
  wire::DumpEnd end_{};
  std::vector<Outgoing> packets_;
};

}  // namespace

std::vector<Outgoing> make_dump(const Registry& registry, const DumpFacts& facts,
                                const wire::Dump& request) {
  return Writer(registry, facts, request).write();
}

}  // namespace agnocast::daemon
