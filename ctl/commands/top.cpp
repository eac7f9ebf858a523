// SPDX-License-Identifier: Apache-2.0
//
// top: the whole system on one screen, the worst first. On a terminal it is redrawn and takes
// keys; with -b it prints one round after the other, with --json one line a round.

#include <base/clock.hpp>
#include <base/text/text.hpp>
#include <ctl/cli/commands.hpp>
#include <ctl/cli/screen.hpp>
#include <ctl/cli/waiting.hpp>
#include <ctl/snapshot/overview.hpp>
#include <ctl/snapshot/watch.hpp>

#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <string>
#include <vector>

namespace agnocast::ctl {
namespace {

using Lines = std::vector<Screen::Line>;

/// The user's choices by keys.
struct Choice {
  std::string sort;
  std::string filter;  // a part of a topic's name
  bool help = false;
};

constexpr const char* keys =
    "q quit   s next order   f filter by name   h help\n"
    "\n"
    "S  X refused or not matched   L a reader lags   H a message is held long\n"
    "   D a publisher is gone with unread messages   R running   I idle\n"
    "LAG   messages that the slowest reader has not taken\n"
    "HOLD  messages that are held, and the age of the oldest\n"
    "LOST  messages that exceeded a reader's depth, since its start\n";

std::string heading_of(const Totals& totals, bool is_away, const Choice& choice) {
  std::string text = "agnocast  up " + duration_for_people(totals.uptime_ns) + "  topics " +
                     std::to_string(totals.topics) + "  processes " +
                     std::to_string(totals.processes) + "  heap " +
                     bytes_for_people(totals.heap_bytes) + "  lost " + std::to_string(totals.lost) +
                     "  refused " + std::to_string(totals.refused) + "  recoveries " +
                     std::to_string(totals.recoveries);
  if (choice.sort != "trouble") text += "  by " + choice.sort;
  if (!choice.filter.empty()) text += "  only " + escaped(choice.filter);
  if (is_away) text += "  AGNOCASTD IS ABSENT";
  return text;
}

std::string rate_for_people(double rate_hz) {
  char text[32];
  std::snprintf(text, sizeof text, rate_hz < 1000 ? "%.1f" : "%.0f", rate_hz);
  return text;
}

// topic info shows the full "sensor_msgs/msg/PointCloud2"; here the last part is enough.
std::string short_type(const std::string& type) {
  const std::size_t slash = type.rfind('/');
  return escaped(slash == std::string::npos ? type : type.substr(slash + 1), 40);
}

Lines lines_of(const std::vector<Row>& rows, const Totals& totals, bool is_away,
               const Choice& choice) {
  Table table(
      {"S", "TOPIC", "TYPE", "RATE", "SIZE", "BW", "PUB", "SUB", "LAG", "HOLD", "AGE", "LOST"});
  for (const Row& row : rows)
    table.add({std::string(1, letter_of(row.trouble)), escaped(row.topic->name, 60),
               short_type(row.topic->type), row.rate_known ? rate_for_people(row.rate_hz) : "-",
               bytes_for_people(row.message_bytes),
               bytes_for_people(static_cast<std::uint64_t>(row.bytes_per_second)) + "/s",
               std::to_string(row.publishers), std::to_string(row.subscriptions),
               std::to_string(row.lag), std::to_string(row.held),
               row.held == 0 ? "-" : time_for_people(row.oldest_held_ns),
               std::to_string(row.lost)});
  const std::vector<std::string> texts = table.lines();
  Lines lines{{heading_of(totals, is_away, choice), false}, {texts.front(), true}};
  for (std::size_t i = 0; i < rows.size(); ++i) {
    lines.push_back({texts[i + 1], false});
    for (const std::string& note : rows[i].notes) lines.push_back({"  `- " + note, false});
  }
  return lines;
}

class Top {
 public:
  Top(const Arguments& arguments, Console& console, Watch watch)
      : arguments_(arguments), console_(console), watch_(std::move(watch)) {
    choice_.sort = arguments.text(options::sort);
  }

  Outcome<void> print(const Waiting& waiting) {
    const std::uint64_t rounds = arguments_.whole(options::rounds);
    for (std::uint64_t done = 0;;) {
      if (auto seen = look(); !seen) return seen;
      if (arguments_.json != Json::no) {
        Object list = Object::array();
        for (const Row& row : rows_) list.push_back(object_of(row));
        console_.object({{"schema", "agnocast.top/1"},
                         {"is_daemon_away", watch_.is_away()},
                         {"totals", object_of(totals_)},
                         {"topics", list}},
                        arguments_.json);
      } else {
        if (done != 0) console_.line("");
        for (const auto& line : lines_of(rows_, totals_, watch_.is_away(), choice_))
          console_.line(line.strong ? console_.strong(line.text) : line.text);
      }
      console_.flush();
      if (++done == rounds || !waiting.sleep_ms(delay_ms())) return {};
    }
  }

  Outcome<void> draw(const Waiting& waiting, Screen& screen) {
    const std::uint64_t rounds = arguments_.whole(options::rounds);
    for (std::uint64_t done = 0;;) {
      if (auto seen = look(); !seen) return seen;
      show(screen);
      if (++done == rounds) return {};
      const std::uint64_t until = monotonic_ms() + static_cast<std::uint64_t>(delay_ms());
      for (std::uint64_t now = monotonic_ms(); now < until; now = monotonic_ms()) {
        const auto event = waiting.wait(STDIN_FILENO, static_cast<int>(until - now));
        if (event == Waiting::Event::end) return {};
        if (event == Waiting::Event::input && !take_keys(screen)) return {};
      }
    }
  }

 private:
  int delay_ms() const {
    return std::max(1, static_cast<int>(std::lround(arguments_.real(options::delay) * 1000)));
  }

  Outcome<void> look() {
    if (auto renewed = watch_.renew(); !renewed) return renewed;
    rows_ =
        overview_.look(watch_.system(), arguments_.all_domains, arguments_.domain, monotonic_ns());
    totals_ = Overview::totals_of(watch_.system(), rows_);
    std::erase_if(rows_, [&](const Row& row) {
      return row.topic->name.find(choice_.filter) == std::string::npos;
    });
    sort_rows(rows_, choice_.sort);
    return {};
  }

  void show(Screen& screen) const {
    Lines lines = lines_of(rows_, totals_, watch_.is_away(), choice_);
    if (choice_.help) {
      lines.resize(1);
      std::string_view text = keys;
      while (!text.empty()) {
        const std::size_t end = text.find('\n');
        lines.push_back({std::string(text.substr(0, end)), false});
        text.remove_prefix(end + 1);
      }
    }
    screen.draw(lines);
  }

  // Returns false when the command is to end.
  bool take_keys(Screen& screen) {
    bool changed = false;
    for (char key = screen.key(); key != '\0'; key = screen.key()) {
      changed = true;
      if (key == 'q') return false;
      if (key == 'h' || key == '?') choice_.help = !choice_.help;
      if (key == 's') choice_.sort = next_order();
      if (key == 'f') choice_.filter = screen.ask("only topics with: ");
    }
    if (changed) {
      sort_rows(rows_, choice_.sort);
      show(screen);
    }
    return true;
  }

  std::string next_order() const {
    const std::string words(options::sort.words);
    const std::size_t at = words.find(choice_.sort) + choice_.sort.size() + 1;
    return at >= words.size() ? words.substr(0, words.find(' '))
                              : words.substr(at, words.find(' ', at) - at);
  }

  const Arguments& arguments_;
  Console& console_;
  Watch watch_;
  Overview overview_;
  Choice choice_;
  std::vector<Row> rows_;
  Totals totals_;
};

}  // namespace

Outcome<void> show_top(const Arguments& arguments, Console& console) {
  const Waiting waiting;
  auto watch = Watch::begin(arguments.socket);
  if (!watch) return tl::unexpected(watch.error());
  Top top(arguments, console, std::move(*watch));
  const bool live = !arguments.has(options::batch) && arguments.json == Json::no &&
                    ::isatty(STDOUT_FILENO) == 1 && ::isatty(STDIN_FILENO) == 1;
  if (!live) return top.print(waiting);
  Screen screen;
  if (!screen.works())
    return problem(Status::failed, "terminal", "TERM is unknown or not suitable",
                   "agnocast-ctl top -b");
  return top.draw(waiting, screen);
}

}  // namespace agnocast::ctl
