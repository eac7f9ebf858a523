// SPDX-License-Identifier: Apache-2.0
//
// Goal: when the daemon's store is lost and another daemon begins, processes that were there before
// come to it by themselves, with everything they have, and nobody who publishes or takes has to do
// anything: nothing comes twice, in another order, or damaged; and nothing is left behind.
// Method: real daemons, killed with their supervisors (or stopped) and begun anew at the same socket;
// real processes, some of them stopped (SIGSTOP) meanwhile.

#include <agnocast/error.hpp>
#include <tests/support/client_tool.hpp>
#include <tests/support/daemon_process.hpp>
#include <tests/support/own_process.hpp>
#include <tests/support/wire_dump.hpp>

#include <gtest/gtest.h>

#include <csignal>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <memory>
#include <optional>
#include <string>
#include <vector>

namespace agnocast {
namespace {

using test::ClientTool;
using test::DaemonProcess;
using test::eventually;

/// One daemon after the other at the same place, each with nothing of the former's.
class Reregistration : public testing::Test {
 protected:
  Reregistration() : directory_(test::make_directory()) { begin(); }
  ~Reregistration() override {
    daemon_.reset();
    test::remove_directory(directory_);
  }
  std::string socket() const { return directory_ + "/agnocastd.sock"; }
  void begin(const std::string& program = {}) {
    daemon_ = std::make_unique<DaemonProcess>(
        test::DaemonOptions{.socket = socket(), .program = program});
  }
  void end(bool cleanly = false) {
    if (cleanly) {
      daemon_->stop();
    } else {
      daemon_->kill();
    }
  }
  void lose(bool cleanly = false) {
    end(cleanly);
    begin();
  }

  std::string directory_;
  std::unique_ptr<DaemonProcess> daemon_;
};

/// Takes and releases until nothing is there any more: the numbers, each followed by a space.
std::string take_all(ClientTool& subscriber) {
  std::string numbers;
  for (;;) {
    const std::string number = subscriber.ask("take");
    if (number == "none") return numbers;
    numbers += number + " ";
    EXPECT_EQ(subscriber.ask("release"), "ok");
  }
}

std::size_t count_in(const std::string& directory) {
  std::size_t count = 0;
  for ([[maybe_unused]] const auto& entry : std::filesystem::directory_iterator(directory)) ++count;
  return count;
}
struct Use {
  std::size_t descriptors, threads, mappings;
  friend bool operator==(const Use&, const Use&) = default;
  friend std::ostream& operator<<(std::ostream& out, const Use& use) {
    return out << use.descriptors << " descriptors, " << use.threads << " threads, " << use.mappings
               << " mappings";
  }
};
/// Of the library; the allocator's mappings come and go.
Use use_of(pid_t pid) {
  const std::string process = "/proc/" + std::to_string(pid);
  std::ifstream maps(process + "/maps");
  std::size_t mappings = 0;
  for (std::string line; std::getline(maps, line);)
    mappings += line.find("agnocast-") != std::string::npos;
  return {count_in(process + "/fd"), count_in(process + "/task"), mappings};
}

TEST_F(Reregistration, AStreamGoesOn) {
  ClientTool publisher(socket()), subscriber(socket());
  ASSERT_EQ(subscriber.ask("sub /t 100"), "ok");
  ASSERT_EQ(publisher.ask("pub /t 100"), "ok");
  ASSERT_TRUE(publisher.eventually("matched", "1"));
  int number = 0;
  const auto pass_on = [&](int count) {
    for (int i = 0; i < count; ++i) {
      subscriber.tell("wait 10000");
      ASSERT_EQ(publisher.ask("publish 1 100"), "ok") << number;
      ASSERT_EQ(subscriber.answer(), "news") << number;
      ASSERT_EQ(take_all(subscriber), std::to_string(++number) + " ");
    }
  };
  for (const bool cleanly : {false, true, false}) {
    pass_on(20);
    end(cleanly);
    pass_on(20);
    begin();
    for (int rounds = 0; rounds < 1000; ++rounds) {
      pass_on(1);
      if (publisher.ask("state") == "connected" && subscriber.ask("state") == "connected") break;
    }
    pass_on(200);
    ASSERT_TRUE(publisher.eventually("state", "connected"));
    ASSERT_TRUE(subscriber.eventually("state", "connected"));
    pass_on(20);
  }
  EXPECT_EQ(subscriber.ask("lost"), "0");
  EXPECT_TRUE(subscriber.eventually("links", "1")) << "what is former has ended";
  EXPECT_EQ(publisher.ask("matched"), "1");
  EXPECT_TRUE(publisher.eventually("allocated", "0"));
}

TEST_F(Reregistration, WhatIsUnreadComesBeforeWhatIsNew) {
  ClientTool publisher(socket()), subscriber(socket());
  ASSERT_EQ(subscriber.ask("sub /t 100"), "ok");
  ASSERT_EQ(publisher.ask("pub /t 100"), "ok");
  ASSERT_TRUE(publisher.eventually("matched", "1"));
  ASSERT_EQ(publisher.ask("publish 5 10"), "ok");
  ASSERT_EQ(subscriber.ask("take"), "1");  // held over all this
  lose();
  ASSERT_EQ(publisher.ask("publish 5 10"), "ok");
  ASSERT_TRUE(publisher.eventually("state", "connected"));
  ASSERT_TRUE(subscriber.eventually("state", "connected"));
  // It has moved as soon as a process that was never in the former membership gets its messages.
  ClientTool newcomer(socket());
  ASSERT_EQ(newcomer.ask("sub /t 100"), "ok");
  ASSERT_TRUE(publisher.eventually("matched", "2"));
  ASSERT_EQ(publisher.ask("publish 5 10"), "ok");
  lose();
  ASSERT_TRUE(publisher.eventually("state", "connected"));
  ASSERT_TRUE(subscriber.eventually("state", "connected"));
  ASSERT_TRUE(newcomer.eventually("state", "connected"));
  ASSERT_TRUE(publisher.eventually("matched", "2"));
  ASSERT_EQ(publisher.ask("publish 5 10"), "ok");
  // The first one stays held: it is the oldest, and what is taken after it is released in its turn.
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

TEST_F(Reregistration, HistoryGoesAlongAndComesOnce) {
  ClientTool publisher(socket()), subscriber(socket());
  ASSERT_EQ(publisher.ask("pub /t 3 tl"), "ok");
  ASSERT_EQ(subscriber.ask("sub /t 10 tl"), "ok");
  ASSERT_TRUE(publisher.eventually("matched", "1"));
  ASSERT_EQ(publisher.ask("publish 5 10"), "ok");
  EXPECT_EQ(take_all(subscriber), "1 2 3 4 5 ");
  for (int round = 1; round <= 2; ++round) {
    lose();
    ASSERT_TRUE(publisher.eventually("state", "connected"));
    ASSERT_TRUE(subscriber.eventually("state", "connected"));
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

TEST_F(Reregistration, NewcomersMeetThoseWhoWereThereBefore) {
  ClientTool publisher(socket()), subscriber(socket());
  ASSERT_EQ(publisher.ask("pub /a 10"), "ok");
  ASSERT_EQ(subscriber.ask("sub /b 10"), "ok");
  ASSERT_EQ(publisher.ask("publish 1 10"), "ok");
  end();
  begin();
  ClientTool newcomer(socket());  // perhaps before the others are back
  ASSERT_EQ(newcomer.ask("sub /a 10"), "ok");
  ASSERT_EQ(newcomer.ask("pub /b 10"), "ok");
  ASSERT_TRUE(publisher.eventually("matched", "1"));
  ASSERT_TRUE(newcomer.eventually("matched", "1"));
  ASSERT_EQ(publisher.ask("publish 3 1000"), "ok");
  ASSERT_EQ(newcomer.ask("publish 3 1000"), "ok");
  EXPECT_EQ(take_all(newcomer), "2 3 4 ");
  EXPECT_EQ(take_all(subscriber), "1 2 3 ");
}

TEST_F(Reregistration, WhoWasStoppedComesLater) {
  ClientTool publisher(socket()), subscriber(socket()), stopped(socket());
  for (ClientTool* const tool : {&subscriber, &stopped}) ASSERT_EQ(tool->ask("sub /t 100"), "ok");
  ASSERT_EQ(publisher.ask("pub /t 100"), "ok");
  ASSERT_TRUE(publisher.eventually("matched", "2"));
  ASSERT_EQ(publisher.ask("publish 3 10"), "ok");
  ::kill(stopped.pid(), SIGSTOP);
  lose();
  ASSERT_TRUE(publisher.eventually("state", "connected"));
  ASSERT_TRUE(subscriber.eventually("state", "connected"));
  ASSERT_EQ(publisher.ask("publish 3 10"), "ok");
  // It waits for a while for the one that does not come.
  ASSERT_TRUE(publisher.eventually("matched", "1"));
  ASSERT_EQ(publisher.ask("publish 3 10"), "ok");
  EXPECT_EQ(take_all(subscriber), "1 2 3 4 5 6 7 8 9 ");
  ::kill(stopped.pid(), SIGCONT);
  ASSERT_TRUE(stopped.eventually("state", "connected"));
  ASSERT_TRUE(publisher.eventually("matched", "2"));
  ASSERT_EQ(publisher.ask("publish 3 10"), "ok");
  const std::string heard = take_all(stopped);
  EXPECT_EQ(heard.substr(0, 12), "1 2 3 4 5 6 ") << heard;
  EXPECT_EQ(heard.substr(heard.size() - 9), "10 11 12 ") << heard;
  EXPECT_EQ(take_all(subscriber), "10 11 12 ");
}

TEST_F(Reregistration, WhoDiesMeanwhileKeepsNothing) {
  ClientTool publisher(socket()), subscriber(socket());
  auto dies = std::make_unique<ClientTool>(socket());
  for (ClientTool* const tool : {&subscriber, dies.get()})
    ASSERT_EQ(tool->ask("sub /t 2 all"), "ok");
  ASSERT_EQ(publisher.ask("pub /t 2 all"), "ok");
  ASSERT_TRUE(publisher.eventually("matched", "2"));
  ASSERT_EQ(publisher.ask("publish 2 10"), "ok");
  ASSERT_EQ(dies->ask("take"), "1");
  EXPECT_EQ(take_all(subscriber), "1 2 ");
  end();
  ASSERT_NE(publisher.ask("publish 2 10"), "ok");
  dies.reset();
  EXPECT_TRUE(publisher.eventually("state", "reconnecting"));
  begin();
  ASSERT_TRUE(publisher.eventually("state", "connected"));
  ASSERT_TRUE(publisher.eventually("matched", "1"));
  EXPECT_EQ(take_all(subscriber), "3 ") << "of two there was room for one";
  EXPECT_TRUE(publisher.eventually("allocated", "0"));
  EXPECT_TRUE(subscriber.eventually("links", "1"));
  ASSERT_EQ(publisher.ask("publish 2 10"), "ok");
  EXPECT_EQ(take_all(subscriber), "4 5 ");
}

TEST_F(Reregistration, WhatIsCreatedAndDestroyedMeanwhileIsSo) {
  ClientTool publisher(socket()), subscriber(socket()), other(socket());
  ASSERT_EQ(subscriber.ask("sub /t 10"), "ok");
  ASSERT_EQ(publisher.ask("pub /t 10"), "ok");
  ASSERT_EQ(other.ask("sub /t 10"), "ok");
  ASSERT_TRUE(publisher.eventually("matched", "2"));
  for (int round = 0; round < 5; ++round) {
    end();
    ASSERT_TRUE(other.eventually("state", "reconnecting"));
    ASSERT_EQ(other.ask("unsub"), "ok");
    other.tell("sub /t 10");  // waits for the next daemon
    begin();
    ASSERT_EQ(other.answer(), "ok");
    ASSERT_TRUE(other.eventually("state", "connected"));
    ASSERT_TRUE(publisher.eventually("state", "connected"));
    ASSERT_TRUE(publisher.eventually("matched", "2"));
    ASSERT_EQ(publisher.ask("unpub"), "ok");
    ASSERT_EQ(publisher.ask("pub /t 10"), "ok");
    ASSERT_TRUE(publisher.eventually("matched", "2"));
    ASSERT_EQ(publisher.ask("publish 2 10"), "ok");
    EXPECT_EQ(take_all(other), "1 2 ");
    EXPECT_EQ(take_all(subscriber), "1 2 ");
  }
  EXPECT_TRUE(eventually([&] { return test::wire_dump(socket()).endpoints.size() == 3; }))
      << "the daemon knows of nothing else";
}

TEST_F(Reregistration, TenLossesLeaveNothingBehind) {
  ClientTool publisher(socket()), subscriber(socket());
  ASSERT_EQ(subscriber.ask("sub /t 100"), "ok");
  ASSERT_EQ(publisher.ask("pub /t 10"), "ok");
  ASSERT_TRUE(publisher.eventually("matched", "1"));
  std::optional<Use> publishers_use, subscribers_use;
  std::string expected, heard;
  for (int round = 1; round <= 11; ++round) {
    ASSERT_EQ(publisher.ask("publish 1 1000"), "ok");
    lose();
    ASSERT_TRUE(publisher.eventually("state", "connected")) << round;
    ASSERT_TRUE(subscriber.eventually("state", "connected")) << round;
    heard += take_all(subscriber);
    expected += std::to_string(round) + " ";
    ASSERT_EQ(heard, expected);
    ASSERT_TRUE(publisher.eventually("matched", "1"));
    ASSERT_TRUE(subscriber.eventually("links", "1"));
    // The former membership's last look, and its thread's end.
    EXPECT_TRUE(eventually([&] {
      return use_of(publisher.pid()).threads == 2 && use_of(subscriber.pid()).threads == 2;
    })) << round;
    if (round == 1) {
      publishers_use = use_of(publisher.pid());
      subscribers_use = use_of(subscriber.pid());
    }
  }
  EXPECT_TRUE(eventually([&] { return use_of(publisher.pid()) == *publishers_use; }))
      << use_of(publisher.pid()) << " after " << *publishers_use;
  EXPECT_TRUE(eventually([&] { return use_of(subscriber.pid()) == *subscribers_use; }))
      << use_of(subscriber.pid()) << " after " << *subscribers_use;
  EXPECT_TRUE(publisher.eventually("allocated", "0"));
}

TEST_F(Reregistration, AddressesThatAreInUseAreNotMappedOver) {
  auto publisher = std::make_unique<ClientTool>(socket());
  ClientTool subscriber(socket()), other(socket());
  ASSERT_EQ(subscriber.ask("sub /t 10"), "ok");
  ASSERT_EQ(publisher->ask("pub /t 10"), "ok");
  ASSERT_TRUE(publisher->eventually("matched", "1"));
  ASSERT_EQ(publisher->ask("publish 2 1000"), "ok");
  ASSERT_EQ(subscriber.ask("take"), "1");
  const std::string address = subscriber.ask("address");
  ::kill(publisher->pid(), SIGSTOP);
  end();
  // As if eight daemons had been here: this one gives out the same places once more.
  std::filesystem::remove(socket() + ".lock");
  begin();
  ASSERT_TRUE(subscriber.eventually("state", "connected"));
  auto newcomer = std::make_unique<ClientTool>(socket());
  ASSERT_EQ(newcomer->ask("pub /t 10"), "ok");
  ASSERT_EQ(other.ask("sub /t 10"), "ok");
  ASSERT_TRUE(newcomer->eventually("matched", "2"));
  ASSERT_EQ(newcomer->ask("publish 1 1000"), "ok");
  EXPECT_EQ(other.ask("wait 10000"), "news");
  EXPECT_EQ(other.ask("take"), "1");
  EXPECT_EQ(other.ask("address"), address) << "or this test shows nothing";
  EXPECT_EQ(other.ask("release"), "ok");
  EXPECT_EQ(subscriber.ask("take"), "2") << "what is unread there is as it was";
  EXPECT_EQ(subscriber.ask("take"), "none");
  EXPECT_EQ(subscriber.ask("unreachable"), "1");
  EXPECT_EQ(subscriber.ask("release"), "ok");
  ::kill(publisher->pid(), SIGCONT);
  const std::string island = "island " + std::to_string(static_cast<int>(Errc::arena_occupied));
  EXPECT_TRUE(publisher->eventually("state", island));
  ASSERT_EQ(publisher->ask("publish 1 1000"), "ok");
  EXPECT_EQ(subscriber.ask("wait 10000"), "news");
  EXPECT_EQ(subscriber.ask("take"), "3") << "an island goes on";
  newcomer.reset();
  EXPECT_TRUE(publisher->eventually("state", "connected")) << "the addresses are free again";
  ASSERT_TRUE(publisher->eventually("matched", "2"));
  ASSERT_EQ(publisher->ask("publish 1 1000"), "ok");
  EXPECT_EQ(other.ask("wait 10000"), "news");
  EXPECT_EQ(other.ask("take"), "4");
  while (subscriber.ask("release") == "ok") {
  }
  EXPECT_EQ(take_all(subscriber), "4 ");
}

TEST_F(Reregistration, AnotherDaemonGivesOtherAddresses) {
  ClientTool publisher(socket()), subscriber(socket());
  ASSERT_EQ(subscriber.ask("sub /t 10"), "ok");
  ASSERT_EQ(publisher.ask("pub /t 10"), "ok");
  ASSERT_TRUE(publisher.eventually("matched", "1"));
  ASSERT_EQ(publisher.ask("publish 1 10"), "ok");
  ASSERT_EQ(subscriber.ask("take"), "1");
  const std::uint64_t before = std::stoull(subscriber.ask("address"));
  ::kill(publisher.pid(), SIGSTOP);  // it has not come back when the next one asks
  lose();
  ClientTool newcomer(socket());
  ASSERT_EQ(newcomer.ask("pub /t 10"), "ok");
  ASSERT_TRUE(newcomer.eventually("matched", "1"));
  ASSERT_EQ(newcomer.ask("publish 1 10"), "ok");
  EXPECT_EQ(subscriber.ask("release"), "ok");
  EXPECT_TRUE(subscriber.eventually("take", "1"));
  const std::uint64_t after = std::stoull(subscriber.ask("address"));
  constexpr std::uint64_t arena_bytes = std::uint64_t{64} << 30;  // of DaemonProcess
  EXPECT_GE(after - before, arena_bytes / 8 - (std::uint64_t{64} << 20));
  ::kill(publisher.pid(), SIGCONT);
  EXPECT_TRUE(publisher.eventually("state", "connected"));
}

TEST_F(Reregistration, AnotherLayoutLeavesAnIsland) {
  ClientTool publisher(socket()), subscriber(socket());
  ASSERT_EQ(subscriber.ask("sub /t 100"), "ok");
  ASSERT_EQ(publisher.ask("pub /t 10"), "ok");
  ASSERT_TRUE(publisher.eventually("matched", "1"));
  end();
  begin(AGNOCAST_TEST_OTHER_LAYOUT);
  const std::string island = "island " + std::to_string(static_cast<int>(Errc::layout_mismatch));
  ASSERT_TRUE(publisher.eventually("state", island));
  ASSERT_TRUE(subscriber.eventually("state", island));
  ASSERT_EQ(publisher.ask("publish 3 10"), "ok");
  EXPECT_EQ(take_all(subscriber), "1 2 3 ");
}

}  // namespace
}  // namespace agnocast
