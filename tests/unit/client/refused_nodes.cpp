// SPDX-License-Identifier: Apache-2.0
//
// Goal: the compiler refuses an rclcpp node without the adapter, in plain words, instead of running
// its callbacks beside rclcpp's. Method: as refused_types.cpp. The node here has the members of
// rclcpp::Node by which the library knows it.

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

#if defined(CASE_base_interface)
using Node = refused::NodeBaseInterface;
#elif defined(CASE_publisher) || defined(CASE_subscription) || defined(CASE_polling) || \
    defined(CASE_generic) || defined(CASE_service) || defined(CASE_client) ||           \
    defined(CASE_executor) || defined(CASE_group) || defined(CASE_timer)
using Node = refused::RclcppNode;
#else
#define CASE_NONE
using Node = refused::OtherNode;
#endif

void use(const std::shared_ptr<Node>& node);
void use([[maybe_unused]] const std::shared_ptr<Node>& node) {
  using namespace refused;
#if defined(CASE_publisher) || defined(CASE_NONE)
  agnocast::create_publisher<Message>(node, "topic", 10);
#endif
#if defined(CASE_subscription) || defined(CASE_NONE)
  agnocast::create_subscription<Message>(*node, "topic", 10,
                                         [](const agnocast::ipc_shared_ptr<const Message>&) {});
#endif
#if defined(CASE_polling) || defined(CASE_NONE)
  agnocast::create_subscription<Message>(node.get(), "topic", 10);
#endif
#if defined(CASE_generic) || defined(CASE_NONE)
  agnocast::create_generic_subscription(node, "topic", agnocast::TypeIdentity{"pkg/msg/Type", 1},
                                        10);
#endif
#if defined(CASE_service) || defined(CASE_NONE)
  agnocast::create_service<Service>(node, "service",
                                    [](const agnocast::ipc_shared_ptr<const Service::Request>&,
                                       agnocast::ipc_shared_ptr<Service::Response>&) {});
#endif
#if defined(CASE_client) || defined(CASE_NONE)
  agnocast::create_client<Service>(node, "service");
#endif
#if defined(CASE_executor) || defined(CASE_base_interface) || defined(CASE_NONE)
  agnocast::SingleThreadedExecutor().add_node(node);
#endif
#if defined(CASE_group) || defined(CASE_NONE)
  agnocast::create_callback_group(node, agnocast::CallbackGroupType::Reentrant);
#endif
#if defined(CASE_timer) || defined(CASE_NONE)
  agnocast::create_wall_timer(node, std::chrono::seconds(1), [] {});
#endif
}
