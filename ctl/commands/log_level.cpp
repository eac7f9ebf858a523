// SPDX-License-Identifier: Apache-2.0
//
// log-level: prints or changes the level of the daemon's log.

#include <base/text/text.hpp>
#include <ctl/cli/commands.hpp>
#include <ctl/commands/objects.hpp>
#include <ctl/snapshot/system.hpp>

#include <string>
#include <string_view>
#include <vector>

namespace agnocast::ctl {
namespace {

struct Level {
  std::uint64_t number;  // syslog's
  const char* word;
};
constexpr Level levels[] = {{3, "error"}, {4, "warning"}, {5, "notice"}, {6, "info"}, {7, "debug"}};

Outcome<std::uint64_t> level_of(const std::string& word) {
  if (word.empty()) return 0;  // no change
  std::vector<std::string_view> words;
  for (const Level& level : levels) {
    if (level.word == word) return level.number;
    words.emplace_back(level.word);
  }
  const std::string_view meant = nearest(word, words);
  return problem(Status::wrong_usage, in_quotes(word),
                 "unknown level; use one of error, warning, notice, info, debug",
                 meant.empty() ? "agnocast-ctl log-level --help"
                               : "agnocast-ctl log-level " + std::string(meant));
}

}  // namespace

const char* level_word(std::uint64_t number) noexcept {
  for (const Level& level : levels) {
    if (level.number == number) return level.word;
  }
  return "unknown";
}

Outcome<void> show_log_level(const Arguments& arguments, Console& console) {
  const auto wanted = level_of(arguments.subject(0));
  if (!wanted) return tl::unexpected(wanted.error());
  auto observer = Observer::connect(arguments.socket);
  if (!observer) return tl::unexpected(observer.error());
  const auto level = observer->log_level(*wanted);
  if (!level) return tl::unexpected(level.error());
  if (arguments.json == Json::no) {
    console.line(level_word(*level));
  } else {
    console.object({{"schema", "agnocast.log-level/1"}, {"log_level", level_word(*level)}},
                   arguments.json);
  }
  return {};
}

}  // namespace agnocast::ctl
