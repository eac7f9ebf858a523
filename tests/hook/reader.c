/* SPDX-License-Identifier: Apache-2.0
 *
 * A subscriber without the hook, without C++ and without a daemon: reads commands "FRONTIER
 * ADDRESS" from stdin, opens the window (descriptor 3, read-only) up to the frontier at its fixed
 * address, and prints what it finds at the address through the publisher's own pointers. The
 * layouts are those of tests/hook/sharing_test.cpp on libstdc++.
 */
#define _GNU_SOURCE
#include <errno.h>
#include <inttypes.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>

struct vector {
  const unsigned char *begin, *end, *capacity;
};
struct string {
  const char* data;
  size_t size;
  char local[16];
};
struct cloud {
  uint32_t height, width;
  struct string frame_id;
  struct vector fields;
  struct vector data;
};
struct field {
  struct string name;
  uint32_t offset;
  uint32_t count;
};

int main(int argc, char** argv) {
  if (argc != 2) return 2;
  char* const base = (char*)(uintptr_t)strtoull(argv[1], NULL, 16);
  size_t open = 0;
  uint64_t frontier, address;
  while (scanf("%" SCNu64 " %" SCNx64, &frontier, &address) == 2) {
    if (frontier > open) {
      void* piece = mmap(base + open, frontier - open, PROT_READ, MAP_SHARED | MAP_FIXED_NOREPLACE,
                         3, (off_t)open);
      if (piece != base + open) {
        printf("mmap: %s\n", strerror(errno));
        return 1;
      }
      open = frontier;
    }
    const struct cloud* const cloud = (const struct cloud*)(uintptr_t)address;
    uint64_t sum = 1469598103934665603u;
    for (const unsigned char* p = cloud->data.begin; p != cloud->data.end; ++p)
      sum = (sum ^ *p) * 1099511628211u;
    printf("%" PRIu32 " %" PRIu32 " %.*s", cloud->height, cloud->width, (int)cloud->frame_id.size,
           cloud->frame_id.data);
    for (const unsigned char* p = cloud->fields.begin; p != cloud->fields.end;
         p += sizeof(struct field)) {
      const struct field* const field = (const struct field*)(const void*)p;
      printf(" %.*s:%" PRIu32, (int)field->name.size, field->name.data, field->offset);
    }
    printf(" %" PRIu64 "\n", sum);
    fflush(stdout);
  }
  return 0;
}
