// SPDX-License-Identifier: Apache-2.0
//
// Goal: every request to the daemon ends with an answer or an error, whatever happens to the
// answer and the connection. Method: a client's connection over socket pairs; this test plays the
// daemon and the client's control thread.

#include <client/connection/connection.hpp>
#include <client/connection/reconnection.hpp>
#include <client/endpoint/departure.hpp>

#include <gtest/gtest.h>

#include <poll.h>

#include <new>
#include <optional>
#include <thread>
#include <utility>

namespace agnocast {
namespace {

namespace wire = abi::wire;
using std::chrono::milliseconds;

/// The daemon's end, and the control thread.
class Daemon {
 public:
  explicit Daemon(Connection& connection) : connection_(connection) {}
  void connect() {
    auto ends = PacketSocket::pair();
    ASSERT_TRUE(ends);
    connection_.begin(std::move(ends->first));
    socket_ = std::move(ends->second);
    connection_.open();
  }
  void disconnect() {
    connection_.end();
    socket_.close();
  }
  std::optional<wire::Header> hear(int patience_ms = 10000) {
    pollfd readable{socket_.fd(), POLLIN, 0};
    if (::poll(&readable, 1, patience_ms) != 1) return std::nullopt;
    Incoming packet;
    const Result<Packet> asked = socket_.receive(packet.bytes);
    if (!asked || asked->kind != Packet::Kind::data) return std::nullopt;
    return packet.header();
  }
  void answer(std::uint64_t id, wire::Opcode opcode = wire::Opcode::done) {
    const wire::Done body{{opcode, sizeof body, id}};
    ASSERT_TRUE(socket_.send(std::as_bytes(std::span(&body, 1))));
    Incoming packet;
    bool unasked = true;
    const Result<bool> alive = connection_.receive(packet, unasked);
    EXPECT_TRUE(alive && *alive);
  }

 private:
  Connection& connection_;
  PacketSocket socket_;
};

void nobody() noexcept {}
Result<void> accept_all(Incoming&) { return {}; }

/// A request in its own thread.
struct Asker {
  Asker(Connection& connection, wire::Opcode opcode, Connection::OnAnswer on_answer = accept_all,
        Connection::OnAnswer on_late = nullptr)
      : thread([this, &connection, opcode, on_answer, on_late] {
          result = connection.request(opcode, wire::WaitSetRequest{}, on_answer, on_late);
        }) {}
  Result<void> result;
  std::thread thread;
};

TEST(Connection, AnAnswerWithoutMemoryForItFailsItsRequest) {
  Connection connection(nobody, "/socket");
  Daemon daemon(connection);
  daemon.connect();
  Asker asks(connection, wire::Opcode::open_wait_set,
             [](Incoming&) -> Result<void> { throw std::bad_alloc(); });
  const auto asked = daemon.hear();
  ASSERT_TRUE(asked);
  daemon.answer(asked->request);
  asks.thread.join();
  ASSERT_FALSE(asks.result);
  EXPECT_EQ(asks.result.error().code, Errc::os_failure);
  EXPECT_EQ(asks.result.error().os_errno, ENOMEM);
}

TEST(Connection, AnUnusableAnswerIsTreatedLikeALateOne) {
  Connection connection(nobody, "/socket");
  Daemon daemon(connection);
  daemon.connect();
  int late = 0;
  Asker asks(
      connection, wire::Opcode::create_subscription,
      [](Incoming&) -> Result<void> { return fail(Errc::os_failure, "mapping", ENOMEM); },
      [&](Incoming&) -> Result<void> { return ++late, Result<void>(); });
  const auto asked = daemon.hear();
  ASSERT_TRUE(asked);
  daemon.answer(asked->request);
  asks.thread.join();
  EXPECT_EQ(late, 1) << "the client must undo what the daemon created";
  ASSERT_FALSE(asks.result);
  EXPECT_EQ(asks.result.error().os_errno, ENOMEM);
}

TEST(Connection, UnansweredRequestsAreSentAgainInOrder) {
  Connection connection(nobody, "/socket");
  Daemon daemon(connection);
  daemon.connect();
  Asker first(connection, wire::Opcode::open_wait_set);
  const auto one = daemon.hear();
  ASSERT_TRUE(one);
  EXPECT_EQ(one->request & wire::asked_again, 0u);
  int later_answers = 0;
  connection.request_later(wire::Opcode::open_window, wire::WindowRequest{},
                           [&](Result<Incoming*> answer) { later_answers += answer ? 1 : 0; });
  const auto two = daemon.hear();
  ASSERT_TRUE(two);
  connection.post(wire::Opcode::unlinked, wire::Unlinked{});
  daemon.disconnect();
  connection.post(wire::Opcode::unlinked, wire::Unlinked{});
  connection.request_later(wire::Opcode::open_window, wire::WindowRequest{},
                           [&](Result<Incoming*> answer) { later_answers += answer ? 1 : 0; });
  EXPECT_TRUE(connection.is_waiting(one->request));
  EXPECT_FALSE(connection.is_open());

  daemon.connect();
  for (const auto& [opcode, id] : {std::pair(wire::Opcode::open_wait_set, one->request),
                                   std::pair(wire::Opcode::open_window, two->request),
                                   std::pair(wire::Opcode::open_window, two->request + 1)}) {
    const auto again = daemon.hear();
    ASSERT_TRUE(again);
    EXPECT_EQ(again->opcode, opcode);
    EXPECT_EQ(again->request, id | wire::asked_again);
  }
  EXPECT_FALSE(daemon.hear(0)) << "statements are not repeated";
  daemon.answer(one->request);
  first.thread.join();
  EXPECT_TRUE(first.result);
  EXPECT_FALSE(connection.is_waiting(one->request));
  daemon.answer(two->request);
  daemon.answer(two->request + 1);
  EXPECT_EQ(later_answers, 2);
}

TEST(Connection, ALateAnswerDoesNotReachACallerThatHasGivenUp) {
  Connection connection(nobody, "/socket");
  Daemon daemon(connection);
  daemon.connect();
  int answers = 0, late = 0;
  Asker asks(
      connection, wire::Opcode::create_publisher,
      [&](Incoming&) -> Result<void> { return ++answers, Result<void>(); },
      [&](Incoming&) -> Result<void> { return ++late, Result<void>(); });
  const auto asked = daemon.hear();
  ASSERT_TRUE(asked);
  asks.thread.join();
  ASSERT_FALSE(asks.result);
  EXPECT_EQ(asks.result.error().code, Errc::daemon_not_running);
  EXPECT_FALSE(connection.is_waiting(asked->request));
  daemon.answer(asked->request);
  daemon.answer(asked->request);
  EXPECT_EQ(answers, 0);
  EXPECT_EQ(late, 1);
}

TEST(Connection, AFinalRefusalFailsAllRequests) {
  Connection connection(nobody, "/socket");
  Daemon daemon(connection);
  daemon.connect();
  Asker asks(connection, wire::Opcode::open_wait_set);
  ASSERT_TRUE(daemon.hear());
  std::vector<Errc> later;
  const auto remember = [&](Result<Incoming*> answer) { later.push_back(answer.error().code); };
  connection.request_later(wire::Opcode::leave, wire::Reference{}, remember);
  connection.refuse(failure_with(Errc::started_anew, "a reason"));
  asks.thread.join();
  ASSERT_FALSE(asks.result);
  EXPECT_EQ(asks.result.error().code, Errc::started_anew);
  connection.request_later(wire::Opcode::leave, wire::Reference{}, remember);
  EXPECT_EQ(later, (std::vector{Errc::started_anew, Errc::started_anew}));
  const auto refused =
      connection.request(wire::Opcode::open_wait_set, wire::WaitSetRequest{}, accept_all);
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, Errc::started_anew);
  EXPECT_STREQ(detail_of(refused.error()), "a reason");
}

TEST(Connection, PacketsThatTheSocketRefusesAreSentLaterInOrder) {
  static int wakes;
  wakes = 0;
  Connection connection([]() noexcept { ++wakes; }, "/socket");
  Daemon daemon(connection);
  daemon.connect();
  constexpr std::uint64_t count = 2000;
  for (std::uint64_t i = 0; i < count; ++i) {
    wire::Unlinked body{};
    body.index = i;
    connection.post(wire::Opcode::unlinked, body);
  }
  ASSERT_GT(wakes, 0) << "the socket took everything: not tested";
  std::uint64_t heard = 0;
  do {
    while (daemon.hear(0)) ++heard;
  } while (connection.flush());
  while (daemon.hear(0)) ++heard;
  EXPECT_EQ(heard, count);
}

TEST(Reconnection, PausesLongerAndLongerUntilAConnectionLasts) {
  Reconnection reconnection;
  Reconnection::Clock::time_point now{};
  const auto pause_after_end = [&] {
    reconnection.ended(now);
    EXPECT_EQ(reconnection.state(), Reconnection::State::waiting);
    const auto pause = reconnection.next_try() - now;
    EXPECT_FALSE(reconnection.is_due(now));
    now = reconnection.next_try();
    EXPECT_TRUE(reconnection.is_due(now));
    reconnection.asked();
    EXPECT_FALSE(reconnection.is_due(now));
    return std::chrono::duration_cast<milliseconds>(pause).count();
  };
  reconnection.succeeded(now);
  std::vector<long> pauses;
  for (int i = 0; i < 10; ++i) pauses.push_back(pause_after_end());
  EXPECT_EQ(pauses, (std::vector<long>{1, 2, 4, 8, 16, 32, 64, 128, 250, 250}));
  reconnection.succeeded(now);
  now += Reconnection::lasting - milliseconds(1);
  EXPECT_EQ(pause_after_end(), 250) << "a daemon that soon ends the connection again";
  reconnection.succeeded(now);
  now += Reconnection::lasting;
  EXPECT_EQ(pause_after_end(), 1);
  reconnection.refused();
  reconnection.ended(now);
  EXPECT_EQ(reconnection.state(), Reconnection::State::orphaned);
  EXPECT_FALSE(reconnection.is_due(now + std::chrono::hours(1)));
}

TEST(Reconnection, ATemporaryRefusalIsRetriedRarelyUntilItIsLifted) {
  using State = Reconnection::State;
  Reconnection reconnection;
  auto now = Reconnection::Clock::time_point{} + std::chrono::hours(1);
  for (int i = 0; i < 3; ++i) {
    reconnection.ended(now);
    reconnection.refused_until_mended(now);
    EXPECT_TRUE(reconnection.is_refused());
    EXPECT_EQ(reconnection.state(), State::waiting);
    EXPECT_FALSE(reconnection.is_due(now + Reconnection::pause_refused - std::chrono::seconds(1)));
    now += Reconnection::pause_refused;
    ASSERT_TRUE(reconnection.is_due(now));
    reconnection.asked();
  }
  reconnection.succeeded(now);
  EXPECT_FALSE(reconnection.is_refused());
  reconnection.ended(now + Reconnection::lasting);
  EXPECT_TRUE(reconnection.is_due(now + Reconnection::lasting + Reconnection::pause_first));
}

TEST(Departure, IsReportedOnceOnRequest) {
  Departure departure;
  EXPECT_FALSE(departure.is_due());
  departure.want();
  EXPECT_TRUE(departure.is_due());
  departure.reported();
  EXPECT_FALSE(departure.is_due());
  EXPECT_FALSE(departure.is_known());
  departure.known();
  EXPECT_TRUE(departure.is_known());
  Departure other;
  other.want();
  other.known();
  EXPECT_FALSE(other.is_due()) << "a departure that the daemon knows is not reported";
}

}  // namespace
}  // namespace agnocast
