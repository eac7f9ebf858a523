// SPDX-License-Identifier: Apache-2.0

#include <agnocast/node/agnocast_node.hpp>

#include <agnocast/graph.hpp>
#include <agnocastlib/forked_child.hpp>

#include <chrono>
#include <cstddef>
#include <memory>
#include <mutex>
#include <string>
#include <utility>

namespace agnocast {
namespace {

/// The endpoints of this host, for all nodes of the process. Any thread.
class LastGraph {
 public:
  /// Never destroyed, for nodes in statics.
  static LastGraph& instance() {
    static auto* const only = new LastGraph;
    return *only;
  }
  /// Returns the present endpoints. Throws Error.
  std::shared_ptr<const GraphSnapshot> get() {
    const std::lock_guard lock(mutex_);
    auto state = graph_.wait(std::chrono::milliseconds{last_ != nullptr ? 0 : 5'000});
    // A daemon that is started again is no error.
    const bool is_away = !state && state.error().code == Errc::daemon_not_running;
    if (!state && !(is_away && last_ != nullptr)) detail::throw_error(state.error());
    if (state && *state) last_ = std::make_shared<const GraphSnapshot>(std::move(**state));
    if (last_ == nullptr)
      detail::throw_error(Failure{Errc::daemon_not_running, 0, "it gave no answer", 0});
    return last_;
  }

 private:
  std::mutex mutex_;
  Graph graph_;
  std::shared_ptr<const GraphSnapshot> last_;  // null: none yet
};

std::size_t count(const rclcpp::Node& node, const std::string& topic, EndpointKind kind) {
  if (agnocastlib::is_forked_child())
    detail::throw_error(Failure{Errc::shut_down, 0, "this process was forked", 0});
  auto& writable = const_cast<rclcpp::Node&>(node);  // its getters are not const
  const std::string name = writable.get_node_topics_interface()->resolve_topic_name(topic);
  const std::size_t domain = writable.get_node_base_interface()->get_context()->get_domain_id();
  const std::shared_ptr<const GraphSnapshot> graph = LastGraph::instance().get();
  std::size_t found = 0;
  for (const EndpointInfo& endpoint : graph->endpoints)
    found += endpoint.topic == name && endpoint.kind == kind && endpoint.domain == domain;
  return found;
}

}  // namespace

std::size_t Node::count_publishers(const std::string& topic_name) const {
  return count(*this, topic_name, EndpointKind::publisher);
}
std::size_t Node::count_subscribers(const std::string& topic_name) const {
  return count(*this, topic_name, EndpointKind::subscription);
}

void init(int argc, char const* const* argv) {
  if (!rclcpp::contexts::get_global_default_context()->is_valid()) rclcpp::init(argc, argv);
}
bool ok() { return rclcpp::ok(); }
void shutdown() { (void)rclcpp::shutdown(); }

}  // namespace agnocast
