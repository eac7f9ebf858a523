// SPDX-License-Identifier: Apache-2.0
//
// Goal: agnocast-ctl access says of any topic who may publish, subscribe and connect, by which
// rule, and a user's limits and usage; and the daemon decides the same. Method: the real daemon
// with rules, agnocast-ctl as a program of its own, and clients of two users that try.

#include <tests/integration/ctl/ctl_node.hpp>
#include <tests/integration/daemon/raw_node.hpp>
#include <tests/support/processes/ctl.hpp>
#include <tests/support/processes/daemon_process.hpp>

#include <gmock/gmock.h>
#include <grp.h>
#include <pwd.h>
#include <sys/stat.h>

#include <fstream>
#include <string>
#include <vector>

namespace agnocast::test {
namespace {

using nlohmann::json;
using testing::HasSubstr;
using Words = std::vector<std::string>;

// The line of the first rule is the third.
const char* const rules =
    "[daemon]\nsocket_mode = \"0666\"\n"
    "[[access]]\ntopic = \"/lidar/**\"\npublish = [\"user:nobody\", \"gid:4242\"]\n"
    "[[access]]\ntopic = \"/lidar/raw\"\ndomain = 7\nsubscribe = [\"uid:54321\"]\n"
    "[[access]]\ntopic = \"/closed\"\npublish = []\nsubscribe = []\n"
    "[quota]\npublishers = 5\nheap_bytes = \"unlimited\"\n";

class CtlAccess : public testing::Test {
 protected:
  void SetUp() override {
    if (::getpwnam("nobody") == nullptr) GTEST_SKIP() << "there is no user nobody here";
  }
  CtlResult ctl(Words words, std::optional<uid_t> uid = {}) {
    words.insert(words.begin(), "access");
    return run_ctl(daemon_.socket_path(), words, {}, uid);
  }
  json answer(Words words, std::optional<uid_t> uid = {}) {
    words.emplace_back("-j");
    const CtlResult result = ctl(std::move(words), uid);
    EXPECT_EQ(result.status, 0) << result.err;
    json object = result.json();
    EXPECT_EQ(object["schema"], "agnocast.access/1");
    return object;
  }

  DaemonProcess daemon_{DaemonOptions{.config = rules}};
  const uid_t nobody_ = ::getpwnam("nobody") == nullptr ? 0 : ::getpwnam("nobody")->pw_uid;
};

TEST_F(CtlAccess, NamesTheDecidingRuleAndItsUsersByNameAndNumber) {
  const json is = answer({"/lidar/front"});
  EXPECT_EQ(is["topic"], "/lidar/front");
  EXPECT_EQ(is["domain"], 0);
  EXPECT_EQ(is["publish"]["rule"], json({{"line", 3}, {"pattern", "/lidar/**"}}));
  EXPECT_EQ(is["publish"]["everybody"], false);
  EXPECT_EQ(
      is["publish"]["who"],
      json::array(
          {{{"kind", "user"}, {"name", "nobody"}, {"id", nobody_}, {"written", "user:nobody"}},
           {{"kind", "group"}, {"name", nullptr}, {"id", 4242}, {"written", "gid:4242"}}}));
  EXPECT_EQ(is["subscribe"]["everybody"], true);
  EXPECT_EQ(is["subscribe"]["rule"], nullptr);
  const CtlResult people = ctl({"lidar/front"});
  EXPECT_EQ(people.status, 0) << people.err;
  EXPECT_THAT(people.out, HasSubstr("/lidar/front of domain 0, at " + daemon_.socket_path()));
  EXPECT_THAT(people.out, HasSubstr("user nobody (uid " + std::to_string(nobody_) + "), gid 4242"));
  EXPECT_THAT(people.out, HasSubstr("rule \"/lidar/**\", line 3 of the configuration"));
  EXPECT_THAT(people.out, HasSubstr("everybody"));
  EXPECT_THAT(people.out, HasSubstr("none of 3 rules matches it"));
}

TEST_F(CtlAccess, FollowsTheDomainAndTheOrderOfTheFile) {
  EXPECT_EQ(answer({"/lidar/raw"})["subscribe"]["rule"], nullptr);
  const json there = answer({"/lidar/raw", "--domain", "7"});
  EXPECT_EQ(there["subscribe"]["rule"]["line"], 6);
  EXPECT_EQ(there["subscribe"]["who"][0]["id"], 54321);
  EXPECT_EQ(there["publish"]["rule"]["line"], 3) << "the rule of line 6 does not name it";
  const json closed = answer({"/closed"});
  EXPECT_EQ(closed["publish"]["who"], json::array());
  EXPECT_EQ(closed["user"]["subscribe"]["allowed"], false);
  EXPECT_THAT(ctl({"/closed"}).out, HasSubstr("nobody"));
}

TEST_F(CtlAccess, SaysTheSameOfAUserAsTheDaemonDecides) {
  if (::geteuid() != 0) GTEST_SKIP() << "needs root and another user";
  const auto may = [&](const std::string& topic, const std::string& user) {
    const json of = answer({topic, "--user", user})["user"];
    return std::pair(of["publish"]["allowed"].get<bool>(), of["subscribe"]["allowed"].get<bool>());
  };
  EXPECT_EQ(may("/lidar/front", "nobody"), std::pair(true, true));
  EXPECT_EQ(may("/lidar/front", std::to_string(nobody_)), std::pair(true, true));
  EXPECT_EQ(may("/lidar/front", "root"), std::pair(false, true));
  EXPECT_EQ(may("/closed", "nobody"), std::pair(false, false));
  CtlNode root(daemon_.socket_path());
  EXPECT_EQ(root.wire.create_publisher("/lidar/front").refused_code(), Errc::access_denied);
  EXPECT_EQ(in_other_user([&] {
              WireClient other(daemon_.socket_path());
              EXPECT_EQ(other.hello().opcode(), wire::Opcode::welcome);
              EXPECT_EQ(other.create_publisher("/lidar/front").opcode(),
                        wire::Opcode::endpoint_created);
              return 0;
            }),
            0);
  // The calling user is meant, unless another one is named.
  EXPECT_EQ(answer({"/lidar/front"}, nobody_)["user"]["uid"], nobody_);
  EXPECT_EQ(answer({"/lidar/front"}, nobody_)["user"]["publish"]["allowed"], true);
  EXPECT_THAT(ctl({"/lidar/front"}).out, HasSubstr("publish    no   is not one of them"));
}

// A rule that was added after the publishers: the process goes on with both.
TEST(CtlAccessToMemory, NamesReadersThroughOtherTopicsOfTheSameProcess) {
  DaemonProcess daemon;
  CtlNode node(daemon.socket_path());
  node.publisher("/secret");
  node.publisher("/public");
  const auto memory = [&](const char* topic) {
    return run_ctl(daemon.socket_path(), {"access", topic, "-j"}).json()["memory"];
  };
  EXPECT_EQ(memory("/secret"), json::array()) << "the same users read both";
  std::ofstream(daemon.directory() + "/agnocastd.toml", std::ios::app)
      << "[[access]]\ntopic = \"/secret\"\nsubscribe = [\"uid:54321\"]\n";
  const pid_t killed = daemon.kill_worker();
  ASSERT_TRUE(daemon.wait_for_next(killed));
  const json found = memory("/secret");
  ASSERT_EQ(found.size(), 1u) << found;
  EXPECT_EQ(found[0]["topic"], "/public");
  EXPECT_EQ(found[0]["pid"], ::getpid());
  EXPECT_EQ(found[0]["subscribe"]["everybody"], true);
  EXPECT_EQ(memory("/public")[0]["topic"], "/secret");
  EXPECT_THAT(run_ctl(daemon.socket_path(), {"access", "/secret"}).out,
              testing::ContainsRegex("memory +everybody +/public .domain 0., which process"));
  EXPECT_EQ(memory("/other"), json::array());
}

TEST_F(CtlAccess, ShowsHowMuchAUserUsesOfItsQuotas) {
  CtlNode node(daemon_.socket_path());
  node.publisher("/free");
  node.publisher("/free/too");
  const json user = answer({"/free"})["user"];
  EXPECT_EQ(user["in_use"]["publishers"], 2);
  EXPECT_EQ(user["quota"]["publishers"], 5);
  EXPECT_EQ(user["in_use"]["topics"], 2);
  EXPECT_EQ(user["quota"]["heap_bytes"], nullptr) << "unlimited";
  EXPECT_EQ(answer({"/free", "--user", "54321"})["user"]["in_use"]["publishers"], 0);
  EXPECT_THAT(ctl({"/free"}).out, testing::ContainsRegex("publishers +2 +5\n"));
}

TEST_F(CtlAccess, NamesTheUsersThatMayConnect) {
  if (::geteuid() != 0) GTEST_SKIP() << "needs root to give the socket to others";
  ASSERT_EQ(::chown(daemon_.socket_path().c_str(), 0, 4242), 0);
  ASSERT_EQ(::chmod(daemon_.socket_path().c_str(), 0660), 0);
  const json is = answer({"/free", "--user", "nobody"});
  EXPECT_EQ(is["socket"]["mode"], "0660");
  EXPECT_EQ(is["socket"]["group"]["id"], 4242);
  EXPECT_EQ(is["socket"]["owner"]["name"], "root");
  EXPECT_EQ(is["user"]["connect"]["allowed"], false);
  EXPECT_EQ(ctl({"/free"}, nobody_).status, 5) << "the daemon decides the same";
  EXPECT_THAT(ctl({"/free"}).out, HasSubstr("mode 0660 of the socket"));
}

TEST_F(CtlAccess, RefusesBadInputWithAHint) {
  for (const Words& words : {Words{}, Words{"/a", "/b"}, Words{"/a//b"}, Words{"/a b"},
                             Words{"/" + std::string(300, 'x')}, Words{"/a", "--user"},
                             Words{"/a", "--user="}, Words{"/a", "--domain", "300"}}) {
    const CtlResult result = ctl(words);
    EXPECT_EQ(result.status, 2) << result.out << result.err;
    EXPECT_THAT(result.err, HasSubstr("\nhint: "));
    EXPECT_EQ(result.out, "");
  }
  const CtlResult stranger = ctl({"/a", "--user", "no such user"});
  EXPECT_EQ(stranger.status, 4);
  EXPECT_EQ(stranger.err,
            "agnocast-ctl: \"no such user\": this host has no such user\nhint: getent passwd\n");
  daemon_.kill();
  EXPECT_EQ(ctl({"/a"}).status, 3);
}

// More names than the answer has room for: for those that are cut off the answer says "more", not
// "denied".
TEST(CtlAccessOfMany, SaysMoreWhereTheAnswerIsCutOff) {
  std::string names;
  for (int uid = 50000; uid < 50200; ++uid) names += "\"uid:" + std::to_string(uid) + "\", ";
  const DaemonProcess daemon(
      {.config = "[[access]]\ntopic = \"/many\"\npublish = [" + names + "\"uid:60000\"]\n"});
  const auto of = [&](const char* user) {
    return run_ctl(daemon.socket_path(), {"access", "/many", "-j", "--user", user}).json();
  };
  EXPECT_EQ(of("50000")["publish"]["has_more"], true);
  EXPECT_EQ(of("50000")["user"]["publish"]["allowed"], true);
  EXPECT_EQ(of("60000")["user"]["publish"]["allowed"], nullptr);
}

}  // namespace
}  // namespace agnocast::test
