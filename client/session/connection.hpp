// SPDX-License-Identifier: Apache-2.0
//
// Connection: this process's conversation with the daemon, over one socket after the other.
//
// Any thread asks; only the control thread receives, so announcements are handled in the order in
// which the daemon made them. A request waits for its answer; what the answer means is done by the
// request's own function *in the control thread*, before the next packet is looked at: an endpoint
// is registered before it can be announced anything.
//
//            begin()               open()                end()
//   no socket ──────▶ introducing ────────▶ open ──────────────▶ no socket …      refuse(): until open()
//
// A request outlives the socket it was sent on: open() sends what has no answer yet once more, in
// the order of the ids, marked as asked again; so does it what was asked while there was no socket.
// A statement (post) does not. It speaks of what was announced on its own connection, and the
// daemon announces on the next one whatever it still believes: the answer to that is the statement.
#pragma once

#include <agnocast/abi/wire.hpp>
#include <agnocast/result.hpp>
#include <base/sockets/packet_socket.hpp>
#include <client/process/steps.hpp>

#include <array>
#include <chrono>
#include <condition_variable>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <deque>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <span>
#include <string>
#include <string_view>
#include <type_traits>
#include <vector>

namespace agnocast {

/// A packet as it came, with what travelled with it. The body is a copy: nobody changes it any
/// more.
struct Incoming {
  alignas(8) std::array<std::byte, abi::wire::packet_bytes_max> bytes;
  std::size_t size = 0;
  Packet packet;

  abi::wire::Header header() const noexcept {
    abi::wire::Header header{};
    std::memcpy(&header, bytes.data(), sizeof header);
    return header;
  }
  /// The body as a T, if the packet has exactly that size.
  template <class T>
  bool read(T& body) const noexcept {
    static_assert(std::is_trivially_copyable_v<T>);
    if (size != sizeof(T)) return false;
    std::memcpy(&body, bytes.data(), sizeof body);
    return true;
  }
  /// The body of an answer that is meant to be `opcode` and to bring so many descriptors. Errors:
  /// protocol_violation; of an answer whose descriptors did not arrive see
  /// failure_of_descriptors().
  template <class T>
  [[nodiscard]] Result<void> read_as(abi::wire::Opcode opcode, T& body,
                                     std::size_t descriptor_count,
                                     const char* what) const noexcept {
    if (header().opcode != opcode || !read(body) || packet.descriptor_count > descriptor_count)
      return fail(Errc::protocol_violation, what);
    if (packet.descriptors_lost || packet.descriptor_count < descriptor_count)
      return tl::unexpected(failure_of_descriptors(what));
    return {};
  }
};

/// What the daemon refused, in its words: of a packet that is shaped like `refused`.
Failure refusal_of(const Incoming& packet) noexcept;
Failure refusal_of(abi::wire::Refused refused) noexcept;

class Connection {
 public:
  // A daemon under load answers within milliseconds; one that is restarted by its service manager
  // is back within seconds.
  static constexpr std::chrono::milliseconds answer_timeout{5000};
  using OnAnswer = std::function<Result<void>(Incoming&)>;
  using OnLater = std::function<void(Result<Incoming*>)>;

  /// `wake`: asks the control thread to call flush(); any thread. `path`: of the daemon's socket,
  /// for people.
  Connection(std::function<void()> wake, std::string path)
      : wake_(std::move(wake)), path_(std::move(path)) {}

  // --- any thread but the control thread

  /// Sends `body` (a struct of abi/wire.hpp; its header is filled in here) and waits for the
  /// answer, across connections. `on_answer` runs in the control thread and may fail the request.
  /// `on_late` instead of it, when the answer comes after this function has given up, and after it,
  /// when it has failed; not for refusals. `again`: the daemon may have done it for an earlier
  /// request. `fd`: goes with it; stays the caller's, and open until this returns; -1: none.
  /// Errors: what the daemon refused, daemon_not_running (gone, or no answer in time), what
  /// refuse() said.
  template <class T>
  [[nodiscard]] Result<void> request(abi::wire::Opcode opcode, T body, OnAnswer on_answer,
                                     OnAnswer on_late = nullptr, bool again = false, int fd = -1) {
    body.header = {opcode, sizeof(T), again ? abi::wire::asked_again : 0};
    return request_bytes({reinterpret_cast<const std::byte*>(&body), sizeof(T)},
                         std::move(on_answer), std::move(on_late), fd);
  }

  // --- any thread

  bool is_open() const noexcept;
  /// Sends `body` on the open connection, if there is one; expects no answer. `again`: as above.
  template <class T>
  void post(abi::wire::Opcode opcode, T body, bool again = false) {
    body.header = {opcode, sizeof(T), again ? abi::wire::asked_again : 0};
    const std::lock_guard lock(mutex_);
    if (!is_open_) return;
    AGNOCAST_CRASH_POINT(C_post);
    send({reinterpret_cast<const std::byte*>(&body), sizeof(T)});
  }
  /// Sends `body` and returns; `on_answer` runs in the control thread when the answer comes, with
  /// the refusal if it is one. For the control thread itself, which cannot wait for what only it
  /// receives.
  template <class T>
  void request_later(abi::wire::Opcode opcode, T body, OnLater on_answer, bool again = false) {
    body.header = {opcode, sizeof(T), again ? abi::wire::asked_again : 0};
    request_bytes_later({reinterpret_cast<const std::byte*>(&body), sizeof(T)},
                        std::move(on_answer));
  }

  // --- control thread

  int fd() const noexcept { return socket_.fd(); }
  /// Packets read from this connection so far, the first one included (Unlinked::seen).
  std::uint64_t seen() const noexcept { return seen_; }

  /// A new socket. Requests and statements are not sent on it before open().
  void begin(PacketSocket socket) noexcept;
  /// Says who this is: hello or rejoin, the first packet. Its answer comes unasked. Errors: as
  /// PacketSocket::send, daemon_not_running.
  template <class T>
  [[nodiscard]] Result<void> introduce(abi::wire::Opcode opcode, T body) {
    body.header = {opcode, sizeof(T), introduction_id};
    return introduce_bytes({reinterpret_cast<const std::byte*>(&body), sizeof(T)});
  }
  /// Sends `body` ahead of everything that waits for open(): what the daemon has to know before it
  /// serves a request. Expects no answer.
  template <class T>
  void state(abi::wire::Opcode opcode, T body) {
    body.header = {opcode, sizeof(T), 0};
    const std::lock_guard lock(mutex_);
    send({reinterpret_cast<const std::byte*>(&body), sizeof(T)});
  }
  /// The daemon knows us: everything that waits is sent.
  void open();
  /// The socket is of no use any more.
  void end() noexcept;
  /// Nobody answers any more: every request fails with `why`, those to come as well, until open().
  void refuse(const Failure& why) noexcept;
  /// Whether somebody waits for the answer to this request.
  bool is_waiting(std::uint64_t id) const noexcept;

  /// The next packet for nobody in particular, if there is one; answers are handled inside. False
  /// when the connection has ended.
  [[nodiscard]] Result<bool> receive(Incoming& packet, bool& unasked);
  /// Waits for the very first answer, before there is a control thread. Errors: what the daemon
  /// refused, daemon_not_running (it has ended, or no answer in time).
  [[nodiscard]] Result<void> receive_first(Incoming& packet,
                                           std::chrono::steady_clock::time_point deadline);
  /// daemon_not_running if the other end is gone, though what it sent may still wait here.
  [[nodiscard]] Result<void> check_alive() const noexcept;
  /// Sends what the socket did not take; true while something is left.
  bool flush() noexcept;

 private:
  static constexpr std::uint64_t introduction_id = 1;

  /// Of a failure, for another thread. No allocation: a failure is told also when there is no
  /// memory.
  struct Detail {
    char text[detail_bytes_max] = "";
    void keep(const Failure& failure) noexcept {
      std::strncpy(text, detail_of(failure), sizeof text - 1);
    }
  };
  struct Request {
    std::vector<std::byte> bytes;  // as it is sent when it is asked again
    OnAnswer on_answer;            // of request()
    OnAnswer on_late;
    OnLater later;  // of request_later()
    int fd = -1;    // sent with it
    bool given_up = false;
    bool done = false;
    Result<void> result;
    Detail detail;
  };

  [[nodiscard]] Result<void> request_bytes(std::span<const std::byte> bytes, OnAnswer on_answer,
                                           OnAnswer on_late, int fd);
  void request_bytes_later(std::span<const std::byte> bytes, OnLater on_answer);
  [[nodiscard]] Result<void> introduce_bytes(std::span<const std::byte> bytes) noexcept;
  void enter(std::span<const std::byte> bytes, const std::shared_ptr<Request>& request);
  void send(std::span<const std::byte> bytes, int fd = -1);
  Result<void> give_up(Request& request);
  void answer(std::uint64_t id, Incoming& packet);
  void finish(Request& request, Result<void> result) noexcept;
  tl::unexpected<Failure> refused() const noexcept;

  std::function<void()> wake_;
  std::string path_;
  PacketSocket socket_;     // control thread; others send on it under the mutex while it is open
  std::uint64_t seen_ = 0;  // control thread

  mutable std::mutex mutex_;
  std::condition_variable answered_;
  std::map<std::uint64_t, std::shared_ptr<Request>> requests_;
  std::uint64_t next_id_ = introduction_id + 1;
  bool is_open_ = false;
  Errc refused_ = Errc::ok;
  Detail refused_detail_;
  struct Unsent {
    std::vector<std::byte> bytes;
    UniqueFd fd;
  };
  std::deque<Unsent> unsent_;
};

/// The body of leave and drained: an endpoint of this process.
inline abi::wire::Reference reference(abi::wire::Kind kind, std::uint32_t topic,
                                      std::uint64_t index, std::uint64_t generation) noexcept {
  abi::wire::Reference body{};
  body.kind = kind;
  body.topic = topic;
  body.index = index;
  body.generation = generation;
  return body;
}
/// What was announced is used here no more, or never was; with how much of the connection this
/// process has read.
inline void say_unlinked(Connection& connection, abi::wire::Kind kind, std::uint32_t topic,
                         std::uint64_t index, std::uint64_t generation) {
  abi::wire::Unlinked body{};
  body.kind = kind;
  body.topic = topic;
  body.index = index;
  body.generation = generation;
  body.seen = connection.seen();
  connection.post(abi::wire::Opcode::unlinked, body);
}
/// Copies a name into a packet. False if it does not fit with its terminator.
bool write_name(abi::wire::Name& name, std::string_view text) noexcept;

}  // namespace agnocast
