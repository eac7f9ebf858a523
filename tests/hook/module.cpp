// SPDX-License-Identifier: Apache-2.0
//
// A library that tests load and unload: allocates in its constructor, destructor and per thread.

#include <cstdlib>
#include <new>
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

namespace {
int handler_calls = 0;

int count_bad_allocs() {
  int thrown = 0;
  const std::size_t huge = ~std::size_t{0} >> 1;
  try {
    operator delete(operator new(huge));
  } catch (const std::bad_alloc&) {
    ++thrown;
  }
  try {
    operator delete[](operator new[](huge, std::align_val_t{256}), std::align_val_t{256});
  } catch (const std::bad_alloc&) {
    ++thrown;
  }
  if (operator new(huge, std::nothrow) == nullptr) ++thrown;
  if (operator new (huge, std::align_val_t{256}, std::nothrow) == nullptr) ++thrown;
  return thrown;
}
}  // namespace

// Tries every form of new that fails, with a new-handler that gives up at its second call. Returns
// 4 * 100 + 2 on success.
extern "C" __attribute__((visibility("default"))) int module_out_of_memory() {
  handler_calls = 0;
  const int without_handler = count_bad_allocs();
  std::set_new_handler([] {
    if (++handler_calls == 2) std::set_new_handler(nullptr);
  });
  try {
    operator delete(operator new (~std::size_t{0} >> 1));
  } catch (const std::bad_alloc&) {
  }
  struct alignas(128) Wide {
    char payload[300];
  };
  delete new Wide;
  delete[] new Wide[3];
  return without_handler * 100 + handler_calls;
}
