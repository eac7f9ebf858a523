// SPDX-License-Identifier: Apache-2.0
//
// Goal: each refusal is the same on both sides: a code of its own for the client, and one line of
// the daemon's log with that code and its details as fields. Method: for each bound and rule a
// real daemon that has it, a client that goes one step too far, its answer, and the log.
// client/api/bad_input_test.cpp covers the library's use of the codes.

#include <tests/integration/daemon/raw_node.hpp>

#include <gmock/gmock.h>

#include <memory>
#include <string>
#include <vector>

namespace agnocast::test {
namespace {

using testing::HasSubstr;
using wire::Opcode;
using Clients = std::vector<std::unique_ptr<WireClient>>;

WireClient& greeted(const DaemonProcess& daemon, Clients& clients) {
  clients.push_back(std::make_unique<WireClient>(daemon.socket_path()));
  EXPECT_EQ(clients.back()->hello().opcode(), Opcode::welcome);
  return *clients.back();
}

struct Case {
  std::string name;
  std::string config;
  Incoming (*provoke)(const DaemonProcess&, Clients&);
  Errc code;
  std::string fields;  // after pid and uid
};
void PrintTo(const Case& which, std::ostream* out) { *out << which.name; }

const Case cases[] = {
    {"clients", "[quota]\nclients = 1\n",
     [](const DaemonProcess& daemon, Clients& clients) {
       greeted(daemon, clients);
       // It may still observe, so the daemon waits for its first request.
       clients.push_back(std::make_unique<WireClient>(daemon.socket_path()));
       return clients.back()->hello();
     },
     Errc::quota_exceeded, "limit=\"[quota] clients\" value=1 used=1 asked=1 code=quota_exceeded"},
    {"topics", "[quota]\ntopics = 1\n",
     [](const DaemonProcess& daemon, Clients& clients) {
       WireClient& one = greeted(daemon, clients);
       EXPECT_EQ(one.create_publisher("/one").opcode(), Opcode::endpoint_created);
       return one.create_publisher("/two");
     },
     Errc::quota_exceeded,
     "topic=/two limit=\"[quota] topics\" value=1 used=1 asked=1 code=quota_exceeded"},
    {"publishers", "[quota]\npublishers = 1\n",
     [](const DaemonProcess& daemon, Clients& clients) {
       WireClient& one = greeted(daemon, clients);
       EXPECT_EQ(one.create_publisher("/one").opcode(), Opcode::endpoint_created);
       return one.create_publisher("/one");
     },
     Errc::quota_exceeded,
     "topic=/one limit=\"[quota] publishers\" value=1 used=1 asked=1 code=quota_exceeded"},
    {"subscriptions", "[quota]\nsubscriptions = 1\n",
     [](const DaemonProcess& daemon, Clients& clients) {
       WireClient& one = greeted(daemon, clients);
       EXPECT_EQ(one.open_wait_set().opcode(), Opcode::wait_set_opened);
       EXPECT_EQ(one.create_subscription("/one").opcode(), Opcode::endpoint_created);
       return one.create_subscription("/one");
     },
     Errc::quota_exceeded,
     "topic=/one limit=\"[quota] subscriptions\" value=1 used=1 asked=1 code=quota_exceeded"},
    {"held_messages", "[quota]\nheld_messages = 6\n",
     [](const DaemonProcess& daemon, Clients& clients) {
       WireClient& one = greeted(daemon, clients);
       EXPECT_EQ(one.open_wait_set().opcode(), Opcode::wait_set_opened);
       EXPECT_EQ(one.create_subscription("/one").opcode(), Opcode::endpoint_created);
       return one.create_subscription("/one");  // each holds four
     },
     Errc::quota_exceeded,
     "topic=/one limit=\"[quota] held_messages\" value=6 used=4 asked=4 code=quota_exceeded"},
    {"wait_sets", "[quota]\nwait_sets = 1\n",
     [](const DaemonProcess& daemon, Clients& clients) {
       WireClient& one = greeted(daemon, clients);
       EXPECT_EQ(one.open_wait_set(0).opcode(), Opcode::wait_set_opened);
       return one.open_wait_set(1);
     },
     Errc::quota_exceeded,
     "limit=\"[quota] wait_sets\" value=1 used=1 asked=1 code=quota_exceeded"},
    {"heap_bytes",
     "[heap]\nwindow_bytes = \"64MiB\"\narena_bytes = \"1GiB\"\n[quota]\nheap_bytes = \"64MiB\"\n",
     [](const DaemonProcess& daemon, Clients& clients) {
       WireClient& one = greeted(daemon, clients);
       EXPECT_EQ(one.open_window(0).opcode(), Opcode::window_opened);
       return one.open_window(1);
     },
     Errc::quota_exceeded,
     "limit=\"[quota] heap_bytes\" value=67108864 used=67108864 asked=67108864 "
     "code=quota_exceeded"},
    {"access_to_publish", "[[access]]\ntopic = \"/secret\"\npublish = []\n",
     [](const DaemonProcess& daemon, Clients& clients) {
       return greeted(daemon, clients).create_publisher("/secret");
     },
     Errc::access_denied, "topic=/secret code=access_denied"},
    {"access_to_subscribe", "[[access]]\ntopic = \"/secret\"\nsubscribe = []\n",
     [](const DaemonProcess& daemon, Clients& clients) {
       WireClient& one = greeted(daemon, clients);
       EXPECT_EQ(one.open_wait_set().opcode(), Opcode::wait_set_opened);
       return one.create_subscription("/secret");
     },
     Errc::access_denied, "topic=/secret code=access_denied"},
    {"limits_topics", "[limits]\ntopics = 1\n",
     [](const DaemonProcess& daemon, Clients& clients) {
       WireClient& one = greeted(daemon, clients);
       EXPECT_EQ(one.create_publisher("/one").opcode(), Opcode::endpoint_created);
       return one.create_publisher("/two");
     },
     Errc::limit_reached, "topic=/two code=limit_reached"},
    {"depth", "[limits]\ndepth_max = 5\n",
     [](const DaemonProcess& daemon, Clients& clients) {
       return greeted(daemon, clients).create_publisher("/deep", {6});
     },
     Errc::depth_refused, "topic=/deep code=depth_refused"},
};

class Refusal : public testing::TestWithParam<Case> {};

TEST_P(Refusal, HasOneCodeForTheClientAndInTheLog) {
  const Case& which = GetParam();
  const DaemonProcess daemon({.config = which.config});
  Clients clients;
  const Incoming answer = which.provoke(daemon, clients);
  EXPECT_EQ(answer.refused_code(), which.code) << answer.refused_text();
  const std::string line = "request refused pid=" + std::to_string(::getpid()) +
                           " uid=" + std::to_string(::geteuid()) + ' ' + which.fields +
                           " errno=0 why=\"";
  EXPECT_TRUE(daemon.wait_for_log(line)) << line << "\nis not in\n" << daemon.log();
}
INSTANTIATE_TEST_SUITE_P(Each, Refusal, testing::ValuesIn(cases),
                         [](const auto& which) { return which.param.name; });

// A user that has all connections and all observers is refused at accept, before it sends
// anything.
TEST(RefusalAtTheDoor, HasOneCodeForTheConnectionAndInTheLog) {
  const DaemonProcess daemon({.config = "[quota]\nclients = 1\n"});
  Clients clients;
  greeted(daemon, clients);
  for (std::uint32_t i = 0; i < abi::observer_count_max; ++i) {
    clients.push_back(std::make_unique<WireClient>(daemon.socket_path()));
    wire::Observe observe{};
    observe.fingerprint = abi::fingerprint();
    EXPECT_EQ(clients.back()->ask(Opcode::observe, observe).opcode(), Opcode::observed);
  }
  WireClient late(daemon.socket_path());
  EXPECT_EQ(late.next().refused_code(), Errc::quota_exceeded);
  const std::string line = "connection refused pid=" + std::to_string(::getpid()) +
                           " uid=" + std::to_string(::geteuid()) +
                           " limit=\"[quota] clients\" value=1 used=1 asked=1 code=quota_exceeded";
  EXPECT_TRUE(daemon.wait_for_log(line)) << daemon.log();
}

TEST(RefusalOfAnObserver, HasOneCodeForTheObserverAndInTheLog) {
  const DaemonProcess daemon;
  Clients clients;
  wire::Observe observe{};
  observe.fingerprint = abi::fingerprint();
  for (std::uint32_t i = 0; i < abi::observer_count_max; ++i) {
    clients.push_back(std::make_unique<WireClient>(daemon.socket_path()));
    EXPECT_EQ(clients.back()->ask(Opcode::observe, observe).opcode(), Opcode::observed);
  }
  WireClient late(daemon.socket_path());
  EXPECT_EQ(late.ask(Opcode::observe, observe).refused_code(), Errc::quota_exceeded);
  const std::string count = std::to_string(abi::observer_count_max);
  EXPECT_TRUE(daemon.wait_for_log("limit=observers value=" + count + " used=" + count +
                                  " asked=1 code=quota_exceeded"))
      << daemon.log();
}

// The kernel refuses before the daemon notices: there is no log line, and no other counter
// changes.
TEST(RefusalByTheSocket, HasItsOwnCodeAndDoesNotReachTheDaemon) {
  if (::geteuid() != 0) GTEST_SKIP() << "needs root to become another user";
  const DaemonProcess daemon({.config = "[daemon]\nsocket_mode = \"0600\"\n"});
  EXPECT_EQ(in_other_user([&] {
              const auto socket = PacketSocket::connect(daemon.socket_path());
              return !socket && socket.error().code == Errc::permission_denied &&
                             socket.error().os_errno == EACCES
                         ? 0
                         : 1;
            }),
            0);
  Clients clients;
  greeted(daemon, clients);
  EXPECT_EQ(daemon.log().find("refused"), std::string::npos) << daemon.log();
}

}  // namespace
}  // namespace agnocast::test
