// SPDX-License-Identifier: Apache-2.0
//
// Registry: what exists and who knows of it. Pure state, no descriptor in it, no packet.
//
// Every change goes one way: a record is committed to the redo log, apply() carries it out on the
// tables and on the board, the log notes that it is applied. apply() is idempotent, so a daemon
// that died in between does it again when it starts. A creation has two halves: plan_*() says what
// it would be (index, generation, extent), the shell makes the memory ready, add_*() makes it so;
// between the two nothing else may change.
//
// The rules about *when* something may change lie in endings.cpp, leaving.cpp and reaper.cpp; here
// are the facts that they ask for. What is kept beside the tables (names to topics, endpoints and
// extents of a process) is derived from them and made anew by open().
//
// Callers pass indexes that they have checked: an index out of range is a mistake of ours.
#pragma once

#include <agnocast/abi/words.hpp>
#include <agnocast/result.hpp>
#include <daemon/state/hold_pool.hpp>
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
#include <vector>

namespace agnocast::daemon {

using Kind = abi::wire::Kind;

/// A place for an endpoint; with the record's generation it names one.
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

/// The place that a process would get.
struct ClientPlan {
  ClientIndex index{};
  std::uint64_t generation = 0;
};

/// What holds for a whole incarnation.
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
};

struct PublisherPlan {
  std::uint32_t index = 0;
  std::uint64_t generation = 0;
  std::uint64_t extent = 0;
  std::uint64_t slot_count = 0;
  std::uint64_t first_sequence = 0;
};

/// A publisher that must be able to keep more messages before a deeper subscription may join.
struct SlotRaise {
  std::uint32_t index = 0;
  std::uint64_t slot_count = 0;
};

/// What a subscription may hold of each publisher.
struct HoldQuota {
  std::uint64_t own = 0;     // of publishers of its user
  std::uint64_t others = 0;  // of those of other users
};

struct SubscriptionPlan {
  std::uint32_t index = 0;
  std::uint64_t generation = 0;
  std::uint64_t extent = 0;
  std::vector<SlotRaise> raises;  // to be made ready and done first
};

/// How much of the tables may be used; at most what they have room for.
struct Capacity {
  std::uint32_t clients = abi::client_count_max;
  std::uint32_t topics = abi::topic_count_max;
  std::uint32_t publishers_per_topic = abi::publisher_count_max;
  std::uint32_t subscriptions_per_topic = abi::subscription_count_max;
  std::uint32_t slots_per_publisher = abi::slot_count_max;
  std::uint32_t depth_max = abi::depth_max;
};

/// What one user has in use. Processes that are dead count as long as others have their memory.
struct Usage {
  std::uint64_t clients = 0;
  std::uint64_t publishers = 0;
  std::uint64_t subscriptions = 0;
  std::uint64_t executors = 0;
  std::uint64_t windows = 0;
  std::uint64_t heap_bytes = 0;
  std::uint64_t held_messages = 0;  // what its subscriptions may hold, together
  std::uint64_t topics = 0;         // in which it has endpoints

  Usage& operator+=(const Usage& more) noexcept;
  Usage& operator-=(const Usage& less) noexcept;
  friend bool operator==(const Usage&, const Usage&) = default;
};

/// Places of one topic that one user has; gone publishers that are not read to their end count too.
struct Places {
  std::uint64_t publishers = 0;
  std::uint64_t subscriptions = 0;
};

/// What a start after a death found and did.
struct Recovered {
  std::uint32_t pid = 0;               // of the new daemon
  std::uint64_t dead_count = 0;        // processes that ended meanwhile
  std::uint64_t board_word_count = 0;  // words of the board that had to be written again
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
  // Of addresses, for 13,000 endpoints; the memory is as long as what was given out of it.
  static constexpr std::uint64_t client_region_bytes = std::uint64_t{1} << 30;

  explicit Registry(const Memory& memory, const Capacity& capacity = {}) noexcept;
  const Capacity& capacity() const noexcept { return capacity_; }

  /// Fresh memory, all zero. Says on the board what it is.
  void create(std::uint64_t incarnation, const Format& format = {});
  /// Memory that an earlier life left: completes the change under way and derives the rest. Errors:
  /// layout_mismatch (nothing was touched), store_damaged (the detail says how).
  [[nodiscard]] Result<void> open();
  /// What open() looks at before it touches anything; header() means something afterwards.
  [[nodiscard]] Result<void> check() const;
  [[nodiscard]] static Result<void> check_log(const journal::RedoLog& log);
  /// Makes the board say what the tables say; how many words it had otherwise. Then everybody looks
  /// again.
  std::uint64_t repair_board();
  std::uint64_t incarnation() const noexcept { return log_.incarnation(); }
  const TableHeader& header() const noexcept { return tables_.header; }

  // --- processes
  /// Errors: limit_reached, store_damaged.
  [[nodiscard]] Result<ClientPlan> plan_client() const;
  void add_client(const NewClient& client, const ClientPlan& plan);
  /// Both at once.
  [[nodiscard]] Result<ClientIndex> add_client(const NewClient& client);
  std::uint32_t client_high() const noexcept { return tables_.header.client_high; }
  const ClientRecord& client(ClientIndex index) const noexcept {
    return tables_.client[number(index)];
  }
  bool is_alive(ClientIndex index) const noexcept {
    return client(index).state == ClientState::alive;
  }
  const std::vector<EndpointRef>& endpoints_of(ClientIndex index) const {
    return views_[number(index)].endpoints;
  }
  /// Of its region: up to the end of the last extent.
  std::uint64_t used_bytes_of(ClientIndex index) const;
  /// Of its region: where the next endpoint that needs so many bytes will lie. None: nowhere.
  std::optional<std::uint64_t> lowest_extent(ClientIndex client, std::uint64_t bytes) const;
  /// Asked before every creation, so it is kept and not counted.
  Usage usage_of(std::uint32_t uid) const;
  /// Has a process of this user an endpoint there?
  bool takes_part(std::uint32_t uid, TopicIndex topic) const;
  /// Users that have something, and the topics of one in which it has endpoints, each in turn: the
  /// first one behind what is given, the very first when nothing is.
  std::optional<std::uint32_t> next_user(std::optional<std::uint32_t> after) const;
  std::optional<TopicIndex> next_topic_of(std::uint32_t uid, std::optional<TopicIndex> after) const;
  std::size_t user_count() const noexcept { return accounts_.size(); }
  bool has_user(std::uint32_t uid) const { return accounts_.count(uid) != 0; }
  Places user_places(std::uint32_t uid, TopicIndex topic) const;
  /// Of the topic where the user has most of them, of each kind.
  Places most_places_of(std::uint32_t uid) const;
  void open_window(ClientIndex index, const WindowRecord& window);
  void open_executor(ClientIndex index, std::uint32_t executor);
  /// Who may read what the process publishes (access.hpp, readers_of): for its whole life.
  void set_readers(ClientIndex index, std::uint64_t readers);
  /// It is without a session. Its endpoints stay what they are until they are changed one by one.
  /// Said again of one that was revoked when its process is gone.
  void client_died(ClientIndex index, journal::DeathReason reason);
  /// Without a session, and its process has not ended.
  bool is_revoked(ClientIndex index) const noexcept {
    return client(index).state >= ClientState::dead &&
           client(index).reason == journal::DeathReason::revoked;
  }
  /// It is dead, and leaves the announce sets of all endpoints of this topic: what it had mapped
  /// there is unmapped.
  void acknowledge_topic(ClientIndex gone, TopicIndex topic);
  /// A topic with an endpoint that it was told of and has not let go of.
  std::optional<TopicIndex> known_topic_of(ClientIndex index) const;
  /// It leaves those of all regions, and has let go of everything that it was ever told about. Only
  /// when there is no such topic any more.
  void client_forgotten(ClientIndex index);
  /// Gone, forgotten, without endpoints, known to nobody: its place may be used again after
  /// free_client().
  bool can_free(ClientIndex index) const;
  void free_client(ClientIndex index);

  // --- the flight recorder
  /// Counters outlive the daemon. What a record counts is set by the record; the others are the
  /// caller's to raise.
  abi::wire::DaemonCounters& counters() noexcept { return tables_.header.counters; }
  const abi::wire::DaemonCounters& counters() const noexcept { return tables_.header.counters; }
  /// A daemon has taken over what another one left, once it serves.
  void note_recovered(const Recovered& facts);
  /// A process that is alive here is connected again.
  void note_rejoined(ClientIndex index);
  /// The publisher's process says that it serves this subscription no more, and why; and again.
  void note_withdrawn(const ReaderPair& pair, abi::Withdrawal why);
  void note_served_again(const ReaderPair& pair);
  /// Nobody can ring this subscription.
  void note_mute(const EndpointRef& subscription);
  /// What open() had to complete; 0: nothing was under way.
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
  /// Errors: limit_reached (indexes of the topic, room in the client region), store_damaged.
  [[nodiscard]] Result<PublisherPlan> plan_publisher(ClientIndex client, TopicIndex topic,
                                                     const abi::Qos& qos) const;
  void add_publisher(ClientIndex client, TopicIndex topic, const abi::Qos& qos,
                     const PublisherPlan& plan, std::string_view node, std::uint64_t creation = 0);
  [[nodiscard]] Result<SubscriptionPlan> plan_subscription(ClientIndex client, TopicIndex topic,
                                                           const abi::Qos& qos,
                                                           const HoldQuota& quota) const;
  void raise_slots(TopicIndex topic, const SlotRaise& raise);
  void add_subscription(ClientIndex client, TopicIndex topic, const abi::Qos& qos,
                        const HoldQuota& quota, std::uint64_t executor,
                        const SubscriptionPlan& plan, std::string_view node,
                        std::uint64_t creation = 0);
  /// What subscriptions of the topic have of the pool (hold_pool.hpp), seen by one of this user's.
  HoldPool::Use pool_use(std::uint32_t uid, TopicIndex topic) const;
  HoldPool hold_pool() const noexcept {
    return {capacity_.slots_per_publisher, capacity_.depth_max, capacity_.subscriptions_per_topic};
  }
  std::uint64_t hold_quota(const SubscriptionRecord& subscription,
                           const PublisherRecord& publisher) const noexcept {
    return uid_of(subscription.client) == uid_of(publisher.client) ? subscription.quota
                                                                   : subscription.quota_of_others;
  }
  /// The endpoint of the process that this request created, if it is still there.
  std::optional<EndpointRef> find_creation(ClientIndex client, Kind kind,
                                           std::uint64_t creation) const;
  void orphan_publisher(TopicIndex topic, std::uint32_t index, std::uint64_t final_head,
                        journal::LeaveCause cause = journal::LeaveCause::left);
  /// Of an orphan: the head up to which it is still read.
  std::uint64_t final_head_of(TopicIndex topic, std::uint32_t index) const noexcept;
  /// over, then free.
  void end_publisher(TopicIndex topic, std::uint32_t index, EndpointState state);
  /// leaving, over, dead.
  void change_subscription(TopicIndex topic, std::uint32_t index, EndpointState state);
  void free_subscription(TopicIndex topic, std::uint32_t index);
  /// Does some publisher of the topic use slots whose hold bits lie behind the link lines?
  bool uses_far_slots(TopicIndex topic) const;

  /// Is there an endpoint at this place? Where there is none nobody may look: reading a hole of the
  /// tables gives it memory, and clients name places at will.
  bool is_used(const EndpointRef& ref) const noexcept {
    if (number(ref.topic) >= topic_high() || topic(ref.topic).state != TopicState::used)
      return false;
    return is_set(places_of(ref.kind, ref.topic), ref.index);
  }

  // --- rule RU
  const AnnounceSet& notified_of(const EndpointRef& ref) const noexcept;
  ClientIndex owner_of(const EndpointRef& ref) const noexcept;
  std::uint64_t generation_of(const EndpointRef& ref) const noexcept;
  /// `to` is about to be told of the endpoint, and with it of the region of its process.
  void tell(const EndpointRef& ref, ClientIndex to);
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
  /// The first place from `index` on with an endpoint; nothing: there is none.
  std::optional<std::uint32_t> next_place(Kind kind, TopicIndex topic,
                                          std::uint32_t index) const noexcept;

  journal::RedoLog& log() noexcept { return log_; }
  const journal::RedoLog& log() const noexcept { return log_; }

 private:
  using M = SharedMemory;
  using Record = journal::Record;
  using Type = journal::RecordType;

  /// Derived: what a process has in its region, what it knows, and what of its user's usage is the
  /// process's own: itself, its executors and windows.
  struct View {
    std::vector<EndpointRef> endpoints;
    std::map<std::uint64_t, std::uint64_t> extents;  // offset → bytes
    std::map<std::uint32_t, std::uint32_t> knows;    // topic → announce sets there that it is in
    std::uint32_t uid = 0;
    Usage own;
  };
  /// Derived: of a user that has something.
  struct Account {
    Usage usage;
    std::map<std::uint32_t, Places> topics;  // by number
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
  /// Makes the account of its user say what the record of the process says now.
  void count_client(ClientIndex index);
  void count_endpoint(const EndpointRef& ref, bool is_there);
  void track(const EndpointRef& ref);
  void untrack(const EndpointRef& ref);
  /// Derived as well: who knows something of which topic. `set` is one of that topic's.
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
  void use_place(const EndpointRef& ref);
  /// Gives the memory of its record back when nothing else is there.
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
  std::vector<View> views_;
  std::unordered_map<std::string, TopicIndex> topics_;
  std::map<std::uint32_t, Account> accounts_;  // by uid
};

/// What the board says of an endpoint in this state.
abi::BoardState on_board(EndpointState state) noexcept;

/// Key of a topic: no two (domain, name) share one.
std::string topic_key(std::uint64_t domain, std::string_view name);

}  // namespace agnocast::daemon
