// SPDX-License-Identifier: Apache-2.0
//
// Messages to bytes. The message may lie in memory of another process, which may change it
// meanwhile and make it refer to any address. The length is counted in one look and the bytes are
// written in another, so the writer checks each step against the room left, copies each string and
// sequence object once (Snapshot), and follows it only into its publisher's memory.

#include <bridge/cdr/cdr_plan.hpp>

#include <algorithm>
#include <bit>
#include <cstring>
#include <limits>
#include <optional>
#include <string_view>

namespace agnocast::bridge {
namespace {

static_assert(std::endian::native == std::endian::little, "memory is copied to the wire as it is");

constexpr std::size_t count_max = std::numeric_limits<std::uint32_t>::max();

/// The memory that a message may refer to: any, if the message is this process's own.
class Reach {
 public:
  Reach(const CdrPlan& plan, const std::byte* message, const WindowSet* within) noexcept {
    if (within != nullptr) bounds_.emplace(*within);
    if (!take(message, 1, plan.memory_bytes)) is_left_ = true;
  }
  bool is_left() const noexcept { return is_left_; }

  template <class Text>
  bool has(const Snapshot<Text>& text, const std::byte* at) noexcept {
    return note(!bounds_ || agnocast::detail::take_text(*bounds_, *text, at));
  }
  bool has(const Snapshot<std::vector<bool>>& bits) noexcept {
    return note(!bounds_ || agnocast::detail::take_bits(*bounds_, *bits));
  }
  bool take(const void* first, std::size_t count, std::size_t bytes) noexcept {
    return note(!bounds_ || bounds_->take(first, count, bytes));
  }
  /// Finds the elements of a sequence; returns false if they lie elsewhere.
  struct Elements {
    const std::byte* first = nullptr;
    std::size_t count = 0;
  };
  bool follow(const CdrElements& elements, const std::byte* at, Elements& found) noexcept {
    const Snapshot<agnocast::detail::VectorEnds> ends(at);
    const std::size_t stride = elements.element->memory_bytes;
    // Elements at a null address are not searched: they lie nowhere.
    if (note(ends->end == ends->begin || (ends->end > ends->begin && ends->begin != nullptr))) {
      const auto bytes = static_cast<std::size_t>(ends->end - ends->begin);
      if (note(bytes % stride == 0) && bytes != 0) found = {ends->begin, bytes / stride};
    }
    return !is_left_ && take(found.first, found.count, elements.element->memory_bytes);
  }

 private:
  bool note(bool is_inside) noexcept {
    is_left_ = is_left_ || !is_inside;
    return is_inside;
  }

  std::optional<MessageBounds> bounds_;
  bool is_left_ = false;
};

// Positions count from the first byte after the encapsulation, as for alignment in CDR.
class Size {
 public:
  explicit Size(Reach& reach) : reach_(reach) {}
  /// Returns 0 if the message refers to memory elsewhere.
  std::size_t of(const CdrPlan& plan, const std::byte* memory, std::size_t position) {
    position_ = position;
    if (!reach_.is_left()) message(plan, memory);
    return reach_.is_left() ? 0 : cdr_encapsulation_bytes + position_;
  }

 private:
  void message(const CdrPlan& plan, const std::byte* memory) {
    for (const CdrStep& step : plan.steps)
      std::visit([&](const auto& of_kind) { add(of_kind, memory + of_kind.offset); }, step);
  }
  void add(const CdrRun& run, const std::byte*, std::size_t count = 1) {
    position_ = align_up(position_, run.alignment) + count * run.bytes;
  }
  void add_count() { position_ = align_up(position_, 4) + 4; }
  void add(const CdrText& text, const std::byte* at) {
    add_count();
    if (text.is_wide) {
      const Snapshot<std::u16string> letters(at);
      if (reach_.has(letters, at)) position_ += 4 * letters->size();
    } else {
      const Snapshot<std::string> letters(at);
      if (reach_.has(letters, at)) position_ += letters->size() + 1;
    }
  }
  void add(const CdrBits& bits, const std::byte* at) {
    add_count();
    const Snapshot<std::vector<bool>> values(at);
    if (reach_.has(values)) position_ += bits.table->size_function(&*values);
  }
  void add(const CdrElements& elements, const std::byte* at) {
    Reach::Elements found{at, elements.fixed_count};
    if (elements.is_sequence()) {
      add_count();
      if (!reach_.follow(elements, at, found) || found.count == 0) return;
    }
    if (const CdrRun* const run = elements.element->dense())
      return add(*run, found.first, found.count);
    for (std::size_t i = 0; i < found.count && !reach_.is_left(); ++i)
      message(*elements.element, found.first + i * elements.element->memory_bytes);
  }

  Reach& reach_;
  std::size_t position_ = 0;
};

class Writer {
 public:
  Writer(std::span<std::byte> to, Reach& reach) : to_(to), reach_(reach) {}

  CdrResult<std::size_t> write(const CdrPlan& plan, const ServiceHeader* header,
                               const std::byte* memory) {
    constexpr std::byte encapsulation[cdr_encapsulation_bytes] = {std::byte{0}, std::byte{1}};
    const bool has_begun = put_bytes(encapsulation, sizeof encapsulation) &&
                           (header == nullptr || (put_bytes(&header->client_id, 8) &&
                                                  put_bytes(&header->sequence_number, 8)));
    if (!has_begun) (void)fail(CdrReason::no_room, "");
    if (reach_.is_left()) {
      (void)fail(CdrReason::elsewhere, "");
      return tl::unexpected(std::move(*failure_));
    }
    if (!has_begun || !message(plan, memory)) return tl::unexpected(std::move(*failure_));
    return at_;
  }

 private:
  bool fail(CdrReason reason, std::string member) {
    failure_ = CdrFailure{reason, at_, std::move(member)};
    return false;
  }
  std::size_t room() const { return to_.size() - at_; }
  bool put_bytes(const void* bytes, std::size_t count) {
    if (count > room()) return false;
    if (count != 0) std::memcpy(to_.data() + at_, bytes, count);  // a text of nothing may be null
    at_ += count;
    return true;
  }
  bool align(std::size_t alignment) {
    const std::size_t position = at_ - cdr_encapsulation_bytes;
    const std::size_t padding = align_up(position, alignment) - position;
    if (padding > room()) return false;
    std::memset(to_.data() + at_, 0, padding);
    at_ += padding;
    return true;
  }
  template <class Step>
  bool put_count(const Step& step, std::size_t count, std::size_t more = 0) {
    if (count > step.bound) return fail(CdrReason::above_bound, step.member);
    if (count > count_max - more) return fail(CdrReason::uncountable, step.member);
    const auto number = static_cast<std::uint32_t>(count + more);
    return (align(4) && put_bytes(&number, sizeof number)) || fail(CdrReason::no_room, step.member);
  }

  bool message(const CdrPlan& plan, const std::byte* memory) {
    for (const CdrStep& step : plan.steps) {
      if (!std::visit([&](const auto& of_kind) { return put(of_kind, memory + of_kind.offset); },
                      step))
        return false;
    }
    return true;
  }
  bool put(const CdrRun& run, const std::byte* at) {
    return put_runs(run, at, 1) || fail(CdrReason::no_room, run.member_at(0));
  }
  bool put_runs(const CdrRun& run, const std::byte* at, std::size_t count) {
    if (!align(run.alignment) || count > room() / run.bytes) return false;
    std::byte* const first = to_.data() + at_;
    (void)put_bytes(at, count * run.bytes);
    if (run.has_bool) {
      for (std::size_t i = 0; i < count; ++i) make_bools_valid(run, first + i * run.bytes);
    }
    return true;
  }
  static void make_bools_valid(const CdrRun& run, std::byte* at) {
    for (const CdrPiece& piece : run.pieces) {
      if (!piece.is_bool) continue;
      std::transform(at + piece.offset, at + piece.end(), at + piece.offset,
                     [](std::byte value) { return std::byte(value != std::byte{0}); });
    }
  }
  bool put(const CdrText& text, const std::byte* at) {
    if (text.is_wide) {
      const Snapshot<std::u16string> wide(at);
      if (!reach_.has(wide, at)) return fail(CdrReason::elsewhere, text.member);
      return put_wide(text, std::u16string_view(*wide));
    }
    const Snapshot<std::string> string(at);
    if (!reach_.has(string, at)) return fail(CdrReason::elsewhere, text.member);
    const std::string_view letters = *string;
    constexpr char end = '\0';
    if (!put_count(text, letters.size(), sizeof end)) return false;
    return (put_bytes(letters.data(), letters.size()) && put_bytes(&end, sizeof end)) ||
           fail(CdrReason::no_room, text.member);
  }
  // Each unit takes four bytes, without a terminator.
  bool put_wide(const CdrText& text, std::u16string_view letters) {
    if (!put_count(text, letters.size())) return false;
    for (const std::uint32_t letter : letters) {
      if (!put_bytes(&letter, sizeof letter)) return fail(CdrReason::no_room, text.member);
    }
    return true;
  }
  bool put(const CdrBits& bits, const std::byte* at) {
    const Snapshot<std::vector<bool>> values(at);
    if (!reach_.has(values)) return fail(CdrReason::elsewhere, bits.member);
    const std::size_t count = bits.table->size_function(&*values);
    if (!put_count(bits, count)) return false;
    if (count > room()) return fail(CdrReason::no_room, bits.member);
    for (std::size_t i = 0; i < count; ++i) {
      bool value = false;
      bits.table->fetch_function(&*values, i, &value);
      to_[at_++] = std::byte(value);
    }
    return true;
  }
  bool put(const CdrElements& elements, const std::byte* at) {
    Reach::Elements found{at, elements.fixed_count};
    if (elements.is_sequence()) {
      if (!reach_.follow(elements, at, found)) return fail(CdrReason::elsewhere, elements.member);
      if (!put_count(elements, found.count)) return false;
      if (found.count == 0) return true;
    }
    const std::size_t count = found.count;
    at = found.first;
    const CdrPlan& plan = *elements.element;
    if (const CdrRun* const run = plan.dense())
      return put_runs(*run, at, count) || fail(CdrReason::no_room, elements.member);
    for (std::size_t i = 0; i < count; ++i) {
      if (message(plan, at + i * plan.memory_bytes)) continue;
      failure_->member = element_name(elements.member, i, failure_->member);
      return false;
    }
    return true;
  }

  std::span<std::byte> to_;
  Reach& reach_;
  std::size_t at_ = 0;
  std::optional<CdrFailure> failure_;
};

}  // namespace

std::size_t cdr_bytes(const CdrType& type, const void* message, const WindowSet* within) noexcept {
  const auto* const memory = static_cast<const std::byte*>(message);
  Reach reach(type.plan(), memory, within);
  return Size(reach).of(type.plan(), memory, 0);
}
std::size_t service_cdr_bytes(const CdrType& type, const void* message,
                              const WindowSet* within) noexcept {
  const auto* const memory = static_cast<const std::byte*>(message);
  Reach reach(type.plan(), memory, within);
  return Size(reach).of(type.plan(), memory, cdr_service_header_bytes);
}

CdrResult<std::size_t> write_cdr(const CdrType& type, const void* message, std::span<std::byte> to,
                                 const WindowSet* within) {
  const auto* const memory = static_cast<const std::byte*>(message);
  Reach reach(type.plan(), memory, within);
  return Writer(to, reach).write(type.plan(), nullptr, memory);
}
CdrResult<std::size_t> write_service_cdr(const CdrType& type, const ServiceHeader& header,
                                         const void* message, std::span<std::byte> to,
                                         const WindowSet* within) {
  const auto* const memory = static_cast<const std::byte*>(message);
  Reach reach(type.plan(), memory, within);
  return Writer(to, reach).write(type.plan(), &header, memory);
}

}  // namespace agnocast::bridge
