// SPDX-License-Identifier: Apache-2.0
//
// Zeroed: an object that begins as zero bytes and whose pages get memory as they are written: large
// arrays of which most processes use the beginning only.
#pragma once

#include <sys/mman.h>

#include <cstring>
#include <memory>
#include <new>
#include <type_traits>

namespace agnocast {

/// Owns a T, which must be valid as zero bytes. Not thread-safe beyond what T is.
template <class T>
class Zeroed {
  static_assert(std::is_trivially_copyable_v<T> && std::is_trivially_destructible_v<T>);

 public:
  /// A mapping of its own: calloc(3) writes the zeroes into memory that was used before. Throws
  /// std::bad_alloc.
  Zeroed() : object_(map()) {}
  /// Copies, and so writes, all of it. Throws std::bad_alloc.
  Zeroed(const Zeroed& other) : Zeroed() {
    std::memcpy(static_cast<void*>(object_.get()), other.object_.get(), sizeof(T));
  }
  Zeroed& operator=(const Zeroed&) = delete;

  T* operator->() noexcept { return object_.get(); }
  const T* operator->() const noexcept { return object_.get(); }

 private:
  static T* map() {
    void* const at = ::mmap(nullptr, sizeof(T), PROT_READ | PROT_WRITE,
                            MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
    if (at == MAP_FAILED) throw std::bad_alloc();
    return static_cast<T*>(at);
  }
  struct Unmap {
    void operator()(T* object) const noexcept { ::munmap(object, sizeof(T)); }
  };
  std::unique_ptr<T, Unmap> object_;
};

}  // namespace agnocast
