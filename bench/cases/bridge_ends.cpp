// SPDX-License-Identifier: Apache-2.0
//
// Sender and receiver of the case bridge, each for all ways at once.
//
//   bridge-sender     answers "ROAD BYTES NUMBER" with the time of sending, or with an error
//   bridge-receiver   answers "ROAD NUMBER MILLISECONDS" with the time of arrival, "late", or
//                     that it was changed

#include <bench/process.hpp>
#include <examples/demo/content.hpp>
#include <examples/demo/dds_road.hpp>

#include <agnocast/agnocast.hpp>

#include <chrono>
#include <condition_variable>
#include <cstdlib>
#include <iostream>
#include <memory>
#include <mutex>
#include <set>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

namespace agnocast::bench {
namespace {

using demo::Cloud;

std::int64_t now_ns() {
  return std::chrono::duration_cast<std::chrono::nanoseconds>(
             std::chrono::steady_clock::now().time_since_epoch())
      .count();
}

int fail(const std::string& why) {
  std::cout << why << std::endl;  // as the answer to the first command
  return 1;
}

int be_bridge_sender(const std::vector<std::string>&) {
  std::string why;
  const auto native = demo::DdsWriter::make("rt/native", why);
  const auto inward = demo::DdsWriter::make("rt/in", why);
  if (native == nullptr || inward == nullptr) return fail(why);
  Node node("sender");
  const auto publisher = create_publisher<Cloud>(node, "/out", QoS(1).reliable());
  for (std::string line; std::getline(std::cin, line);) {
    std::istringstream words(line);
    std::string road;
    std::size_t bytes = 0;
    std::uint64_t number = 0;
    words >> road >> bytes >> number;
    std::int64_t began = 0;
    bool is_sent = false;
    if (road == "out") {
      auto loan = publisher->borrow_loaned_message();
      demo::build(*loan, number, bytes);
      began = now_ns();
      is_sent = static_cast<bool>(publisher->publish(std::move(loan)));
    } else {
      Cloud cloud;
      demo::build(cloud, number, bytes);
      demo::DdsWriter& writer = road == "in" ? *inward : *native;
      writer.fill(cloud);
      began = now_ns();
      is_sent = writer.write();
    }
    std::cout << (is_sent ? std::to_string(began) : "not sent") << std::endl;
  }
  return 0;
}

/// The received messages, for the waiting thread.
class Inbox {
 public:
  void put(const std::string& road, std::uint64_t number, std::int64_t time, bool is_intact) {
    const std::lock_guard lock(mutex_);
    is_intact_ = is_intact_ && is_intact;
    last_ = {road, number, time};
    news_.notify_one();
  }
  std::string wait(const std::string& road, std::uint64_t number, std::chrono::milliseconds wait) {
    std::unique_lock lock(mutex_);
    const bool has_come = news_.wait_for(
        lock, wait, [&] { return !is_intact_ || (last_.road == road && last_.number == number); });
    if (!is_intact_) return "a message was changed";
    return has_come ? std::to_string(last_.time) : "late";
  }

 private:
  struct Arrival {
    std::string road;
    std::uint64_t number = 0;
    std::int64_t time = 0;
  };
  std::mutex mutex_;
  std::condition_variable news_;
  Arrival last_;
  bool is_intact_ = true;
};

int be_bridge_receiver(const std::vector<std::string>&) {
  static Inbox inbox;
  std::string why;
  const auto reader_of = [&why](const char* road, const char* topic) {
    return demo::DdsReader::make(
        topic,
        [road](std::uint64_t number, bool is_intact, std::uint64_t time) {
          inbox.put(road, number, static_cast<std::int64_t>(time), is_intact);
        },
        why);
  };
  const auto native = reader_of("native", "rt/native");
  const auto outward = reader_of("out", "rt/out");
  if (native == nullptr || outward == nullptr) return fail(why);
  Node node("receiver");
  BackgroundExecutor executor;
  executor.add_node(node);
  const auto subscription = create_subscription<Cloud>(
      node, "/in", QoS(1).reliable(), [](const ipc_shared_ptr<const Cloud>& cloud) {
        const std::int64_t time = now_ns();
        inbox.put("in", demo::number_of(*cloud), time, demo::is_intact<demo::RosAccess>(*cloud));
      });
  for (std::string line; std::getline(std::cin, line);) {
    std::istringstream words(line);
    std::string road;
    std::uint64_t number = 0;
    std::int64_t milliseconds = 0;
    words >> road >> number >> milliseconds;
    std::cout << inbox.wait(road, number, std::chrono::milliseconds(milliseconds)) << std::endl;
  }
  std::_Exit(0);  // callbacks may still run
}

const RegisterRole sender("bridge-sender", be_bridge_sender);
const RegisterRole receiver("bridge-receiver", be_bridge_receiver);

}  // namespace
}  // namespace agnocast::bench
