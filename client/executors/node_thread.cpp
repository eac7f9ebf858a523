// SPDX-License-Identifier: Apache-2.0

#include <client/executors/node_thread.hpp>
#include <client/forked_child.hpp>
#include <client/user_code.hpp>

#include <sys/epoll.h>

#include <cstdint>
#include <new>
#include <utility>
#include <vector>

namespace agnocast {
namespace {

/// The sources of a node, as they were in the last turn. Weakly: what goes takes with it what its
/// callback holds.
struct Turn {
  std::vector<std::weak_ptr<CallbackSource>> sources;
  std::uint64_t listed = 0;  // list_changes(); 0: never
};

void run_turn(NodeCallbacks& node, NodeCallbacks::Host self, Turn& turn, bool& any) {
  if (node.list_changes() != turn.listed) {
    turn.sources.clear();
    turn.listed = 0;  // should there be no memory
    turn.listed = node.list(self, turn.sources);
  }
  for (const auto& listed : turn.sources) {
    const UserCode code;  // goes after the source, which may be what keeps the callback
    if (!code.may_run()) return;
    const auto source = listed.lock();
    if (source == nullptr || !source->has_work()) continue;
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

void serve(NodeCallbacks& node, int epoll, const SleepTick& tick) noexcept {
  const NodeCallbacks::Host self = &node;
  Turn turn;
  bool has_rung = false;  // the datagram bell, which is emptied before the next sleep
  while (node.await(self)) {
    try {
      bool any = false;
      run_turn(node, self, turn, any);
      if (is_forked_child()) return;  // a callback has forked, and has returned in the child
      if (exit_has_begun()) return;   // for good: what is unread stays unread
      if (any) continue;
    } catch (const std::bad_alloc&) {
      // Of the list: what is unread stays unread until there is memory.
    }
    if (std::exchange(has_rung, false)) node.drain(self);
    if (node.arm_or_find_work(self)) continue;
    epoll_event events[3];
    const int count = ::epoll_wait(epoll, events, 3, -1);
    node.disarm(self);
    for (int i = 0; i < count; ++i) {
      if (events[i].data.u64 == datagram_tag) has_rung = true;
      if (events[i].data.u64 == tick_tag) tick.wind_up();
    }
  }
}

}  // namespace agnocast
