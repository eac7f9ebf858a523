// SPDX-License-Identifier: Apache-2.0
//
// A library that tests load and unload: allocates in its constructor, destructor and per thread.

#include <cstdlib>
#include <string>
#include <vector>

namespace {
std::vector<std::string>* kept = nullptr;
thread_local std::string per_thread(200, 't');
thread_local char block_of_tls[3000];

[[gnu::constructor]] void load() { kept = new std::vector<std::string>(50, std::string(100, 'k')); }
[[gnu::destructor]] void unload() { delete kept; }
}  // namespace

extern "C" __attribute__((visibility("default"))) std::size_t module_work(std::size_t size) {
  per_thread.append(100, 'x');
  block_of_tls[size % sizeof block_of_tls] = 1;
  void* const block = malloc(size);
  free(block);
  return kept->size() + (per_thread.size() > 0 ? 1 : 0);
}
