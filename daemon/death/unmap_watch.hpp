// SPDX-License-Identifier: Apache-2.0
//
// UnmapWatch: finds processes that do not unmap what is over, and so keep its place from others.
//
// By rule RU the place of an endpoint that is gone is free when everybody who was told of it has
// said `unlinked`. Of more than a bounded number Endings gives the oldest up: what is unread there
// is nobody's any more. Then nothing is left that a living process could want of them but messages
// that it holds, and a library answers as soon as its control thread has read that it is to. Who
// neither holds something nor answers is stopped, or broken, and what it keeps is others' to use:
// places, processes, regions, heaps.
//
// Only what was given up counts, so a process may be stopped as long as it likes while others have
// room. It must not have let go of the same endpoint in each of many looks, so nobody is found who
// is merely asked for one after the other. Few looks are enough if it was sent everything, or reads
// nothing of it. Who reads, has no connection or has just come back gets more, and no more than
// that, however often it comes back.
//
// One look goes over everything that one user's processes had and that was given up, in as many
// calls as that takes: others must not wait for it. Each user has looks of its own, and in a call
// its time slice: what one has left behind makes no look at another's longer.
#pragma once

#include <daemon/lifecycle/endings.hpp>
#include <daemon/lifecycle/regions.hpp>
#include <daemon/state/registry.hpp>
#include <daemon/transport/client_channel.hpp>

#include <cstdint>
#include <map>
#include <vector>

namespace agnocast::daemon {

class UnmapWatch {
 public:
  UnmapWatch(const Registry& registry, const Regions& regions, const Endings& endings,
             ClientChannel& channel) noexcept
      : registry_(registry), regions_(regions), endings_(endings), channel_(channel) {}

  struct Finding {
    ClientIndex client{};
    EndpointRef oldest;
    std::uint64_t generation = 0;  // of the oldest
    std::uint64_t count = 0;       // of such endpoints
  };
  /// To be called about once a second. All that were found, a process once: one alone may make no
  /// place free.
  std::vector<Finding> look();
  /// It is told everything once more.
  void notified_again(ClientIndex client);
  /// Whether it still has not let go.
  bool is_true(const Finding& finding) const;

 private:
  struct Suspect {
    std::uint64_t generation = 0;  // of the oldest endpoint that it is to let go of
    unsigned looks = 0;
    // Of them the last ones in a row: nothing is left to be sent, or nothing leaves.
    unsigned deaf = 0;
    std::uint64_t sent = 0;  // packets, on its connection
  };
  /// Of one user: the look that is under way, up to which generation, and what it found.
  struct Round {
    std::uint64_t next = 0;
    std::map<ClientIndex, Finding> debts;
    std::map<ClientIndex, Suspect> suspects;
  };
  bool holds(const SubscriptionRecord& subscription, const EndpointRef& of);
  void note_debtors(Round& round, std::uint64_t generation, const EndpointRef& ref);
  void use_time_slice(std::uint32_t uid, Round& round, std::map<ClientIndex, Finding>& found);
  Suspect looked_at(const Round& round, const Finding& debt) const;
  void conclude(Round& round, std::map<ClientIndex, Finding>& found);

  const Registry& registry_;
  const Regions& regions_;
  const Endings& endings_;
  ClientChannel& channel_;
  std::map<std::uint32_t, Round> rounds_;  // by uid
  std::uint32_t next_user_ = 0;            // whose time slice is the first
  std::uint64_t steps_ = 0;                // of this call
};

}  // namespace agnocast::daemon
