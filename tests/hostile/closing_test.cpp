// SPDX-License-Identifier: Apache-2.0
//
// Goal: a descriptor from another user may take for ever to close; no other process waits for
// that, and the daemon does not run out of descriptors.
// Method: an attacker sends TCP sockets that linger for years over a peer that reads nothing, in
// every place where the daemon closes a client's descriptors; meanwhile the daemon answers the
// honest pair. Once on the kernel as it is, and once as before Linux 6.16, where nothing keeps
// descriptors from being sent. The same with a file of a FUSE server that never answers, whose
// close not even a signal ends.

#include <tests/hostile/hostile_node.hpp>
#include <tests/support/machine/silent_fuse.hpp>
#include <tests/support/wire/deaf_peer.hpp>

#include <fcntl.h>
#include <poll.h>
#include <sched.h>
#include <sys/file.h>
#include <sys/mount.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/wait.h>

#include <array>
#include <chrono>
#include <csignal>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <optional>
#include <thread>

namespace agnocast::test {
namespace {

using wire::Opcode;

template <class Body>
bool say(const PacketSocket& socket, Opcode opcode, Body body, std::span<const int> fds = {}) {
  body.header = {opcode, sizeof body, 1};
  const auto sent = socket.send(std::as_bytes(std::span(&body, 1)), fds);
  return sent && *sent == Sent::sent;
}

wire::Hello some_hello() {
  wire::Hello hello{};
  hello.fingerprint = abi::fingerprint();
  hello.process_name = wire_name("hostile");
  return hello;
}

enum Place : unsigned {
  with_hello,      // a request that may not carry one
  before_hello,    // a packet that ends the connection
  behind_the_end,  // queued on a connection that ends
  unread,          // sent, and the sender exits before it is read
  with_observe,
  as_window,         // the request that may carry a descriptor
  as_window_number,  // the same, with more descriptors than the daemon receives per packet
  place_count
};

/// Sends `fd` once. Returns false if the kernel refuses to send it.
bool send_at(Place place, const std::string& path, int fd) {
  auto connected = PacketSocket::connect(path, std::chrono::milliseconds(200));
  if (!connected) return true;
  const PacketSocket socket = std::move(*connected);
  const std::array<int, 1> one{fd};
  const std::array<std::byte, 3> nonsense{};
  const auto send_nonsense = [&](std::span<const int> fds) {
    const auto sent = socket.send(nonsense, fds);
    return sent.has_value();  // an ended connection is no refusal
  };
  // Waits for the daemon's answer to fix the order of events. There may be none.
  const timeval patience{0, 300'000};
  ::setsockopt(socket.fd(), SOL_SOCKET, SO_RCVTIMEO, &patience, sizeof patience);
  const auto wait_for_answer = [&] {
    std::array<std::byte, wire::packet_bytes_max> answer;
    static_cast<void>(socket.receive(answer, Wait::yes));
  };
  switch (place) {
    case with_hello: {
      const bool sent = say(socket, Opcode::hello, some_hello(), one);
      if (sent) wait_for_answer();
      return sent;
    }
    case before_hello:
      return send_nonsense(one);
    case behind_the_end:
      static_cast<void>(send_nonsense({}));
      return send_nonsense(one);
    case unread:
      say(socket, Opcode::hello, some_hello());
      return send_nonsense(one);
    case with_observe: {
      wire::Observe observe{};
      observe.fingerprint = abi::fingerprint();
      say(socket, Opcode::observe, observe);
      wait_for_answer();
      return say(socket, Opcode::dump, wire::Dump{}, one);
    }
    case as_window:
    case as_window_number: {
      say(socket, Opcode::hello, some_hello());
      wait_for_answer();
      wire::BringWindow window{};
      window.base = 1 << 30;
      window.bytes = 64 << 20;
      const std::vector<int> fds(place == as_window ? 1 : abi::wire::descriptor_count_max, fd);
      const bool sent = say(socket, Opcode::bring_window, window, fds);
      if (sent) wait_for_answer();
      return sent;
    }
    case place_count:
      break;
  }
  return false;
}

bool kernel_refuses_descriptors() {
  auto ends = PacketSocket::pair();
  return ends && refuse_descriptors(ends->first.fd());
}

/// Calls `after` when the attackers are gone, before it expects the daemon to have its descriptors
/// back.
void honest_goes_on_beside_descriptors(
    Stage& stage, const std::function<void(Attack&)>& body,
    const std::function<void()>& after = [] {}) {
  const std::size_t before = stage.daemon().descriptor_count();
  Attacker attacker(body);
  if (!attacker.wait_until_ready()) return;
  const auto end = std::chrono::steady_clock::now() + attack_time();
  std::size_t most = 0;
  do {
    stage.honest_goes_on();
    stage.honest_is_served();
    most = std::max(most, stage.daemon().descriptor_count());
  } while ((std::chrono::steady_clock::now() < end || attacker.word(0) < 50) &&
           !testing::Test::HasFailure());
  std::printf("%llu sent, at most %zu descriptors in the daemon, %zu before\n",
              static_cast<unsigned long long>(attacker.word(0)), most, before);
  attacker.kill();
  stage.honest_goes_on();
  after();
  // The quota bounds each user's connections; Disposal::waiting_max bounds the waiting
  // descriptors.
  EXPECT_LT(most, before + 4'096);
  EXPECT_TRUE(eventually([&] { return stage.daemon().descriptor_count() <= before; }))
      << stage.daemon().descriptor_count() << " descriptors; before the attack " << before;
}

/// Returns whether one of its threads is in a wait that no signal ends.
bool is_waiting_in_kernel(pid_t process) {
  for (const auto& task :
       std::filesystem::directory_iterator("/proc/" + std::to_string(process) + "/task")) {
    std::ifstream file(task.path() / "stat");
    const std::string stat((std::istreambuf_iterator<char>(file)), {});
    const std::size_t end_of_name = stat.rfind(')');
    if (end_of_name != std::string::npos && stat.substr(end_of_name, 3) == ") D") return true;
  }
  return false;
}

class HostileClosing : public testing::TestWithParam<bool> {};

TEST_P(HostileClosing, SocketsThatLingerDelayNobody) {
  AGNOCAST_NEEDS_TWO_USERS();
  const bool fallback = GetParam();
  Stage stage({.without_passrights = fallback});
  const bool refused = !fallback && kernel_refuses_descriptors();
  const std::string path = stage.socket_path();
  honest_goes_on_beside_descriptors(stage, [&](Attack& attack) {
    DeafPeer peer;
    {
      // The premise of the attack: closing such a socket waits.
      UniqueFd one = peer.lingering_socket(1);
      const auto begin = std::chrono::steady_clock::now();
      one.reset();
      EXPECT_GE(std::chrono::steady_clock::now() - begin, std::chrono::milliseconds(900));
    }
    std::array<bool, place_count> sent{};
    // data in the peer's queue uses the kernel's memory for TCP
    constexpr unsigned rounds_max = 300;
    for (unsigned round = 0; attack.goes_on(); ++round) {
      if (round >= rounds_max) {
        std::this_thread::sleep_for(std::chrono::milliseconds(10));
        continue;
      }
      const auto place = static_cast<Place>(round % place_count);
      // The sender exits, so the daemon holds the last reference to the socket.
      Child sender(
          [&] { return send_at(place, path, peer.lingering_socket(1'000'000).release()) ? 0 : 1; });
      sent[place] = sender.wait() == 0;
      ++attack.word(0);
      if (round == place_count) attack.ready();
    }
    for (unsigned place = 0; place < place_count; ++place) {
      const bool carries_window = place == as_window || place == as_window_number;
      EXPECT_EQ(sent[place], !refused || carries_window) << "place " << place;
    }
  });
}

// Two files whose servers never answer: closing any descriptor of the first waits, and so does
// closing the last one of the second, which has dirty pages. Destroy it before the processes that
// may wait for it.
class SilentFiles {
 public:
  SilentFiles()
      : directory_(make_directory()),
        clean_(file("clean"), S_IFREG),
        dirty_(file("dirty"), S_IFREG, true) {}
  ~SilentFiles() {
    end();
    remove_directory(directory_);
  }
  SilentFiles(const SilentFiles&) = delete;
  SilentFiles& operator=(const SilentFiles&) = delete;

  bool made() const { return clean_.made() && dirty_.made(); }
  unsigned unanswered() const { return clean_.unanswered() + dirty_.unanswered(); }
  void end() {
    clean_.end();
    dirty_.end();
  }

  /// Body of an attacker: sends one of the files to every place in turn.
  void send_all(Attack& attack, const std::string& path) const {
    for (unsigned round = 0; attack.goes_on(); ++round) {
      if (round >= 8 * place_count) {
        std::this_thread::sleep_for(std::chrono::milliseconds(10));
        continue;
      }
      // Its own close would not end either, so it stays until the file system ends.
      const pid_t attacker = ::getpid();
      const pid_t sender = ::fork();
      if (sender == 0) {
        ::prctl(PR_SET_PDEATHSIG, SIGKILL);
        if (::getppid() != attacker) ::_exit(2);  // it was killed before that
        const bool is_dirty = round / place_count % 2 != 0;
        const int silent =
            ::open((directory_ + (is_dirty ? "/dirty" : "/clean")).c_str(), O_RDWR | O_CLOEXEC);
        if (silent < 0 ||
            // Each round has its own page: a page under writeback cannot be written to.
            (is_dirty && ::pwrite(silent, "x", 1, off_t{4096} * round) != 1))
          ::_exit(2);
        send_at(static_cast<Place>(round % place_count), path, silent);
        ::raise(SIGSTOP);
        ::_exit(0);
      }
      int status = 0;
      ::waitpid(sender, &status, WUNTRACED);
      EXPECT_TRUE(WIFSTOPPED(status));
      ++attack.word(0);
      if (round == 2 * place_count) attack.ready();
    }
  }

 private:
  std::string file(const char* name) const {
    const std::string path = directory_ + "/" + name;
    UniqueFd(::open(path.c_str(), O_CREAT | O_WRONLY | O_CLOEXEC, 0666));
    return path;
  }

  std::string directory_;
  SilentFuse clean_, dirty_;
};

TEST_P(HostileClosing, AFileWhoseServerNeverAnswersDelaysNobody) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage({.without_passrights = GetParam()});
  SilentFiles files;
  if (!files.made()) GTEST_SKIP() << "no FUSE here";
  const auto send_silent_files = [&](Attack& attack) {
    files.send_all(attack, stage.socket_path());
  };
  honest_goes_on_beside_descriptors(stage, send_silent_files, [&] {
    EXPECT_GT(files.unanswered(), 0u) << "no process waits for a close";
    // A thread that nothing can end does not keep the daemon from being restarted.
    const pid_t old = stage.daemon().pid();
    ::kill(stage.daemon().supervisor_pid(), SIGHUP);
    EXPECT_TRUE(stage.daemon().wait_for_next(old));
    stage.honest_goes_on();
    stage.honest_is_served();
    files.end();
  });
}

// The kernel reports no end of a process that has a thread in an uninterruptible wait.
TEST_P(HostileClosing, AWorkerThatDiesBesideSuchFilesIsReplaced) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage({.without_passrights = GetParam()});
  SilentFiles files;
  if (!files.made()) GTEST_SKIP() << "no FUSE here";
  Attacker attacker([&](Attack& attack) { files.send_all(attack, stage.socket_path()); });
  ASSERT_TRUE(attacker.wait_until_ready());
  ASSERT_TRUE(eventually([&] { return files.unanswered() > 0; }));
  const pid_t old = stage.daemon().kill_worker();
  ASSERT_TRUE(stage.daemon().wait_for_next(old)) << stage.daemon().log();
  EXPECT_TRUE(stage.daemon().wait_for_log("worker does not end"));
  stage.honest_goes_on();
  stage.honest_is_served();
  const auto another = stage.another_honest_process();
  EXPECT_EQ(another->ask(std::string("watch ") + open_topic), "ok")
      << "the next process is welcomed";
  attacker.kill();
  files.end();
}

TEST_P(HostileClosing, ADaemonThatDiesBesideSuchFilesKeepsNothingOpen) {
  AGNOCAST_NEEDS_TWO_USERS();
  DaemonProcess daemon(
      {.config =
           "[daemon]\nsocket_mode = \"0666\"\n"
           "[heap]\nwindow_bytes = \"64MiB\"\narena_bytes = \"4GiB\"\n" AGNOCAST_TEST_ARENA_BASE,
       .arguments = {"--fd-store=none"},
       .without_passrights = GetParam()});
  SilentFiles files;
  if (!files.made()) GTEST_SKIP() << "no FUSE here";
  WireClient client(daemon.socket_path());
  EXPECT_EQ(client.hello().opcode(), Opcode::welcome);
  Attacker attacker([&](Attack& attack) { files.send_all(attack, daemon.socket_path()); });
  ASSERT_TRUE(attacker.wait_until_ready());
  ASSERT_TRUE(eventually([&] { return files.unanswered() > 0; }));
  const UniqueFd lock(::open((daemon.socket_path() + ".lock").c_str(), O_RDONLY | O_CLOEXEC));
  ASSERT_TRUE(lock);
  ASSERT_NE(::flock(lock.get(), LOCK_EX | LOCK_NB), 0);
  ::kill(daemon.pid(), SIGKILL);
  EXPECT_TRUE(eventually([&] { return ::flock(lock.get(), LOCK_EX | LOCK_NB) == 0; }))
      << "the next daemon would find that another one is running";
  EXPECT_TRUE(eventually([&] {
    pollfd end{client.socket().fd(), 0, 0};
    return ::poll(&end, 1, 0) == 1 && (end.revents & POLLHUP) != 0;
  })) << "clients would not come back";
  attacker.kill();
}

// When the daemon reads a process's entries there, it may wait for a lock that the process holds.
// A FUSE server that never answers stands in for /proc/PID, in a mount namespace of this test.
TEST(HostileLooking, LookingAtAProcessThatDoesNotEndDelaysNobody) {
  AGNOCAST_NEEDS_TWO_USERS();
  ASSERT_EQ(::unshare(CLONE_NEWNS), 0);
  ASSERT_EQ(::mount("none", "/", nullptr, MS_REC | MS_PRIVATE, nullptr), 0);
  Stage stage;
  const std::string path = stage.socket_path();
  Attacker attacker([&](Attack& attack) {
    {
      HostileNode node(path);
      attack.ready();
      while (attack.goes_on() && attack.word(1) == 0) ::usleep(1'000);
    }
    attack.word(0) = 1;  // disconnected and still alive
    while (attack.goes_on()) ::usleep(1'000);
  });
  ASSERT_TRUE(attacker.wait_until_ready());
  SilentFuse process("/proc/" + std::to_string(attacker.pid()), S_IFDIR);
  if (!process.made()) GTEST_SKIP() << "no FUSE here";
  attacker.set_word(1, 1);
  EXPECT_TRUE(eventually([&] { return attacker.word(0) == 1 && process.unanswered() > 0; }))
      << "the daemon does not look at the process";
  for (int round = 0; round < 5; ++round) {
    stage.honest_goes_on();
    stage.honest_is_served();
  }
  const auto another = stage.another_honest_process();
  EXPECT_EQ(another->ask(std::string("watch ") + open_topic), "ok")
      << "the next process is welcomed";
  process.end();
  attacker.end();
}

// A write holds the kernel's lock on its file while it waits for the page that it copies from.
class LockedFile {
 public:
  LockedFile() : directory_(make_directory()), page_(directory_ + "/page") {
    UniqueFd(::open(page_.c_str(), O_CREAT | O_WRONLY | O_CLOEXEC, 0666));
    silent_.emplace(page_, S_IFREG, false, abi::page_bytes);
  }
  ~LockedFile() {
    silent_->end();
    remove_directory(directory_);
  }
  LockedFile(const LockedFile&) = delete;
  LockedFile& operator=(const LockedFile&) = delete;

  bool made() const { return silent_->made(); }
  bool is_kept() const { return silent_->unanswered() > 0; }
  /// Called in the attacker: a child without a session locks, and outlives the attacker.
  pid_t keep(int file) const {
    const pid_t keeper = ::fork();
    if (keeper != 0) return keeper;
    // No other descriptor of the test may outlive it here, above all not the server's end of the
    // file system.
    ::dup2(file, 3);
    ::syscall(SYS_close_range, 4U, ~0U, 0U);
    const int source = ::open(page_.c_str(), O_RDONLY | O_CLOEXEC);
    struct stat size {};
    static_cast<void>(::fstat(source, &size));  // the kernel asks the server
    void* const from = ::mmap(nullptr, abi::page_bytes, PROT_READ, MAP_SHARED, source, 0);
    static_cast<void>(!::pwrite(3, from, abi::page_bytes, 0));
    ::_exit(0);
  }
  /// Body of an attacker. While its region is locked, one endpoint goes together with its memory,
  /// one comes, and one stays, which may need more memory.
  void attack(Attack& attack, const std::string& path, const char* known_type) const {
    HostileNode node(path);
    const auto leaving = node.join(wire::Kind::publisher, "/leaving");
    EXPECT_EQ(node.wire()
                  .ask(Opcode::create_publisher, node.body_like(known_type, "/locked", {}))
                  .opcode(),
              Opcode::endpoint_created);
    attack.word(0) = static_cast<std::uint64_t>(keep(node.region_fd()));
    EXPECT_TRUE(eventually([&] { return attack.word(1) != 0; }));
    EXPECT_EQ(node.wire()
                  .reference(Opcode::leave, wire::Kind::publisher, leaving.topic, leaving.index,
                             leaving.generation)
                  .opcode(),
              Opcode::done);
    const std::uint64_t waits =
        node.wire().send(Opcode::create_publisher, WireClient::endpoint("/waits", {}));
    attack.ready();
    while (attack.goes_on()) {
      const auto answer = node.wire().poll();
      if (answer && answer->header().request == waits &&
          answer->refused_code() == Errc::limit_reached)
        attack.word(2) = 1;
      ::usleep(1'000);
    }
  }

 private:
  std::string directory_, page_;
  std::optional<SilentFuse> silent_;
};

TEST(HostileLocking, AFileThatItsProcessKeepsLockedDelaysNobody) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage;
  LockedFile file;
  if (!file.made()) GTEST_SKIP() << "no FUSE here";
  Attacker attacker([&](Attack& attack) { file.attack(attack, stage.socket_path(), open_topic); });
  EXPECT_TRUE(eventually([&] { return file.is_kept(); }));
  attacker.set_word(1, 1);
  if (!attacker.wait_until_ready()) return;
  const auto others_go_on = [&] {
    stage.honest_goes_on();
    stage.honest_is_served();
    // They read more than the hostile publishers have had to keep before.
    const auto another = stage.another_honest_process();
    EXPECT_EQ(another->ask(std::string("watch ") + open_topic), "ok");
    EXPECT_EQ(another->ask("watch /locked"), "ok");
    EXPECT_EQ(another->ask("create /locked"), "ok");
  };
  others_go_on();
  EXPECT_TRUE(eventually([&] { return attacker.word(2) == 1; }) ||
              eventually([&] { return attacker.word(2) == 1; }))
      << "the daemon does not explain the wait to the client";
  // Nor does it hold up the next daemon, which creates the memory for every process that is
  // present.
  const pid_t killed = stage.daemon().kill_worker();
  EXPECT_TRUE(stage.daemon().wait_for_next(killed)) << stage.daemon().log();
  others_go_on();
  const auto keeper = static_cast<pid_t>(attacker.word(0));
  const std::uint64_t died = stage.counters().clients_died;
  attacker.kill();
  EXPECT_TRUE(eventually([&] { return stage.counters().clients_died > died; }))
      << "the daemon did not notice the death";
  others_go_on();
  ::kill(keeper, SIGKILL);
}

TEST(HostileLocking, ADaemonThatDiesBesideALockedFileKeepsNothingOpen) {
  AGNOCAST_NEEDS_TWO_USERS();
  DaemonProcess daemon(
      {.config =
           "[daemon]\nsocket_mode = \"0666\"\n"
           "[heap]\nwindow_bytes = \"64MiB\"\narena_bytes = \"4GiB\"\n" AGNOCAST_TEST_ARENA_BASE,
       .arguments = {"--fd-store=none"}});
  LockedFile file;
  if (!file.made()) GTEST_SKIP() << "no FUSE here";
  WireClient client(daemon.socket_path());
  EXPECT_EQ(client.hello().opcode(), Opcode::welcome);
  Attacker attacker([&](Attack& attack) { file.attack(attack, daemon.socket_path(), "/locked"); });
  EXPECT_TRUE(eventually([&] { return file.is_kept(); }));
  attacker.set_word(1, 1);
  if (!attacker.wait_until_ready()) return;
  const UniqueFd lock(::open((daemon.socket_path() + ".lock").c_str(), O_RDONLY | O_CLOEXEC));
  ASSERT_TRUE(lock);
  EXPECT_TRUE(eventually([&] { return is_waiting_in_kernel(daemon.pid()); }))
      << "the daemon does not wait for the lock";
  ::kill(daemon.pid(), SIGKILL);
  EXPECT_TRUE(eventually([&] { return ::flock(lock.get(), LOCK_EX | LOCK_NB) == 0; }));
  EXPECT_TRUE(eventually([&] {
    pollfd end{client.socket().fd(), 0, 0};
    return ::poll(&end, 1, 0) == 1 && (end.revents & POLLHUP) != 0;
  }));
  EXPECT_TRUE(file.is_kept());
  ::kill(static_cast<pid_t>(attacker.word(0)), SIGKILL);
  attacker.kill();
}

INSTANTIATE_TEST_SUITE_P(Kernels, HostileClosing, testing::Bool(), [](const auto& param) {
  return param.param ? "before_6_16" : "as_it_is";
});

}  // namespace
}  // namespace agnocast::test
