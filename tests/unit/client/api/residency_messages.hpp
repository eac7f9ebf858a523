// SPDX-License-Identifier: Apache-2.0
//
// Messages with single allocations inside or outside the arena, for residency_test.cpp, and their
// check against the oracle.
#pragma once

#include "client/api/message_plan.hpp"
#include "tests/support/memory/tagging_heap.hpp"
#include "tests/unit/client/api/message_oracle.hpp"

#include <agnocast/residency.hpp>
#include <agnocast/rosidl.hpp>

#include <gmock/gmock.h>

#include <geometry_msgs/msg/point.hpp>
#include <std_msgs/msg/string.hpp>

#include <cstdlib>
#include <memory>
#include <new>
#include <numeric>
#include <optional>
#include <random>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

namespace agnocast {
namespace test {
struct Map;
struct Opaque;
struct Thrower;
}  // namespace test

template <>
struct MessageTraits<test::Map> {
  static constexpr const char* name = "test/Map";
  static void for_each_pointer(const test::Map& map, PointerVisitor& visit) noexcept;
};
template <>
struct MessageTraits<test::Opaque> {
  static constexpr const char* name = "test/Opaque";
};
template <>
struct MessageTraits<test::Thrower> {
  static constexpr const char* name = "test/Thrower";
};

namespace test {

using agnocast_test_msgs::msg::Everything;
using agnocast_test_msgs::msg::Forest;
using agnocast_test_msgs::msg::Inner;
using sensor_msgs::msg::PointCloud2;
using testing::ElementsAre;
using testing::Not;

// Longer than any string object holds inline, also as UTF-16.
inline const std::string long_text(40, 'x');
inline const std::u16string long_wide(40, u'x');
// libc++ and libstdc++ hold at least this much inline.
inline const std::string short_text = "short";

struct Map {
  std::string name;
  std::vector<std::uint16_t> cells;
  std::vector<bool> known;
};

struct Opaque {
  std::vector<int> numbers;
};

struct Thrower {
  enum class What { nothing, bad_alloc, other };
  What what = What::nothing;
  std::string text = long_text;
  Thrower() = default;
  Thrower(const Thrower& other) : what(other.what), text(other.text) {
    if (what == What::bad_alloc) throw std::bad_alloc();
    if (what == What::other) throw std::runtime_error("no copies today");
  }
  Thrower& operator=(const Thrower&) = delete;
};

}  // namespace test

void MessageTraits<test::Map>::for_each_pointer(const test::Map& map,
                                                PointerVisitor& visit) noexcept {
  visit("name", map.name);
  visit("cells", map.cells);
  visit("known", map.known);
}

namespace test {

template <class T>
const MessageType& type_of() {
  static const Result<MessageType> type = message_type_of<T>();
  if (!type) {
    ADD_FAILURE() << type.error().what;
    std::abort();
  }
  return *type;
}

template <class Make>
auto in_shared_heap(Make&& make) {
  const SharedHeap heap = shared_heap();
  SharedScope scope(heap);
  return make();
}

template <class T>
Residency check(const T* message) {
  return check_residency(type_of<T>(), message, windows());
}

inline std::string path_of(const Residency& found) { return found.first_path.data(); }

// Compares the library with the oracle; returns the oracle's list.
template <class T>
std::vector<ForeignRange> expect_agreement(const T* message) {
  type_of<T>();  // made on first use, which allocates
  const std::vector<ForeignRange> expected = Oracle::foreign_ranges(message);
  const HeapCounters before = heap_counters();
  const Residency found = check(message);
  EXPECT_EQ(heap_counters().allocations, before.allocations) << "the check allocated memory";
  EXPECT_EQ(found.foreign_count, expected.size());
  std::uint64_t bytes = 0;
  for (const ForeignRange& range : expected) bytes += range.bytes;
  EXPECT_EQ(found.foreign_bytes, bytes);
  EXPECT_EQ(found.unseen_count, 0U);
  EXPECT_EQ(path_of(found), expected.empty() ? "" : expected.front().path);
  EXPECT_EQ(found.is_resident(), expected.empty());
  return expected;
}

inline PointCloud2* make_cloud() {
  auto message = std::make_unique<PointCloud2>();
  message->header.frame_id = long_text;
  message->fields.resize(3);
  for (auto& field : message->fields) field.name = long_text;
  message->data.assign(1000, 7);
  return message.release();
}

template <class E>
void fill_inner(E& inner) {
  inner.label = long_text;
  inner.notes = {long_text, short_text};
  inner.blob.assign(100, 1);
  inner.wide = long_wide;
  inner.flags.assign(100, true);
}

inline Everything* make_everything() {
  auto message = std::make_unique<Everything>();
  message->flags.assign(70, true);
  message->bounded_flags.resize(65, true);
  message->text = long_text;
  message->bounded_text = long_text;
  for (auto& text : message->fixed_texts) text = long_text;
  message->texts = {long_text, short_text, long_text};
  message->bounded_texts.resize(2, long_text);
  message->texts_of_bounded.resize(1, long_text);
  message->wide = long_wide;
  for (auto& text : message->fixed_wides) text = long_wide;
  message->wides = {long_wide, u"short"};
  message->numbers.assign(10, 1.5);
  message->bounded_numbers.resize(5, 3);
  fill_inner(message->inner);
  for (auto& inner : message->fixed_inners) fill_inner(inner);
  message->inners.resize(2);
  for (auto& inner : message->inners) fill_inner(inner);
  message->bounded_inners.resize(1);
  fill_inner(message->bounded_inners[0]);
  message->nothings.resize(3);
  message->flats.resize(2);
  return message.release();
}

inline Forest* make_forest() {
  auto message = std::make_unique<Forest>();
  message->trees.resize(2);
  for (auto& tree : message->trees) {
    for (auto* branch : {&tree.trunk, &tree.boughs[0], &tree.boughs[1]}) {
      branch->name = long_text;
      branch->leaves.resize(2);
      for (auto& leaf : branch->leaves) {
        leaf.name = long_text;
        leaf.data.assign(9, 1);
      }
    }
  }
  return message.release();
}

// Makes the message again and again with one more allocation diverted to libc. Returns the paths
// that were found alone, in the order of the allocations; growing sequences leave some diverted
// allocations unused.
template <class Make>
std::vector<std::string> divert_each_allocation(Make&& make) {
  std::vector<std::string> paths;
  const std::uint64_t before = heap_counters().shared_allocations;
  std::unique_ptr<std::remove_pointer_t<decltype(make())>> whole(in_shared_heap(make));
  const std::uint64_t count = heap_counters().shared_allocations - before;
  EXPECT_TRUE(expect_agreement(whole.get()).empty());
  for (std::uint64_t n = 1; n <= count; ++n) {
    SCOPED_TRACE("allocation " + std::to_string(n));
    divert_shared_allocation(n);
    decltype(whole) message(in_shared_heap(make));
    divert_shared_allocation(0);
    const std::vector<ForeignRange> found = expect_agreement(message.get());
    EXPECT_LE(found.size(), 1U);
    if (!found.empty()) paths.push_back(found.front().path);
  }
  return paths;
}

}  // namespace test
}  // namespace agnocast
