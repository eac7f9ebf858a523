// SPDX-License-Identifier: Apache-2.0
//
// Member: a CtlNode in its own process, which runs a function and then lives until it is killed.
#pragma once

#include <base/descriptors/unique_fd.hpp>
#include <tests/integration/ctl/ctl_node.hpp>
#include <tests/support/processes/child.hpp>

#include <fcntl.h>
#include <sys/prctl.h>
#include <unistd.h>

#include <optional>
#include <string>
#include <utility>

namespace agnocast::test {

class NodeProcess {
 public:
  /// Runs `body(node)` in the process; the constructor returns when it has finished.
  template <class Body>
  NodeProcess(const std::string& socket, Body body, const std::string& name = "wire_client") {
    int ends[2];
    EXPECT_EQ(::pipe2(ends, O_CLOEXEC), 0);
    UniqueFd read(ends[0]), write(ends[1]);
    child_.emplace([&] {
      ::prctl(PR_SET_PDEATHSIG, SIGKILL);
      CtlNode node(socket, 0, name);
      body(node);
      if (::write(write.get(), "+", 1) != 1) return 1;
      return sleep_for_ever();
    });
    write.reset();
    char done = 0;
    EXPECT_EQ(::read(read.get(), &done, 1), 1) << "the process has ended";
  }

  pid_t pid() const { return child_->pid(); }
  void kill(int signal = SIGKILL) const { child_->kill(signal); }
  int wait() { return child_->wait(); }

 private:
  std::optional<Child> child_;
};

}  // namespace agnocast::test
