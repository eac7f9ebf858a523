// SPDX-License-Identifier: Apache-2.0
//
// The functions in a table get only the address of a message. So each message type has a slot, and
// each slot its own instances of the functions, which find their sizes by the number of the slot:
// those that make and destroy a message, and those of sequences of it. All other sequences are
// std::vectors, whose functions need no slot.

#include <tests/support/schema_tables.hpp>

#include <algorithm>
#include <array>
#include <cstring>
#include <memory>
#include <new>
#include <stdexcept>
#include <utility>

namespace agnocast::test {
namespace {

namespace ros = rosidl_typesupport_introspection_cpp;
using Initialization = rosidl_runtime_cpp::MessageInitialization;

constexpr std::size_t slot_count = 384;

struct Slot {
  MessageMembers members{};
  std::vector<MessageMember> member_list;
  std::vector<std::string> member_names;
  std::string space;
  std::string name;
  std::size_t alignment = 1;
  rosidl_message_type_support_t support{};
};
std::array<std::unique_ptr<Slot>, slot_count> slots;

/// The memory of a sequence of messages: three pointers like those of a std::vector, which
/// publishing checks, initially null.
struct RawSequence {
  std::byte* begin;
  std::byte* end;
  std::byte* end_of_memory;

  std::size_t count(std::size_t bytes) const {
    return static_cast<std::size_t>(end - begin) / bytes;
  }
};
static_assert(sizeof(RawSequence) == sizeof(std::vector<int>));

std::byte* begin_of(const void* sequence) {
  return static_cast<const RawSequence*>(sequence)->begin;
}

void make(const MessageMembers& members, std::byte* memory) {
  members.init_function(memory, Initialization::ALL);
}

void resize(const MessageMembers& members, RawSequence& sequence, std::size_t count) {
  const std::size_t bytes = members.size_of_, old_count = sequence.count(bytes);
  for (std::size_t i = count; i < old_count; ++i) members.fini_function(sequence.begin + i * bytes);
  if (count > old_count) {
    auto* const begin = static_cast<std::byte*>(::operator new(count* bytes));
    for (std::size_t i = 0; i < count; ++i) make(members, begin + i * bytes);
    for (std::size_t i = 0; i < old_count; ++i) {
      agnocast::detail::copy_by_table(members, sequence.begin + i * bytes, begin + i * bytes);
      members.fini_function(sequence.begin + i * bytes);
    }
    ::operator delete(std::exchange(sequence.begin, begin));
    sequence.end_of_memory = begin + count * bytes;
  }
  sequence.end = sequence.begin + count * bytes;
}

bool is_fixed(const MessageMember& member) {
  return member.is_array_ && member.array_size_ != 0 && !member.is_upper_bound_;
}

template <class Use>
void with_type(std::uint8_t type_id, Use&& use);

/// Numbers are already zero.
void begin_member(const MessageMember& member, std::byte* at) {
  if (member.is_array_ && !is_fixed(member)) {
    // Made like a vector of any type.
    if (member.type_id_ != ros::ROS_TYPE_MESSAGE)
      with_type(member.type_id_, [&]<class T>(T*) { new (at) std::vector<T>(); });
    return;
  }
  const std::size_t count = is_fixed(member) ? member.array_size_ : 1;
  for (std::size_t i = 0; i < count; ++i) {
    if (member.type_id_ == ros::ROS_TYPE_MESSAGE) {
      const MessageMembers& nested = agnocast::detail::nested_members(member);
      make(nested, at + i * nested.size_of_);
    } else if (member.type_id_ == ros::ROS_TYPE_STRING) {
      new (at + i * sizeof(std::string)) std::string();
    } else if (member.type_id_ == ros::ROS_TYPE_WSTRING) {
      new (at + i * sizeof(std::u16string)) std::u16string();
    }
  }
}

void end_member(const MessageMember& member, std::byte* at) {
  if (member.is_array_ && !is_fixed(member)) {
    if (member.type_id_ == ros::ROS_TYPE_MESSAGE) {
      auto& sequence = *reinterpret_cast<RawSequence*>(at);
      resize(agnocast::detail::nested_members(member), sequence, 0);
      ::operator delete(sequence.begin);
    } else {
      with_type(member.type_id_,
                [&]<class T>(T*) { std::destroy_at(reinterpret_cast<std::vector<T>*>(at)); });
    }
    return;
  }
  const std::size_t count = is_fixed(member) ? member.array_size_ : 1;
  for (std::size_t i = 0; i < count; ++i) {
    if (member.type_id_ == ros::ROS_TYPE_MESSAGE) {
      const MessageMembers& nested = agnocast::detail::nested_members(member);
      nested.fini_function(at + i * nested.size_of_);
    } else if (member.type_id_ == ros::ROS_TYPE_STRING) {
      std::destroy_at(reinterpret_cast<std::string*>(at) + i);
    } else if (member.type_id_ == ros::ROS_TYPE_WSTRING) {
      std::destroy_at(reinterpret_cast<std::u16string*>(at) + i);
    }
  }
}

struct SlotFunctions {
  void (*init)(void*, Initialization);
  void (*fini)(void*);
  std::size_t (*size)(const void*);
  const void* (*get_const)(const void*, std::size_t);
  void* (*get)(void*, std::size_t);
  void (*resize)(void*, std::size_t);
  const void* (*get_const_of_array)(const void*, std::size_t);
  void* (*get_of_array)(void*, std::size_t);
};

template <std::size_t slot>
constexpr SlotFunctions functions_of() {
  return {[](void* message, Initialization) {
            const Slot& own = *slots[slot];
            std::memset(message, 0, own.members.size_of_);
            for (const MessageMember& member : own.member_list)
              begin_member(member, static_cast<std::byte*>(message) + member.offset_);
          },
          [](void* message) {
            for (const MessageMember& member : slots[slot]->member_list)
              end_member(member, static_cast<std::byte*>(message) + member.offset_);
          },
          [](const void* sequence) {
            return static_cast<const RawSequence*>(sequence)->count(slots[slot]->members.size_of_);
          },
          [](const void* sequence, std::size_t i) -> const void* {
            return begin_of(sequence) + i * slots[slot]->members.size_of_;
          },
          [](void* sequence, std::size_t i) -> void* {
            return begin_of(sequence) + i * slots[slot]->members.size_of_;
          },
          [](void* sequence, std::size_t count) {
            test::resize(slots[slot]->members, *static_cast<RawSequence*>(sequence), count);
          },
          [](const void* array, std::size_t i) -> const void* {
            return static_cast<const std::byte*>(array) + i * slots[slot]->members.size_of_;
          },
          [](void* array, std::size_t i) -> void* {
            return static_cast<std::byte*>(array) + i * slots[slot]->members.size_of_;
          }};
}
template <std::size_t... slot>
constexpr std::array<SlotFunctions, sizeof...(slot)> all_functions(std::index_sequence<slot...>) {
  return {functions_of<slot>()...};
}
constexpr auto slot_functions = all_functions(std::make_index_sequence<slot_count>());

template <class Use>
void with_type(std::uint8_t type_id, Use&& use) {
  const auto call = [&]<class T>() { use(static_cast<T*>(nullptr)); };
  switch (type_id) {
    case ros::ROS_TYPE_BOOLEAN:
      return call.template operator()<bool>();
    case ros::ROS_TYPE_INT8:
      return call.template operator()<std::int8_t>();
    case ros::ROS_TYPE_INT16:
      return call.template operator()<std::int16_t>();
    case ros::ROS_TYPE_UINT16:
      return call.template operator()<std::uint16_t>();
    case ros::ROS_TYPE_INT32:
      return call.template operator()<std::int32_t>();
    case ros::ROS_TYPE_UINT32:
      return call.template operator()<std::uint32_t>();
    case ros::ROS_TYPE_INT64:
      return call.template operator()<std::int64_t>();
    case ros::ROS_TYPE_UINT64:
      return call.template operator()<std::uint64_t>();
    case ros::ROS_TYPE_FLOAT:
      return call.template operator()<float>();
    case ros::ROS_TYPE_DOUBLE:
      return call.template operator()<double>();
    case ros::ROS_TYPE_STRING:
      return call.template operator()<std::string>();
    case ros::ROS_TYPE_WSTRING:
      return call.template operator()<std::u16string>();
    default:
      return call.template operator()<std::uint8_t>();
  }
}

template <class T>
void set_sequence_functions(MessageMember& member) {
  using Sequence = std::vector<T>;
  member.size_function = [](const void* at) { return static_cast<const Sequence*>(at)->size(); };
  member.resize_function = [](void* at, std::size_t n) { static_cast<Sequence*>(at)->resize(n); };
  member.fetch_function = [](const void* at, std::size_t i, void* value) {
    *static_cast<T*>(value) = (*static_cast<const Sequence*>(at))[i];
  };
  member.assign_function = [](void* at, std::size_t i, const void* value) {
    (*static_cast<Sequence*>(at))[i] = *static_cast<const T*>(value);
  };
  if constexpr (!std::is_same_v<T, bool>) {
    member.get_const_function = [](const void* at, std::size_t i) -> const void* {
      return &(*static_cast<const Sequence*>(at))[i];
    };
    member.get_function = [](void* at, std::size_t i) -> void* {
      return &(*static_cast<Sequence*>(at))[i];
    };
  }
}

/// An array has its size in the table, and no function to set it.
template <class T>
void set_array_functions(MessageMember& member) {
  member.get_const_function = [](const void* at, std::size_t i) -> const void* {
    return static_cast<const T*>(at) + i;
  };
  member.get_function = [](void* at, std::size_t i) -> void* { return static_cast<T*>(at) + i; };
}

const std::map<std::string, std::uint8_t> type_ids = {
    {"bool", ros::ROS_TYPE_BOOLEAN},   {"byte", ros::ROS_TYPE_OCTET},
    {"char", ros::ROS_TYPE_UINT8},     {"uint8", ros::ROS_TYPE_UINT8},
    {"int8", ros::ROS_TYPE_INT8},      {"uint16", ros::ROS_TYPE_UINT16},
    {"int16", ros::ROS_TYPE_INT16},    {"uint32", ros::ROS_TYPE_UINT32},
    {"int32", ros::ROS_TYPE_INT32},    {"uint64", ros::ROS_TYPE_UINT64},
    {"int64", ros::ROS_TYPE_INT64},    {"float32", ros::ROS_TYPE_FLOAT},
    {"float64", ros::ROS_TYPE_DOUBLE}, {"string", ros::ROS_TYPE_STRING},
    {"wstring", ros::ROS_TYPE_WSTRING}};

class Maker {
 public:
  explicit Maker(const Schema& schema) : schema_(schema) {}

  std::size_t slot_of(const std::string& type) {
    if (const auto made = made_.find(type); made != made_.end()) return made->second;
    const auto fields = schema_.find(type);
    if (fields == schema_.end()) throw std::runtime_error("no fields of '" + type + "'");
    auto slot = std::make_unique<Slot>();
    const std::size_t slash = type.rfind('/');
    slot->space = type.substr(0, slash);
    slot->name = type.substr(slash + 1);
    // Their addresses must not change.
    slot->member_names.reserve(fields->second.size());
    std::size_t offset = 0;
    for (const auto& [name, text] : fields->second) {
      slot->member_names.push_back(name);
      MessageMember member = member_of(text);
      member.name_ = slot->member_names.back().c_str();
      const auto [bytes, alignment] = room_of(member);
      offset = (offset + alignment - 1) / alignment * alignment;
      member.offset_ = static_cast<std::uint32_t>(offset);
      offset += bytes;
      slot->alignment = std::max(slot->alignment, alignment);
      slot->member_list.push_back(member);
    }
    const std::size_t index = next_++;
    if (index == slot_count) throw std::runtime_error("too many types");
    MessageMembers& members = slot->members;
    members.message_namespace_ = slot->space.c_str();
    members.message_name_ = slot->name.c_str();
    members.member_count_ = static_cast<std::uint32_t>(slot->member_list.size());
    members.members_ = slot->member_list.data();
    members.size_of_ = (offset + slot->alignment - 1) / slot->alignment * slot->alignment;
    members.init_function = slot_functions[index].init;
    members.fini_function = slot_functions[index].fini;
    slot->support.data = &members;
    slots[index] = std::move(slot);
    return made_[type] = index;
  }

 private:
  /// Cuts "<=N" off the end of `text`. Returns N, or 0 if there is none.
  static std::size_t cut_bound(std::string& text) {
    const std::size_t at = text.find("<=");
    if (at == std::string::npos) return 0;
    const std::size_t bound = std::stoul(text.substr(at + 2));
    text.resize(at);
    return bound;
  }
  MessageMember member_of(std::string text) {
    MessageMember member{};
    if (const std::size_t bracket = text.find('['); bracket != std::string::npos) {
      std::string size = text.substr(bracket + 1, text.size() - bracket - 2);
      text.resize(bracket);
      member.is_array_ = true;
      member.array_size_ = cut_bound(size);
      member.is_upper_bound_ = member.array_size_ != 0;
      if (!member.is_upper_bound_ && !size.empty()) member.array_size_ = std::stoul(size);
    }
    member.string_upper_bound_ = cut_bound(text);
    if (const auto id = type_ids.find(text); id != type_ids.end()) {
      member.type_id_ = id->second;
      with_type(member.type_id_, [&]<class T>(T*) {
        if (is_fixed(member))
          set_array_functions<T>(member);
        else if (member.is_array_)
          set_sequence_functions<T>(member);
      });
      return member;
    }
    member.type_id_ = ros::ROS_TYPE_MESSAGE;
    const std::size_t slot = slot_of(text);
    const SlotFunctions& functions = slot_functions[slot];
    member.members_ = &slots[slot]->support;
    if (is_fixed(member)) {
      member.get_const_function = functions.get_const_of_array;
      member.get_function = functions.get_of_array;
    } else if (member.is_array_) {
      member.size_function = functions.size;
      member.get_const_function = functions.get_const;
      member.get_function = functions.get;
      member.resize_function = functions.resize;
    }
    return member;
  }

  std::pair<std::size_t, std::size_t> room_of(const MessageMember& member) const {
    if (member.is_array_ && !is_fixed(member)) {
      const bool is_bits = member.type_id_ == ros::ROS_TYPE_BOOLEAN;
      return {is_bits ? sizeof(std::vector<bool>) : sizeof(std::vector<int>),
              alignof(std::vector<int>)};
    }
    std::size_t bytes = agnocast::detail::ros_element_layout(member.type_id_).bytes;
    std::size_t alignment = agnocast::detail::ros_element_layout(member.type_id_).alignment;
    if (member.type_id_ == ros::ROS_TYPE_MESSAGE) {
      bytes = agnocast::detail::nested_members(member).size_of_;
      alignment = agnocast::detail::ros_alignment(agnocast::detail::nested_members(member));
    }
    return {bytes * (is_fixed(member) ? member.array_size_ : 1), alignment};
  }

  const Schema& schema_;
  std::map<std::string, std::size_t> made_;
  static inline std::size_t next_ = 0;
};

}  // namespace

const MessageMembers& members_of_schema(const Schema& schema, const std::string& type) {
  static std::map<std::pair<Schema, std::string>, const MessageMembers*> known;
  const MessageMembers*& members = known[{schema, type}];
  if (members == nullptr) members = &slots[Maker(schema).slot_of(type)]->members;
  return *members;
}

}  // namespace agnocast::test
