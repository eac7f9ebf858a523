// SPDX-License-Identifier: Apache-2.0

#include <agnocast/node/agnocast_node.hpp>

#include <agnocast/graph.hpp>
#include <agnocastlib/forked_child.hpp>

#include <chrono>
#include <cstddef>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <utility>

namespace agnocast {
namespace {

using Clock = std::chrono::steady_clock;

// Of one answer. agnocastd gives a user 20 a second, and each lists all endpoints of the host.
constexpr std::chrono::milliseconds age_max{100};
// How long a first answer may take.
constexpr std::chrono::seconds patience{5};
// agnocastd serves eight observers of a user at once, each for a few milliseconds.
constexpr std::chrono::milliseconds pause_of_refused{20};

/// What agnocastd has said last, for all nodes of the process. It is asked over a connection that
/// ends with the answer, so that any number of processes can ask. Any thread.
class LastGraph {
 public:
  /// Never destroyed, for nodes in statics.
  static LastGraph& instance() {
    static auto* const only = new LastGraph;
    return *only;
  }
  /// Returns the endpoints of this host, as they were at most `age_max` ago, or longer if agnocastd
  /// has too many observers of this user. Throws Error.
  std::shared_ptr<const GraphSnapshot> get() {
    const std::lock_guard lock(mutex_);
    const Clock::time_point start = Clock::now();
    if (last_ != nullptr && start - asked_ < age_max) return last_;
    for (;;) {
      const Clock::time_point asked = Clock::now();
      Graph graph;  // a new connection gets the present state
      auto state = graph.wait(patience);
      if (state && state->has_value()) {
        last_ = std::make_shared<const GraphSnapshot>(std::move(**state));
        asked_ = asked;
        return last_;
      }
      const Failure why =
          state ? Failure{Errc::daemon_not_running, 0, "it gave no answer", 0} : state.error();
      const bool is_full = why.code == Errc::quota_exceeded || why.code == Errc::limit_reached;
      if (is_full && last_ != nullptr) return last_;
      if (!is_full || asked - start > patience) detail::throw_error(why);
      std::this_thread::sleep_for(pause_of_refused);
    }
  }

 private:
  std::mutex mutex_;
  std::shared_ptr<const GraphSnapshot> last_;  // null: none yet
  Clock::time_point asked_;                    // before it
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
