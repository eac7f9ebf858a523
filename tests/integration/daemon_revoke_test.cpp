// SPDX-License-Identifier: Apache-2.0
//
// Goal: the membership of a process that lives can be ended: nobody else is hurt, waits or loses
// what was committed; the process is told, may not come back, and its places are used again only
// after its end. Who lies about what it holds, or keeps the places of those that are gone from others,
// is put out without being asked for.
// All that outlives the daemon.
// Method: raw clients in processes of their own, SIGSTOP, and an observer that revokes; SIGKILL of the
// daemon, whose supervisor starts the next one.

#include <agnocast/abi/observe.hpp>
#include <tests/recovery/stage.hpp>
#include <tests/support/daemon_process.hpp>
#include <tests/support/wire_dump.hpp>
#include <tests/support/wire_node.hpp>

#include <grp.h>
#include <gtest/gtest.h>
#include <poll.h>
#include <signal.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <cstring>
#include <map>
#include <memory>
#include <optional>
#include <string>

namespace agnocast::test {
namespace {

using abi::Qos;
using sweep::Child;
using sweep::serve;

constexpr Qos deep{10, false, true, false, false};
constexpr const char* topic_name = "/revoked";
const DaemonOptions talkative{.arguments = {"--log-level", "debug"}};

char answer(bool done) { return testing::Test::HasFailure() ? '!' : done ? '+' : '-'; }

/// The answer to a hello on a new connection; none: the daemon hung up, since it had no time to look whether the process was
/// revoked.
std::optional<Incoming> greet(const std::string& socket) {
  auto connected = PacketSocket::connect(socket);
  if (!connected) return std::nullopt;
  wire::Hello hello{};
  hello.header = {wire::Opcode::hello, sizeof hello, 1};
  hello.fingerprint = abi::fingerprint();
  if (!connected->send(std::as_bytes(std::span(&hello, 1)), {}, Wait::yes)) return std::nullopt;
  pollfd entry{connected->fd(), POLLIN, 0};
  if (::poll(&entry, 1, WireClient::patience_ms) != 1) return std::nullopt;
  std::array<std::byte, wire::answer_bytes_max> buffer;
  const auto packet = connected->receive(buffer);
  if (!packet || packet->kind != Packet::Kind::data) return std::nullopt;
  return Incoming{{buffer.begin(), buffer.begin() + static_cast<std::ptrdiff_t>(packet->bytes)},
                  {}};
}

// What every child can: R reads packets up to `revoked` and the end behind it · H says hello on a new
// connection and is refused · J the same with rejoin · A hello, and is welcome · e executes another
// program, and so does not answer.
char execute_common(WireNode& node, const std::string& socket, char what) {
  if (what == 'R') {
    for (;;) {
      const Incoming packet = node.wire().next();
      if (packet.bytes.empty()) return '-';
      if (packet.opcode() != wire::Opcode::revoked) continue;
      const auto body = packet.as<wire::Refused>();
      return answer(static_cast<Errc>(body.code) == Errc::revoked && body.text.text[0] != '\0' &&
                    node.wire().is_hung_up());
    }
  }
  if (what == 'e') ::execlp("sleep", "sleep", "60", static_cast<char*>(nullptr));
  if (what == 'J') {
    WireClient again(socket);
    return answer(again.rejoin(node.welcome()).refused_code() == Errc::revoked);
  }
  std::optional<Incoming> said;
  if (!eventually([&] { return (said = greet(socket)).has_value(); })) return '-';
  if (what == 'H') return answer(said->refused_code() == Errc::revoked);
  return what == 'A' ? answer(said->opcode() == wire::Opcode::welcome) : '?';
}

// p publish · w until a subscription is attached · x packets, then a pass.
Child publisher_child(const std::string& socket) {
  return Child(0, [socket](int commands, std::uint64_t) {
    ::prctl(PR_SET_PDEATHSIG, SIGKILL);
    WireNode node(socket);
    if (!node.create_publisher(topic_name, deep)) ::_exit(3);
    std::uint64_t number = 0;
    serve(commands, [&](char what) -> char {
      switch (what) {
        case 'w':
          return answer(node.wait_for([&] { return node.attached_count() == 1; }));
        case 'p':
          return answer(node.publish(++number));
        default:
          return execute_common(node, socket, what);
      }
    });
  });
}

// w until a publisher is linked · t take · l holds more than it may.
Child subscriber_child(const std::string& socket) {
  return Child(0, [socket](int commands, std::uint64_t) {
    ::prctl(PR_SET_PDEATHSIG, SIGKILL);
    WireNode node(socket);
    if (!node.create_subscription(topic_name, deep)) ::_exit(3);
    serve(commands, [&](char what) -> char {
      switch (what) {
        case 'w':
          return answer(node.wait_for([&] { return node.link_count() == 1; }));
        case 't':
          return answer(node.take().has_value());
        case 'l':
          return answer(node.claim_holds(0, 5));
        default:
          return execute_common(node, socket, what);
      }
    });
  });
}

struct Observer {
  explicit Observer(const std::string& socket) : wire(socket) {
    wire::Observe body{};
    body.fingerprint = abi::fingerprint();
    EXPECT_EQ(wire.ask(wire::Opcode::observe, body).opcode(), wire::Opcode::observed);
  }
  Incoming revoke(std::uint64_t client, std::uint64_t generation) {
    wire::Revoke body{};
    body.client = client;
    body.generation = generation;
    return wire.ask(wire::Opcode::revoke, body);
  }
  /// The processes as they are now, by index.
  std::map<std::uint64_t, wire::DumpProcess> processes() {
    std::map<std::uint64_t, wire::DumpProcess> all;
    wire.send(wire::Opcode::dump, wire::Dump{});
    for (;;) {
      const Incoming packet = wire.next();
      if (packet.bytes.empty() || packet.opcode() == wire::Opcode::dump_end) return all;
      if (packet.opcode() != wire::Opcode::dump_process) continue;
      const auto process = packet.as<wire::DumpProcess>();
      all[process.client] = process;
    }
  }
  WireClient wire;
};

TEST(DaemonRevoke, EndsASubscriberThatIsStoppedAndItsHoldsVanish) {
  DaemonProcess daemon(talkative);
  WireNode publisher(daemon.socket_path());  // process 0
  ASSERT_TRUE(publisher.create_publisher(topic_name, deep));
  Child subscriber = subscriber_child(daemon.socket_path());
  ASSERT_TRUE(publisher.wait_for([&] { return publisher.attached_count() == 1; }));
  ASSERT_EQ(subscriber.command('w'), '+');
  for (std::uint64_t number = 1; number <= 5; ++number) ASSERT_TRUE(publisher.publish(number));
  for (int i = 0; i < 3; ++i) ASSERT_EQ(subscriber.command('t'), '+');
  ASSERT_EQ(::kill(subscriber.pid(), SIGSTOP), 0);
  for (std::uint64_t number = 6; number <= 60; ++number)
    ASSERT_TRUE(publisher.publish(number)) << "it is never blocked";
  publisher.pass();
  EXPECT_EQ(publisher.allocated_count(), 13u) << "what is held, and its depth";

  Observer observer(daemon.socket_path());
  const auto before = observer.processes();
  ASSERT_EQ(before.count(1), 1u);
  ASSERT_EQ(observer.revoke(1, before.at(1).generation).opcode(), wire::Opcode::done);
  ASSERT_TRUE(publisher.wait_for([&] { return publisher.attached_count() == 0; }));
  publisher.pass();
  EXPECT_EQ(publisher.allocated_count(), 0u);
  EXPECT_EQ(observer.processes().at(1).state, wire::ProcessState::revoked);
  EXPECT_EQ(observer.revoke(1, before.at(1).generation).refused_code(), Errc::endpoint_gone);

  ASSERT_EQ(::kill(subscriber.pid(), SIGCONT), 0);
  EXPECT_EQ(subscriber.command('R'), '+');
  EXPECT_EQ(subscriber.command('H'), '+') << "it may not come back";
  EXPECT_EQ(subscriber.command('t'), '-');
  EXPECT_TRUE(
      daemon.wait_for_log("client revoked client=1 pid=" + std::to_string(subscriber.pid())));
  EXPECT_EQ(daemon.log().find("client place free client=1"), std::string::npos);
  subscriber.end();
  EXPECT_TRUE(daemon.wait_for_log("client place free client=1"));
}

TEST(DaemonRevoke, DeliversWhatAPublisherHadCommittedAndNothingAfterIt) {
  DaemonProcess daemon(talkative);
  WireNode subscriber(daemon.socket_path());  // process 0
  ASSERT_TRUE(subscriber.create_subscription(topic_name, deep));
  Child publisher = publisher_child(daemon.socket_path());
  ASSERT_TRUE(subscriber.wait_for([&] { return subscriber.link_count() == 1; }));
  ASSERT_EQ(publisher.command('w'), '+');
  for (int i = 0; i < 4; ++i) ASSERT_EQ(publisher.command('p'), '+');
  ASSERT_EQ(subscriber.take(), 1u);
  ASSERT_EQ(::kill(publisher.pid(), SIGSTOP), 0);
  Observer observer(daemon.socket_path());
  const auto revoked = observer.processes().at(1);
  ASSERT_EQ(observer.revoke(1, revoked.generation).opcode(), wire::Opcode::done);
  ASSERT_TRUE(subscriber.wait_for([&] { return subscriber.orphaned().size() == 1; }));
  // It goes on and does not know yet: a core that honours what the board and its readers say. What
  // it publishes still pushes older messages out of a subscription's depth.
  ASSERT_EQ(::kill(publisher.pid(), SIGCONT), 0);
  for (int i = 0; i < 5; ++i) ASSERT_EQ(publisher.command('p'), '+');
  for (std::uint64_t number = 2; number <= 4; ++number) EXPECT_EQ(subscriber.take(), number);
  EXPECT_EQ(subscriber.take(), std::nullopt) << "what came later is nobody's";
  EXPECT_EQ(publisher.command('R'), '+');
  for (int i = 0; i < 50; ++i) ASSERT_EQ(publisher.command('p'), '+');
  while (subscriber.release()) {  // each is checked: it did not change while it was held
  }
  subscriber.unlink_drained();
  EXPECT_EQ(subscriber.wire().open_window(7).opcode(), wire::Opcode::refused);

  // Its index in the topic has nobody any more; its place and its addresses it has itself.
  const auto next_place = [&] {
    Child next = publisher_child(daemon.socket_path());
    Incoming packet = subscriber.wire().next();
    EXPECT_EQ(packet.opcode(), wire::Opcode::announce);
    const auto body = packet.as<wire::Announcement>();
    subscriber.handle(std::move(packet));
    next.end();
    EXPECT_TRUE(subscriber.wait_for([&] { return subscriber.orphaned().size() == 1; }));
    subscriber.unlink_drained();
    EXPECT_EQ(subscriber.wire().open_window(7).opcode(), wire::Opcode::refused);
    return body;
  };
  const auto while_it_lives = next_place();
  EXPECT_EQ(while_it_lives.index, 0u);
  EXPECT_NE(while_it_lives.client, 1u);
  EXPECT_NE(while_it_lives.window[0].base, revoked.window[0].base);
  publisher.end();
  ASSERT_TRUE(daemon.wait_for_log("client place free client=1"));
  const auto after = next_place();
  EXPECT_EQ(after.client, 1u);
  EXPECT_EQ(after.window[0].base, revoked.window[0].base);
}

TEST(DaemonRevoke, RepairsNothingInTheRegionOfAProcessThatLives) {
  DaemonProcess daemon;
  WireNode publisher(daemon.socket_path());
  ASSERT_TRUE(publisher.create_publisher(topic_name, deep));
  ASSERT_TRUE(publisher.publish(1));
  // As it stands between P4 and P5: it may go on with the commit at any time.
  const auto words = publisher.queue();
  const std::uint64_t next = abi::sequence_of(words.head().load()) + 1;
  words.intent_sequence().store(next);
  words.intent_slot().store(5);
  words.intent_op().store(abi::intent_publish);
  words.slot_id(5).store(next);
  words.order(next).store(abi::pack_entry(next, 5));
  Observer observer(daemon.socket_path());
  ASSERT_EQ(observer.revoke(0, observer.processes().at(0).generation).opcode(), wire::Opcode::done);
  EXPECT_EQ(words.intent_op().load(), abi::intent_publish);
  EXPECT_EQ(words.slot_id(5).load(), next);
  EXPECT_EQ(words.order(next).load(), abi::pack_entry(next, 5));
}

TEST(DaemonRevoke, TellsAProcessWhoseSocketIsFullWhenItReads) {
  DaemonProcess daemon({.more_config = "[quota]\nsubscriptions_per_topic = \"unlimited\"\n",
                        .arguments = {"--log-level", "debug"}});
  Child publisher = publisher_child(daemon.socket_path());
  ASSERT_EQ(publisher.command('x'), '?');
  ASSERT_EQ(::kill(publisher.pid(), SIGSTOP), 0);
  WireClient many(daemon.socket_path());
  many.hello();
  many.open_executor();
  for (int i = 0; i < 700; ++i)
    ASSERT_EQ(many.create_subscription(topic_name, deep).opcode(), wire::Opcode::endpoint_created);
  Observer observer(daemon.socket_path());
  ASSERT_EQ(observer.revoke(0, observer.processes().at(0).generation).opcode(), wire::Opcode::done);
  ASSERT_EQ(::kill(publisher.pid(), SIGCONT), 0);
  EXPECT_EQ(publisher.command('R'), '+');
}

TEST(DaemonRevoke, IsForgottenWhenTheProcessExecutesAnotherProgramOrEnds) {
  DaemonProcess daemon(talkative);
  Observer observer(daemon.socket_path());
  Child first = publisher_child(daemon.socket_path());
  ASSERT_EQ(first.command('p'), '+');
  const auto process = observer.processes().at(0);
  ASSERT_EQ(observer.revoke(0, process.generation).opcode(), wire::Opcode::done);
  EXPECT_EQ(first.command('H'), '+');
  first.end();
  ASSERT_TRUE(daemon.wait_for_log("client place free client=0"));
  EXPECT_EQ(observer.revoke(0, process.generation).refused_code(), Errc::endpoint_gone);
  Child second = publisher_child(daemon.socket_path());
  ASSERT_EQ(second.command('p'), '+');
  EXPECT_EQ(second.command('A'), '+') << "another process is welcome";
  const auto again = observer.processes().at(0);
  EXPECT_NE(again.generation, process.generation);
  ASSERT_EQ(observer.revoke(0, again.generation).opcode(), wire::Opcode::done);
  EXPECT_EQ(second.command('e'), std::nullopt);
  EXPECT_TRUE(eventually([&] { return observer.processes().count(0) == 0; }));
  const auto counters = wire_dump(daemon.socket_path()).daemon.counters;
  EXPECT_EQ(counters.clients_revoked, 2u);
  EXPECT_EQ(counters.clients_died, 0u) << "each is counted once";
  EXPECT_EQ(counters.clients_let_go, 1u) << "the one that was welcome";
}

// n nothing · d lets go of everything · m makes it slow to look at · h hello: welcome, revoked, connection ended.
Child forgetful_child(const std::string& socket) {
  return Child(0, [socket](int commands, std::uint64_t) {
    ::prctl(PR_SET_PDEATHSIG, SIGKILL);
    auto node = std::make_unique<WireNode>(socket);
    serve(commands, [&](char what) -> char {
      if (what == 'd') node.reset();
      if (what == 'd' || what == 'n') return '+';
      if (what == 'm') {
        // Below the region, where one looks first; neighbours with the same rights would be one.
        constexpr std::size_t count = 60'000;
        const auto page = static_cast<std::size_t>(::sysconf(_SC_PAGESIZE));
        void* const all = ::mmap(nullptr, count * page, PROT_NONE,
                                 MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
        std::size_t made = 0;
        while (made < count &&
               ::mprotect(static_cast<char*>(all) + made * page, page, PROT_READ) == 0)
          made += 2;
        return answer(made > count / 2);
      }
      const auto said = greet(socket);
      if (!said) return 'e';
      return said->opcode() == wire::Opcode::welcome ? 'w' : 'r';
    });
  });
}

TEST(DaemonRevoke, IsNotSaidOfAProcessThatThereIsNoTimeToLookAt) {
  DaemonProcess daemon(talkative);
  Observer observer(daemon.socket_path());
  Child slow = forgetful_child(daemon.socket_path());
  ASSERT_EQ(slow.command('m'), '+') << "vm.max_map_count is too small";
  Child other = forgetful_child(daemon.socket_path());
  ASSERT_EQ(other.command('n'), '+');
  for (const auto& [client, process] : observer.processes())
    ASSERT_EQ(observer.revoke(client, process.generation).opcode(), wire::Opcode::done);
  // The look at the slow one takes all the time there is for a while.
  ASSERT_TRUE(eventually([&] { return slow.command('h') == 'r'; }));
  ASSERT_EQ(other.command('d'), '+');
  std::optional<char> answer;
  ASSERT_TRUE(eventually([&] {
    answer = other.command('h');
    return answer != 'e';
  }));
  EXPECT_EQ(answer, 'w') << "it has nothing left of what was revoked";
}

// --- and the daemon dies

void restart(DaemonProcess& daemon) {
  const pid_t old = daemon.kill_worker();
  ASSERT_TRUE(daemon.wait_for_next(old)) << daemon.log();
}

enum class End : std::uint8_t { later, while_away, becomes_another_program };

TEST(DaemonRevoke, OutlivesTheDaemonAndThePlaceIsKeptUntilTheProcessEnds) {
  for (const End end : {End::later, End::while_away, End::becomes_another_program}) {
    SCOPED_TRACE(static_cast<int>(end));
    DaemonProcess daemon(talkative);
    std::uint64_t others = 0;  // that were members and are none any more
    const auto revoke = [&](std::uint64_t client) {
      Observer observer(daemon.socket_path());
      return observer.revoke(client, observer.processes().at(client).generation).opcode();
    };
    const auto process = [&](std::uint64_t client) {
      const WireDump dump = wire_dump(daemon.socket_path());
      const wire::DaemonCounters& counters = dump.daemon.counters;
      EXPECT_EQ(counters.clients_revoked, 1u);
      EXPECT_LE(counters.clients_died + counters.clients_let_go, others) << "counted once more";
      EXPECT_EQ(counters.clients_died_meanwhile, 0u);
      const auto* const found = dump.process(client);
      return found == nullptr ? std::optional<wire::DumpProcess>() : *found;
    };
    Child bystander = publisher_child(daemon.socket_path());  // process 0
    ASSERT_EQ(bystander.command('p'), '+');
    const std::size_t kept = daemon.kept_count();
    Child revoked = publisher_child(daemon.socket_path());
    ASSERT_EQ(revoked.command('p'), '+');
    ASSERT_EQ(revoke(1), wire::Opcode::done);
    const auto before = process(1);
    ASSERT_TRUE(before);
    EXPECT_EQ(before->state, wire::ProcessState::revoked);
    for (int life = 0; life < 3; ++life) {
      restart(daemon);
      // Longer than the daemon takes between two looks at a process without a connection.
      ::usleep(600'000);
      const auto now = process(1);
      ASSERT_TRUE(now) << "its place was given away";
      EXPECT_EQ(now->state, wire::ProcessState::revoked);
      EXPECT_EQ(now->generation, before->generation);
      EXPECT_EQ(revoked.command('H'), '+');
      EXPECT_EQ(revoked.command('J'), '+');
      EXPECT_EQ(revoked.command('p'), '+') << "it is not disturbed in its own memory";
      {
        Child other = publisher_child(daemon.socket_path());
        ASSERT_EQ(other.command('p'), '+');
        const auto its = process(2);
        ASSERT_TRUE(its) << "index 1 was given away";
        EXPECT_NE(its->window[0].base, before->window[0].base);
        ++others;
      }
      ASSERT_TRUE(eventually([&] { return !process(2); }));
    }
    if (end == End::while_away) {
      ::kill(daemon.supervisor_pid(), SIGSTOP);
      const pid_t old = daemon.kill_worker();
      revoked.end();
      ::kill(daemon.supervisor_pid(), SIGCONT);
      ASSERT_TRUE(daemon.wait_for_next(old));
    } else if (end == End::becomes_another_program) {
      EXPECT_EQ(revoked.command('e'), std::nullopt);
    } else {
      revoked.end();
    }
    EXPECT_TRUE(eventually([&] { return !process(1); })) << "its place is not free";
    EXPECT_TRUE(eventually([&] { return daemon.kept_count() == kept; }))
        << daemon.kept_count() << " of " << kept;
    Child next = publisher_child(daemon.socket_path());
    ASSERT_EQ(next.command('p'), '+');
    const auto after = process(1);
    ASSERT_TRUE(after);
    EXPECT_EQ(after->state, wire::ProcessState::connected);
    EXPECT_EQ(after->window[0].base, before->window[0].base);
    EXPECT_EQ(daemon.log().find("client lost"), std::string::npos) << daemon.log();
  }
}

TEST(DaemonRevoke, OfAProcessWithoutAConnectionIsHeardOfWhenItComesBack) {
  DaemonProcess daemon(talkative);
  WireNode publisher(daemon.socket_path());  // process 0
  ASSERT_TRUE(publisher.create_publisher(topic_name, deep));
  Child subscriber = subscriber_child(daemon.socket_path());
  ASSERT_TRUE(publisher.wait_for([&] { return publisher.attached_count() == 1; }));
  ASSERT_EQ(subscriber.command('w'), '+');
  for (std::uint64_t number = 1; number <= 5; ++number) ASSERT_TRUE(publisher.publish(number));
  for (int i = 0; i < 3; ++i) ASSERT_EQ(subscriber.command('t'), '+');
  ASSERT_EQ(::kill(subscriber.pid(), SIGSTOP), 0);
  restart(daemon);
  publisher.wire().connect_again(daemon.socket_path());
  ASSERT_EQ(publisher.wire().rejoin(publisher.welcome()).opcode(), wire::Opcode::rejoined);
  publisher.wire().expect<wire::Own>(wire::Opcode::own);
  publisher.wire().expect<wire::Announcement>(wire::Opcode::announce);
  publisher.wire().expect<wire::Reference>(wire::Opcode::region);

  Observer observer(daemon.socket_path());
  const auto before = observer.processes().at(1);
  EXPECT_EQ(before.state, wire::ProcessState::orphaned) << "alive, but without a connection";
  ASSERT_EQ(observer.revoke(1, before.generation).opcode(), wire::Opcode::done);
  EXPECT_EQ(observer.processes().at(1).state, wire::ProcessState::revoked);
  ASSERT_TRUE(publisher.wait_for([&] { return publisher.attached_count() == 0; }));
  publisher.pass();
  EXPECT_EQ(publisher.allocated_count(), 0u) << "what it held and had not read is free";

  // Handled before the daemon dies: everybody else has let go of it.
  EXPECT_EQ(publisher.wire().open_window(7).opcode(), wire::Opcode::refused);

  restart(daemon);  // nobody has told it yet
  ASSERT_EQ(::kill(subscriber.pid(), SIGCONT), 0);
  EXPECT_EQ(subscriber.command('J'), '+');
  EXPECT_EQ(subscriber.command('H'), '+');
  EXPECT_EQ(subscriber.command('t'), '-');
  const auto state = [&] { return wire_dump(daemon.socket_path()); };
  ASSERT_NE(state().process(1), nullptr);
  EXPECT_EQ(state().process(1)->state, wire::ProcessState::revoked);
  subscriber.end();
  EXPECT_TRUE(eventually([&] { return state().process(1) == nullptr; }));
  EXPECT_EQ(state().daemon.counters.clients_revoked, 1u);
  EXPECT_EQ(state().daemon.counters.clients_died, 0u);
}

TEST(DaemonRevoke, PutsOutASubscriptionThatHoldsMoreThanItsQuota) {
  DaemonProcess daemon(talkative);
  WireNode publisher(daemon.socket_path());
  ASSERT_TRUE(publisher.create_publisher(topic_name, deep));
  Child honest = subscriber_child(daemon.socket_path());
  Child liar = subscriber_child(daemon.socket_path());
  ASSERT_TRUE(publisher.wait_for([&] { return publisher.attached_count() == 2; }));
  ASSERT_EQ(honest.command('w'), '+');
  ASSERT_EQ(liar.command('w'), '+');
  for (std::uint64_t number = 1; number <= 6; ++number) ASSERT_TRUE(publisher.publish(number));
  for (int i = 0; i < 4; ++i) ASSERT_EQ(honest.command('t'), '+');  // as many as it may
  ASSERT_EQ(liar.command('l'), '+');
  EXPECT_TRUE(daemon.wait_for_log("holds 5 messages of one publisher, its quota is 4"));
  EXPECT_EQ(liar.command('R'), '+');
  ASSERT_TRUE(publisher.wait_for([&] { return publisher.attached_count() == 1; }));
  EXPECT_EQ(honest.command('t'), '+') << "the honest one stays";
  const std::string log = daemon.log();
  EXPECT_EQ(log.find("client revoked"), log.rfind("client revoked"));
}

std::size_t count_of(const std::string& what, const std::string& text) {
  std::size_t count = 0;
  for (auto at = text.find(what); at != std::string::npos; at = text.find(what, at + 1)) ++count;
  return count;
}

// The next one in a place that has run short. It is refused until whoever keeps the places is put out.
std::unique_ptr<Child> next_of(Child (*kind)(const std::string&), const std::string& socket,
                               char what) {
  std::unique_ptr<Child> child;
  EXPECT_TRUE(eventually([&] {
    if (WireClient(socket).hello().opcode() != wire::Opcode::welcome) return false;
    child.reset(new Child(kind(socket)));
    return child->command(what).has_value();
  }));
  return child;
}

TEST(DaemonRevoke, PutsOutWhoIsStoppedBeforePublishersThatDieLockTheTopic) {
  DaemonProcess daemon(talkative);
  WireNode living(daemon.socket_path());
  ASSERT_TRUE(living.create_subscription(topic_name, deep));
  Child stopped = subscriber_child(daemon.socket_path());
  ASSERT_EQ(stopped.command('t'), '-');
  ASSERT_EQ(::kill(stopped.pid(), SIGSTOP), 0);
  constexpr int lives = 300;
  static_assert(lives > abi::publisher_count_max);
  for (int life = 0; life < lives; ++life) {
    const auto publisher = next_of(publisher_child, daemon.socket_path(), 'p');
    ASSERT_TRUE(living.wait_for([&] { return living.link_count() == 1; }));
    ASSERT_EQ(living.take(), 1u);
    ASSERT_TRUE(living.release());
    publisher->end();
    ASSERT_TRUE(living.wait_for([&] { return living.orphaned().size() == 1; }));
    living.unlink_drained();
  }
  EXPECT_TRUE(daemon.wait_for_log("endpoints that are gone, the oldest a publisher of /revoked"));
  Observer observer(daemon.socket_path());
  EXPECT_TRUE(eventually([&] { return observer.processes().size() == 2; }))
      << "those that are gone have places";
  const auto counters = wire_dump(daemon.socket_path()).daemon.counters;
  EXPECT_EQ(counters.clients_revoked, 1u);
  EXPECT_EQ(count_of("client revoked", daemon.log()), 1u);
  ASSERT_EQ(::kill(stopped.pid(), SIGCONT), 0);
  EXPECT_EQ(stopped.command('R'), '+');
}

TEST(DaemonRevoke, PutsOutWhoIsStoppedBeforeSubscriptionsOrProcessesRunShort) {
  struct Scarce {
    const char* config;
    Child (*stops)(const std::string&);
    Child (*comes_and_goes)(const std::string&);
    char what;
  };
  for (const Scarce& scarce :
       {Scarce{"[limits]\nsubscriptions_per_topic = 6\n"
               "[quota]\nsubscriptions_per_topic = \"unlimited\"\n",
               publisher_child, subscriber_child, 't'},
        Scarce{"[limits]\nclients = 8\n", subscriber_child, publisher_child, 'p'}}) {
    SCOPED_TRACE(scarce.config);
    DaemonProcess daemon({.more_config = scarce.config, .arguments = {"--log-level", "debug"}});
    Child stopped = scarce.stops(daemon.socket_path());
    ASSERT_NE(stopped.command(scarce.what == 't' ? 'p' : 't'), std::nullopt);
    ASSERT_EQ(::kill(stopped.pid(), SIGSTOP), 0);
    for (int life = 0; life < 20; ++life) {
      const auto other = next_of(scarce.comes_and_goes, daemon.socket_path(), scarce.what);
      ASSERT_FALSE(HasFailure()) << "life " << life << daemon.log();
      other->end();
    }
    EXPECT_EQ(count_of("client revoked", daemon.log()), 1u);
    ASSERT_EQ(::kill(stopped.pid(), SIGCONT), 0);
    EXPECT_EQ(stopped.command('R'), '+');
  }
}

TEST(DaemonRevoke, GivesMoreTimeToWhoLostItsConnectionButNotForEver) {
  DaemonProcess daemon({.more_config = "[limits]\npublishers_per_topic = 6\n"
                                       "[quota]\npublishers_per_topic = \"unlimited\"\n",
                        .arguments = {"--log-level", "debug"}});
  WireNode slow(daemon.socket_path());
  ASSERT_TRUE(slow.create_subscription(topic_name, deep));
  for (int life = 0; life < 5; ++life) {
    Child publisher = publisher_child(daemon.socket_path());
    ASSERT_EQ(publisher.command('p'), '+');
    publisher.end();
  }
  const pid_t before = daemon.pid();
  daemon.kill_worker();
  ASSERT_TRUE(daemon.wait_for_next(before));
  // More looks than anybody gets who has a connection.
  ::sleep(8);
  // Nor is it spared for coming back, when it is told again and again and does not answer.
  int returns = 0;
  EXPECT_TRUE(eventually([&] {
    WireClient again(daemon.socket_path());
    if (again.rejoin(slow.welcome()).opcode() == wire::Opcode::rejoined) ++returns;
    ::sleep(2);
    return daemon.log().find("client revoked") != std::string::npos;
  })) << daemon.log();
  EXPECT_GT(returns, 3);
}

TEST(DaemonRevoke, SparesWhoHoldsMessagesOfPublishersThatAreGone) {
  DaemonProcess daemon({.more_config = "[limits]\npublishers_per_topic = 6\n"
                                       "[quota]\npublishers_per_topic = \"unlimited\"\n",
                        .arguments = {"--log-level", "debug"}});
  WireNode holder(daemon.socket_path());
  ASSERT_TRUE(holder.create_subscription(topic_name, deep));
  Child stopped = subscriber_child(daemon.socket_path());
  ASSERT_EQ(stopped.command('t'), '-');
  ASSERT_EQ(::kill(stopped.pid(), SIGSTOP), 0);
  for (std::size_t life = 0; life < 6; ++life) {
    Child publisher = publisher_child(daemon.socket_path());
    ASSERT_EQ(publisher.command('p'), '+');
    ASSERT_TRUE(holder.wait_for([&] { return holder.link_count() == life + 1; }));
    ASSERT_EQ(holder.take(), 1u);
    publisher.end();
    ASSERT_TRUE(holder.wait_for([&] { return holder.orphaned().size() == life + 1; }));
  }
  // The same publishers, as long: one of the two answers for itself by what it holds.
  ASSERT_TRUE(daemon.wait_for_log("endpoints that are gone"));
  WireNode next(daemon.socket_path());
  EXPECT_FALSE(next.create_publisher(topic_name, deep)) << "what is held is not taken away";
  EXPECT_TRUE(daemon.wait_for_log("has not let go of 6"));
  holder.pump();
  EXPECT_EQ(holder.held_count(), 6u);
  while (holder.release()) {
  }
  holder.unlink_drained();
  EXPECT_TRUE(eventually([&] {
    return next.wire().create_publisher(topic_name, deep).opcode() ==
           wire::Opcode::endpoint_created;
  }));
  const auto counters = wire_dump(daemon.socket_path()).daemon.counters;
  EXPECT_EQ(counters.clients_revoked, 1u);
}

TEST(DaemonRevoke, IsForRootForTheDaemonsUserAndForTheOwner) {
  if (::geteuid() != 0) GTEST_SKIP() << "needs root";
  DaemonProcess daemon({.config = "[daemon]\nsocket_mode = \"0666\"\n"});
  const auto become = [](uid_t uid) {
    return ::setgroups(0, nullptr) == 0 && ::setgid(uid) == 0 && ::setuid(uid) == 0;
  };
  WireNode of_root(daemon.socket_path());  // process 0
  // Process 1 is another user's.
  Child stranger(0, [&](int commands, std::uint64_t) {
    if (!become(65534)) ::_exit(9);
    WireNode node(daemon.socket_path());
    serve(commands, [&](char what) { return execute_common(node, daemon.socket_path(), what); });
  });
  ASSERT_EQ(stranger.command('x'), '?');
  const auto as = [&](uid_t uid, std::uint64_t client) {
    const pid_t pid = ::fork();
    if (pid == 0) {
      if (!become(uid)) ::_exit(9);
      Observer observer(daemon.socket_path());
      const Incoming said = observer.revoke(client, observer.processes().at(client).generation);
      ::_exit(said.opcode() == wire::Opcode::done              ? 0
              : said.refused_code() == Errc::permission_denied ? 1
                                                               : 2);
    }
    int status = 0;
    ::waitpid(pid, &status, 0);
    return WEXITSTATUS(status);
  };
  EXPECT_EQ(as(65534, 0), 1) << "not another user's";
  EXPECT_EQ(as(65533, 1), 1);
  EXPECT_EQ(as(65534, 1), 0) << "one's own";
  EXPECT_EQ(stranger.command('R'), '+');
  EXPECT_EQ(as(0, 0), 0);
}

}  // namespace
}  // namespace agnocast::test
