// SPDX-License-Identifier: Apache-2.0
//
// Session: one connection: the process at its other end, its role, the packets still to be sent.
//
//   accepted ──identity confirmed and hello──▶ greeted ──end of connection, overflow──▶ closed
//            ──identity confirmed and observe──▶ observing ──────────────────────────▶ closed
//
// Packets leave in the order in which they were pushed, each counted; `seen` in an `unlinked` is
// the number of a packet, so the session also remembers in which packet each thing was announced
// last. Packets that do not fit into the socket wait in a bounded queue; a client that does not
// read until the bound is reached is disconnected. A closed session is not a dead process: the
// reaper finds that out. An observer is sent one whole dump at a time, however long, and has to
// read it before it asks for the next.
//
// The queue and the notes of announcements are pure; only flush() touches the socket.
#pragma once

#include <agnocast/abi/wire.hpp>
#include <agnocast/result.hpp>
#include <base/sockets/packet_socket.hpp>
#include <base/sockets/peer_identity.hpp>
#include <daemon/state/tables.hpp>
#include <daemon/transport/request_reading.hpp>
#include <daemon/transport/shared_fd.hpp>

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
#include <unordered_map>
#include <utility>
#include <vector>

namespace agnocast::daemon {

/// The subject of an announcement: an endpoint, or (kind region) a process's region and windows.
struct Announced {
  abi::wire::Kind kind = abi::wire::Kind::region;
  std::uint32_t topic = 0;
  std::uint64_t index = 0;
  friend bool operator<(const Announced& a, const Announced& b) noexcept {
    return std::tuple(a.kind, a.topic, a.index) < std::tuple(b.kind, b.topic, b.index);
  }
};

/// Amounts kept for all processes of one user.
struct KeptForUser {
  std::uint64_t callback_groups = 0;
  std::uint64_t callback_threads = 0;
  std::uint64_t callback_spins = 0;      // pairs of a thread and an executor
  std::uint64_t bytes = 0;               // of waiting packets
  std::uint64_t peak = 0;                // since the last check
  std::uint64_t bytes_max = UINT64_MAX;  // [quota] queued_bytes
  std::uint64_t noted_bytes = 0;         // of what it has noted, below
};

/// The amount of one object, as a part of the sum of its user. It is subtracted with the object.
class ShareOfUser {
 public:
  using Sum = std::uint64_t KeptForUser::*;
  ShareOfUser(std::shared_ptr<KeptForUser> user, Sum sum) noexcept
      : user_(std::move(user)), sum_(sum) {}
  ShareOfUser(ShareOfUser&& other) noexcept
      : user_(std::move(other.user_)), sum_(other.sum_), own_(std::exchange(other.own_, 0)) {}
  ShareOfUser& operator=(ShareOfUser&& other) noexcept {
    std::swap(user_, other.user_);
    std::swap(sum_, other.sum_);
    std::swap(own_, other.own_);
    return *this;
  }
  ~ShareOfUser() { set(0); }

  void set(std::uint64_t own) noexcept {
    if (user_) (*user_).*sum_ += own - own_;
    own_ = own;
  }
  std::uint64_t own() const noexcept { return own_; }
  const KeptForUser& user() const noexcept { return *user_; }
  KeptForUser& user() noexcept { return *user_; }

 private:
  std::shared_ptr<KeptForUser> user_;
  Sum sum_;
  std::uint64_t own_ = 0;
};

/// The cost of one list that a session notes.
class NotedBytes : public ShareOfUser {
 public:
  // As much as the default for waiting packets: two million announcements. The processes with more
  // pay with connections that begin anew, so the number has no key.
  static constexpr std::uint64_t of_user_max = std::uint64_t{96} << 20;
  // For each list, whatever the others of its user cost: 1,536 processes of one user (its default
  // quota) with two lists each have 96 MiB of this.
  static constexpr std::uint64_t own_max = std::uint64_t{32} << 10;

  explicit NotedBytes(std::shared_ptr<KeptForUser> user) noexcept
      : ShareOfUser(std::move(user), &KeptForUser::noted_bytes) {}

  bool has_room_for(std::uint64_t more) const noexcept {
    return own() + more <= own_max || user().noted_bytes + more <= of_user_max;
  }
};

/// The packet of one connection in which each thing was announced last. If there is no room for
/// more, the older half is forgotten. A statement that was made before what was forgotten cannot
/// be judged any more: its process is notified of everything again, on a new connection.
class AnnouncementNumbers {
 public:
  // A node of 24 bytes with malloc's overhead, and its part of the buckets.
  static constexpr std::uint64_t entry_bytes = 48;

  explicit AnnouncementNumbers(std::shared_ptr<KeptForUser> user) : bytes_(std::move(user)) {}

  void announced(const Announced& subject, std::uint64_t packet) {
    const auto known = last_.find(key_of(subject));
    if (known != last_.end()) {
      known->second = packet;
      return;
    }
    if (!bytes_.has_room_for(entry_bytes)) forget_older_half();
    last_.emplace(key_of(subject), packet);
    bytes_.set(last_.size() * entry_bytes);
  }
  /// Returns whether a later packet announced the subject: a statement after `seen` packets is
  /// void.
  bool is_void(const Announced& subject, std::uint64_t seen) const {
    const auto found = last_.find(key_of(subject));
    return found != last_.end() && found->second > seen;
  }
  /// Returns whether the subject may have been announced in a later packet that was forgotten.
  bool may_be_void(const Announced& subject, std::uint64_t seen) const {
    return seen < forgotten_ && !last_.contains(key_of(subject));
  }
  void forget(const Announced& subject) {
    last_.erase(key_of(subject));
    bytes_.set(last_.size() * entry_bytes);
  }
  std::size_t size() const noexcept { return last_.size(); }

 private:
  static std::uint64_t key_of(const Announced& subject) noexcept {
    static_assert(abi::client_count_max <= 1 << 16 && abi::subscription_count_max <= 1 << 16);
    return std::uint64_t{static_cast<std::uint32_t>(subject.kind)} << 48 |
           std::uint64_t{subject.topic} << 16 | subject.index;
  }
  void forget_older_half() {
    if (last_.empty()) return;
    std::vector<std::uint64_t> numbers;
    numbers.reserve(last_.size());
    for (const auto& [key, packet] : last_) numbers.push_back(packet);
    const auto middle = numbers.begin() + static_cast<std::ptrdiff_t>(numbers.size() / 2);
    std::nth_element(numbers.begin(), middle, numbers.end());
    forgotten_ = *middle;
    std::erase_if(last_, [&](const auto& entry) { return entry.second <= forgotten_; });
  }

  std::unordered_map<std::uint64_t, std::uint64_t> last_;
  std::uint64_t forgotten_ = 0;  // the latest packet with a forgotten announcement
  NotedBytes bytes_;
};

/// The collisions that a process was notified of on one connection. A reader that comes back again
/// and again causes no new notices to its publishers.
class CollisionsNotified {
 public:
  // Pairs of endpoints. A process with more is notified of some twice, and costs the daemon 2 MB.
  static constexpr std::size_t count_max = 16 * 1024;
  // A node, with malloc's overhead.
  static constexpr std::uint64_t entry_bytes = 128;
  struct Collision {
    std::uint64_t own_generation = 0, other_generation = 0, window = 0;
    bool moves = false;
    friend bool operator==(const Collision&, const Collision&) = default;
  };
  explicit CollisionsNotified(std::shared_ptr<KeptForUser> user) : bytes_(std::move(user)) {}

  /// Returns whether this is news about the endpoint of the process and the other one.
  bool report(const Announced& own, const Announced& other, const Collision& what) {
    const bool is_full = notified_.size() >= count_max || !bytes_.has_room_for(entry_bytes);
    if (is_full && !notified_.contains({own, other})) notified_.clear();
    Collision& before = notified_[{own, other}];
    bytes_.set(notified_.size() * entry_bytes);
    return std::exchange(before, what) != what;
  }
  std::size_t size() const noexcept { return notified_.size(); }

 private:
  std::map<std::pair<Announced, Announced>, Collision> notified_;
  NotedBytes bytes_;
};

struct Outgoing {
  std::vector<std::byte> bytes;
  std::vector<SharedFd> fds;
  // Called once, just before the packet is sent. Descriptors for this packet alone are made here:
  // queued for a client that does not read, each packet would cost one more descriptor.
  std::function<void(Outgoing&)> complete = {};
  std::uint64_t since_ms = 0;    // when it was pushed
  std::uint64_t cost_bytes = 0;  // charged to the session while it waits
};

class Session {
 public:
  // For one client that does not read, some 10 MB; [quota] queued_bytes bounds the sum of a user's
  // clients. A process that comes back is notified in parts of half of this, plus one endpoint or
  // topic; each of those is at most 1,022 packets.
  static constexpr std::size_t queue_count_max = 16 * 1024;

  Session(PacketSocket socket, PeerIdentity identity,
          std::shared_ptr<KeptForUser> user = std::make_shared<KeptForUser>())
      : socket_(std::move(socket)),
        identity_(std::move(identity)),
        queued_(user, &KeptForUser::bytes),
        announcements_(user),
        collisions_(std::move(user)) {}

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
  /// Ends sending and reading. The caller closes the returned connection, which takes as long as
  /// the client likes unless may_carry() is false.
  [[nodiscard]] UniqueFd close() noexcept {
    drop_output();
    return socket_.release();
  }
  /// Returns whether descriptors may be in the queue of the connection, or come into it.
  bool may_carry() const noexcept { return may_carry_; }
  void set_may_carry(bool may_carry) noexcept { may_carry_ = may_carry; }
  bool closed() const noexcept { return !socket_; }
  void drop_output() noexcept {
    std::deque<Outgoing>().swap(queue_);  // frees its memory too
    queued_.set(0);
  }

  /// Appends a packet and returns its number. Sends nothing yet.
  std::uint64_t push(std::span<const std::byte> bytes, std::vector<SharedFd> fds);
  void push(Outgoing packet);
  enum class Flushed : std::uint8_t {
    all,
    blocked,  ///< continue when the socket is writable
    later,    ///< too many descriptors are in flight, even if it is writable; continue later
    gone,     ///< the peer has closed; the loop reads the end of the connection like any other
    over,     ///< the queue is too long, or the kernel refuses
  };
  /// Sends what the socket accepts.
  [[nodiscard]] Flushed flush();
  bool has_output() const noexcept { return !queue_.empty(); }
  std::size_t queued_count() const noexcept { return queue_.size(); }
  std::uint64_t queued_bytes() const noexcept { return queued_.own(); }
  /// Returns how long the first packet has waited for the reader; 0: none waits.
  std::uint64_t waits_ms(std::uint64_t now) const noexcept {
    return queue_.empty() || held_back_ ? 0 : now - std::min(now, queue_.front().since_ms);
  }
  /// Returns whether this user's queues are more than half full: further work should wait.
  bool is_crowded() const noexcept { return queued_.user().bytes >= queued_.user().bytes_max / 2; }
  bool is_over() const noexcept { return queued_.user().bytes > queued_.user().bytes_max; }
  /// Returns whether the last flush() returned `later`: not the reader's fault.
  bool held_back() const noexcept { return held_back_; }
  /// Returns the number of packets pushed so far, sent or not.
  std::uint64_t packet_count() const noexcept { return packet_count_; }

  AnnouncementNumbers& announcements() noexcept { return announcements_; }
  CollisionsNotified& collisions() noexcept { return collisions_; }

  /// Requests refused because they broke the protocol; the log reports only the first ones.
  std::uint64_t violation_count = 0;
  /// User namespace of the process, 0 when unknown.
  std::uint64_t user_namespace = 0;

 private:
  PacketSocket socket_;
  PeerIdentity identity_;
  std::optional<ClientIndex> client_;
  bool observing_ = false, held_back_ = false, may_carry_ = true;
  std::deque<Outgoing> queue_;
  ShareOfUser queued_;  // bytes of waiting packets
  std::uint64_t packet_count_ = 0;
  AnnouncementNumbers announcements_;
  CollisionsNotified collisions_;
};

}  // namespace agnocast::daemon
