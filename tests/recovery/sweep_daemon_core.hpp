// SPDX-License-Identifier: Apache-2.0
//
// The daemon's core without its sockets: registry, endpoint manager and reaper on real tables,
// board and client regions, which outlive the process that changes them. The client channel pushes
// packets into sessions that no process reads.
#pragma once

#include <base/memory/memfd.hpp>
#include <daemon/death/reaper.hpp>
#include <daemon/lifecycle/endpoint_manager.hpp>
#include <daemon/state/steps.hpp>
#include <tests/support/crash/crash_point.hpp>

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cstdint>
#include <iterator>
#include <map>
#include <memory>
#include <set>
#include <sstream>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

namespace agnocast::sweep {

using namespace agnocast::daemon;

inline constexpr std::uint32_t core_client_count = 5;
inline constexpr std::uint64_t core_window_bytes = std::uint64_t{64} << 20;
constexpr std::uint64_t core_window_base(std::uint32_t client, std::uint64_t window) {
  return 0x200000000000 + (client * 2 + window) * core_window_bytes;
}

/// What the processes know of their endpoints, by the number of the request that created each. It
/// also outlives the daemon.
using References = std::map<std::uint64_t, wire::Reference>;

/// Memory of memfds that the kernel keeps for the next daemon.
class KeptMemory {
 public:
  KeptMemory()
      : board_(make_memfd("agnocast-board", abi::board_bytes).value()),
        journal_(make_memfd("agnocast-journal", journal::RedoLog::bytes + tables_bytes).value()),
        regions_(Regions::adopt(store_, duplicate(board_), duplicate(journal_)).value()) {
    for (std::uint32_t i = 0; i < core_client_count; ++i) {
      if (!regions_.open_client(ClientIndex{i}, i + 1)) throw std::runtime_error("a client region");
      for (std::uint64_t window = 0; window < 2; ++window) {
        if (!regions_.open_window(ClientIndex{i}, core_window_base(i, window), 1000))
          throw std::runtime_error("a window");
      }
    }
  }
  /// Fills this memory, which is fresh, with what a daemon left in another.
  void copy(const KeptMemory& from) {
    copy(from.board_.get(), board_.get());
    copy(from.journal_.get(), journal_.get());
    for (std::uint32_t i = 0; i < core_client_count; ++i)
      copy(from.regions_.region_writer(ClientIndex{i})->get(),
           regions_.region_writer(ClientIndex{i})->get());
  }
  Regions& regions() { return regions_; }
  DescriptorStore& store() { return store_; }

 private:
  static UniqueFd duplicate(const UniqueFd& fd) {
    return UniqueFd(::fcntl(fd.get(), F_DUPFD_CLOEXEC, 0));
  }
  static void copy(int from, int to) {
    struct stat file {};
    if (::fstat(from, &file) != 0 ||
        !lengthen(to, static_cast<std::uint64_t>(file.st_size)).has_value())
      throw std::runtime_error("the length of a memfd");
    std::byte page[abi::page_bytes];
    for (off_t at = 0; (at = ::lseek(from, at, SEEK_DATA)) >= 0; at += sizeof page) {
      if (::pread(from, page, sizeof page, at) != sizeof page ||
          ::pwrite(to, page, sizeof page, at) != sizeof page)
        throw std::runtime_error("a page of a memfd");
    }
  }

  DescriptorStore store_;  // keeps nothing: the test keeps the memory
  UniqueFd board_, journal_;
  Regions regions_;
};

/// One incarnation of the daemon.
class Core final : private ClientChannel {
 public:
  Core(KeptMemory& memory, const std::string& doorbells, References& references)
      : regions_(memory.regions()),
        registry_(regions_.memory()),
        doorbells_(doorbells, memory.store()),
        endpoint_manager_(registry_, regions_, doorbells_, *this),
        sessions_(core_client_count),
        references_(references) {
    endpoint_manager_.use_wide_topics({"/wide"});
  }

  Registry& registry() { return registry_; }

  // Operations. `again`: repeats the one during which the last daemon died.

  void hello(std::uint32_t client, bool again) {
    const ClientIndex index{client};
    if (!again || client >= registry_.client_high() || !registry_.is_alive(index)) {
      const auto made = registry_.add_client({1000, 1000, 4000 + client, 0, "node"});
      require(made && number(*made) == client, "a process got another place");
    }
    connect(client);
  }
  void open_window(std::uint32_t client, std::uint64_t window, bool again) {
    const ClientIndex index{client};
    if (again && registry_.client(index).window_count > window) return;
    registry_.open_window(index, {core_window_base(client, window), core_window_bytes, 0});
    endpoint_manager_.announce_window(index);
  }
  void open_wait_set(std::uint32_t client) {
    ring_at(client);
    registry_.open_wait_set(ClientIndex{client}, 0);
  }
  void create(std::uint32_t client, Kind kind, const char* topic, std::uint64_t request,
              std::uint32_t depth, bool again) {
    CreateRequest asked;
    asked.again = again;
    asked.kind = kind;
    asked.request = request;
    asked.qos = {depth, false, true, false, false, true, 7, 0, 9};
    if (kind == Kind::publisher) asked.qos.lifespan_ns = 8;
    asked.layout_hash = 7;
    asked.quota = kind == Kind::subscription ? 8 : 0;
    asked.topic = topic;
    asked.type = "tests/Type";
    asked.node = "/node";
    if (!again || !endpoint_manager_.answer_again(ClientIndex{client}, asked))
      require(static_cast<bool>(endpoint_manager_.create(ClientIndex{client}, asked)),
              "a creation");
    const auto ref = registry_.find_creation(ClientIndex{client}, kind, request);
    require(ref.has_value(), "an endpoint is not where its creation says");
    wire::Reference reference{};
    reference.kind = kind;
    reference.topic = number(ref->topic);
    reference.index = ref->index;
    reference.generation = registry_.generation_of(*ref);
    references_[request] = reference;
  }
  void leave(std::uint32_t client, std::uint64_t request, bool again) {
    LeaveRequest asked;
    asked.again = again;
    asked.reference = references_.at(request);
    require(static_cast<bool>(endpoint_manager_.leave(ClientIndex{client}, asked)), "leave");
  }
  void drained(std::uint32_t client, std::uint64_t request, bool again) {
    DrainedRequest asked;
    asked.again = again;
    asked.reference = references_.at(request);
    require(static_cast<bool>(endpoint_manager_.drained(ClientIndex{client}, asked)), "drained");
  }
  /// `by` acknowledges the unmap of what that request created.
  void unlinked(std::uint32_t by, std::uint64_t request) {
    const wire::Reference of = references_.at(request);
    wire::Unlinked statement{};
    statement.kind = of.kind;
    statement.topic = of.topic;
    statement.index = of.index;
    statement.generation = of.generation;
    statement.seen = sessions_[by]->packet_count();
    require(static_cast<bool>(endpoint_manager_.unlinked(ClientIndex{by}, statement)), "unlinked");
  }
  void unlinked_region(std::uint32_t by, std::uint32_t client) {
    wire::Unlinked statement{};
    statement.kind = Kind::region;
    statement.index = client;
    statement.generation = registry_.client(ClientIndex{client}).generation;
    statement.seen = sessions_[by]->packet_count();
    require(static_cast<bool>(endpoint_manager_.unlinked(ClientIndex{by}, statement)), "let go");
  }
  /// Leaves what a process leaves that dies in a publish, before or after its commit. Not an
  /// operation of the daemon: it has no crash points.
  void stop_in_publish(std::uint32_t client, std::uint64_t request, bool committed) {
    const wire::Reference& of = references_.at(request);
    const PublisherRecord& record =
        registry_.publisher(TopicIndex{of.topic}, static_cast<std::uint32_t>(of.index));
    const region::PublisherWords<SharedMemory> words{regions_.region(ClientIndex{client}),
                                                     record.extent};
    const std::uint64_t sequence = abi::sequence_of(words.head().load()) + 1;
    words.intent_sequence().store(sequence);
    words.intent_slot().store(0);
    words.intent_op().store(abi::intent_publish);
    words.slot_id(0).store(sequence);
    words.order(sequence).store(abi::pack_entry(sequence, 0));
    if (committed) words.head().store(abi::pack_entry(sequence, 0));
  }
  void reap(std::uint32_t client) {
    sessions_[client].reset();
    end_session(client, journal::DeathReason::died);
  }
  /// The process lives and keeps its place.
  void revoke(std::uint32_t client) {
    sessions_[client].reset();
    end_session(client, journal::DeathReason::revoked);
  }
  /// Ends a revoked process.
  void end(std::uint32_t client) {
    const ClientIndex index{client};
    if (registry_.is_revoked(index)) registry_.client_died(index, journal::DeathReason::died);
    endpoint_manager_.run(endpoint_manager_.endings().free_unused_client(index));
  }

  /// Resumes as a new daemon does: completes the change and the deaths under way and those that it
  /// finds, and frees what is over; every living process reconnects.
  void resume(const std::set<std::uint32_t>& ended) {
    require(registry_.open().has_value(), "these are not our tables");
    registry_.repair_board();
    for (std::uint32_t i = 0; i < registry_.client_high(); ++i) {
      if (ended.count(i) != 0 && registry_.is_revoked(ClientIndex{i})) end(i);
      if (is_dying(i) || ended.count(i) != 0) reap(i);
    }
    endpoint_manager_.carry_out_what_is_owed();
    for (std::uint32_t i = 0; i < registry_.client_high(); ++i) {
      if (!registry_.is_alive(ClientIndex{i})) continue;
      if (registry_.client(ClientIndex{i}).wait_sets != 0) ring_at(i);
      connect(i);
      endpoint_manager_.welcome_back(ClientIndex{i});
    }
  }

  /// Returns all relevant state as text: tables, board, and what the registry derives from them.
  /// Generations exact, or only by their order: a repeated operation takes new ones.
  enum class Generations { exact, order };
  std::string state(Generations generations) const;

 private:
  /// Returns what the dead process left in its queue; the region is read as its readers map it.
  std::string queue_of(const PublisherRecord& record) const {
    const SharedFd& reader = regions_.region_reader(record.client);
    if (!reader) return {};
    const Mapping region =
        Mapping::map(reader->get(), abi::client_region_bytes, Mapping::Access::read).value();
    const region::PublisherWords<SharedMemory> words{region.base(), record.extent};
    const std::uint64_t first = abi::first_sequence_of(record.generation);
    const auto is_there = [&](std::uint64_t sequence) { return sequence > first ? "+" : "-"; };
    return " ends " + std::to_string(abi::sequence_of(record.final_head) - first) + " intent " +
           std::to_string(words.intent_op().load()) + " slot " + is_there(words.slot_id(0).load()) +
           " order " + is_there(abi::sequence_of(words.order(first + 1).load()));
  }
  static void require(bool holds, const char* what) {
    if (!holds) throw std::runtime_error(what);
  }
  void end_session(std::uint32_t client, journal::DeathReason reason) {
    const ClientIndex index{client};
    if (!registry_.is_alive(index) && !is_dying(client)) return;
    Reaping reaping(index, is_dying(client) ? registry_.client(index).reason : reason, registry_,
                    regions_, doorbells_, endpoint_manager_);
    while (!reaping.go_on(UINT64_MAX)) {
    }
  }
  bool is_dying(std::uint32_t client) const {
    return registry_.client(ClientIndex{client}).state == ClientState::dead;
  }
  void connect(std::uint32_t client) {
    sessions_[client] = std::make_unique<Session>(PacketSocket(), PeerIdentity());
    sessions_[client]->greet(ClientIndex{client});
  }
  void ring_at(std::uint32_t client) {
    if (!doorbells_.is_open(ClientIndex{client}, 0))
      require(static_cast<bool>(doorbells_.open(ClientIndex{client}, 0, 0)), "doorbells");
  }

  Session* session_of(ClientIndex client) override { return sessions_[number(client)].get(); }
  std::uint64_t user_namespace_of(ClientIndex) override { return 1; }
  void begin_anew(ClientIndex, std::string_view) override {}  // the notes never fill up here
  void send(ClientIndex client, Outgoing packet) override {
    Session* const session = session_of(client);
    if (session == nullptr) return;
    crash_point(steps::B_send);
    session->push(std::move(packet));
    session->drop_output();
    crash_point(steps::B_sent);
  }

  Regions& regions_;
  Registry registry_;
  Doorbells doorbells_;
  EndpointManager endpoint_manager_;
  std::vector<std::unique_ptr<Session>> sessions_;
  References& references_;
};

inline std::string text_of(const abi::QosWords& qos) {
  std::string text;
  for (const std::uint64_t word : {qos.policies, qos.deadline_ns, qos.lifespan_ns, qos.lease_ns})
    text += (text.empty() ? "" : "/") + std::to_string(word);
  return text;
}

// Long because each table of the registry is printed here, one after the other.
inline std::string Core::state(Generations generations) const {
  const Registry& registry = registry_;
  std::set<std::uint64_t> all;
  for (std::uint32_t i = 0; i < registry.client_high(); ++i)
    all.insert(registry.client(ClientIndex{i}).generation);
  for (std::uint32_t t = 0; t < registry.topic_high(); ++t) {
    const TopicIndex at{t};
    if (registry.topic(at).state == TopicState::free) continue;
    all.insert(registry.topic(at).generation);
    registry.for_each_publisher(
        at, [&](std::uint32_t, const PublisherRecord& record) { all.insert(record.generation); });
    registry.for_each_subscription(at, [&](std::uint32_t, const SubscriptionRecord& record) {
      all.insert(record.generation);
    });
  }
  const auto shown = [&](std::uint64_t generation) -> std::uint64_t {
    if (generations == Generations::exact) return generation;
    const auto found = all.find(generation);
    return found == all.end() ? generation
                              : static_cast<std::uint64_t>(std::distance(all.begin(), found)) + 1;
  };
  std::ostringstream text;
  const auto set = [&](const AnnounceSet& notified) {
    for (std::uint32_t i = 0; i < core_client_count; ++i)
      text << (notified.contains(i) ? '1' : '0');
    text << " of " << shown(notified.generation());
  };
  const auto member = [&](std::uint64_t word) {
    text << ' ' << shown(abi::generation_of(word)) << '/' << static_cast<int>(abi::state_of(word));
  };
  for (std::uint32_t i = 0; i < registry.client_high(); ++i) {
    const ClientRecord& client = registry.client(ClientIndex{i});
    text << "process " << i << " state " << static_cast<int>(client.state);
    if (client.state != ClientState::free) {
      text << " generation " << shown(client.generation) << " uid " << client.uid << " gid "
           << client.gid << " pid " << client.pid << " executors " << client.wait_sets << " name "
           << client.name;
      if (client.state != ClientState::alive) text << " reason " << static_cast<int>(client.reason);
      text << " windows";
      for (std::uint64_t w = 0; w < client.window_count; ++w)
        text << ' ' << client.window[w].base << '+' << client.window[w].bytes;
      text << " known to ";
      set(client.notified);
      text << " has " << registry.endpoints_of(ClientIndex{i}).size();
    }
    text << '\n';
  }
  const Usage usage = registry.accounts().usage_of(1000);
  text << "user " << usage.clients << ' ' << usage.publishers << ' ' << usage.subscriptions << ' '
       << usage.wait_sets << ' ' << usage.heap_bytes << ' ' << usage.held_messages << '\n';
  for (std::uint32_t t = 0; t < registry.topic_high(); ++t) {
    const TopicIndex at{t};
    const TopicRecord& topic = registry.topic(at);
    const region::TopicWords<SharedMemory> words{regions_.memory().board, abi::topic_offset(t)};
    text << "topic " << t << " state " << static_cast<int>(topic.state);
    if (topic.state != TopicState::free)
      text << ' ' << topic.name << ' ' << topic.type << " generation " << shown(topic.generation)
           << " layout " << topic.layout_hash << " highs " << topic.publisher_high << ' '
           << topic.subscription_high << ' ' << words.publisher_high().load() << ' '
           << words.subscription_high().load();
    text << '\n';
    for (std::uint32_t i = 0; i < topic.publisher_high; ++i) {
      const PublisherRecord& record = registry.publisher(at, i);
      const auto word = [&](std::size_t field) { return words.publisher(i, field).load(); };
      using Entry = abi::PublisherEntry;
      text << "  publisher " << i << " state " << static_cast<int>(record.state) << " board "
           << static_cast<int>(abi::state_of(word(offsetof(Entry, word))));
      if (record.state != EndpointState::free) {
        text << " generation " << shown(record.generation) << " client " << number(record.client)
             << " qos " << text_of(record.qos) << " extent " << record.extent << " slots "
             << record.slot_count << " node " << record.node << " board";
        member(word(offsetof(Entry, word)));
        for (const std::size_t field :
             {offsetof(Entry, policies), offsetof(Entry, client), offsetof(Entry, extent),
              offsetof(Entry, slot_count), offsetof(Entry, deadline_ns), offsetof(Entry, lease_ns)})
          text << ' ' << word(field);
        text << " told ";
        set(record.notified);
        // Its repair has no record: the state is open until all records are there.
        if (generations == Generations::order && record.state == EndpointState::orphan)
          text << queue_of(record);
      }
      text << '\n';
    }
    for (std::uint32_t i = 0; i < topic.subscription_high; ++i) {
      const SubscriptionRecord& record = registry.subscription(at, i);
      const auto word = [&](std::size_t field) { return words.subscription(i, field).load(); };
      using Entry = abi::SubscriptionEntry;
      text << "  subscription " << i << " state " << static_cast<int>(record.state) << " board "
           << static_cast<int>(abi::state_of(word(offsetof(Entry, word))));
      if (record.state != EndpointState::free) {
        text << " generation " << shown(record.generation) << " client " << number(record.client)
             << " qos " << text_of(record.qos) << " extent " << record.extent << " quota "
             << record.quota << " wait set " << record.wait_set << " node " << record.node
             << " board";
        member(word(offsetof(Entry, word)));
        for (const std::size_t field :
             {offsetof(Entry, policies), offsetof(Entry, client), offsetof(Entry, extent),
              offsetof(Entry, quota), offsetof(Entry, wait_set), offsetof(Entry, deadline_ns),
              offsetof(Entry, lease_ns)})
          text << ' ' << word(field);
        text << " told ";
        set(record.notified);
      }
      text << '\n';
    }
  }
  return text.str();
}

}  // namespace agnocast::sweep
