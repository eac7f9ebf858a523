// SPDX-License-Identifier: Apache-2.0
//
// Goal: a ring always wakes a sleeping thread, never blocks, and no process can silence the
// doorbell of another. Method: doorbells as the daemon makes them in a private directory, an epoll
// set as an receiver uses, and raw system calls for what a hostile holder would do.

#include <base/descriptors/doorbell.hpp>
#include <base/sockets/packet_socket.hpp>

#include "tests/support/machine/temporary_directory.hpp"
#include "tests/support/memory/descriptors.hpp"
#include "tests/support/processes/child.hpp"
#include "tests/support/wire/deaf_peer.hpp"

#include <gmock/gmock.h>

#include <fcntl.h>
#include <sched.h>
#include <sys/epoll.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cstring>
#include <limits>
#include <vector>

namespace agnocast {
namespace {

using Rung = Doorbell::Rung;
using testing::ElementsAre;
using testing::IsEmpty;
using testing::UnorderedElementsAre;

constexpr std::uint64_t eventfd_tag = 1;
constexpr std::uint64_t datagram_tag = 2;

struct Receiver {
  test::TemporaryDirectory directory;
  DoorbellReceiver doorbells;
  UniqueFd epoll{::epoll_create1(EPOLL_CLOEXEC)};

  Receiver() {
    doorbells = std::move(make_doorbell(directory.path(), "doorbell").value());
    EXPECT_TRUE(doorbells.add_to(epoll.get(), eventfd_tag, datagram_tag));
  }
  Doorbell same_user() const {
    return Doorbell(connect_doorbell(directory.path(), "doorbell").value(),
                    UniqueFd(::dup(doorbells.eventfd())));
  }
  Doorbell other_user() const {
    return Doorbell(connect_doorbell(directory.path(), "doorbell").value());
  }
  // Returns the tags that are ready now.
  std::vector<std::uint64_t> ready(int timeout_ms = 0) const {
    std::array<epoll_event, 4> events{};
    const int count = ::epoll_wait(epoll.get(), events.data(), int{events.size()}, timeout_ms);
    std::vector<std::uint64_t> tags;
    for (int i = 0; i < count; ++i) {
      const std::uint64_t tag = events[static_cast<std::size_t>(i)].data.u64;  // packed on x86-64
      tags.push_back(tag);
    }
    return tags;
  }
};

// Sends until the kernel says that the queue is full.
std::size_t fill_queue(const Doorbell& doorbell) {
  std::size_t count = 0;
  while (::send(doorbell.datagram_fd(), "x", 1, MSG_DONTWAIT | MSG_NOSIGNAL) == 1) ++count;
  EXPECT_EQ(errno, EAGAIN);
  return count;
}

void fill_eventfd(int fd) {
  const std::uint64_t most = std::numeric_limits<std::uint64_t>::max() - 1;
  ASSERT_EQ(::write(fd, &most, sizeof most), ssize_t{sizeof most});
}

TEST(Doorbell, SameUserWakesOncePerSleepWithoutAnyRead) {
  Receiver receiver;
  const Doorbell doorbell = receiver.same_user();
  EXPECT_THAT(receiver.ready(), IsEmpty());
  for (int sleep = 0; sleep < 1000; ++sleep) {
    ASSERT_EQ(doorbell.ring(), Rung::rung);
    ASSERT_THAT(receiver.ready(10'000), ElementsAre(eventfd_tag)) << sleep;
    ASSERT_THAT(receiver.ready(), IsEmpty()) << "woken twice by one ring, sleep " << sleep;
  }
}

TEST(Doorbell, ManyRingsBetweenTwoSleepsAreOneWakeUp) {
  Receiver receiver;
  const Doorbell doorbell = receiver.same_user();
  for (int i = 0; i < 100; ++i) ASSERT_EQ(doorbell.ring(), Rung::rung);
  EXPECT_THAT(receiver.ready(), ElementsAre(eventfd_tag));
  EXPECT_THAT(receiver.ready(), IsEmpty());
}

TEST(Doorbell, SameUserSendsNoDatagram) {
  Receiver receiver;
  EXPECT_EQ(receiver.same_user().ring(), Rung::rung);
  char byte = 0;
  EXPECT_EQ(::recv(receiver.doorbells.datagram_fd(), &byte, 1, MSG_DONTWAIT), -1);
  EXPECT_EQ(errno, EAGAIN);
}

TEST(Doorbell, RingsAThreadThatSleepsInAnotherProcess) {
  Receiver receiver;
  for (const bool same_user : {true, false}) {
    const Doorbell doorbell = same_user ? receiver.same_user() : receiver.other_user();
    test::Child child([&] { return doorbell.ring() == Rung::rung ? 0 : 1; });
    EXPECT_THAT(receiver.ready(10'000), ElementsAre(same_user ? eventfd_tag : datagram_tag));
    receiver.doorbells.drain();
    EXPECT_EQ(child.wait(), 0);
  }
}

TEST(Doorbell, OtherUserIsReadableUntilDrained) {
  Receiver receiver;
  const Doorbell doorbell = receiver.other_user();
  EXPECT_EQ(doorbell.ring(), Rung::rung);
  EXPECT_THAT(receiver.ready(), ElementsAre(datagram_tag));
  EXPECT_THAT(receiver.ready(), ElementsAre(datagram_tag));
  receiver.doorbells.drain();
  EXPECT_THAT(receiver.ready(), IsEmpty());
  receiver.doorbells.drain();
  EXPECT_EQ(doorbell.ring(), Rung::rung);
  EXPECT_THAT(receiver.ready(), ElementsAre(datagram_tag));
}

TEST(Doorbell, FullQueueOfDatagramsCountsAsRung) {
  Receiver receiver;
  const Doorbell doorbell = receiver.other_user();
  EXPECT_GT(fill_queue(doorbell), 0U);
  EXPECT_EQ(doorbell.ring(), Rung::rung);
  EXPECT_THAT(receiver.ready(), ElementsAre(datagram_tag));
  receiver.doorbells.drain();
  EXPECT_THAT(receiver.ready(), IsEmpty()) << "one drain empties a full queue";
}

// All holders share the open file description, and any of them may change its flags.
TEST(Doorbell, RingDoesNotBlockWhenAHolderClearedTheNonBlockingFlag) {
  Receiver receiver;
  const Doorbell doorbell = receiver.other_user();
  fill_queue(doorbell);
  ASSERT_EQ(::fcntl(doorbell.datagram_fd(), F_SETFL, 0), 0);
  ASSERT_EQ(::fcntl(receiver.doorbells.datagram_fd(), F_SETFL, 0), 0);
  test::Child child([&] {
    ::alarm(10);  // ends a child that blocks
    if (doorbell.ring() != Rung::rung) return 1;
    receiver.doorbells.drain();
    return receiver.ready().empty() ? 0 : 2;
  });
  EXPECT_EQ(child.wait(), 0);
}

// Distributions raise the length of the queue; a network namespace lets the test do so too.
TEST(Doorbell, OneDrainEmptiesALongQueue) {
  test::Child child([] {
    if (::unshare(::geteuid() == 0 ? CLONE_NEWNET : CLONE_NEWUSER | CLONE_NEWNET) != 0) return 77;
    const UniqueFd length(::open("/proc/sys/net/unix/max_dgram_qlen", O_WRONLY | O_CLOEXEC));
    if (!length || ::write(length.get(), "200", 3) != 3) return 77;
    Receiver receiver;
    const Doorbell doorbell = receiver.other_user();
    if (fill_queue(doorbell) < 100) return 1;
    receiver.doorbells.drain();
    return receiver.ready().empty() ? 0 : 2;
  });
  const int status = child.wait();
  if (status == 77) GTEST_SKIP() << "needs the right to change max_dgram_qlen";
  EXPECT_EQ(status, 0);
}

TEST(Doorbell, FilledEventfdIsBackedByADatagram) {
  Receiver receiver;
  const Doorbell doorbell = receiver.same_user();
  fill_eventfd(doorbell.eventfd());
  receiver.ready();  // the wake-up by the filling itself
  EXPECT_EQ(doorbell.ring(), Rung::rung);
  EXPECT_THAT(receiver.ready(), ElementsAre(datagram_tag));
}

TEST(Doorbell, WorksAfterItsNameIsGone) {
  Receiver receiver;
  const Doorbell doorbell = receiver.other_user();
  ASSERT_EQ(::unlink(receiver.directory.path("doorbell").c_str()), 0);
  EXPECT_EQ(doorbell.ring(), Rung::rung);
  EXPECT_THAT(receiver.ready(), ElementsAre(datagram_tag));
  const auto later = connect_doorbell(receiver.directory.path(), "doorbell");
  ASSERT_FALSE(later);
  EXPECT_EQ(later.error().code, Errc::endpoint_gone);
}

TEST(Doorbell, OneSenderCannotSilenceAnother) {
  Receiver receiver;
  const Doorbell hostile = receiver.other_user();
  const Doorbell honest = receiver.other_user();
  fill_queue(hostile);
  EXPECT_EQ(honest.ring(), Rung::rung) << "a flood only makes the socket readable";
  EXPECT_THAT(receiver.ready(), ElementsAre(datagram_tag));
  receiver.doorbells.drain();

  ASSERT_EQ(::shutdown(hostile.datagram_fd(), SHUT_RDWR), 0);
  EXPECT_EQ(hostile.ring(), Rung::gone);
  EXPECT_EQ(honest.ring(), Rung::rung);
  EXPECT_THAT(receiver.ready(), ElementsAre(datagram_tag));
}

TEST(Doorbell, RingingAClosedReceiverSaysGone) {
  Receiver receiver;
  const Doorbell doorbell = receiver.other_user();
  receiver.doorbells = DoorbellReceiver();
  EXPECT_EQ(doorbell.ring(), Rung::gone);
  EXPECT_EQ(doorbell.ring(), Rung::gone);
  EXPECT_EQ(Doorbell().ring(), Rung::gone);
}

TEST(Doorbell, DescriptorsSentThroughADoorbellDoNotLeak) {
  Receiver receiver;
  const Doorbell doorbell = receiver.other_user();
  const std::size_t before = test::open_descriptor_count();
  alignas(cmsghdr) char control[CMSG_SPACE(sizeof(int))]{};
  char byte = 0;
  iovec data{&byte, 1};
  msghdr message{};
  message.msg_iov = &data;
  message.msg_iovlen = 1;
  message.msg_control = control;
  message.msg_controllen = sizeof control;
  cmsghdr* part = CMSG_FIRSTHDR(&message);
  part->cmsg_level = SOL_SOCKET;
  part->cmsg_type = SCM_RIGHTS;
  part->cmsg_len = CMSG_LEN(sizeof(int));
  const int number = 0;
  std::memcpy(CMSG_DATA(part), &number, sizeof number);
  // Linux 6.16 refuses the descriptor for us; on older kernels drain() discards it.
  if (::sendmsg(doorbell.datagram_fd(), &message, MSG_DONTWAIT) < 0) {
    EXPECT_EQ(errno, EPERM);
  }
  receiver.doorbells.drain();
  EXPECT_THAT(receiver.ready(), IsEmpty());
  EXPECT_EQ(test::open_descriptor_count(), before);
}

TEST(Doorbell, DoorbellsAreCloseOnExecAndNonBlocking) {
  Receiver receiver;
  const Doorbell doorbell = receiver.other_user();
  for (const int fd :
       {receiver.doorbells.eventfd(), receiver.doorbells.datagram_fd(), doorbell.datagram_fd()}) {
    EXPECT_TRUE(test::is_close_on_exec(fd));
    EXPECT_TRUE(test::is_non_blocking(fd));
  }
}

TEST(Doorbell, SenderCanBeMadeFromOnlyTheReceiver) {
  Receiver receiver;
  const Doorbell doorbell(connect_doorbell(receiver.doorbells.datagram_fd()).value());
  EXPECT_EQ(doorbell.ring(), Rung::rung);
  EXPECT_THAT(receiver.ready(), ElementsAre(datagram_tag));
}

TEST(Doorbell, LeftoverOfAPreviousIncarnationIsReplaced) {
  Receiver receiver;
  const Doorbell old_doorbell = receiver.other_user();
  const auto replacement = make_doorbell(receiver.directory.path(), "doorbell");
  ASSERT_TRUE(replacement);
  const Doorbell new_doorbell = receiver.other_user();
  EXPECT_EQ(new_doorbell.ring(), Rung::rung);
  EXPECT_THAT(receiver.ready(), IsEmpty()) << "the new doorbell does not ring the old receiver";
  EXPECT_EQ(old_doorbell.ring(), Rung::rung);
  EXPECT_THAT(receiver.ready(), ElementsAre(datagram_tag));
}

TEST(Doorbell, OtherUsersCannotConnectThroughThePrivateDirectory) {
  if (::geteuid() != 0) GTEST_SKIP() << "needs root to become another user";
  Receiver receiver;
  test::Child child([&] {
    if (::setuid(65534) != 0) return 1;
    const auto doorbell = connect_doorbell(receiver.directory.path(), "doorbell");
    return !doorbell && doorbell.error().os_errno == EACCES ? 0 : 2;
  });
  EXPECT_EQ(child.wait(), 0);
}

TEST(Doorbell, DirectoryThatOthersMayEnterIsRefused) {
  test::TemporaryDirectory directory;
  ASSERT_EQ(::chmod(directory.path().c_str(), 0710), 0);
  const auto doorbells = make_doorbell(directory.path(), "doorbell");
  ASSERT_FALSE(doorbells);
  EXPECT_EQ(doorbells.error().code, Errc::permission_denied);
}

TEST(Doorbell, BadNamesAreRefused) {
  test::TemporaryDirectory directory;
  for (const std::string& name : {std::string(), std::string("a/b"), std::string(100, 'x')}) {
    const auto doorbells = make_doorbell(directory.path(), name);
    ASSERT_FALSE(doorbells);
    EXPECT_EQ(doorbells.error().code, Errc::invalid_argument);
  }
}

// As on a kernel before 6.16: a peer sends a socket whose close() blocks. The sender then exits,
// so the doorbell holds the last reference, and a blocking close() would not return.
void send_lingering_socket(const Receiver& receiver, const test::DeafPeer& peer) {
  const UniqueFd sender = connect_doorbell(receiver.directory.path(), "doorbell").value();
  test::Child child([&] {
    const int socket = peer.lingering_socket(1'000'000).release();
    iovec data{const_cast<char*>("x"), 1};
    alignas(cmsghdr) std::array<char, CMSG_SPACE(sizeof socket)> control{};
    msghdr message{};
    message.msg_iov = &data;
    message.msg_iovlen = 1;
    message.msg_control = control.data();
    message.msg_controllen = control.size();
    cmsghdr* const part = CMSG_FIRSTHDR(&message);
    part->cmsg_level = SOL_SOCKET;
    part->cmsg_type = SCM_RIGHTS;
    part->cmsg_len = CMSG_LEN(sizeof socket);
    std::memcpy(CMSG_DATA(part), &socket, sizeof socket);
    return ::sendmsg(sender.get(), &message, MSG_DONTWAIT) == 1 ? 0 : 1;
  });
  EXPECT_EQ(child.wait(), 0);
}

TEST(Doorbell, DrainDoesNotWaitForTheCloseOfSentDescriptors) {
  const test::DeafPeer peer;
  Receiver receiver;
  accept_descriptors(receiver.doorbells.datagram_fd());
  const std::size_t before = test::open_descriptor_count();
  for (int round = 0; round < 3; ++round) {
    send_lingering_socket(receiver, peer);
    receiver.other_user().ring();
    EXPECT_THAT(receiver.ready(), ElementsAre(datagram_tag));
    EXPECT_TRUE(receiver.doorbells.drain());
    EXPECT_THAT(receiver.ready(), IsEmpty());
  }
  EXPECT_EQ(test::open_descriptor_count(), before)
      << "none of the sent descriptors was installed here";
  EXPECT_EQ(receiver.other_user().ring(), Rung::rung);
  EXPECT_THAT(receiver.ready(), ElementsAre(datagram_tag)) << "the doorbell still works";
  send_lingering_socket(receiver, peer);
  receiver.doorbells = DoorbellReceiver();  // while it still contains a datagram
}

}  // namespace
}  // namespace agnocast
