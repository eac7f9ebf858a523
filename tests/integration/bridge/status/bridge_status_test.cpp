// SPDX-License-Identifier: Apache-2.0
//
// Goal: a bridge's status socket serves every client, also beside one that never reads, and
// without memory or descriptors; two bridges of a domain report which of them is on standby.
// Method: as bridge_ctl_test.cpp.

#include <tests/integration/bridge/status/bridge_ctl.hpp>
#include <tests/support/processes/lowered_limit.hpp>

namespace agnocast::bridge {
namespace {

TEST_F(BridgeCtl, IsOneOfADomainAndReplacesADeadOne) {
  auto running = bridge(domain->id());
  SteeredProcess second({AGNOCAST_BRIDGE, "--domain", std::to_string(domain->id())}, {});
  EXPECT_EQ(second.finish(), 1);
  running.reset();  // SIGKILL: the socket stays
  EXPECT_EQ(ctl({"list"}).status, 3) << "nobody listens at the remaining socket";
  running = bridge(domain->id());
  EXPECT_EQ(ctl({"list"}).status, 0);
}

TEST_F(BridgeCtl, AClientThatDoesNotReadDelaysNobodyAndAnIdleBridgeSleeps) {
  const auto running = bridge(domain->id());
  std::vector<UniqueFd> idle;
  for (int i = 0; i < 100; ++i) {
    idle.emplace_back(::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0));
    ASSERT_EQ(::connect(idle.back().get(), unix_address(socket_of(domain->id()))->get(),
                        UnixAddress::size()),
              0);
  }
  EXPECT_EQ(ctl({"list", "-d", "0.1"}).status, 0);
  idle.clear();
  const auto pid = ctl({"list", "-d", "0.1", "-j"}).json()["bridges"][0]["pid"].get<int>();
  const auto wakes = [&] {
    std::ifstream status("/proc/" + std::to_string(pid) + "/status");
    for (std::string line; std::getline(status, line);) {
      if (line.starts_with("voluntary_ctxt_switches:")) return std::stol(line.substr(24));
    }
    return -1L;
  };
  // Discovery of this machine's other participants may still arrive.
  EXPECT_TRUE(soon([&] {
    const long before = wakes();
    std::this_thread::sleep_for(2s);
    return before >= 0 && wakes() - before <= 2;
  }));
}

TEST_F(BridgeCtl, AClientThatNeverReadsGivesUpItsPlaceToOneThatDoes) {
  // Larger than a socket's buffer; small enough to be read in five seconds on a busy machine.
  const std::string text(1 << 20, 'x');
  const std::string path = socket_of(102);
  auto socket = StatusSocket::take(path);
  ASSERT_TRUE(socket) << socket.error().why;
  ASSERT_TRUE((*socket)->listen([&] { return text; }));
  // Each of the 16 places is lost after five seconds anyway: with so many before it, the last one
  // would wait for two minutes. Those that lose it to the next one have it for a tenth of a second.
  const auto began = Clock::now();
  std::vector<UniqueFd> silent;
  for (int i = 0; i < 400; ++i) {
    silent.emplace_back(::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0));
    ASSERT_EQ(::connect(silent.back().get(), unix_address(path)->get(), UnixAddress::size()), 0);
  }
  EXPECT_EQ(status_of(path).size(), text.size());
  EXPECT_LT(Clock::now() - began, 100s);
}

TEST_F(BridgeCtl, ALackOfMemoryCostsOneStatusAndTheNextIsAnswered) {
  const std::string path = socket_of(104);
  auto socket = StatusSocket::take(path);
  ASSERT_TRUE(socket) << socket.error().why;
  ASSERT_TRUE((*socket)->listen([has_memory = false]() mutable {
    if (!std::exchange(has_memory, true)) throw std::bad_alloc();
    return std::string("here");
  }));
  EXPECT_EQ(status_of(path), "");
  EXPECT_EQ(status_of(path), "here");
}

TEST_F(BridgeCtl, ABridgeWithoutDescriptorsSleepsUntilItHasSome) {
  const auto running = bridge(domain->id());
  const std::string process = "/proc/" + std::to_string(running->pid());
  test::LoweredLimit limit(running->pid(), RLIMIT_NOFILE, 3);
  const UniqueFd client(::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0));
  ASSERT_EQ(
      ::connect(client.get(), unix_address(socket_of(domain->id()))->get(), UnixAddress::size()),
      0);
  const auto used_ns = [&] {
    std::uint64_t sum = 0;
    for (const auto& task : std::filesystem::directory_iterator(process + "/task")) {
      std::uint64_t own = 0;
      std::ifstream(task.path() / "schedstat") >> own;
      sum += own;
    }
    return sum;
  };
  // A busy loop would use seconds of CPU time.
  const std::uint64_t at_first = used_ns();
  std::this_thread::sleep_for(3s);
  EXPECT_LT(used_ns() - at_first, 300'000'000u);
  limit.lift();
  char first = 0;
  EXPECT_EQ(::read(client.get(), &first, 1), 1) << "the client has waited";
}

TEST_F(BridgeCtl, NamesTheStandbyBridgeAndItsLosses) {
  const std::string path = socket_of(103);
  auto socket = StatusSocket::take(path);
  ASSERT_TRUE(socket) << socket.error().why;
  ASSERT_TRUE((*socket)->listen([] {
    return std::string(
        R"({"schema":"agnocast.bridge-status/1","version":"1","pid":12,"domain":7,"uptime_ns":1,)"
        R"("discovery_info":"iron","participants":0,"has_daemon":true,"standby_for":11,)"
        R"("announced":6,"lost_early":3,"discovery_info_refused":4,)"
        R"("limits":[{"limit":"endpoints","most":9,"refused":7},{"limit":"x","most":1,"refused":0}],)"
        R"("dds_writers":[],"remote_publishers":[],)"
        R"("local_readers":[{"topic":"/t","type":"p/msg/T","lost":5,"qos":{"reliability":"reliable",)"
        R"("durability":"volatile","history":"keep_last","depth":2}}],)"
        R"("dds_readers":[{"topic":"/i","type":"p/msg/T","nodes":[],"guid":"0","qos":{)"
        R"("reliability":"reliable","durability":"volatile","history":"keep_last","depth":2},)"
        R"("matched":0,"incompatible":0,"malformed":0,"without_remote_publisher":0,"overflow":8}],)"
        R"("services":[],"unbridged":[],"failures":[]})");
  }));
  const std::string text = ctl({"list", "-d", "0.05"}).out;
  EXPECT_THAT(text, HasSubstr("the bridge of domain 7 (pid 12) is on standby for pid 11"));
  EXPECT_THAT(text, HasSubstr("has lost 3 messages of publishers"));
  const auto said = ctl({"list", "-d", "0.05", "-j"}).json()["bridges"][0];
  EXPECT_EQ(said["standby_for"], 11);
  EXPECT_EQ(said["lost_early"], 3);
  EXPECT_THAT(text, HasSubstr("has refused 4 messages about nodes in DDS"));
  EXPECT_EQ(said["discovery_info_refused"], 4);
  EXPECT_THAT(text, HasSubstr("announces 6 publishers in DDS without a reader there"));
  EXPECT_EQ(said["announced"], 6);
  EXPECT_THAT(text, HasSubstr("has refused 7 beyond the limit endpoints (9)"));
  EXPECT_THAT(text, testing::Not(HasSubstr("limit x")));
  EXPECT_EQ(said["limits"].size(), 2u);
  ASSERT_EQ(said["routes"].size(), 2u);
  EXPECT_EQ(said["routes"][0]["topic"], "/i");
  EXPECT_EQ(said["routes"][0]["overflow"], 8);
  EXPECT_THAT(text, HasSubstr("/i")) << "a route that only drops is shown";
  const auto dds_reader = ctl({"info", "/i", "-j"}).json()["bridges"][0]["dds_readers"][0];
  EXPECT_EQ(dds_reader["overflow"], 8);
  EXPECT_THAT(
      ctl({"info", "/i"}).out,
      HasSubstr("Dropped: 0 malformed, 0 of writers without a publisher here, 8 over a limit"));
  EXPECT_EQ(said["routes"][1]["lost"], 5);
  EXPECT_THAT(ctl({"info", "/t"}).out,
              HasSubstr("Lost on the way to DDS: 5 messages (reliable, volatile, keep_last 2)"));
}

TEST_F(BridgeCtl, RefusesAnswersThatNoBridgeGives) {
  const std::string path = socket_of(101);
  const auto says = [&](const std::string& text, bool ends) {
    ::unlink(path.c_str());
    const UniqueFd listener(::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0));
    EXPECT_EQ(::bind(listener.get(), unix_address(path)->get(), UnixAddress::size()), 0);
    EXPECT_EQ(::listen(listener.get(), 1), 0);
    std::thread server([&] {
      const UniqueFd client(::accept4(listener.get(), nullptr, nullptr, SOCK_CLOEXEC));
      for (std::size_t at = 0; at < text.size();) {
        const ssize_t sent = ::send(client.get(), text.data() + at, text.size() - at, MSG_NOSIGNAL);
        if (sent <= 0) break;
        at += static_cast<std::size_t>(sent);
      }
      char end = 0;
      if (!ends) (void)!::read(client.get(), &end, 1);  // until ctl gives up
    });
    const CtlResult result = ctl({"list", "-j"});
    server.join();
    ::unlink(path.c_str());
    EXPECT_THAT(result.out, "") << text.substr(0, 80);
    return result.status;
  };
  const std::string right =
      R"({"schema":"agnocast.bridge-status/1","version":"1","pid":1,"domain":1,"uptime_ns":1,)"
      R"("discovery_info":"iron","participants":0,"has_daemon":true,"dds_writers":[],"remote_publishers":[],)"
      R"("local_readers":[],"dds_readers":[],"services":[],"unbridged":[],"failures":[)";
  for (const std::string& lie :
       {std::string("hello"), std::string("[]"), std::string("{\"schema\":1}"),
        std::string(200'000, '['), right + "{\"what\":1,\"why\":\"\"}]}",
        right + "{\"what\":\"" + std::string(5000, 'x') + "\",\"why\":\"\"}]}",
        std::string(right).replace(right.find("\"pid\":1"), 7, "\"pid\":-1") + "]}",
        std::string(right).replace(right.find("\"domain\":1"), 10, "\"domain\":999") + "]}",
        right + "]", std::string(20 << 20, ' ')})
    EXPECT_EQ(says(lie, true), 1) << lie.substr(0, 300);
  EXPECT_EQ(says("", true), 124) << "busy";
  EXPECT_EQ(says("{", false), 124) << "never ends";
}

}  // namespace
}  // namespace agnocast::bridge
