// SPDX-License-Identifier: Apache-2.0
//
// RandomFiller builds random messages with random allocations outside the arena; half of all
// scalars keep their defaults.
#pragma once

#include <tests/unit/client/api/residency_messages.hpp>

#include <random>

namespace agnocast {
namespace test {

class RandomFiller {
 public:
  explicit RandomFiller(std::uint64_t seed) : random_(seed), foreign_chance_(number(4)) {}

  template <class T>
  T* make() {
    T* message = somewhere([] { return new T; });
    std::unique_ptr<T> owner(message);
    fill(*message);
    return owner.release();
  }

  std::size_t number(std::size_t bound) {
    return std::uniform_int_distribution<std::size_t>(0, bound)(random_);
  }

 private:
  // Each message has its own share of foreign allocations, none to most, so some are resident.
  template <class Do>
  auto somewhere(Do&& what) {
    const SharedHeap heap = shared_heap();
    std::optional<SharedScope> scope;
    if (number(4) >= foreign_chance_) scope.emplace(heap);
    return what();
  }

  template <class C>
  void fill_text(std::basic_string<C>& text, std::size_t length_max) {
    const std::size_t length = number(length_max);
    somewhere([&] {
      switch (number(3)) {
        case 0:
          text.assign(length, C('a'));
          break;
        case 1:
          text = std::basic_string<C>(length, C('b'));
          break;
        case 2:
          text.reserve(length);
          break;
        default:
          for (std::size_t i = 0; i < length; ++i) text.push_back(C('c'));
      }
      return 0;
    });
    if (number(5) == 0) text.clear();
  }
  void fill(std::string& text) { fill_text(text, 40); }
  void fill(std::u16string& text) { fill_text(text, 40); }
  template <class E>
  std::enable_if_t<std::is_arithmetic_v<E>> fill(E&) {}
  template <class E, std::size_t N>
  void fill(std::array<E, N>& elements) {
    for (E& element : elements) fill(element);
  }
  void fill(std::vector<bool>& bits) {
    const std::size_t size = number(200);
    somewhere([&] {
      bits.resize(size, true);
      return 0;
    });
    if (number(5) == 0) bits.clear();
  }
  template <std::size_t N>
  void fill(rosidl_runtime_cpp::BoundedVector<bool, N>& bits) {
    const std::size_t size = number(N);
    somewhere([&] {
      bits.resize(size, true);
      return 0;
    });
  }
  template <class E>
  void fill(std::vector<E>& elements) {
    const std::size_t size = number(4);
    somewhere([&] {
      switch (number(3)) {
        case 0:
          elements = std::vector<E>(size);
          break;
        case 1:
          elements.resize(size);
          break;
        case 2:
          elements.reserve(size + 3);
          break;
        default:
          for (std::size_t i = 0; i < size; ++i) elements.push_back(E());
      }
      return 0;
    });
    for (E& element : elements) fill(element);
    // Growing after the elements were filled moves them, with their memory, into another buffer.
    if (number(3) == 0)
      somewhere([&] {
        elements.resize(elements.capacity() + 1);
        return 0;
      });
    if (number(8) == 0) elements.clear();
  }
  template <class E, std::size_t N>
  void fill(rosidl_runtime_cpp::BoundedVector<E, N>& elements) {
    const std::size_t size = number(N);
    somewhere([&] {
      elements.resize(size);
      return 0;
    });
    for (E& element : elements) fill(element);
  }
  void fill(std_msgs::msg::Header& m) { fill(m.frame_id); }
  void fill(sensor_msgs::msg::PointField& m) { fill(m.name); }
  void fill(PointCloud2& m) {
    fill(m.header);
    fill(m.fields);
    fill(m.data);
  }
  void fill(agnocast_test_msgs::msg::Leaf& m) {
    fill(m.name);
    fill(m.data);
  }
  void fill(agnocast_test_msgs::msg::Branch& m) {
    fill(m.leaves);
    fill(m.name);
  }
  void fill(agnocast_test_msgs::msg::Tree& m) {
    fill(m.trunk);
    fill(m.boughs);
  }
  void fill(Forest& m) { fill(m.trees); }
  void fill(agnocast_test_msgs::msg::Empty&) {}
  void fill(agnocast_test_msgs::msg::Flat&) {}
  void fill(Inner& m) {
    fill(m.label);
    fill(m.notes);
    fill(m.blob);
    fill(m.wide);
    fill(m.flags);
  }
  void fill(Everything& m) {
    fill(m.flags);
    fill(m.bounded_flags);
    fill(m.text);
    fill_text(m.bounded_text, 40);
    fill(m.fixed_texts);
    fill(m.texts);
    fill(m.bounded_texts);
    fill(m.texts_of_bounded);
    fill(m.wide);
    fill(m.fixed_wides);
    fill(m.wides);
    fill(m.numbers);
    fill(m.bounded_numbers);
    fill(m.inner);
    fill(m.fixed_inners);
    fill(m.inners);
    fill(m.bounded_inners);
    fill(m.nothings);
    fill(m.flats);
  }

  std::mt19937_64 random_;
  std::size_t foreign_chance_;  // of 5
};

}  // namespace test
}  // namespace agnocast
