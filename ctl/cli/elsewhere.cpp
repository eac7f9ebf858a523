// SPDX-License-Identifier: Apache-2.0
//
// The commands that publish or subscribe, as agnocast-ctl has them: they exec agnocast-ctl-topic.
//
// They need the library, a YAML parser and, to publish, the heap hook, which has to be in the
// process from its start. Linked into this program, they would slow the start of every command.

#include <base/text/text.hpp>
#include <ctl/cli/commands.hpp>

#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <filesystem>
#include <string>
#include <vector>

namespace agnocast::ctl {
namespace {

Outcome<void> become_other(const Arguments& arguments) {
  const std::string program = "agnocast-ctl-topic";
  std::error_code unknown;
  const std::filesystem::path own =
      std::filesystem::read_symlink("/proc/self/exe", unknown).parent_path();
  std::vector<std::string> words = arguments.words;
  words.insert(words.begin(), "agnocast-ctl");
  std::vector<char*> argv;
  for (std::string& word : words) argv.push_back(word.data());
  argv.push_back(nullptr);
  // Beside this program in the build tree; in libexec when installed, since it is no user command.
  for (const std::filesystem::path& directory : {own, own / AGNOCAST_LIBEXEC_FROM_BIN})
    ::execv((directory / program).c_str(), argv.data());
  return problem(Status::failed, program,
                 "cannot be started from " + escaped(own.string()) + ": " + std::strerror(errno),
                 "install all packages of agnocast");
}

}  // namespace

Outcome<void> echo_topic(const Arguments& arguments, Console&) { return become_other(arguments); }
Outcome<void> pub_topic(const Arguments& arguments, Console&) { return become_other(arguments); }
Outcome<void> show_delay(const Arguments& arguments, Console&) { return become_other(arguments); }
Outcome<void> call_service(const Arguments& arguments, Console&) { return become_other(arguments); }

}  // namespace agnocast::ctl
