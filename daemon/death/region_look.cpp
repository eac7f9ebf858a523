// SPDX-License-Identifier: Apache-2.0
//
// RegionLook: see the header.

#include <daemon/death/region_look.hpp>

#include <base/clock.hpp>
#include <daemon/death/reaper.hpp>
#include <daemon/state/memory_reserve.hpp>

#include <optional>
#include <utility>

namespace agnocast::daemon {

namespace {

// After a look that took longer than the budget, no process of that user is looked at for so many
// times as long as it took.
constexpr std::uint64_t look_budget_ns = 20'000'000, look_rest = 20;

}  // namespace

bool RegionLook::begin(const Peer& peer, std::function<void(RegionTrace)> then) {
  const MemoryReserve::MustNotFail must_not_fail;
  const std::uint32_t uid = peer.session.identity().uid;
  if (monotonic_ns() < connections_.user(uid).look_due_ns ||
      errands_.waiting(Errands::Lane::looking, uid) >= waiting_max)
    return false;
  struct Look {
    std::optional<bool> maps;
    std::uint64_t took_ns = 0;
  };
  const auto look = std::make_shared<Look>();
  errands_.run(
      Errands::Lane::looking, uid,
      [look, pid = peer.session.identity().pid,
       file = regions_.region_file(*peer.session.client())] {
        const std::uint64_t begin = monotonic_ns();
        look->maps = maps_file(pid, file);
        look->took_ns = monotonic_ns() - begin;
      },
      [this, look, uid, then = std::move(then), here = std::weak_ptr(here_)] {
        if (here.expired()) return;
        if (const auto user = connections_.users().find(uid); user != connections_.users().end())
          user->second.look_due_ns =
              look->took_ns > look_budget_ns ? monotonic_ns() + look->took_ns * look_rest : 0;
        then(!look->maps   ? RegionTrace::unknown
             : *look->maps ? RegionTrace::some
                           : RegionTrace::none);
      });
  return true;
}

}  // namespace agnocast::daemon
