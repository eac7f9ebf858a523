// SPDX-License-Identifier: Apache-2.0

#include <base/descriptors/kept_fd.hpp>
#include <client/connection/connection.hpp>
#include <client/process/steps.hpp>

#include <fcntl.h>
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

Failure refusal_of(const Incoming& packet) noexcept {
  abi::wire::Refused refused{};
  if (!packet.read(refused)) return {Errc::protocol_violation, 0, "an answer from agnocastd"};
  return refusal_of(refused);
}

Failure refusal_of(abi::wire::Refused refused) noexcept {
  char* const end = std::find(std::begin(refused.text.text), std::end(refused.text.text) - 1, '\0');
  *end = '\0';
  std::replace_if(
      refused.text.text, end, [](char c) { return c < ' ' || c > '~'; }, '?');
  return failure_with(static_cast<Errc>(refused.code), refused.text.text,
                      static_cast<int>(refused.os_errno));
}

namespace {

int milliseconds_until(std::chrono::steady_clock::time_point deadline) noexcept {
  using std::chrono::milliseconds;
  const auto left = std::chrono::ceil<milliseconds>(deadline - std::chrono::steady_clock::now());
  return static_cast<int>(std::max(left, milliseconds{0}).count());
}

tl::unexpected<Failure> gone() noexcept {
  return fail(Errc::daemon_not_running, "the connection to agnocastd has ended");
}

/// Keeps the daemon's descriptors open for as long as this process, or its peers, use them.
Packet kept(Packet packet) noexcept {
  for (UniqueFd& fd : packet.fds()) fd = keep(std::move(fd));
  return packet;
}

void put_id(std::vector<std::byte>& bytes, std::uint64_t id) noexcept {
  std::memcpy(bytes.data() + offsetof(Header, request), &id, sizeof id);
}
std::uint64_t id_in(std::span<const std::byte> bytes) noexcept {
  std::uint64_t id = 0;
  std::memcpy(&id, bytes.data() + offsetof(Header, request), sizeof id);
  return id;
}

}  // namespace

// --- asking

bool Connection::is_open() const noexcept {
  const std::lock_guard lock(mutex_);
  return is_open_;
}

// The control thread makes the failure and the waiting thread returns it; the detail is copied.
tl::unexpected<Failure> Connection::refused() const noexcept {
  return tl::unexpected(failure_with(refused_, refused_detail_.text));
}

void Connection::enter(std::span<const std::byte> bytes, const std::shared_ptr<Request>& request) {
  const std::uint64_t id = next_id_++;
  request->bytes.assign(bytes.begin(), bytes.end());
  std::vector<std::byte> first = request->bytes;
  put_id(first, id | (id_in(bytes) & abi::wire::asked_again));
  put_id(request->bytes, id | abi::wire::asked_again);
  requests_.emplace(id, request);
  AGNOCAST_CRASH_POINT(C_ask);
  if (!is_open_) return;
  try {
    send(first, request->fd);
  } catch (const std::bad_alloc&) {
    requests_.erase(id);  // the request refers to a caller that returns now
    throw;
  }
}

Result<void> Connection::request_bytes(std::span<const std::byte> bytes, OnAnswer on_answer,
                                       OnAnswer on_late, int fd) {
  const auto deadline = std::chrono::steady_clock::now() + answer_timeout;
  const auto request = std::make_shared<Request>();
  request->on_answer = std::move(on_answer);
  request->on_late = std::move(on_late);
  request->fd = fd;
  std::unique_lock lock(mutex_);
  if (refused_ != Errc::ok) return refused();
  enter(bytes, request);
  if (!answered_.wait_until(lock, deadline, [&] { return request->done; })) {
    const std::uint64_t id = id_in(request->bytes) & ~abi::wire::asked_again;
    if (requests_.count(id) != 0) {
      // No thread may call `on_answer` any more: the objects it refers to end with the caller.
      request->on_answer = nullptr;
      request->fd = -1;  // it belongs to the caller
      request->given_up = true;
      if (!is_open_ || request->on_late == nullptr) requests_.erase(id);
      const std::string why =
          path_ + (is_open_ ? ": no answer within 5 s" : ": the connection ended at least 5 s ago");
      return tl::unexpected(failure_with(Errc::daemon_not_running, why.c_str()));
    }
    // The control thread is running `on_answer` at this moment.
    answered_.wait(lock, [&] { return request->done; });
  }
  if (request->result || *request->detail.text == '\0') return request->result;
  const Failure& why = request->result.error();
  return tl::unexpected(failure_with(why.code, request->detail.text, why.os_errno));
}

void Connection::request_bytes_later(std::span<const std::byte> bytes, OnLater on_answer) {
  {
    const std::lock_guard lock(mutex_);
    if (refused_ == Errc::ok) {
      const auto request = std::make_shared<Request>();
      request->later = std::move(on_answer);
      return enter(bytes, request);
    }
  }
  on_answer(refused());
}

void Connection::send(std::span<const std::byte> bytes, int fd) {
  const std::span<const int> fds(&fd, fd >= 0 ? 1 : 0);
  if (unsent_.empty()) {
    const Result<Sent> sent = socket_.send(bytes, fds);
    if (sent && *sent != Sent::would_block)
      return;  // if the peer is gone, the control thread notices
  }
  // The caller may have given up, and closed `fd`, by the time this is sent.
  UniqueFd copy = keep(UniqueFd(fd >= 0 ? ::fcntl(fd, F_DUPFD_CLOEXEC, 0) : -1));
  if (fd >= 0 && !copy)
    throw std::bad_alloc();  // no descriptor is free: handled like a lack of memory
  unsent_.push_back({{bytes.begin(), bytes.end()}, std::move(copy)});
  wake_();
}

bool Connection::flush() noexcept {
  const std::lock_guard lock(mutex_);
  while (!unsent_.empty()) {
    const Unsent& next = unsent_.front();
    const int fd = next.fd.get();
    const Result<Sent> sent = socket_.send(next.bytes, {&fd, fd >= 0 ? 1u : 0u});
    if (sent && *sent == Sent::would_block) return true;
    unsent_.pop_front();
  }
  return false;
}

// --- one socket after the other

void Connection::begin(PacketSocket socket) noexcept {
  socket_ = PacketSocket(keep(socket.release()));
  seen_ = 0;
}

Result<void> Connection::introduce_bytes(std::span<const std::byte> bytes) noexcept {
  const Result<Sent> sent = socket_.send(bytes);
  if (!sent) return tl::unexpected<Failure>(sent.error());
  return *sent == Sent::sent ? Result<void>() : gone();
}

void Connection::open() {
  const std::lock_guard lock(mutex_);
  refused_ = Errc::ok;
  for (const auto& [id, request] : requests_) send(request->bytes, request->fd);
  is_open_ = true;
}

void Connection::end() noexcept {
  const std::lock_guard lock(mutex_);
  is_open_ = false;
  unsent_.clear();
  // The callers of these requests gave up. The daemon reports what it did for them after rejoin
  // (`own`).
  for (auto at = requests_.begin(); at != requests_.end();)
    at = at->second->given_up ? requests_.erase(at) : std::next(at);
  socket_.close();
}

void Connection::refuse(const Failure& why) noexcept {
  end();
  std::map<std::uint64_t, std::shared_ptr<Request>> requests;
  {
    const std::lock_guard lock(mutex_);
    refused_ = why.code;
    refused_detail_.keep(why);
    requests.swap(requests_);
  }
  for (const auto& [id, request] : requests) {
    if (request->later != nullptr) {
      request->later(refused());
    } else {
      finish(*request, refused());
    }
  }
}

bool Connection::is_waiting(std::uint64_t id) const noexcept {
  const std::lock_guard lock(mutex_);
  const auto found = requests_.find(id);
  return found != requests_.end() && !found->second->given_up;
}

// --- being answered

void Connection::finish(Request& request, Result<void> result) noexcept {
  const std::lock_guard lock(mutex_);
  if (!result) request.detail.keep(result.error());
  request.result = std::move(result);
  request.done = true;
  answered_.notify_all();
}

void Connection::answer(std::uint64_t id, Incoming& packet) {
  AGNOCAST_CRASH_POINT(C_answer);
  std::shared_ptr<Request> request;
  {
    const std::lock_guard lock(mutex_);
    const auto found = requests_.find(id);
    if (found == requests_.end())
      return;  // given up; descriptors of the answer are closed with the packet
    request = std::move(found->second);
    requests_.erase(found);
    // Erased but not done: the requester waits for `done`, so what its function refers to stays.
  }
  // Without the lock, because the functions may post.
  const bool refused = packet.header().opcode == Opcode::refused;
  if (request->later != nullptr) {
    if (refused) return request->later(tl::unexpected<Failure>(refusal_of(packet)));
    return request->later(&packet);
  }
  Result<void> result;
  if (refused) {
    result = tl::unexpected<Failure>(refusal_of(packet));
  } else {
    const auto hand = [&](const OnAnswer& to) -> Result<void> {
      try {
        return to(packet);
      } catch (const std::bad_alloc&) {  // a caller waits for this answer
        return fail(Errc::os_failure, "an answer from agnocastd", ENOMEM);
      }
    };
    result = hand(request->given_up ? request->on_late : request->on_answer);
    // The caller cannot use the created object, so handle it like an answer that came too late.
    if (!result && !request->given_up && request->on_late != nullptr)
      static_cast<void>(hand(request->on_late));
  }
  finish(*request, std::move(result));
}

Result<bool> Connection::receive(Incoming& packet, bool& unasked) {
  unasked = false;
  for (;;) {
    Result<Packet> received = socket_.receive(packet.bytes);
    if (!received) return tl::unexpected<Failure>(received.error());
    if (received->kind == Packet::Kind::nothing) return true;
    if (received->kind == Packet::Kind::end) return false;
    ++seen_;
    packet.packet = kept(std::move(*received));
    packet.size = packet.packet.bytes;
    if (packet.size < sizeof(Header) || packet.packet.truncated ||
        packet.header().bytes != packet.size) {
      return fail(Errc::protocol_violation, "a packet from agnocastd");
    }
    if (packet.header().request <= introduction_id) {
      unasked = true;
      return true;
    }
    answer(packet.header().request, packet);
  }
}

Result<void> Connection::receive_first(Incoming& packet,
                                       std::chrono::steady_clock::time_point deadline) {
  pollfd readable{socket_.fd(), POLLIN, 0};
  for (int found = -1; found < 0;) {
    found = ::poll(&readable, 1, milliseconds_until(deadline));
    if (found == 0 || (found < 0 && errno != EINTR))
      return fail(Errc::daemon_not_running, "no answer from agnocastd within 5 s");
  }
  Result<Packet> received = socket_.receive(packet.bytes);
  if (!received) return tl::unexpected<Failure>(received.error());
  if (received->kind != Packet::Kind::data) return gone();
  ++seen_;
  packet.packet = kept(std::move(*received));
  packet.size = packet.packet.bytes;
  if (packet.size < sizeof(Header) || packet.packet.truncated)
    return fail(Errc::protocol_violation, "a packet from agnocastd");
  if (packet.header().opcode == Opcode::refused) return tl::unexpected<Failure>(refusal_of(packet));
  return {};
}

Result<void> Connection::check_alive() const noexcept {
  pollfd hung_up{socket_.fd(), 0, 0};
  if (::poll(&hung_up, 1, 0) > 0) return gone();
  return {};
}

}  // namespace agnocast
