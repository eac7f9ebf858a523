// SPDX-License-Identifier: Apache-2.0
//
// Goal: a datagram of the notification protocol means what sd_notify(3) says, and a malformed one
// means nothing. Method: the parser alone, on exact and on random bytes.

#include <daemon/process/supervisor.hpp>

#include <gtest/gtest.h>

#include <random>
#include <string>

namespace agnocast::daemon {
namespace {

TEST(Notification, NamesTheDescriptorsToKeep) {
  const auto store = parse_notification("FDSTORE=1\nFDPOLL=0\nFDNAME=w12.3");
  ASSERT_TRUE(store);
  EXPECT_TRUE(store->store);
  EXPECT_FALSE(store->remove);
  EXPECT_FALSE(store->ready);
  EXPECT_EQ(store->name, "w12.3");
  const auto remove = parse_notification("FDSTOREREMOVE=1\nFDNAME=r7\n");
  ASSERT_TRUE(remove);
  EXPECT_TRUE(remove->remove);
  EXPECT_FALSE(remove->store);
  EXPECT_EQ(remove->name, "r7");
  EXPECT_EQ(parse_notification("FDSTORE=1")->name, "stored") << "the default name of systemd";
}

TEST(Notification, ReportsStatesAndIgnoresTheRest) {
  const auto ready = parse_notification("WATCHDOG=1\nREADY=1\nSTATUS=serving a=b\nX_MINE=2");
  ASSERT_TRUE(ready);
  EXPECT_TRUE(ready->ready);
  EXPECT_EQ(ready->status, "serving a=b");
  EXPECT_FALSE(ready->stopping);
  EXPECT_TRUE(parse_notification("STOPPING=1")->stopping);
  for (const char* other :
       {"", "\n\n", "READY=0", "READY=11", "ready=1", " READY=1", "BARRIER=1"}) {
    const auto nothing = parse_notification(other);
    ASSERT_TRUE(nothing) << other;
    EXPECT_FALSE(nothing->ready || nothing->store || nothing->remove || nothing->stopping) << other;
  }
}

TEST(Notification, RefusesNamesThatCannotBePassedOn) {
  using namespace std::string_literals;
  for (const std::string& name :
       {""s, "a:b"s, "a b"s, "a\tb"s, "\x7f"s, "\xc3\xa4"s, std::string(256, 'x')})
    EXPECT_FALSE(parse_notification("FDSTORE=1\nFDNAME=" + name)) << name;
  EXPECT_TRUE(parse_notification("FDSTORE=1\nFDNAME=" + std::string(255, 'x')));
  EXPECT_FALSE(parse_notification("READY=1\0FDSTORE=1"s));
}

TEST(Notification, SurvivesAnyBytes) {
  std::mt19937 random(3);
  const std::string words[] = {"FDSTORE=1", "FDNAME=",        "\n", "READY=1", ":",
                               "=",         "FDSTOREREMOVE=1"};
  for (int round = 0; round < 20'000; ++round) {
    std::string text;
    for (unsigned parts = random() % 8; parts > 0; --parts) {
      if (random() % 2 == 0) {
        text += words[random() % std::size(words)];
      } else {
        text += static_cast<char>(random());
      }
    }
    const auto notification = parse_notification(text);
    if (notification) {
      EXPECT_FALSE(notification->name.empty());
      EXPECT_EQ(notification->name.find(':'), std::string::npos);
    }
  }
}

}  // namespace
}  // namespace agnocast::daemon
