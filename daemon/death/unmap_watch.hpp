// SPDX-License-Identifier: Apache-2.0
//
// UnmapWatch: finds processes that do not unmap what is over, and so keep its place from others.
//
// By rule RU the place of a gone endpoint is free when each process that was notified of it has
// sent `unlinked`. Beyond a bounded number Endings gives up the oldest: their unread messages are
// lost. Then a living process can want nothing of them but messages that it holds, and a library
// answers as soon as its control thread has read the request. A process that neither holds a
// message nor answers is stopped or broken, and others need what it keeps: places, processes,
// regions, heaps.
//
// Only endpoints that were given up count, so a process may be stopped for as long as it likes
// while others have room. It must have kept the same endpoint mapped in each of many looks, so a
// process that is merely asked for one after the other is never found. Few looks are enough if it
// was sent everything, or reads nothing of it. A process that reads, has no connection or has just
// come back gets more looks, but never more than that, however often it comes back.
//
// One look covers all given-up endpoints of one user's processes, in as many calls as that takes:
// others must not wait for it. Each user has looks of its own, and a time slice in each call: no
// user makes another's look longer.
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
    std::uint64_t generation = 0;  // generation of the oldest
    std::uint64_t count = 0;       // number of such endpoints
  };
  /// Returns all findings, one for each process: revoking one of them alone may make no place
  /// free. To be called about once a second.
  std::vector<Finding> look();
  /// The process is being notified of everything once more.
  void notified_again(ClientIndex client);
  /// Returns whether the process still has not unmapped the endpoint.
  bool is_true(const Finding& finding) const;

 private:
  struct Suspect {
    std::uint64_t generation = 0;  // generation of the oldest endpoint that it is to unmap
    unsigned looks = 0;
    // The last of these looks in a row with nothing left to send, or nothing sent.
    unsigned deaf = 0;
    std::uint64_t sent = 0;  // packets sent on its connection
  };
  /// The running look at one user's endpoints, the generation reached, and its findings.
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
  std::uint32_t next_user_ = 0;            // gets the first time slice
  std::uint64_t steps_ = 0;                // in this call
};

}  // namespace agnocast::daemon
