// SPDX-License-Identifier: Apache-2.0
//
// CallbackIsolatedAgnocastExecutor: one single-threaded executor of rclcpp's, in a thread, for each
// callback group. The thread that calls spin() runs no callback. It starts and ends the others: for
// a group that is found or added, and for one that is removed or gone.

#include <agnocast/agnocast_callback_isolated_executor.hpp>

#include <pthread.h>

#include <algorithm>
#include <chrono>
#include <condition_variable>
#include <cstddef>
#include <exception>
#include <list>
#include <map>
#include <mutex>
#include <stdexcept>
#include <string>
#include <thread>
#include <utility>
#include <vector>

namespace agnocast {
namespace {

using Group = rclcpp::CallbackGroup;
using NodeBase = rclcpp::node_interfaces::NodeBaseInterface;

/// The thread of one group.
struct Child {
  explicit Child(const rclcpp::ExecutorOptions& options) : executor(options) {}

  Group::WeakPtr group;
  rclcpp::executors::SingleThreadedExecutor executor;
  std::thread thread;
  bool is_done = false;  // under the executor's mutex; the thread takes it no more

  /// Asks the thread to end after the running callback. Lost if the thread has not begun to spin.
  void cancel() noexcept {
    try {
      executor.cancel();
    } catch (const std::exception&) {
      // The context was shut down, which ends the thread as well.
    }
  }
};

/// How long the thread in spin() waits for children that it has asked to end before it asks again.
constexpr std::chrono::milliseconds pause_of_ending{1};

bool is_same(const Group::WeakPtr& a, const Group::WeakPtr& b) noexcept {
  return !a.owner_before(b) && !b.owner_before(a);
}

[[noreturn]] void refuse_single_calls() {
  throw std::logic_error(
      "CallbackIsolatedAgnocastExecutor: callbacks have threads of their own, so only spin() can "
      "run them");
}

}  // namespace

struct CallbackIsolatedAgnocastExecutor::State {
  rclcpp::Context::SharedPtr context;
  std::chrono::milliseconds interval;

  std::mutex mutex;  // never held while a callback is waited for
  std::condition_variable changed;
  bool is_woken = false;  // something for the thread in spin()
  std::list<NodeBase::WeakPtr> nodes;
  std::map<Group::WeakPtr, NodeBase::WeakPtr, std::owner_less<Group::WeakPtr>> groups;
  std::list<std::unique_ptr<Child>> children;  // only the thread in spin() adds and erases
  std::exception_ptr failure;

  void wake() {
    is_woken = true;
    changed.notify_all();
  }
  bool has_node(const NodeBase::SharedPtr& node) const {
    return std::any_of(nodes.begin(), nodes.end(),
                       [&](const NodeBase::WeakPtr& weak) { return weak.lock() == node; });
  }
  Child* child_of(const Group::WeakPtr& group) const {
    for (const auto& child : children)
      if (is_same(child->group, group)) return child.get();
    return nullptr;
  }
  /// Calls see(group, node) for every group that is to have a thread.
  template <class See>
  void for_each_group(See see) const {
    for (const auto& [weak_group, weak_node] : groups) {
      const auto group = weak_group.lock();
      const auto node = weak_node.lock();
      if (group != nullptr && node != nullptr) see(group, node);
    }
    for (const NodeBase::WeakPtr& weak : nodes) {
      const auto node = weak.lock();
      if (node == nullptr) continue;
      node->for_each_callback_group([&](const Group::SharedPtr& group) {
        if (group->automatically_add_to_executor_with_node() && groups.count(group) == 0)
          see(group, node);
      });
    }
  }
  std::vector<Group::WeakPtr> wanted_groups() const {
    std::vector<Group::WeakPtr> wanted;
    for_each_group([&](const Group::SharedPtr& group, const NodeBase::SharedPtr&) {
      wanted.push_back(group);
    });
    return wanted;
  }
  /// Erases the children that have ended and asks those of no `wanted` group to end. Returns
  /// whether some have not ended yet. Does not wait for them: a callback of one may itself wait for
  /// the end of another, in remove_node().
  bool end_all_but(const std::vector<Group::WeakPtr>& wanted) {
    bool some_run = false;
    const auto has_ended = [](const auto& child) {
      if (child->is_done) child->thread.join();
      return child->is_done;
    };
    const std::size_t before = children.size();
    children.remove_if(has_ended);
    if (children.size() != before) changed.notify_all();
    for (const auto& child : children) {
      const bool is_wanted = std::any_of(wanted.begin(), wanted.end(), [&](const auto& group) {
        return is_same(group, child->group);
      });
      if (is_wanted) continue;
      child->cancel();
      some_run = true;
    }
    return some_run;
  }
  void start_missing() {
    for_each_group([&](const Group::SharedPtr& group, const NodeBase::SharedPtr& node) {
      // A group of a node of ours may be in another executor.
      if (child_of(group) == nullptr && !group->get_associated_with_executor_atomic())
        start(group, node);
    });
  }
  void start(const Group::SharedPtr& group, const NodeBase::SharedPtr& node) {
    rclcpp::ExecutorOptions options;  // each with a memory strategy of its own
    options.context = context;
    auto child = std::make_unique<Child>(options);
    child->group = group;
    child->executor.add_callback_group(group, node, false);
    Child& run = *child;
    children.push_back(std::move(child));
    try {
      run.thread = std::thread([this, &run] {
        try {
          run.executor.spin();
        } catch (...) {
          const std::lock_guard lock(mutex);
          if (failure == nullptr) failure = std::current_exception();
        }
        const std::lock_guard lock(mutex);
        run.is_done = true;
        wake();
      });
    } catch (...) {
      children.pop_back();
      throw;
    }
    const std::string name = std::string(node->get_name()).substr(0, 15);
    ::pthread_setname_np(run.thread.native_handle(), name.c_str());
  }
  /// Waits until none of `ended` has a thread, but for the calling one.
  void wait_for_end_of(std::unique_lock<std::mutex>& lock,
                       const std::vector<Group::WeakPtr>& ended) {
    wake();
    changed.wait(lock, [&] {
      return std::none_of(ended.begin(), ended.end(), [&](const auto& group) {
        const Child* const child = child_of(group);
        return child != nullptr && child->thread.get_id() != std::this_thread::get_id();
      });
    });
  }
};

CallbackIsolatedAgnocastExecutor::CallbackIsolatedAgnocastExecutor(
    const rclcpp::ExecutorOptions& options, int, int monitor_polling_interval_ms)
    : Executor(options), state_(std::make_unique<State>()) {
  state_->context = options.context;
  state_->interval = std::chrono::milliseconds(std::max(monitor_polling_interval_ms, 1));
}

CallbackIsolatedAgnocastExecutor::~CallbackIsolatedAgnocastExecutor() {
  for (const NodeBase::WeakPtr& weak : state_->nodes)
    if (const auto node = weak.lock()) node->get_associated_with_executor_atomic() = false;
}

void CallbackIsolatedAgnocastExecutor::spin() {
  if (spinning.exchange(true)) throw std::runtime_error("spin() called while already spinning");
  State& state = *state_;
  std::unique_lock lock(state.mutex);
  state.failure = nullptr;
  while (rclcpp::ok(context_) && spinning && state.failure == nullptr) {
    const bool some_end = state.end_all_but(state.wanted_groups());
    try {
      state.start_missing();
    } catch (...) {
      state.failure = std::current_exception();
      break;
    }
    state.changed.wait_for(lock, some_end ? pause_of_ending : state.interval,
                           [&] { return state.is_woken; });
    state.is_woken = false;
  }
  while (state.end_all_but({})) state.changed.wait_for(lock, pause_of_ending);
  spinning = false;
  const std::exception_ptr failure = std::exchange(state.failure, nullptr);
  lock.unlock();
  if (failure != nullptr) std::rethrow_exception(failure);
}

void CallbackIsolatedAgnocastExecutor::cancel() {
  spinning = false;
  const std::lock_guard lock(state_->mutex);
  state_->wake();
}

void CallbackIsolatedAgnocastExecutor::add_callback_group(Group::SharedPtr group_ptr,
                                                          NodeBase::SharedPtr node_ptr, bool) {
  const std::lock_guard lock(state_->mutex);
  if (group_ptr->get_associated_with_executor_atomic() || state_->groups.count(group_ptr) != 0)
    throw std::runtime_error("Callback group has already been added to an executor.");
  state_->groups.emplace(group_ptr, node_ptr);
  state_->wake();
}

void CallbackIsolatedAgnocastExecutor::remove_callback_group(Group::SharedPtr group_ptr, bool) {
  std::unique_lock lock(state_->mutex);
  if (state_->groups.erase(group_ptr) == 0)
    throw std::runtime_error("Callback group needs to be associated with executor.");
  state_->wait_for_end_of(lock, {group_ptr});
}

void CallbackIsolatedAgnocastExecutor::add_node(NodeBase::SharedPtr node_ptr, bool) {
  if (node_ptr->get_associated_with_executor_atomic().exchange(true))
    throw std::runtime_error("Node has already been added to an executor.");
  const std::lock_guard lock(state_->mutex);
  state_->nodes.push_back(node_ptr);
  state_->wake();
}
void CallbackIsolatedAgnocastExecutor::add_node(rclcpp::Node::SharedPtr node_ptr, bool notify) {
  add_node(node_ptr->get_node_base_interface(), notify);
}

void CallbackIsolatedAgnocastExecutor::remove_node(NodeBase::SharedPtr node_ptr, bool) {
  std::unique_lock lock(state_->mutex);
  if (!state_->has_node(node_ptr))
    throw std::runtime_error("Node needs to be associated with this executor.");
  std::vector<Group::WeakPtr> ended;
  node_ptr->for_each_callback_group([&](const Group::SharedPtr& group) {
    if (state_->groups.count(group) == 0) ended.emplace_back(group);
  });
  state_->nodes.remove_if([&](const NodeBase::WeakPtr& weak) { return weak.lock() == node_ptr; });
  state_->wait_for_end_of(lock, ended);
  node_ptr->get_associated_with_executor_atomic() = false;
}
void CallbackIsolatedAgnocastExecutor::remove_node(rclcpp::Node::SharedPtr node_ptr, bool notify) {
  remove_node(node_ptr->get_node_base_interface(), notify);
}

std::vector<Group::WeakPtr> CallbackIsolatedAgnocastExecutor::get_all_callback_groups() {
  const std::lock_guard lock(state_->mutex);
  std::vector<Group::WeakPtr> all;
  state_->for_each_group(
      [&](const Group::SharedPtr& group, const NodeBase::SharedPtr&) { all.emplace_back(group); });
  return all;
}
std::vector<Group::WeakPtr> CallbackIsolatedAgnocastExecutor::get_manually_added_callback_groups() {
  const std::lock_guard lock(state_->mutex);
  std::vector<Group::WeakPtr> added;
  for (const auto& entry : state_->groups) added.push_back(entry.first);
  return added;
}
std::vector<Group::WeakPtr>
CallbackIsolatedAgnocastExecutor::get_automatically_added_callback_groups_from_nodes() {
  const std::lock_guard lock(state_->mutex);
  std::vector<Group::WeakPtr> of_nodes;
  state_->for_each_group([&](const Group::SharedPtr& group, const NodeBase::SharedPtr&) {
    if (state_->groups.count(group) == 0) of_nodes.emplace_back(group);
  });
  return of_nodes;
}

void CallbackIsolatedAgnocastExecutor::spin_some(std::chrono::nanoseconds) {
  refuse_single_calls();
}
void CallbackIsolatedAgnocastExecutor::spin_all(std::chrono::nanoseconds) { refuse_single_calls(); }
void CallbackIsolatedAgnocastExecutor::spin_once(std::chrono::nanoseconds) {
  refuse_single_calls();
}
void CallbackIsolatedAgnocastExecutor::spin_once_impl(std::chrono::nanoseconds) {
  refuse_single_calls();
}

}  // namespace agnocast
