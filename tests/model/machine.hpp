// SPDX-License-Identifier: Apache-2.0
//
// Machine: a modelled memory on which the data plane's templates run unchanged.
//
// An operation is an ordinary function (publish, take, …). It cannot be suspended half way, so the
// machine remembers what the operation has read so far: a thread's position inside an operation is
// the private state at its start plus the list of values its shared accesses returned. To take one
// more step the operation runs again from its start with the recorded values, performs one further
// access for real, continues to the next one and is abandoned there. Two states with equal private
// state, list and memory behave alike for ever, so that is what gets hashed. Nothing is
// reimplemented: the code that runs is the code that ships.
//
// Stores go through a TSO store buffer per thread and reach memory one by one in separate steps;
// read-modify-writes, seq_cst stores and fences drain it. (Without store buffers, for larger
// plans, every store is its own step and takes effect at once.) A thread that dies leaves a prefix
// of its buffer: exactly what a SIGKILL between two instructions leaves.
#pragma once

#include <tests/support/crash/step_names.hpp>

#include <setjmp.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>

namespace agnocast::model {

inline constexpr std::uint32_t log_capacity = 112;
inline constexpr std::uint32_t buffer_capacity = 40;

struct BufferedStore {
  std::uint64_t word;
  std::uint64_t value;
};

/// One thread of one process.
struct Thread {
  std::uint64_t pc = 0;
  std::uint64_t log_count = 0;
  std::uint64_t buffer_count = 0;
  std::uint64_t log[log_capacity];  // the rest of both arrays means nothing
  BufferedStore buffer[buffer_capacity];

  Thread() noexcept {}
  Thread(const Thread& other) noexcept { *this = other; }
  // A tenth of the bytes of a whole state are in use.
  Thread& operator=(const Thread& other) noexcept {
    pc = other.pc;
    log_count = other.log_count;
    buffer_count = other.buffer_count;
    std::copy_n(other.log, log_count, log);
    std::copy_n(other.buffer, buffer_count, buffer);
    return *this;
  }
};

/// A change to the shipped statements, to see whether the explorer notices it.
struct Mutation {
  enum class Kind : std::uint8_t { none, leave_out, force_true, force_false };
  Step step = no_step;
  Kind kind = Kind::none;
};

/// The current access, for traces.
struct Access {
  const char* what = "";
  std::uint64_t word = 0;
  std::uint64_t value = 0;
  Step step = no_step;
};

struct Machine {
  // --- the world being stepped
  std::uint64_t* memory = nullptr;
  const std::uint8_t* word_is_quiet_for_thread =
      nullptr;  // loads that no other living process can influence
  Thread* thread = nullptr;
  // --- this run
  std::uint64_t position = 0;
  bool live = false;
  bool stepped = false;
  bool starting = false;
  std::uint64_t buffer_at_start = 0;
  std::uint64_t choice = 0;
  std::uint64_t choice_count = 0;
  jmp_buf stop;
  // --- settings
  bool store_buffers = true;
  std::uint64_t ring = 4;
  Mutation mutation;
  // --- findings
  const char* violation = nullptr;
  Step last_step = no_step;
  Access access;
  std::array<bool, step_bound> statements{};
  std::array<bool, step_bound> decisions{};

  void begin(std::uint64_t* world_memory, Thread* world_thread, std::uint64_t taken_choice) {
    memory = world_memory;
    thread = world_thread;
    position = 0;
    live = world_thread->log_count == 0;
    stepped = false;
    starting = live;
    buffer_at_start = world_thread->buffer_count;
    choice = taken_choice;
    choice_count = 0;
    access = {};
    if (!starting) {
      position = 1;
      return;
    }
    append(0);  // from here on the operation has begun, even if it stops before its first access
  }

  void fail(const char* text) {
    if (violation == nullptr) violation = text;
  }

  [[noreturn]] static void give_up(const char* text) {
    std::fprintf(stderr, "model: %s\n", text);
    std::abort();
  }

  void append(std::uint64_t value) {
    if (thread->log_count == log_capacity)
      give_up("an operation makes more accesses than log_capacity");
    thread->log[thread->log_count++] = value;
    ++position;
    live = true;
  }

  /// Returns whether the access was made before; then `value` is what it returned.
  bool replayed(std::uint64_t& value) {
    if (position == thread->log_count) return false;
    value = thread->log[position++];
    return true;
  }

  /// The step before which other threads may run: one per run. What an operation stores before its
  /// first such step is a run of its own.
  void scheduling_point() {
    if (stepped || (starting && thread->buffer_count != buffer_at_start)) _longjmp(stop, 1);
    stepped = true;
  }

  std::uint64_t visible(std::uint64_t word) const {
    for (std::uint64_t i = thread->buffer_count; i > 0; --i) {
      if (thread->buffer[i - 1].word == word) return thread->buffer[i - 1].value;
    }
    return memory[word];
  }

  void drain_all() {
    for (std::uint64_t i = 0; i < thread->buffer_count; ++i)
      memory[thread->buffer[i].word] = thread->buffer[i].value;
    clear_buffer(*thread, 0);
  }
  static void clear_buffer(Thread& of, std::uint64_t keep) {
    for (std::uint64_t i = keep; i < of.buffer_count; ++i) of.buffer[i] = {};
    of.buffer_count = keep;
  }
  static void drain_one(std::uint64_t* memory, Thread& of) {
    memory[of.buffer[0].word] = of.buffer[0].value;
    for (std::uint64_t i = 1; i < of.buffer_count; ++i) of.buffer[i - 1] = of.buffer[i];
    of.buffer[--of.buffer_count] = {};
  }

  std::uint64_t load(std::uint64_t word) {
    std::uint64_t value = 0;
    if (replayed(value)) return value;
    if (word_is_quiet_for_thread[word] == 0) scheduling_point();
    value = visible(word);
    if (word_is_quiet_for_thread[word] == 0) access = {"load", word, value, last_step};
    append(value);
    return value;
  }
  void store(std::uint64_t word, std::uint64_t value) {
    if (!store_buffers) {
      std::uint64_t ignored = 0;
      if (replayed(ignored)) return;
      scheduling_point();
      memory[word] = value;
      access = {"store", word, value, last_step};
      append(0);
      return;
    }
    if (!live) return;
    if (thread->buffer_count == buffer_capacity)
      give_up("more buffered stores than buffer_capacity");
    thread->buffer[thread->buffer_count++] = {word, value};
  }
  void store_and_drain(std::uint64_t word, std::uint64_t value) {
    std::uint64_t ignored = 0;
    if (replayed(ignored)) return;
    scheduling_point();
    drain_all();
    memory[word] = value;
    access = {"store seq_cst", word, value, last_step};
    append(0);
  }
  template <class Change>
  std::uint64_t modify(std::uint64_t word, Change change) {
    std::uint64_t value = 0;
    if (replayed(value)) return value;
    scheduling_point();
    drain_all();
    value = memory[word];
    memory[word] = change(value);
    access = {"modify", word, memory[word], last_step};
    append(value);
    return value;
  }
  void fence() {
    std::uint64_t ignored = 0;
    if (replayed(ignored)) return;
    if (thread->buffer_count != 0) {
      scheduling_point();
      drain_all();
      access = {"fence", 0, 0, last_step};
    }
    append(0);
  }
  /// A decision of the environment: the explorer tries every value below count.
  std::uint64_t choose(std::uint64_t count) {
    std::uint64_t value = 0;
    if (replayed(value)) return value;
    scheduling_point();
    choice_count = count;
    access = {"choose", 0, choice, no_step};
    append(choice);
    return choice;
  }
  /// Returns the current value of the outside world and remembers it for later runs.
  std::uint64_t remember(std::uint64_t now) {
    std::uint64_t value = 0;
    if (replayed(value)) return value;
    append(now);
    return now;
  }

  bool has_stated(Step name) const { return statements[static_cast<std::size_t>(name)]; }
  bool has_decided(Step name) const { return decisions[static_cast<std::size_t>(name)]; }

  bool step(Step name) {
    last_step = name;
    statements[static_cast<std::size_t>(name)] = true;
    return !(mutation.kind == Mutation::Kind::leave_out && mutation.step == name);
  }
  bool holds(Step name, bool condition) {
    last_step = name;
    decisions[static_cast<std::size_t>(name)] = true;
    if (mutation.step != name) return condition;
    if (mutation.kind == Mutation::Kind::force_true) return true;
    if (mutation.kind == Mutation::Kind::force_false) return false;
    return condition;
  }
};

inline Machine machine;

/// Maps modelled words: (region, byte offset) → word number. Filled once per scenario; unknown
/// offsets are an error.
struct AddressMap {
  static constexpr std::uint32_t region_count = 4;
  static constexpr std::uint32_t slots_per_region = 2048;  // as far as a link line
  std::array<std::array<std::uint8_t, slots_per_region>, region_count> table{};
  std::array<char[64], 128> names{};
  std::array<std::uint8_t, 128> region_of{};
  std::uint64_t count = 0;

  void add(std::uint32_t region, std::uint64_t offset, const char* name) {
    if (offset / 8 >= slots_per_region || offset % 8 != 0 || count + 1 >= names.size())
      Machine::give_up("address map is too small");
    table[region][offset / 8] = static_cast<std::uint8_t>(++count);  // number + 1; 0 = unknown
    std::snprintf(names[count - 1], sizeof names[0], "%s", name);
    region_of[count - 1] = static_cast<std::uint8_t>(region);
  }
  std::uint64_t find(std::uint32_t region, std::uint64_t offset) const {
    const std::uint8_t found = offset / 8 < slots_per_region ? table[region][offset / 8] : 0;
    if (found == 0) Machine::give_up("access to a word that the scenario does not have");
    return static_cast<std::uint64_t>(found - 1);
  }
};

inline AddressMap address_map;

/// The explorer's memory policy; same members as SharedMemory.
struct ModelMemory {
  struct Region {
    std::uint64_t id = 0;
  };
  struct Word {
    std::uint64_t index;
    std::uint64_t load(std::memory_order) const { return machine.load(index); }
    void store(std::uint64_t value, std::memory_order order) const {
      if (order == std::memory_order_seq_cst) {
        machine.store_and_drain(index, value);
      } else {
        machine.store(index, value);
      }
    }
    std::uint64_t fetch_or(std::uint64_t bits, std::memory_order) const {
      return machine.modify(index, [bits](std::uint64_t value) { return value | bits; });
    }
    std::uint64_t fetch_and(std::uint64_t bits, std::memory_order) const {
      return machine.modify(index, [bits](std::uint64_t value) { return value & bits; });
    }
  };
  // A part of the state, which the explorer copies.
  template <class T>
  struct Zeroed {
    T object{};
    T* operator->() noexcept { return &object; }
    const T* operator->() const noexcept { return &object; }
  };
  static constexpr std::uint32_t slot_capacity = 5;
  static constexpr std::uint32_t subscription_capacity = 2;
  static std::uint64_t ring_count() { return machine.ring; }
  static constexpr std::uint64_t publisher_count() { return 1; }
  static constexpr std::uint64_t near_slot_count() { return 64; }
  static Word word(Region region, std::uint64_t offset) {
    return {address_map.find(static_cast<std::uint32_t>(region.id), offset)};
  }
  static void fence() { machine.fence(); }
  static bool step(Step name) { return machine.step(name); }
  static bool holds(Step name, bool condition) { return machine.holds(name, condition); }
};

}  // namespace agnocast::model
