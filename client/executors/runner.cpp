// SPDX-License-Identifier: Apache-2.0

#include <client/executors/runner.hpp>
#include <client/process/forked_child.hpp>

#include <client/executors/executor_core.hpp>
#include <client/session/context.hpp>

#include <map>
#include <mutex>
#include <vector>

namespace agnocast {
namespace {

struct Place {
  std::weak_ptr<Runner> runner;
  ExecutorCore* executor = nullptr;  // it removes its claims before it is destroyed
};
struct Places {
  std::mutex mutex;  // taken before those of executors, which are taken before those of nodes
  std::map<std::string, Place> by_node;

  void forget_if_unused(const std::string& node) {
    const auto found = by_node.find(node);
    if (found != by_node.end() && found->second.executor == nullptr &&
        found->second.runner.expired())
      by_node.erase(found);
  }
};
Places& places() {
  static Places* const all = new Places;  // immortal, like the context
  return *all;
}

}  // namespace

Result<void> Runner::run_by_thread() {
  if (thread_ == nullptr) {
    auto started = NodeThread::start(callbacks_);
    if (!started) return tl::unexpected<Failure>(started.error());
    thread_ = std::move(*started);
  }
  callbacks_->hand_to(callbacks_.get());
  return {};
}

Result<std::shared_ptr<Runner>> Runner::of_node(const std::string& node) {
  if (Result<void> refused = refuse_forked_child(); !refused)
    return tl::unexpected<Failure>(refused.error());
  std::shared_ptr<Runner> runner;  // both outside the lock: the destructor takes it
  std::unique_ptr<Runner> made;
  Places& all = places();
  const std::lock_guard lock(all.mutex);
  Place& place = all.by_node[node];
  runner = place.runner.lock();
  if (runner != nullptr) return runner;
  auto wait_set = Context::instance().create_wait_set();
  if (!wait_set) {
    all.forget_if_unused(node);
    return tl::unexpected<Failure>(wait_set.error());
  }
  made.reset(new Runner(std::make_shared<NodeCallbacks>(node, std::move(*wait_set))));
  runner = std::move(made);
  if (Result<void> assigned = place.executor != nullptr ? place.executor->adopt(runner->callbacks_)
                                                        : runner->run_by_thread();
      !assigned)
    return tl::unexpected<Failure>(assigned.error());
  place.runner = runner;
  return runner;
}

Runner::~Runner() {
  if (is_forked_child()) {
    if (thread_ != nullptr) thread_->abandon();
    return;
  }
  {
    Places& all = places();
    const std::lock_guard lock(all.mutex);
    const auto place = all.by_node.find(callbacks_->node());
    if (place != all.by_node.end() && place->second.executor != nullptr)
      place->second.executor->drop(*callbacks_);
    all.forget_if_unused(callbacks_->node());
  }
  callbacks_->stop();
  if (thread_ != nullptr) thread_->join();
}

Result<void> Runner::claim(const std::string& node, ExecutorCore& executor) {
  if (Result<void> refused = refuse_forked_child(); !refused) return refused;
  std::shared_ptr<Runner> runner;
  Places& all = places();
  const std::lock_guard lock(all.mutex);
  Place& place = all.by_node[node];
  if (place.executor != nullptr)
    return fail(Errc::invalid_argument, "the node has been added to an executor already");
  runner = place.runner.lock();
  if (runner != nullptr) {
    if (Result<void> adopted = executor.adopt(runner->callbacks_); !adopted) return adopted;
  }
  place.executor = &executor;
  return {};
}

Result<void> Runner::release(const std::string& node, ExecutorCore& executor) {
  if (Result<void> refused = refuse_forked_child(); !refused) return refused;
  std::shared_ptr<Runner> runner;
  Places& all = places();
  const std::lock_guard lock(all.mutex);
  const auto place = all.by_node.find(node);
  if (place == all.by_node.end() || place->second.executor != &executor)
    return fail(Errc::invalid_argument, "the node is not in this executor");
  place->second.executor = nullptr;
  executor.drop(node);
  runner = place->second.runner.lock();
  if (runner == nullptr) {
    all.by_node.erase(place);
    return {};
  }
  return runner->run_by_thread();
}

void Runner::release_all(ExecutorCore& executor) noexcept {
  if (is_forked_child()) return;
  std::vector<std::string> nodes;
  {
    Places& all = places();
    const std::lock_guard lock(all.mutex);
    for (const auto& [node, place] : all.by_node) {
      if (place.executor == &executor) nodes.push_back(node);
    }
  }
  // If there is no thread, the callbacks wait for the node's next executor.
  for (const std::string& node : nodes) (void)release(node, executor);
}

}  // namespace agnocast
