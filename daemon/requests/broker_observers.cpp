// SPDX-License-Identifier: Apache-2.0
//
// Broker: observers: processes that only look (agnocast-ctl). They have no place in the tables; an
// answer is made at once and read at their pace, within their patience.

#include <daemon/requests/broker.hpp>

#include <agnocast/abi/fingerprint.hpp>
#include <agnocast/version.hpp>
#include <base/clock.hpp>
#include <base/names.hpp>
#include <daemon/requests/flight_recorder.hpp>
#include <daemon/state/memory_reserve.hpp>

#include <base/check.hpp>

#include <unistd.h>

#include <algorithm>
#include <cstring>
#include <new>
#include <utility>

namespace agnocast::daemon {

namespace {

// As many as fit, separated by commas.
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

// What an observer has not read by then is thrown away, and the observer with it.
constexpr std::uint64_t observer_patience_ms = 5'000;

}  // namespace

Result<void> Broker::observe(Peer& peer, const wire::Observe& request) {
  if (auto known = check_caller(peer, request.fingerprint); !known) return known;
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
  packet.client_region_bytes = Registry::client_region_bytes;
  output_.reply(peer, packet_of(packet), {regions_.board_reader()});
  log_.write(LogLevel::debug, "observer",
             {{"pid", peer.session.identity().pid}, {"uid", peer.session.identity().uid}});
  return {};
}

Result<void> Broker::dump(Peer& peer, const wire::Dump& request) {
  peer.awaits_change.reset();
  if (request.waits != 0 && request.seen == registry_.log().committed_lsn()) {
    peer.awaits_change = request;
  } else {
    answer_in_turn(peer, request);
  }
  return {};
}

// A small request for much work. Who has had his share waits, and is answered with what is true then.
void Broker::answer_in_turn(Peer& peer, const LongRequest& request) {
  MemoryReserve::no_return();
  const std::uint64_t rate = options_.config.quota.dumps_per_second;
  const auto allowance =
      rate == unlimited ? Allowance(1, 0) : Allowance(rate, std::uint64_t{1000} / rate);
  const std::uint32_t uid = peer.session.identity().uid;
  Answers& answers = answers_.try_emplace(uid, Answers{allowance, {}}).first->second;
  peer.asked = request;
  answers.waiting.push_back(peer.id);
}

void Broker::answer_whose_turn_it_is() {
  const std::uint64_t now = monotonic_ms();
  for (auto& [uid, answers] : answers_) {
    while (!answers.waiting.empty()) {
      Peer* const peer = connections_.find(answers.waiting.front());
      if (peer == nullptr || peer->session.closed() || !peer->asked) {
        answers.waiting.pop_front();
        continue;
      }
      // What others of this user have not read yet is read, or thrown away, soon.
      if (peer->session.is_crowded()) break;
      if (options_.config.quota.dumps_per_second != unlimited && !answers.allowance.take(now)) break;
      answers.waiting.pop_front();
      answer(*peer, *std::exchange(peer->asked, std::nullopt));
    }
  }
}

void Broker::answer(Peer& peer, const LongRequest& request) {
  try {
    const MemoryReserve::MayFail may_fail;
    if (const auto* const dump = std::get_if<wire::Dump>(&request)) {
      answer_at_length(peer, make_dump(registry_, facts(), *dump));
    } else {
      answer_at_length(
          peer, make_journal(registry_, std::get<wire::ReadJournal>(request), monotonic_ns()));
    }
  } catch (const std::bad_alloc&) {
    output_.end(peer, "agnocastd has no memory left for an answer at length");
  }
}

int Broker::answers_due_ms() const noexcept {
  const std::uint64_t now = monotonic_ms();
  std::uint64_t due = UINT64_MAX;
  for (const auto& [uid, answers] : answers_) {
    if (answers.waiting.empty()) continue;
    const Peer* const first = connections_.find(answers.waiting.front());
    // Who waits for room does not wait for time, and is looked at with everything else.
    const bool is_crowded = first != nullptr && first->session.is_crowded();
    due = std::min(due, is_crowded ? 1000 : answers.allowance.due_ms(now));
  }
  return due == UINT64_MAX ? -1 : static_cast<int>(std::min<std::uint64_t>(due, 1000));
}

void Broker::answer_who_awaits_change() {
  const std::uint64_t lsn = registry_.log().committed_lsn();
  if (connections_.observer_count() == 0 || lsn == answered_lsn_) return;
  answered_lsn_ = lsn;
  for (const auto& [id, peer] : connections_.all()) {
    if (peer->session.closed() || !peer->awaits_change || peer->awaits_change->seen == lsn)
      continue;
    answer_in_turn(*peer, *std::exchange(peer->awaits_change, std::nullopt));
  }
}

Result<void> Broker::read_journal(Peer& peer, const wire::ReadJournal& request) {
  answer_in_turn(peer, request);
  return {};
}

Result<void> Broker::set_log_level(Peer& peer, const wire::SetLogLevel& request) {
  const PeerIdentity& who = peer.session.identity();
  if (request.level != 0) {
    if (who.uid != 0 && who.uid != ::geteuid())
      return fail_with(Errc::permission_denied,
                     "user " + std::to_string(who.uid) + " may not change what agnocastd logs");
    log_.set_level(static_cast<LogLevel>(request.level));
    log_.write(LogLevel::notice, "log level",
               {{"level", name_of(log_.level())}, {"pid", who.pid}, {"uid", who.uid}});
  }
  auto answer = make_body<wire::LogLevelIs>(wire::Opcode::log_level_is, request.header.request);
  answer.level = static_cast<std::uint64_t>(log_.level());
  output_.reply(peer, packet_of(answer));
  return {};
}

Result<void> Broker::ask_access(Peer& peer, const wire::AskAccess& request) {
  std::string_view topic;
  AGNOCAST_CHECK(text_of(request.topic, topic));  // decode() has looked
  if (const auto problem = check_topic_name(topic))
    return fail_with(Errc::invalid_name, "topic " + printable(topic) + ": " + problem->text());
  const auto& rules = options_.config.access;
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

void Broker::answer_at_length(Peer& peer, std::vector<Outgoing> packets) {
  peer.asked_ms = monotonic_ms();
  Outgoing together;
  together.since_ms = peer.asked_ms;
  for (Outgoing& packet : packets) {
    if (together.bytes.size() + packet.bytes.size() > wire::answer_bytes_max ||
        together.fds.size() + packet.fds.size() > wire::descriptor_count_max)
      peer.session.push(std::exchange(together, Outgoing{{}, {}, {}, peer.asked_ms, 0}));
    together.bytes.insert(together.bytes.end(), packet.bytes.begin(), packet.bytes.end());
    together.fds.insert(together.fds.end(), packet.fds.begin(), packet.fds.end());
  }
  peer.session.push(std::move(together));
  output_.flush(peer);
  if (peer.session.is_over()) output_.end_longest(peer.session.identity().uid);
}

void Broker::drop_slow_observers(std::uint64_t now) {
  if (connections_.observer_count() == 0) return;
  std::vector<PeerId> slow;
  for (const auto& [id, peer] : connections_.all()) {
    if (peer->session.role() == Role::observer && peer->session.has_output() &&
        now - peer->asked_ms > observer_patience_ms)
      slow.push_back(id);
  }
  for (const PeerId id : slow) termination_.disconnect(*connections_.find(id), "an observer does not read");
}

DumpFacts Broker::facts() const {
  const std::uint64_t now = monotonic_ns();
  DumpFacts facts;
  wire::DumpDaemon& daemon = facts.daemon;
  daemon.version_major = AGNOCAST_VERSION_MAJOR;
  daemon.version_minor = AGNOCAST_VERSION_MINOR;
  daemon.version_patch = AGNOCAST_VERSION_PATCH;
  daemon.pid = static_cast<std::uint32_t>(::getpid());
  daemon.uid = ::geteuid();
  daemon.incarnation = registry_.incarnation();
  daemon.uptime_ns = now - registry_.header().began_ns;
  daemon.arena_base = options_.arena.base;
  daemon.arena_bytes = options_.arena.bytes;
  daemon.window_bytes = options_.arena.window_bytes;
  daemon.windows_used = plan_.used_count();
  daemon.log_level = static_cast<std::uint32_t>(log_.level());
  daemon.kept_descriptors = store_.kept_count();
  daemon.kept_descriptors_max = store_.keeps() ? store_.capacity() : 0;
  daemon.counters = registry_.counters();
  const Config::Limits& limits = options_.config.limits;
  daemon.limits = {limits.clients,
                   limits.topics,
                   limits.publishers_per_topic,
                   limits.subscriptions_per_topic,
                   limits.slots_per_publisher,
                   limits.depth_max,
                   options_.config.heap.windows_per_process};
  const Config::Quota& quota = options_.config.quota;
  daemon.quota = {quota.clients, quota.publishers,    quota.subscriptions, quota.executors,
                  admission_.heap_quota(),  quota.held_messages, quota.topics,
                  quota.queued_bytes, quota.queued_seconds, quota.dumps_per_second,
                  admission_.places_quota(Kind::publisher), admission_.places_quota(Kind::subscription)};
  const std::uint64_t now_ms = monotonic_ms();
  for (const auto& [id, peer] : connections_.all()) {
    std::uint64_t& waits_ms = facts.users[peer->session.identity().uid].waits_ms;
    waits_ms = std::max(waits_ms, peer->session.waits_ms(now_ms));
  }
  for (const auto& [uid, answers] : answers_) {
    if (connections_.users().contains(uid))
      facts.users[uid].answers_ahead = answers.allowance.ahead(now_ms);
  }
  for (const auto& [uid, used] : connections_.users()) {
    DumpFacts::User& user = facts.users[uid];
    user.connections = used.clients;
    user.observers = used.observers;
    user.queued_bytes = used.kept->bytes;
    daemon.connections += used.clients;
    daemon.observers += used.observers;
  }
  facts.refusals = refusals_.all();
  facts.now_ns = now;
  facts.process_of = [this, now](ClientIndex client) {
    DumpFacts::Process process;
    const Peer* const peer = connections_.of_client(client);
    if (peer != nullptr)
      process.state = peer->detached ? wire::ProcessState::orphaned : wire::ProcessState::connected;
    if (registry_.is_revoked(client)) process.state = wire::ProcessState::revoked;
    process.age_ns = now - registry_.client(client).since_ns;
    process.region = regions_.region_reader(client);
    const std::uint64_t executors = registry_.client(client).executors;
    for (std::uint64_t executor = 0; executor < abi::executor_count_max; ++executor) {
      if ((executors >> executor & 1) != 0 && doorbells_.is_silent(client, executor))
        process.silent_executors |= std::uint64_t{1} << executor;
    }
    for (const Obstacles::Claim& claim : obstacles_.of(client)) {
      process.blocked_bytes += claim.bytes;
      if (process.blocked_by.empty()) process.blocked_by = claim.what;
    }
    return process;
  };
  return facts;
}

}  // namespace agnocast::daemon
