// SPDX-License-Identifier: Apache-2.0
//
// Goal: the daemon may die, be restarted or be replaced at any moment; the same incarnation goes on,
// with every place, window, address and count, data flows meanwhile, and whoever ended while it was
// away is repaired. What cannot be gone on with is refused and not touched.
// Method: the real supervisor and its worker; SIGKILL and SIGHUP; real client processes. To keep the
// daemon away for a while, its supervisor is stopped.

#include <agnocast/abi/fingerprint.hpp>
#include <base/pidfd.hpp>
#include <tests/recovery/stage.hpp>
#include <tests/support/crash_control.hpp>
#include <tests/support/daemon_process.hpp>
#include <tests/support/wire_dump.hpp>
#include <tests/support/wire_node.hpp>

#include <dirent.h>
#include <fcntl.h>
#include <gtest/gtest.h>
#include <linux/capability.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <sys/xattr.h>
#include <unistd.h>

#include <atomic>
#include <csignal>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <random>

namespace agnocast::test {
namespace {

using abi::Qos;
using sweep::Child;
using sweep::serve;

constexpr Qos deep{10, false, true, false, false};
constexpr const char* topic_name = "/restart";

char answer(bool done) { return testing::Test::HasFailure() ? '!' : done ? '+' : '-'; }

// A publisher in a process of its own, because no two clients of one process could have the same
// window: w until a subscription is attached · p publish.
Child publisher_child(const std::string& socket, const char* topic = topic_name) {
  return Child(0, [socket, topic](int commands, std::uint64_t) {
    ::prctl(PR_SET_PDEATHSIG, SIGKILL);
    WireNode node(socket);
    if (!node.create_publisher(topic, deep)) ::_exit(3);
    std::uint64_t number = 0;
    serve(commands, [&](char what) -> char {
      if (what == 'w') return answer(node.wait_for([&] { return node.attached_count() == 1; }));
      return answer(node.publish(++number));
    });
  });
}
// w until a publisher is linked · t take the next, which must be the successor of the last.
Child subscriber_child(const std::string& socket, const char* topic = topic_name) {
  return Child(0, [socket, topic](int commands, std::uint64_t) {
    ::prctl(PR_SET_PDEATHSIG, SIGKILL);
    WireNode node(socket);
    if (!node.create_subscription(topic, deep)) ::_exit(3);
    std::uint64_t last = 0;
    serve(commands, [&](char what) -> char {
      if (what == 'w') return answer(node.wait_for([&] { return node.link_count() == 1; }));
      const auto number = node.take();
      const bool next = number && (last == 0 || *number == last + 1);
      last = number.value_or(0);
      return answer(next && node.release());
    });
  });
}
// Two processes that exchange messages; nothing must disturb them.
struct Pair {
  explicit Pair(DaemonProcess& daemon, const char* topic = topic_name)
      : publisher(publisher_child(daemon.socket_path(), topic)),
        subscriber(subscriber_child(daemon.socket_path(), topic)) {
    EXPECT_EQ(publisher.command('w'), '+');
    EXPECT_EQ(subscriber.command('w'), '+');
  }
  void exchange() {
    EXPECT_EQ(publisher.command('p'), '+');
    EXPECT_EQ(subscriber.command('t'), '+');
  }
  Child publisher, subscriber;
};

// The daemon is away as long as this lives.
class Absence {
 public:
  explicit Absence(DaemonProcess& daemon) : daemon_(daemon), old_(daemon.pid()) {
    const auto worker = Pidfd::open(old_);
    ::kill(daemon.supervisor_pid(), SIGSTOP);
    daemon.kill_worker();
    pollfd entry{worker->fd(), POLLIN, 0};
    EXPECT_EQ(::poll(&entry, 1, 10'000), 1);
  }
  ~Absence() {
    ::kill(daemon_.supervisor_pid(), SIGCONT);
    EXPECT_TRUE(daemon_.wait_for_next(old_));
  }
  Absence(const Absence&) = delete;
  Absence& operator=(const Absence&) = delete;

 private:
  DaemonProcess& daemon_;
  pid_t old_;
};

void restart(DaemonProcess& daemon, bool politely = false) {
  const pid_t old = daemon.pid();
  if (politely) {
    ::kill(daemon.supervisor_pid(), SIGHUP);
  } else {
    daemon.kill_worker();
  }
  ASSERT_TRUE(daemon.wait_for_next(old)) << daemon.log();
}

// One descriptor of a process whose file has `name` in it, opened once more by ourselves.
UniqueFd descriptor_of(pid_t pid, const std::string& name) {
  const std::string directory = "/proc/" + std::to_string(pid) + "/fd/";
  for (const auto& entry : std::filesystem::directory_iterator(directory)) {
    std::error_code ignored;
    if (std::filesystem::read_symlink(entry.path(), ignored).string().find(name) !=
        std::string::npos)
      return UniqueFd(::open(entry.path().c_str(), O_RDWR | O_CLOEXEC));
  }
  return UniqueFd();
}

TEST(DaemonRestart, GoesOnAsTheSameIncarnationWithEverythingItKnew) {
  for (const bool politely : {false, true}) {
    SCOPED_TRACE(politely ? "SIGHUP" : "SIGKILL");
    DaemonProcess daemon;
    Pair pair(daemon);
    const WireDump before = wire_dump(daemon.socket_path());
    for (int life = 0; life < 5; ++life) {
      pair.exchange();
      restart(daemon, politely);
      pair.exchange();  // nothing that the pair shares has moved
    }
    const WireDump after = wire_dump(daemon.socket_path());
    EXPECT_EQ(after.incarnation, before.incarnation);
    EXPECT_EQ(after.daemon.pid, static_cast<unsigned>(daemon.pid()));
    EXPECT_NE(after.daemon.pid, before.daemon.pid);
    EXPECT_EQ(after.daemon.windows_used, 1u);
    EXPECT_EQ(after.daemon.counters.clients_registered, 2u) << "counters are the incarnation's";
    EXPECT_EQ(after.daemon.counters.clients_died, 0u);
    EXPECT_GE(after.daemon.uptime_ns, before.daemon.uptime_ns);
    ASSERT_EQ(after.processes.size(), 2u);
    for (std::size_t i = 0; i < 2; ++i) {
      EXPECT_EQ(after.processes[i].generation, before.processes[i].generation);
      EXPECT_EQ(after.processes[i].pid, before.processes[i].pid);
      EXPECT_GE(after.processes[i].age_ns, before.processes[i].age_ns);
      EXPECT_EQ(after.processes[i].executors, before.processes[i].executors);
      EXPECT_EQ(after.processes[i].state, wire::ProcessState::orphaned) << "has no connection";
      EXPECT_EQ(after.processes[i].region_count, 1u);
    }
    ASSERT_EQ(after.endpoints.size(), 2u);
    for (std::size_t i = 0; i < 2; ++i) {
      EXPECT_EQ(after.endpoints[i].generation, before.endpoints[i].generation);
      EXPECT_EQ(after.endpoints[i].member, before.endpoints[i].member);
      EXPECT_EQ(after.endpoints[i].extent, before.endpoints[i].extent);
    }
    // A newcomer gets what nobody has, and meets who is there.
    WireNode late(daemon.socket_path());
    EXPECT_EQ(late.welcome().incarnation, before.incarnation);
    EXPECT_EQ(late.welcome().client, 2u);
    ASSERT_TRUE(late.create_subscription(topic_name, deep));
    EXPECT_EQ(late.subscription().index, 1u);
    ASSERT_TRUE(late.wait_for([&] { return late.link_count() == 1; }));
    EXPECT_EQ(pair.publisher.command('p'), '+');
    EXPECT_TRUE(late.take());
    WireClient other(daemon.socket_path());
    EXPECT_EQ(other.hello().opcode(), wire::Opcode::welcome);
    const auto window = other.open_window(0).as<wire::WindowOpened>();
    EXPECT_EQ(window.base, late.welcome().arena_base + window.bytes) << "the first one is taken";
    EXPECT_EQ(daemon.log().find(" board_words_repaired=0 ") != std::string::npos, true);
    EXPECT_EQ(daemon.log().find("client lost"), std::string::npos) << daemon.log();
    EXPECT_EQ(daemon.stop(), 0);
    EXPECT_FALSE(std::filesystem::exists(daemon.socket_path()));
    EXPECT_FALSE(std::filesystem::exists(daemon.socket_path() + ".bells"));
  }
}

TEST(DaemonRestart, LetsWhoConnectsMeanwhileWaitInsteadOfFail) {
  DaemonProcess daemon;
  const std::uint64_t incarnation = wire_dump(daemon.socket_path()).incarnation;
  std::optional<PacketSocket> early;
  {
    Absence away(daemon);
    auto socket = PacketSocket::connect(daemon.socket_path());
    ASSERT_TRUE(socket) << "the listening socket is the supervisor's as well";
    early = std::move(*socket);
  }
  wire::Hello hello{};
  hello.header = {wire::Opcode::hello, sizeof hello, 1};
  hello.fingerprint = abi::fingerprint();
  ASSERT_TRUE(early->send(std::as_bytes(std::span(&hello, 1)), {}, Wait::yes));
  std::array<std::byte, 2048> buffer;
  const auto packet = early->receive(buffer, Wait::yes);
  ASSERT_TRUE(packet);
  wire::Welcome welcome{};
  ASSERT_EQ(packet->bytes, sizeof welcome);
  std::memcpy(static_cast<void*>(&welcome), buffer.data(), sizeof welcome);
  EXPECT_EQ(welcome.header.opcode, wire::Opcode::welcome);
  EXPECT_EQ(welcome.incarnation, incarnation);
}

TEST(DaemonRestart, RepairsWhoEndedWhileItWasAwayAndDeliversWhatTheyHadCommitted) {
  DaemonProcess daemon;
  const std::size_t kept = daemon.kept_count();
  WireNode subscriber(daemon.socket_path());
  ASSERT_TRUE(subscriber.create_subscription(topic_name, deep));
  Child publisher = publisher_child(daemon.socket_path());
  ASSERT_TRUE(subscriber.wait_for([&] { return subscriber.link_count() == 1; }));
  ASSERT_EQ(publisher.command('w'), '+');
  Child bystander = publisher_child(daemon.socket_path(), "/elsewhere");
  ASSERT_EQ(bystander.command('p'), '+');
  subscriber.bells().drain();
  {
    Absence away(daemon);
    ASSERT_EQ(publisher.command('p'), '+');
    ASSERT_EQ(publisher.command('p'), '+');
    publisher.end();
    bystander.end();
  }
  const WireDump after = wire_dump(daemon.socket_path());
  EXPECT_EQ(after.daemon.counters.clients_died, 2u);
  // Nobody was told of the bystander: nothing of it is left. The publisher is being drained.
  ASSERT_EQ(after.processes.size(), 2u);
  EXPECT_EQ(after.process(1)->state, wire::ProcessState::dead);
  EXPECT_EQ(after.topics.size(), 1u);
  const auto orphan = std::find_if(after.endpoints.begin(), after.endpoints.end(),
                                   [](auto& e) { return e.kind == wire::Kind::publisher; });
  ASSERT_NE(orphan, after.endpoints.end());
  EXPECT_EQ(abi::state_of(orphan->member), abi::MemberState::orphan);
  EXPECT_EQ(subscriber.take(), 1u);
  EXPECT_EQ(subscriber.take(), 2u);
  EXPECT_EQ(subscriber.take(), std::nullopt);
  pollfd bell{subscriber.bells().datagram_fd(), POLLIN, 0};
  EXPECT_EQ(::poll(&bell, 1, 10'000), 1) << "it was not rung";
  // Of the subscriber region, pidfd and eventfd; of the publisher region and window, because whoever
  // was told of them may have to be told again; of the bystander nothing.
  EXPECT_TRUE(eventually([&] { return daemon.kept_count() == kept + 5; }))
      << daemon.kept_count() << " of " << kept;
  // Its place is not given to anybody as long as the subscriber has it.
  WireClient next(daemon.socket_path());
  EXPECT_EQ(next.hello().as<wire::Welcome>().client, 2u);
  EXPECT_NE(next.open_window(0).as<wire::WindowOpened>().base, subscriber.welcome().arena_base);
}

TEST(DaemonRestart, TakesBackWhoComesAgainAndTellsHimWhatHappenedMeanwhile) {
  for (const bool meanwhile : {false, true}) {
    SCOPED_TRACE(meanwhile ? "the publisher ends while the daemon is away" : "everybody lives");
    DaemonProcess daemon;
    WireNode subscriber(daemon.socket_path());
    ASSERT_TRUE(subscriber.create_subscription(topic_name, deep));
    const std::uint64_t creation = subscriber.wire().last_request();
    Child publisher = publisher_child(daemon.socket_path());
    ASSERT_TRUE(subscriber.wait_for([&] { return subscriber.link_count() == 1; }));
    ASSERT_EQ(publisher.command('w'), '+');
    {
      Absence away(daemon);
      if (meanwhile) publisher.end();
    }
    WireClient& wire = subscriber.wire();
    wire.connect_again(daemon.socket_path());
    ASSERT_EQ(wire.rejoin(subscriber.welcome()).opcode(), wire::Opcode::rejoined);
    const auto own = wire.expect<wire::Own>(wire::Opcode::own);
    EXPECT_EQ(own.generation, subscriber.subscription().generation);
    EXPECT_EQ(own.creation, creation);
    std::vector<UniqueFd> fds;
    const auto about = wire.expect<wire::Announcement>(wire::Opcode::announce, &fds);
    EXPECT_EQ(fds.size(), 2u) << "region and window, also of the dead";
    if (meanwhile) {
      EXPECT_EQ(wire.expect<wire::Orphaned>(wire::Opcode::orphaned).generation, about.generation);
    }
    EXPECT_EQ(wire.expect<wire::Reference>(wire::Opcode::region).index, about.client);
    // The answer to a creation of the former life, and a creation of this one.
    const Incoming again = wire.ask_again(wire::Opcode::create_subscription,
                                          WireClient::endpoint(topic_name, deep), creation);
    EXPECT_EQ(again.as<wire::EndpointCreated>().generation, own.generation);
    EXPECT_EQ(wire.create_subscription("/new", deep).opcode(), wire::Opcode::endpoint_created);
    EXPECT_EQ(wire_dump(daemon.socket_path()).process(0)->state, wire::ProcessState::connected);
  }
}

TEST(DaemonRestart, NoticesThatAProcessBecameAnotherProgramMeanwhile) {
  DaemonProcess daemon;
  Child publisher(0, [&](int commands, std::uint64_t) {
    ::prctl(PR_SET_PDEATHSIG, SIGKILL);
    WireNode node(daemon.socket_path());
    if (!node.create_publisher(topic_name, deep)) ::_exit(3);
    serve(commands, [&](char what) -> char {
      if (what == 'e') ::execlp("sleep", "sleep", "60", static_cast<char*>(nullptr));
      return '+';
    });
  });
  ASSERT_EQ(publisher.command('?'), '+');
  {
    Absence away(daemon);
    EXPECT_EQ(publisher.command('e'), std::nullopt);
  }
  EXPECT_TRUE(daemon.wait_for_log("how=\"process let go of its region\"")) << daemon.log();
  EXPECT_TRUE(eventually([&] { return wire_dump(daemon.socket_path()).processes.empty(); }));
}

TEST(DaemonRestart, StaysFlatWhenEverybodyDiesAtRandomMoments) {
  DaemonProcess daemon;
  std::mt19937 random(17);
  const auto settled = [&] {
    return eventually([&] { return wire_dump(daemon.socket_path()).processes.empty(); });
  };
  ASSERT_TRUE(settled());
  const std::size_t kept = daemon.kept_count();
  const std::uint64_t incarnation = wire_dump(daemon.socket_path()).incarnation;
  for (int round = 0; round < 25 && !HasFailure(); ++round) {
    SCOPED_TRACE("round " + std::to_string(round));
    Child publisher = publisher_child(daemon.socket_path());
    Child subscriber = subscriber_child(daemon.socket_path());
    ASSERT_EQ(publisher.command('w'), '+');
    ASSERT_EQ(subscriber.command('w'), '+');
    ASSERT_EQ(publisher.command('p'), '+');
    const pid_t old = daemon.pid();
    // Death of the daemon somewhere in the two reaps, before, or after.
    if (random() % 4 == 0) daemon.kill_worker();
    publisher.end();
    ::usleep(static_cast<useconds_t>(random() % 1500));
    if (random() % 2 == 0) subscriber.end();
    ::usleep(static_cast<useconds_t>(random() % 1500));
    if (daemon.pid() == old) daemon.kill_worker();
    subscriber.end();
    ASSERT_TRUE(daemon.wait_for_next(old)) << daemon.log();
    ASSERT_TRUE(settled()) << daemon.log();
  }
  const WireDump after = wire_dump(daemon.socket_path());
  EXPECT_EQ(after.incarnation, incarnation);
  EXPECT_EQ(after.daemon.windows_used, 0u);
  EXPECT_TRUE(after.topics.empty());
  EXPECT_EQ(after.daemon.counters.clients_registered, 50u);
  EXPECT_TRUE(eventually([&] { return daemon.kept_count() == kept; }))
      << daemon.kept_count() << " instead of " << kept;
  EXPECT_TRUE(std::filesystem::is_empty(daemon.socket_path() + ".bells"));
  EXPECT_EQ(daemon.log().find("client lost"), std::string::npos) << daemon.log();
}

TEST(DaemonRestart, BeginsAnewWhenWhatWasKeptIsLost) {
  std::uint64_t incarnation = 0;
  std::string left, socket;
  const std::string directory = make_directory();
  {
    DaemonProcess first;
    WireNode node(first.socket_path());
    ASSERT_TRUE(node.create_subscription(topic_name, deep));
    incarnation = node.welcome().incarnation;
    first.kill();  // its supervisor, and it dies with it
    std::filesystem::rename(first.directory() + "/run", directory + "/run");
  }
  ASSERT_FALSE(std::filesystem::is_empty(directory + "/run/agnocastd.sock.bells"));
  {
    DaemonProcess second({.socket = directory + "/run/agnocastd.sock"});
    const WireDump all = wire_dump(second.socket_path());
    EXPECT_NE(all.incarnation, incarnation);
    EXPECT_TRUE(all.processes.empty());
    EXPECT_TRUE(std::filesystem::is_empty(second.socket_path() + ".bells"));
  }
  remove_directory(directory);
}

// A program of our own that can be replaced.
class Program {
 public:
  Program() : directory_(make_directory()) { put(AGNOCAST_TEST_DAEMON); }
  ~Program() { remove_directory(directory_); }
  Program(const Program&) = delete;
  Program& operator=(const Program&) = delete;
  std::string path() const { return directory_ + "/agnocastd"; }
  /// As an installation does it: a new file under the old name.
  void put(const std::string& other) const {
    std::filesystem::copy_file(other, path() + ".new");
    std::filesystem::rename(path() + ".new", path());
  }
  static ino_t inode(const std::string& path) {
    struct stat file {};
    return ::stat(path.c_str(), &file) == 0 ? file.st_ino : 0;
  }

 private:
  std::string directory_;
};

// Who would not survive a restart of the daemon is refused, and not lost at the restart.
TEST(DaemonRestart, KeepsNoMoreThanItsLimitOfOpenFilesCanHandOn) {
  const std::string directory = make_directory();
  const std::string program = directory + "/agnocastd";
  std::ofstream(program) << "#!/bin/sh\nulimit -n 200\nexec " AGNOCAST_TEST_DAEMON " \"$@\"\n";
  std::filesystem::permissions(program, std::filesystem::perms::owner_all);
  {
    DaemonProcess daemon({.program = program});
    std::vector<std::unique_ptr<WireClient>> clients;
    std::vector<Incoming> welcomes;  // with the regions, and without them nobody is a member
    Errc refused = Errc::ok;
    while (refused == Errc::ok && clients.size() < 50) {
      clients.push_back(std::make_unique<WireClient>(daemon.socket_path()));
      welcomes.push_back(clients.back()->hello());
      refused = welcomes.back().refused_code();
      for (std::uint64_t w = 0; refused == Errc::ok && w < abi::window_count_max; ++w)
        refused = clients.back()->open_window(w).refused_code();
    }
    EXPECT_EQ(refused, Errc::limit_reached);
    std::vector<Mapping> regions;
    for (const Incoming& welcome : welcomes) {
      if (welcome.opcode() == wire::Opcode::welcome)
        regions.push_back(
            Mapping::map(welcome.fds[1].get(), abi::page_bytes, Mapping::Access::read_write)
                .value());
    }
    restart(daemon);
    EXPECT_TRUE(daemon.wait_for_log("clients_lost=0"));
    EXPECT_EQ(daemon.log().find("descriptor was lost"), std::string::npos);
    EXPECT_EQ(wire_dump(daemon.socket_path()).processes.size(), regions.size());
  }
  remove_directory(directory);
}

// exec of such a program forgets what the supervisor's child asked for before it.
TEST(DaemonRestart, DoesNotOutliveItsSupervisorWithFileCapabilitiesEither) {
  if (::geteuid() != 0) GTEST_SKIP() << "needs root";
  Program program;
  vfs_cap_data capabilities{};
  capabilities.magic_etc = VFS_CAP_REVISION_2 | VFS_CAP_FLAGS_EFFECTIVE;
  capabilities.data[0].permitted = 1U << CAP_IPC_LOCK;
  if (::setxattr(program.path().c_str(), "security.capability", &capabilities, sizeof capabilities,
                 0) != 0)
    GTEST_SKIP() << "no file capabilities here: " << std::strerror(errno);
  DaemonProcess daemon({.uid = 65534, .program = program.path()});
  const auto worker = Pidfd::open(daemon.pid());
  ASSERT_TRUE(worker);
  ::kill(daemon.supervisor_pid(), SIGKILL);
  pollfd entry{worker->fd(), POLLIN, 0};
  EXPECT_EQ(::poll(&entry, 1, 10'000), 1);
}

TEST(DaemonRestart, TakesUpAReplacedProgramAndGoesOnWithoutOne) {
  Program program;
  DaemonProcess daemon({.program = program.path()});
  WireNode node(daemon.socket_path());
  const auto exe = [&] { return "/proc/" + std::to_string(daemon.pid()) + "/exe"; };
  const ino_t first = Program::inode(exe());
  program.put(AGNOCAST_TEST_DAEMON);
  ASSERT_NE(Program::inode(program.path()), first);
  restart(daemon, true);
  EXPECT_EQ(Program::inode(exe()), Program::inode(program.path()));
  std::filesystem::remove(program.path());
  restart(daemon);
  EXPECT_EQ(Program::inode(exe()), first) << "what the supervisor itself is";
  const WireDump all = wire_dump(daemon.socket_path());
  EXPECT_EQ(all.incarnation, node.welcome().incarnation);
  EXPECT_EQ(all.processes.size(), 1u);
}

TEST(DaemonRestart, IsTriedAgainWhenItFailsAndGoesOnOnceItCan) {
  Program program;
  DaemonProcess daemon({.program = program.path()});
  WireNode node(daemon.socket_path());
  const pid_t old = daemon.pid();
  program.put("/bin/false");
  daemon.kill_worker();
  EXPECT_TRUE(daemon.wait_for_log("failures=3"));
  EXPECT_TRUE(daemon.is_running()) << "what it keeps cannot be got back";
  program.put(AGNOCAST_TEST_DAEMON);
  ASSERT_TRUE(daemon.wait_for_next(old));
  EXPECT_EQ(wire_dump(daemon.socket_path()).incarnation, node.welcome().incarnation);
}

TEST(DaemonRestart, DeathsOfReadyDaemonsDoNotMakeThePauseLong) {
  Program program;
  DaemonProcess daemon({.program = program.path()});
  for (int death = 1; death <= 10; ++death) {
    const pid_t old = daemon.kill_worker();
    ASSERT_TRUE(daemon.wait_for_next(old)) << death;
  }
  const pid_t old = daemon.pid();
  program.put("/bin/false");
  daemon.kill_worker();
  ASSERT_TRUE(daemon.wait_for_log("failures=13"));
  EXPECT_EQ(daemon.log().find("again_in_ms=5000"), std::string::npos) << daemon.log();
  program.put(AGNOCAST_TEST_DAEMON);
  EXPECT_TRUE(daemon.wait_for_next(old));
}

#ifdef AGNOCAST_TEST_OTHER_DAEMON

TEST(DaemonRestart, RefusesTheTablesOfAnotherBuildAndHarmsNothing) {
  Program program;
  DaemonProcess daemon({.program = program.path()});
  Pair pair(daemon);
  const WireDump before = wire_dump(daemon.socket_path());
  const std::size_t kept = daemon.kept_count();

  program.put(AGNOCAST_TEST_OTHER_DAEMON);
  ::kill(daemon.supervisor_pid(), SIGHUP);
  ASSERT_TRUE(daemon.wait_for_log("refusing everybody"));
  char own[32];
  std::snprintf(own, sizeof own, "0x%016llx", static_cast<unsigned long long>(abi::fingerprint()));
  for (int again = 0; again < 2; ++again) {
    WireClient client(daemon.socket_path());
    const Incoming hello = client.hello();
    EXPECT_EQ(hello.refused_code(), Errc::layout_mismatch);
    EXPECT_NE(hello.refused_text().find(own), std::string::npos) << hello.refused_text();
    EXPECT_NE(hello.refused_text().find("this agnocastd has layout 0x"), std::string::npos);
    wire::Rejoin rejoin{};
    // Layout_mismatch would be for good: the process would not come back to the former build.
    EXPECT_EQ(client.ask(wire::Opcode::rejoin, rejoin).refused_code(), Errc::daemon_not_running);
    wire::Observe observe{};
    EXPECT_EQ(client.ask(wire::Opcode::observe, observe).refused_code(), Errc::layout_mismatch);
    const pid_t old = daemon.kill_worker();  // it may die as often as it likes
    ASSERT_TRUE(eventually([&] { return daemon.pid() > 0 && daemon.pid() != old; }));
  }
  pair.exchange();
  // The supervisor has more open while it starts a worker.
  EXPECT_TRUE(eventually([&] { return daemon.kept_count() == kept; })) << daemon.kept_count();

  const pid_t refusing = daemon.pid();
  program.put(AGNOCAST_TEST_DAEMON);
  ::kill(daemon.supervisor_pid(), SIGHUP);
  ASSERT_TRUE(daemon.wait_for_next(refusing)) << daemon.log();
  const WireDump after = wire_dump(daemon.socket_path());
  EXPECT_EQ(after.incarnation, before.incarnation);
  EXPECT_EQ(after.processes.size(), 2u);
  EXPECT_EQ(after.endpoints.size(), 2u);
  EXPECT_EQ(daemon.kept_count(), kept);
}

#endif

TEST(DaemonRestart, RefusesADamagedJournalAndSaysWhatIsWrong) {
  DaemonProcess daemon;
  WireNode node(daemon.socket_path());
  const UniqueFd journal = descriptor_of(daemon.supervisor_pid(), "agnocast-journal");
  ASSERT_TRUE(journal);
  const auto with = [&](off_t offset, std::uint64_t value, const char* what) {
    std::uint64_t before = 0;
    pid_t refusing = -1;
    {
      Absence away(daemon);
      ASSERT_EQ(::pread(journal.get(), &before, sizeof before, offset), ssize_t{8});
      ASSERT_EQ(::pwrite(journal.get(), &value, sizeof value, offset), ssize_t{8});
      // Not served: Absence waits for a ready one in vain, so it is left by hand.
      ::kill(daemon.supervisor_pid(), SIGCONT);
      EXPECT_TRUE(daemon.wait_for_log(what)) << daemon.log();
      ASSERT_TRUE(eventually([&] { return daemon.pid() > 0; }));
      WireClient client(daemon.socket_path());
      const Incoming hello = client.hello();
      EXPECT_EQ(hello.refused_code(), Errc::layout_mismatch);
      EXPECT_NE(hello.refused_text().find(what), std::string::npos) << hello.refused_text();
      refusing = daemon.pid();
      ASSERT_EQ(::pwrite(journal.get(), &before, sizeof before, offset), ssize_t{8});
      daemon.kill_worker();
    }
    ASSERT_TRUE(daemon.wait_for_next(refusing));
    const WireDump all = wire_dump(daemon.socket_path());
    EXPECT_EQ(all.incarnation, node.welcome().incarnation);
    EXPECT_EQ(all.processes.size(), 1u);
  };
  with(0, 1, "the journal does not begin like one");
  with(64, 1'000, "has not committed");
  with(64, 0, "has not committed");
}

// The address that the worker was given, seen from here.
sockaddr_un address_of_supervisor(const DaemonProcess& daemon) {
  std::ifstream file("/proc/" + std::to_string(daemon.pid()) + "/environ", std::ios::binary);
  std::ostringstream text;
  text << file.rdbuf();
  const std::string environment = text.str();
  const std::string prefix = "NOTIFY_SOCKET=/proc/self/fd/";
  const std::size_t at = environment.find(prefix);
  EXPECT_NE(at, std::string::npos);
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  if (at != std::string::npos)
    std::snprintf(address.sun_path, sizeof address.sun_path, "/proc/%d/fd/%s",
                  static_cast<int>(daemon.pid()), environment.c_str() + at + prefix.size());
  return address;
}

TEST(DaemonRestart, TakesOrdersFromItsWorkerAlone) {
  DaemonProcess daemon;
  const std::size_t kept = daemon.kept_count();
  sockaddr_un address = address_of_supervisor(daemon);
  const UniqueFd socket(::socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC, 0));
  for (const char* order : {"FDSTOREREMOVE=1\nFDNAME=board", "FDSTORE=1\nFDNAME=mine", "x"}) {
    ASSERT_EQ(::sendto(socket.get(), order, std::strlen(order), 0,
                       reinterpret_cast<sockaddr*>(&address), sizeof address),
              static_cast<ssize_t>(std::strlen(order)))
        << std::strerror(errno);
  }
  EXPECT_TRUE(daemon.wait_for_log("notification passed over"));
  EXPECT_EQ(daemon.kept_count(), kept);
  restart(daemon);
  EXPECT_EQ(daemon.log().find("former life lost"), std::string::npos);
}

TEST(DaemonRestart, MakesItsSocketAnewWhereItsNameWasRemoved) {
  DaemonProcess daemon;
  WireNode node(daemon.socket_path());
  std::filesystem::remove(daemon.socket_path());
  restart(daemon);
  EXPECT_EQ(wire_dump(daemon.socket_path()).incarnation, node.welcome().incarnation);
  restart(daemon);
  EXPECT_EQ(wire_dump(daemon.socket_path()).incarnation, node.welcome().incarnation);
}

// A daemon that dies right after it has made its socket anew leaves its name, and nobody behind it.
TEST(DaemonRestart, MakesItsSocketAnewWhereItsNameLeadsToNobody) {
  DaemonProcess daemon;
  WireNode node(daemon.socket_path());
  std::filesystem::remove(daemon.socket_path());
  {
    const auto stale = PacketListener::listen(daemon.socket_path());
    ASSERT_TRUE(stale);
  }
  restart(daemon);
  EXPECT_EQ(wire_dump(daemon.socket_path()).incarnation, node.welcome().incarnation);
}

/// Says something to the supervisor in the name of its worker. Needs root.
void order_as_worker(const DaemonProcess& daemon, const std::string& order) {
  sockaddr_un address = address_of_supervisor(daemon);
  const UniqueFd socket(::socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC, 0));
  iovec data{const_cast<char*>(order.data()), order.size()};
  alignas(cmsghdr) char control[CMSG_SPACE(sizeof(ucred))] = {};
  msghdr message{};
  message.msg_name = &address;
  message.msg_namelen = sizeof address;
  message.msg_iov = &data;
  message.msg_iovlen = 1;
  message.msg_control = control;
  message.msg_controllen = sizeof control;
  cmsghdr* const part = CMSG_FIRSTHDR(&message);
  part->cmsg_level = SOL_SOCKET;
  part->cmsg_type = SCM_CREDENTIALS;
  part->cmsg_len = CMSG_LEN(sizeof(ucred));
  const ucred worker{daemon.pid(), ::getuid(), ::getgid()};
  std::memcpy(CMSG_DATA(part), &worker, sizeof worker);
  ASSERT_EQ(::sendmsg(socket.get(), &message, 0), static_cast<ssize_t>(order.size()))
      << std::strerror(errno);
}

// It may have died between the removal of the former socket from the store and the new one's arrival.
TEST(DaemonRestart, MakesSocketAndLockAnewWhereTheyWereNotKept) {
  if (::geteuid() != 0) GTEST_SKIP() << "needs root";
  for (const char* const lost : {"listen", "lock"}) {
    SCOPED_TRACE(lost);
    DaemonProcess daemon;
    Pair pair(daemon);
    const WireDump before = wire_dump(daemon.socket_path());
    const std::size_t kept = daemon.kept_count();
    order_as_worker(daemon, std::string("FDSTOREREMOVE=1\nFDNAME=") + lost);
    ASSERT_TRUE(eventually([&] { return daemon.kept_count() == kept - 1; }));
    restart(daemon);
    EXPECT_EQ(daemon.log().find("former life lost"), std::string::npos);
    const WireDump after = wire_dump(daemon.socket_path());
    EXPECT_EQ(after.incarnation, before.incarnation);
    EXPECT_EQ(after.processes.size(), 2u);
    EXPECT_TRUE(eventually([&] { return daemon.kept_count() == kept; })) << daemon.kept_count();
    pair.exchange();
    EXPECT_EQ(run_daemon({"--socket", daemon.socket_path(), "--fd-store=none"}).status, 1)
        << "another one while this one runs";
  }
}

TEST(DaemonRestart, KeepsTheArenaOfItsIncarnationWhateverTheConfigurationSaysNow) {
  DaemonProcess daemon;
  WireNode first(daemon.socket_path());
  ASSERT_TRUE(first.create_publisher(topic_name, deep));
  std::ofstream(daemon.directory() + "/agnocastd.toml")
      << "[daemon]\nsocket_mode = \"0666\"\n[heap]\nwindow_bytes = \"128MiB\"\n"
         "arena_bytes = \"32GiB\"\n" AGNOCAST_TEST_ARENA_BASE;
  restart(daemon, true);
  WireClient next(daemon.socket_path());
  EXPECT_EQ(next.hello().as<wire::Welcome>().arena_bytes, first.welcome().arena_bytes);
  const auto another = next.open_window(0).as<wire::WindowOpened>();
  EXPECT_EQ(another.bytes, first.window().bytes);
  EXPECT_EQ(another.base, first.window().base + first.window().bytes);
}

TEST(DaemonRestart, IsOneProcessThatKeepsNothingIfThatIsWanted) {
  DaemonProcess daemon({.arguments = {"--fd-store=none"}});
  EXPECT_EQ(daemon.pid(), daemon.supervisor_pid());
  std::ifstream children("/proc/" + std::to_string(daemon.pid()) + "/task/" +
                         std::to_string(daemon.pid()) + "/children");
  std::string none;
  EXPECT_FALSE(children >> none);
  EXPECT_EQ(daemon.stop(), 0);
  EXPECT_FALSE(std::filesystem::exists(daemon.socket_path()));
  const Ended alone = run_daemon({"--fd-store=manager", "--socket", "/nowhere/agnocastd.sock"});
  EXPECT_EQ(alone.status, 1);
  EXPECT_EQ(alone.err.substr(0, alone.err.find('\n')),
            "agnocastd: --fd-store=manager: nobody is there who keeps descriptors");
  EXPECT_EQ(run_daemon({"--fd-store=everybody"}).status, 2);
}

#ifdef AGNOCAST_TEST_CRASHING_DAEMON

// The daemon dies at the n-th step of going on, for n = 1, 2, 3 … until it survives; what it has to
// do then: two processes have ended, each with an endpoint that the other knows, and a living pair
// must not notice.
TEST(DaemonRestart, MayDieAtAnyStepOfGoingOn) {
  unsigned deaths = 0;
  bool survived = false;
  for (std::uint64_t n = 1; !survived && !HasFailure(); ++n) {
    SCOPED_TRACE("step " + std::to_string(n));
    const std::string directory = make_directory();
    CrashControl control(directory + "/control");
    DaemonProcess daemon({.program = AGNOCAST_TEST_CRASHING_DAEMON});
    Pair pair(daemon, "/living");
    Child dead_publisher = publisher_child(daemon.socket_path());
    Child dead_subscriber = subscriber_child(daemon.socket_path());
    ASSERT_EQ(dead_publisher.command('w'), '+');
    ASSERT_EQ(dead_subscriber.command('w'), '+');
    ASSERT_EQ(dead_publisher.command('p'), '+');
    {
      Absence away(daemon);
      dead_publisher.end();
      dead_subscriber.end();
      control.arm(n);
    }
    control.arm(0);  // it serves: the rest is for the sweep of serving
    const std::string log = daemon.log();
    std::size_t died = 0;
    for (std::size_t at = 0; (at = log.find("worker died", at)) != std::string::npos; ++at) ++died;
    survived = died == 1;
    if (!survived) ++deaths;
    const WireDump all = wire_dump(daemon.socket_path());
    EXPECT_EQ(all.processes.size(), 2u);
    EXPECT_EQ(all.topics.size(), 1u);
    EXPECT_EQ(all.endpoints.size(), 2u);
    EXPECT_EQ(all.daemon.windows_used, 1u);
    pair.exchange();
    EXPECT_EQ(log.find("client lost"), std::string::npos) << log;
    EXPECT_EQ(log.find("damaged"), std::string::npos) << log;
    EXPECT_EQ(std::distance(std::filesystem::directory_iterator(daemon.socket_path() + ".bells"),
                            std::filesystem::directory_iterator()),
              1);
    remove_directory(directory);
  }
  std::printf("died at %u steps of going on\n", deaths);
  EXPECT_GT(deaths, 60u);
}

#endif

}  // namespace
}  // namespace agnocast::test
