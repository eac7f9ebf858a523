// SPDX-License-Identifier: Apache-2.0

#include <daemon/transport/dispatcher.hpp>

#include <cerrno>
#include <utility>

namespace agnocast::daemon {

Result<Dispatcher> Dispatcher::create() noexcept {
  Dispatcher dispatcher;
  dispatcher.epoll_.reset(::epoll_create1(EPOLL_CLOEXEC));
  if (!dispatcher.epoll_) return fail(Errc::os_failure, "making an epoll set", errno);
  return dispatcher;
}

Result<Dispatcher::Token> Dispatcher::add(int fd, std::uint32_t events, Handler handler) {
  epoll_event event{};
  event.events = events;
  event.data.u64 = last_token_ + 1;
  if (::epoll_ctl(epoll_.get(), EPOLL_CTL_ADD, fd, &event) != 0)
    return fail(Errc::os_failure, "watching a descriptor", errno);
  sources_.emplace(++last_token_, Source{fd, std::make_shared<const Handler>(std::move(handler))});
  return last_token_;
}

void Dispatcher::change(Token token, std::uint32_t events) noexcept {
  const auto found = sources_.find(token);
  if (found == sources_.end()) return;
  epoll_event event{};
  event.events = events;
  event.data.u64 = token;
  ::epoll_ctl(epoll_.get(), EPOLL_CTL_MOD, found->second.fd, &event);
}

void Dispatcher::remove(Token token) noexcept {
  const auto found = sources_.find(token);
  if (found == sources_.end()) return;
  ::epoll_ctl(epoll_.get(), EPOLL_CTL_DEL, found->second.fd, nullptr);
  sources_.erase(found);
}

Result<void> Dispatcher::wait(int timeout_ms) {
  const int count =
      ::epoll_wait(epoll_.get(), events_.data(), static_cast<int>(events_.size()), timeout_ms);
  if (count < 0) {
    if (errno == EINTR) return {};
    return fail(Errc::os_failure, "waiting for events", errno);
  }
  for (int i = 0; i < count; ++i) {
    const epoll_event& event = events_[static_cast<std::size_t>(i)];
    // Copied, because epoll_event is packed on x86-64: find() takes a reference, which must be
    // aligned.
    const std::uint64_t token = event.data.u64;
    const auto found = sources_.find(token);
    if (found == sources_.end()) continue;
    const std::shared_ptr<const Handler> handler = found->second.handler;
    (*handler)(event.events);
  }
  return {};
}

}  // namespace agnocast::daemon
