// SPDX-License-Identifier: Apache-2.0
//
// agnocast-bench: compares systems side by side. Runs the requested cases, writes their results,
// and has agnocast-bench-plot draw the plots. Its own processes start as %ROLE (process.hpp).
//
// Exit status: 0 done, 1 a failure, 2 wrong usage.

#include <bench/cases.hpp>
#include <bench/environment.hpp>
#include <bench/options.hpp>
#include <bench/process.hpp>
#include <bench/services.hpp>
#include <bench/system.hpp>

#include <fcntl.h>
#include <signal.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <exception>
#include <fstream>
#include <optional>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

namespace agnocast::bench {
namespace {

int refuse(const std::string& what) {
  std::fprintf(stderr, "agnocast-bench: %s\nhint: agnocast-bench --help\n", what.c_str());
  return 2;
}

// Ctrl-C ends a measurement of minutes: first its processes, then its directories. All threads
// block the signals and one waits for them, so that nothing is interrupted in the middle; Process
// unblocks them again.
void clean_up_on_signals() {
  static sigset_t signals;
  ::sigemptyset(&signals);
  for (const int signal : {SIGINT, SIGTERM, SIGHUP}) ::sigaddset(&signals, signal);
  ::pthread_sigmask(SIG_BLOCK, &signals, nullptr);
  std::thread([] {
    int signal = 0;
    ::sigwait(&signals, &signal);
    Process::end_all();
    remove_directories();
    ::_exit(128 + signal);
  }).detach();
}

std::string padded(std::string_view name) {
  return "  " + std::string(name) + std::string(name.size() < 24 ? 24 - name.size() : 1, ' ');
}

void list() {
  std::string text =
      "cases, with about how long they take, and what each reads beside --small, --json and "
      "--plot:\n";
  for (const Case& one : cases()) {
    text += padded(one.name) + std::string(one.summary) + "; " +
            std::to_string((one.usual.count() + 59) / 60) + " min\n" + padded("") +
            options_text(one) + "\n";
  }
  text += "systems, and the cases that compare them:\n";
  for (const SystemName& system : systems_of(cases())) {
    text += padded(system.name) + std::string(system.summary) + "\n" + padded("");
    for (const Case& one : cases()) {
      if (compares(one, system.name)) text += std::string(one.name) + " ";
    }
    text.back() = '\n';
  }
  for (const std::string& what : absent()) text += "  " + what + "\n";
  std::fputs(text.c_str(), stdout);
}

/// The destination of results with --json=-: the original standard output. From then on
/// descriptor 1 is standard error, so that no output of a process or a library mixes with them.
class PureOutput {
 public:
  PureOutput() : file_(::fdopen(::fcntl(STDOUT_FILENO, F_DUPFD_CLOEXEC, 0), "w")) {
    if (file_ == nullptr || ::dup2(STDERR_FILENO, STDOUT_FILENO) < 0) fail();
  }
  ~PureOutput() { std::fclose(file_); }
  PureOutput(const PureOutput&) = delete;
  PureOutput& operator=(const PureOutput&) = delete;

  void write(const std::string& text) {
    if (std::fputs(text.c_str(), file_) == EOF || std::fflush(file_) == EOF) fail();
  }

 private:
  [[noreturn]] static void fail() {
    throw std::runtime_error(std::string("standard output: ") + std::strerror(errno));
  }
  std::FILE* file_;
};

std::string text_of(const nlohmann::json& document) { return document.dump(1) + "\n"; }

void write(const nlohmann::json& document, const std::string& file) {
  std::ofstream stream(file);
  if (!(stream << text_of(document) << std::flush))
    throw std::runtime_error(file + ": cannot be written");
}

// An hour of measuring must not end with results that cannot be written.
void check_writable(const std::string& file) {
  if (file.empty() || file == "-") return;
  if (!std::ofstream(file, std::ios::app)) throw std::runtime_error(file + ": cannot be written");
}

void check_runs(const char* program, const char* option, const std::string& what) {
  const Directory place;
  Process process({.command = {program, option}, .output = place.path() + "/output"});
  if (process.wait(std::chrono::minutes(1)) != 0) throw std::runtime_error(what);
}

// Checks early for programs that would be missing later.
void check_programs(const Options& options) {
  if (std::find(options.cases.begin(), options.cases.end(), "load") != options.cases.end())
    check_runs("stress-ng", "--version",
               "the case load needs stress-ng, which Debian has in the package stress-ng");
  if (!options.plot.empty())
    check_runs(path_of("agnocast-bench-plot").c_str(), "--check",
               "--plot needs matplotlib, which Debian has in the package python3-matplotlib");
}

void draw(const nlohmann::json& document, const std::string& directory) {
  const Directory place;
  const std::string file = place.path() + "/results.json";
  write(document, file);
  Process plot({.command = {path_of("agnocast-bench-plot"), file, directory}});
  if (plot.wait(std::chrono::minutes(5)) != 0)
    throw std::runtime_error("agnocast-bench-plot could not draw");
}

// Runs the cases. A failed one keeps its results so far, and does not stop the others. Returns
// failures by name. Calls `after_each` with the failures so far.
template <class AfterEach>
nlohmann::json run_cases(const Options& options, Report& report, AfterEach after_each) {
  nlohmann::json failed = nlohmann::json::object();
  for (const std::string& name : options.cases) {
    for (const Case& one : cases()) {
      if (one.name != name) continue;
      // For other than default runs the duration is unknown until they progress.
      report.begin_case(name, options.is_default ? one.usual : std::chrono::seconds(0));
      report.say("\n== " + name + ": " + std::string(one.summary));
      try {
        one.run(options.run, report);
      } catch (const std::exception& error) {
        report.clear_bar();
        std::fprintf(stderr, "agnocast-bench: %s: %s\n", name.c_str(), error.what());
        failed[name] = error.what();
      }
      after_each(failed);
    }
  }
  return failed;
}

int measure(const Options& options, const std::vector<std::string>& arguments) {
  clean_up_on_signals();
  // Floors and peers run without preloads; only selected processes get one (Process::Options).
  ::unsetenv("LD_PRELOAD");
  // Process::send() reports a process that reads no more, with its name.
  ::signal(SIGPIPE, SIG_IGN);
  check_writable(options.json);
  check_programs(options);
  std::optional<PureOutput> output;
  if (options.json == "-") output.emplace();
  Report report;
  report.is_quiet = output.has_value();
  nlohmann::json document = {{"schema", "agnocast.bench/1"},
                             {"environment", environment(arguments)}};
  for (const std::string& doubt : doubts(document["environment"])) report.say("note: " + doubt);
  // After each case the file has all results so far, in case the user ends the next one.
  const auto gather = [&](const nlohmann::json& failed) {
    complete(document["environment"]);
    document["results"] = report.results;
    document["plots"] = report.plots;
    if (!failed.empty()) document["failed"] = failed;
    if (!output && !options.json.empty()) write(document, options.json);
  };
  const nlohmann::json failed = run_cases(options, report, gather);
  if (output) output->write(text_of(document));
  if (!options.plot.empty()) draw(document, options.plot);
  return failed.empty() ? 0 : 1;
}

}  // namespace
}  // namespace agnocast::bench

int main(int argc, char** argv) {
  using namespace agnocast::bench;
  try {
    const std::vector<std::string> arguments(argv + 1, argv + argc);
    if (!arguments.empty() && arguments[0].starts_with('%'))
      return run_role(arguments[0].substr(1), {arguments.begin() + 1, arguments.end()});
    const Options options = parse(arguments, cases());
    if (!options.help.empty()) return std::fputs(options.help.c_str(), stdout), 0;
    if (!options.error.empty()) return refuse(options.error);
    if (options.is_list) return list(), 0;
    return measure(options, arguments);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "agnocast-bench: %s\n", error.what());
    return 1;
  }
}
