// SPDX-License-Identifier: Apache-2.0
//
// load PACKAGE PLUGIN…    loads components into the container /ComponentManager
// load --unload           unloads all of its components

#include <composition_interfaces/srv/list_nodes.hpp>
#include <composition_interfaces/srv/load_node.hpp>
#include <composition_interfaces/srv/unload_node.hpp>
#include <rclcpp/rclcpp.hpp>

#include <cstdio>
#include <string>

namespace {

template <class Service>
typename Service::Response::SharedPtr call(const rclcpp::Node::SharedPtr& node,
                                           const std::string& name,
                                           typename Service::Request::SharedPtr request) {
  const auto client = node->create_client<Service>("/ComponentManager/_container/" + name);
  if (!client->wait_for_service(std::chrono::seconds(120))) return nullptr;
  auto sent = client->async_send_request(std::move(request));
  if (rclcpp::spin_until_future_complete(node, sent, std::chrono::seconds(120)) !=
      rclcpp::FutureReturnCode::SUCCESS)
    return nullptr;
  return sent.get();
}

int fail(const std::string& what) {
  std::printf("load: %s failed\n", what.c_str());
  return 1;
}

}  // namespace

int main(int argc, char** argv) {
  using namespace composition_interfaces::srv;
  rclcpp::init(argc, argv);
  const auto node = std::make_shared<rclcpp::Node>("load");
  if (argc == 2 && std::string(argv[1]) == "--unload") {
    const auto list = call<ListNodes>(node, "list_nodes", std::make_shared<ListNodes::Request>());
    if (list == nullptr || list->unique_ids.empty()) return fail("listing");
    for (const std::uint64_t id : list->unique_ids) {
      auto request = std::make_shared<UnloadNode::Request>();
      request->unique_id = id;
      const auto response = call<UnloadNode>(node, "unload_node", request);
      if (response == nullptr || !response->success) return fail("unloading");
    }
    return 0;
  }
  for (int i = 2; i < argc; ++i) {
    auto request = std::make_shared<LoadNode::Request>();
    request->package_name = argv[1];
    request->plugin_name = argv[i];
    const auto response = call<LoadNode>(node, "load_node", request);
    if (response == nullptr || !response->success) return fail(argv[i]);
  }
  return 0;
}
