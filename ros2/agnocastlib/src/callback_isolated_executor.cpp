// SPDX-License-Identifier: Apache-2.0
//
// CallbackIsolatedAgnocastExecutor: one single-threaded executor of rclcpp's, in a thread, for each
// callback group. The thread that calls spin() runs no callback. It starts and ends the others: for
// a group that is found or added, and for one that is removed or gone.

#include <agnocast/agnocast_callback_isolated_executor.hpp>

#include <rclcpp/exceptions.hpp>

#include <pthread.h>

#include <algorithm>
#include <chrono>
#include <condition_variable>
#include <cstddef>
#include <exception>
#include <iterator>
#include <list>
#include <map>
#include <memory>
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

/// A group that is to have a thread, and its node.
struct Wanted {
  Group::SharedPtr group;
  NodeBase::SharedPtr node;
};

/// The thread of one group.
struct Child {
  explicit Child(const rclcpp::ExecutorOptions& options)
      : executor(std::make_unique<rclcpp::executors::SingleThreadedExecutor>(options)) {}

  Group::WeakPtr group;  // none: it has never had a thread
  std::unique_ptr<rclcpp::executors::SingleThreadedExecutor> executor;
  std::thread thread;
  // Under the mutex of State, which the thread takes no more afterwards.
  bool is_done = true;

  /// Asks the thread to end after the running callback. Lost if the thread has not begun to spin.
  void cancel() noexcept {
    try {
      executor->cancel();
    } catch (const std::exception&) {
      // The context was shut down, which ends the thread as well.
    }
  }
};

/// Releases a mutex for a scope.
class Unlocked {
 public:
  explicit Unlocked(std::unique_lock<std::mutex>& lock) : lock_(lock) { lock_.unlock(); }
  ~Unlocked() { lock_.lock(); }
  Unlocked(const Unlocked&) = delete;
  Unlocked& operator=(const Unlocked&) = delete;

 private:
  std::unique_lock<std::mutex>& lock_;
};

/// How long the thread in spin() waits for children that it has asked to end before it asks again.
constexpr std::chrono::milliseconds pause_of_ending{1};

template <class A, class B>
bool is_same(const A& a, const B& b) noexcept {
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

  // Never held while a callback is waited for, nor while executors, nodes or groups are made or
  // destroyed: those take locks that rclcpp::shutdown() holds while it calls functions of the user,
  // and such a function may call cancel().
  std::mutex mutex;
  std::condition_variable changed;
  bool is_woken = false;  // something for the thread in spin()
  std::list<NodeBase::WeakPtr> nodes;
  std::map<Group::WeakPtr, NodeBase::WeakPtr, std::owner_less<Group::WeakPtr>> groups;
  std::list<std::unique_ptr<Child>> children;  // only the thread in spin() adds and erases
  /// Executors that ended with their context: a function of rclcpp::on_shutdown() may wait for
  /// spin(), and the destructor of an executor for that function. Only for the thread in spin().
  std::vector<std::unique_ptr<rclcpp::executors::SingleThreadedExecutor>> parked;
  std::exception_ptr failure;

  void wake() {
    is_woken = true;
    changed.notify_all();
  }
  bool has_node(const NodeBase::SharedPtr& node) const {
    return std::any_of(nodes.begin(), nodes.end(),
                       [&](const NodeBase::WeakPtr& weak) { return is_same(weak, node); });
  }
  Child* child_of(const Group::WeakPtr& group) const {
    for (const auto& child : children)
      if (is_same(child->group, group)) return child.get();
    return nullptr;
  }
  /// Returns the groups that are to have a thread. Destroy the result without the mutex: it may be
  /// the last owner of a node.
  std::vector<Wanted> wanted_groups() {
    for (auto at = groups.begin(); at != groups.end();)
      at = at->first.expired() ? groups.erase(at) : std::next(at);
    nodes.remove_if([](const NodeBase::WeakPtr& node) { return node.expired(); });
    std::vector<Wanted> wanted;
    for (const auto& [weak_group, weak_node] : groups) {
      Wanted one{weak_group.lock(), weak_node.lock()};
      if (one.group != nullptr && one.node != nullptr) wanted.push_back(std::move(one));
    }
    for (const NodeBase::WeakPtr& weak : nodes) {
      const auto node = weak.lock();
      if (node == nullptr) continue;
      node->for_each_callback_group([&](const Group::SharedPtr& group) {
        if (group->automatically_add_to_executor_with_node() && groups.count(group) == 0)
          wanted.push_back({group, node});
      });
    }
    return wanted;
  }
  bool is_wanted(const Wanted& one) const {
    return groups.count(one.group) != 0 ||
           (one.group->automatically_add_to_executor_with_node() && has_node(one.node));
  }
  /// Erases the children that have ended and asks those of no `wanted` group to end. Returns
  /// whether some have not ended yet. Does not wait for them: a callback of one may itself wait for
  /// the end of another, in remove_node().
  bool end_all_but(std::unique_lock<std::mutex>& lock, const std::vector<Wanted>& wanted) {
    std::vector<Child*> ended;
    bool some_run = false;
    for (const auto& child : children) {
      if (child->is_done) {
        ended.push_back(child.get());
        continue;
      }
      const bool is_wanted = std::any_of(wanted.begin(), wanted.end(), [&](const Wanted& one) {
        return is_same(one.group, child->group);
      });
      if (is_wanted) continue;
      child->cancel();
      some_run = true;
    }
    if (ended.empty()) return some_run;
    {
      // They stay in the list meanwhile: until then their groups are in an executor.
      const Unlocked unlocked(lock);
      for (Child* const child : ended) {
        if (child->thread.joinable()) child->thread.join();
        if (!rclcpp::ok(context)) parked.push_back(std::move(child->executor));
        child->executor.reset();
      }
    }
    children.remove_if([](const auto& child) { return child->executor == nullptr; });
    changed.notify_all();
    return some_run;
  }
  void start_missing(std::unique_lock<std::mutex>& lock, const std::vector<Wanted>& wanted) {
    for (const Wanted& one : wanted) {
      // A group of a node of ours may be in another executor.
      if (child_of(one.group) != nullptr || one.group->get_associated_with_executor_atomic())
        continue;
      children.push_back(make_child(lock));
      // Removed meanwhile: the child ends without a thread.
      if (is_wanted(one)) start(*children.back(), one);
    }
  }
  std::unique_ptr<Child> make_child(std::unique_lock<std::mutex>& lock) const {
    const Unlocked unlocked(lock);
    rclcpp::ExecutorOptions options;  // each with a memory strategy of its own
    options.context = context;
    return std::make_unique<Child>(options);
  }
  void start(Child& child, const Wanted& one) {
    child.executor->add_callback_group(one.group, one.node, false);
    child.group = one.group;
    child.thread = std::thread([this, &child] {
      std::exception_ptr thrown;
      try {
        child.executor->spin();
      } catch (const rclcpp::exceptions::RCLErrorBase&) {
        // After rclcpp::shutdown() there may be nothing left to wait with.
        if (rclcpp::ok(context)) thrown = std::current_exception();
      } catch (...) {
        thrown = std::current_exception();
      }
      const std::lock_guard lock(mutex);
      if (failure == nullptr) failure = std::move(thrown);
      child.is_done = true;
      wake();
    });
    child.is_done = false;
    const std::string name = std::string(one.node->get_name()).substr(0, 15);
    ::pthread_setname_np(child.thread.native_handle(), name.c_str());
  }
  /// Waits until none of `ended` has a thread, but for the calling one.
  void wait_for_end_of(std::unique_lock<std::mutex>& lock,
                       const std::vector<Group::WeakPtr>& ended) {
    wake();
    changed.wait(lock, [&] {
      return std::none_of(ended.begin(), ended.end(), [&](const auto& group) {
        const Child* const child = child_of(group);
        // The thread in spin() joins those that are done.
        return child != nullptr &&
               (child->is_done || child->thread.get_id() != std::this_thread::get_id());
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
  if (spinning.exchange(true))
    throw std::runtime_error("CallbackIsolatedAgnocastExecutor: another thread is in spin()");
  State& state = *state_;
  state.parked.clear();
  std::unique_lock lock(state.mutex);
  state.failure = nullptr;
  while (rclcpp::ok(context_) && spinning && state.failure == nullptr) {
    bool some_end = false;
    std::vector<Wanted> wanted;
    try {
      wanted = state.wanted_groups();
      some_end = state.end_all_but(lock, wanted);
      state.start_missing(lock, wanted);
    } catch (...) {
      // After rclcpp::shutdown() no executor can be made.
      if (rclcpp::ok(context_) && state.failure == nullptr)
        state.failure = std::current_exception();
    }
    {
      const Unlocked unlocked(lock);
      wanted.clear();
    }
    if (state.failure != nullptr || !rclcpp::ok(context_)) break;
    state.changed.wait_for(lock, some_end ? pause_of_ending : state.interval,
                           [&] { return state.is_woken; });
    state.is_woken = false;
  }
  while (state.end_all_but(lock, {})) state.changed.wait_for(lock, pause_of_ending);
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
    throw std::runtime_error(
        "CallbackIsolatedAgnocastExecutor: an executor has this callback group already");
  state_->groups.emplace(group_ptr, node_ptr);
  state_->wake();
}

void CallbackIsolatedAgnocastExecutor::remove_callback_group(Group::SharedPtr group_ptr, bool) {
  std::unique_lock lock(state_->mutex);
  if (state_->groups.erase(group_ptr) == 0)
    throw std::runtime_error(
        "CallbackIsolatedAgnocastExecutor: this callback group was not added to it");
  state_->wait_for_end_of(lock, {group_ptr});
}

void CallbackIsolatedAgnocastExecutor::add_node(NodeBase::SharedPtr node_ptr, bool) {
  if (node_ptr->get_associated_with_executor_atomic().exchange(true))
    throw std::runtime_error("CallbackIsolatedAgnocastExecutor: an executor has this node already");
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
    throw std::runtime_error("CallbackIsolatedAgnocastExecutor: this node was not added to it");
  std::vector<Group::WeakPtr> ended;
  node_ptr->for_each_callback_group([&](const Group::SharedPtr& group) {
    if (state_->groups.count(group) == 0) ended.emplace_back(group);
  });
  state_->nodes.remove_if([&](const NodeBase::WeakPtr& weak) { return is_same(weak, node_ptr); });
  state_->wait_for_end_of(lock, ended);
  node_ptr->get_associated_with_executor_atomic() = false;
}
void CallbackIsolatedAgnocastExecutor::remove_node(rclcpp::Node::SharedPtr node_ptr, bool notify) {
  remove_node(node_ptr->get_node_base_interface(), notify);
}

std::vector<Group::WeakPtr> CallbackIsolatedAgnocastExecutor::get_all_callback_groups() {
  std::vector<Wanted> wanted;  // outlives the lock
  const std::lock_guard lock(state_->mutex);
  wanted = state_->wanted_groups();
  std::vector<Group::WeakPtr> all;
  for (const Wanted& one : wanted) all.emplace_back(one.group);
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
  std::vector<Wanted> wanted;  // outlives the lock
  const std::lock_guard lock(state_->mutex);
  wanted = state_->wanted_groups();
  std::vector<Group::WeakPtr> of_nodes;
  for (const Wanted& one : wanted)
    if (state_->groups.count(one.group) == 0) of_nodes.emplace_back(one.group);
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
