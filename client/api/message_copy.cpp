// SPDX-License-Identifier: Apache-2.0

#include <client/api/message_copy.hpp>
#include <client/api/message_plan.hpp>

#include <algorithm>
#include <cstring>
#include <string>
#include <vector>

namespace agnocast::detail {
namespace {

// The alignment of each piece behind the object: no element of a ROS message needs more.
constexpr std::size_t piece_alignment = 16;

constexpr std::size_t aligned(std::size_t bytes) noexcept {
  return (bytes + piece_alignment - 1) / piece_alignment * piece_alignment;
}

constexpr std::size_t local_bytes = 16;

// A std::basic_string of libstdc++ (its ABI of 2011): a short text is in `local`.
struct TextWords {
  const std::byte* text;
  std::size_t size;  // characters
  union {
    std::byte local[local_bytes];
    std::size_t capacity;
  };
};

// A std::vector<bool> of libstdc++.
struct BitsWords {
  using Word = unsigned long;
  const Word* first;
  unsigned first_offset;
  const Word* last;
  unsigned last_offset;
  const Word* end_of_storage;

  std::size_t word_count() const noexcept {
    return static_cast<std::size_t>(last - first) + (last_offset != 0 ? 1 : 0);
  }
};

template <class Words>
Words words_at(const void* member) noexcept {
  Words words;
  std::memcpy(&words, member, sizeof words);
  return words;
}

const std::byte* local_text(const void* member) noexcept {
  return static_cast<const std::byte*>(member) + offsetof(TextWords, local);
}

// Compares the words with what texts of several sizes say of themselves.
template <class Text>
bool text_words_hold() {
  if constexpr (sizeof(Text) != sizeof(TextWords)) return false;
  using Letter = typename Text::value_type;
  constexpr std::size_t local_size = local_bytes / sizeof(Letter) - 1;
  for (const std::size_t size :
       {std::size_t{0}, std::size_t{1}, local_size, local_size + 1, std::size_t{1000}}) {
    const Text text(size, Letter{'x'});
    const auto words = words_at<TextWords>(&text);
    if (static_cast<const void*>(words.text) != text.data() || words.size != size) return false;
    if ((words.text == local_text(&text)) != (size <= local_size)) return false;
    if (size > local_size && words.capacity != text.capacity()) return false;
  }
  return true;
}

bool bits_words_hold() {
  using Bits = std::vector<bool>;
  if constexpr (sizeof(Bits) != sizeof(BitsWords)) return false;
  if (!bits_reader_holds<Bits>()) return false;
  for (const std::size_t size : {0U, 1U, 63U, 64U, 65U, 1000U}) {
    const Bits bits(size, true);
    const auto words = words_at<BitsWords>(&bits);
    if (size != 0 && words.first != BitsReader<Bits>::words(bits)) return false;
    if (words.first_offset != 0 || words.word_count() * sizeof(BitsWords::Word) !=
                                       (size == 0 ? 0 : BitsReader<Bits>::bytes(bits)))
      return false;
    const auto whole = static_cast<std::size_t>(words.last - words.first);
    if (whole * sizeof(BitsWords::Word) * 8 + words.last_offset != size) return false;
  }
  return true;
}

// Constant for the life of the process. May throw bad_alloc; the next call then tries again.
bool words_hold() {
  static const bool hold =
      text_words_hold<std::string>() && text_words_hold<std::u16string>() && bits_words_hold();
  return hold;
}

// One pass over a message. Without a block it only measures.
class Pass {
 public:
  Pass(const MessagePlan& plan, std::byte* block, std::size_t block_bytes) noexcept
      : plan_(plan), block_(block), block_bytes_(block_bytes) {}

  bool run(const std::byte* object, std::size_t header_bytes, std::size_t object_bytes) noexcept {
    std::byte* const copy = piece(object, object_bytes);
    return !is_too_long_ &&
           steps(plan_.root, object + header_bytes, copy == nullptr ? copy : copy + header_bytes);
  }
  std::size_t bytes() const noexcept { return used_; }

 private:
  // Copies a piece behind the others. Returns its copy; null while measuring.
  std::byte* piece(const std::byte* from, std::size_t bytes) noexcept {
    const std::size_t start = aligned(used_);
    used_ = start + bytes;
    if (block_ == nullptr) return nullptr;
    is_too_long_ = is_too_long_ || start > block_bytes_ || bytes > block_bytes_ - start;
    if (is_too_long_) return nullptr;
    std::memcpy(block_ + start, from, bytes);
    return block_ + start;
  }

  // `to`: the copy of `from`, byte for byte, in which this repairs what refers to other memory.
  bool steps(StepRange range, const std::byte* from, std::byte* to) noexcept {
    const PlanStep* step = plan_.steps.data() + range.first;
    for (const PlanStep* end = step + range.count; step != end && !is_too_long_; ++step) {
      const std::byte* const member = from + step->offset;
      std::byte* const copy = to == nullptr ? nullptr : to + step->offset;
      switch (step->step) {
        case Step::string:
          text(member, copy, sizeof(char));
          break;
        case Step::u16string:
          text(member, copy, sizeof(char16_t));
          break;
        case Step::bits:
          bits(member, copy);
          break;
        case Step::sequence:
          sequence(*step, member, copy);
          break;
        case Step::array:
          elements(*step, member, copy, step->count);
          break;
      }
    }
    return !is_too_long_;
  }

  void elements(const PlanStep& step, const std::byte* from, std::byte* to,
                std::size_t count) noexcept {
    for (std::size_t i = 0; i < count && !is_too_long_; ++i, from += step.stride) {
      steps(step.elements, from, to);
      if (to != nullptr) to += step.stride;
    }
  }

  void sequence(const PlanStep& step, const std::byte* member, std::byte* copy) noexcept {
    const auto words = words_at<VectorWords>(member);
    const auto bytes = static_cast<std::size_t>(words.end - words.begin);
    if (bytes == 0) return put(copy, VectorWords{nullptr, nullptr, nullptr});
    std::byte* const made = piece(words.begin, bytes);
    if (made != nullptr) put(copy, VectorWords{made, made + bytes, made + bytes});
    if (step.elements.count != 0) elements(step, words.begin, made, bytes / step.stride);
  }

  void bits(const std::byte* member, std::byte* copy) noexcept {
    auto words = words_at<BitsWords>(member);
    const std::size_t count = words.word_count();
    if (count == 0) return put(copy, BitsWords{});
    const std::byte* const made =
        piece(reinterpret_cast<const std::byte*>(words.first), count * sizeof(BitsWords::Word));
    if (made == nullptr) return;
    const auto* const first = reinterpret_cast<const BitsWords::Word*>(made);
    words.last = first + (words.last - words.first);
    words.first = first;
    words.end_of_storage = first + count;
    put(copy, words);
  }

  // A text whose terminator fits as well is copied into the object.
  void text(const std::byte* member, std::byte* copy, std::size_t letter_bytes) noexcept {
    auto words = words_at<TextWords>(member);
    const std::size_t bytes = (words.size + 1) * letter_bytes;
    if (bytes <= local_bytes) {
      if (copy == nullptr) return;
      std::byte local[local_bytes] = {};
      std::memcpy(local, words.text, bytes);
      std::memcpy(words.local, local, local_bytes);
      words.text = local_text(copy);
      return put(copy, words);
    }
    const std::byte* const made = piece(words.text, bytes);
    if (made == nullptr) return;
    words.text = made;
    words.capacity = words.size;
    put(copy, words);
  }

  template <class Words>
  static void put(std::byte* copy, const Words& words) noexcept {
    if (copy != nullptr) std::memcpy(copy, &words, sizeof words);
  }

  const MessagePlan& plan_;
  std::byte* const block_;
  const std::size_t block_bytes_;
  std::size_t used_ = 0;
  bool is_too_long_ = false;
};

}  // namespace

bool is_copied_into_block(const MessageType& type) {
  return type.kind() == MessageType::Kind::flat ||
         (type.kind() == MessageType::Kind::described && words_hold());
}

MessageCopy::MessageCopy(const MessageType& type, const void* message) noexcept
    : type_(type), object_(static_cast<const std::byte*>(message) - type.header_bytes()) {
  Pass measuring(type_.plan(), nullptr, 0);
  (void)measuring.run(object_, type_.header_bytes(), type_.message_bytes());
  block_bytes_ = measuring.bytes();
}

std::size_t MessageCopy::alignment() const noexcept {
  return std::max<std::size_t>(type_.message_alignment(), piece_alignment);
}

bool MessageCopy::write(void* block) const noexcept {
  Pass writing(type_.plan(), static_cast<std::byte*>(block), block_bytes_);
  return writing.run(object_, type_.header_bytes(), type_.message_bytes());
}

}  // namespace agnocast::detail
