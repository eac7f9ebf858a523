// SPDX-License-Identifier: Apache-2.0
//
// Linked into programs that are left out where ThreadSanitizer is because they have one thread
// (ONE_THREAD of agnocast_test): a program that begins a second one ends, and belongs there again.

#include <cstdio>
#include <cstdlib>

extern "C" [[gnu::visibility("default")]] int pthread_create(void*, const void*, void* (*)(void*),
                                                             void*);

extern "C" int pthread_create(void*, const void*, void* (*)(void*), void*) {
  std::fputs("this program begins a thread: take ONE_THREAD from its agnocast_test\n", stderr);
  std::abort();
}
