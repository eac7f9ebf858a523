// SPDX-License-Identifier: Apache-2.0

#include <base/standard_error.hpp>
#include <base/text.hpp>
#include <daemon/log.hpp>

#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <utility>

namespace agnocast::daemon {
namespace {

constexpr std::pair<LogLevel, std::string_view> levels[] = {{LogLevel::error, "error"},
                                                            {LogLevel::warning, "warning"},
                                                            {LogLevel::notice, "notice"},
                                                            {LogLevel::info, "info"},
                                                            {LogLevel::debug, "debug"}};

constexpr std::string_view shared_cause = "other causes";
constexpr std::size_t cause_bytes_max = 100;
constexpr std::size_t value_bytes_max = 256;

std::string time_text(std::uint64_t now_ns) {
  const auto seconds = static_cast<std::time_t>(now_ns / 1'000'000'000);
  const auto ms = static_cast<unsigned>(now_ns / 1'000'000 % 1000);
  std::tm utc{};
  ::gmtime_r(&seconds, &utc);
  std::array<char, 32> text{};
  const std::size_t bytes = std::strftime(text.data(), text.size(), "%Y-%m-%dT%H:%M:%S", &utc);
  std::array<char, 8> rest{};
  std::snprintf(rest.data(), rest.size(), ".%03uZ", ms);
  return std::string(text.data(), bytes) + rest.data();
}

// What needs no quotes: a value that ends at the next space and looks like nothing else.
bool is_plain(std::string_view text) noexcept {
  if (text.empty() || text.size() > value_bytes_max) return false;
  return std::all_of(text.begin(), text.end(), [](char c) {
    return c > ' ' && c <= '~' && c != '"' && c != '\\' && c != '=';
  });
}

void append(std::string& line, const LogField& field) {
  if (std::holds_alternative<std::monostate>(field.value)) return;
  line += ' ';
  line += field.key;
  line += '=';
  if (const auto* number = std::get_if<std::uint64_t>(&field.value)) {
    line += std::to_string(*number);
  } else if (const auto* signed_number = std::get_if<std::int64_t>(&field.value)) {
    line += std::to_string(*signed_number);
  } else {
    const auto text = std::get<std::string_view>(field.value);
    line += is_plain(text) ? std::string(text) : in_quotes(text, value_bytes_max);
  }
}

std::uint64_t wall_clock() {
  timespec now{};
  ::clock_gettime(CLOCK_REALTIME, &now);
  return static_cast<std::uint64_t>(now.tv_sec) * 1'000'000'000 +
         static_cast<std::uint64_t>(now.tv_nsec);
}

}  // namespace

std::string_view name_of(LogLevel level) noexcept {
  for (const auto& [known, name] : levels) {
    if (known == level) return name;
  }
  return "unknown";
}

std::optional<LogLevel> log_level_of(std::string_view name) noexcept {
  for (const auto& [level, known] : levels) {
    if (known == name) return level;
  }
  return std::nullopt;
}

Log::Log(LogLevel level, Format format, Sink sink, Clock clock)
    : level_(level), format_(format), sink_(std::move(sink)), clock_(std::move(clock)) {}

Log Log::to_stderr(LogLevel level) {
  const bool to_journal = is_journal_stream(std::getenv("JOURNAL_STREAM"), STDERR_FILENO);
  return Log(level, to_journal ? Format::journald : Format::people, say_on_stderr, wall_clock);
}

void Log::write(LogLevel level, std::string_view event, Fields fields) {
  if (!is_written(level)) return;
  if (lost_ != 0 && sink_(line_of(LogLevel::warning, "lines were lost", {{"count", lost_}})))
    lost_ = 0;
  if (!sink_(line_of(level, event, fields))) ++lost_;
}

std::string Log::line_of(LogLevel level, std::string_view event, Fields fields) const {
  std::string line;
  if (format_ == Format::journald) {
    line = '<' + std::to_string(static_cast<unsigned>(level)) + '>';
  } else {
    line = time_text(clock_()) + ' ' + std::string(name_of(level)) + ' ';
  }
  line += event;
  for (const LogField& field : fields) append(line, field);
  if (line.size() >= line_bytes_max) {
    line.resize(line_bytes_max - 4);
    line += "...";
  }
  line += '\n';
  return line;
}

void Log::write_limited(std::string_view cause_name, LogLevel level, std::string_view event,
                        Fields fields) {
  if (!is_written(level)) return;
  const std::uint64_t now = clock_();
  std::string name(cause_name.substr(0, cause_bytes_max));
  if (causes_.size() >= cause_count_max && !causes_.contains(name)) {
    flush();
    if (causes_.size() >= cause_count_max) name = shared_cause;
  }
  auto [entry, is_new] = causes_.try_emplace(std::move(name));
  Cause& cause = entry->second;
  // A wall clock that was set back ends the interval as well.
  const bool is_over = now - cause.began_ns >= interval_ns;
  if (is_new || is_over) {
    if (cause.left_out != 0) say_left_out(entry->first, cause);
    cause = {now, 0, 0, level};
  }
  cause.level = std::min(cause.level, level);
  if (cause.written == lines_per_interval) {
    ++cause.left_out;
    return;
  }
  ++cause.written;
  write(level, event, fields);
}

void Log::flush(bool all) {
  const std::uint64_t now = clock_();
  std::erase_if(causes_, [&](const auto& entry) {
    const auto& [name, cause] = entry;
    const bool is_over = now - cause.began_ns >= interval_ns;
    if (!all && !is_over) return false;
    if (cause.left_out != 0) say_left_out(name, cause);
    return true;
  });
}

void Log::say_left_out(const std::string& name, const Cause& cause) {
  const std::uint64_t now = clock_();
  const std::uint64_t elapsed_ns = now > cause.began_ns ? now - cause.began_ns : 0;
  write(cause.level, "more of the same was left out",
        {{"cause", name}, {"repeated", cause.left_out}, {"seconds", elapsed_ns / 1'000'000'000}});
}

bool is_journal_stream(const char* journal_stream, int fd) noexcept {
  if (journal_stream == nullptr) return false;
  const std::string_view text(journal_stream);
  std::uint64_t device = 0;
  std::uint64_t inode = 0;
  const char* const end = text.data() + text.size();
  const auto first = std::from_chars(text.data(), end, device);
  if (first.ec != std::errc() || first.ptr == end || *first.ptr != ':') return false;
  const auto second = std::from_chars(first.ptr + 1, end, inode);
  if (second.ec != std::errc() || second.ptr != end) return false;
  struct stat file {};
  return ::fstat(fd, &file) == 0 && file.st_dev == device && file.st_ino == inode;
}

}  // namespace agnocast::daemon
