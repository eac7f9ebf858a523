// SPDX-License-Identifier: Apache-2.0
//
// Nodes and guard conditions.

#include <ros2/rmw_agnocast_cpp/src/common.hpp>

#include <rmw/validate_namespace.h>
#include <rmw/validate_node_name.h>

#include <algorithm>

using namespace agnocast;
using namespace agnocast::rmw;

GraphWatch& rmw_context_impl_s::graph() {
  const std::lock_guard lock(watching_);
  if (graph_ == nullptr) {
    graph_ = std::make_unique<GraphWatch>(domain, [this] {
      const std::lock_guard changing(mutex);
      tell_nodes();
    });
  }
  return *graph_;
}

extern "C" {

rmw_node_t* rmw_create_node(rmw_context_t* context, const char* name, const char* namespace_) {
  RMW_CHECK_ARGUMENT_FOR_NULL(context, nullptr);
  RMW_CHECK_ARGUMENT_FOR_NULL(name, nullptr);
  RMW_CHECK_ARGUMENT_FOR_NULL(namespace_, nullptr);
  RMW_CHECK_TYPE_IDENTIFIERS_MATCH(context, context->implementation_identifier, identifier,
                                   return nullptr);
  RMW_CHECK_FOR_NULL_WITH_MSG(context->impl, "the context is not initialized", return nullptr);
  if (context->impl->is_shut_down) {
    RMW_SET_ERROR_MSG("the context is shut down");
    return nullptr;
  }
  int result = RMW_NODE_NAME_VALID;
  if (rmw_validate_node_name(name, &result, nullptr) != RMW_RET_OK) return nullptr;
  if (result != RMW_NODE_NAME_VALID) {
    RMW_SET_ERROR_MSG(rmw_node_name_validation_result_string(result));
    return nullptr;
  }
  if (rmw_validate_namespace(namespace_, &result, nullptr) != RMW_RET_OK) return nullptr;
  if (result != RMW_NAMESPACE_VALID) {
    RMW_SET_ERROR_MSG(rmw_namespace_validation_result_string(result));
    return nullptr;
  }
  rmw_node_t* const node = rmw_node_allocate();
  const rmw_ret_t made = guarded([&] {
    if (node == nullptr) throw std::bad_alloc();
    if (context->impl->is_in_child())
      return refuse(RMW_RET_ERROR, "a forked child has no nodes: initialize a context there");
    auto data = std::make_unique<NodeData>();
    data->name = {name, namespace_, context->impl->domain};
    *node = {};
    node->implementation_identifier = identifier;
    node->context = context;
    node->name = copied_text(name);
    node->namespace_ = copied_text(namespace_);
    data->graph_guard.implementation_identifier = identifier;
    data->graph_guard.context = context;
    data->graph_guard.data = &data->graph_changed;
    if (node->name == nullptr || node->namespace_ == nullptr) throw std::bad_alloc();
    (void)context->impl->graph();
    const std::lock_guard lock(context->impl->mutex);
    context->impl->nodes.push_back(data.get());
    node->data = data.release();
    context->impl->tell_nodes();
    return rmw_ret_t{RMW_RET_OK};
  });
  if (made == RMW_RET_OK) return node;
  if (node != nullptr) {
    rmw_free(const_cast<char*>(node->name));
    rmw_free(const_cast<char*>(node->namespace_));
    rmw_node_free(node);
  }
  return nullptr;
}

rmw_ret_t rmw_destroy_node(rmw_node_t* node) {
  AGNOCAST_RMW_OURS(node);
  auto* const data = static_cast<NodeData*>(node->data);
  rmw_context_impl_s& context = *node->context->impl;
  if (!context.is_in_child()) {
    const std::lock_guard lock(context.mutex);
    context.nodes.erase(std::remove(context.nodes.begin(), context.nodes.end(), data),
                        context.nodes.end());
    context.tell_nodes();
  }
  delete data;
  rmw_free(const_cast<char*>(node->name));
  rmw_free(const_cast<char*>(node->namespace_));
  rmw_node_free(node);
  return RMW_RET_OK;
}

rmw_ret_t rmw_node_assert_liveliness(const rmw_node_t* node) {
  AGNOCAST_RMW_OURS(node);
  return RMW_RET_OK;
}

const rmw_guard_condition_t* rmw_node_get_graph_guard_condition(const rmw_node_t* node) {
  RMW_CHECK_ARGUMENT_FOR_NULL(node, nullptr);
  RMW_CHECK_TYPE_IDENTIFIERS_MATCH(node, node->implementation_identifier, identifier,
                                   return nullptr);
  return &data_of<NodeData>(node).graph_guard;
}

rmw_guard_condition_t* rmw_create_guard_condition(rmw_context_t* context) {
  RMW_CHECK_ARGUMENT_FOR_NULL(context, nullptr);
  RMW_CHECK_TYPE_IDENTIFIERS_MATCH(context, context->implementation_identifier, identifier,
                                   return nullptr);
  rmw_guard_condition_t* const made = rmw_guard_condition_allocate();
  auto* const condition = new (std::nothrow) Condition;
  if (made == nullptr || condition == nullptr) {
    if (made != nullptr) rmw_guard_condition_free(made);
    delete condition;
    RMW_SET_ERROR_MSG("there is no memory left");
    return nullptr;
  }
  *made = {};
  made->implementation_identifier = identifier;
  made->context = context;
  made->data = condition;
  return made;
}

rmw_ret_t rmw_destroy_guard_condition(rmw_guard_condition_t* guard_condition) {
  AGNOCAST_RMW_OURS(guard_condition);
  delete static_cast<Condition*>(guard_condition->data);
  rmw_guard_condition_free(guard_condition);
  return RMW_RET_OK;
}

rmw_ret_t rmw_trigger_guard_condition(const rmw_guard_condition_t* guard_condition) {
  AGNOCAST_RMW_OURS(guard_condition);
  static_cast<Condition*>(guard_condition->data)->trigger();
  return RMW_RET_OK;
}

}  // extern "C"
