// SPDX-License-Identifier: Apache-2.0
//
// Builds a MessageType from a table: verifies it, hashes it, reduces it to a plan, when an
// endpoint is created; nothing here runs at publish.
//
//     make_described_type → probe (is the table true?) → add_to_hash (which types are equal?)
//                         → plan (what to check)

#include "client/api/message_plan.hpp"

#include <agnocast/heap.hpp>
#include <agnocast/message_type.hpp>
#include <agnocast/type_library.hpp>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <exception>
#include <limits>
#include <new>
#include <string>
#include <utility>
#include <vector>

namespace agnocast::detail {
namespace {

// Ends the building of a type; caught in make_described_type, never visible outside.
struct Refusal {
  Failure failure;
};

[[noreturn]] void refuse(const char* why) { throw Refusal{Failure{Errc::type_refused, 0, why}}; }

constexpr const char* table_is_wrong = "the introspection table of the message contradicts itself";
constexpr const char* build_differs =
    "this program and libagnocast were compiled with different standard libraries or ABI switches";
constexpr const char* not_a_vector =
    "a sequence member is not a std::vector but an object that only works in the process that made "
    "it, such as "
    "rosidl::Buffer; its virtual functions belong to one process";

bool is_sequence(const FieldTable& field) {
  return field.array == ArrayKind::bounded || field.array == ArrayKind::unbounded;
}

// One message type with its nested types, and the walk over it that all functions share.
class Builder {
 public:
  explicit Builder(const TableReader& reader) : reader_(reader) {}

  MessageTable message_of(const void* table) {
    if (table == nullptr) refuse("the type support of the message has no introspection table");
    const MessageTable message = reader_.message(table);
    if (message.message_bytes == 0) refuse(table_is_wrong);
    if (message.message_bytes > std::numeric_limits<std::uint32_t>::max()) refuse(table_is_wrong);
    return message;
  }

  // Calls `see(field, element_bytes)` for each member of `table`.
  template <class See>
  void for_each_field(const void* table, See&& see) {
    const MessageTable message = message_of(table);
    for (std::size_t i = 0; i < message.field_count; ++i) {
      const FieldTable field = reader_.field(table, i);
      see(field, element_bytes_of(field));
    }
  }

  // Builds one message of each nested type and compares every sequence in it with VectorWords.
  // This finds sequence types that are no std::vector under any name, and saves the check all
  // calls into the type support.
  void probe(const void* table) {
    for (const void* seen : probed_) {
      if (seen == table) return;
    }
    probed_.push_back(table);
    const Sample sample(reader_, table, message_of(table).message_bytes);
    for_each_field(table, [&](const FieldTable& field, std::size_t element_bytes) {
      if (field.is_polymorphic) refuse(not_a_vector);
      std::byte* member = sample.memory() + field.offset;
      if (field.offset + member_bytes(field, element_bytes) > sample.message_bytes())
        refuse(table_is_wrong);
      if (is_sequence(field)) {
        probe_sequence(field, member, element_bytes);
      } else if (field.array == ArrayKind::fixed && field.get != nullptr) {
        const std::size_t last = field.array_bound - 1;
        if (field.get(member, last) != member + last * element_bytes) refuse(table_is_wrong);
      }
      if (field.element == ElementKind::message) probe(field.nested);
    });
  }

  // Includes names of nested types: two types whose members agree by chance are still different.
  // Checks the depth and the number of members for all later functions.
  void add_to_hash(LayoutHash& hash, const void* table, std::size_t depth = 0) {
    if (depth > plan_depth_max) refuse("the message type nests too deep");
    const MessageTable message = message_of(table);
    hash.add(name_of(table)).add(message.message_bytes).add(message.field_count);
    for_each_field(table, [&](const FieldTable& field, std::size_t element_bytes) {
      count_member();
      hash.add(std::string_view(field.name)).add(static_cast<std::uint64_t>(field.element));
      hash.add(std::uint64_t{field.primitive_id}).add(field.offset).add(element_bytes);
      hash.add(static_cast<std::uint64_t>(field.array))
          .add(field.array_bound)
          .add(field.string_bound);
      if (field.element == ElementKind::message) add_to_hash(hash, field.nested, depth + 1);
    });
  }

  StepRange plan(MessagePlan& out, const void* table) {
    std::vector<PlanStep> steps;
    plan_members(out, steps, table, 0, std::string());
    return append(out, steps);
  }

  std::string name_of(const void* table) {
    const MessageTable message = message_of(table);
    std::string name;
    for (const char* letter = message.message_namespace; *letter != '\0'; ++letter) {
      if (letter[0] == ':' && letter[1] == ':') {
        name += '/';
        ++letter;
      } else {
        name += *letter;
      }
    }
    name += '/';
    return name += message.message_name;
  }

 private:
  // A default message of one type.
  class Sample {
   public:
    Sample(const TableReader& reader, const void* table, std::size_t message_bytes)
        : reader_(reader),
          table_(table),
          message_bytes_(message_bytes),
          // VectorWords are read even where a smaller object is at the very end; zeroes there
          // are not vectors.
          memory_(message_bytes_ + sizeof(VectorWords)) {
      reader_.construct(table_, memory());
    }
    ~Sample() { reader_.destroy(table_, memory()); }
    Sample(const Sample&) = delete;
    Sample& operator=(const Sample&) = delete;
    std::byte* memory() const { return reinterpret_cast<std::byte*>(memory_.data()); }
    std::size_t message_bytes() const { return message_bytes_; }

   private:
    struct alignas(64) Line {
      std::byte bytes[64];
    };
    struct Memory {
      explicit Memory(std::size_t bytes) : lines((bytes + sizeof(Line) - 1) / sizeof(Line)) {}
      void* data() const { return const_cast<Line*>(lines.data()); }
      std::vector<Line> lines;
    };
    const TableReader& reader_;
    const void* table_;
    std::size_t message_bytes_;
    Memory memory_;
  };

  std::size_t element_bytes_of(const FieldTable& field) {
    if (field.element != ElementKind::message) {
      if (field.element_bytes == 0)
        refuse("a member has an element type that this version does not know");
      return field.element_bytes;
    }
    return message_of(field.nested).message_bytes;
  }

  static std::size_t member_bytes(const FieldTable& field, std::size_t element_bytes) {
    if (field.array == ArrayKind::none) return element_bytes;
    if (field.array == ArrayKind::fixed) return element_bytes * field.array_bound;
    return 0;  // an object that is no vector may be smaller; probe_sequence has a better sentence
               // for it
  }

  static void probe_sequence(const FieldTable& field, std::byte* member,
                             std::size_t element_bytes) {
    if (field.size == nullptr || field.resize == nullptr) refuse(table_is_wrong);
    const std::size_t count =
        field.array == ArrayKind::bounded && field.array_bound < 2 ? field.array_bound : 2;
    field.resize(member, count);
    if (field.size(member) != count) refuse(not_a_vector);
    if (field.element == ElementKind::boolean) {
      if (static_cast<const std::vector<bool>*>(static_cast<const void*>(member))->size() != count)
        refuse(not_a_vector);
      return;
    }
    if (field.get == nullptr) refuse(not_a_vector);
    VectorWords words;
    std::memcpy(&words, member, sizeof(words));
    if (words.begin == nullptr || words.end != words.begin + count * element_bytes)
      refuse(not_a_vector);
    if (words.end_of_storage < words.end) refuse(not_a_vector);
    for (std::size_t i = 0; i < count; ++i) {
      if (field.get(member, i) != words.begin + i * element_bytes) refuse(not_a_vector);
    }
  }

  void count_member() {
    if (++member_count_ > plan_member_count_max) refuse("the message type has too many members");
  }

  const char* keep(MessagePlan& out, std::string path) {
    return out.paths.emplace_back(std::move(path)).c_str();
  }

  StepRange append(MessagePlan& out, const std::vector<PlanStep>& steps) {
    const StepRange range{static_cast<std::uint32_t>(out.steps.size()),
                          static_cast<std::uint32_t>(steps.size())};
    out.steps.insert(out.steps.end(), steps.begin(), steps.end());
    return range;
  }

  // Returns the steps of one element of `field`, none if it owns no memory.
  StepRange plan_element(MessagePlan& out, const FieldTable& field) {
    if (field.element == ElementKind::message) return plan(out, field.nested);
    if (field.element == ElementKind::string || field.element == ElementKind::u16string) {
      const Step step = field.element == ElementKind::string ? Step::string : Step::u16string;
      return append(out, {{step, 0, 1, 0, {}, ""}});
    }
    return {};
  }

  void plan_members(MessagePlan& out, std::vector<PlanStep>& steps, const void* table,
                    std::size_t base, const std::string& prefix) {
    for_each_field(table, [&](const FieldTable& field, std::size_t element_bytes) {
      const std::string path = prefix + field.name;
      const auto offset = static_cast<std::uint32_t>(base + field.offset);
      const auto stride = static_cast<std::uint32_t>(element_bytes);
      if (is_sequence(field)) {
        if (field.element == ElementKind::boolean) {
          steps.push_back({Step::bits, offset, 1, 0, {}, keep(out, path)});
        } else {
          steps.push_back(
              {Step::sequence, offset, 1, stride, plan_element(out, field), keep(out, path)});
        }
      } else if (field.array == ArrayKind::fixed) {
        const StepRange element = plan_element(out, field);
        if (element.count != 0) {
          const auto count = static_cast<std::uint32_t>(field.array_bound);
          steps.push_back({Step::array, offset, count, stride, element, keep(out, path)});
        }
      } else if (field.element == ElementKind::message) {
        plan_members(out, steps, field.nested, offset, path + ".");
      } else if (field.element == ElementKind::string) {
        steps.push_back({Step::string, offset, 1, 0, {}, keep(out, path)});
      } else if (field.element == ElementKind::u16string) {
        steps.push_back({Step::u16string, offset, 1, 0, {}, keep(out, path)});
      }
    });
  }

  const TableReader& reader_;
  std::vector<const void*> probed_;
  std::size_t member_count_ = 0;
};

// Constant for the life of the process. May throw bad_alloc; the next call then tries again.
bool bits_are_seen() {
  static const bool holds = bits_reader_holds<std::vector<bool>>();
  return holds;
}

// Converts a bad_alloc or an exception of the message's default constructor to a Failure.
template <class Build>
Result<MessageType> guarded(Build&& build) noexcept {
  try {
    return build();
  } catch (const Refusal& refusal) {
    return tl::unexpected<Failure>(refusal.failure);
  } catch (const std::bad_alloc&) {
    return fail(Errc::os_failure, "describing a message type", ENOMEM);
  } catch (...) {
    return fail(Errc::user_code_threw, "default constructor of the message");
  }
}

}  // namespace

void DestroyPlan::operator()(const MessagePlan* plan) const noexcept { delete plan; }

Result<MessageType> make_described_type(const TableReader& reader, const void* table,
                                        std::uint32_t alignment, std::uint64_t build) noexcept {
  return guarded([&]() -> Result<MessageType> {
    if (build != build_hash) refuse(build_differs);
    Builder builder(reader);
    builder.probe(table);
    std::unique_ptr<MessagePlan, DestroyPlan> plan(new MessagePlan);
    LayoutHash hash;
    hash.add(build).add(std::string_view("described")).add(std::uint64_t{alignment});
    builder.add_to_hash(hash, table);
    plan->name = builder.name_of(table);
    plan->layout_hash = hash.value();
    plan->bytes = static_cast<std::uint32_t>(builder.message_of(table).message_bytes);
    plan->alignment = alignment;
    plan->kind = MessageType::Kind::described;
    plan->bits_are_seen = bits_are_seen();
    plan->root = builder.plan(*plan, table);
    return MessageType(std::move(plan));
  });
}

Result<MessageType> make_plain_type(const PlainType& type, std::uint64_t build) noexcept {
  return guarded([&]() -> Result<MessageType> {
    if (build != build_hash) refuse(build_differs);
    std::unique_ptr<MessagePlan, DestroyPlan> plan(new MessagePlan);
    plan->name = std::string(type.name);
    LayoutHash hash;
    hash.add(build).add(std::string_view("plain")).add(type.name).add(type.version);
    hash.add(std::uint64_t{type.bytes}).add(std::uint64_t{type.alignment});
    plan->layout_hash = hash.value();
    plan->bytes = type.bytes;
    plan->alignment = type.alignment;
    plan->visit = type.visit;
    plan->bits_are_seen = bits_are_seen();
    if (type.is_flat) {
      plan->kind = MessageType::Kind::flat;
    } else {
      plan->kind = type.visit != nullptr ? MessageType::Kind::visited : MessageType::Kind::opaque;
    }
    return MessageType(std::move(plan));
  });
}

Result<const void*> found_table(const void* (*find)(const void*), const void* argument,
                                const char* name) noexcept {
  const LoanPause pause;  // a library that it loads outlives any loan of this thread
  try {
    std::string why;
    try {
      if (const void* const table = find(argument)) return table;
      // rosidl leaves the reason in a variable of rcutils, which is not linked here. Loading the
      // library by its name fails for the same reason.
      if (const Result<void*> support = find_type_support(name, {}); !support)
        return tl::unexpected<Failure>(support.error());
      // That has loaded libraries which the loader alone does not find.
      if (const void* const table = find(argument)) return table;
      why = "the type support that is linked offers no introspection table";
    } catch (const std::bad_alloc&) {
      throw;
    } catch (const std::exception& thrown) {
      why = thrown.what();
    } catch (...) {
      why = "loading its type support threw an exception";
    }
    return fail_with(Errc::type_not_found, std::string(name) + ": " + why);
  } catch (const std::bad_alloc&) {
    return fail(Errc::os_failure, "finding the table of a message type", ENOMEM);
  }
}

}  // namespace agnocast::detail

namespace agnocast {

std::string_view MessageType::name() const noexcept { return plan_->name; }
std::uint64_t MessageType::layout_hash() const noexcept {
  return header_bytes_ == 0 ? plan_->layout_hash : layout_hash_;
}
std::uint32_t MessageType::message_bytes() const noexcept { return header_bytes_ + plan_->bytes; }
std::uint32_t MessageType::message_alignment() const noexcept {
  return std::max(header_bytes_, plan_->alignment);
}
MessageType::Kind MessageType::kind() const noexcept { return plan_->kind; }

}  // namespace agnocast
