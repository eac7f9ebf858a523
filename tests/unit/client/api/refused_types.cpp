// SPDX-License-Identifier: Apache-2.0
//
// Goal: the compiler refuses types that cannot be messages, in plain words. Method: refused_test.py
// compiles this file with REFUSED_CASES and looks for the sentence of each case among the errors
// that its line causes; without it, everything must compile.

#include <agnocast/message_type.hpp>
#include <agnocast/publisher.hpp>
#if !defined(REFUSED_WITHOUT_HEADER)
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
struct Unnamed {
  explicit Unnamed(int value = 0) : number(value) {}
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
AGNOCAST_TEST_NAMED(WithConstructor)
template <>
struct MessageTraits<refused::Box<long>> {
  static constexpr const char* name = "refused/BoxOfLong";
};
}  // namespace agnocast

template <class T>
bool describe() {
  return agnocast::message_type_of<T>().has_value();
}

// Each of these is refused with its sentence.
#define REFUSED(name, sentence, body) \
  bool name##_is_refused() { body }
#if defined(REFUSED_CASES)
REFUSED(pointer, "a pointer or reference is not a message", return describe<refused::Flat*>();)
REFUSED(reference, "a pointer or reference is not a message", return describe<refused::Flat&>();)
REFUSED(const, "without const or volatile", return describe<const refused::Flat>();)
REFUSED(volatile, "without const or volatile", return describe<volatile refused::Flat>();)
REFUSED(array, "put the value into a struct", return describe<refused::Flat[3]>();)
REFUSED(enumeration, "put the value into a struct", return describe<refused::Number>();)
REFUSED(declared, "only declared here", return describe<refused::Declared>();)
REFUSED(hidden_copy, "a message must be copy constructible",
        return describe<refused::HiddenCopy>();)
REFUSED(abstract, "a class with virtual functions is not a message",
        return describe<refused::Abstract>();)
REFUSED(function, "a smart pointer or function object is not a message",
        return describe<std::function<void()>>();)
REFUSED(shared_ptr, "a smart pointer or function object is not a message",
        return describe<std::shared_ptr<refused::Flat>>();)
REFUSED(unique_ptr, "a smart pointer or function object is not a message",
        return describe<std::unique_ptr<refused::Flat>>();)
REFUSED(any, "a smart pointer or function object is not a message", return describe<std::any>();)
REFUSED(no_default, "this message has no default constructor",
        static_cast<agnocast::Publisher<refused::NoDefault>*>(nullptr)->borrow_loaned_message();
        return false;)
REFUSED(number, "put the value into a struct", return describe<int>();)
REFUSED(virtual, "a class with virtual functions is not a message",
        return describe<refused::Virtual>();)
REFUSED(throwing_destructor, "the destructor of a message must not throw",
        return describe<refused::ThrowingDestructor>();)
REFUSED(move_only, "a message must be copy constructible", return describe<refused::MoveOnly>();)
REFUSED(vector, "specialise agnocast::MessageTraits", return describe<std::vector<int>>();)
REFUSED(unknown, "specialise agnocast::MessageTraits", return describe<refused::Unknown>();)
REFUSED(view, "a view is not a message", return describe<std::string_view>();)
REFUSED(reference_wrapper, "a view is not a message",
        return describe<std::reference_wrapper<int>>();)
REFUSED(pointer_member, "has a pointer, reference, view or smart pointer as a member",
        return describe<refused::PointerMember>();)
REFUSED(view_member, "has a pointer, reference, view or smart pointer as a member",
        return describe<refused::ViewMember>();)
REFUSED(reference_member, "has a pointer, reference, view or smart pointer as a member",
        return describe<refused::ReferenceMember>();)
REFUSED(constant_reference_member, "has a pointer, reference, view or smart pointer as a member",
        return describe<refused::ConstantReferenceMember>();)
REFUSED(function_member, "has a pointer, reference, view or smart pointer as a member",
        return describe<refused::FunctionMember>();)
REFUSED(shared_member, "has a pointer, reference, view or smart pointer as a member",
        return describe<refused::SharedMember>();)
REFUSED(nested_view, "has a pointer, reference, view or smart pointer as a member",
        return describe<refused::NestedView>();)
REFUSED(array_of_views, "has a pointer, reference, view or smart pointer as a member",
        return describe<refused::ArrayOfViews>();)
REFUSED(vector_of_pointers, "has a pointer, reference, view or smart pointer as a member",
        return describe<refused::VectorOfPointers>();)
REFUSED(private_member, "cannot examine a member of this message",
        return describe<refused::PrivateMember>();)
REFUSED(private_two_levels_down, "cannot examine a member of this message",
        return describe<refused::PrivateTwoLevelsDown>();)
REFUSED(private_or_nothing, "cannot examine a member of this message",
        return describe<refused::PrivateOrNothing>();)
REFUSED(private_base, "cannot examine a member of this message",
        return describe<refused::PrivateBase>();)
REFUSED(union_member, "cannot examine a member of this message",
        return describe<refused::UnionMember>();)
REFUSED(error_code, "cannot examine a member of this message",
        return describe<refused::ErrorCode>();)
REFUSED(list_member, "has a pointer, reference, view or smart pointer as a member",
        return describe<refused::ListMember>();)
REFUSED(maybe_pointer, "has a pointer, reference, view or smart pointer as a member",
        return describe<refused::MaybePointer>();)
REFUSED(private_pointer, "cannot examine a class", return describe<refused::PrivatePointer>();)
REFUSED(with_constructor, "cannot examine a class", return describe<refused::Unnamed>();)
REFUSED(template, "give it a name by MessageTraits", return describe<refused::Box<int>>();)
REFUSED(nameless, "must have: static constexpr const char", return describe<refused::Nameless>();)
REFUSED(not_noexcept, "for_each_pointer must be noexcept", return describe<refused::NotNoexcept>();)
REFUSED(wrong_signature, "must be callable as", return describe<refused::WrongSignature>();)
#if __cplusplus >= 202002L
REFUSED(span, "a view is not a message", return describe<std::span<const int>>();)
REFUSED(span_member, "has a pointer, reference, view or smart pointer as a member",
        return describe<refused::SpanMember>();)
REFUSED(array_of_spans, "has a pointer, reference, view or smart pointer as a member",
        return describe<refused::ArrayOfSpans>();)
#endif
#elif defined(REFUSED_STRING)  // with a sentence for the switches of the compiler
bool string() { return describe<std_msgs::msg::String>(); }
#else
bool all() {
  return describe<refused::Flat>() && describe<refused::Good>() && describe<refused::Box<long>>() &&
         describe<refused::Tree>() && describe<refused::Constant>() &&
         describe<refused::Everything>() && describe<refused::Seen>() &&
         describe<refused::PrivateByName>() && describe<refused::WithConstructor>() &&
         describe<std_msgs::msg::String>();
}
#endif
