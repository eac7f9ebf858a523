// SPDX-License-Identifier: Apache-2.0
//
// What the steered programs of these tests have in common: they become a user, then answer each
// line.
#pragma once

#include <grp.h>
#include <sys/prctl.h>
#include <sys/types.h>
#include <unistd.h>

#include <cstdlib>
#include <exception>
#include <iostream>
#include <sstream>
#include <string>

namespace agnocast::test {

/// Dumpable as any process that was this user's from the beginning. Stays root for 0.
inline bool become(uid_t uid) {
  if (uid == 0) return true;
  return ::setgroups(0, nullptr) == 0 && ::setgid(uid) == 0 && ::setuid(uid) == 0 &&
         ::prctl(PR_SET_DUMPABLE, 1) == 0;
}

/// The main of a program whose argument is a user's number and whose Node executes lines.
template <class Node>
int steered_main(int argc, char** argv) {
  if (argc != 2 || !become(static_cast<uid_t>(std::atol(argv[1])))) return 2;
  static Node node;
  std::string text;
  while (std::getline(std::cin, text)) {
    std::istringstream line(text);
    std::string answer;
    try {
      answer = node.execute(line);
    } catch (const std::exception& error) {
      answer = error.what();
    }
    std::cout << answer << std::endl;
  }
  return 0;
}

}  // namespace agnocast::test
