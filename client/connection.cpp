// SPDX-License-Identifier: Apache-2.0

#include <base/step.hpp>
#include <client/connection.hpp>

#include <poll.h>

#include <algorithm>
#include <cerrno>
#include <iterator>
#include <new>
#include <utility>

namespace agnocast {

using abi::wire::Header;
using abi::wire::Opcode;

bool write_name(abi::wire::Name& name, std::string_view text) noexcept {
  name = {};
  if (text.size() >= sizeof name.text) return false;
  std::memcpy(name.text, text.data(), text.size());
  return true;
}

namespace {

tl::unexpected<Failure> gone() noexcept {
  return fail(Errc::daemon_not_running, "the connection to agnocastd has ended");
}

/// What the daemon refused, in its words.
Failure refusal_of(const Incoming& packet) noexcept {
  abi::wire::Refused refused{};
  if (!packet.read(refused)) return {Errc::protocol_violation, 0, "an answer of agnocastd"};
  char* const end = std::find(std::begin(refused.text.text), std::end(refused.text.text) - 1, '\0');
  *end = '\0';
  std::replace_if(
      refused.text.text, end, [](char c) { return c < ' ' || c > '~'; }, '?');
  return failure_with(static_cast<Errc>(refused.code), refused.text.text,
                      static_cast<int>(refused.os_errno));
}

// A failure is made in the control thread and told in the thread that waits; the detail goes with
// it.
Result<void> in_this_thread(const Result<void>& result, const std::string& detail) {
  if (result || detail.empty()) return result;
  return tl::unexpected(failure_with(result.error().code, detail.c_str(), result.error().os_errno));
}

}  // namespace

Result<void> Connection::request_bytes(std::byte* bytes, std::size_t size,
                                       std::function<Result<void>(Incoming&)> on_answer) {
  const auto deadline = std::chrono::steady_clock::now() + answer_timeout;
  Waiting waiting{std::move(on_answer), false, {}, {}};
  std::uint64_t id = 0;
  {
    const std::lock_guard lock(mutex_);
    if (ended_) return gone();
    id = next_id_++;
    waiting_[id] = &waiting;
  }
  std::memcpy(bytes + offsetof(Header, request), &id, sizeof id);
  // Nobody may know `waiting` any more when this function returns; the control thread may be at it
  // in the last moment.
  const auto give_up = [&](tl::unexpected<Failure> why) -> Result<void> {
    std::unique_lock lock(mutex_);
    if (waiting_.erase(id) != 0) return why;
    answered_.wait(lock, [&] { return waiting.done; });
    return in_this_thread(waiting.result, waiting.detail);
  };
  AGNOCAST_CRASH_POINT(C_ask);
  for (;;) {
    const Result<Sent> sent = socket_.send({bytes, size});
    if (!sent) return give_up(tl::unexpected<Failure>(sent.error()));
    if (*sent == Sent::sent) break;
    if (*sent == Sent::peer_gone) return give_up(gone());
    const auto left = std::chrono::duration_cast<std::chrono::milliseconds>(
        deadline - std::chrono::steady_clock::now());
    pollfd writable{socket_.fd(), POLLOUT, 0};
    if (left.count() <= 0 ||
        (::poll(&writable, 1, static_cast<int>(left.count())) < 0 && errno != EINTR)) {
      return give_up(fail(Errc::daemon_not_running, "agnocastd does not read its socket"));
    }
  }
  {
    std::unique_lock lock(mutex_);
    if (answered_.wait_until(lock, deadline, [&] { return waiting.done; }))
      return in_this_thread(waiting.result, waiting.detail);
  }
  return give_up(fail(Errc::daemon_not_running, "no answer of agnocastd within 5 s"));
}

void Connection::post_bytes(std::span<const std::byte> bytes) {
  const std::lock_guard lock(mutex_);
  if (ended_) return;
  AGNOCAST_CRASH_POINT(C_post);
  if (unsent_.empty()) {
    const Result<Sent> sent = socket_.send(bytes);
    if (sent && *sent != Sent::would_block)
      return;  // a peer that is gone: the control thread notices
  }
  unsent_.emplace_back(bytes.begin(), bytes.end());
}

bool Connection::flush() noexcept {
  const std::lock_guard lock(mutex_);
  while (!unsent_.empty()) {
    const Result<Sent> sent = socket_.send(unsent_.front());
    if (sent && *sent == Sent::would_block) return true;
    unsent_.pop_front();
  }
  return false;
}

void Connection::answer(std::uint64_t id, Incoming& packet) {
  AGNOCAST_CRASH_POINT(C_answer);
  std::unique_lock lock(mutex_);
  if (const auto later = later_.find(id); later != later_.end()) {
    const auto on_answer = std::move(later->second);
    later_.erase(later);
    lock.unlock();
    if (packet.header().opcode == Opcode::refused) {
      on_answer(tl::unexpected<Failure>(refusal_of(packet)));
    } else {
      on_answer(&packet);
    }
    return;
  }
  const auto found = waiting_.find(id);
  if (found == waiting_.end())
    return;  // given up; what came with the answer is closed with the packet
  Waiting& waiting = *found->second;
  waiting_.erase(found);
  // Erased but not done: the requester waits for `done`, so `waiting` stays. Its function runs
  // without the lock, it may post.
  lock.unlock();
  Result<void> result;
  if (packet.header().opcode == Opcode::refused) {
    result = tl::unexpected<Failure>(refusal_of(packet));
  } else {
    try {
      result = waiting.on_answer(packet);
    } catch (const std::bad_alloc&) {  // somebody waits for this answer
      result = fail(Errc::os_failure, "an answer of agnocastd", ENOMEM);
    }
  }
  lock.lock();
  if (!result) waiting.detail = detail_of(result.error());
  waiting.result = std::move(result);
  waiting.done = true;
  answered_.notify_all();
}

Result<bool> Connection::receive(Incoming& packet, bool& unasked) {
  unasked = false;
  for (;;) {
    Result<Packet> received = socket_.receive(packet.bytes);
    if (!received) return tl::unexpected<Failure>(received.error());
    if (received->kind == Packet::Kind::nothing) return true;
    if (received->kind == Packet::Kind::end) return false;
    ++seen_;
    packet.packet = std::move(*received);
    packet.size = packet.packet.bytes;
    if (packet.size < sizeof(Header) || packet.packet.truncated ||
        packet.header().bytes != packet.size) {
      return fail(Errc::protocol_violation, "a packet of agnocastd");
    }
    if (packet.header().request == 0) {
      unasked = true;
      return true;
    }
    answer(packet.header().request, packet);
  }
}

Result<void> Connection::receive_first(Incoming& packet) {
  pollfd readable{socket_.fd(), POLLIN, 0};
  if (::poll(&readable, 1, static_cast<int>(answer_timeout.count())) <= 0) {
    return fail(Errc::daemon_not_running, "no answer of agnocastd within 5 s");
  }
  Result<Packet> received = socket_.receive(packet.bytes);
  if (!received) return tl::unexpected<Failure>(received.error());
  if (received->kind != Packet::Kind::data) return gone();
  ++seen_;
  packet.packet = std::move(*received);
  packet.size = packet.packet.bytes;
  if (packet.size < sizeof(Header) || packet.packet.truncated)
    return fail(Errc::protocol_violation, "a packet of agnocastd");
  if (packet.header().opcode == Opcode::refused) return tl::unexpected<Failure>(refusal_of(packet));
  return {};
}

void Connection::fail_all() noexcept {
  const std::lock_guard lock(mutex_);
  ended_ = true;
  for (auto& [id, waiting] : waiting_) {
    waiting->result = gone();
    waiting->done = true;
  }
  waiting_.clear();
  later_.clear();
  unsent_.clear();
  answered_.notify_all();
}

}  // namespace agnocast
