// Publishes clouds and their names.
#include "robot.hpp"

#include <chrono>
#include <cstdio>
#include <cstdlib>

int main(int argc, char** argv) try {
  const auto count = static_cast<std::uint32_t>(argc > 1 ? std::atoi(argv[1]) : 1);
  agnocast::Node node("lidar");
  auto clouds =
      agnocast::create_publisher<Cloud>(node, "cloud_count", agnocast::QoS(1).transient_local());
  auto names =
      agnocast::create_publisher<Name>(node, "cloud_name", agnocast::QoS(1).transient_local());
  unsigned long long adopted = 0;
  for (std::uint32_t number = 1; number <= count; ++number) {
    auto cloud = clouds->borrow_loaned_message();
    cloud->width = number;
    for (std::size_t i = 0; i < bytes_of(number); ++i) cloud->data.push_back(byte_of(number, i));
    const auto result = clouds->publish_for(std::move(cloud), std::chrono::seconds(30));
    auto name = names->borrow_loaned_message();
    name->data = name_of(number);
    const auto named = names->publish_for(std::move(name), std::chrono::seconds(30));
    if (!result || !named) {
      std::fprintf(stderr, "lidar: %s\n", agnocast::sentence_of((result ? named : result).code));
      return 1;
    }
    adopted += result.adopted_bytes;
  }
  std::printf("%u clouds published, %llu bytes adopted\n", count, adopted);
  return 0;
} catch (const agnocast::Error& error) {
  std::fprintf(stderr, "lidar: %s\n", error.what());
  return 1;
}
