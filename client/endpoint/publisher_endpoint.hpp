// SPDX-License-Identifier: Apache-2.0
//
// PublisherEndpoint: an untyped publisher: its queue, the subscriptions it has mapped, and whom it
// rings.
//
// publish() runs in user threads, scan() also in the control thread, under one private mutex. Two
// things happen outside it: messages that may go are destroyed there (their destructors are user
// code; after small publishes not before the next borrow or publish), and wait sets beyond the
// first two are rung by the control thread, so that a wide topic does not cost its publisher one
// system call per wait set.
#pragma once

#include <agnocast/message_type.hpp>
#include <base/descriptors/doorbell.hpp>
#include <client/endpoint/departure.hpp>
#include <client/endpoint/endpoint_events.hpp>
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

class Context;

class PublisherEndpoint {
 public:
  using Core = dataplane::PublisherCore<SharedMemory>;
  struct Identity {
    Core::Identity core;
    std::uint32_t topic_index;
    detail::MessageEnd end_message;
    std::function<void()> wake_control;  // asks the control thread to call run_errands(); any
                                         // thread, no allocation
    std::shared_ptr<EndpointEvents> events = {};  // of the endpoint that this one continues
    Context* context = nullptr;                   // its session
    std::uint64_t persistent_id = 0;
    bool announces_persistent_id_later = false;
    bool (*make_room_everywhere)() noexcept =
        nullptr;              // destroys what nobody needs, of every publisher of this process
    SignalMask signals = {};  // of who has made it: for destructors of messages in threads of ours
  };
  /// Of small messages: most publishes look at no link, and so take no line from a reader on
  /// another core.
  static constexpr std::uint64_t deferred_limit = 7;
  static_assert(deferred_limit <= abi::deferred_scan_count_max);

  struct Subscription {
    std::uint64_t index;
    std::uint64_t generation;
    std::uint64_t extent;
    std::uint64_t executor;  // in its process
    PeerOwner owner;         // of its process
    std::uint64_t quota;     // messages of this publisher that it may hold
  };
  /// A subscription that this publisher serves no more, or again: what the daemon is told.
  struct Withdrawn {
    std::uint64_t index;
    std::uint64_t generation;
    abi::Withdrawal why;  // none: again
    std::uint64_t bytes;  // that it held then
  };

  /// How a wait set is rung, and what that costs this process.
  struct PeerDoorbell {
    Doorbell sender;
    DescriptorShare::Part counted;
  };

  explicit PublisherEndpoint(const Identity& identity);
  PublisherEndpoint(const PublisherEndpoint&) = delete;
  PublisherEndpoint& operator=(const PublisherEndpoint&) = delete;
  /// Only when the daemon has freed the index, or the process ends: what is still allocated is left
  /// alone.
  ~PublisherEndpoint() = default;

  const Core::Identity& identity() const noexcept { return identity_.core; }
  Context* context() const noexcept { return identity_.context; }
  std::uint64_t persistent_id() const noexcept { return identity_.persistent_id; }
  std::uint32_t topic_index() const noexcept { return identity_.topic_index; }

  // --- user threads
  // --------------------------------------------------------------------------------------------------------------

  /// Commits `message`, an object of `object_bytes` in this process's shared heap; with what
  /// belongs to it `message_bytes`, which is only counted. After `published` it belongs to the
  /// queue; otherwise it stays the caller's. System calls: none while nobody sleeps, one per wait
  /// set for the first two, one more for all others.
  dataplane::PublishOutcome publish(void* message, std::uint64_t object_bytes,
                                    std::uint64_t message_bytes) noexcept;
  /// Destroys what publishes of small messages have freed: they leave it, so that a publish returns
  /// sooner to who borrows for each; the next publish does where nobody borrows.
  void make_room() noexcept;
  /// Two whole scans, the second of which frees what the first has retired, and every message that
  /// they have found is destroyed here. False: there was none.
  bool has_more_room() noexcept;
  /// A publish found the heap full: the next make_room() does this for all publishers.
  void lacked_room() noexcept;
  /// Before the first message, if the identity says that it is to be said later. Successors say it
  /// by themselves.
  void announce_persistent_id() noexcept;
  /// For agnocast-ctl: a message was adopted, or the shared heap had no room to adopt it. Any
  /// thread.
  void count_adopted(std::uint64_t bytes) noexcept;
  void count_heap_exhausted() noexcept;

  // --- control thread
  // ------------------------------------------------------------------------------------------------------------

  /// An announced subscription. `doorbell` may be mute (empty): the subscription is looked at like
  /// any other and rung by nobody. A doorbell of one that is attached already replaces the one it
  /// has, and false is returned. Allocates.
  bool attach(const Subscription& subscription, std::shared_ptr<Peer> peer, PeerDoorbell doorbell);
  bool is_attached(std::uint64_t index, std::uint64_t generation) const noexcept;
  /// It is over: looks at it no more and unmaps its region.
  void detach(std::uint64_t index, std::uint64_t generation) noexcept;
  /// The session of the process was revoked: nobody is matched any more.
  void revoke() noexcept;
  /// A subscription that it is attached to.
  struct EndpointId {
    std::uint64_t index;
    std::uint64_t generation;
  };
  /// Unmaps every region, at the very end. Returns the readers.
  std::vector<EndpointId> detach_all();
  struct Reader {
    Core::EndpointId id;
    std::uint32_t uid;
  };
  /// The attached subscriptions of other users, instead of what is there. Allocates.
  void list_foreign_readers(std::vector<Reader>& readers) const;
  /// See PublisherCore.
  std::uint64_t kept_bytes(std::span<const Core::EndpointId> readers) const noexcept;
  /// Its user has more than its share.
  void withdraw(const Core::EndpointId& reader) noexcept;
  /// A subscription that was announced and cannot be mapped. Its user has some seconds, or, if it
  /// `is_out`, none: its former ones could not be mapped either. Allocates.
  void note_unmapped(const EndpointId& endpoint, PeerOwner owner, bool is_out,
                     ReaderShares::Clock::time_point now);
  /// Who could not be mapped for long is not served, and its user is banned in `unmapped`, where
  /// the users of all others that are not mapped are noted; whoever was is served again; who was
  /// told long ago that it is not served is disregarded. What there is to tell the daemon is added.
  /// Allocates.
  void look_at_readers(ReaderShares::Clock::time_point now, const ReaderShares& shares,
                       UnmappedUsers& unmapped, std::vector<Withdrawn>& news);
  /// One scan, and everything that publishes have left to do.
  void run_errands() noexcept;
  /// Something outside the history is allocated: a scan may free it.
  bool has_reclaimable() const noexcept;
  /// The daemon has freed it and nothing is left to destroy.
  bool is_over() const noexcept;
  std::uint64_t allocated_count() const noexcept;
  /// Subscriptions that get what is published from now on: mapped here, and linked there.
  std::size_t subscription_count() const noexcept;
  /// Their persistent endpoint ids.
  std::vector<std::uint64_t> reader_persistent_ids() const;
  /// A subscription is mapped that has not linked yet: run_errands() shall look again soon, because
  /// nobody rings when it has.
  bool awaits_link() const noexcept;
  const std::shared_ptr<EndpointEvents>& shared_events() const noexcept { return events_; }
  EndpointEvents& events() noexcept { return *events_; }
  Departure& departure() noexcept { return departure_; }

  // --- after the daemon's store was lost: docs/decisions/0006. The endpoint that the user has
  // stays, and hands what it is given to the one that the new daemon knows.

  /// From now on what is published goes to `successor`, with the history for late joiners ahead of
  /// it; here nothing is added any more, and readers can see that. False when it has moved already.
  bool move_to(const std::shared_ptr<PublisherEndpoint>& successor) noexcept;
  /// A later successor of an endpoint that has moved.
  void redirect_to(const std::shared_ptr<PublisherEndpoint>& successor) noexcept;
  /// The endpoint that publishes now: this one, or its successor.
  std::shared_ptr<PublisherEndpoint> present(const std::shared_ptr<PublisherEndpoint>& self) const;
  /// Its owner wants no more of it.
  void end() noexcept { has_ended_.store(true, std::memory_order_release); }
  bool has_ended() const noexcept { return has_ended_.load(std::memory_order_acquire); }
  /// Its session will not be used after all: nothing was published.
  void abandon() noexcept;
  /// Every linked subscription of this one that is not closed, and whose process lives, is linked
  /// to `successor` as well.
  bool is_succeeded_by(const PublisherEndpoint& successor) const;
  /// What a daemon would have said: endpoints whose processes are gone count no more.
  void bury_dead();
  /// It has moved or ended, and nobody reads anything of it any more.
  bool is_finished() noexcept;
  /// Touches nothing of its session any more.
  void finish() noexcept;

 private:
  // Destroyed by one borrow or publish at most; what is more waits for the next ones, or for the
  // timer of the control thread. A publish frees as many as it adds on average.
  static constexpr std::size_t destroy_at_once_max = 16;
  // protocol §4.2: sending to the first one or two wait sets at once costs 1–6 µs each, handing over
  // the rest 2–3 µs for all.
  static constexpr std::uint64_t ring_at_once_max = 2;

  struct Executor {
    std::uint64_t client = 0;
    std::uint64_t client_generation = 0;
    std::uint64_t executor = 0;
    std::uint64_t users = 0;  // attached subscriptions; 0 = free
    PeerDoorbell doorbell;
    std::uint64_t owed = 0;  // sleep generation that the control thread shall ring; 0 = none
    std::byte* region = nullptr;
  };
  /// Whether a subscription was counted as matched, which it is once: when it is seen linked, at
  /// the latest when it is detached. Not any more when the session is revoked, or the subscription
  /// is the successor's.
  enum class Match : std::uint8_t { awaited, counted, ended };
  struct Attached {
    std::uint64_t index;
    std::uint64_t generation;
    std::uint64_t extent;
    std::size_t executor;
    std::shared_ptr<Peer> peer;
    PeerOwner owner;
    Match match = Match::awaited;
  };
  /// Of a subscription that is withdrawn, or not attached.
  struct Watched {
    std::uint64_t generation;
    ReaderShares::Clock::time_point since;
    abi::Withdrawal why = abi::Withdrawal::none;  // as far as the daemon was told
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
  bool see_readers(std::vector<Seen>& seen) const;
  void look_at(const Seen& reader, Watched& endpoint, const Look& look);
  std::size_t executor_of(const Peer& peer, std::uint64_t executor, PeerDoorbell doorbell);
  void replace_doorbell(const Subscription& subscription, PeerDoorbell doorbell) noexcept;
  bool is_linked(const Attached& attached) const noexcept;
  void note_links() noexcept;
  std::size_t linked_count() const noexcept;  // under the mutex
  std::vector<std::uint64_t> linked_persistent_ids(bool living) const;

  Identity identity_;
  mutable std::mutex mutex_;
  std::unique_ptr<Core> core_;
  std::vector<Executor> executors_;
  std::vector<Attached> attached_;
  std::map<std::uint64_t, Watched> watched_;  // by index; control thread only
  std::vector<void*> doomed_;  // to be destroyed later; capacity for every slot from the start
  // For a look without the mutex; whoever misses one comes again. `has_doomed_` where any of both
  // is so.
  std::atomic<bool> has_doomed_{false}, lacked_room_{false};
  void destroy(void* message) noexcept;
  void inherit(const dataplane::Entry& entry) noexcept;

  const std::shared_ptr<EndpointEvents> events_;
  Departure departure_;
  bool moved_ = false;                            // under the mutex, as the next
  std::shared_ptr<PublisherEndpoint> successor_;  // null with `moved_`: it was abandoned
  std::atomic<bool> has_ended_{false};
};

}  // namespace agnocast
