// SPDX-License-Identifier: Apache-2.0
//
// Goal: whatever a peer writes, the data plane stays inside its own arrays, ends its loops,
// returns no message outside the announced window, and an honest endpoint beside the liar loses
// nothing. History never counts as news. Also: the table of recovery decisions, row by row.
// Method: seeded random garbage in the publisher's queue while an honest subscription takes;
// seeded garbage in a subscription's lines while an honest publisher publishes to it and to an
// honest one; a publisher that commits between any two loads of a subscription.

#include <tests/unit/dataplane/dataplane_pair.hpp>

namespace agnocast::dataplane {
namespace {

TEST(Dataplane, TakesOnlyFromTheAnnouncedWindowWhateverThePublisherWrites) {
  std::uint64_t taken = 0, malformed = 0;
  for (std::uint64_t seed = 1; seed <= 200; ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    std::mt19937_64 random(seed);
    Pair pair;
    journal::BoardSteps<M>(pair.topic()).add_subscription(0, 1, {pair.requested, 1, extent, 8, 0});
    LinkCore<M> link = pair.link(0);
    ASSERT_TRUE(link.link(true));
    NumberWindow window;
    for (int round = 0; round < 50; ++round) {
      for (int i = 0; i < 40; ++i) {
        const std::uint64_t sequence = link.cursor() + random() % 4;
        switch (random() % 6) {
          case 0:
            pair.words().head().store(
                random() % 2 == 0 ? nasty(random) : abi::pack_entry(sequence, random() % 100));
            break;
          case 1:
            pair.words().order(sequence).store(
                random() % 2 == 0 ? nasty(random) : abi::pack_entry(sequence, random() % 100));
            break;
          case 2:
            pair.words()
                .slot_id(random() % 100)
                .store(random() % 2 == 0 ? nasty(random) : sequence);
            break;
          case 3:
            pair.words()
                .slot_address(random() % 100)
                .store(random() % 2 == 0 ? nasty(random)
                                         : (0xfff00 + random() % 0x100400) & ~std::uint64_t{7});
            break;
          case 4:
            pair.words()
                .slot_size(random() % 100)
                .store(random() % 2 == 0 ? nasty(random) : random() % 0x2000);
            break;
          default:
            pair.words().slot_stamp(random() % 100).store(nasty(random));
            break;
        }
      }
      if (random() % 2 == 0) {  // an entry that is right except for its address
        const std::uint64_t sequence = link.cursor();
        const std::uint64_t slot = random() % 64;
        pair.words().slot_address(slot).store(random() % 2 == 0 ? nasty(random)
                                                                : (0xfff00 + random() % 0x100400) &
                                                                      ~std::uint64_t{7});
        pair.words().slot_size(slot).store(random() % 2 == 0 ? nasty(random) : random() % 0x2000);
        pair.words().slot_id(slot).store(sequence);
        pair.words().order(sequence).store(abi::pack_entry(sequence, slot));
        pair.words().head().store(abi::pack_entry(sequence, slot));
      }
      if (const auto found = link.take(window)) {
        ++taken;
        ASSERT_TRUE(window.contains(found->address, found->size));
        ASSERT_LT(found->slot, abi::slot_count_max);
        link.release(found->slot);
      }
      (void)link.has_news();
    }
    malformed += link.malformed();
  }
  std::printf("a lying publisher: %llu taken, %llu refused as malformed\n",
              static_cast<unsigned long long>(taken), static_cast<unsigned long long>(malformed));
  EXPECT_GT(taken, 100u) << "too little of the garbage was valid enough to be taken";
  EXPECT_GT(malformed, 10u);
}

TEST(Dataplane, AnHonestSubscriptionLosesNothingBesideALyingOne) {
  for (std::uint64_t seed = 1; seed <= 100; ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    std::mt19937_64 random(seed);
    Pair pair;
    auto publisher = std::make_unique<PublisherCore<M>>(PublisherCore<M>::Identity{
        pair.topic(), pair.words(), 0, generation, Pair::first(), pair.offered, 64, 0});
    Freed environment;
    for (std::uint64_t s = 0; s < 2; ++s) {
      journal::BoardSteps<M>(pair.topic())
          .add_subscription(s, s + 1, {pair.requested, s, extent, 8, 0});
      publisher->attach(s, s + 1, pair.subscriber[s].base(), extent,
                        offsetof(abi::ClientRegionHeader, wait_set), s, environment);
    }
    LinkCore<M> honest = pair.link(0);
    ASSERT_TRUE(honest.link(true));
    NumberWindow window;
    std::uint64_t next = 1;
    for (std::uint64_t number = 1; number <= 300; ++number) {
      for (int i = 0; i < 4; ++i) {
        switch (random() % 4) {
          case 0:
            pair.line(1).publisher_generation().store(random() % 2 == 0 ? generation
                                                                        : nasty(random));
            break;
          case 1:
            pair.line(1).cursor().store(nasty(random));
            break;
          case 2:
            pair.line(1).hold(0).store(nasty(random));
            break;
          default:
            M::word(pair.subscriber[1].base(), offsetof(abi::ClientRegionHeader, wait_set))
                .store(nasty(random));
            break;
        }
      }
      const std::uint64_t address = window.base + number * 16;
      environment.live.insert(address);
      ASSERT_EQ(publisher->publish({address, 16, number}, environment), PublishOutcome::published);
      if (random() % 3 == 0) {
        while (const auto found = honest.take(window)) {
          ASSERT_EQ(found->address, window.base + next * 16)
              << "the honest subscription got a wrong message";
          ASSERT_TRUE(environment.live.count(found->address)) << "take() returned a freed message";
          ++next;
          honest.release(found->slot);
        }
      } else if (number - next >= 7) {
        while (const auto found = honest.take(window)) {
          next = (found->address - window.base) / 16 + 1;
          honest.release(found->slot);
        }
      }
    }
    EXPECT_EQ(honest.lost(), 0u);
    EXPECT_EQ(honest.malformed(), 0u);
  }
}

/// Shared memory that runs a function before each load of a thread that reads by this policy.
struct Interrupted : SharedMemory {
  static inline std::function<void()> before_load;
  static inline const abi::SharedWord* loaded = nullptr;  // the word to be loaded
  struct Word {
    abi::SharedWord& word;
    std::uint64_t load(std::memory_order order) const {
      loaded = &word;
      before_load();
      return word.load(order);
    }
    void store(std::uint64_t value, std::memory_order order) const { word.store(value, order); }
    std::uint64_t fetch_or(std::uint64_t bits, std::memory_order order) const {
      return word.fetch_or(bits, order);
    }
    std::uint64_t fetch_and(std::uint64_t bits, std::memory_order order) const {
      return word.fetch_and(bits, order);
    }
  };
  static Word word(Region region, std::uint64_t offset) noexcept {
    return {SharedMemory::word(region, offset)};
  }
};

/// A publisher of 200 slots with one linked reader, which is interrupted before each of its loads.
struct InterruptedPublisher : Pair {
  explicit InterruptedPublisher(std::uint64_t quota) {
    offered.depth = requested.depth = 150;
    journal::BoardSteps<M>(topic()).add_subscription(0, 1, {requested, 1, extent, quota, 0});
    Interrupted::before_load = [] {};
    core = std::make_unique<PublisherCore<Interrupted>>(PublisherCore<Interrupted>::Identity{
        {board.base(), 0}, {publisher.base(), extent}, 0, generation, first(), offered, 200, 0});
    core->attach(0, 1, subscriber[0].base(), extent, offsetof(abi::ClientRegionHeader, wait_set), 0,
                 environment);
    reader = std::make_unique<LinkCore<M>>(link(0));
    EXPECT_TRUE(reader->link(true));
  }
  ~InterruptedPublisher() {
    Interrupted::before_load = [] {};
  }
  PublishOutcome publish() {
    const std::uint64_t address = window.base + ++number * 16;
    environment.live.insert(address);
    return core->publish({address, 16, number}, environment);
  }
  Freed environment;
  NumberWindow window;
  std::unique_ptr<PublisherCore<Interrupted>> core;
  std::unique_ptr<LinkCore<M>> reader;
  std::uint64_t number = 0;
};

TEST(Dataplane, HistoryThatArrivesDuringALookIsNoNews) {
  constexpr std::uint64_t history = 60;
  for (const std::uint64_t depth : {1u, 100u}) {
    SCOPED_TRACE("depth " + std::to_string(depth));
    Pair pair;
    pair.offered = {static_cast<std::uint32_t>(history), true, true, false, false};
    pair.requested = {static_cast<std::uint32_t>(depth), true, true, false, false};
    auto publisher = std::make_unique<PublisherCore<M>>(PublisherCore<M>::Identity{
        pair.topic(), pair.words(), 0, generation, Pair::first(), pair.offered, 64, 0});
    Freed environment;
    NumberWindow window;
    const auto publish = [&] {
      const std::uint64_t next = publisher->head_sequence() - Pair::first() + 1;
      const std::uint64_t address = window.base + next * 16;
      environment.live.insert(address);
      ASSERT_EQ(publisher->publish({address, 16, next}, environment), PublishOutcome::published);
    };
    Interrupted::before_load = [&] {
      const std::uint64_t head = publisher->head_sequence();
      if (head >= Pair::first() + history) return;
      pair.words().inherited().store(head + 1);
      publish();
    };
    LinkCore<Interrupted> link({{pair.board.base(), 0},
                                {pair.publisher.base(), extent},
                                {pair.subscriber[0].base(), extent, 0},
                                0,
                                generation,
                                Pair::first(),
                                pair.offered,
                                pair.requested,
                                0,
                                8});
    link.want_history(0);
    ASSERT_TRUE(link.link(true));
    while (publisher->head_sequence() != Pair::first() + history) {
      EXPECT_FALSE(link.take(window));
      EXPECT_EQ(link.unread(), 0u);
      link.skip();
    }
    EXPECT_FALSE(link.take(window));
    EXPECT_EQ(link.lost(), 0u);
    publish();
    EXPECT_EQ(link.unread(), 1u);
    const auto news = link.take(window);
    ASSERT_TRUE(news);
    EXPECT_EQ(news->sequence, Pair::first() + history + 1);
  }
}

// A scan reads the reader's holds in several words, while the reader continues.
TEST(Dataplane, AReaderAtItsQuotaIsNotMistakenForOneAboveIt) {
  constexpr std::uint64_t quota = 3;
  std::uint64_t taken = 0;
  for (std::uint64_t seed = 1; seed <= 20; ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    std::mt19937_64 random(seed);
    InterruptedPublisher publisher(quota);
    LinkCore<M>& reader = *publisher.reader;
    std::vector<std::uint64_t> held;
    bool is_busy = false;
    // Skipping messages puts the next hold into another word: a scan may see old and new hold.
    Interrupted::before_load = [&] {
      is_busy = reader.unread() >= (is_busy ? 10u : 140u);
      if (!is_busy || random() % 2 == 0) return;
      if (held.size() == quota) {
        const auto one = held.begin() + static_cast<std::ptrdiff_t>(random() % held.size());
        reader.release(*one);
        held.erase(one);
      }
      for (std::uint64_t passed_over = random() % 50; passed_over > 0; --passed_over) {
        if (const auto found = reader.take(publisher.window)) reader.release(found->slot);
      }
      if (const auto found = reader.take(publisher.window)) {
        held.push_back(found->slot);
        ++taken;
      }
    };
    for (int message = 1; message <= 5000; ++message) {
      ASSERT_EQ(publisher.publish(), PublishOutcome::published);
      ASSERT_EQ(publisher.core->withdrawal(0, 1), abi::Withdrawal::none) << "message " << message;
    }
  }
  EXPECT_GT(taken, 1000u) << "the publisher saw too few changes";
}

// The worst case of an honest reader: one bit more than its quota in two looks of a scan.
TEST(Dataplane, ABitThatATakeUndoesIsNotMistakenForAHold) {
  InterruptedPublisher publisher(2);
  for (int message = 1; message <= 140; ++message)
    ASSERT_EQ(publisher.publish(), PublishOutcome::published);
  // The hold words as loaded, one look at three words per line: messages a and b of the first
  // word, c of the second, d of the third. A take, begun before the scan, aims at the earlier
  // message in the slot of c.
  constexpr std::uint64_t a = 2, b = 4, c = 8, d = 16;
  const std::uint64_t history[][3] = {
      {a | b, c, 0},  // a is released; the late take sets the bit of c
      {b, c, d},      // which it undoes; d is taken
      {b, c, d},      // b is released; c is taken
      {0, c, d},     {0, c, d},
  };
  std::size_t visits = 0;
  Interrupted::before_load = [&] {
    for (std::size_t word = 0; word < 3; ++word) {
      if (Interrupted::loaded != &publisher.line(0).hold(word)) continue;
      ASSERT_LT(visits / 3, std::size(history));
      ASSERT_EQ(visits % 3, word);
      publisher.line(0).hold(word).store(history[visits++ / 3][word]);
    }
  };
  publisher.core->scan(publisher.environment);
  EXPECT_EQ(publisher.core->withdrawal(0, 1), abi::Withdrawal::none);
  EXPECT_GT(visits, 3u) << "the publisher did not look twice";
}

// However late, they return only live messages; a take that comes too late looks again.
TEST(Dataplane, TakesAfterOneLookBehaveLikeSlowTakes) {
  for (std::uint64_t meanwhile = 0; meanwhile < 20; ++meanwhile) {
    SCOPED_TRACE("published between the second take and the third: " + std::to_string(meanwhile));
    Pair pair;  // the subscription has room for 8
    journal::BoardSteps<M>(pair.topic()).add_subscription(0, 1, {pair.requested, 1, extent, 64, 0});
    auto publisher = std::make_unique<PublisherCore<M>>(PublisherCore<M>::Identity{
        pair.topic(), pair.words(), 0, generation, Pair::first(), pair.offered, 64, 0});
    Freed environment;
    publisher->attach(0, 1, pair.subscriber[0].base(), extent,
                      offsetof(abi::ClientRegionHeader, wait_set), 0, environment);
    LinkCore<M> link = pair.link(0);
    ASSERT_TRUE(link.link(true));
    NumberWindow window;
    std::uint64_t number = 0;
    const auto publish = [&](std::uint64_t count) {
      while (count-- > 0) {
        const std::uint64_t address = window.base + ++number * 16;
        environment.live.insert(address);
        ASSERT_EQ(publisher->publish({address, 16, number}, environment),
                  PublishOutcome::published);
      }
    };
    publish(5);
    std::uint64_t head = link.look();
    std::set<std::uint64_t> taken;
    const auto take = [&](LinkCore<M>& from) {
      const auto found = from.take(window, head);
      if (!found) return false;
      EXPECT_TRUE(environment.live.count(found->address)) << "take() returned a freed message";
      EXPECT_TRUE(taken.empty() || *taken.rbegin() < found->sequence) << "out of order";
      taken.insert(found->sequence);
      return true;
    };
    EXPECT_TRUE(take(link) && take(link));
    publish(meanwhile);
    while (link.has_news(head))
      EXPECT_TRUE(take(link)) << "take() must return the news of that look";
    const bool is_overrun = 3 + meanwhile > 8;
    EXPECT_EQ(taken.size(), is_overrun ? 2u + 8 : 5u);
    EXPECT_EQ(link.lost(), is_overrun ? 3 + meanwhile - 8 : 0);
    EXPECT_EQ(link.has_news(), !is_overrun && meanwhile > 0);
    head = link.look();
    while (link.has_news(head)) EXPECT_TRUE(take(link));
    EXPECT_EQ(taken.size() + link.lost(), number);
  }
}

TEST(Dataplane, APublisherDoesNotWaitForASubscriptionThatIgnoresItsProcess) {
  const abi::Qos offered{2, false, true, true, false}, requested{2, false, true, true, true};
  for (const std::uint64_t client : {0u, 1u}) {
    Pair pair;
    journal::BoardSteps<M>(pair.topic()).add_subscription(0, 1, {requested, client, extent, 8, 0});
    auto publisher = std::make_unique<PublisherCore<M>>(PublisherCore<M>::Identity{
        pair.topic(), pair.words(), 0, generation, Pair::first(), offered, 64, 0, 0});
    Freed environment;
    PublishOutcome outcome = PublishOutcome::published;
    for (std::uint64_t at = 16; at <= 160 && outcome == PublishOutcome::published; at += 16)
      outcome = publisher->publish({*environment.live.insert(at).first, 16, at}, environment);
    EXPECT_EQ(outcome, client == 0 ? PublishOutcome::published : PublishOutcome::would_block);
  }
}

TEST(Dataplane, EverySlotOfAFullQueueCanBeHeldThenPublishFails) {
  // Publisher index 7: its link line and its far hold words are not the first ones.
  constexpr std::uint64_t index = 7;
  Pair pair;
  Region wide(std::uint64_t{1} << 20), queue(std::uint64_t{1} << 18);
  const region::PublisherWords<M> words{queue.base(), extent};
  words.head().store(abi::pack_entry(Pair::first(), 0));
  const abi::Qos offered{1, false, true, false, false};
  const abi::Qos requested{1000, false, true, false, false};
  journal::BoardSteps<M>(pair.topic())
      .add_publisher(index, generation, {offered, 0, extent, abi::slot_count_max});
  journal::BoardSteps<M>(pair.topic()).add_subscription(0, 1, {requested, 1, extent, 4096, 0});
  auto publisher = std::make_unique<PublisherCore<M>>(PublisherCore<M>::Identity{
      pair.topic(), words, index, generation, Pair::first(), offered, abi::slot_count_max, 0});
  Freed environment;
  publisher->attach(0, 1, wide.base(), extent, offsetof(abi::ClientRegionHeader, wait_set), 0,
                    environment);
  LinkCore<M> link({pair.topic(),
                    words,
                    {wide.base(), extent, index},
                    index,
                    generation,
                    Pair::first(),
                    offered,
                    requested,
                    16,
                    16});
  ASSERT_TRUE(link.link(true));
  NumberWindow window;
  std::set<std::uint64_t> held;
  std::uint64_t number = 0;
  for (;;) {
    const std::uint64_t address = window.base + ++number * 16;
    environment.live.insert(address);
    if (publisher->publish({address, 16, number}, environment) == PublishOutcome::no_slot) {
      environment.live.erase(address);
      break;
    }
    const auto taken = link.take(window);
    ASSERT_TRUE(taken);
    ASSERT_EQ(taken->address, address);
    ASSERT_TRUE(held.insert(taken->slot).second) << "a held slot was reused";
  }
  EXPECT_EQ(held.size(), abi::slot_count_max) << "every slot can be held, including the far ones";
  EXPECT_EQ(environment.live.size(), abi::slot_count_max);
  for (const std::uint64_t slot : held) link.release(slot);
  publisher->scan(environment);
  EXPECT_EQ(publisher->allocated_count(), 0u);
  EXPECT_TRUE(environment.live.empty());
}

struct DeferringPublisher : Pair {
  static constexpr std::uint64_t deferred_limit = 7;
  explicit DeferringPublisher(std::uint64_t slots) : queue(std::uint64_t{1} << 18) {
    const region::PublisherWords<M> own{queue.base(), extent};
    own.head().store(abi::pack_entry(first(), 0));
    journal::BoardSteps<M>(topic()).add_publisher(0, generation, {offered, 0, extent, slots});
    core = std::make_unique<PublisherCore<M>>(PublisherCore<M>::Identity{
        topic(), own, 0, generation, first(), offered, slots, deferred_limit});
  }
  PublishOutcome publish(std::uint64_t bytes) {
    const std::uint64_t address = 0x100000 + ++number * 16;
    environment.live.insert(address);
    const PublishOutcome outcome = core->publish({address, 16, number, bytes}, environment);
    if (outcome != PublishOutcome::published) environment.live.erase(address);
    return outcome;
  }
  Region queue;
  std::unique_ptr<PublisherCore<M>> core;
  Freed environment;
  std::uint64_t number = 0;
};

// No subscription reads, so a full scan frees everything.
TEST(Dataplane, DefersScansOnlyForSmallMessages) {
  DeferringPublisher publisher(64);
  for (std::uint64_t i = 1; i <= DeferringPublisher::deferred_limit; ++i) {
    ASSERT_EQ(publisher.publish(64), PublishOutcome::published);
    EXPECT_EQ(publisher.environment.live.size(), i);
  }
  ASSERT_EQ(publisher.publish(64), PublishOutcome::published);
  EXPECT_TRUE(publisher.environment.live.empty()) << "this publish must scan";
  ASSERT_EQ(publisher.publish(PublisherCore<M>::kept_back_max), PublishOutcome::published);
  EXPECT_EQ(publisher.environment.live.size(), 1u);
  ASSERT_EQ(publisher.publish(64), PublishOutcome::published);
  EXPECT_TRUE(publisher.environment.live.empty())
      << "together they are too large to defer the scan";
  ASSERT_EQ(publisher.publish(PublisherCore<M>::kept_back_max + 1), PublishOutcome::published);
  EXPECT_TRUE(publisher.environment.live.empty());
}

TEST(Dataplane, LeavesTheScanForALargeMessageToAnotherThreadOnce) {
  struct HandsOver : Freed {
    bool scans_soon() const noexcept { return is_coming; }
    bool is_coming = true;
  };
  DeferringPublisher publisher(64);
  HandsOver environment;
  const auto publish = [&] {
    const std::uint64_t address = 0x100000 + ++publisher.number * 16;
    environment.live.insert(address);
    return publisher.core->publish(
        {address, 16, publisher.number, PublisherCore<M>::kept_back_max + 1}, environment);
  };
  ASSERT_EQ(publish(), PublishOutcome::published);
  EXPECT_EQ(environment.live.size(), 1u);
  ASSERT_EQ(publish(), PublishOutcome::published);
  EXPECT_TRUE(environment.live.empty()) << "no other scan came in between";
  ASSERT_EQ(publish(), PublishOutcome::published);
  EXPECT_EQ(environment.live.size(), 1u);
  publisher.core->scan(environment);
  EXPECT_TRUE(environment.live.empty()) << "the scan of the other thread";
  ASSERT_EQ(publish(), PublishOutcome::published);
  EXPECT_EQ(environment.live.size(), 1u) << "the next scan may be left again";
  environment.is_coming = false;
  ASSERT_EQ(publish(), PublishOutcome::published);
  EXPECT_TRUE(environment.live.empty());
}

TEST(Dataplane, DeferredScansRefuseNothingWhereSlotsAreFew) {
  constexpr std::uint64_t depth = 8;
  DeferringPublisher publisher(depth + 2);
  Region reader(std::uint64_t{1} << 20);
  publisher.requested.depth = depth;
  journal::BoardSteps<M>(publisher.topic())
      .add_subscription(0, 1, {publisher.requested, 1, extent, 8, 0});
  publisher.core->attach(0, 1, reader.base(), extent, offsetof(abi::ClientRegionHeader, wait_set),
                         0, publisher.environment);
  LinkCore<M> link({publisher.topic(),
                    {publisher.queue.base(), extent},
                    {reader.base(), extent, 0},
                    0,
                    generation,
                    Pair::first(),
                    publisher.offered,
                    publisher.requested,
                    16,
                    16});
  ASSERT_TRUE(link.link(true));  // and never takes
  for (int i = 0; i < 1000; ++i) ASSERT_EQ(publisher.publish(64), PublishOutcome::published) << i;
}

// A scan looks at no more slots than the publisher has; their number may grow.
TEST(Dataplane, UsesThePublishersSlotsIncludingLaterOnes) {
  constexpr std::uint64_t few = 65, many = 200;
  Pair pair;
  Region queue(std::uint64_t{1} << 18);
  const region::PublisherWords<M> words{queue.base(), extent};
  words.head().store(abi::pack_entry(Pair::first(), 0));
  const abi::Qos keeps_all{1000, true, true, false, false};  // for late joiners
  journal::BoardSteps<M>(pair.topic()).add_publisher(0, generation, {keeps_all, 0, extent, few});
  auto publisher = std::make_unique<PublisherCore<M>>(PublisherCore<M>::Identity{
      pair.topic(), words, 0, generation, Pair::first(), keeps_all, few, 0});
  Freed environment;
  std::uint64_t number = 0;
  const auto publish_until_full = [&] {
    for (std::uint64_t published = 0;; ++published) {
      const std::uint64_t address = 0x100000 + ++number * 16;
      environment.live.insert(address);
      if (publisher->publish({address, 16, number}, environment) == PublishOutcome::published)
        continue;
      environment.live.erase(address);
      return published;
    }
  };
  EXPECT_EQ(publish_until_full(), few);
  pair.topic().publisher(0, offsetof(abi::PublisherEntry, slot_count)).store(many);
  pair.topic().epoch().fetch_add(1);
  EXPECT_EQ(publish_until_full(), many - few);
  EXPECT_EQ(publisher->allocated_count(), many);
  EXPECT_FALSE(publisher->has_reclaimable());
  publisher->keep_no_history();
  EXPECT_TRUE(publisher->has_reclaimable());
  publisher->scan(environment);
  publisher->scan(environment);
  EXPECT_EQ(publisher->allocated_count(), 0u) << "slots that it got later are freed too";
  EXPECT_TRUE(environment.live.empty());
}

TEST(Dataplane, RefusesAMessageOfAnotherSizeOrAlignment) {
  for (const auto& [address, size, is_right] : {std::tuple{0x100010ull, 32ull, true},
                                                {0x100010ull, 31ull, false},
                                                {0x100010ull, 0ull, false},
                                                {0x100014ull, 32ull, false},
                                                {0x1ffff0ull, 32ull, false},
                                                {0x200000ull, 0ull, false}}) {
    Pair pair;
    journal::BoardSteps<M>(pair.topic()).add_subscription(0, 1, {pair.requested, 1, extent, 8, 0});
    LinkCore<M> link({pair.topic(), pair.words(), pair.line(0), 0, generation, Pair::first(),
                      pair.offered, pair.requested, 32, 16});
    ASSERT_TRUE(link.link(true));
    auto publisher = std::make_unique<PublisherCore<M>>(PublisherCore<M>::Identity{
        pair.topic(), pair.words(), 0, generation, Pair::first(), pair.offered, 64, 0});
    Freed environment;
    ASSERT_EQ(publisher->publish({address, size, 1}, environment), PublishOutcome::published);
    NumberWindow window;
    EXPECT_EQ(link.take(window).has_value(), is_right) << std::hex << address << " + " << size;
    EXPECT_EQ(link.malformed(), is_right ? 0u : 1u);
  }
}

TEST(Recovery, EveryCombinationOfIntentAndHeadHasExactlyOneDecision) {
  using journal::decide;
  using journal::IntentDecision;
  constexpr std::uint64_t slots = 4;
  for (std::uint64_t op = 0; op <= 3; ++op) {
    for (std::uint64_t sequence = 98; sequence <= 103; ++sequence) {
      for (std::uint64_t slot = 0; slot <= slots; ++slot) {
        const IntentDecision decision =
            decide({op, sequence, slot, abi::pack_entry(100, 1)}, slots);
        IntentDecision expected = IntentDecision::corrupt;
        if (op == abi::intent_idle) expected = IntentDecision::nothing;
        if (op == abi::intent_publish && sequence == 100) expected = IntentDecision::roll_forward;
        if (op == abi::intent_publish && sequence == 101 && slot < slots)
          expected = IntentDecision::roll_back;
        EXPECT_EQ(decision, expected)
            << "op " << op << " sequence " << sequence << " slot " << slot;
      }
    }
  }
}

}  // namespace
}  // namespace agnocast::dataplane
