// SPDX-License-Identifier: Apache-2.0

#include <daemon/transport/disposal.hpp>

#include <sys/socket.h>

#include <algorithm>
#include <chrono>
#include <map>
#include <mutex>
#include <new>
#include <thread>
#include <utility>

namespace agnocast::daemon {
namespace {

// Interval of checks for the end of a thread while a descriptor waits for it.
constexpr std::chrono::milliseconds pause_first{1}, pause_last{100};
// The errand that hands over belongs to no user; no user has this uid.
constexpr std::uint32_t nobody = UINT32_MAX;

}  // namespace

struct Disposal::State {
  struct User {
    std::vector<UniqueFd> waiting;
    std::vector<UniqueFd> batch;  // being handed over; only the errand uses it
    std::vector<pid_t> closing;   // threads that have not ended, when last looked at
    std::vector<pid_t> receiving;
    std::size_t receiving_count = 0;  // errands without an answer yet

    bool is_idle() const {
      return waiting.empty() && batch.empty() && closing.empty() && receiving.empty() &&
             receiving_count == 0;
    }
  };

  std::mutex mutex;
  std::map<std::uint32_t, User> users;
  bool is_closing = false;    // the errand exists
  bool is_forbidden = false;  // to take over descriptors

  // Under the mutex. Returns whether there is something to hand over now.
  static bool may_begin(User& user) {
    std::erase_if(user.closing, [](pid_t thread) { return has_ended(thread); });
    if (user.batch.empty()) {
      if (!user.closing.empty() && user.waiting.size() < waiting_max) return false;
      user.batch.swap(user.waiting);
    }
    user.closing.reserve(user.closing.size() + 1);
    return !user.batch.empty();
  }
};

Disposal::Disposal(Errands& errands) : errands_(errands), state_(std::make_shared<State>()) {}

void Disposal::close_connection(std::uint32_t uid, UniqueFd connection) {
  if (!connection) return;
  ::shutdown(connection.get(), SHUT_RDWR);
  close(uid, std::move(connection));
}

void Disposal::close(std::uint32_t uid, UniqueFd fd) {
  if (!fd) return;
  bool forbidden = false, is_first = false;
  {
    const std::lock_guard lock(state_->mutex);
    state_->users[uid].waiting.push_back(std::move(fd));
    forbidden = state_->is_forbidden;
    is_first = !forbidden && !std::exchange(state_->is_closing, true);
  }
  if (forbidden) return close_in_place();
  if (!is_first) return;  // the existing errand takes it along
  errands_.run(
      Errands::Lane::closing, nobody, [state = state_] { close_what_waits(*state); },
      [this] { close_in_place(); });
}

// Continues until nothing waits.
void Disposal::close_what_waits(State& state) {
  auto pause = pause_first;
  std::unique_lock lock(state.mutex);
  for (;;) {
    bool waits = false, handed_over = false;
    for (auto at = state.users.begin(); at != state.users.end();) {
      State::User& user = at->second;  // only this errand removes users
      bool begins = false;
      try {
        begins = State::may_begin(user);
      } catch (const std::bad_alloc&) {  // later
      }
      if (begins) {
        lock.unlock();
        const EndingThread thread = close_at_end_of_thread(user.batch);
        lock.lock();
        std::erase_if(user.batch, [](const UniqueFd& fd) { return !fd; });
        if (thread.id != 0) user.closing.push_back(thread.id);
        handed_over = handed_over || user.batch.empty();
        state.is_forbidden = state.is_forbidden || thread.is_forbidden();
      }
      waits = waits || !user.batch.empty() || !user.waiting.empty();
      at = user.is_idle() ? state.users.erase(at) : std::next(at);
    }
    if (!waits || state.is_forbidden) break;
    pause = handed_over ? pause_first : std::min(pause * 2, pause_last);
    lock.unlock();
    std::this_thread::sleep_for(pause);
    lock.lock();
  }
  state.is_closing = false;
}

// Runs in the loop: an errand of each user, which may never end.
void Disposal::close_in_place() {
  for (;;) {
    auto fds = std::make_shared<std::vector<UniqueFd>>();
    std::uint32_t uid = 0;
    {
      const std::lock_guard lock(state_->mutex);
      if (!state_->is_forbidden || state_->is_closing) return;
      const auto user = std::find_if(
          state_->users.begin(), state_->users.end(),
          [](const auto& one) { return !one.second.batch.empty() || !one.second.waiting.empty(); });
      if (user == state_->users.end()) return;
      uid = user->first;
      std::vector<UniqueFd>& batch = user->second.batch;
      fds->swap(batch.empty() ? user->second.waiting : batch);
    }
    errands_.run(Errands::Lane::closing, uid, [fds] { close_received(*fds); });
  }
}

void Disposal::close_memory(std::uint32_t uid, UniqueFd memory) {
  if (!memory) return;
  // std::function must be copyable.
  const auto owned = std::make_shared<UniqueFd>(std::move(memory));
  errands_.run(Errands::Lane::freeing, uid, [owned] { owned->reset(); });
}

bool Disposal::may_receive(std::uint32_t uid) {
  const std::lock_guard lock(state_->mutex);
  const auto user = state_->users.find(uid);
  if (user == state_->users.end()) return true;
  std::erase_if(user->second.receiving, [](pid_t thread) { return has_ended(thread); });
  return user->second.receiving.size() < receiving_max &&
         user->second.receiving_count < receiving_waiting_max;
}

void Disposal::receive(std::uint32_t uid, PacketSocket connection, std::size_t bytes_max,
                       std::function<void(Received&)> then) {
  struct Errand {
    PacketSocket connection;
    Received received;
  };
  const auto errand = std::make_shared<Errand>();
  errand->connection = std::move(connection);
  errand->received.bytes.resize(bytes_max);
  {
    const std::lock_guard lock(state_->mutex);
    State::User& user = state_->users[uid];
    ++user.receiving_count;
    user.receiving.reserve(user.receiving.size() + user.receiving_count);
  }
  errands_.run(
      Errands::Lane::receiving, uid,
      [errand] {
        errand->received.memory =
            receive_memory(std::move(errand->connection), errand->received.bytes);
      },
      [state = state_, errand, uid, then = std::move(then)] {
        {
          const std::lock_guard lock(state->mutex);
          State::User& user = state->users.at(uid);
          --user.receiving_count;
          if (errand->received.memory.thread != 0)
            user.receiving.push_back(errand->received.memory.thread);
        }
        then(errand->received);
      });
}

std::size_t Disposal::stuck(std::uint32_t uid) const {
  const std::lock_guard lock(state_->mutex);
  const auto found = state_->users.find(uid);
  return found == state_->users.end() || found->second.waiting.empty()
             ? 0
             : found->second.closing.size();
}

}  // namespace agnocast::daemon
