// SPDX-License-Identifier: Apache-2.0
//
// Goal: doctor finds nothing in a healthy system, and exactly the fault of one broken program, and
// its remedy, run completely, repairs the program. Method: the installed examples with the real
// hook.

#include <tests/support/machine/doctored.hpp>
#include <tests/support/processes/steered_process.hpp>

#include <gmock/gmock.h>

#include <filesystem>
#include <string>
#include <vector>

namespace agnocast::test {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;

class DoctorLive : public testing::Test {
 protected:
  DoctorLive() : doctor_(daemon_.socket_path()) {}
  void SetUp() override {
    if (!Doctored::has_namespaces()) GTEST_SKIP() << "needs root: a mount namespace";
  }
  std::vector<std::string> with(std::vector<std::string> variables) const {
    variables.push_back("AGNOCAST_SOCKET=" + daemon_.socket_path());
    return variables;
  }
  bool is_published() {
    const CtlResult info = run_ctl(daemon_.socket_path(), {"topic", "info", "/chatter", "-j"});
    if (info.status != 0) return false;
    const auto publishers = info.json()["publishers"];
    return !publishers.empty() && publishers[0]["published_messages"] > 3;
  }
  bool is_subscribed() {
    const CtlResult info = run_ctl(daemon_.socket_path(), {"topic", "info", "/chatter", "-j"});
    return info.status == 0 && !info.json()["subscriptions"].empty();
  }
  bool has_processes(std::size_t count) {
    return soon([&] {
      return run_ctl(daemon_.socket_path(), {"processes", "-j"}).json()["process_count"] == count;
    });
  }
  bool finds_nothing() {
    return soon([&] { return doctor_.look().all.empty(); });
  }

  DaemonProcess daemon_;
  Doctored doctor_;
  const std::string talker_ = AGNOCAST_EXAMPLES "/talker",
                    listener_ = AGNOCAST_EXAMPLES "/listener";
};

TEST_F(DoctorLive, FindsNothingWhereMessagesArrive) {
  const SteeredProcess listener({listener_}, with({})), other({listener_}, with({}));
  const SteeredProcess talker({talker_, "--rate", "50"}, with({"LD_PRELOAD=" AGNOCAST_HOOK}));
  ASSERT_TRUE(soon([&] { return is_published(); }));
  // Two listeners are two nodes of one name.
  EXPECT_THAT(doctor_.look().ids(), ElementsAre("same-node"));
  const Remedy remedy(doctor_.look().remedies[0]);
  ASSERT_TRUE(finds_nothing());
  const Findings findings = doctor_.look({}, {"-w"});
  EXPECT_THAT(findings.all, IsEmpty());
  EXPECT_EQ(findings.result.status, 0) << findings.result.err;
}

TEST_F(DoctorLive, ReportsThatTheLoaderSkippedTheHook) {
  const SteeredProcess listener({listener_, "--count", "3"},
                                with({"LD_PRELOAD=/nonexistent/libagnocast_heaphook.so"}));
  ASSERT_TRUE(has_processes(1));
  const Findings findings = doctor_.look();
  ASSERT_THAT(findings.ids(), ElementsAre("hook-not-loaded"));
  EXPECT_EQ(findings.remedies[0], "kill " + std::to_string(listener.pid()) + " && agnocast-run " +
                                      listener_ + " --count 3 &");
}

TEST_F(DoctorLive, ReportsThatAnUpdateAwaitsTheRestartOfAProcess) {
  const std::string directory = make_directory(), hook = directory + "/libagnocast_heaphook.so";
  std::filesystem::copy_file(AGNOCAST_HOOK, hook);
  {
    const SteeredProcess talker({talker_, "--rate", "50"}, with({"LD_PRELOAD=" + hook}));
    ASSERT_TRUE(soon([&] { return is_published(); }));
    EXPECT_THAT(doctor_.look().all, IsEmpty());
    std::filesystem::copy_file(AGNOCAST_HOOK, hook + ".new");
    std::filesystem::rename(hook + ".new", hook);
    const Findings findings = doctor_.look();
    ASSERT_THAT(findings.ids(), ElementsAre("old-library"));
    EXPECT_THAT(findings.all[0], HasSubstr(hook));
    const Remedy remedy(findings.remedies[0], with({"LD_PRELOAD=" + hook}));
    EXPECT_TRUE(finds_nothing());
    EXPECT_TRUE(soon([&] { return is_published(); }));
  }
  remove_directory(directory);
}

TEST_F(DoctorLive, NamesAProcessThatIsSwitchedOff) {
  const SteeredProcess listener({listener_}, with({"AGNOCAST=off"}));
  ASSERT_TRUE(soon([&] { return !doctor_.look().all.empty(); }));
  const Findings findings = doctor_.look();
  const std::string pid = std::to_string(listener.pid());
  ASSERT_THAT(findings.all,
              ElementsAre("process-switched-off: process " + pid + " runs with AGNOCAST=off"));
  const Remedy remedy(findings.remedies[0], with({}));
  EXPECT_TRUE(has_processes(1));
  EXPECT_TRUE(finds_nothing());
}

TEST_F(DoctorLive, RestartsARevokedProcess) {
  const SteeredProcess listener({listener_}, with({}));
  // The listener ends if it is revoked before it has its subscription.
  ASSERT_TRUE(soon([&] { return is_subscribed(); }));
  ASSERT_EQ(
      run_ctl(daemon_.socket_path(), {"process", "revoke", std::to_string(listener.pid())}).status,
      0);
  ASSERT_TRUE(soon([&] { return !doctor_.look().all.empty(); }));
  const Findings findings = doctor_.look();
  ASSERT_THAT(findings.ids(), ElementsAre("process-revoked"));
  const Remedy remedy(findings.remedies[0], with({}));
  EXPECT_TRUE(finds_nothing());
  EXPECT_TRUE(has_processes(1));
}

}  // namespace
}  // namespace agnocast::test
