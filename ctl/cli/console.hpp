// SPDX-License-Identifier: Apache-2.0
//
// Console: how answers look. Tables and plain lines for people, one JSON object for programs.
//
// Names of topics, types, nodes and processes are other people's text: they are printed through
// escaped(), so that nobody writes control characters into a terminal. Colour only on a terminal,
// and not with NO_COLOR.
#pragma once

#include <ctl/cli/arguments.hpp>

#include <nlohmann/json.hpp>

#include <cstdint>
#include <cstdio>
#include <string>
#include <string_view>
#include <vector>

namespace agnocast::ctl {

/// Keys stay in the order in which they are written.
using Object = nlohmann::ordered_json;

class Console {
 public:
  Console(std::FILE* out, bool colour) noexcept : out_(out), colour_(colour) {}

  void line(std::string_view text) { std::fprintf(out_, "%.*s\n", int(text.size()), text.data()); }
  /// Lines, each with its newline.
  void text(std::string_view lines) { std::fwrite(lines.data(), 1, lines.size(), out_); }
  void object(const Object& object, Json form);
  /// Now, although more is to come.
  void flush() { std::fflush(out_); }
  /// `text`, bold on a terminal.
  std::string strong(std::string_view text) const;

 private:
  std::FILE* out_;
  bool colour_;
};

/// Columns as wide as their widest cell; the first row is the heading.
class Table {
 public:
  explicit Table(std::vector<std::string> heading) { rows_.push_back(std::move(heading)); }
  void add(std::vector<std::string> row) { rows_.push_back(std::move(row)); }
  /// The heading, then a line for each row.
  std::vector<std::string> lines() const;
  void print(Console& console) const;

 private:
  std::vector<std::vector<std::string>> rows_;
};

/// "1.5 GiB", "0 B".
std::string bytes_for_people(std::uint64_t bytes);
/// "1 h 2 min", "35 s", "under 1 s".
std::string duration_for_people(std::uint64_t nanoseconds);
/// Of short ones: "41.0 us", "12.3 ms", "7.5 s", "1 min 2 s".
std::string time_for_people(std::uint64_t nanoseconds);
/// "1 message", "2 messages".
std::string counted(std::uint64_t count, std::string_view one, std::string_view many = {});
std::string hexadecimal(std::uint64_t value);
/// Unlimited is no number in JSON.
Object limit_or_null(std::uint64_t limit);

}  // namespace agnocast::ctl
