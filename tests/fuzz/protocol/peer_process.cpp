// SPDX-License-Identifier: Apache-2.0
//
// Peer process: see the header. It has this process's thread-local data, so it makes system calls
// and nothing else. One that fails overwrites this process's errno.

#include <tests/fuzz/protocol/peer_process.hpp>

#include <base/check.hpp>
#include <base/sockets/unix_address.hpp>

#include <linux/futex.h>
#include <sched.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cerrno>
#include <climits>
#include <csignal>
#include <cstdint>
#include <new>
#include <utility>

// The sanitizers keep thread-local data, too.
#define NOT_SANITIZED __attribute__((no_sanitize("address", "undefined", "coverage")))

namespace agnocast::daemon::fuzz {

/// Shared by both. `given` and `done` count orders: to connect `socket`. Words for the compiler's
/// atomics: members of std::atomic are sanitized functions in a build without optimisation.
struct PeerProcess::Orders {
  static constexpr std::size_t stack_bytes = 64 * 1024;

  std::uint32_t given = 0, done = 0;
  uid_t uid = 0;
  int socket = -1;
  UnixAddress address;
  bool connected = false;
  alignas(64) char stack[stack_bytes];

  NOT_SANITIZED static void wait(std::uint32_t& word, std::uint32_t while_it_is) {
    while (__atomic_load_n(&word, __ATOMIC_SEQ_CST) == while_it_is)
      ::syscall(SYS_futex, &word, FUTEX_WAIT, while_it_is, nullptr, nullptr, 0);
  }
  NOT_SANITIZED static void advance(std::uint32_t& word) {
    __atomic_fetch_add(&word, 1, __ATOMIC_SEQ_CST);
    ::syscall(SYS_futex, &word, FUTEX_WAKE, INT_MAX, nullptr, nullptr, 0);
  }
  NOT_SANITIZED static int run(void* shared);
};

int PeerProcess::Orders::run(void* shared) {
  Orders& orders = *static_cast<Orders*>(shared);
  // Not setresuid(3), which would change the threads of this process as well. It may not in a user
  // namespace without that uid.
  if (::syscall(SYS_geteuid) == 0) ::syscall(SYS_setresuid, orders.uid, orders.uid, orders.uid);
  orders.uid = static_cast<uid_t>(::syscall(SYS_geteuid));
  ::syscall(SYS_prctl, PR_SET_PDEATHSIG, SIGKILL, 0, 0, 0);  // after the change, which resets it
  for (std::uint32_t number = 0;; ++number) {
    advance(orders.done);
    wait(orders.given, number);
    orders.connected = ::syscall(SYS_connect, orders.socket, &orders.address.address,
                                 sizeof orders.address.address) == 0;
  }
}

PeerProcess::PeerProcess(uid_t uid) {
  void* const memory =
      ::mmap(nullptr, sizeof(Orders), PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
  AGNOCAST_CHECK(memory != MAP_FAILED);
  orders_ = new (memory) Orders;
  orders_->uid = uid;
  pid_ = ::clone(&Orders::run, orders_->stack + Orders::stack_bytes,
                 CLONE_VM | CLONE_FILES | SIGCHLD, orders_);
  AGNOCAST_CHECK(pid_ > 0);
  Orders::wait(orders_->done, 0);
  // The change of its user has forbidden core dumps of the memory that both have.
  ::prctl(PR_SET_DUMPABLE, 1);
}

uid_t PeerProcess::uid() const { return orders_->uid; }

PeerProcess::~PeerProcess() {
  ::kill(pid_, SIGKILL);
  while (::waitpid(pid_, nullptr, 0) < 0 && errno == EINTR) {
  }
  ::munmap(orders_, sizeof(Orders));
}

PacketSocket PeerProcess::connect(const std::string& path) {
  UniqueFd socket(::socket(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0));
  AGNOCAST_CHECK(static_cast<bool>(socket));
  orders_->socket = socket.get();
  orders_->address = unix_address(path).value();
  const std::uint32_t before = __atomic_load_n(&orders_->done, __ATOMIC_SEQ_CST);
  Orders::advance(orders_->given);
  Orders::wait(orders_->done, before);
  AGNOCAST_CHECK(orders_->connected);
  return PacketSocket(std::move(socket));
}

}  // namespace agnocast::daemon::fuzz
