/* SPDX-License-Identifier: Apache-2.0
 *
 * A C program that loads C++ late and privately, as python does with extension modules: when the
 * hook looks for the next operator new there is none in sight.
 */
#include <dlfcn.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

int main(int argc, char** argv) {
  if (argc != 2) return 2;
  for (int round = 0; round < 3; ++round) {
    void* module = dlopen(argv[1], RTLD_NOW | RTLD_LOCAL);
    if (module == NULL) {
      puts(dlerror());
      return 1;
    }
    size_t (*work)(size_t);
    int (*out_of_memory)(void);
    void* symbol = dlsym(module, "module_work");
    memcpy(&work, &symbol, sizeof symbol);
    symbol = dlsym(module, "module_out_of_memory");
    memcpy(&out_of_memory, &symbol, sizeof symbol);
    printf("work %zu, out of memory %d\n", work(1000), out_of_memory());
    dlclose(module);
  }
  return 0;
}
