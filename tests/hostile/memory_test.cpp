// SPDX-License-Identifier: Apache-2.0
//
// Goal: with the descriptors and mappings that a client really gets, another user can write only
// its own memory, resize nothing at all, and cause no SIGBUS in another process, whatever the
// kernel offers.
// Method: a list of attempts, each with the errno that it must end with, on every kind of shared
// memory, with the daemon as root and as a user of its own, while an honest pair runs. When a
// kernel or one of our changes opens a way, or closes it otherwise, an attempt fails the test.

#include <tests/hostile/hostile_node.hpp>
#include <tests/support/machine/immutable_memory.hpp>

#include <base/memory/populate.hpp>

#include <fcntl.h>
#include <linux/fs.h>
#include <linux/futex.h>
#include <linux/userfaultfd.h>
#include <sched.h>
#include <sys/ioctl.h>
#include <sys/ptrace.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/uio.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <fstream>
#include <string>
#include <thread>

namespace agnocast::test {
namespace {

using wire::Kind;
using wire::Opcode;

constexpr std::uint64_t page = 4096;

std::string path_of(int fd) { return "/proc/self/fd/" + std::to_string(fd); }

/// Returns 0 when the call worked, else errno.
template <class Call>
int outcome(Call call) {
  errno = 0;
  return call() < 0 ? errno : 0;
}
int outcome_of_map(void* at) { return at == MAP_FAILED ? errno : 0; }

int write_self(void* at) {
  const UniqueFd memory(::open("/proc/self/mem", O_RDWR | O_CLOEXEC));
  EXPECT_TRUE(memory);
  return outcome([&] {
    return ::pwrite(memory.get(), "x", 1, static_cast<off_t>(reinterpret_cast<std::uintptr_t>(at)));
  });
}

int write_vm(pid_t pid, void* at) {
  char byte = 'x';
  const iovec local{&byte, 1}, remote{at, 1};
  return outcome([&] { return ::process_vm_writev(pid, &local, 1, &remote, 1, 0); });
}

// Registers a fault handler that would fill pages of a mapping; returns 0 only if the kernel
// allows it.
int userfaultfd_on(void* at) {
  const UniqueFd fd(
      static_cast<int>(::syscall(SYS_userfaultfd, O_CLOEXEC | O_NONBLOCK | UFFD_USER_MODE_ONLY)));
  if (!fd) return EPERM;  // not available here
  uffdio_api api{};
  api.api = UFFD_API;
  if (::ioctl(fd.get(), UFFDIO_API, &api) != 0) return EPERM;
  uffdio_register range{};
  range.range = {reinterpret_cast<std::uintptr_t>(at), page};
  range.mode = UFFDIO_REGISTER_MODE_MISSING;
  return outcome([&] { return ::ioctl(fd.get(), UFFDIO_REGISTER, &range); });
}

/// Returns whether the daemon has forbidden to punch holes there.
bool has_no_holes(int fd) {
  int flags = 0;
  return ::ioctl(fd, FS_IOC_GETFLAGS, &flags) == 0 && (flags & FS_IMMUTABLE_FL) != 0;
}

int punch(int fd, std::uint64_t offset, std::uint64_t bytes) {
  return outcome([&] {
    return ::fallocate(fd, FALLOC_FL_PUNCH_HOLE | FALLOC_FL_KEEP_SIZE, static_cast<off_t>(offset),
                       static_cast<off_t>(bytes));
  });
}

// Tries everything that might write through a read-only descriptor, or through a mapping of it.
void try_to_write(int fd, const std::string& what, Length length = Length::may_grow) {
  SCOPED_TRACE(what);
  const std::string path = path_of(fd);
  for (const int flags : {O_RDWR, O_WRONLY, O_RDONLY, O_RDWR | O_TRUNC}) {
    const bool is_immutable = flags != O_RDONLY && has_no_holes(fd);
    EXPECT_EQ(outcome([&] { return ::open(path.c_str(), flags | O_CLOEXEC); }),
              is_immutable ? EPERM : EACCES)
        << flags;
  }
  EXPECT_EQ(outcome_of_map(::mmap(nullptr, page, PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0)),
            EACCES);
  EXPECT_EQ(outcome([&] { return ::pwrite(fd, "x", 1, 0); }), EBADF);
  EXPECT_EQ(outcome([&] { return ::ftruncate(fd, 0); }), EINVAL);
  EXPECT_EQ(outcome([&] { return ::fallocate(fd, 0, 0, page); }), EBADF);
  EXPECT_EQ(punch(fd, 0, page), EBADF);
  EXPECT_EQ(outcome([&] { return ::fcntl(fd, F_ADD_SEALS, F_SEAL_WRITE); }), EPERM);
  EXPECT_EQ(::fcntl(fd, F_GET_SEALS), F_SEAL_SHRINK | F_SEAL_SEAL |
                                          (length == Length::fixed ? F_SEAL_GROW : 0) |
                                          (::fcntl(fd, F_GET_SEALS) & 0x20 /* F_SEAL_EXEC */));
  EXPECT_EQ(outcome([&] { return ::fchmod(fd, 0777); }), EPERM);
  EXPECT_EQ(outcome([&] { return ::fchown(fd, ::getuid(), ::getgid()); }), EPERM);
  struct stat before {};
  ASSERT_EQ(::fstat(fd, &before), 0);
  EXPECT_EQ(before.st_mode & 0777, 0600u);
  EXPECT_NE(before.st_uid, ::getuid());

  char* const at = static_cast<char*>(::mmap(nullptr, page, PROT_READ, MAP_SHARED, fd, 0));
  ASSERT_NE(at, MAP_FAILED);
  EXPECT_EQ(outcome([&] { return ::mprotect(at, page, PROT_READ | PROT_WRITE); }), EACCES);
  void* const twin = ::mremap(at, 0, page, MREMAP_MAYMOVE);
  ASSERT_NE(twin, MAP_FAILED);
  EXPECT_EQ(outcome([&] { return ::mprotect(twin, page, PROT_WRITE); }), EACCES);
  void* const moved = ::mremap(twin, page, 2 * page, MREMAP_MAYMOVE);
  ASSERT_NE(moved, MAP_FAILED);
  EXPECT_EQ(outcome([&] { return ::mprotect(moved, page, PROT_WRITE); }), EACCES);
  EXPECT_EQ(outcome([&] { return ::madvise(at, page, MADV_REMOVE); }), EACCES);
  EXPECT_EQ(outcome([&] { return ::madvise(at, page, MADV_POPULATE_WRITE); }), EINVAL);
  EXPECT_EQ(write_self(at), EIO);
  EXPECT_EQ(write_vm(::getpid(), at), EFAULT);
  EXPECT_EQ(userfaultfd_on(at), EPERM);
  // The kernel as the writer: into the mapping as a buffer, and as a futex.
  const UniqueFd zero(::open("/dev/zero", O_RDONLY | O_CLOEXEC));
  EXPECT_EQ(outcome([&] { return ::read(zero.get(), at, 8); }), EFAULT);
  std::uint32_t own = 0;
  EXPECT_EQ(outcome([&] {
              return ::syscall(SYS_futex, &own, FUTEX_WAKE_OP, 1, 1L, at,
                               FUTEX_OP(FUTEX_OP_SET, 1, FUTEX_OP_CMP_EQ, 0));
            }),
            EFAULT);
  EXPECT_EQ(outcome([&] { return ::syscall(SYS_futex, at, FUTEX_LOCK_PI, 0, nullptr); }), EFAULT);
  struct stat after {};
  ASSERT_EQ(::fstat(fd, &after), 0);
  EXPECT_EQ(after.st_size, before.st_size);
  ::munmap(at, page);
  ::munmap(moved, 2 * page);
}

// A process may write and lengthen its own memory, but neither shorten it nor give it away.
void try_to_resize(int fd, const std::string& what) {
  SCOPED_TRACE(what);
  struct stat status {};
  ASSERT_EQ(::fstat(fd, &status), 0);
  EXPECT_EQ(outcome([&] { return ::ftruncate(fd, 0); }), EPERM);
  EXPECT_EQ(outcome([&] { return ::ftruncate(fd, status.st_size - 4096); }), EPERM);
  EXPECT_EQ(outcome([&] { return ::ftruncate(fd, status.st_size + 4096); }), 0);
  EXPECT_EQ(outcome([&] { return ::ftruncate(fd, status.st_size); }), EPERM);
  for (const int mode : {FALLOC_FL_COLLAPSE_RANGE, FALLOC_FL_INSERT_RANGE})
    EXPECT_NE(outcome([&] { return ::fallocate(fd, mode, 0, page); }), 0);
  for (const int seal : {F_SEAL_WRITE, F_SEAL_FUTURE_WRITE, F_SEAL_GROW})
    EXPECT_EQ(outcome([&] { return ::fcntl(fd, F_ADD_SEALS, seal); }), EPERM);
  EXPECT_EQ(outcome([&] { return ::fchmod(fd, 0777); }), EPERM);
  EXPECT_EQ(outcome([&] { return ::open(path_of(fd).c_str(), O_RDWR | O_TRUNC | O_CLOEXEC); }),
            has_no_holes(fd) ? EPERM : EACCES);
  int none = 0;
  EXPECT_NE(outcome([&] { return ::ioctl(fd, FS_IOC_SETFLAGS, &none); }), 0);
}

class HostileMemory : public testing::TestWithParam<bool> {
 protected:
  StageOptions options() const {
    StageOptions options;
    if (GetParam()) options.daemon = daemon_uid;
    return options;
  }
};

TEST_P(HostileMemory, GivesNobodyAWayToWriteMemoryOfOthers) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage(options());
  Attacker attacker([&](Attack&) {
    HostileNode node(stage.socket_path());
    node.join(Kind::subscription, stream_topic);
    const auto publisher = node.announced();
    ASSERT_EQ(publisher.fds.size(), 2u);
    node.join(Kind::publisher, open_topic);
    const auto subscription = node.announced();
    ASSERT_EQ(subscription.body.kind, Kind::subscription);
    ASSERT_EQ(subscription.fds.size(), 2u)
        << "region and datagram doorbell: no eventfd for this user";
    struct stat doorbell {};
    ASSERT_EQ(::fstat(subscription.fds[1].get(), &doorbell), 0);
    EXPECT_TRUE(S_ISSOCK(doorbell.st_mode)) << "an eventfd would let us block its other holders";
    try_to_write(node.board_fd(), "board", Length::fixed);
    try_to_write(publisher.fds[0].get(), "region of the honest publisher");
    try_to_write(publisher.fds[1].get(), "window of the honest publisher");
    try_to_write(subscription.fds[0].get(), "region of the honest subscriber");
    try_to_write(node.window_read_fd(), "own window, as its children get it");
    try_to_resize(node.region_fd(), "own region");
    try_to_resize(node.window_fd(), "own window");
  });
  attacker.end();
  stage.honest_goes_on();
}

TEST_P(HostileMemory, GivesAnObserverNoWayToWrite) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage(options());
  Attacker attacker([&](Attack&) {
    WireClient observer(stage.socket_path());
    wire::Observe observe{};
    observe.fingerprint = abi::fingerprint();
    Incoming observed = observer.ask(Opcode::observe, observe);
    ASSERT_EQ(observed.opcode(), Opcode::observed) << observed.refused_text();
    ASSERT_EQ(observed.fds.size(), 1u);
    try_to_write(observed.fds[0].get(), "board", Length::fixed);
    observer.send(Opcode::dump, wire::Dump{});
    unsigned regions = 0;
    for (;;) {
      Incoming packet = observer.next();
      if (packet.bytes.empty() || packet.opcode() == Opcode::dump_end) break;
      EXPECT_LE(packet.fds.size(), 1u);
      for (const UniqueFd& fd : packet.fds) {
        ++regions;
        struct stat status {};
        ASSERT_EQ(::fstat(fd.get(), &status), 0);
        char name[64] = {};
        EXPECT_GT(::readlink(path_of(fd.get()).c_str(), name, sizeof name - 1), 0);
        EXPECT_EQ(std::string(name), "/memfd:agnocast-region (deleted)")
            << "an observer gets no window";
        EXPECT_LT(status.st_size, off_t{1} << 20) << "the region should be only a few extents long";
        try_to_write(fd.get(), "region of a process");
      }
    }
    EXPECT_EQ(regions, 2u);
  });
  attacker.end();
}

// Indirect ways: through the processes that have the memory for writing.
TEST_P(HostileMemory, KeepsOthersOutOfTheProcessesThatMayWrite) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage(options());
  Attacker attacker([&](Attack&) {
    for (const pid_t pid : {stage.daemon().pid(), stage.publisher().pid()}) {
      SCOPED_TRACE(pid == stage.daemon().pid() ? "daemon" : "honest publisher");
      const std::string proc = "/proc/" + std::to_string(pid);
      for (const char* const file : {"/mem", "/maps", "/fd/0", "/map_files"})
        EXPECT_EQ(outcome([&] { return ::open((proc + file).c_str(), O_RDONLY | O_CLOEXEC); }),
                  EACCES)
            << file;
      int here = 0;
      const int error = write_vm(pid, &here);
      EXPECT_EQ(error, EPERM);
      EXPECT_EQ(outcome([&] { return ::ptrace(PTRACE_SEIZE, pid, nullptr, nullptr); }), EPERM);
      EXPECT_EQ(outcome([&] { return ::kill(pid, SIGSTOP); }), EPERM);
      const UniqueFd process(static_cast<int>(::syscall(SYS_pidfd_open, pid, 0)));
      ASSERT_TRUE(process);
      EXPECT_EQ(outcome([&] { return ::syscall(SYS_pidfd_getfd, process.get(), 3, 0); }), EPERM);
    }
  });
  attacker.end();
  stage.honest_goes_on();
}

void make_zero(const HostileNode& node, std::uint64_t offset, std::uint64_t bytes) {
  const int error = punch(node.region_fd(), offset, bytes);
  EXPECT_EQ(error, has_no_holes(node.region_fd()) ? EPERM : 0);
  if (error != 0) std::memset(node.region() + offset, 0, bytes);
}

// A process can free its own pages while others read them: they read zero, and nobody faults.
TEST_P(HostileMemory, KillsNoReaderByFreeingItsOwnMemory) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage(options());
  Chance chance(1);
  Attacker attacker([&](Attack& attack) {
    HostileNode node(stage.socket_path());
    const auto publisher = node.join(Kind::publisher, open_topic);
    const auto subscription = node.join(Kind::subscription, stream_topic);
    const auto queue = node.queue(publisher);
    const auto about = [&] {
      for (;;) {
        auto announced = node.announced();
        if (announced.body.kind == Kind::subscription || announced.fds.empty()) return announced;
      }
    }();
    ASSERT_EQ(about.fds.size(), 2u);
    const Doorbell doorbell(UniqueFd(::dup(about.fds[1].get())));
    attack.ready();
    for (std::uint64_t round = 0; attack.goes_on(); ++round) {
      for (std::uint64_t i = 0; i < 20; ++i)
        node.commit(publisher, node.open_window().base + (round * 20 + i) % 4096 * 64, flat_bytes);
      static_cast<void>(doorbell.ring());
      ::usleep(static_cast<useconds_t>(chance.below(500)));
      const std::uint64_t head = queue.head().load();
      EXPECT_EQ(punch(node.window_fd(), 0, 1 << 20), 0);
      // Through its own descriptors: header, queue, link lines.
      make_zero(node, 0, page);
      if (round % 2 == 0) make_zero(node, publisher.extent, abi::publisher_extent_bytes);
      make_zero(node, subscription.extent, abi::subscription_extent_bytes(1));
      node.frontier().store(1 << 20);
      // It restores the old head, or nobody would read any more.
      if (round % 2 == 0) queue.head().store(head);
      ++attack.word(0);
    }
  });
  ASSERT_TRUE(attacker.wait_until_ready());
  stage.honest_goes_on();
  EXPECT_TRUE(eventually([&] { return attacker.word(0) > 100 && stage.state().watched > 100; }))
      << "nobody read the memory that was taken away";
  attacker.kill();
  stage.honest_goes_on();
  stage.honest_is_served();
}

// A page fault waits while a hole is punched over its page, and a thread that the scheduler seldom
// runs takes long to punch one. So the daemon forbids holes in memory that it and publishers of
// others read.
TEST(HostileHoles, InItsOwnRegionDelayNobody) {
  AGNOCAST_NEEDS_TWO_USERS();
  if (const int error = kernel_refuses_immutable_memory())
    GTEST_SKIP() << "it needs Linux 6.0 and CAP_LINUX_IMMUTABLE: " << std::strerror(error);
  Stage stage;
  Attacker attacker([&](Attack& attack) {
    HostileNode node(stage.socket_path());
    EXPECT_TRUE(has_no_holes(node.region_fd()));
    const auto subscription = node.join(Kind::subscription, stream_topic);
    constexpr std::uint64_t much = 256 << 20;
    EXPECT_TRUE(lengthen(node.region_fd(), much));
    EXPECT_TRUE(populate(node.region(), much));
    cpu_set_t one_cpu;
    CPU_ZERO(&one_cpu);
    CPU_SET(0, &one_cpu);
    EXPECT_EQ(::sched_setaffinity(0, sizeof one_cpu, &one_cpu), 0);
    std::thread hog([&] {
      while (attack.goes_on()) attack.word(2) = attack.word(2) + 1;
    });
    const sched_param lowest{};
    EXPECT_EQ(::sched_setscheduler(0, SCHED_IDLE, &lowest), 0);
    while (attack.goes_on()) {
      const int by_call = punch(node.region_fd(), subscription.extent, much - subscription.extent);
      const int by_mapping = outcome([&] {
        return ::madvise(node.region() + subscription.extent, much - subscription.extent,
                         MADV_REMOVE);
      });
      EXPECT_EQ(by_call, EPERM);
      EXPECT_EQ(by_mapping, EPERM);
      attack.ready();
      if (by_call == 0) static_cast<void>(populate(node.region(), much));
    }
    hog.join();
  });
  EXPECT_TRUE(attacker.wait_until_ready());
  for (int round = 0; round < 5; ++round) {
    stage.honest_goes_on();
    stage.honest_is_served();
  }
  attacker.kill();
}

/// Sets the host's huge pages of shared memory, and restores the setting.
class SharedHugePages {
 public:
  explicit SharedHugePages(const char* word) {
    std::ifstream file(path);
    std::string text;
    std::getline(file, text);
    if (const std::size_t at = text.find('['); at != std::string::npos)
      before_ = text.substr(at + 1, text.find(']') - at - 1);
    is_set_ = !before_.empty() && set(word);
  }
  ~SharedHugePages() {
    if (is_set_) set(before_);
  }
  SharedHugePages(const SharedHugePages&) = delete;
  SharedHugePages& operator=(const SharedHugePages&) = delete;
  bool is_set() const { return is_set_; }

 private:
  static constexpr const char* path = "/sys/kernel/mm/transparent_hugepage/shmem_enabled";
  static bool set(const std::string& word) {
    std::ofstream file(path);
    file << word << std::endl;
    return file.good();
  }
  std::string before_;
  bool is_set_ = false;
};

// A reader of a file may collapse its pages into a huge page, which locks them for as long as the
// reader's scheduling class and mappings allow. "deny", as the package sets it, leaves nothing to
// collapse.
TEST(HostileHoles, AReaderCannotCollapsePagesOfOthers) {
  AGNOCAST_NEEDS_TWO_USERS();
#ifndef MADV_COLLAPSE
  constexpr int MADV_COLLAPSE = 25;  // Linux 6.1
#endif
  const SharedHugePages denied("deny");
  if (!denied.is_set()) GTEST_SKIP() << "shmem_enabled cannot be set here";
  Stage stage;
  Attacker attacker([&](Attack& attack) {
    HostileNode node(stage.socket_path());
    node.join(Kind::subscription, stream_topic);
    const auto publisher = node.announced();
    ASSERT_EQ(publisher.fds.size(), 2u);
    constexpr std::uint64_t huge = 2 << 20;
    const auto collapse = [&](int fd) {
      const auto addresses = Mapping::reserve(0, 2 * huge);
      auto* const at = reinterpret_cast<void*>(
          (reinterpret_cast<std::uintptr_t>(addresses->base()) + huge - 1) / huge * huge);
      EXPECT_EQ(::mmap(at, huge, PROT_READ, MAP_SHARED | MAP_FIXED, fd, 0), at);
      EXPECT_EQ(outcome([&] { return ::madvise(at, huge, MADV_COLLAPSE); }), EINVAL);
    };
    while (attack.goes_on()) {
      collapse(node.board_fd());
      collapse(publisher.fds[0].get());
      collapse(publisher.fds[1].get());
      attack.ready();
    }
  });
  EXPECT_TRUE(attacker.wait_until_ready());
  for (int round = 0; round < 3; ++round) {
    stage.honest_goes_on();
    stage.honest_is_served();
  }
  attacker.end();
}

/// Populates the pages of the first `bytes` that a read-only descriptor can reach. Returns how
/// many bytes of the file are then allocated.
std::uint64_t touch_all(int fd, std::uint64_t bytes) {
  const Mapping mapping = std::move(Mapping::map(fd, bytes, Mapping::Access::read).value());
  constexpr std::uint64_t slice = std::uint64_t{2} << 20;
  for (std::uint64_t at = 0; at < bytes; at += slice) {
    // Beyond the end this is EFAULT; a touch would be SIGBUS.
    const std::uint64_t there = std::min(slice, bytes - at);
    ::madvise(mapping.base() + at, there, MADV_POPULATE_READ);
  }
  struct stat status {};
  EXPECT_EQ(::fstat(fd, &status), 0);
  return static_cast<std::uint64_t>(status.st_blocks) * 512;
}

// Reading a hole through a mapping allocates a page, which belongs to the owner and stays. There
// are hardly any holes: readers can only touch memory that an honest process already uses.
TEST_P(HostileMemory, ReadersAllocateNoMemoryInHoles) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage(options());
  constexpr std::uint64_t mib = std::uint64_t{1} << 20;
  Attacker attacker([&](Attack& attack) {
    HostileNode node(stage.socket_path());
    node.join(Kind::subscription, stream_topic);
    const auto publisher = node.announced();
    ASSERT_EQ(publisher.body.window_count, 1u);
    const std::uint64_t window = publisher.body.window[0].bytes;
    ASSERT_GE(window, 64 * mib);
    EXPECT_LE(touch_all(publisher.fds[0].get(), node.welcome().client_region_bytes), mib);
    EXPECT_LE(touch_all(publisher.fds[1].get(), window), 8 * mib)
        << "the owner extends it by 2 MiB at a time";
    attack.ready();
    while (attack.goes_on()) ::usleep(5000);
  });
  ASSERT_TRUE(attacker.wait_until_ready());
  stage.honest_goes_on();
  attacker.end();
  stage.honest_goes_on();
}

// A publisher that claims a frontier beyond the end of its window's file.
TEST_P(HostileMemory, AWindowThatIsShorterThanItsOwnerClaimsKillsNoReader) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage(options());
  Attacker attacker([&](Attack& attack) {
    HostileNode node(stage.socket_path(), page);
    const auto publisher = node.join(Kind::publisher, open_topic);
    const std::uint64_t base = node.open_window().base;
    node.frontier().store(node.open_window().bytes);
    attack.ready();
    for (std::uint64_t round = 0; attack.goes_on(); ++round) {
      // Inside, across the end, beyond it.
      for (const std::uint64_t at : {std::uint64_t{0}, page - flat_bytes / 2, page, 2 * page})
        node.commit(publisher, base + at, flat_bytes);
      ::usleep(500);
      ++attack.word(0);
    }
  });
  ASSERT_TRUE(attacker.wait_until_ready());
  stage.honest_goes_on();
  EXPECT_TRUE(eventually([&] { return attacker.word(0) > 100 && stage.state().watched > 100; }))
      << "nobody read the messages that exist";
  attacker.kill();
  stage.honest_goes_on();
  stage.honest_is_served();
}

INSTANTIATE_TEST_SUITE_P(Daemon, HostileMemory, testing::Bool(),
                         [](const testing::TestParamInfo<bool>& daemon) {
                           return std::string(daemon.param ? "AsAUserOfItsOwn" : "AsRoot");
                         });

}  // namespace
}  // namespace agnocast::test
