// SPDX-License-Identifier: Apache-2.0

#include <bench/pipeline/edge.hpp>

#include <agnocast/agnocast.hpp>

#include <stdexcept>
#include <utility>

namespace agnocast::bench::pipeline {
namespace {

using Received = ipc_shared_ptr<const Cloud>;

class AgnocastSender final : public CloudSender {
 public:
  explicit AgnocastSender(const Lidar& lidar)
      : node_(std::string(lidar.name) + "_ring_outlier_filter"),
        publisher_(node_.create_publisher<Cloud>(topic_of(lidar), QoS(edge_depth))) {}

  bool is_matched() override { return publisher_->get_linked_subscription_count() == 1; }
  Cloud& borrow() override {
    loan_ = publisher_->borrow_loaned_message();
    return *loan_;
  }
  void send() override {
    const PublishResult result = publisher_->publish(std::move(loan_));
    if (!result)
      throw std::runtime_error(std::string("agnocast: publish: ") + sentence_of(result.code));
    if (result.adopted_bytes != 0)
      throw std::runtime_error("agnocast: publish had to copy " +
                               std::to_string(result.adopted_bytes) +
                               " bytes; is the heap hook loaded?");
  }

 private:
  Node node_;
  Publisher<Cloud>::SharedPtr publisher_;
  ipc_shared_ptr<Cloud> loan_;
};

class AgnocastReceiver final : public CloudReceiver {
 public:
  explicit AgnocastReceiver(OnCloud on_cloud) : on_cloud_(std::move(on_cloud)) {
    for (std::size_t i = 0; i < lidar_count; ++i) {
      subscriptions_.push_back(node_.create_subscription<Cloud>(
          topic_of(lidars()[i]), QoS(edge_depth), [this, i](const Received& message) {
            const auto kept = std::make_shared<const Received>(message);
            on_cloud_(i, std::shared_ptr<const Cloud>(kept, kept->get()));
          }));
    }
    executor_.add_node(node_);
  }

  /// Both sides of agnocast match at the same time, and the senders check.
  bool is_matched() override { return true; }
  void run() override { executor_.spin(); }
  void stop() override { executor_.cancel(); }

 private:
  OnCloud on_cloud_;
  Node node_{"concatenate_data"};
  std::vector<Subscription<Cloud>::SharedPtr> subscriptions_;
  SingleThreadedExecutor executor_;
};

}  // namespace

const Edge agnocast_edge{
    .name = "agnocast-executor",
    .make_sender = [](const Lidar& lidar) -> std::unique_ptr<CloudSender> {
      return std::make_unique<AgnocastSender>(lidar);
    },
    .make_receiver = [](CloudReceiver::OnCloud on_cloud) -> std::unique_ptr<CloudReceiver> {
      return std::make_unique<AgnocastReceiver>(std::move(on_cloud));
    }};

}  // namespace agnocast::bench::pipeline
