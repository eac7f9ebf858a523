// SPDX-License-Identifier: Apache-2.0

#include <client/forked_child.hpp>
#include <client/runner.hpp>

#include <pthread.h>
#include <signal.h>
#include <sys/epoll.h>

#include <algorithm>
#include <cerrno>
#include <condition_variable>
#include <map>
#include <mutex>
#include <new>
#include <utility>
#include <vector>

namespace agnocast {
namespace {

// A publisher that dies between commit and ring, with the daemon down as well, rings nobody; so
// nobody sleeps longer than this.
constexpr int safety_timeout_ms = 1000;

struct ReceivedBlock : detail::Block {
  Received received;
};

struct Runners {
  std::mutex mutex;
  std::map<std::string, std::weak_ptr<Runner>> by_node;
};
Runners& runners() {
  static Runners* const all = new Runners;  // immortal, as the context
  return *all;
}

}  // namespace

detail::Block* take_block(SubscriptionEndpoint& subscription) noexcept {
  if (!subscription.has_news()) return nullptr;
  std::unique_ptr<ReceivedBlock> block(new (std::nothrow) ReceivedBlock);
  if (block == nullptr) return nullptr;
  auto received = subscription.take();
  if (!received) return nullptr;
  block->message = reinterpret_cast<void*>(received->taken.address);
  block->end = [](detail::Block* last) noexcept {
    auto* const own = static_cast<ReceivedBlock*>(last);
    Context::instance().release(own->received);
    delete own;
  };
  block->info.sequence = received->taken.sequence - received->link->first_sequence();
  block->info.publisher = received->link->generation();
  block->info.publish_time_ns = received->taken.stamp_ns;
  block->received = std::move(*received);
  return block.release();
}

struct Runner::State {
  struct Entry {
    std::shared_ptr<SubscriptionEndpoint> subscription;
    detail::UntypedSubscription::Callback callback;
    bool removed = false;
  };

  std::shared_ptr<Sleeper> sleeper;
  UniqueFd epoll;
  std::mutex mutex;
  std::condition_variable idle;
  std::vector<std::shared_ptr<Entry>> entries;
  const Entry* running = nullptr;
  bool stop = false;

  bool has_news() {
    const std::lock_guard lock(mutex);
    return std::any_of(entries.begin(), entries.end(),
                       [](const auto& entry) { return entry->subscription->has_news(); });
  }

  /// One message of each subscription in turn, so that a fast topic does not starve the others.
  /// True while there was one.
  bool dispatch() {
    std::vector<std::shared_ptr<Entry>> turn;
    {
      const std::lock_guard lock(mutex);
      turn = entries;
    }
    bool any = false;
    for (const std::shared_ptr<Entry>& entry : turn) {
      {
        const std::lock_guard lock(mutex);
        if (entry->removed || stop) continue;
        running = entry.get();
      }
      if (detail::Block* const block = take_block(*entry->subscription)) {
        any = true;
        entry->callback(block);
      }
      const std::lock_guard lock(mutex);
      running = nullptr;
      idle.notify_all();
    }
    return any;
  }

  void run() {
    for (;;) {
      while (dispatch()) {
      }
      {
        const std::lock_guard lock(mutex);
        if (stop) return;
      }
      sleeper->arm();
      if (has_news()) {
        sleeper->disarm();
        continue;
      }
      epoll_event event{};
      const int count = ::epoll_wait(epoll.get(), &event, 1, safety_timeout_ms);
      sleeper->disarm();
      if (count > 0 && event.data.u64 == 1) sleeper->bells().drain();
    }
  }
};

Result<std::shared_ptr<Runner>> Runner::of_node(const std::string& node) {
  if (Result<void> refused = refuse_forked_child(); !refused)
    return tl::unexpected<Failure>(refused.error());
  Runners& all = runners();
  const std::lock_guard lock(all.mutex);
  std::weak_ptr<Runner>& known = all.by_node[node];
  if (std::shared_ptr<Runner> runner = known.lock()) return runner;
  auto sleeper = Context::instance().create_sleeper();
  if (!sleeper) return tl::unexpected<Failure>(sleeper.error());
  auto state = std::make_shared<State>();
  state->sleeper = std::move(*sleeper);
  state->epoll.reset(::epoll_create1(EPOLL_CLOEXEC));
  if (!state->epoll) return fail(Errc::os_failure, "preparing a callback thread", errno);
  if (Result<void> added = state->sleeper->bells().add_to(state->epoll.get(), 0, 1); !added)
    return tl::unexpected<Failure>(added.error());

  std::shared_ptr<Runner> runner(new Runner(state));
  sigset_t every, before;
  ::sigfillset(&every);
  ::pthread_sigmask(SIG_SETMASK, &every, &before);
  runner->thread_ = std::thread([state] { state->run(); });
  ::pthread_sigmask(SIG_SETMASK, &before, nullptr);
  ::pthread_setname_np(runner->thread_.native_handle(), "agnocast-call");
  known = runner;
  return runner;
}

Runner::~Runner() {
  if (is_forked_child()) {
    new std::thread(std::move(thread_));  // left alone: the thread is the parent's
    return;
  }
  {
    const std::lock_guard lock(state_->mutex);
    state_->stop = true;
  }
  state_->sleeper->wake();
  if (thread_.get_id() == std::this_thread::get_id()) {
    thread_.detach();
  } else {
    thread_.join();
  }
}

const std::shared_ptr<Sleeper>& Runner::sleeper() const noexcept { return state_->sleeper; }

void Runner::add(const std::shared_ptr<SubscriptionEndpoint>& subscription,
                 detail::UntypedSubscription::Callback callback) {
  auto entry =
      std::make_shared<State::Entry>(State::Entry{subscription, std::move(callback), false});
  {
    const std::lock_guard lock(state_->mutex);
    state_->entries.push_back(std::move(entry));
  }
  state_->sleeper->wake();
}

void Runner::remove(const SubscriptionEndpoint& subscription) noexcept {
  if (is_forked_child()) return;
  std::unique_lock lock(state_->mutex);
  auto& entries = state_->entries;
  const auto found = std::find_if(entries.begin(), entries.end(), [&](const auto& entry) {
    return entry->subscription.get() == &subscription;
  });
  if (found == entries.end()) return;
  const std::shared_ptr<State::Entry> entry = *found;
  entry->removed = true;
  entries.erase(found);
  if (thread_.get_id() != std::this_thread::get_id())
    state_->idle.wait(lock, [&] { return state_->running != entry.get(); });
}

}  // namespace agnocast
