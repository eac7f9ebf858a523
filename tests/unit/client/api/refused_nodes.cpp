// SPDX-License-Identifier: Apache-2.0
//
// Goal: the compiler refuses an rclcpp node without the adapter, in plain words, instead of running
// its callbacks beside rclcpp's. Method: as refused_types.cpp; without REFUSED_CASES the node is
// another one. The node here has the members of rclcpp::Node by which the library knows it.

#include <agnocast/agnocast.hpp>
#include <agnocast/generic.hpp>

#include <chrono>
#include <memory>
#include <string>

namespace refused {

struct Message {
  int number;
};
struct Service {
  struct Request {};
  struct Response {};
};

struct NodeBaseInterface {
  const char* get_fully_qualified_name() const { return "/node"; }
  void* get_rcl_node_handle() { return nullptr; }
};
template <class Case>
struct RclcppNode {
  std::shared_ptr<NodeBaseInterface> get_node_base_interface() const { return nullptr; }
  std::string get_name() const { return "node"; }
  std::string get_namespace() const { return "/"; }
  std::string get_fully_qualified_name() const { return "/node"; }
};
struct OtherNode {
  std::string get_name() const { return "node"; }
  std::string get_namespace() const { return "/"; }
  std::string get_fully_qualified_name() const { return "/node"; }
};

}  // namespace refused

// Each of these is refused with its sentence.
#if defined(REFUSED_CASES)
#define REFUSED(name, sentence, body)                                                            \
  void name##_is_refused(const std::shared_ptr<refused::RclcppNode<struct name##_case>>& node) { \
    using namespace refused;                                                                     \
    body                                                                                         \
  }
#else
#define REFUSED(name, sentence, body)                                       \
  void name##_is_allowed(const std::shared_ptr<refused::OtherNode>& node) { \
    using namespace refused;                                                \
    body                                                                    \
  }
#endif

REFUSED(publisher,
        "the callbacks of an rclcpp node run in rclcpp's executors: include "
        "<agnocast_rclcpp/agnocast_rclcpp.hpp>",
        agnocast::create_publisher<Message>(node, "topic", 10);)
REFUSED(subscription,
        "the callbacks of an rclcpp node run in rclcpp's executors: include "
        "<agnocast_rclcpp/agnocast_rclcpp.hpp>",
        agnocast::create_subscription<Message>(*node, "topic", 10,
                                               [](const agnocast::ipc_shared_ptr<const Message>&) {
                                               });)
REFUSED(polling,
        "the callbacks of an rclcpp node run in rclcpp's executors: include "
        "<agnocast_rclcpp/agnocast_rclcpp.hpp>",
        agnocast::create_subscription<Message>(node.get(), "topic", 10);)
REFUSED(generic,
        "the callbacks of an rclcpp node run in rclcpp's executors: include "
        "<agnocast_rclcpp/agnocast_rclcpp.hpp>",
        agnocast::create_generic_subscription(node, "topic",
                                              agnocast::TypeIdentity{"pkg/msg/Type", 1}, 10);)
REFUSED(
    service,
    "the callbacks of an rclcpp node run in rclcpp's executors: include "
    "<agnocast_rclcpp/agnocast_rclcpp.hpp>",
    agnocast::create_service<Service>(node, "service",
                                      [](const agnocast::ipc_shared_ptr<const Service::Request>&,
                                         agnocast::ipc_shared_ptr<Service::Response>&) {});)
REFUSED(client,
        "the callbacks of an rclcpp node run in rclcpp's executors: include "
        "<agnocast_rclcpp/agnocast_rclcpp.hpp>",
        agnocast::create_client<Service>(node, "service");)
REFUSED(executor, "the callbacks of an rclcpp node run in rclcpp's executors",
        agnocast::SingleThreadedExecutor().add_node(node);)
REFUSED(group, "an rclcpp node makes rclcpp's callback groups",
        agnocast::create_callback_group(node, agnocast::CallbackGroupType::Reentrant);)
REFUSED(timer, "an rclcpp node makes rclcpp's timers",
        agnocast::create_wall_timer(node, std::chrono::seconds(1), [] {});)
#if defined(REFUSED_CASES)
REFUSED(base_interface, "the callbacks of an rclcpp node run in rclcpp's executors",
        agnocast::SingleThreadedExecutor().add_node(std::make_shared<NodeBaseInterface>());)
#endif
