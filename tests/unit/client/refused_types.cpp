// SPDX-License-Identifier: Apache-2.0
//
// Goal: the compiler refuses types that cannot be messages, in plain words. Method: CMakeLists.txt
// compiles this file once for every CASE and looks for the sentence; without CASE it must compile.
// Keep in step with the list there.

#include <agnocast/message_type.hpp>
#include <agnocast/publisher.hpp>
#if !defined(CASE_rosidl_without_header)
#include <agnocast/rosidl.hpp>
#endif

#include <std_msgs/msg/string.hpp>

#include <any>
#include <array>
#include <bitset>
#include <chrono>
#include <complex>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <system_error>
#include <variant>
#include <vector>
#if __cplusplus >= 202002L
#include <span>
#endif

namespace refused {

struct Flat {
  int a;
};
enum class Number { one };
struct Virtual {
  virtual ~Virtual() = default;
};
struct ThrowingDestructor {
  std::string text;
  ~ThrowingDestructor() noexcept(false) {}
};
struct MoveOnly {
  std::unique_ptr<int> number;
};
struct Unknown {
  std::vector<int> numbers;
};
struct PointerMember {
  int count;
  const int* first;
};
struct ViewMember {
  int count;
  std::string_view name;
};
struct ReferenceMember {
  int count;
  int& other;
};
struct ConstantReferenceMember {
  const std::string& name;
};
struct FunctionMember {
  std::array<int, 3> numbers;
  std::function<void()> call;
};
struct SharedMember {
  char text[20];
  std::shared_ptr<int> number;
};
struct NestedView {
  double number;
  ViewMember inner;
};
struct ArrayOfViews {
  std::array<std::string_view, 2> names;
};
struct VectorOfPointers {
  std::string name;
  std::vector<std::vector<const int*>> all;
};
class PrivatePointer {
 public:
  int count = 0;

 private:
  [[maybe_unused]] const int* first = nullptr;
};
struct PrivateMember {
  int a;
  PrivatePointer p;
};
struct PrivateTwoLevelsDown {
  std::optional<int> maybe;
  char text[20];
  struct {
    std::array<PrivatePointer, 2> all;
  } inner;
};
struct PrivateOrNothing {
  std::variant<int, std::optional<PrivatePointer>> p;
};
struct PrivateBase : PrivatePointer {
  int a;
};
struct UnionMember {
  int a;
  union {
    long number;
    const int* first;
  };
};
struct ErrorCode {
  std::error_code code;  // points to its category
};
struct ListMember {
  int count;
  std::initializer_list<int> numbers;
};
struct MaybePointer {
  std::optional<const int*> first;
};
#if __cplusplus >= 202002L
struct SpanMember {
  int a;
  std::span<const int> s;
};
struct ArrayOfSpans {
  std::array<std::span<int, 4>, 2> all;
};
#endif
struct WithConstructor {
  explicit WithConstructor(int value = 0) : number(value) {}
  int number;
};
template <class T>
struct Box {
  T value;
};
// Types that resemble some of the above, but are allowed.
struct Tree {
  std::vector<Tree> children;
  std::string name;
};
struct Inner {
  float x, y;
};
struct Constant {
  const int number;
  const Inner inner;
};
struct Everything {
  bool yes : 1, no : 2;
  char text[33];
  Number number;
  std::array<Inner, 3> inner;
  int Inner::*member;
  std::optional<int> maybe;
  std::string names[2];
  std::vector<bool> bits;
  std::vector<std::vector<std::string>> words;
  Constant constant;
  WithConstructor hidden;
};
// Trivially copyable, and usable without a MessageTraits.
struct Empty {};
struct Base {
  std::int64_t id;
};
struct Seen : Base {
  std::optional<Inner> maybe;
  std::variant<std::monostate, int, Inner> either;
  std::chrono::nanoseconds age;
  std::chrono::time_point<std::chrono::steady_clock, std::chrono::milliseconds> at;
  std::complex<double> impedance;
  std::array<std::complex<float>, 2> pair;
  std::bitset<100> bits;
  std::byte bytes[8];
  WithConstructor named;  // with its own MessageTraits
  std::optional<WithConstructor> perhaps;
  Inner grid[2][2];
  Number number;
  int Inner::*member;
  Empty empty;
  bool yes : 1, no : 2;
  const int constant;
};
// A MessageTraits of the message also covers its members.
struct PrivateByName {
  int a;
  PrivatePointer p;
  union {
    long number;
    double real;
  };
};
struct Declared;
class HiddenCopy {
  std::string text;
  HiddenCopy(const HiddenCopy&) = default;
};
struct Abstract {
  virtual void act() = 0;
};
struct NoDefault {
  explicit NoDefault(int);
  int a;
};
struct Nameless {
  std::vector<int> numbers;
};
struct NotNoexcept {
  std::vector<int> numbers;
};
struct WrongSignature {
  std::vector<int> numbers;
};
struct Good {
  std::vector<int> numbers;
};

}  // namespace refused

namespace agnocast {
template <>
struct MessageTraits<refused::Nameless> {
  static constexpr std::uint64_t version = 1;
};
template <>
struct MessageTraits<refused::NotNoexcept> {
  static constexpr const char* name = "refused/NotNoexcept";
  static void for_each_pointer(const refused::NotNoexcept&, PointerVisitor&) {}
};
template <>
struct MessageTraits<refused::WrongSignature> {
  static constexpr const char* name = "refused/WrongSignature";
  static void for_each_pointer(const refused::WrongSignature&) noexcept {}
};
template <>
struct MessageTraits<refused::Good> {
  static constexpr const char* name = "refused/Good";
  static void for_each_pointer(const refused::Good&, PointerVisitor&) noexcept {}
};
#define AGNOCAST_TEST_NAMED(type)                         \
  template <>                                             \
  struct MessageTraits<refused::type> {                   \
    static constexpr const char* name = "refused/" #type; \
  };
AGNOCAST_TEST_NAMED(ViewMember)  // a name does not allow it
AGNOCAST_TEST_NAMED(ConstantReferenceMember)
AGNOCAST_TEST_NAMED(FunctionMember)
AGNOCAST_TEST_NAMED(SharedMember)
AGNOCAST_TEST_NAMED(VectorOfPointers)
AGNOCAST_TEST_NAMED(Tree)
AGNOCAST_TEST_NAMED(Constant)
AGNOCAST_TEST_NAMED(Everything)
AGNOCAST_TEST_NAMED(PrivateByName)
AGNOCAST_TEST_NAMED(ListMember)
#if !defined(CASE_with_constructor)
AGNOCAST_TEST_NAMED(WithConstructor)
#endif
template <>
struct MessageTraits<refused::Box<long>> {
  static constexpr const char* name = "refused/BoxOfLong";
};
}  // namespace agnocast

template <class T>
bool describe() {
  return agnocast::message_type_of<T>().has_value();
}

// Long because each type that must be refused is one case.
bool all() {
#if defined(CASE_pointer)
  return describe<refused::Flat*>();
#elif defined(CASE_reference)
  return describe<refused::Flat&>();
#elif defined(CASE_const)
  return describe<const refused::Flat>();
#elif defined(CASE_volatile)
  return describe<volatile refused::Flat>();
#elif defined(CASE_array)
  return describe<refused::Flat[3]>();
#elif defined(CASE_enumeration)
  return describe<refused::Number>();
#elif defined(CASE_declared)
  return describe<refused::Declared>();
#elif defined(CASE_hidden_copy)
  return describe<refused::HiddenCopy>();
#elif defined(CASE_abstract)
  return describe<refused::Abstract>();
#elif defined(CASE_function)
  return describe<std::function<void()>>();
#elif defined(CASE_shared_ptr)
  return describe<std::shared_ptr<refused::Flat>>();
#elif defined(CASE_unique_ptr)
  return describe<std::unique_ptr<refused::Flat>>();
#elif defined(CASE_any)
  return describe<std::any>();
#elif defined(CASE_no_default)
  static_cast<agnocast::Publisher<refused::NoDefault>*>(nullptr)->borrow_loaned_message();
  return false;
#elif defined(CASE_number)
  return describe<int>();
#elif defined(CASE_virtual)
  return describe<refused::Virtual>();
#elif defined(CASE_throwing_destructor)
  return describe<refused::ThrowingDestructor>();
#elif defined(CASE_move_only)
  return describe<refused::MoveOnly>();
#elif defined(CASE_vector)
  return describe<std::vector<int>>();
#elif defined(CASE_unknown)
  return describe<refused::Unknown>();
#elif defined(CASE_view)
  return describe<std::string_view>();
#elif defined(CASE_reference_wrapper)
  return describe<std::reference_wrapper<int>>();
#elif defined(CASE_pointer_member)
  return describe<refused::PointerMember>();
#elif defined(CASE_view_member)
  return describe<refused::ViewMember>();
#elif defined(CASE_reference_member)
  return describe<refused::ReferenceMember>();
#elif defined(CASE_constant_reference_member)
  return describe<refused::ConstantReferenceMember>();
#elif defined(CASE_function_member)
  return describe<refused::FunctionMember>();
#elif defined(CASE_shared_member)
  return describe<refused::SharedMember>();
#elif defined(CASE_nested_view)
  return describe<refused::NestedView>();
#elif defined(CASE_array_of_views)
  return describe<refused::ArrayOfViews>();
#elif defined(CASE_vector_of_pointers)
  return describe<refused::VectorOfPointers>();
#elif defined(CASE_private_member)
  return describe<refused::PrivateMember>();
#elif defined(CASE_private_two_levels_down)
  return describe<refused::PrivateTwoLevelsDown>();
#elif defined(CASE_private_or_nothing)
  return describe<refused::PrivateOrNothing>();
#elif defined(CASE_private_base)
  return describe<refused::PrivateBase>();
#elif defined(CASE_union_member)
  return describe<refused::UnionMember>();
#elif defined(CASE_error_code)
  return describe<refused::ErrorCode>();
#elif defined(CASE_list_member)
  return describe<refused::ListMember>();
#elif defined(CASE_maybe_pointer)
  return describe<refused::MaybePointer>();
#elif defined(CASE_span)
  return describe<std::span<const int>>();
#elif defined(CASE_span_member)
  return describe<refused::SpanMember>();
#elif defined(CASE_array_of_spans)
  return describe<refused::ArrayOfSpans>();
#elif defined(CASE_private_pointer)
  return describe<refused::PrivatePointer>();
#elif defined(CASE_with_constructor)
  return describe<refused::WithConstructor>();
#elif defined(CASE_template)
  return describe<refused::Box<int>>();
#elif defined(CASE_nameless)
  return describe<refused::Nameless>();
#elif defined(CASE_not_noexcept)
  return describe<refused::NotNoexcept>();
#elif defined(CASE_wrong_signature)
  return describe<refused::WrongSignature>();
#elif defined(CASE_rosidl_without_header) || defined(CASE_debug_containers)
  return describe<std_msgs::msg::String>();
#else
  return describe<refused::Flat>() && describe<refused::Good>() && describe<refused::Box<long>>() &&
         describe<refused::Tree>() && describe<refused::Constant>() &&
         describe<refused::Everything>() && describe<refused::Seen>() &&
         describe<refused::PrivateByName>() && describe<refused::WithConstructor>() &&
         describe<std_msgs::msg::String>();
#endif
}
