// SPDX-License-Identifier: Apache-2.0
//
// A library of message types like a message package's, for agnocast_random_msgs/msg/T0 to T39. It
// chooses the types at random when it is loaded, by AGNOCAST_TEST_SEED: the same in each process
// with the same seed.

#include <tests/support/schema_tables.hpp>

#include <cstdlib>
#include <random>
#include <string>

namespace agnocast::test {
namespace {

constexpr std::size_t type_count = 40;

std::string name_of(std::size_t index) {
  return "agnocast_random_msgs/msg/T" + std::to_string(index);
}

class Chooser {
 public:
  explicit Chooser(std::uint64_t seed) : random_(seed) {}

  /// Messages only contain earlier messages.
  std::vector<std::pair<std::string, std::string>> fields(std::size_t index) {
    std::vector<std::pair<std::string, std::string>> list;
    for (std::size_t i = below(9) + 1; i-- > 0;)
      list.emplace_back("m" + std::to_string(list.size()), field(index));
    return list;
  }

 private:
  std::string field(std::size_t index) {
    static const char* const numbers[] = {"bool",   "byte",    "char",   "uint8",  "int8",
                                          "int16",  "int32",   "uint16", "uint32", "int64",
                                          "uint64", "float32", "float64"};
    std::string type = numbers[below(std::size(numbers))];
    bool is_message = false;
    if (below(4) == 0) {
      type = below(2) == 0 ? "string" : "wstring";
      if (below(2) == 0) type += bound();
    } else if (index > 0 && below(4) == 0) {
      // Near the beginning of the list: otherwise a message would be as large as all earlier ones
      // together.
      type = name_of(below(std::min<std::size_t>(index, 12)));
      is_message = true;
    }
    switch (below(is_message ? 8 : 5)) {
      case 0:
        return type + "[" + std::to_string(below(is_message ? 2 : 7) + 1) + "]";
      case 1:
        return type + "[" + bound() + "]";
      case 2:
        return type + "[]";
      default:
        return type;
    }
  }
  std::string bound() { return "<=" + std::to_string(below(9) + 1); }
  std::uint64_t below(std::uint64_t end) { return random_() % end; }

  std::mt19937_64 random_;
};

const rosidl_message_type_support_t* support_of(std::size_t index) {
  static const std::vector<rosidl_message_type_support_t> all = [] {
    const char* const seed = std::getenv("AGNOCAST_TEST_SEED");
    Chooser chooser(seed == nullptr ? 1 : std::stoull(seed));
    Schema schema;
    std::vector<rosidl_message_type_support_t> made(type_count);
    for (std::size_t i = 0; i < type_count; ++i) schema[name_of(i)] = chooser.fields(i);
    for (std::size_t i = 0; i < type_count; ++i)
      made[i].data = &members_of_schema(schema, name_of(i));
    return made;
  }();
  return &all[index];
}

}  // namespace
}  // namespace agnocast::test

#define TYPE(index)                                                                                                  \
  extern "C" [[gnu::visibility("default")]] const rosidl_message_type_support_t*                                     \
      rosidl_typesupport_introspection_cpp__get_message_type_support_handle__agnocast_random_msgs__msg__T##index() { \
    return agnocast::test::support_of(index);                                                                        \
  }
#define TEN_TYPES(ten) \
  TYPE(ten##0)         \
  TYPE(ten##1)         \
  TYPE(ten##2)         \
  TYPE(ten##3) TYPE(ten##4) TYPE(ten##5) TYPE(ten##6) TYPE(ten##7) TYPE(ten##8) TYPE(ten##9)
// clang-format off
TYPE(0) TYPE(1) TYPE(2) TYPE(3) TYPE(4) TYPE(5) TYPE(6) TYPE(7) TYPE(8) TYPE(9)
TEN_TYPES(1) TEN_TYPES(2) TEN_TYPES(3)
    // clang-format on
