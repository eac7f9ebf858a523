// SPDX-License-Identifier: Apache-2.0

#include <client/executors/callback_groups.hpp>

#include <client/executors/background_thread.hpp>
#include <client/executors/executor_state.hpp>
#include <client/process/forked_child.hpp>
#include <client/session/context.hpp>

#include <algorithm>
#include <map>
#include <mutex>
#include <utility>
#include <vector>

namespace agnocast {

/// The library's thread of one default group.
class NodeThread {
 public:
  /// Errors: os_failure.
  [[nodiscard]] static Result<std::unique_ptr<NodeThread>> start() {
    auto core = ExecutorCore::make();
    if (!core) return tl::unexpected<Failure>(core.error());
    std::shared_ptr<ExecutorCore> shared = std::move(*core);
    auto thread = BackgroundThread::start(shared);
    if (!thread) return tl::unexpected<Failure>(thread.error());
    return std::make_unique<NodeThread>(std::move(shared), std::move(*thread));
  }
  NodeThread(std::shared_ptr<ExecutorCore> core, std::shared_ptr<BackgroundThread> thread) noexcept
      : groups_(*core), thread_(std::move(thread)) {}
  /// Waits as BackgroundThread::join() does.
  ~NodeThread() {
    if (is_forked_child()) {
      thread_->abandon();
    } else {
      thread_->join();
    }
  }
  NodeThread(const NodeThread&) = delete;
  NodeThread& operator=(const NodeThread&) = delete;
  GroupExecutor& groups() noexcept { return groups_; }

 private:
  CoreGroups groups_;
  const std::shared_ptr<BackgroundThread> thread_;  // keeps the core
};

CallbackGroup::State::State(std::string node, CallbackGroupType type, bool with_node)
    : node_name(std::move(node)),
      is_with_node(with_node),
      callbacks(std::make_shared<GroupCallbacks>(type)) {}
CallbackGroup::State::~State() = default;

namespace {

// Of the wait sets of a process, this many are for groups; the others are for subscriptions
// without callbacks, and for wait sets that are about to come back.
constexpr std::size_t own_wait_sets_max = 48;
static_assert(own_wait_sets_max < abi::executor_count_max);

struct NodePlace {
  std::weak_ptr<CallbackGroup> default_group;
  std::vector<CallbackGroup*> groups;  // all that live, the default one too
  GroupExecutor* executor = nullptr;   // it removes its claims before it is destroyed
};

struct Places {
  std::mutex mutex;  // taken before those of executors, which are taken before those of groups
  std::map<std::string, NodePlace> by_node;
  std::vector<std::weak_ptr<WaitSet>> wait_sets;

  void forget_if_unused(const std::string& node) {
    const auto found = by_node.find(node);
    if (found != by_node.end() && found->second.executor == nullptr && found->second.groups.empty())
      by_node.erase(found);
  }

  /// Returns a wait set for a group: a new one, or the one that the fewest share.
  Result<std::shared_ptr<WaitSet>> wait_set() {
    std::erase_if(wait_sets, [](const auto& set) { return set.expired(); });
    if (wait_sets.size() < own_wait_sets_max) {
      wait_sets.reserve(wait_sets.size() + 1);
      auto made = Context::instance().create_wait_set();
      if (made) wait_sets.push_back(*made);
      if (made || made.error().code != Errc::limit_reached || wait_sets.empty()) return made;
    }
    return std::min_element(wait_sets.begin(), wait_sets.end(),
                            [](const auto& one, const auto& other) {
                              return one.use_count() < other.use_count();
                            })
        ->lock();
  }
};
Places& places() {
  static Places* const all = new Places;  // immortal, like the context
  return *all;
}

Result<void> assign(CallbackGroup::State& group, GroupExecutor& executor) {
  if (Result<void> adopted = executor.adopt(group.callbacks); !adopted) return adopted;
  group.executor = &executor;
  return {};
}

void unassign(CallbackGroup::State& group) noexcept {
  if (group.executor == nullptr) return;
  std::exchange(group.executor, nullptr)->drop(*group.callbacks);
  group.is_added_alone = false;
}

bool is_in_executor(const CallbackGroup::State& group) noexcept {
  return group.executor != nullptr &&
         (group.own_thread == nullptr || group.executor != &group.own_thread->groups());
}

/// For a group that no executor has. Errors: os_failure.
Result<void> give_to_own_thread(CallbackGroup::State& state) {
  if (state.executor != nullptr || !state.is_default) return {};
  if (state.own_thread == nullptr) {
    auto started = NodeThread::start();
    if (!started) return tl::unexpected<Failure>(started.error());
    state.own_thread = std::move(*started);
  }
  return assign(state, state.own_thread->groups());
}

/// Under the mutex of Places.
Result<CallbackGroup::SharedPtr> make(Places& all, const std::string& node, CallbackGroupType type,
                                      bool with_node) {
  NodePlace& place = all.by_node[node];
  place.groups.reserve(place.groups.size() + 1);
  auto state = std::make_unique<CallbackGroup::State>(node, type, with_node);
  if (with_node && place.executor != nullptr) {
    if (Result<void> assigned = assign(*state, *place.executor); !assigned)
      return tl::unexpected<Failure>(assigned.error());
  }
  auto group = std::make_shared<CallbackGroup>(std::move(state));
  place.groups.push_back(group.get());
  return group;
}

}  // namespace

CallbackGroup::CallbackGroup(std::unique_ptr<State> state) noexcept : state_(std::move(state)) {}

CallbackGroup::~CallbackGroup() {
  if (is_forked_child()) return;
  Places& all = places();
  // The state is destroyed after unlocking: it may wait for a thread.
  const std::lock_guard lock(all.mutex);
  unassign(*state_);
  const auto place = all.by_node.find(state_->node_name);
  if (place == all.by_node.end()) return;
  std::erase(place->second.groups, this);
  all.forget_if_unused(state_->node_name);
}

CallbackGroupType CallbackGroup::type() const noexcept { return state_->callbacks->type(); }
bool CallbackGroup::automatically_add_to_executor_with_node() const noexcept {
  return state_->is_with_node;
}

CallbackGroup::SharedPtr detail::make_callback_group(const std::string& node,
                                                     CallbackGroupType type, bool with_node) {
  if (Result<void> refused = refuse_forked_child(); !refused) throw Error(refused.error());
  Places& all = places();
  const std::lock_guard lock(all.mutex);
  auto made = make(all, node, type, with_node);
  if (!made) throw Error(made.error());
  return std::move(*made);
}

namespace callback_groups {

Result<CallbackGroup::SharedPtr> of_endpoint(const std::string& node,
                                             const CallbackGroup::SharedPtr& named) {
  if (Result<void> refused = refuse_forked_child(); !refused)
    return tl::unexpected<Failure>(refused.error());
  if (named != nullptr && named->state().node_name != node)
    return fail(Errc::invalid_argument, "the callback group belongs to another node");
  CallbackGroup::SharedPtr group = named;  // outside the lock: the destructor takes it
  Places& all = places();
  const std::lock_guard lock(all.mutex);
  if (group == nullptr) group = all.by_node[node].default_group.lock();
  if (group == nullptr) {
    auto made = make(all, node, CallbackGroupType::MutuallyExclusive, true);
    if (!made) return made;
    group = std::move(*made);
    group->state().is_default = true;
    all.by_node[node].default_group = group;
  }
  CallbackGroup::State& state = group->state();
  if (Result<void> given = give_to_own_thread(state); !given)
    return tl::unexpected<Failure>(given.error());
  if (state.callbacks->wait_set() != nullptr) return group;
  auto wait_set = all.wait_set();
  if (!wait_set) return tl::unexpected<Failure>(wait_set.error());
  if (state.executor != nullptr) {
    if (Result<void> listening = state.executor->listen(*state.callbacks, *wait_set); !listening)
      return tl::unexpected<Failure>(listening.error());
  }
  state.callbacks->set_wait_set(std::move(*wait_set));
  return group;
}

Result<void> claim_node(const std::string& node, GroupExecutor& executor) {
  if (Result<void> refused = refuse_forked_child(); !refused) return refused;
  Places& all = places();
  const std::lock_guard lock(all.mutex);
  NodePlace& place = all.by_node[node];
  if (place.executor != nullptr)
    return fail(Errc::invalid_argument, "the node has been added to an executor already");
  for (CallbackGroup* const group : place.groups) {
    CallbackGroup::State& state = group->state();
    if (!state.is_with_node || is_in_executor(state)) continue;
    unassign(state);
    Result<void> assigned = assign(state, executor);
    if (assigned) continue;
    for (CallbackGroup* const before : place.groups) {
      if (before->state().executor == &executor && !before->state().is_added_alone)
        unassign(before->state());
    }
    all.forget_if_unused(node);
    return assigned;
  }
  place.executor = &executor;
  return {};
}

Result<void> release_node(const std::string& node, GroupExecutor& executor) {
  if (Result<void> refused = refuse_forked_child(); !refused) return refused;
  Places& all = places();
  const std::lock_guard lock(all.mutex);
  const auto place = all.by_node.find(node);
  if (place == all.by_node.end() || place->second.executor != &executor)
    return fail(Errc::invalid_argument, "the node is not in this executor");
  place->second.executor = nullptr;
  for (CallbackGroup* const group : place->second.groups) {
    CallbackGroup::State& state = group->state();
    if (state.executor != &executor || state.is_added_alone) continue;
    unassign(state);
    if (Result<void> given = give_to_own_thread(state); !given) return given;
  }
  all.forget_if_unused(node);
  return {};
}

Result<void> claim_group(CallbackGroup& group, GroupExecutor& executor) {
  if (Result<void> refused = refuse_forked_child(); !refused) return refused;
  const std::lock_guard lock(places().mutex);
  if (is_in_executor(group.state()))
    return fail(Errc::invalid_argument, "the callback group has been added to an executor already");
  Result<void> assigned = assign(group.state(), executor);
  group.state().is_added_alone = assigned.has_value();
  return assigned;
}

Result<void> release_group(CallbackGroup& group, GroupExecutor& executor) {
  if (Result<void> refused = refuse_forked_child(); !refused) return refused;
  const std::lock_guard lock(places().mutex);
  if (group.state().executor != &executor)
    return fail(Errc::invalid_argument, "the callback group is not in this executor");
  unassign(group.state());
  return {};
}

void release_all(GroupExecutor& executor) noexcept {
  if (is_forked_child()) return;
  Places& all = places();
  const std::lock_guard lock(all.mutex);
  for (auto place = all.by_node.begin(); place != all.by_node.end();) {
    NodePlace& node = place->second;
    for (CallbackGroup* const group : node.groups) {
      if (group->state().executor != &executor) continue;
      unassign(group->state());
      // If there is no thread, the callbacks wait for the node's next executor.
      (void)give_to_own_thread(group->state());
    }
    if (node.executor == &executor) node.executor = nullptr;
    place = node.executor == nullptr && node.groups.empty() ? all.by_node.erase(place)
                                                            : std::next(place);
  }
}

}  // namespace callback_groups
}  // namespace agnocast
