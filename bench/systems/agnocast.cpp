// SPDX-License-Identifier: Apache-2.0
//
// agnocast through its public headers: sensor_msgs/PointCloud2, whose `data` is the payload, is
// borrowed, resized, and published; a receiver gets it
//
//   agnocast-executor  in a callback of the ordinary executor, which sleeps
//   agnocast-spinning  in a callback of an executor that never sleeps
//   agnocast-take      by take() in a loop

#include <agnocast/agnocast.hpp>
#include <bench/services.hpp>
#include <bench/system.hpp>

#include <sensor_msgs/msg/point_cloud2.hpp>

#include <atomic>
#include <stdexcept>
#include <string>
#include <utility>

namespace agnocast::bench {
namespace {

using Cloud = sensor_msgs::msg::PointCloud2;

class CloudSender final : public Sender {
 public:
  explicit CloudSender(const Carriage& carriage)
      : bytes_(carriage.bytes),
        receivers_(carriage.receivers),
        node_("bench_sender"),
        publisher_(node_.create_publisher<Cloud>(carriage.topic, carriage.depth)) {}

  bool is_matched() override { return publisher_->get_linked_subscription_count() >= receivers_; }
  std::byte* prepare() override {
    message_ = publisher_->borrow_loaned_message();
    message_->data.resize(bytes_);
    return reinterpret_cast<std::byte*>(message_->data.data());
  }
  bool send() override {
    const PublishResult result = publisher_->publish(std::move(message_));
    if (result.adopted_bytes != 0)
      throw std::runtime_error("agnocast: a message was not in the shared heap");
    return static_cast<bool>(result);
  }

 private:
  std::size_t bytes_, receivers_;
  Node node_;
  Publisher<Cloud>::SharedPtr publisher_;
  ipc_shared_ptr<Cloud> message_;
};

void deliver(const ipc_shared_ptr<const Cloud>& message, const Receiver::OnMessage& on_message) {
  on_message(reinterpret_cast<const std::byte*>(message->data.data()), message->data.size());
}

template <class Spinner>
class ExecutorReceiver final : public Receiver {
 public:
  template <class... Arguments>
  explicit ExecutorReceiver(const Carriage& carriage, Arguments... arguments)
      : node_("bench_receiver" + std::to_string(carriage.index)), executor_(arguments...) {
    executor_.add_node(node_);
    subscription_ = node_.create_subscription<Cloud>(
        carriage.topic, carriage.depth,
        [this](const ipc_shared_ptr<const Cloud>& message) { deliver(message, *on_message_); });
  }
  void run(const OnMessage& on_message) override {
    on_message_ = &on_message;
    executor_.spin();
  }
  void stop() override { executor_.cancel(); }

 private:
  const OnMessage* on_message_ = nullptr;
  Node node_;
  Spinner executor_;
  Subscription<Cloud>::SharedPtr subscription_;
};

class TakeReceiver final : public Receiver {
 public:
  explicit TakeReceiver(const Carriage& carriage)
      : node_("bench_receiver" + std::to_string(carriage.index)),
        subscription_(node_.create_subscription<Cloud>(carriage.topic, carriage.depth)) {}
  void run(const OnMessage& on_message) override {
    while (!is_stopped_.load(std::memory_order_relaxed)) {
      if (const auto message = subscription_->take()) deliver(message, on_message);
    }
  }
  void stop() override { is_stopped_.store(true); }

 private:
  Node node_;
  PollingSubscriber<Cloud>::SharedPtr subscription_;
  std::atomic<bool> is_stopped_{false};
};

std::unique_ptr<Sender> make_sender(const Carriage& carriage) {
  return std::make_unique<CloudSender>(carriage);
}
std::unique_ptr<Receiver> make_sleeping(const Carriage& carriage) {
  return std::make_unique<ExecutorReceiver<SingleThreadedExecutor>>(carriage);
}
std::unique_ptr<Receiver> make_spinning(const Carriage& carriage) {
  return std::make_unique<ExecutorReceiver<SpinningExecutor>>(carriage, SpinningExecutor::forever);
}
std::unique_ptr<Receiver> make_taking(const Carriage& carriage) {
  return std::make_unique<TakeReceiver>(carriage);
}

std::vector<std::string> environment() {
  return {"LD_PRELOAD=" + path_of("libagnocast_heaphook.so")};
}

System system(std::string_view name, std::string_view summary,
              std::unique_ptr<Receiver> (*make_receiver)(const Carriage&), bool is_spinning) {
  return {.name = name,
          .summary = summary,
          .make_sender = make_sender,
          .make_receiver = make_receiver,
          .service = "agnocastd",
          .environment = environment,
          .is_spinning = is_spinning,
          .descriptors = nullptr};
}

}  // namespace

std::vector<System> agnocast_systems() {
  return {
      system("agnocast-executor", "agnocast, a callback of the ordinary executor", make_sleeping,
             false),
      system("agnocast-spinning", "agnocast, a callback of an executor that never sleeps",
             make_spinning, true),
      system("agnocast-take", "agnocast, take() again and again", make_taking, true),
  };
}

}  // namespace agnocast::bench
