// SPDX-License-Identifier: Apache-2.0
//
// WireClient: a raw client that sends exactly what a test tells it to, right or wrong.
//
// None of our library is between test and socket: requests are the structs of wire.hpp, or any
// bytes. The request id distinguishes answers from announcements; unsolicited packets are kept in
// order. Every wait is bounded and fails the test with a description.
#pragma once

#include <agnocast/abi/fingerprint.hpp>
#include <agnocast/abi/observe.hpp>
#include <agnocast/abi/wire.hpp>
#include <agnocast/abi/words.hpp>
#include <agnocast/error.hpp>
#include <base/memory/mapping.hpp>
#include <base/sockets/packet_socket.hpp>

#include <gtest/gtest.h>
#include <poll.h>

#include <cstring>
#include <deque>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

namespace agnocast::test {

namespace wire = abi::wire;

struct Incoming {
  std::vector<std::byte> bytes;
  std::vector<UniqueFd> fds;

  wire::Opcode opcode() const { return header().opcode; }
  wire::Header header() const {
    wire::Header header{};
    if (bytes.size() >= sizeof header)
      std::memcpy(static_cast<void*>(&header), bytes.data(), sizeof header);
    return header;
  }
  template <class Body>
  Body as() const {
    Body body{};
    EXPECT_EQ(bytes.size(), sizeof body) << "opcode " << static_cast<unsigned>(opcode());
    std::memcpy(static_cast<void*>(&body), bytes.data(), std::min(bytes.size(), sizeof body));
    return body;
  }
  Errc refused_code() const {
    return opcode() == wire::Opcode::refused ? static_cast<Errc>(as<wire::Refused>().code)
                                             : Errc::ok;
  }
  std::string refused_text() const {
    return opcode() == wire::Opcode::refused ? as<wire::Refused>().text.text : "";
  }
};

inline wire::Name wire_name(std::string_view text) {
  wire::Name name{};
  std::memcpy(name.text, text.data(), std::min(text.size(), sizeof name.text - 1));
  return name;
}

class WireClient {
 public:
  static constexpr int patience_ms = 60'000;

  explicit WireClient(const std::string& path) {
    auto socket = PacketSocket::connect(path);
    if (socket) {
      socket_ = std::move(*socket);
    } else {
      ADD_FAILURE() << "cannot connect to " << path;
    }
  }

  PacketSocket& socket() noexcept { return socket_; }
  /// Opens a new connection instead of this one; request ids continue.
  void connect_again(const std::string& path) {
    auto socket = PacketSocket::connect(path);
    EXPECT_TRUE(socket) << "cannot connect to " << path;
    if (socket) socket_ = std::move(*socket);
    seen_ = 0;
    bodies_.clear();
    unasked_.clear();
  }
  std::uint64_t last_request() const noexcept { return last_request_; }
  /// Returns the number of packets read so far, as `seen` of an unlinked means it.
  std::uint64_t seen() const noexcept { return seen_; }

  bool send_bytes(std::span<const std::byte> bytes, std::span<const int> fds = {}) {
    const auto sent = socket_.send(bytes, fds, Wait::yes);
    return sent && *sent == Sent::sent;
  }
  /// Fills in opcode, length and a fresh request id.
  template <class Body>
  std::uint64_t send(wire::Opcode opcode, Body body) {
    body.header = {opcode, sizeof body, ++last_request_};
    EXPECT_TRUE(send_bytes(std::as_bytes(std::span(&body, 1)))) << "the daemon has hung up";
    return last_request_;
  }
  /// Sends and waits for the answer, which may be `refused`.
  template <class Body>
  Incoming ask(wire::Opcode opcode, const Body& body) {
    return answer_to(send(opcode, body));
  }

  /// Waits for the answer to this request, which may be `refused`.
  Incoming answer_to(std::uint64_t request) {
    for (;;) {
      auto packet = receive();
      if (!packet) return {};  // the test has failed already
      if (packet->header().request == request) return std::move(*packet);
      unasked_.push_back(std::move(*packet));
    }
  }
  /// Sends the request again under an id that was used before.
  template <class Body>
  Incoming ask_again(wire::Opcode opcode, Body body, std::uint64_t request) {
    body.header = {opcode, sizeof body, request | wire::asked_again};
    EXPECT_TRUE(send_bytes(std::as_bytes(std::span(&body, 1)))) << "the daemon has hung up";
    return answer_to(request);
  }

  /// Returns the answer, or nothing if the daemon ends the connection instead.
  template <class Body>
  std::optional<Incoming> try_ask(wire::Opcode opcode, Body body) {
    body.header = {opcode, sizeof body, ++last_request_};
    if (!send_bytes(std::as_bytes(std::span(&body, 1)))) return std::nullopt;
    for (;;) {
      auto packet = try_receive();
      if (!packet || packet->header().request == body.header.request) return packet;
      unasked_.push_back(std::move(*packet));
    }
  }
  /// Returns the next packet, or nothing if the daemon ends the connection instead.
  std::optional<Incoming> try_receive() {
    if (!bodies_.empty() || readable(patience_ms)) return receive(0);
    ADD_FAILURE() << "neither answered nor hung up";
    return std::nullopt;
  }

  /// Returns the next unsolicited packet; fails the test if none comes.
  Incoming next() {
    if (!unasked_.empty()) {
      Incoming first = std::move(unasked_.front());
      unasked_.pop_front();
      return first;
    }
    auto packet = receive();
    return packet ? std::move(*packet) : Incoming{};
  }
  /// The same, of a known kind.
  template <class Body>
  Body expect(wire::Opcode opcode, std::vector<UniqueFd>* fds = nullptr) {
    Incoming packet = next();
    EXPECT_EQ(static_cast<unsigned>(packet.opcode()), static_cast<unsigned>(opcode));
    if (packet.opcode() != opcode) return Body{};
    if (fds != nullptr) *fds = std::move(packet.fds);
    return packet.as<Body>();
  }
  /// Returns the unsolicited packets up to now: everything that the daemon sent before it answers
  /// a request that changes nothing.
  std::deque<Incoming> drain() {
    wire::WindowRequest nonsense{};
    nonsense.window = abi::window_count_max;
    const Incoming answer = ask(wire::Opcode::open_window, nonsense);
    EXPECT_EQ(answer.opcode(), wire::Opcode::refused);
    return std::exchange(unasked_, {});
  }
  std::size_t unasked_count() { return unasked_.size(); }
  /// Returns a packet if there is one.
  std::optional<Incoming> poll() {
    if (!unasked_.empty()) return next();
    return receive(0);
  }
  /// Returns whether the daemon ends the connection; drops the packets before that.
  bool is_hung_up() {
    for (;;) {
      std::array<std::byte, 2048> buffer;
      if (!readable(patience_ms)) return false;
      const auto packet = socket_.receive(buffer);
      if (!packet || packet->kind == Packet::Kind::end) return true;
    }
  }

  // --- the usual requests
  Incoming hello(std::uint64_t fingerprint = abi::fingerprint(), std::uint64_t domain = 0) {
    wire::Hello body{};
    body.fingerprint = fingerprint;
    body.domain = domain;
    body.process_name = wire_name("wire_client");
    return ask(wire::Opcode::hello, body);
  }
  Incoming rejoin(const wire::Welcome& welcome, std::uint64_t fingerprint = abi::fingerprint()) {
    wire::Rejoin body{};
    body.fingerprint = fingerprint;
    body.incarnation = welcome.incarnation;
    body.client = welcome.client;
    body.client_generation = welcome.client_generation;
    return ask(wire::Opcode::rejoin, body);
  }
  Incoming open_window(std::uint64_t window) {
    wire::WindowRequest body{};
    body.window = window;
    return ask(wire::Opcode::open_window, body);
  }
  Incoming bring_window(const wire::WindowOpened& window, int fd) {
    wire::BringWindow body{};
    body.header = {wire::Opcode::bring_window, sizeof body, ++last_request_};
    body.window = window.window;
    body.base = window.base;
    body.bytes = window.bytes;
    body.first = window.first;
    EXPECT_TRUE(send_bytes(std::as_bytes(std::span(&body, 1)), std::span(&fd, 1)));
    return answer_to(last_request_);
  }
  Incoming open_wait_set(std::uint64_t executor = 0) {
    wire::WaitSetRequest body{};
    body.wait_set = executor;
    return ask(wire::Opcode::open_wait_set, body);
  }
  static wire::CreateEndpoint endpoint(std::string_view topic, const abi::Qos& qos,
                                       std::string_view type = "test/msg/Type") {
    wire::CreateEndpoint body{};
    body.qos = abi::pack_qos(qos);
    body.layout_hash = 1;
    body.quota = 4;
    body.topic = wire_name(topic);
    body.type = wire_name(type);
    body.node = wire_name("node");
    return body;
  }
  Incoming create_publisher(std::string_view topic, const abi::Qos& qos = {}) {
    return ask(wire::Opcode::create_publisher, endpoint(topic, qos));
  }
  Incoming create_subscription(std::string_view topic, const abi::Qos& qos = {}) {
    return ask(wire::Opcode::create_subscription, endpoint(topic, qos));
  }
  Incoming reference(wire::Opcode opcode, wire::Kind kind, std::uint32_t topic, std::uint64_t index,
                     std::uint64_t generation) {
    wire::Reference body{};
    body.kind = kind;
    body.topic = topic;
    body.index = index;
    body.generation = generation;
    return ask(opcode, body);
  }
  void unlinked(wire::Kind kind, std::uint32_t topic, std::uint64_t index, std::uint64_t generation,
                std::optional<std::uint64_t> seen = {}) {
    wire::Unlinked body{};
    body.kind = kind;
    body.topic = topic;
    body.index = index;
    body.generation = generation;
    body.seen = seen.value_or(seen_);
    send(wire::Opcode::unlinked, body);
  }

 private:
  bool readable(int timeout_ms) {
    pollfd entry{socket_.fd(), POLLIN, 0};
    return ::poll(&entry, 1, timeout_ms) > 0;
  }
  std::optional<Incoming> receive(int timeout_ms = patience_ms) {
    if (!socket_) return std::nullopt;
    if (!bodies_.empty()) {
      Incoming first = std::move(bodies_.front());
      bodies_.pop_front();
      return first;
    }
    if (!readable(timeout_ms)) {
      EXPECT_EQ(timeout_ms, 0) << "no packet came from the daemon";
      return std::nullopt;
    }
    std::array<std::byte, wire::answer_bytes_max> buffer;
    auto packet = socket_.receive(buffer);
    if (!packet || packet->kind != Packet::Kind::data) {
      EXPECT_EQ(timeout_ms, 0) << "the daemon has hung up";
      return std::nullopt;
    }
    ++seen_;
    EXPECT_FALSE(packet->truncated);
    EXPECT_FALSE(packet->descriptors_lost);
    const std::span<const std::byte> all(buffer.data(), packet->bytes);
    std::size_t next_fd = 0;
    for (std::size_t at = 0; at < all.size();) {
      Incoming body{{all.begin() + static_cast<std::ptrdiff_t>(at), all.end()}, {}};
      const std::size_t bytes = body.header().bytes;
      EXPECT_TRUE(bytes >= sizeof(wire::Header) && bytes <= body.bytes.size())
          << "a packet of " << all.size() << " bytes has a body of " << bytes << " at " << at;
      if (bytes < sizeof(wire::Header) || bytes > body.bytes.size()) return body;
      body.bytes.resize(bytes);
      at += bytes;
      // Descriptors belong to the only body, or to the processes of a dump.
      std::size_t fds = bytes == all.size() ? packet->fds().size() : 0;
      if (body.opcode() == wire::Opcode::dump_process)
        fds = body.as<wire::DumpProcess>().region_count;
      for (; fds > 0 && next_fd < packet->fds().size(); --fds)
        body.fds.push_back(std::move(packet->fds()[next_fd++]));
      bodies_.push_back(std::move(body));
    }
    EXPECT_EQ(next_fd, packet->fds().size()) << "descriptors that belong to no body";
    return receive(timeout_ms);
  }

  PacketSocket socket_;
  std::uint64_t seen_ = 0;
  std::uint64_t last_request_ = 0;
  std::deque<Incoming> bodies_;  // of the last packet, not yet handled
  std::deque<Incoming> unasked_;
};

}  // namespace agnocast::test
