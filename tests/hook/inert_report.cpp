// SPDX-License-Identifier: Apache-2.0
//
// Says what is in its process, in a form that two runs can be compared by: descriptors, tasks, mappings (path and rights,
// without addresses) after ordinary work with malloc, new, threads, exceptions and fork.

#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <iostream>
#include <map>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include <dirent.h>
#include <sys/auxv.h>
#include <sys/wait.h>
#include <unistd.h>

namespace {

int entries(const char* path) {
  DIR* const directory = opendir(path);
  int count = 0;
  while (readdir(directory) != nullptr) ++count;
  closedir(directory);
  return count;
}

void work() {
  std::vector<std::string> texts;
  for (std::size_t i = 0; i < 1000; ++i) texts.emplace_back(i % 300, 'x');
  std::thread([] { std::make_unique<int[]>(100000)[5] = 1; }).join();
  try {
    texts.at(5000);
  } catch (const std::exception&) {
  }
  const pid_t child = fork();
  if (child == 0) _exit(std::string(1000, 'c').size() == 1000 ? 0 : 1);
  int status = 0;
  waitpid(child, &status, 0);
  std::cout << "child " << status << '\n';
}

}  // namespace

int main() {
  work();
  std::cout << "secure " << getauxval(AT_SECURE) << '\n';
  std::cout << "descriptors " << entries("/proc/self/fd") << '\n';
  std::cout << "tasks " << entries("/proc/self/task") << '\n';
  std::ifstream maps("/proc/self/maps");
  std::string line;
  std::string last_path;
  std::map<std::string, int> mappings;
  while (std::getline(maps, line)) {
    const std::size_t dash = line.find('-');
    const std::size_t space = line.find(' ');
    const std::string rights = line.substr(space + 1, 4);
    const std::size_t slash = line.find_first_of("/[");
    std::string path = slash == std::string::npos ? "" : line.substr(slash);
    // A library's zero-initialised data is an unnamed mapping right behind it.
    static std::string last_end;
    if (path.empty() && line.substr(0, dash) == last_end) path = "after " + last_path;
    last_end = line.substr(dash + 1, space - dash - 1);
    last_path = path;
    ++mappings[path + " " + rights];
  }
  for (const auto& [what, count] : mappings) std::cout << "map " << what << " " << count << '\n';
}
