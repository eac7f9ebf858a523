// SPDX-License-Identifier: Apache-2.0

#include <daemon/disposal.hpp>

#include <base/closing.hpp>

#include <sys/socket.h>

#include <algorithm>
#include <array>
#include <map>
#include <mutex>
#include <span>
#include <utility>

namespace agnocast::daemon {
namespace {

// What one thread takes over at most: one that is stuck keeps no more from being closed.
constexpr std::size_t batch_count_max = 64;

}  // namespace

struct Disposal::State {
  std::mutex mutex;
  struct User {
    std::vector<UniqueFd> connections;
    std::size_t closing = 0;
  };
  std::map<std::uint32_t, User> users;
};

Disposal::Disposal(Errands& errands) : errands_(errands), state_(std::make_shared<State>()) {}

void Disposal::close_connection(std::uint32_t uid, UniqueFd connection) {
  if (!connection) return;
  ::shutdown(connection.get(), SHUT_RDWR);
  bool is_first = false;
  {
    const std::lock_guard lock(state_->mutex);
    State::User& user = state_->users[uid];
    user.connections.push_back(std::move(connection));
    is_first = user.connections.size() == 1;
  }
  if (!is_first) return;  // the errand that waits takes it along
  errands_.run(Errands::Lane::closing, uid,
               [state = state_, uid] { close_some(*state, uid); });
}

// Goes on until there are none: the next connection hands in another errand only when it is the first.
void Disposal::close_some(State& state, std::uint32_t uid) {
  for (;;) {
    std::array<UniqueFd, batch_count_max> batch;
    std::size_t count = 0;
    {
      const std::lock_guard lock(state.mutex);
      const auto user = state.users.find(uid);
      if (user == state.users.end()) return;
      auto& all = user->second.connections;
      count = std::min(all.size(), batch_count_max);
      user->second.closing = count;
      if (count == 0) {
        state.users.erase(user);
        return;
      }
      const auto end = all.begin() + static_cast<std::ptrdiff_t>(count);
      std::move(all.begin(), end, batch.begin());
      all.erase(all.begin(), end);
    }
    close_by_ending_thread(std::span(batch).first(count));
  }
}

void Disposal::close_received(std::uint32_t uid, std::vector<UniqueFd> fds) {
  if (fds.empty()) return;
  // std::function wants something to copy.
  auto owned = std::make_shared<std::vector<UniqueFd>>(std::move(fds));
  errands_.run(Errands::Lane::receiving, uid,
               [owned] { agnocast::close_received(*owned); });
}

std::size_t Disposal::waiting(std::uint32_t uid) const {
  const std::lock_guard lock(state_->mutex);
  const auto found = state_->users.find(uid);
  return found == state_->users.end() ? 0
                                      : found->second.connections.size() + found->second.closing;
}

}  // namespace agnocast::daemon
