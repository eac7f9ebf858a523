// SPDX-License-Identifier: Apache-2.0
//
// Publishes "Hello World: N". With agnocast-run talker it copies nothing.

#include <agnocast/agnocast.hpp>
#include <examples/options.hpp>

#include <std_msgs/msg/string.hpp>

#include <chrono>
#include <cstdio>
#include <exception>
#include <thread>

int main(int argc, char** argv) try {
  const example::Options options = example::parse(argc, argv, "chatter");
  agnocast::Node node("talker");
  auto publisher = node.create_publisher<std_msgs::msg::String>(options.topic, options.depth);
  auto next = std::chrono::steady_clock::now();
  for (std::uint64_t number = 1; options.count == 0 || number <= options.count; ++number) {
    auto message = publisher->borrow_loaned_message();
    message->data = "Hello World: " + std::to_string(number);
    if (options.verbose)
      std::printf("Publishing: '%s'\n", message->data.c_str()), std::fflush(stdout);
    if (const auto result = publisher->publish(std::move(message)); !result) {
      std::fprintf(stderr, "talker: publish: %s\nhint: %s\n", agnocast::sentence_of(result.code),
                   agnocast::remedy_of(result.code));
      return 1;
    }
    std::this_thread::sleep_until(next += std::chrono::duration_cast<std::chrono::nanoseconds>(
                                      std::chrono::duration<double>(1 / options.rate)));
  }
  return 0;
} catch (const agnocast::Error& error) {
  std::fprintf(stderr, "talker: %s\nhint: %s\n", error.what(),
               agnocast::remedy_of(error.failure().code));
  return 1;
}
