// SPDX-License-Identifier: Apache-2.0
//
// Explorer: depth-first search over every interleaving of a scenario, with hash compaction (64-bit
// fingerprints of whole states, by XXH3).
//
// A scenario S gives
//   S::State                     everything but memory and threads: private states, messages in
//                                transit, ghosts; plain data
//   S::word_count, S::thread_count
//   runnable(world, thread)      may it take a step now (asked only between two operations)?
//   run(world, thread)           performs its next operation on the machine; the completion of
//                                the operation changes pc and private state
//   moves(world, emit)           further moves: emit(thread, argument) for deaths and the like
//   perform(world, move)         performs one
//   quiet(world, thread, words)  per word: 1 when no other living process can change it
//   finished(world)              called when no move is left; checks the final invariants
#pragma once

#include <tests/model/machine.hpp>

#include <xxhash.h>

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <string>
#include <vector>

namespace agnocast::model {

template <class S>
struct World {
  std::uint64_t memory[S::word_count] = {};
  Thread threads[S::thread_count] = {};
  typename S::State state{};
};

struct Move {
  enum Kind : std::uint8_t { operate, drain, scenario_own };
  Kind kind = operate;
  std::uint8_t thread = 0;
  std::uint16_t argument = 0;  // choice of an operation; meaning of a scenario's own move
};

struct Report {
  std::uint64_t states = 0;
  std::uint64_t transitions = 0;
  std::uint64_t endings = 0;
  std::uint64_t depth = 0;
  bool complete = true;            // false: the limit on states was reached first
  std::string violation;           // empty: none
  std::vector<std::string> trace;  // the moves that lead there
};

/// Open addressing, 8 bytes per state.
class Fingerprints {
 public:
  Fingerprints() : slots_(1 << 16, 0) {}
  bool insert(std::uint64_t fingerprint) {
    if (fingerprint == 0) fingerprint = 1;
    if (2 * count_ >= slots_.size()) grow();
    if (!place(fingerprint)) return false;
    ++count_;
    return true;
  }
  std::uint64_t count() const { return count_; }

 private:
  bool place(std::uint64_t fingerprint) {
    const std::size_t mask = slots_.size() - 1;
    for (std::size_t i = fingerprint & mask;; i = (i + 1) & mask) {
      if (slots_[i] == fingerprint) return false;
      if (slots_[i] == 0) {
        slots_[i] = fingerprint;
        return true;
      }
    }
  }
  void grow() {
    std::vector<std::uint64_t> old(slots_.size() * 2, 0);
    old.swap(slots_);
    for (std::uint64_t fingerprint : old) {
      if (fingerprint != 0) place(fingerprint);
    }
  }
  std::vector<std::uint64_t> slots_;
  std::uint64_t count_ = 0;
};

template <class S>
class Explorer {
 public:
  Explorer(S& scenario, std::uint64_t state_limit)
      : scenario_(scenario), state_limit_(state_limit) {}

  Report explore(const World<S>& start) {
    machine.violation = nullptr;
    stack_.clear();
    push(start);
    while (!stack_.empty() && report_.violation.empty()) {
      if (stack_.size() > report_.depth) report_.depth = stack_.size();
      if (stack_.size() > depth_limit) violate("something goes on for ever");
      Frame& frame = stack_.back();
      if (frame.next == frame.move_count) {
        if (!frame.moved) end(frame.world);
        if (report_.violation.empty()) stack_.pop_back();
        continue;
      }
      const std::size_t index = frame.next++;
      take(index);
    }
    report_.states = seen_.count();
    return report_;
  }

 private:
  static constexpr std::size_t move_capacity = 40;
  // The deepest plan needs 300 steps from start to end.
  static constexpr std::size_t depth_limit = 2000;
  struct Frame {
    explicit Frame(const World<S>& at) : world(at) {}
    World<S> world;
    Move moves[move_capacity];
    std::size_t move_count = 0;
    std::size_t next = 0;
    bool moved = false;  // a move other than a death was possible here
    Access access;       // access of the current move
    BufferedStore drained{};

    void add(const Move& move) {
      if (move_count == move_capacity) Machine::give_up("more moves than move_capacity");
      moves[move_count++] = move;
    }
  };

  static std::uint64_t fingerprint(const World<S>& world) {
    std::uint64_t parts[2 + 2 * S::thread_count];
    std::size_t count = 0;
    const auto add = [&](const void* data, std::size_t bytes) {
      parts[count++] = XXH3_64bits(data, bytes);
    };
    add(world.memory, sizeof world.memory);
    for (const Thread& thread : world.threads) {
      // Its counters and the part of its log that is in use, which follows them.
      add(&thread, offsetof(Thread, log) + thread.log_count * sizeof thread.log[0]);
      add(thread.buffer, thread.buffer_count * sizeof thread.buffer[0]);
    }
    add(&world.state, sizeof world.state);
    return XXH3_64bits(parts, sizeof parts);
  }

  void push(const World<S>& world) {
    if (!seen_.insert(fingerprint(world))) return;
    if (seen_.count() >= state_limit_) {
      report_.complete = false;
      return;
    }
    Frame& frame = stack_.emplace_back(world);
    for (std::uint8_t t = 0; t < S::thread_count; ++t) {
      const Thread& thread = frame.world.threads[t];
      if (thread.log_count != 0 || scenario_.runnable(frame.world, t))
        frame.add({Move::operate, t, 0});
      if (thread.buffer_count != 0) frame.add({Move::drain, t, 0});
    }
    scenario_.moves(frame.world, [&](std::uint8_t thread, std::uint16_t argument) {
      frame.add({Move::scenario_own, thread, argument});
    });
  }

  void take(std::size_t index) {
    Frame& frame = stack_.back();
    const Move move = frame.moves[index];
    next_ = frame.world;
    Thread& thread = next_.threads[move.thread];
    bool essential = true;
    switch (move.kind) {
      case Move::drain:
        frame.drained = thread.buffer[0];
        Machine::drain_one(next_.memory, thread);
        break;
      case Move::scenario_own:
        essential = scenario_.perform(next_, move.thread, move.argument);
        break;
      case Move::operate:
        scenario_.quiet(next_, move.thread, quiet_);
        machine.word_is_quiet_for_thread = quiet_;
        machine.begin(next_.memory, &thread, move.argument);
        operate(move.thread);
        frame.access = machine.access;
        if (move.argument == 0) {
          for (std::uint16_t c = 1; c < machine.choice_count; ++c)
            frame.add({Move::operate, move.thread, c});
        }
        break;
    }
    ++report_.transitions;
    if (essential) frame.moved = true;
    if (machine.violation != nullptr) {
      violate(machine.violation);
      return;
    }
    push(next_);
  }

  void operate(std::uint8_t t) {
    if (_setjmp(machine.stop) != 0) return;
    scenario_.run(next_, t);
    next_.threads[t].log_count = 0;  // the operation is complete: its reads no longer matter
  }

  void end(const World<S>& world) {
    ++report_.endings;
    if (const char* violation = scenario_.finished(world)) violate(violation);
  }

  void violate(const char* text) {
    report_.violation = text;
    for (const Frame& frame : stack_) {
      if (frame.next != 0) report_.trace.push_back(describe(frame, frame.moves[frame.next - 1]));
    }
  }

  std::string describe(const Frame& frame, const Move& move) const {
    char text[160];
    const char* who = S::thread_name(move.thread);
    switch (move.kind) {
      case Move::drain:
        std::snprintf(text, sizeof text, "%-12s %s = %llx reaches memory", who,
                      address_map.names[frame.drained.word],
                      static_cast<unsigned long long>(frame.drained.value));
        break;
      case Move::scenario_own:
        std::snprintf(text, sizeof text, "%-12s %s (%u)", who,
                      scenario_.describe(move.thread, move.argument), move.argument);
        break;
      case Move::operate:
        std::snprintf(text, sizeof text, "%-12s [%s] %s %s -> %llx at %s", who,
                      scenario_.operation_name(frame.world, move.thread), frame.access.what,
                      frame.access.what[0] == 0 ? "(runs)" : address_map.names[frame.access.word],
                      static_cast<unsigned long long>(frame.access.value),
                      name_of(frame.access.step));
        break;
    }
    return text;
  }

  S& scenario_;
  std::uint64_t state_limit_;
  Fingerprints seen_;
  std::vector<Frame> stack_;
  World<S> next_;
  std::uint8_t quiet_[S::word_count] = {};
  Report report_;
};

}  // namespace agnocast::model
