// SPDX-License-Identifier: Apache-2.0
//
// agnocast-ctl: main() prints every answer and every error.
//
// It observes (docs/control-plane.md) and reads shared regions; it never maps memory writable and
// never subscribes. `process revoke` and `log-level` alone change anything, through the daemon.
// The commands that publish or subscribe are a separate program (elsewhere.cpp), with this main().

#include <ctl/cli/commands.hpp>
#include <ctl/commands/completion.hpp>

#include <sys/resource.h>

#include <cstdio>
#include <cstdlib>
#include <span>
#include <string>
#include <vector>

namespace agnocast::ctl {
namespace {

int complain(const Problem& problem) {
  std::fprintf(stderr, "agnocast-ctl: %s: %s\nhint: %s\n", problem.what.c_str(),
               problem.why.c_str(), problem.hint.c_str());
  return static_cast<int>(problem.status);
}

// Each process costs one descriptor until its region is mapped; the usual soft limit is only 1024.
void raise_descriptor_limit() noexcept {
  rlimit limit{};
  if (::getrlimit(RLIMIT_NOFILE, &limit) != 0) return;
  limit.rlim_cur = limit.rlim_max;
  ::setrlimit(RLIMIT_NOFILE, &limit);
}

// Returns whether all output was written; a full disk may refuse an early part and not the last.
bool is_written(std::FILE* out) noexcept {
  const bool flushed = std::fflush(out) == 0;
  return std::ferror(out) == 0 && flushed;
}

// Prints completions for the shell scripts, one word a line; prints nothing if anything fails.
int complete(std::span<const std::string> words, const Surroundings& around) {
  std::string named;
  for (std::size_t i = 0; i + 1 < words.size(); ++i) {
    if (words[i] == "--socket") named = words[i + 1];
  }
  const std::string socket = choose_socket(named, around);
  for (const std::string& word :
       completions_of(words, all_commands, [&](Names kind) { return names_from(socket, kind); }))
    std::printf("%s\n", word.c_str());
  return 0;
}

int run(int argc, const char* const* argv) {
  const std::vector<std::string> words(argv + (argc > 0 ? 1 : 0), argv + argc);
  const Surroundings around = Surroundings::of_process();
  const Problem unwritten{Status::failed, "output", "it cannot be written",
                          "df; agnocast-ctl status"};
  if (!words.empty() && words.front() == "--complete")
    return complete(std::span(words).subspan(1), around);
  const auto parsed = parse_arguments(words, all_commands, around);
  if (!parsed) return complain(parsed.error());
  if (const auto* const answer = std::get_if<Answer>(&*parsed)) {
    std::fputs(answer->text.c_str(), stdout);
    return is_written(stdout) ? 0 : complain(unwritten);
  }
  const Arguments& arguments = std::get<Arguments>(*parsed);
  raise_descriptor_limit();
  const char* const no_colour = std::getenv("NO_COLOR");
  Console console(stdout, around.out_is_terminal && (no_colour == nullptr || *no_colour == '\0'));
  const Outcome<void> done = arguments.command->run(arguments, console);
  if (!is_written(stdout) && done) return complain(unwritten);
  return done ? 0 : complain(done.error());
}

}  // namespace
}  // namespace agnocast::ctl

int main(int argc, char** argv) { return agnocast::ctl::run(argc, argv); }
