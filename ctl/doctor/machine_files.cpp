// SPDX-License-Identifier: Apache-2.0

#include <ctl/doctor/machine_files.hpp>

#include <base/descriptors/unique_fd.hpp>

#include <fcntl.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cstdlib>
#include <sstream>

namespace agnocast::ctl {

std::string target_of(const std::string& link) {
  std::array<char, 4096> path;
  const ssize_t bytes = ::readlink(link.c_str(), path.data(), path.size());
  return bytes > 0 ? std::string(path.data(), static_cast<std::size_t>(bytes)) : std::string();
}

std::vector<std::string> split(const std::string& text, char mark) {
  std::vector<std::string> parts;
  std::istringstream in(text);
  for (std::string part; std::getline(in, part, mark);) parts.push_back(part);
  return parts;
}

std::string command_name(pid_t pid) {
  std::string name = contents_of(of_process(pid, "comm"));
  if (!name.empty()) name.pop_back();
  return name;
}
std::optional<std::string> variable(const char* name) {
  const char* const value = ::secure_getenv(name);
  if (value == nullptr || *value == '\0') return std::nullopt;
  return value;
}

std::string named_configuration_of(pid_t pid) {
  const auto words = split(contents_of(of_process(pid, "cmdline")), '\0');
  for (std::size_t i = 0; i < words.size(); ++i) {
    std::string path;
    if (words[i].starts_with("--config=")) path = words[i].substr(9);
    if (words[i] == "--config" && i + 1 < words.size()) path = words[i + 1];
    if (path.empty()) continue;
    return path.front() == '/' ? path : target_of(of_process(pid, "cwd")) + '/' + path;
  }
  return {};
}
std::string complaint_of(std::vector<std::string> words) {
  int ends[2];
  if (::pipe2(ends, O_CLOEXEC) != 0) return {};
  UniqueFd read(ends[0]), write(ends[1]);
  posix_spawn_file_actions_t actions;
  ::posix_spawn_file_actions_init(&actions);
  ::posix_spawn_file_actions_addopen(&actions, STDOUT_FILENO, "/dev/null", O_WRONLY, 0);
  ::posix_spawn_file_actions_adddup2(&actions, write.get(), STDERR_FILENO);
  std::vector<char*> argv;
  for (std::string& word : words) argv.push_back(word.data());
  argv.push_back(nullptr);
  pid_t pid = 0;
  const int error = ::posix_spawnp(&pid, argv[0], &actions, nullptr, argv.data(), environ);
  ::posix_spawn_file_actions_destroy(&actions);
  write.reset();
  if (error != 0) return {};
  std::string said = contents_of("/dev/fd/" + std::to_string(read.get()));
  int status = 0;
  while (::waitpid(pid, &status, 0) < 0 && errno == EINTR) {
  }
  if (!WIFEXITED(status) || WEXITSTATUS(status) == 0) return {};
  return said;
}

}  // namespace agnocast::ctl
