// SPDX-License-Identifier: Apache-2.0
//
// The systems of the cases ros2 and rmw that need rclcpp, by the names of bench/systems/ros2.cpp.
// Ordinary nodes with their parameter services and topics, in an executor of rclcpp's that has this
// one node.
//
//   agnocast-rclcpp…       agnocast_rclcpp; the message is a loan, and read where it is
//   rclcpp-cyclonedds…     rclcpp; publish() serializes, the subscription deserializes
//   rclcpp-agnocast…       the same over another rmw; or the message is borrowed from it
//   rclcpp-intra-process   both nodes in one process: publish() moves a unique_ptr to the callback

#include <agnocast_rclcpp/agnocast_rclcpp.hpp>
#include <bench/system.hpp>
#include <bench/systems/ready_count.hpp>

#include <rclcpp/rclcpp.hpp>
#include <sensor_msgs/msg/point_cloud2.hpp>

#include <atomic>
#include <chrono>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <thread>
#include <utility>

namespace agnocast::bench {
namespace {

using Cloud = sensor_msgs::msg::PointCloud2;

rclcpp::QoS qos_of(const Carriage& carriage) { return rclcpp::QoS(carriage.depth).reliable(); }

rclcpp::Node::SharedPtr make_node(const std::string& name, bool is_intra_process = false) {
  return std::make_shared<rclcpp::Node>(
      name, rclcpp::NodeOptions().use_intra_process_comms(is_intra_process));
}
std::string receiver_name(const Carriage& carriage) {
  return "bench_receiver" + std::to_string(carriage.index);
}

std::byte* resized(Cloud& cloud, std::size_t bytes) {
  cloud.data.resize(bytes);
  return reinterpret_cast<std::byte*>(cloud.data.data());
}

// --- senders

class AgnocastSender final : public Sender {
 public:
  explicit AgnocastSender(const Carriage& carriage)
      : bytes_(carriage.bytes),
        receivers_(carriage.receivers),
        node_(make_node("bench_sender")),
        publisher_(agnocast::create_publisher<Cloud>(node_, carriage.topic, qos_of(carriage))) {}

  bool is_matched() override { return publisher_->get_linked_subscription_count() >= receivers_; }
  std::byte* prepare() override {
    message_ = publisher_->borrow_loaned_message();
    return resized(*message_, bytes_);
  }
  bool send() override {
    const PublishResult result = publisher_->publish(std::move(message_));
    if (result.adopted_bytes != 0)
      throw std::runtime_error("agnocast: a message was not in the shared heap");
    return static_cast<bool>(result);
  }

 private:
  std::size_t bytes_, receivers_;
  rclcpp::Node::SharedPtr node_;
  agnocast::Publisher<Cloud>::SharedPtr publisher_;
  ipc_shared_ptr<Cloud> message_;
};

class RclcppSender final : public Sender {
 public:
  RclcppSender(const Carriage& carriage, bool is_intra_process)
      : ready_(carriage),
        bytes_(carriage.bytes),
        receivers_(carriage.receivers),
        is_intra_process_(is_intra_process),
        node_(make_node("bench_sender", is_intra_process)),
        publisher_(node_->create_publisher<Cloud>(carriage.topic, qos_of(carriage))) {}

  // The publisher would also serialize for subscriptions that it does not know to be in the
  // process.
  bool is_matched() override {
    return ready_.is_complete() && publisher_->get_subscription_count() == receivers_ &&
           publisher_->get_intra_process_subscription_count() ==
               (is_intra_process_ ? receivers_ : 0);
  }
  std::byte* prepare() override {
    if (message_ == nullptr) message_ = std::make_unique<Cloud>();
    return resized(*message_, bytes_);
  }
  bool send() override {
    if (is_intra_process_) {
      publisher_->publish(std::move(message_));
    } else {
      publisher_->publish(*message_);
    }
    return true;
  }

 private:
  ReadyCount ready_;
  std::size_t bytes_, receivers_;
  bool is_intra_process_;
  rclcpp::Node::SharedPtr node_;
  rclcpp::Publisher<Cloud>::SharedPtr publisher_;
  std::unique_ptr<Cloud> message_;
};

/// Fills messages that the rmw lends.
class LoanSender final : public Sender {
 public:
  explicit LoanSender(const Carriage& carriage)
      : ready_(carriage),
        bytes_(carriage.bytes),
        receivers_(carriage.receivers),
        node_(make_node("bench_sender")),
        publisher_(node_->create_publisher<Cloud>(carriage.topic, qos_of(carriage))) {
    if (!publisher_->can_loan_messages())
      throw std::runtime_error("the rmw lends no messages of this type");
  }

  bool is_matched() override {
    return ready_.is_complete() && publisher_->get_subscription_count() == receivers_;
  }
  std::byte* prepare() override {
    message_.emplace(publisher_->borrow_loaned_message());
    return resized(message_->get(), bytes_);
  }
  bool send() override {
    publisher_->publish(std::move(*message_));
    message_.reset();
    return true;
  }

 private:
  ReadyCount ready_;
  std::size_t bytes_, receivers_;
  rclcpp::Node::SharedPtr node_;
  rclcpp::Publisher<Cloud>::SharedPtr publisher_;
  std::optional<rclcpp::LoanedMessage<Cloud>> message_;
};

// --- receivers

/// Spins a node's executor. Subclasses subscribe.
class SpunReceiver : public Receiver {
 public:
  SpunReceiver(rclcpp::Node::SharedPtr node, std::unique_ptr<rclcpp::Executor> executor)
      : node_(std::move(node)), executor_(std::move(executor)) {}
  void run(const OnMessage& on_message) override {
    on_message_ = &on_message;
    executor_->add_node(node_);
    executor_->spin();
    executor_->remove_node(node_);
  }
  void stop() override {
    is_stopped_.store(true);
    executor_->cancel();
  }

 protected:
  void deliver(const Cloud& cloud) const {
    (*on_message_)(reinterpret_cast<const std::byte*>(cloud.data.data()), cloud.data.size());
  }
  bool is_stopped() const noexcept { return is_stopped_.load(); }

  const rclcpp::Node::SharedPtr node_;

 private:
  const std::unique_ptr<rclcpp::Executor> executor_;
  const OnMessage* on_message_ = nullptr;
  std::atomic<bool> is_stopped_{false};
};

class AgnocastReceiver final : public SpunReceiver {
 public:
  AgnocastReceiver(const Carriage& carriage, std::unique_ptr<rclcpp::Executor> executor)
      : SpunReceiver(make_node(receiver_name(carriage)), std::move(executor)),
        subscription_(agnocast::create_subscription<Cloud>(
            node_, carriage.topic, qos_of(carriage),
            [this](const ipc_shared_ptr<const Cloud>& cloud) { deliver(*cloud); })) {}

 private:
  agnocast::Subscription<Cloud>::SharedPtr subscription_;
};

/// Counts itself when it knows the publisher too: what arrives before is dropped.
class RclcppReceiver final : public SpunReceiver {
 public:
  RclcppReceiver(const Carriage& carriage, bool is_intra_process)
      : SpunReceiver(make_node(receiver_name(carriage), is_intra_process),
                     std::make_unique<rclcpp::executors::SingleThreadedExecutor>()),
        ready_(carriage) {
    // Each way with the callback that rclcpp copies nothing for.
    const auto subscribe = [&](auto callback) {
      return node_->create_subscription<Cloud>(carriage.topic, qos_of(carriage), callback);
    };
    subscription_ = is_intra_process
                        ? subscribe([this](std::unique_ptr<Cloud> cloud) { deliver(*cloud); })
                        : subscribe([this](const Cloud& cloud) { deliver(cloud); });
  }
  void run(const OnMessage& on_message) override {
    while (!is_stopped() && subscription_->get_publisher_count() == 0)
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    ready_.add();
    SpunReceiver::run(on_message);
  }

 private:
  ReadyCount ready_;
  rclcpp::Subscription<Cloud>::SharedPtr subscription_;
};

// --- makers

std::unique_ptr<Sender> make_agnocast_sender(const Carriage& carriage) {
  return std::make_unique<AgnocastSender>(carriage);
}
template <class Executor>
std::unique_ptr<Receiver> make_agnocast_receiver(const Carriage& carriage) {
  return std::make_unique<AgnocastReceiver>(carriage, std::make_unique<Executor>());
}
template <bool is_intra_process>
std::unique_ptr<Sender> make_rclcpp_sender(const Carriage& carriage) {
  return std::make_unique<RclcppSender>(carriage, is_intra_process);
}
std::unique_ptr<Sender> make_loan_sender(const Carriage& carriage) {
  return std::make_unique<LoanSender>(carriage);
}
template <bool is_intra_process>
std::unique_ptr<Receiver> make_rclcpp_receiver(const Carriage& carriage) {
  return std::make_unique<RclcppReceiver>(carriage, is_intra_process);
}

/// The rest of a System is for the process that starts the others.
System system(std::string_view name, std::unique_ptr<Sender> (*make_sender)(const Carriage&),
              std::unique_ptr<Receiver> (*make_receiver)(const Carriage&)) {
  System made{};
  made.name = name;
  made.make_sender = make_sender;
  made.make_receiver = make_receiver;
  return made;
}

}  // namespace

const std::vector<System>& systems() {
  using rclcpp::executors::SingleThreadedExecutor, rclcpp::executors::StaticSingleThreadedExecutor;
  static const std::vector<System> all = {
      system("agnocast-rclcpp", make_agnocast_sender,
             make_agnocast_receiver<SingleThreadedExecutor>),
      system("agnocast-rclcpp-static", make_agnocast_sender,
             make_agnocast_receiver<StaticSingleThreadedExecutor>),
      system("rclcpp-cyclonedds", make_rclcpp_sender<false>, make_rclcpp_receiver<false>),
      system("rclcpp-cyclonedds-tuned", make_rclcpp_sender<false>, make_rclcpp_receiver<false>),
      system("rclcpp-cyclonedds-iceoryx", make_rclcpp_sender<false>, make_rclcpp_receiver<false>),
      system("rclcpp-agnocast", make_rclcpp_sender<false>, make_rclcpp_receiver<false>),
      system("rclcpp-agnocast-loans", make_loan_sender, make_rclcpp_receiver<false>),
      system("rclcpp-intra-process", make_rclcpp_sender<true>, make_rclcpp_receiver<true>),
  };
  return all;
}

}  // namespace agnocast::bench
