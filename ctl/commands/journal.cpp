// SPDX-License-Identifier: Apache-2.0
//
// journal: the last operations and recoveries of the daemon, a line each.

#include <base/text/text.hpp>
#include <ctl/cli/commands.hpp>
#include <ctl/commands/objects.hpp>
#include <ctl/snapshot/journal.hpp>
#include <ctl/snapshot/select.hpp>
#include <ctl/snapshot/system.hpp>
#include <journal/withdrawal.hpp>

#include <chrono>
#include <ctime>
#include <limits>
#include <string_view>
#include <thread>
#include <utility>

namespace agnocast::ctl {
namespace {

using journal::RecordType;
using wire::JournalRecord;

constexpr std::chrono::milliseconds follow_interval(500);
// A restarting daemon is absent for seconds at most.
constexpr int follow_attempts = 20;
constexpr std::uint64_t all = std::numeric_limits<std::uint64_t>::max();

// The time of a record on the wall clock: now minus the record's age.
struct Moment {
  std::uint64_t age_ns = 0;
  std::time_t seconds = 0;
  unsigned milliseconds = 0;
  std::time_t now = 0;
};

Moment moment_of(const JournalRecord& record, const wire::JournalEnd& end) {
  timespec now{};
  ::clock_gettime(CLOCK_REALTIME, &now);
  Moment moment;
  moment.age_ns = end.now_ns > record.stamp_ns ? end.now_ns - record.stamp_ns : 0;
  const std::int64_t at = std::int64_t{now.tv_sec} * 1000 + now.tv_nsec / 1'000'000 -
                          static_cast<std::int64_t>(moment.age_ns / 1'000'000);
  moment.seconds = static_cast<std::time_t>(at / 1000);
  moment.milliseconds = static_cast<unsigned>(at % 1000);
  moment.now = now.tv_sec;
  return moment;
}

std::string with_milliseconds(const char* text, const Moment& moment, const char* end) {
  char whole[80];
  std::snprintf(whole, sizeof whole, "%s.%03u%s", text, moment.milliseconds, end);
  return whole;
}

// Returns "12:01:33.120", with the date if that is not today.
std::string clock_time_for_people(const Moment& moment) {
  std::tm at{}, now{};
  ::localtime_r(&moment.seconds, &at);
  ::localtime_r(&moment.now, &now);
  char text[64];
  if (at.tm_year == now.tm_year && at.tm_yday == now.tm_yday) {
    std::strftime(text, sizeof text, "%H:%M:%S", &at);
  } else {
    std::strftime(text, sizeof text, "%Y-%m-%d %H:%M:%S", &at);
  }
  return with_milliseconds(text, moment, "");
}

std::string time_for_programs(const Moment& moment) {
  std::tm at{};
  ::gmtime_r(&moment.seconds, &at);
  char text[64];
  std::strftime(text, sizeof text, "%Y-%m-%dT%H:%M:%S", &at);
  return with_milliseconds(text, moment, "Z");
}

// Returns what records of another start of the daemon say about this record.
std::string state_words(const JournalRecord& record, const Journal& journal) {
  if (record.state == wire::JournalState::pending) return " [not complete]";
  for (const JournalRecord& later : journal.records) {
    if (later.lsn > record.lsn && !is_damaged(later) &&
        static_cast<RecordType>(later.type) == RecordType::recovered &&
        argument(later, "redone_lsn") == record.lsn)
      return " [completed after a restart]";
  }
  return "";
}

Object process_object(const wire::JournalProcess& process) {
  const std::string name = text_of(process.name);
  if (name.empty() && process.pid == 0) return nullptr;
  return {{"name", name}, {"pid", process.pid}};
}

Object arguments_object(const JournalRecord& record) {
  Object object = Object::object();
  std::string_view names = journal::arguments_of(static_cast<RecordType>(record.type));
  for (std::size_t i = 0; !names.empty() && i < std::size(record.argument); ++i) {
    const std::size_t blank = names.find(' ');
    const std::string name(names.substr(0, blank));
    const bool is_code = name == "base" || name == "layout_hash" || name == "final_head";
    object[name] = is_code ? Object(hexadecimal(record.argument[i]))
                   : name == "why"
                       ? Object(journal::name_of(static_cast<abi::Withdrawal>(record.argument[i])))
                       : Object(record.argument[i]);
    names.remove_prefix(blank == std::string_view::npos ? names.size() : blank + 1);
  }
  return object;
}

}  // namespace

Object record_object(const JournalRecord& record, const Journal& journal) {
  if (is_damaged(record)) return {{"lsn", record.lsn}, {"state", "damaged"}};
  const Moment moment = moment_of(record, journal.end);
  const std::string topic = text_of(record.topic);
  return {{"lsn", record.lsn},
          {"state", record.state == wire::JournalState::pending ? "pending" : "applied"},
          {"time", time_for_programs(moment)},
          {"age_ns", moment.age_ns},
          {"type", journal::name_of(static_cast<RecordType>(record.type))},
          {"topic", topic.empty() ? Object(nullptr) : Object(topic)},
          {"process", process_object(record.process)},
          {"receiver", process_object(record.receiver)},
          {"arguments", arguments_object(record)},
          {"text", subject_of(record) + ": " + deed_of(record) + state_words(record, journal)}};
}

std::string line_of(const JournalRecord& record, const Journal& journal) {
  const std::string when =
      is_damaged(record) ? "--:--:--.---" : clock_time_for_people(moment_of(record, journal.end));
  return when + " #" + std::to_string(record.lsn) + ' ' + subject_of(record) + ": " +
         deed_of(record) + state_words(record, journal);
}

std::string now_for_people() { return clock_time_for_people(moment_of({}, {})); }
std::string now_for_programs() { return time_for_programs(moment_of({}, {})); }

namespace {

class Printer {
 public:
  Printer(const Arguments& arguments, Console& console, JournalFilter filter)
      : arguments_(arguments), console_(console), filter_(std::move(filter)) {}

  bool filters() const { return !filter_.topic.empty() || !filter_.process.empty(); }

  /// Prints at most the newest `count` of the selected records.
  void print(const Journal& journal, std::uint64_t count, bool first) {
    std::vector<const JournalRecord*> chosen;
    for (const JournalRecord& record : journal.records) {
      if (passes(record, filter_)) chosen.push_back(&record);
    }
    if (chosen.size() > count)
      chosen.erase(chosen.begin(), chosen.end() - static_cast<std::ptrdiff_t>(count));
    const bool reaches_back = chosen.size() < count;
    if (arguments_.json != Json::no) {
      Object records = Object::array();
      for (const JournalRecord* const record : chosen)
        records.push_back(record_object(*record, journal));
      console_.object({{"schema", "agnocast.journal/1"},
                       {"oldest", journal.end.oldest},
                       {"newest", journal.end.newest},
                       {"records", records}},
                      arguments_.json);
    } else {
      if (first && reaches_back && journal.end.oldest > 1)
        console_.line("records before #" + std::to_string(journal.end.oldest) +
                      " have been overwritten");
      for (const JournalRecord* const record : chosen) console_.line(line_of(*record, journal));
    }
    console_.flush();
  }

 private:
  const Arguments& arguments_;
  Console& console_;
  JournalFilter filter_;
};

// Prints new records until a signal arrives or the daemon stays absent.
Outcome<void> follow(Observer observer, std::uint64_t seen, const Arguments& arguments,
                     Printer& printer) {
  for (int failures = 0;;) {
    std::this_thread::sleep_for(follow_interval);
    auto look = observer.read_journal(0, 0);
    if (!look) {
      if (look.error().status != Status::not_reachable || ++failures > follow_attempts)
        return tl::unexpected(look.error());
      if (auto again = Observer::connect(arguments.socket)) observer = std::move(*again);
      continue;
    }
    failures = 0;
    const std::uint64_t newest = look->end.newest;
    if (newest < seen) seen = 0;  // another incarnation of the daemon
    if (newest == seen) continue;
    const auto news = observer.read_journal(newest, newest - seen);
    if (!news) continue;  // retry at the next look
    printer.print(*news, all, false);
    seen = newest;
  }
}

}  // namespace

Outcome<void> show_journal(const Arguments& arguments, Console& console) {
  auto filter = filter_of(arguments);
  if (!filter) return tl::unexpected(filter.error());
  auto observer = Observer::connect(arguments.socket);
  if (!observer) return tl::unexpected(observer.error());
  Printer printer(arguments, console, std::move(*filter));
  auto journal =
      observer->read_journal(0, printer.filters() ? all : arguments.whole(options::records));
  if (!journal) return tl::unexpected(journal.error());
  printer.print(*journal, arguments.whole(options::records), true);
  if (!arguments.has(options::follow)) return {};
  return follow(std::move(*observer), journal->end.newest, arguments, printer);
}

}  // namespace agnocast::ctl
