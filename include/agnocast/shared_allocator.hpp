// SPDX-License-Identifier: Apache-2.0
//
// SharedAllocator, SharedMessage: messages that allocate from the shared heap by themselves.
//
// Such a message is shared from its birth, in any thread, without a loan and whoever answers malloc
// in the process. So its publisher also works where the heap hook cannot stand in front of malloc:
// under AddressSanitizer and ThreadSanitizer, or beside another malloc. The hook must be in the
// process all the same, linked or preloaded: it owns the memory.
#pragma once

#include <agnocast/exceptions.hpp>
#include <agnocast/export.hpp>

#include <cstddef>
#include <limits>
#include <new>
#include <string>
#include <vector>

namespace agnocast {
namespace detail {

/// From the shared heap; from operator new when it has no room or is not open, in a LoanPause and in
/// a forked child. Throws bad_alloc. Any thread.
[[nodiscard]] AGNOCAST_PUBLIC void* allocate_shared(std::size_t bytes, std::size_t alignment);
AGNOCAST_PUBLIC void deallocate_shared(void* block, std::size_t alignment) noexcept;

}  // namespace detail

/// A standard allocator on the shared heap of this process. Before the first publisher, and in
/// processes without one, it allocates as usual; publish adopts what lies elsewhere, as always.
template <class T>
class SharedAllocator {
 public:
  using value_type = T;

  SharedAllocator() noexcept = default;
  template <class U>
  SharedAllocator(const SharedAllocator<U>&) noexcept {}

  [[nodiscard]] T* allocate(std::size_t count) {
    if (count > std::numeric_limits<std::size_t>::max() / sizeof(T))
      detail::throw_bad_array_new_length();
    return static_cast<T*>(detail::allocate_shared(count * sizeof(T), alignof(T)));
  }
  void deallocate(T* first, std::size_t) noexcept { detail::deallocate_shared(first, alignof(T)); }

  template <class U>
  bool operator==(const SharedAllocator<U>&) const noexcept {
    return true;
  }
  template <class U>
  bool operator!=(const SharedAllocator<U>&) const noexcept {
    return false;
  }
};

template <class T>
using SharedVector = std::vector<T, SharedAllocator<T>>;
using SharedString = std::basic_string<char, std::char_traits<char>, SharedAllocator<char>>;

/// Base of a message whose memory is all its own doing: the object itself by the operators here, what
/// it refers to by SharedAllocator. Its publisher does not ask who answers malloc. A member that
/// allocates otherwise (std::string) must not be there: where malloc is not the hook's it cannot be
/// adopted, and publish says heap_exhausted.
///
///     struct Track : agnocast::SharedMessage {
///       std::uint32_t id = 0;
///       agnocast::SharedVector<Point> points;
///     };
struct SharedMessage {
  static void* operator new(std::size_t bytes) {
    return detail::allocate_shared(bytes, __STDCPP_DEFAULT_NEW_ALIGNMENT__);
  }
  static void* operator new(std::size_t bytes, std::align_val_t alignment) {
    return detail::allocate_shared(bytes, static_cast<std::size_t>(alignment));
  }
  static void* operator new(std::size_t, void* place) noexcept { return place; }
  static void operator delete(void* message) noexcept {
    detail::deallocate_shared(message, __STDCPP_DEFAULT_NEW_ALIGNMENT__);
  }
  static void operator delete(void* message, std::align_val_t alignment) noexcept {
    detail::deallocate_shared(message, static_cast<std::size_t>(alignment));
  }
  static void operator delete(void*, void*) noexcept {}
};

}  // namespace agnocast
