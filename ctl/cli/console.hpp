// SPDX-License-Identifier: Apache-2.0
//
// Console: prints tables and lines for people, and one JSON object for programs.
//
// Names of topics, types, nodes and processes come from other users. They are printed through
// escaped(), so that nobody can write control characters to a terminal. Colour is used only on a
// terminal, and not with NO_COLOR.
#pragma once

#include <ctl/cli/arguments.hpp>

#include <nlohmann/json.hpp>

#include <cstdint>
#include <cstdio>
#include <string>
#include <string_view>
#include <vector>

namespace agnocast::ctl {

/// Keeps keys in the order in which they are written.
using Object = nlohmann::ordered_json;

class Console {
 public:
  Console(std::FILE* out, bool colour) noexcept : out_(out), colour_(colour) {}

  void line(std::string_view text) { std::fprintf(out_, "%.*s\n", int(text.size()), text.data()); }
  /// Prints lines, each with its newline.
  void text(std::string_view lines) { std::fwrite(lines.data(), 1, lines.size(), out_); }
  void object(const Object& object, Json form);
  /// Writes out now, before a longer wait.
  void flush() { std::fflush(out_); }
  /// Returns `text`, bold on a terminal.
  std::string strong(std::string_view text) const;

 private:
  std::FILE* out_;
  bool colour_;
};

/// A table; columns are as wide as their widest cell, and the first row is the heading.
class Table {
 public:
  explicit Table(std::vector<std::string> heading) { rows_.push_back(std::move(heading)); }
  void add(std::vector<std::string> row) { rows_.push_back(std::move(row)); }
  /// Returns the heading, then one line a row.
  std::vector<std::string> lines() const;
  void print(Console& console) const;

 private:
  std::vector<std::vector<std::string>> rows_;
};

/// "1.5 GiB", "0 B".
std::string bytes_for_people(std::uint64_t bytes);
/// "1 h 2 min", "35 s", "under 1 s".
std::string duration_for_people(std::uint64_t nanoseconds);
/// For short times: "41.0 us", "12.3 ms", "7.5 s", "1 min 2 s".
std::string time_for_people(std::uint64_t nanoseconds);
/// "1 message", "2 messages".
std::string counted(std::uint64_t count, std::string_view one, std::string_view many = {});
std::string hexadecimal(std::uint64_t value);
/// Returns null for "unlimited", which is not a number in JSON.
Object limit_or_null(std::uint64_t limit);

}  // namespace agnocast::ctl
