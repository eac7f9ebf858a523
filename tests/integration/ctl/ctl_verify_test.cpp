// SPDX-License-Identifier: Apache-2.0
//
// Goal: agnocast-ctl verify finds every kind of broken word and nothing else.
// Method: as ctl_test.cpp.

#include <tests/integration/ctl/ctl_node.hpp>
#include <tests/support/processes/ctl.hpp>
#include <tests/support/processes/daemon_process.hpp>

#include <gmock/gmock.h>
#include <signal.h>
#include <sys/stat.h>

#include <functional>
#include <map>
#include <string>
#include <vector>

namespace agnocast::test {
namespace {

using abi::Qos;
using testing::HasSubstr;
using testing::MatchesRegex;
using wire::Opcode;
using M = SharedMemory;
using Node = CtlNode;

/// A publisher with five messages, and a subscription that has taken three of them and holds two.
struct HonestPair {
  DaemonProcess daemon;
  Node a{daemon.socket_path()}, b{daemon.socket_path()};
  wire::EndpointCreated p, s;
  HonestPair() {
    a.open_window();
    p = a.publisher("/points");
    s = b.subscription("/points");
    a.commit(p, 5);
    b.link(s, p, 3, 2);
  }
  region::LinkWords<M> line() const { return {b.region.base(), s.extent, p.index}; }
  CtlResult verify(std::vector<std::string> options = {}) const {
    options.insert(options.begin(), "verify");
    return run_ctl(daemon.socket_path(), options);
  }
};

TEST(CtlVerify, HoldsForHonestProcesses) {
  const HonestPair pair;
  const CtlResult result = pair.verify();
  EXPECT_EQ(result.status, 0) << result.out << result.err;
  EXPECT_EQ(result.out, "every invariant holds: 2 processes, 1 topic, 1 queue at rest, 1 link\n");
}

// Long because it is the table of broken words.
TEST(CtlVerify, NamesEveryBrokenWordAndWhereItIs) {
  DaemonProcess daemon;
  Node a(daemon.socket_path()), b(daemon.socket_path());
  a.open_window();
  using Words = region::PublisherWords<M>;
  using Line = region::LinkWords<M>;
  struct Broken {
    std::string invariant;
    std::function<void(const Words&, std::uint64_t first, const Line&)> destroy;
  };
  // One topic each, before with an honest publisher (five messages) and an honest subscription
  // (three taken, two held).
  const Broken cases[] = {
      {"queue_head",
       [](auto& w, auto first, auto&) { w.head().store(abi::pack_entry(first - 1, 0)); }},
      {"queue_slot_committed", [](auto& w, auto first, auto&) { w.slot_id(9).store(first + 77); }},
      {"queue_slot_unique",
       [](auto& w, auto first, auto&) { w.slot_id(9).store(abi::retired_mark | (first + 2)); }},
      {"queue_order", [](auto& w, auto first,
                         auto&) { w.order(first + 500).store(abi::pack_entry(first + 500, 1)); }},
      {"queue_order_slot",
       [](auto& w, auto first, auto&) { w.order(first + 2).store(abi::pack_entry(first + 2, 4)); }},
      {"queue_intent_known", [](auto& w, auto, auto&) { w.intent_op().store(77); }},
      {"queue_address", [](auto& w, auto, auto&) { w.slot_address(2).store(4096); }},
      {"link_cursor", [](auto&, auto first, auto& l) { l.cursor().store(first + 50); }},
      {"link_unlinked_zero", [](auto&, auto, auto& l) { l.publisher_generation().store(0); }},
      {"link_generation", [](auto&, auto, auto& l) { l.publisher_generation().store(999); }},
      {"hold_slot_used", [](auto&, auto, auto& l) { l.hold(0).fetch_or(1 << 30); }},
      {"hold_behind_cursor", [](auto&, auto, auto& l) { l.hold(0).fetch_or(1 << 4); }},
  };
  std::map<std::string, std::string> wanted;  // topic to invariant
  std::vector<std::function<void()>> destroy;
  for (const Broken& broken : cases) {
    const std::string topic = "/" + broken.invariant;
    const auto p = a.publisher(topic);
    const auto s = b.subscription(topic);
    a.commit(p, 5);
    b.link(s, p, 3, 2);
    wanted[topic] = broken.invariant;
    destroy.push_back([&, p, s] {
      broken.destroy({a.region.base(), p.extent}, p.first_sequence,
                     {b.region.base(), s.extent, p.index});
    });
  }
  ASSERT_EQ(run_ctl(daemon.socket_path(), {"verify"}).status, 0)
      << "the processes are honest before";
  for (const auto& one : destroy) one();
  auto& header = *reinterpret_cast<abi::ClientRegionHeader*>(b.region.base());
  header.generation.store(12345);
  auto& window = reinterpret_cast<abi::ClientRegionHeader*>(a.region.base())->window[0];
  window.base.store(1);
  window.frontier.fetch_add(8);
  const CtlResult result = run_ctl(daemon.socket_path(), {"verify", "--json"});
  EXPECT_EQ(result.status, 6);
  EXPECT_THAT(result.err,
              MatchesRegex("agnocast-ctl: verify: [0-9]+ invariants are broken\nhint: .*\n"));
  const auto json = result.json();
  EXPECT_EQ(json["holds"], false);
  std::map<std::string, std::string> found;
  for (const auto& finding : json["broken"]) {
    const std::string where = finding["where"];
    const std::string place = where.substr(0, where.find(' '));
    if (place[0] == '/') {
      // A head that went back breaks all later words as well.
      if (place == "/queue_head" && finding["invariant"] != "queue_head") continue;
      const auto [known, fresh] = found.emplace(place, finding["invariant"]);
      EXPECT_TRUE(fresh || known->second == finding["invariant"]) << finding;
    } else {
      found[finding["invariant"]] = where;
    }
  }
  for (const auto& [topic, invariant] : wanted) EXPECT_EQ(found[topic], invariant);
  EXPECT_EQ(found.count("region_header"), 1u);
  EXPECT_EQ(found.count("window_header"), 1u);
  EXPECT_EQ(found.count("window_frontier"), 1u);
  EXPECT_EQ(found.size(), wanted.size() + 3) << json["broken"].dump(1);
  // The same as text.
  const CtlResult text = run_ctl(daemon.socket_path(), {"verify"});
  EXPECT_EQ(text.status, 6);
  EXPECT_THAT(text.out, HasSubstr("hold_slot_used: a held slot is in use (0x000000000000001e 0x"));
  EXPECT_THAT(text.out, HasSubstr("broken: /link_cursor subscription 0 (generation "));
}

// Apart from the others: a few seconds later the daemon revokes a process that holds too much.
TEST(CtlVerify, NamesASubscriptionThatHoldsTooMuch) {
  const HonestPair pair;
  pair.line().cursor().store(pair.p.first_sequence + 6);
  pair.line().hold(0).store(31);
  const auto json = pair.verify({"--json"}).json();
  ASSERT_EQ(json["broken"].size(), 1u) << json.dump(1);
  EXPECT_EQ(json["broken"][0]["invariant"], "hold_quota");
}

TEST(CtlVerify, ChecksTheQueuesOfDeadPublishers) {
  DaemonProcess daemon;
  Node watcher(daemon.socket_path());
  watcher.subscription("/topic");
  const pid_t pid = ::fork();
  if (pid == 0) {
    Node dying(daemon.socket_path());
    dying.open_window();
    const auto p = dying.publisher("/topic");
    dying.commit(p, 3);
    region::PublisherWords<M>{dying.region.base(), p.extent}.slot_id(1).store(p.first_sequence + 1);
    ::raise(SIGKILL);
  }
  ::waitpid(pid, nullptr, 0);
  watcher.wire.expect<wire::Announcement>(Opcode::announce);
  watcher.wire.expect<wire::Orphaned>(Opcode::orphaned);
  const CtlResult result = run_ctl(daemon.socket_path(), {"verify"});
  EXPECT_EQ(result.status, 6);
  EXPECT_THAT(result.out, HasSubstr("/topic publisher 0"));
  EXPECT_THAT(result.out, HasSubstr("pid " + std::to_string(pid)));
  EXPECT_THAT(result.out, HasSubstr("broken: "));
}

TEST(CtlVerify, ReportsNothingAboutWordsThatChange) {
  // A line that is never the same twice belongs to a working process, however odd it looks each
  // time.
  const HonestPair pair;
  const pid_t pid = ::fork();
  if (pid == 0) {
    for (std::uint64_t i = 0; ::getppid() != 1; ++i) {
      pair.line().cursor().store(pair.p.first_sequence + 100 + i);
      ::usleep(1000);
    }
    ::_exit(0);
  }
  const CtlResult result = pair.verify();
  ::kill(pid, SIGKILL);
  ::waitpid(pid, nullptr, 0);
  EXPECT_EQ(result.status, 0) << result.out;
}

}  // namespace
}  // namespace agnocast::test
