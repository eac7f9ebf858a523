// SPDX-License-Identifier: Apache-2.0
//
// Goal: whatever is wrong with a process, or between two of them, doctor names exactly that, and
// its remedy repairs it. Method: raw clients in processes of their own, which break themselves.
//
// A remedy that restarts a process would start this test program, as that is the running one; the
// test runs only the part that ends the process. doctor_live_test.cpp runs such remedies
// completely.

#include <tests/support/machine/doctored.hpp>
#include <tests/support/node_process.hpp>

#include <gmock/gmock.h>
#include <sched.h>
#include <signal.h>
#include <sys/mman.h>
#include <sys/resource.h>
#include <sys/wait.h>

#include <string>
#include <vector>

namespace agnocast::test {
namespace {

using abi::Qos;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::StartsWith;
using Node = CtlNode;

class DoctorProcesses : public testing::Test {
 protected:
  DoctorProcesses() : daemon_({.config = "", .more_config = ""}), doctor_(daemon_.socket_path()) {}
  void SetUp() override {
    if (!Doctored::has_namespaces()) GTEST_SKIP() << "needs root: a mount namespace";
  }
  const std::string& socket() const { return daemon_.socket_path(); }
  std::string environment() const { return "AGNOCAST_SOCKET=" + socket(); }
  bool is_well() {
    return soon([&] { return doctor_.look().all.empty(); });
  }
  static std::string first_part(const std::string& remedy) {
    return remedy.substr(0, remedy.find(" && "));
  }

  DaemonProcess daemon_;
  Doctored doctor_;
};

TEST_F(DoctorProcesses, FindsNothingWhereMessagesArrive) {
  Node a(socket()), b(socket());
  a.open_window();
  const auto p = a.publisher("/points", {7}, "/lidar");
  const auto s = b.subscription("/points", {5}, "/viewer");
  a.commit(p, 4);
  b.link(s, p, 4, 1);
  const Findings findings = doctor_.look({}, {"-w"});
  EXPECT_THAT(findings.all, IsEmpty());
  EXPECT_EQ(findings.result.status, 0);
}

TEST_F(DoctorProcesses, NamesAStoppedProcess) {
  const NodeProcess process(socket(), [](Node& node) { node.publisher("/points"); });
  EXPECT_THAT(doctor_.look().all, IsEmpty());
  process.kill(SIGSTOP);
  ASSERT_TRUE(soon([&] { return !doctor_.look().all.empty(); }));
  const Findings findings = doctor_.look();
  const std::string pid = std::to_string(process.pid());
  ASSERT_THAT(findings.all, ElementsAre("process-stopped: wire_client (pid " + pid + ", uid " +
                                        std::to_string(::geteuid()) + ") is stopped"));
  EXPECT_EQ(findings.remedies[0], "kill -CONT " + pid);
  const Remedy remedy(findings.remedies[0]);
  EXPECT_TRUE(is_well());
}

TEST_F(DoctorProcesses, NamesAProcessWithoutAConnection) {
  NodeProcess process(socket(), [](Node& node) {
    node.publisher("/points");
    node.wire.socket().close();
  });
  ASSERT_TRUE(soon([&] { return !doctor_.look().all.empty(); }));
  const Findings findings = doctor_.look();
  ASSERT_THAT(findings.ids(), ElementsAre("process-orphaned"));
  const Remedy remedy(findings.remedies[0]);
  EXPECT_EQ(process.wait(), -SIGTERM);
  EXPECT_TRUE(is_well());
}

TEST_F(DoctorProcesses, NamesARevokedProcess) {
  NodeProcess process(socket(), [](Node& node) { node.publisher("/points"); });
  ASSERT_EQ(run_ctl(socket(), {"process", "revoke", "-j", std::to_string(process.pid())}).status,
            0);
  ASSERT_TRUE(soon([&] { return !doctor_.look().all.empty(); }));
  const Findings findings = doctor_.look();
  ASSERT_THAT(findings.ids(), ElementsAre("process-revoked"));
  const Remedy remedy(first_part(findings.remedies[0]));
  EXPECT_EQ(process.wait(), -SIGTERM);
  EXPECT_TRUE(is_well());
}

TEST_F(DoctorProcesses, NamesAProcessThatKeepsTheMemoryOfTheDead) {
  NodeProcess publisher(socket(), [](Node& node) {
    node.open_window();
    node.commit(node.publisher("/points", {7}, "/lidar"), 2);
  });
  // In the order of creation, each the first of its topic.
  const auto of = [&](const char* kind) {
    return run_ctl(socket(), {"topic", "info", "/points", "-j"}).json()[kind][0];
  };
  wire::EndpointCreated published{};
  published.index = 0;
  published.generation = of("publishers")["generation"];
  NodeProcess holder(socket(), [&](Node& node) {
    const auto own = node.subscription("/points", {5}, "/viewer");
    const auto announcement = node.wire.expect<wire::Announcement>(wire::Opcode::announce);
    published.first_sequence = announcement.first_sequence;
    node.link(own, published, 2, 1);
  });
  EXPECT_THAT(doctor_.look().all, IsEmpty());
  publisher.kill();
  publisher.wait();
  ASSERT_TRUE(soon([&] { return !doctor_.look().all.empty(); }));
  const Findings findings = doctor_.look();
  ASSERT_THAT(findings.ids(), ElementsAre("dead-kept"));
  EXPECT_THAT(findings.all[0],
              HasSubstr("/viewer of wire_client (pid " + std::to_string(holder.pid()) + ", uid " +
                        std::to_string(::geteuid()) + ") holds 1 message of /points"));
  const Remedy remedy(first_part(findings.remedies[0]));
  EXPECT_EQ(holder.wait(), -SIGTERM);
  EXPECT_TRUE(is_well());
}

// Root may lock any amount.
TEST_F(DoctorProcesses, NamesAProcessThatMayNotLockMoreMemory) {
  constexpr uid_t nobody = 65534;
  ASSERT_EQ(::chmod(daemon_.socket_path().c_str(), 0666), 0);
  const NodeProcess process(socket(), [](Node& node) {
    node.publisher("/points");
    const rlimit limit{1 << 20, 1 << 20};
    const std::size_t bytes = 1 << 16;
    void* const memory =
        ::mmap(nullptr, bytes, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
    EXPECT_EQ(::mlock(memory, bytes), 0);
    EXPECT_EQ(::setrlimit(RLIMIT_MEMLOCK, &limit), 0);
    EXPECT_EQ(::setresuid(nobody, nobody, 0), 0) << "the daemon's root, the kernel's nobody";
    EXPECT_EQ(::prctl(PR_SET_DUMPABLE, 1), 0);
  });
  const Findings findings = doctor_.look();
  ASSERT_THAT(findings.ids(), ElementsAre("lock-limit"));
  EXPECT_THAT(findings.all[0], HasSubstr("has locked 64.0 KiB of at most 1.0 MiB"));
  EXPECT_EQ(findings.remedies[0],
            "sudo prlimit --pid " + std::to_string(process.pid()) + " --memlock=unlimited");
  if (!may_raise_limits()) GTEST_SKIP() << "the remedy needs CAP_SYS_RESOURCE";
  const Remedy remedy(findings.remedies[0]);
  EXPECT_EQ(remedy.status(), 0);
  EXPECT_TRUE(is_well());
}

TEST_F(DoctorProcesses, NamesAProcessWithoutFreeAddresses) {
  const NodeProcess process(socket(), [](Node& node) {
    node.publisher("/points");
    rlimit limit{};
    EXPECT_EQ(::getrlimit(RLIMIT_AS, &limit), 0);
    limit.rlim_cur = rlim_t{2} << 30;  // its region alone is half of that
    EXPECT_EQ(::setrlimit(RLIMIT_AS, &limit), 0);
  });
  const Findings findings = doctor_.look();
  ASSERT_THAT(findings.ids(), ElementsAre("address-limit"));
  EXPECT_EQ(findings.remedies[0],
            "sudo prlimit --pid " + std::to_string(process.pid()) + " --as=unlimited");
  const Remedy remedy(findings.remedies[0]);
  EXPECT_TRUE(is_well());
}

TEST_F(DoctorProcesses, NamesAProcessWithOtherClocks) {
  if (Child([] { return ::unshare(CLONE_NEWTIME) == 0 ? 0 : 1; }).wait() != 0)
    GTEST_SKIP() << "this kernel has no time namespaces, or permits none";
  // The children of a process that asks for a time namespace are in it; the process itself is not.
  Child outer([&] {
    ::prctl(PR_SET_PDEATHSIG, SIGKILL);
    if (::unshare(CLONE_NEWTIME) != 0) return 1;
    const NodeProcess process(socket(), [](Node& node) { node.publisher("/points"); });
    return sleep_for_ever();
  });
  ASSERT_TRUE(soon([&] {
    return run_ctl(socket(), {"processes", "-j"}).json()["process_count"] == 1;
  }));
  const Findings findings = doctor_.look();
  ASSERT_THAT(findings.ids(), ElementsAre("time-namespace"));
  const Remedy remedy(first_part(findings.remedies[0]));
  EXPECT_TRUE(is_well());
}

TEST_F(DoctorProcesses, NamesADuplicateNode) {
  const NodeProcess first(socket(), [](Node& node) { node.publisher("/points", {7}, "/lidar"); });
  Node own(socket());
  own.publisher("/points", {7}, "/viewer");
  own.other_domain = 7;
  own.publisher("/points", {7}, "/lidar");
  EXPECT_THAT(doctor_.look().all, IsEmpty());
  NodeProcess second(socket(), [](Node& node) { node.publisher("/points", {7}, "/lidar"); });
  const Findings findings = doctor_.look();
  ASSERT_THAT(findings.ids(), ElementsAre("same-node"));
  EXPECT_EQ(findings.remedies[0], "kill " + std::to_string(second.pid())) << "the later one";
  const Remedy remedy(findings.remedies[0]);
  second.wait();
  EXPECT_TRUE(is_well());
}

TEST_F(DoctorProcesses, NamesQualitiesThatDoNotMatch) {
  Node a(socket()), b(socket());
  const Qos reliable{5, false, true, false, false}, best_effort{5, false, false, false, false};
  a.publisher("/points", best_effort, "/lidar");
  b.subscription("/points", reliable, "/viewer");
  const Findings findings = doctor_.look();
  const std::string process = " of wire_client (pid " + std::to_string(::getpid()) + ", uid " +
                              std::to_string(::geteuid()) + ")";
  ASSERT_THAT(findings.all,
              ElementsAre("qos-mismatch: /points: /lidar" + process + " -> /viewer" + process +
                          ": reliable is requested, best effort is offered"));
  const Remedy remedy(findings.remedies[0], {environment()});
  EXPECT_EQ(remedy.status(), 0) << findings.remedies[0];
}

TEST_F(DoctorProcesses, NamesAProcessWithAnotherTypeOrLibrary) {
  {
    Node a(socket());
    a.publisher("/points");
    auto other = WireClient::endpoint("/points", {5}, "other/msg/Type");
    ASSERT_EQ(a.wire.ask(wire::Opcode::create_publisher, other).refused_code(),
              Errc::type_mismatch);
    const Findings findings = doctor_.look();
    ASSERT_THAT(findings.ids(), ElementsAre("type-mismatch"));
    EXPECT_THAT(findings.all[0], HasSubstr("other/msg/Type"));
    const Remedy remedy(findings.remedies[0], {environment()});
    EXPECT_EQ(remedy.status(), 0) << findings.remedies[0];
  }
  DaemonProcess daemon;
  Doctored doctor(daemon.socket_path());
  WireClient client(daemon.socket_path());
  ASSERT_EQ(client.hello(abi::fingerprint() ^ 1).refused_code(), Errc::layout_mismatch);
  const Findings findings = doctor.look();
  ASSERT_THAT(findings.ids(), ElementsAre("library-mismatch"));
  EXPECT_THAT(findings.remedies[0], StartsWith("kill " + std::to_string(::getpid()) + " && "));
}

TEST_F(DoctorProcesses, NamesTheRuleThatRefusedARequest) {
  DaemonProcess daemon(
      {.config = "[daemon]\nsocket_mode = \"0666\"\n[[access]]\ntopic = \"/x\"\npublish = [\"*\"]\n"
                 "[[access]]\ntopic = \"/lidar/**\"\npublish = [\"uid:4711\"]\n"});
  Doctored doctor(daemon.socket_path());
  Node a(daemon.socket_path());
  ASSERT_EQ(a.wire.create_publisher("/lidar/points").refused_code(), Errc::access_denied);
  const Findings findings = doctor.look();
  ASSERT_THAT(findings.ids(), ElementsAre("permission"));
  EXPECT_THAT(findings.remedies[0], StartsWith("sudo \"${EDITOR:-vi}\" +6 " + daemon.directory() +
                                               "/agnocastd.toml && "));
}

TEST_F(DoctorProcesses, NamesPairsThatAreNotZeroCopyOrCannotConnect) {
  Node a(socket()), b(socket());
  a.open_window();
  const auto p = a.publisher("/points", {7}, "/lidar");
  const auto s = b.subscription("/points", {5}, "/viewer");
  a.commit(p, 3);
  b.link(s, p, 3, 0);
  auto& endpoint = *reinterpret_cast<abi::PublisherEndpoint*>(a.region.base() + p.extent);
  endpoint.adopted_messages.store(2);
  endpoint.adopted_bytes.store(2048);
  Findings findings = doctor_.look();
  ASSERT_THAT(findings.ids(), ElementsAre("not-zero-copy"));
  EXPECT_THAT(findings.remedies[0], HasSubstr("agnocast-run --scope all "));
  endpoint.adopted_messages.store(0);
  const region::SubscriptionWords<SharedMemory> counters{b.region.base(), s.extent};
  counters.counter(offsetof(abi::SubscriptionCounters, unreachable)).store(4);
  findings = doctor_.look();
  ASSERT_THAT(findings.ids(), ElementsAre("unreachable"));
}

TEST_F(DoctorProcesses, NamesAWithdrawnSubscription) {
  Node a(socket()), b(socket());
  a.open_window();
  const auto p = a.publisher("/points", {7}, "/lidar");
  const auto s = b.subscription("/points", {5}, "/viewer");
  b.link(s, p, 0, 0);
  const region::PublisherWords<SharedMemory> words{a.region.base(), p.extent};
  words.withdrawn(s.index).store(abi::pack_withdrawal(s.index, abi::Withdrawal::over_share));
  const Findings findings = doctor_.look();
  ASSERT_THAT(findings.ids(), ElementsAre("reader-withdrawn"));
  EXPECT_THAT(findings.all[0], HasSubstr("the publisher reports that its user kept too much"));
  words.withdrawn(s.index).store(0);
  EXPECT_TRUE(is_well());
}

TEST_F(DoctorProcesses, NamesASubscriptionThatReadsTooSlowlyOrHoldsTooMuch) {
  Node a(socket());
  a.open_window();
  const auto p = a.publisher("/points", {20}, "/lidar");
  a.commit(p, 11);
  NodeProcess reader(socket(), [&](Node& node) {
    const auto s = node.subscription("/points", {10}, "/viewer");
    node.link(s, p, 2, 0);  // 9 of 10 unread
    const region::SubscriptionWords<SharedMemory> counters{node.region.base(), s.extent};
    counters.counter(offsetof(abi::SubscriptionCounters, lost)).store(5);
  });
  Findings findings = doctor_.look();
  ASSERT_THAT(findings.ids(), ElementsAre("slow-reader"));
  EXPECT_THAT(findings.all[0], HasSubstr("has lost 5 messages of /points and has not read 9"));
  reader.kill();
  reader.wait();
  EXPECT_TRUE(is_well());
  NodeProcess holder(socket(), [&](Node& node) {
    const auto s = node.subscription("/points", {10}, "/viewer");
    node.link(s, p, 11, 4);  // its quota
  });
  findings = doctor_.look();
  ASSERT_THAT(findings.ids(), ElementsAre("holder-at-quota"));
  EXPECT_THAT(findings.all[0], HasSubstr("holds all 4 messages of /points that it may hold"));
  const Remedy remedy(findings.remedies[0], {environment()});
  EXPECT_EQ(remedy.status(), 0) << findings.remedies[0];
  EXPECT_TRUE(soon([&] {
    return doctor_.look().ids() == std::vector<std::string>{"process-revoked"};
  })) << "doctor says that it has to be restarted";
}

TEST_F(DoctorProcesses, NamesAMuteSubscription) {
  Node a(socket());
  a.open_window();
  a.publisher("/points", {20}, "/lidar");
  NodeProcess reader(socket(), [&](Node& node) {
    node.subscription("/points", {10}, "/viewer");
    node.doorbells.clear();
  });
  ASSERT_TRUE(soon([&] { return !doctor_.look().all.empty(); }));
  const Findings findings = doctor_.look();
  ASSERT_THAT(findings.ids(), ElementsAre("no-doorbell"));
  EXPECT_THAT(
      findings.all[0],
      HasSubstr("/viewer of wire_client (pid " + std::to_string(reader.pid()) + ", uid " +
                std::to_string(::geteuid()) + ") finds messages of /points only by polling"));
  EXPECT_THAT(run_ctl(socket(), {"topic", "info", "-v", "/points"}).out,
              HasSubstr("Doorbell: none"));
  const Remedy remedy(first_part(findings.remedies[0]));
  EXPECT_EQ(reader.wait(), -SIGTERM);
  EXPECT_TRUE(is_well());
}

TEST_F(DoctorProcesses, NamesAProcessWithAFullHeap) {
  DaemonProcess daemon({.more_config = "windows_per_process = 1\n"});
  Doctored doctor(daemon.socket_path());
  Node a(daemon.socket_path());
  a.open_window();
  a.publisher("/points");
  EXPECT_THAT(doctor.look().all, IsEmpty());
  reinterpret_cast<abi::ClientRegionHeader*>(a.region.base())
      ->window[0]
      .frontier.store(a.window.bytes - (std::uint64_t{1} << 20));
  const Findings findings = doctor.look();
  ASSERT_THAT(findings.ids(), ElementsAre("heap-full"));
  EXPECT_THAT(findings.all[0], HasSubstr("uses 63.0 MiB of 64.0 MiB in all 1 window"));
  EXPECT_THAT(findings.remedies[0], HasSubstr("window_bytes = 134217728/"));
}

}  // namespace
}  // namespace agnocast::test
