// SPDX-License-Identifier: Apache-2.0
//
// Session: one connection. Who is at its other end, how far it has come, what still has to be sent.
//
//   accepted ──identity confirmed and hello──▶ greeted ──end of connection, overflow──▶ closed
//            ──identity confirmed and observe──▶ observing ──────────────────────────▶ closed
//
// Packets leave in the order in which they were handed in, each counted; the number of a packet is
// what `seen` in an `unlinked` refers to, so the session also remembers in which packet each thing
// was announced last. What does not fit into the socket waits in a bounded queue; a client that
// does not read until the bound is reached is disconnected. A closed session is not a dead process:
// that is the reaper's to find out. An observer is sent one whole dump at a time, however long, and
// has to read it before it asks for the next.
//
// The queue and the book of announcements are pure; only flush() touches the socket.
#pragma once

#include <agnocast/abi/wire.hpp>
#include <agnocast/result.hpp>
#include <base/packet_socket.hpp>
#include <base/peer_identity.hpp>
#include <daemon/requests.hpp>
#include <daemon/shared_fd.hpp>
#include <daemon/tables.hpp>

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <span>
#include <tuple>
#include <utility>
#include <vector>

namespace agnocast::daemon {

/// What an announcement is about: an endpoint, or (kind region) a process's region and windows.
struct Announced {
  abi::wire::Kind kind = abi::wire::Kind::region;
  std::uint32_t topic = 0;
  std::uint64_t index = 0;
  friend bool operator<(const Announced& a, const Announced& b) noexcept {
    return std::tuple(a.kind, a.topic, a.index) < std::tuple(b.kind, b.topic, b.index);
  }
};

/// In which packet of one connection each thing was announced last.
class AnnouncementNumbers {
 public:
  void announced(const Announced& subject, std::uint64_t packet) { last_[subject] = packet; }
  /// A statement made after `seen` packets is void when the subject was announced in a later one.
  bool is_void(const Announced& subject, std::uint64_t seen) const {
    const auto found = last_.find(subject);
    return found != last_.end() && found->second > seen;
  }
  void forget(const Announced& subject) { last_.erase(subject); }
  std::size_t size() const noexcept { return last_.size(); }

 private:
  std::map<Announced, std::uint64_t> last_;
};

/// Of which collisions a process was told on one connection. A reader that comes back again and again
/// has nothing new to say to its publishers.
class CollisionsTold {
 public:
  // Pairs of endpoints. Whoever has more is told of some twice, and costs the daemon 2 MB.
  static constexpr std::size_t count_max = 16 * 1024;
  struct Collision {
    std::uint64_t own_generation = 0, other_generation = 0, window = 0;
    bool moves = false;
    friend bool operator==(const Collision&, const Collision&) = default;
  };
  /// Whether this is news about the endpoint of the process and the other one.
  bool tell(const Announced& own, const Announced& other, const Collision& what) {
    if (told_.size() >= count_max && !told_.contains({own, other})) told_.clear();
    Collision& before = told_[{own, other}];
    return std::exchange(before, what) != what;
  }
  std::size_t size() const noexcept { return told_.size(); }

 private:
  std::map<std::pair<Announced, Announced>, Collision> told_;
};

struct Outgoing {
  std::vector<std::byte> bytes;
  std::vector<SharedFd> fds;
  // Called once, just before it is sent. Whatever is made for this packet alone is made here: in the
  // queue of a client that does not read it would be one more descriptor of ours for each packet.
  std::function<void(Outgoing&)> complete = {};
  std::uint64_t since_ms = 0;    // when it was handed in
  std::uint64_t cost_bytes = 0;  // of the session, as long as it waits
};

/// What waits for all processes of one user.
struct QueuedOfUser {
  std::uint64_t bytes = 0;
  std::uint64_t peak = 0;             // since somebody has last looked
  std::uint64_t bytes_max = UINT64_MAX;  // [quota] queued_bytes
};

/// A session's part of that. It goes with the session.
class QueuedBytes {
 public:
  explicit QueuedBytes(std::shared_ptr<QueuedOfUser> user) : user_(std::move(user)) {}
  QueuedBytes(QueuedBytes&& other) noexcept
      : user_(std::move(other.user_)), own_(std::exchange(other.own_, 0)) {}
  QueuedBytes& operator=(QueuedBytes&& other) noexcept {
    std::swap(user_, other.user_);
    std::swap(own_, other.own_);
    return *this;
  }
  ~QueuedBytes() { remove(own_); }

  void add(std::uint64_t bytes) noexcept {
    own_ += bytes;
    user_->bytes += bytes;
    user_->peak = std::max(user_->peak, user_->bytes);
  }
  void remove(std::uint64_t bytes) noexcept {
    own_ -= bytes;
    if (user_) user_->bytes -= bytes;
  }
  std::uint64_t own() const noexcept { return own_; }
  const QueuedOfUser& user() const noexcept { return *user_; }

 private:
  std::shared_ptr<QueuedOfUser> user_;
  std::uint64_t own_ = 0;
};

class Session {
 public:
  // Of one client that does not read, some 10 MB; [quota] queued_bytes bounds those of all clients of
  // a user together. Who comes back is told in parts of half of this, and of one endpoint or topic
  // more; each is at most 1,022 packets.
  static constexpr std::size_t queue_count_max = 16 * 1024;

  Session(PacketSocket socket, PeerIdentity identity,
          std::shared_ptr<QueuedOfUser> user = std::make_shared<QueuedOfUser>())
      : socket_(std::move(socket)), identity_(std::move(identity)), queued_(std::move(user)) {}

  const PacketSocket& socket() const noexcept { return socket_; }
  PeerIdentity& identity() noexcept { return identity_; }
  const PeerIdentity& identity() const noexcept { return identity_; }

  bool greeted() const noexcept { return client_.has_value(); }
  std::optional<ClientIndex> client() const noexcept { return client_; }
  void greet(ClientIndex client) noexcept { client_ = client; }
  void observe() noexcept { observing_ = true; }
  Role role() const noexcept {
    return observing_ ? Role::observer : greeted() ? Role::client : Role::unknown;
  }
  /// After this nothing is sent and nothing is read. The connection is the caller's to close, which
  /// takes as long as the client likes unless may_carry() is false.
  [[nodiscard]] UniqueFd close() noexcept {
    drop_output();
    return socket_.release();
  }
  /// Whether descriptors may be in the queue of the connection, or come into it.
  bool may_carry() const noexcept { return may_carry_; }
  void set_may_carry(bool may_carry) noexcept { may_carry_ = may_carry; }
  bool closed() const noexcept { return !socket_; }
  void drop_output() noexcept {
    std::deque<Outgoing>().swap(queue_);  // and its memory
    queued_.remove(queued_.own());
  }

  /// Appends a packet; its number. Sends nothing yet.
  std::uint64_t push(std::span<const std::byte> bytes, std::vector<SharedFd> fds);
  void push(Outgoing packet);
  enum class Flushed : std::uint8_t {
    all,
    blocked,  ///< go on when the socket is writable
    later,    ///< too many descriptors are under way, whatever the socket says; go on in a while
    gone,     ///< the peer has closed; the end of the connection will be read like any other
    over,     ///< the queue is too long, or the kernel refuses
  };
  /// Sends what the socket takes.
  [[nodiscard]] Flushed flush();
  bool has_output() const noexcept { return !queue_.empty(); }
  std::size_t queued_count() const noexcept { return queue_.size(); }
  std::uint64_t queued_bytes() const noexcept { return queued_.own(); }
  /// How long the first packet has waited for the reader; 0: none does.
  std::uint64_t waits_ms(std::uint64_t now) const noexcept {
    return queue_.empty() || held_back_ ? 0 : now - std::min(now, queue_.front().since_ms);
  }
  /// More than half of what this user may have waits already: what can wait elsewhere is to do so.
  bool is_crowded() const noexcept { return queued_.user().bytes >= queued_.user().bytes_max / 2; }
  bool is_over() const noexcept { return queued_.user().bytes > queued_.user().bytes_max; }
  /// Not the reader's fault: the last flush() said `later`.
  bool held_back() const noexcept { return held_back_; }
  /// Packets handed in so far, sent or not.
  std::uint64_t packet_count() const noexcept { return packet_count_; }

  AnnouncementNumbers& announcements() noexcept { return announcements_; }
  CollisionsTold& collisions() noexcept { return collisions_; }

  /// Requests refused because they broke the protocol; the log speaks only of the first ones.
  std::uint64_t violation_count = 0;
  /// User namespace of the process, 0 when unknown.
  std::uint64_t user_namespace = 0;

 private:
  PacketSocket socket_;
  PeerIdentity identity_;
  std::optional<ClientIndex> client_;
  bool observing_ = false, held_back_ = false, may_carry_ = true;
  std::deque<Outgoing> queue_;
  QueuedBytes queued_;
  std::uint64_t packet_count_ = 0;
  AnnouncementNumbers announcements_;
  CollisionsTold collisions_;
};

}  // namespace agnocast::daemon
