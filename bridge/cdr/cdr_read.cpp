// SPDX-License-Identifier: Apache-2.0
//
// Bytes to messages. The bytes come from another host. Whatever they are, the message's members
// stay valid: every size is checked before memory is allocated or written, and bools become 0 or
// 1. The border between two pieces may cut any value, even a number.

#include <bridge/cdr/cdr_plan.hpp>

#include <algorithm>
#include <cstring>
#include <optional>
#include <string>

namespace agnocast::bridge {
namespace {

/// The rest of the pieces.
class Input {
 public:
  explicit Input(CdrInput pieces) : pieces_(pieces) {
    for (const std::span<const std::byte> piece : pieces) size_ += piece.size();
  }

  std::size_t size() const { return size_; }
  std::size_t position() const { return position_; }
  std::size_t remaining() const { return size_ - position_; }

  /// Calls use(bytes, count) for each contiguous part of the next `count` bytes, which must exist.
  template <class Use>
  void take(std::size_t count, Use&& use) {
    position_ += count;
    while (count > 0) {
      if (current_.empty()) {
        current_ = pieces_[next_++];
        continue;
      }
      const std::size_t part = std::min(count, current_.size());
      use(current_.data(), part);
      current_ = current_.subspan(part);
      count -= part;
    }
  }
  void copy(void* to, std::size_t count) {
    auto* target = static_cast<std::byte*>(to);
    take(count, [&](const std::byte* bytes, std::size_t part) {
      std::memcpy(target, bytes, part);
      target += part;
    });
  }
  /// Returns false if the input ends before; then it is used up.
  bool align(std::size_t alignment) {
    const std::size_t body = position_ - cdr_encapsulation_bytes;
    const std::size_t padding = align_up(body, alignment) - body;
    const std::size_t there = std::min(padding, remaining());
    take(there, [](const std::byte*, std::size_t) {});
    return there == padding;
  }

 private:
  CdrInput pieces_;
  std::span<const std::byte> current_;
  std::size_t next_ = 0;
  std::size_t size_ = 0;
  std::size_t position_ = 0;
};

template <class Number, class Swap>
void swap_each(std::byte* at, std::size_t count, Swap swap) {
  for (std::size_t i = 0; i < count; ++i, at += sizeof(Number)) {
    Number number;
    std::memcpy(&number, at, sizeof number);
    number = swap(number);
    std::memcpy(at, &number, sizeof number);
  }
}
void swap_bytes(std::byte* at, std::size_t width, std::size_t count) {
  if (width == 2)
    swap_each<std::uint16_t>(at, count, [](std::uint16_t n) { return __builtin_bswap16(n); });
  else if (width == 4)
    swap_each<std::uint32_t>(at, count, [](std::uint32_t n) { return __builtin_bswap32(n); });
  else if (width == 8)
    swap_each<std::uint64_t>(at, count, [](std::uint64_t n) { return __builtin_bswap64(n); });
}

class Reader {
 public:
  explicit Reader(CdrInput from) : in_(from) {}

  CdrResult<std::size_t> read(const CdrPlan& plan, ServiceHeader* header, std::byte* memory) {
    if (!read_encapsulation() || (header != nullptr && !read_header(*header)) ||
        !message(plan, memory))
      return tl::unexpected(std::move(*failure_));
    return in_.position();
  }

 private:
  bool fail(CdrReason reason, std::size_t byte, std::string member) {
    failure_ = CdrFailure{reason, byte, std::move(member)};
    return false;
  }
  bool truncated(std::string member) {
    return fail(CdrReason::truncated, in_.size(), std::move(member));
  }

  // Only the second byte counts, as in rmw_cyclonedds.
  bool read_encapsulation() {
    if (in_.remaining() < cdr_encapsulation_bytes) return truncated("");
    std::uint8_t bytes[cdr_encapsulation_bytes];
    in_.copy(bytes, sizeof bytes);
    const std::uint8_t kind = bytes[1];
    if (kind == 2 || kind == 3) return fail(CdrReason::parameter_list, 1, "");
    if (kind >= 6 && kind <= 11) return fail(CdrReason::xcdr2, 1, "");
    is_swapped_ = kind != 1;
    return true;
  }
  bool read_header(ServiceHeader& header) {
    if (in_.remaining() < cdr_service_header_bytes) return truncated("");
    std::uint64_t words[2];
    in_.copy(words, sizeof words);
    if (is_swapped_) swap_bytes(reinterpret_cast<std::byte*>(words), 8, 2);
    header = {words[0], static_cast<std::int64_t>(words[1])};
    return true;
  }

  bool message(const CdrPlan& plan, std::byte* memory) {
    for (const CdrStep& step : plan.steps) {
      if (!std::visit([&](const auto& of_kind) { return get(of_kind, memory + of_kind.offset); },
                      step))
        return false;
    }
    return true;
  }

  bool get(const CdrRun& run, std::byte* at) {
    return get_runs(run, at, 1) || truncated(run.member_at(in_.remaining()));
  }
  /// Returns false if the input has fewer; then remaining() is the size of those that exist.
  bool get_runs(const CdrRun& run, std::byte* at, std::size_t count) {
    if (!in_.align(run.alignment) || in_.remaining() / run.bytes < count) return false;
    in_.copy(at, count * run.bytes);
    if (run.pieces.size() == 1) {
      mend(run.pieces.front(), at, count * run.pieces.front().count);
    } else if (is_swapped_ || run.has_bool) {
      for (std::size_t i = 0; i < count; ++i) {
        for (const CdrPiece& piece : run.pieces)
          mend(piece, at + i * run.bytes + piece.offset, piece.count);
      }
    }
    return true;
  }
  void mend(const CdrPiece& piece, std::byte* at, std::size_t count) const {
    if (is_swapped_) swap_bytes(at, piece.width, count);
    if (piece.is_bool) {
      std::transform(at, at + count, at,
                     [](std::byte value) { return std::byte(value != std::byte{0}); });
    }
  }

  /// Reads a count of elements that take at least `least` bytes each; returns nothing if the rest
  /// cannot hold them and the elements promised already. So all counts together promise no more
  /// than the input has, however deeply sequences are nested, and the input bounds the memory.
  template <class Step>
  std::optional<std::size_t> get_count(const Step& step, std::size_t least) {
    std::uint32_t count = 0;
    if (!in_.align(4) || in_.remaining() < sizeof count) {
      (void)truncated(step.member);
      return std::nullopt;
    }
    const std::size_t place = in_.position();
    in_.copy(&count, sizeof count);
    if (is_swapped_) count = __builtin_bswap32(count);
    if (promised_ > in_.remaining() || count > (in_.remaining() - promised_) / least) {
      (void)fail(CdrReason::overlong, place, step.member);
      return std::nullopt;
    }
    return count;
  }
  template <class Step>
  bool check_bound(const Step& step, std::size_t count) {
    return count <= step.bound ||
           fail(CdrReason::above_bound, in_.position() - sizeof(std::uint32_t), step.member);
  }

  bool get(const CdrText& text, std::byte* at) {
    const auto count = get_count(text, text.is_wide ? 4 : 1);
    if (!count) return false;
    if (text.is_wide) return get_wide(text, *count, *reinterpret_cast<std::u16string*>(at));
    const std::size_t length = *count == 0 ? 0 : *count - 1;  // without the zero; count 0: empty
    if (!check_bound(text, length)) return false;
    auto& letters = *reinterpret_cast<std::string*>(at);
    letters.clear();
    if (*count == 0) return true;
    letters.reserve(length);
    in_.take(length, [&](const std::byte* bytes, std::size_t part) {
      letters.append(reinterpret_cast<const char*>(bytes), part);
    });
    char end = 0;
    in_.copy(&end, sizeof end);
    return end == '\0' || fail(CdrReason::unterminated, in_.position() - sizeof end, text.member);
  }
  bool get_wide(const CdrText& text, std::size_t count, std::u16string& letters) {
    if (!check_bound(text, count)) return false;
    letters.clear();
    letters.reserve(count);
    std::uint32_t units[64];
    while (count > 0) {
      const std::size_t part = std::min(count, std::size(units));
      const std::size_t place = in_.position();
      in_.copy(units, part * sizeof *units);
      if (is_swapped_) swap_bytes(reinterpret_cast<std::byte*>(units), sizeof *units, part);
      for (std::size_t i = 0; i < part; ++i) {
        if (units[i] > 0xffff) return fail(CdrReason::no_utf16, place + i * 4, text.member);
        letters.push_back(static_cast<char16_t>(units[i]));
      }
      count -= part;
    }
    return true;
  }
  bool get(const CdrBits& bits, std::byte* at) {
    const auto count = get_count(bits, 1);
    if (!count || !check_bound(bits, *count)) return false;
    bits.table->resize_function(at, *count);
    std::size_t index = 0;
    in_.take(*count, [&](const std::byte* bytes, std::size_t part) {
      for (const std::byte one : std::span(bytes, part)) {
        const bool value = one != std::byte{0};
        bits.table->assign_function(at, index++, &value);
      }
    });
    return true;
  }
  bool get(const CdrElements& elements, std::byte* at) {
    const CdrPlan& plan = *elements.element;
    std::size_t count = elements.fixed_count;
    if (elements.is_sequence()) {
      const auto said = get_count(elements, plan.wire_bytes_min);
      if (!said || !check_bound(elements, *said)) return false;
      count = *said;
      elements.table->resize_function(at, count);
      if (count == 0) return true;
      at = static_cast<std::byte*>(elements.table->get_function(at, 0));
    }
    if (const CdrRun* const run = plan.dense()) {
      if (get_runs(*run, at, count)) return true;
      const std::size_t there = in_.remaining();
      return truncated(
          element_name(elements.member, there / run->bytes, run->member_at(there % run->bytes)));
    }
    const std::size_t promised = promised_;
    for (std::size_t i = 0; i < count; ++i) {
      promised_ = promised + (count - 1 - i) * plan.wire_bytes_min;
      if (message(plan, at + i * plan.memory_bytes)) continue;
      failure_->member = element_name(elements.member, i, failure_->member);
      return false;
    }
    return true;
  }

  Input in_;
  std::size_t promised_ = 0;  // minimum bytes of the open sequences' remaining elements
  bool is_swapped_ = false;
  std::optional<CdrFailure> failure_;
};

}  // namespace

CdrResult<std::size_t> read_cdr(const CdrType& type, CdrInput from, void* message) {
  return Reader(from).read(type.plan(), nullptr, static_cast<std::byte*>(message));
}
CdrResult<std::size_t> read_service_cdr(const CdrType& type, CdrInput from, ServiceHeader& header,
                                        void* message) {
  return Reader(from).read(type.plan(), &header, static_cast<std::byte*>(message));
}

std::string CdrFailure::text() const {
  const auto what = [&] {
    switch (reason) {
      case CdrReason::truncated:
        return "truncated";
      case CdrReason::parameter_list:
        return "a parameter list instead of plain CDR";
      case CdrReason::xcdr2:
        return "XCDR2 instead of XCDR1";
      case CdrReason::overlong:
        return "a count that the rest of the input cannot hold";
      case CdrReason::above_bound:
        return "more than the type allows";
      case CdrReason::unterminated:
        return "a string without a zero at its end";
      case CdrReason::no_utf16:
        return "a wide character of more than 16 bits";
      case CdrReason::no_room:
        return "no room, or the message changed";
      case CdrReason::uncountable:
        return "more than a count can express";
      case CdrReason::elsewhere:
        return "it refers to memory outside its publisher's";
    }
    return "";
  };
  return std::string(what()) + " at byte " + std::to_string(byte) +
         (member.empty() ? "" : " in " + member);
}

}  // namespace agnocast::bridge
