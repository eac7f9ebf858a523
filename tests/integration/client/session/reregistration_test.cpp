// SPDX-License-Identifier: Apache-2.0
//
// Goal: when the daemon's store is lost and another daemon begins, processes move to it by
// themselves, with all their endpoints, messages and heaps, without any action of their publishers
// or subscriptions; and nothing is left behind.
// Method: real daemons at the same socket (reregistration.hpp); real processes, some of them
// stopped (SIGSTOP) meanwhile. reregistration_order_test.cpp covers the order of their messages.

#include <agnocast/abi/wire.hpp>
#include <agnocast/error.hpp>
#include <base/sockets/packet_socket.hpp>
#include <tests/integration/client/session/reregistration.hpp>
#include <tests/support/wire/foreign_socket.hpp>
#include <tests/support/wire/listen_at.hpp>
#include <tests/support/wire/wire_dump.hpp>

#include <poll.h>

#include <array>
#include <atomic>
#include <csignal>
#include <cstdint>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <optional>
#include <ostream>
#include <span>
#include <thread>
#include <vector>

namespace agnocast {
namespace {

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
/// Returns the library's resources; the allocator's mappings come and go.
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
  ASSERT_TRUE(meet(subscriber, "sub /t 100", publisher, "pub /t 100"));
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
    ASSERT_TRUE(are_connected({&publisher, &subscriber}));
    pass_on(20);
  }
  EXPECT_EQ(subscriber.ask("lost"), "0");
  EXPECT_TRUE(subscriber.eventually("links", "1")) << "the previous session has ended";
  EXPECT_EQ(publisher.ask("matched"), "1");
  EXPECT_TRUE(publisher.eventually("allocated", "0"));
}

TEST_F(Reregistration, ASubscriptionThatIgnoresItsProcessStillDoes) {
  ClientTool both(socket()), other(socket());
  ASSERT_EQ(both.ask("pub /t 10"), "ok");
  ASSERT_TRUE(meet(both, "sub /t 100 others", other, "pub /t 10"));
  for (int number = 1; number <= 3; ++number) {
    ASSERT_EQ(both.ask("publish 1 10"), "ok") << number;
    ASSERT_EQ(other.ask("publish 1 10"), "ok") << number;
    ASSERT_EQ(both.ask("wait 10000"), "news") << number;
    EXPECT_EQ(take_all(both), std::to_string(number) + " ") << "the other process's message alone";
    EXPECT_TRUE(both.eventually("links", "1")) << "the previous session has ended";
    lose();
    ASSERT_TRUE(are_connected({&both, &other}));
    ASSERT_TRUE(other.eventually("matched", "1"));
  }
  EXPECT_EQ(both.ask("matched"), "0");
}

TEST_F(Reregistration, NewEndpointsMatchMovedOnes) {
  ClientTool publisher(socket()), subscriber(socket());
  ASSERT_EQ(publisher.ask("pub /a 10"), "ok");
  ASSERT_EQ(subscriber.ask("sub /b 10"), "ok");
  ASSERT_EQ(publisher.ask("publish 1 10"), "ok");
  end();
  begin();
  ClientTool newcomer(socket());  // perhaps before the others have moved
  ASSERT_EQ(newcomer.ask("sub /a 10"), "ok");
  ASSERT_EQ(newcomer.ask("pub /b 10"), "ok");
  ASSERT_TRUE(publisher.eventually("matched", "1"));
  ASSERT_TRUE(newcomer.eventually("matched", "1"));
  ASSERT_EQ(publisher.ask("publish 3 1000"), "ok");
  ASSERT_EQ(newcomer.ask("publish 3 1000"), "ok");
  EXPECT_EQ(take_all(newcomer), "2 3 4 ");
  EXPECT_EQ(take_all(subscriber), "1 2 3 ");
}

TEST_F(Reregistration, AStoppedProcessMovesLater) {
  ClientTool publisher(socket()), subscriber(socket()), stopped(socket());
  for (ClientTool* const tool : {&subscriber, &stopped}) ASSERT_EQ(tool->ask("sub /t 100"), "ok");
  ASSERT_EQ(publisher.ask("pub /t 100"), "ok");
  ASSERT_TRUE(publisher.eventually("matched", "2"));
  ASSERT_EQ(publisher.ask("publish 3 10"), "ok");
  ::kill(stopped.pid(), SIGSTOP);
  lose();
  ASSERT_TRUE(are_connected({&publisher, &subscriber}));
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

TEST_F(Reregistration, AProcessThatDiesMeanwhileKeepsNothing) {
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
  EXPECT_EQ(take_all(subscriber), "3 ") << "room for one of two";
  EXPECT_TRUE(publisher.eventually("allocated", "0"));
  EXPECT_TRUE(subscriber.eventually("links", "1"));
  ASSERT_EQ(publisher.ask("publish 2 10"), "ok");
  EXPECT_EQ(take_all(subscriber), "4 5 ");
}

TEST_F(Reregistration, AChildOfADeadProcessDoesNotKeepItAlive) {
  ClientTool publisher(socket()), subscriber(socket());
  auto reads = std::make_unique<ClientTool>(socket()),
       writes = std::make_unique<ClientTool>(socket());
  for (ClientTool* const tool : {&subscriber, reads.get()}) ASSERT_EQ(tool->ask("sub /t 10"), "ok");
  ASSERT_EQ(publisher.ask("pub /t 10"), "ok");
  ASSERT_EQ(writes->ask("pub /t 10"), "ok");
  ASSERT_TRUE(publisher.eventually("matched", "2"));
  ASSERT_TRUE(writes->eventually("matched", "2"));
  ASSERT_EQ(publisher.ask("publish 1 10"), "ok");
  ASSERT_EQ(writes->ask("publish 1 10"), "ok");
  std::vector<pid_t> children;
  for (ClientTool* const tool : {reads.get(), writes.get()})
    children.push_back(std::stoi(tool->ask("fork")));
  end();
  for (auto* const tool : {&reads, &writes}) tool->reset();
  begin();
  for (ClientTool* const tool : {&publisher, &subscriber}) {
    EXPECT_TRUE(tool->eventually("state", "connected"));
    EXPECT_TRUE(eventually([&] {
      take_all(subscriber);
      return use_of(tool->pid()).threads == 2;
    })) << "the previous session has not ended";
  }
  EXPECT_TRUE(publisher.eventually("allocated", "0"));
  for (const pid_t child : children) {
    EXPECT_EQ(::kill(child, 0), 0) << "the child has ended, so the test proves nothing";
    ::kill(child, SIGKILL);
  }
}

TEST_F(Reregistration, EndpointsCreatedAndDestroyedMeanwhileMoveCorrectly) {
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
    ASSERT_TRUE(are_connected({&other, &publisher}));
    ASSERT_TRUE(publisher.eventually("matched", "2"));
    ASSERT_EQ(publisher.ask("unpub"), "ok");
    ASSERT_EQ(publisher.ask("pub /t 10"), "ok");
    ASSERT_TRUE(publisher.eventually("matched", "2"));
    ASSERT_EQ(publisher.ask("publish 2 10"), "ok");
    EXPECT_EQ(take_all(other), "1 2 ");
    EXPECT_EQ(take_all(subscriber), "1 2 ");
  }
  EXPECT_TRUE(eventually([&] { return test::wire_dump(socket()).endpoints.size() == 3; }))
      << "the daemon knows no other endpoint";
}

TEST_F(Reregistration, TenLossesLeaveNothingBehind) {
  ClientTool publisher(socket()), subscriber(socket());
  ASSERT_TRUE(meet(subscriber, "sub /t 100", publisher, "pub /t 10"));
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
    // The last look of the previous session, and the end of its thread.
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
  // As if eight daemons had been here: this one assigns the same places once more.
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
  EXPECT_EQ(other.ask("address"), address) << "the address differs, so the test proves nothing";
  EXPECT_EQ(other.ask("release"), "ok");
  EXPECT_EQ(subscriber.ask("take"), "2") << "its unread message is unchanged";
  EXPECT_EQ(subscriber.ask("take"), "none");
  EXPECT_EQ(subscriber.ask("unreachable"), "1");
  EXPECT_EQ(subscriber.ask("release"), "ok");
  ::kill(publisher->pid(), SIGCONT);
  const std::string orphaned = "orphaned " + std::to_string(static_cast<int>(Errc::arena_occupied));
  EXPECT_TRUE(publisher->eventually("state", orphaned));
  ASSERT_EQ(publisher->ask("publish 1 1000"), "ok");
  EXPECT_EQ(subscriber.ask("wait 10000"), "news");
  EXPECT_EQ(subscriber.ask("take"), "3") << "an orphaned session goes on";
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

TEST_F(Reregistration, AnotherDaemonAssignsOtherAddresses) {
  ClientTool publisher(socket()), subscriber(socket());
  ASSERT_TRUE(meet(subscriber, "sub /t 10", publisher, "pub /t 10"));
  ASSERT_EQ(publisher.ask("publish 1 10"), "ok");
  ASSERT_EQ(subscriber.ask("take"), "1");
  const std::uint64_t before = std::stoull(subscriber.ask("address"));
  ::kill(publisher.pid(), SIGSTOP);  // it has not rejoined when the next one asks
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

TEST_F(Reregistration, AnotherLayoutLeavesAnOrphanedSession) {
  ClientTool publisher(socket()), subscriber(socket());
  ASSERT_TRUE(meet(subscriber, "sub /t 100", publisher, "pub /t 10"));
  end();
  begin({.program = AGNOCAST_TEST_OTHER_LAYOUT});
  const std::string orphaned =
      "orphaned " + std::to_string(static_cast<int>(Errc::layout_mismatch));
  ASSERT_TRUE(publisher.eventually("state", orphaned));
  ASSERT_TRUE(subscriber.eventually("state", orphaned));
  ASSERT_EQ(publisher.ask("publish 3 10"), "ok");
  EXPECT_EQ(take_all(subscriber), "1 2 3 ");
  // The user who installed that daemon restores the right one.
  end();
  begin();
  ASSERT_TRUE(are_connected({&publisher, &subscriber}));
  ASSERT_TRUE(publisher.eventually("matched", "1"));
  ASSERT_EQ(publisher.ask("publish 3 10"), "ok");
  EXPECT_EQ(take_all(subscriber), "4 5 6 ");
}

/// Takes the daemon's place and refuses: rejoin with one code, every other request with another.
class Refusing {
 public:
  Refusing(const std::string& path, Errc to_rejoin, Errc to_others)
      : path_(path),
        listener_((std::filesystem::remove(path), test::listen_at(path)).value()),
        thread_([=, this] {
          while (!over_) serve(to_rejoin, to_others);
        }) {}
  ~Refusing() {
    over_ = true;
    thread_.join();
    std::filesystem::remove(path_);
  }

 private:
  void serve(Errc to_rejoin, Errc to_others) {
    namespace wire = abi::wire;
    pollfd waiting{listener_.fd(), POLLIN, 0};
    if (::poll(&waiting, 1, 10) != 1) return;
    auto caller = listener_.accept();
    if (!caller || !*caller) return;
    pollfd readable{(*caller)->fd(), POLLIN, 0};
    std::array<std::byte, wire::packet_bytes_max> buffer;
    if (::poll(&readable, 1, 10'000) != 1) return;
    const auto said = (*caller)->receive(buffer);
    wire::Header header{};
    if (!said || said->bytes < sizeof header) return;
    std::memcpy(static_cast<void*>(&header), buffer.data(), sizeof header);
    wire::Refused refused{};
    refused.header = {wire::Opcode::refused, sizeof refused, header.request};
    const Errc code = header.opcode == wire::Opcode::rejoin ? to_rejoin : to_others;
    refused.code = static_cast<std::uint32_t>(code);
    static_cast<void>((*caller)->send(std::as_bytes(std::span(&refused, 1))));
  }
  std::string path_;
  PacketListener listener_;
  std::atomic<bool> over_{false};
  std::thread thread_;
};

TEST_F(Reregistration, ADamagedStoreLeavesAnOrphanedSessionUntilAnotherDaemonBegins) {
  // Our daemon refuses a rejoin so only later; an earlier refusal does no harm.
  for (const Errc to_rejoin : {Errc::started_anew, Errc::store_damaged}) {
    ClientTool publisher(socket()), subscriber(socket());
    ASSERT_TRUE(meet(subscriber, "sub /t 100", publisher, "pub /t 10"));
    end();
    const std::string orphaned =
        "orphaned " + std::to_string(static_cast<int>(Errc::store_damaged));
    {
      const Refusing refusing(socket(), to_rejoin, Errc::store_damaged);
      ASSERT_TRUE(publisher.eventually("state", orphaned));
      ASSERT_TRUE(subscriber.eventually("state", orphaned));
      ASSERT_EQ(publisher.ask("publish 3 10"), "ok");
      EXPECT_EQ(take_all(subscriber), "1 2 3 ");
    }
    begin();
    ASSERT_TRUE(are_connected({&publisher, &subscriber}));
    ASSERT_TRUE(publisher.eventually("matched", "1"));
    ASSERT_EQ(publisher.ask("publish 3 10"), "ok");
    EXPECT_EQ(take_all(subscriber), "4 5 6 ");
  }
}

// The daemon lives, but for a while its socket belongs to another program, which refuses:
// endpoints destroyed meanwhile have to leave when the process rejoins.
TEST_F(Reregistration, EndpointsDestroyedDuringARefusalHaveLeftAfterwards) {
  ClientTool publisher(socket()), subscriber(socket()), others(socket());
  ASSERT_EQ(subscriber.ask("sub /t 5 all"), "ok");
  ASSERT_EQ(others.ask("pub /t 100 all"), "ok");
  ASSERT_TRUE(others.eventually("matched", "1"));
  ASSERT_EQ(others.ask("publish 1 10"), "ok");
  ASSERT_EQ(subscriber.ask("take"), "1");
  ASSERT_EQ(publisher.ask("pub /u 1"), "ok");
  const std::string away = socket() + ".away";
  std::filesystem::rename(socket(), away);
  {
    const Refusing refusing(socket(), Errc::permission_denied, Errc::permission_denied);
    const std::string orphaned =
        "orphaned " + std::to_string(static_cast<int>(Errc::permission_denied));
    for (ClientTool* const tool : {&publisher, &subscriber}) {
      ASSERT_TRUE(test::end_connection(tool->pid()));
      ASSERT_TRUE(tool->eventually("state", orphaned));
    }
    ASSERT_EQ(publisher.ask("unpub"), "ok");
    ASSERT_EQ(subscriber.ask("unsub"), "ok");  // and still holds a message
  }
  std::filesystem::rename(away, socket());
  for (ClientTool* const tool : {&publisher, &subscriber})
    ASSERT_TRUE(tool->eventually("state", "connected"));
  EXPECT_TRUE(others.eventually("publish 20 10", "ok")) << "nobody reads any more";
  EXPECT_EQ(subscriber.ask("release"), "ok");
  EXPECT_TRUE(others.eventually("matched", "0"));
  EXPECT_TRUE(eventually([&] { return test::wire_dump(socket()).endpoints.size() == 1; }))
      << "only the other process's publisher is left";
}

TEST_F(Reregistration, APublisherWaitsForItsPreviousReadersAndNotForOthers) {
  ClientTool publisher(socket()), first(socket()), slow(socket());
  for (ClientTool* const tool : {&first, &slow}) ASSERT_EQ(tool->ask("sub /t 100"), "ok");
  ASSERT_EQ(publisher.ask("pub /t 100"), "ok");
  ASSERT_TRUE(publisher.eventually("matched", "2"));
  ::kill(slow.pid(), SIGSTOP);
  lose();
  ClientTool newcomer(socket());
  ASSERT_EQ(newcomer.ask("sub /t 100"), "ok");
  ASSERT_TRUE(first.eventually("links", "2"));
  ASSERT_TRUE(newcomer.eventually("links", "1"));
  EXPECT_EQ(newcomer.ask("wait 200"), "timeout");  // long enough for one that does not wait
  ASSERT_EQ(publisher.ask("publish 5 10"), "ok");
  EXPECT_EQ(take_all(first), "1 2 3 4 5 ");
  EXPECT_EQ(take_all(newcomer), "") << "it has not moved";
  ::kill(slow.pid(), SIGCONT);
  ASSERT_TRUE(slow.eventually("state", "connected"));
  ASSERT_TRUE(publisher.eventually("matched", "3"));
  ASSERT_EQ(publisher.ask("publish 1 10"), "ok");
  EXPECT_EQ(take_all(slow), "1 2 3 4 5 6 ");
  EXPECT_EQ(take_all(newcomer), "6 ");
}

TEST_F(Reregistration, ASessionLostBeforeAnyEndpointMovedToItEnds) {
  ClientTool both(socket()), slow(socket());
  for (ClientTool* const tool : {&both, &slow}) ASSERT_EQ(tool->ask("sub /t 100"), "ok");
  ASSERT_EQ(both.ask("pub /t 100"), "ok");
  ASSERT_TRUE(both.eventually("matched", "2"));
  const Use before = use_of(both.pid());
  ::kill(slow.pid(), SIGSTOP);  // the publisher waits for it
  lose();
  ASSERT_TRUE(both.eventually("state", "connected"));
  ASSERT_TRUE(both.eventually("links", "2"));
  lose();
  ::kill(slow.pid(), SIGCONT);
  ASSERT_TRUE(are_connected({&both, &slow}));
  ASSERT_EQ(both.ask("publish 3 10"), "ok");
  EXPECT_EQ(take_all(both), "1 2 3 ");
  EXPECT_EQ(take_all(slow), "1 2 3 ");
  EXPECT_TRUE(both.eventually("links", "1"));
  EXPECT_TRUE(eventually([&] { return use_of(both.pid()).threads == before.threads; }))
      << use_of(both.pid()) << " after " << before;
}

}  // namespace
}  // namespace agnocast
