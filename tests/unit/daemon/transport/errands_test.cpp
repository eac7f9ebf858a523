// SPDX-License-Identifier: Apache-2.0
//
// Goal: the threads of Errands continue without allocating memory. Method: this program's own
// operator new, which fails in every thread that has run an errand.

#include <daemon/transport/errands.hpp>

#include <gtest/gtest.h>

#include <cstdlib>
#include <new>

namespace {
thread_local bool memory_fails = false;
}

#if !defined(AGNOCAST_UNDER_THREAD_SANITIZER)  // it has its own
void* operator new(std::size_t bytes) {
  void* const memory = memory_fails ? nullptr : std::malloc(bytes);
  if (memory == nullptr) throw std::bad_alloc();
  return memory;
}
// If both are inlined, the compiler sees new and free, which do not match.
#pragma GCC diagnostic ignored "-Wmismatched-new-delete"
void operator delete(void* memory) noexcept { std::free(memory); }
void operator delete(void* memory, std::size_t) noexcept { std::free(memory); }
#endif

namespace agnocast::daemon {
namespace {

TEST(Errands, ContinueWithoutMemory) {
  auto dispatcher = Dispatcher::create();
  ASSERT_TRUE(dispatcher);
  auto errands = Errands::create(*dispatcher);
  ASSERT_TRUE(errands);
  constexpr unsigned count = 2'000;  // more entries than a container allocates at a time
  unsigned answered = 0;
  for (unsigned i = 0; i < count; ++i)
    (*errands)->run(
        Errands::Lane::looking, 1, [] { memory_fails = true; }, [&] { ++answered; });
  // One wait may have nothing left to answer: the previous wait has answered it as well.
  for (unsigned idle = 0; answered < count && idle < 2;) {
    const unsigned before = answered;
    ASSERT_TRUE(dispatcher->wait(10'000));
    idle = answered > before ? 0 : idle + 1;
  }
  EXPECT_EQ(answered, count) << "the threads have stopped";
  EXPECT_EQ((*errands)->waiting(Errands::Lane::looking, 1), 0u);
}

}  // namespace
}  // namespace agnocast::daemon
