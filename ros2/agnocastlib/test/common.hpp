// SPDX-License-Identifier: Apache-2.0
//
// Shared by the tests: rclcpp's life, a thread that spins, waiting, and lines that were logged.
#pragma once

#include <agnocast/agnocast.hpp>

#include <rclcpp/rclcpp.hpp>
#include <std_msgs/msg/string.hpp>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <chrono>
#include <cstdarg>
#include <cstdio>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <utility>
#include <vector>

namespace agnocastlib {

using String = std_msgs::msg::String;
using Message = agnocast::ipc_shared_ptr<String>;
using namespace std::chrono_literals;

class AgnocastTest : public testing::Test {
 protected:
  void SetUp() override { agnocast::init(0, nullptr); }
  void TearDown() override { agnocast::shutdown(); }
};

/// A node and the executor that a test spins itself.
class NodeTest : public AgnocastTest {
 protected:
  void SetUp() override {
    AgnocastTest::SetUp();
    node_ = std::make_shared<rclcpp::Node>("node");
    executor_ = std::make_unique<agnocast::SingleThreadedAgnocastExecutor>();
    executor_->add_node(node_);
  }
  void TearDown() override {
    executor_.reset();
    node_.reset();
    AgnocastTest::TearDown();
  }
  template <class Condition>
  [[nodiscard]] bool spin_until(Condition condition) {
    for (int i = 0; i < 3000 && !condition(); ++i) executor_->spin_once(10ms);
    return condition();
  }

  rclcpp::Node::SharedPtr node_;
  std::unique_ptr<agnocast::SingleThreadedAgnocastExecutor> executor_;
};

/// Spins any executor of either package until it is destroyed.
template <class Executor>
class Spinning {
 public:
  explicit Spinning(Executor& executor)
      : executor_(executor), thread_([this] {
          executor_.spin();
          has_ended_ = true;
        }) {}
  ~Spinning() {
    // rclcpp forgets a cancel() that comes before the spin.
    while (!has_ended_) {
      executor_.cancel();
      std::this_thread::sleep_for(1ms);
    }
    thread_.join();
  }

 private:
  Executor& executor_;
  std::atomic<bool> has_ended_{false};
  std::thread thread_;
};

template <class Condition>
[[nodiscard]] bool eventually(Condition condition) {
  for (int i = 0; i < 30'000; ++i) {
    if (condition()) return true;
    std::this_thread::sleep_for(1ms);
  }
  return false;
}

/// Sends `text`, built in the shared heap.
template <class Publisher>
void publish(Publisher& publisher, const std::string& text) {
  auto message = publisher.borrow_loaned_message();
  message->data = text;
  publisher.publish(std::move(message));
}

/// Keeps the lines that are logged at level warning or above while it lives. One at a time.
class LogLines {
 public:
  LogLines() : before_(rcutils_logging_get_output_handler()) {
    {
      const std::lock_guard lock(kept().mutex);
      kept().lines.clear();
    }
    rcutils_logging_set_output_handler([](const rcutils_log_location_t*, int severity, const char*,
                                          rcutils_time_point_value_t, const char* format,
                                          va_list* arguments) {
      char text[2048];
      std::vsnprintf(text, sizeof text, format, *arguments);
      const std::lock_guard lock(kept().mutex);
      if (severity >= RCUTILS_LOG_SEVERITY_WARN) kept().lines.emplace_back(text);
    });
  }
  ~LogLines() { rcutils_logging_set_output_handler(before_); }
  std::vector<std::string> with(const std::string& part) const {
    const std::lock_guard lock(kept().mutex);
    std::vector<std::string> found;
    for (const std::string& line : kept().lines)
      if (line.find(part) != std::string::npos) found.push_back(line);
    return found;
  }

 private:
  /// Never destroyed: another thread may still be logging when the test ends.
  struct Kept {
    std::mutex mutex;
    std::vector<std::string> lines;
  };
  static Kept& kept() {
    static auto* const all = new Kept;
    return *all;
  }
  const rcutils_logging_output_handler_t before_;
};

/// Returns how many seconds have begun since `start`: no more lines of one kind may have come.
inline std::size_t seconds_begun_since(std::chrono::steady_clock::time_point start) {
  return static_cast<std::size_t>((std::chrono::steady_clock::now() - start) / 1s) + 1;
}

}  // namespace agnocastlib
