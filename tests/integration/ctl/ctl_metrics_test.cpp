// SPDX-License-Identifier: Apache-2.0
//
// Goal: Prometheus and OpenMetrics can parse the output of agnocast-ctl metrics, its values are
// right, and it changes atomically. Method: the real daemon and raw clients; the judges are
// promtool and the parser of Prometheus' Python library.

#include <tests/integration/ctl/ctl_node.hpp>
#include <tests/support/machine/temporary_directory.hpp>
#include <tests/support/processes/ctl.hpp>
#include <tests/support/processes/daemon_process.hpp>

#include <gmock/gmock.h>
#include <signal.h>
#include <sys/stat.h>
#include <sys/wait.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>
#include <vector>

namespace agnocast::test {
namespace {

using testing::AllOf;
using testing::ContainsRegex;
using testing::HasSubstr;
using testing::Not;

std::string text_of(const std::string& path) {
  std::ifstream file(path);
  return {std::istreambuf_iterator<char>(file), {}};
}

class CtlMetrics : public testing::Test {
 protected:
  CtlMetrics() {
    node_.open_window();
    const auto publisher = node_.publisher("/points", {7}, "/lidar/top");
    node_.commit(publisher, 3);
    const auto subscription = node_.subscription("/points", {5}, "/viewer");
    node_.link(subscription, publisher, 2, 1);
    auto other = WireClient::endpoint("/points", {1}, "other/msg/Type");
    node_.wire.ask(wire::Opcode::create_publisher, other);
  }
  CtlResult metrics(std::vector<std::string> more = {}) {
    more.insert(more.begin(), "metrics");
    return run_ctl(daemon_.socket_path(), std::move(more));
  }
  /// Returns whether this program accepts the text on its stdin.
  bool is_content(const std::string& judge, const std::string& text) {
    const std::string path = directory_.path("judged");
    std::ofstream(path) << text;
    return std::system((judge + " <'" + path + "'").c_str()) == 0;
  }

  DaemonProcess daemon_;
  CtlNode node_{daemon_.socket_path()};
  TemporaryDirectory directory_;
};

TEST_F(CtlMetrics, AreParsedByPrometheus) {
  const CtlResult result = metrics();
  ASSERT_EQ(result.status, 0) << result.err;
  const std::string of_topic = "\\{domain=\"0\",topic=\"/points\"\\} ";
  const std::string of_viewer =
      "\\{domain=\"0\",topic=\"/points\",node=\"/viewer\",pid=\"[0-9]+\",generation=\"[0-9]+\"\\} ";
  EXPECT_THAT(
      result.out,
      AllOf(HasSubstr("\nagnocast_up 1\n"), HasSubstr("\nagnocast_processes{state=\"alive\"} 1\n"),
            HasSubstr("\nagnocast_requests_refused_total 1\n"),
            ContainsRegex("\nagnocast_topic_unread_messages" + of_topic + "1\n"),
            ContainsRegex("\nagnocast_topic_held_messages" + of_topic + "1\n"),
            ContainsRegex("\nagnocast_topic_trouble" + of_topic + "1\n"),
            ContainsRegex("\nagnocast_lost_messages_total" + of_viewer + "0\n"),
            ContainsRegex("\nagnocast_published_messages_total\\{.*node=\"/lidar/"
                          "top\".*\\} 3\n")));
  if (std::system("command -v promtool >/dev/null") != 0)
    GTEST_SKIP() << "promtool is not installed";
  EXPECT_TRUE(is_content("promtool check metrics", result.out));
  EXPECT_FALSE(is_content("promtool check metrics 2>/dev/null", result.out + "no metric\n"));
}

// A process may have any name.
TEST_F(CtlMetrics, AreParsedWhateverTheNameOfAProcess) {
  CtlNode node(daemon_.socket_path(), 0, "a\"\\\n}\xff{b=\"1");
  const CtlResult result = metrics();
  EXPECT_THAT(result.out, HasSubstr(R"(process="a\\\"\\\\\\n}\\xff{b=\\\"1"} 0)"));
  if (std::system("command -v promtool >/dev/null") != 0)
    GTEST_SKIP() << "promtool is not installed";
  EXPECT_TRUE(is_content("promtool check metrics", result.out));
}

TEST_F(CtlMetrics, AreParsedAsOpenMetrics) {
  const CtlResult result = metrics({"--format", "openmetrics"});
  ASSERT_EQ(result.status, 0) << result.err;
  EXPECT_TRUE(result.out.ends_with("\n# EOF\n"));
  if (std::system("/usr/bin/python3 -c 'import prometheus_client' 2>/dev/null") != 0)
    GTEST_SKIP() << "python3-prometheus-client is not installed";
  const std::string judge =
      "/usr/bin/python3 -c 'import sys; from prometheus_client.openmetrics.parser import "
      "text_string_to_metric_families as parse; sys.exit(len(list(parse(sys.stdin.read()))) < 30)'";
  EXPECT_TRUE(is_content(judge, result.out));
  EXPECT_FALSE(is_content(judge + " 2>/dev/null", metrics().out)) << "the two formats differ";
}

TEST_F(CtlMetrics, ReplaceTheFileAndReportAMissingDaemon) {
  const std::string path = directory_.path("agnocast.prom");
  const CtlResult once = metrics({"--output", path});
  EXPECT_EQ(once.status, 0) << once.err;
  EXPECT_EQ(once.out, "");
  struct stat file {};
  ASSERT_EQ(::stat(path.c_str(), &file), 0);
  EXPECT_EQ(file.st_mode & 07777, 0644U) << "the collector is another user";
  EXPECT_THAT(text_of(path), HasSubstr("\nagnocast_up 1\n"));
  const pid_t pid = ::fork();
  if (pid == 0) {
    ::setenv("AGNOCAST_SOCKET", daemon_.socket_path().c_str(), 1);
    ::execl(AGNOCAST_TEST_CTL, AGNOCAST_TEST_CTL, "metrics", "-o", path.c_str(), "--every", "1",
            nullptr);
    ::_exit(99);
  }
  daemon_.kill();
  EXPECT_TRUE(
      eventually([&] { return text_of(path).find("\nagnocast_up 0\n") != std::string::npos; }));
  EXPECT_THAT(text_of(path), Not(HasSubstr("agnocast_topic")));
  EXPECT_EQ(::kill(pid, SIGTERM), 0);
  int status = 0;
  EXPECT_EQ(::waitpid(pid, &status, 0), pid);
  EXPECT_TRUE(WIFEXITED(status) && WEXITSTATUS(status) == 0);
  EXPECT_EQ(metrics({"--output", path}).status, 3);
  EXPECT_EQ(std::distance(std::filesystem::directory_iterator(directory_.path()), {}), 1)
      << "no temporary file stays beside it";
}

TEST(CtlMetricsOfOthers, ReportADaemonAsMissingOnlyWhenItIs) {
  if (::geteuid() != 0) GTEST_SKIP() << "needs root to become another user";
  DaemonProcess daemon({.config = "[daemon]\nsocket_mode = \"0600\"\n"});
  const TemporaryDirectory directory;
  ASSERT_EQ(::chmod(directory.path().c_str(), 0777), 0);
  const std::string path = directory.path("agnocast.prom");
  const CtlResult result =
      run_ctl(daemon.socket_path(), {"metrics", "--every", "1", "--output", path}, {}, 65534);
  EXPECT_EQ(result.status, 5) << result.err;
  EXPECT_THAT(result.err, HasSubstr("this user may not do that"));
  EXPECT_FALSE(std::filesystem::exists(path));
}

TEST_F(CtlMetrics, RefuseImpossibleOptions) {
  const CtlResult no_file = metrics({"--every", "15"});
  EXPECT_EQ(no_file.status, 2);
  EXPECT_EQ(no_file.err,
            "agnocast-ctl: --every: there is no file to rewrite\n"
            "hint: agnocast-ctl metrics --every 15 --output FILE\n");
  const CtlResult no_folder = metrics({"--output", "/nowhere/at/all"});
  EXPECT_EQ(no_folder.status, 1);
  EXPECT_THAT(no_folder.err, HasSubstr("/nowhere/at/all: it cannot be written: No such file"));
  const CtlResult a_folder = metrics({"--output", directory_.path()});
  EXPECT_EQ(a_folder.status, 1);
  EXPECT_THAT(a_folder.err, HasSubstr("it cannot be written: Is a directory"));
  EXPECT_EQ(metrics({"--every", "0", "--output", "/x"}).status, 2);
  EXPECT_EQ(metrics({"--format", "graphite"}).status, 2);
  EXPECT_EQ(metrics({"-j", "--output", directory_.path("m")}).status, 2);
}

TEST(CtlMetricsExamples, AreValidRulesAboutExistingSeries) {
  const std::string rules = AGNOCAST_TEST_RULES;
  DaemonProcess daemon;
  const std::string made = run_ctl(daemon.socket_path(), {"metrics"}).out;
  const std::string text = text_of(rules);
  std::size_t count = 0;
  for (std::size_t at = 0; (at = text.find("agnocast_", at)) != std::string::npos; ++count) {
    const std::size_t end = text.find_first_of(" =[{/", at);
    EXPECT_THAT(made, HasSubstr("# TYPE " + text.substr(at, end - at) + ' '));
    at = end;
  }
  EXPECT_GE(count, 8U);
  if (std::system("command -v promtool >/dev/null") != 0)
    GTEST_SKIP() << "promtool is not installed";
  EXPECT_EQ(std::system(("promtool check rules '" + rules + "' >/dev/null").c_str()), 0);
}

}  // namespace
}  // namespace agnocast::test
