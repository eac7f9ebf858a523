// SPDX-License-Identifier: Apache-2.0
//
// Receives and checks the messages of talker. Exits with status 1 if one was wrong.

#include <agnocast/agnocast.hpp>
#include <examples/options.hpp>

#include <std_msgs/msg/string.hpp>

#include <cstdint>
#include <cstdio>
#include <string>

int main(int argc, char** argv) try {
  const example::Options options = example::parse(argc, argv, "chatter");
  agnocast::Node node("listener");
  agnocast::SingleThreadedExecutor executor;
  executor.add_node(node);
  example::end_by_signal(executor);
  std::uint64_t received = 0, wrong = 0;
  auto subscription = node.create_subscription<std_msgs::msg::String>(
      options.topic, options.depth,
      [&](const agnocast::ipc_shared_ptr<const std_msgs::msg::String>& message) {
        if (options.verbose)
          std::printf("I heard: '%s'\n", message->data.c_str()), std::fflush(stdout);
        if (message->data != "Hello World: " + std::to_string(message.info().sequence)) ++wrong;
        if (++received == options.count) executor.cancel();
      });
  executor.spin();
  std::printf("%llu received, %llu wrong\n", static_cast<unsigned long long>(received),
              static_cast<unsigned long long>(wrong));
  return wrong == 0 ? 0 : 1;
} catch (const agnocast::Error& error) {
  std::fprintf(stderr, "listener: %s\nhint: %s\n", error.what(),
               agnocast::remedy_of(error.failure().code));
  return 1;
}
