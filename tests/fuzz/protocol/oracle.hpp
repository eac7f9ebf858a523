// SPDX-License-Identifier: Apache-2.0
//
// Oracle: what the daemon may send and assign, judged from the packets alone.
//
// It sees every packet that a process receives, so also which answer a request got, and records for
// every process what it knows (processes.hpp). It never looks into the daemon's tables:
// table_checks.hpp compares those with each other. Any error aborts.
#pragma once

#include <agnocast/error.hpp>
#include <base/descriptors/unique_fd.hpp>
#include <daemon/transport/request_reading.hpp>

#include <tests/fuzz/protocol/processes.hpp>

#include <cstddef>
#include <cstdint>
#include <optional>
#include <set>
#include <span>
#include <utility>
#include <vector>

namespace agnocast::daemon::fuzz {

class Oracle {
 public:
  explicit Oracle(Processes& processes) : processes_(processes) {}

  // --- what the daemon sends
  /// A packet as a process received it.
  struct Heard {
    std::span<const std::byte> bytes;
    std::span<const UniqueFd> fds;
  };
  /// A request of a process, or (null) of the observer, is about to be served: forgets the previous
  /// answer. `id`: of the request.
  void expect_answer(const Process* from, std::uint64_t id) {
    answer_ = {};
    answer_.from = from;
    answer_.id = id;
  }
  void hear(Process& to, const Heard& packet);
  void hear_observer(Opcode body) { answer_.observed.push_back(body); }
  /// All that follows from the request was heard and judged.
  void end_answer();

  // --- the answer to a request
  /// Checks that the request has got one answer, or none where it needs none.
  void check_answered(const Request& request) const;
  void hello_served(Process& who, const wire::Hello& request) const;
  void rejoin_served(Process& who, const wire::Rejoin& request) const;
  void window_served(Process& who) const;
  /// `is_its_own`: whether the window that came with the request is the one it claims.
  void window_brought(Process& who, const wire::BringWindow& request, bool is_its_own) const;
  /// Records the ranges that `who` reports as blocked.
  void blocked(Process& who, const wire::Blocked& range) const;
  /// Returns the endpoint that a request with this id has created, if there is one.
  static const Endpoint* created_before(const Process& who, const CreateRequest& request);
  void create_served(Process& who, const CreateRequest& request);
  void leave_served(Process& who, const LeaveRequest& request) const;
  void drained_served(Process& who, const DrainedRequest& request) const;
  void unlinked(Process& who, const wire::Unlinked& statement) const;
  void observer_served(const Request& request) const;
  /// It lives on with its memory and windows; its notifications no longer count.
  static void revoked(Process& who);

 private:
  /// What was heard since the request.
  struct Answer {
    const Process* from = nullptr;
    std::uint64_t id = 0;
    std::size_t count = 0;
    bool done = false, rejoined = false;
    std::optional<Errc> refused;
    std::optional<wire::Welcome> welcome;
    std::optional<wire::WindowOpened> window;
    wire::EndpointCreated created{};
    std::vector<Opcode> observed;  // bodies for the observer
    // Announcements: generation of the notified endpoint, and of the other one.
    std::set<std::pair<std::uint64_t, std::uint64_t>> announced;
    struct NewWindow {
      Process* notified;
      std::uint64_t owner;
      Range window;
    };
    std::vector<NewWindow> windows;
    std::size_t own_count = 0;  // endpoints reported to a process that has come back
  };

  /// Checks that an answer is the one that is expected, and counts it.
  void hear_answer(const Process& to, const wire::Header& header);
  void hear_announcement(Process& to, const wire::Announcement& body, std::size_t fd_count);
  void hear_own(const Process& to, const wire::Own& body);
  void check_welcome_back(const Process& who) const;
  /// Checks a window that the daemon has assigned to `who`.
  void window_given(Process& who, const Range& window) const;
  /// Checks that the answer ends with `last`, and contains no other one.
  void check_whole(Opcode last) const;
  /// Checks that `own`, an endpoint of `who`, was just notified of the endpoints that match it and
  /// of no other one. With `in_both_directions`, that they were notified of it as well.
  void check_announced(const Process& who, const Endpoint& own, bool in_both_directions) const;

  Processes& processes_;
  Answer answer_;
  std::uint64_t last_generation_ = 0;
};

}  // namespace agnocast::daemon::fuzz
