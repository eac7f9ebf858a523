// SPDX-License-Identifier: Apache-2.0
//
// Oracle: what the daemon may send and assign, judged from the packets alone.
//
// It sees every packet to a process and the result of each request, and records for every process
// what it knows (processes.hpp). It never looks into the daemon's tables: table_checks.hpp
// compares those with each other. Any error aborts.
#pragma once

#include <daemon/transport/request_reading.hpp>
#include <daemon/transport/session.hpp>
#include <journal/cases.hpp>

#include <tests/fuzz/protocol/processes.hpp>

#include <cstddef>
#include <cstdint>
#include <set>
#include <span>
#include <utility>
#include <vector>

namespace agnocast::daemon::fuzz {

class Oracle {
 public:
  explicit Oracle(Processes& processes) : processes_(processes) {}

  // --- what the daemon sends
  /// A request is about to be served: forgets the previous answer.
  void expect_answer() {
    created_ = {};
    done_ = false;
    announced_.clear();
  }
  /// `number`: the packet's number on the connection of `to`.
  void hear(Process& to, std::uint64_t number, const Outgoing& packet);
  /// Checks that an observer's answer ends with `last`, and contains no other one.
  static void check_whole(const std::vector<Outgoing>& packets, Opcode last);

  // --- the result of a request
  void greeted(Process& who, ClientIndex client, std::uint64_t generation);
  void check_rejoin(const Process& who, const wire::Rejoin& request,
                    journal::RejoinDecision decision) const;
  /// Between these two the daemon repeats to `who` what it has and which peers it knows.
  void begin_welcome_back(Process& who);
  void end_welcome_back(const Process& who) const;
  /// Records the ranges that `who` reports as blocked.
  static void blocked(Process& who, const Range& what) { who.blocked.push_back(what); }
  /// Checks a window that the daemon has chosen for `who`.
  static void check_not_blocked(const Process& who, const Range& window);
  void window_given(Process& who, const Range& window);
  /// Returns the endpoint that a request with this id has created, if there is one.
  const Endpoint* created_before(const Process& who, const CreateRequest& request) const;
  void check_answered_again(const Endpoint& endpoint) const;
  void create_served(Process& who, const CreateRequest& request, bool was_made);
  void leave_served(Process& who, const LeaveRequest& request, bool accepted) const;
  void drained_served(Process& who, const DrainedRequest& request, bool accepted) const;
  static void unlinked(Process& who, const wire::Unlinked& statement);
  /// It lives on with its memory and windows; its notifications no longer count.
  static void revoked(Process& who);

 private:
  void hear_announcement(Process& to, const wire::Announcement& body, std::uint64_t packet,
                         std::size_t fd_count);
  void hear_own(const Process& to, const wire::Own& body);
  /// Checks that `own`, an endpoint of `who`, was just notified of the endpoints that match it and
  /// of no other one. With `in_both_directions`, that they were notified of it as well.
  void check_announced(const Process& who, const Endpoint& own, bool in_both_directions) const;

  Processes& processes_;
  wire::EndpointCreated created_{};
  bool done_ = false;
  // Announcements since the request: generation of the notified endpoint, and of the other one.
  std::set<std::pair<std::uint64_t, std::uint64_t>> announced_;
  std::size_t own_reported_ = 0;  // endpoints reported to a process that has come back
  std::uint64_t last_generation_ = 0;
};

}  // namespace agnocast::daemon::fuzz
