// SPDX-License-Identifier: Apache-2.0
//
// Goal: when processes move to another daemon, no message arrives twice, out of order, or damaged:
// unread messages come before new ones, histories once and to subscriptions that request them; and
// no publisher holds back the messages of another.
// Method: as reregistration_test.cpp.

#include <tests/integration/client/session/reregistration.hpp>

#include <csignal>
#include <vector>

namespace agnocast {
namespace {

TEST_F(Reregistration, UnreadMessagesComeBeforeNewOnes) {
  ClientTool publisher(socket()), subscriber(socket());
  ASSERT_TRUE(meet(subscriber, "sub /t 100", publisher, "pub /t 100"));
  ASSERT_EQ(publisher.ask("publish 5 10"), "ok");
  ASSERT_EQ(subscriber.ask("take"), "1");  // held over all this
  lose();
  ASSERT_EQ(publisher.ask("publish 5 10"), "ok");
  ASSERT_TRUE(are_connected({&publisher, &subscriber}));
  // It has moved as soon as a process without a previous session gets its messages.
  ClientTool newcomer(socket());
  ASSERT_EQ(newcomer.ask("sub /t 100"), "ok");
  ASSERT_TRUE(publisher.eventually("matched", "2"));
  ASSERT_EQ(publisher.ask("publish 5 10"), "ok");
  lose();
  ASSERT_TRUE(are_connected({&publisher, &subscriber, &newcomer}));
  ASSERT_TRUE(publisher.eventually("matched", "2"));
  ASSERT_EQ(publisher.ask("publish 5 10"), "ok");
  // The first one stays held: it is the oldest, and later ones are released when the next is
  // taken.
  std::string heard;
  for (int i = 2; i <= 20; ++i) {
    heard += subscriber.ask("take") + " ";
    if (i > 10) {
      ASSERT_EQ(subscriber.ask("release"), "ok");
    }
  }
  EXPECT_EQ(heard, "2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17 18 19 20 ");
  EXPECT_EQ(subscriber.ask("take"), "none");
  while (subscriber.ask("release") == "ok") {
  }
  EXPECT_EQ(take_all(newcomer), "11 12 13 14 15 16 17 18 19 20 ");
  EXPECT_EQ(subscriber.ask("lost"), "0");
  EXPECT_TRUE(publisher.eventually("allocated", "0"));
  EXPECT_TRUE(subscriber.eventually("links", "1"));
}

TEST_F(Reregistration, HistoryMovesAndArrivesOnce) {
  ClientTool publisher(socket()), subscriber(socket());
  ASSERT_EQ(publisher.ask("pub /t 3 tl"), "ok");
  ASSERT_EQ(subscriber.ask("sub /t 10 tl"), "ok");
  ASSERT_TRUE(publisher.eventually("matched", "1"));
  ASSERT_EQ(publisher.ask("publish 5 10"), "ok");
  EXPECT_EQ(take_all(subscriber), "1 2 3 4 5 ");
  for (int round = 1; round <= 2; ++round) {
    lose();
    ASSERT_TRUE(are_connected({&publisher, &subscriber}));
    ClientTool late(socket());
    ASSERT_EQ(late.ask("sub /t 10 tl"), "ok");
    ASSERT_TRUE(publisher.eventually("matched", "2"));
    std::string heard;
    EXPECT_TRUE(eventually([&] {
      heard += take_all(late);
      return heard.size() >= 6;
    }));
    EXPECT_EQ(heard, "3 4 5 ");
    EXPECT_EQ(take_all(subscriber), "");
  }
  // A machine under load may take longer than publishers wait.
  ASSERT_TRUE(subscriber.eventually("links", "1"));
  ASSERT_EQ(publisher.ask("publish 2 10"), "ok");
  EXPECT_EQ(take_all(subscriber), "6 7 ");
  EXPECT_EQ(subscriber.ask("malformed"), "0");
  EXPECT_TRUE(publisher.eventually("allocated", "3")) << "each has one owner in the end";
}

struct OneStays {
  explicit OneStays(const std::string& socket) : subscriber(socket), moves(socket), stays(socket) {
    EXPECT_EQ(subscriber.ask("sub /t 1000"), "ok");
    for (ClientTool* const tool : {&moves, &stays}) {
      EXPECT_EQ(tool->ask("pub /t 100"), "ok");
      EXPECT_TRUE(tool->eventually("matched", "1"));
    }
    ::kill(stays.pid(), SIGSTOP);
  }
  /// Starts a daemon that has room for one publisher.
  void come_to_next() {
    ASSERT_TRUE(are_connected({&moves, &subscriber}));
    ASSERT_TRUE(moves.eventually("matched", "1"));
    ::kill(stays.pid(), SIGCONT);
    ASSERT_TRUE(stays.eventually("state", "connected"));
  }
  static constexpr const char* config = "[quota]\npublishers = 1\n";

  ClientTool subscriber, moves, stays;
};

TEST_F(Reregistration, APublisherThatStaysDelaysNoOtherHoweverFastItIs) {
  OneStays stage(socket());
  ASSERT_EQ(stage.moves.ask("publish 50 10"), "ok");
  EXPECT_EQ(take_all(stage.subscriber).substr(0, 8), "1 2 3 4 ");
  end();
  begin({.more_config = OneStays::config});
  ASSERT_NO_FATAL_FAILURE(stage.come_to_next());
  ASSERT_EQ(stage.stays.ask("publish 20 10"), "ok");
  ASSERT_EQ(stage.moves.ask("publish 1 10"), "ok");  // number 51
  std::string heard;
  for (int i = 0; i < 40; ++i) {
    ASSERT_EQ(stage.stays.ask("publish 1 10"), "ok");
    heard += stage.subscriber.ask("take") + " ";
    ASSERT_EQ(stage.subscriber.ask("release"), "ok");
  }
  EXPECT_NE(heard.find(" 20 51 21 "), std::string::npos) << heard;
}

TEST_F(Reregistration, AQuotaUsedUpByOnePublisherDelaysNoOther) {
  OneStays stage(socket());
  end();
  begin({.more_config = OneStays::config});
  ASSERT_NO_FATAL_FAILURE(stage.come_to_next());
  ASSERT_EQ(stage.stays.ask("publish 20 10"), "ok");
  for (int i = 1; i <= 16; ++i) ASSERT_EQ(stage.subscriber.ask("take"), std::to_string(i));
  ASSERT_EQ(stage.subscriber.ask("take"), "none") << "it holds as many as it may of this one";
  EXPECT_EQ(stage.subscriber.ask("wait 100"), "timeout") << "it sleeps instead of retrying";
  ASSERT_EQ(stage.moves.ask("publish 2 10"), "ok");
  EXPECT_EQ(stage.subscriber.ask("wait 10000"), "news");
  EXPECT_EQ(stage.subscriber.ask("take"), "1");
  EXPECT_EQ(stage.subscriber.ask("take"), "2");
  EXPECT_EQ(stage.subscriber.ask("wait 100"), "timeout");
  EXPECT_EQ(stage.subscriber.ask("release"), "ok");
  EXPECT_EQ(stage.subscriber.ask("wait 10000"), "news");
  EXPECT_EQ(stage.subscriber.ask("take"), "17");
}

TEST_F(Reregistration, ThePreviousQueueIsReadBeforeTheSamePublishersNext) {
  ClientTool publisher(socket()), subscriber(socket());
  ASSERT_TRUE(meet(subscriber, "sub /t 1000", publisher, "pub /t 100"));
  ASSERT_EQ(publisher.ask("publish 20 10"), "ok");
  for (int i = 1; i <= 16; ++i) ASSERT_EQ(subscriber.ask("take"), std::to_string(i));
  lose();
  ASSERT_TRUE(are_connected({&publisher, &subscriber}));
  ASSERT_TRUE(publisher.eventually("matched", "1"));
  ASSERT_TRUE(subscriber.eventually("links", "2"));
  ASSERT_EQ(publisher.ask("publish 4 10"), "ok");
  EXPECT_EQ(subscriber.ask("take"), "none");
  EXPECT_EQ(subscriber.ask("wait 100"), "timeout") << "messages held back are no news";
  for (int i = 17; i <= 24; ++i) {
    EXPECT_EQ(subscriber.ask("release"), "ok");
    EXPECT_EQ(subscriber.ask("wait 10000"), "news") << i;
    EXPECT_EQ(subscriber.ask("take"), std::to_string(i));
  }
}

TEST_F(Reregistration, HistoryGoesToSubscriptionsThatRequestIt) {
  ClientTool publisher(socket()), slow(socket());
  ASSERT_TRUE(meet(slow, "sub /t 100", publisher, "pub /t 3 tl"));
  ASSERT_EQ(publisher.ask("publish 5 10"), "ok");
  ::kill(slow.pid(), SIGSTOP);  // so that the new subscriptions exist before the history
  lose();
  ClientTool asks(socket()), asks_not(socket());
  ASSERT_EQ(asks.ask("sub /t 100 tl"), "ok");
  ASSERT_EQ(asks_not.ask("sub /t 100"), "ok");
  ASSERT_TRUE(asks.eventually("links", "1"));
  ASSERT_TRUE(asks_not.eventually("links", "1"));
  ::kill(slow.pid(), SIGCONT);
  ASSERT_TRUE(publisher.eventually("matched", "3"));
  ASSERT_EQ(publisher.ask("publish 1 10"), "ok");
  EXPECT_EQ(take_all(asks), "3 4 5 6 ");
  EXPECT_EQ(take_all(asks_not), "6 ");
  EXPECT_EQ(asks_not.ask("lost"), "0");
  EXPECT_EQ(take_all(slow), "1 2 3 4 5 6 ");
}

TEST_F(Reregistration, HistoryArrivesAlthoughTheFirstQueueOfItsPublisherStayedEmpty) {
  ClientTool publisher(socket()), slow(socket());
  ASSERT_TRUE(meet(slow, "sub /t 100", publisher, "pub /t 3 tl"));
  ASSERT_EQ(publisher.ask("publish 5 10"), "ok");
  ::kill(slow.pid(), SIGSTOP);  // the publisher waits for it
  lose();
  ClientTool newcomer(socket());
  ASSERT_EQ(newcomer.ask("sub /t 100 tl"), "ok");
  ASSERT_TRUE(newcomer.eventually("links", "1"));
  lose();
  ASSERT_TRUE(newcomer.eventually("state", "connected"));
  ::kill(slow.pid(), SIGCONT);
  ASSERT_TRUE(publisher.eventually("matched", "2"));
  ASSERT_EQ(publisher.ask("publish 1 10"), "ok");
  std::string heard;
  EXPECT_TRUE(eventually([&] {
    heard += take_all(newcomer);
    return heard.ends_with("6 ");
  }));
  EXPECT_EQ(heard, "3 4 5 6 ");
  EXPECT_EQ(take_all(slow), "1 2 3 4 5 6 ");
}

TEST_F(Reregistration, HistoryAlreadyReadIsNotCountedAsLost) {
  ClientTool publisher(socket()), subscriber(socket());
  ASSERT_EQ(publisher.ask("pub /t 5 tl"), "ok");
  ASSERT_EQ(subscriber.ask("sub /t 5 tl"), "ok");
  ASSERT_TRUE(publisher.eventually("matched", "1"));
  ASSERT_EQ(publisher.ask("publish 5 10"), "ok");
  EXPECT_EQ(take_all(subscriber), "1 2 3 4 5 ");
  lose();
  ASSERT_TRUE(are_connected({&publisher, &subscriber}));
  ASSERT_TRUE(publisher.eventually("matched", "1"));
  ASSERT_TRUE(subscriber.eventually("links", "1"));  // the previous queue has ended
  ASSERT_EQ(publisher.ask("publish 4 10"), "ok");
  EXPECT_EQ(take_all(subscriber), "6 7 8 9 ");
  EXPECT_EQ(subscriber.ask("lost"), "0");
}

TEST_F(Reregistration, HistoriesOfManyPublishersArriveOnceHoweverLong) {
  ClientTool subscriber(socket());
  ASSERT_EQ(subscriber.ask("sub /t 1000 tl"), "ok");
  std::vector<std::unique_ptr<ClientTool>> publishers;
  for (int i = 0; i < 4; ++i) {
    publishers.push_back(std::make_unique<ClientTool>(socket()));
    ASSERT_EQ(publishers.back()->ask("pub /t 300 tl"), "ok");
    ASSERT_TRUE(publishers.back()->eventually("matched", "1"));
  }
  for (int i = 0; i < 3; ++i) {
    for (const auto& publisher : publishers) ASSERT_EQ(publisher->ask("publish 100 1"), "ok");
    take_all(subscriber);
  }
  lose();
  for (const auto& publisher : publishers) ASSERT_TRUE(publisher->eventually("matched", "1"));
  ASSERT_TRUE(subscriber.eventually("state", "connected"));
  ASSERT_TRUE(subscriber.eventually("links", "4"));
  EXPECT_EQ(take_all(subscriber), "");
  for (const auto& publisher : publishers) ASSERT_EQ(publisher->ask("publish 1 1"), "ok");
  EXPECT_EQ(take_all(subscriber), "301 301 301 301 ");
  EXPECT_EQ(subscriber.ask("lost"), "0");
}

TEST_F(Reregistration, TheHistoryOfAKeepAllPublisherMovesWhole) {
  ClientTool publisher(socket()), subscriber(socket());
  ASSERT_EQ(publisher.ask("pub /t 10 tl all"), "ok");
  ASSERT_EQ(subscriber.ask("sub /t 3 all"), "ok");
  ASSERT_TRUE(publisher.eventually("matched", "1"));
  for (int i = 1; i <= 10; ++i) {
    ASSERT_EQ(publisher.ask("publish 1 10"), "ok");
    EXPECT_EQ(take_all(subscriber), std::to_string(i) + " ");
  }
  lose();
  ASSERT_TRUE(are_connected({&publisher, &subscriber}));
  ClientTool late(socket());
  ASSERT_EQ(late.ask("sub /t 10 tl"), "ok");
  ASSERT_TRUE(publisher.eventually("matched", "2"));
  std::string heard;
  EXPECT_TRUE(eventually([&] {
    heard += take_all(late);
    return heard == "1 2 3 4 5 6 7 8 9 10 ";
  })) << heard;
  EXPECT_EQ(take_all(subscriber), "") << "it already had the history";
  ASSERT_TRUE(publisher.eventually("publish 1 10", "ok"));
  EXPECT_EQ(take_all(subscriber), "11 ");
}

TEST_F(Reregistration, AFalsePersistentIdDelaysNobody) {
  OneStays stage(socket());
  end();
  begin({.more_config = OneStays::config});
  ASSERT_NO_FATAL_FAILURE(stage.come_to_next());
  const std::string persistent_id = stage.moves.ask("persistent_id");
  ASSERT_EQ(stage.stays.ask("publish 20 10"), "ok");
  ASSERT_EQ(stage.stays.ask("forge " + persistent_id), "ok");
  ASSERT_EQ(stage.moves.ask("publish 1 10"), "ok");
  bool heard = false;
  for (int i = 0; i < 60 && !heard; ++i) {
    ASSERT_EQ(stage.stays.ask("publish 1 10"), "ok");
    ASSERT_EQ(stage.stays.ask("forge " + persistent_id), "ok");
    heard = stage.subscriber.ask("take") == "1" && i > 0;
    ASSERT_EQ(stage.subscriber.ask("release"), "ok");
  }
  EXPECT_TRUE(heard);
}

}  // namespace
}  // namespace agnocast
