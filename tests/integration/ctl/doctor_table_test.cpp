// SPDX-License-Identifier: Apache-2.0
//
// Goal: doctor checks exactly what it documents: the list, the answer and docs/doctor.md have the
// same checks, and each has a cause and a command. Method: agnocast-ctl as a program, and the
// table.

#include <ctl/doctor/doctor.hpp>
#include <tests/support/processes/ctl.hpp>

#include <gmock/gmock.h>

#include <fstream>
#include <iterator>
#include <set>
#include <sstream>
#include <string>

namespace agnocast::test {
namespace {

std::string row_of(const ctl::Check& check) {
  std::string remedy;
  for (const char c : check.remedy) remedy += c == '|' ? std::string("\\|") : std::string(1, c);
  return "| `" + std::string(check.id) + "` | " +
         (check.severity == ctl::Check::Severity::failed ? "failed" : "warning") + " | " +
         std::string(check.title) + " | " + std::string(check.cause) + " | `" + remedy + "` |";
}

TEST(DoctorTable, AgreesWithTheDocument) {
  std::ifstream in(AGNOCAST_TEST_DOCUMENT);
  std::string rows, expected;
  for (std::string line; std::getline(in, line);) {
    if (line.starts_with("| `")) rows += line + '\n';
  }
  for (const ctl::Check* const check : ctl::all_checks()) expected += row_of(*check) + '\n';
  EXPECT_EQ(rows, expected);
}

TEST(DoctorTable, NamesEachCheckOnceWithCauseAndCommand) {
  std::set<std::string> ids;
  for (const ctl::Check* const check : ctl::all_checks()) {
    const std::string id(check->id);
    EXPECT_TRUE(ids.insert(id).second) << id;
    EXPECT_THAT(id, testing::MatchesRegex("[a-z][a-z-]+[a-z]"));
    EXPECT_FALSE(check->title.empty() || check->cause.empty() || check->remedy.empty()) << id;
  }
  EXPECT_GE(ids.size(), 25u);
}

TEST(DoctorTable, HasATestForEachRow) {
  std::string sources;
  for (const char* const name :
       {"ctl/ctl_threads_test.cpp", "ctl/doctor_daemon_test.cpp", "ctl/doctor_door_test.cpp",
        "ctl/doctor_processes_test.cpp", "client/tools/doctor_live_test.cpp",
        "bridge/status/bridge_doctor_test.cpp", "../system/containers_test.cpp"}) {
    std::ifstream in(std::string(AGNOCAST_TEST_SOURCES "/") + name);
    sources.append(std::istreambuf_iterator<char>(in), {});
  }
  for (const ctl::Check* const check : ctl::all_checks()) {
    const std::string id = '"' + std::string(check->id);
    EXPECT_TRUE(sources.find(id + '"') != std::string::npos ||
                sources.find(id + ": ") != std::string::npos)
        << id;
  }
}

TEST(DoctorTable, AgreesWithTheList) {
  const CtlResult list = run_ctl("/nonexistent/socket", {"doctor", "--list", "-j"});
  EXPECT_EQ(list.status, 0);
  EXPECT_EQ(list.json()["schema"], "agnocast.doctor-list/1");
  const auto checks = list.json()["checks"];
  const auto all = ctl::all_checks();
  ASSERT_EQ(checks.size(), all.size());
  for (std::size_t i = 0; i < all.size(); ++i) {
    EXPECT_EQ(checks[i]["id"], all[i]->id);
    EXPECT_EQ(checks[i]["remedy"], all[i]->remedy);
  }
  const CtlResult people = run_ctl("/nonexistent/socket", {"doctor", "--list"});
  EXPECT_THAT(people.out,
              testing::HasSubstr("no-daemon (failed): there is a socket of agnocastd\n"));
}

TEST(DoctorTable, SkipsChecksThatNeedADaemon) {
  const auto report = run_ctl("/nonexistent/socket", {"doctor", "-j"}).json();
  const auto all = ctl::all_checks();
  ASSERT_EQ(report["checks"].size(), all.size());
  std::size_t run = 0;
  for (std::size_t i = 0; i < all.size(); ++i) {
    const bool needs = all[i]->needs == ctl::Check::Needs::daemon;
    EXPECT_EQ(report["checks"][i]["status"] == "skipped", needs) << all[i]->id;
    run += needs ? 0 : 1;
  }
  EXPECT_EQ(report["check_count"], run);
}

}  // namespace
}  // namespace agnocast::test
