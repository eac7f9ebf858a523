// SPDX-License-Identifier: Apache-2.0
//
// Reuse scenario (rule RU): publishers come and go on one index whose region is reused in place; a
// subscriber links, drains, unlinks, dies and comes back, loses its connection and reconnects; the
// daemon dies between any two of its steps and restarts from its tables. Publishers also come and
// go while the subscriber is disconnected: it is notified all the same, and on reconnection the
// daemon announces what its bit in the set says.
//
// The scenario runs the shipped AnnounceSet and AnnouncementState, and link(), release() and
// unlink() of LinkCore on the one link line that all these publishers share. Checked: a linked
// subscriber never sees the region of another generation, and links every generation that it was
// notified of, once; every publisher finds the line zero and owns it until its link is gone; in
// the end every generation could be created (no index is lost). The queue scenario begins with
// such a line and one publisher, so it covers every publisher of the index.
#pragma once

#include <dataplane/subscription_core.hpp>
#include <journal/announce_set.hpp>
#include <tests/model/explorer.hpp>
#include <tests/model/steps.hpp>

#include <cstdint>

namespace agnocast::model {

struct ReusePlan {
  const char* name = "";
  std::uint64_t generations = 3;
  std::uint64_t daemon_deaths = 2;
  std::uint64_t subscriber_lives = 2;
  std::uint64_t disconnections = 0;
  bool says_unlinked_first = false;  // a fault: while its line still belongs to the old link
};

class ReuseScenario {
 public:
  enum ThreadId : std::uint8_t { daemon_main, subscriber };
  static constexpr std::uint8_t thread_count = 2;
  static constexpr std::size_t word_count = 5;
  enum RegionId : std::uint32_t { board, publisher_region, subscriber_region };
  static constexpr std::uint64_t first = 16;  // first_sequence of every publisher
  static constexpr std::uint64_t pub_word =
      abi::publisher_entry_offset(0) + offsetof(abi::PublisherEntry, word);
  enum Pc : std::uint64_t {
    idle = 0,
    send_announcement,
    restart,
    down,
    /* subscriber */ unconnected,
    serving,
    say_unlinked,
    link_line,
    unlink_line
  };

  static constexpr std::uint64_t queue_capacity = 6;
  struct Channel {
    std::uint64_t count = 0;
    std::uint64_t message[queue_capacity] = {};
    void push(std::uint64_t value) {
      if (count == queue_capacity) Machine::give_up("a channel is too short");
      message[count++] = value;
    }
    std::uint64_t pop() {
      const std::uint64_t first = message[0];
      for (std::uint64_t i = 1; i < count; ++i) message[i - 1] = message[i];
      message[--count] = 0;
      return first;
    }
  };
  enum PublisherState : std::uint64_t { free_index, active, orphan };
  struct State {
    // the daemon's tables under the redo log
    journal::AnnounceSet<ModelMemory, 64> set;
    std::uint64_t publisher_state = free_index;
    std::uint64_t notified[4] = {};  // per client: the generation of its last notification
    // the world
    std::uint64_t publisher_alive = 0;
    std::uint64_t region_owner = 0;
    Channel to_subscriber, to_daemon;
    std::uint64_t connected = 0;
    std::uint64_t known_life = 0;          // the last incarnation that has connected
    std::uint64_t linked_generations = 0;  // one bit each, of this incarnation
    std::uint64_t disconnections = 0;
    std::uint64_t life = 1;  // of the subscriber = its client index
    std::uint64_t dead_unnoticed =
        0;  // client index of a dead subscriber that the daemon has not reaped
    journal::AnnouncementState<ModelMemory> announcement;
    std::uint64_t linking_generation = 0;   // announced, about to be linked
    std::uint64_t unlinked_generation = 0;  // about to be reported
    std::uint64_t addressee = 0;  // of the announcement about to be sent; lost with the daemon
    std::uint64_t daemon_deaths = 0;
  };
  using W = World<ReuseScenario>;

  explicit ReuseScenario(const ReusePlan& plan) : plan_(plan) {}

  W start() {
    address_map = {};
    address_map.add(board, pub_word, "pub.word");
    address_map.add(publisher_region, 0, "head");
    const char* line[] = {"publisher_generation", "cursor", "hold"};
    for (std::uint64_t field = 0; field < 3; ++field)
      address_map.add(subscriber_region, abi::link_offset(0) + field * 8, line[field]);
    machine.store_buffers = true;
    W world;
    world.threads[daemon_main].pc = idle;
    world.threads[subscriber].pc = unconnected;
    return world;
  }

  bool runnable(const W& world, std::uint8_t t) const {
    const State& state = world.state;
    if (t == daemon_main) return world.threads[t].pc != idle || task(world, 0) != nothing_to_do;
    switch (world.threads[t].pc) {
      case unconnected:
        return world.threads[daemon_main].pc != down && world.threads[daemon_main].pc != restart;
      case serving:
        return state.connected == 0 || state.to_subscriber.count != 0 || must_unlink(state);
      case say_unlinked:
      case link_line:
      case unlink_line:
        return true;
      default:
        return false;
    }
  }

  enum Own : std::uint16_t { publisher_dies, daemon_dies, subscriber_dies, connection_ends };
  template <class Emit>
  void moves(const W& world, Emit emit) const {
    const State& state = world.state;
    if (state.publisher_alive != 0) emit(daemon_main, publisher_dies);
    if (state.daemon_deaths < plan_.daemon_deaths && world.threads[daemon_main].pc != down)
      emit(daemon_main, daemon_dies);
    if (state.life < plan_.subscriber_lives && state.dead_unnoticed == 0)
      emit(subscriber, subscriber_dies);
    if (state.connected != 0 && state.disconnections < plan_.disconnections)
      emit(subscriber, connection_ends);
  }
  bool perform(W& world, std::uint8_t, std::uint16_t what) {
    State& state = world.state;
    switch (what) {
      case publisher_dies:
        state.publisher_alive = 0;
        return state.set.generation() <
               plan_.generations;  // the last one may live for ever: that is an ending too
      case daemon_dies:
        world.threads[daemon_main].pc = down;
        ++state.daemon_deaths;
        disconnect(state);  // a new connection has a new, empty channel
        return false;
      case connection_ends:
        ++state.disconnections;
        disconnect(state);
        return false;
      default:
        state.dead_unnoticed = state.life++;
        state.linked_generations = 0;
        disconnect(state);
        state.announcement = {};
        state.linking_generation = 0;
        state.unlinked_generation = 0;
        // The next process has its own region and line.
        world.threads[subscriber] = {};
        world.threads[subscriber].pc = unconnected;
        for (std::uint64_t field = 0; field < 3; ++field) line(world, field) = 0;
        return false;
    }
  }
  void quiet(const W&, std::uint8_t, std::uint8_t* words) const {
    std::memset(words, 0, word_count);
  }

  void run(W& world, std::uint8_t t) {
    if (t == daemon_main) {
      run_daemon(world);
    } else {
      run_subscriber(world);
    }
    // A linked subscriber may read the region at any moment.
    const std::uint64_t linked = world.state.announcement.current();
    if (linked != 0 && world.state.region_owner != linked)
      machine.fail("a linked subscriber reads a region that was used again");
    if (linked != 0 && line(world, 0) != linked)
      machine.fail("the line of a link shows another publisher");
  }

  const char* finished(const W& world) {
    const State& state = world.state;
    if (state.set.generation() < plan_.generations)
      return "an index is lost: no further generation could be created";
    if (state.publisher_state == orphan) return "an orphan stays for ever";
    if (state.publisher_alive != 0 && state.announcement.current() != state.set.generation())
      return "a living publisher is not linked";
    return nullptr;
  }

  static const char* thread_name(std::uint8_t t) {
    return t == daemon_main ? "daemon" : "subscriber";
  }
  static const char* describe(std::uint8_t, std::uint16_t what) {
    return what == publisher_dies    ? "publisher dies"
           : what == daemon_dies     ? "daemon dies"
           : what == connection_ends ? "connection ends"
                                     : "subscriber dies";
  }
  static const char* operation_name(const W& world, std::uint8_t t) {
    static const char* names[] = {"task",  "send announcement", "restart", "start again", "connect",
                                  "serve", "say unlinked",      "link",    "unlink"};
    return names[world.threads[t].pc];
  }

 private:
  enum Task : std::uint64_t {
    nothing_to_do,
    hear,
    orphan_publisher,
    free_it,
    create,
    announce,
    reap
  };

  static std::uint64_t& line(W& world, std::uint64_t field) {
    return world.memory[address_map.find(subscriber_region, abi::link_offset(0) + field * 8)];
  }
  static dataplane::LinkCore<ModelMemory> link_to(std::uint64_t generation) {
    const abi::Qos qos{1, false, true, false, false};
    return dataplane::LinkCore<ModelMemory>({{{board}, 0},
                                             {{publisher_region}, 0},
                                             {{subscriber_region}, 0, 0},
                                             0,
                                             generation,
                                             first,
                                             qos,
                                             qos,
                                             16,
                                             16});
  }
  static void unmap(std::uint64_t generation) {
    dataplane::LinkCore<ModelMemory> link = link_to(generation);
    link.release(0);
    link.unlink();
  }
  static void show(W& world, abi::BoardState state_on_board) {
    world.memory[address_map.find(board, pub_word)] =
        abi::pack_board_word(world.state.set.generation(), state_on_board);
  }

  static void disconnect(State& state) {
    state.connected = 0;
    state.to_subscriber = {};
    state.to_daemon = {};
  }
  static bool must_unlink(const State& state) {
    return state.announcement.current() != 0 &&
           (state.publisher_state != active ||
            state.set.generation() != state.announcement.current());
  }

  Task task(const W& world, std::uint64_t n) const {
    const State& state = world.state;
    auto is = [&](bool condition) { return condition && n-- == 0; };
    if (is(state.to_daemon.count != 0)) return hear;
    if (is(state.publisher_state == active && state.publisher_alive == 0)) return orphan_publisher;
    if (is(state.publisher_state == orphan && state.set.reusable())) return free_it;
    if (is(state.publisher_state == free_index && state.set.generation() < plan_.generations))
      return create;
    // A living process, connected or not.
    if (is(state.publisher_state == active && state.known_life == state.life &&
           state.notified[state.life] != state.set.generation()))
      return announce;
    if (is(state.dead_unnoticed != 0)) return reap;
    return nothing_to_do;
  }

  void run_daemon(W& world) {
    State& state = world.state;
    Thread& thread = world.threads[daemon_main];
    switch (thread.pc) {
      case down:
        state.addressee = 0;
        thread.pc = idle;
        break;
      case send_announcement:
        // Into the connection of the notified process, which may be gone by now.
        if (state.connected == state.addressee) state.to_subscriber.push(state.set.generation());
        state.addressee = 0;
        thread.pc = idle;
        break;
      case idle: {
        std::uint64_t count = 0;
        while (task(world, count) != nothing_to_do) ++count;
        const std::uint64_t chosen = count > 1 ? machine.choose(count) : 0;
        switch (task(world, chosen)) {
          case hear:
            state.set.acknowledge(state.connected, state.to_daemon.pop());
            break;
          case orphan_publisher:
            state.publisher_state = orphan;
            show(world, abi::BoardState::orphan);
            break;
          case free_it:
            if (state.notified[state.life] == state.set.generation() &&
                (state.linked_generations >> state.set.generation() & 1) == 0)
              machine.fail("the last messages of a publisher are lost");
            state.publisher_state = free_index;
            show(world, abi::BoardState::free);
            break;
          case create:
            state.set.begin(state.set.generation() + 1);
            state.publisher_state = active;
            state.publisher_alive = 1;
            state.region_owner = state.set.generation();  // the same memory, in place
            world.memory[address_map.find(publisher_region, 0)] = abi::pack_entry(first, 0);
            show(world, abi::BoardState::active);
            for (std::uint64_t field = 0; field < 3; ++field) {
              if (line(world, field) != 0)
                machine.fail("a publisher begins on the line of an older one");
            }
            break;
          case announce:
            state.addressee = state.life;
            state.set.notify(state.life);  // (a) logged; sent in a separate step
            state.notified[state.life] = state.set.generation();
            thread.pc = send_announcement;
            break;
          case reap:
            state.set.died(state.dead_unnoticed);
            state.dead_unnoticed = 0;
            break;
          case nothing_to_do:
            break;
        }
        break;
      }
      default:
        break;
    }
  }

  void run_subscriber(W& world) {
    State& state = world.state;
    Thread& thread = world.threads[subscriber];
    switch (thread.pc) {
      case unconnected:
        connect(world);
        break;
      case serving:
        if (state.connected == 0) {
          thread.pc = unconnected;
        } else if (state.to_subscriber.count != 0 &&
                   (!must_unlink(state) || machine.choose(2) == 0)) {
          const std::uint64_t generation = state.to_subscriber.pop();
          switch (state.announcement.on_announce(generation)) {
            case journal::AnnouncementState<ModelMemory>::Action::link:
              state.linking_generation = generation;
              thread.pc = link_line;
              break;
            case journal::AnnouncementState<ModelMemory>::Action::say_unlinked:
              state.unlinked_generation = generation;
              thread.pc = say_unlinked;
              break;
            case journal::AnnouncementState<ModelMemory>::Action::nothing:
              break;
          }
        } else {
          state.unlinked_generation = state.announcement.current();
          thread.pc = unlink_line;
        }
        break;
      case link_line:
        if (!link_to(state.linking_generation).link(true))
          machine.fail("the announced publisher is not on the board");
        if ((state.linked_generations >> state.linking_generation & 1) != 0)
          machine.fail("a generation is linked twice");
        state.linked_generations |= std::uint64_t{1} << state.linking_generation;
        state.announcement.linked(state.linking_generation);
        line(world, 2) = 1;  // holds a message while it is linked
        state.linking_generation = 0;
        thread.pc = serving;
        break;
      case unlink_line:
        if (!plan_.says_unlinked_first) unmap(state.unlinked_generation);
        state.announcement.unlinked(
            state.unlinked_generation);  // (b) the link is gone; reported in a separate step
        thread.pc = say_unlinked;
        break;
      case say_unlinked:
        machine.fence();  // a system call
        if (state.connected == 0) {
          thread.pc = unconnected;
          break;
        }
        state.to_daemon.push(state.unlinked_generation);
        if (plan_.says_unlinked_first) unmap(state.unlinked_generation);
        state.unlinked_generation = 0;
        thread.pc = serving;
        break;
      default:
        break;
    }
  }

  void connect(W& world) {
    State& state = world.state;
    state.connected = state.life;
    state.known_life = state.life;
    // (c) the daemon repeats the announcement to every client in the set; the task `announce`
    // notifies a new one.
    if (state.set.contains(state.life) && machine.step(steps::R8_again))
      state.to_subscriber.push(state.set.generation());
    world.threads[subscriber].pc = serving;
  }

  ReusePlan plan_;
};

}  // namespace agnocast::model
