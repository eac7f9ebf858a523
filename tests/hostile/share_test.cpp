// SPDX-License-Identifier: Apache-2.0
//
// Goal: a reader of another user that releases none of its messages may fill a publisher's heap,
// but not for long, and not again and again.
// Method: a publisher of large messages whose process may have one window, and a subscriber that
// may hold as many of them as fit and releases none; or a subscriber whose region the publisher's
// process cannot map, so that the publisher does not know its holds.

#include <tests/hostile/hostile_node.hpp>
#include <tests/support/processes/ctl.hpp>

#include <cerrno>
#include <cstring>
#include <memory>
#include <sstream>
#include <string>
#include <vector>

namespace agnocast::test {
namespace {

constexpr const char* bulk_topic = "/bulk";
// Mebibytes: all that the window has, but for one.
constexpr std::uint64_t kept = 63;

/// Holds as many messages as it may.
struct Hoarder {
  explicit Hoarder(Stage& stage, std::uint64_t quota = kept, std::uint64_t first_slot = 0)
      : node(stage.socket_path()) {
    join(quota, first_slot);
  }
  void join(std::uint64_t quota, std::uint64_t first_slot = 0) {
    made = node.join(wire::Kind::subscription, bulk_topic, {1, false, true, false, false}, quota);
    joined.push_back(made);
    publisher = node.announced().body;
    line().cursor().store(publisher.first_sequence + 1);
    line().publisher_generation().store(publisher.generation);
    line().hold(0).store(((std::uint64_t{1} << quota) - 1) << first_slot);
  }
  void release() const {
    for (const wire::EndpointCreated& each : joined)
      node.line(each, publisher.index).hold(0).store(0);
  }
  region::LinkWords<SharedMemory> line() const { return node.line(made, publisher.index); }

  HostileNode node;
  wire::EndpointCreated made{};
  std::vector<wire::EndpointCreated> joined;
  wire::Announcement publisher{};
};

struct Progress {
  std::uint64_t published = 0, refused = 0;
};
Progress progress_of(SteeredProcess& publisher) {
  Progress progress;
  std::istringstream words(publisher.ask("state"));
  words >> progress.published >> progress.refused;
  return progress;
}

/// Waits for the ten seconds of patience, and for the log line.
bool is_logged(Stage& stage, const char* text) {
  return stage.daemon().wait_for_log(text) || stage.daemon().wait_for_log(text) ||
         stage.daemon().wait_for_log(text);
}

bool goes_on(SteeredProcess& publisher) {
  const std::uint64_t before = progress_of(publisher).published;
  return eventually([&] { return progress_of(publisher).published >= before + 50; });
}

/// Every administrator's command names the reader's process and user, and the reason.
void expect_named(Stage& stage, pid_t reader) {
  const std::string process =
      "(pid " + std::to_string(reader) + ", uid " + std::to_string(hostile_uid) + ")";
  const std::string why = "its user kept too much of the heap";
  const std::vector<std::vector<std::string>> looks = {
      {"doctor"}, {"topic", "info", "-v", bulk_topic}, {"verify"}};
  for (const std::vector<std::string>& look : looks) {
    const CtlResult result = run_ctl(stage.socket_path(), look);
    EXPECT_NE(result.out.find(process), std::string::npos) << look[0] << ": " << result.out;
    EXPECT_NE(result.out.find(why), std::string::npos) << look[0] << ": " << result.out;
    EXPECT_NE(result.out.find("withdrawn"), std::string::npos) << look[0] << ": " << result.out;
  }
}

/// Returns the records of this kind about the reader, oldest first.
std::vector<nlohmann::json> records_of(Stage& stage, const char* type, pid_t reader) {
  const nlohmann::json journal =
      run_ctl(stage.socket_path(), {"journal", "-j", "-n", "4096", "--topic", bulk_topic,
                                    "--process", std::to_string(reader)})
          .json();
  std::vector<nlohmann::json> found;
  for (const nlohmann::json& record : journal["records"])
    if (record["type"] == type) found.push_back(record);
  return found;
}

/// Checks that the flight recorder names both sides.
void expect_both_sides(const nlohmann::json& record, pid_t publisher, pid_t reader) {
  const nlohmann::json& arguments = record["arguments"];
  EXPECT_EQ(record["topic"], bulk_topic);
  EXPECT_EQ(arguments["reader_uid"], hostile_uid);
  EXPECT_EQ(arguments["reader_pid"], reader);
  EXPECT_EQ(record["receiver"]["pid"], reader);
  EXPECT_EQ(arguments["uid"], honest_uid);
  EXPECT_EQ(arguments["pid"], publisher);
  EXPECT_EQ(record["process"]["pid"], publisher);
  EXPECT_EQ(arguments["index"], 0);
}

TEST(HostileShare, ASubscriberThatKeepsAHeapFullIsWithdrawn) {
  AGNOCAST_NEEDS_TWO_USERS();
  // A window for each of the honest processes.
  Stage stage({.quota = "held_messages = 400\nheap_bytes = 201326592\n"});
  const auto victim = stage.another_honest_process();
  ASSERT_EQ(victim->ask(std::string("publish_bulk ") + bulk_topic), "ok");
  ASSERT_TRUE(goes_on(*victim));
  Attacker attacker([&](Attack& attack) {
    Hoarder hoarder(stage);
    attack.ready();
    while (attack.goes_on()) {
      if (attack.word(0).exchange(0) != 0) {
        hoarder.join(kept - 10);  // its user's rest of the pool
        attack.word(1).store(1);
      }
      if (attack.word(2).exchange(0) != 0) hoarder.release();
      std::this_thread::sleep_for(std::chrono::milliseconds(10));
    }
  });
  ASSERT_TRUE(attacker.wait_until_ready());
  ASSERT_TRUE(eventually([&] { return progress_of(*victim).refused > 0; }))
      << "the heap was never full";
  ASSERT_TRUE(is_logged(stage, "reader withdrawn")) << stage.daemon().log();
  EXPECT_NE(stage.daemon().log().find("its user kept too much of the heap"), std::string::npos);
  ASSERT_TRUE(goes_on(*victim) || goes_on(*victim))
      << "messages held by a withdrawn subscription still count";
  expect_named(stage, attacker.pid());
  const std::vector<nlohmann::json> withdrawn =
      records_of(stage, "reader_withdrawn", attacker.pid());
  ASSERT_EQ(withdrawn.size(), 1u);
  expect_both_sides(withdrawn[0], victim->pid(), attacker.pid());
  EXPECT_EQ(withdrawn[0]["arguments"]["subscription"], 0);
  EXPECT_EQ(withdrawn[0]["arguments"]["why"], "over_share");
  EXPECT_NE(withdrawn[0]["text"].get<std::string>().find("its user kept too much of the heap"),
            std::string::npos);

  // Once more, with a subscription that the publisher has not seen yet.
  const std::uint64_t refused = progress_of(*victim).refused;
  attacker.set_word(0, 1);
  ASSERT_TRUE(eventually([&] { return attacker.word(1) == 1; }));
  for (int i = 0; i < 4; ++i) ASSERT_TRUE(goes_on(*victim));
  EXPECT_EQ(progress_of(*victim).refused, refused)
      << "a new subscription of that user gets the full time again";

  // Both release their messages, and their user's minute passes.
  attacker.set_word(2, 1);
  bool is_served = false;
  for (int patience = 0; patience < 6 && !is_served; ++patience)
    is_served = is_logged(stage, "reader served again");
  ASSERT_TRUE(is_served) << stage.daemon().log();
  const auto served = records_of(stage, "reader_served_again", attacker.pid());
  ASSERT_FALSE(served.empty());
  expect_both_sides(served[0], victim->pid(), attacker.pid());
  stage.victim_was(*victim);
  attacker.end();
  stage.honest_goes_on();
}

// In a user namespace the other user's uid, as the daemon reports it, may equal geteuid() here.
TEST(HostileShare, AUidThatIsEqualOnlyInsideANamespaceIsAnotherUser) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage({.quota = "held_messages = 400\nheap_bytes = 201326592\n"});
  const auto victim = stage.another_honest_process();
  const std::string entered = victim->ask("enter-user-namespace");
  for (const int refusal : {EPERM, ENOSPC, EUSERS}) {
    if (entered == std::strerror(refusal))
      GTEST_SKIP() << "users may not create user namespaces here: " << entered;
  }
  ASSERT_EQ(entered, "ok");
  ASSERT_EQ(victim->ask(std::string("publish_bulk ") + bulk_topic), "ok");
  ASSERT_TRUE(goes_on(*victim));
  static_assert(hostile_uid == 65534, "the uid of a user namespace without a map");
  Attacker attacker([&](Attack& attack) {
    Hoarder hoarder(stage);
    attack.ready();
    while (attack.goes_on()) std::this_thread::sleep_for(std::chrono::milliseconds(10));
  });
  ASSERT_TRUE(attacker.wait_until_ready());
  ASSERT_TRUE(is_logged(stage, "reader withdrawn")) << stage.daemon().log();
  ASSERT_TRUE(goes_on(*victim) || goes_on(*victim));
  stage.victim_was(*victim);
  attacker.end();
  stage.honest_goes_on();
}

// None of them keeps most of it, and each could come back while the others are excluded.
TEST(HostileShare, SubscribersThatKeepAHeapFullTogetherAreWithdrawnTogether) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage({.quota = "held_messages = 400\nheap_bytes = 201326592\n"});
  const auto victim = stage.another_honest_process();
  ASSERT_EQ(victim->ask(std::string("publish_bulk ") + bulk_topic), "ok");
  ASSERT_TRUE(goes_on(*victim));
  constexpr std::uint64_t third = kept / 3;
  std::vector<std::unique_ptr<Attacker>> attackers;
  for (const uid_t uid : {hostile_uid, third_uid, third_uid - 1}) {
    attackers.push_back(std::make_unique<Attacker>(
        [&, first_slot = attackers.size() * third](Attack& attack) {
          Hoarder hoarder(stage, third, first_slot);
          attack.ready();
          while (attack.goes_on()) {
            if (attack.word(0).exchange(0) != 0) {
              hoarder.join(1);
              attack.word(1).store(1);
            }
            std::this_thread::sleep_for(std::chrono::milliseconds(10));
          }
        },
        uid));
  }
  for (const auto& attacker : attackers) ASSERT_TRUE(attacker->wait_until_ready());
  ASSERT_TRUE(eventually([&] { return progress_of(*victim).refused > 0; }))
      << "the heap was never full";
  for (const auto& attacker : attackers) {
    const std::string whose = "pid=" + std::to_string(attacker->pid());
    EXPECT_TRUE(eventually([&] {
      std::istringstream log(stage.daemon().log());
      for (std::string line; std::getline(log, line);) {
        if (line.find("reader withdrawn") != std::string::npos &&
            line.find(' ' + whose + ' ') != std::string::npos)
          return true;
      }
      return false;
    })) << whose;
  }
  ASSERT_TRUE(goes_on(*victim) || goes_on(*victim));
  const std::uint64_t refused = progress_of(*victim).refused;
  for (const auto& attacker : attackers) {
    attacker->set_word(0, 1);
    ASSERT_TRUE(eventually([&] { return attacker->word(1) == 1; }));
  }
  for (int i = 0; i < 4; ++i) ASSERT_TRUE(goes_on(*victim));
  EXPECT_EQ(progress_of(*victim).refused, refused);
  // The newest first: it has inherited the pipes that stop the others.
  stage.victim_was(*victim);
  for (; !attackers.empty(); attackers.pop_back()) attackers.back()->end();
  stage.honest_goes_on();
}

TEST(HostileShare, ASubscriberThatCannotBeMappedIsWithdrawn) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage({.quota = "held_messages = 400\nheap_bytes = 201326592\n"});
  const auto victim = stage.another_honest_process();
  ASSERT_EQ(victim->ask(std::string("publish_bulk ") + bulk_topic), "ok");
  ASSERT_TRUE(goes_on(*victim));
  ASSERT_EQ(victim->ask("limit-addresses"), "ok");
  Attacker attacker([&](Attack& attack) {
    HostileNode node(stage.socket_path());
    const auto join = [&] {
      node.join(wire::Kind::subscription, bulk_topic, {1, false, true, false, false}, 1);
    };
    join();
    attack.ready();
    while (attack.goes_on()) {
      if (attack.word(0).exchange(0) != 0) {
        join();
        ++attack.word(1);
      }
      std::this_thread::sleep_for(std::chrono::milliseconds(10));
    }
  });
  ASSERT_TRUE(attacker.wait_until_ready());
  ASSERT_TRUE(eventually([&] { return progress_of(*victim).refused > 0; }))
      << "the heap never filled: the publisher mapped the subscriber after all";
  ASSERT_TRUE(is_logged(stage, "its process could not be mapped")) << stage.daemon().log();
  ASSERT_TRUE(goes_on(*victim) || goes_on(*victim));
  const std::uint64_t refused = progress_of(*victim).refused;
  for (int i = 0; i < 4; ++i) ASSERT_TRUE(goes_on(*victim));
  EXPECT_EQ(progress_of(*victim).refused, refused);

  // Further subscriptions cost next to nothing together, one after the other: on a busy machine the
  // publisher's heap may be full before they are withdrawn.
  for (std::uint64_t joined = 1; joined <= 4; ++joined) {
    attacker.set_word(0, 1);
    ASSERT_TRUE(eventually([&] { return attacker.word(1) == joined; }));
    for (int i = 0; i < 4; ++i) ASSERT_TRUE(goes_on(*victim));
    EXPECT_LT((progress_of(*victim).refused - refused) * 5, refused)
        << "at subscription " << joined + 1;
  }
  stage.victim_was(*victim);
  attacker.end();
  stage.honest_goes_on();
}

// None of them stays for ten seconds, and there is one at any time.
TEST(HostileShare, SubscribersThatCannotBeMappedShareTenSeconds) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage({.quota = "held_messages = 400\nheap_bytes = 201326592\n"});
  const auto victim = stage.another_honest_process();
  ASSERT_EQ(victim->ask(std::string("publish_bulk ") + bulk_topic), "ok");
  ASSERT_TRUE(goes_on(*victim));
  ASSERT_EQ(victim->ask("limit-addresses"), "ok");
  Attacker attacker([&](Attack& attack) {
    HostileNode node(stage.socket_path());
    const auto join = [&] {
      return node.join(wire::Kind::subscription, bulk_topic, {1, false, true, false, false}, 1);
    };
    wire::EndpointCreated before = join();
    attack.ready();
    while (attack.goes_on()) {
      std::this_thread::sleep_for(std::chrono::seconds(3));
      const wire::EndpointCreated next = join();
      for (const wire::Opcode opcode : {wire::Opcode::leave, wire::Opcode::drained})
        node.wire().reference(opcode, wire::Kind::subscription, before.topic, before.index,
                              before.generation);
      before = next;
    }
  });
  ASSERT_TRUE(attacker.wait_until_ready());
  ASSERT_TRUE(is_logged(stage, "its process could not be mapped")) << stage.daemon().log();
  ASSERT_TRUE(goes_on(*victim) || goes_on(*victim));
  const std::uint64_t refused = progress_of(*victim).refused;
  for (int i = 0; i < 4; ++i) ASSERT_TRUE(goes_on(*victim));
  EXPECT_EQ(progress_of(*victim).refused, refused);
  stage.victim_was(*victim);
  attacker.end();
  stage.honest_goes_on();
}

}  // namespace
}  // namespace agnocast::test
