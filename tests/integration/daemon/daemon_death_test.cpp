// SPDX-License-Identifier: Apache-2.0
//
// Goal: any process may die at any instruction; the daemon undoes or completes the open operation,
// delivers the committed messages, frees the held ones, and reuses nothing of the process while a
// peer knows it. Method: real processes on the daemon's own regions. A child is killed with
// SIGKILL at its n-th crash point, for n = 1, 2, 3 … until it survives; every run uses the places
// of the run before.

#include <journal/verify.hpp>
#include <tests/recovery/stage.hpp>
#include <tests/support/crash/crash_point.hpp>
#include <tests/support/processes/daemon_process.hpp>
#include <tests/support/processes/held.hpp>
#include <tests/support/wire/wire_node.hpp>

#include <fcntl.h>
#include <gtest/gtest.h>
#include <sys/prctl.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

#include <filesystem>
#include <thread>
#include <vector>

namespace agnocast::test {
namespace {

using abi::Qos;
using sweep::answer;
using sweep::Child;
using sweep::serve;

constexpr Qos deep{10, false, true, false, false};
constexpr const char* topic_name = "/sweep";

// A publisher in a process of its own: p publish · w until a subscription is attached · x packets,
// then a reclamation scan.
Child publisher_child(const std::string& socket, std::uint64_t crash_at) {
  return Child(crash_at, [socket](int commands, std::uint64_t n) {
    ::prctl(PR_SET_PDEATHSIG, SIGKILL);
    WireNode node(socket);
    if (!node.create_publisher(topic_name, deep)) ::_exit(3);
    std::uint64_t number = 0;
    serve(commands, [&](char what) -> char {
      switch (what) {
        case 'w':
          if (!node.wait_for([&] { return node.attached_count() == 1; })) return '-';
          crash_points::arm(n);
          return answer(true);
        case 'p':
          return answer(node.publish(++number));
        case 'x':
          node.pump();
          node.scan();
          return answer(true);
        default:
          return '?';
      }
    });
  });
}

// A subscriber in a process of its own: w until a publisher is linked · t take · r release.
Child subscriber_child(const std::string& socket, std::uint64_t crash_at) {
  return Child(crash_at, [socket](int commands, std::uint64_t n) {
    ::prctl(PR_SET_PDEATHSIG, SIGKILL);
    WireNode node(socket);
    if (!node.create_subscription(topic_name, deep)) ::_exit(3);
    serve(commands, [&](char what) -> char {
      switch (what) {
        case 'w':
          if (!node.wait_for([&] { return node.link_count() == 1; })) return '-';
          crash_points::arm(n);
          return answer(true);
        case 't':
          return answer(node.take().has_value());
        case 'r':
          return answer(node.release());
        default:
          return '?';
      }
    });
  });
}

TEST(DaemonDeath, RepairsAPublisherKilledAtAnyPointAndDeliversWhatItCommitted) {
  DaemonProcess daemon({.arguments = {"--log-level", "debug"}});
  WireNode subscriber(daemon.socket_path());
  ASSERT_TRUE(subscriber.create_subscription(topic_name, deep));
  // Upper case: the subscriber's steps between the publisher's commands (T take, R release).
  const char* const script = "wppTpTRpRTRxpTTRRxpx";
  unsigned deaths = 0, kept = 0, completed = 0;
  bool survived = false;
  for (std::uint64_t n = 1; !survived && !HasFailure(); ++n) {
    SCOPED_TRACE("crash point " + std::to_string(n));
    Child child = publisher_child(daemon.socket_path(), n);
    ASSERT_TRUE(subscriber.wait_for([&] { return subscriber.link_count() == 1; }));
    std::uint64_t committed = 0, last = 0;
    bool alive = true, publishing = false;
    const auto take = [&] {
      const auto number = subscriber.take();
      if (number) {
        EXPECT_EQ(*number, last + 1) << "twice, out of order, or lost";
        last = *number;
      }
      return number.has_value();
    };
    for (const char* at = script; *at != '\0' && alive; ++at) {
      if (*at == 'T') {
        take();
      } else if (*at == 'R') {
        subscriber.release();
      } else {
        const auto answer = child.command(*at);
        alive = answer.has_value();
        if (alive) {
          ASSERT_EQ(*answer, '+');
        }
        publishing = !alive && *at == 'p';
        if (alive && *at == 'p') ++committed;
      }
    }
    survived = alive;
    if (survived) break;
    EXPECT_TRUE(child.was_killed());
    ++deaths;
    ASSERT_TRUE(subscriber.wait_for([&] { return subscriber.orphaned().size() == 1; }));
    const auto broken = subscriber.verify_orphans();
    EXPECT_EQ(broken, journal::Invariant::none) << journal::sentence_of(broken);
    while (take()) {
    }
    if (publishing && last == committed + 1) {
      ++completed;  // the interrupted publish was committed
    } else {
      EXPECT_EQ(last, committed);
      ++kept;
    }
    while (subscriber.release()) {
    }
    EXPECT_EQ(subscriber.lost(), 0u);
    subscriber.unlink_drained();
    EXPECT_EQ(subscriber.link_count(), 0u);
    // Handled before the next process arrives, so that it gets the same places.
    EXPECT_EQ(subscriber.wire().open_window(7).opcode(), wire::Opcode::refused);
  }
  EXPECT_TRUE(survived);
  EXPECT_GT(deaths, 60u);
  EXPECT_GT(kept, 0u);
  EXPECT_GT(completed, 0u);
  EXPECT_NE(daemon.log().find("rolled_back=1"), std::string::npos);
  EXPECT_NE(daemon.log().find("rolled_forward=1"), std::string::npos);
  EXPECT_EQ(daemon.log().find("corrupt_intents=1"), std::string::npos);
  std::printf("%u deaths, %u with the interrupted message committed\n", deaths, completed);
}

TEST(DaemonDeath, FreesTheMessagesHeldByASubscriberWhereverItDied) {
  DaemonProcess daemon;
  WireNode publisher(daemon.socket_path());
  ASSERT_TRUE(publisher.create_publisher(topic_name, deep));
  std::uint64_t number = 0;
  unsigned deaths = 0;
  bool survived = false;
  for (std::uint64_t n = 1; !survived && !HasFailure(); ++n) {
    SCOPED_TRACE("crash point " + std::to_string(n));
    Child child = subscriber_child(daemon.socket_path(), n);
    ASSERT_TRUE(publisher.wait_for([&] { return publisher.attached_count() == 1; }));
    bool alive = true;
    for (const char* at = "wPPttPtrPtrPt"; *at != '\0' && alive; ++at) {
      if (*at == 'P') {
        ASSERT_TRUE(publisher.publish(++number));
      } else {
        const auto answered = child.command(*at);
        alive = answered.has_value();
        if (alive) {
          ASSERT_EQ(*answered, '+') << "command " << *at;
        }
      }
    }
    survived = alive;
    if (survived) break;
    EXPECT_TRUE(child.was_killed());
    ++deaths;
    ASSERT_TRUE(publisher.wait_for([&] { return publisher.attached_count() == 0; }));
    publisher.scan();
    EXPECT_EQ(publisher.allocated_count(), 0u) << "a dead process holds a message";
    EXPECT_EQ(publisher.wire().open_window(7).opcode(), wire::Opcode::refused);
  }
  EXPECT_TRUE(survived);
  EXPECT_GT(deaths, 15u);
}

TEST(DaemonDeath, RingsAndDrainsAfterAPublishersDeath) {
  DaemonProcess daemon;
  WireNode subscriber(daemon.socket_path());
  ASSERT_TRUE(subscriber.create_subscription(topic_name, deep));
  Child child = publisher_child(daemon.socket_path(), 0);
  ASSERT_TRUE(subscriber.wait_for([&] { return subscriber.link_count() == 1; }));
  ASSERT_EQ(child.command('w'), '+');
  for (int i = 0; i < 7; ++i) ASSERT_EQ(child.command('p'), '+');
  ASSERT_EQ(subscriber.take(), 1u);
  const auto state = [&] {
    return abi::state_of(subscriber.topic(0)
                             .publisher(0, offsetof(abi::PublisherEntry, word))
                             .load(std::memory_order_acquire));
  };
  EXPECT_EQ(state(), abi::BoardState::active);
  subscriber.doorbells().drain();
  child.end();
  // Only the daemon rings here: the test's publisher has no doorbell in its environment.
  pollfd doorbell{subscriber.doorbells().datagram_fd(), POLLIN, 0};
  EXPECT_EQ(::poll(&doorbell, 1, WireClient::patience_ms), 1)
      << "the daemon does not ring the sleeping subscriber";
  ASSERT_TRUE(subscriber.wait_for([&] { return subscriber.orphaned().size() == 1; }));
  EXPECT_EQ(state(), abi::BoardState::orphan);
  for (std::uint64_t number = 2; number <= 7; ++number) EXPECT_EQ(subscriber.take(), number);
  EXPECT_EQ(subscriber.take(), std::nullopt);
  while (subscriber.release()) {
  }
  subscriber.unlink_drained();
  EXPECT_EQ(subscriber.wire().open_window(7).opcode(), wire::Opcode::refused);
  EXPECT_EQ(state(), abi::BoardState::free);
}

TEST(DaemonDeath, ReusesRegionAndWindowOnlyWhenAllPeersHaveUnmapped) {
  DaemonProcess daemon;
  WireNode subscriber(daemon.socket_path());
  ASSERT_TRUE(subscriber.create_subscription(topic_name, deep));
  struct Places {
    std::uint64_t client, window, publisher;
  };
  // A publisher's process comes, publishes once and is killed; returns its places.
  const auto one_life = [&] {
    Child child = publisher_child(daemon.socket_path(), 0);
    const std::size_t links = subscriber.link_count();
    Places places{};
    while (subscriber.link_count() == links) {
      Incoming packet = subscriber.wire().next();
      if (packet.bytes.empty()) break;
      if (packet.opcode() == wire::Opcode::announce) {
        const auto body = packet.as<wire::Announcement>();
        places = {body.client, body.window[0].base, body.index};
      }
      subscriber.handle(std::move(packet));
    }
    EXPECT_EQ(child.command('w'), '+');
    EXPECT_EQ(child.command('p'), '+');
    const std::size_t orphans = subscriber.orphaned().size();
    child.end();
    EXPECT_TRUE(subscriber.wait_for([&] { return subscriber.orphaned().size() == orphans + 1; }));
    return places;
  };
  const auto settled = [&] {
    EXPECT_EQ(subscriber.wire().open_window(7).opcode(), wire::Opcode::refused);
  };
  const Places first = one_life();
  const Places second = one_life();
  EXPECT_NE(second.client, first.client) << "the subscriber still maps its region";
  EXPECT_NE(second.window, first.window);
  EXPECT_NE(second.publisher, first.publisher);

  ASSERT_TRUE(subscriber.take());
  ASSERT_TRUE(subscriber.take());
  ASSERT_TRUE(subscriber.release());
  ASSERT_TRUE(subscriber.release());
  subscriber.unlink_drained(false);  // the endpoints, not the regions
  settled();
  const Places third = one_life();
  EXPECT_EQ(third.publisher, first.publisher) << "no peer uses the index any more";
  EXPECT_NE(third.client, first.client) << "the region is still mapped";
  EXPECT_NE(third.client, second.client);
  EXPECT_NE(third.window, first.window);

  subscriber.unmap_regions();
  settled();
  const Places fourth = one_life();
  EXPECT_EQ(fourth.client, first.client);
  EXPECT_EQ(fourth.window, first.window);
}

TEST(DaemonDeath, FreesPlacesThatOnlyDeadProcessesKnew) {
  // The process that dies first has never acknowledged the end of the other.
  for (const bool subscriber_first : {true, false}) {
    SCOPED_TRACE(subscriber_first);
    DaemonProcess daemon;
    WireNode watcher(daemon.socket_path());  // process 0
    const auto gone = [&](std::size_t count) {
      return eventually([&] {
        std::size_t found = 0;
        const std::string log = daemon.log();
        for (std::size_t at = 0; (at = log.find("client gone", at)) != std::string::npos; ++at)
          ++found;
        return found == count;
      });
    };
    const std::size_t fds = daemon.descriptor_count();
    Child publisher = publisher_child(daemon.socket_path(), 0);
    Child subscriber = subscriber_child(daemon.socket_path(), 0);
    ASSERT_EQ(publisher.command('w'), '+');
    ASSERT_EQ(subscriber.command('w'), '+');
    (subscriber_first ? subscriber : publisher).end();
    ASSERT_TRUE(gone(1));
    (subscriber_first ? publisher : subscriber).end();
    ASSERT_TRUE(gone(2));
    // Other threads close connections, a moment later.
    EXPECT_TRUE(eventually([&] { return daemon.descriptor_count() == fds; }))
        << daemon.descriptor_count() << " instead of " << fds;
    EXPECT_TRUE(std::filesystem::is_empty(daemon.socket_path() + ".bells"));
    // Everything is as at the beginning: both kinds of places are free again.
    Child next = publisher_child(daemon.socket_path(), 0);
    ASSERT_EQ(next.command('x'), '+');
    ASSERT_TRUE(watcher.create_subscription(topic_name, deep));
    EXPECT_EQ(watcher.subscription().index, 0u);
    Incoming packet = watcher.wire().next();
    ASSERT_EQ(packet.opcode(), wire::Opcode::announce);
    const auto about = packet.as<wire::Announcement>();
    EXPECT_EQ(about.index, 0u);
    EXPECT_LE(about.client, 2u);
    EXPECT_EQ(about.window[0].base, watcher.welcome().arena_base);
  }
}

TEST(DaemonDeath, DoesNotTreatAClosedConnectionAsADeathWhileTheRegionIsMapped) {
  DaemonProcess daemon({.arguments = {"--log-level", "debug"}});
  WireNode subscriber(daemon.socket_path());
  ASSERT_TRUE(subscriber.create_subscription(topic_name, deep));
  sweep::Child publisher(0, [&](int commands, std::uint64_t) {
    auto node = std::make_unique<WireNode>(daemon.socket_path());
    if (!node->create_publisher(topic_name, deep)) ::_exit(3);
    serve(commands, [&](char what) -> char {
      switch (what) {
        case 'w':
          return answer(node->wait_for([&] { return node->attached_count() == 1; }));
        case 'c':
          node->wire().socket().close();
          return answer(true);
        case 'p':
          return answer(node->publish(1));
        default:
          node.reset();
          return answer(true);
      }
    });
  });
  ASSERT_TRUE(subscriber.wait_for([&] { return subscriber.link_count() == 1; }));
  ASSERT_EQ(publisher.command('w'), '+');
  ASSERT_EQ(publisher.command('c'), '+');
  ASSERT_TRUE(daemon.wait_for_log("connection closed"));
  // The daemon has noticed and leaves everything as it is: the pair goes on.
  ASSERT_EQ(publisher.command('p'), '+');
  EXPECT_EQ(subscriber.take(), 1u);
  EXPECT_EQ(subscriber.wire().open_window(7).opcode(), wire::Opcode::refused);
  EXPECT_TRUE(subscriber.orphaned().empty());
  EXPECT_EQ(daemon.log().find("client gone"), std::string::npos);
  // Without connection and without region the process is no client any more, however long it
  // lives.
  ASSERT_EQ(publisher.command('u'), '+');
  EXPECT_TRUE(subscriber.wait_for([&] { return subscriber.orphaned().size() == 1; }));
  EXPECT_TRUE(daemon.wait_for_log("how=\"process unmapped its region\""));
}

TEST(DaemonDeath, KeepsAProcessWhoseFirstThreadHasEnded) {
  DaemonProcess daemon({.arguments = {"--log-level", "debug"}});
  WireNode subscriber(daemon.socket_path());
  ASSERT_TRUE(subscriber.create_subscription(topic_name, deep));
  // Its memory is no longer visible under its pid, and its other thread goes on storing.
  sweep::Child publisher(0, [&](int commands, std::uint64_t) {
    WireNode node(daemon.socket_path());
    if (!node.create_publisher(topic_name, deep)) ::_exit(3);
    std::thread([&] {
      serve(commands, [&](char what) -> char {
        if (what == 'c') node.wire().socket().close();
        return answer(what == 'c' || node.publish(1));
      });
    }).detach();
    ::syscall(SYS_exit, 0);
  });
  ASSERT_TRUE(subscriber.wait_for([&] { return subscriber.link_count() == 1; }));
  ASSERT_EQ(publisher.command('c'), '+');
  ASSERT_TRUE(daemon.wait_for_log("connection closed"));
  ASSERT_EQ(publisher.command('p'), '+');
  EXPECT_EQ(subscriber.take(), 1u);
  // Longer than the daemon's interval between two looks at a process without a connection.
  ::usleep(600'000);
  EXPECT_EQ(daemon.log().find("client gone"), std::string::npos);
  publisher.end();
  EXPECT_TRUE(subscriber.wait_for([&] { return subscriber.orphaned().size() == 1; }));
  EXPECT_TRUE(daemon.wait_for_log("how=\"process ended\""));
}

TEST(DaemonDeath, TreatsAProcessThatExecutesAnotherProgramAsDead) {
  DaemonProcess daemon;
  WireNode subscriber(daemon.socket_path());
  ASSERT_TRUE(subscriber.create_subscription(topic_name, deep));
  sweep::Child publisher(0, [&](int commands, std::uint64_t) {
    WireNode node(daemon.socket_path());
    if (!node.create_publisher(topic_name, deep)) ::_exit(3);
    serve(commands, [&](char what) -> char {
      if (what == 'p') return answer(node.publish(1));
      if (what == 'e') ::execlp("sleep", "sleep", "60", static_cast<char*>(nullptr));
      return '-';
    });
  });
  ASSERT_TRUE(subscriber.wait_for([&] { return subscriber.link_count() == 1; }));
  ASSERT_EQ(publisher.command('p'), '+');
  EXPECT_EQ(publisher.command('e'), std::nullopt);
  ASSERT_TRUE(subscriber.wait_for([&] { return subscriber.orphaned().size() == 1; }));
  EXPECT_EQ(subscriber.take(), 1u) << "its committed message is delivered";
  EXPECT_TRUE(daemon.wait_for_log("how=\"process unmapped its region\""));
  publisher.end();
}

TEST(DaemonDeath, KeepsAForkedChildFromHidingADeath) {
  DaemonProcess daemon;
  WireNode subscriber(daemon.socket_path());
  ASSERT_TRUE(subscriber.create_subscription(topic_name, deep));
  // The child's child keeps the connection open; the pidfd reports the death all the same.
  sweep::Child publisher(0, [&](int commands, std::uint64_t) {
    WireNode node(daemon.socket_path());
    if (!node.create_publisher(topic_name, deep)) ::_exit(3);
    serve(commands, [&](char what) -> char {
      if (what == 'f' && ::fork() == 0) {
        ::prctl(PR_SET_PDEATHSIG, 0);
        ::execlp("sleep", "sleep", "5", static_cast<char*>(nullptr));
        ::_exit(1);
      }
      return '+';
    });
  });
  ASSERT_TRUE(subscriber.wait_for([&] { return subscriber.link_count() == 1; }));
  ASSERT_EQ(publisher.command('f'), '+');
  publisher.end();
  EXPECT_TRUE(subscriber.wait_for([&] { return subscriber.orphaned().size() == 1; }));
}

TEST(DaemonDeath, UsesNoMoreAfterTwoThousandProcesses) {
  DaemonProcess daemon;
  WireNode subscriber(daemon.socket_path());
  ASSERT_TRUE(subscriber.create_subscription(topic_name, deep));
  std::uint64_t highest_client = 0;
  const auto one_life = [&] {
    const pid_t pid = ::fork();
    if (pid == 0) {
      WireNode node(daemon.socket_path());
      if (!node.create_publisher(topic_name, deep)) ::_exit(3);
      ::_exit(node.publish(1) && !HasFailure() ? 0 : 4);
    }
    int status = 0;
    ASSERT_EQ(::waitpid(pid, &status, 0), pid);
    ASSERT_EQ(status, 0);
    while (subscriber.orphaned().empty()) {
      Incoming packet = subscriber.wire().next();
      if (packet.bytes.empty()) break;
      if (packet.opcode() == wire::Opcode::announce)
        highest_client = std::max(highest_client, packet.as<wire::Announcement>().client);
      subscriber.handle(std::move(packet));
    }
    ASSERT_EQ(subscriber.take(), 1u);
    subscriber.release();
    subscriber.unlink_drained();
    ASSERT_EQ(subscriber.link_count(), 0u);
    ASSERT_EQ(subscriber.wire().open_window(7).opcode(), wire::Opcode::refused);
  };
  constexpr int lives = 1900, warm = 100;
  for (int life = 0; life < warm && !HasFailure(); ++life) one_life();
  const std::size_t fds = daemon.descriptor_count();
  // Leaked memory comes each time; a peak, when the daemon was late, is there once and for all.
  std::vector<std::size_t> own_kib = {held_by(daemon.pid()).anonymous_kib};
  const auto is_flat = [&] {
    return own_kib.size() > 1 && own_kib.back() < *(own_kib.end() - 2) + 1024;
  };
  while (!is_flat() && own_kib.size() <= 4 && !HasFailure()) {
    for (int life = 0; life < lives && !HasFailure(); ++life) one_life();
    own_kib.push_back(held_by(daemon.pid()).anonymous_kib);
  }
  EXPECT_TRUE(is_flat()) << "the daemon grows with every process: "
                         << testing::PrintToString(own_kib)
                         << " KiB are its own, one after the other";
  EXPECT_TRUE(eventually([&] { return daemon.descriptor_count() <= fds; }))
      << daemon.descriptor_count() << ", before " << fds;
  EXPECT_LE(highest_client, 3u) << "places are used again";
}

}  // namespace
}  // namespace agnocast::test
