// SPDX-License-Identifier: Apache-2.0
//
// Goal: doorbells that are flooded, full, shut, closed, or belong to a stopped process neither
// stop the publisher that rings them nor the subscriber that is rung.
// Method: attackers of another user with the doorbells that the daemon gives them. hostile_memory
// checks that they get no eventfd; unit_doorbell checks what a process of the same user can do
// with one.

#include <tests/hostile/hostile_node.hpp>

#include <fcntl.h>
#include <poll.h>
#include <sys/socket.h>

#include <cerrno>
#include <chrono>
#include <functional>
#include <memory>
#include <thread>

namespace agnocast::test {
namespace {

using wire::Kind;
using wire::Opcode;

void honest_goes_on_for_a_while(Stage& stage) {
  const auto end = std::chrono::steady_clock::now() + attack_time();
  do {
    stage.honest_goes_on();
    stage.honest_is_served();
  } while (std::chrono::steady_clock::now() < end && !testing::Test::HasFailure());
}

TEST(HostileDoorbells, AFloodOfRingsCostsNoSubscriberAMessage) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage;
  Attacker attacker([&](Attack& attack) {
    HostileNode node(stage.socket_path());
    node.join(Kind::publisher, open_topic);
    const auto about = node.announced();
    ASSERT_EQ(about.fds.size(), 2u);
    const int doorbell = about.fds[1].get();
    // Sends datagrams of every length, with descriptors, and finally shuts down its own sender.
    std::vector<char> bytes(16384, 'x');
    const UniqueFd null(::open("/dev/null", O_RDONLY | O_CLOEXEC));
    attack.ready();
    for (std::uint64_t i = 0; attack.goes_on(); ++i) {
      iovec vector{bytes.data(), i % 7 == 0 ? bytes.size() : 1 + i % 64};
      alignas(cmsghdr) char control[CMSG_SPACE(sizeof(int))] = {};
      msghdr message{};
      message.msg_iov = &vector;
      message.msg_iovlen = 1;
      if (i % 5 == 0) {
        message.msg_control = control;
        message.msg_controllen = sizeof control;
        cmsghdr* const header = CMSG_FIRSTHDR(&message);
        header->cmsg_level = SOL_SOCKET;
        header->cmsg_type = SCM_RIGHTS;
        header->cmsg_len = CMSG_LEN(sizeof(int));
        const int fd = null.get();
        std::memcpy(CMSG_DATA(header), &fd, sizeof fd);
      }
      if (::sendmsg(doorbell, &message, MSG_DONTWAIT | MSG_NOSIGNAL) > 0) ++attack.word(0);
    }
    ::shutdown(doorbell, SHUT_RDWR);
    EXPECT_GT(attack.word(0).load(), 1000u);
  });
  ASSERT_TRUE(attacker.wait_until_ready());
  honest_goes_on_for_a_while(stage);
  attacker.end();
  stage.honest_goes_on();
}

constexpr const char* own_topic = "/doorbells_of_attackers";

/// A process of the attacker's user that may ring the attacker, with a sender of its own as every
/// publisher has one.
class Ringer {
 public:
  explicit Ringer(const std::string& path) : node_(path) {
    node_.join(Kind::publisher, own_topic);
    auto about = node_.announced();
    EXPECT_EQ(about.body.kind, Kind::subscription);
    if (about.fds.size() == 3) doorbell_ = std::move(about.fds[2]);
    EXPECT_TRUE(doorbell_) << "region, eventfd and datagram socket, since the user is the same";
  }
  /// Returns 0 or errno.
  int ring() const {
    return ::send(doorbell_.get(), "", 1, MSG_DONTWAIT | MSG_NOSIGNAL) == 1 ? 0 : errno;
  }
  /// Returns whether a ring would find a free place, without ringing.
  bool finds_place() const {
    pollfd doorbell{doorbell_.get(), POLLOUT, 0};
    return ::poll(&doorbell, 1, 0) == 1;
  }

 private:
  HostileNode node_;
  UniqueFd doorbell_;
};

// The kernel limits each sender, below 512 datagrams. So several senders fill the queue; it is
// full when a sender that has never rung is turned away.
void fill_doorbell(const std::string& path) {
  for (int senders = 0; senders < 20; ++senders) {
    const Ringer ringer(path);
    int error = ringer.ring();
    if (error == EAGAIN) return;
    while (error == 0) error = ringer.ring();
    EXPECT_EQ(error, EAGAIN);
  }
  ADD_FAILURE() << "the doorbell never became full";
}

// The attacker asks for a ring at each message, in the most expensive way. The attacker calls
// `last` while it asks; the attack is under way when `last` returns true.
void asks_for_rings(Stage& stage, const std::function<void(HostileNode&)>& prepare,
                    const std::function<bool(HostileNode&)>& last = {}, bool stops_itself = false) {
  Attacker attacker([&](Attack& attack) {
    HostileNode node(stage.socket_path());
    const auto made =
        node.join(Kind::subscription, stream_topic, {1000, false, true, false, false});
    const auto publisher = node.announced().body;
    const auto line = node.line(made, publisher.index);
    line.cursor().store(publisher.first_sequence + 1);
    line.publisher_generation().store(publisher.generation);
    node.join(Kind::subscription, own_topic);
    prepare(node);
    std::uint64_t armed = 1;
    node.armed().store(armed);
    const auto end = std::chrono::steady_clock::now() + std::chrono::seconds(60);
    for (; last && !last(node); node.armed().store(armed += 2)) {
      ASSERT_LT(std::chrono::steady_clock::now(), end) << "the publisher did not ring";
    }
    if (testing::Test::HasFailure()) return;
    attack.ready();
    if (stops_itself) ::raise(SIGSTOP);
    while (attack.goes_on()) node.armed().store(armed += 2);
  });
  ASSERT_TRUE(attacker.wait_until_ready());
  honest_goes_on_for_a_while(stage);
  attacker.kill();
  stage.honest_goes_on();
}

TEST(HostileDoorbells, AQueueThatIsNeverReadFillsAndDelaysNobody) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage;
  // The honest publisher has to take all the places that are left, and continues to ring.
  constexpr int places = 8;  // net.unix.max_dgram_qlen is 10 where nobody has raised it
  std::unique_ptr<Ringer> witness;
  asks_for_rings(
      stage,
      [&](HostileNode& node) {
        fill_doorbell(stage.socket_path());
        witness = std::make_unique<Ringer>(stage.socket_path());
        EXPECT_FALSE(witness->finds_place());
        char byte = 0;
        for (int i = 0; i < places; ++i)
          EXPECT_GE(::recv(node.doorbells()[1].get(), &byte, 1, MSG_DONTWAIT), 0);
        EXPECT_TRUE(witness->finds_place());
      },
      [&](HostileNode&) {
        if (witness->finds_place()) return false;
        EXPECT_EQ(witness->ring(), EAGAIN);
        return true;
      });
}

TEST(HostileDoorbells, AReceiverThatIsShutOrSmallDelaysNobody) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage;
  asks_for_rings(stage, [](HostileNode& node) {
    const int size = 1;
    ASSERT_EQ(node.doorbells().size(), 2u);
    const int receiver = node.doorbells()[1].get();
    EXPECT_EQ(::setsockopt(receiver, SOL_SOCKET, SO_RCVBUF, &size, sizeof size), 0);
    EXPECT_EQ(::shutdown(receiver, SHUT_RDWR), 0);
  });
}

TEST(HostileDoorbells, AStoppedSubscriberWithAFullDoorbellDelaysNobody) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage;
  asks_for_rings(
      stage, [&](HostileNode&) { fill_doorbell(stage.socket_path()); }, {}, true);
}

TEST(HostileDoorbells, AReceiverThatIsClosedDelaysNobody) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage;
  asks_for_rings(stage, [](HostileNode& node) {
    for (const UniqueFd& doorbell : node.doorbells()) ::close(::dup(doorbell.get()));
    const UniqueFd null(::open("/dev/null", O_RDWR | O_CLOEXEC));
    for (const UniqueFd& doorbell : node.doorbells())
      EXPECT_GE(::dup2(null.get(), doorbell.get()), 0);
  });
}

}  // namespace
}  // namespace agnocast::test
