// SPDX-License-Identifier: Apache-2.0
//
// Connection: this process's one socket to the daemon.
//
// Any thread sends; only the control thread receives, so announcements are handled in the order in
// which the daemon made them. A request waits for its answer; what the answer means is done by the
// request's own function *in the control thread*, before the next packet is looked at: an endpoint
// is registered before it can be announced anything.
#pragma once

#include <agnocast/abi/wire.hpp>
#include <agnocast/result.hpp>
#include <base/packet_socket.hpp>

#include <array>
#include <chrono>
#include <condition_variable>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <deque>
#include <functional>
#include <map>
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
};

class Connection {
 public:
  // A daemon under load answers within milliseconds; one that is restarted by its service manager
  // is back within seconds.
  static constexpr std::chrono::milliseconds answer_timeout{5000};

  explicit Connection(PacketSocket socket) noexcept : socket_(std::move(socket)) {}

  int fd() const noexcept { return socket_.fd(); }
  /// Packets read from this connection so far, the first one included (Unlinked::seen).
  std::uint64_t seen() const noexcept { return seen_; }

  /// Sends `body` (a struct of abi/wire.hpp; its header is filled in here) and waits for the
  /// answer. `on_answer` runs in the control thread and may fail the request. Errors: what the
  /// daemon refused, daemon_not_running (gone, or no answer in time). Not from the control thread.
  template <class T>
  [[nodiscard]] Result<void> request(abi::wire::Opcode opcode, T body,
                                     std::function<Result<void>(Incoming&)> on_answer) {
    body.header = {opcode, sizeof(T), 0};
    return request_bytes(reinterpret_cast<std::byte*>(&body), sizeof(T), std::move(on_answer));
  }
  /// Sends `body`, expects no answer (but for hello, which is answered before there is a control
  /// thread and has `id` 1). What the socket does not take now is sent by the control thread later.
  /// Any thread.
  template <class T>
  void post(abi::wire::Opcode opcode, T body, std::uint64_t id = 0) {
    body.header = {opcode, sizeof(T), id};
    post_bytes({reinterpret_cast<const std::byte*>(&body), sizeof(T)});
  }

  /// Sends `body` and returns; `on_answer` runs in the control thread when the answer comes, with
  /// the refusal if it is one. For the control thread itself, which cannot wait for what only it
  /// receives.
  template <class T>
  void request_later(abi::wire::Opcode opcode, T body,
                     std::function<void(Result<Incoming*>)> on_answer) {
    std::uint64_t id = 0;
    {
      const std::lock_guard lock(mutex_);
      id = next_id_++;
      later_[id] = std::move(on_answer);
    }
    post(opcode, body, id);
  }

  // --- control thread
  // ------------------------------------------------------------------------------------------------------------

  /// The next packet for nobody in particular, if there is one; answers are handled inside. False
  /// when the connection has ended.
  [[nodiscard]] Result<bool> receive(Incoming& packet, bool& unasked);
  /// Waits for the very first answer, before there is a control thread.
  [[nodiscard]] Result<void> receive_first(Incoming& packet);
  /// Sends what post() could not; true while something is left.
  bool flush() noexcept;
  /// Nobody will answer any more: every waiting request fails, and every one to come.
  void fail_all(const Failure& why) noexcept;

 private:
  struct Waiting {
    std::function<Result<void>(Incoming&)> on_answer;
    bool done = false;
    Result<void> result;
    std::string detail;
  };

  [[nodiscard]] Result<void> request_bytes(std::byte* bytes, std::size_t size,
                                           std::function<Result<void>(Incoming&)> on_answer);
  void post_bytes(std::span<const std::byte> bytes);
  void answer(std::uint64_t id, Incoming& packet);

  PacketSocket socket_;
  std::uint64_t seen_ = 0;

  std::mutex mutex_;
  std::condition_variable answered_;
  std::map<std::uint64_t, Waiting*> waiting_;
  std::map<std::uint64_t, std::function<void(Result<Incoming*>)>> later_;
  std::uint64_t next_id_ = 2;  // 1 is hello's
  bool ended_ = false;
  Failure end_;  // why; its detail is kept beside it
  std::string end_detail_;
  std::deque<std::vector<std::byte>> unsent_;
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
/// The text of a Refused, for people: nothing in it that a terminal would obey. Empty for any other.
std::string refusal_text(const Incoming& packet);
/// Copies a name into a packet. False if it does not fit with its terminator.
bool write_name(abi::wire::Name& name, std::string_view text) noexcept;

}  // namespace agnocast
