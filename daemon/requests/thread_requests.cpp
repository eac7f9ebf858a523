// SPDX-License-Identifier: Apache-2.0
//
// ThreadRequests: see the header.

#include <daemon/requests/thread_requests.hpp>

#include <daemon/admission/access_control.hpp>
#include <daemon/requests/thread_scheduling.hpp>

#include <algorithm>
#include <cstring>
#include <memory>
#include <string_view>

namespace agnocast::daemon {

using wire::ThreadSetting;

namespace {

// Threads whose rule is applied in one turn of the loop: a fraction of a millisecond.
constexpr int threads_per_turn = 32;

std::string_view text_in(const wire::Name& name) noexcept {
  std::string_view text;
  text_of(name, text);  // decode() has checked that it ends
  return text;
}

}  // namespace

CallbackThreads& ThreadRequests::threads_of(Peer& peer) {
  if (peer.threads == nullptr)
    peer.threads =
        std::make_unique<ThreadsOfPeer>(connections_.user(peer.session.identity().uid).kept);
  return peer.threads->table;
}

/// Keeps the sums of the user, and remembers who has due threads.
void ThreadRequests::end_change(Peer& peer) {
  peer.threads->count();
  if (!peer.threads->table.has_due()) return;
  if (std::find(due_.begin(), due_.end(), peer.id) == due_.end()) due_.push_back(peer.id);
}

Result<void> ThreadRequests::callback_group(Peer& peer, const wire::CallbackGroup& statement) {
  CallbackThreads& threads = threads_of(peer);
  const CallbackThreads::GroupKey key{statement.executor, statement.group};
  const KeptForUser& user = *connections_.user(peer.session.identity().uid).kept;
  if (statement.is_there == 0) {
    if (!threads.remove_group(key)) threads.leave_out_no_more();
  } else if (threads.has_group(key)) {
    return {};
  } else if (threads.groups().size() >= abi::callback_group_count_max ||
             user.callback_groups >= config_.quota.callback_groups) {
    threads.leave_out();
  } else {
    const char* const process = registry_.client(*peer.session.client()).name;
    const std::string_view node = text_in(statement.node), name = text_in(statement.name);
    threads.add_group(key, node, name, statement.reentrant != 0,
                      matching_rule(config_.threads,
                                    {{process, ::strnlen(process, wire::name_bytes)}, node, name}));
  }
  end_change(peer);
  return {};
}

Result<void> ThreadRequests::callback_thread(Peer& peer, const wire::CallbackThread& statement) {
  CallbackThreads& threads = threads_of(peer);
  const KeptForUser& user = *connections_.user(peer.session.identity().uid).kept;
  if (statement.is_there == 0) {
    if (!threads.remove_thread(statement.executor, statement.thread)) threads.leave_out_no_more();
  } else if (threads.has_thread(statement.executor, statement.thread)) {
    return {};
  } else if (threads.thread_count() >= abi::callback_thread_count_max ||
             user.callback_threads >= config_.quota.callback_threads) {
    threads.leave_out();
  } else {
    threads.add_thread(statement.executor, statement.thread);
  }
  end_change(peer);
  return {};
}

void ThreadRequests::go_on() {
  for (int i = 0; i < threads_per_turn && !due_.empty(); ++i) {
    Peer* const peer = connections_.find(due_.front());
    const auto* const due = peer != nullptr && peer->threads != nullptr && !peer->detached
                                ? peer->threads->table.next_due()
                                : nullptr;
    if (due != nullptr) {
      apply(*peer, due->first, due->second);
      std::rotate(due_.begin(), due_.begin() + 1, due_.end());  // each process in its turn
    } else {
      due_.erase(due_.begin());
    }
  }
}

void ThreadRequests::apply(Peer& peer, std::uint32_t number,
                           const CallbackThreads::Thread& thread) {
  const ThreadRule& rule = config_.threads[*thread.rule];
  const PeerIdentity& identity = peer.session.identity();
  const Subject subject = subject_of(identity);
  const CallbackThreads::Outcome outcome =
      rule.users.contains(subject.uid, subject.groups)
          ? set_scheduling(identity.process, identity.pid, number, rule.scheduling)
          : CallbackThreads::Outcome{ThreadSetting::not_allowed};
  peer.threads->table.note_outcome(number, outcome);
  if (outcome.setting == ThreadSetting::applied) {
    log_.write(LogLevel::debug, "thread scheduled",
               {{"pid", identity.pid}, {"thread", number}, {"line", rule.line}});
    return;
  }
  if (outcome.setting == ThreadSetting::not_found) return;  // it has ended meanwhile
  const bool is_refused = outcome.setting == ThreadSetting::refused;
  log_.write_limited(
      "thread rule", LogLevel::warning, "thread rule not applied",
      {{"pid", identity.pid},
       {"uid", identity.uid},
       {"thread", number},
       {"line", rule.line},
       {"why", is_refused ? std::strerror(outcome.os_errno) : "its user is not in the rule"}});
}

}  // namespace agnocast::daemon
