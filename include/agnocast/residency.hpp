// SPDX-License-Identifier: Apache-2.0
//
// Residency: checks whether every byte that a reader of a message may touch is in shared memory,
// and repairs the message if not.
//
// A std::vector filled before the loan began, or moved in from elsewhere, has memory that no
// other process maps. publish therefore calls check_residency() for every message, and
// make_resident() for those with foreign memory. That needs no knowledge of layouts: it copies
// the message with its own copy constructor while the shared heap is on. Users see the outcome as
// PublishResult::adopted_bytes.
#pragma once

#include <agnocast/exceptions.hpp>
#include <agnocast/export.hpp>
#include <agnocast/message_type.hpp>
#include <agnocast/result.hpp>

#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <new>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

namespace agnocast {

/// Address ranges of shared heap windows, each as far as it is in use: for a publisher those that
/// it may publish from.
class WindowSet {
 public:
  static constexpr std::size_t count_max = 8;
  struct Window {
    std::uintptr_t begin;  ///< first byte
    std::uintptr_t end;    ///< one past the last
  };

  // Elements beyond count() are never read; they are not zeroed, because each publish makes a
  // WindowSet.
  WindowSet() noexcept {}

  /// Adds [begin, end). Returns false, and changes nothing, if the range is empty, overlaps
  /// another or is one too many. Keeps order.
  AGNOCAST_PUBLIC bool add(std::uintptr_t begin, std::uintptr_t end) noexcept;

  /// Returns whether all of [first, first + bytes) is in one window. At most eight comparisons;
  /// usually one.
  bool contains(const void* first, std::size_t bytes) const noexcept {
    const auto address = reinterpret_cast<std::uintptr_t>(first);
    for (std::size_t i = 0; i < count_; ++i) {
      if (address < windows_[i].begin) return false;  // sorted: every later window begins higher
      if (address < windows_[i].end) return bytes <= windows_[i].end - address;
    }
    return false;
  }

  std::size_t count() const noexcept { return count_; }
  const Window& operator[](std::size_t index) const noexcept { return windows_[index]; }

 private:
  std::array<Window, count_max> windows_;
  std::size_t count_ = 0;
};

/// Result of check_residency.
struct Residency {
  static constexpr std::size_t path_bytes_max = 160;

  /// Bytes of all ranges that a reader would touch: the size of the message. For an opaque type
  /// only sizeof is known.
  std::uint64_t message_bytes = 0;

  /// Bytes of the ranges that a reader would touch outside the windows. A range is the message
  /// object, the elements of one sequence (without spare capacity), or the text of one string
  /// outside its object with its terminator. Ranges are disjoint, so no byte counts twice; text
  /// inside a string object counts with the object that contains it.
  std::uint64_t foreign_bytes = 0;
  /// Number of such ranges.
  std::uint64_t foreign_count = 0;
  /// Ranges with an unknown address: an opaque type, or a vector<bool> of an unknown standard
  /// library. foreign_bytes includes their bytes as far as known: only sizeof for an opaque
  /// message.
  std::uint64_t unseen_count = 0;
  /// Start of the first foreign range; null if it is unseen.
  const void* first_address = nullptr;
  /// Path of the first foreign range: "fields[1].name". "(message)" is the object itself. Cut if
  /// too long; empty if resident.
  std::array<char, path_bytes_max> first_path;

  Residency() noexcept { first_path[0] = '\0'; }
  bool is_resident() const noexcept { return foreign_count == 0 && unseen_count == 0; }
};

/// Checks every piece of memory of `message`, a live object of that type that no thread changes
/// meanwhile. Allocates nothing, calls no user code except for_each_pointer, throws nothing. Any
/// thread. Cost: one range check per string and sequence; it visits elements only if they own
/// memory themselves. So the cost grows with the number of strings and inner sequences, never
/// with payload bytes.
[[nodiscard]] AGNOCAST_PUBLIC Residency check_residency(const MessageType& type,
                                                        const void* message,
                                                        const WindowSet& windows) noexcept;

namespace detail {
class Walk;
}

/// The argument of MessageTraits<T>::for_each_pointer. Call it once for each piece of memory;
/// `label` (static text) names it in diagnoses. Nested objects (a vector of strings) need a call
/// for the vector and one for each string.
class PointerVisitor {
 public:
  /// Visits `bytes` bytes from `first`. Nothing is checked if bytes is 0.
  AGNOCAST_PUBLIC void operator()(const char* label, const void* first, std::size_t bytes) noexcept;
  /// Visits the text of a string; a short text inside the string object is always resident.
  template <class C, class Traits, class Allocator>
  void operator()(const char* label, const std::basic_string<C, Traits, Allocator>& text) noexcept {
    const auto first = reinterpret_cast<std::uintptr_t>(text.data());
    const auto self = reinterpret_cast<std::uintptr_t>(&text);
    if (first >= self && first < self + sizeof(text)) return;
    (*this)(label, text.data(), (text.size() + 1) * sizeof(C));
  }
  /// Visits the elements of a vector.
  template <class E, class Allocator>
  void operator()(const char* label, const std::vector<E, Allocator>& elements) noexcept {
    static_assert(!std::is_same_v<E, bool>,
                  "agnocast: only std::vector<bool> with its own allocator can be looked into");
    (*this)(label, elements.data(), elements.size() * sizeof(E));
  }
  AGNOCAST_PUBLIC void operator()(const char* label, const std::vector<bool>& bits) noexcept;

 private:
  friend class detail::Walk;
  explicit PointerVisitor(detail::Walk& walk) noexcept : walk_(walk) {}
  detail::Walk& walk_;
};

/// The library's interface to the heap hook. Functions affect the calling thread or may be called
/// by any.
struct SharedHeap {
  void* context = nullptr;
  /// Make allocations of this thread come from the shared heap, until as many leave() as enter().
  /// Both return a running count; if it is unchanged, everything that this thread allocated in
  /// between is in the windows that windows() returns afterwards.
  std::uint64_t (*enter)(void* context) noexcept = nullptr;
  std::uint64_t (*leave)(void* context) noexcept = nullptr;
  /// Returns the present windows; a scope may have opened another one.
  WindowSet (*windows)(void* context) noexcept = nullptr;
  /// Returns why there is no room: window_exhausted if this process gets no further window, else
  /// heap_exhausted (also if this is null).
  Errc (*why_full)(void* context) noexcept = nullptr;
  /// Sets whether operator new of this thread, in a scope, throws std::bad_alloc if the shared
  /// heap has no room, or allocates elsewhere; returns the previous setting. Null: it always
  /// allocates elsewhere.
  bool (*refuse_private)(void* context, bool refuses) noexcept = nullptr;

  Failure full() const noexcept {
    return {why_full != nullptr ? why_full(context) : Errc::heap_exhausted, 0,
            "copying a message into the shared heap"};
  }
};

/// Turns on the shared heap in this thread while this object lives.
class SharedScope {
 public:
  /// `heap` must outlive this object.
  explicit SharedScope(const SharedHeap& heap) noexcept
      : heap_(&heap), before_(heap.enter(heap.context)) {}
  ~SharedScope() { close(); }
  SharedScope(const SharedScope&) = delete;
  SharedScope& operator=(const SharedScope&) = delete;

  /// Ends the scope. Returns 0 if everything allocated in it is in the windows. Later calls do
  /// nothing and return 0.
  std::uint64_t close() noexcept {
    if (heap_ == nullptr) return 0;
    const SharedHeap& heap = *std::exchange(heap_, nullptr);
    return heap.leave(heap.context) - before_;
  }

 private:
  const SharedHeap* heap_;
  std::uint64_t before_;
};

/// While this object lives, a copy that finds no room in the shared heap stops there instead of
/// writing its rest to private memory in vain.
class SharedOnly {
 public:
  SharedOnly(const SharedHeap& heap, bool may_throw) noexcept
      : heap_(may_throw && heap.refuse_private != nullptr ? &heap : nullptr),
        before_(heap_ != nullptr && heap.refuse_private(heap.context, true)) {}
  ~SharedOnly() {
    if (heap_ != nullptr) (void)heap_->refuse_private(heap_->context, before_);
  }
  SharedOnly(const SharedOnly&) = delete;
  SharedOnly& operator=(const SharedOnly&) = delete;

 private:
  const SharedHeap* heap_;
  bool before_;
};

/// Outcome of make_resident.
struct Adoption {
  /// Residency::foreign_bytes of the original; 0 if it was resident.
  std::uint64_t adopted_bytes = 0;
  std::uint64_t message_bytes = 0;  ///< Residency::message_bytes of the result
};

namespace detail {

/// False for a copy constructor that would terminate the process if operator new threw in it.
/// That of a trivially copyable class allocates nothing.
template <class T>
inline constexpr bool copy_may_throw =
    std::is_trivially_copyable_v<T> || !std::is_nothrow_copy_constructible_v<T>;

/// A message in the shared heap, and its Residency::message_bytes.
template <class Pointer>
struct ResidentCopy {
  Pointer message;
  std::uint64_t message_bytes = 0;
};

/// Runs `code.copy(original)` in the shared heap; it may throw. Not inlined: publish seldom needs
/// it, and would get longer for each message type.
template <class Code, class Object>
[[gnu::noinline]] Result<ResidentCopy<typename Code::Owner>> try_copy_into_heap(
    const Code& code, const Object& original, const MessageType& type,
    const SharedHeap& heap) noexcept {
  SharedScope scope(heap);
  using Made = Result<ResidentCopy<typename Code::Owner>>;
  return guarded(
      [&]() -> Made {
        typename Code::Owner copy = [&] {
          const SharedOnly shared_only(heap, has_exceptions && Code::copy_may_throw);
          return code.copy(original);
        }();
        // Unseen ranges cannot be checked again, but the scope reports whether an allocation went
        // elsewhere.
        const bool has_strays = scope.close() != 0;
        const Residency now = check_residency(type, copy.get(), heap.windows(heap.context));
        if (now.foreign_count != 0 || (now.unseen_count != 0 && has_strays))
          return tl::unexpected(heap.full());
        return ResidentCopy<typename Code::Owner>{std::move(copy), now.message_bytes};
      },
      [&]() -> Made { return tl::unexpected(heap.full()); },
      []() -> Made { return fail(Errc::user_code_threw, "copy constructor of the message"); });
}

/// The same; if there is no room, calls `has_more_room()` to make some, and tries once more.
template <class Code, class Object, class HasMoreRoom>
[[gnu::noinline]] Result<ResidentCopy<typename Code::Owner>> copy_into_heap(
    const Code& code, const Object& original, const HasMoreRoom& has_more_room,
    const MessageType& type, const SharedHeap& heap) noexcept {
  // No assignment: without exceptions tl::expected assigns only copyable types.
  auto copy = try_copy_into_heap(code, original, type, heap);
  if (copy || copy.error().code == Errc::user_code_threw || !has_more_room()) return copy;
  return try_copy_into_heap(code, original, type, heap);
}

/// Replaces a message with foreign memory, as check_residency() has `found`, by a copy in the
/// shared heap; calls `make_room()` before it makes one.
template <class Code, class MakeRoom, class HasMoreRoom>
Result<Adoption> adopt_by(const Code& code, const MakeRoom& make_room,
                          const HasMoreRoom& has_more_room, typename Code::Owner& message,
                          const Residency& found, const MessageType& type,
                          const SharedHeap& heap) noexcept {
  make_room();
  auto copy = copy_into_heap(code, std::as_const(*message), has_more_room, type, heap);
  if (!copy) return tl::unexpected(copy.error());
  message = std::move(copy->message);
  return Adoption{found.foreign_bytes, copy->message_bytes};
}

/// Makes, copies, owns and measures messages of class T.
template <class T>
struct TypedCode {
  using Owner = std::unique_ptr<T>;
  static constexpr bool copy_may_throw = detail::copy_may_throw<T>;
  Owner make() const { return Owner(new T()); }
  Owner copy(const T& original) const { return Owner(new T(original)); }
  Owner own(T* message) const noexcept { return Owner(message); }
  void* start_of(T* message) const noexcept { return message; }
  constexpr std::size_t bytes() const noexcept { return sizeof(T); }
};

}  // namespace detail

/// Makes `message` resident, by adoption if necessary: builds a copy in the shared heap, destroys
/// the original and points `message` at the copy. It copies the whole message, resident parts
/// too; adopted_bytes has the foreign bytes alone.
///
/// On failure `message` is unchanged. Errors: heap_exhausted: the shared heap cannot hold it;
/// user_code_threw: the copy constructor threw something other than bad_alloc. Throws nothing,
/// whatever T does. Cost: check_residency, and for foreign memory a copy, a second check and a
/// destruction. Any thread.
template <class T>
[[nodiscard]] Result<Adoption> make_resident(std::unique_ptr<T>& message, const MessageType& type,
                                             const SharedHeap& heap) noexcept {
  static_assert(detail::require_message<T>());
  const Residency found = check_residency(type, message.get(), heap.windows(heap.context));
  if (found.is_resident()) return Adoption{0, found.message_bytes};
  return detail::adopt_by(
      detail::TypedCode<T>(), [] {}, [] { return false; }, message, found, type, heap);
}

}  // namespace agnocast
