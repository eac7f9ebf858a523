// SPDX-License-Identifier: Apache-2.0
//
// ObserverAnswers: see the header.

#include <daemon/observers/observer_answers.hpp>

#include <base/clock.hpp>
#include <daemon/observers/flight_recorder.hpp>
#include <daemon/state/memory_reserve.hpp>

#include <algorithm>
#include <new>
#include <utility>

namespace agnocast::daemon {

namespace {

// An observer that takes longer to read its answer is disconnected.
constexpr std::uint64_t observer_patience_ms = 5'000;

}  // namespace

// A request beyond the user's allowance waits, and the answer has the facts of its own time.
void ObserverAnswers::ask(Peer& peer, const LongRequest& request) {
  MemoryReserve::no_return();
  const std::uint64_t rate = quota_.dumps_per_second;
  const auto allowance =
      rate == unlimited ? Allowance(1, 0) : Allowance(rate, std::uint64_t{1000} / rate);
  const std::uint32_t uid = peer.session.identity().uid;
  Answers& answers = answers_.try_emplace(uid, Answers{allowance, {}}).first->second;
  peer.asked = request;
  answers.waiting.push_back(peer.id);
}

void ObserverAnswers::go_on() {
  const std::uint64_t now = monotonic_ms();
  for (auto& [uid, answers] : answers_) {
    while (!answers.waiting.empty()) {
      Peer* const peer = connections_.find(answers.waiting.front());
      if (peer == nullptr || peer->session.closed() || !peer->asked) {
        answers.waiting.pop_front();
        continue;
      }
      // Unread answers of this user's observers are soon read or discarded.
      if (peer->session.is_crowded()) break;
      if (quota_.dumps_per_second != unlimited && !answers.allowance.take(now)) break;
      answers.waiting.pop_front();
      answer(*peer, *std::exchange(peer->asked, std::nullopt));
    }
  }
}

void ObserverAnswers::answer(Peer& peer, const LongRequest& request) {
  try {
    const MemoryReserve::MayFail may_fail;
    if (const auto* const dump = std::get_if<wire::Dump>(&request)) {
      send(peer, make_dump(registry_, facts(), *dump));
    } else {
      send(peer, make_journal(registry_, std::get<wire::ReadJournal>(request), monotonic_ns()));
    }
  } catch (const std::bad_alloc&) {
    output_.end(peer, "agnocastd has no memory left for a long answer");
  }
}

int ObserverAnswers::due_ms() const noexcept {
  const std::uint64_t now = monotonic_ms();
  std::uint64_t due = UINT64_MAX;
  for (const auto& [uid, answers] : answers_) {
    if (answers.waiting.empty()) continue;
    const Peer* const first = connections_.find(answers.waiting.front());
    // An observer that waits for room does not wait for time; the periodic look serves it.
    const bool is_crowded = first != nullptr && first->session.is_crowded();
    due = std::min(due, is_crowded ? 1000 : answers.allowance.due_ms(now));
  }
  return due == UINT64_MAX ? -1 : static_cast<int>(std::min<std::uint64_t>(due, 1000));
}

void ObserverAnswers::send(Peer& peer, std::vector<Outgoing> packets) {
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

void ObserverAnswers::drop_slow(std::uint64_t now) {
  if (connections_.observer_count() == 0) return;
  std::vector<PeerId> slow;
  for (const auto& [id, peer] : connections_.all()) {
    if (peer->session.role() == Role::observer && peer->session.has_output() &&
        now - peer->asked_ms > observer_patience_ms)
      slow.push_back(id);
  }
  for (const PeerId id : slow)
    termination_.disconnect(*connections_.find(id), "an observer does not read");
}

void ObserverAnswers::forget_idle_users(std::uint64_t now) {
  std::erase_if(answers_, [&](const auto& one) {
    return one.second.waiting.empty() && one.second.allowance.is_whole(now);
  });
}

DumpFacts ObserverAnswers::facts() const {
  DumpFacts facts = collector_.collect();
  const std::uint64_t now_ms = monotonic_ms();
  for (const auto& [uid, answers] : answers_) {
    if (connections_.users().contains(uid))
      facts.users[uid].answers_ahead = answers.allowance.ahead(now_ms);
  }
  return facts;
}

}  // namespace agnocast::daemon
