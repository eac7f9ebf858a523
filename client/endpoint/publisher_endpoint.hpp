// SPDX-License-Identifier: Apache-2.0
//
// PublisherEndpoint: an untyped publisher: its queue, the subscriptions that it has mapped, and the
// wait sets that it rings.
//
// publish() runs in user threads, run_upkeep() in the control thread, under one private mutex. Two
// things happen outside it. Freed messages are destroyed there: their destructors are user code
// (after small publishes, not before the next borrow or publish). And the control thread rings the
// wait sets beyond the first two, so that a wide topic does not cost its publisher one system call
// per wait set.
#pragma once

#include <agnocast/message_type.hpp>
#include <base/descriptors/doorbell.hpp>
#include <client/endpoint/departure.hpp>
#include <client/endpoint/endpoint_events.hpp>
#include <client/endpoint/endpoint_owner.hpp>
#include <client/endpoint/peer.hpp>
#include <client/process/library_thread.hpp>
#include <client/shares/descriptor_share.hpp>
#include <client/shares/peer_owner.hpp>
#include <client/shares/reader_shares.hpp>
#include <client/shares/unmapped_users.hpp>
#include <dataplane/publisher_core.hpp>

#include <array>
#include <atomic>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <span>
#include <vector>

namespace agnocast {

class PublisherEndpoint {
 public:
  using Core = dataplane::PublisherCore<SharedMemory>;
  struct Identity {
    Core::Identity core;
    std::uint32_t topic_index;
    detail::MessageEnd end_message;
    std::function<void()> wake_control;  // asks the control thread to call run_upkeep(); any
                                         // thread, no allocation
    std::shared_ptr<EndpointEvents> events = {};  // of the endpoint that this one continues
    EndpointOwner* owner = nullptr;
    std::uint64_t persistent_id = 0;
    bool announces_persistent_id_later = false;
    bool (*make_room_everywhere)() noexcept =
        nullptr;              // destroys the unneeded messages of every publisher
    SignalMask signals = {};  // of its creator: for message destructors in library threads
  };
  /// For small messages: most publishes look at no link, and so take no cache line from a reader on
  /// another core.
  static constexpr std::uint64_t deferred_limit = 7;
  static_assert(deferred_limit <= abi::deferred_scan_count_max);

  struct Subscription {
    std::uint64_t index;
    std::uint64_t generation;
    std::uint64_t extent;
    std::uint64_t wait_set;  // in its process
    PeerOwner owner;         // of its process
    std::uint64_t quota;     // messages of this publisher that it may hold
  };
  /// A subscription that this publisher no longer serves, or serves again, as reported to the
  /// daemon.
  struct Withdrawn {
    std::uint64_t index;
    std::uint64_t generation;
    abi::Withdrawal why;  // none: served again
    std::uint64_t bytes;  // that it held at that time
  };

  /// The doorbell of a wait set, and its part of this process's descriptor share.
  struct PeerDoorbell {
    Doorbell sender;
    DescriptorShare::Part counted;
  };

  explicit PublisherEndpoint(const Identity& identity);
  PublisherEndpoint(const PublisherEndpoint&) = delete;
  PublisherEndpoint& operator=(const PublisherEndpoint&) = delete;
  /// Call only when the daemon has freed the index, or the process ends: messages that are still
  /// allocated are left alone.
  ~PublisherEndpoint() = default;

  const Core::Identity& identity() const noexcept { return identity_.core; }
  EndpointOwner* owner() const noexcept { return identity_.owner; }
  std::uint64_t persistent_id() const noexcept { return identity_.persistent_id; }
  std::uint32_t topic_index() const noexcept { return identity_.topic_index; }

  // --- user threads

  /// Commits `message`, an object of `object_bytes` in this process's shared heap. `message_bytes`
  /// includes all that it owns and is only counted. After `published` the queue owns the message;
  /// otherwise the caller keeps it. System calls: none while no reader sleeps, one per wait set for
  /// the first two, one more for all others.
  dataplane::PublishOutcome publish(void* message, std::uint64_t object_bytes,
                                    std::uint64_t message_bytes) noexcept;
  /// Destroys messages that publishes of small messages have freed, so that a publish returns
  /// sooner. Each borrow calls this; without a borrow the next publish destroys them.
  void make_room() noexcept;
  /// Makes two full scans (the second one frees what the first one has retired), and destroys every
  /// message that they free. Returns false if there was none.
  bool has_more_room() noexcept;
  std::uint64_t head_sequence() const noexcept;
  /// Counts missed deadlines, and the loss of its liveliness, up to now. Any thread.
  void look_at_times() noexcept;
  /// Returns false if there is no session.
  bool assert_liveliness() noexcept;
  /// Scans, and returns whether no reliable subscription can still take a message up to `sequence`.
  bool is_taken(std::uint64_t sequence) noexcept;
  /// A publish found the heap full: the next make_room() then makes room for all publishers.
  void lacked_room() noexcept;
  /// Call before the first message, if the identity says that the id is announced later. Successors
  /// announce it by themselves.
  void announce_persistent_id() noexcept;
  /// For agnocast-ctl: counts a message that was adopted, or that the shared heap had no room for.
  /// Any thread.
  void count_adopted(std::uint64_t bytes) noexcept;
  void count_heap_exhausted() noexcept;

  // --- control thread

  /// Attaches an announced subscription. `doorbell` may be mute (empty): the subscription is then
  /// looked at like any other, but no publisher rings it. For a subscription that is attached
  /// already, its doorbell is replaced and false is returned. Allocates.
  bool attach(const Subscription& subscription, std::shared_ptr<Peer> peer, PeerDoorbell doorbell);
  bool is_attached(std::uint64_t index, std::uint64_t generation) const noexcept;
  /// The subscription is over: stops looking at it and ends its use of the peer, which PeerTable
  /// unmaps once nothing uses it.
  void detach(std::uint64_t index, std::uint64_t generation) noexcept;
  /// The session of the process was revoked: ends all matches.
  void revoke() noexcept;
  /// A subscription that this publisher is attached to.
  struct EndpointId {
    std::uint64_t index;
    std::uint64_t generation;
  };
  /// Ends the use of every peer, at the very end. Returns the readers.
  std::vector<EndpointId> detach_all();
  struct Reader {
    Core::EndpointId id;
    std::uint32_t uid;
  };
  /// Replaces `readers` by the attached subscriptions of other users. Allocates.
  void list_foreign_readers(std::vector<Reader>& readers) const;
  /// Returns the bytes of messages that stay because of these readers; see PublisherCore.
  std::uint64_t kept_bytes(std::span<const Core::EndpointId> readers) const noexcept;
  /// Withdraws a reader whose user keeps more than its share.
  void withdraw(const Core::EndpointId& reader) noexcept;
  /// Notes an announced subscription that cannot be mapped. It is withdrawn after some seconds;
  /// at once if its user `is_out`, because earlier ones could not be mapped either. Allocates.
  void note_unmapped(const EndpointId& endpoint, PeerOwner owner, bool is_out,
                     ReaderShares::Clock::time_point now);
  /// Withdraws readers that could not be mapped for too long and bans their users in `unmapped`,
  /// which also notes the users of all other unmapped readers. Serves readers again that are mapped
  /// and may be. Disregards readers that were withdrawn long ago. Adds the changes for the daemon
  /// to `news`. Allocates.
  void look_at_readers(ReaderShares::Clock::time_point now, const ReaderShares& shares,
                       UnmappedUsers& unmapped, std::vector<Withdrawn>& news);
  /// Scans once, and does all that publishes have left to do.
  void run_upkeep() noexcept;
  /// Returns whether a message outside the history is allocated: a scan may free it.
  bool has_reclaimable() const noexcept;
  /// Returns whether the daemon has freed the index and nothing is left to destroy.
  bool is_over() const noexcept;
  std::uint64_t allocated_count() const noexcept;
  enum class Readers : std::uint8_t { all, local, linked, local_linked };
  /// Returns how many subscriptions receive new messages: they match, and are not withdrawn. One
  /// counts as soon as its creation is answered. `local`: those of this process alone. `linked`:
  /// those that are mapped here, and have linked; also those that have left and hold a message.
  /// `local_linked`: of these, those of this process.
  std::size_t subscription_count(Readers readers = Readers::all) const noexcept;
  /// Returns their persistent endpoint ids.
  std::vector<std::uint64_t> reader_persistent_ids() const;
  /// Returns whether a mapped subscription has not linked yet. run_upkeep() must look again soon,
  /// because linking rings no doorbell.
  bool awaits_link() const noexcept;
  const std::shared_ptr<EndpointEvents>& shared_events() const noexcept { return events_; }
  EndpointEvents& events() noexcept { return *events_; }
  Departure& departure() noexcept { return departure_; }

  // --- after the daemon's store was lost: docs/decisions/0006. The user's endpoint stays and
  // passes messages on to the endpoint that the new daemon knows.

  /// From now on messages go to `successor`, after the history for late joiners. This endpoint adds
  /// no more, and readers can see that. Returns false if it has moved already.
  bool move_to(const std::shared_ptr<PublisherEndpoint>& successor) noexcept;
  /// Sets a later successor of an endpoint that has moved.
  void redirect_to(const std::shared_ptr<PublisherEndpoint>& successor) noexcept;
  /// Returns the endpoint that publishes now: this one, or its successor.
  std::shared_ptr<PublisherEndpoint> present(const std::shared_ptr<PublisherEndpoint>& self) const;
  /// The owner has destroyed it.
  void end() noexcept { has_ended_.store(true, std::memory_order_release); }
  bool has_ended() const noexcept { return has_ended_.load(std::memory_order_acquire); }
  /// Its session will not be used after all; nothing was published.
  void abandon() noexcept;
  /// Returns whether every linked subscription of this one that is not closed, and whose process
  /// lives, is also linked to `successor`.
  bool is_succeeded_by(const PublisherEndpoint& successor) const;
  /// Stands in for the daemon: ends the endpoints whose processes are gone.
  void remove_dead_subscriptions();
  /// Returns whether it has moved or ended, and no reader needs any of its messages.
  bool is_finished() noexcept;
  /// From now on it does not access its session.
  void finish() noexcept;

 private:
  // One borrow or publish destroys this many at most. The rest waits for the next ones, or for the
  // timer of the control thread. On average a publish frees as many as it adds.
  static constexpr std::size_t destroy_at_once_max = 16;
  // docs/protocol.md, "Sleep and wake": to ring the first one or two wait sets at once costs
  // 1–6 µs each; to hand over the rest costs 2–3 µs for all.
  static constexpr std::uint64_t ring_at_once_max = 2;

  struct PeerWaitSet {
    std::uint64_t client = 0;
    std::uint64_t client_generation = 0;
    std::uint64_t wait_set = 0;  // in its process
    std::uint64_t users = 0;     // attached subscriptions; 0 = free
    PeerDoorbell doorbell;
    bool is_owed_ring = false;  // by the control thread
    std::byte* region = nullptr;
  };
  /// Each subscription is counted as matched once: when it is seen linked, at the latest when it is
  /// detached. `ended`: the session is revoked, or the subscription belongs to the successor.
  enum class Match : std::uint8_t { awaited, counted, ended };
  struct Attached {
    std::uint64_t index;
    std::uint64_t generation;
    std::uint64_t extent;
    std::size_t wait_set;
    std::shared_ptr<Peer> peer;
    PeerOwner owner;
    Match match = Match::awaited;
  };
  /// A subscription that is withdrawn, or not attached.
  struct Watched {
    std::uint64_t generation;
    ReaderShares::Clock::time_point since;
    abi::Withdrawal why = abi::Withdrawal::none;  // as last reported to the daemon
    std::optional<PeerOwner> owner = {};          // if it was announced
  };
  struct Work;
  struct Seen;
  struct Look;

  template <class Do>
  void run_locked(Do work, Work& left) noexcept;
  void destroy_all(const Work& left) noexcept;
  template <class Do>
  void with_queue(Do work) noexcept;
  template <class Do>
  void in_control_thread(Do work) noexcept;
  void count(std::size_t counter, std::uint64_t more) noexcept;
  std::uint64_t newest_stamp() const noexcept;
  std::uint64_t newest_stamp_here() const noexcept;
  bool see_readers(std::vector<Seen>& seen) const;
  void look_at(const Seen& reader, Watched& endpoint, const Look& look);
  std::size_t number_of(const Peer& peer, std::uint64_t wait_set, PeerDoorbell doorbell);
  void replace_doorbell(const Subscription& subscription, PeerDoorbell doorbell) noexcept;
  bool is_linked(const Attached& attached) const noexcept;
  std::size_t reader_count_max() const noexcept;
  void note_links() noexcept;
  std::size_t matched_count(Readers readers) const noexcept;  // under the mutex
  std::size_t linked_count(Readers readers) const noexcept;   // likewise
  std::vector<std::uint64_t> linked_persistent_ids(bool living) const;

  Identity identity_;
  mutable std::mutex mutex_;
  std::unique_ptr<Core> core_;
  std::vector<PeerWaitSet> wait_sets_;
  std::vector<Attached> attached_;
  std::map<std::uint64_t, Watched> watched_;  // by index; control thread only
  std::vector<void*> doomed_;  // to be destroyed later; capacity for every slot from the start
  // For a check without the mutex; a caller that misses a change comes again. `has_doomed_` is set
  // whenever either one applies.
  std::atomic<bool> has_doomed_{false}, lacked_room_{false};
  void destroy(void* message) noexcept;
  void inherit(const dataplane::Entry& entry) noexcept;

  const std::shared_ptr<EndpointEvents> events_;
  Departure departure_;
  LeaseWatch lease_;       // under the mutex, like the next ones
  bool is_alone_ = false;  // remove_dead_subscriptions() stands in for the daemon
  bool moved_ = false;
  std::shared_ptr<PublisherEndpoint> successor_;  // null with `moved_`: this one was abandoned
  std::atomic<bool> has_ended_{false};
};

}  // namespace agnocast
