// SPDX-License-Identifier: Apache-2.0

#include <bench/options.hpp>

#include <CLI/CLI.hpp>

#include <algorithm>
#include <cmath>
#include <cstdio>

namespace agnocast::bench {
namespace {

// Splits a number and its unit.
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
  return size_of(text) >= 16 ? ""
                             : "'" + text + "' is not a size of 16 bytes or more, like 1K or 8M";
}
std::string check_period(const std::string& text) {
  return period_of(text).count() >= 0 ? "" : "'" + text + "' is not a time like 250us, 1ms or 1s";
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

// Options that only some cases read.
constexpr std::string_view of_some_cases[] = {"--rounds", "--messages", "--period",
                                              "--sizes",  "--systems",  "--scan"};

/// Returns why `what` is wrong unless a requested case `takes` it; empty: nothing is wrong.
template <class Takes>
std::string refusal(const std::string& what, const std::vector<std::string>& asked,
                    const std::vector<Case>& cases, Takes takes) {
  std::string those, others;
  for (const Case& one : cases) {
    const bool is_asked = std::find(asked.begin(), asked.end(), one.name) != asked.end();
    if (is_asked && takes(one)) return "";
    std::string& list = is_asked ? those : others;
    if (is_asked || takes(one)) list += (list.empty() ? "" : ", ") + std::string(one.name);
  }
  const std::string nobody =
      asked.size() == 1 ? those + " does not take " : "none of " + those + " takes ";
  return nobody + what + "; leave it out" + (others.empty() ? "" : ", or ask for " + others);
}

/// Every requested case that reads sizes must accept all of them: sizes cannot be assigned to
/// cases.
std::string refusal_of_sizes(const Options& options, const std::vector<Case>& cases) {
  const std::vector<std::size_t>& sizes = options.run.sizes;
  for (const Case& one : cases) {
    const bool is_asked =
        std::find(options.cases.begin(), options.cases.end(), one.name) != options.cases.end();
    if (!is_asked || one.reads.count("--sizes") == 0) continue;
    const std::string name(one.name);
    if (sizes.size() > one.sizes_max)
      return name + " does not take more than one of --sizes; give one, or leave " + name + " out";
    for (const std::size_t size : sizes) {
      const std::vector<std::size_t>& known = one.sizes_of;
      if (known.empty() || std::find(known.begin(), known.end(), size) != known.end()) continue;
      std::string all;
      for (const std::size_t other : known) all += (all.empty() ? "" : " and ") + size_text(other);
      return name + " has messages of " + all + " only, and none of " + size_text(size) +
             "; leave it out of --sizes, or leave " + name + " out";
    }
  }
  return "";
}

std::string first_refusal(const Options& options, const CLI::App& app,
                          const std::vector<Case>& cases) {
  std::string why;
  for (const std::string_view option : of_some_cases) {
    if (app.get_option(std::string(option))->count() == 0) continue;
    why = refusal(std::string(option), options.cases, cases,
                  [&](const Case& one) { return one.reads.count(option) != 0; });
    if (!why.empty()) return why;
  }
  for (const std::string& system : options.run.systems) {
    why = refusal("--systems " + system, options.cases, cases,
                  [&](const Case& one) { return compares(one, system); });
    if (!why.empty()) return why;
  }
  return refusal_of_sizes(options, cases);
}

}  // namespace

std::string options_text(const Case& one) {
  std::string text;
  for (const std::string_view option : of_some_cases) {
    if (one.reads.count(option) == 0) continue;
    text += (text.empty() ? "" : " ") + std::string(option);
    if (option == "--sizes" && one.sizes_max == 1) text += " (one)";
  }
  return text;
}

bool compares(const Case& one, std::string_view system) {
  if (one.systems == nullptr) return false;
  const std::vector<SystemName> all = one.systems();
  return std::any_of(all.begin(), all.end(),
                     [&](const SystemName& name) { return name.name == system; });
}

std::vector<SystemName> systems_of(const std::vector<Case>& cases) {
  std::vector<SystemName> all;
  for (const Case& one : cases) {
    if (one.systems == nullptr) continue;
    for (const SystemName& name : one.systems()) {
      const bool is_known = std::any_of(
          all.begin(), all.end(), [&](const SystemName& known) { return known.name == name.name; });
      if (!is_known) all.push_back(name);
    }
  }
  return all;
}

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

/// Long because each option has its branch.
Options parse(const std::vector<std::string>& arguments, const std::vector<Case>& cases) {
  Options options;
  std::vector<std::string> names, systems;
  std::string which = "Which case reads which, beside --small, --json and --plot:\n";
  for (const Case& one : cases) {
    names.emplace_back(one.name);
    which += "  " + names.back() + ": " + options_text(one) + "\n";
  }
  for (const SystemName& name : systems_of(cases)) systems.emplace_back(name.name);
  Run& run = options.run;
  std::vector<std::string> sizes;
  std::string period;
  std::size_t rounds = 0, messages = 0;
  std::vector<std::string> with_all = names;
  with_all.emplace_back("all");
  CLI::App app{
      "Compares agnocast with other ways to carry messages on this host. The systems run "
      "interleaved\n"
      "in one run; ratios are to the floor of the same round, medians over the rounds."};
  app.name("agnocast-bench");
  app.get_formatter()->column_width(30);
  app.footer(which);
  app.add_option("CASE", options.cases, "what to measure (--list names them); all: everything")
      ->check(one_of(with_all, "case"));
  app.add_flag("--list", options.is_list,
               "print the cases and systems of this build, and how long they take");
  auto* const rounds_option = app.add_option("--rounds", rounds, "number of rounds of each system")
                                  ->check(CLI::Range(1, 1000))
                                  ->type_name("N");
  auto* const messages_option =
      app.add_option("--messages", messages, "messages of a system per round")
          ->check(CLI::Range(1, 1000000))
          ->type_name("N");
  app.add_option("--period", period, "time between messages, like 1ms")
      ->check(check_period)
      ->type_name("TIME");
  app.add_option("--sizes", sizes, "payloads, like 1K,1M")
      ->delimiter(',')
      ->check(check_size)
      ->type_name("A,B");
  app.add_option("--systems", run.systems, "only these")
      ->delimiter(',')
      ->check(one_of(systems, "system"))
      ->type_name("A,B");
  app.add_option("--scan", run.scan, "pipeline: a recorded scan of 5 float32 per point")
      ->check(CLI::ExistingFile)
      ->type_name("FILE");
  app.add_flag("--small", run.is_small, "as short as possible: to check it, not to measure");
  app.add_option("--json", options.json, "write results to this file; -: to stdout, without tables")
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
    options.cases = names;
  if (rounds_option->count() > 0) run.rounds = rounds;
  if (messages_option->count() > 0) run.messages = messages;
  if (!period.empty()) run.period = period_of(period);
  for (const std::string& size : sizes) run.sizes.push_back(size_of(size));
  options.is_default =
      !run.is_small &&
      std::all_of(std::begin(of_some_cases), std::end(of_some_cases), [&](std::string_view option) {
        return app.get_option(std::string(option))->count() == 0;
      });
  if (options.error.empty() && !options.cases.empty())
    options.error = first_refusal(options, app, cases);
  return options;
}

}  // namespace agnocast::bench
