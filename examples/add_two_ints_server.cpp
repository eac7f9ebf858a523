// SPDX-License-Identifier: Apache-2.0
//
// Serves /add_two_ints: adds two numbers, until a signal. With agnocast-run
// add_two_ints_server it copies nothing.

#include <agnocast/agnocast.hpp>
#include <examples/options.hpp>

#include <example_interfaces/srv/add_two_ints.hpp>

#include <cstdio>

using example_interfaces::srv::AddTwoInts;

int main(int argc, char** argv) try {
  agnocast::init(argc, argv);
  if (const auto words = agnocast::remove_ros_arguments(argc, argv); words.size() != 1) {
    const bool is_help = words.size() == 2 && words[1] == "--help";
    std::fputs("usage: add_two_ints_server [--ros-args -r FROM:=TO …]\n",
               is_help ? stdout : stderr);
    return is_help ? 0 : 2;
  }
  agnocast::Node node("add_two_ints_server");
  agnocast::SingleThreadedExecutor executor;
  executor.add_node(node);
  example::end_by_signal(executor);
  auto service = node.create_service<AddTwoInts>(
      "add_two_ints", [](const agnocast::ipc_shared_ptr<const AddTwoInts::Request>& request,
                         agnocast::ipc_shared_ptr<AddTwoInts::Response>& response) {
        response->sum = request->a + request->b;
        std::printf("Incoming request: a: %lld b: %lld, sending back: %lld\n",
                    static_cast<long long>(request->a), static_cast<long long>(request->b),
                    static_cast<long long>(response->sum));
        std::fflush(stdout);
      });
  std::puts("Ready to add two ints."), std::fflush(stdout);
  executor.spin();
  return 0;
} catch (const agnocast::Error& error) {
  std::fprintf(stderr, "add_two_ints_server: %s\nhint: %s\n", error.what(),
               agnocast::remedy_of(error.failure().code));
  return 1;
}
