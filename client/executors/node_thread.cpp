// SPDX-License-Identifier: Apache-2.0

#include <client/executors/executor_core.hpp>
#include <client/executors/node_thread.hpp>
#include <client/forked_child.hpp>
#include <client/user_code.hpp>

#include <sys/epoll.h>

#include <new>
#include <vector>

namespace agnocast {
namespace {

void run_turn(NodeCallbacks& node, NodeCallbacks::Host self, bool& any) {
  std::vector<std::weak_ptr<CallbackSource>> turn;
  node.list(self, turn);
  for (const auto& listed : turn) {
    const UserCode code;  // goes after the source, which may be what keeps the callback
    if (!code.may_run()) return;
    const auto source = listed.lock();
    if (source == nullptr) continue;
    if (is_forked_child()) return;
    try {
      any = node.run(self, *source) || any;
    } catch (...) {
      // There is nobody to give it to, and ending the process is not the library's business.
      any = true;
      source->exception_count.fetch_add(1, std::memory_order_relaxed);
    }
  }
}

}  // namespace

void serve(NodeCallbacks& node, int epoll) noexcept {
  const NodeCallbacks::Host self = &node;
  while (node.await(self)) {
    try {
      bool any = false;
      run_turn(node, self, any);
      if (is_forked_child()) return;  // a callback has forked, and has returned in the child
      if (exit_has_begun()) return;   // for good: what is unread stays unread
      if (any) continue;
    } catch (const std::bad_alloc&) {
      // Of the list: what is unread stays unread until there is memory.
    }
    node.arm(self);
    epoll_event events[2];
    int count = 0;
    if (!node.has_work(self))
      count = ::epoll_wait(epoll, events, 2, static_cast<int>(ExecutorCore::sleep_max.count()));
    node.disarm(self);
    for (int i = 0; i < count; ++i) {
      if (events[i].data.u64 == 1) node.drain(self);
    }
  }
}

}  // namespace agnocast
