// SPDX-License-Identifier: Apache-2.0
//
// Registry: what exists and which processes know of it. Pure state: no descriptors, no packets.
//
// Every change takes one way: the registry commits a record to the redo log, apply() carries it
// out on the tables and the board, and the log notes that it is applied. apply() is idempotent, so
// the next daemon repeats it if this one died in between. A creation has two halves: plan_*()
// chooses index, generation and extent, the caller prepares the memory, add_*() commits the
// creation. Nothing else may change between the two.
//
// endings.cpp, leaving.cpp and reaper.cpp decide *when* something may change; the registry has the
// facts that they ask for. Indexes beside the tables (names to topics, endpoints and extents of a
// process) are derived from them; open() rebuilds them.
//
// Callers pass checked indexes: one out of range is a bug of the daemon.
#pragma once

#include <agnocast/abi/words.hpp>
#include <agnocast/result.hpp>
#include <array>
#include <daemon/state/accounts.hpp>
#include <daemon/state/hold_pool.hpp>
#include <daemon/state/per_client.hpp>
#include <daemon/state/tables.hpp>
#include <journal/board_steps.hpp>
#include <journal/redo_log.hpp>

#include <cstddef>
#include <cstdint>
#include <map>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <unordered_map>
#include <utility>
#include <vector>

namespace agnocast::daemon {

/// A place for an endpoint; together with the generation it identifies one endpoint.
struct EndpointRef {
  Kind kind = Kind::publisher;
  TopicIndex topic{};
  std::uint32_t index = 0;
  friend bool operator==(const EndpointRef&, const EndpointRef&) = default;
};

struct NewClient {
  std::uint32_t uid = 0;
  std::uint32_t gid = 0;
  std::uint32_t pid = 0;
  std::uint64_t domain = 0;
  std::string_view name;
};

/// The place that a new process would get.
struct ClientPlan {
  ClientIndex index{};
  std::uint64_t generation = 0;
};

/// Values that hold for a whole incarnation.
struct Format {
  std::uint64_t arena_base = 0;
  std::uint64_t arena_bytes = 0;
  std::uint64_t window_bytes = 0;
  std::uint64_t now_ns = 0;
  std::string_view doorbells;  // at most doorbells_bytes_max - 1
};

struct NewTopic {
  std::uint64_t domain = 0;
  std::string_view name;
  std::string_view type;
  std::uint64_t layout_hash = 0;
  std::uint32_t link_blocks = 1;  // more: a wide topic
};

struct PublisherPlan {
  std::uint32_t index = 0;
  std::uint64_t generation = 0;
  std::uint64_t extent = 0;
  std::uint64_t slot_count = 0;
  std::uint64_t first_sequence = 0;
};

/// A publisher that needs more slots before a deeper subscription may join.
struct SlotRaise {
  std::uint32_t index = 0;
  std::uint64_t slot_count = 0;
};

/// For each link block of a subscription: the most slots of any publisher in it, 0 if there is
/// none.
using LinkBlocks = std::array<std::uint64_t, abi::link_block_max>;

/// Messages that a subscription may hold of each publisher.
struct HoldQuota {
  std::uint64_t own = 0;     // of publishers of its own user
  std::uint64_t others = 0;  // of publishers of other users
};

struct SubscriptionPlan {
  std::uint32_t index = 0;
  std::uint64_t generation = 0;
  std::uint64_t extent = 0;
  std::vector<SlotRaise> raises;  // to prepare and commit first
};

/// Limits on the use of the tables; at most the capacity of the tables.
struct Capacity {
  std::uint32_t clients = abi::client_count_max;
  std::uint32_t topics = abi::topic_count_max;
  std::uint32_t publishers_per_topic = abi::publisher_count_max;
  std::uint32_t subscriptions_per_topic = abi::subscription_count_max;
  std::uint32_t slots_per_publisher = abi::slot_count_max;
  std::uint32_t depth_max = abi::depth_max;
};

/// What a daemon that starts after a death found and did.
struct Recovered {
  std::uint32_t pid = 0;               // of the new daemon
  std::uint64_t dead_count = 0;        // processes that ended meanwhile
  std::uint64_t board_word_count = 0;  // board words that had to be repaired
};

/// A publisher and a subscription of its topic.
struct ReaderPair {
  EndpointRef publisher;
  EndpointRef reader;
};

class Registry {
 public:
  struct Memory {
    std::byte* log;     // journal::RedoLog::bytes
    std::byte* tables;  // tables_bytes, aligned to a page
    std::byte* board;   // abi::board_bytes
  };
  explicit Registry(const Memory& memory, const Capacity& capacity = {}) noexcept;
  const Capacity& capacity() const noexcept { return capacity_; }

  /// Initializes fresh, zeroed memory and writes the board's header.
  void create(std::uint64_t incarnation, const Format& format = {});
  /// Opens memory that an earlier daemon left: completes the pending change and rebuilds derived
  /// data. Errors: layout_mismatch (nothing was touched), store_damaged (the detail says how).
  [[nodiscard]] Result<void> open();
  /// Checks what open() checks before it changes anything; header() is valid afterwards.
  [[nodiscard]] Result<void> check() const;
  [[nodiscard]] static Result<void> check_log(const journal::RedoLog& log);
  /// Makes the board agree with the tables and makes all processes look at it again. Returns the
  /// number of words that differed.
  std::uint64_t repair_board();
  std::uint64_t incarnation() const noexcept { return log_.incarnation(); }
  const TableHeader& header() const noexcept { return tables_.header; }

  // --- processes
  /// Chooses a place for a new process. Errors: limit_reached, store_damaged.
  [[nodiscard]] Result<ClientPlan> plan_client() const;
  void add_client(const NewClient& client, const ClientPlan& plan);
  /// Plans and adds a process.
  [[nodiscard]] Result<ClientIndex> add_client(const NewClient& client);
  std::uint32_t client_high() const noexcept { return tables_.header.client_high; }
  const ClientRecord& client(ClientIndex index) const noexcept {
    return tables_.client[number(index)];
  }
  bool is_alive(ClientIndex index) const noexcept {
    return client(index).state == ClientState::alive;
  }
  const std::vector<EndpointRef>& endpoints_of(ClientIndex index) const {
    return views_[index].endpoints;
  }
  /// Returns the used length of the process's region: the end of its last extent.
  std::uint64_t used_bytes_of(ClientIndex index) const;
  /// Returns the offset in the process's region for an endpoint of `bytes`; nothing: no room.
  std::optional<std::uint64_t> lowest_extent(ClientIndex client, std::uint64_t bytes) const;
  /// What users have in use; maintained, because every creation asks for it.
  const Accounts& accounts() const noexcept { return accounts_; }
  void open_window(ClientIndex index, const WindowRecord& window);
  void open_wait_set(ClientIndex index, std::uint32_t wait_set);
  /// Sets who may read what the process publishes (access.hpp, readers_of), for its whole life.
  void set_readers(ClientIndex index, std::uint64_t readers);
  /// Marks a process as without a session. Its endpoints stay as they are until they are changed
  /// one by one. Called again for a revoked process when it has ended.
  void client_died(ClientIndex index, journal::DeathReason reason);
  /// Returns whether the process was revoked and has not ended.
  bool is_revoked(ClientIndex index) const noexcept {
    return client(index).state >= ClientState::dead &&
           client(index).reason == journal::DeathReason::revoked;
  }
  /// Removes a dead process from the announce sets of all endpoints of this topic: what it had
  /// mapped there is unmapped.
  void acknowledge_topic(ClientIndex gone, TopicIndex topic);
  /// Returns a topic with an endpoint announced to the process and not yet acknowledged by it.
  std::optional<TopicIndex> known_topic_of(ClientIndex index) const;
  /// Removes the process from the announce sets of all regions: it has then acknowledged
  /// everything that was ever announced to it. Only when known_topic_of() returns nothing.
  void client_forgotten(ClientIndex index);
  /// Returns whether free_client() may be called: the process is gone and forgotten, has no
  /// endpoints, and no peer knows it.
  bool can_free(ClientIndex index) const;
  void free_client(ClientIndex index);

  // --- the flight recorder
  /// Counters outlive the daemon. A record that counts something sets its counter; callers raise
  /// the others.
  abi::wire::DaemonCounters& counters() noexcept { return tables_.header.counters; }
  const abi::wire::DaemonCounters& counters() const noexcept { return tables_.header.counters; }
  /// Records that a daemon has taken over what another one left, once it serves.
  void note_recovered(const Recovered& facts);
  /// Records that a process that is alive here is connected again.
  void note_rejoined(ClientIndex index);
  /// Record that the publisher's process no longer serves this subscription, and why; and that it
  /// serves it again.
  void note_withdrawn(const ReaderPair& pair, abi::Withdrawal why);
  void note_served_again(const ReaderPair& pair);
  /// Records that no publisher can ring this subscription.
  void note_mute(const EndpointRef& subscription);
  /// Returns the change that open() had to complete; 0: none was pending.
  std::uint64_t redone_lsn() const noexcept { return redone_lsn_; }

  // --- topics
  std::optional<TopicIndex> find_topic(std::uint64_t domain, std::string_view name) const;
  [[nodiscard]] Result<TopicIndex> add_topic(const NewTopic& topic);
  std::uint32_t topic_high() const noexcept { return tables_.header.topic_high; }
  const TopicRecord& topic(TopicIndex index) const noexcept { return tables_.topic[number(index)]; }
  bool topic_is_empty(TopicIndex index) const;
  void free_topic(TopicIndex index);

  // --- endpoints
  const PublisherRecord& publisher(TopicIndex topic, std::uint32_t index) const noexcept {
    return tables_.publisher[number(topic)][index];
  }
  const SubscriptionRecord& subscription(TopicIndex topic, std::uint32_t index) const noexcept {
    return tables_.subscription[number(topic)][index];
  }
  /// Plan an endpoint. Errors: limit_reached (index or room in the client region), store_damaged.
  [[nodiscard]] Result<PublisherPlan> plan_publisher(ClientIndex client, TopicIndex topic,
                                                     const abi::Qos& qos) const;
  void add_publisher(ClientIndex client, TopicIndex topic, const abi::Qos& qos,
                     const PublisherPlan& plan, std::string_view node, std::uint64_t creation = 0);
  [[nodiscard]] Result<SubscriptionPlan> plan_subscription(ClientIndex client, TopicIndex topic,
                                                           const abi::Qos& qos,
                                                           const HoldQuota& quota) const;
  void raise_slots(TopicIndex topic, const SlotRaise& raise);
  void add_subscription(ClientIndex client, TopicIndex topic, const abi::Qos& qos,
                        const HoldQuota& quota, std::uint64_t wait_set,
                        const SubscriptionPlan& plan, std::string_view node,
                        std::uint64_t creation = 0);
  /// Returns what the topic's subscriptions use of the pool (hold_pool.hpp), seen by this user.
  HoldPool::Use pool_use(std::uint32_t uid, TopicIndex topic) const;
  HoldPool hold_pool() const noexcept {
    return {capacity_.slots_per_publisher, capacity_.depth_max, capacity_.subscriptions_per_topic};
  }
  std::uint64_t hold_quota(const SubscriptionRecord& subscription,
                           const PublisherRecord& publisher) const noexcept {
    return uid_of(subscription.client) == uid_of(publisher.client) ? subscription.quota
                                                                   : subscription.quota_of_others;
  }
  /// Returns the endpoint of the process that this request created, if it still exists.
  std::optional<EndpointRef> find_creation(ClientIndex client, Kind kind,
                                           std::uint64_t creation) const;
  void orphan_publisher(TopicIndex topic, std::uint32_t index, std::uint64_t final_head,
                        journal::LeaveCause cause = journal::LeaveCause::left);
  /// Returns the head up to which an orphan is still read.
  std::uint64_t final_head_of(TopicIndex topic, std::uint32_t index) const noexcept;
  /// Changes an orphan to over, or over to free.
  void end_publisher(TopicIndex topic, std::uint32_t index, EndpointState state);
  /// Changes the state to leaving, over or dead.
  void change_subscription(TopicIndex topic, std::uint32_t index, EndpointState state);
  void free_subscription(TopicIndex topic, std::uint32_t index);
  LinkBlocks slots_by_link_block(TopicIndex topic) const;

  /// Returns whether there is an endpoint at this place. Check before every read: reading a hole
  /// of the tables allocates memory, and clients name places at will.
  bool is_used(const EndpointRef& ref) const noexcept {
    if (number(ref.topic) >= topic_high() || topic(ref.topic).state != TopicState::used)
      return false;
    return is_set(places_of(ref.kind, ref.topic), ref.index);
  }

  // --- rule RU
  const AnnounceSet& notified_of(const EndpointRef& ref) const noexcept;
  ClientIndex owner_of(const EndpointRef& ref) const noexcept;
  std::uint64_t generation_of(const EndpointRef& ref) const noexcept;
  /// Records that `to` is about to be notified of the endpoint, and of its process's region.
  void notify(const EndpointRef& ref, ClientIndex to);
  void acknowledge_unmap(const EndpointRef& ref, ClientIndex by);
  void acknowledge_region_unmap(ClientIndex owner, ClientIndex by);

  /// Visits all endpoints of a topic that are not free: function(index, record).
  template <class Function>
  void for_each_publisher(TopicIndex topic, Function function) const {
    for_each_place(Kind::publisher, topic,
                   [&](std::uint32_t i) { function(i, publisher(topic, i)); });
  }
  template <class Function>
  void for_each_subscription(TopicIndex topic, Function function) const {
    for_each_place(Kind::subscription, topic,
                   [&](std::uint32_t i) { function(i, subscription(topic, i)); });
  }
  /// Returns the first place from `index` on with an endpoint, or nothing.
  std::optional<std::uint32_t> next_place(Kind kind, TopicIndex topic,
                                          std::uint32_t index) const noexcept;

  // --- who follows the endpoints
  /// Begins to note which endpoints change.
  void note_changed_endpoints() noexcept { notes_changes_ = true; }
  /// Returns the places of endpoints that may have come, changed state or gone since the last call.
  /// The death of their process counts.
  std::vector<EndpointRef> take_changed_endpoints() noexcept { return std::exchange(changed_, {}); }

  journal::RedoLog& log() noexcept { return log_; }
  const journal::RedoLog& log() const noexcept { return log_; }

 private:
  using M = SharedMemory;
  using Record = journal::Record;
  using Type = journal::RecordType;

  /// Derived: what a process has in its region, what it knows, and its own part of its user's
  /// usage: the process, its wait sets and windows.
  struct View {
    std::vector<EndpointRef> endpoints;
    std::map<std::uint64_t, std::uint64_t> extents;  // offset → bytes
    std::map<std::uint32_t, std::uint32_t>
        knows;  // topic → number of its announce sets with the process
    std::uint32_t uid = 0;
    Usage own;
  };
  void change(Type type, std::initializer_list<std::uint64_t> arguments);
  void apply(const Record& record);
  void apply_to_client(const Record& record);
  void apply_to_topic(const Record& record);
  void apply_to_publisher(const Record& record);
  void apply_to_subscription(const Record& record);
  void apply_to_announce_sets(const Record& record);
  void apply_to_counters(const Record& record);
  void rebuild();
  const char* flaw_of_change(const Record& record) const noexcept;
  const char* flaw_of_client(std::uint32_t index) const noexcept;
  const char* flaw_of_topic(std::uint32_t index) const noexcept;
  const char* flaw() const noexcept;
  std::uint64_t repair_publisher(TopicIndex topic, std::uint32_t index);
  std::uint64_t repair_subscription(TopicIndex topic, std::uint32_t index);
  void note_generation(std::uint64_t generation) noexcept;
  std::uint64_t next_generation() const noexcept { return tables_.header.last_generation + 1; }
  std::uint64_t slots_needed(TopicIndex topic, const PublisherRecord& publisher,
                             const SubscriptionRecord* joining) const;
  std::uint32_t uid_of(ClientIndex index) const noexcept { return client(index).uid; }
  /// Updates the user's account from the record of this process.
  void count_client(ClientIndex index);
  void count_endpoint(const EndpointRef& ref, bool is_there);
  void track(const EndpointRef& ref);
  void untrack(const EndpointRef& ref);
  /// Derived as well: which process knows something of which topic. `set` belongs to that topic.
  void add_to(AnnounceSet& set, TopicIndex topic, std::uint64_t client);
  void take_from(AnnounceSet& set, TopicIndex topic, std::uint64_t client);

  std::span<const std::uint64_t> places_of(Kind kind, TopicIndex topic) const noexcept {
    const TopicRecord& record = this->topic(topic);
    if (kind == Kind::publisher) return record.publishers;
    return record.subscriptions;
  }
  static bool is_set(std::span<const std::uint64_t> places, std::uint32_t index) noexcept {
    return index / 64 < places.size() && (places[index / 64] >> index % 64 & 1) != 0;
  }
  /// An endpoint may end while it is visited, and its topic with it.
  template <class Function>
  void for_each_place(Kind kind, TopicIndex topic, Function function) const {
    for (auto place = next_place(kind, topic, 0); place;
         place = next_place(kind, topic, *place + 1))
      function(*place);
  }
  void note_change(const EndpointRef& ref);
  void use_place(const EndpointRef& ref);
  /// Gives the memory of its record back when no other record shares the page.
  void vacate_place(const EndpointRef& ref);
  bool has_record_at(Kind kind, std::uint64_t number) const noexcept;
  region::TopicWords<M> words(TopicIndex topic) const noexcept {
    return {board_, abi::topic_offset(number(topic))};
  }
  journal::BoardSteps<M> board(TopicIndex topic) const noexcept {
    return journal::BoardSteps<M>(words(topic));
  }
  AnnounceSet& notified(const EndpointRef& ref) noexcept;

  Capacity capacity_;
  journal::RedoLog log_;
  Tables& tables_;
  std::byte* board_;
  std::uint64_t redone_lsn_ = 0;
  PerClient<View> views_;
  std::unordered_map<std::string, TopicIndex> topics_;
  Accounts accounts_;
  bool notes_changes_ = false;
  std::vector<EndpointRef> changed_;
};

/// Returns the board's state for an endpoint in this state.
abi::BoardState on_board(EndpointState state) noexcept;

/// Returns the key of a topic; it is unique for each (domain, name).
std::string topic_key(std::uint64_t domain, std::string_view name);

}  // namespace agnocast::daemon
