// SPDX-License-Identifier: Apache-2.0
//
// SharedAllocator, SharedMessage: messages that allocate from the shared heap by themselves.
//
// Such a message is in the shared heap from its construction, in any thread, without a loan,
// whichever library provides malloc. So its publisher also works where the heap hook cannot
// replace malloc: under AddressSanitizer and ThreadSanitizer, or beside another malloc. The
// process still needs the hook, linked or preloaded: the hook owns the memory.
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

/// Allocates from the shared heap; from operator new if that has no room or is not open, in a
/// LoanPause and in a forked child. Throws bad_alloc. Any thread.
[[nodiscard]] AGNOCAST_PUBLIC void* allocate_shared(std::size_t bytes, std::size_t alignment);
AGNOCAST_PUBLIC void deallocate_shared(void* block, std::size_t alignment) noexcept;

}  // namespace detail

/// A standard allocator on the shared heap of this process. Before the first publisher, and in
/// processes without one, it allocates as usual; publish adopts such memory, as always.
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

/// Base class of a message that allocates all of its memory from the shared heap: the object
/// itself by these operators, its content by SharedAllocator. Its publisher does not check which
/// library provides malloc. All members must allocate in this way (so no std::string): where the
/// hook does not provide malloc, publish cannot adopt other memory and returns heap_exhausted.
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
