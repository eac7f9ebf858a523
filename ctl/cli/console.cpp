// SPDX-License-Identifier: Apache-2.0

#include <ctl/cli/console.hpp>

#include <algorithm>
#include <cinttypes>
#include <limits>

namespace agnocast::ctl {

void Console::object(const Object& object, Json form) {
  // Names are any bytes that a client chose: invalid UTF-8 is replaced, not refused. The output is
  // ASCII: characters that reverse a terminal's direction of writing are escaped.
  line(object.dump(form == Json::pretty ? 2 : -1, ' ', true, Object::error_handler_t::replace));
}

std::string Console::strong(std::string_view text) const {
  if (!colour_) return std::string(text);
  return "\x1b[1m" + std::string(text) + "\x1b[0m";
}

std::vector<std::string> Table::lines() const {
  std::vector<std::size_t> width(rows_.front().size(), 0);
  for (const auto& row : rows_) {
    for (std::size_t i = 0; i < row.size(); ++i) width[i] = std::max(width[i], row[i].size());
  }
  std::vector<std::string> lines;
  for (const auto& row : rows_) {
    std::string text;
    for (std::size_t i = 0; i < row.size(); ++i) {
      text += row[i];
      if (i + 1 < row.size()) text.append(width[i] - row[i].size() + 2, ' ');
    }
    lines.push_back(std::move(text));
  }
  return lines;
}

void Table::print(Console& console) const {
  bool heading = true;
  for (const std::string& text : lines()) {
    console.line(heading ? console.strong(text) : text);
    heading = false;
  }
}

std::string bytes_for_people(std::uint64_t bytes) {
  constexpr const char* units[] = {"B", "KiB", "MiB", "GiB", "TiB", "PiB", "EiB"};
  if (bytes < 1024) return std::to_string(bytes) + " B";
  std::size_t unit = 0;
  double value = static_cast<double>(bytes);
  for (; value >= 1024 && unit + 1 < std::size(units); ++unit) value /= 1024;
  char text[32];
  std::snprintf(text, sizeof text, "%.1f %s", value, units[unit]);
  return text;
}

std::string duration_for_people(std::uint64_t nanoseconds) {
  const std::uint64_t seconds = nanoseconds / 1'000'000'000;
  if (seconds == 0) return "under 1 s";
  if (seconds < 60) return std::to_string(seconds) + " s";
  if (seconds < 3600)
    return std::to_string(seconds / 60) + " min " + std::to_string(seconds % 60) + " s";
  if (seconds < 86400)
    return std::to_string(seconds / 3600) + " h " + std::to_string(seconds / 60 % 60) + " min";
  return std::to_string(seconds / 86400) + " d " + std::to_string(seconds / 3600 % 24) + " h";
}

std::string time_for_people(std::uint64_t nanoseconds) {
  if (nanoseconds >= 60'000'000'000) return duration_for_people(nanoseconds);
  constexpr struct {
    double length_ns;
    const char* name;
  } units[] = {{1e9, "s"}, {1e6, "ms"}, {1e3, "us"}, {1, "ns"}};
  const auto value = static_cast<double>(nanoseconds);
  for (const auto& unit : units) {
    if (value < unit.length_ns) continue;
    char text[32];
    std::snprintf(text, sizeof text, "%.1f %s", value / unit.length_ns, unit.name);
    return text;
  }
  return "0 ns";
}

std::string counted(std::uint64_t count, std::string_view one, std::string_view many) {
  std::string text = std::to_string(count) + ' ';
  if (count == 1) return text.append(one);
  return many.empty() ? text.append(one) + 's' : text.append(many);
}

std::string hexadecimal(std::uint64_t value) {
  char text[32];
  std::snprintf(text, sizeof text, "0x%016" PRIx64, value);
  return text;
}

Object limit_or_null(std::uint64_t limit) {
  return limit == std::numeric_limits<std::uint64_t>::max() ? Object(nullptr) : Object(limit);
}

}  // namespace agnocast::ctl
