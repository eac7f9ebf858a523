// SPDX-License-Identifier: Apache-2.0
//
// Explorer: depth-first search over every interleaving of a scenario, with hash compaction (64-bit
// fingerprints of whole states).
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

class Hasher {
 public:
  void add(std::uint64_t value) {
    value *= 0x9e3779b97f4a7c15;
    value ^= value >> 32;
    hash_ = (hash_ ^ value) * 0xd6e8feb86659fd93;
    hash_ ^= hash_ >> 29;
  }
  void add(const void* data, std::size_t bytes) {
    const auto* at = static_cast<const unsigned char*>(data);
    for (; bytes >= 8; bytes -= 8, at += 8) {
      std::uint64_t word;
      std::memcpy(&word, at, 8);
      add(word);
    }
    if (bytes != 0) {
      std::uint64_t word = 0;
      std::memcpy(&word, at, bytes);
      add(word);
    }
  }
  std::uint64_t value() const { return hash_; }

 private:
  std::uint64_t hash_ = 0x2545f4914f6cdd1d;
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
    Hasher hasher;
    hasher.add(world.memory, sizeof world.memory);
    for (const Thread& thread : world.threads) {
      hasher.add(thread.pc);
      hasher.add(thread.log_count << 32 | thread.buffer_count);
      hasher.add(thread.log, thread.log_count * sizeof thread.log[0]);
      hasher.add(thread.buffer, thread.buffer_count * sizeof thread.buffer[0]);
    }
    hasher.add(&world.state, sizeof world.state);
    return hasher.value();
  }

  void push(const World<S>& world) {
    if (!seen_.insert(fingerprint(world))) return;
    if (seen_.count() >= state_limit_) {
      report_.complete = false;
      return;
    }
    stack_.emplace_back();
    Frame& frame = stack_.back();
    frame.world = world;
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
    std::memset(next_.threads[t].log, 0, sizeof next_.threads[t].log);
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
