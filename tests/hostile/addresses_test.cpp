// SPDX-License-Identifier: Apache-2.0
//
// Goal: a process that falsely claims the addresses of the honest publisher's heap neither ends
// the stream nor uses up the moves and windows that a real collision within the honest user needs.
// Method: an attacker of another user claims every window as soon as the daemon announces it. When
// the heap no longer moves for the attacker, a process of the honest user joins that has mapped a
// page in the newest window: it has to get the stream.

#include <tests/hostile/hostile_node.hpp>

#include <array>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <sstream>
#include <string>
#include <thread>

namespace agnocast::test {
namespace {

using wire::Kind;
using wire::Opcode;

// Indices of the attack's shared words.
constexpr std::size_t moves = 0, newest_base = 1, claims = 2;

/// Claims each new window of the honest publisher until the attack ends.
void claims_every_window(Stage& stage, Attack& attack) {
  HostileNode node(stage.socket_path());
  node.join(Kind::subscription, stream_topic);
  const auto honest = node.announced().body;
  ASSERT_GE(honest.window_count, 1u);
  const auto claim = [&](std::uint64_t base, std::uint64_t bytes) {
    attack.word(newest_base).store(base);
    wire::Blocked range{};
    range.base = base;
    range.bytes = bytes;
    range.what = wire_name("nothing at all");
    node.wire().send(Opcode::blocked, range);
    ++attack.word(claims);
  };
  const auto& first = honest.window[honest.window_count - 1];
  claim(first.base, first.bytes);
  for (bool stays = false; attack.goes_on();) {
    const auto packet = node.wire().poll();
    if (!packet) {
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
      continue;
    }
    if (packet->opcode() == Opcode::window_announced) {
      const auto window = packet->as<wire::WindowAnnounced>();
      if (window.client != honest.client) continue;
      if (!stays) ++attack.word(moves);
      claim(window.base, window.bytes);
    } else if (packet->opcode() == Opcode::notice && !stays) {
      const std::string text = packet->as<wire::Notice>().text.text;
      stays = text.find("it stays: ") != std::string::npos;
      EXPECT_TRUE(stays || text.find("it goes on in another window") != std::string::npos) << text;
      if (stays) attack.ready();
    }
  }
}

void a_real_collision_is_served_beside(Stage& stage, std::uint64_t moves_for_strangers) {
  Attacker attacker([&](Attack& attack) { claims_every_window(stage, attack); });
  ASSERT_TRUE(attacker.wait_until_ready());
  // A window may also be announced because the heap grows between two claims.
  const std::uint64_t announced = attacker.word(moves);
  EXPECT_GE(announced, moves_for_strangers);
  stage.honest_goes_on();

  const auto collider = stage.another_honest_process();
  const std::uint64_t page = attacker.word(newest_base) + (std::uint64_t{1} << 20);
  ASSERT_EQ(collider->ask("occupy " + std::to_string(page) + " 4096"), "ok");
  ASSERT_EQ(collider->ask(std::string("join ") + stream_topic), "ok");
  // published refused received wrong …
  std::array<std::uint64_t, 4> state{};
  EXPECT_TRUE(eventually([&] {
    std::istringstream words(collider->ask("state"));
    for (std::uint64_t& word : state) words >> word;
    return state[2] >= 100;
  })) << "the process received "
      << state[2] << " messages\n"
      << stage.daemon().log();
  EXPECT_EQ(state[3], 0u);
  EXPECT_TRUE(eventually([&] { return attacker.word(claims) >= announced + 2; }))
      << "the publisher moved to another window and the attacker could not claim it";
  stage.honest_goes_on();
  stage.honest_is_served();
  attacker.kill();
  stage.honest_goes_on();
}

TEST(HostileAddresses, FalseClaimsLeaveAMoveForACollisionWithinTheUser) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage({.quota = "held_messages = 600\n"});
  a_real_collision_is_served_beside(stage, abi::heap_move_max - 1);
  EXPECT_NE(stage.daemon().log().find("it stays: it has moved " +
                                      std::to_string(abi::heap_move_max - 1) + " times"),
            std::string::npos);
}

TEST(HostileAddresses, FalseClaimsLeaveAWindowOfTheUsersQuotaForARealCollision) {
  AGNOCAST_NEEDS_TWO_USERS();
  // Both processes of the honest user have one window; one more is left.
  Stage stage({.quota = "held_messages = 600\nheap_bytes = \"192MiB\"\n"});
  a_real_collision_is_served_beside(stage, 0);
}

TEST(HostileAddresses, FalseClaimsLeaveAWindowOfTheProcessForARealCollision) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage({.quota = "held_messages = 600\n", .heap = "windows_per_process = 2\n"});
  a_real_collision_is_served_beside(stage, 0);
}

}  // namespace
}  // namespace agnocast::test
