// SPDX-License-Identifier: Apache-2.0
//
// Node: a name in the ROS graph, and the remap rules of its command line. Publishers,
// subscriptions, services and clients belong to a node by its name; so they can belong to any
// class that node_like.hpp describes, such as an rclcpp::Node.
#pragma once

#include <agnocast/callback_group.hpp>
#include <agnocast/client.hpp>
#include <agnocast/core_namespace.hpp>
#include <agnocast/export.hpp>
#include <agnocast/publisher.hpp>
#include <agnocast/qos.hpp>
#include <agnocast/result.hpp>
#include <agnocast/service.hpp>
#include <agnocast/subscription.hpp>
#include <agnocast/timer.hpp>

#include <chrono>
#include <memory>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

namespace agnocast {

AGNOCAST_CORE_BEGIN

/// Options of init(), with setters.
class InitOptions {
 public:
  /// False: init() writes nothing, and the program itself reports the result of
  /// ignored_ros_arguments() to its user.
  InitOptions& warn_of_ignored_arguments(bool wanted) noexcept { return warns_ = wanted, *this; }
  bool warns_of_ignored_arguments() const noexcept { return warns_; }

 private:
  bool warns_ = true;
};

/// Takes the ROS arguments of the command line (`--ros-args … --`) for all nodes created later;
/// the last call counts. Optional. It installs no signal handler. For each argument without
/// effect (ignored_ros_arguments) it writes a line to standard error, once in the life of the
/// process; the library writes nothing else anywhere. Throws Error: invalid_argument,
/// invalid_name.
AGNOCAST_PUBLIC void init(int argc, char const* const* argv, const InitOptions& options = {});
/// Returns the arguments without those for ROS; the program's name stays the first. Throws as
/// init().
[[nodiscard]] AGNOCAST_PUBLIC std::vector<std::string> remove_ros_arguments(
    int argc, char const* const* argv);
/// Returns the ROS arguments that agnocast accepts but that have no effect (parameters, enclaves,
/// log options), each with its value: {"-p rate:=10"}. Writes nothing. Throws as init().
[[nodiscard]] AGNOCAST_PUBLIC std::vector<std::string> ignored_ros_arguments(
    int argc, char const* const* argv);

/// Options of a node, with setters.
class NodeOptions {
 public:
  /// Sets ROS arguments for this node alone; its rules come before those of init(). As on a
  /// command line: {"--ros-args", "-r", "from:=to"}.
  NodeOptions& arguments(std::vector<std::string> arguments) {
    return arguments_ = std::move(arguments), *this;
  }
  /// False: this node ignores the arguments of init().
  NodeOptions& use_global_arguments(bool use) noexcept { return use_global_ = use, *this; }

  const std::vector<std::string>& arguments() const noexcept { return arguments_; }
  bool use_global_arguments() const noexcept { return use_global_; }

 private:
  std::vector<std::string> arguments_;
  bool use_global_ = true;
};

/// Names do not change after construction; any thread may call any function. A node and its
/// endpoints do not keep each other alive.
class AGNOCAST_PUBLIC Node {
 public:
  using SharedPtr = std::shared_ptr<Node>;

  /// A name is one token; a namespace begins with a slash (one is added if it is missing), and
  /// the empty one is "/". Remap rules change both. Throws Error: invalid_name (with the
  /// position), invalid_argument (for the arguments).
  explicit Node(const std::string& name, const NodeOptions& options = {});
  Node(const std::string& name, const std::string& node_namespace, const NodeOptions& options = {});
  virtual ~Node();
  Node(const Node&) = delete;
  Node& operator=(const Node&) = delete;

  const char* get_name() const noexcept;
  const char* get_namespace() const noexcept;
  const char* get_fully_qualified_name() const noexcept;

  /// Returns the ROS arguments without effect on this node, those of NodeOptions first, then
  /// those of init(): see ignored_ros_arguments(). Valid as long as the node.
  const std::vector<std::string>& ignored_arguments() const noexcept;

  /// Returns the fully qualified and remapped name of `topic` in this node. Errors: invalid_name.
  [[nodiscard]] Result<std::string> try_resolve_topic_name(const std::string& topic) const;
  /// The same; throws Error.
  std::string resolve_topic_name(const std::string& topic) const;
  /// The same for services.
  [[nodiscard]] Result<std::string> try_resolve_service_name(const std::string& service) const;
  std::string resolve_service_name(const std::string& service) const;

  /// The functions below are the free functions of callback_group.hpp, timer.hpp, publisher.hpp,
  /// subscription.hpp, service.hpp and client.hpp. They throw Error.
  CallbackGroup::SharedPtr create_callback_group(
      CallbackGroupType type, bool automatically_add_to_executor_with_node = true,
      const std::string& name = {}) {
    return agnocast::create_callback_group(*this, type, automatically_add_to_executor_with_node,
                                           name);
  }
  template <class Rep, class Period, class Callback>
  WallTimer::SharedPtr create_wall_timer(std::chrono::duration<Rep, Period> period,
                                         Callback&& callback,
                                         const CallbackGroup::SharedPtr& group = nullptr) {
    return core::create_wall_timer(*this, period, std::forward<Callback>(callback), group);
  }
  template <class T>
  typename Publisher<T>::SharedPtr create_publisher(const std::string& topic, const QoS& qos,
                                                    const PublisherOptions& options = {}) {
    return core::create_publisher<T>(*this, topic, qos, options);
  }
  template <class T, class Callback,
            class = std::enable_if_t<!std::is_same_v<std::decay_t<Callback>, SubscriptionOptions>>>
  typename Subscription<T>::SharedPtr create_subscription(const std::string& topic, const QoS& qos,
                                                          Callback&& callback,
                                                          const SubscriptionOptions& options = {}) {
    return core::create_subscription<T>(*this, topic, qos, std::forward<Callback>(callback),
                                        options);
  }
  template <class T>
  typename PollingSubscriber<T>::SharedPtr create_subscription(
      const std::string& topic, const QoS& qos, const SubscriptionOptions& options = {}) {
    return core::create_subscription<T>(*this, topic, qos, options);
  }
  template <class ServiceT, class Callback>
  typename Service<ServiceT>::SharedPtr create_service(
      const std::string& service, Callback&& callback, const QoS& qos = ServicesQoS(),
      const CallbackGroup::SharedPtr& group = nullptr) {
    return core::create_service<ServiceT>(*this, service, std::forward<Callback>(callback), qos,
                                          group);
  }
  template <class ServiceT>
  typename Client<ServiceT>::SharedPtr create_client(
      const std::string& service, const QoS& qos = ServicesQoS(),
      const CallbackGroup::SharedPtr& group = nullptr) {
    return core::create_client<ServiceT>(*this, service, qos, group);
  }

 private:
  struct Names;
  std::shared_ptr<const Names> names_;
};

AGNOCAST_CORE_END

}  // namespace agnocast
