// SPDX-License-Identifier: Apache-2.0
//
// Queue scenario: one topic, one publisher with its control thread, two subscriptions, the daemon.
// Any process may die.
//
// The scenario runs the shipped code: PublisherCore, LinkCore, SleepCore, BoardSteps,
// recover_queue, store_frontier/load_frontier. It models only scripts (the order of calls),
// messages between daemon and clients as flags, and ghosts that remember what was promised.
// Checked at every step: no message is read or held after it was freed, none is freed twice, order
// per publisher, every loss happens with D newer messages committed, a late joiner starts where it
// may, the opened mapping covers the message. Checked when no move is left: no subscription sleeps
// beside a message, no memory leaks, no thread is stuck, recovery left a consistent queue.
#pragma once

#include <dataplane/frontier.hpp>
#include <dataplane/publisher_core.hpp>
#include <dataplane/subscription_core.hpp>
#include <journal/board_steps.hpp>
#include <journal/queue_recovery.hpp>
#include <journal/start_steps.hpp>
#include <region/windows.hpp>
#include <tests/model/explorer.hpp>
#include <tests/model/queue_plan.hpp>
#include <tests/model/steps.hpp>

#include <algorithm>
#include <cstdint>
#include <new>

namespace agnocast::model {

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
    served,  // subscription; the last two if one executor takes for both
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
    // messages in transit
    std::uint64_t doorbell[2] = {};
    std::uint64_t request[2] = {};   // client → daemon
    std::uint64_t joined[2] = {};    // daemon → client, for join and leave
    std::uint64_t announce[2] = {};  // daemon → publisher: generation to map
    std::uint64_t forget[2] = {};    // daemon → publisher: generation to unmap
    std::uint64_t announced[2] =
        {};  // rule RU: generation the publisher was notified of and has not unlinked
    std::uint64_t kick = 0;
    Journal journal;
    std::uint64_t generation[2] = {};  // of the subscription index, daemon's table
    // processes
    std::uint64_t publisher_dead = 0;  // 1 dead, 2 known to the daemon, 3 recovered
    std::uint64_t sub_dead[2] = {};
    std::uint64_t publisher_deaths = 0, subscriber_deaths = 0, daemon_deaths = 0;
    std::uint64_t publisher_request = 0;
    std::uint64_t publisher_state =
        0;  // daemon's table: 0 active, 1 orphan by its own request, 2 free again
    std::uint64_t linked_to[2] =
        {};  // rule RU: this subscription was notified of the publisher and has not unlinked it
    std::uint64_t second_window = 0;  // of the publisher: 1 requested, 2 open
    // Its announcement: 1 in the subscriber's socket, 2 read.
    std::uint64_t window_announced[2] = {};
    std::uint64_t timer_runs = 0;
    std::uint64_t room_snapshot = 0;
    // ghosts
    std::uint64_t freed = 0;            // bit per message number
    std::uint64_t join_head[2] = {};    // newest sequence when the subscription asked to join
    std::uint64_t answer_head[2] = {};  // and when it was answered; 0 when it has linked
    std::uint64_t held_count[2] = {};
    Held held[2][3] = {};
    std::uint64_t cursor_before[2] = {};
    std::uint64_t need_open[16] = {};  // per message: frontier when it was built
    std::uint64_t rung[2] = {};        // the last sleep that was rung
    std::uint64_t withdrawal[2] = {};  // 1 planned, 2 reported, 3 disregarded or served again
  };

  using W = World<QueueScenario>;

  explicit QueueScenario(const QueuePlan& plan) : plan_(plan) {}

  static constexpr std::uint64_t first = 16;      // first_sequence of the publisher
  static constexpr std::uint64_t generation = 7;  // of the publisher
  static constexpr std::uint64_t pe = 4096, se = 4096, second_se = se + 1024;
  static constexpr std::uint64_t heap = 0x10000, second_heap = 0x20000, page = 0x100;

  W start();

  // --- possible moves

  bool runnable(const W& world, std::uint8_t t) const;

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

  /// Deaths; the publisher's timer when no other move is left; and a subscriber's control thread
  /// that reads the announcement of a window. Returns whether the move is not a death: then the
  /// state was no ending.
  bool perform(W& world, std::uint8_t t, std::uint16_t argument);

  /// Loads that no other living process can influence are no scheduling points.
  void quiet(const W& world, std::uint8_t t, std::uint8_t* quiet_words) const;

  // --- what the threads do

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

  const char* finished(const W& world);

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
    return t == publisher_control ? "control scan" : names[world.threads[t].pc];
  }

 private:
  // --- addresses

  static constexpr std::uint64_t armed_offset() {
    return offsetof(abi::ClientRegionHeader, wait_set);
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
  /// Returns whether the subscription may lose this message because of its place: it may point
  /// anywhere in the windows of its window set.
  bool may_be_unreachable(const W& world, std::uint32_t s, std::uint64_t number) const {
    const std::uint32_t closed = plan_.sub[s].cannot_map;
    if (closed == 0) return false;
    if (plan_.second_is_fresh) return closed == (needs_second(number) ? 2u : 1u);
    return closed == 1 || machine.remember(world.state.second_window) == 2;
  }

  void build_map() const;

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
  std::uint64_t line_offset(std::uint32_t s) const { return extent(s) + abi::link_offset(0); }
  /// The publisher's number for it.
  std::uint64_t executor(std::uint32_t s) const {
    const bool one = plan_.one_executor || plan_.fault == QueueFault::one_number_for_two_wait_sets;
    return one ? 0 : s;
  }
  /// Generation, cursor, hold.
  std::uint64_t peek_line(const W& world, std::uint32_t s, std::uint64_t field) const {
    return peek(world, static_cast<std::uint32_t>(client_region(s).id), line_offset(s) + field * 8);
  }

  static region::TopicWords<MM> topic() { return {{board}, 0}; }
  static region::PublisherWords<MM> words() { return {{publisher_region}, pe}; }
  region::LinkWords<MM> line(std::uint32_t s) const { return {client_region(s), extent(s), 0}; }
  abi::Qos offered() const {
    return {plan_.depth, plan_.transient_local, true, plan_.keep_all, false};
  }
  /// `subscription_generation`: 1, or 2 after a rejoin.
  abi::Qos requested(std::uint32_t s, std::uint64_t subscription_generation) const {
    const SubscriptionPlan& plan = plan_.sub[s];
    const bool again = subscription_generation > 1 && plan.rejoin_depth != 0;
    return {again ? plan.rejoin_depth : plan.depth, plan.transient_local, true, plan.keep_all,
            false};
  }
  dataplane::LinkCore<MM>::Identity link_identity(std::uint32_t s,
                                                  std::uint64_t subscription_generation) const {
    return {topic(),    words(), line(s),   0,
            generation, first,   offered(), requested(s, subscription_generation),
            16,         16,      s};
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

  /// A thread in the middle of an operation holds the publisher's mutex; it releases it together
  /// with its stores.
  static bool busy(const W& world, std::uint8_t t) {
    return world.threads[t].log_count != 0 || world.threads[t].buffer_count != 0;
  }

  static bool is_withdrawn(const State& state, std::uint32_t s) {
    return state.withdrawal[s] == 2 || state.withdrawal[s] == 3;
  }
  /// Returns whether the publisher's control thread must act on a withdrawal. Steps that it may
  /// take without knowing the holds, it takes when there are none.
  bool withdrawal_is_due(const W& world, std::uint32_t s) const {
    const State& state = world.state;
    if (state.sub_dead[s] != 0) return false;
    if (state.withdrawal[s] == 1)
      return abi::state_of(peek(
                 world, board,
                 abi::subscription_entry_offset(1, s) + offsetof(abi::SubscriptionEntry, word))) ==
             abi::BoardState::active;
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
    std::uint64_t parts[8];
    std::size_t count = 0;
    for (std::uint32_t s = 0; s < 2; ++s) {
      for (std::uint64_t f = 0; f < 3; ++f) parts[count++] = peek_line(world, s, f);
    }
    parts[count++] = peek(world, board, offsetof(abi::TopicHeader, epoch));
    // The control thread may have learned something.
    parts[count++] = XXH3_64bits(world.state.publisher, sizeof world.state.publisher);
    return XXH3_64bits(parts, sizeof parts);
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
  /// Returns the n-th request that waits at the daemon.
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
      world.state.doorbell[executor] = 1;
      if (armed == 0) return;  // newly mapped: rung in any state
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

  void run_publisher(W& world, std::uint8_t t);

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
    own.core.scan(environment);
  }

  /// Returns the lowest cursor of the keep-all subscriptions that joined first: a late joiner may
  /// have one more message (see abi::window_of). A subscription that the publisher has not mapped
  /// yet counts as having read nothing.
  std::uint64_t lowest_keep_all_cursor(const W& world) const;
  /// Checks the exact bound: no unread message beyond it, and no waiting while there is room.
  void check_bound(const W& world, std::uint64_t head, std::uint64_t cursor_before,
                   dataplane::PublishOutcome outcome) const;

  /// Like PeerHeap.
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
      // The owner's header shows the window before a message lies there.
      if (count == 1 && machine.remember(world.state.second_window) == 2) return Place::awaited;
      if (window >= count) return Place::outside;
      const bool one_window_set = count == 2 && !second_is_fresh;
      if (closed == window + 1 || (one_window_set && closed != 0)) return Place::unreachable;
      return address + size <= base(window) + opened[window] ? Place::readable : Place::outside;
    }
  };

  void run_subscription(W& world, std::uint32_t s);

  static bool is_executing(std::uint64_t pc) {
    return pc == take || pc == take_other || pc == sleep || pc == blocked;
  }

  /// The executor of both: takes from one, then from the other, sleeps when neither has a message.
  void run_executor(W& world);

  /// What J6 and J7 leave if nothing is published in between.
  void start_linked(W& world, std::uint32_t s);

  static std::uint64_t windows_of(const W& world, std::uint32_t s) {
    return world.state.window_announced[s] == 2 ? 2 : 1;
  }
  /// Like SubscriptionEndpoint::can_take: asking again makes sense once there is another window.
  static bool awaits_window(const W& world, std::uint32_t s, const SubscriptionPrivate& own) {
    return own.link.is_awaiting_window() &&
           machine.remember(windows_of(world, s)) == own.windows_seen;
  }

  static bool M_holds(Step step, bool condition) { return MM::holds(step, condition); }

  void run_take(W& world, std::uint32_t s, SubscriptionPrivate& own, Thread& thread);

  void check_start(const W& world, std::uint32_t s, std::uint64_t cursor, bool from_start);

  void release_oldest(W& world, std::uint32_t s, SubscriptionPrivate& own);
  static void forget_oldest(State& state, std::uint32_t s);

  bool is_to_be_replaced(const W& world, std::uint32_t s) const {
    return plan_.sub[s].rejoin_depth != 0 && machine.remember(world.state.generation[s]) == 1;
  }
  /// Its region is new: the line is already zero, the sleep word starts from zero.
  void become_another_process(W& world, std::uint32_t s, SubscriptionPrivate& own);

  void run_releaser(W& world, std::uint32_t s);

  void run_daemon(W& world);
  void take_request(W& world);
  void apply_record(W& world);
  void answer_record(W& world);

  QueuePlan plan_;
};

}  // namespace agnocast::model

// The bodies for each participant.
#include <tests/model/queue_daemon.hpp>
#include <tests/model/queue_ending.hpp>
#include <tests/model/queue_memory.hpp>
#include <tests/model/queue_moves.hpp>
#include <tests/model/queue_publisher.hpp>
#include <tests/model/queue_subscription.hpp>
