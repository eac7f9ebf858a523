// SPDX-License-Identifier: Apache-2.0
//
// The residency check: walks the plan of a message type over one message, at every publish.
//
// Allocates nothing and throws nothing; recursion is as deep as sequences nest in the type, which
// the plan bounds. It reads this process's own live message, so it trusts values; do not use this
// walk on messages of other processes. A fully resident message costs one range comparison per
// string and sequence. Only the first foreign range needs a path, built from the frames of the
// recursion.

#include <agnocast/residency.hpp>

#include "client/api/message_plan.hpp"

#include <charconv>
#include <cstring>

namespace agnocast {

namespace detail {

class Walk {
 public:
  Walk(const MessageType& type, const WindowSet& windows, Residency& found) noexcept
      : type_(type), plan_(type.plan()), windows_(windows), found_(found) {}

  void run(const void* message) noexcept {
    const bool is_opaque = plan_.kind == MessageType::Kind::opaque;
    const std::size_t bytes = type_.message_bytes();
    const std::byte* const object = static_cast<const std::byte*>(message) - type_.header_bytes();
    found_.message_bytes += bytes;
    if (!windows_.contains(object, bytes)) {
      report(object, bytes, "(message)", nullptr);
    } else if (is_opaque) {
      found_.foreign_bytes += bytes;
    }
    if (is_opaque) unseen(0, "(message)", nullptr);
    if (plan_.kind == MessageType::Kind::visited) {
      PointerVisitor visitor(*this);
      plan_.visit(message, visitor);
    } else {
      steps(plan_.root, static_cast<const std::byte*>(message), nullptr);
    }
  }

  void visited_range(const char* label, const void* first, std::size_t bytes) noexcept {
    if (bytes != 0) range(first, bytes, label, nullptr);
  }
  void visited_bits(const char* label, const std::vector<bool>& bits) noexcept {
    this->bits(bits, label, nullptr);
  }

 private:
  template <class T>
  static const T& object_at(const void* member) noexcept {
    return *static_cast<const T*>(member);
  }

  // The present element of each enclosing sequence.
  struct Frame {
    const Frame* outer;
    const char* path;
    std::size_t index;
  };

  void steps(StepRange range_of_steps, const std::byte* base, const Frame* frame) noexcept {
    const PlanStep* step = plan_.steps.data() + range_of_steps.first;
    for (const PlanStep* end = step + range_of_steps.count; step != end; ++step) {
      const std::byte* const member = base + step->offset;
      // Nearly all are one of these two: branches are predicted, the table of a switch is loaded.
      if (step->step == Step::sequence) {
        sequence(*step, member, frame);
      } else if (step->step == Step::string) {
        text(object_at<std::string>(member), *step, frame);
      } else {
        rarer(*step, member, frame);
      }
    }
  }

  [[gnu::noinline]] void rarer(const PlanStep& step, const std::byte* member,
                               const Frame* frame) noexcept {
    switch (step.step) {
      case Step::string:
      case Step::sequence:
        break;  // not here
      case Step::u16string:
        return text(object_at<std::u16string>(member), step, frame);
      case Step::bits:
        return bits(object_at<std::vector<bool>>(member), step.path, frame);
      case Step::array:
        return elements(step, member, step.count, frame);
    }
  }

  void sequence(const PlanStep& step, const std::byte* member, const Frame* frame) noexcept {
    VectorWords words;
    std::memcpy(&words, member, sizeof(words));
    // Without elements there is nothing to touch: spare capacity is never read.
    if (words.begin == words.end) return;
    const auto bytes = static_cast<std::size_t>(words.end - words.begin);
    range(words.begin, bytes, step.path, frame);
    if (step.elements.count != 0) elements(step, words.begin, bytes / step.stride, frame);
  }

  void elements(const PlanStep& step, const std::byte* first, std::size_t count,
                const Frame* frame) noexcept {
    Frame inner{frame, step.path, 0};
    for (; inner.index < count; ++inner.index)
      steps(step.elements, first + inner.index * step.stride, &inner);
  }

  // A short text is in the string object, which belongs to a range that was checked before.
  // Even an empty text counts if it is outside, because c_str() reads its terminator.
  template <class C>
  void text(const std::basic_string<C>& text, const PlanStep& step, const Frame* frame) noexcept {
    const auto self = reinterpret_cast<std::uintptr_t>(&text);
    const auto first = reinterpret_cast<std::uintptr_t>(text.data());
    if (first - self < sizeof(text)) return;
    range(text.data(), (text.size() + 1) * sizeof(C), step.path, frame);
  }

  void bits(const std::vector<bool>& bits, const char* path, const Frame* frame) noexcept {
    if (bits.empty()) return;
    const std::size_t bytes = BitsReader<std::vector<bool>>::bytes(bits);
    if (plan_.bits_are_seen) {
      range(BitsReader<std::vector<bool>>::words(bits), bytes, path, frame);
    } else {
      unseen(bytes, path, frame);
    }
  }

  void range(const void* first, std::size_t bytes, const char* path, const Frame* frame) noexcept {
    found_.message_bytes += bytes;
    if (!windows_.contains(first, bytes)) report(first, bytes, path, frame);
  }

  void report(const void* first, std::size_t bytes, const char* path, const Frame* frame) noexcept {
    if (found_.is_resident()) {
      found_.first_address = first;
      write_path(path, frame);
    }
    ++found_.foreign_count;
    found_.foreign_bytes += bytes;
  }

  void unseen(std::size_t bytes, const char* path, const Frame* frame) noexcept {
    found_.message_bytes += bytes;
    if (found_.is_resident()) write_path(path, frame);
    ++found_.unseen_count;
    found_.foreign_bytes += bytes;
  }

  void write_path(const char* path, const Frame* frame) noexcept {
    path_length_ = 0;
    write_frames(frame);
    if (path[0] != '\0' && path_length_ != 0) write(".");
    write(path);
  }

  void write_frames(const Frame* frame) noexcept {
    if (frame == nullptr) return;
    write_frames(frame->outer);
    if (path_length_ != 0) write(".");
    write(frame->path);
    char digits[24];
    const std::to_chars_result end =
        std::to_chars(digits, digits + sizeof(digits) - 1, frame->index);
    *end.ptr = '\0';
    write("[");
    write(digits);
    write("]");
  }

  // Keeps the terminator in place; cuts text that does not fit.
  void write(const char* text) noexcept {
    while (*text != '\0' && path_length_ + 1 < found_.first_path.size())
      found_.first_path[path_length_++] = *text++;
    found_.first_path[path_length_] = '\0';
  }

  const MessageType& type_;
  const MessagePlan& plan_;
  const WindowSet& windows_;
  Residency& found_;
  std::size_t path_length_ = 0;
};

}  // namespace detail

Residency check_residency(const MessageType& type, const void* message,
                          const WindowSet& windows) noexcept {
  Residency found;
  detail::Walk(type, windows, found).run(message);
  return found;
}

void PointerVisitor::operator()(const char* label, const void* first, std::size_t bytes) noexcept {
  walk_.visited_range(label, first, bytes);
}

void PointerVisitor::operator()(const char* label, const std::vector<bool>& bits) noexcept {
  walk_.visited_bits(label, bits);
}

}  // namespace agnocast
