// SPDX-License-Identifier: Apache-2.0

#include <client/dataplane/windows.hpp>
#include <client/heap.hpp>

#include <dlfcn.h>

#include <atomic>
#include <cerrno>
#include <cstdlib>
#include <memory>
#include <new>

namespace agnocast {
namespace {

static_assert(WindowSet::count_max == abi::window_count_max &&
              AGNOCAST_HEAPHOOK_WINDOWS_MAX == abi::window_count_max);

// One heap per process, for its whole life; the hook keeps pointers to these.
struct Attached {
  std::byte* client_region = nullptr;
  void (*grown)() noexcept = nullptr;
  std::uint64_t base[abi::window_count_max] = {};
  std::atomic<std::uint64_t> count{0};
  const agnocast_heaphook_table* hook = nullptr;
};
Attached attached;

// In whatever thread allocates, under the allocator's locks.
void store_grown(void* context, std::uint32_t window, std::uint64_t bytes) {
  const auto& heap = *static_cast<Attached*>(context);
  dataplane::store_frontier<SharedMemory>(heap.client_region, window, bytes);
  if (heap.grown != nullptr) heap.grown();
}

Result<void> result_of(int status) noexcept {
  switch (status) {
    case AGNOCAST_HEAPHOOK_OK:
      return {};
    case AGNOCAST_HEAPHOOK_SECURE:
      return fail(Errc::hook_missing, "the heap hook does nothing in a setuid process");
    case AGNOCAST_HEAPHOOK_FORKED:
      return fail(Errc::hook_missing, "the heap hook is off in a forked child");
    case AGNOCAST_HEAPHOOK_OCCUPIED:
      return fail(Errc::arena_occupied, "opening a heap window", EEXIST);
    case AGNOCAST_HEAPHOOK_LOCK_LIMIT:
      return fail(Errc::lock_limit, "opening a heap window", errno);
    case AGNOCAST_HEAPHOOK_FULL:
      return fail(Errc::window_exhausted, "opening a heap window");
    case AGNOCAST_HEAPHOOK_OS:
      return fail(Errc::os_failure, "opening a heap window", errno);
    default:
      return fail(Errc::internal, "opening a heap window");
  }
}

void describe_window(std::byte* client_region, std::uint64_t window, std::uint64_t base,
                     std::uint64_t length) noexcept {
  auto& entry = reinterpret_cast<abi::ClientRegionHeader*>(client_region)->window[window];
  entry.length.store(length, std::memory_order_relaxed);
  entry.base.store(base, std::memory_order_release);
}

template <class Pointer>
bool lies_in_heap(const agnocast_heaphook_table& hook, Pointer block) noexcept {
  return block != nullptr && hook.owns(block) != 0;
}

// LoanPauses of the calling thread. Adoption lifts them: publish works during a pause as well.
thread_local std::uint64_t pause_count = 0;

std::uint64_t begin_adoption(void*) noexcept {
  for (std::uint64_t i = 0; i < pause_count; ++i) attached.hook->resume();
  attached.hook->enter();
  return attached.hook->spilled();
}
std::uint64_t end_adoption(void*) noexcept {
  attached.hook->leave();
  for (std::uint64_t i = 0; i < pause_count; ++i) attached.hook->pause();
  return attached.hook->spilled();
}
WindowSet windows(void*) noexcept {
  WindowSet set;
  const std::uint64_t count = attached.count.load(std::memory_order_acquire);
  for (std::uint64_t i = 0; i < count; ++i) {
    (void)set.add(attached.base[i],
                  attached.base[i] + attached.hook->frontier(static_cast<std::uint32_t>(i)));
  }
  return set;
}

}  // namespace

Result<Heap> Heap::find() noexcept {
  using Find = const agnocast_heaphook_table* (*)();
  const auto find_hook = reinterpret_cast<Find>(::dlsym(RTLD_DEFAULT, "agnocast_heaphook"));
  if (find_hook == nullptr) return fail(Errc::hook_missing, "no heap hook in this process");
  const agnocast_heaphook_table* const hook = find_hook();
  if (hook->abi_version != AGNOCAST_HEAPHOOK_ABI_VERSION || hook->size_bytes != sizeof *hook) {
    return fail(Errc::hook_missing, "the heap hook in this process is of another version");
  }
  return Heap(hook);
}

Result<void> Heap::attach(std::byte* client_region, std::uint64_t base, std::uint64_t length,
                          int write_fd, int read_fd, HeapScope scope,
                          void (*grown)() noexcept) noexcept {
  attached.client_region = client_region;
  attached.grown = grown;
  attached.hook = hook_;
  describe_window(client_region, 0, base, length);
  const agnocast_heaphook_window window{
      reinterpret_cast<void*>(base),     length, write_fd, read_fd,
      AGNOCAST_HEAPHOOK_WINDOW_RESERVED, 0};
  const agnocast_heaphook_options options{
      static_cast<std::uint32_t>(scope == HeapScope::all ? AGNOCAST_HEAPHOOK_SCOPE_ALL
                                                         : AGNOCAST_HEAPHOOK_SCOPE_LOAN),
      0, store_grown, &attached};
  if (Result<void> opened = result_of(hook_->attach(&window, &options)); !opened) return opened;
  attached.base[0] = base;
  attached.count.store(1, std::memory_order_release);

  // Who answers malloc and new? The compiler must not pair these calls away.
  hook_->enter();
  void* volatile by_malloc = std::malloc(64);
  void* volatile by_new = ::operator new(64, std::nothrow);
  hook_->leave();
  const bool malloc_is_ours = lies_in_heap(*hook_, static_cast<void*>(by_malloc));
  const bool new_is_ours = lies_in_heap(*hook_, static_cast<void*>(by_new));
  std::free(by_malloc);
  ::operator delete(by_new, std::nothrow);
  if (!malloc_is_ours) return fail(Errc::hook_ineffective, "malloc is somebody else's");
  if (!new_is_ours) return fail(Errc::hook_ineffective, "operator new is somebody else's");
  return {};
}

Result<void> Heap::add_window(std::byte* client_region, std::uint64_t window, std::uint64_t base,
                              std::uint64_t length, int write_fd, int read_fd) noexcept {
  describe_window(client_region, window, base, length);
  const agnocast_heaphook_window next{reinterpret_cast<void*>(base),     length, write_fd, read_fd,
                                      AGNOCAST_HEAPHOOK_WINDOW_RESERVED, 0};
  // Known before the hook hands out its first address: a message that lies there is resident.
  attached.base[window] = base;
  attached.count.store(window + 1, std::memory_order_release);
  Result<void> opened = result_of(hook_->add_window(&next));
  if (!opened) attached.count.store(window, std::memory_order_release);
  return opened;
}

bool Heap::wants_window() const noexcept {
  agnocast_heaphook_usage usage{};
  hook_->usage(&usage);
  return usage.next_window_wanted != 0;
}

std::uint64_t Heap::used_bytes() const noexcept {
  agnocast_heaphook_usage usage{};
  hook_->usage(&usage);
  return usage.used_bytes;
}

void Heap::pause() const noexcept {
  ++pause_count;
  hook_->pause();
}

void Heap::resume() const noexcept {
  hook_->resume();
  --pause_count;
}

SharedHeap Heap::shared_heap() const noexcept {
  return {nullptr, begin_adoption, end_adoption, windows};
}

}  // namespace agnocast
