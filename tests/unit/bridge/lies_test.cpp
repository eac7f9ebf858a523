// SPDX-License-Identifier: Apache-2.0
//
// Goal: false counts and lengths cost no more memory than the input justifies (cdr_memory_factor),
// at any nesting depth. Method: this program's operator new adds up the requested bytes; types are
// schema tables, whose sequences use it.

#include <bridge/cdr/cdr.hpp>
#include <tests/support/messages/random_message.hpp>
#include <tests/unit/bridge/golden_sample.hpp>
#include <tests/unit/bridge/pieces.hpp>

#include <gtest/gtest.h>

#include <cstdlib>
#include <new>

namespace {
std::size_t bytes_asked_for = 0;
}  // namespace

// Not inlined: GCC would not see that new and delete belong together.
[[gnu::noinline]] void* operator new(std::size_t bytes) {
  bytes_asked_for += bytes;
  void* const memory = std::malloc(bytes);
  if (memory == nullptr) throw std::bad_alloc();
  return memory;
}
[[gnu::noinline]] void operator delete(void* memory) noexcept { std::free(memory); }
[[gnu::noinline]] void operator delete(void* memory, std::size_t) noexcept { std::free(memory); }

namespace agnocast::bridge {
namespace {

using test::Bytes;
using test::Pieces;

// Room for the text that names the position of a failure.
constexpr std::size_t text_bytes_max = 2048;

/// Returns whether it was read; adds a failure if that took more memory than allowed.
bool read_within_bounds(const IntrospectedType& type, const CdrType& cdr, const Bytes& bytes) {
  const OwnedGenericMessage message = type.make();
  const Pieces pieces(bytes);
  const std::size_t before = bytes_asked_for;
  const auto read = read_cdr(cdr, pieces.all(), message.get());
  EXPECT_LE(bytes_asked_for - before, cdr_memory_factor * bytes.size() + text_bytes_max)
      << (read ? "was read" : read.error().text());
  return read.has_value();
}

void put(Bytes& bytes, std::size_t at, std::uint32_t number) {
  std::memcpy(bytes.data() + at, &number, sizeof number);
}

TEST(CdrLies, MemoryForAnyFalseCountIsBoundedByTheInput) {
  int refused = 0;
  for (const test::Sample& sample : test::samples_with("cdr_hex")) {
    SCOPED_TRACE(sample.file);
    const IntrospectedType type(test::members_of_schema(sample.schema(), sample.text("ros_type")));
    const CdrType cdr = CdrType::of(type.members()).value();
    const Bytes bytes = test::bytes_of_hex(sample.text("cdr_hex"));
    ASSERT_TRUE(read_within_bounds(type, cdr, bytes));
    for (std::size_t at = 4; at + 4 <= bytes.size(); at += 4) {
      for (const std::uint32_t lie : {0xffffffffU, 0x80000000U, 0x7fffffffU, 0x10000000U, 100000U,
                                      static_cast<std::uint32_t>(bytes.size()), 1U, 0U}) {
        Bytes lying = bytes;
        put(lying, at, lie);
        if (!read_within_bounds(type, cdr, lying)) ++refused;
      }
    }
  }
  EXPECT_GT(refused, 0);
}

/// A megabyte of zeros, with some counts as large as possible.
class Promises {
 public:
  explicit Promises(const test::Schema& schema)
      : type_(test::members_of_schema(schema, "p/msg/Root")),
        cdr_(CdrType::of(type_.members()).value()) {}
  void promise(std::size_t at, std::size_t count) {
    put(bytes_, at, static_cast<std::uint32_t>(count));
  }
  std::size_t after(std::size_t at) const { return bytes_.size() - at - 4; }
  bool read() const { return read_within_bounds(type_, cdr_, bytes_); }

 private:
  IntrospectedType type_;
  CdrType cdr_;
  Bytes bytes_ = [] {
    Bytes bytes(1U << 20);
    bytes[1] = std::byte{1};
    return bytes;
  }();
};

TEST(CdrLies, ExactlyAsManyElementsAreReadAsTheInputHolds) {
  // Types that are large in memory and small on the wire.
  for (const char* const field : {"string", "wstring", "uint8[]", "bool[]"}) {
    SCOPED_TRACE(field);
    Promises promises(
        {{"p/msg/Root", {{"list", "p/msg/Element[]"}}}, {"p/msg/Element", {{"value", field}}}});
    promises.promise(4, promises.after(4) / 4);
    EXPECT_TRUE(promises.read());
    promises.promise(4, promises.after(4) / 4 + 1);
    EXPECT_FALSE(promises.read());
  }
}

TEST(CdrLies, AFalseLengthIsRefusedBeforeAllocation) {
  for (const char* const field : {"string", "wstring", "uint8[]", "bool[]", "float64[]"}) {
    SCOPED_TRACE(field);
    Promises promises({{"p/msg/Root", {{"value", field}}}});
    promises.promise(4, 0xffffffff);
    EXPECT_FALSE(promises.read());
  }
}

TEST(CdrLies, NestedFalseCountsAddUp) {
  Promises promises({{"p/msg/Root", {{"trees", "p/msg/Tree[]"}}},
                     {"p/msg/Tree", {{"branches", "p/msg/Branch[]"}, {"name", "string"}}},
                     {"p/msg/Branch", {{"leaves", "string[]"}, {"weights", "float64[]"}}}});
  // Half the input, then all of the rest, then a quarter: each alone would fit.
  promises.promise(4, promises.after(4) / 8 / 2);
  promises.promise(8, promises.after(8) / 8);
  promises.promise(12, promises.after(12) / 4 / 4);
  EXPECT_FALSE(promises.read());
  // All of the input on each level.
  promises.promise(4, promises.after(4) / 8);
  promises.promise(12, promises.after(12) / 4);
  EXPECT_FALSE(promises.read());
}

}  // namespace
}  // namespace agnocast::bridge
