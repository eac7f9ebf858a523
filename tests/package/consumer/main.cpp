// SPDX-License-Identifier: Apache-2.0
//
// A program with a message type of its own, no ROS, no generated code: publishes and takes.
#include <agnocast/agnocast.hpp>

#include <cstdint>
#include <cstdio>
#include <string>
#include <vector>

struct Map {
  std::string name;
  std::vector<std::uint16_t> cells;
};

template <>
struct agnocast::MessageTraits<Map> {
  static constexpr const char* name = "consumer/Map";
  static void for_each_pointer(const Map& map, agnocast::PointerVisitor& visit) noexcept {
    visit("name", map.name);
    visit("cells", map.cells);
  }
};

struct Node {
  const char* get_name() const { return "consumer"; }
  const char* get_namespace() const { return "/"; }
  std::string get_fully_qualified_name() const { return "/consumer"; }
};

int main() {
  const Node node;
  auto subscription = agnocast::try_create_subscription<Map>(node, "map", agnocast::QoS(200));
  auto publisher = agnocast::try_create_publisher<Map>(node, "map", agnocast::QoS(1));
  if (!subscription || !publisher) {
    const auto& failure = subscription ? publisher.error() : subscription.error();
    std::fprintf(stderr, "consumer: %s\n", agnocast::sentence_of(failure.code));
    return 1;
  }
  unsigned long long adopted = 0;
  unsigned right = 0;
  // Each take below is to find the message at once.
  while ((*publisher)->get_linked_subscription_count() == 0) continue;
  for (std::uint16_t number = 1; number <= 100; ++number) {
    auto map = (*publisher)->borrow_loaned_message();
    map->name = "a map that has a name which is too long for the string object itself";
    map->cells.assign(number, number);
    const agnocast::PublishResult result = (*publisher)->publish(std::move(map));
    if (!result) return 1;
    adopted += result.adopted_bytes;
    const auto taken = (*subscription)->take();
    if (taken && taken->cells == std::vector<std::uint16_t>(number, number)) ++right;
  }
  std::printf("%u maps, %llu bytes adopted\n", right, adopted);
  return right == 100 ? 0 : 1;
}
