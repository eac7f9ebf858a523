// SPDX-License-Identifier: Apache-2.0
//
// Goal: a publisher whose result is ignored says once a second that the shared heap is full, and
// goes on when there is room again. Method: a daemon of this test gives one small window, and the
// history of a publisher keeps all messages.

#include "daemon.hpp"

namespace agnocastlib {
namespace {

TEST(FullHeapTest, IsLoggedOnceASecond) {
  Daemon daemon(
      "[heap]\nwindow_bytes = \"64MiB\"\narena_bytes = \"1GiB\"\nwindows_per_process = 1\n");
  agnocast::init(0, nullptr);
  {
    const LogLines lines;
    const auto node = std::make_shared<agnocast::Node>("node");
    auto keeps = node->create_publisher<String>("kept", rclcpp::QoS(100).transient_local());
    const auto start = std::chrono::steady_clock::now();
    const std::string large(4 << 20, '.');
    const std::string line = "publishing on '/kept' failed: ";
    EXPECT_TRUE(eventually([&] {
      publish(*keeps, large);
      return lines.with(line).size() >= 3;
    }));
    const auto logged = lines.with(line);
    EXPECT_LE(logged.size(), seconds_begun_since(start));
    for (const std::string& of_full : logged)
      EXPECT_THAT(of_full, testing::AnyOf(testing::HasSubstr("heap_exhausted: "),
                                          testing::HasSubstr("window_exhausted: ")));
    // Its history ends with it.
    keeps.reset();
    const auto other = node->create_publisher<String>("other", 1);
    const auto subscription = node->create_subscription<String>("other", 1);
    ASSERT_TRUE(eventually([&] { return other->get_linked_subscription_count() == 1; }));
    EXPECT_TRUE(eventually([&] {
      publish(*other, large);
      return static_cast<bool>(subscription->take_data());
    }));
  }
  agnocast::shutdown();
}

}  // namespace
}  // namespace agnocastlib
