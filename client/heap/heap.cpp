// SPDX-License-Identifier: Apache-2.0

#include <base/memory/mapping.hpp>
#include <base/text/text.hpp>
#include <client/heap/address_users.hpp>
#include <client/heap/block_heap.hpp>
#include <client/heap/heap.hpp>
#include <client/process/steps.hpp>
#include <dataplane/frontier.hpp>
#include <region/windows.hpp>

#include <agnocast/shared_allocator.hpp>

#include <dlfcn.h>

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <chrono>
#include <cstdlib>
#include <iterator>
#include <memory>
#include <new>
#include <string>
#include <thread>
#include <utility>

namespace agnocast {
namespace {

static_assert(WindowSet::count_max == abi::window_count_max &&
              AGNOCAST_HEAPHOOK_WINDOWS_MAX == abi::window_count_max);

// Losses of the store in succession before the messages of the first session were read.
constexpr std::size_t regions_max = 8;

// One heap per process, for its whole life; the hook keeps pointers to this.
struct Attached {
  // Regions of all sessions that readers may still use; more than one after the daemon's store
  // was lost. A growth takes no lock and never waits: it runs in any allocating thread.
  std::atomic<std::byte*> client_region[regions_max] = {};
  std::atomic<std::uint64_t> growths{0};  // begun and ended; odd: one is in progress
  void (*grown)() noexcept = nullptr;
  std::uint64_t base[abi::window_count_max] = {};
  std::uint64_t length[abi::window_count_max] = {};
  std::uint64_t first[abi::window_count_max] = {};
  int write_fd[abi::window_count_max] = {};  // never closed, like all of this
  std::atomic<std::uint64_t> count{0};
  std::atomic<bool> is_last{false};  // there will be no further window
  const agnocast_heaphook_table* hook = nullptr;
  bool malloc_is_ours = false;
  bool new_is_ours = false;
};
Attached attached;
// For SharedAllocator, in any thread: the hook, once its heap is open.
std::atomic<const agnocast_heaphook_table*> open_hook{nullptr};

// Runs in the allocating thread, under the allocator's locks, one call at a time.
void store_grown(void* context, std::uint32_t window, std::uint64_t bytes) {
  auto& heap = *static_cast<Attached*>(context);
  // [sync:growth] seq_cst, like the reverse order in follow() and leave_region(). A region that
  // is not seen here belongs to a follow() that sees this growth, and gets the frontier from the
  // hook; one that is seen belongs to a leave_region() that waits.
  heap.growths.fetch_add(1, std::memory_order_seq_cst);
  for (const auto& entry : heap.client_region) {
    std::byte* const region = entry.load(std::memory_order_seq_cst);
    if (region != nullptr) dataplane::store_frontier<SharedMemory>(region, window, bytes);
  }
  heap.growths.fetch_add(1, std::memory_order_release);
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
      return tl::unexpected(lock_refusal(AGNOCAST_HEAPHOOK_ATTACH_BYTES));
    case AGNOCAST_HEAPHOOK_FULL:
      return fail(Errc::window_exhausted, "opening a heap window");
    case AGNOCAST_HEAPHOOK_OS:
      if (errno == ENOMEM)
        return tl::unexpected(no_memory(AGNOCAST_HEAPHOOK_ATTACH_BYTES, "opening a heap window"));
      return fail(Errc::os_failure, "opening a heap window", errno);
    default:
      return fail(Errc::internal, "opening a heap window");
  }
}

// Returns the object file that contains `address`; "an unknown library" in a statically linked
// program.
std::string file_of(const void* address) {
  Dl_info info{};
  return ::dladdr(address, &info) != 0 && info.dli_fname != nullptr ? info.dli_fname
                                                                    : "an unknown library";
}

// Allocates as `new Message` does.
void* new_block() {
  try {
    return ::operator new(64);
  } catch (const std::bad_alloc&) {
    return nullptr;
  }
}

// Reports the library that provides `symbol` instead of the hook.
tl::unexpected<Failure> ineffective(const char* name, const char* symbol,
                                    const agnocast_heaphook_table* hook) {
  const std::string owner = file_of(::dlsym(RTLD_DEFAULT, symbol));
  const std::string ours = file_of(hook);
  return fail_with(Errc::hook_ineffective,
                   owner == ours
                       ? std::string(name) + " does not reach " + ours
                       : std::string(name) + " comes from " + owner + ", not from " + ours);
}

void describe_window(std::byte* client_region, std::uint64_t window, std::uint64_t base,
                     std::uint64_t length) noexcept {
  auto& entry = reinterpret_cast<abi::ClientRegionHeader*>(client_region)->window[window];
  AGNOCAST_CRASH_POINT(C_window_described);
  entry.length.store(length, std::memory_order_relaxed);
  AGNOCAST_CRASH_POINT(C_window_described);
  entry.base.store(base, std::memory_order_release);
}

void remember(std::uint64_t window, std::uint64_t base, std::uint64_t length, std::uint64_t first,
              UniqueFd write_fd) {
  attached.base[window] = base;
  attached.length[window] = length;
  attached.first[window] = first;
  // Stays for the life of the process: other windows at these addresses are not mapped here.
  [[maybe_unused]] const bool entered = AddressUsers::instance().enter(
      base, length, AddressUsers::file_of(write_fd.get()), AddressUsers::own);
  attached.write_fd[window] = write_fd.release();
}

template <class Pointer>
bool lies_in_heap(const agnocast_heaphook_table& hook, Pointer block) noexcept {
  return block != nullptr && hook.owns(block) != 0;
}

// LoanPauses of the calling thread. Adoption lifts them: publish works during a pause as well.
thread_local std::uint64_t pause_count = 0;

/// Grows with each allocation that came from elsewhere, and with each move of the heap: readers
/// of later messages may not be able to map memory allocated before it.
std::uint64_t strays() noexcept { return attached.hook->spilled() + attached.hook->first_window(); }

// Whether allocations of the calling thread are useless unless they are shared.
thread_local bool refuses_private = false;
[[noreturn]] void throw_no_room() { throw std::bad_alloc(); }

bool refuse_private(void*, bool refuses) noexcept {
  attached.hook->on_no_room(refuses ? throw_no_room : nullptr);
  return std::exchange(refuses_private, refuses);
}

std::uint64_t begin_adoption(void*) noexcept {
  AGNOCAST_CRASH_POINT(C_adopt);
  for (std::uint64_t i = 0; i < pause_count; ++i) attached.hook->resume();
  attached.hook->enter();
  return strays();
}
std::uint64_t end_adoption(void*) noexcept {
  AGNOCAST_CRASH_POINT(C_adopted);
  attached.hook->leave();
  for (std::uint64_t i = 0; i < pause_count; ++i) attached.hook->pause();
  return strays();
}
WindowSet windows(void*) noexcept {
  // Earlier windows are foreign: a reader of the message may not have mapped them.
  WindowSet set;
  const std::uint64_t first = attached.hook->first_window();
  const std::uint64_t count = attached.count.load(std::memory_order_acquire);
  for (std::uint64_t i = first; i < count; ++i) {
    (void)set.add(attached.base[i],
                  attached.base[i] + attached.hook->frontier(static_cast<std::uint32_t>(i)));
  }
  return set;
}

Errc why_full(void*) noexcept {
  return attached.is_last.load(std::memory_order_relaxed) ? Errc::window_exhausted
                                                          : Errc::heap_exhausted;
}

}  // namespace

tl::unexpected<Failure> Heap::missing_hook() {
  const char* const preload = std::getenv("LD_PRELOAD");
  return fail_with(Errc::hook_missing,
                   preload == nullptr || *preload == '\0'
                       ? std::string("LD_PRELOAD is not set")
                       : "LD_PRELOAD is " + in_quotes(preload, 512) + ", which did not load it");
}

Result<Heap> Heap::find() {
  using Find = const agnocast_heaphook_table* (*)();
  const auto find_hook = reinterpret_cast<Find>(::dlsym(RTLD_DEFAULT, "agnocast_heaphook"));
  if (find_hook == nullptr) return Heap(&block_heap());
  const agnocast_heaphook_table* const hook = find_hook();
  if (hook->abi_version != AGNOCAST_HEAPHOOK_ABI_VERSION || hook->size_bytes != sizeof *hook) {
    return fail_with(Errc::hook_missing,
                     file_of(hook) + " has version " + std::to_string(hook->abi_version) +
                         " of the hook's interface, the library needs version " +
                         std::to_string(AGNOCAST_HEAPHOOK_ABI_VERSION));
  }
  return Heap(hook);
}

Result<void> Heap::attach(std::byte* client_region, std::uint64_t base, std::uint64_t length,
                          UniqueFd write_fd, int read_fd, HeapScope scope,
                          void (*grown)() noexcept) {
  attached.client_region[0].store(client_region, std::memory_order_seq_cst);
  attached.grown = grown;
  attached.hook = hook_;
  describe_window(client_region, 0, base, length);
  const agnocast_heaphook_window window{
      reinterpret_cast<void*>(base),     length, write_fd.get(), read_fd,
      AGNOCAST_HEAPHOOK_WINDOW_RESERVED, 0};
  const agnocast_heaphook_options options{
      static_cast<std::uint32_t>(scope == HeapScope::all ? AGNOCAST_HEAPHOOK_SCOPE_ALL
                                                         : AGNOCAST_HEAPHOOK_SCOPE_LOAN),
      0, store_grown, &attached};
  // A second call after an ineffective hook: the hook attaches only once, and the answer is the
  // same.
  if (attached.count.load(std::memory_order_relaxed) == 0) {
    AGNOCAST_CRASH_POINT(C_window_open);
    if (Result<void> opened = result_of(hook_->attach(&window, &options)); !opened) return opened;
    AGNOCAST_CRASH_POINT(C_window_opened);
    remember(0, base, length, 0, std::move(write_fd));
    attached.count.store(1, std::memory_order_release);
  }

  if (copies()) return {};
  // Find out who provides malloc and new. The compiler must not optimise these calls away.
  hook_->enter();
  void* volatile by_malloc = std::malloc(64);
  void* volatile by_new = new_block();
  hook_->leave();
  attached.malloc_is_ours = lies_in_heap(*hook_, static_cast<void*>(by_malloc));
  attached.new_is_ours = lies_in_heap(*hook_, static_cast<void*>(by_new));
  std::free(by_malloc);
  ::operator delete(by_new);
  open_hook.store(hook_, std::memory_order_release);
  return {};
}

bool Heap::copies() const noexcept { return hook_ == &block_heap(); }

Result<void> Heap::check_interposition() const {
  if (!attached.malloc_is_ours) return ineffective("malloc", "malloc", hook_);
  if (!attached.new_is_ours) return ineffective("operator new", "_Znwm", hook_);
  return {};
}

Result<void> Heap::add_window(std::byte* client_region, std::uint64_t window, std::uint64_t base,
                              std::uint64_t length, UniqueFd write_fd, int read_fd,
                              bool fresh) noexcept {
  describe_window(client_region, window, base, length);
  const agnocast_heaphook_window next{
      reinterpret_cast<void*>(base),
      length,
      write_fd.get(),
      read_fd,
      AGNOCAST_HEAPHOOK_WINDOW_RESERVED | (fresh ? AGNOCAST_HEAPHOOK_WINDOW_FRESH : 0u),
      0};
  // Recorded before the hook returns its first address, so that a message there is resident.
  remember(window, base, length, fresh ? window : attached.first[window - 1], std::move(write_fd));
  attached.count.store(window + 1, std::memory_order_release);
  AGNOCAST_CRASH_POINT(C_window_open);
  Result<void> opened = result_of(hook_->add_window(&next));
  AGNOCAST_CRASH_POINT(C_window_opened);
  if (!opened) {
    attached.count.store(window, std::memory_order_release);
    UniqueFd gone(attached.write_fd[window]);
    AddressUsers::instance().leave(base);
  }
  return opened;
}

std::uint64_t Heap::window_count() noexcept {
  return attached.count.load(std::memory_order_acquire);
}

Heap::Window Heap::window(std::uint64_t number) noexcept {
  return {attached.base[number], attached.length[number], attached.first[number],
          attached.write_fd[number]};
}

bool Heap::follow(std::byte* client_region) noexcept {
  const std::uint64_t count = window_count();
  for (std::uint64_t i = 0; i < count; ++i)
    describe_window(client_region, i, attached.base[i], attached.length[i]);
  AGNOCAST_CRASH_POINT(C_follow);
  const bool is_followed = std::any_of(
      std::begin(attached.client_region), std::end(attached.client_region), [&](auto& entry) {
        std::byte* none = nullptr;
        return entry.compare_exchange_strong(none, client_region, std::memory_order_seq_cst);
      });
  if (!is_followed) return false;
  AGNOCAST_CRASH_POINT(C_follow);
  // [sync:growth] A growth that did not see the region has stored the frontier in the hook
  // before.
  attached.growths.load(std::memory_order_seq_cst);
  for (std::uint64_t i = 0; i < count; ++i) {
    std::uint64_t none = 0;  // or a growth has stored a newer one
    region::frontier_word<SharedMemory>(client_region, i)
        .compare_exchange_strong(none, attached.hook->frontier(static_cast<std::uint32_t>(i)),
                                 std::memory_order_release, std::memory_order_relaxed);
  }
  return true;
}

void Heap::leave_region(std::byte* client_region) noexcept {
  for (auto& entry : attached.client_region) {
    std::byte* left = client_region;
    if (!entry.compare_exchange_strong(left, nullptr, std::memory_order_seq_cst)) continue;
    // [sync:growth] A growth in progress may have seen it. Sleeps: the growing thread may have a
    // lower priority.
    const std::uint64_t now = attached.growths.load(std::memory_order_seq_cst);
    while (now % 2 != 0 && attached.growths.load(std::memory_order_acquire) == now)
      std::this_thread::sleep_for(std::chrono::microseconds{100});
  }
}

void Heap::no_more_windows() noexcept { attached.is_last.store(true, std::memory_order_relaxed); }

bool Heap::has_last_window() const noexcept {
  return attached.is_last.load(std::memory_order_relaxed);
}

bool Heap::wants_window() const noexcept { return hook_->window_wanted() != 0; }

std::uint64_t Heap::used_bytes() const noexcept {
  agnocast_heaphook_usage usage{};
  hook_->usage(&usage);
  return usage.used_bytes;
}

Heap::Room Heap::room() const noexcept {
  agnocast_heaphook_usage usage{};
  hook_->usage(&usage);
  const std::uint64_t windows = std::max<std::uint64_t>(usage.window_count, 1);
  return {usage.used_bytes, usage.refused_count,
          usage.length_bytes / windows * abi::window_count_max};
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
  return {nullptr, begin_adoption, end_adoption, windows, why_full, refuse_private};
}

namespace {

constexpr bool is_ordinary(std::size_t alignment) noexcept {
  return alignment <= __STDCPP_DEFAULT_NEW_ALIGNMENT__;
}

}  // namespace

void* detail::allocate_shared(std::size_t bytes, std::size_t alignment) {
  if (const auto* hook = open_hook.load(std::memory_order_acquire); hook != nullptr) {
    if (void* const block = hook->allocate(alignment, bytes); block != nullptr) return block;
    // Not during a LoanPause.
    if (refuses_private && hook->active() != 0) throw_no_room();
  }
  if (is_ordinary(alignment)) return ::operator new(bytes);
  return ::operator new(bytes, std::align_val_t(alignment));
}

void detail::deallocate_shared(void* block, std::size_t alignment) noexcept {
  const auto* const hook = open_hook.load(std::memory_order_acquire);
  if (hook != nullptr && hook->deallocate(block) != 0) return;
  if (is_ordinary(alignment)) {
    ::operator delete(block);
  } else {
    ::operator delete(block, std::align_val_t(alignment));
  }
}

}  // namespace agnocast
