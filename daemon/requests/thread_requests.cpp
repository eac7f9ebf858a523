// SPDX-License-Identifier: Apache-2.0
//
// ThreadRequests: see the header.

#include <daemon/requests/thread_requests.hpp>

#include <daemon/admission/access_control.hpp>
#include <daemon/requests/thread_scheduling.hpp>

#include <fcntl.h>

#include <algorithm>
#include <cerrno>
#include <cstddef>
#include <cstring>
#include <memory>
#include <string_view>
#include <utility>

namespace agnocast::daemon {

using wire::ThreadSetting;

namespace {

// Threads of one errand. The other processes of its user wait for it.
constexpr std::size_t threads_per_errand = 32;
// Executors that each thread of a user may spin on average; a process has a limit of its own.
constexpr std::uint64_t spins_per_thread = 64;

std::string_view text_in(const wire::Name& name) noexcept {
  std::string_view text;
  text_of(name, text);  // decode() has checked that it ends
  return text;
}

}  // namespace

/// Some threads of one process. An errand owns it: the process may end meanwhile.
struct ThreadRequests::Batch {
  struct Item {
    CallbackThreads::Due due;
    wire::ThreadScheduling wanted;
    CallbackThreads::Outcome outcome;
  };
  PeerId peer;
  Pidfd process;
  pid_t pid;
  std::uint32_t uid;
  std::vector<Item> items;
};

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
  const bool is_listed =
      std::any_of(due_.begin(), due_.end(), [&](const DuePeer& due) { return due.id == peer.id; });
  if (!is_listed) due_.push_back({peer.id, peer.session.identity().uid});
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

/// Returns whether a limit keeps one more executor of this thread from being known.
bool ThreadRequests::is_known_enough(const Peer& peer, std::uint32_t thread) const {
  const CallbackThreads& known = peer.threads->table;
  const KeptForUser& user = *connections_.users().at(peer.session.identity().uid).kept;
  const std::uint64_t quota = config_.quota.callback_threads;
  if (known.spin_count() >= abi::callback_spin_count_max) return true;
  if (quota != unlimited && user.callback_spins / spins_per_thread >= quota) return true;
  return !known.threads().contains(thread) &&
         (known.threads().size() >= abi::callback_thread_count_max ||
          user.callback_threads >= quota);
}

Result<void> ThreadRequests::callback_thread(Peer& peer, const wire::CallbackThread& statement) {
  CallbackThreads& threads = threads_of(peer);
  if (statement.is_there == 0) {
    if (!threads.remove_thread(statement.executor, statement.thread)) threads.leave_out_no_more();
  } else if (threads.has_thread(statement.executor, statement.thread)) {
    return {};
  } else if (is_known_enough(peer, statement.thread)) {
    threads.leave_out();
  } else {
    threads.add_thread(statement.executor, statement.thread);
  }
  end_change(peer);
  return {};
}

bool ThreadRequests::has_due() const noexcept {
  return std::any_of(due_.begin(), due_.end(),
                     [this](const DuePeer& due) { return !busy_.contains(due.uid); });
}

void ThreadRequests::go_on() {
  for (auto due = due_.begin(); due != due_.end();) {
    if (busy_.contains(due->uid)) {
      ++due;
      continue;
    }
    const DuePeer present = *due;
    due = due_.erase(due);
    Peer* const peer = connections_.find(present.id);
    if (peer == nullptr || peer->threads == nullptr) continue;
    apply_some(*peer);
    if (!peer->threads->table.has_due()) continue;
    const auto next = due - due_.begin();
    due_.push_back(present);  // each process in its turn
    due = due_.begin() + next;
    if (!busy_.contains(present.uid)) return;  // all of them were refused: the rest comes next
  }
}

void ThreadRequests::apply_some(Peer& peer) {
  const PeerIdentity& identity = peer.session.identity();
  const Subject subject = subject_of(identity);
  const auto batch = std::make_shared<Batch>();
  batch->peer = peer.id;
  batch->pid = identity.pid;
  batch->uid = identity.uid;
  batch->process = Pidfd(UniqueFd(::fcntl(identity.process.fd(), F_DUPFD_CLOEXEC, 0)));
  const int error = batch->process ? 0 : errno;
  for (std::size_t i = 0; i < threads_per_errand; ++i) {
    const auto due = peer.threads->table.next_due();
    if (!due) break;
    const ThreadRule& rule = config_.threads[due->rule];
    CallbackThreads::Outcome outcome{ThreadSetting::due};
    if (!rule.users.contains(subject.uid, subject.groups)) {
      outcome = {ThreadSetting::not_allowed};
    } else if (error != 0) {
      outcome = {ThreadSetting::refused, wire::ThreadCall::none, error};
    }
    if (outcome.setting == ThreadSetting::due) {
      batch->items.push_back({*due, rule.scheduling, outcome});
    } else {
      peer.threads->table.note_outcome(*due, outcome);
      report(*batch, *due, outcome);
    }
  }
  if (batch->items.empty()) return;
  busy_.insert(batch->uid);
  errands_.run(
      Errands::Lane::scheduling, batch->uid,
      [batch] {
        for (Batch::Item& item : batch->items)
          item.outcome = set_scheduling({batch->process, batch->pid, batch->uid}, item.due.thread,
                                        item.wanted);
      },
      [this, batch] { end_batch(*batch); });
}

void ThreadRequests::end_batch(const Batch& batch) {
  busy_.erase(batch.uid);
  Peer* const peer = connections_.find(batch.peer);
  for (const Batch::Item& item : batch.items) {
    if (peer != nullptr && peer->threads != nullptr)
      peer->threads->table.note_outcome(item.due, item.outcome);
    report(batch, item.due, item.outcome);
  }
}

void ThreadRequests::report(const Batch& batch, const CallbackThreads::Due& due,
                            const CallbackThreads::Outcome& outcome) {
  const std::uint32_t line = config_.threads[due.rule].line;
  const char* why = nullptr;
  switch (outcome.setting) {
    case ThreadSetting::applied:
      log_.write(LogLevel::debug, "thread scheduled",
                 {{"pid", batch.pid}, {"thread", due.thread}, {"line", line}});
      return;
    case ThreadSetting::not_allowed:
      why = "its user is not in the rule";
      break;
    case ThreadSetting::refused:
      why = std::strerror(outcome.os_errno);
      break;
    default:
      if (outcome.call == wire::ThreadCall::none) return;  // it ended before
      why = "it ended meanwhile; a new thread with its number may have the scheduling";
  }
  log_.write_limited("thread rule", LogLevel::warning, "thread rule not applied",
                     {{"pid", batch.pid},
                      {"uid", batch.uid},
                      {"thread", due.thread},
                      {"line", line},
                      {"why", why}});
}

}  // namespace agnocast::daemon
