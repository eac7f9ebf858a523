// SPDX-License-Identifier: Apache-2.0

#include <daemon/config/scheduling_text.hpp>

#include <base/text/text.hpp>

#include <sched.h>

#include <charconv>
#include <limits>
#include <utility>

namespace agnocast::daemon {
namespace {

constexpr std::pair<std::string_view, std::uint32_t> policies[] = {
    {"other", SCHED_OTHER}, {"fifo", SCHED_FIFO}, {"rr", SCHED_RR},
    {"batch", SCHED_BATCH}, {"idle", SCHED_IDLE}, {"deadline", SCHED_DEADLINE}};

constexpr std::uint64_t nanoseconds_max = std::numeric_limits<std::int64_t>::max();
constexpr std::pair<std::string_view, std::uint64_t> time_units[] = {
    {"s", 1'000'000'000}, {"ms", 1'000'000}, {"us", 1'000}, {"ns", 1}};

// Takes a number from the front of `text`.
std::optional<std::uint64_t> take_number(std::string_view& text) noexcept {
  std::uint64_t number = 0;
  const auto parsed = std::from_chars(text.data(), text.data() + text.size(), number);
  if (parsed.ec != std::errc()) return std::nullopt;
  text.remove_prefix(static_cast<std::size_t>(parsed.ptr - text.data()));
  return number;
}

// Adds one part of a list: "6" or "0-3".
std::optional<std::string> read_cpus(std::string_view part,
                                     std::uint64_t (&cpus)[abi::cpu_count_max / 64]) {
  std::string_view rest = part;
  const std::string wrong = in_quotes(part, 32) + " is neither a processor nor a range of them";
  const auto first = take_number(rest);
  if (!first) return wrong;
  auto last = first;
  if (rest.starts_with('-')) {
    rest.remove_prefix(1);
    last = take_number(rest);
  }
  if (!last || !rest.empty()) return wrong;
  if (*first > *last) return in_quotes(part, 32) + " begins with the higher number";
  if (*last >= abi::cpu_count_max) return "processor " + std::to_string(*last) + " is out of range";
  for (std::uint64_t cpu = *first; cpu <= *last; ++cpu)
    cpus[cpu / 64] |= std::uint64_t{1} << cpu % 64;
  return std::nullopt;
}

}  // namespace

std::optional<std::uint32_t> policy_of(std::string_view name) noexcept {
  for (const auto& [known, number] : policies) {
    if (known == name) return number;
  }
  return std::nullopt;
}

std::string_view policy_name(std::uint32_t policy) noexcept {
  for (const auto& [name, number] : policies) {
    if (number == policy) return name;
  }
  return {};
}

std::optional<std::uint64_t> parse_duration(std::string_view text) noexcept {
  const auto count = take_number(text);
  if (!count) return std::nullopt;
  if (text.starts_with(' ')) text.remove_prefix(1);
  for (const auto& [unit, nanoseconds] : time_units) {
    if (text != unit) continue;
    if (*count > nanoseconds_max / nanoseconds) return std::nullopt;
    return *count * nanoseconds;
  }
  return std::nullopt;
}

std::string duration_text(std::uint64_t nanoseconds) {
  for (const auto& [unit, size] : time_units) {
    if (nanoseconds >= size && nanoseconds % size == 0)
      return std::to_string(nanoseconds / size) + std::string(unit);
  }
  return "0ns";
}

std::optional<std::string> read_cpu_list(std::string_view text,
                                         std::uint64_t (&cpus)[abi::cpu_count_max / 64]) {
  while (true) {
    const std::size_t comma = text.find(',');
    if (auto problem = read_cpus(text.substr(0, comma), cpus)) return problem;
    if (comma == std::string_view::npos) return std::nullopt;
    text.remove_prefix(comma + 1);
  }
}

}  // namespace agnocast::daemon
