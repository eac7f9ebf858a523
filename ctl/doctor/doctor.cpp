// SPDX-License-Identifier: Apache-2.0
//
// doctor: prints what is wrong, and the command that fixes it.

#include <ctl/cli/commands.hpp>
#include <ctl/doctor/doctor_facts.hpp>

#include <algorithm>
#include <string>

namespace agnocast::ctl {

std::vector<const Check*> all_checks() {
  std::vector<const Check*> all;
  for (const auto checks :
       {door_checks, host_checks, process_checks, thread_checks, bridge_checks}) {
    for (const Check& check : checks) all.push_back(&check);
  }
  return all;
}

std::string shell_word(std::string_view text) {
  constexpr std::string_view plain =
      "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789_/.:,+@%=-";
  if (!text.empty() && text.find_first_not_of(plain) == std::string_view::npos)
    return std::string(text);
  // Control characters are escaped: the shell decodes them, the terminal must not obey them.
  const bool is_printable =
      std::all_of(text.begin(), text.end(), [](char c) { return c >= ' ' && c < 127; });
  std::string word = is_printable ? "'" : "$'";
  for (const char c : text) {
    char code[8];
    std::snprintf(code, sizeof code, "\\%03o",
                  static_cast<unsigned>(static_cast<unsigned char>(c)));
    if (is_printable) {
      word += c == '\'' ? "'\\''" : std::string(1, c);
    } else {
      word += c >= ' ' && c < 127 && c != '\'' && c != '\\' ? std::string(1, c) : std::string(code);
    }
  }
  return word + '\'';
}

std::string filled(std::string_view remedy, const Fill& words, const Fill& common) {
  std::string text;
  while (!remedy.empty()) {
    const std::size_t length =
        std::min(remedy.find_first_not_of("ABCDEFGHIJKLMNOPQRSTUVWXYZ_"), remedy.size());
    const std::string_view word = remedy.substr(0, std::max<std::size_t>(length, 1));
    remedy.remove_prefix(word.size());
    if (const auto own = words.find(word); own != words.end()) {
      text += own->second;
    } else if (const auto shared = common.find(word); shared != common.end()) {
      text += shared->second;
    } else {
      text += word;
    }
  }
  return text;
}

namespace {

using Severity = Check::Severity;

struct Result {
  const Check* check;
  bool is_skipped;
  std::vector<Ailment> ailments;

  const char* status() const noexcept {
    if (is_skipped) return "skipped";
    if (ailments.empty()) return "ok";
    return check->severity == Severity::failed ? "failed" : "warning";
  }
};

struct Report {
  std::vector<Result> results;
  std::uint64_t run = 0, passed = 0, failed = 0, warnings = 0;
};

Report examine(const Facts& facts) {
  Report report;
  for (const Check* const check : all_checks()) {
    Result result{check, check->needs == Check::Needs::daemon && !facts.look, {}};
    if (!result.is_skipped) {
      result.ailments = check->find(facts);
      ++report.run;
      ++(result.ailments.empty()               ? report.passed
         : check->severity == Severity::failed ? report.failed
                                               : report.warnings);
    }
    report.results.push_back(std::move(result));
  }
  return report;
}

std::string remedy_of(const Result& result, const Ailment& ailment, const Fill& common) {
  return filled(result.check->remedy, ailment.words, common);
}
std::string cause_of(const Result& result, const Ailment& ailment) {
  return ailment.cause.empty() ? std::string(result.check->cause) : ailment.cause;
}

std::string sum_of(const Report& report) {
  std::string text =
      std::to_string(report.passed) + " of " + std::to_string(report.run) + " checks passed";
  if (report.failed != 0) text += ", " + std::to_string(report.failed) + " failed";
  if (report.warnings != 0) text += ", " + counted(report.warnings, "warning");
  const std::uint64_t skipped = report.results.size() - report.run;
  if (skipped != 0) text += ", " + std::to_string(skipped) + " skipped: they need the daemon";
  return text;
}

void print(const Report& report, const Fill& common, Console& console) {
  for (const Result& result : report.results) {
    for (const Ailment& ailment : result.ailments) {
      console.line(std::string(result.status()) + ": " + console.strong(result.check->id) + ": " +
                   ailment.what);
      console.line("  cause: " + cause_of(result, ailment));
      console.line("  fix:   " + remedy_of(result, ailment, common));
    }
  }
  console.line(sum_of(report));
}

Object object_of(const Report& report, const Fill& common) {
  Object checks = Object::array();
  for (const Result& result : report.results) {
    Object findings = Object::array();
    for (const Ailment& ailment : result.ailments)
      findings.push_back({{"what", ailment.what},
                          {"cause", cause_of(result, ailment)},
                          {"remedy", remedy_of(result, ailment, common)}});
    checks.push_back({{"id", result.check->id},
                      {"title", result.check->title},
                      {"status", result.status()},
                      {"findings", findings}});
  }
  return {{"schema", "agnocast.doctor/1"},    {"check_count", report.run},
          {"passed_count", report.passed},    {"failed_count", report.failed},
          {"warning_count", report.warnings}, {"checks", checks}};
}

void list(const Arguments& arguments, Console& console) {
  Object checks = Object::array();
  for (const Check* const check : all_checks()) {
    const char* const severity = check->severity == Severity::failed ? "failed" : "warning";
    checks.push_back({{"id", check->id},
                      {"severity", severity},
                      {"title", check->title},
                      {"cause", check->cause},
                      {"remedy", check->remedy}});
    if (arguments.json != Json::no) continue;
    console.line(console.strong(check->id) + " (" + severity + "): " + std::string(check->title));
    console.line("  cause: " + std::string(check->cause));
    console.line("  fix:   " + std::string(check->remedy));
  }
  if (arguments.json != Json::no)
    console.object({{"schema", "agnocast.doctor-list/1"}, {"checks", checks}}, arguments.json);
}

}  // namespace

Outcome<void> run_doctor(const Arguments& arguments, Console& console) {
  if (arguments.has(options::list_checks)) {
    list(arguments, console);
    return {};
  }
  const Facts facts = collect_facts(arguments);
  const Report report = examine(facts);
  const Fill common = facts.common();
  if (arguments.json == Json::no) {
    print(report, common, console);
  } else {
    console.object(object_of(report, common), arguments.json);
  }
  const bool count_warnings = arguments.has(options::include_warnings);
  const std::uint64_t wrong = report.failed + (count_warnings ? report.warnings : 0);
  if (wrong == 0) return {};
  const auto first_of = [&](Severity severity) {
    return std::find_if(report.results.begin(), report.results.end(), [&](const Result& result) {
      return !result.ailments.empty() && result.check->severity == severity;
    });
  };
  const auto first = first_of(report.failed != 0 ? Severity::failed : Severity::warning);
  return problem(
      Status::check_failed, "doctor",
      counted(wrong, "check") + " failed, the first of them " + std::string(first->check->id),
      remedy_of(*first, first->ailments.front(), common));
}

}  // namespace agnocast::ctl
