// SPDX-License-Identifier: Apache-2.0

#include <bench/options.hpp>

#include <CLI/CLI.hpp>

#include <algorithm>
#include <cmath>
#include <cstdio>

namespace agnocast::bench {
namespace {

// A number and the unit behind it.
bool split(const std::string& text, double& number, std::string& unit) {
  std::size_t end = 0;
  try {
    number = std::stod(text, &end);
  } catch (const std::exception&) {
    return false;
  }
  unit = text.substr(end);
  return std::isfinite(number) && number >= 0 && number < 1e15;
}

std::string check_size(const std::string& text) {
  return size_of(text) >= 16 ? "" : "'" + text + "' is no size of 16 bytes or more, like 1K or 8M";
}
std::string check_period(const std::string& text) {
  return period_of(text).count() >= 0 ? "" : "'" + text + "' is no time like 250us, 1ms or 1s";
}
CLI::Validator one_of(const std::vector<std::string>& names, const char* kind) {
  return CLI::Validator(
      [names, kind](std::string& text) {
        if (std::find(names.begin(), names.end(), text) != names.end()) return std::string();
        std::string all;
        for (const std::string& name : names) all += " " + name;
        return "there is no " + std::string(kind) + " '" + text +
               "' in this build; there are:" + all;
      },
      "");
}

}  // namespace

std::size_t size_of(const std::string& text) {
  double number = 0;
  std::string unit;
  if (!split(text, number, unit)) return 0;
  const std::size_t place = std::string("KMG").find(unit.empty() ? '?' : unit[0]);
  const bool is_plain = unit.empty() || unit == "B";
  const bool is_scaled =
      place < 3 && (unit.size() == 1 || unit.substr(1) == "B" || unit.substr(1) == "iB");
  if (!is_plain && !is_scaled) return 0;
  return static_cast<std::size_t>(
      std::ldexp(number, is_plain ? 0 : static_cast<int>(10 * (place + 1))));
}

std::chrono::microseconds period_of(const std::string& text) {
  double number = 0;
  std::string unit;
  if (!split(text, number, unit)) return std::chrono::microseconds(-1);
  const double factor = unit == "us" ? 1 : unit == "ms" ? 1e3 : unit == "s" ? 1e6 : -1;
  if (factor < 0) return std::chrono::microseconds(-1);
  return std::chrono::microseconds(static_cast<std::int64_t>(number * factor));
}

std::string size_text(std::size_t bytes) {
  char text[32];
  const auto value = static_cast<double>(bytes);
  if (bytes < 1024) {
    std::snprintf(text, sizeof text, "%zu B", bytes);
  } else if (bytes < 1024 * 1024) {
    std::snprintf(text, sizeof text, "%.4g KiB", value / 1024);
  } else {
    std::snprintf(text, sizeof text, "%.4g MiB", value / 1024 / 1024);
  }
  return text;
}

Options parse(const std::vector<std::string>& arguments, const std::vector<std::string>& cases,
              const std::vector<std::string>& systems) {
  Options options;
  Run& run = options.run;
  std::vector<std::string> sizes;
  std::string period;
  std::size_t rounds = 0, messages = 0;
  std::vector<std::string> with_all = cases;
  with_all.emplace_back("all");
  CLI::App app{
      "Compares agnocast with other ways to carry messages on this host. The systems run "
      "interleaved\n"
      "in one run; ratios are to the floor of the same round, medians over the rounds."};
  app.name("agnocast-bench");
  app.get_formatter()->column_width(30);
  app.add_option("CASE", options.cases, "what to measure (--list names them); all: everything")
      ->check(one_of(with_all, "case"));
  app.add_flag("--list", options.is_list, "say which cases and systems this build has");
  auto* const rounds_option =
      app.add_option("--rounds", rounds, "how often each system has its turn")
          ->check(CLI::Range(1, 1000))
          ->type_name("N");
  auto* const messages_option =
      app.add_option("--messages", messages, "messages of a system's turn")
          ->check(CLI::Range(1, 1000000))
          ->type_name("N");
  app.add_option("--period", period, "time between messages, like 1ms")
      ->check(check_period)
      ->type_name("TIME");
  app.add_option("--sizes", sizes, "payloads, like 1K,1M")
      ->delimiter(',')
      ->check(check_size)
      ->type_name("A,B");
  app.add_option("--systems", run.systems, "these alone")
      ->delimiter(',')
      ->check(one_of(systems, "system"))
      ->type_name("A,B");
  app.add_option("--scan", run.scan, "pipeline: a recorded scan of 5 float32 per point")
      ->check(CLI::ExistingFile)
      ->type_name("FILE");
  app.add_flag("--small", run.is_small, "as short as works: to see that it does, not to measure");
  app.add_option("--json", options.json, "write the results there; -: to stdout, and no tables")
      ->type_name("FILE");
  app.add_option("--plot", options.plot, "draw pictures into this directory, as SVG and PNG")
      ->type_name("DIR");
  try {
    app.parse(std::vector<std::string>(arguments.rbegin(), arguments.rend()));
  } catch (const CLI::CallForHelp&) {
    options.help = app.help();
    return options;
  } catch (const CLI::ParseError& error) {
    options.error = error.what();
    return options;
  }
  if (options.cases.empty() && !options.is_list) options.error = "which case?";
  if (std::find(options.cases.begin(), options.cases.end(), "all") != options.cases.end())
    options.cases = cases;
  if (rounds_option->count() > 0) run.rounds = rounds;
  if (messages_option->count() > 0) run.messages = messages;
  if (!period.empty()) run.period = period_of(period);
  for (const std::string& size : sizes) run.sizes.push_back(size_of(size));
  return options;
}

}  // namespace agnocast::bench
