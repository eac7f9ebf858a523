// SPDX-License-Identifier: Apache-2.0
//
// Container: a steered program in its own namespaces (container.sh), as another user.
#pragma once

#include <tests/support/processes/daemon_process.hpp>
#include <tests/support/processes/steered_process.hpp>

#include <signal.h>
#include <sys/types.h>
#include <unistd.h>

#include <array>
#include <cstdlib>
#include <fstream>
#include <string>
#include <utility>
#include <vector>

namespace agnocast::test {

struct ContainerOptions {
  uid_t uid = 0;
  std::vector<gid_t> groups = {};
  /// Outside and inside; the directory of the test's programs is always mounted.
  std::vector<std::pair<std::string, std::string>> mounts = {};
  std::vector<std::string> environment = {};
  bool has_user_namespace = false;
};

class Container {
 public:
  Container(std::vector<std::string> program, const ContainerOptions& options)
      : process_(words_of(std::move(program)), variables_of(options, root_)) {}
  /// Kills process 1 as well, before its parent, so that nothing remains.
  ~Container() {
    kill_inside();
    process_.kill();
    remove_directory(root_);
  }
  Container(const Container&) = delete;
  Container& operator=(const Container&) = delete;

  /// Returns whether this process may create the namespaces.
  static bool is_possible(bool has_user_namespace = false) {
    if (::geteuid() != 0) return false;
    Container probe({"/bin/echo", "made"},
                    {.uid = 65534, .has_user_namespace = has_user_namespace});
    return probe->answer() == "made";
  }

  SteeredProcess* operator->() { return &process_; }
  SteeredProcess& operator*() { return process_; }

  /// Returns the container's process 1, as this process sees it; 0 if there is none.
  pid_t pid() const {
    const std::string outer = std::to_string(process_.pid());
    std::ifstream children("/proc/" + outer + "/task/" + outer + "/children");
    pid_t child = 0;
    children >> child;
    return child;
  }
  void kill_inside() {
    if (const pid_t inside = pid(); inside > 0) ::kill(inside, SIGKILL);
  }

 private:
  static std::vector<std::string> words_of(std::vector<std::string> program) {
    program.insert(program.begin(), AGNOCAST_TEST_CONTAINER);
    return program;
  }
  static std::vector<std::string> variables_of(const ContainerOptions& options,
                                               const std::string& root) {
    std::string mounts = AGNOCAST_TEST_PROGRAMS " " AGNOCAST_TEST_PROGRAMS "\n", groups;
    for (const auto& [outside, inside] : options.mounts) mounts += outside + ' ' + inside + '\n';
    for (const gid_t group : options.groups)
      groups += (groups.empty() ? "" : ",") + std::to_string(group);
    std::vector<std::string> variables = options.environment;
    variables.push_back("CONTAINER_ROOT=" + root);
    variables.push_back("CONTAINER_MOUNTS=" + mounts);
    variables.push_back("CONTAINER_UID=" + std::to_string(options.uid));
    variables.push_back("CONTAINER_GROUPS=" + groups);
    variables.push_back(std::string("CONTAINER_USER_NAMESPACE=") +
                        (options.has_user_namespace ? "yes" : ""));
    variables.emplace_back("PATH=/usr/sbin:/usr/bin:/sbin:/bin");
    return variables;
  }

  std::string root_ = make_directory();
  SteeredProcess process_;
};

}  // namespace agnocast::test
