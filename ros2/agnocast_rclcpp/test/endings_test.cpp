// SPDX-License-Identifier: Apache-2.0
//
// Goal: in an rclcpp node, callbacks of every kind (messages, requests, responses, events) begin
// with the spin and end with rclcpp::shutdown(); what they throw leaves the spin; and node,
// endpoints, group, executor and context may end in every order.
// Method: a node with a callback of each kind, and a peer in the same process that causes them.

#include "test_node.hpp"

#include <rclcpp/version.h>
#include <std_srvs/srv/trigger.hpp>

#include <gmock/gmock.h>

#include <algorithm>
#include <array>
#include <stdexcept>
#include <vector>

namespace agnocast_rclcpp {
namespace {

using namespace std::chrono_literals;
using Message = agnocast::ipc_shared_ptr<const String>;
using Trigger = std_srvs::srv::Trigger;
using Request = agnocast::ipc_shared_ptr<const Trigger::Request>;
using Response = agnocast::ipc_shared_ptr<Trigger::Response>;
using testing::Each;

class EndingsTest : public EveryExecutorTest {};
AGNOCAST_TEST_EXECUTORS(EndingsTest);

enum Kind { message, request, response, event, kind_count };
using Counts = std::array<int, kind_count>;

/// Publishes, requests and responds, in a thread of its own.
class Peer {
 public:
  void cause(Kind kind) {
    ASSERT_TRUE(eventually([&] { return publisher_->get_subscription_count() == 1; }));
    if (kind == message) {
      (void)publisher_->publish(String());
    } else if (kind == request) {
      ASSERT_TRUE(client_->wait_for_service(30s));
      (void)client_->async_send_request(client_->borrow_loaned_request());
    } else if (kind == event) {
      publisher_.reset();
      publisher_ = agnocast::create_publisher<String>(node_, "topic", 10);
    }
  }
  /// An event, and nobody there any more.
  void leave() { publisher_.reset(); }
  int responses() const { return responses_; }

 private:
  std::atomic<int> responses_{0};
  rclcpp::Node::SharedPtr node_ = std::make_shared<rclcpp::Node>("peer");
  agnocast::Publisher<String>::SharedPtr publisher_ =
      agnocast::create_publisher<String>(node_, "topic", 10);
  agnocast::Client<Trigger>::SharedPtr client_ =
      agnocast::create_client<Trigger>(node_, "of_all_kinds");
  agnocast::Service<Trigger>::SharedPtr service_ = agnocast::create_service<Trigger>(
      node_, "of_peer", [this](const Request&, Response&) { ++responses_; });
  rclcpp::executors::SingleThreadedExecutor executor_;
  struct Added {
    Added(rclcpp::Executor& executor, const rclcpp::Node::SharedPtr& node) {
      executor.add_node(node);
    }
  } added_{executor_, node_};
  SpinningThread spinning_{executor_};
};

/// A node with a callback of each kind. `throws`: the kind whose first callback does.
class AllKinds {
 public:
  explicit AllKinds(Kind throws = kind_count) : throws_(throws) {}

  rclcpp::Node::SharedPtr node() const { return node_; }
  Counts counts() const {
    Counts now{};
    for (int kind = 0; kind < kind_count; ++kind) now[kind] = counts_[kind];
    return now;
  }
  /// Returns when everything lies ready.
  void cause(Peer& peer, Kind kind) {
    if (kind == response) {
      ASSERT_TRUE(client_->wait_for_service(30s));
      const int before = peer.responses();
      (void)client_->async_send_request(client_->borrow_loaned_request(),
                                        [this](const auto&) { count(response); });
      ASSERT_TRUE(eventually([&] { return peer.responses() > before; }));
    } else {
      peer.cause(kind);
    }
  }
  void cause_all(Peer& peer) {
    for (const Kind kind : {message, request, response, event}) cause(peer, kind);
    std::this_thread::sleep_for(50ms);
  }

 private:
  void count(Kind kind) {
    if (++counts_[kind] == 1 && kind == throws_) throw std::runtime_error("from a callback");
  }

  const Kind throws_;
  std::array<std::atomic<int>, kind_count> counts_{};
  rclcpp::Node::SharedPtr node_ = std::make_shared<rclcpp::Node>("all_kinds");
  agnocast::Subscription<String>::SharedPtr subscription_ = agnocast::create_subscription<String>(
      node_, "topic", 10, [this](const Message&) { count(message); },
      agnocast::SubscriptionOptions().matched_callback(
          [this](agnocast::MatchedInfo&) { count(event); }));
  agnocast::Service<Trigger>::SharedPtr service_ = agnocast::create_service<Trigger>(
      node_, "of_all_kinds", [this](const Request&, Response&) { count(request); });
  agnocast::Client<Trigger>::SharedPtr client_ = agnocast::create_client<Trigger>(node_, "of_peer");
};

TEST_P(EndingsTest, NothingOfAnyKindRunsBeforeTheSpin) {
  Peer peer;
  AllKinds all;
  all.cause_all(peer);
  EXPECT_THAT(all.counts(), Each(0));
  executor_->add_node(all.node());
  std::this_thread::sleep_for(50ms);
  EXPECT_THAT(all.counts(), Each(0));
  const SpinningThread spinning(*executor_);
  for (int kind = 0; kind < kind_count; ++kind)
    EXPECT_TRUE(eventually([&] { return all.counts()[kind] > 0; })) << kind;
}

TEST_P(EndingsTest, NothingOfAnyKindRunsAfterShutdown) {
  Peer peer;
  AllKinds all;
  executor_->add_node(all.node());
  std::thread spinning([&] { executor_->spin(); });
  all.cause_all(peer);
  for (int kind = 0; kind < kind_count; ++kind)
    EXPECT_TRUE(eventually([&] { return all.counts()[kind] > 0; })) << kind;
  std::this_thread::sleep_for(50ms);
  rclcpp::shutdown();
  spinning.join();
  const Counts before = all.counts();
  for (const Kind kind : {message, request}) all.cause(peer, kind);
  peer.leave();
  std::this_thread::sleep_for(50ms);
  for (int i = 0; i < 5; ++i) executor_->spin_once(10ms);
  executor_->spin_some();
  EXPECT_EQ(all.counts(), before);
}

TEST_P(EndingsTest, NothingBeginsOnceACallbackHasShutDown) {
  Source source;
  const auto node = std::make_shared<rclcpp::Node>("node");
  std::atomic<int> begun{0}, begun_after{0};
  std::atomic<bool> is_shut_down{false};
  std::vector<rclcpp::CallbackGroup::SharedPtr> groups;
  std::vector<agnocast::Subscription<String>::SharedPtr> subscriptions;
  for (int i = 0; i < 2; ++i) {
    rclcpp::SubscriptionOptions options;
    groups.push_back(node->create_callback_group(rclcpp::CallbackGroupType::MutuallyExclusive));
    options.callback_group = groups.back();
    subscriptions.push_back(agnocast::create_subscription<String>(
        node, "topic", 1000,
        [&](const Message&) {
          if (is_shut_down) ++begun_after;
          if (++begun != 1) return;
          rclcpp::shutdown();
          is_shut_down = true;
        },
        options));
  }
  executor_->add_node(node);
  source.publish(100, 2);
  executor_->spin();
  EXPECT_GE(begun, 1);
  // Another thread may be about to begin the callback of the other group.
  EXPECT_LE(begun_after, GetParam() == &multi_threaded(4) ? 1 : 0);
}

TEST_P(EndingsTest, AnExceptionOfEachKindLeavesTheSpinAndTheNextOneGoesOn) {
  for (const Kind kind : {message, request, response, event}) {
    Peer peer;
    AllKinds all(kind);
    executor_ = GetParam()->make();
    executor_->add_node(all.node());
    all.cause(peer, kind);
    if (GetParam() == &multi_threaded(4)) {
      // Humble's other threads end with std::terminate(), so only the spinning one is asked.
      EXPECT_THROW(while (all.counts()[kind] < 2) executor_->spin_once(), std::runtime_error)
          << kind;
    } else {
      EXPECT_THROW(executor_->spin(), std::runtime_error) << kind;
    }
    EXPECT_EQ(all.counts()[kind], 1) << kind;
    const SpinningThread spinning(*executor_);
    all.cause(peer, kind);
    EXPECT_TRUE(eventually([&] { return all.counts()[kind] >= 2; })) << kind;
  }
}

/// What ends, one after the other.
class Ends {
 public:
  enum What { node, endpoints, group, executor, context, what_count };

  explicit Ends(const ExecutorKind& kind) {
    rclcpp::InitOptions options;
    options.auto_initialize_logging(false);  // it is already
    context_ = std::make_shared<rclcpp::Context>();
    context_->init(0, nullptr, options);
    node_ = std::make_shared<rclcpp::Node>("ends", rclcpp::NodeOptions().context(context_));
    group_ = node_->create_callback_group(rclcpp::CallbackGroupType::MutuallyExclusive);
    rclcpp::SubscriptionOptions in_group;
    in_group.callback_group = group_;
    subscription_ = agnocast::create_subscription<String>(
        node_, "topic", 10, [this](const Message&) { ++heard_; }, in_group);
    service_ = agnocast::create_service<Trigger>(
        node_, "service", [](const Request&, Response&) {}, rclcpp::ServicesQoS(), group_);
    client_ = agnocast::create_client<Trigger>(node_, "service", rclcpp::ServicesQoS(), group_);
    rclcpp::ExecutorOptions in_context;
    in_context.context = context_;
    executor_ = kind.make_with(in_context);
    executor_->add_node(node_);
  }
  int heard() const { return heard_; }
  void spin() {
    if (executor_ != nullptr) executor_->spin_some();
  }
  void end(What what) {
    if (what == node) node_.reset();
    if (what == endpoints) subscription_.reset(), service_.reset(), client_.reset();
    if (what == group) group_.reset();
    if (what == executor) executor_.reset();
    if (what == context) {
      context_->shutdown("it ends here");
      context_.reset();
    }
  }

 private:
  std::atomic<int> heard_{0};
  rclcpp::Context::SharedPtr context_;
  rclcpp::Node::SharedPtr node_;
  rclcpp::CallbackGroup::SharedPtr group_;
  agnocast::Subscription<String>::SharedPtr subscription_;
  agnocast::Service<Trigger>::SharedPtr service_;
  agnocast::Client<Trigger>::SharedPtr client_;
  std::unique_ptr<rclcpp::Executor> executor_;
};

TEST_P(EndingsTest, TheyComeInEveryOrder) {
  std::vector<Ends::What> order{Ends::node, Ends::endpoints, Ends::group, Ends::executor,
                                Ends::context};
  Source source;
  do {
    Ends ends(*GetParam());
    ASSERT_TRUE(eventually([&] {
      source.publish_to_any();  // it may still count the subscription before
      ends.spin();
      return ends.heard() > 0;
    }));
    bool is_over = false;
    for (const Ends::What what : order) {
      ends.end(what);
      // Humble's static executor goes on with what it has found in a node or group that is gone,
      // and Jazzy's executors with what they have found in a node.
      const bool is_static = GetParam() == &static_single_threaded;
      const bool goes_on = what == Ends::node ? is_static || RCLCPP_VERSION_MAJOR >= 28
                                              : what == Ends::group && is_static;
      is_over = is_over || !goes_on;
      const int before = ends.heard();
      source.publish_to_any();
      ends.spin();
      if (is_over) {
        ASSERT_EQ(ends.heard(), before) << "after the end of " << what;
      }
    }
  } while (std::next_permutation(order.begin(), order.end()));
}

}  // namespace
}  // namespace agnocast_rclcpp
