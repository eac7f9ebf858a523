// SPDX-License-Identifier: Apache-2.0

#include <base/text/log.hpp>

#include <base/descriptors/unique_fd.hpp>
#include <base/text/standard_error.hpp>
#include <base/text/text.hpp>

#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <charconv>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <memory>
#include <utility>

namespace agnocast {
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

// Returns whether a value needs no quotes: it ends at the next space and contains nothing
// ambiguous.
bool is_plain(std::string_view text) noexcept {
  if (text.empty() || text.size() > value_bytes_max) return false;
  return std::all_of(text.begin(), text.end(), [](char c) {
    return c > ' ' && c <= '~' && c != '"' && c != '\\' && c != '=';
  });
}

bool is_known(const LogField& field) noexcept {
  return !std::holds_alternative<std::monostate>(field.value);
}

/// `shown` escapes a text for output.
template <class Shown>
std::string value_of(const LogField& field, const Shown& shown) {
  if (const auto* number = std::get_if<std::uint64_t>(&field.value)) return std::to_string(*number);
  if (const auto* number = std::get_if<std::int64_t>(&field.value)) return std::to_string(*number);
  return shown(std::get<std::string_view>(field.value));
}

std::string line_of(std::string_view event, Log::FieldSpan fields) {
  std::string line(event);
  for (const LogField& field : fields) {
    if (!is_known(field)) continue;
    line += ' ';
    line += field.key;
    line += '=';
    line += value_of(field, [](std::string_view text) {
      return is_plain(text) ? std::string(text) : in_quotes(text, value_bytes_max);
    });
  }
  return line;
}

/// Builds an entry in Journal Export Format, as the socket takes it: KEY=value lines. No value
/// has a newline.
std::string entry_of(const Log::Program& program, LogLevel level, std::string_view event,
                     Log::FieldSpan fields, const std::string& line) {
  std::string entry = "MESSAGE=" + line +
                      "\nPRIORITY=" + std::to_string(static_cast<unsigned>(level)) +
                      "\nSYSLOG_IDENTIFIER=" + std::string(program.identifier) +
                      "\nAGNOCAST_EVENT=" + std::string(event) + '\n';
  const std::string_view id = program.message_id ? program.message_id(event) : std::string_view();
  if (!id.empty()) entry += "MESSAGE_ID=" + std::string(id) + '\n';
  for (const LogField& field : fields) {
    if (!is_known(field)) continue;
    entry += "AGNOCAST_";
    for (const char c : field.key)
      entry += c >= 'a' && c <= 'z' ? static_cast<char>(c - 'a' + 'A') : c;
    entry += '=';
    entry += value_of(field, [](std::string_view text) { return escaped(text, value_bytes_max); });
    entry += '\n';
  }
  return entry;
}

// sd_journal_send() would wait for a journald that does not read.
class JournalSocket {
 public:
  explicit JournalSocket(std::string path) : path_(std::move(path)) {}

  bool connect() {
    sockaddr_un address{};
    address.sun_family = AF_UNIX;
    path_.copy(address.sun_path, sizeof address.sun_path - 1);
    socket_.reset(::socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC, 0));
    return socket_ && ::connect(socket_.get(), reinterpret_cast<const sockaddr*>(&address),
                                sizeof address) == 0;
  }
  bool send(std::string_view entry) {
    const auto sent = [&] {
      return ::send(socket_.get(), entry.data(), entry.size(), MSG_DONTWAIT | MSG_NOSIGNAL) ==
             static_cast<ssize_t>(entry.size());
    };
    // The socket may belong to a new journald at the same path.
    return sent() || (errno != EAGAIN && connect() && sent());
  }

 private:
  std::string path_;
  UniqueFd socket_;
};

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

Log::Log(Program program, LogLevel level, Format format, Sink sink, Clock clock)
    : program_(program),
      level_(level),
      format_(format),
      sink_(std::move(sink)),
      clock_(std::move(clock)) {}

Log Log::to_stderr(Program program, LogLevel level, const std::string& journal_path) {
  if (!is_journal_stream(std::getenv("JOURNAL_STREAM"), STDERR_FILENO))
    return Log(program, level, Format::people, say_on_stderr, wall_clock);
  const auto journal = std::make_shared<JournalSocket>(journal_path);
  if (!journal->connect())
    return Log(program, level, Format::journald_pipe, say_on_stderr, wall_clock);
  return Log(
      program, level, Format::journald,
      [journal](std::string_view entry) { return journal->send(entry); }, wall_clock);
}

void Log::write(LogLevel level, std::string_view event, FieldSpan fields) {
  if (!is_written(level)) return;
  const LogField count("count", lost_);
  if (lost_ != 0 && sink_(text_of(LogLevel::warning, "lines were lost", FieldSpan(&count, 1))))
    lost_ = 0;
  if (!sink_(text_of(level, event, fields))) ++lost_;
}

std::string Log::text_of(LogLevel level, std::string_view event, FieldSpan fields) const {
  std::string line;
  if (format_ == Format::journald_pipe)
    line = '<' + std::to_string(static_cast<unsigned>(level)) + '>';
  if (format_ == Format::people)
    line = time_text(clock_()) + ' ' + std::string(name_of(level)) + ' ';
  line += line_of(event, fields);
  if (line.size() >= line_bytes_max) {
    line.resize(line_bytes_max - 4);
    line += "...";
  }
  if (format_ == Format::journald) return entry_of(program_, level, event, fields, line);
  return line + '\n';
}

void Log::write_limited(std::string_view cause_name, LogLevel level, std::string_view event,
                        FieldSpan fields) {
  if (!is_written(level)) return;
  const std::uint64_t now = clock_();
  std::string name(cause_name.substr(0, cause_bytes_max));
  if (causes_.size() >= cause_count_max && !causes_.contains(name)) {
    flush();
    if (causes_.size() >= cause_count_max) name = shared_cause;
  }
  auto [entry, is_new] = causes_.try_emplace(std::move(name));
  Cause& cause = entry->second;
  // A wall clock set back ends the interval as well.
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

}  // namespace agnocast
