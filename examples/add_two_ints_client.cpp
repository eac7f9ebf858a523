// SPDX-License-Identifier: Apache-2.0
//
// Requests the sum of two numbers from /add_two_ints. Waits for the service until a signal. With
// agnocast-run add_two_ints_client 2 3 it copies nothing.

#include <agnocast/agnocast.hpp>
#include <examples/options.hpp>

#include <example_interfaces/srv/add_two_ints.hpp>

#include <charconv>
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <string>
#include <vector>

using example_interfaces::srv::AddTwoInts;

namespace {

bool read(const std::string& text, std::int64_t& number) {
  const char* const end = text.data() + text.size();
  const auto read = std::from_chars(text.data(), end, number);
  return read.ec == std::errc() && read.ptr == end;
}

}  // namespace

int main(int argc, char** argv) try {
  agnocast::init(argc, argv);
  const std::vector<std::string> words = agnocast::remove_ros_arguments(argc, argv);
  std::int64_t a = 0, b = 0;
  if (words.size() != 3 || !read(words[1], a) || !read(words[2], b)) {
    const bool is_help = words.size() == 2 && words[1] == "--help";
    std::fputs("usage: add_two_ints_client A B [--ros-args -r FROM:=TO …]\n",
               is_help ? stdout : stderr);
    return is_help ? 0 : 2;
  }
  agnocast::Node node("add_two_ints_client");
  agnocast::SingleThreadedExecutor executor;
  executor.add_node(node);
  auto client = node.create_client<AddTwoInts>("add_two_ints");
  while (!client->wait_for_service(std::chrono::seconds(1))) {
    if (!client->is_active()) {
      std::fputs(
          "add_two_ints_client: agnocast is switched off, or agnocastd has revoked this process\n",
          stderr);
      return 1;
    }
    std::puts("Service not available, waiting again…"), std::fflush(stdout);
  }
  auto request = client->borrow_loaned_request();
  request->a = a;
  request->b = b;
  auto sent = client->async_send_request(std::move(request));
  executor.spin_until_future_complete(sent);  // the response is a callback
  std::printf("Sum: %lld\n", static_cast<long long>(sent.get()->sum));
  return 0;
} catch (const agnocast::Error& error) {
  std::fprintf(stderr, "add_two_ints_client: %s\nhint: %s\n", error.what(),
               agnocast::remedy_of(error.failure().code));
  return 1;
}
