// SPDX-License-Identifier: Apache-2.0
//
// Goal: packets and descriptors arrive whole or the loss is reported, and no descriptor leaks.
// Method: both ends in this process; where PacketSocket would refuse to send, the test uses raw
// sendmsg. Counting /proc/self/fd finds leaks.

#include <base/sockets/packet_socket.hpp>
#include <base/sockets/unix_address.hpp>

#include "tests/support/machine/temporary_directory.hpp"
#include "tests/support/memory/descriptors.hpp"
#include "tests/support/processes/child.hpp"
#include "tests/support/wire/listen_at.hpp"

#include <gmock/gmock.h>

#include <signal.h>
#include <sys/mman.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/time.h>

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <cstring>
#include <new>
#include <string>
#include <string_view>
#include <vector>

namespace agnocast {
namespace {

using test::is_close_on_exec;
using test::is_non_blocking;
using test::is_same_file;
using test::open_descriptor_count;

std::span<const std::byte> bytes_of(std::string_view text) {
  return std::as_bytes(std::span(text.data(), text.size()));
}

struct Pair {
  PacketSocket left;
  PacketSocket right;
  std::array<std::byte, 64> buffer{};

  Pair() {
    auto ends = PacketSocket::pair();
    left = std::move(ends->first);
    right = std::move(ends->second);
  }
  Packet receive(Wait wait = Wait::no) { return right.receive(buffer, wait).value(); }
  std::string text(const Packet& packet) const {
    return {reinterpret_cast<const char*>(buffer.data()), packet.bytes};
  }
};

UniqueFd some_file() { return UniqueFd(::memfd_create("test", MFD_CLOEXEC)); }

// Sends what PacketSocket::send refuses.
ssize_t send_raw(int socket, std::string_view text, const std::vector<int>& fds) {
  std::vector<char> control(CMSG_SPACE(fds.size() * sizeof(int)));
  iovec data{const_cast<char*>(text.data()), text.size()};
  msghdr message{};
  message.msg_iov = &data;
  message.msg_iovlen = 1;
  message.msg_control = control.data();
  message.msg_controllen = control.size();
  cmsghdr* part = CMSG_FIRSTHDR(&message);
  part->cmsg_level = SOL_SOCKET;
  part->cmsg_type = SCM_RIGHTS;
  part->cmsg_len = CMSG_LEN(fds.size() * sizeof(int));
  std::memcpy(CMSG_DATA(part), fds.data(), fds.size() * sizeof(int));
  return ::sendmsg(socket, &message, MSG_NOSIGNAL);
}

TEST(PacketSocket, DescriptorsArriveInOrderOwnedAndCloseOnExec) {
  Pair pair;
  std::vector<UniqueFd> files;
  std::vector<int> numbers;
  for (std::uint32_t i = 0; i < abi::wire::descriptor_count_max; ++i) {
    files.push_back(some_file());
    numbers.push_back(files.back().get());
  }
  const std::size_t before = open_descriptor_count();
  ASSERT_EQ(pair.left.send(bytes_of("hello"), numbers).value(), Sent::sent);
  {
    Packet packet = pair.receive();
    EXPECT_EQ(packet.kind, Packet::Kind::data);
    EXPECT_FALSE(packet.truncated);
    EXPECT_FALSE(packet.descriptors_lost);
    EXPECT_EQ(pair.text(packet), "hello");
    EXPECT_FALSE(packet.credentials);
    ASSERT_EQ(packet.fds().size(), files.size());
    for (std::size_t i = 0; i < files.size(); ++i) {
      EXPECT_TRUE(is_same_file(packet.fds()[i].get(), files[i].get())) << i;
      EXPECT_TRUE(is_close_on_exec(packet.fds()[i].get())) << i;
    }
    EXPECT_EQ(open_descriptor_count(), before + files.size());
  }
  EXPECT_EQ(open_descriptor_count(), before);
}

TEST(PacketSocket, PacketsKeepTheirBordersAndTheirOrder) {
  Pair pair;
  ASSERT_EQ(pair.left.send(bytes_of("one")).value(), Sent::sent);
  ASSERT_EQ(pair.left.send(bytes_of("two")).value(), Sent::sent);
  EXPECT_EQ(pair.text(pair.receive()), "one");
  EXPECT_EQ(pair.text(pair.receive()), "two");
  EXPECT_EQ(pair.receive().kind, Packet::Kind::nothing);
}

TEST(PacketSocket, PacketLongerThanTheBufferIsReportedAndItsDescriptorsAreOwned) {
  Pair pair;
  const UniqueFd file = some_file();
  const int number = file.get();
  const std::size_t before = open_descriptor_count();
  const std::string text(pair.buffer.size() + 1, 'x');
  ASSERT_EQ(pair.left.send(bytes_of(text), {&number, 1}).value(), Sent::sent);
  {
    const Packet packet = pair.receive();
    EXPECT_EQ(packet.kind, Packet::Kind::data);
    EXPECT_TRUE(packet.truncated);
    EXPECT_EQ(packet.bytes, pair.buffer.size());
    EXPECT_EQ(packet.descriptor_count, 1U);
  }
  EXPECT_EQ(open_descriptor_count(), before);
}

TEST(PacketSocket, PacketThatFillsTheBufferIsNotTruncated) {
  Pair pair;
  const std::string text(pair.buffer.size(), 'x');
  ASSERT_EQ(pair.left.send(bytes_of(text)).value(), Sent::sent);
  const Packet packet = pair.receive();
  EXPECT_FALSE(packet.truncated);
  EXPECT_EQ(pair.text(packet), text);
}

// From one too many (it fits into padding of the control buffer) to what the kernel cuts off.
TEST(PacketSocket, TooManyDescriptorsAreReportedAndNoneLeaks) {
  Pair pair;
  const UniqueFd file = some_file();
  const std::size_t before = open_descriptor_count();
  for (std::size_t count = abi::wire::descriptor_count_max + 1; count <= 253; ++count) {
    ASSERT_EQ(send_raw(pair.left.fd(), "x", std::vector<int>(count, file.get())), 1) << count;
    {
      const Packet packet = pair.receive();
      EXPECT_EQ(packet.kind, Packet::Kind::data);
      EXPECT_TRUE(packet.descriptors_lost) << count;
      EXPECT_EQ(packet.descriptor_count, abi::wire::descriptor_count_max) << count;
    }
    ASSERT_EQ(open_descriptor_count(), before) << count;
  }
}

TEST(PacketSocket, DescriptorsThatThisProcessMayNotOpenAreReported) {
  test::Child child([] {
    Pair pair;
    const UniqueFd file = some_file();
    const std::vector<int> numbers(4, file.get());
    if (pair.left.send(bytes_of("x"), numbers).value() != Sent::sent) return 1;
    const auto limit = static_cast<rlim_t>(file.get()) + 3;  // room for two
    const rlimit limits{limit, limit};
    if (::setrlimit(RLIMIT_NOFILE, &limits) != 0) return 2;
    const Packet packet = pair.receive();
    if (!packet.descriptors_lost) return 3;
    if (packet.descriptor_count != 2) return 4;
    const Failure why = failure_of_descriptors("a packet");
    if (why.code != Errc::os_failure || why.os_errno != EMFILE) return 6;
    return pair.text(packet) == "x" ? 0 : 5;
  });
  EXPECT_EQ(child.wait(), 0);
}

TEST(PacketSocket, LostDescriptorsCountAsWithheldWhereThereIsRoomForThem) {
  const std::size_t before = open_descriptor_count();
  EXPECT_EQ(failure_of_descriptors("a packet").code, Errc::descriptors_withheld);
  EXPECT_EQ(open_descriptor_count(), before);
}

TEST(PacketSocket, EmptyPacketEndsTheConnectionAndItsDescriptorsAreClosed) {
  Pair pair;
  const UniqueFd file = some_file();
  const std::size_t before = open_descriptor_count();
  ASSERT_EQ(send_raw(pair.left.fd(), "", {file.get()}), 0);
  EXPECT_EQ(pair.receive().kind, Packet::Kind::end);
  EXPECT_EQ(open_descriptor_count(), before);
}

TEST(PacketSocket, RefusesToSendNothingOrTooManyDescriptors) {
  Pair pair;
  EXPECT_EQ(pair.left.send({}).error().code, Errc::invalid_argument);
  const std::vector<int> numbers(abi::wire::descriptor_count_max + 1, pair.left.fd());
  EXPECT_EQ(pair.left.send(bytes_of("x"), numbers).error().code, Errc::invalid_argument);
  EXPECT_EQ(pair.receive().kind, Packet::Kind::nothing);
}

TEST(PacketSocket, SendingABadDescriptorIsAFaultWithItsErrno) {
  Pair pair;
  const int number = 999999;
  const auto sent = pair.left.send(bytes_of("x"), {&number, 1});
  ASSERT_FALSE(sent);
  EXPECT_EQ(sent.error().code, Errc::os_failure);
  EXPECT_EQ(sent.error().os_errno, EBADF);
}

TEST(PacketSocket, FullQueueAnswersWouldBlockAndOpensAgainAfterReading) {
  Pair pair;
  const std::string text(pair.buffer.size(), 'x');
  std::size_t sent_count = 0;
  while (pair.left.send(bytes_of(text)).value() == Sent::sent) {
    ASSERT_LT(++sent_count, 1'000'000U);
  }
  EXPECT_EQ(pair.left.send(bytes_of(text)).value(), Sent::would_block);
  for (std::size_t i = 0; i < sent_count; ++i) EXPECT_EQ(pair.receive().bytes, text.size());
  EXPECT_EQ(pair.receive().kind, Packet::Kind::nothing) << "a refused packet was sent anyway";
  EXPECT_EQ(pair.left.send(bytes_of(text)).value(), Sent::sent);
}

TEST(PacketSocket, ClosedPeerIsAnOutcomeAndNoSignal) {
  Pair pair;
  pair.right.close();
  EXPECT_EQ(pair.left.send(bytes_of("x")).value(), Sent::peer_gone);
  EXPECT_EQ(pair.left.receive(pair.buffer).value().kind, Packet::Kind::end);
}

TEST(PacketSocket, PacketsSentBeforeTheEndAreStillReceived) {
  Pair pair;
  ASSERT_EQ(pair.left.send(bytes_of("last words")).value(), Sent::sent);
  pair.left.close();
  EXPECT_EQ(pair.text(pair.receive()), "last words");
  EXPECT_EQ(pair.receive().kind, Packet::Kind::end);
  EXPECT_EQ(pair.receive().kind, Packet::Kind::end);
}

// The kernel puts ECONNRESET in front of the queue when the peer left packets unread.
TEST(PacketSocket, PacketsSentBeforeAResetAreStillReceived) {
  Pair pair;
  ASSERT_EQ(pair.right.send(bytes_of("never read")).value(), Sent::sent);
  ASSERT_EQ(pair.left.send(bytes_of("first")).value(), Sent::sent);
  ASSERT_EQ(pair.left.send(bytes_of("second")).value(), Sent::sent);
  pair.left.close();
  EXPECT_EQ(pair.text(pair.receive()), "first");
  EXPECT_EQ(pair.text(pair.receive()), "second");
  EXPECT_EQ(pair.receive().kind, Packet::Kind::end);
}

// In memory shared with the child.
std::atomic<int>& signal_count =
    *new (::mmap(nullptr, sizeof(std::atomic<int>), PROT_READ | PROT_WRITE,
                 MAP_SHARED | MAP_ANONYMOUS, -1, 0)) std::atomic<int>(0);

TEST(PacketSocket, SignalsDoNotEndAWait) {
  Pair pair;
  struct sigaction action {};
  action.sa_handler = [](int) { ++signal_count; };  // without SA_RESTART
  struct sigaction old {};
  ASSERT_EQ(::sigaction(SIGALRM, &action, &old), 0);
  signal_count = 0;
  test::Child child([&] {
    for (int round = 0; round < 10'000 && signal_count < 5; ++round) ::usleep(1'000);
    return pair.left.send(bytes_of("at last")).value() == Sent::sent ? 0 : 1;
  });
  const itimerval often{{0, 2'000}, {0, 2'000}};
  const itimerval never{};
  ::setitimer(ITIMER_REAL, &often, nullptr);
  const Packet packet = pair.receive(Wait::yes);
  ::setitimer(ITIMER_REAL, &never, nullptr);
  ::sigaction(SIGALRM, &old, nullptr);
  EXPECT_EQ(pair.text(packet), "at last");
  EXPECT_GT(signal_count, 0);
  EXPECT_EQ(child.wait(), 0);
}

TEST(PacketSocket, CredentialsComeOnlyOnRequest) {
  Pair pair;
  ASSERT_TRUE(pair.right.want_credentials(true));
  ASSERT_EQ(pair.left.send(bytes_of("x")).value(), Sent::sent);
  const Packet packet = pair.receive();
  ASSERT_TRUE(packet.credentials);
  EXPECT_EQ(packet.credentials->pid, ::getpid());
  EXPECT_EQ(packet.credentials->uid, ::getuid());

  ASSERT_TRUE(pair.right.want_credentials(false));
  ASSERT_EQ(pair.left.send(bytes_of("x")).value(), Sent::sent);
  EXPECT_FALSE(pair.receive().credentials);
}

TEST(PacketSocket, CredentialsAndAllDescriptorsFitTogether) {
  Pair pair;
  ASSERT_TRUE(pair.right.want_credentials(true));
  const std::vector<int> numbers(abi::wire::descriptor_count_max, pair.left.fd());
  ASSERT_EQ(pair.left.send(bytes_of("x"), numbers).value(), Sent::sent);
  const Packet packet = pair.receive();
  EXPECT_TRUE(packet.credentials);
  EXPECT_FALSE(packet.descriptors_lost);
  EXPECT_EQ(packet.descriptor_count, numbers.size());
}

TEST(PacketSocket, RefusedDescriptorsStayWithTheSender) {
  Pair pair;
  const std::size_t before = open_descriptor_count();
  constexpr int so_passrights = 83;
  int value = 0;
  socklen_t bytes = sizeof value;
  if (::getsockopt(pair.right.fd(), SOL_SOCKET, so_passrights, &value, &bytes) != 0)
    GTEST_SKIP() << "SO_PASSRIGHTS needs Linux 6.16";
  ASSERT_TRUE(refuse_descriptors(pair.right.fd()));
  const int number = pair.left.fd();
  const auto sent = pair.left.send(bytes_of("x"), {&number, 1});
  ASSERT_FALSE(sent);
  EXPECT_EQ(sent.error().os_errno, EPERM);
  EXPECT_EQ(pair.left.send(bytes_of("x")).value(), Sent::sent);
  EXPECT_EQ(pair.receive().bytes, 1U);
  EXPECT_EQ(open_descriptor_count(), before);
}

TEST(PacketListener, AcceptsNonBlockingConnectionsThatAreCloseOnExec) {
  test::TemporaryDirectory directory;
  const auto listener = test::listen_at(directory.path("socket"));
  ASSERT_TRUE(listener);
  EXPECT_FALSE(listener->accept().value()) << "no client has connected";
  const auto client = PacketSocket::connect(directory.path("socket"));
  ASSERT_TRUE(client);
  const auto session = listener->accept();
  ASSERT_TRUE(session);
  ASSERT_TRUE(*session);
  for (const int fd : {listener->fd(), client->fd(), (*session)->fd()})
    EXPECT_TRUE(is_close_on_exec(fd));
  EXPECT_TRUE(is_non_blocking(listener->fd()));
  EXPECT_TRUE(is_non_blocking((*session)->fd()));

  ASSERT_EQ(client->send(bytes_of("hello")).value(), Sent::sent);
  std::array<std::byte, 16> buffer;
  EXPECT_EQ((*session)->receive(buffer).value().bytes, 5U);
}

TEST(PacketListener, NobodyIsRefusedOrAcceptedBeforeItListens) {
  test::TemporaryDirectory directory;
  ASSERT_EQ(::chmod(directory.path("").c_str(), 0755), 0);
  const std::string path = directory.path("socket");
  // The answer to another user, where this test can become one.
  const auto answer_to_other = [&] {
    test::Child other([&] {
      if (::geteuid() == 0 && ::setuid(65534) != 0) return 99;
      const auto connected = PacketSocket::connect(path, std::chrono::milliseconds(0));
      return connected ? 0 : static_cast<int>(connected.error().code);
    });
    return static_cast<Errc>(other.wait());
  };
  const mode_t mask = ::umask(077);
  const auto listener = PacketListener::bind(path);
  EXPECT_EQ(::umask(mask), 077u) << "the umask is unchanged";
  ASSERT_TRUE(listener);
  EXPECT_EQ(answer_to_other(), Errc::daemon_not_running);
  ASSERT_EQ(::chmod(path.c_str(), 0600), 0);
  ASSERT_TRUE(listener->listen());
  EXPECT_TRUE(PacketSocket::connect(path));
  EXPECT_EQ(answer_to_other(), ::geteuid() == 0 ? Errc::permission_denied : Errc::ok);
}

TEST(PacketListener, SecondListenerIsRefusedAsAlreadyRunning) {
  test::TemporaryDirectory directory;
  const auto first = test::listen_at(directory.path("socket"));
  ASSERT_TRUE(first);
  const auto second = test::listen_at(directory.path("socket"));
  ASSERT_FALSE(second);
  EXPECT_EQ(second.error().code, Errc::already_running);
}

TEST(PacketListener, CredentialsComeFromTheFirstPacketOn) {
  test::TemporaryDirectory directory;
  const auto listener = test::listen_at(directory.path("socket"));
  ASSERT_TRUE(listener->want_credentials(true));
  const auto client = PacketSocket::connect(directory.path("socket"));
  const auto session = listener->accept();
  ASSERT_TRUE(client && session && *session);
  ASSERT_EQ(client->send(bytes_of("x")).value(), Sent::sent);
  std::array<std::byte, 16> buffer;
  const Packet packet = (*session)->receive(buffer).value();
  ASSERT_TRUE(packet.credentials);
  EXPECT_EQ(packet.credentials->pid, ::getpid());
}

TEST(PacketSocket, ConnectSaysWhyItFailed) {
  test::TemporaryDirectory directory;
  auto refused = PacketSocket::connect(directory.path("nobody"));
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, Errc::daemon_not_running);
  EXPECT_EQ(refused.error().os_errno, ENOENT);

  { ASSERT_TRUE(test::listen_at(directory.path("stale"))); }
  refused = PacketSocket::connect(directory.path("stale"));
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, Errc::daemon_not_running);
  EXPECT_EQ(refused.error().os_errno, ECONNREFUSED);

  for (const std::string& path :
       {std::string(), std::string(108, 'x'), std::string("/tmp/\0x", 7)}) {
    refused = PacketSocket::connect(path);
    ASSERT_FALSE(refused);
    EXPECT_EQ(refused.error().code, Errc::invalid_argument);
  }
}

TEST(PacketSocket, ConnectDoesNotWaitForeverForAServerThatDoesNotAccept) {
  test::TemporaryDirectory directory;
  const std::string path = directory.path("busy");
  const UniqueFd listener(::socket(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0));
  ASSERT_EQ(::bind(listener.get(), unix_address(path)->get(), UnixAddress::size()), 0);
  ASSERT_EQ(::listen(listener.get(), 0), 0);
  std::vector<PacketSocket> waiting;
  for (int i = 0; i < 16; ++i) {
    auto connected = PacketSocket::connect(path, std::chrono::milliseconds(20));
    if (connected) {
      waiting.push_back(std::move(*connected));
      continue;
    }
    EXPECT_EQ(connected.error().code, Errc::daemon_not_running);
    EXPECT_EQ(connected.error().os_errno, ETIMEDOUT);
    break;
  }
  ASSERT_FALSE(waiting.empty());
  EXPECT_LT(waiting.size(), 16u) << "the listener's queue must become full";
  timeval limit{1, 1};
  socklen_t size = sizeof limit;
  ASSERT_EQ(::getsockopt(waiting[0].fd(), SOL_SOCKET, SO_SNDTIMEO, &limit, &size), 0);
  EXPECT_EQ(limit.tv_sec + limit.tv_usec, 0)
      << "connect() must not leave its time limit on the socket";
}

TEST(PacketSocket, ConnectWithoutPermissionSaysSo) {
  if (::geteuid() != 0) GTEST_SKIP() << "needs root to become another user";
  test::TemporaryDirectory directory;
  ASSERT_EQ(::chmod(directory.path().c_str(), 0711), 0);
  const auto listener = test::listen_at(directory.path("socket"));
  ASSERT_TRUE(listener);
  ASSERT_EQ(::chmod(directory.path("socket").c_str(), 0600), 0);
  test::Child child([&] {
    if (::setuid(65534) != 0) return 1;
    const auto client = PacketSocket::connect(directory.path("socket"));
    return !client && client.error().code == Errc::permission_denied ? 0 : 2;
  });
  EXPECT_EQ(child.wait(), 0);
}

}  // namespace
}  // namespace agnocast
