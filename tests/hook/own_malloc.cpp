// SPDX-License-Identifier: Apache-2.0
//
// A program with its own malloc linked in: a bump allocator that refuses to free blocks of others.
// Definitions in the program precede every library, so C++'s operators, libc and the hook must all
// call them.

#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <map>
#include <string>

#include <unistd.h>

#define EXPORTED __attribute__((visibility("default")))

namespace {
alignas(64) char arena[64 << 20];
std::size_t used = 0;
bool foreign = false;
std::size_t calls = 0;

void* take(std::size_t alignment, std::size_t size) {
  ++calls;
  used = (used + 16 + alignment - 1) & ~(alignment - 1);
  if (size > sizeof arena - used) return nullptr;
  std::memcpy(arena + used - 16, &size, sizeof size);
  void* const block = arena + used;
  used += size;
  return block;
}
}  // namespace

extern "C" {
EXPORTED void* malloc(std::size_t size) { return take(16, size); }
EXPORTED void* calloc(std::size_t count, std::size_t size) { return take(16, count * size); }
EXPORTED void* aligned_alloc(std::size_t alignment, std::size_t size) {
  return take(alignment, size);
}
EXPORTED int posix_memalign(void** result, std::size_t alignment, std::size_t size) {
  *result = take(alignment, size);
  return *result == nullptr ? 12 : 0;
}
EXPORTED void free(void* block) {
  if (block == nullptr) return;
  ++calls;
  if (static_cast<char*>(block) < arena || static_cast<char*>(block) >= arena + sizeof arena)
    foreign = true;
}
EXPORTED void* realloc(void* old, std::size_t size) {
  void* const block = take(16, size);
  if (old != nullptr && block != nullptr) {
    std::size_t old_size = 0;
    std::memcpy(&old_size, static_cast<char*>(old) - 16, sizeof old_size);
    std::memcpy(block, old, old_size < size ? old_size : size);
  }
  return block;
}
}

int main() {
  std::map<int, std::string> texts;
  for (int i = 0; i < 1000; ++i) texts[i] = std::string(100, 'x');
  auto* const block = new char[1000];
  const bool mine = block >= arena && block < arena + sizeof arena;
  delete[] block;
  char* const copy = strdup("by libc");
  const bool libcs = copy >= arena && copy < arena + sizeof arena;
  free(copy);
  texts.clear();
  std::printf("new lands in the program's heap: %d, strdup: %d, foreign frees: %d, used: %d\n",
              mine, libcs, foreign, calls > 3000);
  return mine && libcs && !foreign ? 0 : 1;
}
