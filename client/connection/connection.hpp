// SPDX-License-Identifier: Apache-2.0
//
// Connection: this process's conversation with the daemon, over a sequence of sockets.
//
// Any thread sends requests. Only the control thread receives, so it handles announcements in the
// order in which the daemon sent them. A request waits for its answer. Its own function handles the
// answer *in the control thread*, before the next packet is read: an endpoint is registered before
// the daemon can announce anything to it.
//
//            begin()               open()                end()
//   no socket ──────▶ introducing ────────▶ open ──────────────▶ no socket …
//
// refuse() holds until open().
//
// A request outlives the socket it was sent on: open() sends every unanswered request once more, in
// the order of the ids, marked as asked again. It also sends the requests made while there was no
// socket. A statement (post) does not outlive its socket. It refers to announcements of its own
// connection; on the next one the daemon announces all that it still believes, and the client
// answers that.
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

/// A received packet with its descriptors. The body is a copy, so no other process can change it.
struct Incoming {
  alignas(8) std::array<std::byte, abi::wire::packet_bytes_max> bytes;
  std::size_t size = 0;
  Packet packet;

  abi::wire::Header header() const noexcept {
    abi::wire::Header header{};
    std::memcpy(&header, bytes.data(), sizeof header);
    return header;
  }
  /// Copies the body to `body`. Returns false if the packet does not have the size of a T.
  template <class T>
  bool read(T& body) const noexcept {
    static_assert(std::is_trivially_copyable_v<T>);
    if (size != sizeof(T)) return false;
    std::memcpy(&body, bytes.data(), sizeof body);
    return true;
  }
  /// Copies the body of an answer that must have this opcode and `descriptor_count` descriptors.
  /// Errors: protocol_violation; if descriptors did not arrive, see failure_of_descriptors().
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

/// Returns the daemon's refusal, in its words, from a packet shaped like `refused`.
Failure refusal_of(const Incoming& packet) noexcept;
Failure refusal_of(abi::wire::Refused refused) noexcept;

class Connection {
 public:
  // A daemon under load answers within milliseconds; its service manager restarts it within
  // seconds.
  static constexpr std::chrono::milliseconds answer_timeout{5000};
  using OnAnswer = std::function<Result<void>(Incoming&)>;
  using OnLater = std::function<void(Result<Incoming*>)>;

  /// `wake`: asks the control thread to call flush(), from any thread. `path`: the daemon's socket,
  /// for error texts.
  Connection(std::function<void()> wake, std::string path)
      : wake_(std::move(wake)), path_(std::move(path)) {}

  // --- any thread but the control thread

  /// Sends `body` (a struct of abi/wire.hpp; its header is filled in here) and waits for the
  /// answer, across connections. `on_answer` runs in the control thread and may fail the request.
  /// `on_late` runs instead when the answer comes after this function has given up, and also after
  /// an `on_answer` that failed; not for refusals. `again`: the daemon may have done it for an
  /// earlier request. `fd`: sent along; it stays the caller's, and open until this returns; -1:
  /// none. Errors: the daemon's refusal, daemon_not_running (gone, or no answer in time), the
  /// failure given to refuse().
  template <class T>
  [[nodiscard]] Result<void> request(abi::wire::Opcode opcode, T body, OnAnswer on_answer,
                                     OnAnswer on_late = nullptr, bool again = false, int fd = -1) {
    body.header = {opcode, sizeof(T), again ? abi::wire::asked_again : 0};
    return request_bytes({reinterpret_cast<const std::byte*>(&body), sizeof(T)},
                         std::move(on_answer), std::move(on_late), fd);
  }

  // --- any thread

  bool is_open() const noexcept;
  /// Sends `body` on the open connection, if any. Expects no answer. `again`: as above.
  template <class T>
  void post(abi::wire::Opcode opcode, T body, bool again = false) {
    body.header = {opcode, sizeof(T), again ? abi::wire::asked_again : 0};
    const std::lock_guard lock(mutex_);
    if (!is_open_) return;
    AGNOCAST_CRASH_POINT(C_send);
    send({reinterpret_cast<const std::byte*>(&body), sizeof(T)});
  }
  /// Sends `body` and returns. `on_answer` runs in the control thread with the answer or the
  /// refusal. For the control thread itself, which cannot wait for a packet that only it receives.
  template <class T>
  void request_later(abi::wire::Opcode opcode, T body, OnLater on_answer, bool again = false) {
    body.header = {opcode, sizeof(T), again ? abi::wire::asked_again : 0};
    request_bytes_later({reinterpret_cast<const std::byte*>(&body), sizeof(T)},
                        std::move(on_answer));
  }

  // --- control thread

  int fd() const noexcept { return socket_.fd(); }
  /// Returns how many packets were read from this connection, with the first one (Unlinked::seen).
  std::uint64_t seen() const noexcept { return seen_; }

  /// Takes a new socket. No request or statement is sent on it before open().
  void begin(PacketSocket socket) noexcept;
  /// Sends hello or rejoin, the first packet. Its answer comes as an unasked packet. Errors: as
  /// PacketSocket::send, daemon_not_running.
  template <class T>
  [[nodiscard]] Result<void> introduce(abi::wire::Opcode opcode, T body) {
    body.header = {opcode, sizeof(T), introduction_id};
    return introduce_bytes({reinterpret_cast<const std::byte*>(&body), sizeof(T)});
  }
  /// Sends `body` ahead of all that waits for open(), for facts that the daemon needs before it
  /// serves a request. Expects no answer.
  template <class T>
  void state(abi::wire::Opcode opcode, T body) {
    body.header = {opcode, sizeof(T), 0};
    const std::lock_guard lock(mutex_);
    send({reinterpret_cast<const std::byte*>(&body), sizeof(T)});
  }
  /// Marks the connection as accepted by the daemon, and sends all that waits.
  void open();
  /// Closes the socket.
  void end() noexcept;
  /// Fails every request with `why`, also later ones, until open().
  void refuse(const Failure& why) noexcept;
  /// Returns whether a caller waits for the answer to this request.
  bool is_waiting(std::uint64_t id) const noexcept;

  /// Reads the next unasked packet, if there is one; answers are handled inside. Returns false when
  /// the connection has ended.
  [[nodiscard]] Result<bool> receive(Incoming& packet, bool& unasked);
  /// Waits for the very first answer, before the control thread exists. Errors: the daemon's
  /// refusal, daemon_not_running (it has ended, or no answer in time).
  [[nodiscard]] Result<void> receive_first(Incoming& packet,
                                           std::chrono::steady_clock::time_point deadline);
  /// Returns daemon_not_running if the other end is closed, even if unread packets wait here.
  [[nodiscard]] Result<void> check_alive() const noexcept;
  /// Sends packets that the socket did not take before. Returns true while some are left.
  bool flush() noexcept;

 private:
  static constexpr std::uint64_t introduction_id = 1;

  /// The text of a failure, for another thread. It does not allocate, because a failure is reported
  /// even without memory.
  struct Detail {
    char text[detail_bytes_max] = "";
    void keep(const Failure& failure) noexcept {
      std::strncpy(text, detail_of(failure), sizeof text - 1);
    }
  };
  struct Request {
    std::vector<std::byte> bytes;  // as sent when the request is repeated
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

/// Returns the body of leave and drained for an endpoint of this process.
inline abi::wire::Reference reference(abi::wire::Kind kind, std::uint32_t topic,
                                      std::uint64_t index, std::uint64_t generation) noexcept {
  abi::wire::Reference body{};
  body.kind = kind;
  body.topic = topic;
  body.index = index;
  body.generation = generation;
  return body;
}
/// Reports that an announced endpoint or region is not, or no longer, in use here, and how far this
/// process has read the connection.
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
/// Copies a name into a packet. Returns false if it does not fit with its terminator.
bool write_name(abi::wire::Name& name, std::string_view text) noexcept;

}  // namespace agnocast
