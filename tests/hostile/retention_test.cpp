// SPDX-License-Identifier: Apache-2.0
//
// Goal: messages that other users hold, together and for as long as they like, never keep a
// publisher from publishing; and each of these users can hold some.
// Method: attackers of several users take every subscription that they can get beside the honest
// pair, each with the largest quota, and for ever hold as many messages as they may, all different
// ones. The honest publisher goes through all its slots meanwhile. The topic is small, so that all
// its places and slots are taken.

#include <tests/hostile/hostile_node.hpp>

#include <csignal>
#include <memory>
#include <optional>
#include <sstream>
#include <string>
#include <thread>
#include <vector>

namespace agnocast::test {
namespace {

using wire::Opcode;

// History and messages in hand take 1035 slots, the subscriptions one each: the pool has 25.
const char* const small_topic =
    "[limits]\nslots_per_publisher = 1100\nsubscriptions_per_topic = 40\n";
constexpr std::uint64_t all_places = 1100;
constexpr std::uint64_t places = 40;
constexpr std::uint32_t deepest = 1000;

constexpr uid_t more_hostile_uids[] = {65521, 65522};

/// The subscriptions of an attacker on a topic with one publisher.
class Holder {
 public:
  explicit Holder(const std::string& path) : node_(path) { node_.open_wait_set(); }

  /// Adds one on the stream; returns false when the daemon refused it.
  bool subscribe(std::uint64_t quota) {
    body_.quota = quota;
    const Incoming answer = node_.wire().ask(Opcode::create_subscription, body_);
    if (answer.opcode() == Opcode::refused) {
      EXPECT_TRUE(answer.refused_code() == Errc::quota_exceeded ||
                  answer.refused_code() == Errc::limit_reached);
      refusal_ = answer.refused_text();
      return false;
    }
    const auto made = answer.as<wire::EndpointCreated>();
    const auto publisher = node_.announced().body;
    EXPECT_EQ(publisher.own_index, made.index);
    EXPECT_EQ(publisher.quota, quota) << "quota announced for a publisher of another user";
    const auto line = node_.line(made, publisher.index);
    for (std::uint64_t i = 0; i < quota; ++i, ++slot_)
      line.hold(slot_ / 64).fetch_or(std::uint64_t{1} << slot_ % 64);
    line.cursor().store(~std::uint64_t{0} >> 16);
    line.publisher_generation().store(publisher.generation);
    return true;
  }

  /// Subscribes for the largest quota, which the refusal of a larger one states.
  std::uint64_t subscribe_for_most() {
    EXPECT_FALSE(subscribe(all_places));
    const std::size_t at = refusal_.find(" have ");
    if (at == std::string::npos) return ADD_FAILURE() << refusal_, 0;
    const std::uint64_t most = std::stoull(refusal_.substr(at + 6));
    EXPECT_FALSE(subscribe(most + 1)) << "the refusal names less than is available";
    return subscribe(most) ? most : 0;
  }

  void begin_at(std::uint64_t slot) { slot_ = slot; }

 private:
  HostileNode node_;
  wire::CreateEndpoint body_ =
      node_.body_like(stream_topic, stream_topic, {deepest, false, true, false, false});
  std::string refusal_;
  std::uint64_t slot_ = 0;
};

/// Takes the largest quota, then places with one message each: words 0 and 1 count both.
std::unique_ptr<Attacker> holder_of(Stage& stage, uid_t uid, std::uint64_t first_slot,
                                    std::uint64_t more) {
  auto attacker = std::make_unique<Attacker>(
      [&stage, first_slot, more](Attack& attack) {
        Holder holder(stage.socket_path());
        holder.begin_at(first_slot);
        attack.word(0) = holder.subscribe_for_most();
        EXPECT_FALSE(holder.subscribe(2)) << "it already has its share";
        std::uint64_t got = 0;
        while (got < more && holder.subscribe(1)) ++got;
        attack.word(1) = got;
        attack.ready();
        while (attack.goes_on()) std::this_thread::sleep_for(std::chrono::milliseconds(5));
      },
      uid);
  EXPECT_TRUE(attacker->wait_until_ready());
  return attacker;
}

void publisher_goes_through_all_its_slots(Stage& stage) {
  const std::uint64_t last = stage.state().published + all_places + 100;
  do {
    stage.honest_goes_on();
  } while (stage.state().published < last && !testing::Test::HasFailure());
}

TEST(HostileRetention, AllHoldsOfOtherUsersLeaveAPublisherItsSlots) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage({.quota = "", .more = small_topic});
  const auto first = holder_of(stage, hostile_uid, 0, 27);
  EXPECT_EQ(first->word(0), 12u) << "half of the pool that the honest one leaves, and one";
  EXPECT_EQ(first->word(1), 27u);
  const auto second = holder_of(stage, more_hostile_uids[0], 40, 100);
  EXPECT_EQ(second->word(0), 7u) << "half of the rest";
  EXPECT_EQ(second->word(1), places - 1 - 28 - 1) << "all but the honest subscription";
  ASSERT_TRUE(stage.publisher().eventually("matched", std::to_string(places)));
  publisher_goes_through_all_its_slots(stage);
  EXPECT_EQ(stage.daemon().log().find("client revoked"), std::string::npos)
      << "the holders stay within their quotas";
  first->kill();
  second->kill();
  ASSERT_TRUE(stage.publisher().eventually("matched", "1"));
  const auto next = holder_of(stage, more_hostile_uids[1], 0, 1);
  EXPECT_EQ(next->word(0), 12u) << "the pool gets back the share of an ended process";
  next->kill();
}

TEST(HostileRetention, SharesOutliveTheDaemon) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage({.quota = "", .more = small_topic});
  const auto first = holder_of(stage, hostile_uid, 0, 1);
  const pid_t before = stage.daemon().pid();
  stage.daemon().kill_worker();
  ASSERT_TRUE(stage.daemon().wait_for_next(before));
  stage.honest_goes_on();
  const auto second = holder_of(stage, more_hostile_uids[0], 12 + 1, 1);
  EXPECT_EQ(second->word(0), 7u) << "half of the first one's rest";
  publisher_goes_through_all_its_slots(stage);
  second->kill();
  first->kill();
}

// The node keeps eight messages, and may hold three of another user's publisher.
TEST(HostileRetention, AnHonestReaderTakesNoMoreThanItMay) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage({.quota = "", .more = small_topic});
  const auto reader = stage.another_honest_process(hostile_uid);
  ASSERT_EQ(reader->ask(std::string("join ") + stream_topic), "ok");
  ASSERT_TRUE(stage.publisher().eventually("matched", "2"));
  const auto received = [&] {
    std::uint64_t published = 0, refused = 0, count = 0;
    std::istringstream(reader->ask("state")) >> published >> refused >> count;
    return count;
  };
  EXPECT_TRUE(eventually([&] { return received() == 3; })) << received();
  publisher_goes_through_all_its_slots(stage);
  EXPECT_EQ(received(), 3u);
}

// Subscriptions that exist before any publisher, and may hold all messages of publishers of their
// own user.
TEST(HostileRetention, ALaterPublisherHasItsSlots) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage({.quota = "", .more = small_topic});
  Attacker attacker([&](Attack& attack) {
    HostileNode node(stage.socket_path());
    node.open_wait_set();
    std::vector<wire::EndpointCreated> made;
    for (int i = 0; i < 20; ++i) {
      auto body = node.body_like(stream_topic, "/later", {deepest, false, true, false, false});
      body.quota = all_places;
      const Incoming answer = node.wire().ask(Opcode::create_subscription, body);
      EXPECT_EQ(answer.opcode(), Opcode::endpoint_created) << answer.refused_text();
      if (answer.opcode() == Opcode::endpoint_created)
        made.push_back(answer.as<wire::EndpointCreated>());
    }
    attack.ready();
    // It holds all slots, as of its own user's publisher; it may hold fewer of this one, and the
    // excess counts as a lie.
    for (std::size_t i = 0; i < made.size(); ++i) {
      const auto publisher = node.announced().body;
      EXPECT_LE(publisher.quota, 13u);
      for (const auto& one : made) {
        if (one.index != publisher.own_index) continue;
        const auto line = node.line(one, publisher.index);
        for (std::uint64_t word = 0; word < all_places / 64; ++word)
          line.hold(word).store(~std::uint64_t{0});
        line.cursor().store(~std::uint64_t{0} >> 16);
        line.publisher_generation().store(publisher.generation);
      }
    }
    attack.word(0) = 1;
    while (attack.goes_on()) std::this_thread::sleep_for(std::chrono::milliseconds(5));
  });
  ASSERT_TRUE(attacker.wait_until_ready());
  const auto late = stage.another_honest_process();
  ASSERT_EQ(late->ask("publish /later"), "ok");
  ASSERT_TRUE(late->eventually("matched", "20"));
  ASSERT_TRUE(eventually([&] { return attacker.word(0) == 1; }));
  // It must not wait for the daemon, which ends the session of a process that holds more than it
  // may.
  ASSERT_EQ(::kill(stage.daemon().pid(), SIGSTOP), 0);
  std::uint64_t published = 0, refused = 0, last = 0;
  const auto look = [&] {
    std::istringstream state(late->ask("state"));
    state >> published >> refused;
    return published;
  };
  last = look() + all_places + 100;
  EXPECT_TRUE(eventually([&] { return look() >= last || refused != 0; }));
  EXPECT_EQ(::kill(stage.daemon().pid(), SIGCONT), 0);
  EXPECT_EQ(refused, 0u);
  EXPECT_GE(published, last);
  stage.victim_was(*late);
  EXPECT_EQ(late->ask("stop"), "ok");
  attacker.kill();
}

}  // namespace
}  // namespace agnocast::test
