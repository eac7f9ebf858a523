// SPDX-License-Identifier: Apache-2.0
//
// The stage of the hostile tests: the real daemon, an honest pair of one user that never stops,
// and attackers of another one.
//
//   Stage stage;                          daemon with rules and quotas, pair started and matched
//   Attacker attacker([](Attack& attack) { … attack.ready(); while (attack.goes_on()) …; });
//   attacker.wait_until_ready();
//   stage.honest_goes_on();               while the attack lasts
//   attacker.end();                       a failed expectation of the body fails the test
//   stage.honest_lost_nothing();          and the row of the attack table is written
//
// Attackers are children that have dropped their privileges: gtest's EXPECT works in them. The
// honest processes are programs of their own, because the library's hook and threads belong to a
// process.
#pragma once

#include <agnocast/abi/observe.hpp>
#include <tests/hostile/attack_table.hpp>
#include <tests/support/processes/child.hpp>
#include <tests/support/processes/daemon_process.hpp>
#include <tests/support/processes/steered_process.hpp>
#include <tests/support/wire/wire_client.hpp>

#include <gtest/gtest.h>
#include <unistd.h>

#include <array>
#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <random>
#include <string>

// First line of every test of this folder.
#define AGNOCAST_NEEDS_TWO_USERS() \
  if (::geteuid() != 0) GTEST_SKIP() << "needs root and a second uid"

namespace agnocast::test {

inline constexpr uid_t honest_uid = 65533, hostile_uid = 65534, daemon_uid = 65532,
                       third_uid = 65531;
/// A topic on which only the honest user may publish, and one that is open to everybody.
inline constexpr const char* stream_topic = "/stream";
inline constexpr const char* open_topic = "/open";

struct StageOptions {
  std::optional<uid_t> daemon = {};  ///< none: root
  std::string quota = "held_messages = 400\n";
  std::string more = {};            ///< further text of the configuration
  std::string daemon_keys = {};     ///< further text of [daemon]
  std::string heap = {};            ///< further text of [heap]
  bool without_passrights = false;  ///< as on a kernel before 6.16
};

class Stage {
 public:
  explicit Stage(const StageOptions& options = {});
  ~Stage();

  DaemonProcess& daemon() noexcept { return daemon_; }
  const std::string& socket_path() const noexcept { return daemon_.socket_path(); }
  SteeredProcess& publisher() noexcept { return *publisher_; }
  SteeredProcess& subscriber() noexcept { return *subscriber_; }
  /// Starts another process of the honest user, or of `uid`.
  std::unique_ptr<SteeredProcess> another_honest_process(uid_t uid = honest_uid) const;

  /// Waits until another 100 messages have been published and have arrived. That is what "is not
  /// blocked" means: a publisher that waits for another process, or a reader that starves, never
  /// gets there.
  void honest_goes_on();
  /// Checks that the daemon grants the requests of the honest subscriber's process.
  void honest_is_served();
  /// Ends the stream; every message has arrived, once, in order, whole. The daemon runs.
  void honest_lost_nothing();
  /// The attack was on this publisher, not on the pair: the row of the table shows its state now.
  /// The test judges it.
  void victim_was(SteeredProcess& publisher);

  struct State {
    std::uint64_t published = 0, refused = 0, received = 0, wrong = 0, lost = 0;
    std::uint64_t watched = 0, low = 0, high = 0, watch_lost = 0;
    std::uint64_t largest_gap_ns = 0;  // between two messages of the stream at the subscriber
    std::string refusal;
  };
  /// Returns the state of both processes together.
  State state();
  /// Returns the daemon's counters.
  abi::wire::DaemonCounters counters();

 private:
  DaemonProcess daemon_;
  std::unique_ptr<SteeredProcess> subscriber_, publisher_;
  std::unique_ptr<AttackRow> row_;
  std::optional<AttackRow::Victim> victim_;
  std::uint64_t served_ = 0;
  bool judged_ = false;
};

/// An attacker's view of its test: shared words, and when to stop.
class Attack {
 public:
  using Word = std::atomic<std::uint64_t>;
  Attack(Word* words, int stop, int ready) : words_(words), stop_(stop), ready_(ready) {}
  /// Reports that the attack is under way.
  void ready();
  /// Returns true until the test calls end(). The attacker may check at any time.
  bool goes_on() const;
  /// Returns a word that the test reads.
  Word& word(std::size_t index) { return words_[index]; }

 private:
  Word* words_;
  int stop_, ready_;
};

class Attacker {
 public:
  explicit Attacker(std::function<void(Attack&)> body, uid_t uid = hostile_uid);
  ~Attacker();
  Attacker(const Attacker&) = delete;
  Attacker& operator=(const Attacker&) = delete;

  /// Returns false, and fails the test, when the attacker ended before.
  bool wait_until_ready();
  std::uint64_t word(std::size_t index) const { return words_[index].load(); }
  /// Sends a value to the running attacker.
  void set_word(std::size_t index, std::uint64_t value) { words_[index] = value; }
  pid_t pid() const noexcept { return child_->pid(); }
  /// Asks the attacker to stop and waits; a failure in it fails the test.
  void end();
  /// Sends SIGKILL, whatever the attacker is doing. A failure in it fails the test as well.
  void kill();

 private:
  static constexpr std::size_t word_count = 16;  // one more follows that counts its failures
  Attack::Word* words_;
  UniqueFd stop_, ready_;
  std::unique_ptr<Child> child_;
};

/// A seeded source of bytes; prints the seed, which AGNOCAST_SEED= repeats.
class Chance {
 public:
  explicit Chance(std::uint64_t seed);
  std::uint64_t operator()() { return engine_(); }
  std::uint64_t below(std::uint64_t end) { return engine_() % end; }
  /// Returns a value that breaks arithmetic more often than chance does.
  std::uint64_t nasty();

 private:
  std::mt19937_64 engine_;
};

/// Returns how long an attack lasts: AGNOCAST_ATTACK_SECONDS, 2 by default.
std::chrono::milliseconds attack_time();

}  // namespace agnocast::test
