// SPDX-License-Identifier: Apache-2.0
//
// Goal: whatever another user does with the descriptors that the daemon gives to every observer,
// new processes join and the others go on.
// Method: an observer of another user asks for dumps without end and puts every lock, seal, lease
// and flag that exists on each descriptor that it receives; processes of the honest user join
// meanwhile. The same once more after the daemon has been killed and restarted.

#include <tests/hostile/hostile_node.hpp>

#include <fcntl.h>
#include <sys/file.h>
#include <sys/mman.h>

#include <cerrno>
#include <csignal>
#include <thread>

namespace agnocast::test {
namespace {

using wire::Opcode;

// glibc defines only some of them, with _GNU_SOURCE.
#ifndef F_SEAL_FUTURE_WRITE
#define F_SEAL_FUTURE_WRITE 0x0010
#endif

bool lock_for_reading(int fd, int command) {
  struct flock lock {};
  lock.l_type = F_RDLCK;
  lock.l_whence = SEEK_SET;
  return ::fcntl(fd, command, &lock) == 0;
}

/// Tries every operation with which a reader's descriptor could keep others from the file.
void take_hold_of(int fd) {
  // A lock is possible on a region that its process has closed; it disturbs nobody.
  static_cast<void>(lock_for_reading(fd, F_OFD_SETLK));
  static_cast<void>(lock_for_reading(fd, F_SETLK));
  static_cast<void>(::flock(fd, LOCK_EX | LOCK_NB));
  struct flock writing {};
  writing.l_type = F_WRLCK;
  writing.l_whence = SEEK_SET;
  EXPECT_EQ(::fcntl(fd, F_OFD_SETLK, &writing), -1);
  EXPECT_EQ(errno, EBADF);
  EXPECT_EQ(::fcntl(fd, F_SETLEASE, F_RDLCK), -1);
  EXPECT_EQ(::fcntl(fd, F_NOTIFY, DN_MODIFY | DN_ACCESS), -1);
  EXPECT_EQ(::fcntl(fd, F_ADD_SEALS, F_SEAL_WRITE), -1);
  EXPECT_EQ(::fcntl(fd, F_ADD_SEALS, F_SEAL_FUTURE_WRITE), -1);
  EXPECT_EQ(::fcntl(fd, F_SETFL, O_NONBLOCK | O_APPEND | O_ASYNC | O_NOATIME), -1);
  static_cast<void>(::fcntl(fd, F_SETFL, O_NONBLOCK | O_APPEND | O_ASYNC));
  static_cast<void>(::lseek(fd, 1, SEEK_SET));
}

/// Reads one dump; returns false when the daemon has ended the connection.
bool look(WireClient& observer, Attack& attack) {
  wire::Dump dump{};
  dump.header = {Opcode::dump, sizeof dump, 7};
  if (!observer.send_bytes(std::as_bytes(std::span(&dump, 1)))) return false;
  for (;;) {
    if (!attack.goes_on()) return false;
    const auto packet = observer.poll();
    if (!packet) {
      std::this_thread::yield();
      continue;
    }
    if (packet->opcode() == Opcode::dump_end) return true;
    for (const UniqueFd& fd : packet->fds) {
      take_hold_of(fd.get());
      ++attack.word(0);
    }
  }
}

void look_on(const std::string& path, Attack& attack) {
  WireClient observer(path);
  wire::Observe observe{};
  observe.fingerprint = abi::fingerprint();
  const Incoming seen = observer.ask(Opcode::observe, observe);
  EXPECT_EQ(seen.opcode(), Opcode::observed) << seen.refused_text();
  for (const UniqueFd& board : seen.fds) take_hold_of(board.get());
  bool is_ready = false;
  while (look(observer, attack)) {
    if (!std::exchange(is_ready, true)) attack.ready();
  }
}

void processes_join(Stage& stage, const Attacker& attacker) {
  constexpr unsigned processes = 12;
  const std::uint64_t before = attacker.word(0);
  for (unsigned i = 0; i < processes; ++i)
    EXPECT_EQ(stage.another_honest_process()->ask("create /joined" + std::to_string(i)), "ok");
  stage.honest_is_served();
  stage.honest_goes_on();
  EXPECT_GT(attacker.word(0), before + processes) << "the attacker did not attack";
}

TEST(HostileJoining, IsNotPreventedByLocksOfReaders) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage;
  const auto attack = [&](Attack& on) { look_on(stage.socket_path(), on); };
  {
    Attacker attacker(attack);
    if (!attacker.wait_until_ready()) return attacker.end();
    processes_join(stage, attacker);
    attacker.end();
  }
  const pid_t killed = stage.daemon().kill_worker();
  ASSERT_TRUE(stage.daemon().wait_for_next(killed));
  Attacker attacker(attack);
  if (!attacker.wait_until_ready()) return attacker.end();
  processes_join(stage, attacker);
  attacker.end();
}

}  // namespace
}  // namespace agnocast::test
