// SPDX-License-Identifier: Apache-2.0
//
// Dispatcher: one epoll set, one thread, one handler per descriptor.
//
// A token that is never used twice identifies a source. Descriptor numbers are used again: a
// handler may close one source and open another with the same number while an event of the old one
// still waits in the batch; no source has its token, so the event is dropped.
#pragma once

#include <agnocast/abi/limits.hpp>
#include <agnocast/result.hpp>
#include <base/descriptors/unique_fd.hpp>

#include <sys/epoll.h>

#include <cstdint>
#include <functional>
#include <memory>
#include <unordered_map>
#include <vector>

namespace agnocast::daemon {

class Dispatcher {
 public:
  using Token = std::uint64_t;
  using Handler = std::function<void(std::uint32_t events)>;

  [[nodiscard]] static Result<Dispatcher> create() noexcept;

  /// Watches `fd`, which the caller owns and must remove before closing it. Errors: os_failure
  /// (ENOSPC: fs.epoll.max_user_watches).
  [[nodiscard]] Result<Token> add(int fd, std::uint32_t events, Handler handler);
  void change(Token token, std::uint32_t events) noexcept;
  /// Stops calling its handler. Ignores an unknown token.
  void remove(Token token) noexcept;

  /// Handles pending events, each source once; waits for them at most `timeout_ms` (-1: for ever).
  /// Errors: os_failure.
  [[nodiscard]] Result<void> wait(int timeout_ms);

 private:
  struct Source {
    int fd;
    std::shared_ptr<const Handler> handler;  // survives its own removal while it runs
  };

  UniqueFd epoll_;
  // Connection and process of every client: one wait reports all of them if all are ready.
  std::vector<epoll_event> events_ = std::vector<epoll_event>(2 * abi::client_count_max);
  std::unordered_map<Token, Source> sources_;
  Token last_token_ = 0;
};

}  // namespace agnocast::daemon
