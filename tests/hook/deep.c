// SPDX-License-Identifier: Apache-2.0
//
// A library for RTLD_DEEPBIND: its calls bind to its own dependencies, libc, before the hook.

#include <stdlib.h>

__attribute__((visibility("default"))) void* deep_allocate(size_t bytes) { return malloc(bytes); }
__attribute__((visibility("default"))) void deep_release(void* block) { free(block); }
