// SPDX-License-Identifier: Apache-2.0
//
// Goal: two processes share a type exactly if one can read what the other wrote, and types that
// cannot be shared are refused with a sentence. Method: change one part of a real introspection
// table at a time and compare hashes; compare translation units and processes that must agree;
// describe an imitation of rosidl::Buffer. refused_types.cpp covers what the compiler refuses.

#include "tests/unit/client/api/type_identity_types.hpp"

#include <agnocast/residency.hpp>
#include <agnocast/rosidl.hpp>

#include <gmock/gmock.h>

#include <agnocast_test_msgs/msg/empty.hpp>
#include <agnocast_test_msgs/msg/everything.hpp>
#include <agnocast_test_msgs/msg/forest.hpp>
#include <sensor_msgs/msg/image.hpp>
#include <sensor_msgs/msg/point_cloud2.hpp>
#include <sensor_msgs/srv/set_camera_info.hpp>

#include <cstdio>
#include <cstdlib>
#include <functional>
#include <memory>
#include <set>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

namespace buffer_test {

// The essence of rosidl::Buffer: a pointer to an object with virtual functions that owns the
// bytes.
class Backend {
 public:
  virtual ~Backend() = default;
  virtual std::vector<std::uint8_t>& bytes() = 0;
};
class CpuBackend final : public Backend {
 public:
  std::vector<std::uint8_t>& bytes() override { return bytes_; }

 private:
  std::vector<std::uint8_t> bytes_;
};
class Buffer {
 public:
  Buffer() : backend_(std::make_unique<CpuBackend>()) {}
  Buffer(const Buffer& other) : Buffer() { backend_->bytes() = other.backend_->bytes(); }
  Buffer& operator=(const Buffer&) = delete;
  std::vector<std::uint8_t>& bytes() const { return backend_->bytes(); }

 private:
  std::unique_ptr<Backend> backend_;
};
// The same with the vector inside: its table of virtual functions comes first.
class InlineBuffer : public Backend {
 public:
  std::vector<std::uint8_t>& bytes() override { return bytes_; }

 private:
  std::vector<std::uint8_t> bytes_;
};

template <class B>
struct Image {
  std::uint32_t width = 0;
  B data;
};
using PimplImage = Image<Buffer>;
using InlineImage = Image<InlineBuffer>;

// A message whose package has no introspection.
struct Unsupported {
  std::string text;
};
// One whose introspection library is there only at the third search; before, rosidl's function
// throws as that of one release of ROS 2, then returns null as that of another.
struct Late : sensor_msgs::msg::PointCloud2 {};
int late_searches = 0;

}  // namespace buffer_test

namespace rosidl_generator_traits {
template <>
struct is_message<buffer_test::PimplImage> : std::true_type {};
template <>
struct is_message<buffer_test::InlineImage> : std::true_type {};
template <>
struct is_message<buffer_test::Unsupported> : std::true_type {};
template <>
struct is_message<buffer_test::Late> : std::true_type {};
template <>
inline const char* name<buffer_test::PimplImage>() {
  return "buffer_test/msg/PimplImage";
}
template <>
inline const char* name<buffer_test::InlineImage>() {
  return "buffer_test/msg/InlineImage";
}
template <>
inline const char* name<buffer_test::Unsupported>() {
  return "buffer_test/msg/Unsupported";
}
template <>
inline const char* name<buffer_test::Late>() {
  return "buffer_test/msg/Late";
}
}  // namespace rosidl_generator_traits

namespace {

using agnocast::Errc;
using agnocast::LayoutHash;
using agnocast::message_type_of;
using agnocast::MessageType;
using agnocast::Result;
using agnocast::TypeIdentity;
using rosidl_typesupport_introspection_cpp::MessageMember;
using rosidl_typesupport_introspection_cpp::MessageMembers;
namespace ros = rosidl_typesupport_introspection_cpp;
using testing::HasSubstr;

template <class Image>
auto& bytes_at(const void* member) {
  using Data = decltype(Image::data);
  return const_cast<Data*>(static_cast<const Data*>(member))->bytes();
}

// The table that rosidl would generate for such an image.
template <class Image>
rosidl_message_type_support_t support_of_image() {
  static MessageMember members[2];
  members[0].name_ = "width";
  members[0].type_id_ = ros::ROS_TYPE_UINT32;
  members[1].name_ = "data";
  members[1].type_id_ = ros::ROS_TYPE_UINT8;
  members[1].is_array_ = true;
  members[1].offset_ = 8;
  static_assert(sizeof(Image) == 8 + sizeof(Image::data));
  members[1].size_function = [](const void* member) { return bytes_at<Image>(member).size(); };
  members[1].get_const_function = [](const void* member, size_t i) {
    return static_cast<const void*>(&bytes_at<Image>(member)[i]);
  };
  members[1].resize_function = [](void* member, size_t size) {
    bytes_at<Image>(member).resize(size);
  };
  static MessageMembers table{};
  table.message_namespace_ = "buffer_test::msg";
  table.message_name_ = "Image";
  table.member_count_ = 2;
  table.size_of_ = sizeof(Image);
  table.members_ = members;
  table.init_function = [](void* memory, rosidl_runtime_cpp::MessageInitialization) {
    new (memory) Image;
  };
  table.fini_function = [](void* memory) { static_cast<Image*>(memory)->~Image(); };
  rosidl_message_type_support_t support{};
  support.data = &table;
  support.func = [](const rosidl_message_type_support_t* of, const char*) { return of; };
  return support;
}

}  // namespace

namespace rosidl_typesupport_cpp {
template <>
const rosidl_message_type_support_t* get_message_type_support_handle<buffer_test::PimplImage>() {
  static const rosidl_message_type_support_t support = support_of_image<buffer_test::PimplImage>();
  return &support;
}
template <>
const rosidl_message_type_support_t* get_message_type_support_handle<buffer_test::InlineImage>() {
  static const rosidl_message_type_support_t support = support_of_image<buffer_test::InlineImage>();
  return &support;
}
template <>
const rosidl_message_type_support_t* get_message_type_support_handle<buffer_test::Unsupported>() {
  return nullptr;
}
template <>
const rosidl_message_type_support_t* get_message_type_support_handle<buffer_test::Late>() {
  static rosidl_message_type_support_t support{};
  support.func = [](const rosidl_message_type_support_t*, const char* identifier) {
    if (++buffer_test::late_searches == 1) throw std::runtime_error("liblate.so: file too short");
    if (buffer_test::late_searches == 2)
      return static_cast<const rosidl_message_type_support_t*>(nullptr);
    const auto* const cloud = get_message_type_support_handle<sensor_msgs::msg::PointCloud2>();
    return cloud->func(cloud, identifier);
  };
  return &support;
}
}  // namespace rosidl_typesupport_cpp

namespace {

template <class T>
std::uint64_t hash_of() {
  const Result<MessageType> type = message_type_of<T>();
  EXPECT_TRUE(type.has_value()) << type.error().what;
  return type ? type->layout_hash() : 0;
}

std::uint64_t fnv(std::string_view bytes) {
  LayoutHash hash;
  for (char byte : bytes) hash.add_byte(static_cast<unsigned char>(byte));
  return hash.value();
}

TEST(LayoutHash, IsFnv1aWithItsPublishedTestValues) {
  EXPECT_EQ(fnv(""), 0xcbf29ce484222325U);
  EXPECT_EQ(fnv("a"), 0xaf63dc4c8601ec8cU);
  EXPECT_EQ(fnv("foobar"), 0x85944171f73967e8U);
}

TEST(LayoutHash, EncodingDistinguishesNeighbouringTexts) {
  EXPECT_NE(LayoutHash().add("ab").add("c").value(), LayoutHash().add("a").add("bc").value());
  EXPECT_NE(LayoutHash().add("").add("a").value(), LayoutHash().add("a").add("").value());
  EXPECT_NE(LayoutHash().add(1).add(0).value(), LayoutHash().add(0).add(1).value());
  EXPECT_NE(LayoutHash().add(256).value(), LayoutHash().add(1).value());
}

TEST(TypeIdentity, NamesAreThoseOfRos) {
  const Result<MessageType> cloud = message_type_of<sensor_msgs::msg::PointCloud2>();
  ASSERT_TRUE(cloud.has_value());
  EXPECT_EQ(cloud->name(), "sensor_msgs/msg/PointCloud2");
  EXPECT_EQ(cloud->name(), rosidl_generator_traits::name<sensor_msgs::msg::PointCloud2>());
  EXPECT_EQ(cloud->message_bytes(), sizeof(sensor_msgs::msg::PointCloud2));
  EXPECT_EQ(cloud->message_alignment(), alignof(sensor_msgs::msg::PointCloud2));
  EXPECT_EQ(cloud->kind(), MessageType::Kind::described);
  using Request = sensor_msgs::srv::SetCameraInfo::Request;
  EXPECT_EQ(message_type_of<Request>()->name(), "sensor_msgs/srv/SetCameraInfo_Request");
  EXPECT_EQ(message_type_of<Request>()->name(), rosidl_generator_traits::name<Request>());
  EXPECT_EQ(message_type_of<identity_test::Pose>()->name(), "identity_test::Pose");
  EXPECT_EQ(message_type_of<identity_test::Pose>()->kind(), MessageType::Kind::flat);
  EXPECT_EQ(message_type_of<identity_test::Named>()->name(), "identity_test/Named");
}

TEST(TypeIdentity, DiffersBetweenTypesAndIsComparedWithTheName) {
  const std::set<std::uint64_t> hashes{
      hash_of<sensor_msgs::msg::PointCloud2>(),       hash_of<sensor_msgs::msg::Image>(),
      hash_of<agnocast_test_msgs::msg::Everything>(), hash_of<identity_test::Pose>(),
      hash_of<agnocast_test_msgs::msg::Empty>(),      hash_of<identity_test::Named>()};
  EXPECT_EQ(hashes.size(), 6U);
  EXPECT_EQ((TypeIdentity{"a", 1}), (TypeIdentity{"a", 1}));
  EXPECT_NE((TypeIdentity{"a", 1}), (TypeIdentity{"b", 1}));
  EXPECT_NE((TypeIdentity{"a", 1}), (TypeIdentity{"a", 2}));
}

identity_test::Hashes hashes_of_this_unit() {
  return {hash_of<identity_test::Pose>(), hash_of<identity_test::Named>(),
          hash_of<sensor_msgs::msg::PointCloud2>(), hash_of<agnocast_test_msgs::msg::Everything>(),
          std::string(message_type_of<identity_test::Pose>()->name())};
}

TEST(TypeIdentity, IsEqualInAUnitWithAnotherLanguageVersionAndOptimisation) {
  const identity_test::Hashes here = hashes_of_this_unit();
  const identity_test::Hashes there = identity_test::hashes_of_other_unit();
  EXPECT_EQ(here.pose, there.pose);
  EXPECT_EQ(here.named, there.named);
  EXPECT_EQ(here.cloud, there.cloud);
  EXPECT_EQ(here.everything, there.everything);
  EXPECT_EQ(here.pose_name, there.pose_name);
}

// Runs this program again, at other addresses.
TEST(TypeIdentity, IsEqualInAnotherProcess) {
  std::FILE* child = popen("/proc/$PPID/exe --print-hashes", "r");
  ASSERT_NE(child, nullptr);
  identity_test::Hashes there{};
  const int read = std::fscanf(child, "hashes %lx %lx %lx %lx", &there.pose, &there.named,
                               &there.cloud, &there.everything);
  EXPECT_EQ(pclose(child), 0);
  ASSERT_EQ(read, 4);
  const identity_test::Hashes here = hashes_of_this_unit();
  EXPECT_EQ(here.pose, there.pose);
  EXPECT_EQ(here.named, there.named);
  EXPECT_EQ(here.cloud, there.cloud);
  EXPECT_EQ(here.everything, there.everything);
}

// A copy of the tables of Forest (Forest › Tree › Branch › Leaf) that can be changed. The library
// probes tables before it hashes them, so changes of layout need a sample message that agrees:
// construct() makes none, and the sequences of the changed tables are imitated.
class Tables {
 public:
  Tables() {
    for (std::size_t i = 0; i < sample_fields.size(); ++i) fields[i] = sample_fields[i];
  }

  Result<MessageType> describe() const {
    current = this;
    const agnocast::detail::TableReader reader{
        [](const void* table) {
          return table == &current->nested_fields ? current->nested : current->message;
        },
        [](const void* table, std::size_t i) {
          return table == &current->nested_fields ? current->nested_fields[i] : current->fields[i];
        },
        [](const void*, void*) {}, [](const void*, void*) {}};
    return agnocast::detail::make_described_type(reader, &fields, alignment, build);
  }

  using Field = agnocast::detail::FieldTable;
  using Element = agnocast::detail::ElementKind;
  using Array = agnocast::detail::ArrayKind;

  std::uint32_t alignment = 8;
  std::uint64_t build = agnocast::detail::build_hash;
  agnocast::detail::MessageTable message{"a::msg", "B", 256, 6};
  agnocast::detail::MessageTable nested{"c::msg", "D", 16, 2};
  // Two doubles, nested once directly and once as a sequence.
  std::vector<Field> nested_fields{{"p", Element::primitive, Array::none, ros::ROS_TYPE_DOUBLE,
                                    false, 8, 0, 0, 0, nullptr, nullptr, nullptr, nullptr},
                                   {"q", Element::primitive, Array::none, ros::ROS_TYPE_DOUBLE,
                                    false, 8, 8, 0, 0, nullptr, nullptr, nullptr, nullptr}};
  std::vector<Field> sample_fields{
      {"plain", Element::message, Array::none, 0, false, 0, 0, 0, 0, &nested_fields, nullptr,
       nullptr, nullptr},
      {"text", Element::string, Array::none, ros::ROS_TYPE_STRING, false, sizeof(std::string), 16,
       0, 20, nullptr, nullptr, nullptr, nullptr},
      {"array", Element::primitive, Array::fixed, ros::ROS_TYPE_UINT8, false, 1, 48, 5, 0, nullptr,
       nullptr, nullptr, nullptr},
      {"sequence", Element::message, Array::unbounded, 0, false, 0, 64, 0, 0, &nested_fields, &size,
       &get<16>, &resize<16>},
      {"bounded", Element::primitive, Array::bounded, ros::ROS_TYPE_INT32, false, 4, 88, 7, 0,
       nullptr, &size, &get<4>, &resize<4>},
      {"number", Element::primitive, Array::none, ros::ROS_TYPE_INT32, false, 4, 112, 0, 0, nullptr,
       nullptr, nullptr, nullptr}};
  std::vector<Field> fields = std::vector<Field>(6);

 private:
  // A vector of two elements without its own memory: three pointers into `storage`.
  static std::size_t size(const void*) { return 2; }
  template <std::size_t Stride>
  static const void* get(const void*, std::size_t index) {
    return storage + index * Stride;
  }
  template <std::size_t Stride>
  static void resize(void* member, std::size_t) {
    resize_to<Stride>(member);
  }

 public:
  template <std::size_t Stride>
  static void resize_to(void* member) {
    auto* words = static_cast<const std::byte**>(member);
    words[0] = storage;
    words[1] = words[2] = storage + 2 * Stride;
  }

 private:
  static inline const Tables* current = nullptr;
  static inline std::byte storage[64];
};

TEST(TypeIdentity, EveryChangeOfTheTableChangesTheHash) {
  using Array = Tables::Array;
  const std::vector<std::pair<const char*, std::function<void(Tables&)>>> changes{
      {"nothing", [](Tables&) {}},
      {"message namespace", [](Tables& t) { t.message.message_namespace = "b::msg"; }},
      {"message name", [](Tables& t) { t.message.message_name = "C"; }},
      {"message size", [](Tables& t) { t.message.message_bytes = 264; }},
      {"message alignment", [](Tables& t) { t.alignment = 16; }},
      {"member left out", [](Tables& t) { t.message.field_count = 5; }},
      {"member name", [](Tables& t) { t.fields[5].name = "count"; }},
      {"member type of the same size",
       [](Tables& t) { t.fields[5].primitive_id = ros::ROS_TYPE_UINT32; }},
      {"member type of another size", [](Tables& t) { t.fields[5].element_bytes = 8; }},
      {"member offset", [](Tables& t) { t.fields[5].offset = 116; }},
      {"members swapped", [](Tables& t) { std::swap(t.fields[1], t.fields[5]); }},
      {"string to wstring", [](Tables& t) { t.fields[1].element = Tables::Element::u16string; }},
      {"string bound", [](Tables& t) { t.fields[1].string_bound = 21; }},
      {"string bound removed", [](Tables& t) { t.fields[1].string_bound = 0; }},
      {"array length", [](Tables& t) { t.fields[2].array_bound = 6; }},
      {"array to a single", [](Tables& t) { t.fields[2].array = Array::none; }},
      {"sequence bound", [](Tables& t) { t.fields[4].array_bound = 8; }},
      {"bounded to unbounded", [](Tables& t) { t.fields[4].array = Array::unbounded; }},
      {"nested name", [](Tables& t) { t.nested.message_name = "E"; }},
      {"nested member name", [](Tables& t) { t.nested_fields[1].name = "r"; }},
      {"nested member type",
       [](Tables& t) { t.nested_fields[1].primitive_id = ros::ROS_TYPE_INT64; }},
      {"nested member left out", [](Tables& t) { t.nested.field_count = 1; }},
  };
  std::set<std::uint64_t> hashes;
  for (const auto& [what, change] : changes) {
    Tables tables;
    change(tables);
    const Result<MessageType> type = tables.describe();
    ASSERT_TRUE(type.has_value()) << what << ": " << type.error().what;
    EXPECT_TRUE(hashes.insert(type->layout_hash()).second)
        << what << " gives a hash that another change already gave";
    Tables same;
    change(same);
    EXPECT_EQ(same.describe()->layout_hash(), type->layout_hash()) << what;
  }
}

TEST(TypeIdentity, EveryChangeOfAPlainTypeChangesTheHash) {
  const agnocast::detail::PlainType base{"a", 1, 16, 8, true, nullptr};
  const auto hash = [](const agnocast::detail::PlainType& type) {
    return agnocast::detail::make_plain_type(type, agnocast::detail::build_hash)->layout_hash();
  };
  std::set<std::uint64_t> hashes{hash(base)};
  agnocast::detail::PlainType type = base;
  type.name = "b";
  EXPECT_TRUE(hashes.insert(hash(type)).second);
  type = base, type.version = 2;
  EXPECT_TRUE(hashes.insert(hash(type)).second);
  type = base, type.bytes = 24;
  EXPECT_TRUE(hashes.insert(hash(type)).second);
  type = base, type.alignment = 16;
  EXPECT_TRUE(hashes.insert(hash(type)).second);
  EXPECT_EQ(hash(base), hash(base));
}

void expect_refused(const Result<MessageType>& type, const char* why) {
  ASSERT_FALSE(type.has_value()) << why;
  EXPECT_EQ(type.error().code, Errc::type_refused);
  EXPECT_THAT(type.error().what, HasSubstr(why));
}

TEST(TypeRefusal, ASequenceThatIsAPolymorphicBufferIsRefusedWithASentence) {
  expect_refused(message_type_of<buffer_test::PimplImage>(), "rosidl::Buffer");
  expect_refused(message_type_of<buffer_test::InlineImage>(),
                 "virtual functions belong to one process");
}

// Members of newer releases.
struct MarkedMember {
  bool is_rosidl_buffer_;
};
TEST(TypeRefusal, TheGeneratorsMarkIsTrusted) {
  EXPECT_TRUE(agnocast::detail::BufferMark<MarkedMember>::of({true}));
  EXPECT_FALSE(agnocast::detail::BufferMark<MarkedMember>::of({false}));
  EXPECT_FALSE(agnocast::detail::BufferMark<int>::of(1));
  Tables tables;
  tables.fields[4].is_polymorphic = true;
  expect_refused(tables.describe(), "rosidl::Buffer");
}

TEST(TypeRefusal, AStandardLibraryOtherThanTheLibrarysIsRefused) {
  Tables tables;
  tables.build ^= 1;
  expect_refused(tables.describe(), "different standard libraries");
  const agnocast::detail::PlainType plain{"a", 1, 16, 8, true, nullptr};
  expect_refused(agnocast::detail::make_plain_type(plain, agnocast::detail::build_hash ^ 1),
                 "different standard libraries");
}

TEST(TypeRefusal, TablesThatContradictThemselvesAreRefused) {
  const auto refused = [](const char* why, const std::function<void(Tables&)>& change) {
    SCOPED_TRACE(why);
    Tables tables;
    change(tables);
    expect_refused(tables.describe(), why);
  };
  refused("contradicts itself", [](Tables& t) { t.fields[5].offset = 253; });
  refused("contradicts itself", [](Tables& t) { t.message.message_bytes = 0; });
  refused("no introspection table", [](Tables& t) { t.fields[3].nested = nullptr; });
  refused("contradicts itself", [](Tables& t) { t.fields[3].size = nullptr; });
  refused("contradicts itself", [](Tables& t) { t.fields[3].resize = nullptr; });
  refused("not a std::vector", [](Tables& t) { t.fields[3].get = nullptr; });
  refused("not a std::vector", [](Tables& t) { t.fields[4].element_bytes = 8; });
  // Types whose elements lie where a vector's do, but with {elements, count, …} or without
  // capacity.
  refused("not a std::vector", [](Tables& t) {
    t.fields[3].resize = [](void* member, std::size_t) {
      Tables::resize_to<16>(member);
      static_cast<std::size_t*>(member)[1] = 2;
    };
  });
  refused("not a std::vector", [](Tables& t) {
    t.fields[3].resize = [](void* member, std::size_t) {
      Tables::resize_to<16>(member);
      static_cast<void**>(member)[2] = nullptr;
    };
  });
  refused("not a std::vector",
          [](Tables& t) { t.fields[3].size = [](const void*) { return std::size_t{3}; }; });
  refused("not a std::vector", [](Tables& t) {
    t.fields[3].get = [](const void* member, std::size_t i) {
      return static_cast<const void*>(*static_cast<const std::byte* const*>(member) + 8 * i);
    };
  });
  refused("does not know", [](Tables& t) { t.fields[5].element_bytes = 0; });
  refused("contradicts itself", [](Tables& t) {
    t.fields[2].get = [](const void* member, std::size_t i) {
      return static_cast<const void*>(static_cast<const std::byte*>(member) + 2 * i);
    };
  });
}

void expect_not_found(const Result<MessageType>& type, const std::string& why) {
  ASSERT_FALSE(type.has_value()) << why;
  EXPECT_EQ(type.error().code, Errc::type_not_found);
  EXPECT_THAT(text_of(type.error()), HasSubstr(": buffer_test/msg/" + why));
}

TEST(TypeRefusal, ATypeWithoutIntrospectionIsReportedWithTheLibraryThatIsMissing) {
  expect_not_found(message_type_of<buffer_test::Unsupported>(),
                   "Unsupported: no libbuffer_test__rosidl_typesupport_introspection_cpp.so");
}

TEST(TypeRefusal, ATypeWhoseLibraryCouldNotBeLoadedIsSearchedAgainUntilItIsFound) {
  using buffer_test::Late, buffer_test::late_searches;
  expect_not_found(message_type_of<Late>(), "Late: liblate.so: file too short");
  expect_not_found(message_type_of<Late>(), "Late: no libbuffer_test__");
  EXPECT_TRUE(message_type_of<Late>());
  EXPECT_EQ(message_type_of<Late>()->name(), "sensor_msgs/msg/PointCloud2");
  EXPECT_EQ(late_searches, 3) << "what was found is kept";
}

TEST(TypeRefusal, ATypeThatContainsItselfOrIsEndlesslyWideIsRefused) {
  Tables endless;
  endless.nested_fields[1].element = Tables::Element::message;
  endless.nested_fields[1].nested = &endless.nested_fields;
  endless.nested_fields[1].offset = 0;
  expect_refused(endless.describe(), "nests too deep");

  Tables wide;
  wide.nested.message_bytes = 1;
  wide.nested.field_count = 70000;
  wide.nested_fields.assign(70000, Tables::Field{"w", Tables::Element::primitive,
                                                 Tables::Array::none, ros::ROS_TYPE_UINT8, false, 1,
                                                 0, 0, 0, nullptr, nullptr, nullptr, nullptr});
  wide.message.field_count = 1;
  expect_refused(wide.describe(), "too many members");
}

TEST(TypeRefusal, ExceptionsOfADefaultConstructorBecomeErrors) {
  const auto describe = [](void (*construct)(const void*, void*)) {
    static const std::vector<Tables::Field> none;
    const agnocast::detail::TableReader reader{
        [](const void*) {
          return agnocast::detail::MessageTable{"a::msg", "B", 8, 0};
        },
        [](const void*, std::size_t) { return Tables::Field{}; }, construct,
        [](const void*, void*) {}};
    return agnocast::detail::make_described_type(reader, &none, 8, agnocast::detail::build_hash);
  };
  EXPECT_TRUE(describe([](const void*, void*) {}).has_value());
  EXPECT_EQ(describe([](const void*, void*) { throw std::bad_alloc(); }).error().os_errno, ENOMEM);
  EXPECT_EQ(describe([](const void*, void*) { throw 1; }).error().code, Errc::user_code_threw);
}

// The rules that the compiler enforces, as far as a test can query them and still compile.
struct HiddenPointer {
  std::uint32_t id;
  const char* text;
};
struct ArrayOfPointers {
  std::uint32_t id;
  int* all[2];
};
struct PointerFree {
  std::uint32_t id;
  double values[3];
  std::uintptr_t handle;
};
struct PointerInFirstMember {
  std::uint32_t id;
  HiddenPointer* first;
};
TEST(MessageRules, PointerMembersOfAggregatesAreSeen) {
  EXPECT_TRUE(agnocast::detail::has_member_elsewhere<HiddenPointer>());
  EXPECT_TRUE(agnocast::detail::has_member_elsewhere<ArrayOfPointers>());
  EXPECT_TRUE(agnocast::detail::has_member_elsewhere<PointerInFirstMember>());
  EXPECT_FALSE(agnocast::detail::has_member_elsewhere<PointerFree>());
  EXPECT_FALSE(agnocast::detail::has_member_elsewhere<identity_test::Pose>());
}

TEST(MessageRules, SpellingsThatDifferBetweenCompilersAreNotStable) {
  for (const char* stable : {"Pose", "a::b::Pose_2"})
    EXPECT_TRUE(agnocast::detail::is_stable_spelling(stable)) << stable;
  for (const char* unstable : {"", "std::array<int, 3>", "{anonymous}::Pose",
                               "(anonymous namespace)::Pose", "main()::Pose"}) {
    EXPECT_FALSE(agnocast::detail::is_stable_spelling(unstable)) << unstable;
  }
}

}  // namespace

int main(int argc, char** argv) {
  if (argc == 2 && std::string_view(argv[1]) == "--print-hashes") {
    const identity_test::Hashes hashes = hashes_of_this_unit();
    std::printf("hashes %lx %lx %lx %lx\n", hashes.pose, hashes.named, hashes.cloud,
                hashes.everything);
    return 0;
  }
  testing::InitGoogleMock(&argc, argv);
  return RUN_ALL_TESTS();
}
