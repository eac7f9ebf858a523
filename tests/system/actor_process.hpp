// SPDX-License-Identifier: Apache-2.0
//
// ActorProcess: one process of tests/system/actor, with or without the heap hook. Seeds: the tests
// of this folder print theirs; --seed=N or AGNOCAST_SEED=N repeats one.
#pragma once

#include <tests/support/processes/steered_process.hpp>

#include <cstdint>
#include <cstdlib>
#include <fstream>
#include <string>
#include <vector>

namespace agnocast::test {

class ActorProcess : public SteeredProcess {
 public:
  ActorProcess(const std::string& socket_path, bool may_publish)
      : SteeredProcess({AGNOCAST_ACTOR}, variables(socket_path, may_publish)) {}

 private:
  static std::vector<std::string> variables(const std::string& socket_path, bool may_publish) {
    std::vector<std::string> all{"AGNOCAST_SOCKET=" + socket_path};
    if (may_publish) all.push_back("LD_PRELOAD=" AGNOCAST_HOOK);
    return all;
  }
};

inline std::uint64_t number_from_environment(const char* name, std::uint64_t otherwise) {
  const char* const text = std::getenv(name);
  return text != nullptr ? std::strtoull(text, nullptr, 0) : otherwise;
}

/// Returns --seed=N, else AGNOCAST_SEED; 0 = none given.
inline std::uint64_t seed_given() {
  std::ifstream arguments("/proc/self/cmdline");
  for (std::string argument; std::getline(arguments, argument, '\0');) {
    if (argument.rfind("--seed=", 0) == 0) return std::strtoull(argument.c_str() + 7, nullptr, 0);
  }
  return number_from_environment("AGNOCAST_SEED", 0);
}

}  // namespace agnocast::test
