// SPDX-License-Identifier: Apache-2.0
//
// Lists the foreign memory of a message by other means than the library: it walks the C++ members
// by name, written by hand, and reads the tag that operator new left in front of each allocation.
#pragma once

#include "tests/support/memory/tagging_heap.hpp"

#include <agnocast_test_msgs/msg/everything.hpp>
#include <agnocast_test_msgs/msg/forest.hpp>
#include <rosidl_runtime_cpp/bounded_vector.hpp>
#include <sensor_msgs/msg/point_cloud2.hpp>
#include <std_msgs/msg/string.hpp>

#include <array>
#include <cstddef>
#include <cstdint>
#include <string>
#include <type_traits>
#include <vector>

namespace agnocast::test {

struct ForeignRange {
  std::string path;
  std::uint64_t bytes;
};

class Oracle {
 public:
  template <class T>
  static std::vector<ForeignRange> foreign_ranges(const T* message) {
    Oracle oracle;
    if (origin_of(message) != Origin::shared) oracle.found_.push_back({"(message)", sizeof(T)});
    oracle.members(*message, "");
    return oracle.found_;
  }

 private:
  using Path = std::string;
  static Path join(const Path& outer, const char* name) {
    return outer.empty() ? name : outer + "." + name;
  }

  void allocation(const void* first, std::uint64_t bytes, const Path& path) {
    if (origin_of(first) != Origin::shared) found_.push_back({path, bytes});
  }

  template <class C>
  void see(const std::basic_string<C>& text, const Path& path) {
    // Capacity, not address: text longer than an empty string's capacity lies outside the object.
    if (text.capacity() > std::basic_string<C>().capacity())
      allocation(text.data(), (text.size() + 1) * sizeof(C), path);
  }
  void see(const std::vector<bool>& bits, const Path& path) {
    bool_words(&bits, bits.size(), path);
  }
  template <std::size_t N>
  void see(const rosidl_runtime_cpp::BoundedVector<bool, N>& bits, const Path& path) {
    bool_words(&bits, bits.size(), path);
  }
  void bool_words(const void* bits, std::size_t size, const Path& path) {
    if (size != 0) allocation(*static_cast<void* const*>(bits), (size + 63) / 64 * 8, path);
  }
  template <class E>
  void see(const std::vector<E>& elements, const Path& path) {
    sequence(elements, path);
  }
  template <class E, std::size_t N>
  void see(const rosidl_runtime_cpp::BoundedVector<E, N>& elements, const Path& path) {
    sequence(elements, path);
  }
  template <class E, std::size_t N>
  void see(const std::array<E, N>& elements, const Path& path) {
    each(elements, path);
  }
  template <class S>
  void sequence(const S& elements, const Path& path) {
    if (elements.size() == 0) return;
    allocation(&elements[0], elements.size() * sizeof(elements[0]), path);
    each(elements, path);
  }
  template <class S>
  void each(const S& elements, const Path& path) {
    if constexpr (std::is_class_v<std::decay_t<decltype(elements[0])>>) {
      for (std::size_t i = 0; i < elements.size(); ++i)
        see(elements[i], path + "[" + std::to_string(i) + "]");
    }
  }
  template <class T>
  std::enable_if_t<rosidl_generator_traits::is_message<T>::value> see(const T& message,
                                                                      const Path& path) {
    members(message, path);
  }

  void members(const std_msgs::msg::Header& m, const Path& p) {
    see(m.frame_id, join(p, "frame_id"));
  }
  void members(const std_msgs::msg::String& m, const Path& p) { see(m.data, join(p, "data")); }
  void members(const sensor_msgs::msg::PointField& m, const Path& p) {
    see(m.name, join(p, "name"));
  }
  void members(const sensor_msgs::msg::PointCloud2& m, const Path& p) {
    see(m.header, join(p, "header"));
    see(m.fields, join(p, "fields"));
    see(m.data, join(p, "data"));
  }
  void members(const agnocast_test_msgs::msg::Leaf& m, const Path& p) {
    see(m.name, join(p, "name"));
    see(m.data, join(p, "data"));
  }
  void members(const agnocast_test_msgs::msg::Branch& m, const Path& p) {
    see(m.leaves, join(p, "leaves"));
    see(m.name, join(p, "name"));
  }
  void members(const agnocast_test_msgs::msg::Tree& m, const Path& p) {
    see(m.trunk, join(p, "trunk"));
    see(m.boughs, join(p, "boughs"));
  }
  void members(const agnocast_test_msgs::msg::Forest& m, const Path& p) {
    see(m.trees, join(p, "trees"));
  }
  void members(const agnocast_test_msgs::msg::Empty&, const Path&) {}
  void members(const agnocast_test_msgs::msg::Flat&, const Path&) {}
  void members(const agnocast_test_msgs::msg::Inner& m, const Path& p) {
    see(m.label, join(p, "label"));
    see(m.notes, join(p, "notes"));
    see(m.blob, join(p, "blob"));
    see(m.wide, join(p, "wide"));
    see(m.flags, join(p, "flags"));
  }
  void members(const agnocast_test_msgs::msg::Everything& m, const Path& p) {
    see(m.flags, join(p, "flags"));
    see(m.bounded_flags, join(p, "bounded_flags"));
    see(m.text, join(p, "text"));
    see(m.bounded_text, join(p, "bounded_text"));
    see(m.fixed_texts, join(p, "fixed_texts"));
    see(m.texts, join(p, "texts"));
    see(m.bounded_texts, join(p, "bounded_texts"));
    see(m.texts_of_bounded, join(p, "texts_of_bounded"));
    see(m.wide, join(p, "wide"));
    see(m.fixed_wides, join(p, "fixed_wides"));
    see(m.wides, join(p, "wides"));
    see(m.numbers, join(p, "numbers"));
    see(m.bounded_numbers, join(p, "bounded_numbers"));
    see(m.inner, join(p, "inner"));
    see(m.fixed_inners, join(p, "fixed_inners"));
    see(m.inners, join(p, "inners"));
    see(m.bounded_inners, join(p, "bounded_inners"));
    see(m.nothings, join(p, "nothings"));
    see(m.flats, join(p, "flats"));
  }

  std::vector<ForeignRange> found_;
};

}  // namespace agnocast::test
