// SPDX-License-Identifier: Apache-2.0

#include <bridge/cdr/cdr_plan.hpp>

#include <algorithm>
#include <limits>
#include <utility>

namespace agnocast::bridge {
namespace {

namespace ros = rosidl_typesupport_introspection_cpp;

constexpr std::size_t unbounded = std::numeric_limits<std::size_t>::max();

bool is_fixed_array(const MessageMember& member) {
  return member.is_array_ && member.array_size_ != 0 && !member.is_upper_bound_;
}

class Planner {
 public:
  /// Returns false if the type is refused; why() gives the reason.
  bool add(const MessageMembers& members, std::size_t offset, const std::string& prefix,
           int depth) {
    if (members.member_count_ == 0) return refuse(prefix, "a message without members");
    if (depth > cdr_depth_max) return refuse(prefix, "nested too deep");
    for (std::uint32_t i = 0; i < members.member_count_; ++i) {
      const MessageMember& member = members.members_[i];
      const std::string name = prefix.empty() ? member.name_ : prefix + "." + member.name_;
      if (!add(member, offset + member.offset_, name, depth)) return false;
    }
    return true;
  }
  CdrPlan take(std::size_t memory_bytes) {
    plan_.memory_bytes = memory_bytes;
    return std::move(plan_);
  }
  const std::string& why() const { return why_; }

 private:
  bool refuse(const std::string& member, const char* what) {
    why_ = member.empty() ? what : member + ": " + what;
    return false;
  }

  bool add(const MessageMember& member, std::size_t offset, const std::string& name, int depth) {
    if (detail::BufferMark<MessageMember>::of(member)) return refuse(name, "rosidl::Buffer");
    if (!member.is_array_) return add_one(member, offset, name, depth + 1);
    const bool is_number =
        detail::ros_element_kind(member.type_id_) == detail::ElementKind::primitive ||
        member.type_id_ == ros::ROS_TYPE_BOOLEAN;
    if (is_fixed_array(member) && is_number)
      return add_numbers(member, offset, name, member.array_size_);

    const std::size_t bound = member.is_upper_bound_ ? member.array_size_ : unbounded;
    if (!is_fixed_array(member) && member.type_id_ == ros::ROS_TYPE_BOOLEAN) {
      plan_.steps.emplace_back(CdrBits{offset, bound, &member, name});
      plan_.wire_bytes_min += sizeof(std::uint32_t);
      return true;
    }
    Planner element;
    if (!element.add_one(member, 0, "", depth + 1)) return refuse(name, element.why_.c_str());
    const std::size_t memory_bytes = member.type_id_ == ros::ROS_TYPE_MESSAGE
                                         ? detail::nested_members(member).size_of_
                                         : detail::ros_element_layout(member.type_id_).bytes;
    const auto plan = std::make_shared<const CdrPlan>(element.take(memory_bytes));
    const std::size_t fixed_count = is_fixed_array(member) ? member.array_size_ : 0;
    plan_.wire_bytes_min +=
        fixed_count == 0 ? sizeof(std::uint32_t) : fixed_count * plan->wire_bytes_min;
    plan_.steps.emplace_back(CdrElements{offset, fixed_count, bound, &member, plan, name});
    return true;
  }

  bool add_one(const MessageMember& member, std::size_t offset, const std::string& name,
               int depth) {
    switch (member.type_id_) {
      case ros::ROS_TYPE_MESSAGE:
        return add(detail::nested_members(member), offset, name, depth);
      case ros::ROS_TYPE_STRING:
      case ros::ROS_TYPE_WSTRING:
        plan_.steps.emplace_back(CdrText{
            offset, member.string_upper_bound_ != 0 ? member.string_upper_bound_ : unbounded,
            member.type_id_ == ros::ROS_TYPE_WSTRING, name});
        plan_.wire_bytes_min += sizeof(std::uint32_t);
        return true;
      default:
        return add_numbers(member, offset, name, 1);
    }
  }

  bool add_numbers(const MessageMember& member, std::size_t offset, const std::string& name,
                   std::size_t count) {
    const std::size_t width = detail::ros_element_layout(member.type_id_).bytes;
    // Neither occurs in .msg files, and vendors disagree on their bytes.
    if (member.type_id_ == ros::ROS_TYPE_WCHAR || width > 8 || width == 0)
      return refuse(name, "wchar, long double or an unknown type");
    CdrRun* run = plan_.steps.empty() ? nullptr : std::get_if<CdrRun>(&plan_.steps.back());
    // Both are aligned in memory, so neighbours in memory are neighbours on the wire.
    if (run == nullptr || offset != run->offset + run->bytes || width > run->alignment) {
      run = &std::get<CdrRun>(plan_.steps.emplace_back(CdrRun{offset, 0, width, false, {}}));
    }
    const bool is_bool = member.type_id_ == ros::ROS_TYPE_BOOLEAN;
    run->pieces.push_back(
        {name, run->bytes, width, count, member.is_array_ && !name.empty(), is_bool});
    run->bytes += width * count;
    run->has_bool |= is_bool;
    plan_.wire_bytes_min += width * count;
    return true;
  }

  CdrPlan plan_;
  std::string why_;
};

}  // namespace

Result<CdrType> CdrType::of(const MessageMembers& members) {
  Planner planner;
  if (!planner.add(members, 0, "", 0)) {
    return fail_with(Errc::type_refused,
                     std::string("CDR of ") + members.message_name_ + ": " + planner.why());
  }
  return CdrType(members, std::make_shared<const CdrPlan>(planner.take(members.size_of_)));
}

const CdrRun* CdrPlan::dense() const noexcept {
  const CdrRun* const run = steps.size() == 1 ? std::get_if<CdrRun>(&steps.front()) : nullptr;
  return run != nullptr && run->bytes == memory_bytes ? run : nullptr;
}

std::string CdrRun::member_at(std::size_t at) const {
  const auto piece = std::find_if(pieces.begin(), pieces.end() - 1,
                                  [&](const CdrPiece& one) { return at < one.end(); });
  if (!piece->is_array) return piece->member;
  return element_name(piece->member, (at - piece->offset) / piece->width, "");
}

std::string element_name(const std::string& sequence, std::size_t index,
                         const std::string& member) {
  return sequence + "[" + std::to_string(index) + "]" + (member.empty() ? "" : "." + member);
}

}  // namespace agnocast::bridge
