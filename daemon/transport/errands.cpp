// SPDX-License-Identifier: Apache-2.0

#include <daemon/transport/errands.hpp>

#include <base/descriptors/unique_fd.hpp>
#include <base/signals.hpp>

#include <sys/epoll.h>
#include <sys/eventfd.h>

#include <cerrno>
#include <chrono>
#include <condition_variable>
#include <deque>
#include <exception>
#include <iterator>
#include <list>
#include <map>
#include <mutex>
#include <new>
#include <thread>
#include <utility>
#include <vector>

namespace agnocast::daemon {
namespace {

// An idle thread stays for a moment: one errand is often followed by the next.
constexpr std::chrono::milliseconds idle_time{200};

}  // namespace

// Shared with the threads, which may outlive the pool.
struct Errands::State {
  using Key = std::pair<std::uint32_t, Lane>;
  struct Errand {
    std::function<void()> work, then;
  };

  struct Queue {
    std::deque<Errand> errands;  // the first one is ready or running
    std::list<Key> place;        // its node of `ready` while not there; a thread may get no memory
  };

  std::mutex mutex;
  std::condition_variable changed;
  std::map<Key, Queue> queues;
  std::list<Key> ready;
  std::vector<std::function<void()>> answers;
  std::size_t errand_count = 0, thread_count = 0, idle_count = 0;
  bool stops = false;
  UniqueFd event;

  static void work(const std::shared_ptr<State>& state);
  void start_thread(const std::shared_ptr<State>& self);
  bool begin_thread(const std::shared_ptr<State>& self);
  void add(const std::shared_ptr<State>& self, const Key& key, Errand errand);
};

void Errands::State::work(const std::shared_ptr<State>& state) {
  std::unique_lock lock(state->mutex);
  for (;;) {
    ++state->idle_count;
    const bool found = state->changed.wait_for(
        lock, idle_time, [&] { return state->stops || !state->ready.empty(); });
    --state->idle_count;
    if (state->stops || !found) break;
    Queue& queue = state->queues.at(state->ready.front());  // a map does not move its elements
    queue.place.splice(queue.place.begin(), state->ready, state->ready.begin());
    Errand& errand = queue.errands.front();  // nor does a deque while it grows
    lock.unlock();
    try {
      errand.work();
    } catch (const std::bad_alloc&) {
      // Treated as an errand that found nothing.
    }
    errand.work = nullptr;  // frees what it owns
    lock.lock();
    if (errand.then) {
      state->answers.push_back(std::move(errand.then));
      static_cast<void>(::eventfd_write(state->event.get(), 1));
    }
    queue.errands.pop_front();
    --state->errand_count;
    if (queue.errands.empty()) {
      state->queues.erase(state->queues.find(queue.place.front()));
    } else {
      state->ready.splice(state->ready.end(), queue.place);
    }
  }
  --state->thread_count;
}

void Errands::State::start_thread(const std::shared_ptr<State>& self) {
  if (idle_count >= ready.size() || thread_count >= thread_count_max) return;
  // Otherwise the existing threads do it; without any, the next errand or answer() tries again.
  static_cast<void>(begin_thread(self));
}

bool Errands::State::begin_thread(const std::shared_ptr<State>& self) {
  const SignalsBlocked blocked;  // the first thread handles them
  try {
    std::thread([self] { work(self); }).detach();
    ++thread_count;
    return true;
  } catch (const std::exception&) {  // no thread left, or no memory for one
    return false;
  }
}

void Errands::State::add(const std::shared_ptr<State>& self, const Key& key, Errand errand) {
  // Reserved for the errand's thread, which may have no memory.
  answers.reserve(answers.size() + errand_count + 1);
  std::list<Key> place{key};
  Queue& queue = queues[key];
  queue.errands.push_back(std::move(errand));
  ++errand_count;
  if (queue.errands.size() == 1) ready.splice(ready.end(), place);
  start_thread(self);
  changed.notify_one();
}

Result<std::unique_ptr<Errands>> Errands::create(Dispatcher& dispatcher) {
  auto state = std::make_shared<State>();
  state->event.reset(::eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK));
  if (!state->event) return fail(Errc::os_failure, "making an eventfd", errno);
  std::unique_ptr<Errands> made(new Errands(dispatcher, state));
  Errands* const self = made.get();
  const auto token =
      dispatcher.add(state->event.get(), EPOLLIN, [self](std::uint32_t) { self->answer(); });
  if (!token) return tl::unexpected(token.error());
  made->token_ = *token;
  return made;
}

Errands::~Errands() {
  dispatcher_.remove(token_);
  const std::lock_guard lock(state_->mutex);
  state_->stops = true;
  state_->changed.notify_all();
}

void Errands::run(Lane lane, std::uint32_t uid, std::function<void()> errand,
                  std::function<void()> then) {
  const std::lock_guard lock(state_->mutex);
  state_->add(state_, {uid, lane}, {std::move(errand), std::move(then)});
}

bool Errands::try_run(Lane lane, std::uint32_t uid, std::function<void()> errand,
                      std::function<void()> then) {
  const std::lock_guard lock(state_->mutex);
  if (state_->thread_count == 0 && !state_->begin_thread(state_)) return false;
  state_->add(state_, {uid, lane}, {std::move(errand), std::move(then)});
  return true;
}

std::size_t Errands::waiting(Lane lane, std::uint32_t uid) const {
  const std::lock_guard lock(state_->mutex);
  const auto found = state_->queues.find({uid, lane});
  return found == state_->queues.end() ? 0 : found->second.errands.size();
}

void Errands::answer() {
  eventfd_t count = 0;
  static_cast<void>(::eventfd_read(state_->event.get(), &count));
  std::vector<std::function<void()>> answers;
  {
    const std::lock_guard lock(state_->mutex);
    answers.assign(std::make_move_iterator(state_->answers.begin()),
                   std::make_move_iterator(state_->answers.end()));
    state_->answers.clear();  // keeps what run() has reserved
    if (!state_->ready.empty()) state_->start_thread(state_);
  }
  for (const auto& then : answers) then();
}

}  // namespace agnocast::daemon
