// SPDX-License-Identifier: Apache-2.0
//
// Messages to bytes. The message may lie in memory of another process, which may change it while it
// is written: the length is counted in one look and the bytes are written in another, so the writer
// checks each step against the room that there is.

#include <bridge/cdr_plan.hpp>

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

const std::string& text_at(const void* at) { return *static_cast<const std::string*>(at); }
const std::u16string& wide_text_at(const void* at) {
  return *static_cast<const std::u16string*>(at);
}

// Positions are from the first byte after the encapsulation, as CDR aligns.
class Size {
 public:
  std::size_t of(const CdrPlan& plan, const std::byte* memory, std::size_t position) {
    position_ = position;
    message(plan, memory);
    return position_;
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
    position_ += text.is_wide ? 4 * wide_text_at(at).size() : text_at(at).size() + 1;
  }
  void add(const CdrBits& bits, const std::byte* at) {
    add_count();
    position_ += bits.table->size_function(at);
  }
  void add(const CdrElements& elements, const std::byte* at) {
    std::size_t count = elements.fixed_count;
    if (elements.is_sequence()) {
      add_count();
      count = elements.table->size_function(at);
      if (count == 0) return;
      at = static_cast<const std::byte*>(elements.table->get_const_function(at, 0));
    }
    if (const CdrRun* const run = elements.element->dense()) return add(*run, at, count);
    for (std::size_t i = 0; i < count; ++i)
      message(*elements.element, at + i * elements.element->memory_bytes);
  }

  std::size_t position_ = 0;
};

class Writer {
 public:
  explicit Writer(std::span<std::byte> to) : to_(to) {}

  CdrResult<std::size_t> write(const CdrPlan& plan, const ServiceHeader* header,
                               const std::byte* memory) {
    constexpr std::byte encapsulation[cdr_encapsulation_bytes] = {std::byte{0}, std::byte{1}};
    const bool has_begun = put_bytes(encapsulation, sizeof encapsulation) &&
                           (header == nullptr || (put_bytes(&header->client_id, 8) &&
                                                  put_bytes(&header->sequence_number, 8)));
    if (!has_begun) (void)fail(CdrReason::no_room, "");
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
    std::memcpy(to_.data() + at_, bytes, count);
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
    if (text.is_wide) return put_wide(text, std::u16string_view(wide_text_at(at)));
    const std::string_view letters = text_at(at);
    constexpr char end = '\0';
    if (!put_count(text, letters.size(), sizeof end)) return false;
    return (put_bytes(letters.data(), letters.size()) && put_bytes(&end, sizeof end)) ||
           fail(CdrReason::no_room, text.member);
  }
  // Each unit takes four bytes, and nothing ends them.
  bool put_wide(const CdrText& text, std::u16string_view letters) {
    if (!put_count(text, letters.size())) return false;
    for (const std::uint32_t letter : letters) {
      if (!put_bytes(&letter, sizeof letter)) return fail(CdrReason::no_room, text.member);
    }
    return true;
  }
  bool put(const CdrBits& bits, const std::byte* at) {
    const std::size_t count = bits.table->size_function(at);
    if (!put_count(bits, count)) return false;
    if (count > room()) return fail(CdrReason::no_room, bits.member);
    for (std::size_t i = 0; i < count; ++i) {
      bool value = false;
      bits.table->fetch_function(at, i, &value);
      to_[at_++] = std::byte(value);
    }
    return true;
  }
  bool put(const CdrElements& elements, const std::byte* at) {
    std::size_t count = elements.fixed_count;
    if (elements.is_sequence()) {
      count = elements.table->size_function(at);
      if (!put_count(elements, count)) return false;
      if (count == 0) return true;
      at = static_cast<const std::byte*>(elements.table->get_const_function(at, 0));
    }
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
  std::size_t at_ = 0;
  std::optional<CdrFailure> failure_;
};

}  // namespace

std::size_t cdr_bytes(const CdrType& type, const void* message) noexcept {
  return cdr_encapsulation_bytes +
         Size().of(type.plan(), static_cast<const std::byte*>(message), 0);
}
std::size_t service_cdr_bytes(const CdrType& type, const void* message) noexcept {
  return cdr_encapsulation_bytes +
         Size().of(type.plan(), static_cast<const std::byte*>(message), cdr_service_header_bytes);
}

CdrResult<std::size_t> write_cdr(const CdrType& type, const void* message,
                                 std::span<std::byte> to) {
  return Writer(to).write(type.plan(), nullptr, static_cast<const std::byte*>(message));
}
CdrResult<std::size_t> write_service_cdr(const CdrType& type, const ServiceHeader& header,
                                         const void* message, std::span<std::byte> to) {
  return Writer(to).write(type.plan(), &header, static_cast<const std::byte*>(message));
}

}  // namespace agnocast::bridge
