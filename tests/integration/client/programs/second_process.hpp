// SPDX-License-Identifier: Apache-2.0
//
// SecondProcess: this test program started once more, as a publisher or a subscription of its own.
// second_process.cpp has the main() of both roles. Ends with its standard input, at the latest
// with the destructor.
//
//   publish TOPIC QOS COUNT   waits for a subscription, publishes Number 1 … COUNT, stays
//   subscribe TOPIC QOS       stays
//   blocks TOPIC QOS          stays; then takes all Blocks, and ends with 5 if one is damaged
//   other_type TOPIC          requests the topic with another type, is refused, stays
//
// QOS: a depth, then r/b (reliable, best effort), v/t (volatile, transient local), a for keep-all:
// "10rv", "100rva".
#pragma once

#include <agnocast/message_traits.hpp>
#include <agnocast/qos.hpp>

#include <sys/types.h>

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

namespace agnocast::test {

struct Number {
  std::uint64_t value = 0;
};

/// Its words lie in another block of the heap.
struct Block {
  std::uint64_t value = 0;
  std::vector<std::uint64_t> words;
  void fill(std::uint64_t with, std::size_t count) {
    value = with;
    words.assign(count, with);
  }
  bool is_intact() const {
    return !words.empty() &&
           std::all_of(words.begin(), words.end(), [this](auto word) { return word == value; });
  }
};

/// "10rv": the depth, then letters as below; of times the seconds follow.
///   r reliable · b best effort · v volatile · t transient local · a keep all · m manual liveliness
///   d deadline · l liveliness lease
QoS qos_of(const std::string& text);

class SecondProcess {
 public:
  explicit SecondProcess(const std::vector<std::string>& role);
  ~SecondProcess() { kill(); }
  SecondProcess(const SecondProcess&) = delete;
  SecondProcess& operator=(const SecondProcess&) = delete;
  /// Sends SIGKILL, and waits for its end.
  void kill();
  /// Lets it end by itself; returns its exit status.
  int end();

 private:
  int reap();
  pid_t pid_ = -1;
  int input_ = -1;
};

}  // namespace agnocast::test

template <>
struct agnocast::MessageTraits<agnocast::test::Block> {
  static constexpr const char* name = "tests/Block";
  static void for_each_pointer(const test::Block& block, PointerVisitor& visit) noexcept {
    visit("words", block.words);
  }
};
