// SPDX-License-Identifier: Apache-2.0

#include <ros2/rmw_agnocast_cpp/core/c_layout.hpp>

#include <agnocast/checked_copy.hpp>

#include <rosidl_runtime_c/string_functions.h>
#include <rosidl_runtime_c/u16string_functions.h>
#include <rosidl_typesupport_introspection_c/field_types.h>

#include <cstring>
#include <limits>
#include <new>
#include <optional>
#include <string>
#include <utility>
#include <variant>
#include <vector>

namespace agnocast::rmw {
namespace {

namespace ros = rosidl_typesupport_introspection_cpp;

using CMember = rosidl_typesupport_introspection_c__MessageMember;
using CText = rosidl_runtime_c__String;
using CWideText = rosidl_runtime_c__U16String;

constexpr std::size_t unbounded = std::numeric_limits<std::size_t>::max();

}  // namespace

struct CLayout::Plan {
  // Where a member is, in bytes from the begin of its message or element.
  struct Offsets {
    std::size_t c = 0, cpp = 0;
  };
  struct Run {
    Offsets at;
    std::size_t bytes = 0;
  };
  // Another process may have written any byte; a bool other than 0 and 1 is undefined to read.
  struct Bools {
    Offsets at;
    std::size_t count = 0;
  };
  struct Text {
    Offsets at;
    std::size_t bound = 0;  // characters
    std::string member;
  };
  struct WideText {
    Offsets at;
    std::size_t bound = 0;
    std::string member;
  };
  // bool* in C, std::vector<bool> in C++.
  struct Bits {
    Offsets at;
    std::size_t bound = 0;
    const CMember* c = nullptr;
    std::string member;
  };
  struct Elements {
    Offsets at;
    std::size_t fixed_count = 0;  // 0: a sequence
    std::size_t bound = 0;
    const CMember* c = nullptr;
    const MessageMember* cpp = nullptr;
    std::shared_ptr<const Plan> element;
    std::string member;
  };
  using Step = std::variant<Run, Bools, Text, WideText, Bits, Elements>;

  std::vector<Step> steps;
  Offsets bytes;  // sizeof the message or element

  /// Returns whether the whole element is the same bytes in both layouts.
  bool is_dense() const noexcept {
    const Run* const run = steps.size() == 1 ? std::get_if<Run>(&steps.front()) : nullptr;
    return run != nullptr && run->bytes == bytes.c && run->bytes == bytes.cpp;
  }
};

namespace {

using Plan = CLayout::Plan;
using Offsets = Plan::Offsets;
using Run = Plan::Run;
using Bools = Plan::Bools;
using Text = Plan::Text;
using WideText = Plan::WideText;
using Bits = Plan::Bits;
using Elements = Plan::Elements;
using Step = Plan::Step;

const CMembers& nested(const CMember& member) noexcept {
  return *static_cast<const CMembers*>(member.members_->data);
}
template <class Member>
bool is_fixed_array(const Member& member) noexcept {
  return member.is_array_ && member.array_size_ != 0 && !member.is_upper_bound_;
}
template <class Member>
std::size_t array_bound(const Member& member) noexcept {
  return member.is_upper_bound_ ? member.array_size_ : unbounded;
}
std::size_t text_bound(const CMember& member) noexcept {
  return member.string_upper_bound_ != 0 ? member.string_upper_bound_ : unbounded;
}
// "poses.position" for "position" in "poses"; of elements likewise.
std::string inside(const std::string& outer, const std::string& inner) {
  return outer.empty() || inner.empty() ? outer + inner : outer + "." + inner;
}

class Planner {
 public:
  /// Returns false if the type is refused; why() gives the reason.
  bool add(const CMembers& c, const MessageMembers& cpp, Offsets at, const std::string& prefix,
           int depth) {
    if (c.member_count_ != cpp.member_count_)
      return refuse(prefix, "it has another number of members in C than in C++");
    if (depth > layout_depth_max) return refuse(prefix, "nested too deep");
    for (std::uint32_t i = 0; i < c.member_count_; ++i) {
      const CMember& in_c = c.members_[i];
      const MessageMember& in_cpp = cpp.members_[i];
      const std::string name = inside(prefix, in_c.name_);
      if (!are_alike(in_c, in_cpp)) return refuse(name, "it is another member in C than in C++");
      if (agnocast::detail::BufferMark<MessageMember>::of(in_cpp))
        return refuse(name, "rosidl::Buffer");
      if (!add(in_c, in_cpp, {at.c + in_c.offset_, at.cpp + in_cpp.offset_}, name, depth))
        return false;
    }
    return true;
  }
  Plan take(Offsets bytes) {
    plan_.bytes = bytes;
    return std::move(plan_);
  }
  const std::string& why() const { return why_; }

 private:
  bool refuse(const std::string& member, const std::string& what) {
    why_ = member.empty() ? what : member + ": " + what;
    return false;
  }
  // The numbers of types are the same in both.
  static bool are_alike(const CMember& c, const MessageMember& cpp) noexcept {
    return std::strcmp(c.name_, cpp.name_) == 0 && c.type_id_ == cpp.type_id_ &&
           c.is_array_ == cpp.is_array_ && c.array_size_ == cpp.array_size_ &&
           c.is_upper_bound_ == cpp.is_upper_bound_ &&
           c.string_upper_bound_ == cpp.string_upper_bound_;
  }

  bool add(const CMember& c, const MessageMember& cpp, Offsets at, const std::string& name,
           int depth) {
    if (!c.is_array_) return add_one(c, cpp, at, name, depth + 1);
    const std::size_t fixed_count = is_fixed_array(c) ? c.array_size_ : 0;
    const bool is_bool = c.type_id_ == ros::ROS_TYPE_BOOLEAN;
    if (fixed_count != 0 && is_bool) return add_step(Bools{at, fixed_count});
    if (is_bool) return add_step(Bits{at, array_bound(c), &c, name});
    const Offsets bytes =
        c.type_id_ == ros::ROS_TYPE_MESSAGE
            ? Offsets{nested(c).size_of_, agnocast::detail::nested_members(cpp).size_of_}
            : Offsets{bytes_in_c(c), agnocast::detail::ros_element_layout(cpp.type_id_).bytes};
    if (fixed_count != 0 && is_number(c)) return add_run(at, fixed_count * bytes.cpp);
    Planner element;
    if (!element.add_one(c, cpp, {}, "", depth + 1)) return refuse(name, element.why_);
    auto plan = std::make_shared<const Plan>(element.take(bytes));
    return add_step(Elements{at, fixed_count, array_bound(c), &c, &cpp, std::move(plan), name});
  }
  bool add_one(const CMember& c, const MessageMember& cpp, Offsets at, const std::string& name,
               int depth) {
    switch (c.type_id_) {
      case ros::ROS_TYPE_MESSAGE:
        return add(nested(c), agnocast::detail::nested_members(cpp), at, name, depth);
      case ros::ROS_TYPE_STRING:
        return add_step(Text{at, text_bound(c), name});
      case ros::ROS_TYPE_WSTRING:
        return add_step(WideText{at, text_bound(c), name});
      case ros::ROS_TYPE_BOOLEAN:
        return add_step(Bools{at, 1});
      default: {
        const std::size_t bytes = agnocast::detail::ros_element_layout(c.type_id_).bytes;
        return bytes != 0 ? add_run(at, bytes) : refuse(name, "a type of an unknown number");
      }
    }
  }
  static bool is_number(const CMember& c) noexcept {
    return agnocast::detail::ros_element_kind(c.type_id_) ==
           agnocast::detail::ElementKind::primitive;
  }
  static std::size_t bytes_in_c(const CMember& c) noexcept {
    switch (c.type_id_) {
      case ros::ROS_TYPE_STRING:
        return sizeof(CText);
      case ros::ROS_TYPE_WSTRING:
        return sizeof(CWideText);
      default:
        return agnocast::detail::ros_element_layout(c.type_id_).bytes;
    }
  }
  bool add_run(Offsets at, std::size_t bytes) {
    Run* const last = plan_.steps.empty() ? nullptr : std::get_if<Run>(&plan_.steps.back());
    if (last != nullptr && at.c == last->at.c + last->bytes && at.cpp == last->at.cpp + last->bytes)
      last->bytes += bytes;
    else
      plan_.steps.emplace_back(Run{at, bytes});
    return true;
  }
  bool add_step(Step step) {
    plan_.steps.push_back(std::move(step));
    return true;
  }

  Plan plan_;
  std::string why_;
};

void copy_bools(const std::byte* from, std::byte* to, std::size_t count) noexcept {
  for (std::size_t i = 0; i < count; ++i) to[i] = std::byte(from[i] != std::byte{0});
}

// Functions return false after they have noted the member that is too long.
class ToCpp {
 public:
  bool message(const Plan& plan, const std::byte* from, std::byte* to) {
    for (const Step& step : plan.steps) {
      const auto copied = [&](const auto& of_kind) {
        return copy(of_kind, from + of_kind.at.c, to + of_kind.at.cpp);
      };
      if (!std::visit(copied, step)) return false;
    }
    return true;
  }
  const std::string& too_long() const noexcept { return too_long_; }

 private:
  template <class Part>
  bool fits(const Part& part, std::size_t count) {
    if (count > part.bound) too_long_ = part.member;
    return count <= part.bound;
  }
  static bool copy(const Run& run, const std::byte* from, std::byte* to) noexcept {
    std::memcpy(to, from, run.bytes);
    return true;
  }
  static bool copy(const Bools& bools, const std::byte* from, std::byte* to) noexcept {
    copy_bools(from, to, bools.count);
    return true;
  }
  bool copy(const Text& text, const std::byte* from, std::byte* to) {
    const auto& source = *reinterpret_cast<const CText*>(from);
    if (!fits(text, source.size)) return false;
    auto& target = *reinterpret_cast<std::string*>(to);
    source.size == 0 ? target.clear() : (void)target.assign(source.data, source.size);
    return true;
  }
  bool copy(const WideText& text, const std::byte* from, std::byte* to) {
    const auto& source = *reinterpret_cast<const CWideText*>(from);
    if (!fits(text, source.size)) return false;
    auto& target = *reinterpret_cast<std::u16string*>(to);
    target.resize(source.size);
    if (source.size != 0) std::memcpy(target.data(), source.data, source.size * sizeof(char16_t));
    return true;
  }
  bool copy(const Bits& bits, const std::byte* from, std::byte* to) {
    const std::size_t count = bits.c->size_function(from);
    if (!fits(bits, count)) return false;
    auto& target = *reinterpret_cast<std::vector<bool>*>(to);
    target.resize(count);
    if (count == 0) return true;
    const auto* const values = static_cast<const std::byte*>(bits.c->get_const_function(from, 0));
    for (std::size_t i = 0; i < count; ++i) target[i] = values[i] != std::byte{0};
    return true;
  }
  bool copy(const Elements& elements, const std::byte* from, std::byte* to) {
    std::size_t count = elements.fixed_count;
    if (count == 0) {
      count = elements.c->size_function(from);
      if (!fits(elements, count)) return false;
      elements.cpp->resize_function(to, count);
      if (count == 0) return true;
      from = static_cast<const std::byte*>(elements.c->get_const_function(from, 0));
      to = static_cast<std::byte*>(elements.cpp->get_function(to, 0));
    }
    const Plan& plan = *elements.element;
    if (plan.is_dense()) {
      std::memcpy(to, from, count * plan.bytes.c);
      return true;
    }
    for (; count != 0; --count, from += plan.bytes.c, to += plan.bytes.cpp) {
      if (message(plan, from, to)) continue;
      too_long_ = inside(elements.member, too_long_);
      return false;
    }
    return true;
  }

  std::string too_long_;
};

// The message may lie in memory of another process, which may change it meanwhile: each string and
// sequence object is copied once (Snapshot), and followed only into its publisher's memory.
class ToC {
 public:
  explicit ToC(const WindowSet* within) {
    if (within != nullptr) bounds_.emplace(*within);
  }
  bool take(const void* first, std::size_t count, std::size_t bytes) noexcept {
    return !bounds_ || bounds_->take(first, count, bytes);
  }
  bool message(const Plan& plan, const std::byte* from, std::byte* to) {
    for (const Step& step : plan.steps) {
      const auto copied = [&](const auto& of_kind) {
        return copy(of_kind, from + of_kind.at.cpp, to + of_kind.at.c);
      };
      if (!std::visit(copied, step)) return false;
    }
    return true;
  }
  const std::string& wrong() const noexcept { return wrong_; }

 private:
  template <class Part>
  bool check(const Part& part, bool is_right) {
    if (!is_right) wrong_ = part.member;
    return is_right;
  }
  static void allocated(bool is_allocated) {
    if (!is_allocated) throw std::bad_alloc();
  }

  static bool copy(const Run& run, const std::byte* from, std::byte* to) noexcept {
    std::memcpy(to, from, run.bytes);
    return true;
  }
  static bool copy(const Bools& bools, const std::byte* from, std::byte* to) noexcept {
    copy_bools(from, to, bools.count);
    return true;
  }
  template <class Letters, class Part>
  bool is_valid(const Part& part, const Snapshot<Letters>& source, const std::byte* from) {
    return check(part, source->size() <= part.bound &&
                           (!bounds_ || agnocast::detail::take_text(*bounds_, *source, from)));
  }
  bool copy(const Text& text, const std::byte* from, std::byte* to) {
    const Snapshot<std::string> source(from);
    if (!is_valid(text, source, from)) return false;
    // Null is no text for rosidl, not even for nothing.
    allocated(rosidl_runtime_c__String__assignn(
        reinterpret_cast<CText*>(to), source->empty() ? "" : source->data(), source->size()));
    return true;
  }
  bool copy(const WideText& text, const std::byte* from, std::byte* to) {
    const Snapshot<std::u16string> source(from);
    if (!is_valid(text, source, from)) return false;
    const char16_t* const letters = source->empty() ? u"" : source->data();
    allocated(rosidl_runtime_c__U16String__assignn(reinterpret_cast<CWideText*>(to),
                                                   reinterpret_cast<const std::uint16_t*>(letters),
                                                   source->size()));
    return true;
  }
  bool copy(const Bits& bits, const std::byte* from, std::byte* to) {
    const Snapshot<std::vector<bool>> source(from);
    const bool is_right = (!bounds_ || agnocast::detail::take_bits(*bounds_, *source)) &&
                          source->size() <= bits.bound;
    if (!check(bits, is_right)) return false;
    const std::size_t count = source->size();
    allocated(bits.c->resize_function(to, count));
    if (count == 0) return true;
    auto* const values = static_cast<bool*>(bits.c->get_function(to, 0));
    for (std::size_t i = 0; i < count; ++i) values[i] = (*source)[i];
    return true;
  }
  bool copy(const Elements& elements, const std::byte* from, std::byte* to) {
    const Plan& plan = *elements.element;
    std::size_t count = elements.fixed_count;
    if (count == 0) {
      const Snapshot<agnocast::detail::VectorEnds> ends(from);
      const auto bytes = reinterpret_cast<std::uintptr_t>(ends->end) -
                         reinterpret_cast<std::uintptr_t>(ends->begin);
      count = bytes / plan.bytes.cpp;
      if (!check(elements, ends->begin <= ends->end && bytes % plan.bytes.cpp == 0 &&
                               count <= elements.bound && take(ends->begin, count, plan.bytes.cpp)))
        return false;
      allocated(elements.c->resize_function(to, count));
      if (count == 0) return true;
      from = ends->begin;
      to = static_cast<std::byte*>(elements.c->get_function(to, 0));
    }
    if (plan.is_dense()) {
      std::memcpy(to, from, count * plan.bytes.c);
      return true;
    }
    for (; count != 0; --count, from += plan.bytes.cpp, to += plan.bytes.c) {
      if (message(plan, from, to)) continue;
      wrong_ = inside(elements.member, wrong_);
      return false;
    }
    return true;
  }

  std::optional<MessageBounds> bounds_;
  std::string wrong_;
};

}  // namespace

Result<CLayout> CLayout::of(const CMembers& c, const MessageMembers& cpp) {
  Planner planner;
  if (!planner.add(c, cpp, {}, "", 0)) {
    return fail_with(Errc::type_refused,
                     std::string(cpp.message_name_) + " in C: " + planner.why());
  }
  return CLayout(std::make_shared<const Plan>(planner.take({c.size_of_, cpp.size_of_})));
}

Result<void> CLayout::to_cpp(const void* c, void* cpp) const {
  ToCpp copy;
  if (copy.message(*plan_, static_cast<const std::byte*>(c), static_cast<std::byte*>(cpp)))
    return {};
  return fail_with(Errc::type_refused, copy.too_long() + " is longer than its type allows");
}

Result<void> CLayout::to_c(const void* cpp, void* c, const WindowSet* within) const {
  ToC copy(within);
  if (copy.take(cpp, 1, plan_->bytes.cpp) &&
      copy.message(*plan_, static_cast<const std::byte*>(cpp), static_cast<std::byte*>(c)))
    return {};
  return fail_with(Errc::protocol_violation,
                   (copy.wrong().empty() ? "the message" : copy.wrong()) +
                       std::string(" leads out of its publisher's memory, or is too long"));
}

}  // namespace agnocast::rmw
