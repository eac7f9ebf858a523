// SPDX-License-Identifier: Apache-2.0
//
// Goal: one event is one true line whatever clients write into it, and floods are counted instead
// of written. Method: a sink that keeps lines and a clock that the test moves.

#include <base/descriptors/unique_fd.hpp>
#include <base/text/log.hpp>
#include <daemon/process/log_events.hpp>
#include <tests/support/machine/temporary_directory.hpp>
#include <tests/support/processes/child.hpp>

#include <gmock/gmock.h>

#include <fcntl.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <unistd.h>

#include <array>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <limits>
#include <memory>
#include <optional>
#include <regex>
#include <set>
#include <string>
#include <vector>

namespace agnocast::daemon {
namespace {

using testing::ElementsAre;
using testing::IsEmpty;
using testing::SizeIs;

constexpr std::uint64_t second = 1'000'000'000;

struct Lines : testing::Test {
  std::vector<std::string> lines;
  bool has_room = true;
  std::uint64_t now = 1'769'860'800 * second;  // 2026-01-31T12:00:00Z

  Log make(Log::Format format = Log::Format::journald_pipe, LogLevel level = LogLevel::info) {
    return Log(
        log_program, level, format,
        [this](std::string_view line) {
          if (has_room) lines.emplace_back(line);
          return has_room;
        },
        [this] { return now; });
  }
};

TEST_F(Lines, JournaldGetsThePriorityAndReadersTheTime) {
  make().write(LogLevel::warning, "client refused", {{"uid", 1000U}, {"why", "no rule"}});
  now += 7'000'000;
  make(Log::Format::people).write(LogLevel::error, "out of descriptors", {{"errno", -24}});
  EXPECT_THAT(lines, ElementsAre("<4>client refused uid=1000 why=\"no rule\"\n",
                                 "2026-01-31T12:00:00.007Z error out of descriptors errno=-24\n"));
}

TEST_F(Lines, AnUnknownFieldIsOmitted) {
  const std::optional<std::uint64_t> none, some = 7;
  const std::optional<std::string_view> text = "/a topic";
  make().write(LogLevel::info, "event", {{"a", none}, {"b", some}, {"c", text}, {"d", 1}});
  EXPECT_THAT(lines, ElementsAre("<6>event b=7 c=\"/a topic\" d=1\n"));
}

TEST_F(Lines, LostLinesAreCountedAndReportedOnce) {
  Log log = make();
  has_room = false;
  for (int i = 0; i < 3; ++i) log.write(LogLevel::info, "lost");
  has_room = true;
  log.write(LogLevel::info, "a");
  log.write(LogLevel::info, "b");
  EXPECT_THAT(lines, ElementsAre("<4>lines were lost count=3\n", "<6>a\n", "<6>b\n"));
}

TEST_F(Lines, EveryLevelHasItsPriorityAndItsName) {
  Log log = make(Log::Format::journald_pipe, LogLevel::debug);
  for (const char* name : {"error", "warning", "notice", "info", "debug"}) {
    const auto level = log_level_of(name);
    ASSERT_TRUE(level) << name;
    EXPECT_EQ(name_of(*level), name);
    log.write(*level, "x");
  }
  EXPECT_THAT(lines, ElementsAre("<3>x\n", "<4>x\n", "<5>x\n", "<6>x\n", "<7>x\n"));
  EXPECT_FALSE(log_level_of("loud"));
  EXPECT_FALSE(log_level_of(""));
  EXPECT_EQ(log_level_names, "error, warning, notice, info, debug");
}

TEST_F(Lines, EventsBelowTheLevelAreNotWritten) {
  Log log = make(Log::Format::journald_pipe, LogLevel::warning);
  log.write(LogLevel::notice, "x");
  log.write_limited("cause", LogLevel::info, "x");
  EXPECT_THAT(lines, IsEmpty());
  log.set_level(LogLevel::notice);
  log.write(LogLevel::notice, "x");
  EXPECT_THAT(lines, SizeIs(1));
}

TEST_F(Lines, ForeignTextCannotForgeLinesOrFields) {
  Log log = make();
  log.write(LogLevel::info, "client",
            {{"name", "x\n<0>root owned"},
             {"a", "b=c"},
             {"b", "say \"hi\""},
             {"c", "\x1b[2J"},
             {"d", ""},
             {"e", std::string("/plain/text.sock")}});
  EXPECT_THAT(lines,
              ElementsAre("<6>client name=\"x\\n<0>root owned\" a=\"b=c\" b=\"say \\\"hi\\\"\" "
                          "c=\"\\x1b[2J\" d=\"\" e=/plain/text.sock\n"));
}

TEST_F(Lines, ValuesAndLinesAreBounded) {
  Log log = make();
  log.write(LogLevel::info, "x", {{"name", std::string(300, 'a')}});
  EXPECT_EQ(lines.back(), "<6>x name=\"" + std::string(256, 'a') + "...\"\n");
  const std::string hostile(256, '\n');
  log.write(LogLevel::info, "x", {{"a", hostile}, {"b", hostile}, {"c", hostile}});
  EXPECT_EQ(lines.back().size(), Log::line_bytes_max);
  EXPECT_THAT(lines.back(), testing::EndsWith("...\n"));
  for (const std::string& line : lines) EXPECT_EQ(line.find('\n'), line.size() - 1);
}

TEST_F(Lines, NumbersAreWhole) {
  Log log = make();
  log.write(LogLevel::info, "x",
            {{"a", std::numeric_limits<std::uint64_t>::max()},
             {"b", std::numeric_limits<std::int64_t>::min()},
             {"c", std::uint8_t{65}}});
  EXPECT_THAT(lines, ElementsAre("<6>x a=18446744073709551615 b=-9223372036854775808 c=65\n"));
}

TEST_F(Lines, FloodIsCountedAndTheCountIsReported) {
  Log log = make();
  for (int i = 0; i < 1000; ++i)
    log.write_limited("refused 1000", LogLevel::warning, "client refused", {{"uid", 1000}});
  EXPECT_THAT(lines, SizeIs(Log::lines_per_interval));
  lines.clear();
  now += Log::interval_ns - 1;
  log.flush();
  EXPECT_THAT(lines, IsEmpty()) << "the interval is not over";
  now += 1;
  log.flush();
  EXPECT_THAT(lines, ElementsAre("<4>more of the same was left out cause=\"refused 1000\" "
                                 "repeated=995 seconds=10\n"));
  lines.clear();
  log.flush();
  EXPECT_THAT(lines, IsEmpty()) << "the count is reported once";
}

TEST_F(Lines, NextEventAfterAnIntervalFirstReportsTheOmitted) {
  Log log = make();
  for (int i = 0; i < 7; ++i) log.write_limited("c", LogLevel::info, "x");
  lines.clear();
  now += 12 * second;
  log.write_limited("c", LogLevel::info, "x");
  EXPECT_THAT(lines, ElementsAre("<6>more of the same was left out cause=c repeated=2 seconds=12\n",
                                 "<6>x\n"));
}

TEST_F(Lines, CausesAreCountedSeparately) {
  Log log = make();
  for (int i = 0; i < 10; ++i) {
    log.write_limited("a", LogLevel::info, "of a");
    log.write_limited("b", LogLevel::info, "of b");
  }
  EXPECT_EQ(std::count(lines.begin(), lines.end(), "<6>of a\n"), 5);
  EXPECT_EQ(std::count(lines.begin(), lines.end(), "<6>of b\n"), 5);
}

TEST_F(Lines, FewEventsAreNotReportedAsOmitted) {
  Log log = make();
  for (int i = 0; i < 5; ++i) log.write_limited("c", LogLevel::info, "x");
  lines.clear();
  log.flush(true);
  EXPECT_THAT(lines, IsEmpty());
}

TEST_F(Lines, InventedCausesCannotFloodTheLog) {
  Log log = make();
  for (int i = 0; i < 100'000; ++i)
    log.write_limited("cause " + std::to_string(i), LogLevel::info, "x");
  EXPECT_THAT(lines, SizeIs(Log::cause_count_max + Log::lines_per_interval));
  lines.clear();
  log.flush(true);
  const std::uint64_t left_out = 100'000 - Log::cause_count_max - Log::lines_per_interval;
  EXPECT_THAT(lines,
              ElementsAre("<6>more of the same was left out cause=\"other causes\" repeated=" +
                          std::to_string(left_out) + " seconds=0\n"));
}

TEST_F(Lines, ClockThatIsSetBackDoesNotSilenceTheLog) {
  Log log = make();
  for (int i = 0; i < 7; ++i) log.write_limited("c", LogLevel::info, "x");
  lines.clear();
  now -= 3600 * second;
  log.write_limited("c", LogLevel::info, "x");
  EXPECT_THAT(lines, ElementsAre("<6>more of the same was left out cause=c repeated=2 seconds=0\n",
                                 "<6>x\n"));
}

TEST(Log, JournalStreamNamesExactlyThisFile) {
  std::array<int, 2> ends{};
  ASSERT_EQ(::pipe2(ends.data(), O_CLOEXEC), 0);
  struct stat file {};
  ASSERT_EQ(::fstat(ends[1], &file), 0);
  const std::string right = std::to_string(file.st_dev) + ':' + std::to_string(file.st_ino);
  EXPECT_TRUE(is_journal_stream(right.c_str(), ends[1]));
  EXPECT_FALSE(is_journal_stream((right + '1').c_str(), ends[1]));
  EXPECT_FALSE(is_journal_stream((right + 'x').c_str(), ends[1]));
  EXPECT_FALSE(is_journal_stream(std::to_string(file.st_dev).c_str(), ends[1]));
  EXPECT_FALSE(is_journal_stream("", ends[1]));
  EXPECT_FALSE(is_journal_stream(nullptr, ends[1]));
  EXPECT_FALSE(is_journal_stream(right.c_str(), -1));
  ::close(ends[0]);
  ::close(ends[1]);
}

// The real stderr, once as a stream to the systemd journal and once not.
TEST(Log, StderrHasTheFormatOfItsDestination) {
  for (const bool is_journal : {true, false}) {
    std::array<int, 2> ends{};
    ASSERT_EQ(::pipe2(ends.data(), O_CLOEXEC), 0);
    test::Child child([&] {
      struct stat file {};
      if (::dup2(ends[1], STDERR_FILENO) < 0 || ::fstat(STDERR_FILENO, &file) != 0) return 1;
      const std::string stream =
          is_journal ? std::to_string(file.st_dev) + ':' + std::to_string(file.st_ino) : "1:1";
      ::setenv("JOURNAL_STREAM", stream.c_str(), 1);
      Log::to_stderr(log_program, LogLevel::info, "/nobody/listens/here")
          .write(LogLevel::notice, "up", {{"pid", 1}});
      return 0;
    });
    EXPECT_EQ(child.wait(), 0);
    std::array<char, 256> text{};
    ASSERT_GT(::read(ends[0], text.data(), text.size() - 1), 0);
    if (is_journal) {
      EXPECT_STREQ(text.data(), "<5>up pid=1\n");
    } else {
      EXPECT_THAT(text.data(),
                  testing::MatchesRegex("20[0-9-]+T[0-9:]+\\.[0-9]+Z notice up pid=1\n"));
    }
    ::close(ends[0]);
    ::close(ends[1]);
  }
}

// --- entries of the systemd journal

TEST_F(Lines, AnEntryHasExactlyItsFields) {
  Log log = make(Log::Format::journald);
  log.write(LogLevel::warning, "request refused",
            {{"pid", 7U},
             {"topic", std::optional<std::string>("/a\nAGNOCAST_UID=0")},
             {"limit", std::optional<std::string>()},
             {"why", "no rule"}});
  log.write(LogLevel::debug, "unheard");
  EXPECT_THAT(
      lines,
      ElementsAre("MESSAGE=request refused pid=7 topic=\"/a\\nAGNOCAST_UID=0\" why=\"no rule\"\n"
                  "PRIORITY=4\nSYSLOG_IDENTIFIER=agnocastd\nAGNOCAST_EVENT=request refused\n"
                  "MESSAGE_ID=" +
                  std::string(message_id_of("request refused")) +
                  "\nAGNOCAST_PID=7\nAGNOCAST_TOPIC=/a\\nAGNOCAST_UID=0\nAGNOCAST_WHY=no rule\n"));
}

/// A socket like journald's.
struct JournalSocket {
  explicit JournalSocket(const std::string& path)
      : fd(::socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0)) {
    sockaddr_un address{};
    address.sun_family = AF_UNIX;
    path.copy(address.sun_path, sizeof address.sun_path - 1);
    EXPECT_EQ(::bind(fd.get(), reinterpret_cast<const sockaddr*>(&address), sizeof address), 0);
  }
  std::size_t read_all() {
    std::array<char, 4096> entry{};
    std::size_t count = 0;
    for (; ::recv(fd.get(), entry.data(), entry.size(), 0) > 0; ++count) last = entry.data();
    return count;
  }
  UniqueFd fd;
  std::string last;
};

TEST(Log, DoesNotWaitForJournaldAndFindsTheNextOne) {
  const test::TemporaryDirectory directory;
  const std::string path = directory.path() + "/journal";
  auto journal = std::make_unique<JournalSocket>(path);
  std::array<int, 2> ends{};
  ASSERT_EQ(::pipe2(ends.data(), O_CLOEXEC), 0);
  const UniqueFd stderr_before(::dup(STDERR_FILENO));
  ASSERT_GE(::dup2(ends[1], STDERR_FILENO), 0);
  struct stat file {};
  ASSERT_EQ(::fstat(STDERR_FILENO, &file), 0);
  ::setenv("JOURNAL_STREAM",
           (std::to_string(file.st_dev) + ':' + std::to_string(file.st_ino)).c_str(), 1);
  Log log = Log::to_stderr(log_program, LogLevel::info, path);
  ASSERT_GE(::dup2(stderr_before.get(), STDERR_FILENO), 0);
  ::unsetenv("JOURNAL_STREAM");
  // The socket has no reader, so it takes only a limited number.
  constexpr std::size_t many = 10'000;
  for (std::size_t i = 0; i < many; ++i) log.write(LogLevel::notice, "ready");
  const std::size_t taken = journal->read_all();
  EXPECT_GT(taken, 0U);
  EXPECT_LT(taken, many);
  log.write(LogLevel::notice, "ready");
  EXPECT_EQ(journal->read_all(), 2U) << "the lost lines are reported first";
  EXPECT_THAT(journal->last, testing::HasSubstr("\nAGNOCAST_EVENT=ready\n"));
  journal.reset();
  ASSERT_EQ(::unlink(path.c_str()), 0);
  log.write(LogLevel::notice, "ready");
  journal = std::make_unique<JournalSocket>(path);
  log.write(LogLevel::notice, "ready");
  EXPECT_EQ(journal->read_all(), 2U);
  ::close(ends[0]);
  ::close(ends[1]);
}

// --- the table of events

std::string file_text(const std::filesystem::path& path) {
  std::ifstream file(path);
  return {std::istreambuf_iterator<char>(file), {}};
}

std::set<std::string> found_in(const std::string& text, const char* pattern) {
  const std::regex regex(pattern);
  std::set<std::string> all;
  for (std::sregex_iterator i(text.begin(), text.end(), regex), end; i != end; ++i)
    all.insert((*i)[1].str());
  return all;
}

TEST(LogEvents, HaveAUniqueIdAndAnEntryInTheCatalogue) {
  std::set<std::string> numbers, words;
  for (const LogEvent& event : log_events) {
    EXPECT_TRUE(std::regex_match(std::string(event.id), std::regex("[0-9a-f]{32}"))) << event.words;
    EXPECT_TRUE(numbers.emplace(event.id).second) << event.words;
    EXPECT_TRUE(words.emplace(event.words).second) << event.words;
  }
  const std::string catalogue = file_text(AGNOCAST_SOURCE_DIR "/systemd/agnocast.catalog");
  EXPECT_EQ(found_in(catalogue, "\n-- ([0-9a-f]+)\n"), numbers);
}

// In the sources the words follow the level directly, or a choice of levels.
TEST(LogEvents, MatchTheSourcesAndTheDocument) {
  std::string sources = file_text(AGNOCAST_SOURCE_DIR "/base/text/log.cpp");
  for (const auto& entry :
       std::filesystem::recursive_directory_iterator(AGNOCAST_SOURCE_DIR "/daemon")) {
    if (entry.path().extension() == ".cpp") sources += file_text(entry.path());
  }
  const std::set<std::string> written = found_in(
      sources,
      "LogLevel::(?:error|warning|notice|info),\\s*(?:[a-z_.]+uid,\\s*|uid,\\s*)?\"([a-z ]+)\"");
  EXPECT_GT(written.size(), 20U);
  for (const std::string& words : written) {
    EXPECT_TRUE(!message_id_of(words).empty() || log_level_of(words)) << words;
  }
  const std::string document = file_text(AGNOCAST_SOURCE_DIR "/docs/agnocastd.md");
  const std::string log = document.substr(document.find("\n## Log\n"));
  for (const LogEvent& event : log_events) {
    EXPECT_NE(sources.find('"' + std::string(event.words) + '"'), std::string::npos) << event.words;
    EXPECT_TRUE(std::regex_search(
        log, std::regex("\n\\|(?:[a-z ,]+,)? " + std::string(event.words) + "(?:,[a-z ,]+)? \\|")))
        << event.words << " is missing in docs/agnocastd.md";
  }
}

}  // namespace
}  // namespace agnocast::daemon
