// SPDX-License-Identifier: Apache-2.0
//
// Residency: is every byte that a reader of a message may touch in shared memory? And if not, the
// repair.
//
// A std::vector that was filled before the loan began, or moved in from elsewhere, lies in memory
// that no other process has. publish therefore asks check_residency() about every message, and
// hands foreign ones to make_resident(), which needs no knowledge of layouts: it copies the message
// by its own copy constructor while the shared heap is on. Called by publish; users see the outcome
// as PublishResult::adopted_bytes.
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

/// The address ranges of this process's shared heap that may be published from: each window up to
/// its frontier.
class WindowSet {
 public:
  static constexpr std::size_t count_max = 8;
  struct Window {
    std::uintptr_t begin;  ///< first byte
    std::uintptr_t end;    ///< one past the last
  };

  // What lies beyond count() is never read, and each publish makes one: it is not filled with zeros.
  WindowSet() noexcept {}

  /// Adds [begin, end). False, and nothing changed, if it is empty, overlaps another or is one too
  /// many. Keeps order.
  AGNOCAST_PUBLIC bool add(std::uintptr_t begin, std::uintptr_t end) noexcept;

  /// Whether all of [first, first + bytes) lies in one window. At most eight comparisons; usually
  /// one.
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

/// What check_residency found.
struct Residency {
  static constexpr std::size_t path_bytes_max = 160;

  /// Bytes of all ranges that a reader would touch: the size of the message. Of an opaque type only
  /// sizeof is known.
  std::uint64_t message_bytes = 0;

  /// Bytes of the ranges that a reader would touch and that lie outside the windows. A range is the
  /// message object, the elements of one sequence (not its spare capacity), or the text of one
  /// string outside its object with its terminator. Ranges are disjoint, so no byte counts twice;
  /// text inside a string object counts with what contains that object.
  std::uint64_t foreign_bytes = 0;
  /// How many such ranges.
  std::uint64_t foreign_count = 0;
  /// Ranges whose address cannot be learnt: an opaque type, or a vector<bool> of an unknown
  /// standard library. Their bytes are in foreign_bytes too, as far as known: of an opaque message
  /// only sizeof.
  std::uint64_t unseen_count = 0;
  /// Start of the first foreign range; null if it is unseen.
  const void* first_address = nullptr;
  /// Where the first one is: "fields[1].name". "(message)" is the object itself. Shortened if too
  /// long; empty if resident.
  std::array<char, path_bytes_max> first_path;

  Residency() noexcept { first_path[0] = '\0'; }
  bool is_resident() const noexcept { return foreign_count == 0 && unseen_count == 0; }
};

/// Looks at every piece of memory of `message`, which must be a live object of that type that
/// nobody changes meanwhile. Allocates nothing, calls nothing of the user's but for_each_pointer,
/// throws nothing. Any thread. Cost: one range check per string and sequence; elements are walked
/// only if they own memory themselves. So it grows with the number of strings and inner sequences,
/// which the publisher built one by one, never with payload bytes.
[[nodiscard]] AGNOCAST_PUBLIC Residency check_residency(const MessageType& type,
                                                        const void* message,
                                                        const WindowSet& windows) noexcept;

namespace detail {
class Walk;
}

/// What MessageTraits<T>::for_each_pointer is given. One call for each piece of memory; `label`
/// (static text) names it in diagnoses. Objects inside objects (a vector of strings) need a call
/// for the vector and one for each string.
class PointerVisitor {
 public:
  /// `bytes` bytes from `first`. Nothing to check if bytes is 0.
  AGNOCAST_PUBLIC void operator()(const char* label, const void* first, std::size_t bytes) noexcept;
  /// The text of a string; one short enough to lie in the string object is fine.
  template <class C, class Traits, class Allocator>
  void operator()(const char* label, const std::basic_string<C, Traits, Allocator>& text) noexcept {
    const auto first = reinterpret_cast<std::uintptr_t>(text.data());
    const auto self = reinterpret_cast<std::uintptr_t>(&text);
    if (first >= self && first < self + sizeof(text)) return;
    (*this)(label, text.data(), (text.size() + 1) * sizeof(C));
  }
  /// The elements of a vector.
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

/// How the library steers the heap hook. All concern the calling thread or are safe from any.
struct SharedHeap {
  void* context = nullptr;
  /// From now on allocations of this thread come from the shared heap, until as many leave() as
  /// enter(). Both return a running count; as long as it stays the same, whatever this thread
  /// allocated in between lies in what windows() returns afterwards.
  std::uint64_t (*enter)(void* context) noexcept = nullptr;
  std::uint64_t (*leave)(void* context) noexcept = nullptr;
  /// The windows as they are now; a scope may have opened another one.
  WindowSet (*windows)(void* context) noexcept = nullptr;
  /// Why there is no room: window_exhausted when this process gets no further window, else
  /// heap_exhausted (also where this is null).
  Errc (*why_full)(void* context) noexcept = nullptr;
  /// Whether what the shared heap has no room for throws std::bad_alloc out of operator new of this
  /// thread, in a scope, or comes from elsewhere; returns what was so before. Null: it always comes
  /// from elsewhere.
  bool (*refuse_private)(void* context, bool refuses) noexcept = nullptr;

  Failure full() const noexcept {
    return {why_full != nullptr ? why_full(context) : Errc::heap_exhausted, 0,
            "copying a message into the shared heap"};
  }
};

/// The shared heap is on in this thread while this object lives.
class SharedScope {
 public:
  /// `heap` must outlive this object.
  explicit SharedScope(const SharedHeap& heap) noexcept
      : heap_(&heap), before_(heap.enter(heap.context)) {}
  ~SharedScope() { close(); }
  SharedScope(const SharedScope&) = delete;
  SharedScope& operator=(const SharedScope&) = delete;

  /// Ends the scope; 0 if all that was allocated in it lies in the windows. Later calls do nothing
  /// and return 0.
  std::uint64_t close() noexcept {
    if (heap_ == nullptr) return 0;
    const SharedHeap& heap = *std::exchange(heap_, nullptr);
    return heap.leave(heap.context) - before_;
  }

 private:
  const SharedHeap* heap_;
  std::uint64_t before_;
};

/// While this object lives, a copy that finds no room in the shared heap ends there: the rest of it is
/// not written to private memory first, only to be thrown away.
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

/// What make_resident did.
struct Adoption {
  /// Residency::foreign_bytes of the original; 0 if nothing was to do.
  std::uint64_t adopted_bytes = 0;
  std::uint64_t message_bytes = 0;  ///< Residency::message_bytes of what is there now
};

namespace detail {

/// False of a copy constructor that would end the process if operator new threw in it. That of a
/// trivially copyable class allocates nothing.
template <class T>
inline constexpr bool copy_may_throw =
    std::is_trivially_copyable_v<T> || !std::is_nothrow_copy_constructible_v<T>;

/// A message in the shared heap, and its Residency::message_bytes.
template <class Pointer>
struct ResidentCopy {
  Pointer message;
  std::uint64_t message_bytes = 0;
};

/// `code.copy(original)` with memory that is allocated while it runs; it may throw. Not inlined: publish, which seldom
/// needs it, would get longer for each message.
template <class Code, class Object>
[[gnu::noinline]] Result<ResidentCopy<typename Code::Owner>> try_copy_into_heap(const Code& code,
                                                              const Object& original,
                                                              const MessageType& type,
                                                              const SharedHeap& heap) noexcept {
  SharedScope scope(heap);
  using Made = Result<ResidentCopy<typename Code::Owner>>;
  return guarded(
      [&]() -> Made {
        typename Code::Owner copy = [&] {
          const SharedOnly shared_only(heap, has_exceptions && Code::copy_may_throw);
          return code.copy(original);
        }();
        // What is unseen cannot be looked at again, but then it is known that no allocation went
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

/// The same; where there was no room `has_more_room()` is asked to make some, and it is tried once more.
template <class Code, class Object, class HasMoreRoom>
[[gnu::noinline]] Result<ResidentCopy<typename Code::Owner>> copy_into_heap(const Code& code, const Object& original,
                                                          const HasMoreRoom& has_more_room,
                                                          const MessageType& type,
                                                          const SharedHeap& heap) noexcept {
  // Nothing is assigned: without exceptions tl::expected assigns only what can be copied.
  auto copy = try_copy_into_heap(code, original, type, heap);
  if (copy || copy.error().code == Errc::user_code_threw || !has_more_room()) return copy;
  return try_copy_into_heap(code, original, type, heap);
}

/// make_resident() for any owning pointer; `make_room()` is called before a copy is made.
template <class Code, class MakeRoom, class HasMoreRoom>
Result<Adoption> make_resident_by(const Code& code, const MakeRoom& make_room,
                                  const HasMoreRoom& has_more_room, typename Code::Owner& message,
                                  const MessageType& type, const SharedHeap& heap) noexcept {
  const Residency found = check_residency(type, message.get(), heap.windows(heap.context));
  if (found.is_resident()) return Adoption{0, found.message_bytes};
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

/// Makes `message` resident, by adoption if it must: a copy is built in the shared heap, the
/// original destroyed and `message` pointed at the copy. The whole message is copied, resident parts
/// too; adopted_bytes says what would have been enough.
///
/// On failure `message` is as before. Errors: heap_exhausted: the shared heap cannot hold it;
/// user_code_threw: the copy constructor threw something other than bad_alloc. Throws nothing,
/// whatever T does. Cost: check_residency, and if anything is foreign a copy, a second check and a
/// destruction. Any thread.
template <class T>
[[nodiscard]] Result<Adoption> make_resident(std::unique_ptr<T>& message, const MessageType& type,
                                             const SharedHeap& heap) noexcept {
  static_assert(detail::require_message<T>());
  return detail::make_resident_by(
      detail::TypedCode<T>(), [] {}, [] { return false; }, message, type, heap);
}

}  // namespace agnocast
