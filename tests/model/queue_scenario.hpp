// SPDX-License-Identifier: Apache-2.0
//
// Queue scenario: one topic, one publisher with its control thread, two subscriptions, the daemon.
// Anything may die.
//
// What runs is the shipped code: PublisherCore, LinkCore, SleepCore, BoardSteps, recover_queue,
// store_frontier/load_frontier. Modelled around it are only scripts (who calls what next), messages
// between the daemon and clients as flags, and ghosts that remember what was promised. Checked at
// every step: no message is read or held after it was freed, none is freed twice, order per
// publisher, every loss happens with D newer messages committed, a late joiner starts where it may,
// the opened mapping covers what the message needs. Checked where nothing can move: nobody sleeps
// beside a message, nothing is leaked, nobody is stuck, recovery left a consistent queue.
#pragma once

#include <dataplane/frontier.hpp>
#include <dataplane/publisher_core.hpp>
#include <dataplane/subscription_core.hpp>
#include <journal/board_steps.hpp>
#include <journal/recovery.hpp>
#include <region/windows.hpp>
#include <tests/model/explorer.hpp>
#include <tests/model/steps.hpp>

#include <algorithm>
#include <cstdint>
#include <new>

namespace agnocast::model {

struct SubscriptionPlan {
  bool present = false;
  bool late = false;    // joins while the publisher runs; otherwise it was there before
  bool linked = false;  // and is linked and mapped when the publisher begins
  std::uint32_t depth = 1;
  bool transient_local = false;
  bool keep_all = false;
  std::uint32_t quota = 1;     // messages held at once
  bool sleep_holding = false;  // may go to sleep with messages held
  bool other_thread_releases = false;
  bool leaves = false;  // may leave after any take
  bool rejoins = false;
  // Another process with this depth takes its place after it was woken twice, or when there is
  // something to take; 0 = none. What its executor's number was rung for must not stick to it.
  std::uint32_t rejoin_depth = 0;
  bool hangs = false;            // links and then never takes, as if stopped
  std::uint32_t cannot_map = 0;  // window of the publisher, from 1; 0 = it can map all
  // The publisher withdraws it at any time, for good.
  bool withdrawn = false;
  // The publisher cannot map it before it is withdrawn and holds nothing: then it is disregarded, or, with
  // served_again, mapped and served.
  bool unmapped = false;
  bool served_again = false;
};

/// What a plan breaks on purpose, where no named step stands for it.
enum class QueueFault : std::uint8_t {
  none,
  one_number_for_two_sleepers,  // two processes; the number has the bell of the first
  looks_at_last_link,           // before it sleeps, the executor looks at its second link only
  links_without_waking,         // a link made while the executor sleeps does not wake it
};

struct QueuePlan {
  const char* name = "";
  std::uint32_t messages = 3;
  std::uint32_t depth = 1;
  bool transient_local = true;
  bool keep_all = false;
  std::uint64_t slots = 4;
  std::uint64_t slots_before =
      0;  // raised to `slots` by the first join; 0 = `slots` from the start
  std::uint64_t ring = 4;
  std::uint64_t lazy_limit = 0;
  std::uint32_t grow_before = 0;         // the heap grows before this message (1-based); 0 = never
  std::uint32_t second_window_from = 0;  // messages from this one on lie there; 0 = never
  bool second_has_members = false;  // they only point there: the objects lie in the first window
  bool second_is_fresh = false;  // it begins a group: the first one is not allocated from any more
  SubscriptionPlan sub[2];
  std::uint32_t publisher_deaths = 0;
  std::uint32_t subscriber_deaths = 0;
  std::uint32_t daemon_deaths = 0;
  bool store_buffers = true;
  bool may_run_out_of_slots = false;
  bool publisher_leaves = false;  // after its last message; its process stays
  // Both subscriptions belong to one process and one executor: one sleep word, one number, one
  // bell. sub0 is the executor's thread and takes for both; sub1 is the thread that joins and links
  // the second one. Nobody dies or leaves in such a plan.
  bool one_executor = false;
  QueueFault fault = QueueFault::none;
};

class QueueScenario {
 public:
  using MM = ModelMemory;
  enum ThreadId : std::uint8_t {
    publisher_main,
    publisher_control,
    sub0,
    sub1,
    releaser0,
    daemon_main
  };
  static constexpr std::uint8_t thread_count = 6;
  static constexpr std::size_t word_count = 64;
  enum RegionId : std::uint32_t { board, publisher_region, sub_region0, sub_region1 };

  // pc values: what a thread does next.
  enum Pc : std::uint64_t {
    idle = 0,
    publish,
    wait_for_room,
    timer,
    finished_publishing,
    leave_topic,
    await_window,  // publisher
    join,
    await_join,
    link_up,
    take,
    release_one,
    sleep,
    blocked,
    leave,
    await_leave,
    drain_holds,
    unlink_line,
    left,
    hung,
    take_other,
    served,  // subscription; the last two where one executor takes for both
    redo_check,
    apply,
    reply,  // daemon
    down
  };

  struct Held {
    std::uint64_t slot = 0;
    std::uint64_t sequence = 0;
  };
  struct PublisherPrivate {
    dataplane::PublisherCore<MM> core;
    std::uint64_t published = 0;
    explicit PublisherPrivate(const dataplane::PublisherCore<MM>::Identity& identity)
        : core(identity) {}
  };
  struct SubscriptionPrivate {
    dataplane::LinkCore<MM> link;
    dataplane::SleepCore<MM> sleep;
    std::uint64_t opened[2] = {};    // bytes of the publisher's windows that are accessible
    std::uint64_t windows_seen = 0;  // by the last take
    std::uint64_t last = 0;          // newest sequence delivered
    std::uint64_t wakes = 0;         // of a process that is to be replaced
    SubscriptionPrivate(const dataplane::LinkCore<MM>::Identity& identity, MM::Region region,
                        std::uint64_t armed)
        : link(identity), sleep(region, armed) {}
  };
  enum Request : std::uint64_t {
    none,
    joining,
    leaving,
    drained,
    unlinked,
    death_of_subscription,
    publisher_leaving,
    publisher_unlinked,
    window_wanted,
    death_of_publisher
  };
  struct Journal {
    std::uint64_t request = none;
    std::uint64_t index = 0;
    std::uint64_t generation = 0;
  };
  struct State {
    alignas(8) unsigned char publisher[sizeof(PublisherPrivate)] = {};
    alignas(8) unsigned char sub[2][sizeof(SubscriptionPrivate)] = {};
    // on their way
    std::uint64_t bell[2] = {};
    std::uint64_t request[2] = {};   // client → daemon
    std::uint64_t joined[2] = {};    // daemon → client, for join and leave
    std::uint64_t announce[2] = {};  // daemon → publisher: generation to map
    std::uint64_t forget[2] = {};    // daemon → publisher: generation to unmap
    std::uint64_t announced[2] =
        {};  // rule RU: generation the publisher was told about and has not unlinked
    std::uint64_t kick = 0;
    Journal journal;
    std::uint64_t generation[2] = {};  // of the subscription index, daemon's table
    // processes
    std::uint64_t publisher_dead = 0;  // 1 dead, 2 known to the daemon, 3 recovered
    std::uint64_t sub_dead[2] = {};
    std::uint64_t publisher_deaths = 0, subscriber_deaths = 0, daemon_deaths = 0;
    std::uint64_t publisher_request = 0;
    std::uint64_t publisher_state =
        0;  // daemon's table: 0 active, 1 orphan by its own wish, 2 free again
    std::uint64_t linked_to[2] =
        {};  // rule RU: the publisher was announced to this subscription, which has not unlinked
    std::uint64_t second_window = 0;  // of the publisher: 1 asked for, 2 there
    // The announcement of it: 1 in the subscriber's socket, 2 read.
    std::uint64_t window_announced[2] = {};
    std::uint64_t timer_runs = 0;
    std::uint64_t room_snapshot = 0;
    // ghosts
    std::uint64_t freed = 0;          // bit per message number
    std::uint64_t join_head[2] = {};  // newest sequence when the subscription asked to join
    std::uint64_t held_count[2] = {};
    Held held[2][3] = {};
    std::uint64_t cursor_before[2] = {};
    std::uint64_t need_open[16] = {};  // per message: frontier it was built under
    std::uint64_t rung[2] = {};        // sleep that was rung last
    std::uint64_t withdrawal[2] = {};  // 1 to come, 2 said, 3 over: disregarded or served again
  };

  using W = World<QueueScenario>;

  explicit QueueScenario(const QueuePlan& plan) : plan_(plan) {}

  static constexpr std::uint64_t first = 16;      // first_sequence of the publisher
  static constexpr std::uint64_t generation = 7;  // of the publisher
  static constexpr std::uint64_t pe = 4096, se = 4096, second_se = se + 1024;
  static constexpr std::uint64_t heap = 0x10000, second_heap = 0x20000, page = 0x100;

  W start() {
    machine.ring = plan_.ring;
    machine.store_buffers = plan_.store_buffers;
    build_map();
    W world;
    poke(world, board, offsetof(abi::TopicHeader, epoch), 1);
    poke(world, board, offsetof(abi::TopicHeader, publisher_high), 1);
    poke_publisher(world, offsetof(abi::PublisherEntry, word),
                   abi::pack_member(generation, abi::MemberState::active));
    const std::uint64_t slots = plan_.slots_before != 0 ? plan_.slots_before : plan_.slots;
    poke_publisher(world, offsetof(abi::PublisherEntry, slot_count), slots);
    poke(world, publisher_region, pe, abi::pack_entry(first, 0));
    poke(world, publisher_region, frontier_offset(0), page);
    new (world.state.publisher) PublisherPrivate(
        {topic(), words(), 0, generation, first, offered(), slots, plan_.lazy_limit});
    world.threads[publisher_main].pc = publish;
    world.threads[daemon_main].pc = idle;
    for (std::uint32_t s = 0; s < 2; ++s) {
      new (world.state.sub[s])
          SubscriptionPrivate(link_identity(s, 1), {sub_region0 + s}, armed_offset());
      const SubscriptionPlan& sub = plan_.sub[s];
      if (!sub.present) {
        world.threads[sub0 + s].pc = left;
      } else if (sub.late) {
        world.threads[sub0 + s].pc = join;
      } else {
        // Subscribed before the publisher came: on the board, and announced to it; it links at any
        // time.
        world.state.generation[s] = 1;
        world.state.withdrawal[s] = sub.withdrawn;
        poke(world, board, offsetof(abi::TopicHeader, subscription_high), s + 1);
        poke_sub(world, s, offsetof(abi::SubscriptionEntry, word),
                 abi::pack_member(1, abi::MemberState::active));
        poke_sub(world, s, offsetof(abi::SubscriptionEntry, qos), abi::pack_qos(requested(s, 1)));
        poke_sub(world, s, offsetof(abi::SubscriptionEntry, quota), sub.quota);
        world.state.announced[s] = 1;
        world.state.linked_to[s] = 1;
        if (sub.linked) {
          start_linked(world, s);
        } else {
          world.state.announce[s] = 1;
          world.threads[sub0 + s].pc = link_up;
        }
      }
    }
    return world;
  }

  // --- what may move
  // -------------------------------------------------------------------------------------------------------------

  bool runnable(const W& world, std::uint8_t t) const {
    const State& state = world.state;
    const std::uint64_t pc = world.threads[t].pc;
    switch (t) {
      case publisher_main:
        if (state.publisher_dead != 0 || busy(world, publisher_control)) return false;
        return pc == publish || pc == timer || pc == leave_topic ||
               (pc == await_window && state.second_window == 2) ||
               (pc == wait_for_room && state.room_snapshot != room_digest(world));
      case publisher_control:
        if (state.publisher_dead != 0 || busy(world, publisher_main)) return false;
        return state.kick != 0 || has_announcement(state, 0) || has_announcement(state, 1) ||
               state.forget[0] != 0 || state.forget[1] != 0 || withdrawal_is_due(world, 0) ||
               withdrawal_is_due(world, 1);
      case sub0:
      case sub1: {
        const std::uint32_t s = t - sub0;
        if (state.sub_dead[s] != 0) return false;
        if (pc == left || pc == hung || pc == served) return false;
        if (pc == await_join) return state.joined[s] == 1 || state.joined[s] == 3;
        if (pc == await_leave) return state.joined[s] == 2;
        if (pc == blocked) return state.bell[s] != 0;
        if (pc == join && state.announced[s] != 0) return false;
        if (plan_.sub[s].other_thread_releases) {
          if (pc == release_one)
            return state.held_count[s] < plan_.sub[s].quota;  // waits for the other thread
          if (pc == drain_holds) return state.held_count[s] == 0;
        }
        return true;
      }
      case releaser0:
        return plan_.sub[0].other_thread_releases && state.sub_dead[0] == 0 &&
               state.held_count[0] > 0;
      case daemon_main:
        if (pc == down) return true;
        if (pc != idle) return true;
        return has_request(world);
      default:
        return false;
    }
  }

  template <class Emit>
  void moves(const W& world, Emit emit) const {
    const State& state = world.state;
    if (state.publisher_dead == 0 && state.publisher_deaths < plan_.publisher_deaths) {
      emit_prefixes(world, publisher_main, emit);
      if (busy(world, publisher_control)) emit_prefixes(world, publisher_control, emit);
    }
    for (std::uint8_t s = 0; s < 2; ++s) {
      if (plan_.sub[s].present && state.sub_dead[s] == 0 &&
          state.subscriber_deaths < plan_.subscriber_deaths) {
        emit_prefixes(world, static_cast<std::uint8_t>(sub0 + s), emit);
      }
    }
    if (state.daemon_deaths < plan_.daemon_deaths && world.threads[daemon_main].pc != down)
      emit_prefixes(world, daemon_main, emit);
    for (std::uint8_t s = 0; s < 2; ++s) {
      if (state.window_announced[s] == 1 && state.sub_dead[s] == 0 &&
          !busy(world, static_cast<std::uint8_t>(sub0 + s)))
        emit(static_cast<std::uint8_t>(sub0 + s), 2000);
    }
    if (state.publisher_dead == 0 && state.timer_runs < 2 &&
        publisher_private(world).core.has_reclaimable() && quiescent(world)) {
      emit(publisher_main, 1000);
    }
  }

  /// Deaths; the publisher's timer where nothing else moves; and a subscriber's control thread that
  /// reads the announcement of a window. True if the move is not a death: then the state was no
  /// ending.
  bool perform(W& world, std::uint8_t t, std::uint16_t argument) {
    State& state = world.state;
    if (argument == 1000) {
      ++state.timer_runs;
      world.threads[publisher_main].pc = timer;
      return true;
    }
    if (argument == 2000) {
      state.window_announced[t - sub0] = 2;
      state.bell[t - sub0] = 1;
      state.timer_runs = 0;  // what it takes now is to be freed by a later one
      return true;
    }
    Thread& thread = world.threads[t];
    // What a SIGKILL leaves of the victim's stores is a prefix; the rest was never executed.
    Machine::clear_buffer(thread, argument);
    auto stop = [&](std::uint8_t which) {
      world.threads[which].log_count = 0;
      std::memset(world.threads[which].log, 0, sizeof thread.log);
      world.threads[which].pc = down;
    };
    stop(t);
    switch (t) {
      case publisher_main:
      case publisher_control:
        stop(publisher_main);
        stop(publisher_control);
        state.publisher_dead = 1;
        ++state.publisher_deaths;
        break;
      case sub0:
      case sub1:
        state.sub_dead[t - sub0] = 1;
        if (t == sub0) stop(releaser0);
        ++state.subscriber_deaths;
        state.held_count[t - sub0] = 0;
        std::memset(static_cast<void*>(state.held[t - sub0]), 0, sizeof state.held[0]);
        break;
      default:
        ++state.daemon_deaths;
        break;
    }
    return false;
  }

  /// Loads that nobody else alive can influence are no scheduling points.
  void quiet(const W& world, std::uint8_t t, std::uint8_t* quiet_words) const {
    const State& state = world.state;
    for (std::size_t w = 0; w < word_count; ++w) {
      std::uint8_t is_quiet = 0;
      if (w < address_map.count) {
        switch (address_map.region_of[w]) {
          case board:
            is_quiet = t == daemon_main;
            break;
          case publisher_region:
            if (!plan_.sub[0].withdrawn && !plan_.sub[1].withdrawn &&
                w == address_map.find(publisher_region,
                                      pe + offsetof(abi::PublisherEndpoint, withdrawn))) {
              is_quiet = 1;
              break;
            }
            is_quiet =
                t == publisher_main || t == publisher_control ||
                (state.publisher_dead != 0 && world.threads[publisher_main].buffer_count == 0 &&
                 world.threads[publisher_control].buffer_count == 0 &&
                 (t == daemon_main || state.publisher_dead == 3));
            break;
          case sub_region0:
            is_quiet = t == sub0;
            break;
          case sub_region1:
            is_quiet = t == sub1;
            break;
          default:
            break;
        }
      }
      quiet_words[w] = is_quiet;
    }
  }

  // --- what they do
  // --------------------------------------------------------------------------------------------------------------

  void run(W& world, std::uint8_t t) {
    switch (t) {
      case publisher_main:
      case publisher_control:
        run_publisher(world, t);
        break;
      case sub0:
      case sub1:
        if (plan_.one_executor && t == sub0 && is_executing(world.threads[t].pc)) {
          run_executor(world);
        } else {
          run_subscription(world, t - sub0);
        }
        break;
      case releaser0:
        run_releaser(world, 0);
        break;
      default:
        run_daemon(world);
        break;
    }
  }

  const char* finished(const W& world) {
    const State& state = world.state;
    const std::uint64_t head = abi::sequence_of(peek(world, publisher_region, pe));
    const bool alive = state.publisher_dead == 0;
    if (world.threads[daemon_main].pc == down) return "the daemon stays down";
    if (!alive && state.publisher_dead != 3) return "a dead publisher was not recovered";
    for (std::uint32_t s = 0; s < 2; ++s) {
      if (!plan_.sub[s].present || state.sub_dead[s] != 0) continue;
      const std::uint64_t pc = world.threads[sub0 + s].pc;
      if (pc == left && plan_.sub[s].present) {
        for (std::uint64_t field = 0; field < 3; ++field) {
          if (peek_line(world, s, field) != 0) return "a link that is gone left its line set";
        }
      }
      if (pc == left || pc == hung) continue;
      if (pc != blocked && pc != served) return "a subscription is stuck";
      const SubscriptionPrivate& own = sub_private(world, s);
      if (!alive || plan_.publisher_leaves)
        return "a subscription of a publisher that is gone did not finish";
      if (own.link.cursor() <= head && !is_withdrawn(state, s))
        return "a subscription sleeps beside a message";
    }
    if (alive) {
      const PublisherPrivate& own = publisher_private(world);
      if (world.threads[publisher_main].pc == wait_for_room && !plan_.may_run_out_of_slots)
        return "the publisher is stuck";
      if (peek(world, publisher_region, pe + offsetof(abi::PublisherEndpoint, intent_op)) !=
          abi::intent_idle) {
        return "the intent stays open after the operation";
      }
      std::uint64_t justified = 0;
      for (std::uint64_t q = first + 1; q <= own.core.head_sequence(); ++q) {
        bool keep = plan_.transient_local && !plan_.publisher_leaves &&
                    q + plan_.depth > own.core.head_sequence();
        for (std::uint32_t s = 0; s < 2; ++s) {
          if (plan_.sub[s].hangs && state.sub_dead[s] == 0 && !is_withdrawn(state, s))
            keep = keep || q + plan_.sub[s].depth > own.core.head_sequence();
          for (std::uint64_t i = 0; i < state.held_count[s]; ++i)
            keep = keep || state.held[s][i].sequence == q;
        }
        justified += keep;
        if (keep && (state.freed >> (q - first) & 1) != 0)
          return "history or a held message is gone";
      }
      std::uint64_t live = 0;
      for (std::uint64_t i = 0; i < plan_.slots; ++i)
        live += peek(world, publisher_region, pe + abi::slot_offset(plan_.ring, i)) != 0;
      if (live != own.core.allocated_count())
        return "slots in memory and the publisher's own account differ";
      if (own.core.allocated_count() != justified)
        return "leak: a message nobody can ask for stays allocated";
    } else {
      if (peek(world, publisher_region, pe + offsetof(abi::PublisherEndpoint, intent_op)) !=
          abi::intent_idle) {
        return "recovery left the intent open";
      }
      for (std::uint64_t i = 0; i < plan_.slots; ++i) {
        const std::uint64_t id =
            peek(world, publisher_region, pe + abi::slot_offset(plan_.ring, i));
        if ((id & ~abi::retired_mark) > head)
          return "recovery left a slot of a message that was never committed";
      }
      for (std::uint64_t i = 0; i < plan_.ring; ++i) {
        if (abi::sequence_of(peek(world, publisher_region, pe + abi::order_offset(i))) > head) {
          return "recovery left a ring entry of a message that was never committed";
        }
      }
    }
    return nullptr;
  }

  static const char* thread_name(std::uint8_t t) {
    static const char* names[] = {"publisher", "control", "sub0", "sub1", "releaser", "daemon"};
    return names[t];
  }
  static const char* describe(std::uint8_t, std::uint16_t argument) {
    if (argument == 2000) return "reads of a window";
    return argument == 1000 ? "timer" : "dies";
  }
  static const char* operation_name(const W& world, std::uint8_t t) {
    static const char* names[] = {
        "idle",         "publish", "wait for room", "timer",       "finished",    "leave topic",
        "await window", "join",    "await join",    "link",        "take",        "release",
        "sleep",        "wake",    "leave",         "await leave", "drain holds", "unlink",
        "left",         "hung",    "take other",    "served",      "restart",     "apply",
        "reply",        "down"};
    return t == publisher_control ? "control pass" : names[world.threads[t].pc];
  }

 private:
  // --- addresses
  // -----------------------------------------------------------------------------------------------------------------

  static constexpr std::uint64_t armed_offset() {
    return offsetof(abi::ClientRegionHeader, executor);
  }
  static constexpr std::uint64_t frontier_offset(std::uint64_t window) {
    return offsetof(abi::ClientRegionHeader, window) + window * sizeof(abi::WindowEntry) +
           offsetof(abi::WindowEntry, frontier);
  }
  std::uint64_t address_of(std::uint64_t number) const {
    return (needs_second(number) && !plan_.second_has_members ? second_heap : heap) + number * 16;
  }
  bool needs_second(std::uint64_t number) const {
    return plan_.second_window_from != 0 && number >= plan_.second_window_from;
  }
  /// May the subscription lose this message because of where it lies? It may point anywhere in the
  /// windows of its group.
  bool may_be_unreachable(const W& world, std::uint32_t s, std::uint64_t number) const {
    const std::uint32_t closed = plan_.sub[s].cannot_map;
    if (closed == 0) return false;
    if (plan_.second_is_fresh) return closed == (needs_second(number) ? 2u : 1u);
    return closed == 1 || machine.remember(world.state.second_window) == 2;
  }

  void build_map() const {
    address_map = {};
    char name[64];
    address_map.add(board, offsetof(abi::TopicHeader, epoch), "epoch");
    address_map.add(board, offsetof(abi::TopicHeader, publisher_high), "publisher_high");
    address_map.add(board, offsetof(abi::TopicHeader, subscription_high), "subscription_high");
    address_map.add(publisher_region, pe + offsetof(abi::PublisherEndpoint, withdrawn),
                    "withdrawn");
    const std::uint64_t p = abi::publisher_entry_offset(0);
    address_map.add(board, p + offsetof(abi::PublisherEntry, word), "pub.word");
    address_map.add(board, p + offsetof(abi::PublisherEntry, slot_count), "pub.slot_count");
    address_map.add(board, p + offsetof(abi::PublisherEntry, final_head), "pub.final_head");
    for (std::uint64_t s = 0; s < 2; ++s) {
      const std::uint64_t at = abi::subscription_entry_offset(1, s);
      const char* fields[] = {"word", "qos", "client", "extent", "quota", "executor"};
      for (std::uint64_t f = 0; f < 6; ++f) {
        std::snprintf(name, sizeof name, "sub%llu.%s", static_cast<unsigned long long>(s),
                      fields[f]);
        address_map.add(board, at + f * 8, name);
      }
    }
    address_map.add(publisher_region, frontier_offset(0), "frontier");
    address_map.add(publisher_region, frontier_offset(1), "frontier of the second window");
    address_map.add(publisher_region, pe, "head");
    const char* intent[] = {"intent.op", "intent.sequence", "intent.slot", "intent.address"};
    for (std::uint64_t f = 0; f < 4; ++f) {
      address_map.add(publisher_region, pe + offsetof(abi::PublisherEndpoint, intent_op) + f * 8,
                      intent[f]);
    }
    for (std::uint64_t i = 0; i < plan_.ring; ++i) {
      std::snprintf(name, sizeof name, "order[%llu]", static_cast<unsigned long long>(i));
      address_map.add(publisher_region, pe + abi::order_offset(i), name);
    }
    const char* slot[] = {"id", "address", "stamp", "size"};
    for (std::uint64_t i = 0; i < plan_.slots; ++i) {
      for (std::uint64_t f = 0; f < 4; ++f) {
        std::snprintf(name, sizeof name, "slot[%llu].%s", static_cast<unsigned long long>(i),
                      slot[f]);
        address_map.add(publisher_region, pe + abi::slot_offset(plan_.ring, i) + f * 8, name);
      }
    }
    for (std::uint32_t s = 0; s < 2; ++s) {
      const char* line[] = {"publisher_generation", "cursor", "hold"};
      for (std::uint64_t f = 0; f < 3; ++f) {
        std::snprintf(name, sizeof name, "s%u.%s", s, line[f]);
        address_map.add(static_cast<std::uint32_t>(client_region(s).id), extent(s) + f * 8, name);
      }
      if (plan_.one_executor && s == 1) continue;
      std::snprintf(name, sizeof name, "s%u.armed", s);
      address_map.add(sub_region0 + s, armed_offset(), name);
    }
    if (address_map.count > word_count) Machine::give_up("word_count is too small");
  }

  static std::uint64_t peek(const W& world, std::uint32_t region, std::uint64_t offset) {
    return world.memory[address_map.find(region, offset)];
  }
  static void poke(W& world, std::uint32_t region, std::uint64_t offset, std::uint64_t value) {
    world.memory[address_map.find(region, offset)] = value;
  }
  static void poke_publisher(W& world, std::uint64_t field, std::uint64_t value) {
    poke(world, board, abi::publisher_entry_offset(0) + field, value);
  }
  static void poke_sub(W& world, std::uint64_t s, std::uint64_t field, std::uint64_t value) {
    poke(world, board, abi::subscription_entry_offset(1, s) + field, value);
  }

  MM::Region client_region(std::uint32_t s) const {
    return {plan_.one_executor ? sub_region0 : sub_region0 + s};
  }
  std::uint64_t extent(std::uint32_t s) const {
    return plan_.one_executor && s == 1 ? second_se : se;
  }
  /// As the publisher numbers it.
  std::uint64_t executor(std::uint32_t s) const {
    const bool one = plan_.one_executor || plan_.fault == QueueFault::one_number_for_two_sleepers;
    return one ? 0 : s;
  }
  /// Generation, cursor, hold.
  std::uint64_t peek_line(const W& world, std::uint32_t s, std::uint64_t field) const {
    return peek(world, static_cast<std::uint32_t>(client_region(s).id), extent(s) + field * 8);
  }

  static region::TopicWords<MM> topic() { return {{board}, 0}; }
  static region::PublisherWords<MM> words() { return {{publisher_region}, pe}; }
  abi::Qos offered() const {
    return {plan_.depth, plan_.transient_local, true, plan_.keep_all, false};
  }
  /// `subscription_generation`: 1, or 2 for who joined again.
  abi::Qos requested(std::uint32_t s, std::uint64_t subscription_generation) const {
    const SubscriptionPlan& plan = plan_.sub[s];
    const bool again = subscription_generation > 1 && plan.rejoin_depth != 0;
    return {again ? plan.rejoin_depth : plan.depth, plan.transient_local, true, plan.keep_all,
            false};
  }
  dataplane::LinkCore<MM>::Identity link_identity(std::uint32_t s,
                                                  std::uint64_t subscription_generation) const {
    return {topic(), words(),   {client_region(s), extent(s), 0},      0,  generation,
            first,   offered(), requested(s, subscription_generation), 16, 16,
            s};
  }
  bool matches(std::uint32_t s) const { return abi::qos_match(offered(), requested(s, 1)); }

  static PublisherPrivate& publisher_private(W& world) {
    return *std::launder(reinterpret_cast<PublisherPrivate*>(world.state.publisher));
  }
  static const PublisherPrivate& publisher_private(const W& world) {
    return *std::launder(reinterpret_cast<const PublisherPrivate*>(world.state.publisher));
  }
  static SubscriptionPrivate& sub_private(W& world, std::uint32_t s) {
    return *std::launder(reinterpret_cast<SubscriptionPrivate*>(world.state.sub[s]));
  }
  static const SubscriptionPrivate& sub_private(const W& world, std::uint32_t s) {
    return *std::launder(reinterpret_cast<const SubscriptionPrivate*>(world.state.sub[s]));
  }

  // --- helpers
  // -------------------------------------------------------------------------------------------------------------------

  /// The publisher's mutex is held by a thread in the middle of an operation; it is handed over
  /// with its stores.
  static bool busy(const W& world, std::uint8_t t) {
    return world.threads[t].log_count != 0 || world.threads[t].buffer_count != 0;
  }

  static bool is_withdrawn(const State& state, std::uint32_t s) {
    return state.withdrawal[s] == 2 || state.withdrawal[s] == 3;
  }
  /// The publisher's control thread has something to do about it. What it may do without knowing what is
  /// held, it does when nothing is.
  bool withdrawal_is_due(const W& world, std::uint32_t s) const {
    const State& state = world.state;
    if (state.sub_dead[s] != 0) return false;
    if (state.withdrawal[s] == 1)
      return abi::state_of(peek(
                 world, board,
                 abi::subscription_entry_offset(1, s) + offsetof(abi::SubscriptionEntry, word))) ==
             abi::MemberState::active;
    const std::uint8_t t = static_cast<std::uint8_t>(sub0 + s);
    return state.withdrawal[s] == 2 && plan_.sub[s].unmapped && state.announce[s] != 0 &&
           state.held_count[s] == 0 && world.threads[t].pc == blocked && !busy(world, t);
  }
  bool has_announcement(const State& state, std::uint32_t s) const {
    return state.announce[s] != 0 && !plan_.sub[s].unmapped;
  }

  template <class Emit>
  static void emit_prefixes(const W& world, std::uint8_t t, Emit emit) {
    for (std::uint16_t keep = 0; keep <= world.threads[t].buffer_count; ++keep) emit(t, keep);
  }

  bool quiescent(const W& world) const {
    for (std::uint8_t t = 0; t < thread_count; ++t) {
      if (busy(world, t) || runnable(world, t)) return false;
    }
    return true;
  }

  std::uint64_t room_digest(const W& world) const {
    Hasher hasher;
    for (std::uint32_t s = 0; s < 2; ++s) {
      for (std::uint64_t f = 0; f < 3; ++f) hasher.add(peek_line(world, s, f));
    }
    hasher.add(peek(world, board, offsetof(abi::TopicHeader, epoch)));
    hasher.add(world.state.publisher,
               sizeof world.state.publisher);  // the control thread may have learned something
    return hasher.value();
  }

  static bool dead_and_drained(const W& world, std::uint8_t t) {
    return world.threads[t].buffer_count == 0;
  }

  bool has_request(const W& world) const {
    for (std::uint64_t n = 0; n < 5; ++n) {
      if (request_number(world, n).request != none) return true;
    }
    return false;
  }
  /// The n-th request that waits at the daemon's door.
  Journal request_number(const W& world, std::uint64_t n) const {
    const State& state = world.state;
    for (std::uint64_t s = 0; s < 2; ++s) {
      if (state.request[s] != none && state.sub_dead[s] == 0 && n-- == 0) {
        const std::uint64_t g = state.generation[s] + (state.request[s] == joining ? 1 : 0);
        return {state.request[s], s, g};
      }
    }
    if (state.publisher_request != none && state.publisher_dead == 0 && n-- == 0)
      return {state.publisher_request, 0, generation};
    for (std::uint64_t s = 0; s < 2; ++s) {
      // A pidfd becomes readable once no store of the process can follow.
      if (state.sub_dead[s] == 1 && dead_and_drained(world, static_cast<std::uint8_t>(sub0 + s)) &&
          dead_and_drained(world, releaser0) && n-- == 0) {
        return {death_of_subscription, s, state.generation[s]};
      }
    }
    if (state.publisher_dead == 1 && dead_and_drained(world, publisher_main) &&
        dead_and_drained(world, publisher_control) && n-- == 0) {
      return {death_of_publisher, 0, generation};
    }
    return {};
  }

  struct PublisherEnvironment {
    W& world;
    void ring(std::uint64_t executor, std::uint64_t armed) {
      if (!machine.live) return;
      world.state.bell[executor] = 1;
      if (armed == 0) return;  // newly mapped: rung whatever it does
      if ((armed & 1) == 0) machine.fail("somebody awake was rung");
      if (world.state.rung[executor] == armed) machine.fail("one sleep was rung twice");
      world.state.rung[executor] = armed;
    }
    void freed(std::uint64_t, std::uint64_t address) {
      if (!machine.live) return;
      State& state = world.state;
      const std::uint64_t number = (address % (second_heap - heap)) / 16;
      if ((state.freed >> number & 1) != 0) machine.fail("a message was freed twice");
      state.freed |= std::uint64_t{1} << number;
      for (std::uint32_t s = 0; s < 2; ++s) {
        for (std::uint64_t i = 0; i < state.held_count[s]; ++i) {
          if (state.sub_dead[s] == 0 && state.held[s][i].sequence == first + number)
            machine.fail("a held message was freed");
        }
      }
    }
  };

  void run_publisher(W& world, std::uint8_t t) {
    // Private state is committed when the operation is complete; until then every run starts from
    // the same copy.
    alignas(8) unsigned char scratch[sizeof(PublisherPrivate)];
    std::memcpy(scratch, world.state.publisher, sizeof scratch);
    auto& own = *std::launder(reinterpret_cast<PublisherPrivate*>(scratch));
    PublisherEnvironment environment{world};
    Thread& thread = world.threads[t];
    State& state = world.state;
    if (t == publisher_control) {
      std::uint64_t due[2] = {};
      for (std::uint32_t s = 0; s < 2; ++s) {
        const bool is_due = machine.remember(withdrawal_is_due(world, s)) != 0;
        due[s] = is_due ? machine.remember(state.withdrawal[s]) : 0;
        const bool withheld = plan_.sub[s].unmapped && !(due[s] == 2 && plan_.sub[s].served_again);
        const std::uint64_t mapped = withheld ? 0 : machine.remember(state.announce[s]);
        const std::uint64_t unmapped = machine.remember(state.forget[s]);
        if (machine.live && !withheld) state.announce[s] = 0;
        if (machine.live) state.forget[s] = 0;
        if (mapped != 0 && unmapped != mapped)
          own.core.attach(s, mapped, client_region(s), extent(s), armed_offset(), executor(s),
                          environment);
        if (mapped != 0 && machine.live) state.rung[executor(s)] = 0;
        if (unmapped != 0) own.core.detach(s, unmapped);
        if (unmapped != 0 && machine.live && state.announced[s] == unmapped)
          state.announced[s] = 0;  // UNLINKED
      }
      if (machine.live) state.kick = 0;
      own.core.pass(environment);
      for (std::uint32_t s = 0; s < 2; ++s) change_withdrawal(world, own, s, due[s], environment);
      std::memcpy(state.publisher, scratch, sizeof scratch);
      return;
    }
    if (thread.pc == leave_topic) {
      machine.fence();  // the request is a system call
      state.publisher_request = publisher_leaving;
      thread.pc = finished_publishing;
      return;
    }
    if (thread.pc == timer) {
      own.core.pass(environment);
      thread.pc = own.published == plan_.messages ? finished_publishing : publish;
      std::memcpy(state.publisher, scratch, sizeof scratch);
      return;
    }
    // What others have done until here; a retry makes sense once there is more.
    const std::uint64_t room = machine.remember(room_digest(world));
    const std::uint64_t number = own.published + 1;
    const std::uint64_t frontier =
        plan_.grow_before != 0 && number >= plan_.grow_before ? 2 * page : page;
    if (number == plan_.grow_before) dataplane::store_frontier<MM>({publisher_region}, 0, frontier);
    if (number == plan_.second_window_from) {
      if (machine.remember(state.second_window) != 2) {
        // The hook cannot allocate there before it has the window.
        state.publisher_request = window_wanted;
        state.second_window = 1;
        thread.pc = await_window;
        return;
      }
      dataplane::store_frontier<MM>({publisher_region}, 1, frontier);
    }
    if (machine.live) state.need_open[number] = frontier;
    const std::uint64_t cursor_before = machine.remember(lowest_keep_all_cursor(world));
    const auto outcome = own.core.publish({address_of(number), 16, number}, environment);
    check_bound(world, own.core.head_sequence(), cursor_before, outcome);
    if (outcome == dataplane::PublishOutcome::published) {
      ++own.published;
      state.timer_runs = 0;
      thread.pc = own.published < plan_.messages ? publish
                  : plan_.publisher_leaves       ? leave_topic
                                                 : finished_publishing;
      std::memcpy(state.publisher, scratch, sizeof scratch);
    } else {
      thread.pc = wait_for_room;
      std::memcpy(state.publisher, scratch, sizeof scratch);
      state.room_snapshot = room;
    }
  }

  void change_withdrawal(W& world, PublisherPrivate& own, std::uint32_t s, std::uint64_t due,
                         PublisherEnvironment& environment) {
    if (due == 0) return;
    State& state = world.state;
    const std::uint64_t g = machine.remember(state.generation[s]);
    std::uint64_t next = due;
    if (due == 1) {
      if (own.core.withdraw(s, g, abi::Withdrawal::over_share)) next = 2;
    } else if (!plan_.sub[s].served_again) {
      own.core.disregard(s, g);
      next = 3;
    } else if (own.core.serve_again(s, g, environment)) {
      next = 4;
    }
    if (machine.live) state.withdrawal[s] = next;
    own.core.pass(environment);
  }

  /// How far the keep-all subscription is that is farthest behind, of those that were there first:
  /// who joins late may have one more message (see abi::window_of). One that the publisher has not
  /// mapped yet counts as having read nothing.
  std::uint64_t lowest_keep_all_cursor(const W& world) const {
    std::uint64_t lowest = ~std::uint64_t{0};
    for (std::uint32_t s = 0; s < 2; ++s) {
      const SubscriptionPlan& plan = plan_.sub[s];
      if (!plan_.keep_all || !plan.present || plan.late || !plan.keep_all) continue;
      const std::uint64_t told = world.state.announce[s] == 0 ? peek_line(world, s, 1) : 0;
      lowest = std::min(lowest, std::max(told, first + 1));
    }
    return lowest;
  }
  /// Exactly the bound: never one unread message more, and no waiting while there is room for one.
  void check_bound(const W& world, std::uint64_t head, std::uint64_t cursor_before,
                   dataplane::PublishOutcome outcome) const {
    if (!machine.live || cursor_before == ~std::uint64_t{0}) return;
    if (world.state.withdrawal[0] >= 2 || world.state.withdrawal[1] >= 2) return;
    std::uint64_t bound = plan_.depth;
    for (const SubscriptionPlan& plan : plan_.sub) {
      if (plan.keep_all) bound = std::min<std::uint64_t>(bound, plan.depth);
    }
    if (outcome == dataplane::PublishOutcome::published &&
        head + 1 > lowest_keep_all_cursor(world) + bound)
      machine.fail("a keep-all subscription has more unread messages than its bound");
    if (outcome == dataplane::PublishOutcome::would_block && head + 1 < cursor_before + bound)
      machine.fail("a keep-all publisher waits although there is room");
  }

  /// As PeerHeap.
  struct ModelWindows {
    const W& world;
    std::uint64_t (&opened)[2];
    std::uint64_t count;   // announced and read
    std::uint64_t closed;  // cannot be mapped, from 1
    bool second_is_fresh;
    void open() {
      for (std::uint64_t i = 0; i < count; ++i) {
        if (i + 1 == closed) continue;
        opened[i] =
            std::max(opened[i], region::load_frontier<MM>({publisher_region}, i, 16 * page));
      }
    }
    static std::uint64_t base(std::uint64_t window) { return window == 0 ? heap : second_heap; }
    region::Place place_of(std::uint64_t address, std::uint64_t size) const {
      using region::Place;
      const std::uint64_t window = address >= second_heap ? 1 : 0;
      // The owner's header shows it before anything lies there.
      if (count == 1 && machine.remember(world.state.second_window) == 2) return Place::awaited;
      if (window >= count) return Place::outside;
      const bool one_group = count == 2 && !second_is_fresh;
      if (closed == window + 1 || (one_group && closed != 0)) return Place::unreachable;
      return address + size <= base(window) + opened[window] ? Place::readable : Place::outside;
    }
  };

  void run_subscription(W& world, std::uint32_t s) {
    alignas(8) unsigned char scratch[sizeof(SubscriptionPrivate)];
    std::memcpy(scratch, world.state.sub[s], sizeof scratch);
    auto& own = *std::launder(reinterpret_cast<SubscriptionPrivate*>(scratch));
    Thread& thread = world.threads[sub0 + s];
    State& state = world.state;
    const SubscriptionPlan& plan = plan_.sub[s];
    switch (thread.pc) {
      case join:
        state.join_head[s] = abi::sequence_of(peek(world, publisher_region, pe));
        state.request[s] = joining;
        state.joined[s] = 0;
        thread.pc = await_join;
        break;
      case await_join:
        thread.pc = state.joined[s] == 1
                        ? link_up
                        : left;  // no publisher was announced: late joiners do not link to orphans
        state.joined[s] = 0;
        break;
      case link_up: {
        const bool from_start = !plan.late;
        if (!own.link.link(from_start)) {
          machine.fail("the announced publisher is not on the board");
          break;
        }
        check_start(world, s, own.link.cursor(), from_start);
        own.last = own.link.cursor() - 1;
        thread.pc = plan.hangs ? hung : take;
        if (plan_.one_executor && s == 1) {
          thread.pc = served;
          if (plan_.fault != QueueFault::links_without_waking) state.bell[0] = 1;
        }
        if (is_to_be_replaced(world, s)) thread.pc = sleep;
        break;
      }
      case take: {
        if (machine.remember(state.held_count[s]) == plan.quota) {
          thread.pc = release_one;
          break;
        }
        if (is_to_be_replaced(world, s) || (plan.leaves && machine.choose(2) == 1)) {
          thread.pc = leave;
          break;
        }
        if (!plan.other_thread_releases && machine.remember(state.held_count[s]) != 0 &&
            machine.choose(2) == 1) {
          thread.pc = release_one;
          break;
        }
        run_take(world, s, own, thread);
        break;
      }
      case release_one:
        if (!plan.other_thread_releases) release_oldest(world, s, own);
        thread.pc = take;
        break;
      case sleep:
        own.sleep.arm();
        own.link.observe_publisher();
        if (own.link.drained()) {
          own.sleep.disarm();
          thread.pc = drain_holds;
        } else if (M_holds(steps::S3_news, own.link.has_news()) && !awaits_window(world, s, own)) {
          own.sleep.disarm();
          thread.pc = take;
        } else {
          thread.pc = blocked;
        }
        break;
      case blocked:
        if (machine.live) state.bell[s] = 0;
        own.sleep.disarm();
        thread.pc = take;
        if (is_to_be_replaced(world, s) && ++own.wakes < 2) thread.pc = sleep;
        break;
      case leave:
        state.request[s] = leaving;
        state.joined[s] = 0;
        thread.pc = await_leave;
        break;
      case await_leave:
        state.joined[s] = 0;
        thread.pc = drain_holds;
        break;
      case drain_holds:
        if (machine.remember(state.held_count[s]) == 0) {
          thread.pc = unlink_line;
        } else {
          release_oldest(world, s, own);
        }
        break;
      case unlink_line:
        own.link.unlink();
        thread.pc = left;
        if (own.link.drained()) {
          if (own.link.cursor() <= abi::sequence_of(peek(world, publisher_region, pe)) &&
              state.withdrawal[s] < 2) {
            machine.fail("what a publisher that is gone had committed was not delivered");
          }
          state.request[s] = unlinked;
        } else {
          state.request[s] = drained;
          if ((plan.rejoins || plan.rejoin_depth != 0) && state.generation[s] == 1)
            thread.pc = join;
          if (plan.rejoin_depth != 0 && state.generation[s] == 1)
            become_another_process(world, s, own);
        }
        break;
      default:
        break;
    }
    std::memcpy(state.sub[s], scratch, sizeof scratch);
  }

  static bool is_executing(std::uint64_t pc) {
    return pc == take || pc == take_other || pc == sleep || pc == blocked;
  }

  /// The executor of both: takes from one, then from the other, sleeps when neither has anything.
  void run_executor(W& world) {
    alignas(8) unsigned char scratch[2][sizeof(SubscriptionPrivate)];
    std::memcpy(scratch, world.state.sub, sizeof scratch);
    const auto own = [&](std::uint32_t s) -> SubscriptionPrivate& {
      return *std::launder(reinterpret_cast<SubscriptionPrivate*>(scratch[s]));
    };
    Thread& thread = world.threads[sub0];
    const auto second = [&] { return machine.remember(world.threads[sub1].pc == served) != 0; };
    const std::uint32_t s = thread.pc == take_other ? 1 : 0;
    switch (thread.pc) {
      case take:
      case take_other:
        if (machine.remember(world.state.held_count[s]) != 0) {
          release_oldest(world, s, own(s));
          break;
        }
        run_take(world, s, own(s), thread);
        if (s == 0 && thread.pc == sleep && second()) thread.pc = take_other;
        break;
      case sleep: {
        own(0).sleep.arm();
        bool news = plan_.fault != QueueFault::looks_at_last_link && own(0).link.has_news();
        if (!news && second()) news = own(1).link.has_news();
        news = M_holds(steps::S3_news, news);
        if (news) own(0).sleep.disarm();
        thread.pc = news ? take : blocked;
        break;
      }
      default:
        if (machine.live) world.state.bell[0] = 0;
        own(0).sleep.disarm();
        thread.pc = take;
        break;
    }
    // The second one is another thread's until it is linked.
    std::memcpy(world.state.sub[0], scratch[0], sizeof scratch[0]);
    if (s == 1) std::memcpy(world.state.sub[1], scratch[1], sizeof scratch[1]);
  }

  /// What J6 and J7 leave when nothing is published meanwhile.
  void start_linked(W& world, std::uint32_t s) {
    const std::uint32_t region = static_cast<std::uint32_t>(client_region(s).id);
    const SubscriptionPrivate& own = sub_private(world, s);
    poke(world, region, extent(s), generation);
    poke(world, region, extent(s) + 8, own.link.cursor());
    sub_private(world, s).last = own.link.cursor() - 1;
    struct {
      void ring(std::uint64_t, std::uint64_t) {}
    } nobody_sleeps_yet;
    publisher_private(world).core.attach(s, 1, client_region(s), extent(s), armed_offset(),
                                         executor(s), nobody_sleeps_yet);
    world.threads[sub0 + s].pc = plan_.one_executor && s == 1 ? served : take;
  }

  static std::uint64_t windows_of(const W& world, std::uint32_t s) {
    return world.state.window_announced[s] == 2 ? 2 : 1;
  }
  /// As Link::is_ready: asking again makes sense once there is another window.
  static bool awaits_window(const W& world, std::uint32_t s, const SubscriptionPrivate& own) {
    return own.link.is_awaiting_window() &&
           machine.remember(windows_of(world, s)) == own.windows_seen;
  }

  static bool M_holds(Step step, bool condition) { return MM::holds(step, condition); }

  void run_take(W& world, std::uint32_t s, SubscriptionPrivate& own, Thread& thread) {
    State& state = world.state;
    const SubscriptionPlan& plan = plan_.sub[s];
    const abi::Qos qos = requested(s, state.generation[s]);
    const std::uint64_t from = own.link.cursor();
    const std::uint64_t head_before =
        machine.remember(abi::sequence_of(peek(world, publisher_region, pe)));
    own.windows_seen = machine.remember(windows_of(world, s));
    ModelWindows windows{world, own.opened, own.windows_seen, plan.cannot_map,
                         plan_.second_is_fresh};
    const auto taken = own.link.take(windows);
    const std::uint64_t head = abi::sequence_of(peek(world, publisher_region, pe));
    const std::uint64_t to = taken ? taken->sequence : own.link.cursor();
    if (own.link.malformed() != 0) machine.fail("an honest publisher looks malformed");
    for (std::uint64_t q = from; q < to; ++q) {
      if (head < q + qos.depth && !may_be_unreachable(world, s, q - first) &&
          state.withdrawal[s] < 2)
        machine.fail("a message was lost with fewer than D newer ones");
      if (plan.keep_all && plan_.keep_all && state.withdrawal[s] < 2)
        machine.fail("keep-all lost a message");
    }
    if (!taken) {
      thread.pc = machine.remember(state.held_count[s]) != 0 && !plan.sleep_holding &&
                          !plan.other_thread_releases
                      ? release_one
                      : sleep;
      return;
    }
    if (taken->sequence <= own.last) machine.fail("a message came twice or out of order");
    if (taken->sequence + abi::window_of(qos) <= head_before)
      machine.fail("a message outside the own depth was delivered");
    own.last = taken->sequence;
    const std::uint64_t number = taken->sequence - first;
    if (taken->address != address_of(number) || taken->size != 16 || taken->stamp_ns != number)
      machine.fail("the entry of another message");
    const bool second = needs_second(number);
    if (plan.cannot_map == (second ? 2u : 1u))
      machine.fail("a message that cannot be read was handed out");
    if (number < 16 && own.opened[second ? 1 : 0] < state.need_open[number])
      machine.fail("the mapping does not cover the message");
    if (number < 64 && (state.freed >> number & 1) != 0)
      machine.fail("a freed message was handed out");
    state.held[s][state.held_count[s]++] = {taken->slot, taken->sequence};
  }

  void check_start(const W& world, std::uint32_t s, std::uint64_t cursor, bool from_start) {
    const State& state = world.state;
    if (from_start) {
      if (cursor != first + 1)
        machine.fail("a subscription that was there first misses the beginning");
      return;
    }
    const std::uint64_t back = plan_.transient_local && plan_.sub[s].transient_local
                                   ? std::min(plan_.depth, requested(s, state.generation[s]).depth)
                                   : 0;
    const std::uint64_t earliest =
        std::max(first + 1, state.join_head[s] + 1 - std::min(back, state.join_head[s]));
    // The head is monotone, so the one that the link was made with is at most the present one and at least the one of the request.
    const std::uint64_t head_now = abi::sequence_of(peek(world, publisher_region, pe));
    if (cursor > std::max(first + 1, head_now + 1 - std::min(back, head_now))) {
      machine.fail("a late joiner does not get its history");
    }
    if (cursor < earliest) machine.fail("a late joiner starts before it may");
  }

  void release_oldest(W& world, std::uint32_t s, SubscriptionPrivate& own) {
    State& state = world.state;
    const std::uint64_t slot = machine.remember(state.held[s][0].slot);
    forget_oldest(state, s);
    own.link.release(slot);
  }
  static void forget_oldest(State& state, std::uint32_t s) {
    if (!machine.live) return;
    // Reading ends here; the ghost lets go before the bit does.
    for (std::uint64_t i = 1; i < state.held_count[s]; ++i) state.held[s][i - 1] = state.held[s][i];
    state.held[s][--state.held_count[s]] = {};
  }

  bool is_to_be_replaced(const W& world, std::uint32_t s) const {
    return plan_.sub[s].rejoin_depth != 0 && machine.remember(world.state.generation[s]) == 1;
  }
  /// Its region is a new one: the line is zero already, the sleep word begins anew.
  void become_another_process(W& world, std::uint32_t s, SubscriptionPrivate& own) {
    if (!machine.live) return;
    poke(world, sub_region0 + s, armed_offset(), 0);
    own.~SubscriptionPrivate();
    new (&own) SubscriptionPrivate(link_identity(s, 2), {sub_region0 + s}, armed_offset());
  }

  void run_releaser(W& world, std::uint32_t s) {
    alignas(8) unsigned char scratch[sizeof(SubscriptionPrivate)];
    std::memcpy(scratch, world.state.sub[s], sizeof scratch);
    release_oldest(world, s, *std::launder(reinterpret_cast<SubscriptionPrivate*>(scratch)));
  }

  void run_daemon(W& world) {
    Thread& thread = world.threads[daemon_main];
    State& state = world.state;
    switch (thread.pc) {
      case idle: {
        std::uint64_t waiting = 0;
        while (request_number(world, waiting).request != none) ++waiting;
        waiting = machine.remember(waiting);
        const std::uint64_t chosen = waiting > 1 ? machine.choose(waiting) : 0;
        // The journal record is committed by one store; the request is gone from the door from here
        // on.
        state.journal = request_number(world, chosen);
        switch (state.journal.request) {
          case joining:
            state.linked_to[state.journal.index] =
                matches(static_cast<std::uint32_t>(state.journal.index)) &&
                state.publisher_dead < 2 && state.publisher_state == 0;
            state.generation[state.journal.index] = state.journal.generation;
            state.withdrawal[state.journal.index] =
                plan_.sub[state.journal.index].withdrawn && state.journal.generation == 1;
            state.announced[state.journal.index] =
                matches(static_cast<std::uint32_t>(state.journal.index)) &&
                        state.publisher_dead == 0
                    ? state.journal.generation
                    : 0;
            [[fallthrough]];
          case leaving:
          case drained:
            state.request[state.journal.index] = none;
            break;
          case unlinked:
            state.request[state.journal.index] = none;
            state.linked_to[state.journal.index] = 0;
            break;
          case publisher_leaving:
          case publisher_unlinked:
          case window_wanted:
            state.publisher_request = none;
            break;
          case death_of_subscription:
            state.sub_dead[state.journal.index] = 2;
            break;
          default:
            state.publisher_dead = 2;
            break;
        }
        thread.pc = apply;
        break;
      }
      case down:
        // Restart: redo what the journal holds, kick everybody, ring everybody.
        thread.pc = state.journal.request != none ? std::uint64_t{apply} : std::uint64_t{idle};
        state.kick = state.publisher_dead == 0;
        for (std::uint32_t s = 0; s < 2; ++s) state.bell[s] = 1;
        break;
      case apply: {
        const Journal record = state.journal;
        journal::BoardSteps<MM> steps(topic());
        switch (record.request) {
          case joining:
            // Before it is a member: the publisher that sees it sees its slots.
            if (plan_.slots_before != 0)
              topic()
                  .publisher(0, offsetof(abi::PublisherEntry, slot_count))
                  .store(plan_.slots, std::memory_order_release);
            steps.add_subscription(
                record.index, record.generation,
                {requested(static_cast<std::uint32_t>(record.index), record.generation), 0, se,
                 plan_.sub[record.index].quota, 0});
            break;
          case leaving:
            steps.set_subscription(record.index, record.generation, abi::MemberState::leaving);
            break;
          case drained:
            steps.set_subscription(record.index, record.generation, abi::MemberState::free);
            break;
          case death_of_subscription:
            if (record.generation != 0)
              steps.set_subscription(record.index, record.generation, abi::MemberState::dead);
            break;
          case unlinked:
          case window_wanted:
            break;
          case publisher_leaving:
            steps.orphan_publisher(0, generation, words().head().load(std::memory_order_acquire));
            break;
          case publisher_unlinked:
            steps.free_publisher(0, generation);
            break;
          default: {
            std::uint64_t final_head = 0;
            if (journal::recover_queue(words(), plan_.slots, final_head) ==
                journal::IntentDecision::corrupt) {
              machine.fail("an honest publisher left a corrupt intent");
            }
            steps.orphan_publisher(0, generation, final_head);
            break;
          }
        }
        thread.pc = reply;
        break;
      }
      case reply: {
        // A reply leaves only when the board is in memory (the socket call is a full barrier).
        machine.fence();
        const Journal record = state.journal;
        const bool publisher_alive = state.publisher_dead == 0;
        switch (record.request) {
          case joining:
            state.joined[record.index] = state.linked_to[record.index] != 0 ? 1 : 3;
            // The announcement brings all windows that there are.
            if (state.second_window == 2) state.window_announced[record.index] = 2;
            if (publisher_alive && matches(static_cast<std::uint32_t>(record.index)))
              state.announce[record.index] = record.generation;
            break;
          case leaving:
            state.joined[record.index] = 2;
            state.kick = publisher_alive;
            break;
          case unlinked:
            break;
          case window_wanted:
            // The announcement is in the subscribers' sockets before the answer.
            for (std::uint32_t s = 0; s < 2; ++s) state.window_announced[s] = state.linked_to[s];
            state.second_window = 2;
            break;
          case publisher_unlinked:
            state.kick = publisher_alive;
            break;
          case publisher_leaving:
            state.publisher_state = 1;
            for (std::uint32_t s = 0; s < 2; ++s) state.bell[s] = 1;
            state.kick = publisher_alive;
            break;
          case drained:
          case death_of_subscription:
            state.linked_to[record.index] = 0;
            if (publisher_alive && record.generation != 0)
              state.forget[record.index] = record.generation;
            state.kick = publisher_alive;
            break;
          default:
            state.publisher_dead = 3;
            for (std::uint32_t s = 0; s < 2; ++s) {
              if (MM::step(steps::D3_ring)) state.bell[s] = 1;
              state.announced[s] = 0;
            }
            state.kick = 0;
            break;
        }
        state.journal = {};
        if (state.publisher_state == 1 && state.linked_to[0] == 0 && state.linked_to[1] == 0) {
          state.publisher_state = 2;
          state.publisher_request = publisher_unlinked;  // the daemon's own next task
        }
        thread.pc = idle;
        break;
      }
      default:
        break;
    }
  }

  QueuePlan plan_;
};

}  // namespace agnocast::model
