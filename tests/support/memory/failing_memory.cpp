// SPDX-License-Identifier: Apache-2.0
//
// operator new of a daemon under test, preloaded: see failing_memory.hpp. Counts the allocations
// of the first thread of a process with a new-handler, which is the daemon's loop.

#include <tests/support/memory/failing_memory.hpp>

#include <daemon/state/memory_reserve.hpp>

#include <fcntl.h>
#include <sys/mman.h>
#include <unistd.h>

#include <cstdlib>
#include <new>

namespace {

using agnocast::test::FailingMemory;

FailingMemory* find_control() {
  const char* const path = std::getenv(FailingMemory::variable);
  if (path == nullptr) return nullptr;
  const int fd = ::open(path, O_RDWR | O_CLOEXEC);
  if (fd < 0) return nullptr;
  void* const at =
      ::mmap(nullptr, sizeof(FailingMemory), PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
  ::close(fd);
  return at == MAP_FAILED ? nullptr : static_cast<FailingMemory*>(at);
}

FailingMemory* control() {
  static FailingMemory* const found = find_control();
  return found;
}

std::size_t credit = 0;  // returned by the handler and not yet used

void fail_if_told(std::size_t size) {
  const std::new_handler handler = std::get_new_handler();
  if (handler == nullptr || ::gettid() != ::getpid() || control() == nullptr) return;
  FailingMemory& memory = *control();
  const std::uint64_t first = memory.first.load();
  if (first == 0) {
    credit = 0;
    return;
  }
  const std::uint64_t count = memory.count.fetch_add(1) + 1;
  if (count == first) {
    ++memory.failures;
    handler();  // throws, or has made room
    credit = agnocast::daemon::MemoryReserve::piece_bytes;
  }
  if (count <= first || memory.all_that_follow.load() == 0) return;
  while (credit < size) {
    ++memory.failures;
    handler();
    credit += agnocast::daemon::MemoryReserve::piece_bytes;
  }
  credit -= size;
}

void* allocate(std::size_t size, std::size_t alignment) {
  fail_if_told(size);
  void* const block =
      alignment == 0
          ? std::malloc(size == 0 ? 1 : size)
          : std::aligned_alloc(alignment, (size + alignment - 1) / alignment * alignment);
  if (block == nullptr) throw std::bad_alloc();
  return block;
}

}  // namespace

void* operator new(std::size_t size) { return allocate(size, 0); }
void* operator new[](std::size_t size) { return allocate(size, 0); }
void* operator new(std::size_t size, std::align_val_t alignment) {
  return allocate(size, static_cast<std::size_t>(alignment));
}
void* operator new[](std::size_t size, std::align_val_t alignment) {
  return allocate(size, static_cast<std::size_t>(alignment));
}
void* operator new(std::size_t size, const std::nothrow_t&) noexcept {
  try {
    return allocate(size, 0);
  } catch (const std::bad_alloc&) {
    return nullptr;
  }
}
void* operator new[](std::size_t size, const std::nothrow_t& tag) noexcept {
  return operator new(size, tag);
}
void operator delete(void* block) noexcept { std::free(block); }
void operator delete[](void* block) noexcept { std::free(block); }
void operator delete(void* block, std::size_t) noexcept { std::free(block); }
void operator delete[](void* block, std::size_t) noexcept { std::free(block); }
void operator delete(void* block, std::align_val_t) noexcept { std::free(block); }
void operator delete[](void* block, std::align_val_t) noexcept { std::free(block); }
void operator delete(void* block, std::size_t, std::align_val_t) noexcept { std::free(block); }
void operator delete[](void* block, std::size_t, std::align_val_t) noexcept { std::free(block); }
