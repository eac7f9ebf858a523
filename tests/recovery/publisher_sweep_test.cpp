// SPDX-License-Identifier: Apache-2.0
//
// Goal: a publisher may be killed at any crash point of publish, retire, free, growth, attach and
// detach; its committed messages arrive, no others do, and its queue is consistent after recovery.
// Method: a child process runs a script and is killed with SIGKILL at its n-th crash point, for
// n = 1, 2, 3 … until it survives. The parent is daemon and subscriber: it recovers, verifies,
// drains, and compares with what the publisher had acknowledged.

#include <tests/recovery/one_sided_script.hpp>
#include <tests/recovery/stage.hpp>

#include <algorithm>
#include <cstdio>
#include <ostream>
#include <string>

namespace agnocast::sweep {
namespace {

// Commands. Publisher (child): p publish · g grow, then publish · x scan · a attach · d detach ·
// e withdraw · i disregard · s serve again. Subscriber and daemon (parent): j subscribe and link ·
// t take · T take, must find a message · 0 take, must find none · r release · z sleep · w wake ·
// l leave · u unlink, subscription over.
const Script scripts[] = {
    {"volatile, everything read and released", {keep_last(1), keep_last(5)}, "japtrptrptrx"},
    {"volatile, held while more is published", {keep_last(1), keep_last(5)}, "japptptprrptrrx"},
    {"overrun of a shallow reader", {keep_last(1), keep_last(1)}, "japppptrpppxtrx"},
    {"overrun while held", {keep_last(2, true), keep_last(2, true)}, "japptpppprpptrx"},
    {"history for late joiners", {keep_last(3, true), keep_last(2, true)}, "pppppjapttrrpptrtrx"},
    {"growth", {keep_last(2), keep_last(4)}, "japtgtrrgptrtrx"},
    {"wait set is rung once", {keep_last(1), keep_last(3)}, "jazppwtrzpwtrtrx"},
    {"joins, leaves and joins again", {keep_last(1), keep_last(3)}, "ppjatptrludppjaptrx"},
    {"leaves while holding", {keep_last(1), keep_last(3)}, "jappttlpprrudppx"},
    {"keep-all",
     {{2, false, true, true, false}, {2, false, true, true, false}},
     "jappptrptrptrtrtrx"},
    {"deferred scans", {keep_last(1), keep_last(4), 2}, "japppptrtrpptrppptrtrx"},
    {"withdrawn while it holds, then served again",
     {keep_last(1), keep_last(3)},
     "japppttepp0pprrxspTrpTrx"},
    {"withdrawn asleep and unread, leaves", {keep_last(2), keep_last(2)}, "jappzepw0ludpjapTrx"},
    {"withdrawn before it is mapped, disregarded, served again",
     {keep_last(2), keep_last(2)},
     "pjppeppippaspTrpTrx"},
    {"nobody there", {keep_last(2, true), keep_last(1)}, "pppppx"},
    {"endpoint seen but not mapped yet", {keep_last(1), keep_last(2)}, "ppjpppaptrx"},
};

class PublisherSweep : public testing::TestWithParam<Script> {};

struct Totals {
  unsigned points = 0, untouched = 0, rolled_back = 0, rolled_forward = 0;
};

/// Runs the script with a death at crash point n (0 = none). Returns whether the child survived.
// Long because the commands of the child and those of its parent stand beside each other.
bool run(const Script& script, std::uint64_t n, Totals& totals) {
  Stage stage(script.setup);
  Child child(n, [&](int socket, std::uint64_t crash_at) {
    stage.restrict_child(Stage::Role::publisher);
    PublisherSide publisher(stage);
    std::uint64_t generation = 0;
    crash_points::arm(crash_at);
    serve(socket, [&](char what) -> char {
      switch (what) {
        case 'p':
        case 'g':
          return publisher.publish(what == 'g') == dataplane::PublishOutcome::published ? '+' : '-';
        case 'x':
          publisher.scan();
          return '+';
        case 'a':
          publisher.attach(++generation);
          return '+';
        case 'd':
          publisher.detach(generation);
          return '+';
        case 'e':  // the subscription may not be attached yet
          return publisher.withdraw(std::max(generation, std::uint64_t{1})) ? '+' : '-';
        case 'i':
          publisher.disregard(std::max(generation, std::uint64_t{1}));
          return '+';
        case 's':
          return publisher.serve_again(generation) ? '+' : '-';
        default:
          return '?';
      }
    });
  });

  auto subscriber = std::optional<SubscriberSide>(std::in_place, stage);
  std::uint64_t generation = 0, committed = 0, last = 0;
  std::uint64_t served_from = 0;  // earlier messages were for others
  bool linked = false, leaving = false, in_flight = false, alive = true;
  const auto take = [&] {
    std::uint64_t number = 0;
    const std::uint64_t before = subscriber->cursor();
    const std::uint64_t lost = subscriber->lost();
    switch (subscriber->take(&number)) {
      case SubscriberSide::Found::damaged:
        ADD_FAILURE() << "a damaged message";
        return false;
      case SubscriberSide::Found::nothing:
        return false;
      case SubscriberSide::Found::intact:
        break;
    }
    EXPECT_GT(number, last) << "a message arrived twice or out of order";
    last = number;
    const std::uint64_t head =
        abi::sequence_of(stage.words().head().load(std::memory_order_acquire));
    const std::uint64_t next = before + (subscriber->lost() - lost);
    for (std::uint64_t q = std::max(before, served_from); q < next; ++q) {
      EXPECT_GE(head, q + script.setup.requested.depth)
          << "a message was lost with fewer than D newer ones";
    }
    return true;
  };

  for (const char* at = script.commands; *at != '\0' && alive; ++at) {
    switch (*at) {
      case 'p':
      case 'g':
      case 'x':
      case 'a':
      case 'd':
      case 'e':
      case 'i':
      case 's': {
        const auto answer = child.command(*at);
        alive = answer.has_value();
        in_flight = !alive && (*at == 'p' || *at == 'g');
        if (alive && (*at == 'p' || *at == 'g') && *answer == '+') ++committed;
        if (*at == 'e' || *at == 's') {
          if (alive) {
            EXPECT_EQ(*answer, '+') << *at;
          }
          served_from = abi::sequence_of(stage.words().head().load(std::memory_order_acquire)) + 1;
        }
        break;
      }
      case 'j':
        subscriber.emplace(stage);
        stage.board_steps().add_subscription(
            0, ++generation, {script.setup.requested, 1, subscription_extent, 8, 0});
        EXPECT_TRUE(subscriber->link(false));
        last = subscriber->cursor() - 1 - Stage::first_sequence();
        linked = true;
        leaving = false;
        break;
      case 't':
        take();
        break;
      case 'T':
        EXPECT_TRUE(take());
        break;
      case '0':
        EXPECT_FALSE(take());
        break;
      case 'r':
        EXPECT_TRUE(subscriber->release()) << "a held message changed";
        break;
      case 'z':
        subscriber->arm();
        break;
      case 'w':
        subscriber->disarm();
        break;
      case 'l':
        stage.board_steps().set_subscription(0, generation, abi::BoardState::leaving);
        leaving = true;
        break;
      case 'u':
        subscriber->unlink();
        linked = false;
        stage.board_steps().set_subscription(0, generation, abi::BoardState::free);
        break;
      default:
        ADD_FAILURE() << "unknown command " << *at;
        return true;
    }
    if (alive) {
      EXPECT_EQ(stage.verify(), journal::Invariant::none)
          << sentence_of(stage.verify()) << " after " << *at;
    }
  }

  if (!alive) {
    ++totals.points;
    EXPECT_TRUE(child.was_killed()) << "the publisher did not die at its crash point";
    std::uint64_t final_head = 0;
    switch (journal::recover_queue(stage.words(), slot_count, final_head)) {
      case journal::IntentDecision::nothing:
        ++totals.untouched;
        break;
      case journal::IntentDecision::roll_back:
        ++totals.rolled_back;
        break;
      case journal::IntentDecision::roll_forward:
        ++totals.rolled_forward;
        break;
      case journal::IntentDecision::corrupt:
        ADD_FAILURE() << "an honest publisher left a corrupt intent";
        break;
    }
    stage.board_steps().orphan_publisher(0, Stage::publisher_generation, final_head);
    const std::uint64_t final_number = abi::sequence_of(final_head) - Stage::first_sequence();
    EXPECT_GE(final_number, committed) << "an acknowledged message was lost";
    EXPECT_LE(final_number, committed + (in_flight ? 1 : 0))
        << "more was committed than was published";
    // Recovery of recovery: nothing is left to do.
    std::uint64_t again = 0;
    EXPECT_EQ(journal::recover_queue(stage.words(), slot_count, again),
              journal::IntentDecision::nothing);
    EXPECT_EQ(again, final_head);
  }
  EXPECT_EQ(stage.verify(), journal::Invariant::none) << sentence_of(stage.verify());
  if (linked && !leaving) {
    subscriber->disarm();
    subscriber->observe_publisher();
    while (take()) {
    }
    if (!alive) {
      EXPECT_TRUE(subscriber->drained()) << "a committed message was not delivered";
    }
  }
  while (linked && subscriber->held_count() != 0)
    EXPECT_TRUE(subscriber->release()) << "a held message of a dead publisher changed";
  if (linked) subscriber->unlink();
  EXPECT_EQ(stage.verify(), journal::Invariant::none) << sentence_of(stage.verify());
  return alive;
}

TEST_P(PublisherSweep, SurvivesDeathAtEveryCrashPoint) {
  Totals totals;
  for (std::uint64_t n = 1;; ++n) {
    SCOPED_TRACE("death at crash point " + std::to_string(n));
    if (run(GetParam(), n, totals) || testing::Test::HasFailure()) break;
  }
  std::printf("%-40s %4u deaths: %3u nothing to do, %3u rolled back, %3u rolled forward\n",
              GetParam().name, totals.points, totals.untouched, totals.rolled_back,
              totals.rolled_forward);
  EXPECT_GT(totals.points, 20u) << "too few crash points were reached";
}

INSTANTIATE_TEST_SUITE_P(Scripts, PublisherSweep, testing::ValuesIn(scripts));

}  // namespace
}  // namespace agnocast::sweep
