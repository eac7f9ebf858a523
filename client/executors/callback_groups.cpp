// SPDX-License-Identifier: Apache-2.0

#include <client/executors/callback_groups.hpp>

#include <agnocast/heap.hpp>
#include <client/process/forked_child.hpp>
#include <client/process/user_code.hpp>
#include <client/session/context.hpp>

#include <cerrno>
#include <map>
#include <mutex>
#include <new>
#include <utility>
#include <vector>

namespace agnocast {

CallbackGroup::State::State(const std::string& node, CallbackGroupType type, bool with_node,
                            const std::string& name)
    : is_with_node(with_node), callbacks(std::make_shared<GroupCallbacks>(type, node, name)) {}

namespace {

// This many of the wait sets of a process are for groups; the others are for subscriptions
// without callbacks, and for wait sets that are about to come back.
constexpr std::size_t own_wait_sets_max = 48;
static_assert(own_wait_sets_max < abi::wait_set_count_max);
constexpr const char* default_name = "default";

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

  /// Returns a wait set for a group: a new one, or the one that the fewest share. Without the
  /// mutex, because it may wait for the daemon. Threads that call it at once may make some more
  /// than own_wait_sets_max.
  Result<std::shared_ptr<WaitSet>> wait_set() {
    std::unique_lock lock(mutex);
    std::erase_if(wait_sets, [](const auto& set) { return set.expired(); });
    if (wait_sets.size() < own_wait_sets_max) {
      lock.unlock();
      auto made = Context::instance().create_wait_set();
      lock.lock();
      if (made) wait_sets.push_back(*made);
      if (made || made.error().code != Errc::limit_reached || wait_sets.empty()) return made;
    }
    std::shared_ptr<WaitSet> least_used;
    for (const auto& weak : wait_sets) {
      std::shared_ptr<WaitSet> set = weak.lock();  // null: its last group has just left
      if (set != nullptr && (least_used == nullptr || set.use_count() < least_used.use_count()))
        least_used = std::move(set);
    }
    if (least_used != nullptr) return least_used;
    lock.unlock();
    return Context::instance().create_wait_set();
  }
};
Places& places() {
  static Places* const all = new Places;  // immortal, like the context
  return *all;
}

Result<void> assign(CallbackGroup::State& group, GroupExecutor& executor) {
  try {
    if (Result<void> adopted = executor.adopt(group.callbacks); !adopted) return adopted;
  } catch (const std::bad_alloc&) {
    return fail(Errc::os_failure, "adding a callback group to an executor", ENOMEM);
  }
  group.executor = &executor;
  return {};
}

/// Also after exit handlers have begun, like every creation.
Result<void> refuse_creation() noexcept {
  if (Result<void> refused = refuse_forked_child(); !refused) return refused;
  return refuse_after_exit();
}

void unassign(CallbackGroup::State& group) noexcept {
  if (group.executor == nullptr) return;
  std::exchange(group.executor, nullptr)->drop(*group.callbacks);
  group.is_added_alone = false;
}

/// Under the mutex of Places, which the destructor of `group` takes: also after a failure it must
/// be destroyed later.
Result<void> make(Places& all, const std::string& node, CallbackGroupType type, bool with_node,
                  const std::string& name, CallbackGroup::SharedPtr& group) {
  group = std::make_shared<CallbackGroup>(
      std::make_unique<CallbackGroup::State>(node, type, with_node, name));
  NodePlace& place = all.by_node[node];
  place.groups.push_back(group.get());
  return with_node && place.executor != nullptr ? assign(group->state(), *place.executor)
                                                : Result<void>();
}

}  // namespace

CallbackGroup::CallbackGroup(std::unique_ptr<State> state) noexcept : state_(std::move(state)) {}

CallbackGroup::~CallbackGroup() {
  if (is_forked_child()) return;
  Places& all = places();
  const std::lock_guard lock(all.mutex);
  unassign(*state_);
  const auto place = all.by_node.find(state_->callbacks->node());
  if (place == all.by_node.end()) return;
  std::erase(place->second.groups, this);
  all.forget_if_unused(state_->callbacks->node());
}

CallbackGroupType CallbackGroup::type() const noexcept { return state_->callbacks->type(); }
bool CallbackGroup::automatically_add_to_executor_with_node() const noexcept {
  return state_->is_with_node;
}

const std::string& CallbackGroup::name() const noexcept { return state_->callbacks->name(); }

CallbackGroup::SharedPtr detail::make_callback_group(const std::string& node,
                                                     CallbackGroupType type, bool with_node,
                                                     const std::string& name) {
  if (Result<void> refused = refuse_creation(); !refused) throw Error(refused.error());
  const LoanPause pause;
  CallbackGroup::SharedPtr group;
  Places& all = places();
  const std::lock_guard lock(all.mutex);
  if (Result<void> made = make(all, node, type, with_node, name, group); !made)
    throw Error(made.error());
  return group;
}

namespace callback_groups {

Result<CallbackGroup::SharedPtr> of_callback(const std::string& node,
                                             const CallbackGroup::SharedPtr& named) {
  if (Result<void> refused = refuse_creation(); !refused)
    return tl::unexpected<Failure>(refused.error());
  if (named != nullptr && named->state().callbacks->node() != node)
    return fail(Errc::invalid_argument, "the callback group belongs to another node");
  const LoanPause pause;
  CallbackGroup::SharedPtr group = named;  // outside the lock: the destructor takes it
  Places& all = places();
  const std::lock_guard lock(all.mutex);
  if (group == nullptr) group = all.by_node[node].default_group.lock();
  if (group == nullptr) {
    if (Result<void> made =
            make(all, node, CallbackGroupType::MutuallyExclusive, true, default_name, group);
        !made)
      return tl::unexpected<Failure>(made.error());
    all.by_node[node].default_group = group;
  }
  return group;
}

Result<CallbackGroup::SharedPtr> of_endpoint(const std::string& node,
                                             const CallbackGroup::SharedPtr& named) {
  const LoanPause pause;  // executors and groups outlive any loan of this thread
  auto group = of_callback(node, named);
  if (!group) return group;
  CallbackGroup::State& state = (*group)->state();
  Places& all = places();
  {
    const std::lock_guard lock(all.mutex);
    if (state.callbacks->wait_set() != nullptr) return group;
  }
  auto wait_set = all.wait_set();
  if (!wait_set) return tl::unexpected<Failure>(wait_set.error());
  const std::lock_guard lock(all.mutex);
  if (state.callbacks->wait_set() != nullptr) return group;  // another thread was faster
  // First, because an executor that takes the group meanwhile (a core of CallbackIsolatedExecutor)
  // listens to what the group has.
  state.callbacks->set_wait_set(*wait_set);
  if (state.executor == nullptr) return group;
  Result<void> listening = state.executor->listen(*state.callbacks, std::move(*wait_set));
  if (listening) return group;
  state.callbacks->set_wait_set(nullptr);
  return tl::unexpected<Failure>(listening.error());
}

Result<void> claim_node(const std::string& node, GroupExecutor& executor) {
  if (Result<void> refused = refuse_forked_child(); !refused) return refused;
  const LoanPause pause;
  Places& all = places();
  const std::lock_guard lock(all.mutex);
  NodePlace& place = all.by_node[node];
  if (place.executor != nullptr)
    return fail(Errc::invalid_argument, "the node has been added to an executor already");
  for (CallbackGroup* const group : place.groups) {
    CallbackGroup::State& state = group->state();
    if (!state.is_with_node || state.executor != nullptr) continue;
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
    if (state.executor == &executor && !state.is_added_alone) unassign(state);
  }
  all.forget_if_unused(node);
  return {};
}

Result<void> claim_group(CallbackGroup& group, GroupExecutor& executor) {
  if (Result<void> refused = refuse_forked_child(); !refused) return refused;
  const LoanPause pause;
  const std::lock_guard lock(places().mutex);
  if (group.state().executor != nullptr)
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
      if (group->state().executor == &executor) unassign(group->state());
    }
    if (node.executor == &executor) node.executor = nullptr;
    place = node.executor == nullptr && node.groups.empty() ? all.by_node.erase(place)
                                                            : std::next(place);
  }
}

}  // namespace callback_groups
}  // namespace agnocast
