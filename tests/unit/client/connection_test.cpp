// SPDX-License-Identifier: Apache-2.0
//
// Goal: whoever waits for the daemon's answer gets one, whatever happens to the answer.
// Method: the connection of a client over a socket pair; this test answers as the daemon and is its
// control thread.

#include <client/connection.hpp>

#include <gtest/gtest.h>

#include <poll.h>

#include <new>
#include <thread>
#include <utility>

namespace agnocast {
namespace {

namespace wire = abi::wire;

TEST(Connection, AnAnswerThatMemoryIsMissingForFailsItsRequest) {
  auto ends = PacketSocket::pair();
  ASSERT_TRUE(ends);
  Connection connection(std::move(ends->first));
  PacketSocket daemon = std::move(ends->second);
  Result<void> result;
  std::thread asks([&] {
    result = connection.request(wire::Opcode::open_executor, wire::ExecutorRequest{},
                                [](Incoming&) -> Result<void> { throw std::bad_alloc(); });
  });
  pollfd readable{daemon.fd(), POLLIN, 0};
  ASSERT_EQ(::poll(&readable, 1, 10000), 1);
  Incoming packet;
  const Result<Packet> asked = daemon.receive(packet.bytes);
  ASSERT_TRUE(asked);
  ASSERT_EQ(asked->kind, Packet::Kind::data);
  const wire::Header answer{wire::Opcode::executor_opened, sizeof answer, packet.header().request};
  ASSERT_TRUE(daemon.send({reinterpret_cast<const std::byte*>(&answer), sizeof answer}));
  bool unasked = true;
  const Result<bool> alive = connection.receive(packet, unasked);
  asks.join();
  EXPECT_TRUE(alive && *alive);
  ASSERT_FALSE(result);
  EXPECT_EQ(result.error().code, Errc::os_failure);
  EXPECT_EQ(result.error().os_errno, ENOMEM);
}

}  // namespace
}  // namespace agnocast
