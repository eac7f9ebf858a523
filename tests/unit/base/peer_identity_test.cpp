// SPDX-License-Identifier: Apache-2.0
//
// Goal: the daemon identifies its peer, also on kernels without SO_PEERPIDFD, and no process
// passes for another one. Method: forked children connect, one as another user; a seccomp filter
// or an argument takes SO_PEERPIDFD away, as on an old kernel.

#include <base/sockets/packet_socket.hpp>
#include <base/sockets/peer_identity.hpp>

#include "tests/support/machine/seccomp_filter.hpp"
#include "tests/support/machine/temporary_directory.hpp"
#include "tests/support/memory/descriptors.hpp"
#include "tests/support/processes/child.hpp"
#include "tests/support/wire/listen_at.hpp"

#include <gmock/gmock.h>

#include <grp.h>
#include <poll.h>
#include <sys/stat.h>
#include <sys/syscall.h>

#include <array>
#include <cerrno>

namespace agnocast {
namespace {

using test::Child;

constexpr std::uint32_t so_peerpidfd = 77;

bool kernel_has_peer_pidfd() {
  const auto pair = PacketSocket::pair();
  int fd = -1;
  socklen_t bytes = sizeof fd;
  const bool has = ::getsockopt(pair->first.fd(), SOL_SOCKET, int{so_peerpidfd}, &fd, &bytes) == 0;
  const UniqueFd close(fd);
  return has;
}

void wait_until_readable(int fd) {
  pollfd entry{fd, POLLIN, 0};
  ASSERT_EQ(::poll(&entry, 1, 10'000), 1);
}

// A listener that asks for credentials, and the connection that it has accepted.
struct Daemon {
  test::TemporaryDirectory directory;
  PacketListener listener;
  PacketSocket session;
  std::array<std::byte, 16> buffer{};

  Daemon() {
    ::chmod(directory.path().c_str(), 0711);
    listener = std::move(test::listen_at(path()).value());
    ::chmod(path().c_str(), 0666);
    EXPECT_TRUE(listener.want_credentials(true));
  }
  std::string path() const { return directory.path("socket"); }
  void accept() {
    wait_until_readable(listener.fd());
    session = std::move(listener.accept().value().value());
  }
  ucred receive_credentials() {
    wait_until_readable(session.fd());
    return session.receive(buffer).value().credentials.value();
  }
};

int connect_send_and_sleep(const Daemon& daemon) {
  const auto client = PacketSocket::connect(daemon.path());
  const std::byte byte{};
  if (!client || client->send({&byte, 1}).value() != Sent::sent) return 1;
  return test::sleep_for_ever();
}

TEST(PeerIdentity, NamesUserGroupsAndProcessOfThePeer) {
  if (::geteuid() != 0) GTEST_SKIP() << "needs root to become another user";
  if (!kernel_has_peer_pidfd()) GTEST_SKIP() << "SO_PEERPIDFD needs Linux 6.5";
  Daemon daemon;
  Child child([&] {
    const gid_t group = 4321;
    if (::setgroups(1, &group) != 0 || ::setgid(65533) != 0 || ::setuid(65534) != 0) return 1;
    return connect_send_and_sleep(daemon);
  });
  daemon.accept();
  const auto identity = identify_peer(daemon.session.fd());
  ASSERT_TRUE(identity);
  EXPECT_EQ(identity->uid, 65534U);
  EXPECT_EQ(identity->gid, 65533U);
  EXPECT_THAT(identity->groups, testing::ElementsAre(4321U));
  EXPECT_EQ(identity->pid, child.pid());
  EXPECT_TRUE(identity->confirmed);
  EXPECT_TRUE(test::is_close_on_exec(identity->process.fd()));
  EXPECT_EQ(identity->process.inode(), Pidfd::open(child.pid())->inode());
  EXPECT_FALSE(identity->process.ended());
  child.kill();
  wait_until_readable(identity->process.fd());
}

TEST(PeerIdentity, ListsAllGroupsBeyondTheFirstGuess) {
  if (::geteuid() != 0) GTEST_SKIP() << "needs root to set groups";
  Daemon daemon;
  std::vector<gid_t> groups(300);
  for (std::size_t i = 0; i < groups.size(); ++i) groups[i] = static_cast<gid_t>(1000 + i);
  Child child([&] {
    if (::setgroups(groups.size(), groups.data()) != 0) return 1;
    return connect_send_and_sleep(daemon);
  });
  daemon.accept();
  const auto identity = identify_peer(daemon.session.fd());
  ASSERT_TRUE(identity);
  EXPECT_THAT(identity->groups, testing::UnorderedElementsAreArray(groups));
}

TEST(PeerIdentity, ProcessThatDiedBeforeItWasAcceptedHasEnded) {
  if (!kernel_has_peer_pidfd()) GTEST_SKIP() << "SO_PEERPIDFD needs Linux 6.5";
  Daemon daemon;
  Child child([&] { return connect_send_and_sleep(daemon); });
  wait_until_readable(daemon.listener.fd());
  child.kill();
  child.wait_until_zombie();
  daemon.accept();
  const auto identity = identify_peer(daemon.session.fd());
  ASSERT_TRUE(identity);
  EXPECT_TRUE(identity->process.ended());
}

TEST(PeerIdentity, OldKernelNeedsAPacketOfTheSameProcess) {
  Daemon daemon;
  Child child([&] { return connect_send_and_sleep(daemon); });
  daemon.accept();
  auto identity = identify_peer(daemon.session.fd(), PeerFacility::only_pidfd_open);
  ASSERT_TRUE(identity);
  EXPECT_EQ(identity->pid, child.pid());
  EXPECT_FALSE(identity->confirmed);
  EXPECT_FALSE(identity->process.ended());
  EXPECT_TRUE(confirm(*identity, daemon.receive_credentials()));
  EXPECT_TRUE(identity->confirmed);
}

TEST(PeerIdentity, PacketOfAnotherProcessConfirmsNothing) {
  Daemon daemon;
  Child child([&] {
    const auto client = PacketSocket::connect(daemon.path());
    Child successor([&] {
      const std::byte byte{};
      return client->send({&byte, 1}).value() == Sent::sent ? 0 : 1;
    });
    if (successor.wait() != 0) return 1;
    return test::sleep_for_ever();
  });
  daemon.accept();
  auto identity = identify_peer(daemon.session.fd(), PeerFacility::only_pidfd_open);
  ASSERT_TRUE(identity);
  const ucred credentials = daemon.receive_credentials();
  EXPECT_NE(credentials.pid, child.pid());
  EXPECT_FALSE(confirm(*identity, credentials));
  EXPECT_FALSE(identity->confirmed);
}

// The kernel may reuse the pid between connect and pidfd_open. Only a packet received before the
// pidfd reports the end proves that it did not.
TEST(PeerIdentity, PacketReadAfterTheEndOfTheProcessConfirmsNothing) {
  Daemon daemon;
  Child child([&] { return connect_send_and_sleep(daemon); });
  daemon.accept();
  auto identity = identify_peer(daemon.session.fd(), PeerFacility::only_pidfd_open);
  ASSERT_TRUE(identity);
  const ucred credentials = daemon.receive_credentials();
  EXPECT_EQ(credentials.pid, child.pid());
  child.kill();
  child.wait_until_zombie();
  EXPECT_FALSE(confirm(*identity, credentials));
}

TEST(PeerIdentity, CredentialsWithoutAPidConfirmNothing) {
  PeerIdentity identity;
  identity.process = std::move(Pidfd::open(::getpid()).value());
  EXPECT_FALSE(confirm(identity, ucred{}));
  identity.pid = ::getpid();
  EXPECT_TRUE(confirm(identity, ucred{::getpid(), 0, 0}));
}

TEST(PeerIdentity, OldKernelReportsAPeerThatIsGone) {
  Daemon daemon;
  Child child([&] { return connect_send_and_sleep(daemon); });
  daemon.accept();
  child.kill();
  child.wait();
  const auto identity = identify_peer(daemon.session.fd(), PeerFacility::only_pidfd_open);
  ASSERT_FALSE(identity);
  EXPECT_EQ(identity.error().os_errno, ESRCH);
}

class MissingOption : public testing::TestWithParam<int> {};

// The kernel's own answer, not our argument: each errno that an older kernel or a filter gives.
TEST_P(MissingOption, FallsBackToPidfdOpen) {
  Child child([&] {
    const auto pair = PacketSocket::pair();
    if (!test::deny_getsockopt(SYS_getsockopt, SOL_SOCKET, so_peerpidfd,
                               static_cast<std::uint32_t>(GetParam())))
      return 77;
    if (kernel_has_peer_pidfd()) return 1;  // the filter does not work
    auto identity = identify_peer(pair->first.fd());
    if (!identity) return 2;
    if (identity->confirmed || identity->pid != ::getpid() || !identity->process) return 3;
    if (!pair->first.want_credentials(true)) return 4;
    const std::byte byte{};
    if (pair->second.send({&byte, 1}).value() != Sent::sent) return 5;
    std::array<std::byte, 4> buffer;
    const Packet packet = pair->first.receive(buffer).value();
    return packet.credentials && confirm(*identity, *packet.credentials) ? 0 : 6;
  });
  const int status = child.wait();
  if (status == 77) GTEST_SKIP() << "needs seccomp filters";
  EXPECT_EQ(status, 0);
}
INSTANTIATE_TEST_SUITE_P(PeerIdentity, MissingOption,
                         testing::Values(ENOPROTOOPT, EINVAL, ENOSYS, EOPNOTSUPP));

TEST(PeerIdentity, OtherErrorsAreNotTakenForAnOldKernel) {
  Child child([] {
    const auto pair = PacketSocket::pair();
    if (!test::deny_getsockopt(SYS_getsockopt, SOL_SOCKET, so_peerpidfd, EMFILE)) return 77;
    const auto identity = identify_peer(pair->first.fd());
    return !identity && identity.error().os_errno == EMFILE ? 0 : 1;
  });
  const int status = child.wait();
  if (status == 77) GTEST_SKIP() << "needs seccomp filters";
  EXPECT_EQ(status, 0);
}

}  // namespace
}  // namespace agnocast
