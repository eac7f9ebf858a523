// SPDX-License-Identifier: Apache-2.0
//
// The function table of the hook for a client library (include/agnocast/abi/heaphook.h describes
// each function).

#include "route.hpp"
#include "shared_heap.hpp"
#include "thread_state.hpp"
#include "windows.hpp"

#include <agnocast/abi/heaphook.h>

#include <cstddef>

namespace agnocast::heaphook {
namespace {

int attach(const struct agnocast_heaphook_window* window,
           const struct agnocast_heaphook_options* options) {
  if (window == nullptr || options == nullptr) return AGNOCAST_HEAPHOOK_INVALID;
  const auto status = shared_heap::attach(*window, *options);
  if (status == AGNOCAST_HEAPHOOK_OK && options->scope == AGNOCAST_HEAPHOOK_SCOPE_ALL) {
    route::scope_all.store(true, std::memory_order_release);
  }
  return status;
}

int add_window(const struct agnocast_heaphook_window* window) {
  return window == nullptr ? AGNOCAST_HEAPHOOK_INVALID : shared_heap::add_window(*window);
}

void enter() { ++thread_state.depth; }

void leave() {
  if (thread_state.depth == 0) {
    shared_heap::note_internal_error();  // an extra leave would otherwise open the scope for ever
    return;
  }
  --thread_state.depth;
}

void pause() { ++thread_state.blocked; }

void resume() {
  if (thread_state.blocked == 0) {
    shared_heap::note_internal_error();
    return;
  }
  --thread_state.blocked;
}

std::uint64_t spilled() { return thread_state.spilled; }

agnocast_heaphook_no_room on_no_room(agnocast_heaphook_no_room no_room) {
  const agnocast_heaphook_no_room before = thread_state.no_room;
  thread_state.no_room = no_room;
  return before;
}

void* allocate(std::size_t alignment, std::size_t size) {
  if (thread_state.blocked != 0 || !windows::is_owner()) return nullptr;
  return alignment <= alignof(std::max_align_t) ? shared_heap::allocate(size)
                                                : shared_heap::allocate_aligned(alignment, size);
}

int deallocate(void* block) {
  const windows::Window* const window = windows::window_of(block);
  if (window == nullptr) return 0;
  shared_heap::release(block, *window);
  return 1;
}

int active() { return route::wants_shared() ? 1 : 0; }
int owns(const void* address) {
  const windows::Window* const window = windows::window_of(address);
  return window != nullptr && windows::is_mapped(*window, address) ? 1 : 0;
}

std::uint64_t frontier(std::uint32_t window) {
  if (window >= windows::count.load(std::memory_order_acquire)) return 0;
  return windows::table[window].frontier.load(std::memory_order_acquire);
}

std::uint32_t first_window() { return shared_heap::first_window(); }

void usage(struct agnocast_heaphook_usage* usage) { shared_heap::usage(*usage); }
int window_wanted() { return windows::wants_another() ? 1 : 0; }

constexpr struct agnocast_heaphook_table table = {
    .abi_version = AGNOCAST_HEAPHOOK_ABI_VERSION,
    .size_bytes = sizeof(struct agnocast_heaphook_table),
    .attach = attach,
    .add_window = add_window,
    .enter = enter,
    .leave = leave,
    .pause = pause,
    .resume = resume,
    .spilled = spilled,
    .on_no_room = on_no_room,
    .allocate = allocate,
    .deallocate = deallocate,
    .active = active,
    .owns = owns,
    .frontier = frontier,
    .first_window = first_window,
    .usage = usage,
    .purge = shared_heap::purge,
    .idle = shared_heap::idle,
    .window_wanted = window_wanted,
};

}  // namespace
}  // namespace agnocast::heaphook

extern "C" __attribute__((visibility("default"))) const struct agnocast_heaphook_table*
agnocast_heaphook(void) {
  return &agnocast::heaphook::table;
}
