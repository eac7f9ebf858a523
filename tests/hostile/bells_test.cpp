// SPDX-License-Identifier: Apache-2.0
//
// Goal: doorbells that are flooded, full, shut, closed, or belong to somebody who is stopped, neither
// stop a publisher that rings them nor a subscriber that is rung.
// Method: attackers of another user with the bells that the daemon gives them. That they get no
// eventfd is checked in hostile_memory, what one user can do with one in unit_doorbell.

#include <tests/hostile/hostile_node.hpp>

#include <fcntl.h>
#include <sys/socket.h>

#include <chrono>
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

TEST(HostileBells, AFloodOfRingsKeepsNobodyFromItsMessages) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage;
  Attacker attacker([&](Attack& attack) {
    HostileNode node(stage.socket_path());
    node.join(Kind::publisher, open_topic);
    const auto about = node.announced();
    ASSERT_EQ(about.fds.size(), 2u);
    const int bell = about.fds[1].get();
    // Datagrams of every length, with descriptors, and then its own sender shut for good.
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
      if (::sendmsg(bell, &message, MSG_DONTWAIT | MSG_NOSIGNAL) > 0) ++attack.word(0);
    }
    ::shutdown(bell, SHUT_RDWR);
    EXPECT_GT(attack.word(0).load(), 1000u);
  });
  ASSERT_TRUE(attacker.wait_until_ready());
  honest_goes_on_for_a_while(stage);
  attacker.end();
  stage.honest_goes_on();
}

// The attacker asks for a ring at each message, in ways that make it as dear as it can.
void asks_for_rings(Stage& stage, const std::function<void(HostileNode&)>& prepare,
                    bool stops_itself = false) {
  Attacker attacker([&](Attack& attack) {
    HostileNode node(stage.socket_path());
    const auto made =
        node.join(Kind::subscription, stream_topic, {1000, false, true, false, false});
    const auto publisher = node.announced().body;
    const auto line = node.line(made, publisher.index);
    line.cursor().store(publisher.first_sequence + 1);
    line.publisher_generation().store(publisher.generation);
    prepare(node);
    node.armed().store(1);
    attack.ready();
    if (stops_itself) ::raise(SIGSTOP);
    for (std::uint64_t armed = 3; attack.goes_on(); armed += 2) node.armed().store(armed);
  });
  ASSERT_TRUE(attacker.wait_until_ready());
  honest_goes_on_for_a_while(stage);
  attacker.kill();
  stage.honest_goes_on();
}

TEST(HostileBells, AQueueThatIsNeverReadFillsAndDelaysNobody) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage;
  asks_for_rings(stage, [](HostileNode&) {});
}

TEST(HostileBells, AReceiverThatIsShutOrSmallDelaysNobody) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage;
  asks_for_rings(stage, [](HostileNode& node) {
    const int size = 1;
    ASSERT_EQ(node.bells().size(), 2u);
    const int receiver = node.bells()[1].get();
    EXPECT_EQ(::setsockopt(receiver, SOL_SOCKET, SO_RCVBUF, &size, sizeof size), 0);
    EXPECT_EQ(::shutdown(receiver, SHUT_RDWR), 0);
  });
}

TEST(HostileBells, AStoppedSubscriberWithAFullBellDelaysNobody) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage;
  asks_for_rings(
      stage,
      [](HostileNode& node) {
        // What the attacker's own publisher gets to ring itself with: full to the brim.
        node.join(Kind::publisher, open_topic);
        node.word(offsetof(abi::ClientRegionHeader, executor)).store(1);
      },
      true);
}

TEST(HostileBells, AReceiverThatIsClosedDelaysNobody) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage;
  asks_for_rings(stage, [](HostileNode& node) {
    for (const UniqueFd& bell : node.bells()) ::close(::dup(bell.get()));
    const UniqueFd null(::open("/dev/null", O_RDWR | O_CLOEXEC));
    for (const UniqueFd& bell : node.bells()) EXPECT_GE(::dup2(null.get(), bell.get()), 0);
  });
}

}  // namespace
}  // namespace agnocast::test
