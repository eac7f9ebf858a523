// SPDX-License-Identifier: Apache-2.0
//
// Goal: whatever a client writes into all memory that it may write, its peers lose nothing, wait
// for nobody, and receive nothing that lies outside the liar's own windows.
// Method: an attacker of another user joins as any process does and then lies about one thing
// after the other, or writes random bytes over everything, for seconds; then it is killed in the
// middle. The attacker subscribes to the honest publisher's stream; the process of the honest
// subscriber takes the messages that the attacker publishes on another topic.

#include <tests/hostile/hostile_node.hpp>

#include <chrono>
#include <thread>

namespace agnocast::test {
namespace {

using wire::Kind;
using wire::Opcode;

// More than a publisher has slots: a publisher that gets no slot back cannot reach it.
// honest_helps_itself() stops the daemon, for as long as a slow machine takes.
constexpr const char* without_watchdog = "watchdog_seconds = \"off\"\n";
constexpr std::uint64_t every_slot = abi::slot_count_max + 100;

/// A publisher on the open topic, with the doorbell of the honest process that watches it.
struct LyingPublisher {
  explicit LyingPublisher(Stage& stage) : node(stage.socket_path()) {
    made = node.join(Kind::publisher, open_topic);
    auto about = node.announced();
    EXPECT_EQ(about.body.kind, Kind::subscription);
    if (about.fds.size() == 2) doorbell = Doorbell(std::move(about.fds[1]));
    base = node.open_window().base;
    bytes = node.open_window().bytes;
  }
  void commit(std::uint64_t address, std::uint64_t size = flat_bytes) {
    node.commit(made, address, size);
  }
  void ring() const { static_cast<void>(doorbell.ring()); }

  HostileNode node;
  wire::EndpointCreated made{};
  Doorbell doorbell;
  std::uint64_t base = 0, bytes = 0;
};

/// A subscription on the stream.
struct LyingSubscriber {
  explicit LyingSubscriber(Stage& stage, std::uint32_t depth = 1000, std::uint64_t quota = 64)
      : node(stage.socket_path()) {
    made = node.join(Kind::subscription, stream_topic, {depth, false, true, false, false}, quota);
    publisher = node.announced().body;
    link();
  }
  void link() {
    line().cursor().store(publisher.first_sequence + 1);
    line().publisher_generation().store(publisher.generation);
  }
  region::LinkWords<SharedMemory> line() const { return node.line(made, publisher.index); }

  HostileNode node;
  wire::EndpointCreated made{};
  wire::Announcement publisher{};
};

bool is_revoked(Stage& stage) {
  return stage.daemon().log().find("client revoked") != std::string::npos;
}

/// Runs the honest pair beside an attack for a while, then kills the attacker. Calls `first` when
/// the attack is under way.
void honest_goes_on_beside(Stage& stage, const std::function<void(Attack&)>& body,
                           const std::function<void()>& first = {}) {
  Attacker attacker(body);
  if (!attacker.wait_until_ready()) return;
  if (first) first();
  const auto end = std::chrono::steady_clock::now() + attack_time();
  do {
    stage.honest_goes_on();
    stage.honest_is_served();
  } while (std::chrono::steady_clock::now() < end && !testing::Test::HasFailure());
  attacker.kill();
  stage.honest_goes_on();
  stage.honest_is_served();
  EXPECT_TRUE(stage.daemon().wait_for_log("client gone"));
}

/// The honest publisher uses all its slots while the daemon is stopped: the daemon revokes a
/// process that holds more than its quota (daemon/death/hold_watch.hpp), and nobody may have to
/// wait for that.
void honest_helps_itself(Stage& stage) {
  // The publisher keeps every message for a subscriber until it has mapped it; the daemon
  // announces it.
  ASSERT_TRUE(stage.publisher().eventually("matched", "2"));
  const pid_t daemon = stage.daemon().pid();
  ASSERT_EQ(::kill(daemon, SIGSTOP), 0);
  EXPECT_FALSE(is_revoked(stage))
      << "the daemon revoked the attacker before the publisher withstood the attack";
  const std::uint64_t last = stage.state().published + every_slot;
  do {
    stage.honest_goes_on();
  } while (stage.state().published < last && !testing::Test::HasFailure());
  EXPECT_EQ(::kill(daemon, SIGCONT), 0);
}

// --- as a subscriber of the honest publisher

TEST(HostileLies, CursorsAheadBehindAndJumpingCostNobodyAMessage) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage({.daemon_keys = without_watchdog});
  Chance chance(1);
  honest_goes_on_beside(stage, [&](Attack& attack) {
    LyingSubscriber liar(stage);
    attack.ready();
    while (attack.goes_on()) liar.line().cursor().store(chance.nasty());
  });
}

TEST(HostileLies, LinksThatChangeOrNameOthersCostNobodyAMessage) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage({.daemon_keys = without_watchdog});
  Chance chance(2);
  honest_goes_on_beside(stage, [&](Attack& attack) {
    LyingSubscriber liar(stage);
    attack.ready();
    while (attack.goes_on()) {
      liar.line().publisher_generation().store(chance.below(2) == 0 ? liar.publisher.generation
                                                                    : chance.nasty());
      if (chance.below(4) == 0) liar.line().cursor().store(chance.nasty());
    }
  });
}

TEST(HostileLies, HoldsOnEverythingTakeNoSlotBeyondTheQuotaAndEndTheSession) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage({.daemon_keys = without_watchdog});
  honest_goes_on_beside(
      stage,
      [&](Attack& attack) {
        LyingSubscriber liar(stage);
        for (std::uint64_t word = 0; word < abi::slot_count_max / 64; ++word)
          liar.line().hold(word).store(~std::uint64_t{0});
        attack.ready();
        while (attack.goes_on()) std::this_thread::sleep_for(std::chrono::milliseconds(10));
      },
      [&] {
        honest_helps_itself(stage);
        // Six looks, one a second, once the daemon can look again.
        EXPECT_TRUE(stage.daemon().wait_for_log("client revoked") || is_revoked(stage));
      });
}

TEST(HostileLies, HoldsThatFlickerTakeNoSlotForLong) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage({.daemon_keys = without_watchdog});
  Chance chance(3);
  honest_goes_on_beside(
      stage,
      [&](Attack& attack) {
        LyingSubscriber liar(stage);
        attack.ready();
        while (attack.goes_on())
          liar.line().hold(chance.below(abi::slot_count_max / 64)).store(chance.nasty());
      },
      [&] { honest_helps_itself(stage); });
}

TEST(HostileLies, AGreedySubscriptionGetsWhatItsUserMayHoldAndNoMore) {
  AGNOCAST_NEEDS_TWO_USERS();
  // The pool has 245 messages.
  Stage stage({.more = "[limits]\nslots_per_publisher = 2048\nsubscriptions_per_topic = 768\n"});
  honest_goes_on_beside(
      stage,
      [&](Attack& attack) {
        // Half of the pool's rest beside the honest subscription, and one
        // (daemon/state/hold_pool.hpp).
        constexpr std::uint64_t most = 115;
        LyingSubscriber greedy(stage, 1000, most);
        HostileNode second(stage.socket_path());
        EXPECT_EQ(second.wire().open_wait_set().opcode(), Opcode::wait_set_opened);
        EXPECT_EQ(
            second.wire()
                .ask(Opcode::create_subscription, second.body_like(stream_topic, stream_topic, {}))
                .refused_code(),
            Errc::quota_exceeded)
            << "four more messages to hold";
        auto wanting = WireClient::endpoint("/any", {});
        wanting.quota = 400 - most + 1;
        EXPECT_EQ(second.wire().ask(Opcode::create_subscription, wanting).refused_code(),
                  Errc::quota_exceeded);
        // Holds all that it may, from now on for ever.
        for (std::uint64_t slot = 0; slot < most; ++slot)
          greedy.line().hold(slot / 64).fetch_or(std::uint64_t{1} << slot % 64);
        greedy.line().cursor().store(~std::uint64_t{0} >> 16);
        attack.ready();
        while (attack.goes_on()) std::this_thread::sleep_for(std::chrono::milliseconds(10));
      },
      [&] { honest_helps_itself(stage); });
  EXPECT_FALSE(is_revoked(stage)) << "the attacker stays within its quota";
}

TEST(HostileLies, SleepWordsThatAlwaysAskForARingCostADatagramEach) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage({.daemon_keys = without_watchdog});
  honest_goes_on_beside(stage, [&](Attack& attack) {
    LyingSubscriber liar(stage);
    attack.ready();
    for (std::uint64_t armed = 1; attack.goes_on(); armed += 2) liar.node.armed().store(armed);
  });
}

TEST(HostileLies, RandomBytesOverEverythingASubscriberMayWriteHarmNobody) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage({.daemon_keys = without_watchdog});
  Chance chance(4);
  honest_goes_on_beside(
      stage,
      [&](Attack& attack) {
        LyingSubscriber liar(stage);
        attack.ready();
        while (attack.goes_on()) {
          for (int i = 0; i < 1000; ++i) {
            const bool header = chance.below(4) == 0;
            const std::uint64_t at =
                header ? chance.below(abi::page_bytes / 8) * 8
                       : liar.made.extent + chance.below(abi::subscription_extent_bytes(1) / 8) * 8;
            liar.node.word(at).store(chance.nasty());
          }
          liar.link();  // or nobody would look any more
        }
      },
      [&] { honest_helps_itself(stage); });
}

// --- as a publisher to the honest subscriber

TEST(HostileLies, AddressesOutsideTheWindowAreHandedToNobody) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage({.daemon_keys = without_watchdog});
  Attacker attacker([&](Attack& attack) {
    LyingPublisher liar(stage);
    attack.word(0).store(liar.base);
    attack.word(1).store(liar.bytes);
    attack.ready();
    // A valid one comes first and last: the reader has checked all between.
    const std::uint64_t frontier = 1 << 20;
    const std::uint64_t wrong[][2] = {
        {0, flat_bytes},
        {8, flat_bytes},
        {~std::uint64_t{0} - 7, flat_bytes},
        {~std::uint64_t{0} - flat_bytes + 1, flat_bytes},
        {liar.base - flat_bytes, flat_bytes},
        {liar.base - 8, flat_bytes},
        {liar.base + frontier, flat_bytes},
        {liar.base + frontier - flat_bytes + 8, flat_bytes},
        {liar.base + liar.bytes - flat_bytes, flat_bytes},  // beyond the frontier
        {liar.base + liar.bytes, flat_bytes},
        {liar.base + 1, flat_bytes},  // misaligned
        {liar.base + 4, flat_bytes},
        {liar.base, 0},
        {liar.base, flat_bytes - 1},
        {liar.base, flat_bytes + 1},
        {liar.base, ~std::uint64_t{0}},
        {liar.base + 64, ~std::uint64_t{0} - liar.base - 32},  // the sum wraps
        {reinterpret_cast<std::uint64_t>(&frontier), flat_bytes},
        {reinterpret_cast<std::uint64_t>(liar.node.region()), flat_bytes},
        {liar.node.welcome().arena_base, flat_bytes},  // the window of the honest publisher
    };
    for (int round = 0; round < 20; ++round) {
      liar.commit(liar.base);
      for (const auto& [address, size] : wrong) liar.commit(address, size);
      liar.commit(liar.base + frontier - flat_bytes);
      liar.ring();
      std::this_thread::sleep_for(std::chrono::milliseconds(10));
    }
    attack.word(2).store(20 * 2);
    attack.word(3).store(20 * std::size(wrong));
  });
  ASSERT_TRUE(attacker.wait_until_ready());
  attacker.end();
  EXPECT_TRUE(eventually([&] { return stage.state().watched >= attacker.word(2); }));
  stage.honest_goes_on();
  const auto state = stage.state();
  EXPECT_EQ(state.watched, attacker.word(2)) << "the reader takes exactly the valid messages";
  EXPECT_EQ(state.watch_lost, attacker.word(3));
  EXPECT_EQ(state.low, attacker.word(0));
  EXPECT_EQ(state.high, attacker.word(0) + (1 << 20));
}

TEST(HostileLies, FrontiersBeyondTheWindowOpenNothingBehindIt) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage({.daemon_keys = without_watchdog});
  Chance chance(5);
  Attacker attacker([&](Attack& attack) {
    LyingPublisher liar(stage);
    attack.word(0).store(liar.base);
    attack.word(1).store(liar.bytes);
    attack.ready();
    while (attack.goes_on()) {
      for (int i = 0; i < 50; ++i) {
        const std::uint64_t window = chance.below(abi::window_count_max);
        liar.node.frontier(window).store(chance.nasty());
        // Claims windows that it was never given, over those of others.
        const std::uint64_t entry = 128 + window * sizeof(abi::WindowEntry);
        if (window != 0 && chance.below(4) == 0) {
          liar.node.word(entry).store(chance.below(2) == 0 ? liar.node.welcome().arena_base
                                                           : chance.nasty());
          liar.node.word(entry + 8).store(chance.nasty());
        }
        // In its own window, beyond it, in the next one, anywhere.
        const std::uint64_t offset = chance.below(4) == 0 ? chance.nasty() & ~std::uint64_t{7}
                                                          : chance.below(2 * liar.bytes / 8) * 8;
        liar.commit(liar.base + offset);
      }
      liar.ring();
      ++attack.word(2);
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }
  });
  ASSERT_TRUE(attacker.wait_until_ready());
  stage.honest_goes_on();
  EXPECT_TRUE(eventually([&] { return attacker.word(2) > 100; }));
  attacker.kill();
  stage.honest_goes_on();
  const auto state = stage.state();
  EXPECT_GE(state.low, attacker.word(0));
  EXPECT_LE(state.high, state.watched == 0 ? 0 : attacker.word(0) + attacker.word(1));
}

TEST(HostileLies, ASequenceThatJumpsOrWrapsCostsTheLiarAlone) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage({.daemon_keys = without_watchdog});
  honest_goes_on_beside(stage, [&](Attack& attack) {
    LyingPublisher liar(stage);
    const auto queue = liar.node.queue(liar.made);
    attack.ready();
    const std::uint64_t jumps[] = {1,
                                   2,
                                   1023,
                                   1024,
                                   1025,
                                   4096,
                                   std::uint64_t{1} << 32,
                                   std::uint64_t{1} << 40,
                                   std::uint64_t{1} << 46};
    while (attack.goes_on()) {
      for (const std::uint64_t jump : jumps) {
        const std::uint64_t head = abi::sequence_of(queue.head().load()) + jump;
        queue.head().store(abi::pack_entry(head, head % liar.made.slot_count));
        liar.commit(liar.base);
        liar.ring();
      }
      // The last possible sequence, slots that do not exist, and back to the beginning.
      queue.head().store(~std::uint64_t{0});
      liar.ring();
      queue.head().store(abi::pack_entry((std::uint64_t{1} << 48) - 1, 0));
      liar.commit(liar.base);
      liar.ring();
      queue.head().store(0);
      liar.ring();
      queue.head().store(abi::pack_entry(liar.made.first_sequence, 0xffff));
      liar.ring();
      queue.head().store(abi::pack_entry(liar.made.first_sequence, 0));
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }
  });
}

TEST(HostileLies, RandomBytesOverEverythingAPublisherMayWriteHarmNobody) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage({.daemon_keys = without_watchdog});
  Chance chance(6);
  std::uint64_t base = 0, bytes = 0;
  {
    Attacker attacker([&](Attack& attack) {
      LyingPublisher liar(stage);
      attack.word(0).store(liar.base);
      attack.word(1).store(liar.bytes);
      attack.ready();
      // A reader never takes from a queue that was garbage before it linked.
      while (attack.goes_on() && attack.word(3).load() == 0) {
        liar.commit(liar.base);
        liar.ring();
        std::this_thread::sleep_for(std::chrono::milliseconds(1));
      }
      while (attack.goes_on()) {
        for (int i = 0; i < 200; ++i) {
          switch (chance.below(4)) {
            case 0:
              liar.node.word(chance.below(abi::page_bytes / 8) * 8).store(chance.nasty());
              break;
            case 1:
              SharedMemory::word(liar.node.heap(), chance.below((1 << 20) / 8) * 8)
                  .store(chance.nasty());
              break;
            default:
              liar.node.word(liar.made.extent + chance.below(abi::publisher_extent_bytes / 8) * 8)
                  .store(chance.nasty());
              break;
          }
        }
        // Good enough now and then that a message of it is taken, while all the rest is garbage.
        liar.node.frontier().store(1 << 20);
        liar.node.queue(liar.made).head().store(
            abi::pack_entry(liar.made.first_sequence + attack.word(2).load() % 100, 0));
        for (std::uint64_t i = 0; i < 10; ++i)
          liar.commit(liar.base + chance.below((1 << 20) / 8 - 16) * 8);
        liar.ring();
        ++attack.word(2);
      }
    });
    ASSERT_TRUE(attacker.wait_until_ready());
    EXPECT_TRUE(eventually([&] { return stage.state().watched > 0; }));
    attacker.set_word(3, 1);
    const auto end = std::chrono::steady_clock::now() + attack_time();
    do {
      stage.honest_goes_on();
      stage.honest_is_served();
    } while (std::chrono::steady_clock::now() < end && !HasFailure());
    base = attacker.word(0);
    bytes = attacker.word(1);
    attacker.kill();
  }
  EXPECT_TRUE(stage.daemon().wait_for_log("client gone"));
  stage.honest_goes_on();
  const auto state = stage.state();
  EXPECT_GE(state.low, base);
  EXPECT_LE(state.high, base + bytes);
}

// --- at its death

TEST(HostileLies, AnIntentThatIsGarbageIsCountedAndNothingElseIsTouched) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage({.daemon_keys = without_watchdog});
  // operation, sequence relative to head, slot
  const std::uint64_t intents[][3] = {
      {2, 0, 0},  // unknown operation
      {~std::uint64_t{0}, 1, 0},
      {abi::intent_publish, 2, 0},  // neither committed nor the next
      {abi::intent_publish, ~std::uint64_t{0}, 0},
      {abi::intent_publish, std::uint64_t{1} << 40, 0},
      {abi::intent_publish, 1, abi::slot_count_max},  // no such slot
      {abi::intent_publish, 1, ~std::uint64_t{0}},
      {abi::intent_publish, 1, std::uint64_t{1} << 59},  // times 32 wraps
  };
  std::uint64_t expected = 0;
  for (const auto& [op, sequence, slot] : intents) {
    SCOPED_TRACE(testing::Message() << op << " " << sequence << " " << slot);
    const std::uint64_t seen_before = stage.state().watched;
    Attacker attacker([&, op = op, sequence = sequence, slot = slot](Attack& attack) {
      LyingPublisher liar(stage);
      // A second publisher of the same process, whose last messages nobody has taken yet.
      const auto other = liar.node.join(Kind::publisher, open_topic);
      liar.node.announced();
      const auto queue = liar.node.queue(liar.made);
      const std::uint64_t head = abi::sequence_of(queue.head().load());
      queue.intent_sequence().store(head + sequence);
      queue.intent_slot().store(slot);
      queue.intent_op().store(op);
      for (std::uint64_t i = 0; i < 5; ++i)
        liar.node.commit(other, liar.base + i * 128, flat_bytes);
      attack.ready();
      for (;;) ::pause();
    });
    ASSERT_TRUE(attacker.wait_until_ready());
    attacker.kill();
    ++expected;
    EXPECT_TRUE(eventually([&] { return stage.counters().intents_corrupt == expected; }));
    EXPECT_TRUE(eventually([&] { return stage.state().watched == seen_before + 5; }))
        << "the reader receives the other publisher's committed messages";
    stage.honest_goes_on();
  }
}

}  // namespace
}  // namespace agnocast::test
