// SPDX-License-Identifier: Apache-2.0
//
// Log: the output of our programs for people, one line per event.
//
//   to people     2026-01-31T12:00:00.123Z warning client refused uid=1000 why="no rule"
//   to journald   an entry: the same line as MESSAGE=; for searches AGNOCAST_EVENT=client refused,
//                 AGNOCAST_UID=1000, AGNOCAST_WHY=no rule, and MESSAGE_ID= of events that have one
//   to its pipe   <4>client refused uid=1000 why="no rule"    if the entry cannot be sent; stderr
//
// Event texts are constant and never contain data, so that one can search for them; the data are
// fields. Untrusted texts (names, paths) are escaped and cut, so no client can forge a line,
// control a terminal or fill the disk with one event. Events that a client can cause at will go
// through write_limited(): it writes a few lines per cause and interval, counts the rest and
// reports the count.
//
// For one thread. Nothing here fails or waits: a line that does not fit is lost, and the next
// written line reports how many were.
#pragma once

#include <agnocast/error.hpp>

#include <concepts>
#include <cstdint>
#include <functional>
#include <initializer_list>
#include <map>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <variant>

namespace agnocast {

/// The numbers are those of syslog, which journald's prefixes use.
enum class LogLevel : std::uint8_t { error = 3, warning = 4, notice = 5, info = 6, debug = 7 };

inline constexpr std::string_view log_level_names = "error, warning, notice, info, debug";
std::string_view name_of(LogLevel level) noexcept;
std::optional<LogLevel> log_level_of(std::string_view name) noexcept;

struct LogField {
  std::string_view key;
  std::variant<std::uint64_t, std::int64_t, std::string_view, std::monostate> value;

  LogField(std::string_view name, std::string_view text) : key(name), value(text) {}
  LogField(std::string_view name, const char* text) : key(name), value(std::string_view(text)) {}
  LogField(std::string_view name, const std::string& text)
      : key(name), value(std::string_view(text)) {}
  template <std::unsigned_integral T>
  LogField(std::string_view name, T number) : key(name), value(std::uint64_t{number}) {}
  template <std::signed_integral T>
  LogField(std::string_view name, T number) : key(name), value(std::int64_t{number}) {}
  /// An optional field: omitted if empty.
  template <class T>
  LogField(std::string_view name, const std::optional<T>& known)
      : key(name), value(std::monostate()) {
    if (known) value = LogField(name, *known).value;
  }
};

class Log {
 public:
  enum class Format : std::uint8_t { people, journald_pipe, journald };
  using Fields = std::initializer_list<LogField>;
  using FieldSpan = std::span<const LogField>;
  /// Identifier of the program in the systemd journal, and the message ids of its events (empty:
  /// none).
  struct Program {
    std::string_view identifier;
    std::string_view (*message_id)(std::string_view event) = nullptr;
  };

  /// Writes a line, with its newline; with Format::journald, an entry. Returns false if it was
  /// lost.
  using Sink = std::function<bool(std::string_view line)>;
  /// Nanoseconds since 1970.
  using Clock = std::function<std::uint64_t()>;

  // A line with its newline; journald would split longer ones at 48 KiB, people much earlier.
  static constexpr std::size_t line_bytes_max = 1024;
  static constexpr std::uint64_t interval_ns = 10'000'000'000;
  static constexpr std::uint64_t lines_per_interval = 5;
  // Causes that are counted separately; the others share one count.
  static constexpr std::size_t cause_count_max = 256;

  Log(Program program, LogLevel level, Format format, Sink sink, Clock clock);
  /// Writes lines to stderr, or entries to journald if stderr goes there (JOURNAL_STREAM).
  static Log to_stderr(Program program, LogLevel level,
                       const std::string& journal = "/run/systemd/journal/socket");

  void write(LogLevel level, std::string_view event, FieldSpan fields);
  void write(LogLevel level, std::string_view event, Fields fields = {}) {
    write(level, event, FieldSpan(fields.begin(), fields.size()));
  }
  /// The same, at most lines_per_interval times per `cause` and interval. A cause names the
  /// common part of a flood, for example event and uid.
  void write_limited(std::string_view cause, LogLevel level, std::string_view event,
                     FieldSpan fields);
  void write_limited(std::string_view cause, LogLevel level, std::string_view event,
                     Fields fields = {}) {
    write_limited(cause, level, event, FieldSpan(fields.begin(), fields.size()));
  }
  /// Reports the counts of omitted lines in past intervals. Call it now and then, and at the end
  /// with `all`.
  void flush(bool all = false);

  LogLevel level() const noexcept { return level_; }
  void set_level(LogLevel level) noexcept { level_ = level; }
  bool is_written(LogLevel level) const noexcept { return level <= level_; }

 private:
  struct Cause {
    std::uint64_t began_ns = 0;
    std::uint64_t written = 0;
    std::uint64_t left_out = 0;
    LogLevel level = LogLevel::info;
  };

  std::string text_of(LogLevel level, std::string_view event, FieldSpan fields) const;
  void say_left_out(const std::string& name, const Cause& cause);

  Program program_;
  LogLevel level_;
  Format format_;
  Sink sink_;
  Clock clock_;
  std::map<std::string, Cause, std::less<>> causes_;
  std::uint64_t lost_ = 0;  // lines since the last written one
};

/// Returns whether `fd` is the stream in JOURNAL_STREAM (its value, or null): "device:inode".
bool is_journal_stream(const char* journal_stream, int fd) noexcept;

}  // namespace agnocast
