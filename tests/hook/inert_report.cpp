// SPDX-License-Identifier: Apache-2.0
//
// Prints the contents of its process in a form that two runs can be compared by: descriptors,
// tasks, mappings (path and rights without addresses; the sum of those without a path) after work
// with malloc, new, threads, exceptions and fork.

#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <iostream>
#include <map>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include <dirent.h>
#include <link.h>
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

// Subtracts the hook's zero-initialised data, which is part of the library's own mapping, from the
// sum.
int own_zero_pages(dl_phdr_info* info, std::size_t, void* sum) {
  if (std::strstr(info->dlpi_name, "libagnocast_heaphook.so") == nullptr) return 0;
  const auto page = static_cast<std::size_t>(sysconf(_SC_PAGESIZE));
  for (int i = 0; i < info->dlpi_phnum; ++i) {
    const auto& segment = info->dlpi_phdr[i];
    if (segment.p_type != PT_LOAD) continue;
    const std::size_t in_file = (segment.p_vaddr + segment.p_filesz + page - 1) / page * page;
    const std::size_t in_memory = (segment.p_vaddr + segment.p_memsz + page - 1) / page * page;
    *static_cast<std::size_t*>(sum) -= in_memory - in_file;
  }
  return 0;
}

}  // namespace

int main() {
  work();
  std::cout << "secure " << getauxval(AT_SECURE) << '\n';
  std::cout << "descriptors " << entries("/proc/self/fd") << '\n';
  std::cout << "tasks " << entries("/proc/self/task") << '\n';
  std::ifstream maps("/proc/self/maps");
  std::string line;
  std::map<std::string, int> mappings;
  std::size_t anonymous_bytes = 0;
  while (std::getline(maps, line)) {
    std::size_t dash = 0;
    const std::uintptr_t first = std::stoul(line, &dash, 16);
    const std::uintptr_t last = std::stoul(line.substr(dash + 1), nullptr, 16);
    const std::size_t slash = line.find_first_of("/[");
    if (slash == std::string::npos) {
      // the kernel merges neighbours unpredictably: only the sum can be compared
      anonymous_bytes += last - first;
    } else {
      ++mappings[line.substr(slash) + " " + line.substr(line.find(' ') + 1, 4)];
    }
  }
  dl_iterate_phdr(own_zero_pages, &anonymous_bytes);
  std::cout << "anonymous_kib " << anonymous_bytes / 1024 << '\n';
  for (const auto& [what, count] : mappings) std::cout << "map " << what << " " << count << '\n';
}
