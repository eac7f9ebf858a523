// SPDX-License-Identifier: Apache-2.0
//
// Goal: a subscriber may be killed at any crash point of link, take, release, sleep and unlink;
// its holds vanish, nothing leaks, the publisher notices nothing else, and the next subscription
// starts clean. Method: a child process runs a script and is killed at its n-th crash point, for
// n = 1, 2, 3 … until it survives. The parent is daemon and publisher.

#include <tests/recovery/one_sided_script.hpp>
#include <tests/recovery/stage.hpp>

#include <cstdio>
#include <ostream>
#include <string>

namespace agnocast::sweep {
namespace {

// Commands. Publisher and daemon (parent): p publish · g grow, then publish · x scan · a attach.
// Subscriber (child): L link from the start · l link late · t take · r release · z sleep ·
// w wake · u unlink.
const Script scripts[] = {
    {"link, take, release, unlink", {keep_last(1), keep_last(5)}, "Lapptrtru"},
    {"several held, released in between", {keep_last(1), keep_last(5)}, "Lapppttrprptrtrtru"},
    {"overrun: skips what it lost", {keep_last(1), keep_last(2)}, "Lapppppttrpppptrtrru"},
    {"overrun while holding", {keep_last(2, true), keep_last(1, true)}, "Laptppptrpprtru"},
    {"late joiner with history", {keep_last(3, true), keep_last(3, true)}, "pppplatttrrrptru"},
    {"growth", {keep_last(1), keep_last(5)}, "LaptgtrgtrrgtrU"},
    {"sleep and wake", {keep_last(1), keep_last(3)}, "LazpwtrzpwtrzU"},
    {"keep-all",
     {{2, false, true, true, false}, {2, false, true, true, false}},
     "Lapppttprrptrtru"},
    {"deferred scans", {keep_last(1), keep_last(3), 2}, "Lappptrpptrtrpptru"},
};

class SubscriberSweep : public testing::TestWithParam<Script> {};

// Long because the commands of the child and those of its parent stand beside each other.
bool run(const Script& script, std::uint64_t n, unsigned& points) {
  Stage stage(script.setup);
  PublisherSide publisher(stage);
  std::uint64_t generation = 1;
  stage.board_steps().add_subscription(0, generation,
                                       {script.setup.requested, 1, subscription_extent, 8, 0});
  Child child(n, [&](int socket, std::uint64_t crash_at) {
    stage.restrict_child(Stage::Role::subscriber);
    // The subscriber maps the heap by its frontier; the publisher's mapping, inherited by fork,
    // must not help.
    ::munmap(reinterpret_cast<void*>(stage.heap_base()), heap_bytes);
    SubscriberSide subscriber(stage);
    crash_points::arm(crash_at);
    serve(socket, [&](char what) -> char {
      using Found = SubscriberSide::Found;
      switch (what) {
        case 'L':
        case 'l':
          return subscriber.link(what == 'L') ? '+' : '-';
        case 't': {
          const Found found = subscriber.take();
          return found == Found::intact ? '+' : found == Found::nothing ? '0' : '!';
        }
        case 'r':
          return subscriber.release() ? '+' : '!';
        case 'z':
          subscriber.arm();
          return '+';
        case 'w':
          subscriber.disarm();
          return '+';
        case 'u':
        case 'U':
          while (subscriber.held_count() != 0) subscriber.release();
          subscriber.unlink();
          return '+';
        default:
          return '?';
      }
    });
  });

  bool alive = true;
  unsigned published = 0;
  const auto publish = [&](bool growing) {
    const auto outcome = publisher.publish(growing);
    EXPECT_NE(outcome, dataplane::PublishOutcome::no_slot);
    if (outcome == dataplane::PublishOutcome::published) ++published;
    return outcome;
  };
  for (const char* at = script.commands; *at != '\0' && alive; ++at) {
    switch (*at) {
      case 'p':
      case 'g':
        publish(*at == 'g');
        break;
      case 'x':
        publisher.scan();
        break;
      case 'a':
        publisher.attach(generation);
        break;
      default: {
        const auto answer = child.command(*at);
        alive = answer.has_value();
        if (alive) {
          EXPECT_TRUE(*answer == '+' || *answer == '0')
              << "command " << *at << " answered " << *answer;
        }
        break;
      }
    }
    if (alive) {
      EXPECT_EQ(stage.verify(), journal::Invariant::none)
          << sentence_of(stage.verify()) << " after " << *at;
    }
  }
  if (!alive) {
    ++points;
    EXPECT_TRUE(child.was_killed()) << "the subscriber did not die at its crash point";
    // The publisher does not know yet and is not blocked: a keep-all publisher reports it at once
    // instead of waiting.
    publish(false);
    stage.board_steps().set_subscription(0, generation, abi::BoardState::dead);
  } else {
    stage.board_steps().set_subscription(0, generation, abi::BoardState::free);
  }
  publisher.scan();
  publisher.scan();
  publisher.detach(generation);
  EXPECT_EQ(journal::verify_queue(stage.words(), Stage::first_sequence(), slot_count, true),
            journal::Invariant::none);
  const std::uint64_t history = script.setup.offered.transient_local
                                    ? std::min<std::uint64_t>(script.setup.offered.depth, published)
                                    : 0;
  EXPECT_EQ(publisher.allocated_count(), history)
      << "messages stay allocated that no subscription can take";

  // Another process reuses the index, in a new region as it would have.
  std::memset(stage.subscriber_region(), 0, region_bytes);
  stage.board_steps().add_subscription(0, ++generation,
                                       {script.setup.requested, 2, subscription_extent, 8, 0});
  SubscriberSide next(stage, true);
  EXPECT_TRUE(next.link(false));
  publisher.attach(generation);
  publish(false);
  unsigned received = 0;
  while (next.take() == SubscriberSide::Found::intact) {
    ++received;
    EXPECT_TRUE(next.release());
  }
  const bool with_history =
      script.setup.offered.transient_local && script.setup.requested.transient_local;
  EXPECT_EQ(received, with_history
                          ? std::min<std::uint64_t>({history + 1, script.setup.requested.depth})
                          : 1u);
  publisher.scan();
  EXPECT_EQ(stage.verify(), journal::Invariant::none) << sentence_of(stage.verify());
  return alive;
}

TEST_P(SubscriberSweep, SurvivesDeathAtEveryCrashPoint) {
  unsigned points = 0;
  for (std::uint64_t n = 1;; ++n) {
    SCOPED_TRACE("death at crash point " + std::to_string(n));
    if (run(GetParam(), n, points) || testing::Test::HasFailure()) break;
  }
  std::printf("%-40s %4u deaths\n", GetParam().name, points);
  EXPECT_GT(points, 10u) << "too few crash points were reached";
}

INSTANTIATE_TEST_SUITE_P(Scripts, SubscriberSweep, testing::ValuesIn(scripts));

}  // namespace
}  // namespace agnocast::sweep
