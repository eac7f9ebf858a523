// SPDX-License-Identifier: Apache-2.0

#include <ctl/snapshot/watch.hpp>

#include <base/clock.hpp>

namespace agnocast::ctl {
namespace {

// A restarting daemon is absent for seconds at most.
constexpr int failure_max = 100;
constexpr std::uint64_t retry_ms = 100;
// Changes without a record in the log: connections, refusals, stopped processes.
constexpr std::uint64_t unlogged_ms = 2'000;

}  // namespace

Outcome<Watch> Watch::begin(const std::string& socket, LookOptions options) {
  auto observer = Observer::connect(socket);
  if (!observer) return tl::unexpected(observer.error());
  Watch watch(socket, options, std::move(*observer));
  if (auto seen = watch.look(); !seen) return tl::unexpected(seen.error());
  return watch;
}

Outcome<void> Watch::look() {
  auto log = observer_.read_journal(0, 0);
  if (!log) return tl::unexpected(log.error());
  auto system = observer_.look(options_);
  if (!system) return tl::unexpected(system.error());
  system_ = std::move(*system);
  newest_ = log->end.newest;
  looked_ms_ = monotonic_ms();
  return {};
}

Outcome<void> Watch::renew() {
  if (failures_ == 0) {
    auto log = observer_.read_journal(0, 0);
    if (log && log->end.newest == newest_ && monotonic_ms() - looked_ms_ < unlogged_ms) return {};
    auto seen = log ? look() : tl::unexpected(log.error());
    if (seen || seen.error().status != Status::not_reachable) return seen;
  } else if (monotonic_ms() - looked_ms_ < retry_ms) {
    return {};
  }
  looked_ms_ = monotonic_ms();
  auto observer = Observer::connect(socket_);
  if (!observer)
    return ++failures_ > failure_max ? tl::unexpected(observer.error()) : Outcome<void>();
  // The last system points into the former board until a newer system is there.
  Watch again(socket_, options_, std::move(*observer));
  if (auto seen = again.look(); !seen) return ++failures_ > failure_max ? seen : Outcome<void>();
  *this = std::move(again);
  return {};
}

}  // namespace agnocast::ctl
